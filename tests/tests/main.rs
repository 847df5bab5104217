//! What no single room can show. One test program for all of it, which is built once and uses all cores.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

mod access;
mod around;
mod both_hands;
mod calibration;
mod carrying;
mod circles;
mod conformance;
mod corpora;
mod either_arm;
mod ended;
mod gaze;
mod golden;
mod guiding;
mod layers;
mod look_around;
mod manifests;
mod new_skill;
mod rules;
mod safety;
mod tare;
mod touching;
mod turning_head;

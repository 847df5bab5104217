//! Any bytes as a frame. What is tried with it is in `tests/src/hostile.rs`.
#![no_main]

use armarium_tests::hostile;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| hostile::frame(bytes));

//! Any text as a chart in an editor, and edits of it. What is tried with it is in `tests/src/hostile.rs`.
#![no_main]

use armarium_tests::hostile;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|text: &str| hostile::edits(text));

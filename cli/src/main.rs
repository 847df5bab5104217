//! The program `armarium`.
fn main() {}

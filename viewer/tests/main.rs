//! Reports, recordings and pictures from outside: read by what others wrote, or by hand. One test program, which is built once and uses all cores.

mod foxglove;
mod mermaid;
#[path = "../../tests/src/outside.rs"]
mod outside;
mod page;
mod recording;

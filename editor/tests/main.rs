//! What an editor is told, as it asks for it. One test program, which is built once and uses all cores.

mod agreement;
mod answers;
mod fixture;
mod names;

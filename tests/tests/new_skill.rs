//! The skill that `armarium new --skill` writes compiles and passes its own test.

#![allow(
    missing_docs,
    unreachable_pub,
    clippy::unwrap_used,
    clippy::upper_case_acronyms,
    reason = "it is a crate of its own, for a user"
)]

#[path = "../../cli/src/template/skill/lib.rs.txt"]
mod template;

#[test]
fn the_template_is_a_skill() {
    let ended = armarium_host::bench::Bench::new(template::NAME::make).run().expect("it runs");
    assert_eq!(ended.outcome, "success");
}

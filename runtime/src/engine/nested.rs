//! Charts inside charts, as the engine runs them.

use std::collections::BTreeMap;

use super::tests::Drive;
use crate::chart::testing::checked;

#[test]
fn history_does_not_reach_into_a_chart_inside() {
    let inner =
        "statechart: Inner\nevents: {go: {}}\ninitial: A\nstates: {A: {transitions: {go: B}}, B: {}}\n";
    let outer = "
statechart: Outer
events: {out: {}, back: {}}
initial: Both
states:
  Both:
    initial: X
    states:
      H: {history: deep, default: X}
      X: {statechart: Inner, transitions: {go: Y}}
      Y: {statechart: Inner}
    transitions: {out: Else}
  Else: {transitions: {back: Both.H}}
";
    let checked = checked(outer, &BTreeMap::from([("inner.yaml", inner)]));
    let mut d = Drive::of(checked.program.unwrap());
    d.take_log();
    // The inner state's transition wins while there is one; then the outer chart's state is left.
    assert_eq!(d.event("go"), "-Both.X.A; +Both.X.B");
    assert_eq!(d.event("go"), "-Both.X.B; -Both.X; +Both.Y; +Both.Y.A");
    assert_eq!(d.event("go"), "-Both.Y.A; +Both.Y.B");
    d.event("out");
    assert_eq!(d.event("back"), "-Else; +Both; +Both.Y; +Both.Y.A");
}

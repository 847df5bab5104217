//! `armarium test FILE...`: cases in YAML beside a chart, played under virtual time, and a table of the transitions that
//! no case takes.

use std::collections::BTreeMap;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use armarium_runtime::chart::Registry;
use armarium_runtime::program::Program;
use armarium_runtime::stepping::{Coverage, Described};
use armarium_runtime::test_cases::TestFile;
use armarium_source::{Finding, Source};

use crate::console;
use armarium_host::catalog;

/// What `test` takes.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct TestArgs {
    /// Files of test cases.
    #[arg(required = true, value_name = "FILE")]
    pub(crate) files: Vec<PathBuf>,
    /// Folders where charts find other charts by name, besides their own.
    #[arg(long, value_name = "DIR")]
    pub(crate) charts: Vec<PathBuf>,
    /// Fail when a transition is not taken by any case.
    #[arg(long)]
    pub(crate) complete: bool,
}

/// A chart that was tested: its program and what the cases of all files took of it.
struct Tested {
    program: Arc<Program>,
    coverage: Coverage,
}

/// Plays all cases and writes how they went. Returns the exit status: 0 when all pass, 1 when one does not, 2 when a file
/// is wrong.
///
/// # Errors
/// When `out` cannot be written.
pub(crate) fn run(args: &TestArgs, out: &mut dyn Write) -> io::Result<u8> {
    let registry = catalog::idle_registry();
    let mut tested: BTreeMap<PathBuf, Tested> = BTreeMap::new();
    let (mut passed, mut failed, mut wrong) = (0, 0, false);
    for file in &args.files {
        match read(file) {
            Err(findings) => {
                console::show(&findings, out)?;
                wrong = true;
            }
            Ok(cases) => {
                let Some(of) = load(file, &cases, args, &registry, &mut tested, out)? else {
                    wrong = true;
                    continue;
                };
                for case in &cases.cases {
                    let (coverage, result) = cases.play(case, &of.program, &registry);
                    of.coverage.extend(coverage);
                    match result {
                        Ok(()) => {
                            passed += 1;
                            writeln!(out, "ok    {}: {}", file.display(), case.case)?;
                        }
                        Err(message) => {
                            failed += 1;
                            writeln!(out, "NO    {}: {}\n      {message}", file.display(), case.case)?;
                        }
                    }
                }
            }
        }
    }
    let mut untaken = 0;
    for (chart, tested) in &tested {
        untaken += table(chart, tested, out)?;
    }
    writeln!(out, "{passed} passed, {failed} failed")?;
    Ok(if wrong { 2 } else { u8::from(failed > 0 || (args.complete && untaken > 0)) })
}

fn read(file: &Path) -> Result<TestFile, Vec<Finding>> {
    TestFile::read(Source::read(file).map_err(|finding| vec![*finding])?)
}

/// The chart that a file tests; what is wrong with it is shown.
fn load<'t>(
    file: &Path,
    cases: &TestFile,
    args: &TestArgs,
    registry: &Registry,
    tested: &'t mut BTreeMap<PathBuf, Tested>,
    out: &mut dyn Write,
) -> io::Result<Option<&'t mut Tested>> {
    let chart = file.parent().unwrap_or(Path::new("")).join(&cases.test);
    if !tested.contains_key(&chart) {
        let checked = catalog::load(&chart, &args.charts, registry);
        let Some(program) = checked.program else {
            console::show(&checked.findings, out)?;
            return Ok(None);
        };
        tested.insert(chart.clone(), Tested { program, coverage: Coverage::default() });
    }
    Ok(tested.get_mut(&chart))
}

/// Writes what no case takes. Returns how many transitions that are.
fn table(chart: &Path, tested: &Tested, out: &mut dyn Write) -> io::Result<usize> {
    let all = tested.coverage.of(&tested.program);
    let untaken: Vec<&Described> = all.iter().filter(|(_, taken)| !taken).map(|(t, _)| t).collect();
    writeln!(
        out,
        "\n{}: {} of {} transitions are taken",
        chart.display(),
        all.len() - untaken.len(),
        all.len()
    )?;
    let widest = untaken.iter().map(|t| t.source.chars().count()).max().unwrap_or(0);
    for Described { source, event, target, guarded } in &untaken {
        let target = if target.is_empty() { "(stays)" } else { target };
        let event = if *guarded { format!("{event} [if]") } else { event.clone() };
        writeln!(out, "  not taken: {source:widest$}  {event:20} -> {target}")?;
    }
    Ok(untaken.len())
}

#[cfg(test)]
mod tests {
    use super::*;

    const CHART: &str = "statechart: C
inputs: {posture: {type: string, default: home}}
outputs: {n: {type: int}}
events: {go: {}, reset: {}}
initial: Move
states:
  Move:
    skill: MoveJoints
    with: {posture: \"${inputs.posture}\"}
    after: {5s: Bad}
    transitions: {success: Wait, failure: Bad}
  Wait:
    watch: {pushed: {if: \"norm(channels.wrist.push) > 6.0\", for: 100ms}}
    transitions: {pushed: Done, go: {target: Done, do: [{log: gone}, {assign: {outputs.n: \"${event.data.n}\"}}]}, reset: Move}
  Done: {final: success}
  Bad: {final: failure}
";

    fn test(cases: &str, complete: bool) -> (u8, String) {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let file = folder.path().join("c.test.yaml");
        std::fs::write(folder.path().join("c.yaml"), CHART).expect("the folder can be written");
        std::fs::write(&file, cases).expect("the folder can be written");
        let mut out = Vec::new();
        let args = TestArgs { files: vec![file], charts: Vec::new(), complete };
        let status = run(&args, &mut out).expect("memory can be written");
        (status, String::from_utf8(out).expect("text is UTF-8"))
    }

    #[test]
    fn cases_pass_and_what_no_case_takes_is_listed() {
        let (status, text) = test(
            "test: c.yaml\nskills: {MoveJoints: {after: 2s}}\ncases:\n\
             - case: it is told\n  steps:\n  - expect: {active: [Move]}\n  - {after: 2s, expect: {active: [Wait]}}\n\
             \x20 - {event: go, data: {n: 3}, expect: {outcome: success, outputs: {n: 3}, log: gone}}\n\
             - case: it is pushed\n  steps:\n  - {after: 3s, channel: wrist, value: {push: [7, 0, 0]}}\n\
             \x20 - {after: 50ms, expect: {active: [Wait]}}\n  - {after: 60ms, expect: {outcome: success}}\n\
             - case: it cannot move\n  skills: {Move: {outcome: failure, reason: no way}}\n  steps:\n\
             \x20 - expect: {outcome: failure, reason: no way}\n\
             - case: it takes too long\n  skills: {MoveJoints: never}\n  steps:\n  - {after: 5s, expect: {outcome: failure}}\n",
            false,
        );
        assert_eq!(status, 0, "{text}");
        assert!(
            text.contains("5 of 6 transitions are taken") && text.contains("4 passed, 0 failed"),
            "{text}"
        );
        assert!(text.contains("not taken: Wait  reset"), "{text}");
    }

    #[test]
    fn a_case_that_fails_says_what_was_found() {
        for (step, part) in [
            ("{expect: {active: [Wait]}}", "step 1: active: [\"Move\"] instead of [\"Wait\"]"),
            ("{expect: {outcome: success}}", "the run has not ended"),
            ("{event: go, from: Nowhere}", "no state `Nowhere`"),
            ("{expect: {log: x}}", "`x` was not said"),
            ("{expect: {locals: {m: 1}}}", "locals.m: nothing instead of 1"),
        ] {
            let (status, text) = test(
                &format!(
                    "test: c.yaml\nskills: {{MoveJoints: never}}\ncases:\n- case: a\n  steps: [{step}]\n"
                ),
                false,
            );
            assert!(status == 1 && text.contains(part), "{step}: {text}");
        }
    }

    #[test]
    fn a_file_that_is_wrong_is_told_from_a_case_that_fails() {
        assert_eq!(test("test: nowhere.yaml\ncases: []\n", false).0, 2);
        assert_eq!(test("test: c.yaml\ncases: []\nskils: {}\n", false).0, 2);
        let (status, text) =
            test("test: c.yaml\ncases: [{case: a, steps: [{event: go, channel: wrist}]}]\n", false);
        assert!(status == 2 && text.contains("one thing") && text.contains("c.test.yaml:2:"), "{text}");
        assert_eq!(test("test: c.yaml\ncases: []\n", false).0, 0);
        assert_eq!(test("test: c.yaml\ncases: []\n", true).0, 1);
    }
}

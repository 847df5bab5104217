//! `armarium test FILE...`: cases in YAML beside a chart, played under virtual time, and a table of the transitions that
//! no case takes.

use std::collections::BTreeMap;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use armarium_host::catalog;
use armarium_runtime::chart::Registry;
use armarium_runtime::program::Program;
use armarium_runtime::stepping::{Coverage, Described};
use armarium_runtime::test_cases::{Programs, TestFile};
use armarium_source::{Disk, Finding, Source};

use crate::console;
use crate::junit::{self, CaseResult, Suite, Verdict};

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
    /// Also write the results as JUnit XML, for CI systems.
    #[arg(long, value_name = "FILE")]
    pub(crate) junit: Option<PathBuf>,
}

/// A chart that was tested: its program and what the cases of all files took of it.
struct Tested {
    program: Arc<Program>,
    coverage: Coverage,
}

/// Plays all cases and writes how they went. Returns the exit status: 0 when all pass, 1 when one does not, 2 when a file
/// is wrong.
pub(crate) fn run(args: &TestArgs, out: &mut dyn Write) -> io::Result<u8> {
    let registry = catalog::idle_registry();
    let mut tested: BTreeMap<PathBuf, Tested> = BTreeMap::new();
    let mut suites = Vec::new();
    for file in &args.files {
        suites.push(suite(file, args, &registry, &mut tested, out)?);
    }
    let count = |is: fn(&Verdict) -> bool| suites.iter().map(|suite| suite.count(is)).sum::<usize>();
    let passed = count(|verdict| *verdict == Verdict::Passed);
    let failed = count(|verdict| matches!(verdict, Verdict::Failed(_)));
    let wrong = count(|verdict| matches!(verdict, Verdict::Error(_))) > 0;
    let mut incomplete = false;
    for (chart, tested) in &tested {
        let untaken = table(chart, tested, out)?;
        incomplete |= !untaken.is_empty();
        if args.complete {
            suites.push(completeness(chart, &untaken));
        }
    }
    writeln!(out, "{passed} passed, {failed} failed")?;
    if let Some(file) = &args.junit
        && let Err(error) = junit::write(file, &suites)
    {
        writeln!(out, "error: the results cannot be written to `{}`: {error}", file.display())?;
        return Ok(2);
    }
    Ok(if wrong { 2 } else { u8::from(failed > 0 || (args.complete && incomplete)) })
}

/// Plays the cases of a file. Where the file or its chart is wrong, the findings stand for its cases.
fn suite(
    file: &Path,
    args: &TestArgs,
    registry: &Registry,
    tested: &mut BTreeMap<PathBuf, Tested>,
    out: &mut dyn Write,
) -> io::Result<Suite> {
    let mut suite = Suite { file: file.display().to_string(), cases: Vec::new() };
    let (cases, programs) = match load(file, args, registry) {
        Ok((cases, programs, warnings)) => {
            if !warnings.is_empty() {
                console::show(&warnings, out)?;
            }
            (cases, programs)
        }
        Err(findings) => {
            console::show(&findings, out)?;
            let lines: Vec<String> = findings.iter().map(ToString::to_string).collect();
            let verdict = Verdict::Error(lines.join("\n"));
            suite.cases.push(CaseResult {
                name: "the file is in order".into(),
                took: Duration::ZERO,
                verdict,
            });
            return Ok(suite);
        }
    };
    let chart = file.parent().unwrap_or(Path::new("")).join(&cases.test);
    let of = tested
        .entry(chart)
        .or_insert_with(|| Tested { program: Arc::clone(&programs.all), coverage: Coverage::default() });
    for (case, program) in cases.cases.iter().zip(&programs.cases) {
        let (took, (coverage, result)) = timed(|| cases.play(case, program));
        of.coverage.extend(coverage);
        let verdict = match result {
            Ok(()) => {
                writeln!(out, "ok    {}: {}", file.display(), case.case)?;
                Verdict::Passed
            }
            Err(error) => {
                writeln!(out, "NO    {}: {}\n      {error}", file.display(), case.case)?;
                Verdict::Failed(error.to_string())
            }
        };
        suite.cases.push(CaseResult { name: case.case.clone(), took, verdict });
    }
    Ok(suite)
}

#[expect(clippy::disallowed_methods, reason = "the results say how long a case took by the wall")]
fn timed<T>(work: impl FnOnce() -> T) -> (Duration, T) {
    let began = Instant::now();
    let result = work();
    (began.elapsed(), result)
}

/// The cases of a file, the programs of the chart that it tests, and warnings; or everything that is wrong with them.
fn load(
    file: &Path,
    args: &TestArgs,
    registry: &Registry,
) -> Result<(TestFile, Programs, Vec<Finding>), Vec<Finding>> {
    let source = Source::read(file).map_err(|finding| vec![*finding])?;
    let cases = TestFile::read(Arc::clone(&source))?;
    let programs = cases.programs(&source, &args.charts, &Disk, registry, &catalog::channels())?;
    let findings = TestFile::check(source, &programs, registry);
    if findings.iter().any(Finding::is_error) { Err(findings) } else { Ok((cases, programs, findings)) }
}

/// Whether the cases take every transition, as a result of its own.
fn completeness(chart: &Path, untaken: &[String]) -> Suite {
    let verdict = match untaken {
        [] => Verdict::Passed,
        untaken => Verdict::Failed(format!(
            "{} transitions are not taken by any case\n{}",
            untaken.len(),
            untaken.join("\n")
        )),
    };
    let case = CaseResult { name: "every transition is taken".into(), took: Duration::ZERO, verdict };
    Suite { file: chart.display().to_string(), cases: vec![case] }
}

/// Writes what no case takes, and returns it, one line a transition.
fn table(chart: &Path, tested: &Tested, out: &mut dyn Write) -> io::Result<Vec<String>> {
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
    let mut lines = Vec::new();
    for Described { source, event, target, guarded } in &untaken {
        let target = if target.is_empty() { "(stays)" } else { target };
        let event = if *guarded { format!("{event} [if]") } else { event.clone() };
        writeln!(out, "  not taken: {source:widest$}  {event:20} -> {target}")?;
        lines.push(format!("{source}: {event} -> {target}"));
    }
    Ok(lines)
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
        let (status, text, _) = results(cases, complete);
        (status, text)
    }

    /// The exit status, what is printed, and the results for CI.
    fn results(cases: &str, complete: bool) -> (u8, String, String) {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let file = folder.path().join("c.test.yaml");
        std::fs::write(folder.path().join("c.yaml"), CHART).expect("the folder can be written");
        std::fs::write(&file, cases).expect("the folder can be written");
        let mut out = Vec::new();
        let junit = Some(folder.path().join("out/results.xml"));
        let args = TestArgs { files: vec![file], charts: Vec::new(), complete, junit };
        let status = run(&args, &mut out).expect("memory can be written");
        let junit = std::fs::read_to_string(folder.path().join("out/results.xml")).expect("it was written");
        let junit = junit.replace(&format!("{}/", folder.path().display()), "");
        (status, String::from_utf8(out).expect("text is UTF-8"), junit)
    }

    #[test]
    fn ci_gets_every_case_findings_and_what_is_not_taken() {
        let (status, _, xml) = results(
            "test: c.yaml\nskills: {MoveJoints: never}\ncases:\n- case: it <works>\n  steps: [{expect: {active: [Move]}}]\n\
             - case: it does not\n  steps: [{expect: {outcome: success}}]\n",
            true,
        );
        assert_eq!(status, 1);
        for part in [
            "<testsuites name=\"armarium test\" tests=\"3\" failures=\"2\" errors=\"0\"",
            "<testcase name=\"it &lt;works&gt;\" classname=\"c\" file=\"c.test.yaml\"",
            "<failure message=\"step 1: the run has not ended",
            "<testcase name=\"every transition is taken\" classname=\"c\" file=\"c.yaml\"",
            "6 transitions are not taken by any case&#10;Move: success -&gt; Wait&#10;",
        ] {
            assert!(xml.contains(part), "{part}: {xml}");
        }
        for cases in [
            "test: c.yaml\ncases:\n- case: a\n  given: {postur: home}\n",
            "test: nowhere.yaml\ncases: []\n",
            "test: [",
        ] {
            let (status, _, xml) = results(cases, false);
            assert_eq!(status, 2);
            assert!(xml.contains("tests=\"1\" failures=\"0\" errors=\"1\""), "{xml}");
            assert!(xml.contains("<error message=\"") && xml.contains(": error[E0"), "{xml}");
        }
    }

    #[test]
    fn results_that_cannot_be_written_are_an_error() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        std::fs::write(folder.path().join("c.yaml"), CHART).expect("the folder can be written");
        let file = folder.path().join("c.test.yaml");
        std::fs::write(&file, "test: c.yaml\ncases: []\n").expect("the folder can be written");
        let junit = Some(folder.path().to_owned());
        let args = TestArgs { files: vec![file], charts: Vec::new(), complete: false, junit };
        let mut out = Vec::new();
        assert_eq!(run(&args, &mut out).expect("memory can be written"), 2);
        let text = String::from_utf8(out).expect("text is UTF-8");
        assert!(text.contains("error: the results cannot be written to"), "{text}");
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
            ("{expect: {log: x}}", "`x` was not said"),
            ("{expect: {outputs: {n: 1}}}", "outputs.n: nothing instead of 1"),
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
    fn what_a_file_names_is_held_against_the_chart() {
        for (case, message) in [
            ("steps: [{event: go, from: Nowhere}]", "there is no state `Nowhere`"),
            ("steps: [{event: gone}]", "the chart takes no event `gone`"),
            ("steps: [{event: pushd, from: Wait}]", "outcome or watch of `Wait` called `pushd`"),
            ("steps: [{channel: wirst, value: {push: [1]}}]", "there is no channel `wirst`"),
            ("steps: [{channel: wrist, value: {psh: [1]}}]", "there is no field `psh`"),
            ("steps: [{channel: wrist, value: {push: far}}]", "error[E016]"),
            ("steps: [{expect: {locals: {m: 1}}}]", "there is no local `m`"),
            ("steps: [{expect: {active: [Waits]}}]", "did you mean `Wait`?"),
            ("steps: [{expect: {outcome: won}}]", "outcome of the chart called `won`"),
            ("given: {postur: home}", "there is no input `postur`"),
            ("profile: fast", "there is no profile `fast`"),
            ("skills: {MoveJonts: never}", "did you mean `MoveJoints`?"),
            ("skills: {OpenHand: never}", "the chart does not use the skill `OpenHand`"),
            ("skills: {Move: blocked}", "there is no outcome `blocked`"),
        ] {
            let (status, text) = test(&format!("test: c.yaml\ncases:\n- case: a\n  {case}\n"), false);
            assert!(status == 2 && text.contains(message) && text.contains("c.test.yaml:"), "{case}: {text}");
        }
    }

    #[test]
    fn charts_inside_can_be_stood_in_for() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let write = |name: &str, text: &str| {
            std::fs::write(folder.path().join(name), text).expect("the folder can be written");
        };
        write(
            "Inner.yaml",
            "statechart: Inner\noutputs: {n: {type: int, default: 1}}\ninitial: A\nstates:\n  A: {after: {1s: Tired}}\n  Tired: {final: tired}\n",
        );
        write(
            "outer.yaml",
            "statechart: Outer\ninitial: In\nstates:\n  In: {statechart: Inner, after: {10s: Failed}, transitions: {tired: Done}}\n  Done: {final: success}\n  Failed: {final: failure}\n",
        );
        let cases = |charts: &str| {
            write(
                "outer.test.yaml",
                &format!(
                    "test: outer.yaml\ncharts: {{{charts}}}\ncases:\n- case: a\n  steps: [{{expect: {{outcome: success}}}}]\n"
                ),
            );
            let files = vec![folder.path().join("outer.test.yaml")];
            let mut out = Vec::new();
            let args = TestArgs { files, charts: Vec::new(), complete: false, junit: None };
            let status = run(&args, &mut out).expect("memory can be written");
            (status, String::from_utf8(out).expect("text is UTF-8"))
        };
        assert_eq!(cases("Inner: tired").0, 0);
        assert_eq!(cases("Inner: {outcome: tired, outputs: {n: 7}}").0, 0);
        assert_eq!(cases("").0, 1, "the chart inside takes a second");
        let (status, text) = cases("Iner: tired");
        assert!(status == 2 && text.contains("stands in for `Iner`"), "{text}");
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

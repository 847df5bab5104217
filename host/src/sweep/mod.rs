//! Many runs of one chart: each seed with each choice of inputs, in processes of their own; how many succeed, and what the
//! figures are. A sweep that was ended goes on where it stopped.
//!
//! It knows no figure by its name: a run says what it measured and what is asked of it.

mod page;

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{BufRead as _, BufReader, ErrorKind, Write as _};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use armarium_values::report::Figure;
use parking_lot::Mutex;
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use crate::error::HostError;

pub use page::write_page;

/// The file of a sweep's folder that has a line for each run.
const RUNS: &str = "sweep.jsonl";
/// The quantile of the normal distribution for 95 %.
const Z: f64 = 1.959_964;

/// What is run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SweepConfig {
    /// The chart.
    pub chart: PathBuf,
    /// The arguments of `armarium run` that all runs share, without the chart, `--seed`, `--set` of what varies, and `--report`.
    pub arguments: Vec<String>,
    /// The seeds.
    pub seeds: Vec<u64>,
    /// Inputs of the chart, each with the values that it takes in turn.
    pub inputs: Vec<(String, Vec<String>)>,
}

/// A run that has ended.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SweptRun {
    /// Its seed.
    pub seed: u64,
    /// The inputs that vary.
    pub inputs: BTreeMap<String, String>,
    /// How it ended; `error` when it could not begin or its process died.
    pub outcome: String,
    /// Why, unless it succeeded.
    pub reason: Option<String>,
    /// What was measured, with what is asked of it.
    pub figures: Vec<Figure>,
    /// The folder of its report, within that of the sweep.
    pub folder: PathBuf,
}

impl SweptRun {
    /// Whether it succeeded and every figure is as required.
    #[must_use]
    pub fn held(&self) -> bool {
        self.outcome == "success" && self.figures.iter().all(|figure| figure.passed() != Some(false))
    }

    /// The figures that are not as required.
    pub fn failed_figures(&self) -> impl Iterator<Item = &Figure> {
        self.figures.iter().filter(|figure| figure.passed() == Some(false))
    }
}

/// The rate of what held among runs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Rate {
    /// How many held.
    pub held: usize,
    /// How many there were.
    pub runs: usize,
    /// The 95 % confidence interval of the rate.
    pub interval: [f64; 2],
}

impl Rate {
    /// The rate with Wilson's score interval.
    ///
    /// # Source
    /// Wilson, Probable inference, the law of succession, and statistical inference, JASA 22 (1927).
    #[must_use]
    pub fn of(held: usize, runs: usize) -> Self {
        if runs == 0 {
            return Self { held, runs, interval: [0.0, 1.0] };
        }
        let (n, p) = (runs as f64, held as f64 / runs as f64);
        let middle = p + Z * Z / (2.0 * n);
        let half = Z * (p * (1.0 - p) / n + Z * Z / (4.0 * n * n)).sqrt();
        let scale = 1.0 + Z * Z / n;
        Self {
            held,
            runs,
            interval: [((middle - half) / scale).max(0.0), ((middle + half) / scale).min(1.0)],
        }
    }
}

/// A sweep while it runs.
struct RunningSweep {
    waiting: std::vec::IntoIter<Choice>,
    runs: Vec<SweptRun>,
    log: File,
    /// Why it does not go on.
    failed: Option<HostError>,
}

/// Runs what is missing in `folder`, `jobs` at a time, with the program `armarium`. `ended` is called after each run with it, how
/// many have ended, and how many there are. Returns all runs, in the order of inputs and seeds.
///
/// # Errors
/// [`HostError::File`] when the folder cannot be used, [`HostError::OtherSweep`] when it holds another sweep, [`HostError::Refused`] when the
/// first run with some inputs cannot begin because of a wrong file or argument: the others would not, either.
pub fn sweep(
    config: &SweepConfig,
    (program, folder, jobs): (&Path, &Path, usize),
    ended: &(dyn Fn(&SweptRun, usize, usize) + Sync),
) -> Result<Vec<SweptRun>, HostError> {
    std::fs::create_dir_all(folder).map_err(|source| file_error(folder, source))?;
    let known = runs_of(folder, config)?;
    let choices = choices(config);
    let path = folder.join(RUNS);
    let log = OpenOptions::new().append(true).open(&path).map_err(|e| file_error(&path, e))?;
    let find = |runs: &[SweptRun], (seed, inputs): &Choice| {
        runs.iter().find(|run| run.seed == *seed && run.inputs == *inputs).cloned()
    };
    let waiting: Vec<_> = choices.iter().filter(|choice| find(&known, choice).is_none()).cloned().collect();
    let progress = Mutex::new(RunningSweep { waiting: waiting.into_iter(), runs: known, log, failed: None });
    let next = || {
        let mut progress = progress.lock();
        if progress.failed.is_some() { None } else { progress.waiting.next() }
    };
    let work = || {
        while let Some(choice) = next() {
            let (run, refused) = one(config, (program, folder), choice);
            let count = {
                let mut progress = progress.lock();
                if let Some(said) =
                    refused.filter(|_| progress.runs.iter().all(|known| known.inputs != run.inputs))
                {
                    progress.failed = Some(HostError::Refused { said });
                    return;
                }
                let line = serde_json::to_string(&run).unwrap_or_default() + "\n";
                let written = progress.log.write_all(line.as_bytes()).and_then(|()| progress.log.sync_data());
                if let Err(error) = written {
                    progress.failed = Some(file_error(&path, error));
                    return;
                }
                progress.runs.push(run.clone());
                progress.runs.len()
            };
            ended(&run, count, choices.len());
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..jobs.max(1) {
            scope.spawn(work);
        }
    });
    let RunningSweep { runs, failed, .. } = progress.into_inner();
    match failed {
        Some(error) => Err(error),
        None => Ok(choices.iter().filter_map(|choice| find(&runs, choice)).collect()),
    }
}

fn file_error(path: &Path, source: std::io::Error) -> HostError {
    HostError::File { what: "the sweep cannot use", path: path.to_owned(), source }
}

/// A seed with a value for each input that varies.
type Choice = (u64, BTreeMap<String, String>);

/// Each choice of inputs with each seed.
fn choices(config: &SweepConfig) -> Vec<Choice> {
    let mut all = vec![BTreeMap::new()];
    for (name, values) in &config.inputs {
        let with = |choice: &BTreeMap<String, String>| {
            let (name, choice) = (name.clone(), choice.clone());
            values.iter().map(move |value| {
                let mut choice = choice.clone();
                choice.insert(name.clone(), value.clone());
                choice
            })
        };
        all = all.iter().flat_map(with).collect();
    }
    all.into_iter().flat_map(|choice| config.seeds.iter().map(move |seed| (*seed, choice.clone()))).collect()
}

/// The runs that a folder holds; begins its file where there is none. A last line that was cut by a crash does not count.
fn runs_of(folder: &Path, config: &SweepConfig) -> Result<Vec<SweptRun>, HostError> {
    let path = folder.join(RUNS);
    // Seeds and values may be added to a sweep; what all runs share may not change.
    let files: BTreeMap<String, String> = files(config).collect();
    let shared = serde_json::json!({"chart": config.chart, "arguments": config.arguments, "files": files});
    let text = match std::fs::read_to_string(&path) {
        Ok(text) => text,
        Err(error) if error.kind() == ErrorKind::NotFound => {
            std::fs::write(&path, format!("{shared}\n")).map_err(|e| file_error(&path, e))?;
            return Ok(Vec::new());
        }
        Err(error) => return Err(file_error(&path, error)),
    };
    let whole = &text[..text.rfind('\n').map_or(0, |end| end + 1)];
    let mut lines = whole.lines();
    let first = lines.next().and_then(|line| serde_json::from_str::<serde_json::Value>(line).ok());
    if first.as_ref() != Some(&shared) {
        return Err(HostError::OtherSweep { path: folder.to_owned() });
    }
    if whole.len() < text.len() {
        std::fs::write(&path, whole).map_err(|e| file_error(&path, e))?;
    }
    Ok(lines.filter_map(|line| serde_json::from_str(line).ok()).collect())
}

/// The files that are named for all runs, and the world beside the chart, each with the digest of what it holds.
fn files(config: &SweepConfig) -> impl Iterator<Item = (String, String)> {
    let beside = config.chart.with_extension("world.yaml");
    let named = config.arguments.iter().map(PathBuf::from).chain([config.chart.clone(), beside]);
    named.filter_map(|path| {
        let digest = Sha256::digest(std::fs::read(&path).ok()?);
        Some((path.display().to_string(), digest.iter().map(|byte| format!("{byte:02x}")).collect()))
    })
}

/// One run, in a process of its own; and what that said if it refused its files or arguments.
fn one(
    config: &SweepConfig,
    (program, folder): (&Path, &Path),
    (seed, inputs): Choice,
) -> (SweptRun, Option<String>) {
    let inside = folder_of(seed, &inputs);
    let report = folder.join(&inside);
    // Runs at the same time do not share what they learn, and one that is run again begins anew.
    let store = report.join("motions.redb");
    let mut command = Command::new(program);
    command.arg("run").arg(&config.chart).args(&config.arguments).args(["--force", "--json", "--seed"]);
    command.arg(seed.to_string()).arg("--report").arg(&report).arg("--store").arg(&store);
    command.args(inputs.iter().flat_map(|(name, value)| ["--set".to_owned(), format!("{name}={value}")]));
    let begun = std::fs::create_dir_all(&report).and_then(|()| match std::fs::remove_file(&store) {
        Err(error) if error.kind() != ErrorKind::NotFound => Err(error),
        _ => command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn(),
    });
    let Ended { outcome, reason, figures, refused } = match begun {
        Ok(child) => wait_for(child),
        Err(error) => Ended::error(format!("`{}` cannot be started: {error}", program.display())),
    };
    (SweptRun { seed, inputs, outcome, reason, figures, folder: inside }, refused)
}

/// The name of the folder of a run's report.
fn folder_of(seed: u64, inputs: &BTreeMap<String, String>) -> PathBuf {
    let word = |text: &str| -> String {
        text.chars().map(|c| if c.is_alphanumeric() || "-_.".contains(c) { c } else { '_' }).collect()
    };
    let chosen: String =
        inputs.iter().map(|(name, value)| format!("{}-{}-", word(name), word(value))).collect();
    PathBuf::from(format!("{chosen}seed-{seed}"))
}

/// The last line that `armarium run --json` prints.
#[derive(Deserialize)]
struct Ended {
    outcome: String,
    reason: Option<String>,
    figures: Vec<Figure>,
    /// What it said, of one that refused its files or arguments.
    #[serde(skip)]
    refused: Option<String>,
}

/// The exit status of `armarium run` where a file or argument is wrong.
const REFUSED: i32 = 2;

impl Ended {
    fn error(reason: String) -> Self {
        Self { outcome: "error".into(), reason: Some(reason), figures: Vec::new(), refused: None }
    }
}

/// Waits for the end of a run.
fn wait_for(mut child: Child) -> Ended {
    let (out, errors) = (child.stdout.take(), child.stderr.take());
    let (last, errors) = std::thread::scope(|scope| {
        let errors = scope.spawn(move || {
            // The first lines say why; the others are read so that the child can go on.
            let mut lines =
                errors.into_iter().flat_map(|said| BufReader::new(said).lines().map_while(Result::ok));
            let first: Vec<String> = lines.by_ref().take(20).collect();
            lines.for_each(drop);
            first.join(" ")
        });
        let lines = out.into_iter().flat_map(|out| BufReader::new(out).lines().map_while(Result::ok));
        (lines.last().unwrap_or_default(), errors.join().unwrap_or_default())
    });
    let status = child.wait();
    serde_json::from_str(&last).unwrap_or_else(|_| {
        let refused = status.as_ref().is_ok_and(|status| status.code() == Some(REFUSED));
        let said = || errors.split_once("error: ").map_or(errors.as_str(), |(_, said)| said).to_owned();
        let refused = refused.then(said);
        let status = status.map_or_else(|error| error.to_string(), |status| status.to_string());
        Ended { refused, ..Ended::error(format!("{status}: {errors}")) }
    })
}

/// The runs by their inputs.
#[must_use]
pub fn groups(runs: &[SweptRun]) -> Vec<(String, Vec<&SweptRun>)> {
    let mut groups: Vec<(String, Vec<&SweptRun>)> = Vec::new();
    for run in runs {
        let name =
            run.inputs.iter().map(|(name, value)| format!("{name}={value}")).collect::<Vec<_>>().join(" ");
        match groups.iter_mut().find(|(known, _)| *known == name) {
            Some((_, group)) => group.push(run),
            None => groups.push((name, vec![run])),
        }
    }
    groups
}

/// The rate of some runs.
#[must_use]
pub fn rate(runs: &[&SweptRun]) -> Rate {
    Rate::of(runs.iter().filter(|run| run.held()).count(), runs.len())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config() -> SweepConfig {
        SweepConfig {
            chart: "c.yaml".into(),
            arguments: Vec::new(),
            seeds: vec![1, 2],
            inputs: vec![("a".into(), vec!["1".into(), "2".into()]), ("b".into(), vec!["x".into()])],
        }
    }

    #[test]
    fn intervals_are_those_of_wilson() {
        // Newcombe, Two-sided confidence intervals for the single proportion (1998), table I: 81 of 263, 15 of 148, 0 of 20.
        for (held, runs, low, high) in
            [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611)]
        {
            let [a, b] = Rate::of(held, runs).interval;
            assert!((a - low).abs() < 1e-4 && (b - high).abs() < 1e-4, "{held} of {runs}: {a} {b}");
        }
        assert_eq!(Rate::of(0, 0).interval, [0.0, 1.0]);
    }

    #[test]
    fn every_choice_of_inputs_meets_every_seed() {
        let choices = choices(&config());
        let shown: Vec<String> = choices.iter().map(|(seed, inputs)| format!("{seed}{inputs:?}")).collect();
        assert_eq!(
            shown,
            [
                "1{\"a\": \"1\", \"b\": \"x\"}",
                "2{\"a\": \"1\", \"b\": \"x\"}",
                "1{\"a\": \"2\", \"b\": \"x\"}",
                "2{\"a\": \"2\", \"b\": \"x\"}"
            ]
        );
    }

    #[test]
    fn a_sweep_goes_on_after_a_crash_and_refuses_the_folder_of_another() {
        let folder = tempfile::tempdir().expect("a folder");
        let config = config();
        assert!(runs_of(folder.path(), &config).expect("it is new").is_empty());
        let run = SweptRun {
            seed: 1,
            inputs: BTreeMap::new(),
            outcome: "failure".into(),
            reason: Some("slippery".into()),
            figures: Vec::new(),
            folder: "seed-1".into(),
        };
        let path = folder.path().join(RUNS);
        let line = serde_json::to_string(&run).expect("it has only names");
        let begun = std::fs::read_to_string(&path).expect("it was begun");
        std::fs::write(&path, format!("{begun}{line}\n{}", &line[..20])).expect("it can be written");
        assert_eq!(runs_of(folder.path(), &config).expect("it is the same sweep"), [run]);
        assert!(std::fs::read_to_string(&path).expect("it is there").ends_with("}\n"));
        let other = SweepConfig { chart: "d.yaml".into(), ..config };
        assert!(matches!(runs_of(folder.path(), &other), Err(HostError::OtherSweep { .. })));
    }

    #[test]
    fn a_sweep_does_not_go_on_with_another_world() {
        let folder = tempfile::tempdir().expect("a folder");
        let world = folder.path().join("a.world.yaml");
        std::fs::write(&world, "world: a").expect("it can be written");
        let arguments = vec!["--world".into(), world.display().to_string()];
        let config = SweepConfig { arguments, ..config() };
        for _ in 0..2 {
            assert!(runs_of(folder.path(), &config).expect("it is the same sweep").is_empty());
        }
        std::fs::write(&world, "world: b").expect("it can be written");
        assert!(matches!(runs_of(folder.path(), &config), Err(HostError::OtherSweep { .. })));
    }

    #[test]
    fn a_program_that_does_not_start_or_says_nothing_is_a_failed_run() {
        let folder = tempfile::tempdir().expect("a folder");
        let config = SweepConfig { inputs: Vec::new(), ..config() };
        for program in ["/there/is/none", "/bin/false"] {
            let place = folder.path().join(program.rsplit('/').next().unwrap_or(""));
            let runs = sweep(&config, (Path::new(program), &place, 2), &|_, _, _| {}).expect("it goes on");
            assert_eq!(runs.len(), 2);
            assert!(runs.iter().all(|run| run.outcome == "error" && run.reason.is_some()), "{runs:?}");
            let page = write_page(&config, &runs, &place).expect("it can be written");
            assert!(std::fs::read_to_string(page).expect("it is there").contains("0 of 2"));
        }
    }
}

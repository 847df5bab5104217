//! Many runs of one chart: each seed with each choice of inputs, in processes of their own; how many succeed, and what the
//! figures are. A sweep that was ended goes on where it stopped.
//!
//! It knows no figure by its name: a run says what it measured and what is asked of it.

use std::collections::BTreeMap;
use std::io::{BufRead as _, BufReader, Write as _};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use armarium_values::report::{Block, Cell, Column, Figure, Section, Table};
use armarium_viewer::report::{self, ReportData};
use parking_lot::Mutex;
use serde::{Deserialize, Serialize};

use crate::error::HostError;

/// The file of a sweep's folder that has a line for each run.
const RUNS: &str = "sweep.jsonl";
/// The page of a sweep.
const PAGE: &str = "sweep.html";
/// Runs whose reports the page names, of those that did not hold or came closest to that.
const WORST: usize = 10;
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
pub struct Run {
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

impl Run {
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

/// Runs what is missing in `folder`, `jobs` at a time, with the program `armarium`. `ended` is called after each run. Returns all
/// runs, in the order of inputs and seeds; fewer when the user has stopped one.
///
/// # Errors
/// [`HostError::File`] when the folder cannot be used, [`HostError::OtherSweep`] when it holds another sweep.
pub fn sweep(
    config: &SweepConfig,
    (program, folder, jobs): (&Path, &Path, usize),
    ended: &(dyn Fn(&Run, usize, usize) + Sync),
) -> Result<Vec<Run>, HostError> {
    std::fs::create_dir_all(folder).map_err(|source| file_error(folder, source))?;
    let known = runs_of(folder, config)?;
    let cells: Vec<(u64, BTreeMap<String, String>)> = cells(config);
    let path = folder.join(RUNS);
    let log = std::fs::OpenOptions::new().append(true).open(&path).map_err(|e| file_error(&path, e))?;
    let find = |runs: &[Run], (seed, inputs): &(u64, BTreeMap<String, String>)| {
        runs.iter().find(|run| run.seed == *seed && run.inputs == *inputs).cloned()
    };
    let waiting: Vec<_> = cells.iter().filter(|cell| find(&known, cell).is_none()).cloned().collect();
    let done = known.len();
    let state = Mutex::new((waiting.into_iter(), known, log, None));
    std::thread::scope(|scope| {
        for _ in 0..jobs.max(1) {
            scope.spawn(|| {
                loop {
                    let next = {
                        let mut state = state.lock();
                        if state.3.is_some() { None } else { state.0.next() }
                    };
                    let Some((seed, inputs)) = next else { return };
                    let run = one(config, (program, folder), seed, inputs);
                    let mut state = state.lock();
                    if run.outcome == "stopped" {
                        // The user ended it: it is run again when the sweep goes on.
                        state.3 = Some(Ok(()));
                        return;
                    }
                    let line = serde_json::to_string(&run).unwrap_or_default() + "\n";
                    if let Err(error) = state.2.write_all(line.as_bytes()).and_then(|()| state.2.sync_data())
                    {
                        state.3 = Some(Err(error));
                        return;
                    }
                    state.1.push(run.clone());
                    let count = state.1.len();
                    drop(state);
                    ended(&run, count, cells.len());
                }
            });
        }
    });
    let (_, runs, _, stopped) = state.into_inner();
    if let Some(Err(error)) = stopped {
        return Err(file_error(&path, error));
    }
    debug_assert!(runs.len() >= done);
    Ok(cells.iter().filter_map(|cell| find(&runs, cell)).collect())
}

fn file_error(path: &Path, source: std::io::Error) -> HostError {
    HostError::File { what: "the sweep cannot use", path: path.to_owned(), source }
}

/// Each choice of inputs with each seed.
fn cells(config: &SweepConfig) -> Vec<(u64, BTreeMap<String, String>)> {
    let mut choices = vec![BTreeMap::new()];
    for (name, values) in &config.inputs {
        let with = |choice: &BTreeMap<String, String>| {
            let (name, choice) = (name.clone(), choice.clone());
            values.iter().map(move |value| {
                let mut choice = choice.clone();
                choice.insert(name.clone(), value.clone());
                choice
            })
        };
        choices = choices.iter().flat_map(with).collect();
    }
    choices
        .into_iter()
        .flat_map(|choice| config.seeds.iter().map(move |seed| (*seed, choice.clone())))
        .collect()
}

/// The runs that a folder holds; begins its file where there is none. A last line that was cut by a crash does not count.
fn runs_of(folder: &Path, config: &SweepConfig) -> Result<Vec<Run>, HostError> {
    let path = folder.join(RUNS);
    // Seeds and values may be added to a sweep; what all runs share may not change.
    let shared = serde_json::json!({"chart": config.chart, "arguments": config.arguments});
    let text = match std::fs::read_to_string(&path) {
        Ok(text) => text,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
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

/// One run, in a process of its own.
fn one(
    config: &SweepConfig,
    (program, folder): (&Path, &Path),
    seed: u64,
    inputs: BTreeMap<String, String>,
) -> Run {
    let word = |text: &str| {
        text.chars()
            .map(|c| if c.is_alphanumeric() || "-_.".contains(c) { c } else { '_' })
            .collect::<String>()
    };
    let choice: String =
        inputs.iter().map(|(name, value)| format!("{}-{}-", word(name), word(value))).collect();
    let inside = PathBuf::from(format!("{choice}seed-{seed}"));
    let mut command = Command::new(program);
    command.arg("run").arg(&config.chart).args(&config.arguments);
    command
        .arg("--seed")
        .arg(seed.to_string())
        .arg("--report")
        .arg(folder.join(&inside))
        .args(["--force", "--json"]);
    // Runs at the same time do not share what they learn.
    command.arg("--store").arg(folder.join(&inside).join("motions.redb"));
    command.args(inputs.iter().flat_map(|(name, value)| ["--set".to_owned(), format!("{name}={value}")]));
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let failed = |reason: String| Run {
        seed,
        inputs: inputs.clone(),
        outcome: "error".into(),
        reason: Some(reason),
        figures: Vec::new(),
        folder: inside.clone(),
    };
    // The store needs its folder; a store of an earlier attempt is not continued.
    let store = std::fs::create_dir_all(folder.join(&inside));
    if let Err(error) = store {
        return failed(error.to_string());
    }
    let _ = std::fs::remove_file(folder.join(&inside).join("motions.redb"));
    let mut child = match command.spawn() {
        Ok(child) => child,
        Err(error) => return failed(format!("`{}` cannot be started: {error}", program.display())),
    };
    let said = child.stderr.take();
    let reading = std::thread::scope(|scope| {
        let errors = scope.spawn(move || {
            // Enough for the reason; the rest is read so that the child can go on.
            let mut lines =
                said.into_iter().flat_map(|said| BufReader::new(said).lines().map_while(Result::ok));
            let first: Vec<String> = lines.by_ref().take(20).collect();
            lines.for_each(drop);
            first
        });
        let mut last = String::new();
        if let Some(out) = child.stdout.take() {
            for line in BufReader::new(out).lines().map_while(Result::ok) {
                last = line;
            }
        }
        (last, errors.join().unwrap_or_default())
    });
    let status = child.wait();
    #[derive(Deserialize)]
    struct Ended {
        outcome: String,
        reason: Option<String>,
        figures: Vec<Figure>,
    }
    match serde_json::from_str::<Ended>(&reading.0) {
        Ok(Ended { outcome, reason, figures }) => {
            Run { seed, inputs, outcome, reason, figures, folder: inside }
        }
        Err(_) => {
            let status = status.map_or_else(|error| error.to_string(), |status| status.to_string());
            failed(format!("{status}: {}", reading.1.join(" ")))
        }
    }
}

/// The runs by their inputs.
#[must_use]
pub fn groups(runs: &[Run]) -> Vec<(String, Vec<&Run>)> {
    let mut groups: Vec<(String, Vec<&Run>)> = Vec::new();
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
pub fn rate(runs: &[&Run]) -> Rate {
    Rate::of(runs.iter().filter(|run| run.held()).count(), runs.len())
}

/// Writes the page of a sweep; returns its path.
///
/// # Errors
/// [`HostError::File`].
pub fn write_page(config: &SweepConfig, runs: &[Run], folder: &Path) -> Result<PathBuf, HostError> {
    let all: Vec<&Run> = runs.iter().collect();
    let Rate { held, runs: count, interval } = rate(&all);
    let percent = |share: f64| format!("{:.1} %", 100.0 * share);
    let text = |text: &str| Column { title: text.into(), is_number: false };
    let number = |text: &str| Column { title: text.into(), is_number: true };
    let rates = groups(runs).into_iter().map(|(name, group)| {
        let Rate { held, runs, interval } = rate(&group);
        let share = Cell::Text(percent(held as f64 / runs.max(1) as f64));
        let range = Cell::Text(format!("{} to {}", percent(interval[0]), percent(interval[1])));
        vec![
            Cell::Code(name),
            Cell::number(held as f64, "", 0),
            Cell::number(runs as f64, "", 0),
            share,
            range,
        ]
    });
    let rates = Table {
        columns: vec![
            text("inputs"),
            number("held"),
            number("runs"),
            number("rate"),
            number("95 % interval"),
        ],
        rows: rates.collect(),
    };
    let mut worst = all.clone();
    worst.sort_by_key(|run| (run.outcome == "success", usize::MAX - run.failed_figures().count()));
    let worst = worst.into_iter().filter(|run| !run.held()).take(WORST).map(|run| {
        let why = run.failed_figures().map(|figure| {
            let value =
                figure.value.map_or("missing".to_owned(), |value| format!("{value:.*}", figure.digits));
            format!("{}: {} {value} {}", figure.group, figure.name, figure.unit)
        });
        let why: Vec<String> = run.reason.iter().cloned().chain(why).collect();
        let inputs =
            run.inputs.iter().map(|(name, value)| format!("{name}={value}")).collect::<Vec<_>>().join(" ");
        let link = run.folder.join("report.html").display().to_string();
        vec![
            Cell::Link { text: format!("seed {}", run.seed), to: link },
            Cell::Code(inputs),
            Cell::Text(run.outcome.clone()),
            Cell::Text(why.join("; ")),
        ]
    });
    let worst =
        Table { columns: ["run", "inputs", "outcome", "why"].map(text).into(), rows: worst.collect() };
    let figures = Table {
        columns: vec![
            text("figure"),
            number("least"),
            number("median"),
            number("most"),
            number("as required"),
        ],
        rows: spread(&all),
    };
    let mut sections = vec![Section::new("Rates", "Wilson's interval.", vec![Block::Table(rates)])];
    if !worst.rows.is_empty() {
        sections.push(Section::new("What did not hold", "", vec![Block::Table(worst)]));
    }
    sections.push(Section::new("Figures", "Over all runs.", vec![Block::Table(figures)]));
    let data = ReportData {
        title: config.chart.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned()),
        subtitle: format!("{count} runs: armarium run {}", config.arguments.join(" ")),
        outcome: format!("{held} of {count}"),
        facts: vec![(
            "95 % interval".into(),
            format!("{} to {}", percent(interval[0]), percent(interval[1])),
        )],
        sections,
        ..ReportData::default()
    };
    let page = folder.join(PAGE);
    std::fs::write(&page, report::render(&data)).map_err(|error| file_error(&page, error))?;
    Ok(page)
}

/// Least, median and greatest value of each figure, and how often it is as required.
fn spread(runs: &[&Run]) -> Vec<Vec<Cell>> {
    let mut figures: Vec<(&Figure, Vec<f64>, usize, usize)> = Vec::new();
    for figure in runs.iter().flat_map(|run| &run.figures) {
        let known = figures.iter_mut().find(|(f, ..)| (&f.group, &f.name) == (&figure.group, &figure.name));
        let entry = match known {
            Some(entry) => entry,
            None => {
                figures.push((figure, Vec::new(), 0, 0));
                figures.last_mut().expect("it was just added")
            }
        };
        entry.1.extend(figure.value);
        entry.2 += usize::from(figure.passed() == Some(true));
        entry.3 += usize::from(figure.passed().is_some());
    }
    let row = |(figure, mut values, passed, judged): (&Figure, Vec<f64>, usize, usize)| {
        values.sort_by(f64::total_cmp);
        let at = |index: usize| {
            values.get(index).map_or(Cell::Absent, |value| Cell::number(*value, &figure.unit, figure.digits))
        };
        let required = if judged == 0 { Cell::Absent } else { Cell::Text(format!("{passed} of {judged}")) };
        let name = Cell::Text(format!("{}: {}", figure.group, figure.name));
        vec![name, at(0), at(values.len() / 2), at(values.len().saturating_sub(1)), required]
    };
    figures.into_iter().map(row).collect()
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
        let cells = cells(&config());
        let shown: Vec<String> = cells.iter().map(|(seed, inputs)| format!("{seed}{inputs:?}")).collect();
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
        let run = Run {
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

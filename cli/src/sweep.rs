//! `armarium sweep CHART`: many runs of a chart, and how many of them hold.

use std::io::{self, Write};
use std::path::PathBuf;

use armarium_host::sweep::{Rate, SweepConfig, SweptRun, groups, rate, sweep, write_page};
use armarium_simulator::World;
use serde_json::json;

use crate::console::{refuse, show};
use crate::run::parse_input;
use crate::vision::Detector;

#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    armarium sweep statecharts/wiping.yaml --seeds 1..20\n  \
    armarium sweep statecharts/wiping.yaml --seeds 1..60 --set arm=right_arm,left_arm --jobs 2 --out both_arms\n\n\
    A run holds when its outcome is success and every figure is as required. A sweep that was ended goes on where it \
    stopped when it is called again. Exit status: 0 all held, 1 some did not, 2 a file or argument that is wrong.")]
pub(crate) struct SweepArgs {
    /// The chart to run.
    #[arg(value_name = "CHART")]
    chart: PathBuf,
    /// The simulated world, which may hold ranges; if not given, as for `armarium run`.
    #[arg(long, value_name = "FILE")]
    world: Option<PathBuf>,
    /// The robot, by its name or its file.
    #[arg(long, value_name = "FILE|NAME")]
    robot: Option<String>,
    /// Seeds: `1..20` is 1 to 20, `3,5,8` these three.
    #[arg(long, value_name = "SEEDS", default_value = "1..20", value_parser = read_seeds)]
    seeds: Seeds,
    /// How people's hands are found; if not given, as for `armarium run`.
    #[arg(long, value_enum)]
    detector: Option<Detector>,
    /// An input of the chart with one or several values, for instance `arm=left_arm,right_arm`; may be repeated.
    #[arg(long = "set", value_name = "INPUT=VALUE,...", value_parser = parse_input)]
    inputs: Vec<(String, String)>,
    /// The chart's profile whose defaults are used.
    #[arg(long)]
    profile: Option<String>,
    /// Stop each run after this time of the robot, for instance `10min`.
    #[arg(long = "for", value_name = "TIME")]
    longest: Option<String>,
    /// How many runs go at the same time.
    #[arg(long, default_value_t = 1)]
    jobs: usize,
    /// Folder for the page, the runs' reports, and the list of runs.
    #[arg(long, value_name = "DIR", default_value = "sweep")]
    out: PathBuf,
    /// Print each run as a line of JSON, and at last a line with the rates.
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Debug)]
struct Seeds(Vec<u64>);

/// More seeds are a slip of the keyboard.
const MOST_SEEDS: u64 = 100_000;

fn read_seeds(text: &str) -> Result<Seeds, String> {
    let number = |text: &str| {
        text.trim().parse::<u64>().map_err(|_| format!("`{text}` is no seed: write `1..20` or `3,5,8`"))
    };
    let mut seeds = Vec::new();
    for part in text.split(',') {
        match part.split_once("..") {
            Some((from, to)) => {
                let (from, to) = (number(from)?, number(to.trim_start_matches('='))?);
                if from > to || to - from >= MOST_SEEDS {
                    return Err(format!(
                        "`{part}` goes from the smaller to the larger, at most {MOST_SEEDS} seeds"
                    ));
                }
                seeds.extend(from..=to);
            }
            None => seeds.push(number(part)?),
        }
    }
    seeds.sort_unstable();
    seeds.dedup();
    Ok(Seeds(seeds))
}

impl SweepArgs {
    fn config(&self) -> SweepConfig {
        let mut arguments = Vec::new();
        let mut option = |name: &str, value: Option<String>| {
            arguments.extend(value.into_iter().flat_map(|value| [name.to_owned(), value]));
        };
        option("--world", self.world.as_ref().map(|file| file.display().to_string()));
        option("--robot", self.robot.clone());
        option("--detector", self.detector.map(Detector::name));
        option("--profile", self.profile.clone());
        option("--for", self.longest.clone());
        let values = |(name, values): &(String, String)| {
            (name.clone(), values.split(',').map(|value| value.trim().to_owned()).collect())
        };
        let inputs = self.inputs.iter().map(values).collect();
        SweepConfig { chart: self.chart.clone(), arguments, seeds: self.seeds.0.clone(), inputs }
    }
}

/// Runs the sweep and prints to `out`. Returns the exit status: 0 when all runs hold, 1 when some do not, 2 for wrong arguments.
pub(crate) fn run(args: &SweepArgs, out: &mut dyn Write) -> io::Result<u8> {
    if !args.chart.is_file() {
        return writeln!(out, "error: there is no chart `{}`", args.chart.display()).map(|()| 2);
    }
    // A wrong world would fail every run in the same way.
    let seed = args.seeds.0.first().copied().unwrap_or(1);
    if let Some(Err(findings)) = args.world.as_deref().map(|world| World::load(world, seed)) {
        return show(&findings, out).map(|()| 2);
    }
    let config = args.config();
    let ended = |run: &SweptRun, count: usize, all: usize| {
        let line =
            if args.json { serde_json::to_string(run).unwrap_or_default() } else { shown(run, count, all) };
        let _ = writeln!(io::stdout(), "{line}");
    };
    let program = std::env::current_exe()?;
    let runs = match sweep(&config, (&program, &args.out, args.jobs), &ended) {
        Ok(runs) => runs,
        Err(error) => return refuse(&error, out),
    };
    let page = match write_page(&config, &runs, &args.out) {
        Ok(page) => page,
        Err(error) => return refuse(&error, out),
    };
    let all: Vec<&SweptRun> = runs.iter().collect();
    let whole = rate(&all);
    if args.json {
        let groups =
            groups(&runs).into_iter().map(|(inputs, runs)| json!({"inputs": inputs, "rate": rate(&runs)}));
        let line = json!({"rate": whole, "groups": groups.collect::<Vec<_>>(), "page": page});
        writeln!(out, "{line}")?;
    } else {
        for (inputs, runs) in groups(&runs) {
            let Rate { held, runs, interval: [low, high] } = rate(&runs);
            let share = 100.0 * held as f64 / runs.max(1) as f64;
            let (low, high) = (100.0 * low, 100.0 * high);
            writeln!(out, "{held} of {runs} held: {share:.1} % ({low:.1} to {high:.1} %)  {inputs}")?;
        }
        writeln!(out, "the page is {}", page.display())?;
    }
    Ok(u8::from(whole.held < whole.runs || runs.is_empty()))
}

fn shown(run: &SweptRun, count: usize, all: usize) -> String {
    let inputs: String = run.inputs.iter().map(|(name, value)| format!(" {name}={value}")).collect();
    let failed: Vec<String> =
        run.failed_figures().map(|figure| format!("{}: {}", figure.group, figure.name)).collect();
    let why = run.reason.clone().into_iter().chain(failed).collect::<Vec<_>>().join("; ");
    let mark = if run.held() { "ok" } else { "NO" };
    format!(
        "[{count}/{all}] {mark} seed {}{inputs}  {}{}{why}",
        run.seed,
        run.outcome,
        if why.is_empty() { "" } else { ": " }
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seeds_are_ranges_and_lists() {
        assert_eq!(read_seeds("1..3,7,2").map(|seeds| seeds.0), Ok(vec![1, 2, 3, 7]));
        for wrong in ["", "3..1", "a", "1..", "0..99999999"] {
            assert!(read_seeds(wrong).is_err(), "{wrong}");
        }
    }
}

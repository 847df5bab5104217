//! The page of a sweep: rates, the spread of each figure, what other choices of inputs change in the same worlds, and what did not hold.
//! It runs nothing.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use armarium_values::report::{Block, Cell, Column, Figure, Section, Table};
use armarium_viewer::report::{self, ReportData};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use super::{Rate, SweepConfig, SweptRun, file_error, groups, rate};
use crate::error::HostError;

const PAGE: &str = "sweep.html";
/// Runs whose reports the page names, of those that did not hold or came closest to that.
const WORST: usize = 10;
/// How often a mean is drawn anew for its interval.
const RESAMPLES: usize = 2000;

/// Writes the page of a sweep; returns its path.
///
/// # Errors
/// [`HostError::File`].
pub fn write_page(config: &SweepConfig, runs: &[SweptRun], folder: &Path) -> Result<PathBuf, HostError> {
    let all: Vec<&SweptRun> = runs.iter().collect();
    let Rate { held, runs: count, interval } = rate(&all);
    let percent = |share: f64| format!("{:.1} %", 100.0 * share);
    let text = |text: &str| Column { title: text.into(), is_number: false };
    let number = |text: &str| Column { title: text.into(), is_number: true };
    let by_inputs = groups(runs);
    let rates = by_inputs.iter().map(|(name, group)| {
        let Rate { held, runs, interval } = rate(group);
        let share = Cell::Text(percent(held as f64 / runs.max(1) as f64));
        let range = Cell::Text(format!("{} to {}", percent(interval[0]), percent(interval[1])));
        vec![
            Cell::Code(name.clone()),
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
            let value = figure.value.map_or("(not measured)".to_owned(), |value| {
                format!("{value:.*} {}", figure.digits, figure.unit)
            });
            format!("{}: {} {value}", figure.group, figure.name)
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
    let figures = |runs: &[&SweptRun]| {
        let titles = ["least", "median", "most", "as required"].map(number);
        Block::Table(Table {
            columns: [text("figure")].into_iter().chain(titles).collect(),
            rows: spread(runs),
        })
    };
    let mut sections = vec![Section::new("Rates", "Wilson's interval.", vec![Block::Table(rates)])];
    if !worst.rows.is_empty() {
        sections.push(Section::new("What did not hold", "", vec![Block::Table(worst)]));
    }
    for (name, group) in &by_inputs {
        let title = if name.is_empty() { "Figures".to_owned() } else { format!("Figures with {name}") };
        sections.push(Section::new(&title, "", vec![figures(group)]));
    }
    if let [(reference, first), others @ ..] = by_inputs.as_slice() {
        for (name, group) in others {
            let rows = differences(first, group);
            let columns =
                [text("figure")].into_iter().chain(["runs", "mean", "95 % interval"].map(number)).collect();
            let note = "Of the runs with the same seed, for which both have the figure; the interval is bootstrapped over seeds.";
            let title = format!("What {name} changes against {reference}");
            sections.push(Section::new(&title, note, vec![Block::Table(Table { columns, rows })]));
        }
    }
    let data = ReportData {
        title: config.chart.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned()),
        subtitle: format!("{count} runs: armarium run {}", config.arguments.join(" ")),
        outcome: if held == count { "success".into() } else { format!("{held} of {count}") },
        reason: (held < count)
            .then(|| format!("{} of {count} do not hold; a table below says why.", count - held)),
        facts: vec![
            ("held".into(), format!("{held} of {count}")),
            ("95 % interval".into(), format!("{} to {}", percent(interval[0]), percent(interval[1]))),
        ],
        sections,
        ..ReportData::default()
    };
    let page = folder.join(PAGE);
    std::fs::write(&page, report::render(&data)).map_err(|error| file_error(&page, error))?;
    Ok(page)
}

/// A run's figures of the same group and name.
fn same<'r>(run: &'r SweptRun, of: &Figure) -> impl Iterator<Item = &'r Figure> {
    run.figures.iter().filter(|figure| (&figure.group, &figure.name) == (&of.group, &of.name))
}

/// The figures that any of the runs has, one of each group and name.
fn figures_of<'r>(runs: &[&'r SweptRun]) -> Vec<&'r Figure> {
    let mut names = BTreeSet::new();
    let figures = runs.iter().flat_map(|run| &run.figures);
    figures.filter(|figure| names.insert((&figure.group, &figure.name))).collect()
}

fn title(figure: &Figure) -> Cell {
    Cell::Text(format!("{}: {}", figure.group, figure.name))
}

/// How much the figures of the other runs differ from those of the first ones with the same seed: how many do, the mean, and its interval.
fn differences(first: &[&SweptRun], other: &[&SweptRun]) -> Vec<Vec<Cell>> {
    let row = |figure: &Figure| {
        let pair = |run: &&SweptRun| {
            let twin = other.iter().find(|twin| twin.seed == run.seed)?;
            Some(same(twin, figure).next()?.value? - same(run, figure).next()?.value?)
        };
        let pairs: Vec<f64> = first.iter().filter_map(pair).collect();
        let [mean, low, high] = bootstrapped_mean(&pairs)?;
        let (unit, digits) = (&figure.unit, figure.digits);
        Some(vec![
            title(figure),
            Cell::number(pairs.len() as f64, "", 0),
            Cell::number(mean, unit, digits),
            Cell::Text(format!("{low:.digits$} to {high:.digits$} {unit}")),
        ])
    };
    figures_of(first).into_iter().filter_map(row).collect()
}

/// The mean of some values, and its 95 % interval by the bootstrap's percentiles; none of fewer than two values.
///
/// # Source
/// Efron and Tibshirani, "An Introduction to the Bootstrap", 1993, chapter 13.
fn bootstrapped_mean(values: &[f64]) -> Option<[f64; 3]> {
    if values.len() < 2 {
        return None;
    }
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let count = values.len() as f64;
    let mut drawn =
        || (0..values.len()).map(|_| values[rng.random_range(..values.len())]).sum::<f64>() / count;
    let mut means: Vec<f64> = (0..RESAMPLES).map(|_| drawn()).collect();
    means.sort_by(f64::total_cmp);
    let at = |share: f64| means[((RESAMPLES - 1) as f64 * share).round() as usize];
    Some([values.iter().sum::<f64>() / count, at(0.025), at(0.975)])
}

/// Least, median and greatest value of each figure, and how often it is as required.
fn spread(runs: &[&SweptRun]) -> Vec<Vec<Cell>> {
    let row = |figure: &Figure| {
        let all = || runs.iter().flat_map(|run| same(run, figure));
        let mut values: Vec<f64> = all().filter_map(|figure| figure.value).collect();
        values.sort_by(f64::total_cmp);
        let at = |index: usize| {
            values.get(index).map_or(Cell::Absent, |value| Cell::number(*value, &figure.unit, figure.digits))
        };
        let judged: Vec<bool> = all().filter_map(Figure::passed).collect();
        let passed = judged.iter().filter(|passed| **passed).count();
        let required = match judged.len() {
            0 => Cell::Absent,
            judged => Cell::Text(format!("{passed} of {judged}")),
        };
        vec![title(figure), at(0), at(values.len() / 2), at(values.len().saturating_sub(1)), required]
    };
    figures_of(runs).into_iter().map(row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mean_of_a_normal_sample_has_about_the_interval_of_students_t() {
        // The differences of Student's sleep data (Biometrika 6, 1908): mean 1.58; 95 % interval by t 0.70 to 2.46, by the bootstrap narrower.
        let values = [1.2, 2.4, 1.3, 1.3, 0.0, 1.0, 1.8, 0.8, 4.6, 1.4];
        let [mean, low, high] = bootstrapped_mean(&values).expect("there are ten");
        assert!(
            (mean - 1.58).abs() < 1e-9 && (0.7..1.1).contains(&low) && (2.1..2.5).contains(&high),
            "{low} to {high}"
        );
        assert_eq!(bootstrapped_mean(&[1.0]), None);
        assert_eq!(bootstrapped_mean(&[2.0; 5]), Some([2.0; 3]));
    }
}

//! The report of a run: `report.json` for programs, `report.html` for people. Its statements about the world are the
//! referee's measurements.

use std::collections::BTreeMap;
use std::io;
use std::path::Path;

use armarium_runtime::exec::RunResult;
use armarium_simulator::{Referee, World};
use armarium_values::Value;
use armarium_values::report::{Block, Figure, Picture, Section, Series, TimePlot};
use armarium_viewer::report::{self, ChainLink, ReportData};
use armarium_visionx::HandDetection;
use serde_json::{Value as Json, json};

use crate::memory_log::{self, LoggedChange};
use crate::other_robots::OtherRobotEnded;
use crate::run_log::RunLog;

/// The data of a report.
pub(crate) struct ReportedRun<'r> {
    pub(crate) chart: &'r str,
    pub(crate) world: &'r World,
    pub(crate) seed: u64,
    pub(crate) profile: Option<&'r str>,
    pub(crate) hands: HandDetection,
    pub(crate) result: &'r RunResult,
    pub(crate) simulated_s: f64,
    pub(crate) wall_s: f64,
    pub(crate) trace_sha256: String,
    pub(crate) referee: &'r Referee,
    pub(crate) log: &'r RunLog,
    pub(crate) pictures: Vec<Picture>,
    pub(crate) joints: Vec<TimePlot>,
    /// The log of the agents' memories; empty if there is only one agent.
    pub(crate) memory_log: &'r [LoggedChange],
    /// The world's other robots that ran charts.
    pub(crate) robots: &'r [OtherRobotEnded],
    /// What somebody did to the run through its page.
    pub(crate) acted: Vec<String>,
}

/// The figures of the run, by the names that all reports use.
pub(crate) fn figures(case: &ReportedRun<'_>) -> Json {
    let measured = case.referee.report();
    let mut report = json!({
        "chart": case.chart,
        "world": case.world.name,
        "seed": case.seed,
        "profile": case.profile,
        "detector": case.hands.name(),
        "inputs": values(&case.log.inputs),
        "outputs": values(&case.result.outputs),
        "log": case.log.written,
        "dropped": case.log.dropped,
        "acted": case.acted,
        "outcome": case.result.outcome,
        "reason": case.result.reason,
        "chain": case.result.chain,
        "simulated_s": case.simulated_s,
        "wall_s": case.wall_s,
        "real_time_factor": case.simulated_s / case.wall_s.max(1e-9),
        "trace_sha256": case.trace_sha256,
    });
    if let (Json::Object(report), Json::Object(measured)) = (&mut report, measured) {
        report.extend(measured);
        if !case.robots.is_empty() {
            report.insert("robots".into(), case.robots.iter().map(OtherRobotEnded::json).collect());
        }
    }
    report
}

/// `force = 8, long = 60 s`, cut where it is long: `report.json` has all.
fn listed(values: &BTreeMap<String, Value>) -> String {
    let one = |(name, value): (&String, &Value)| {
        let text: String = value.to_string().chars().take(60).collect();
        format!("{name} = {text}")
    };
    values.iter().map(one).collect::<Vec<_>>().join(", ")
}

fn values(values: &BTreeMap<String, Value>) -> Json {
    values.iter().map(|(name, value)| (name.clone(), value.to_json())).collect()
}

/// A report that was to be written.
pub(crate) struct WrittenReport {
    /// What is in `report.json`.
    pub(crate) json: Json,
    pub(crate) figures: Vec<Figure>,
    pub(crate) sections: Vec<Section>,
    /// Whether the files could be written.
    pub(crate) files: io::Result<()>,
}

/// Writes both reports into `folder`.
pub(crate) fn write(folder: &Path, case: ReportedRun<'_>) -> WrittenReport {
    let mut figures = figures(&case);
    let memories = (!case.memory_log.is_empty())
        .then(|| {
            memory_log::section(
                case.memory_log,
                case.world,
                case.referee.judged_object(),
                &case.referee.log(),
            )
        })
        .flatten();
    let (json, memories) = memories.unzip();
    if let (Json::Object(report), Some(json)) = (&mut figures, json) {
        report.insert("memories".into(), json);
    }
    let sections = case.referee.sections();
    let judged = sections.iter().flat_map(Section::figures).cloned().collect();
    let page = page(case, sections, memories);
    let files = std::fs::write(folder.join("report.json"), format!("{figures:#}\n"))
        .and_then(|()| std::fs::write(folder.join("report.html"), report::render(&page)));
    if files.is_err() {
        // Half a report would be taken for a whole one.
        for file in ["report.json", "report.html"] {
            let _ = std::fs::remove_file(folder.join(file));
        }
    }
    WrittenReport { json: figures, figures: judged, sections: page.sections, files }
}

/// The sections of a run's report as far as they are known while it goes on.
pub(crate) fn so_far(mut judged: Vec<Section>, log: &RunLog) -> Vec<Section> {
    judged.insert(judged.len().min(1), states(log));
    judged.push(lines(log));
    judged
}

fn states(log: &RunLog) -> Section {
    let about = "Which states were active, and when. A thin bar is a state with states inside.";
    Section::new("States", about, vec![Block::Gantt(log.states.clone())])
}

fn lines(log: &RunLog) -> Section {
    Section::new("Log", "", vec![Block::Lines(log.lines.clone())])
}

fn page(case: ReportedRun<'_>, mut judged: Vec<Section>, memories: Option<Section>) -> ReportData {
    let minutes = |s: f64| format!("{:.0} min {:04.1} s", (s / 60.0).floor(), s % 60.0);
    let rest = judged.split_off(judged.len().min(1));
    let joints = "Trajectories over time in seconds; dashed lines are limits.";
    let mut sections = judged;
    sections.push(states(case.log));
    sections.extend(case.robots.iter().map(OtherRobotEnded::section));
    sections.extend(memories);
    sections.extend(rest);
    sections.push(Section::new("Joints", joints, vec![Block::SmallPlots(case.joints)]));
    sections.push(Section::new("What the cameras saw", "", vec![Block::Pictures(case.pictures)]));
    sections.push(lines(case.log));
    ReportData {
        title: case.chart.to_owned(),
        subtitle: format!("world `{}`, seed {}", case.world.name, case.seed),
        outcome: case.result.outcome.clone(),
        reason: case.result.reason.clone(),
        failure_chain: case
            .result
            .chain
            .iter()
            .map(|s| ChainLink { state: s.clone(), reason: None })
            .collect(),
        facts: [("inputs", &case.log.inputs), ("outputs", &case.result.outputs)]
            .into_iter()
            .filter(|(_, values)| !values.is_empty())
            .map(|(title, values)| (title.to_owned(), listed(values)))
            .chain((!case.acted.is_empty()).then(|| ("acted on".to_owned(), case.acted.join("; "))))
            .chain(case.profile.map(|profile| ("profile".to_owned(), profile.to_owned())))
            .chain(
                (case.hands != HandDetection::default())
                    .then(|| ("hands found by".to_owned(), case.hands.name().to_owned())),
            )
            .chain([
                ("simulated".into(), minutes(case.simulated_s)),
                ("on the wall".into(), minutes(case.wall_s)),
                ("real time factor".into(), format!("{:.2}", case.simulated_s / case.wall_s.max(1e-9))),
                ("trace".into(), case.trace_sha256.chars().take(16).collect()),
            ])
            .collect(),
        sections,
    }
}

/// Joint angles of the moving limbs, collected during the run.
#[derive(Debug, Default)]
pub(crate) struct JointLog {
    times: Vec<f64>,
    positions: BTreeMap<usize, Vec<f64>>,
}

impl JointLog {
    /// Adds a sample of the joints `chosen`.
    pub(crate) fn add(&mut self, t_s: f64, position: &[f64], chosen: &[usize]) {
        self.times.push(t_s);
        for &joint in chosen {
            self.positions.entry(joint).or_default().push(position.get(joint).copied().unwrap_or(f64::NAN));
        }
    }

    /// One plot per joint, with its limits.
    pub(crate) fn plots(&self, model: &armarium_robot::Model) -> Vec<TimePlot> {
        let plot = |(joint, y): (&usize, &Vec<f64>)| {
            let described = &model.joints()[*joint];
            TimePlot {
                title: described.name.clone(),
                y_label: "rad".into(),
                series: vec![Series { label: described.name.clone(), t_s: self.times.clone(), y: y.clone() }],
                limits: vec![(described.lower, "lower".into()), (described.upper, "upper".into())],
                ..TimePlot::default()
            }
        };
        self.positions.iter().map(plot).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inputs_and_outputs_are_shown_with_four_digits() {
        let values = BTreeMap::from([
            ("turn".to_owned(), Value::Float(-0.785_412_345)),
            ("way".to_owned(), Value::from(vec![2.0, 1e-7 / 3.0])),
            ("times".to_owned(), Value::Int(123_456)),
        ]);
        assert_eq!(listed(&values), "times = 123456, turn = -0.7854, way = [2, 3.333e-8]");
    }
}

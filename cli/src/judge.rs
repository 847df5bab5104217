//! The report of a run: `report.json` for programs, `report.html` for people. What it says of the world was measured by
//! the referee.

use std::collections::BTreeMap;
use std::io;
use std::path::Path;

use armarium_runtime::exec::RunResult;
use armarium_simulator::{Referee, World};
use armarium_viewer::report::{
    self, ChainLink, CoachingRow, Memories, Picture, ReportData, Series, TimePlot,
};
use serde_json::{Value as Json, json};

use crate::chronicle::Story;
use crate::memories::{self, Entry};
use crate::plots;

/// What a report is written from.
pub(crate) struct Case<'r> {
    pub(crate) chart: &'r str,
    pub(crate) world: &'r World,
    pub(crate) seed: u64,
    pub(crate) result: &'r RunResult,
    pub(crate) simulated_s: f64,
    pub(crate) wall_s: f64,
    pub(crate) trace_sha256: String,
    pub(crate) referee: &'r Referee,
    pub(crate) story: &'r Story,
    pub(crate) pictures: Vec<Picture>,
    pub(crate) joints: Vec<TimePlot>,
    /// What the memories of the agents knew; empty where there is one agent.
    pub(crate) diary: &'r [Entry],
}

/// The figures of the run, by the names that reports share.
pub(crate) fn figures(case: &Case<'_>) -> Json {
    let measured = serde_json::to_value(case.referee.report()).unwrap_or_else(|_| json!({}));
    let mut report = json!({
        "chart": case.chart,
        "world": case.world.name,
        "seed": case.seed,
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
    }
    if let (Some(imitation), Some(shown)) =
        (report.get_mut("imitation").and_then(Json::as_object_mut), &case.world.coach.demonstration)
    {
        imitation.insert("demonstrated_frequency_hz".into(), json!(shown.frequency));
    }
    report
}

/// Writes both reports into `folder`.
///
/// # Errors
/// When a file cannot be written.
pub(crate) fn write(folder: &Path, case: Case<'_>) -> io::Result<Json> {
    let mut figures = figures(&case);
    let part = memories::part(case.diary, case.world, &case.referee.log()).filter(|_| !case.diary.is_empty());
    let (json, memories) = part.unzip();
    if let (Json::Object(report), Some(json)) = (&mut figures, json) {
        report.insert("memories".into(), json);
    }
    std::fs::write(folder.join("report.json"), format!("{figures:#}\n"))?;
    std::fs::write(folder.join("report.html"), report::render(&page(case, &figures, memories)))?;
    Ok(figures)
}

fn page(case: Case<'_>, figures: &Json, memories: Option<Memories>) -> ReportData {
    let log = case.referee.log();
    let marks = case.referee.marks();
    let minutes = |s: f64| format!("{:.0} min {:04.1} s", (s / 60.0).floor(), s % 60.0);
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
        facts: vec![
            ("simulated".into(), minutes(case.simulated_s)),
            ("on the wall".into(), minutes(case.wall_s)),
            ("real time factor".into(), format!("{:.2}", case.simulated_s / case.wall_s.max(1e-9))),
            ("trace".into(), case.trace_sha256.chars().take(16).collect()),
        ],
        figures: report::figures(figures),
        states: case.story.states.clone(),
        paths: plots::paths(case.world, &log, &marks),
        force: plots::force(&log, &marks),
        wiped: case.referee.wiped().and_then(|cells| plots::wiped(case.world, &log, &marks, &cells)),
        joints: case.joints,
        coaching: coaching(figures),
        memories,
        confusion: serde_json::from_value(figures["gestures"]["confusion"].clone()).unwrap_or_default(),
        pictures: case.pictures,
        log: case.story.log.clone(),
        ..ReportData::default()
    }
}

fn coaching(figures: &Json) -> Vec<CoachingRow> {
    let steps = figures["coaching"].as_array().map(Vec::as_slice).unwrap_or_default();
    let number = |step: &Json, name: &str| step[name].as_f64();
    steps
        .iter()
        .map(|step| CoachingRow {
            kind: step["kind"].as_str().unwrap_or_default().to_owned(),
            at_s: number(step, "at_s").unwrap_or_default(),
            displacement_m: number(step, "displacement_m"),
            retained_m: number(step, "retained_m"),
            far_side_rms_m: number(step, "far_side_rms_m"),
            slowed_to: number(step, "slowed_to"),
        })
        .collect()
}

/// Joint angles of the moving limbs, gathered while the robot runs.
#[derive(Debug, Default)]
pub(crate) struct JointLog {
    times: Vec<f64>,
    positions: BTreeMap<usize, Vec<f64>>,
}

impl JointLog {
    /// One sample of the joints `chosen`.
    pub(crate) fn add(&mut self, t_s: f64, position: &[f64], chosen: &[usize]) {
        self.times.push(t_s);
        for &joint in chosen {
            self.positions.entry(joint).or_default().push(position.get(joint).copied().unwrap_or(f64::NAN));
        }
    }

    /// A plot a joint, with its limits.
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

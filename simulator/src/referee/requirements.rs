//! The requirements on a wiping run's figures: one table from a report's JSON to values with their requirements.
//!
//! The report page and the repository's own check use the same table, so that they cannot disagree.

use armarium_values::report::{Figure, Requirement};
use serde_json::Value;

/// A row of the table: where the value is in the report, how it is displayed (unit, factor, digits), and its
/// requirement.
type RequirementRow = (&'static str, &'static str, &'static str, &'static str, f64, usize, Requirement);

use Requirement::{AtLeast, AtMost, Shown};

const ROWS: [RequirementRow; 10] = [
    ("Grasp", "position error", "/grasp/position_error_m", "mm", 1e3, 1, AtMost(15.0)),
    ("Imitation", "learned frequency", "/imitation/frequency_hz", "Hz", 1.0, 4, Shown),
    ("Imitation", "path error, RMS", "/imitation/path_rms_m", "mm", 1e3, 1, AtMost(10.0)),
    ("Force", "mean", "/force/mean_n", "N", 1.0, 2, Shown),
    ("Force", "cycles of adaptation", "/force/cycles", "", 1.0, 0, Shown),
    ("Force", "largest", "/force/max_n", "N", 1.0, 1, Shown),
    ("Force", "contact lost", "/force/contact_lost_s", "s", 1.0, 3, AtMost(0.0)),
    ("Force", "largest at touchdown", "/force/touchdown_max_n", "N", 1.0, 1, AtMost(25.0)),
    ("Wiping", "wiped fraction", "/wiped_fraction", "%", 1e2, 1, AtLeast(95.0)),
    ("Gestures", "right", "/gestures/accuracy", "%", 1e2, 1, AtLeast(90.0)),
];

/// Values of a run's report (`report.json`) with their requirements, in the order of display. Sections that the
/// report lacks, or that are null, give no figures: for example coaching, in a chart that only wipes.
pub fn judged_figures(report: &Value) -> Vec<Figure> {
    let mut figures = Vec::new();
    for (group, name, pointer, unit, factor, digits, requirement) in ROWS {
        let section = pointer.trim_start_matches('/').split('/').next().unwrap_or_default();
        if report.get(section).is_none_or(Value::is_null) {
            continue;
        }
        let value = report.pointer(pointer).and_then(Value::as_f64).map(|v| v * factor);
        figures.push(figure(group, name, value, unit, digits, requirement));
        match pointer {
            "/imitation/frequency_hz" => figures.extend(frequency_error(report)),
            "/force/mean_n" => figures.push(force_error(report)),
            _ => {}
        }
    }
    figures.extend(coaching(report));
    figures
}

fn figure(
    group: &str,
    name: &str,
    value: Option<f64>,
    unit: &str,
    digits: usize,
    requirement: Requirement,
) -> Figure {
    Figure { group: group.into(), name: name.into(), value, unit: unit.into(), requirement, digits }
}

/// The learned frequency against the demonstrated one, if the report has it.
fn frequency_error(report: &Value) -> Option<Figure> {
    let learned = report.pointer("/imitation/frequency_hz").and_then(Value::as_f64)?;
    let shown = report.pointer("/imitation/demonstrated_frequency_hz").and_then(Value::as_f64)?;
    let error = (learned / shown - 1.0).abs() * 100.0;
    Some(figure("Imitation", "frequency error", Some(error), "%", 2, AtMost(1.0)))
}

/// The force's RMS error: at most 1 N at 8 N, and an eighth of the desired force above that.
fn force_error(report: &Value) -> Figure {
    let desired = report.pointer("/force/desired_n").and_then(Value::as_f64).unwrap_or(8.0);
    let error = report.pointer("/force/rms_error_n").and_then(Value::as_f64);
    figure("Force", "error, RMS", error, "N", 2, AtMost((desired / 8.0).max(1.0)))
}

fn coaching(report: &Value) -> Vec<Figure> {
    let items = report.get("coaching").and_then(Value::as_array).map_or(&[][..], Vec::as_slice);
    items.iter().enumerate().flat_map(|(i, item)| coaching_of_one(i, item)).collect()
}

/// The name of a coaching action in the report.
fn coaching_kind(item: &Value) -> &str {
    ["kind", "gesture"].iter().find_map(|key| item.get(key)?.as_str()).unwrap_or("push")
}

fn coaching_of_one(index: usize, item: &Value) -> Vec<Figure> {
    let kind = coaching_kind(item);
    if kind == "open_hand" {
        return Vec::new();
    }
    let group = format!("Coaching {}: {}", index + 1, kind.replace('_', " "));
    let get = |key: &str| item.get(key).and_then(Value::as_f64);
    let mm = |key: &str| get(key).map(|v| v * 1e3);
    let push = kind == "push";
    let moved = mm("displacement_m");
    let mut rows = vec![figure(&group, "moved", moved, "mm", 1, AtLeast(if push { 20.0 } else { 10.0 }))];
    let retained = get("retained_m").zip(get("displacement_m")).map(|(kept, all)| kept / all * 100.0);
    rows.push(figure(&group, "kept after two cycles", retained, "%", 0, AtLeast(80.0)));
    if push {
        let degrees = get("direction_error_deg");
        rows.push(figure(&group, "off the push's direction", degrees, "°", 1, AtMost(30.0)));
    } else {
        rows.push(figure(&group, "slowed to", get("slowed_to").map(|v| v * 100.0), "%", 0, AtMost(70.0)));
    }
    if kind != "point_one" {
        rows.push(figure(&group, "far side moved, RMS", mm("far_side_rms_m"), "mm", 1, AtMost(5.0)));
    }
    rows
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn by_name<'a>(figures: &'a [Figure], name: &str) -> &'a Figure {
        figures.iter().find(|f| f.name == name).expect("the figure exists")
    }

    #[test]
    fn a_bound_counts_as_kept() {
        let report =
            json!({"grasp": {"position_error_m": 0.015}, "force": {"rms_error_n": 1.01, "mean_n": 8.0}});
        let figures = judged_figures(&report);
        assert_eq!(by_name(&figures, "position error").passed(), Some(true));
        assert_eq!(by_name(&figures, "error, RMS").passed(), Some(false));
    }

    #[test]
    fn a_missing_value_fails_and_a_missing_section_is_not_judged() {
        let figures = judged_figures(&json!({"grasp": {}, "wiped_fraction": null}));
        assert_eq!(figures.len(), 1);
        assert_eq!(figures[0].passed(), Some(false));
    }

    #[test]
    fn each_kind_of_coaching_is_asked_what_is_asked_of_it() {
        let report = json!({"wiped_fraction": 1.0, "coaching": [
            {"kind": "push", "displacement_m": 0.025, "retained_m": 0.021, "far_side_rms_m": 0.001,
             "direction_error_deg": 12.0},
            {"kind": "point_one", "displacement_m": 0.012, "retained_m": 0.011, "slowed_to": 0.5},
            {"kind": "open_hand"},
        ]});
        let figures = judged_figures(&report);
        assert!(figures.iter().all(|f| f.passed() == Some(true)), "{figures:?}");
        assert_eq!(figures.iter().filter(|f| f.group.starts_with("Coaching 1")).count(), 4);
        assert_eq!(figures.iter().filter(|f| f.group.starts_with("Coaching 2")).count(), 3);
        assert_eq!(figures.iter().filter(|f| f.group.starts_with("Coaching 3")).count(), 0);
    }

    #[test]
    fn the_frequency_is_judged_against_the_demonstrated_one() {
        let report = json!({"imitation": {"frequency_hz": 0.506, "demonstrated_frequency_hz": 0.5}});
        assert_eq!(by_name(&judged_figures(&report), "frequency error").passed(), Some(false));
    }
}

//! The experiments, compared with independent implementations and closed forms; and the documentation's pictures,
//! compared with newly drawn ones.

use std::path::Path;

use serde_json::{Map, Value};

use super::*;

fn outcome(name: &str, settings: &[(&str, &str)]) -> ExperimentResult {
    let settings: Vec<_> = settings.iter().map(|(k, v)| ((*k).to_owned(), (*v).to_owned())).collect();
    let entry = all().into_iter().find(|entry| entry.name == name).expect("the experiment exists");
    entry.run(&settings).expect("the settings are possible").1
}

fn figures(name: &str, settings: &[(&str, &str)]) -> Map<String, Value> {
    outcome(name, settings).figures
}

fn number(figures: &Map<String, Value>, name: &str) -> f64 {
    figures[name].as_f64().unwrap_or(f64::NAN)
}

fn numbers(figures: &Map<String, Value>, name: &str) -> Vec<f64> {
    figures[name].as_array().expect("a list").iter().filter_map(Value::as_f64).collect()
}

#[test]
fn each_experiment_says_what_it_is_and_what_its_settings_are() {
    for entry in all() {
        assert!(entry.about.len() > 20, "{}", entry.name);
        assert!(entry.keys.iter().all(|key| key.doc.len() > 1), "{}", entry.name);
    }
}

/// An independent numpy implementation of the same settings gives these values.
#[test]
fn coaching_agrees_with_an_independent_implementation() {
    type Case<'a> = (&'a [(&'a str, &'a str)], [f64; 4]);
    let cases: [Case<'_>; 7] = [
        (&[], [0.349_15, 2.010_51, 0.077_12, 0.641_83]),
        (&[("direction", "cw")], [0.305_93, 2.100_2, 0.111_24, 0.649_99]),
        (&[("o", "1.8,0.8")], [0.314_22, 1.254_66, 0.207_74, 0.742_67]),
        (&[("o", "2.4,0.2"), ("d", "-1,0")], [0.568_36, 1.893_8, 0.138_73, 0.617_91]),
        (&[("posture", "-0.5,0.6,0.6")], [0.341_42, 1.905_61, 0.077_03, 0.643_15]),
        (&[("alpha_z", "48"), ("beta_z", "12")], [0.056_93, 2.695_93, 1.186_54, 0.682_77]),
        (&[("frequency", "1"), ("gamma", "100")], [0.365_19, 2.311_61, 0.072_61, 0.644_77]),
    ];
    for (settings, expected) in cases {
        let found = figures("coaching", settings);
        let names = ["displacement_at_o_m", "coupling_mean_first", "coupling_mean_last", "radius_after_m"];
        for (name, expected) in names.iter().zip(expected) {
            let value = number(&found, name);
            assert!((value / expected - 1.0).abs() < 0.01, "{settings:?} {name}: {value} for {expected}");
        }
        assert!(number(&found, "opposite_phase_m") < 1e-3, "{settings:?}");
    }
}

#[test]
fn a_period_need_not_be_a_whole_number_of_steps() {
    let [whole, odd] = ["0.5", "0.499"].map(|f| figures("coaching", &[("frequency", f)]));
    for name in ["displacement_at_o_m", "radius_before_m", "coupling_mean_first"] {
        let (a, b) = (number(&whole, name), number(&odd, name));
        assert!((a / b - 1.0).abs() < 0.05, "{name}: {a} and {b}");
    }
}

#[test]
fn a_coaching_point_that_follows_makes_the_circle_and_all_amplitudes_smaller() {
    for trail in ["0.2", "-0.2"] {
        let found = figures(
            "coaching",
            &[("follow", "true"), ("trail", trail), ("gamma", "3"), ("posture", "-0.5,0.6,0.6")],
        );
        assert!(number(&found, "radius_after_m") < number(&found, "radius_before_m"));
        let [before, after] = ["joint_amplitude_before", "joint_amplitude_after"].map(|n| numbers(&found, n));
        assert!(before.iter().zip(&after).all(|(b, a)| a < b), "{before:?} {after:?}");
    }
}

#[test]
fn the_force_holds_with_the_feedback_off() {
    for (stiffness, force) in [(500.0, 10.0), (2000.0, 10.0), (2000.0, 4.0), (8000.0, 10.0)] {
        let (k, f) = (format!("{stiffness}"), format!("{force}"));
        let found = figures("force", &[("stiffness", &k), ("force", &f)]);
        let off = number(&found, "rms_off_n");
        assert!(off < f64::max(0.2, stiffness * 1e-4), "{stiffness} N/m: {off} N");
        assert_eq!(numbers(&found, "rms_n").len(), 20);
    }
}

#[test]
fn the_servo_converges_when_the_closed_form_says_so() {
    for (lambda, dt) in [(1.0_f64, 0.04_f64), (2.0, 0.04), (0.5, 0.1)] {
        let (l, t) = (format!("{lambda}"), format!("{dt}"));
        let found = figures("servo", &[("lambda", &l), ("dt", &t)]);
        let start = (0.15_f64.powi(2) + 0.1_f64.powi(2) + 0.25_f64.powi(2)).sqrt();
        let frames = (libm::log(5e-4 / start) / libm::log(1.0 - lambda * dt)).ceil();
        assert!((number(&found, "converged_s") - dt * (frames + 4.0)).abs() < 1e-9);
        assert!((number(&found, "path_ratio") - 1.0).abs() < 1e-9);
        assert!(number(&found, "final_m") < 5e-4);
    }
    let bent = figures("servo", &[("hand_eye_error_deg", "20")]);
    assert!((1.005..1.05).contains(&number(&bent, "path_ratio")));
}

#[test]
fn each_of_the_four_modifications_goes_its_way() {
    let short = [("stop", "35"), ("back", "40"), ("seconds", "40"), ("physics", "false")];
    let found = figures("humanoid_coaching", &short);
    let moved = numbers(&found, "displacement_m");
    assert!(moved.len() == 4 && moved.iter().all(|m| *m > 0.02), "{moved:?}");
    let far = numbers(&found, "far_side_rms_m");
    assert!(far.len() == 4 && far.iter().all(|m| *m < 0.005), "{far:?}");
}

#[test]
fn the_simulated_robot_follows_the_coached_motion() {
    let short = [
        ("start", "2"),
        ("frequency", "0.5"),
        ("stop", "4"),
        ("back", "4"),
        ("seconds", "4"),
        ("radius", "0.04"),
    ];
    let found = figures("humanoid_coaching", &short);
    let lag = numbers(&found, "tracking_rms_m");
    assert!(lag.iter().all(|lag| *lag > 0.0 && *lag < 1e-3), "{lag:?}");
}

/// An experiment with its settings, and the documentation's picture of each of its plots.
struct Pictured {
    experiment: &'static str,
    settings: &'static [(&'static str, &'static str)],
    pictures: &'static [(&'static str, &'static str)],
    /// The sentences about the figures in the documentation.
    said: fn(&Map<String, Value>) -> Vec<String>,
}

const FOLLOWING: &[(&str, &str)] = &[("follow", "true"), ("gamma", "1000"), ("posture", "-0.5,0.6,0.6")];

const PICTURED: [Pictured; 10] = [
    Pictured {
        experiment: "coaching",
        settings: &[],
        pictures: &[("coaching", "coaching")],
        said: |f| {
            let [at_o, opposite, far] =
                ["displacement_at_o_m", "opposite_phase_m", "far_side_rms_m"].map(|name| number(f, name));
            let [first, last] = ["coupling_mean_first", "coupling_mean_last"].map(|name| number(f, name));
            vec![
                format!("{at_o:.3} m at o; {:.2} mm half a period away; {:.1} mm", 1e3 * opposite, 1e3 * far),
                format!("{first:.2}, after 27 periods {last:.3}"),
            ]
        },
    },
    Pictured {
        experiment: "coaching",
        settings: &[("o", "1.8,0.8")],
        pictures: &[("coaching", "coaching_out")],
        said: |f| {
            let [first, last] = ["coupling_mean_first", "coupling_mean_last"].map(|name| number(f, name));
            vec![format!("{:.3} m at o; coupling {first:.2} to {last:.2}", number(f, "displacement_at_o_m"))]
        },
    },
    Pictured {
        experiment: "coaching",
        settings: FOLLOWING,
        pictures: &[("coaching", "coaching_follow")],
        said: |f| vec![format!("with `gamma=1000` to {:.3} m", number(f, "radius_after_m"))],
    },
    Pictured {
        experiment: "oscillator",
        settings: &[("signal", "step"), ("basin", "true")],
        pictures: &[("oscillator", "oscillator"), ("oscillator_basin", "oscillator_basin")],
        said: |f| vec![format!("again {:.2} s after the step", number(f, "settle_after_step_s"))],
    },
    Pictured {
        experiment: "dpdmp",
        settings: &[],
        pictures: &[("dpdmp", "dpdmp")],
        said: |f| {
            let percent = |name: &str, places: usize| {
                let all: Vec<_> =
                    numbers(f, name).iter().map(|e| format!("{:.places$} %", 100.0 * e)).collect();
                all.join(" and ")
            };
            vec![
                format!("off by {} of the range", percent("rmse_original", 0)),
                format!("the modified one by {}", percent("rmse_modified", 2)),
                format!("after an adaptation {}", percent("rmse_adapted_modified", 2)),
            ]
        },
    },
    Pictured {
        experiment: "ilc",
        settings: &[],
        pictures: &[("ilc", "ilc"), ("ilc_joints", "ilc_joints"), ("ilc_feedback", "ilc_feedback")],
        said: |f| {
            let last = |name: &str| 1e3 * numbers(f, name).last().copied().unwrap_or(f64::NAN);
            let second = |name: &str| 1e3 * numbers(f, name)[1];
            let before = |name: &str| 1e3 * number(f, name);
            vec![
                format!("height {:.1} mm to {:.2} mm", before("z_rms_m_before"), last("z_rms_m")),
                format!(
                    "discrete part {:.1} mm to {:.2} mm",
                    before("discrete_z_rms_m_before"),
                    last("discrete_z_rms_m")
                ),
                format!(
                    "{:.1} mm/s instead of {:.1} mm/s",
                    second("velocity_rms_m_s"),
                    second("velocity_rms_m_s_forces_only")
                ),
            ]
        },
    },
    Pictured {
        experiment: "force",
        settings: &[],
        pictures: &[("force", "force")],
        said: |f| {
            let off = number(f, "rms_off_n");
            let first = numbers(f, "rms_n")[0];
            vec![
                format!("{off:.2} N with the feedback off"),
                format!("| 2000 N/m | {first:.1} N | {off:.2} N |"),
            ]
        },
    },
    Pictured {
        experiment: "servo",
        settings: &[("hand_eye_error_deg", "20")],
        pictures: &[("servo", "servo")],
        said: |f| vec![format!("| {:.2} | {:.3} |", number(f, "converged_s"), number(f, "path_ratio"))],
    },
    Pictured {
        experiment: "dual_arm",
        settings: &[],
        pictures: &[("dual_arm", "dual_arm")],
        said: |f| {
            let (distance, force) = (numbers(f, "distance_rms_m"), numbers(f, "force_rms_n"));
            let last = distance.len() - 1;
            vec![
                format!("{:.1} mm to {:.2} mm", 1e3 * distance[0], 1e3 * distance[last]),
                format!("{:.1} N to {:.1} N", force[0], force[last]),
            ]
        },
    },
    Pictured {
        experiment: "humanoid_coaching",
        settings: &[],
        pictures: &[
            ("humanoid_coaching", "humanoid_coaching"),
            ("humanoid_coaching_joints", "humanoid_coaching_joints"),
        ],
        said: |f| {
            let millimetres: Vec<_> =
                numbers(f, "displacement_m").iter().map(|m| format!("{:.0}", 1e3 * m)).collect();
            vec![format!("{} mm their way", millimetres.join(", "))]
        },
    },
];

/// In two tests, because each experiment takes seconds.
#[test]
fn the_documentation_shows_and_says_what_is_found_now() {
    documented(PICTURED.iter().step_by(2));
}

#[test]
fn the_documentation_shows_and_says_the_rest_of_what_is_found_now() {
    documented(PICTURED.iter().skip(1).step_by(2));
}

fn documented<'p>(pictured: impl Iterator<Item = &'p Pictured>) {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs");
    let page = std::fs::read_to_string(docs.join("motion.md")).expect("the page is there");
    for Pictured { experiment, settings, pictures, said } in pictured {
        let outcome = outcome(experiment, settings);
        for text in said(&outcome.figures) {
            assert!(
                page.contains(&text),
                "docs/motion.md does not say `{text}` of {experiment}, {settings:?}"
            );
        }
        for (plot, file) in *pictures {
            let drawn = outcome.plots.iter().find(|(stem, _)| stem == plot);
            let drawn = &drawn.expect("the experiment draws this plot").1;
            let kept = std::fs::read_to_string(docs.join(format!("images/{file}.svg"))).unwrap_or_default();
            assert!(
                alike(drawn, &kept),
                "docs/images/{file}.svg is old: draw it with `armarium reproduce {experiment}`, {settings:?}"
            );
        }
    }
}

/// Whether two pictures differ at most by the rounding of another machine's sine function.
fn alike(a: &str, b: &str) -> bool {
    let numbers = |text: &str| -> Vec<f64> {
        text.split(|c: char| !c.is_ascii_digit() && c != '.' && c != '-')
            .filter_map(|t| t.parse().ok())
            .collect()
    };
    let (a, b) = (numbers(a), numbers(b));
    a.len().abs_diff(b.len()) <= a.len() / 20
        && (a.len() != b.len() || a.iter().zip(&b).all(|(a, b)| (a - b).abs() < 2.0))
}

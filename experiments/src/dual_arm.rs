//! The box task of Gams et al. 2015 (Fig. 4, V): the chart `learn_together.yaml` in its world, with the figures of its referee.

use std::path::Path;
use std::sync::Arc;

use armarium_host::{Console, RunConfig, RunEnded, Silent, run};
use armarium_values::report::{Block, Section, Series, TimePlot};
use armarium_viewer::report::{Curve, Look, Panel, PanelRow, picture};
use serde_json::Value;

use super::error::ExperimentError;
use super::experiment::{Experiment, ExperimentResult, panel};
use super::ilc::Space;
use super::settings::{ExperimentSettings as _, settings};

settings! {
    /// Settings of the learning; the box and the pads are those of the world.
    DualArm {
        /// Space of the learning: joint or task.
        space: Space = Space::Task;
        /// Whether it learns from the velocities of both hands (14), too, and not from the forces alone (10).
        velocity: bool = true;
        /// Epochs of learning.
        epochs: usize = 10, 1.0..=100.0;
        /// Seed that draws the world, noise and offsets.
        seed: u64 = 1;
    }
}

/// The chart, the charts that it needs, and the world.
const FILES: [(&str, &str); 4] = [
    (CHART, include_str!("../../statecharts/learn_together.yaml")),
    ("find_together.yaml", include_str!("../../statecharts/find_together.yaml")),
    ("take_together.yaml", include_str!("../../statecharts/take_together.yaml")),
    ("learn_together.world.yaml", include_str!("../../statecharts/learn_together.world.yaml")),
];
const CHART: &str = "learn_together.yaml";

impl Experiment for DualArm {
    const NAME: &'static str = "dual_arm";
    const ABOUT: &'static str =
        "both arms of ARMAR-III learn to lift and shake a box (Gams et al. 2015, Fig. 4)";

    fn run(&self) -> Result<ExperimentResult, ExperimentError> {
        self.check_ranges()?;
        let failed = |error: &dyn std::fmt::Display| ExperimentError::Failed(error.to_string());
        let folder = tempfile::tempdir().map_err(|error| failed(&error))?;
        let ended = self.run_chart(folder.path()).map_err(|error| failed(&error))?;
        let figures = &ended.report["learning_together"];
        if ended.result.outcome != "success" || figures.is_null() {
            let why = ended.result.reason.as_deref().unwrap_or("the box was not taken");
            return Err(ExperimentError::Failed(format!("{}: {why}", ended.result.outcome)));
        }
        let mut outcome = ExperimentResult::default();
        let epochs = figures["epochs"].as_array().map_or(&[][..], Vec::as_slice);
        for name in EACH {
            outcome.figure(name, epochs.iter().map(|epoch| epoch[name].clone()).collect::<Vec<_>>());
        }
        for name in ["distance_fell", "discrete_fell", "periods_fell"] {
            outcome.figure(name, figures[name].clone());
        }
        outcome.plot(Self::NAME, plot(epochs, &ended.sections));
        Ok(outcome)
    }
}

/// The figures of each epoch.
const EACH: [&str; 8] = [
    "distance_rms_m",
    "discrete_rms_m",
    "periods_rms_m",
    "force_rms_n",
    "internal_most_n",
    "tilt_deg",
    "slipped_m",
    "held",
];

impl DualArm {
    fn run_chart(&self, folder: &Path) -> Result<RunEnded, Box<dyn std::error::Error>> {
        for (name, content) in FILES {
            std::fs::write(folder.join(name), content)?;
        }
        let input = |name: &str, value: &dyn ToString| (name.to_owned(), value.to_string());
        let config = RunConfig {
            seed: self.seed,
            inputs: vec![
                input("space", &if self.space == Space::Joint { "joint" } else { "task" }),
                input("velocity", &self.velocity),
                input("epochs", &self.epochs),
            ],
            report: folder.join("report"),
            store: folder.join("memory.redb"),
            ..RunConfig::new(folder.join(CHART))
        };
        let console: Arc<dyn Console> = Arc::new(Silent);
        Ok(run(&config, &console)?)
    }
}

/// The hands' heights in the first and the last epoch, and the decrease of the errors.
fn plot(epochs: &[Value], sections: &[Section]) -> String {
    let line = |label: &str, colour: u8, name: &str, scale: f64| {
        let errors = epochs.iter().filter_map(|epoch| epoch[name].as_f64());
        let points = errors.zip(1..).map(|(error, n)| [f64::from(n), libm::log10(scale * error)]).collect();
        Curve::new(label, points).looking(Look::Colour(colour))
    };
    let falls = vec![
        line("distance, mm", 1, "distance_rms_m", 1e3),
        line("discrete part, mm", 2, "discrete_rms_m", 1e3),
        line("force, N", 3, "force_rms_n", 1.0),
    ];
    let mut rows: Vec<PanelRow> =
        heights(sections).map(|plot| PanelRow { height: 240.0, panels: vec![over_time(plot)] }).collect();
    rows.push(PanelRow { height: 240.0, panels: vec![panel("epoch", "log10 of the RMS error", falls)] });
    picture("Two arms learn to lift and shake a box", &rows)
}

/// The plots of the referee's section in which both hands are drawn.
fn heights(sections: &[Section]) -> impl Iterator<Item = &TimePlot> {
    sections.iter().flat_map(|section| &section.blocks).filter_map(|block| match block {
        Block::Plot(plot) if plot.series.iter().any(|series| series.label == "first hand") => Some(plot),
        _ => None,
    })
}

/// A plot of an epoch, over the time since its beginning.
fn over_time(plot: &TimePlot) -> Panel {
    let begin =
        plot.series.iter().filter_map(|series| series.t_s.first()).fold(f64::INFINITY, |a, b| a.min(*b));
    let curve = |(series, colour): (&Series, u8)| {
        let points = series.t_s.iter().zip(&series.y).map(|(t, y)| [t - begin, *y]).collect();
        Curve::new(&series.label, points).looking(Look::Colour(colour))
    };
    let marks = plot.marks.iter().map(|(at, name)| (at - begin, name.clone())).collect();
    let curves = plot.series.iter().zip(1..).map(curve).collect();
    Panel { marks, ..panel("time, s", format!("{}: {}", plot.title, plot.y_label), curves) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Entry;

    #[test]
    fn the_left_arm_learns_to_move_with_the_right_one() {
        let outcome = DualArm { epochs: 3, ..DualArm::default() }.run().unwrap();
        let distance: Vec<f64> = outcome.figures["distance_rms_m"]
            .as_array()
            .unwrap()
            .iter()
            .map(|v| v.as_f64().unwrap())
            .collect();
        assert_eq!(distance.len(), 3);
        assert!(distance[2] < 0.7 * distance[0], "{distance:?}");
        assert_eq!(outcome.figures["held"].as_array().unwrap().last(), Some(&1.0.into()));
        assert!(outcome.plots[0].1.contains("first hand"));
    }

    #[test]
    fn settings_out_of_range_are_refused() {
        let none = [("epochs".to_owned(), "0".to_owned())];
        let refused = Entry::of::<DualArm>().run(&none);
        assert!(matches!(refused, Err(ExperimentError::Setting { key, .. }) if key == "epochs"));
    }
}

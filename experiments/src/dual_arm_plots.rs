//! Figures and plots of the box task.

use armarium_simulator::carrying::CarryingRecord;
use armarium_viewer::report::{Curve, Look, Panel, PanelRow, picture};

use super::dual_arm::{DualArm, Epoch};
use super::experiment::{ExperimentResult, panel};

impl DualArm {
    pub(super) fn figures(
        &self,
        before: &Epoch,
        epochs: &[Epoch],
        diverged: Option<usize>,
        outcome: &mut ExperimentResult,
    ) {
        let each = |of: &dyn Fn(&Epoch) -> f64| epochs.iter().map(of).collect::<Vec<f64>>();
        outcome.figure("distance_rms_m", each(&|e| e.figures.distance_rms_m));
        outcome.figure("force_rms_n", each(&|e| e.figures.force_rms_n));
        outcome.figure("distance_rms_before_m", before.figures.distance_rms_m);
        outcome.figure("force_rms_before_n", before.figures.force_rms_n);
        outcome.figure("tilt_rad", each(&|e| e.figures.tilt_rad));
        outcome.figure("slipped_m", each(&|e| e.figures.slipped_m));
        outcome.figure("held", each(&|e| e.figures.held));
        outcome.figure("joint_speed_rad_s", each(&|e| e.speed));
        outcome.figure("joint_margin_rad", each(&|e| e.margin));
        outcome.figure("diverged_in_epoch", diverged.map_or(serde_json::Value::Null, Into::into));
    }

    /// The hands' heights over all epochs, their difference, and the decrease of both errors.
    pub(super) fn plot(&self, before: &Epoch, epochs: &[Epoch]) -> String {
        let samples = |epoch: &Epoch, of: &dyn Fn(&CarryingRecord) -> f64| -> Vec<[f64; 2]> {
            epoch.log.iter().enumerate().step_by(5).map(|(k, r)| [k as f64 * 1e-3, of(r)]).collect()
        };
        let height = |side: usize| move |r: &CarryingRecord| r.tcps[side].translation.vector.z;
        let mut heights = vec![Curve::new("right", samples(before, &height(0))).looking(Look::Reference)];
        heights.extend(epochs.iter().map(|e| Curve::new("", samples(e, &height(1))).looking(Look::Faint)));
        heights.push(Curve::new("left, before", samples(before, &height(1))).looking(Look::Colour(1)));
        let mut boxes = Vec::new();
        if let (Some(first), Some(last)) = (epochs.first(), epochs.last()) {
            heights.push(Curve::new("left, last epoch", samples(last, &height(1))).looking(Look::Colour(2)));
            let tilt =
                |r: &CarryingRecord| (r.carried.rotation * nalgebra::Vector3::x()).z.asin().to_degrees();
            for (name, epoch, colour) in
                [("before", before, 1), ("epoch 1", first, 3), ("last epoch", last, 2)]
            {
                boxes.push(Curve::new(name, samples(epoch, &tilt)).looking(Look::Colour(colour)));
            }
        }
        let mark = || vec![(self.duration, "periodic".to_owned())];
        let line = |name: &str, colour: u8, of: &dyn Fn(&Epoch) -> f64| {
            let points = epochs.iter().zip(1..).map(|(e, n)| [f64::from(n), of(e).log10()]).collect();
            Curve::new(name, points).looking(Look::Colour(colour))
        };
        let falls = vec![
            line("distance, mm", 1, &|e| e.figures.distance_rms_m * 1e3),
            line("force, N", 3, &|e| e.figures.force_rms_n),
        ];
        let over_time = |y: &str, curves| Panel { marks: mark(), ..panel("time, s", y, curves) };
        let row = |height, panel| PanelRow { height, panels: vec![panel] };
        picture(
            "Two arms learn to carry a box",
            &[
                row(300.0, over_time("height of the hands, m", heights)),
                row(220.0, over_time("tilt of the box, degrees", boxes)),
                row(240.0, panel("epoch", "log10 of the RMS error", falls)),
            ],
        )
    }
}

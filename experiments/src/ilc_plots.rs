//! Figures and plots of the learning-control experiment.

use armarium_viewer::report::{Curve, Look, Panel, PanelRow, picture};
use nalgebra::{Vector3, Vector4};

use super::experiment::{ExperimentResult, panel};
use super::ilc::{Epoch, Ilc, Learning};

fn rms(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let n = values.len().max(1) as f64;
    (values.map(|v| v * v).sum::<f64>() / n).sqrt()
}

/// Of the positions or velocities of both hands, the vertical difference.
fn z_rms(hands: &[[Vector3<f64>; 2]]) -> f64 {
    rms(hands.iter().map(|[right, left]| left.z - right.z))
}

impl Ilc {
    /// The discrete part of an epoch.
    fn discrete<'e>(&self, hands: &'e [[Vector3<f64>; 2]]) -> &'e [[Vector3<f64>; 2]] {
        &hands[..self.discrete_steps().min(hands.len())]
    }

    fn distance_rms(&self, epoch: &Epoch) -> f64 {
        let apart = Vector3::new(0.0, 2.0 * self.hand[1], 0.0);
        rms(epoch.x.iter().map(|[right, left]| (right + apart - left).norm()))
    }

    pub(super) fn figures(
        &self,
        learning: &Learning,
        forces_only: &Learning,
        outcome: &mut ExperimentResult,
    ) {
        let per_epoch = |learning: &Learning, of: &dyn Fn(&Epoch) -> f64| {
            learning.epochs.iter().map(of).collect::<Vec<_>>()
        };
        type Figure<'a> = (&'a str, &'a dyn Fn(&Epoch) -> f64);
        let figures: [Figure<'_>; 5] = [
            ("z_rms_m", &|e| z_rms(&e.x)),
            ("discrete_z_rms_m", &|e| z_rms(self.discrete(&e.x))),
            ("velocity_rms_m_s", &|e| z_rms(&e.v)),
            ("discrete_velocity_rms_m_s", &|e| z_rms(self.discrete(&e.v))),
            ("distance_rms_m", &|e| self.distance_rms(e)),
        ];
        for (name, of) in figures {
            outcome.figure(name, per_epoch(learning, of));
        }
        if self.orientation {
            outcome.figure("turned_rms_rad", per_epoch(learning, &|e| rms(e.turned.iter().copied())));
        }
        for (name, of) in figures {
            outcome.figure(&format!("{name}_before"), of(&learning.before));
            outcome.figure(&format!("{name}_forces_only"), per_epoch(forces_only, of));
        }
        outcome.figure("diverged_in_epoch", learning.diverged.map_or(serde_json::Value::Null, Into::into));
        let stride = ((0.01 / self.dt).round() as usize).max(1);
        let thinned = |q: &[Vector4<f64>]| {
            let row = |q: &Vector4<f64>| q.iter().map(|v| (v * 1e6).round() / 1e6).collect::<Vec<f64>>();
            serde_json::Value::from(q.iter().step_by(stride).map(row).collect::<Vec<_>>())
        };
        let left: Vec<_> = learning.epochs.iter().map(|e| thinned(&e.left)).collect();
        outcome.figure("joint_trajectory_dt_s", self.dt * stride as f64);
        outcome.figure("joint_trajectories_rad", left);
        outcome.figure("joint_trajectory_before_rad", thinned(&learning.before.left));
        outcome.figure("joint_trajectory_right_rad", thinned(&learning.right));
    }

    fn curve(&self, values: impl ExactSizeIterator<Item = f64>) -> Vec<[f64; 2]> {
        let stride = values.len().div_ceil(1500).max(1);
        values.enumerate().step_by(stride).map(|(k, v)| [self.dt * k as f64, v]).collect()
    }

    fn left_z(&self, epoch: &Epoch) -> Vec<[f64; 2]> {
        self.curve(epoch.x.iter().map(|[_, left]| left.z))
    }

    fn mark(&self) -> Vec<(f64, String)> {
        vec![(self.duration, "periodic".to_owned())]
    }

    /// Heights in all epochs, and the error over the epochs (Fig. 1).
    pub(super) fn plot_epochs(&self, learning: &Learning) -> String {
        let mut curves = vec![
            Curve::new("right", self.curve(learning.before.x.iter().map(|[right, _]| right.z)))
                .looking(Look::Reference),
        ];
        curves.extend(learning.epochs.iter().map(|e| Curve::new("", self.left_z(e)).looking(Look::Faint)));
        curves.push(Curve::new("left, before", self.left_z(&learning.before)).looking(Look::Colour(1)));
        if let Some(last) = learning.epochs.last() {
            curves.push(Curve::new("left, last epoch", self.left_z(last)).looking(Look::Colour(2)));
        }
        let heights = self.over_time("height, m", curves);
        let mut end_to_end = Vec::new();
        let whole = self.dt * self.steps() as f64;
        for (i, epoch) in learning.epochs.iter().enumerate() {
            let error = self.curve(epoch.x.iter().map(|[right, left]| (left.z - right.z) * 1e3));
            end_to_end.extend(error.iter().map(|[t, e]| [t + whole * i as f64, *e]));
            end_to_end.push([f64::NAN; 2]);
        }
        let error = panel("time over all epochs, s", "height error, mm", vec![Curve::new("", end_to_end)]);
        let line = |label: &str, colour: u8, of: &dyn Fn(&Epoch) -> f64| {
            let points =
                learning.epochs.iter().zip(1..).map(|(e, n)| [f64::from(n), libm::log10(of(e))]).collect();
            Curve::new(label, points).looking(Look::Colour(colour))
        };
        let falls = panel(
            "epoch",
            "log10 of the RMS error, m or m/s",
            vec![
                line("height", 1, &|e| z_rms(&e.x)),
                line("height, discrete part", 2, &|e| z_rms(self.discrete(&e.x))),
                line("velocity", 3, &|e| z_rms(&e.v)),
            ],
        );
        let row = |panel, height| PanelRow { height, panels: vec![panel] };
        picture(
            "The left arm learns to follow the right one",
            &[row(heights, 300.0), row(error, 240.0), row(falls, 260.0)],
        )
    }

    /// Joints of the left arm before and after learning, and of the right arm (Figs 2, 3).
    pub(super) fn plot_joints(&self, learning: &Learning) -> String {
        let joints = ["shoulder about y", "shoulder about x", "shoulder about z", "elbow"];
        let joint = |i: usize| {
            let of = |q: &[Vector4<f64>]| self.curve(q.iter().map(move |q| q[i]));
            let mut curves = vec![
                Curve::new("right", of(&learning.right)).looking(Look::Reference),
                Curve::new("left, before", of(&learning.before.left)).looking(Look::Colour(1)),
            ];
            if let Some(last) = learning.epochs.last() {
                curves.push(Curve::new("left, last epoch", of(&last.left)).looking(Look::Colour(2)));
            }
            self.over_time(&format!("{}, rad", joints[i]), curves)
        };
        let row = |a: usize, b: usize| PanelRow { height: 280.0, panels: vec![joint(a), joint(b)] };
        picture("Joints of both arms", &[row(0, 1), row(2, 3)])
    }

    /// The effect of the velocities in the feedback, in the first epochs (Figs 5, 6).
    pub(super) fn plot_feedback(&self, learning: &Learning, forces_only: &Learning) -> String {
        let of = |name: &str, index: usize, value: &dyn Fn(&Epoch, usize) -> f64| {
            let line = |epoch: &Epoch| self.curve((0..epoch.x.len()).map(|k| value(epoch, k)));
            let right = learning.before.x.len();
            let own = |k: usize| -> f64 {
                if name.starts_with("height") { learning.before.x[k][0].z } else { learning.before.v[k][0].z }
            };
            let mut curves =
                vec![Curve::new("right", self.curve((0..right).map(own))).looking(Look::Reference)];
            for (label, learning, colour) in
                [("forces (10)", forces_only, 1), ("and velocities (14)", learning, 2)]
            {
                if let Some(epoch) = learning.epochs.get(index) {
                    curves.push(Curve::new(label, line(epoch)).looking(Look::Colour(colour)));
                }
            }
            self.over_time(&format!("{name}, epoch {}", index + 1), curves)
        };
        let row = |index: usize| PanelRow {
            height: 270.0,
            panels: vec![
                of("velocity, m/s", index, &|e, k| e.v[k][1].z),
                of("height, m", index, &|e, k| e.x[k][1].z),
            ],
        };
        picture("Forces and velocities in the feedback", &[row(0), row(1), row(2)])
    }

    fn over_time(&self, y_label: &str, curves: Vec<Curve>) -> Panel {
        Panel { marks: self.mark(), ..panel("time, s", y_label, curves) }
    }
}

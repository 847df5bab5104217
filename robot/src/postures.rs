//! Named postures of ARMAR-III for work with the right hand over a table, and the numbers behind their choice.
//!
//! The numbers are from `examples/workspace.rs`, for a TCP 0.10 m over a table 0.95 m high (TCP height 1.05 m),
//! about the point `(0.28, 0.53)`, with every joint within its speed limit (arm 1 rad/s, hip 0.5 rad/s) and 0.06
//! rad from its limits, and the elbow 0.03 m clear of the table.
//!
//! **Lease the torso with the arm.** Worst direction, worst point of a box of ±0.13 m in x and y, with the palm level:
//!
//! | moved by | torso posture | TCP speed | circle r 0.05 m | circle r 0.08 m | distance to limits |
//! |---|---|---|---|---|---|
//! | arm | upright | not every point in reach | | | |
//! | arm | lean 15 degrees | 0.19 m/s | 0.87 Hz | 0.53 Hz | 0.02 rad |
//! | arm | lean 12, roll 13, yaw 20 | 0.25 m/s | 0.73 Hz | 0.44 Hz | 0.20 rad |
//! | arm and torso | roll 14, yaw 7 (`wipe`) | 0.47 m/s | 1.67 Hz | 1.02 Hz | 0.32 rad |
//!
//! The last line holds for TCP heights of 1.00 to 1.10 m. With the centre of the circles 5 cm off in any direction
//! it is 1.62 Hz, 0.98 Hz and 0.23 rad. With the arm alone in the same posture it is 0.83 Hz and 0.52 Hz. A hand
//! pitched by 34 degrees (tips down) gains 9 % (0.51 m/s), so the palm stays level. Leaving the rotation about the
//! vertical free gains nothing for arm and torso, and 20 to 30 % for the arm alone.
//!
//! Reach with arm and torso, palm level: for x 0.10..0.40, y 0.35..0.70 and TCP heights 1.00..1.10 m, hand yaws
//! over a range of 90 degrees or more at every point except the near left edge. So an object that can be gripped
//! along either of two perpendicular sides can be gripped at any yaw. From there, 0.15 m straight up are reachable
//! too.

use std::sync::Arc;

use nalgebra::{Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};

use crate::{Gaze, Model};

/// Yaw of the hand in [`wipe`], rad: fingers to the left of forward.
pub const WIPE_YAW: f64 = 0.77;
/// Position of the TCP in [`wipe`], root frame, m.
pub const WIPE_TCP: [f64; 3] = [0.28, 0.53, 1.05];
/// The point that the cameras look at in every posture, root frame, m: the middle of the table, 5 cm over it.
pub const TABLE: [f64; 3] = [0.25, 0.55, 1.00];

const TORSO: [f64; 3] = [0.0, 0.25, 0.125];
const WIPE_ARM: [f64; 7] = [-0.305, 0.675, 0.789, 0.132, -0.699, -0.037, -0.094];
const HOME_ARM: [f64; 7] = [-1.2, 1.4, -0.1, -0.8, -0.3, 0.2, 0.1];
/// Position of an open finger, m.
const OPEN: f64 = 0.06;

/// The orientation of a TCP (root from TCP) whose fingers point `yaw` rad to the left of forward, with the palm
/// down and the fingertips lowered by `pitch` rad.
pub fn palm_down(yaw: f64, pitch: f64) -> UnitQuaternion<f64> {
    let level = Matrix3::new(0.0, -1.0, 0.0, 0.0, 0.0, 1.0, -1.0, 0.0, 0.0);
    let level = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(level));
    UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw)
        * level
        * UnitQuaternion::from_axis_angle(&Vector3::y_axis(), pitch)
}

/// The right arm out to the side, where it does not hide the table from the cameras; hand open. A straight line in
/// joint space leads to [`wipe`] without touching a table up to 0.95 m high.
pub fn home(model: &Arc<Model>) -> Vec<f64> {
    posture(model, &HOME_ARM)
}

/// The right hand over the table at [`WIPE_TCP`], palm level; hand open. It is the null-space posture of
/// [`DifferentialIk`](crate::DifferentialIk) over [`reaching_joints`], and the seed of
/// [`solve_pose`](crate::solve_pose).
pub fn wipe(model: &Arc<Model>) -> Vec<f64> {
    posture(model, &WIPE_ARM)
}

/// The names of the postures.
pub const NAMES: [&str; 2] = ["home", "wipe"];

/// A posture by its name, one of [`NAMES`].
pub fn named(model: &Arc<Model>, name: &str) -> Option<Vec<f64>> {
    match name {
        "home" => Some(home(model)),
        "wipe" => Some(wipe(model)),
        _ => None,
    }
}

/// The ten joints that move the right hand: `torso`, then `right_arm`.
pub fn reaching_joints(model: &Model) -> Vec<usize> {
    model.limb("torso").iter().chain(model.limb("right_arm")).copied().collect()
}

fn posture(model: &Arc<Model>, arm: &[f64; 7]) -> Vec<f64> {
    let mut q = model.zero();
    for (j, value) in reaching_joints(model).into_iter().zip(TORSO.iter().chain(arm)) {
        q[j] = *value;
    }
    model.limb("right_hand").iter().for_each(|&j| q[j] = OPEN);
    match Gaze::of(model) {
        Ok(gaze) => gaze.look_at(model, &q, &Point3::from(TABLE)).unwrap_or_else(|nearest| nearest.nearest),
        Err(_) => q,
    }
}

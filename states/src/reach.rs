//! Whether the arm can perform a motion: each point within reach, each joint within its speed limit.

use armarium_robot::{PoseOptions, solve_pose};
use armarium_runtime::skill::Failure;

use crate::arm::tcp_of;
use crate::equipment::Equipment;
use crate::motions::failed;
use crate::wiper::Wiper;

/// Number of points of the path that are checked.
const POINTS: usize = 48;

/// The largest share of a joint's speed limit that a motion needs of its arm at its frequency, with the TCP `over` m over where
/// it is when the tool stands. Fails where a point is out of reach, or a joint would exceed its speed limit.
pub(crate) fn required_speed(equipment: &Equipment, wiper: &Wiper, over: f64) -> Result<f64, Failure> {
    let model = equipment.robot.model();
    let (arm, motion) = (&wiper.arm, wiper.motion());
    let (joints, link) = (&arm.leases.joints, tcp_of(&arm.limb)?);
    let path = motion.primitive().steady_path(POINTS).map_err(failed)?;
    let pose = |s: usize| {
        let point = &path.y[s % path.len()];
        wiper.pose_at([point[0], point[1]], over)
    };
    let now = &equipment.robot.sensed().borrow().position.clone();
    let mut q = model.taken_at(model.ready(&arm.limb.name), now);
    let mut random = equipment.random();
    let mut solve = |s: usize, seed: &[f64]| {
        solve_pose(model, link, joints, &pose(s), seed, &PoseOptions::default(), &mut random).map_err(|e| {
            let (point, mm) = (pose(s).translation.vector, e.position_error_m * 1e3);
            Failure::new(format!(
                "the motion leaves the arm's reach at x {:.2}, y {:.2} m: {mm:.0} mm are missing",
                point.x, point.y
            ))
        })
    };
    q = solve(0, &q)?;
    let dt = 1.0 / (motion.frequency_hz() * POINTS as f64);
    let mut worst = (0.0_f64, "");
    for s in 1..=POINTS {
        let next = solve(s, &q)?;
        for &joint in joints {
            let limit = model.joints()[joint].velocity;
            let share = (next[joint] - q[joint]).abs() / dt / limit;
            if share > worst.0 {
                worst = (share, &model.joints()[joint].name);
            }
        }
        q = next;
    }
    if worst.0 > 1.0 {
        return Err(Failure::new(format!(
            "the motion is too fast for the arm: at {:.2} Hz the joint `{}` would need {:.0} % of its largest speed; \
             show a slower or smaller motion",
            motion.frequency_hz(),
            worst.1,
            worst.0 * 100.0
        )));
    }
    Ok(worst.0)
}

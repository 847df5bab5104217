//! What the arm reaches: poses, by how far its joints are from their limits there and the arm from its own body, and motions, by the
//! speed that they need of its joints.

use std::sync::Arc;

use armarium_robot::planning::Planner;
use armarium_robot::{LinkId, Model, PoseOptions, solve_pose};
use armarium_runtime::skill::Failure;
use nalgebra::Isometry3;
use rand_chacha::ChaCha8Rng;

use crate::arm::tcp_of;
use crate::equipment::Equipment;
use crate::motions::failed;
use crate::wiper::Wiper;

/// Number of points of the path that are checked.
const POINTS: usize = 48;
/// Poses with less margin than this to a joint limit are not reached, rad, and the margin that is tried for then.
const MIN_MARGIN: f64 = 0.03;
const FREE_MARGIN: f64 = 0.1;

/// How far from its own body the arm is to be, m, and what each m costs by which it is nearer, as margin in rad: about 1 rad where the guard
/// stops it.
const ROOM: f64 = 0.06;
const NEAR_COST: f64 = 25.0;

/// The joints with which a TCP reaches.
pub(crate) struct Reach<'a> {
    model: &'a Arc<Model>,
    joints: &'a [usize],
    tcp: LinkId,
    /// The positions of all joints near which they are to be, rad (m).
    near: &'a [f64],
    /// Knows how near the robot's bodies come to each other.
    own: Planner,
}

impl<'a> Reach<'a> {
    /// How the TCP reaches with these joints, with all joints as near as possible to positions, rad (m).
    pub(crate) fn new(model: &'a Arc<Model>, joints: &'a [usize], tcp: LinkId, near: &'a [f64]) -> Self {
        Self { model, joints, tcp, near, own: Planner::new(model, &[]) }
    }

    /// The least margin to the joints' limits, rad, at poses that the TCP takes one after the other (root frame), less what it costs
    /// that the arm comes near to its own body; else how far one of them is from what is reached, m, which is 0 if only a joint limit is too near.
    pub(crate) fn margin(&mut self, poses: &[Isometry3<f64>], random: &mut ChaCha8Rng) -> Result<f64, f64> {
        let (nearest, cost) = self.margin_beyond(PoseOptions::default().margin, poses, random)?;
        if nearest >= MIN_MARGIN {
            return Ok(nearest - cost);
        }
        // The nearest solution may stand at a limit from which another one is free.
        let (free, cost) = self.margin_beyond(FREE_MARGIN, poses, random).map_err(|_| 0.0)?;
        Ok(free - cost)
    }

    /// The margin of what is found when each joint is to keep `least` rad from its limits, and what the own body costs, rad.
    fn margin_beyond(
        &mut self,
        least: f64,
        poses: &[Isometry3<f64>],
        random: &mut ChaCha8Rng,
    ) -> Result<(f64, f64), f64> {
        let options = PoseOptions { restarts: 3, margin: least, ..PoseOptions::default() };
        let (mut q, mut margin, mut cost) = (self.near.to_vec(), f64::INFINITY, 0.0_f64);
        for pose in poses {
            q = solve_pose(self.model, self.tcp, self.joints, pose, &q, &options, random)
                .map_err(|e| e.position_error_m)?;
            let limits = |&j: &usize| (&self.model.joints()[j], q[j]);
            let margins =
                self.joints.iter().map(limits).map(|(joint, q)| (q - joint.lower).min(joint.upper - q));
            margin = margins.fold(margin, f64::min);
            cost = cost.max(self.cost_of_own_body(&q));
        }
        Ok((margin, cost))
    }

    /// What it costs that the arm is near to its own body with all joints at `q`, rad (m); as margin in rad.
    fn cost_of_own_body(&mut self, q: &[f64]) -> f64 {
        let near = self.own.nearest_guarded(self.joints, q, ROOM);
        near.map_or(0.0, |near| NEAR_COST * (ROOM - near.distance_m))
    }
}

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_arm_that_comes_near_to_its_own_body_costs() {
        let model = Model::shipped("armar3").unwrap();
        let arm = &model.limbs()["right_arm"];
        let ready = model.ready(&arm.name).to_vec();
        let mut reach = Reach::new(&model, &arm.joints, tcp_of(arm).unwrap(), &ready);
        assert_eq!(reach.cost_of_own_body(&ready), 0.0);
        let mut turned = |joint: usize, share: f64| {
            let mut q = ready.clone();
            let (lower, upper) = (model.joints()[joint].lower, model.joints()[joint].upper);
            q[joint] = lower + share * (upper - lower);
            reach.cost_of_own_body(&q)
        };
        let costs =
            arm.joints.iter().flat_map(|&joint| (0..=20).map(move |step| (joint, f64::from(step) / 20.0)));
        let most = costs.map(|(joint, share)| turned(joint, share)).fold(0.0, f64::max);
        assert!(most > 0.8, "{most}");
    }
}

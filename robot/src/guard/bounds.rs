//! The guard's bounds on the velocities of joints and TCPs, and on the acceleration of joints.
//!
//! Limbs with one holder, or that move the same TCP at the same time, form a motion. All its joints are scaled by
//! one factor, so that every TCP keeps its direction, whichever joints move it. Pure; it only limits commands.

use nalgebra::Point3;

use super::clearance::Clearance;
use crate::seam::lease::LeaseTable;
use crate::{Kinematics, LinkId, Model};

/// A TCP and the limbs that move it.
#[derive(Debug)]
struct Tcp {
    link: LinkId,
    /// The limbs with a joint that moves it, as indices into the lease table.
    carriers: Vec<usize>,
    /// Its bound in this step, m/s.
    limit: f64,
}

/// Which limbs are scaled together, and by which factor.
#[derive(Debug)]
pub(crate) struct VelocityBounds {
    /// The joints of each limb, in the lease table's order.
    limbs: Vec<Vec<usize>>,
    tcps: Vec<Tcp>,
    /// The holder number of each limb in this step; leases of one holder have the same number.
    holders: Vec<Option<u64>>,
    /// The motion of each limb in this step; limbs with the same number are scaled together.
    motions: Vec<usize>,
    /// The factor of each limb.
    factors: Vec<f64>,
}

impl VelocityBounds {
    pub(crate) fn new(model: &Model) -> Self {
        let limbs: Vec<Vec<usize>> = model.limbs().values().map(|limb| limb.joints.clone()).collect();
        let carriers = |tcp: LinkId| {
            let moves = |joints: &Vec<usize>| joints.iter().any(|&j| model.moves(j, tcp));
            (0..limbs.len()).filter(|&i| moves(&limbs[i])).collect()
        };
        let tcps = model.limbs().values().filter_map(|limb| limb.tcp);
        let tcps = tcps.map(|link| Tcp { link, carriers: carriers(link), limit: 0.0 }).collect();
        Self {
            tcps,
            holders: vec![None; limbs.len()],
            motions: vec![0; limbs.len()],
            factors: vec![1.0; limbs.len()],
            limbs,
        }
    }

    /// Reads the holders and the limits of the leases; `speed_m_s` limits every TCP.
    pub(crate) fn read(&mut self, table: &LeaseTable, speed_m_s: f64) {
        for (holder, slot) in self.holders.iter_mut().zip(&table.slots) {
            *holder = slot.faultless().map(|held| held.holder_number);
        }
        for tcp in &mut self.tcps {
            let limits = tcp.carriers.iter().filter_map(|&i| table.slots[i].faultless()?.limits.speed_m_s);
            tcp.limit = limits.fold(speed_m_s, f64::min).max(0.0);
        }
    }

    /// Scales the `desired` joint velocities until each joint and each TCP is within its bound.
    /// Bodies that approach each other are within the bounds of `clearance` then.
    pub(crate) fn bound(
        &mut self,
        model: &Model,
        kinematics: &Kinematics,
        clearance: &Clearance,
        desired: &mut [f64],
    ) {
        self.find_motions(desired);
        let joints = model.joints();
        for (factor, limb) in self.factors.iter_mut().zip(&self.limbs) {
            *factor = least(limb.iter().map(|&j| scale_to(joints[j].velocity, desired[j].abs())));
        }
        self.scale(desired);
        self.factors.fill(1.0);
        for tcp in &self.tcps {
            let speed = kinematics.twist(tcp.link, &Point3::origin(), desired).linear.norm();
            let factor = scale_to(tcp.limit, speed);
            for &i in &tcp.carriers {
                self.factors[i] = self.factors[i].min(factor);
            }
        }
        for (carriers, factor) in clearance.bounds(desired) {
            for &i in carriers {
                self.factors[i] = self.factors[i].min(factor);
            }
        }
        self.scale(desired);
    }

    /// Moves `velocity` towards `desired` for `dt` s within the joints' accelerations. Each motion follows a
    /// straight line in joint space, so that a TCP that is within its bound at both ends is so in between.
    pub(crate) fn accelerate(&mut self, model: &Model, desired: &[f64], velocity: &mut [f64], dt: f64) {
        let joints = model.joints();
        for (factor, limb) in self.factors.iter_mut().zip(&self.limbs) {
            let change = |j: usize| (desired[j] - velocity[j]).abs();
            *factor = least(limb.iter().map(|&j| scale_to(joints[j].acceleration * dt, change(j))));
        }
        self.share_factors();
        for (factor, limb) in self.factors.iter().zip(&self.limbs) {
            for &j in limb {
                velocity[j] += factor * (desired[j] - velocity[j]);
            }
        }
    }

    /// Limbs form one motion if they have the same holder and each moves a TCP, or if they move the same TCP.
    fn find_motions(&mut self, desired: &[f64]) {
        let Self { limbs, tcps, holders, motions, .. } = self;
        let moving = |i: usize| limbs[i].iter().any(|&j| desired[j] != 0.0);
        let carries = |i: usize| tcps.iter().any(|tcp| tcp.carriers.contains(&i));
        let together = |i: usize, k: usize| {
            (holders[i].is_some() && holders[i] == holders[k] && carries(i) && carries(k))
                || (moving(i)
                    && moving(k)
                    && tcps.iter().any(|t| t.carriers.contains(&i) && t.carriers.contains(&k)))
        };
        for (i, motion) in motions.iter_mut().enumerate() {
            *motion = i;
        }
        for i in 0..limbs.len() {
            for k in i + 1..limbs.len() {
                if motions[i] != motions[k] && together(i, k) {
                    let (kept, joined) = (motions[i], motions[k]);
                    motions.iter_mut().filter(|m| **m == joined).for_each(|m| *m = kept);
                }
            }
        }
    }

    /// Sets the factor of all limbs of a motion to their smallest one.
    fn share_factors(&mut self) {
        for i in 0..self.factors.len() {
            let mine = self.motions[i];
            let same = self.motions.iter().zip(&self.factors).filter(|(motion, _)| **motion == mine);
            let shared = least(same.map(|(_, factor)| *factor));
            // Every limb of the motion finds the same minimum, whether or not this factor was set already.
            self.factors[i] = shared;
        }
    }

    fn scale(&mut self, desired: &mut [f64]) {
        self.share_factors();
        for (factor, limb) in self.factors.iter().zip(&self.limbs) {
            limb.iter().for_each(|&j| desired[j] *= factor);
        }
    }
}

/// The factor that brings `value` within `limit`.
fn scale_to(limit: f64, value: f64) -> f64 {
    if value > limit { limit / value } else { 1.0 }
}

fn least(factors: impl Iterator<Item = f64>) -> f64 {
    factors.fold(1.0, f64::min)
}

//! Two hands on one load: from the wrenches that both feel to where each of them goes, so that the load moves as it shall and is
//! neither dropped nor crushed.
//!
//! What two hands do to a load has two parts. The external one is the sum of their wrenches: it carries and moves the load. The
//! internal one is half of their difference, which the load does not feel as a motion: along the line between both contacts it
//! is the squeeze, in the other directions it is what the hands do against each other because neither is exactly where it is
//! believed to be. The hands move as if they were fixed to the load. On top of that they come closer until the squeeze is right,
//! and yield to the rest of the internal wrench as a spring does, without an integral, as a load whose middle of mass is not in
//! the middle shares its weight unequally for good. Hands that grip the load need no squeeze: they yield to all of it.
//!
//! It knows no robot and plans no way: whoever uses it says where the load shall be.

#[cfg(test)]
mod tests;

use nalgebra::{Isometry3, Point3, Translation3, Unit, UnitQuaternion, Vector3, Vector6};

use crate::constants::{GAIN, POSITIVE};
use crate::error::{MotionError, finite, sample_time, vector};
use crate::straight_line::LinePoint;

/// Contacts that are nearer to each other than this have no line between them, m.
const LEAST_APART: f64 = 0.01;

/// How much more a hand presses than with what it carries along the load's side over the friction, be it by an unequal share or by a shove.
const FIRM: f64 = 1.25;

constants! {
    /// The constants of a [`SharedLoad`].
    pub struct SharedLoadConfig {
        /// Least squeeze, N.
        squeeze: f64 = 25.0, POSITIVE;
        /// Largest squeeze, N.
        most_squeeze: f64 = 35.0, POSITIVE;
        /// The friction between hands and load on which it relies.
        friction: f64 = 0.6, POSITIVE;
        /// How many times half of the load over that friction the hands press.
        margin: f64 = 1.5, 1.0..=10.0;
        /// A load that would slip in the largest squeeze, without the margin, for this long is about to be lost, s.
        slips_after: f64 = 0.2, 0.0..=60.0;
        /// Time constant with which the load is weighed, s: one that swings on its contacts weighs more and less in turns, and a
        /// squeeze that followed would keep it swinging.
        weighing_time: f64 = 0.5, POSITIVE;
        /// How fast the wanted squeeze changes, N/s.
        squeeze_rate: f64 = 80.0, POSITIVE;
        /// And how fast it rises where a hand would slip without more, N/s.
        slip_rate: f64 = 80.0, POSITIVE;
        /// Closing speed of each hand for a missing newton, m/s/N. With contacts of the stiffness K, the squeeze settles with the
        /// rate K times this; it has to be slower than the drives.
        gain: f64 = 7e-4, GAIN;
        /// Largest closing speed of each hand, m/s.
        fastest: f64 = 0.04, POSITIVE;
        /// How far each hand yields along the load's side for a newton of internal force, m/N.
        compliance: f64 = 5e-4, 0.0..=1.0;
        /// How far each hand turns for a newton metre of internal moment at its contact, rad/(N m).
        turning_compliance: f64 = 5e-3, 0.0..=10.0;
        /// Time constant of yielding, s.
        yield_time: f64 = 0.3, POSITIVE;
        /// A hand that presses with less than this share of the wanted squeeze ...
        lost_share: f64 = 0.3, 0.0..=1.0;
        /// ... for this long has lost the load, s.
        lost_after: f64 = 0.1, 0.0..=60.0;
    }
}

/// A hand on the load, in the frame of the load's motion, which does not turn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HandOnLoad {
    /// Pose of its TCP.
    pub tcp: Isometry3<f64>,
    /// The middle of the contact.
    pub contact: Point3<f64>,
    /// What the load does to the hand: force, N, and torque about the TCP, N m.
    pub wrench: Vector6<f64>,
}

impl HandOnLoad {
    fn check(&self) -> Result<(), MotionError> {
        vector("wrench", 6, self.wrench.as_slice())?;
        vector("contact", 3, self.contact.coords.as_slice())?;
        vector("tcp", 3, self.tcp.translation.vector.as_slice())?;
        finite("tcp", self.tcp.rotation.coords.as_slice())
    }

    /// The force of the hand on the load, and its moment about the contact.
    fn on_load(&self) -> (Vector3<f64>, Vector3<f64>) {
        let (force, torque) = (self.wrench.fixed_rows::<3>(0), self.wrench.fixed_rows::<3>(3));
        let lever = self.tcp.translation.vector - self.contact.coords;
        (-force, -(torque + lever.cross(&force)))
    }
}

/// What two hands do to a load.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LoadForces {
    /// The sum of both forces on the load, N: what carries and moves it.
    pub external: Vector3<f64>,
    /// Half the force of the first hand less that of the second, N.
    pub internal: Vector3<f64>,
    /// The same of the moments about each contact, N m.
    pub moment: Vector3<f64>,
    /// From the first contact to the second.
    pub line: Unit<Vector3<f64>>,
    /// The internal force along that line, N; positive where the hands press against each other.
    pub squeeze: f64,
    /// What each hand presses along it, and what it carries along the load's side, N.
    pub hands: [(f64, f64); 2],
}

impl LoadForces {
    /// Of the first and the second hand.
    ///
    /// # Errors
    /// When a number is not finite, or the contacts are nearer to each other than 10 mm.
    ///
    /// # Source
    /// Williams and Khatib 1993 (the virtual linkage), for two contacts; the external part is the grasp matrix times the
    /// contacts' wrenches.
    pub fn of(hands: &[HandOnLoad; 2]) -> Result<Self, MotionError> {
        hands.iter().try_for_each(HandOnLoad::check)?;
        let line = Unit::try_new(hands[1].contact - hands[0].contact, LEAST_APART);
        let line = line.ok_or(MotionError::Degenerate { what: "contacts", why: "they are in one place" })?;
        let [(first, m1), (second, m2)] = hands.each_ref().map(HandOnLoad::on_load);
        let internal = (first - second) / 2.0;
        let share = |force: &Vector3<f64>, sign: f64| {
            let along = force.dot(&line);
            (sign * along, (force - line.into_inner() * along).norm())
        };
        Ok(Self {
            external: first + second,
            internal,
            moment: (m1 - m2) / 2.0,
            line,
            squeeze: internal.dot(&line),
            hands: [share(&first, 1.0), share(&second, -1.0)],
        })
    }
}

/// Whether both hands have the load.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LoadStatus {
    /// Both press on it, or grip it as far as forces can tell.
    Held,
    /// One does not any more.
    Lost,
    /// The largest squeeze does not hold it by the friction on which the law relies: it is to be put down before it slips away.
    Slips,
}

/// A step of a [`SharedLoad`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SharedLoadStep {
    /// Where the TCPs of the first and the second hand go, with their velocities.
    pub hands: [LinePoint; 2],
    /// What the hands do to the load.
    pub forces: LoadForces,
    /// The squeeze that is wanted now, N.
    pub wanted: f64,
    /// Whether both have it.
    pub status: LoadStatus,
}

/// How hands hold a load.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Holding {
    /// They press on it from two sides: friction alone carries it.
    Pressing,
    /// Each grips it.
    Gripping,
}

/// Two hands on one load; see the module.
#[derive(Debug, Clone)]
pub struct SharedLoad {
    config: SharedLoadConfig,
    holding: Holding,
    /// Pose of the load's frame when it was taken: in the middle between the contacts, its axes along those of the motion's frame.
    taken: Isometry3<f64>,
    /// The TCPs and the contacts in the load's frame.
    load_from_tcp: [Isometry3<f64>; 2],
    contacts: [Point3<f64>; 2],
    /// How far the first hand has gone beyond that, and the second one the other way: m and rad, load's frame.
    beyond: [Vector3<f64>; 2],
    /// What both carry, N.
    carried: f64,
    wanted: f64,
    unpressed: f64,
    /// For how long the largest squeeze has been too little, s.
    slips: f64,
}

impl SharedLoad {
    /// Takes the load with both hands where they are, between which it is pressed. The squeeze goes on from what it is.
    ///
    /// # Errors
    /// When a constant is outside its range, a number is not finite, or the contacts are in one place.
    pub fn new(config: SharedLoadConfig, hands: &[HandOnLoad; 2]) -> Result<Self, MotionError> {
        Self::held(config, Holding::Pressing, hands)
    }

    /// The same for a load that they hold in this way. Of one that they grip, the contacts are the middles of both grips.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn held(
        config: SharedLoadConfig,
        holding: Holding,
        hands: &[HandOnLoad; 2],
    ) -> Result<Self, MotionError> {
        config.check_ranges()?;
        let forces = LoadForces::of(hands)?;
        let middle = nalgebra::center(&hands[0].contact, &hands[1].contact);
        let taken = Isometry3::from_parts(middle.into(), UnitQuaternion::identity());
        Ok(Self {
            wanted: match holding {
                Holding::Pressing => forces.squeeze.clamp(0.0, config.most_squeeze),
                Holding::Gripping => 0.0,
            },
            carried: forces.external.norm(),
            config,
            holding,
            load_from_tcp: hands.each_ref().map(|hand| taken.inverse() * hand.tcp),
            contacts: hands.each_ref().map(|hand| taken.inverse() * hand.contact),
            taken,
            beyond: [Vector3::zeros(); 2],
            unpressed: 0.0,
            slips: 0.0,
        })
    }

    /// The pose of the load's frame when it was taken.
    pub fn taken(&self) -> &Isometry3<f64> {
        &self.taken
    }

    /// Where the load's frame is for a hand whose TCP is there, without what it goes beyond that.
    pub fn load_of(&self, hand: usize, tcp: &LinePoint) -> LinePoint {
        let pose = tcp.pose * self.load_from_tcp[hand].inverse();
        let from_tcp = pose.translation.vector - tcp.pose.translation.vector;
        LinePoint { pose, linear: tcp.linear + tcp.angular.cross(&from_tcp), angular: tcp.angular }
    }

    /// Advances by `dt` s, with the load's frame at `load`. Does not allocate.
    ///
    /// # Errors
    /// When `dt` is not positive, a number is not finite, or the contacts are in one place; nothing is changed.
    pub fn step(
        &mut self,
        dt: f64,
        hands: &[HandOnLoad; 2],
        load: &LinePoint,
    ) -> Result<SharedLoadStep, MotionError> {
        self.step_each(dt, hands, &[*load; 2])
    }

    /// The same for hands that do not agree: each moves as if the load's frame were where it believes it to be.
    ///
    /// # Errors
    /// As [`step`](Self::step).
    pub fn step_each(
        &mut self,
        dt: f64,
        hands: &[HandOnLoad; 2],
        loads: &[LinePoint; 2],
    ) -> Result<SharedLoadStep, MotionError> {
        sample_time(dt)?;
        let forces = LoadForces::of(hands)?;
        let c = &self.config;
        self.carried += (forces.external.norm() - self.carried) * (dt / (dt + c.weighing_time));
        let load_from_root = loads[0].pose.rotation.inverse();
        // With less than this a hand slips.
        let least = forces.hands.iter().map(|(_, along)| along / c.friction).fold(0.0, f64::max);
        // Along this line the squeeze is kept; in all other directions the hands yield. `shared` is what the load asks for, `firm` what
        // keeps each hand from slipping.
        let (line, shared, firm) = match self.holding {
            Holding::Pressing => {
                let shared = c.squeeze.max(c.margin * self.carried / (2.0 * c.friction));
                // What is shoved from one hand towards the other presses less on the first one.
                let firm = |(across, along): &(f64, f64)| FIRM * along / c.friction + forces.squeeze - across;
                let firm = forces.hands.iter().map(firm).fold(0.0, f64::max);
                let line = load_from_root * forces.line.into_inner();
                (line, shared.min(c.most_squeeze), firm.min(c.most_squeeze))
            }
            Holding::Gripping => (Vector3::zeros(), 0.0, 0.0),
        };
        let too_little = self.holding == Holding::Pressing && least > c.most_squeeze;
        self.slips = if too_little { self.slips + dt } else { 0.0 };
        let fastest = if firm > self.wanted { c.slip_rate } else { c.squeeze_rate };
        let missing = shared.max(firm) - self.wanted;
        self.wanted += missing.clamp(-c.squeeze_rate * dt, fastest * dt);
        let closing = (c.gain * (self.wanted - forces.squeeze)).clamp(-c.fastest, c.fastest);
        let along_sides = load_from_root * forces.internal - line * forces.squeeze;
        let along = self.beyond[0] - line * self.beyond[0].dot(&line);
        let moment = load_from_root * forces.moment;
        let rates = [
            line * closing - (along_sides * c.compliance + along) / c.yield_time,
            -(moment * c.turning_compliance + self.beyond[1]) / c.yield_time,
        ];
        for (beyond, rate) in self.beyond.iter_mut().zip(&rates) {
            *beyond += rate * dt;
        }
        let pressed = forces.hands[0].0.min(forces.hands[1].0);
        let loose = self.holding == Holding::Pressing && pressed < c.lost_share * self.wanted;
        self.unpressed = if loose { self.unpressed + dt } else { 0.0 };
        let status = match (self.unpressed > c.lost_after, self.slips > c.slips_after) {
            (true, _) => LoadStatus::Lost,
            (false, true) => LoadStatus::Slips,
            (false, false) => LoadStatus::Held,
        };
        let goal = |hand: usize, sign: f64| self.goal(&loads[hand], hand, sign, &rates);
        Ok(SharedLoadStep { hands: [goal(0, 1.0), goal(1, -1.0)], forces, wanted: self.wanted, status })
    }

    /// Where one hand goes: with the load, and `sign` times beyond that.
    fn goal(&self, load: &LinePoint, hand: usize, sign: f64, rates: &[Vector3<f64>; 2]) -> LinePoint {
        let contact = self.contacts[hand].coords;
        let turned = UnitQuaternion::from_scaled_axis(self.beyond[1] * sign);
        let about_contact = Translation3::from(contact + self.beyond[0] * sign)
            * Isometry3::from_parts(Translation3::identity(), turned)
            * Translation3::from(-contact);
        let pose = load.pose * about_contact * self.load_from_tcp[hand];
        let in_root = |v: &Vector3<f64>| load.pose.rotation * v * sign;
        let (linear, angular) = (in_root(&rates[0]), in_root(&rates[1]));
        let from_load = pose.translation.vector - load.pose.translation.vector;
        let from_contact = from_load - load.pose.rotation * contact;
        LinePoint {
            pose,
            linear: load.linear + load.angular.cross(&from_load) + linear + angular.cross(&from_contact),
            angular: load.angular + angular,
        }
    }
}

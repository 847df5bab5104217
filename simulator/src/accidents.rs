//! What happens to things, to the robot's hand and to its arm in a run, by nobody's plan: knocks, pushes, somebody who takes a thing elsewhere, and things
//! that get slippery.
//!
//! It computes forces and frictions; the physics does with them what follows.

use nalgebra::Vector3;

use crate::physics::{DT, External, Plant};
use crate::world::{ARM, Disturbance, WorldEvent};

/// How stiffly somebody holds what he takes elsewhere, 1/s, and how his hand is damped, over the critical one.
const HOLDS: f64 = 40.0;
const DAMPED: f64 = 1.0;

/// What a disturbance happens to.
#[derive(Clone, Copy, Debug)]
enum Knocked {
    Hand,
    Arm,
    /// A body, by its index.
    Body(usize),
}

/// The disturbances of a world, and how far each is.
#[derive(Debug)]
pub(crate) struct Accidents {
    all: Vec<Accident>,
}

#[derive(Debug)]
struct Accident {
    what: Disturbance,
    /// What it happens to.
    to: Knocked,
    /// Where that was when somebody took it, and where it was a step ago, root frame, m.
    taken: Option<[Vector3<f64>; 2]>,
}

impl Accidents {
    /// Those of a world whose bodies have these names.
    pub(crate) fn new(disturbances: &[Disturbance], names: &[String]) -> Self {
        let to = |what: &Disturbance| match names.iter().position(|name| *name == what.knock) {
            Some(body) => Knocked::Body(body),
            None if what.knock == ARM => Knocked::Arm,
            None => Knocked::Hand,
        };
        let accident = |what: &Disturbance| Accident { to: to(what), what: what.clone(), taken: None };
        Self { all: disturbances.iter().map(accident).collect() }
    }

    /// Adds the forces and frictions of a step at `t` s; `begun` says when that from which a disturbance counts was, s.
    pub(crate) fn add(
        &mut self,
        t: f64,
        begun: impl Fn(WorldEvent) -> Option<f64>,
        plant: &Plant,
        external: &mut External,
    ) {
        for accident in &mut self.all {
            let Some(age) = begun(accident.what.after).map(|begun| t - begun - accident.what.at) else {
                continue;
            };
            if !(0.0..accident.what.duration).contains(&age) {
                continue;
            }
            match accident.to {
                Knocked::Hand => external.hand += accident.what.force_at(age),
                Knocked::Arm => external.arm += accident.what.force_at(age),
                Knocked::Body(body) => {
                    if let Some(friction) = accident.what.slippery {
                        external.slippery.push((body, friction));
                        continue;
                    }
                    let found = plant.object(body).zip(plant.mass(body));
                    let (at, mass) =
                        found.map_or_else(Default::default, |(pose, mass)| (pose.translation.vector, mass));
                    external.objects[body] += accident.on_body(age, at, mass);
                }
            }
        }
    }
}

impl Accident {
    /// The force on a body of `mass` kg that is at `at` (root frame, m), `age` s after it began.
    fn on_body(&mut self, age: f64, at: Vector3<f64>, mass: f64) -> Vector3<f64> {
        let Some(by) = self.what.by.map(Vector3::from) else { return self.what.force_at(age) };
        let [from, before] = self.taken.get_or_insert([at; 2]);
        let velocity = (at - *before) / DT;
        *before = at;
        let share = age / self.what.duration;
        // With the least jerk, from rest to rest.
        let way = share.powi(3) * (10.0 - 15.0 * share + 6.0 * share * share);
        let speed = 30.0 * share.powi(2) * (1.0 - share).powi(2) / self.what.duration;
        let pull = (*from + by * way - at) * HOLDS + (by * speed - velocity) * 2.0 * DAMPED;
        (pull * HOLDS * mass).cap_magnitude(Vector3::from(self.what.force).norm())
    }
}

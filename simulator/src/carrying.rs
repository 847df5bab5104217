//! Both arms and a box between their hands, with soft pads on them: a world of the [physics](crate::physics), the robot's
//! sensors, and a referee that alone knows the truth.
//!
//! A scene for experiments that are stepped by hand, one millisecond at a time. It has no clock, guard, coach or
//! camera. The robot senses its joints, and at each palm the force and torque between hand and pad, with noise and
//! offset.

use std::sync::Arc;

use armarium_robot::Model;
use nalgebra::{Isometry3, Vector3};
use parking_lot::{Mutex, MutexGuard};
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, StandardNormal};

use crate::error::PlantError;
use crate::physics::pad::PadReaction;
use crate::physics::{DT, External, Plant};
use crate::start::{MountedPad, RobotErrors, RobotStart};
use crate::world::{BodySpec, NoiseSpec, Place, TableSpec, World};

/// A pair of values, right and left.
pub type Sides<T> = [T; 2];

/// The box, what it stands on, and the hands' pads.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CarriedBox {
    /// Mass, kg.
    pub mass: f64,
    /// Width (x, between the hands), depth (y) and height (z), m.
    pub size: [f64; 3],
    /// Where its middle is at the start, root frame, m. The table ends under it.
    pub at: [f64; 3],
    /// The pads on the hands, right and left.
    pub pads: Sides<MountedPad>,
}

impl CarriedBox {
    /// The world with this box on its table.
    fn world(&self) -> World {
        let [x, y, z] = self.at;
        let table = TableSpec {
            height: z - self.size[2] / 2.0,
            center: [x, y + 0.8],
            size: [2.0, 2.0],
            tilt_deg: [0.0; 2],
            bumps: Vec::new(),
            friction: FRICTION,
            ..TableSpec::default()
        };
        let carried = BodySpec {
            name: "box".into(),
            size: self.size,
            mass: self.mass,
            friction: FRICTION,
            at: Place::At(self.at),
            ..BodySpec::default()
        };
        World { table, objects: Vec::new(), bodies: vec![carried], ..World::ideal() }
    }
}

/// Friction of box on table.
const FRICTION: f64 = 0.4;

/// The sensor values of one palm: force (N) and torque about the TCP (N m) of the box on the hand, root frame, with
/// the sensor's noise and offset.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PalmSensed {
    /// Force, N.
    pub force: Vector3<f64>,
    /// Torque about the TCP, N m.
    pub torque: Vector3<f64>,
}

/// The true state at one millisecond.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CarryingRecord {
    /// Poses of the TCPs, right and left.
    pub tcps: Sides<Isometry3<f64>>,
    /// Pose of the box's middle.
    pub carried: Isometry3<f64>,
    /// Forces of the box on the hands.
    pub reactions: Sides<PadReaction>,
}

impl CarryingRecord {
    /// Vector from the right TCP to the left one, root frame, m.
    pub fn apart(&self) -> Vector3<f64> {
        self.tcps[1].translation.vector - self.tcps[0].translation.vector
    }

    /// The force with which the left hand presses on the box against the right one, N, root frame: half the
    /// difference of both hands' forces. It excludes the box's weight and inertia, which both hands share.
    pub fn internal_force(&self) -> Vector3<f64> {
        (self.reactions[0].force - self.reactions[1].force) / 2.0
    }
}

/// The referee's figures over a stretch of time, relative to its first entry.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct CarryingFigures {
    /// RMS deviation of the vector between the hands from its initial value, m.
    pub distance_rms_m: f64,
    /// RMS deviation of the force between the hands from its initial value, N.
    pub force_rms_n: f64,
    /// The largest tilt of the box, rad.
    pub tilt_rad: f64,
    /// How far the box has slipped in the right hand by the end, m.
    pub slipped_m: f64,
    /// Share of the time in which both hands pressed on the box.
    pub held: f64,
}

/// The referee; clones share the same log. It tells the robot nothing.
#[derive(Clone, Debug, Default)]
pub struct CarryingReferee {
    log: Arc<Mutex<Vec<CarryingRecord>>>,
}

impl CarryingReferee {
    fn lock(&self) -> MutexGuard<'_, Vec<CarryingRecord>> {
        self.log.lock()
    }

    /// Number of logged milliseconds.
    pub fn len(&self) -> usize {
        self.lock().len()
    }

    /// Whether nothing has been logged yet.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// A copy of the log, for plots: one entry per millisecond.
    pub fn log(&self) -> Vec<CarryingRecord> {
        self.lock().clone()
    }

    /// The figures from millisecond `from` to the end; `None` if nothing was logged there.
    pub fn judge(&self, from: usize) -> Option<CarryingFigures> {
        self.lock().get(from..).and_then(figures)
    }
}

/// The figures of a log, relative to its first entry.
pub fn figures(log: &[CarryingRecord]) -> Option<CarryingFigures> {
    let (first, last) = (log.first()?, log.last()?);
    let mean = |of: &dyn Fn(&CarryingRecord) -> f64| log.iter().map(of).sum::<f64>() / log.len() as f64;
    let in_hand = |r: &CarryingRecord| (r.tcps[0].inverse() * r.carried).translation.vector;
    let tilt = |r: &CarryingRecord| r.carried.rotation.angle_to(&first.carried.rotation);
    let held = |r: &CarryingRecord| f64::from(u8::from(r.reactions.iter().all(|p| p.normal > 0.0)));
    Some(CarryingFigures {
        distance_rms_m: mean(&|r| (r.apart() - first.apart()).norm_squared()).sqrt(),
        force_rms_n: mean(&|r| (r.internal_force() - first.internal_force()).norm_squared()).sqrt(),
        tilt_rad: log.iter().map(tilt).fold(0.0, f64::max),
        slipped_m: (in_hand(last) - in_hand(first)).norm(),
        held: mean(&held),
    })
}

/// The scene.
pub struct Carrying {
    plant: Plant,
    noise: NoiseSpec,
    offset: Sides<PalmSensed>,
    sensed: Sides<PalmSensed>,
    rng: ChaCha8Rng,
    referee: CarryingReferee,
}

impl Carrying {
    /// Builds the scene with the robot in the posture `start` (all the model's joints, rad or m) and the box on its
    /// table. `seed` determines the noise.
    ///
    /// # Errors
    /// [`PlantError`] when the robot lacks an arm or a TCP.
    pub fn new(
        model: &Arc<Model>,
        carried: &CarriedBox,
        noise: &NoiseSpec,
        start: &[f64],
        seed: u64,
    ) -> Result<Self, PlantError> {
        let arm = model.arms().next().map_or_else(String::new, |limb| limb.name.clone());
        let robot = RobotStart {
            name: model.name().to_owned(),
            model: Arc::clone(model),
            arm,
            room_from_root: Isometry3::identity(),
            position: start.to_vec(),
            errors: RobotErrors::none(start.len()),
            pads: carried.pads.to_vec(),
        };
        if model.arms().count() < 2 {
            return Err(PlantError::Missing { what: "second arm".into() });
        }
        let plant = Plant::new(&carried.world(), vec![robot])?;
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let offset = [(); 2].map(|()| drawn(noise.wrench_bias, &mut rng));
        let referee = CarryingReferee::default();
        let mut scene = Self { plant, noise: noise.clone(), offset, sensed: offset, rng, referee };
        scene.sense();
        Ok(scene)
    }

    /// Sensed joint positions, rad or m.
    pub fn position(&self) -> &[f64] {
        self.plant.position(0)
    }

    /// Sensed joint velocities, rad/s or m/s.
    pub fn velocity(&self) -> &[f64] {
        self.plant.velocity(0)
    }

    /// The sensor values of the palms, right and left.
    pub fn palms(&self) -> &Sides<PalmSensed> {
        &self.sensed
    }

    /// The referee of this scene.
    pub fn referee(&self) -> CarryingReferee {
        self.referee.clone()
    }

    /// Advances by one millisecond. The joints are driven to `position` with `velocity`, for all joints of the
    /// model.
    pub fn step(&mut self, position: &[f64], velocity: &[f64]) {
        self.plant.step(&[(position, velocity)], &External::default());
        self.sense();
        let (tcps, reactions) = (pair(self.plant.tcps(0)), pair(self.plant.pads(0)));
        let carried = self.plant.object(0).unwrap_or_default();
        self.referee.lock().push(CarryingRecord { tcps, carried, reactions });
    }

    /// Length of a step, s.
    pub const DT: f64 = DT;

    fn sense(&mut self) {
        let reactions: Sides<PadReaction> = pair(self.plant.pads(0));
        for ((sensed, offset), truth) in self.sensed.iter_mut().zip(&self.offset).zip(&reactions) {
            let noise = drawn(self.noise.wrench, &mut self.rng);
            sensed.force = truth.force + offset.force + noise.force;
            sensed.torque = truth.torque + offset.torque + noise.torque;
        }
    }
}

/// The first two of a list.
fn pair<T: Default>(mut all: impl Iterator<Item = T>) -> Sides<T> {
    [(); 2].map(|()| all.next().unwrap_or_default())
}

/// A random force with standard deviation `deviation` on each axis, N, and a torque with a twentieth of it, N m.
fn drawn(deviation: f64, rng: &mut ChaCha8Rng) -> PalmSensed {
    let mut vector = |scale: f64| {
        Vector3::from_fn(|_, _| {
            let normal: f64 = StandardNormal.sample(&mut *rng);
            scale * normal
        })
    };
    PalmSensed { force: vector(deviation), torque: vector(deviation / 20.0) }
}

//! Cameras in another process than the world: the world sends the state of the scene, and the cameras draw it.
//!
//! The world sends a [`Scenery`]; [`DistantCameras`] draw it. Both sides must use the same world and seed. The
//! images are then identical, bit for bit, to those of cameras in the world's process. The referee renders its own
//! images.

use std::collections::BTreeMap;
use std::sync::Arc;

use armarium_visionx::{StereoCalibration, StereoFrame};
use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};

use super::{Drawing, Eyes, Moment, RobotJoints, SceneState};
use crate::coach::{CoachState, HandShown};
use crate::error::SimulationError;
use crate::render::ShadowedScene;
use crate::start;
use crate::table::{DirtGrid, TableTop};
use crate::world::{Gesture, World};

/// The state of the scene at one frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Scenery {
    /// The world's name and the run's seed.
    pub world: (String, u64),
    /// Number of the frame; counts all frames that were due, drawn or not.
    pub frame: u64,
    /// Time of the exposure, ns.
    pub exposed_ns: u64,
    /// Where everything was shortly before; without it, nothing is blurred.
    #[serde(default)]
    pub before: Option<Moment>,
    /// True joint positions of the robot whose cameras they are, rad (m), in the model's order.
    pub true_position: Vec<f64>,
    /// Joint positions as it senses them.
    pub sensed_position: Vec<f64>,
    /// True joint positions of the world's other robots, in its order.
    #[serde(default)]
    pub others: Vec<Vec<f64>>,
    /// Poses of the bodies, in the world's order, root frame.
    pub objects: Vec<Isometry3<f64>>,
    /// Poses of the parts of all people.
    #[serde(default)]
    pub people: Vec<Vec<Isometry3<f64>>>,
    /// Pose of the coach's tool while it is shown.
    pub tool: Option<Isometry3<f64>>,
    /// Pose and gesture of the coach's hand while it is shown.
    pub hand: Option<(Isometry3<f64>, Gesture)>,
    /// Indices of the table's cells that have been wiped.
    pub wiped: Vec<u32>,
}

/// Receives sceneries; it must not block.
pub trait ScenerySink: Send {
    /// Whether a frame is wanted now.
    fn is_wanted(&self) -> bool;
    /// Receives a scenery.
    fn show(&mut self, scenery: Scenery);
}

/// Why a scenery cannot be drawn.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum SceneryError {
    /// It belongs to another world or another seed.
    #[error(
        "what there is to see is of the world `{name}` with seed {seed}; the cameras have `{own_name}` with seed {own_seed}"
    )]
    World {
        /// The world that the scenery belongs to.
        name: String,
        /// Its seed.
        seed: u64,
        /// The cameras' world.
        own_name: String,
        /// Its seed.
        own_seed: u64,
    },
    /// The number of joints or objects does not match, or a number is not finite.
    #[error("what there is to see does not fit the robot and the world's objects")]
    Shape,
}

/// The cameras of a world that is in another process.
pub struct DistantCameras {
    eyes: Eyes,
    drawing: Drawing,
    frame: String,
    world: (String, u64),
    wiped: DirtGrid,
    /// The bodies' names, and where they are at the start, in the world's order.
    bodies: Vec<(String, Isometry3<f64>)>,
}

/// Where people are who are not to be seen, root frame, m.
const OUT_OF_SIGHT: f64 = -100.0;

impl Scenery {
    pub(crate) fn of(view: &SceneState<'_>, world: &(String, u64), frame: u64) -> Self {
        let wiped = view.wiped.cells().iter().zip(0u32..).filter(|(wiped, _)| **wiped);
        Self {
            world: world.clone(),
            frame,
            exposed_ns: view.exposed_ns,
            before: view.before.cloned(),
            true_position: view.robots[0].truth.to_vec(),
            sensed_position: view.robots[0].sensed.to_vec(),
            others: view.robots[1..].iter().map(|robot| robot.truth.to_vec()).collect(),
            objects: view.objects.to_vec(),
            people: view.people.to_vec(),
            tool: view.coach.tool,
            hand: view.coach.hand.map(|hand| (hand.root_from_hand, hand.gesture)),
            wiped: wiped.map(|(_, cell)| cell).collect(),
        }
    }
}

impl DistantCameras {
    /// The cameras of a world.
    ///
    /// # Errors
    /// [`SimulationError::Camera`] when the robot has none, [`SimulationError::Robot`] when it cannot be used.
    pub fn new(world: &World, seed: u64) -> Result<Self, SimulationError> {
        let robots = start::robots(world, seed, None)?;
        let table = TableTop::new(&world.table);
        let model = &robots[0].model;
        if model.camera().is_none() {
            return Err(SimulationError::Camera);
        }
        Ok(Self {
            eyes: Eyes::new(world, 0, &robots[0], seed),
            drawing: Drawing::new(world, &robots, &table, seed),
            frame: model.camera_frame().to_owned(),
            world: (world.name.clone(), seed),
            wiped: DirtGrid::new(&table),
            bodies: start::bodies(world, &table)
                .into_iter()
                .map(|b| (b.spec.name, b.room_from_body))
                .collect(),
        })
    }

    /// The names of the world's bodies.
    pub fn bodies(&self) -> impl Iterator<Item = &str> {
        self.bodies.iter().map(|(name, _)| name.as_str())
    }

    /// The scene as another physics engine tells it: the robot's joints, rad (m), in the model's order, and where bodies are, by their
    /// names, root frame. Bodies of which nothing is told are where the world puts them; people and the coach are not there.
    pub fn told(
        &self,
        (frame, stamp_ns): (u64, u64),
        position: &[f64],
        bodies: &BTreeMap<String, Isometry3<f64>>,
    ) -> Scenery {
        let at = |(name, start): &(String, Isometry3<f64>)| bodies.get(name).copied().unwrap_or(*start);
        let away = Isometry3::translation(0.0, 0.0, OUT_OF_SIGHT);
        Scenery {
            world: self.world.clone(),
            frame,
            exposed_ns: stamp_ns,
            before: None,
            true_position: position.to_vec(),
            sensed_position: position.to_vec(),
            others: Vec::new(),
            objects: self.bodies.iter().map(at).collect(),
            people: self.drawing.people().map(|parts| vec![away; parts]).collect(),
            tool: None,
            hand: None,
            wiped: Vec::new(),
        }
    }

    /// The name of the image source.
    pub fn name() -> &'static str {
        super::SimulatedCameras::NAME
    }

    /// The left camera's frame.
    pub fn frame(&self) -> &str {
        &self.frame
    }

    /// Intrinsics and extrinsics.
    pub fn calibration(&self) -> StereoCalibration {
        self.eyes.rig.source.calibration
    }

    /// Draws a scenery, with the sensors' noise and faults.
    ///
    /// # Errors
    /// [`SceneryError`] when it does not fit these cameras' world.
    pub fn draw(&mut self, scenery: &Scenery) -> Result<StereoFrame, SceneryError> {
        if scenery.world != self.world {
            let ((name, seed), (own_name, own_seed)) = (scenery.world.clone(), self.world.clone());
            return Err(SceneryError::World { name, seed, own_name, own_seed });
        }
        let truths = || [&scenery.true_position].into_iter().chain(&scenery.others);
        let fits = |q: &Vec<f64>, joints: usize| q.len() == joints && q.iter().all(|v| v.is_finite());
        let joints = truths().count() == self.drawing.joints().count()
            && truths().zip(self.drawing.joints()).all(|(q, joints)| fits(q, joints))
            && fits(&scenery.sensed_position, scenery.true_position.len());
        let poses = (scenery.objects.iter().chain(scenery.people.iter().flatten()))
            .chain(&scenery.tool)
            .chain(scenery.hand.iter().map(|(pose, _)| pose));
        let finite = poses.copied().all(|pose| pose.to_homogeneous().iter().all(|v| v.is_finite()));
        let people = scenery.people.iter().map(Vec::len).eq(self.drawing.people());
        let then = scenery.before.as_ref().is_none_or(|before| {
            let robots = before.robots.iter().zip(self.drawing.joints());
            before.robots.len() == self.drawing.joints().count()
                && robots.into_iter().all(|(q, joints)| fits(q, joints))
                && before.objects.len() == scenery.objects.len()
                && before.people.iter().map(Vec::len).eq(self.drawing.people())
        });
        if !joints || !then || !finite || !people || scenery.objects.len() != self.drawing.bodies() {
            return Err(SceneryError::Shape);
        }
        self.wiped.mark_cells(&scenery.wiped);
        let hand = scenery.hand.map(|(root_from_hand, gesture)| HandShown {
            root_from_hand,
            gesture,
            shown_s: 0.0,
            in_place: false,
        });
        let coach = CoachState { tool: scenery.tool, hand, ..CoachState::default() };
        self.eyes.rig.next_frame = scenery.frame;
        let own = RobotJoints { truth: &scenery.true_position, sensed: &scenery.sensed_position };
        let others = scenery.others.iter().map(|truth| RobotJoints { truth, sensed: truth });
        let robots: Vec<_> = [own].into_iter().chain(others).collect();
        let view = SceneState {
            exposed_ns: scenery.exposed_ns,
            before: scenery.before.as_ref(),
            robots: &robots,
            objects: &scenery.objects,
            people: &scenery.people,
            coach: &coach,
            without_hand_s: 0.0,
            wiped: &self.wiped,
        };
        let seen = Arc::new(ShadowedScene::new(self.drawing.scene(&view)));
        let (drawn, _) = self.eyes.paint(&self.drawing, &seen, &view);
        Ok(self.eyes.sensed(&view, drawn))
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use parking_lot::Mutex;

    use super::*;
    use crate::simulation::{Options, Simulation};

    struct CollectedSceneries(Arc<Mutex<Vec<Scenery>>>);

    impl ScenerySink for CollectedSceneries {
        fn is_wanted(&self) -> bool {
            true
        }

        fn show(&mut self, scenery: Scenery) {
            self.0.lock().push(scenery);
        }
    }

    #[tokio::test(start_paused = true)]
    async fn distant_cameras_see_what_near_ones_see_to_the_last_bit() {
        let world = World::default();
        let kept = Arc::new(Mutex::new(Vec::new()));
        let options =
            Options { scenery: Some(Box::new(CollectedSceneries(Arc::clone(&kept)))), ..Options::default() };
        let mut distant = Simulation::new(&world, 5, options).unwrap();
        (0..300).for_each(|_| distant.step());
        let shown = kept.lock().pop().unwrap();

        let near = Simulation::new(&world, 5, Options::default()).unwrap();
        let (images, handle) = (near.images(), near.handle());
        let running = tokio::spawn(near.run());
        let seen = loop {
            let frame = images.next().await.unwrap();
            if frame.stamp_ns.abs_diff(shown.exposed_ns) < 20_000_000 {
                break frame;
            }
            assert!(frame.stamp_ns < shown.exposed_ns);
        };
        handle.stop();
        running.await.unwrap();
        let mut cameras = DistantCameras::new(&world, 5).unwrap();
        assert!(*seen == cameras.draw(&shown).unwrap());

        let other = Scenery { world: ("elsewhere".into(), 5), ..shown.clone() };
        assert!(matches!(cameras.draw(&other), Err(SceneryError::World { .. })));
        let short = Scenery { true_position: vec![0.0], ..shown.clone() };
        assert_eq!(cameras.draw(&short), Err(SceneryError::Shape));
        let moment = shown.before.clone().map(|before| Moment { objects: Vec::new(), ..before });
        let short = Scenery { before: moment, ..shown.clone() };
        assert_eq!(cameras.draw(&short), Err(SceneryError::Shape));
        let wild = Scenery { wiped: vec![u32::MAX], ..shown };
        assert!(cameras.draw(&wild).is_ok());
    }
}

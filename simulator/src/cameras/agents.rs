//! The cameras of other agents: fixed stereo pairs like the robot's, each in its agent's own root frame.
//!
//! They see the same scene as the robot. A frame is drawn only when it is due and a reader waits for it.

use std::sync::Arc;

use armarium_visionx::StereoCalibration;
use nalgebra::Isometry3;
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

use super::{SimulatedCameras, StereoRendering, StereoRig};
use crate::render::{ExposureMotion, SensorNoise, ShadowedScene};
use crate::world::{AgentSpec, CameraSpec};

/// The stereo pair of one agent.
pub(crate) struct AgentEyes {
    name: String,
    rig: StereoRig,
    scene_from_left: Isometry3<f64>,
    agent_from_left: Isometry3<f64>,
}

impl AgentEyes {
    /// Its errors are those of the robot's cameras, and arrive as late; `seed` determines them.
    pub(crate) fn new(
        agent: &AgentSpec,
        calibration: StereoCalibration,
        spec: &CameraSpec,
        seed: u64,
    ) -> Self {
        let scene_from_left = agent.root_from_left(calibration.baseline);
        let noise = SensorNoise::new(spec.noise, seed);
        let rng = ChaCha8Rng::seed_from_u64(seed);
        Self {
            name: agent.name.clone(),
            rig: StereoRig::new(&agent.name, calibration, spec, (agent.rate, noise), rng),
            scene_from_left,
            agent_from_left: agent.root_from_agent().inverse() * scene_from_left,
        }
    }

    pub(crate) fn name(&self) -> &str {
        &self.name
    }

    pub(crate) fn source(&self) -> &Arc<SimulatedCameras> {
        &self.rig.source
    }

    /// Whether a frame is due at `t` s and a reader waits for it.
    pub(crate) fn due(&mut self, t: f64) -> bool {
        self.rig.is_due(t) && self.rig.source.wanted()
    }

    /// Whether a frame will be due at `t` s.
    pub(crate) fn will_be_due(&self, t: f64) -> bool {
        self.rig.will_be_due(t)
    }

    /// Publishes the frames that have arrived by `now_ns`.
    pub(crate) fn deliver(&mut self, now_ns: u64) {
        self.rig.deliver(now_ns);
    }

    /// Draws a frame of a scene and publishes it.
    pub(crate) fn draw(&mut self, scene: &Arc<ShadowedScene>, exposed_ns: u64) {
        let eyes = self.rig.left_and_right((self.scene_from_left, ExposureMotion::default()));
        let frame = self.rig.sensed(StereoRendering::of(scene, eyes), exposed_ns, self.agent_from_left);
        self.rig.send(exposed_ns, frame);
        self.deliver(exposed_ns);
    }
}

#[cfg(test)]
mod tests {
    use armarium_visionx::{ColorModel, ObjectLocalizer, components};
    use std::path::Path;

    use crate::simulation::{Options, Simulation};
    use crate::world::World;

    #[tokio::test(start_paused = true)]
    async fn what_the_shelf_hides_from_the_robot_alice_sees_in_her_own_frame() {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../statecharts/share_scene.world.yaml");
        let world = World::load(&file, 1).unwrap();
        let simulation = Simulation::new(&world, 1, Options::default()).unwrap();
        let (own, others, handle) = (simulation.images(), simulation.agents(), simulation.handle());
        let (name, eyes) = &others[0];
        assert_eq!((others.len(), name.as_str(), eyes.name()), (1, "alice", "alice"));
        let running = tokio::spawn(simulation.run());
        let (robots, alices) = tokio::join!(own.next(), eyes.next());
        handle.stop();
        running.await.unwrap();
        let (robots, alices) = (robots.unwrap(), alices.unwrap());

        let sponge = &world.objects[world.first_object().unwrap()];
        let color = ColorModel::from_rgb(sponge.color);
        assert!(components(&color.segment(&robots.left), 20).is_empty(), "the robot sees the sponge");
        let localizer = ObjectLocalizer::new(eyes.calibration(), sponge.size, sponge.color);
        let seen = localizer.localize(&alices).unwrap();
        let place = (world.agents[0].root_from_agent() * seen.root_from_object).translation;
        let off = libm::hypot(place.x - sponge.at[0], place.y - sponge.at[1]);
        assert!(off < 0.015, "{place:?} is {off} m off");
    }
}

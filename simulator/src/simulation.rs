//! The whole simulator: each step of one millisecond does sensing, guard, physics, coach and cameras.
//!
//! [`Simulation::new`] builds a world; [`Simulation::run`] steps it by tokio's clock until its [`Handle`] stops it:
//! under a paused clock as fast as possible, else in real time. Spawn it on a current-thread runtime beside the
//! program. [`Simulation::step`] is for tests and benches that need no clock.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use armarium_robot::{Guard, GuardConfig, JointTargets, Kinematics, Limb, LinkId, Model, Robot, Sample};
use armarium_visionx::ImageSource;
use nalgebra::{Isometry3, Point3, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::accidents::Accidents;
use crate::cameras::{
    AgentEyes, Drawing, Eyes, Moment, RobotJoints, SceneShapes, SceneState, Scenery, ScenerySink,
    SimulatedCameras,
};
use crate::coach::{Coach, SeenArm};
use crate::error::SimulationError;
use crate::figure;
use crate::person::Person;
use crate::physics::{External, Plant};
use crate::referee::Referee;
use crate::render::ShadowedScene;
use crate::sensing::RobotSensors;
use crate::start;
use crate::table::DirtGrid;
use crate::table::WIPE_EVERY;
use crate::truth::{TrueReach, TruthEvent, TruthSample, TruthSink};
use crate::world::{World, WorldEvent};

/// One step, ns.
const STEP_NS: u64 = 1_000_000;
/// One step, as a duration.
const STEP: Duration = Duration::from_nanos(STEP_NS);
/// A delay longer than this is not caught up: otherwise the guard would take the silence of the commanders for
/// their end.
const MAX_DELAY: Duration = Duration::from_millis(10);

/// The distances between people and robots are looked at every so many steps.
const LOOKED_AT_EVERY: u64 = 20;

/// Options besides world and seed.
#[derive(Default)]
pub struct Options {
    /// Further receivers of the truth.
    pub truth_sinks: Vec<Box<dyn TruthSink>>,
    /// Joint positions at the start, rad (m), in the model's order; by default the robot's own start with the arm that
    /// works.
    pub start: Option<Vec<f64>>,
    /// The guard's limits; by default the robot's.
    pub guard: Option<GuardConfig>,
    /// Receiver of the scenery for cameras in another process; the cameras here then give no frames.
    pub scenery: Option<Box<dyn ScenerySink>>,
}

/// Stops a simulation and reads its time; clones are the same handle.
#[derive(Clone, Debug, Default)]
pub struct Handle {
    shared: Arc<HandleState>,
}

#[derive(Debug, Default)]
struct HandleState {
    stop: AtomicBool,
    now_ns: AtomicU64,
}

impl Handle {
    /// Requests the simulation to end with its next step.
    pub fn stop(&self) {
        self.shared.stop.store(true, Ordering::Relaxed);
    }

    /// Simulated time since the robot's start, ns.
    pub fn now_ns(&self) -> u64 {
        self.shared.now_ns.load(Ordering::Relaxed)
    }

    /// Says what time it is, for a world that is not simulated here. Returns whether that goes on: false after
    /// [`stop`](Self::stop).
    pub fn advance(&self, now_ns: u64) -> bool {
        self.shared.now_ns.store(now_ns, Ordering::Relaxed);
        !self.shared.stop.load(Ordering::Relaxed)
    }
}

/// A robot of the world, as skills see it.
#[derive(Clone)]
pub struct RobotInWorld {
    /// Its name.
    pub name: String,
    /// The robot, behind its own guard.
    pub robot: Arc<dyn Robot>,
    /// The cameras on its head.
    pub images: Arc<dyn ImageSource>,
}

/// A robot of the world, with what belongs to it.
struct GuardedRobot {
    name: String,
    robot: Arc<dyn Robot>,
    guard: Guard,
    sensors: RobotSensors,
    eyes: Eyes,
    sample: Sample,
    /// What the joints' sensors show beyond what is true, rad (m).
    zeros: Vec<f64>,
    /// Where the motors are, as sensors without noise show it, rad (m).
    measured: Vec<f64>,
    targets: JointTargets,
    /// The set points of the true joints: the targets without the zeros' errors.
    true_targets: Vec<f64>,
}

/// A simulated world.
pub struct Simulation {
    /// The robots; the first is the one that the referee judges.
    robots: Vec<GuardedRobot>,
    plant: Plant,
    /// True poses of the first robot's links: the wrist and elbow of the arm that works, which the coach sees.
    kinematics: Kinematics,
    arm: [LinkId; 2],
    coach: Coach,
    people: Vec<Person>,
    drawing: Drawing,
    /// Where everything was in the step before a frame.
    before: Option<Moment>,
    agents: Vec<AgentEyes>,
    referee: Referee,
    sinks: Vec<Box<dyn TruthSink>>,
    scenery: Option<Box<dyn ScenerySink>>,
    world: (String, u64),
    handle: Handle,
    accidents: Accidents,
    object_names: Vec<String>,
    /// The object in question, see [`TruthSample::object`].
    object: Option<usize>,
    grasped_at: Option<f64>,
    wiping_at: Option<f64>,
    hand_gone_at: f64,
    steps: u64,
    external: External,
    dirt: DirtGrid,
    truth: TruthSample,
}

impl Simulation {
    /// Builds a world; `seed` determines everything random.
    ///
    /// # Errors
    /// [`SimulationError`] when a robot does not fit the world.
    pub fn new(world: &World, seed: u64, options: Options) -> Result<Self, SimulationError> {
        let starts = start::robots(world, seed, options.start)?;
        let model = Arc::clone(&starts[0].model);
        let arm = world.robot.arm(&model).ok_or(SimulationError::Arm)?;
        let stream = |n: u64| {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            rng.set_stream(n);
            rng
        };
        let plant = Plant::new(world, starts.clone())?;
        let mut drawing = Drawing::new(world, &starts, plant.table(), seed);
        drawing.update(&[RobotJoints { truth: &starts[0].true_position(), sensed: &starts[0].position }]);
        let camera = drawing.links(0, model.camera().map(|camera| camera.left))[1].translation.vector.into();
        let mut limits = options.guard;
        let mut robots = Vec::new();
        for ((i, start), spec) in
            starts.iter().enumerate().zip([&world.robot].into_iter().chain(&world.robots))
        {
            let model = &start.model;
            let limits = limits.take().unwrap_or_else(|| GuardConfig::of(model));
            let (guard, robot) = Guard::new(Arc::clone(model), limits);
            let arm = spec.arm(model).ok_or(SimulationError::Arm)?;
            let first = 16 + 256 * i as u64;
            robots.push(GuardedRobot {
                name: start.name.clone(),
                robot,
                guard,
                sensors: RobotSensors::new(model, arm, (&spec.noise, &world.faults), |n| stream(first + n)),
                eyes: Eyes::new(world, i, start, seed),
                sample: Sample::resting(model, start.position.clone()),
                zeros: start.errors.zeros.clone(),
                measured: start.position.clone(),
                true_targets: start.true_position(),
                targets: JointTargets {
                    position: start.position.clone(),
                    velocity: vec![0.0; start.position.len()],
                },
            });
        }
        let calibration = robots[0].eyes.source().calibration();
        let agents = world.agents.iter().zip(1u64..).map(|(agent, n)| {
            let seed = seed.rotate_left(32) ^ n;
            AgentEyes::new(agent, calibration, &world.camera, seed)
        });
        let object_names: Vec<String> =
            start::bodies(world, plant.table()).into_iter().map(|body| body.spec.name).collect();
        let external =
            External { objects: vec![Vector3::zeros(); object_names.len()], ..External::default() };
        Ok(Self {
            kinematics: Kinematics::new(&model),
            arm: bends(&model, arm),
            coach: Coach::new(&world.coach, world.table.height, (camera, model.side_of(arm)), stream(2)),
            people: world.people().zip(0..).map(|(spec, n)| Person::new(spec, stream(4096 + n))).collect(),
            agents: agents.collect(),
            robots,
            drawing,
            before: None,
            referee: Referee::new(world),
            sinks: options.truth_sinks,
            scenery: options.scenery,
            world: (world.name.clone(), seed),
            handle: Handle::default(),
            accidents: Accidents::new(&world.disturbances, &object_names),
            object: world.first_object(),
            object_names,
            grasped_at: None,
            wiping_at: None,
            hand_gone_at: 0.0,
            steps: 0,
            external,
            dirt: DirtGrid::new(plant.table()),
            truth: TruthSample::default(),
            plant,
        })
    }

    /// The first robot, behind its guard.
    pub fn robot(&self) -> Arc<dyn Robot> {
        Arc::clone(&self.robots[0].robot)
    }

    /// All robots by their names, each behind its own guard and with its own cameras, in the world's order. Poses in the frames
    /// are in each robot's own root frame.
    pub fn robots(&self) -> Vec<RobotInWorld> {
        let one = |agent: &GuardedRobot| {
            let images: Arc<SimulatedCameras> = Arc::clone(agent.eyes.source());
            RobotInWorld { name: agent.name.clone(), robot: Arc::clone(&agent.robot), images }
        };
        self.robots.iter().map(one).collect()
    }

    /// The cameras on the first robot's head.
    pub fn images(&self) -> Arc<dyn ImageSource> {
        let source: Arc<SimulatedCameras> = Arc::clone(self.robots[0].eyes.source());
        source
    }

    /// The cameras of the world's other agents, by agent name: of those who only look on, and of the robots besides the first.
    /// Poses are in each agent's own root frame.
    pub fn agents(&self) -> Vec<(String, Arc<dyn ImageSource>)> {
        let eyes = |agent: &AgentEyes| {
            let source: Arc<SimulatedCameras> = Arc::clone(agent.source());
            (agent.name().to_owned(), source as Arc<dyn ImageSource>)
        };
        let robots = self.robots().into_iter().skip(1).map(|robot| (robot.name, robot.images));
        self.agents.iter().map(eyes).chain(robots).collect()
    }

    /// The referee of this run.
    pub fn referee(&self) -> Referee {
        self.referee.clone()
    }

    /// The shapes of what is not a robot, for viewers.
    pub fn shapes(&self) -> SceneShapes {
        self.drawing.shapes()
    }

    /// A handle to stop the simulation and to read its time.
    pub fn handle(&self) -> Handle {
        self.handle.clone()
    }

    /// The true state in the last step; for tests.
    pub fn truth(&self) -> &TruthSample {
        &self.truth
    }

    /// The wiped cells of the table.
    pub fn wiped(&self) -> &DirtGrid {
        &self.dirt
    }

    /// Steps once per millisecond of tokio's clock until the handle stops it; after that no more frames come. If
    /// real time is ahead, the steps are caught up, and the commanders run between them. A long delay is not caught
    /// up: simulated time then stays behind.
    pub async fn run(mut self) {
        let mut tick = tokio::time::interval(STEP);
        while !self.handle.shared.stop.load(Ordering::Relaxed) {
            let due = tick.tick().await;
            let late = due.elapsed();
            if late > MAX_DELAY {
                tick.reset();
            }
            if late > STEP {
                tokio::task::yield_now().await;
            }
            self.step();
        }
    }

    /// Simulated time, s.
    fn t(&self) -> f64 {
        self.steps as f64 * 1e-3
    }

    /// One millisecond.
    pub fn step(&mut self) {
        let stamp_ns = self.steps * STEP_NS;
        let t = self.t();
        self.pass_utterances_to_coach(stamp_ns, t);
        for (i, robot) in self.robots.iter_mut().enumerate() {
            let GuardedRobot { guard, sensors, sample, zeros, measured, targets, true_targets, .. } = robot;
            let plant = &self.plant;
            add(measured, plant.motors(i), zeros, 1.0);
            sensors.sense(t, measured, plant.velocity(i), plant.wrenches(i), sample);
            let next = guard.step(stamp_ns, sample);
            targets.position.copy_from_slice(&next.position);
            targets.velocity.copy_from_slice(&next.velocity);
            add(true_targets, &next.position, zeros, -1.0);
            sensors.slip(true_targets);
        }
        self.apply_external_forces(t);
        self.move_people(t);
        self.publish_truth(stamp_ns);
        self.draw_frames(stamp_ns, t);
        self.before = self.moment();
        self.robots.iter_mut().for_each(|robot| robot.eyes.deliver(stamp_ns));
        self.agents.iter_mut().for_each(|agent| agent.deliver(stamp_ns));
        if self.steps.is_multiple_of(WIPE_EVERY) {
            self.wipe();
        }
        let targets = self.robots.iter().map(|robot| (&robot.true_targets[..], &robot.targets.velocity[..]));
        self.plant.step(&targets.collect::<Vec<_>>(), &self.external);
        self.steps += 1;
        self.handle.shared.now_ns.store(self.steps * STEP_NS, Ordering::Relaxed);
    }

    fn event(&mut self, stamp_ns: u64, event: &TruthEvent) {
        self.referee.event(stamp_ns, event);
        for sink in &mut self.sinks {
            sink.event(stamp_ns, event);
        }
    }

    /// Passes the robot's utterances to the coach.
    fn pass_utterances_to_coach(&mut self, stamp_ns: u64, t: f64) {
        for utterance in self.robots[0].guard.take_utterances() {
            tracing::info!(utterance, "the robot says");
            self.coach.hear(&utterance, t);
            self.event(stamp_ns, &TruthEvent::Said { utterance });
        }
        if self.wiping_at.is_none() && self.coach.wiping_since().is_some() {
            self.wiping_at = Some(t);
            self.event(stamp_ns, &TruthEvent::Reached(WorldEvent::Wiping));
        }
    }

    /// Lets the people see the first robot's hands, and takes over what they want.
    fn move_people(&mut self, t: f64) {
        if self.people.is_empty() {
            return;
        }
        let hands: Vec<_> = self.plant.tcps(0).map(|tcp| tcp.translation.vector.into()).collect();
        let postures: Vec<_> = self.people.iter_mut().map(|person| person.step(t, 1e-3, &hands)).collect();
        self.plant.people_want(&postures);
    }

    /// Computes the external forces: the coach's and those of accidents.
    fn apply_external_forces(&mut self, t: f64) {
        let Self { coach, kinematics, plant, arm, .. } = self;
        let state = *coach.step(t, || seen_arm(kinematics, plant, *arm), 1e-3);
        if state.hand.is_some() {
            self.hand_gone_at = t;
        }
        self.truth.coach = state;
        (self.external.hand, self.external.arm) = (state.push, Vector3::zeros());
        self.external.objects.fill(Vector3::zeros());
        self.external.slippery.clear();
        let (grasped, wiping) = (self.grasped_at, self.wiping_at);
        let begun = |event: WorldEvent| match event {
            WorldEvent::Grasp => grasped,
            WorldEvent::Wiping => wiping,
            WorldEvent::Start => Some(0.0),
        };
        self.accidents.add(t, begun, plant, &mut self.external);
    }

    /// Collects the true state and passes it to the truth sinks.
    fn publish_truth(&mut self, stamp_ns: u64) {
        let held = self.plant.held(0);
        let GuardedRobot { targets, .. } = &self.robots[0];
        let taken = held.filter(|_| held != self.object || !self.truth.held);
        self.object = held.or(self.object);
        let (before, held) = (self.truth.held, held.is_some());
        let truth = &mut self.truth;
        truth.stamp_ns = stamp_ns;
        copy(&mut truth.position, self.plant.position(0));
        copy(&mut truth.velocity, self.plant.velocity(0));
        copy(&mut truth.command_position, &targets.position);
        copy(&mut truth.command_velocity, &targets.velocity);
        truth.tcp = self.plant.tcp(0);
        truth.tcp_velocity = self.plant.tcp_velocity(0);
        truth.held = held;
        truth.object = self.object;
        truth.objects.clear();
        truth.objects.extend((0..self.object_names.len()).filter_map(|object| self.plant.object(object)));
        truth.pressed = self.plant.pressed();
        truth.tcps.clear();
        if self.plant.has_handles() {
            truth.tcps.extend(self.plant.tcps(0));
        }
        truth.led.clear();
        truth.led.extend(self.plant.led());
        truth.collisions.clear();
        truth.collisions.extend(self.plant.collisions(0));
        truth.links_touching.clear();
        truth.links_touching.extend(self.plant.contacts_of_links(0));
        if self.steps.is_multiple_of(LOOKED_AT_EVERY) {
            truth.people.clear();
            truth.people.extend((0..self.people.len()).filter_map(|person| self.plant.distance(0, person)));
            truth.people_parts.clear();
            truth.people_parts.extend((0..self.people.len()).map(|person| self.plant.person(person)));
            let reaches = self.people.iter().zip(&truth.people_parts).enumerate();
            truth.reaches = reaches.filter_map(|(n, (person, parts))| true_reach(n, person, parts)).collect();
        }
        truth.contact = self.object.map(|object| self.plant.contact(object)).unwrap_or_default();
        let wrench = self.plant.wrench(0);
        (truth.wrist_force, truth.wrist_torque) = (wrench.force, wrench.torque);
        self.referee.sample(&self.truth);
        for sink in &mut self.sinks {
            sink.sample(&self.truth);
        }
        for event in self.coach.take_events() {
            self.event(stamp_ns, &TruthEvent::Coach(event));
        }
        if let Some(name) = taken.and_then(|object| self.object_names.get(object)).cloned() {
            self.event(stamp_ns, &TruthEvent::Grasped(name));
        }
        if held != before {
            self.event(stamp_ns, &TruthEvent::Held(held));
        }
        if self.grasped_at.is_none() && self.plant.held(0).is_some() {
            self.grasped_at = Some(stamp_ns as f64 * 1e-9);
            self.event(stamp_ns, &TruthEvent::Reached(WorldEvent::Grasp));
        }
    }

    /// Where everything is, if a frame will be due in the next step.
    fn moment(&self) -> Option<Moment> {
        let next = (self.steps + 1) as f64 * 1e-3;
        let own = self.robots.iter().any(|robot| robot.eyes.will_be_due(next));
        if !own && !self.agents.iter().any(|agent| agent.will_be_due(next)) {
            return None;
        }
        Some(Moment {
            robots: (0..self.robots.len()).map(|robot| self.plant.position(robot).to_vec()).collect(),
            objects: self.truth.objects.clone(),
            people: (0..self.people.len()).map(|person| self.plant.person(person)).collect(),
            tool: self.truth.coach.tool,
            hand: self.truth.coach.hand.map(|hand| hand.root_from_hand),
        })
    }

    /// Draws the frames that are due and wanted: the robot's and those of other agents.
    fn draw_frames(&mut self, stamp_ns: u64, t: f64) {
        let elsewhere = self.scenery.as_ref().is_some_and(|scenery| scenery.is_wanted());
        let robots = self.robots.iter_mut().enumerate();
        let own: Vec<bool> = robots.map(|(i, robot)| robot.eyes.due(t, elsewhere && i == 0)).collect();
        let others: Vec<bool> = self.agents.iter_mut().map(|agent| agent.due(t)).collect();
        if !own.contains(&true) && !others.contains(&true) {
            return;
        }
        let objects: Vec<Isometry3<f64>> =
            (0..self.object_names.len()).filter_map(|i| self.plant.object(i)).collect();
        let people: Vec<_> = (0..self.people.len()).map(|person| self.plant.person(person)).collect();
        let sensed: Vec<Vec<f64>> = self.robots.iter().map(|robot| robot.sample.position.clone()).collect();
        let robots: Vec<RobotJoints<'_>> = (sensed.iter().enumerate())
            .map(|(i, sensed)| RobotJoints { truth: self.plant.position(i), sensed })
            .collect();
        let view = SceneState {
            exposed_ns: stamp_ns,
            before: self.before.as_ref(),
            robots: &robots,
            objects: &objects,
            people: &people,
            coach: &self.truth.coach,
            without_hand_s: t - self.hand_gone_at,
            wiped: &self.dirt,
        };
        let scene = Arc::new(ShadowedScene::new(self.drawing.scene(&view)));
        for (i, robot) in self.robots.iter_mut().enumerate().filter(|(i, _)| own[*i]) {
            let truth = match &mut self.scenery {
                Some(scenery) if i == 0 => {
                    scenery.show(Scenery::of(&view, &self.world, robot.eyes.frame()));
                    robot.eyes.paint(&self.drawing, &scene, &view).1
                }
                _ => robot.eyes.draw(&self.drawing, &scene, &view),
            };
            if i == 0 {
                self.referee.frame(&truth);
                self.sinks.iter_mut().for_each(|sink| sink.frame(&truth));
            }
        }
        for (agent, due) in self.agents.iter_mut().zip(others) {
            if due {
                agent.draw(&scene, stamp_ns);
            }
        }
    }

    fn wipe(&mut self) {
        if self.truth.contact.normal <= 0.0 {
            return;
        }
        if let Some((object, pose)) = self.truth.object_pose()
            && let Some(foundation) = self.plant.foundation(object)
        {
            foundation.wipe(self.plant.table(), &pose, &mut self.dirt);
        }
    }
}

impl Drop for Simulation {
    fn drop(&mut self) {
        self.robots.iter().for_each(|robot| robot.eyes.source().close());
        self.agents.iter().for_each(|agent| agent.source().close());
    }
}

/// What an arm of a person reaches for, and where its joints are.
fn true_reach(index: usize, person: &Person, parts: &[Isometry3<f64>]) -> Option<TrueReach> {
    let reach = person.reaches()?;
    let [_, _, right_elbow, right_wrist, _, left_elbow, left_wrist] = figure::joints(person.spec(), parts)?;
    let forearm = if reach.side == 0 { [right_elbow, right_wrist] } else { [left_elbow, left_wrist] };
    Some(TrueReach { person: index, reach, forearm })
}

/// The arm that works as it truly is, with the links where it bends.
fn seen_arm(kinematics: &mut Kinematics, plant: &Plant, bends: [LinkId; 2]) -> SeenArm {
    kinematics.update(plant.position(0));
    let at = |link: LinkId| Point3::from(kinematics.pose(link).translation.vector);
    let [wrist, elbow] = bends.map(at);
    let tcp = Point3::from(plant.tcp(0).translation.vector);
    SeenArm { tcp, velocity: plant.tcp_velocity(0), wrist, elbow }
}

/// Sets `into` to `a` plus `factor` times `b`.
fn add(into: &mut [f64], a: &[f64], b: &[f64], factor: f64) {
    for ((into, a), b) in into.iter_mut().zip(a).zip(b) {
        *into = a + factor * b;
    }
}

fn copy(into: &mut Vec<f64>, from: &[f64]) {
    into.clear();
    into.extend_from_slice(from);
}

/// The wrist and the elbow of an arm: the two places next to the TCP where it bends. Joints whose origins are within 2 cm
/// bend it at one place, that of the first of them.
fn bends(model: &Model, arm: &Limb) -> [LinkId; 2] {
    const ONE_PLACE: f64 = 0.02;
    let q = model.zero();
    let at = |link: LinkId| model.link_pose(&q, link).translation.vector;
    let links = arm.joints.iter().rev().map(|&joint| model.joints()[joint].link);
    let mut places: Vec<(LinkId, Vector3<f64>)> = arm.tcp.map(|tcp| (tcp, at(tcp))).into_iter().collect();
    for link in links {
        let here = at(link);
        match places.last_mut() {
            Some((first, there)) if (here - *there).norm() < ONE_PLACE && Some(*first) != arm.tcp => {
                *first = link
            }
            Some((_, there)) if (here - *there).norm() < ONE_PLACE => {}
            _ => places.push((link, here)),
        }
    }
    let place = |i: usize| places[i.min(places.len() - 1)].0;
    [place(1), place(2)]
}

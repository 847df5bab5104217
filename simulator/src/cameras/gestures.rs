//! Recognition of the coach's gestures over tables of other colours: the real cameras, coach and observer, with a
//! robot whose hand is moved along the path by kinematics alone.

use std::collections::BTreeMap;

use armarium_robot::{DifferentialIk, IkConfig, Model, Twist};
use armarium_visionx::{EpipolarCheck, Gesture, HandDetection};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::coach::{Coach, CoachPath, SeenArm};
use crate::render::hand::SKIN;
use crate::table::{DirtGrid, TableTop};
use crate::world::{CoachingAction, CoachingStep, Show};

/// How long a gesture (or no hand) must have lasted before a frame counts, s; the same as the referee's.
const STEADY_S: f64 = 0.3;
/// Height of the TCP over the table's plane while it wipes, m.
const TCP_HEIGHT: f64 = 0.10;
/// Duration of each gesture, s.
const STAYS_S: f64 = 1.0;
/// The step of arm and coach, s.
const STEP_S: f64 = 0.005;

/// Recognised gestures, by the gesture that was shown; `None` is no hand.
#[derive(Debug, Default)]
struct Score {
    confusion: BTreeMap<(Option<Gesture>, Option<Gesture>), usize>,
    /// How far the palm was seen from its middle, m, and fingers from the hand's direction, rad, in the frames with the right gesture.
    palms: Vec<f64>,
    pointing: Vec<f64>,
}

impl Score {
    /// The share of the selected frames with the right result.
    fn share(&self, keep: impl Fn(Option<Gesture>) -> bool) -> f64 {
        let count = |right: bool| -> usize {
            let chosen = self.confusion.iter().filter(|((shown, _), _)| keep(*shown));
            chosen.filter(|((shown, seen), _)| !right || shown == seen).map(|(_, n)| n).sum()
        };
        count(true) as f64 / count(false).max(1) as f64
    }

    /// Share of frames with the right result, with as many frames without a hand as with one.
    fn accuracy(&self) -> f64 {
        0.5 * (self.share(|g| g.is_some()) + self.share(|g| g.is_none()))
    }
}

/// The robot's hand, here the one that wipes, moved without physics.
pub(super) struct Wiper {
    ik: DifferentialIk,
    joints: Vec<usize>,
    tcp: LinkId,
    pub(super) q: Vec<f64>,
}

impl Wiper {
    pub(super) fn new(model: &Arc<Model>, arm: &str) -> Self {
        let tcp = model.arms().find(|limb| limb.name == arm).and_then(|limb| limb.tcp).unwrap();
        let joints = model.reaching_joints(arm);
        let ik = DifferentialIk::new(model, tcp, &joints, IkConfig::default());
        Self { ik, joints, tcp, q: model.ready(arm).to_vec() }
    }

    fn tcp(&mut self) -> Isometry3<f64> {
        let q = self.q.clone();
        self.ik.step(&q, &Twist::default(), None);
        *self.ik.kinematics().pose(self.tcp)
    }

    pub(super) fn go(&mut self, goal: &Vector3<f64>) {
        let linear = (goal - self.tcp().translation.vector) * 10.0;
        let linear = linear * (0.4 / linear.norm().max(0.4));
        let step = self.ik.step(&self.q, &Twist { linear, ..Twist::default() }, None);
        self.joints.iter().zip(step.velocities).for_each(|(&j, v)| self.q[j] += v * STEP_S);
    }
}

/// The coach shows all gestures, one after the other, from 2 s on; one finger points across the picture and away from the eyes.
fn world(table: [u8; 3]) -> World {
    let show = |at, gesture, phase, offset, direction| CoachingStep {
        at,
        action: CoachingAction::Show(Show { gesture, phase, offset, duration: STAYS_S, direction }),
    };
    let mut world = World::default();
    world.table.color = table;
    world.camera.noise = 3.0;
    (world.camera.latency, world.camera.jitter, world.camera.dropped) = (0.0, 0.0, 0.0);
    (world.camera.stamp_offset, world.camera.stamp_jitter) = (0.0, 0.0);
    world.camera.mounting_error.rotation_deg = [2.0, -1.5, 1.0];
    world.coach.coaching = vec![
        show(2.0, Gesture::Fist, 0.6, [-0.10, -0.04, 0.05], None),
        show(6.0, Gesture::PointTwo, 0.25, [0.0, 0.12, 0.04], None),
        show(10.0, Gesture::PointOne, 0.5, [-0.05, 0.12, 0.05], Some([0.04, 0.0, 0.0])),
        show(14.0, Gesture::OpenHand, 0.25, [0.0, 0.11, 0.06], None),
        // Away from the eyes.
        show(18.0, Gesture::PointOne, 0.5, [-0.05, 0.12, 0.05], Some([0.0, 0.04, 0.0])),
    ];
    world
}

/// Observes the coach while a hand comes and stays, and for a moment after each has gone.
fn watch(world: &World, seed: u64, hands: HandDetection) -> Score {
    let robots = crate::start::robots(world, seed, None).unwrap();
    let model = Arc::clone(&robots[0].model);
    let table = TableTop::new(&world.table);
    let mut eyes = Eyes::new(world, 0, &robots[0], seed);
    let mut drawing = Drawing::new(world, &robots, &table, seed);
    let mut wiper = Wiper::new(&model, &robots[0].arm);
    drawing.update(&[RobotJoints { truth: &wiper.q, sensed: &wiper.q }]);
    let camera = drawing.links(0, eyes.left)[1].translation.vector.into();
    let rng = ChaCha8Rng::seed_from_u64(seed);
    let mut coach = Coach::new(&world.coach, world.table.height, (camera, 1.0), rng);
    let path = CoachPath::new(&world.coach.demonstration.clone().unwrap_or_default());
    let mut observer = hands.observer(eyes.rig.source.calibration());
    let dirt = DirtGrid::new(&table);
    let (mut score, mut hand_gone_at, mut before) = (Score::default(), 0.0, wiper.tcp());
    coach.hear("wiping", 0.0);
    for step in 0..(22.0 / STEP_S) as u64 {
        let t = step as f64 * STEP_S;
        let [x, y] = path.point(std::f64::consts::TAU * path.frequency() * t);
        wiper.go(&Vector3::new(x, y, table.plane_height(x, y) + TCP_HEIGHT));
        let tcp = wiper.tcp();
        let velocity = (tcp.translation.vector - before.translation.vector) / STEP_S;
        before = tcp;
        let tcp_at = Point3::from(tcp.translation.vector);
        let arm = SeenArm { tcp: tcp_at, velocity, wrist: tcp_at, elbow: tcp_at };
        let state = *coach.step(t, || arm, STEP_S);
        if state.hand.is_some() {
            hand_gone_at = t;
        }
        let without_hand_s = t - hand_gone_at;
        let looks = state.hand.is_some_and(|hand| hand.in_place) || (STEADY_S..0.8).contains(&without_hand_s);
        if !(looks && eyes_open(t)) {
            continue;
        }
        let view = SceneState {
            before: None,
            exposed_ns: step * 5_000_000,
            robots: &[RobotJoints { truth: &wiper.q, sensed: &wiper.q }],
            objects: &[tcp * Isometry3::from_parts(world.grasp_in_tcp().into(), UnitQuaternion::identity())],
            people: &[],
            coach: &state,
            without_hand_s,
            wiped: &dirt,
        };
        let scene = Arc::new(ShadowedScene::new(drawing.scene(&view)));
        let truth = eyes.draw(&drawing, &scene, &view);
        let frame = eyes.rig.source.newest.borrow().frame.unwrap();
        let seen = observer.update(&frame);
        if truth.since_s >= STEADY_S && (truth.visible || truth.gesture.is_none()) {
            let gesture = seen.as_ref().map(|seen| seen.gesture);
            *score.confusion.entry((truth.gesture, gesture)).or_default() += 1;
            if let (Some(hand), Some(seen)) = (state.hand, seen.filter(|_| gesture == truth.gesture)) {
                let hand_from_left = hand.root_from_hand.inv_mul(&frame.root_from_left);
                score.palms.push((hand_from_left * seen.palm_in_left).coords.norm());
                let pointing = seen.pointing.map(|pointing| (hand_from_left * pointing).angle(&Vector3::z()));
                score.pointing.extend(pointing);
            }
        }
    }
    score
}

/// Whether a frame is due: fifteen times per second.
fn eyes_open(t: f64) -> bool {
    (t * 15.0 + 1e-6).fract() < 15.0 * STEP_S
}

/// Dark and light woods, red, grey, and the colour of the hand itself.
#[test]
fn gestures_are_seen_over_tables_of_any_colour() {
    for (color, seed) in
        [SKIN, [120, 84, 60], [222, 190, 150], [150, 70, 60], [128, 128, 130]].into_iter().zip(1..)
    {
        let score = watch(&world(color), seed, HandDetection::Skin);
        let frames: usize = score.confusion.values().sum();
        assert!(frames > 40, "{color:?}: {score:?}");
        assert!(score.accuracy() >= 0.95, "{color:?}: {} {score:?}", score.accuracy());
        for gesture in [Gesture::Fist, Gesture::OpenHand, Gesture::PointOne] {
            assert!(score.share(|shown| shown == Some(gesture)) >= 0.9, "{color:?}: {score:?}");
        }
    }
}

/// With depth and by both eyes. Over a table of the hand's own colour networks find only a part of the hands.
#[test]
fn networks_see_the_gestures_over_tables_of_another_colour() {
    for (color, seed) in [[120, 84, 60], [222, 190, 150], [128, 128, 130]].into_iter().zip(1..) {
        for has_depth in [true, false] {
            let mut world = world(color);
            world.camera.depth = world.camera.depth.filter(|_| has_depth);
            let score = watch(&world, seed, HandDetection::Learned);
            let frames: usize = score.confusion.values().sum();
            assert!(frames > 40, "{color:?}: {score:?}");
            assert!(score.accuracy() >= 0.95, "{color:?}: {} {score:?}", score.accuracy());
        }
    }
}

/// The fingers that point stand apart by up to 14 degrees, so that their mean is not quite the hand's direction.
#[test]
fn networks_see_where_a_hand_is_and_points() {
    for (hands, has_depth) in
        [(HandDetection::Skin, true), (HandDetection::Learned, true), (HandDetection::Learned, false)]
    {
        let mut world = world([120, 84, 60]);
        let mounting = &mut world.camera.mounting_error;
        (mounting.rotation_deg, mounting.distance, mounting.angle_deg) = ([0.0; 3], 0.0, 0.0);
        world.camera.depth = world.camera.depth.filter(|_| has_depth);
        let Score { palms, pointing, .. } = watch(&world, 1, hands);
        assert!(palms.len() > 40 && pointing.len() > 20, "{} {}", palms.len(), pointing.len());
        let [palm, pointing] = [palms, pointing].map(|values| EpipolarCheck::median(&values).unwrap());
        let pointing = pointing.to_degrees();
        println!("{hands:?}, depth {has_depth}: palm {:.1} mm, direction {pointing:.1} degrees", palm * 1e3);
        assert!(
            palm < 0.013 && pointing < 11.0,
            "{hands:?}, depth {has_depth}: {palm} m, {pointing} degrees"
        );
    }
}

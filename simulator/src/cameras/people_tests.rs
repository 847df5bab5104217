//! Where a person's joints are seen to be: the real cameras and the observer of bodies, with drawn people who move their arms before a
//! robot that stands still, and with nobody.

use armarium_robot::{Model, Visual};
use armarium_visionx::{BodyJoint, BodyObserver, OwnPart};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::gestures::Wiper;
use super::*;
use crate::coach::{CoachState, minimum_jerk};
use crate::figure::{joints, poses};
use crate::table::{DirtGrid, TableTop};
use crate::world::{ActorSpec, PersonSpec, Sleeves};

/// Frames of a sequence, those at its beginning that do not count, and their rate, Hz.
const FRAMES: u64 = 28;
const BEGINS: u64 = 6;
const RATE: f64 = 15.0;

/// What a person does with an arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Does {
    Hangs,
    Reaches,
    BeforeTorso,
    Aside,
}

/// A robot that looks at a place, and its world.
struct Watched {
    eyes: Eyes,
    drawing: Drawing,
    table: TableTop,
    model: Arc<Model>,
    arm: String,
    q: Vec<f64>,
}

impl Watched {
    fn new(world: World, at: &Point3<f64>, seed: u64) -> Self {
        let robots = crate::start::robots(&world, seed, None).unwrap();
        let model = Arc::clone(&robots[0].model);
        let table = TableTop::new(&world.table);
        let eyes = Eyes::new(&world, 0, &robots[0], seed);
        let drawing = Drawing::new(&world, &robots, &table, seed);
        let q = looking(&model, model.ready(&robots[0].arm), at);
        Self { eyes, drawing, table, arm: robots[0].arm.clone(), model, q }
    }

    /// The robot's hand goes between its camera and a place, or as near to there as it comes.
    fn reach_before(&mut self, hidden: &Point3<f64>, at: &Point3<f64>) {
        let camera = self.model.link_pose(&self.q, self.model.camera().unwrap().left).translation.vector;
        let goal = camera + (hidden.coords - camera).normalize() * 0.5;
        let mut hand = Wiper::new(&self.model, &self.arm);
        (0..1000).for_each(|_| hand.go(&goal));
        self.q = looking(&self.model, &hand.q, at);
    }

    /// The boxes around all parts of the robot.
    fn own(&self) -> Vec<OwnPart> {
        let mut kinematics = Kinematics::new(&self.model);
        kinematics.update(&self.q);
        let links = self.model.links().iter().filter_map(|link| Some((link, self.model.link(&link.name)?)));
        let part = |root_from_link: &Isometry3<f64>, visual: &Visual| {
            let (middle, half) = visual.shape.surrounding_box();
            let root_from_box = root_from_link * visual.link_from_shape * Translation3::from(middle);
            OwnPart { root_from_box, size: 2.0 * half }
        };
        let parts = links.flat_map(|(link, id)| {
            let pose = *kinematics.pose(id);
            link.visuals.iter().map(move |visual| part(&pose, visual))
        });
        parts.collect()
    }

    /// A frame, and what is before the left eye, m.
    fn frame(&mut self, number: u64, people: &[Vec<Isometry3<f64>>]) -> (Arc<StereoFrame>, DepthImage) {
        let dirt = DirtGrid::new(&self.table);
        let view = SceneState {
            before: None,
            exposed_ns: (number as f64 / RATE * 1e9) as u64,
            robots: &[RobotJoints { truth: &self.q, sensed: &self.q }],
            objects: &[],
            people,
            coach: &CoachState::default(),
            without_hand_s: 0.0,
            wiped: &dirt,
        };
        let scene = Arc::new(ShadowedScene::new(self.drawing.scene(&view)));
        let (drawn, _) = self.eyes.paint(&self.drawing, &scene, &view);
        // Each frame has noise of its own.
        self.eyes.rig.next_frame = number;
        self.eyes.draw(&self.drawing, &scene, &view);
        (self.eyes.rig.source.newest.borrow().frame.unwrap(), drawn.left.depth)
    }
}

/// The joints with the head turned so that the left camera looks at a place, as well as it can.
fn looking(model: &Arc<Model>, start: &[f64], at: &Point3<f64>) -> Vec<f64> {
    let camera = model.camera().unwrap().left;
    let off = |q: &[f64]| {
        let pose = model.link_pose(q, camera);
        let ahead = pose.rotation * Vector3::z();
        let level = (pose.rotation * Vector3::x()).z;
        ahead.angle(&(at - Point3::from(pose.translation.vector))) + level.abs()
    };
    let named = |name: &str| model.joints().iter().position(|joint| joint.name == name).unwrap();
    let joints = ["neck_pitch", "neck_roll", "neck_yaw"].map(named);
    let (mut q, mut step) = (start.to_vec(), 0.3);
    while step > 1e-3 {
        let before = off(&q);
        for joint in joints {
            let limits = (model.joints()[joint].lower, model.joints()[joint].upper);
            for sign in [1.0, -1.0] {
                let mut other = q.clone();
                other[joint] = (q[joint] + sign * step).clamp(limits.0, limits.1);
                if off(&other) < off(&q) {
                    q = other;
                }
            }
        }
        if off(&q) >= before {
            step *= 0.5;
        }
    }
    q
}

/// The errors of joints, m, and what else was counted.
#[derive(Debug, Default)]
struct Errors {
    /// Of joints that are in the picture and not hidden, and of the others in the picture.
    seen: Vec<f64>,
    hidden: Vec<f64>,
    frames: usize,
    without_person: usize,
    exchanged: usize,
    /// Joints that were seen at the robot, and are not there.
    taken: usize,
}

impl Errors {
    /// The share `share` of the errors of joints that are not hidden is smaller than this, m.
    fn quantile(&self, share: f64) -> f64 {
        let mut all = self.seen.clone();
        all.sort_by(f64::total_cmp);
        all.get(((all.len() as f64 - 1.0) * share) as usize).copied().unwrap_or(f64::INFINITY)
    }
}

fn between(rng: &mut ChaCha8Rng, from: f64, to: f64) -> f64 {
    from + (to - from) * rng.random::<f64>()
}

/// A person of any height and clothes at a distance before the robot.
fn somebody(rng: &mut ChaCha8Rng, number: u64) -> PersonSpec {
    PersonSpec {
        at: [between(rng, -0.15, 0.25), between(rng, 0.9, 1.5)],
        yaw_deg: between(rng, 160.0, 200.0),
        height: between(rng, 1.6, 1.85),
        sleeves: if number.is_multiple_of(2) { Sleeves::Long } else { Sleeves::Short },
        color: std::array::from_fn(|_| between(rng, 40.0, 220.0) as u8),
        ..PersonSpec::default()
    }
}

/// Where a hand goes, in the frame of the feet, m.
fn goal(rng: &mut ChaCha8Rng, spec: &PersonSpec, side: usize, does: Does) -> Point3<f64> {
    let (h, out) = (spec.height, if side == 0 { 1.0 } else { -1.0 });
    let mut place = |x: [f64; 2], y: [f64; 2], z: [f64; 2]| {
        let [x, y, z] = [x, y, z].map(|[from, to]| between(rng, from, to));
        Point3::new(out * x, y, z * h)
    };
    match does {
        Does::Hangs => place([0.24; 2], [0.06; 2], [0.49; 2]),
        Does::Reaches => place([0.0, 0.25], [0.30, 0.45], [0.58, 0.78]),
        Does::BeforeTorso => place([-0.10, 0.08], [0.18, 0.26], [0.60, 0.74]),
        Does::Aside => place([0.35, 0.5], [0.0, 0.2], [0.6, 0.9]),
    }
}

/// A world with exact cameras, and perhaps with a person.
fn world(depth: bool, person: Option<PersonSpec>) -> World {
    let mut world = World::default();
    (world.camera.latency, world.camera.jitter, world.camera.dropped) = (0.0, 0.0, 0.0);
    (world.camera.mounting_error.distance, world.camera.mounting_error.angle_deg) = (0.0, 0.0);
    if !depth {
        world.camera.depth = None;
    }
    world.objects.clear();
    world.actors.extend(person.map(|person| ActorSpec { person: Some(person), coach: None }));
    world
}

/// Whether nothing is before a joint in the picture; `None` where it is not in the picture.
fn is_free(
    joint: BodyJoint,
    at: &Point3<f64>,
    (camera, depth): (&PinholeCamera, &DepthImage),
) -> Option<bool> {
    /// How far a joint may be under what is seen of it, m.
    const UNDER: [f64; 7] = [0.13, 0.09, 0.08, 0.06, 0.09, 0.08, 0.06];
    let px = camera.project(at)?;
    let inside =
        px.x >= 0.0 && px.y >= 0.0 && px.x < f64::from(depth.width) && px.y < f64::from(depth.height);
    let shown = f64::from(depth.at(px.x as u32, px.y as u32));
    inside.then(|| shown == 0.0 || shown > at.z - UNDER[joint as usize])
}

/// How far a place is from the nearest part of the robot, m.
fn from_own(own: &[OwnPart], at: &Point3<f64>) -> f64 {
    own.iter().map(|part| part.distance(at)).fold(f64::INFINITY, f64::min)
}

/// What the robot does with its arm meanwhile, and whether the observer knows its body.
#[derive(Clone, Copy, Debug, PartialEq)]
enum OwnArm {
    Rests,
    ReachesOut { known: bool },
}

/// Watches one person who moves both arms once.
fn watch(seed: u64, does: Does, depth: bool, arm: OwnArm, all: &mut Errors) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let spec = somebody(&mut rng, seed);
    let [x, y] = spec.at;
    let looks_at = Point3::new(x, y, 0.76 * spec.height);
    let mut watched = Watched::new(world(depth, Some(spec.clone())), &looks_at, seed);
    let mut observer = BodyObserver::new(watched.eyes.rig.source.calibration());
    if let OwnArm::ReachesOut { .. } = arm {
        let hidden =
            Point3::new(x + between(&mut rng, -0.25, 0.25), y, between(&mut rng, 0.62, 0.8) * spec.height);
        watched.reach_before(&hidden, &looks_at);
    }
    let own = watched.own();
    let known = if arm == (OwnArm::ReachesOut { known: false }) { &[] } else { &own[..] };
    let feet = Isometry3::new(Vector3::new(x, y, 0.0), Vector3::z() * spec.yaw_deg.to_radians());
    let from = [0, 1].map(|side| goal(&mut rng, &spec, side, Does::Hangs));
    let to = [0, 1].map(|side| goal(&mut rng, &spec, side, does));
    for number in 1..=FRAMES {
        let share = minimum_jerk((number as f64 / (0.9 * FRAMES as f64)).min(1.0));
        let hands = [0, 1].map(|side| feet * (from[side] + (to[side] - from[side]) * share));
        let parts = poses(&spec, &feet, &hands);
        let truth = joints(&spec, &parts).unwrap();
        let (frame, shown) = watched.frame(number, &[parts]);
        let seen = observer.update(&frame, known);
        if number <= BEGINS {
            continue;
        }
        all.frames += 1;
        let Some(seen) = seen else {
            all.without_person += 1;
            continue;
        };
        let camera = watched.eyes.rig.source.calibration().camera;
        let mut exchanged = false;
        for joint in BodyJoint::ALL {
            let at = truth[joint as usize];
            let in_left = frame.root_from_left.inverse() * at;
            let Some(free) = is_free(joint, &in_left, (&camera, &shown)) else { continue };
            let taken = seen.joint(joint).is_some_and(|seen| from_own(&own, &seen.at) < 0.05);
            all.taken += usize::from(taken && from_own(&own, &at) > 0.15);
            let error = seen.joint(joint).map_or(f64::INFINITY, |seen| (seen.at - at).norm());
            if free { &mut all.seen } else { &mut all.hidden }.push(error);
            let other = truth[joint.mirrored() as usize];
            let is_other = seen.joint(joint).is_some_and(|seen| (seen.at - other).norm() < error);
            exchanged |= is_other && (at - other).norm() > 0.15;
        }
        all.exchanged += usize::from(exchanged);
    }
}

fn watched(depth: bool, seeds: u64) -> Errors {
    let mut all = Errors::default();
    for does in [Does::Hangs, Does::Reaches, Does::BeforeTorso, Does::Aside] {
        (1..=seeds).for_each(|seed| watch(seed + 10 * does as u64, does, depth, OwnArm::Rests, &mut all));
    }
    all
}

#[test]
fn joints_are_seen_where_they_are_by_depth() {
    let all = watched(true, 5);
    let [half, most] = [0.5, 0.95].map(|share| all.quantile(share));
    assert_eq!(all.without_person, 0, "of {} frames", all.frames);
    assert!(all.exchanged * 100 < all.frames, "{} of {}", all.exchanged, all.frames);
    assert!(half < 0.040 && most < 0.120, "{half} and {most} m, {} hidden", all.hidden.len());
}

#[test]
fn joints_are_seen_where_they_are_by_both_eyes_alone() {
    let all = watched(false, 5);
    let half = all.quantile(0.5);
    assert!(all.without_person * 100 < all.frames && all.exchanged * 100 < all.frames, "{all:?}");
    assert!(half < 0.080, "{half} m");
}

#[test]
fn where_nobody_is_nobody_is_seen_and_the_own_arm_is_no_persons() {
    for depth in [true, false] {
        for at in [[0.25, 0.55, 1.0], [0.3, 0.9, 1.2], [0.0, 1.5, 1.3], [-0.2, 0.6, 1.1]] {
            let mut watched = Watched::new(world(depth, None), &Point3::from(at), 3);
            let mut observer = BodyObserver::new(watched.eyes.rig.source.calibration());
            let own = watched.own();
            for number in 1..=6 {
                let (frame, _) = watched.frame(number, &[]);
                assert_eq!(observer.update(&frame, &own), None, "{at:?}, depth {depth}");
            }
        }
    }
}

/// With its hand before the trunk or an arm of the person, known and unknown to the observer.
#[test]
fn the_own_arm_before_a_person_is_not_taken_for_theirs() {
    let [known, unknown] = [true, false].map(|known| {
        let mut all = Errors::default();
        for does in [Does::Hangs, Does::Reaches, Does::BeforeTorso, Does::Aside] {
            (1..=3).for_each(|seed| {
                watch(seed + 10 * does as u64, does, true, OwnArm::ReachesOut { known }, &mut all);
            });
        }
        let [half, most] = [0.5, 0.95].map(|share| all.quantile(share) * 1e3);
        println!(
            "known {known}: {} taken in {} frames, {half:.0} and {most:.0} mm, {} seen, {} hidden, {} exchanged, {} without",
            all.taken, all.frames, all.seen.len(), all.hidden.len(), all.exchanged, all.without_person
        );
        all
    });
    assert!(known.hidden.len() > 300 && unknown.taken > 20, "it hides nothing: {unknown:?}");
    assert!(known.taken * 100 < known.frames && known.without_person * 100 < known.frames, "{known:?}");
    assert!(known.exchanged * 100 < known.frames, "{} of {}", known.exchanged, known.frames);
    assert!(known.quantile(0.5) < 0.040 && known.quantile(0.95) < 0.120, "{known:?}");
}

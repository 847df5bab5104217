//! The robot's parts as convex bodies, and how near to each other they are.
//!
//! Links that no joint moves against each other form one body. Pairs that need not be kept apart are left out once
//! ([`Bodies::new`]); the others are watched by [`Distances`], which knows one configuration and computes a distance
//! anew only when its bodies may have moved by more than its answer allows. It commands nothing: the guard does.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use nalgebra::{Isometry3, Point3, Unit, Vector3};
use parry3d_f64::math::{Pose, Rotation, Vector};
use parry3d_f64::query::contact;
use parry3d_f64::shape::{Cuboid, Cylinder, SharedShape};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use crate::boundary::{MAX_NAME, is_box};
use crate::{Geometry, Joint, JointKind, Kinematics, LinkId, Load, Mesh, Model};

/// Distance that two bodies keep, m.
pub(crate) const KEPT: f64 = 0.02;
/// Bodies that are farther apart than this, m, are not looked at more closely.
pub(crate) const FAR: f64 = 0.3;
/// Bodies that turn, with at most this many joints between them are kept apart by the limits of those joints: an upper arm and the trunk
/// that carries its shoulder, a hand and the forearm that carries its wrist.
const NEAR_IN_CHAIN: usize = 3;
/// Bodies with at most this many joints between them and what the robot stands on, such as hips, are as far from known boxes as it
/// stands.
const NEAR_THE_BASE: usize = 2;
/// Bodies that are nearer than this at the start, m, are taken for neighbours.
const NEIGHBOURS: f64 = 0.03;
/// Random configurations in which pairs are looked at, and the share of them in which neighbours are near.
const SAMPLES: u32 = 200;
const MOSTLY: f64 = 0.95;
/// A distance is computed anew when its bodies may have moved by this share of it, but not for less than `FINE`, m.
const COARSE: f64 = 0.05;
const FINE: f64 = 0.0005;

/// Links that move as one.
#[derive(Clone, Debug)]
struct MovingLinks {
    /// The link whose frame its parts are in.
    link: LinkId,
    parts: Vec<Part>,
    /// A known box or a load; `None` for the robot's own bodies.
    name: Option<String>,
    /// A ball around all shapes: centre in the link's frame, radius in m.
    center: Point3<f64>,
    radius: f64,
}

/// A shape of a body.
#[derive(Clone, Debug)]
struct Part {
    /// The link that it is of.
    link: LinkId,
    /// Its pose in the frame of the body's link.
    body_from_shape: Isometry3<f64>,
    shape: SharedShape,
}

/// Two bodies that have to stay apart.
#[derive(Clone, Debug)]
struct Pair {
    bodies: [usize; 2],
    /// The parts of both that have to, as indices into theirs.
    parts: Vec<[usize; 2]>,
}

/// Two bodies that are near each other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Near {
    /// A lower bound of their distance, m; negative where they overlap.
    pub(crate) distance: f64,
    /// A link of each.
    pub(crate) links: [LinkId; 2],
    /// The nearest points of both, root frame, m.
    pub(crate) points: [Point3<f64>; 2],
    /// The direction from the first to the second, root frame.
    pub(crate) direction: Unit<Vector3<f64>>,
}

/// The robot's bodies and the pairs that have to stay apart.
#[derive(Debug)]
pub(crate) struct Bodies {
    bodies: Vec<MovingLinks>,
    pairs: Vec<Pair>,
}

/// A box that is known to be there, standing still, for instance a table's top.
#[derive(Clone, Debug, PartialEq)]
pub struct KnownBox {
    /// What people call it.
    pub name: String,
    /// Pose of its middle in the root frame.
    pub root_from_box: Isometry3<f64>,
    /// Edge lengths along its x, y, z, m.
    pub size: Vector3<f64>,
}

impl KnownBox {
    /// Whether it is one, within 1 km, and its name is no longer than others.
    pub fn is_box(&self) -> bool {
        is_box(&self.root_from_box, &self.size) && self.name.len() <= MAX_NAME
    }
}

impl Bodies {
    /// The bodies of a robot. Left out are pairs that its SRDF says may touch, pairs with at most three joints between them, the
    /// links of one hand or head, and pairs that are nearer than 30 mm at the start or in 95 % of random configurations: they
    /// touch by construction.
    pub(crate) fn new(model: &Arc<Model>) -> Self {
        let mut kinematics = Kinematics::new(model);
        let bodies = bodies(&kinematics);
        let tools: Vec<BTreeSet<usize>> = (model.limbs().values())
            .filter(|limb| limb.tcp.is_none())
            .map(|limb| limb.joints.iter().copied().collect())
            .collect();
        let apart = |a: usize, b: usize| {
            let joints = joints_between(model, bodies[a].link, bodies[b].link);
            joints.len() > NEAR_IN_CHAIN && !tools.iter().any(|tool| joints.is_subset(tool))
        };
        let all = (0..bodies.len()).flat_map(|a| (a + 1..bodies.len()).map(move |b| (a, b)));
        let mut pairs: Vec<Pair> = (all.filter(|&(a, b)| apart(a, b)))
            .map(|(a, b)| Pair::new([a, b], &bodies, model))
            .filter(|pair| !pair.parts.is_empty())
            .collect();
        let near = |kinematics: &Kinematics, pair: &Pair| {
            pair.nearest(kinematics, &bodies).is_ok_and(|near| near.distance < NEIGHBOURS)
        };
        kinematics.update(model.start());
        pairs.retain(|pair| !near(&kinematics, pair));
        let mut counts = vec![0_u32; pairs.len()];
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        for _ in 0..SAMPLES {
            let q: Vec<f64> = model.joints().iter().map(|joint| anywhere(joint, &mut rng)).collect();
            kinematics.update(&q);
            for (count, pair) in counts.iter_mut().zip(&pairs) {
                *count += u32::from(near(&kinematics, pair));
            }
        }
        let mut counts = counts.into_iter();
        pairs.retain(|_| counts.next().is_some_and(|count| f64::from(count) < MOSTLY * f64::from(SAMPLES)));
        Self { bodies, pairs }
    }

    /// With what the hands hold, by their names, and boxes, from which every body that moves has to stay apart, but for those that
    /// at most two joints turn. A load stays apart from what its hand has to stay apart from.
    pub(crate) fn with(&self, model: &Model, loads: &BTreeMap<String, Load>, boxes: &[KnownBox]) -> Self {
        let mut all = Self { bodies: self.bodies.clone(), pairs: self.pairs.clone() };
        for arm in model.arms() {
            let load = arm.hand.as_ref().and_then(|hand| loads.get(hand));
            let (Some(load), Some(tcp)) = (load, arm.tcp) else { continue };
            all.add_load(model, tcp, load, loads);
        }
        let root = LinkId(0);
        let root_from_body = model.link_pose(&[], root);
        let own = all.bodies.len();
        for known in boxes {
            let body_from_shape = root_from_body.inverse() * known.root_from_box;
            let index = all.add_box(root, body_from_shape, &known.size, &known.name);
            let moving = (0..own).filter(|&a| goes_far(model, all.bodies[a].link));
            let pairs: Vec<Pair> = moving.map(|a| all.whole([a, index])).collect();
            all.pairs.extend(pairs);
        }
        all
    }

    fn add_load(&mut self, model: &Model, tcp: LinkId, load: &Load, loads: &BTreeMap<String, Load>) {
        let Some(shape) = &load.shape else { return };
        let carrier = carrier(model, tcp);
        let body_from_tcp = model.link_pose(&[], carrier).inv_mul(&model.link_pose(&[], tcp));
        let before = self.pairs.len();
        let index = self.add_box(carrier, body_from_tcp * shape.tcp_from_box, &shape.size, &load.name);
        // Hands that hold the same thing touch it.
        let holders = model.arms().filter(|arm| {
            arm.hand.as_ref().and_then(|hand| loads.get(hand)).is_some_and(|other| other.name == load.name)
        });
        let holders: Vec<usize> =
            holders.filter_map(|arm| arm.tcp).flat_map(|tcp| self.beyond(model, tcp)).collect();
        let hand = self.bodies.iter().position(|body| body.link == carrier && body.name.is_none());
        for pair in 0..before {
            let [a, b] = self.pairs[pair].bodies;
            let other = if Some(a) == hand {
                b
            } else if Some(b) == hand {
                a
            } else {
                continue;
            };
            let same = self.bodies[other].name.as_ref() == Some(&load.name);
            if !same && !holders.contains(&other) {
                self.pairs.push(self.whole([other, index]));
            }
        }
    }

    fn add_box(
        &mut self,
        link: LinkId,
        body_from_shape: Isometry3<f64>,
        size: &Vector3<f64>,
        name: &str,
    ) -> usize {
        let shape = SharedShape::new(Cuboid::new(vector(&(size / 2.0))));
        let mut body = MovingLinks::new(link, Part { link, body_from_shape, shape });
        body.name = Some(name.to_owned());
        body.enclose();
        self.bodies.push(body);
        self.bodies.len() - 1
    }

    /// Two bodies with all their parts.
    fn whole(&self, bodies: [usize; 2]) -> Pair {
        let [a, b] = bodies.map(|body| self.bodies[body].parts.len());
        Pair { bodies, parts: (0..a).flat_map(|i| (0..b).map(move |k| [i, k])).collect() }
    }

    /// Only a hand's bodies against a box.
    pub(crate) fn before(&self, model: &Model, tcp: LinkId, known: &KnownBox) -> Self {
        let mut all = self.with(model, &BTreeMap::new(), std::slice::from_ref(known));
        let (hand, board) = (all.beyond(model, tcp), all.bodies.len() - 1);
        all.pairs.retain(|Pair { bodies: [a, b], .. }| *b == board && hand.contains(a));
        all
    }

    /// The bodies of a hand: what carries its TCP, and what is attached to that.
    pub(crate) fn beyond(&self, model: &Model, tcp: LinkId) -> Vec<usize> {
        let hand: BTreeSet<LinkId> = model.subtree(carrier(model, tcp)).collect();
        (0..self.bodies.len()).filter(|&body| hand.contains(&self.bodies[body].link)).collect()
    }

    /// The bodies of all hands and of what they hold: by the guard, only these stop before known boxes.
    pub(crate) fn hands(&self, model: &Model) -> Vec<usize> {
        model.arms().filter_map(|arm| arm.tcp).flat_map(|tcp| self.beyond(model, tcp)).collect()
    }

    /// What a body is called: as a known box or a load, or as the link that carries it.
    pub(crate) fn name<'a>(&'a self, model: &'a Model, body: usize) -> &'a str {
        let body = &self.bodies[body];
        body.name.as_deref().unwrap_or(&model.links()[body.link.0].name)
    }

    /// The links of the pairs that have to stay apart.
    pub(crate) fn pairs(&self) -> impl Iterator<Item = [LinkId; 2]> {
        self.pairs.iter().map(|pair| pair.bodies.map(|body| self.bodies[body].link))
    }

    /// The bodies of a pair, as indices: those of the robot come first, then loads, then boxes.
    pub(crate) fn pair(&self, pair: usize) -> [usize; 2] {
        self.pairs[pair].bodies
    }

    /// Whether a body is the robot's own, or what it holds; not a known box.
    pub(crate) fn is_own(&self, body: usize) -> bool {
        let body = &self.bodies[body];
        body.name.is_none() || body.link != LinkId(0)
    }

    /// For the links that carry a body which moves, the radius of a ball around the link's origin that holds it, m.
    pub(crate) fn radii(&self) -> impl Iterator<Item = (LinkId, f64)> {
        self.bodies
            .iter()
            .filter(|body| body.link != LinkId(0))
            .map(|body| (body.link, body.center.coords.norm() + body.radius))
    }
}

/// The least distance of all pairs at one configuration, m, computed anew: for referees and conformance.
pub(crate) fn least_distance(bodies: &Bodies, kinematics: &Kinematics) -> f64 {
    let exact =
        |pair: &Pair| pair.nearest(kinematics, &bodies.bodies).map_or_else(|far| far, |near| near.distance);
    bodies.pairs.iter().map(exact).fold(f64::INFINITY, f64::min)
}

/// A position within a joint's limits; a joint without limits turns by half a turn to each side.
fn anywhere(joint: &Joint, rng: &mut ChaCha8Rng) -> f64 {
    let (lower, upper) = (joint.lower.max(-std::f64::consts::PI), joint.upper.min(std::f64::consts::PI));
    if lower < upper { rng.random_range(lower..upper) } else { lower }
}

/// Whether a link is moved by a platform alone, slides, or is turned by enough joints to come near to what stands around.
fn goes_far(model: &Model, link: LinkId) -> bool {
    let drives = |joint: usize| model.platform().is_some_and(|platform| platform.joints.contains(&joint));
    let (driven, own): (Vec<usize>, Vec<usize>) =
        model.motions(link).map(|(_, motion)| motion.joint).partition(|&joint| drives(joint));
    let slides = own.iter().any(|&joint| model.joints()[joint].kind == JointKind::Prismatic);
    own.len() > NEAR_THE_BASE || slides || (own.is_empty() && !driven.is_empty())
}

/// The joints that move one of two links but not the other.
fn joints_between(model: &Model, a: LinkId, b: LinkId) -> BTreeSet<usize> {
    (0..model.joints().len()).filter(|&joint| model.moves(joint, a) != model.moves(joint, b)).collect()
}

fn bodies(kinematics: &Kinematics) -> Vec<MovingLinks> {
    let model = kinematics.model();
    let mut bodies: Vec<MovingLinks> = Vec::new();
    for (index, link) in model.links().iter().enumerate() {
        let id = LinkId(index);
        let carrier = carrier(model, id);
        let carrier_from_link = kinematics.pose(carrier).inv_mul(kinematics.pose(id));
        for collision in &link.collisions {
            let (shape_from_parry, shape) = convex(&collision.shape);
            let body_from_shape = carrier_from_link * collision.link_from_shape * shape_from_parry;
            let part = Part { link: id, body_from_shape, shape };
            match bodies.iter_mut().find(|body| body.link == carrier) {
                Some(body) => body.parts.push(part),
                None => bodies.push(MovingLinks::new(carrier, part)),
            }
        }
    }
    bodies.iter_mut().for_each(MovingLinks::enclose);
    bodies
}

/// The link that carries `link` without a joint between them; it may be `link` itself.
fn carrier(model: &Model, link: LinkId) -> LinkId {
    let mut carrier = link;
    while let link = &model.links()[carrier.index()]
        && link.motion.is_none()
        && let Some(parent) = link.parent
    {
        carrier = parent;
    }
    carrier
}

/// A form as a convex shape, and the pose of that shape's frame: its cylinders are about y, ours about z.
fn convex(form: &Geometry) -> (Isometry3<f64>, SharedShape) {
    let upright = Isometry3::rotation(Vector3::x() * std::f64::consts::FRAC_PI_2);
    match form {
        Geometry::Box { size } => {
            (Isometry3::identity(), SharedShape::new(Cuboid::new(vector(&(size / 2.0)))))
        }
        Geometry::Cylinder { radius, length } => {
            (upright, SharedShape::new(Cylinder::new(length / 2.0, *radius)))
        }
        Geometry::Sphere { radius } => (Isometry3::identity(), SharedShape::ball(*radius)),
        Geometry::Capsule { radius, length } => (upright, SharedShape::capsule_y(length / 2.0, *radius)),
        Geometry::Mesh(mesh) => hull(mesh),
    }
}

/// The convex hull of a mesh; the box around it where it is flat.
fn hull(mesh: &Mesh) -> (Isometry3<f64>, SharedShape) {
    let points: Vec<Vector> = mesh.vertices().iter().map(|v| vector(&v.coords)).collect();
    SharedShape::convex_hull(&points).map_or_else(
        || {
            let (middle, half) = mesh.surrounding_box();
            let shape = SharedShape::new(Cuboid::new(vector(&half.sup(&Vector3::repeat(1e-4)))));
            (Isometry3::from(middle.coords), shape)
        },
        |shape| (Isometry3::identity(), shape),
    )
}

impl MovingLinks {
    /// A body of one part; its ball is not yet known.
    fn new(link: LinkId, part: Part) -> Self {
        Self { link, parts: vec![part], name: None, center: Point3::origin(), radius: 0.0 }
    }

    /// Puts the ball around all shapes.
    fn enclose(&mut self) {
        let balls = self.parts.iter().map(|part| {
            let ball = part.shape.compute_local_bounding_sphere();
            (part.body_from_shape * point(ball.center), ball.radius)
        });
        let balls: Vec<(Point3<f64>, f64)> = balls.collect();
        let sum = balls.iter().fold(Vector3::zeros(), |sum, (center, _)| sum + center.coords);
        self.center = Point3::from(sum / balls.len().max(1) as f64);
        self.radius = balls.iter().map(|(center, r)| (center - self.center).norm() + r).fold(0.0, f64::max);
    }
}

impl Pair {
    /// Two bodies of a robot: all their parts, but for those that may touch.
    fn new([a, b]: [usize; 2], bodies: &[MovingLinks], model: &Model) -> Self {
        let both = (0..bodies[a].parts.len()).flat_map(|i| (0..bodies[b].parts.len()).map(move |k| [i, k]));
        let apart =
            |[i, k]: &[usize; 2]| !model.may_touch(bodies[a].parts[*i].link, bodies[b].parts[*k].link);
        Self { bodies: [a, b], parts: both.filter(apart).collect() }
    }

    /// The nearest points of both, or a lower bound of their distance where they are farther apart than [`FAR`], m.
    fn nearest(&self, kinematics: &Kinematics, bodies: &[MovingLinks]) -> Result<Near, f64> {
        let [a, b] = self.bodies.map(|body| &bodies[body]);
        let (root_from_a, root_from_b) = (kinematics.pose(a.link), kinematics.pose(b.link));
        let between = (root_from_b * b.center - root_from_a * a.center).norm();
        if between - a.radius - b.radius > FAR {
            return Err(between - a.radius - b.radius);
        }
        let mut nearest: Result<Near, f64> = Err(FAR);
        let mut root_from_first = (usize::MAX, Pose::IDENTITY);
        for &[i, k] in &self.parts {
            let (first, second) = (&a.parts[i], &b.parts[k]);
            if root_from_first.0 != i {
                root_from_first = (i, pose(&(root_from_a * first.body_from_shape)));
            }
            let root_from_second = pose(&(root_from_b * second.body_from_shape));
            let found = contact(&root_from_first.1, &*first.shape, &root_from_second, &*second.shape, FAR);
            let Ok(Some(found)) = found else { continue };
            if nearest.as_ref().is_ok_and(|near| near.distance <= found.dist) {
                continue;
            }
            let n = found.normal1;
            let direction = Unit::new_normalize(Vector3::new(n.x, n.y, n.z));
            let points = [point(found.point1), point(found.point2)];
            nearest = Ok(Near { distance: found.dist, links: [a.link, b.link], points, direction });
        }
        nearest
    }
}

fn vector(v: &Vector3<f64>) -> Vector {
    Vector::new(v.x, v.y, v.z)
}

fn point(v: Vector) -> Point3<f64> {
    Point3::new(v.x, v.y, v.z)
}

fn pose(p: &Isometry3<f64>) -> Pose {
    let q = p.rotation;
    Pose::from_parts(vector(&p.translation.vector), Rotation::from_xyzw(q.i, q.j, q.k, q.w))
}

/// The distances of all pairs at one configuration, followed from step to step.
#[derive(Debug)]
pub(crate) struct Distances {
    bodies: Arc<Bodies>,
    /// The pose of each body at the last update, and how far any of its points may have moved since the start, m.
    poses: Vec<Isometry3<f64>>,
    moved: Vec<f64>,
    known: Vec<PairDistance>,
}

/// What is known of a pair.
#[derive(Clone, Copy, Debug)]
struct PairDistance {
    /// As computed; `Err` has only a lower bound, for bodies that are far apart.
    nearest: Result<Near, f64>,
    /// How far both had moved by then, m.
    moved: f64,
}

impl Distances {
    pub(crate) fn new(bodies: &Arc<Bodies>) -> Self {
        Self {
            bodies: Arc::clone(bodies),
            poses: vec![Isometry3::identity(); bodies.bodies.len()],
            moved: vec![0.0; bodies.bodies.len()],
            // Nothing is known: the first update computes every pair.
            known: vec![PairDistance { nearest: Err(0.0), moved: f64::NEG_INFINITY }; bodies.pairs.len()],
        }
    }

    /// Takes over the poses of all links. Does not allocate.
    pub(crate) fn update(&mut self, kinematics: &Kinematics) {
        let Bodies { bodies, pairs } = &*self.bodies;
        for ((body, pose), moved) in bodies.iter().zip(&mut self.poses).zip(&mut self.moved) {
            let now = kinematics.pose(body.link);
            *moved += displacement(pose, now, body);
            *pose = *now;
        }
        for (pair, known) in pairs.iter().zip(&mut self.known) {
            let [a, b] = pair.bodies;
            let moved = self.moved[a] + self.moved[b];
            let since = moved - known.moved;
            let (distance, slack) = match known.nearest {
                Ok(near) => (near.distance, (COARSE * near.distance).max(FINE)),
                Err(distance) => (distance, (distance - FAR).max(FINE)),
            };
            if since > slack || distance.is_nan() {
                *known = PairDistance { nearest: pair.nearest(kinematics, bodies), moved };
            }
        }
    }

    /// The pairs that are nearer than `within` m.
    pub(crate) fn near(&self, within: f64) -> impl Iterator<Item = (usize, Near)> {
        let one = move |((index, known), pair): ((usize, &PairDistance), &Pair)| {
            let [a, b] = pair.bodies;
            let mut near = known.nearest.ok()?;
            near.distance -= (self.moved[a] + self.moved[b] - known.moved).max(0.0);
            (near.distance < within).then_some((index, near))
        };
        self.known.iter().enumerate().zip(&self.bodies.pairs).filter_map(one)
    }
}

/// How far any point of a body has moved at most between two poses of its link, m.
fn displacement(before: &Isometry3<f64>, now: &Isometry3<f64>, body: &MovingLinks) -> f64 {
    let (a, b) = (before.rotation.coords, now.rotation.coords);
    // A quaternion and its negative are one rotation; a chord of the turn is at most twice the quaternions' distance.
    let turned = 2.0 * (a - b).norm().min((a + b).norm());
    (before * body.center - now * body.center).norm() + body.radius * turned
}

#[cfg(test)]
mod tests {
    use super::*;

    fn armar3() -> Arc<Model> {
        Model::shipped("armar3").unwrap()
    }

    #[test]
    fn followed_distances_are_lower_bounds_and_tight() {
        let model = armar3();
        let bodies = Arc::new(Bodies::new(&model));
        let mut distances = Distances::new(&bodies);
        let mut kinematics = Kinematics::new(&model);
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let mut goal = model.zero();
        let mut q = model.zero();
        let mut seen = 0;
        for step in 0..4000 {
            if step % 400 == 0 {
                goal = model.joints().iter().map(|joint| anywhere(joint, &mut rng)).collect();
            }
            for (q, goal) in q.iter_mut().zip(&goal) {
                *q += (goal - *q).clamp(-0.003, 0.003);
            }
            kinematics.update(&q);
            distances.update(&kinematics);
            if step % 37 != 0 {
                continue;
            }
            let followed: std::collections::BTreeMap<usize, Near> = distances.near(0.2).collect();
            for (index, pair) in bodies.pairs.iter().enumerate() {
                let Ok(exact) = pair.nearest(&kinematics, &bodies.bodies) else { continue };
                if exact.distance < 0.19 {
                    let bound = followed[&index].distance;
                    assert!(bound <= exact.distance + 1e-6, "{index}: {bound} {}", exact.distance);
                    assert!(bound >= exact.distance - 0.021, "{index}: {bound} {}", exact.distance);
                    seen += 1;
                }
            }
        }
        assert!(seen > 500, "{seen}");
    }

    #[test]
    fn distances_are_those_of_geometry() {
        let body = |body_from_shape: Isometry3<f64>, shape: SharedShape| {
            let mut body = MovingLinks::new(LinkId(0), Part { link: LinkId(0), body_from_shape, shape });
            body.enclose();
            body
        };
        let ball = |x: f64| body(Isometry3::translation(x, 0.0, 0.0), SharedShape::ball(0.1));
        let (upright, shape) = convex(&Geometry::Cylinder { radius: 0.1, length: 1.0 });
        let cylinder = body(Isometry3::translation(0.0, 0.3, 0.0) * upright, shape);
        let kinematics = Kinematics::new(&armar3());
        let nearest = |a: MovingLinks, b: MovingLinks| {
            Pair { bodies: [0, 1], parts: vec![[0, 0]] }.nearest(&kinematics, &[a, b])
        };
        let near = nearest(ball(0.0), ball(0.25)).unwrap();
        assert!((near.distance - 0.05).abs() < 1e-9 && near.direction.x > 0.999, "{near:?}");
        let overlap = nearest(ball(0.0), ball(0.15)).unwrap();
        assert!((overlap.distance + 0.05).abs() < 1e-9 && overlap.direction.x > 0.999, "{overlap:?}");
        // A cylinder about z, beside the ball.
        let near = nearest(ball(0.0), cylinder).unwrap();
        assert!((near.distance - 0.1).abs() < 1e-6 && near.direction.y > 0.999, "{near:?}");
        assert_eq!(nearest(ball(0.0), ball(1.0)).unwrap_err(), 0.8);
    }

    #[test]
    fn arms_head_and_trunk_have_to_stay_apart_and_neighbours_do_not() {
        let model = armar3();
        let bodies = Bodies::new(&model);
        let name = |link: LinkId| model.links()[link.index()].name.as_str();
        let pairs: BTreeSet<[&str; 2]> = bodies.pairs().map(|links| links.map(name)).collect();
        for kept in [["wrist_2_r", "wrist_2_l"], ["head_tilt", "wrist_2_l"], ["torso", "wrist_2_r"]] {
            assert!(pairs.contains(&kept), "{kept:?}");
        }
        for left_out in [["upperarm_r", "elbow_r"], ["underarm_r", "wrist_2_r"], ["torso", "upperarm_r"]] {
            assert!(!pairs.contains(&left_out), "{left_out:?}");
        }
        assert!(!pairs.contains(&["finger_left_r", "finger_right_r"]));
    }

    #[test]
    fn pairs_that_an_srdf_disables_are_left_out() {
        let mut model = Model::clone(&armar3());
        let [head, hand] = ["head_tilt", "hand_left"].map(|name| model.require_link(name).unwrap());
        let count = Bodies::new(&Arc::new(model.clone())).pairs.len();
        model.may_touch = BTreeSet::from([[head, hand]]);
        let bodies = Bodies::new(&Arc::new(model.clone()));
        let name = |link: LinkId| model.links()[link.index()].name.as_str();
        let pairs: BTreeSet<[&str; 2]> = bodies.pairs().map(|links| links.map(name)).collect();
        assert!(!pairs.contains(&["head_tilt", "wrist_2_l"]), "the hand is the only part of that body");
        assert!(pairs.contains(&["head_tilt", "wrist_2_r"]) && pairs.contains(&["wrist_2_r", "wrist_2_l"]));
        assert_eq!(pairs.len(), count - 1);
    }
}

//! Bodies stop before each other: the robot's own ones, what its hands hold, and known boxes around it. The speed at which two of
//! them approach is bounded by the distance that is left between them, in the measured and in the commanded configuration. Pure;
//! it only limits commands.

use std::sync::Arc;

use crate::bodies::{Bodies, Distances, KEPT, Near};
use crate::seam::lease::LeaseTable;
use crate::{Kinematics, LinkId, Model};

/// From this distance on they slow down, m.
const SLOWING: f64 = 0.2;
/// Bodies that are near to each other when they become known may come nearer by this, m; never nearer than this.
const NEARER: f64 = 0.006;
/// Approaching speed per distance that is left, 1/s. From the largest speed of a TCP, 1 m/s, this brakes with at most
/// 4 m/s² and comes to rest at [`KEPT`] without overshoot.
const RATE: f64 = 4.0;

/// Watches the bodies.
#[derive(Debug)]
pub(crate) struct Clearance {
    model: Arc<Model>,
    /// The robot's own bodies, without loads and boxes.
    own: Bodies,
    bodies: Arc<Bodies>,
    measured: Distances,
    commanded: Distances,
    commanded_kinematics: Kinematics,
    /// For each pair, the limbs that move one of its bodies against the other, as indices into the lease table.
    carriers: Vec<Vec<usize>>,
    /// For each pair, the distance that it keeps, m: what is known to stand nearer when it is told is not fled from.
    kept: Vec<f64>,
    /// Whether the pairs are new, so that this is not found yet.
    renewed: bool,
    /// For each pair, whether a lease allows it to touch.
    allowed: Vec<bool>,
    /// The leases for which that was found.
    leases: Vec<Option<u64>>,
}

impl Clearance {
    pub(crate) fn new(model: &Arc<Model>) -> Self {
        let own = Bodies::new(model);
        let bodies = Arc::new(own.with(model, &std::collections::BTreeMap::new(), &[]));
        let mut clearance = Self {
            model: Arc::clone(model),
            own,
            measured: Distances::new(&bodies),
            commanded: Distances::new(&bodies),
            commanded_kinematics: Kinematics::new(model),
            carriers: Vec::new(),
            kept: Vec::new(),
            renewed: false,
            allowed: Vec::new(),
            leases: Vec::new(),
            bodies,
        };
        clearance.find_carriers();
        clearance
    }

    fn find_carriers(&mut self) {
        let model = &self.model;
        let carriers = |[a, b]: [LinkId; 2]| {
            let moves = |joints: &[usize]| joints.iter().any(|&j| model.moves(j, a) != model.moves(j, b));
            let limbs = model.limbs().values().enumerate();
            limbs.filter(|(_, limb)| moves(&limb.joints)).map(|(index, _)| index).collect()
        };
        self.carriers = self.bodies.pairs().map(carriers).collect();
        self.allowed = vec![false; self.carriers.len()];
        self.kept = vec![KEPT; self.carriers.len()];
        self.renewed = true;
    }

    /// Takes over what the hands hold, what is around the robot, and which leases there are. Allocates only where that changes.
    pub(crate) fn read(&mut self, table: &mut LeaseTable, loads_changed: bool) {
        let changed = std::mem::take(&mut table.surroundings_changed) || loads_changed;
        if changed {
            self.bodies = Arc::new(self.own.with(&self.model, &table.loads, &table.surroundings));
            self.measured = Distances::new(&self.bodies);
            self.commanded = Distances::new(&self.bodies);
            self.find_carriers();
        }
        let leases = || table.slots.iter().map(|slot| slot.held.as_ref().map(|held| held.id));
        if changed || !self.leases.iter().copied().eq(leases()) {
            self.leases.clear();
            self.leases.extend(leases());
            self.allow(table);
        }
    }

    /// Finds the pairs that leases allow: a hand and what it holds against what its lease names.
    fn allow(&mut self, table: &LeaseTable) {
        // Before known boxes, hands stop and what they hold: for the rest of an arm a path is planned.
        let all = self.bodies.hands(&self.model);
        for (pair, allowed) in self.allowed.iter_mut().enumerate() {
            let [a, b] = self.bodies.pair(pair);
            let apart = |known: usize, other: usize| !self.bodies.is_own(known) && !all.contains(&other);
            *allowed = apart(a, b) || apart(b, a);
        }
        for slot in &table.slots {
            let Some(held) = slot.held.as_ref().filter(|held| !held.touches.is_empty()) else { continue };
            let moves = |tcp: LinkId| slot.limb.joints.iter().any(|&joint| self.model.moves(joint, tcp));
            let is_hand = |arm: &&crate::Limb| arm.hand.as_ref() == Some(&slot.limb.name);
            let arms = self.model.arms();
            let arms =
                arms.filter(|arm| arm.name == slot.limb.name || is_hand(arm) || arm.tcp.is_some_and(moves));
            let hands: Vec<usize> =
                arms.filter_map(|arm| arm.tcp).flat_map(|tcp| self.bodies.beyond(&self.model, tcp)).collect();
            let named =
                |body: usize| held.touches.iter().any(|name| name == self.bodies.name(&self.model, body));
            for (pair, allowed) in self.allowed.iter_mut().enumerate() {
                let [a, b] = self.bodies.pair(pair);
                *allowed |= (hands.contains(&a) && named(b)) || (hands.contains(&b) && named(a));
            }
        }
    }

    /// Takes over the measured poses and the commanded joint positions.
    pub(crate) fn update(&mut self, measured: &Kinematics, commanded: &[f64]) {
        self.measured.update(measured);
        self.commanded_kinematics.update(commanded);
        self.commanded.update(&self.commanded_kinematics);
        if std::mem::take(&mut self.renewed) {
            for (pair, near) in self.measured.near(KEPT + NEARER) {
                self.kept[pair] = (near.distance - NEARER).clamp(NEARER, KEPT);
            }
        }
    }

    /// For each pair that approaches too fast with the joint velocities `desired`: the limbs that move it, and the
    /// factor by which they have to be slower.
    pub(crate) fn bounds<'a>(&'a self, desired: &'a [f64]) -> impl Iterator<Item = (&'a [usize], f64)> {
        let kinematics = &self.commanded_kinematics;
        let near = self.measured.near(SLOWING).chain(self.commanded.near(SLOWING));
        near.filter(|(pair, _)| !self.allowed[*pair]).filter_map(move |(pair, near)| {
            let approach = approach(kinematics, &near, desired);
            let limit = RATE * (near.distance - self.kept[pair]).max(0.0);
            (approach > limit).then(|| (self.carriers[pair].as_slice(), limit / approach))
        })
    }
}

/// The speed at which the nearest points of two bodies approach, m/s.
fn approach(kinematics: &Kinematics, near: &Near, desired: &[f64]) -> f64 {
    let [first, second] = [0, 1].map(|i| {
        let (link, point) = (near.links[i], near.points[i]);
        let in_link = kinematics.pose(link).inverse_transform_point(&point);
        kinematics.twist(link, &in_link, desired).linear
    });
    (first - second).dot(&near.direction)
}

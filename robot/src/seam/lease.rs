//! Leases: which holder commands which limb, the newest command of each, and faults.
//!
//! This file holds the data that skills and the guard share; it does not move the robot. The guard reads it once
//! per control step.

use std::collections::{BTreeMap, VecDeque};
use std::fmt;
use std::sync::Arc;

use parking_lot::{Mutex, MutexGuard};

use super::robot::Robot;
use crate::boundary::{MAX_M, MAX_NAME};
use crate::model::Limb;
use crate::model::unknown;
use crate::planning::KnownBox;
use crate::{Fault, LeaseError, LeaseLimits, Load, Model, RobotError, Sensed, SensedWrench, newest};

/// Number of utterances kept until the driver takes them; older ones are dropped.
const MAX_UTTERANCES: usize = 64;
/// Most things that one lease may touch.
const MAX_TOUCHES: usize = 100;
/// Most known boxes around the robot: each costs time in every control step.
const MAX_SURROUNDINGS: usize = 16;

/// Carries a lease's commands to its robot: in this process or over a network. Dropping it releases the limbs.
pub trait Commander: Send + Sync + fmt::Debug {
    /// Sets the joint velocities, rad/s (m/s), in the order of the limbs and of their joints.
    ///
    /// # Errors
    /// The [`Fault`] for which the limbs were taken from their commander.
    fn command(&self, velocities: &[f64]) -> Result<(), Fault>;
    /// The fault for which the limbs were taken from their commander, if any.
    fn fault(&self) -> Option<Fault>;
}

/// The exclusive right to command one or several limbs. Dropping it brakes and releases them.
///
/// The first command starts the watchdog: from then on the limbs need a command at least every 30 ms, unless all
/// velocities of the last one were zero. Limbs at rest need no commands.
#[derive(Debug)]
#[must_use = "dropping a lease brakes the limbs and releases them"]
pub struct Lease(Box<dyn Commander>);

impl Lease {
    /// A lease that commands through `commander`; for implementations of [`Robot`].
    pub fn new(commander: impl Commander + 'static) -> Self {
        Self(Box::new(commander))
    }

    /// Sets the joint velocities of its limbs, rad/s (m/s), limb after limb in their order; they apply until the next command.
    ///
    /// # Errors
    /// The [`Fault`] for which the limbs were taken from their commander. A command that is not finite or has the wrong
    /// length is such a fault. After a fault, every further command fails with the same fault and the limbs stand
    /// still.
    pub fn command(&self, velocities: &[f64]) -> Result<(), Fault> {
        self.0.command(velocities)
    }

    /// The fault for which the limbs were taken from their commander, if any.
    pub fn fault(&self) -> Option<Fault> {
        self.0.fault()
    }
}

/// The holder of a limb, and the newest command.
#[derive(Debug)]
pub(crate) struct LeaseState {
    /// Of the lease: limbs that are leased together have the same.
    pub(crate) id: u64,
    holder: String,
    /// Leases of one holder have the same number.
    pub(crate) holder_number: u64,
    pub(crate) limits: LeaseLimits,
    /// The names of what its hands may touch.
    pub(crate) touches: Arc<[String]>,
    pub(crate) velocities: Vec<f64>,
    /// Number of commands so far.
    pub(crate) sequence: u64,
    /// For the guard: the last sequence that it has seen, and when, ns.
    pub(crate) seen: (u64, u64),
    pub(crate) fault: Option<Fault>,
}

#[derive(Debug)]
pub(crate) struct LimbSlot {
    pub(crate) limb: Limb,
    pub(crate) held: Option<LeaseState>,
}

impl LimbSlot {
    /// The holder's entry, unless it has a fault.
    pub(crate) fn faultless(&self) -> Option<&LeaseState> {
        self.held.as_ref().filter(|held| held.fault.is_none())
    }

    /// Sets the fault that takes the limb from its commander; the first fault stays.
    pub(crate) fn fail(&mut self, fault: &Fault) {
        if let Some(held) = &mut self.held {
            held.fault.get_or_insert_with(|| fault.clone());
        }
    }
}

#[derive(Debug)]
pub(crate) struct LeaseTable {
    pub(crate) slots: Vec<LimbSlot>,
    pub(crate) stopped: Option<String>,
    /// Why the robot is stopped for good.
    pub(crate) ended: Option<String>,
    /// The wrench sensors whose present force is to be taken as zero, as indices into the model's.
    pub(crate) tared: Vec<usize>,
    /// What the hands hold, by their names.
    pub(crate) loads: BTreeMap<String, Load>,
    /// Whether the guard has not seen the loads yet.
    pub(crate) loads_changed: bool,
    /// What is known to stand around the robot.
    pub(crate) surroundings: Vec<KnownBox>,
    /// Whether the guard has not seen them yet.
    pub(crate) surroundings_changed: bool,
    /// By which all commanded velocities are multiplied.
    pub(crate) speed_scale: f64,
    utterances: VecDeque<String>,
    /// The number of the last lease; it changes with every new one.
    pub(crate) last_id: u64,
}

impl LeaseTable {
    fn new(slots: Vec<LimbSlot>) -> Self {
        Self {
            slots,
            stopped: None,
            ended: None,
            tared: Vec::new(),
            loads: BTreeMap::new(),
            loads_changed: false,
            surroundings: Vec::new(),
            surroundings_changed: false,
            speed_scale: 1.0,
            utterances: VecDeque::new(),
            last_id: 0,
        }
    }

    /// Limbs that are leased together have one fault.
    pub(crate) fn share_faults(&mut self) {
        for i in 0..self.slots.len() {
            let Some(held) = &self.slots[i].held else { continue };
            let (id, Some(fault)) = (held.id, held.fault.clone()) else { continue };
            let together = |slot: &&mut LimbSlot| slot.held.as_ref().is_some_and(|other| other.id == id);
            self.slots.iter_mut().filter(together).for_each(|slot| slot.fail(&fault));
        }
    }
}

/// The data that the guard and its robot share.
#[derive(Debug)]
pub(crate) struct LeaseBoard {
    pub(crate) model: Arc<Model>,
    pub(crate) sensed: newest::Sender<Arc<Sensed>>,
    leases: Mutex<LeaseTable>,
}

impl LeaseBoard {
    pub(crate) fn new(model: &Arc<Model>) -> Self {
        let slots = model.limbs().values().map(|limb| LimbSlot { limb: limb.clone(), held: None }).collect();
        let first = Sensed {
            stamp_ns: 0,
            position: model.zero(),
            velocity: vec![0.0; model.joints().len()],
            wrenches: vec![SensedWrench::default(); model.wrenches().len()],
        };
        let sensed = newest::Sender::new(Arc::new(first));
        Self { model: Arc::clone(model), sensed, leases: Mutex::new(LeaseTable::new(slots)) }
    }

    /// No lock is held across code that could panic.
    pub(crate) fn leases(&self) -> MutexGuard<'_, LeaseTable> {
        self.leases.lock()
    }

    pub(crate) fn take_utterances(&self) -> Vec<String> {
        self.leases().utterances.drain(..).collect()
    }
}

/// The robot behind a [`Guard`](crate::Guard), in this process.
#[derive(Debug)]
pub struct GuardedRobot {
    pub(crate) shared: Arc<LeaseBoard>,
}

impl GuardedRobot {
    /// By what all commanded velocities are multiplied.
    pub fn speed_scale(&self) -> f64 {
        self.shared.leases().speed_scale
    }
}

impl Robot for GuardedRobot {
    fn model(&self) -> &Arc<Model> {
        &self.shared.model
    }

    fn sensed(&self) -> newest::NewestReceiver<Arc<Sensed>> {
        self.shared.sensed.subscribe()
    }

    fn lost(&self) -> Option<String> {
        self.shared.leases().ended.clone()
    }

    fn lease_together(
        &self,
        limbs: &[&str],
        holder: &str,
        limits: LeaseLimits,
        touches: &[String],
    ) -> Result<Lease, LeaseError> {
        limits.check()?;
        let long = touches.iter().map(String::as_str).chain([holder]).any(|name| name.len() > MAX_NAME);
        if long || touches.len() > MAX_TOUCHES {
            return Err(LeaseError::Names { bytes: MAX_NAME, touches: MAX_TOUCHES });
        }
        let mut table = self.shared.leases();
        if let Some(reason) = &table.stopped {
            return Err(LeaseError::Stopped { reason: reason.clone() });
        }
        let mut wanted: Vec<usize> = Vec::new();
        for limb in limbs {
            let Some(index) = table.slots.iter().position(|s| s.limb.name == *limb) else {
                let known = table.slots.iter().map(|s| s.limb.name.as_str()).collect::<Vec<_>>().join(", ");
                return Err(LeaseError::Unknown { limb: (*limb).to_owned(), known });
            };
            // Two limbs that share a joint cannot be leased together, either.
            let joints = &table.slots[index].limb.joints;
            let shared = |&other: &usize| table.slots[other].limb.joints.iter().any(|j| joints.contains(j));
            let own = wanted.iter().copied().find(shared).map(|_| holder.to_owned());
            if let Some(holder) = holder_of(&table.slots, index).or(own) {
                return Err(LeaseError::Taken { limb: (*limb).to_owned(), holder });
            }
            wanted.push(index);
        }
        if wanted.is_empty() {
            return Err(LeaseError::Nothing);
        }
        table.last_id += 1;
        let id = table.last_id;
        let known = table.slots.iter().filter_map(|slot| slot.held.as_ref());
        let holder_number = known.filter(|held| held.holder == holder).map(|held| held.holder_number).next();
        let touches: Arc<[String]> = touches.into();
        for &index in &wanted {
            table.slots[index].held = Some(LeaseState {
                id,
                holder: holder.to_owned(),
                holder_number: holder_number.unwrap_or(id),
                limits,
                touches: Arc::clone(&touches),
                velocities: vec![0.0; table.slots[index].limb.joints.len()],
                sequence: 0,
                seen: (0, 0),
                fault: None,
            });
        }
        Ok(Lease::new(LocalCommander { shared: Arc::clone(&self.shared), limbs: wanted, id }))
    }

    fn tare(&self, wrench: &str) -> Result<(), RobotError> {
        let sensors = self.shared.model.wrenches();
        let names = sensors.iter().map(|sensor| &sensor.name);
        let index = sensors.iter().position(|sensor| sensor.name == wrench);
        let index = index.ok_or_else(|| unknown("wrench sensor", wrench, names))?;
        let mut table = self.shared.leases();
        if !table.tared.contains(&index) {
            table.tared.push(index);
        }
        Ok(())
    }

    fn set_load(&self, hand: &str, load: Option<Load>) -> Result<(), RobotError> {
        let hands = self.shared.model.hands();
        if !hands.contains_key(hand) {
            return Err(unknown("hand", hand, hands.keys()));
        }
        let mut table = self.shared.leases();
        match load {
            None => table.loads.remove(hand),
            Some(load) if load.is_physical() => table.loads.insert(hand.to_owned(), load),
            Some(Load { name, mass_kg, .. }) => return Err(RobotError::Load { name, mass_kg }),
        };
        table.loads_changed = true;
        Ok(())
    }

    fn loads(&self) -> BTreeMap<String, Load> {
        self.shared.leases().loads.clone()
    }

    fn set_surroundings(&self, boxes: Vec<KnownBox>) -> Result<(), RobotError> {
        if boxes.len() > MAX_SURROUNDINGS {
            let why = format!("{} boxes, {MAX_SURROUNDINGS} are possible", boxes.len());
            return Err(RobotError::Surroundings { why });
        }
        if let Some(bad) = boxes.iter().find(|known| !known.is_box()) {
            let name = bad.name.chars().take(MAX_NAME).collect::<String>();
            let why = format!(
                "`{name}` has an edge or a place that is no number, no edge, or over {MAX_M} m, or a name over {MAX_NAME} bytes"
            );
            return Err(RobotError::Surroundings { why });
        }
        let mut table = self.shared.leases();
        if table.surroundings != boxes {
            table.surroundings = boxes;
            table.surroundings_changed = true;
        }
        Ok(())
    }

    fn stop(&self, reason: &str) {
        let mut table = self.shared.leases();
        let reason = table.stopped.get_or_insert_with(|| reason.to_owned()).clone();
        for slot in &mut table.slots {
            slot.fail(&Fault::Stopped { reason: reason.clone() });
        }
    }

    fn reset(&self) {
        let mut table = self.shared.leases();
        table.stopped = table.ended.clone();
    }

    fn set_speed_scale(&self, scale: f64) -> Result<(), RobotError> {
        if !(scale > 0.0 && scale <= 1.0) {
            return Err(RobotError::SpeedScale { scale });
        }
        self.shared.leases().speed_scale = scale;
        Ok(())
    }

    fn say(&self, utterance: &str) {
        let mut table = self.shared.leases();
        if table.utterances.len() == MAX_UTTERANCES {
            table.utterances.pop_front();
        }
        table.utterances.push_back(utterance.to_owned());
    }
}

/// The holder of this limb or of one that shares a joint with it.
fn holder_of(slots: &[LimbSlot], index: usize) -> Option<String> {
    let wanted = &slots[index].limb.joints;
    slots.iter().find_map(|slot| {
        let held = slot.held.as_ref()?;
        slot.limb.joints.iter().any(|j| wanted.contains(j)).then(|| held.holder.clone())
    })
}

/// The commander of a lease in this process.
#[derive(Debug)]
struct LocalCommander {
    shared: Arc<LeaseBoard>,
    /// Its limbs, as indices into the lease table, in the order of its commands. Their entries live as long as the lease.
    limbs: Vec<usize>,
    id: u64,
}

impl LocalCommander {
    fn fault_in(&self, table: &LeaseTable) -> Option<Fault> {
        self.limbs.iter().find_map(|&index| table.slots[index].held.as_ref()?.fault.clone())
    }
}

impl Commander for LocalCommander {
    fn command(&self, velocities: &[f64]) -> Result<(), Fault> {
        let mut table = self.shared.leases();
        if let Some(fault) = self.fault_in(&table) {
            return Err(fault);
        }
        let limbs: Vec<&Limb> = self.limbs.iter().map(|&index| &table.slots[index].limb).collect();
        if let Some(fault) = bad_command(velocities, &limbs, &self.shared.model) {
            self.limbs.iter().for_each(|&index| table.slots[index].fail(&fault));
            return Err(fault);
        }
        let mut rest = velocities;
        for &index in &self.limbs {
            let slot = &mut table.slots[index];
            let (own, others) = rest.split_at(slot.limb.joints.len());
            if let Some(held) = &mut slot.held {
                held.velocities.copy_from_slice(own);
                held.sequence += 1;
            }
            rest = others;
        }
        Ok(())
    }

    fn fault(&self) -> Option<Fault> {
        self.fault_in(&self.shared.leases())
    }
}

/// What is wrong with a command for limbs, if anything.
pub(super) fn bad_command(velocities: &[f64], limbs: &[&Limb], model: &Model) -> Option<Fault> {
    let commanded = || limbs.iter().flat_map(|limb| &limb.joints);
    let (expected, got) = (commanded().count(), velocities.len());
    if expected != got {
        let names: Vec<&str> = limbs.iter().map(|limb| limb.name.as_str()).collect();
        return Some(Fault::WrongLength { limb: names.join(" and "), expected, got });
    }
    let (_, bad) = velocities.iter().zip(commanded()).find(|(v, _)| !v.is_finite())?;
    Some(Fault::NotFinite { joint: model.joints()[*bad].name.clone() })
}

impl Drop for LocalCommander {
    fn drop(&mut self) {
        let mut table = self.shared.leases();
        for &index in &self.limbs {
            let slot = &mut table.slots[index];
            slot.held.take_if(|held| held.id == self.id);
        }
    }
}

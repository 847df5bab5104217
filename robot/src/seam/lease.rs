//! Leases: which holder commands which limb, the newest command of each, and faults.
//!
//! This file holds the data that skills and the guard share; it does not move the robot. The guard reads it once
//! per control step.

use std::collections::{BTreeMap, VecDeque};
use std::fmt;
use std::sync::Arc;

use parking_lot::{Mutex, MutexGuard};

use super::robot::Robot;
use crate::model::Limb;
use crate::model::unknown;
use crate::{Fault, LeaseError, LeaseLimits, Load, Model, RobotError, Sensed, SensedWrench, newest};

/// Number of utterances kept until the driver takes them; older ones are dropped.
const MAX_UTTERANCES: usize = 64;

/// Carries a lease's commands to its robot: in this process or over a network. Dropping it releases the limb.
pub trait Commander: Send + Sync + fmt::Debug {
    /// Sets the joint velocities, rad/s (m/s), in the limb's order.
    ///
    /// # Errors
    /// The [`Fault`] for which the limb was taken from its commander.
    fn command(&self, velocities: &[f64]) -> Result<(), Fault>;
    /// The fault for which the limb was taken from its commander, if any.
    fn fault(&self) -> Option<Fault>;
}

/// The exclusive right to command one limb. Dropping it brakes the limb and releases it.
///
/// The first command starts the watchdog: from then on the limb needs a command at least every 30 ms, unless all
/// velocities of the last one were zero. A limb at rest needs no commands.
#[derive(Debug)]
#[must_use = "dropping a lease brakes the limb and releases it"]
pub struct Lease(Box<dyn Commander>);

impl Lease {
    /// A lease that commands through `commander`; for implementations of [`Robot`].
    pub fn new(commander: impl Commander + 'static) -> Self {
        Self(Box::new(commander))
    }

    /// Sets the limb's joint velocities, rad/s (m/s), in limb order; they apply until the next command.
    ///
    /// # Errors
    /// The [`Fault`] for which the limb was taken from its commander. A command that is not finite or has the wrong
    /// length is such a fault. After a fault, every further command fails with the same fault and the limb stands
    /// still.
    pub fn command(&self, velocities: &[f64]) -> Result<(), Fault> {
        self.0.command(velocities)
    }

    /// The fault for which the limb was taken from its commander, if any.
    pub fn fault(&self) -> Option<Fault> {
        self.0.fault()
    }
}

/// The holder of a limb, and the newest command.
#[derive(Debug)]
pub(crate) struct LeaseState {
    id: u64,
    holder: String,
    /// Leases of one holder have the same number.
    pub(crate) holder_number: u64,
    pub(crate) limits: LeaseLimits,
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

#[derive(Debug, Default)]
pub(crate) struct LeaseTable {
    pub(crate) slots: Vec<LimbSlot>,
    pub(crate) stopped: Option<String>,
    /// The wrench sensors whose present force is to be taken as zero, as indices into the model's.
    pub(crate) tared: Vec<usize>,
    /// What the hands hold, by their names.
    pub(crate) loads: BTreeMap<String, Load>,
    /// Whether the guard has not seen the loads yet.
    pub(crate) loads_changed: bool,
    utterances: VecDeque<String>,
    next_id: u64,
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
        Self {
            model: Arc::clone(model),
            sensed,
            leases: Mutex::new(LeaseTable { slots, ..LeaseTable::default() }),
        }
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

impl Robot for GuardedRobot {
    fn model(&self) -> &Arc<Model> {
        &self.shared.model
    }

    fn sensed(&self) -> newest::Receiver<Arc<Sensed>> {
        self.shared.sensed.subscribe()
    }

    fn lease(&self, limb: &str, holder: &str, limits: LeaseLimits) -> Result<Lease, LeaseError> {
        let mut table = self.shared.leases();
        if let Some(reason) = &table.stopped {
            return Err(LeaseError::Stopped { reason: reason.clone() });
        }
        let Some(index) = table.slots.iter().position(|s| s.limb.name == limb) else {
            let known = table.slots.iter().map(|s| s.limb.name.as_str()).collect::<Vec<_>>().join(", ");
            return Err(LeaseError::Unknown { limb: limb.to_owned(), known });
        };
        if let Some(holder) = holder_of(&table.slots, index) {
            return Err(LeaseError::Taken { limb: limb.to_owned(), holder });
        }
        table.next_id += 1;
        let id = table.next_id;
        let known = table.slots.iter().filter_map(|slot| slot.held.as_ref());
        let holder_number = known.filter(|held| held.holder == holder).map(|held| held.holder_number).next();
        table.slots[index].held = Some(LeaseState {
            id,
            holder: holder.to_owned(),
            holder_number: holder_number.unwrap_or(id),
            limits,
            velocities: vec![0.0; table.slots[index].limb.joints.len()],
            sequence: 0,
            seen: (0, 0),
            fault: None,
        });
        Ok(Lease::new(LocalCommander { shared: Arc::clone(&self.shared), index, id }))
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

    fn stop(&self, reason: &str) {
        let mut table = self.shared.leases();
        let reason = table.stopped.get_or_insert_with(|| reason.to_owned()).clone();
        for slot in &mut table.slots {
            slot.fail(&Fault::Stopped { reason: reason.clone() });
        }
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
    index: usize,
    id: u64,
}

impl LocalCommander {
    /// Runs `f` on this lease's entry in the table, which lives as long as the lease.
    fn with<T>(&self, f: impl FnOnce(&Limb, &mut LeaseState) -> T) -> Option<T> {
        let mut table = self.shared.leases();
        let slot = &mut table.slots[self.index];
        let held = slot.held.as_mut().filter(|held| held.id == self.id)?;
        Some(f(&slot.limb, held))
    }
}

impl Commander for LocalCommander {
    fn command(&self, velocities: &[f64]) -> Result<(), Fault> {
        let joints = self.shared.model.joints();
        self.with(|limb, held| {
            if let Some(fault) = &held.fault {
                return Err(fault.clone());
            }
            if let Some(fault) = bad_command(velocities, limb, joints) {
                held.fault = Some(fault.clone());
                return Err(fault);
            }
            held.velocities.copy_from_slice(velocities);
            held.sequence += 1;
            Ok(())
        })
        .unwrap_or(Ok(()))
    }

    fn fault(&self) -> Option<Fault> {
        self.with(|_, held| held.fault.clone()).flatten()
    }
}

fn bad_command(velocities: &[f64], limb: &Limb, joints: &[crate::Joint]) -> Option<Fault> {
    let (expected, got) = (limb.joints.len(), velocities.len());
    if expected != got {
        return Some(Fault::WrongLength { limb: limb.name.clone(), expected, got });
    }
    let bad = velocities.iter().position(|v| !v.is_finite())?;
    Some(Fault::NotFinite { joint: joints[limb.joints[bad]].name.clone() })
}

impl Drop for LocalCommander {
    fn drop(&mut self) {
        let mut table = self.shared.leases();
        let slot = &mut table.slots[self.index];
        if slot.held.as_ref().is_some_and(|held| held.id == self.id) {
            slot.held = None;
        }
    }
}

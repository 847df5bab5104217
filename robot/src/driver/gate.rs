//! Whose targets a driver takes, and which of them. Pure: times are handed in.
//!
//! One commander at a time has the driver: who has claimed it, until he releases it, or has been silent for so long that
//! another may claim it. Of his targets those count that answer a recent sample, in the order of the samples. After the joints have
//! braked by themselves, only targets that were computed by somebody who knows that count.

use armarium_bus::CodecError;

use super::DriverClock;
use super::wire::{Claim, WireTargets};
use crate::JointTargets;

/// After so long without targets another commander may claim the driver, ns.
const SILENCE_NS: u64 = 1_000_000_000;
/// How long a driver waits for targets before it brakes, ns.
pub(super) const WATCHDOG_NS: u64 = 50_000_000;
/// Longest name of a commander or a caller, bytes.
const MAX_NAME: usize = 200;

/// Why a claim or targets are refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(super) enum GateRefusal {
    #[error("it is commanded by `{by}`")]
    Commanded { by: String },
    #[error("a commander has a name of 1 to {MAX_NAME} bytes, a caller one of at most so many")]
    Name,
    #[error("targets of somebody who has not claimed the driver")]
    NotClaimed,
    #[error("targets of somebody else than `{by}`, who has claimed the driver")]
    Stranger { by: String },
    #[error("targets for another start of the driver")]
    Epoch,
    #[error("targets for the sample {number}, which has not been sent")]
    Ahead { number: u64 },
    #[error("targets for the sample {number}, which was answered, or is older than that")]
    Answered { number: u64 },
    #[error("targets for a sample that is {age_ms} ms old")]
    Late { age_ms: u64 },
    #[error("targets for a sample from before the joints braked")]
    Braked,
    #[error("targets with {positions} positions and {velocities} velocities for {joints} joints")]
    Shape { positions: usize, velocities: usize, joints: usize },
    #[error("targets that are not finite numbers")]
    NotFinite,
    /// Something else than what is expected has come.
    #[error(transparent)]
    Message(#[from] CodecError),
}

#[derive(Debug)]
struct Commander {
    id: String,
    /// For people.
    caller: String,
    /// When he was heard of last, ns.
    heard_ns: u64,
}

#[derive(Debug)]
pub(super) struct Gate {
    joints: usize,
    clock: DriverClock,
    period_ns: u64,
    epoch: u64,
    commander: Option<Commander>,
    /// How often it was claimed.
    claims: u64,
    /// The number of the newest sample.
    newest: u64,
    /// The number of the last sample that was answered by the commander.
    answered: Option<u64>,
    /// The first sample that says that the joints have braked, if they have.
    braked_since: Option<u64>,
    /// The targets that were taken and not been fetched yet.
    taken: Option<JointTargets>,
    /// Why targets were refused.
    refused: Option<GateRefusal>,
}

impl Gate {
    pub(super) fn new(joints: usize, clock: DriverClock, period_ns: u64, epoch: u64) -> Self {
        let braked_since = (clock == DriverClock::Realtime).then_some(0);
        Self {
            joints,
            clock,
            period_ns: period_ns.max(1),
            epoch,
            commander: None,
            claims: 0,
            newest: 0,
            answered: None,
            braked_since,
            taken: None,
            refused: None,
        }
    }

    /// A sample is about to be sent. Returns whether its joints have braked by themselves, and why targets were refused.
    pub(super) fn begin_sample(&mut self, number: u64, now_ns: u64) -> (bool, Option<GateRefusal>) {
        self.newest = number;
        let silent =
            self.commander.as_ref().is_none_or(|by| now_ns.saturating_sub(by.heard_ns) > WATCHDOG_NS);
        if silent && self.clock == DriverClock::Realtime {
            self.brake(number);
        }
        (self.braked_since.is_some(), self.refused.take())
    }

    fn brake(&mut self, number: u64) {
        self.braked_since.get_or_insert(number);
        self.taken = None;
    }

    /// Somebody asks for the right to send targets.
    pub(super) fn claim(&mut self, claim: Claim, now_ns: u64) -> Result<(), GateRefusal> {
        if claim.commander.is_empty() || claim.commander.len().max(claim.caller.len()) > MAX_NAME {
            return Err(GateRefusal::Name);
        }
        let other = self.commander.as_ref().filter(|by| by.id != claim.commander);
        if let Some(by) = other.filter(|by| now_ns.saturating_sub(by.heard_ns) <= SILENCE_NS) {
            return Err(GateRefusal::Commanded { by: by.caller.clone() });
        }
        self.claims += 1;
        self.commander = Some(Commander { id: claim.commander, caller: claim.caller, heard_ns: now_ns });
        self.give_up_last();
        Ok(())
    }

    /// How often it was claimed.
    pub(super) fn claims(&self) -> u64 {
        self.claims
    }

    /// The commander gives the right back.
    pub(super) fn release(&mut self, commander: &str) {
        if self.commander.take_if(|by| by.id == commander).is_some() {
            self.give_up_last();
        }
    }

    /// What the last commander wanted does not count any more.
    fn give_up_last(&mut self) {
        (self.answered, self.taken) = (None, None);
        if self.clock == DriverClock::Realtime {
            self.brake(self.newest + 1);
        }
    }

    /// Targets have come; what is refused is said in the next sample.
    pub(super) fn offer(&mut self, targets: WireTargets, now_ns: u64) {
        match self.check(&targets) {
            Ok(()) => {
                self.answered = Some(targets.number);
                self.braked_since = None;
                let WireTargets { position, velocity, .. } = targets;
                self.taken = Some(JointTargets { position, velocity });
                self.commander.iter_mut().for_each(|by| by.heard_ns = now_ns);
            }
            Err(reason) => self.refuse(reason),
        }
    }

    /// Something else than targets has come in their place.
    pub(super) fn refuse(&mut self, reason: GateRefusal) {
        self.refused = Some(reason);
    }

    /// The targets that have come since the last call.
    pub(super) fn take(&mut self) -> Option<JointTargets> {
        self.taken.take()
    }

    fn check(&self, targets: &WireTargets) -> Result<(), GateRefusal> {
        let WireTargets { commander, epoch, number, position, velocity } = targets;
        let by = self.commander.as_ref().ok_or(GateRefusal::NotClaimed)?;
        let (number, joints, age) = (*number, self.joints, self.newest.saturating_sub(*number));
        let age_ns = age.saturating_mul(self.period_ns);
        let shape = || GateRefusal::Shape { positions: position.len(), velocities: velocity.len(), joints };
        match () {
            () if by.id != *commander => Err(GateRefusal::Stranger { by: by.caller.clone() }),
            () if *epoch != self.epoch => Err(GateRefusal::Epoch),
            () if number > self.newest => Err(GateRefusal::Ahead { number }),
            () if self.answered.is_some_and(|answered| number <= answered) => {
                Err(GateRefusal::Answered { number })
            }
            () if age_ns > WATCHDOG_NS => Err(GateRefusal::Late { age_ms: age_ns / 1_000_000 }),
            () if self.braked_since.is_some_and(|since| number < since) => Err(GateRefusal::Braked),
            () if position.len() != joints || velocity.len() != joints => Err(shape()),
            () if !position.iter().chain(velocity).all(|value| value.is_finite()) => {
                Err(GateRefusal::NotFinite)
            }
            () => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    fn targets(commander: &str, number: u64) -> WireTargets {
        let (position, velocity) = (vec![0.1, 0.2], vec![0.0, 0.0]);
        WireTargets { commander: commander.into(), epoch: 7, number, position, velocity }
    }

    fn claim(commander: &str) -> Claim {
        Claim { commander: commander.into(), caller: commander.into() }
    }

    /// A driver of two joints in real time that `a` has claimed, and that has sent the samples 0 to 100.
    fn gate() -> Gate {
        let mut gate = Gate::new(2, DriverClock::Realtime, MS, 7);
        gate.claim(claim("a"), 0).unwrap();
        (0..=100).for_each(|number| drop(gate.begin_sample(number, MS)));
        gate.offer(targets("a", 90), MS);
        assert!(gate.take().is_some());
        gate
    }

    #[test]
    fn targets_that_do_not_fit_are_refused_with_a_reason() {
        let with = |change: fn(&mut WireTargets)| {
            let mut changed = targets("a", 95);
            change(&mut changed);
            changed
        };
        for (offered, reason) in [
            (targets("b", 95), "somebody else than `a`"),
            (targets("a", 90), "which was answered"),
            (targets("a", 89), "or is older than that"),
            (targets("a", 101), "has not been sent"),
            (with(|t| t.epoch = 6), "another start"),
            (with(|t| t.position.push(0.0)), "3 positions and 2 velocities for 2 joints"),
            (with(|t| t.velocity[1] = f64::NAN), "not finite"),
            (with(|t| t.position[0] = f64::INFINITY), "not finite"),
        ] {
            let mut gate = gate();
            gate.offer(offered.clone(), MS);
            assert!(gate.take().is_none(), "{offered:?}");
            let (_, refused) = gate.begin_sample(101, MS);
            assert!(
                refused.as_ref().is_some_and(|said| said.to_string().contains(reason)),
                "{refused:?} {reason}"
            );
            gate.offer(targets("a", 101), MS);
            assert!(gate.take().is_some(), "what fits is taken after {reason}");
        }
        let mut late = gate();
        (101..=160).for_each(|number| drop(late.begin_sample(number, MS)));
        late.offer(targets("a", 101), MS);
        assert!(late.begin_sample(161, MS).1.unwrap().to_string().contains("a sample that is 59 ms old"));
    }

    #[test]
    fn after_it_has_braked_only_who_knows_that_commands() {
        let mut gate = gate();
        assert!(!gate.begin_sample(101, 51 * MS).0);
        assert!(gate.begin_sample(102, 52 * MS).0, "51 ms after the last targets");
        gate.offer(targets("a", 101), 52 * MS);
        assert!(gate.take().is_none());
        assert!(
            gate.begin_sample(103, 53 * MS).1.unwrap().to_string().contains("from before the joints braked")
        );
        gate.offer(targets("a", 102), 53 * MS);
        assert!(gate.take().is_some() && !gate.begin_sample(104, 54 * MS).0);
    }

    #[test]
    fn a_driver_has_one_commander_until_he_is_silent() {
        let mut gate = gate();
        assert_eq!(gate.claim(claim("b"), 1000 * MS), Err(GateRefusal::Commanded { by: "a".into() }));
        for nobody in ["", &"x".repeat(201)] {
            assert_eq!(gate.claim(claim(nobody), 5000 * MS), Err(GateRefusal::Name));
        }
        assert_eq!(gate.claim(claim("a"), 1000 * MS), Ok(()), "who asks again has it still");
        assert_eq!(gate.claim(claim("b"), 2002 * MS), Ok(()));
        assert!(gate.begin_sample(101, 2002 * MS).0, "a new commander begins with joints that stand");
        gate.offer(targets("a", 101), 2002 * MS);
        assert!(gate.take().is_none());
        gate.release("a");
        gate.offer(targets("b", 101), 2002 * MS);
        assert!(gate.take().is_some(), "only who has it can give it back");
        gate.release("b");
        assert_eq!(gate.claim(claim("a"), 2003 * MS), Ok(()));
    }
}

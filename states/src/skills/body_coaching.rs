//! `BodyCoaching`: a person's arms change the running motion. The right arm pushes the near part of the path away along the forearm,
//! the left arm draws it towards the elbow; the arm whose wrist is nearer to the hand that executes the motion is the one that acts.
//!
//! It sees the person by the channel `person` alone.
//!
//! # Source
//! Petrič et al. 2014, eqs. (18) to (21), [`armarium_motion::nearer_hand`]; differs in: an arm acts only while it is ready, and has been for a
//! moment: raised, near, and seen exactly enough.

use armarium_motion::{CoachArm, CoachInput, CoachingCommand, nearer_hand};
use armarium_runtime::skill::{Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Unit, Value};
use nalgebra::Vector3;

use crate::coaching::Coaching;
use crate::equipment::{self, Equipment};
use crate::inputs::as_vector;

/// A person of whom no picture has come for this long shows nothing any more, s.
const WITHOUT_PICTURES: f64 = 0.7;
/// A joint that is known less exactly than this is not taken for where it is: standard deviation, m.
const UNKNOWN: f64 = 0.08;
/// Time constant with which the direction of an arm is smoothed, s; one that differs by more than 60 degrees is another's.
const SMOOTHING: f64 = 0.6;
const OTHER: f64 = 0.5;
/// An arm acts when it has been ready for this long, s.
const READY: f64 = 0.4;
/// More is not counted, s; while it is not ready, what was counted goes down half as fast.
const MOST_READY: f64 = 1.0;
/// A forearm that points down more steeply than this hangs: the cosine between it and the vertical.
const HANGS: f64 = 0.6;

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new(
        "BodyCoaching",
        "Changes the running motion as a person's arms say: the right one pushes, the left one pulls.",
    )
    .input("motion", Type::motion(), "The running motion.")
    .optional("distance", Type::quantity(Unit::M), 0.1, "How far before the wrist an arm acts.")
    .optional(
        "within",
        Type::quantity(Unit::M),
        0.45,
        "An arm acts while its wrist is so near to the hand that executes the motion.",
    )
    .optional("patience", Type::Duration, 60.0, "Ends when no arm has acted for this long.")
    .output("displacement", Type::FLOAT, "How far the path has moved where it moved most, m.")
    .reads("person")
    .reads("motion")
    .attends_pattern("HumanPoses/*/*", 0.1, 1.0);
    equipment::skill(equipment, manifest, run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let (distance, within) = (context.number("distance")?, context.number("within")?);
    let patience = context.number("patience")?;
    let mut coaching = Coaching::begin_in_space(&equipment, &context)?;
    let _both_are_wanted = ["person", "motion"].map(|name| context.channels.demand(name));
    let mut direction: Option<Vector3<f64>> = None;
    let mut readiness = Readiness::default();
    loop {
        let dt = coaching.next().await?;
        let person = context.channels.newest("person");
        let person = person.filter(|s| s.at.elapsed().as_secs_f64() < WITHOUT_PICTURES).map(|s| s.value);
        let hand =
            context.channels.newest("motion").and_then(|s| s.value.get("position").and_then(as_vector));
        let command = person.zip(hand).and_then(|(person, hand)| command(&person, &hand, (distance, within)));
        let is_ready = readiness.update(command.is_some(), dt);
        let command = command.filter(|_| is_ready);
        direction = command.map(|CoachingCommand { d, .. }| match direction {
            Some(before) if before.dot(&d) > OTHER * before.norm() => {
                before + (d - before) * (1.0 - libm::exp(-dt / SMOOTHING))
            }
            _ => d,
        });
        let input = match command.zip(direction) {
            Some((CoachingCommand { o, .. }, direction)) => CoachInput::Along { at: o, direction },
            None => CoachInput::None,
        };
        coaching.apply(dt, input)?;
        if let Some(outcome) = coaching.ended(patience) {
            return Ok(outcome);
        }
    }
}

/// For how long an arm has been ready, s.
#[derive(Default)]
struct Readiness(f64);

impl Readiness {
    /// After `dt` s more in which an arm was ready or not: whether one has been for long enough.
    fn update(&mut self, is_ready: bool, dt: f64) -> bool {
        let change = if is_ready { dt } else { -dt / 2.0 };
        self.0 = (self.0 + change).clamp(0.0, MOST_READY);
        self.0 >= READY
    }
}

/// What the person's arms say to a hand (root frame, m), if one of them is ready.
fn command(person: &Value, hand: &Vector3<f64>, (distance, within): (f64, f64)) -> Option<CoachingCommand> {
    let joint = |name: &str| {
        let rows = person.get("covariances")?.get(name)?.as_list()?;
        let spread = rows.iter().step_by(4).filter_map(Value::as_f64).fold(0.0, f64::max);
        let at = person.get("keypoints")?.get(name).and_then(as_vector)?;
        (spread < UNKNOWN * UNKNOWN).then_some(at)
    };
    let arm = |wrist: &str, elbow: &str| {
        let arm = CoachArm { wrist: joint(wrist)?, elbow: joint(elbow)? };
        is_ready(&arm, hand, within).then_some(arm)
    };
    // An arm that is not ready is nowhere near.
    let away = CoachArm { wrist: Vector3::repeat(f64::MAX.sqrt()), elbow: Vector3::zeros() };
    let [right, left] =
        [("right_wrist", "right_elbow"), ("left_wrist", "left_elbow")].map(|(w, e)| arm(w, e));
    if right.is_none() && left.is_none() {
        return None;
    }
    nearer_hand(&right.unwrap_or(away), &left.unwrap_or(away), hand, distance)
}

/// Whether an arm is raised and near.
fn is_ready(arm: &CoachArm, hand: &Vector3<f64>, within: f64) -> bool {
    let forearm = (arm.wrist - arm.elbow).try_normalize(1e-6);
    (arm.wrist - hand).norm() < within && forearm.is_some_and(|forearm| -forearm.z < HANGS)
}

#[cfg(test)]
mod tests {
    use armarium_values::{Frame, Vector};

    use super::*;

    fn person(joints: &[(&str, [f64; 3])], deviation: f64) -> Value {
        let at = |place: &[f64; 3]| Value::Vector(Vector::new(Frame::root(), &Vector3::from(*place)));
        let of_each = |value: &dyn Fn(&[f64; 3]) -> Value| {
            Value::Map(joints.iter().map(|(name, place)| ((*name).to_owned(), value(place))).collect())
        };
        let variance = deviation * deviation;
        let rows = vec![variance, 0.0, 0.0, 0.0, variance, 0.0, 0.0, 0.0, variance];
        let covariances = of_each(&|_| Value::from(rows.clone()));
        Value::record([("keypoints", of_each(&at)), ("covariances", covariances)])
    }

    #[test]
    fn an_arm_that_seems_ready_for_a_moment_does_not_act() {
        let mut readiness = Readiness::default();
        // A picture in ten shows a hanging arm as ready.
        assert!((0..10_000).all(|i| !readiness.update(i % 670 < 67, 1e-3)));
        let mut readiness = Readiness::default();
        let acts = |readiness: &mut Readiness, shown: bool| {
            (0..2000).filter(|_| readiness.update(shown, 1e-3)).count()
        };
        assert!((1599..=1601).contains(&acts(&mut readiness, true)), "from 0.4 s on");
        assert!((1199..=1201).contains(&acts(&mut readiness, false)), "and 1.2 s longer");
    }

    #[test]
    fn the_right_arm_pushes_the_left_one_pulls_and_a_hanging_one_does_nothing() {
        let hand = Vector3::new(0.3, 0.5, 1.1);
        let told = |joints: &[(&str, [f64; 3])]| command(&person(joints, 0.03), &hand, (0.1, 0.4));
        let right = [("right_elbow", [0.3, 1.0, 1.1]), ("right_wrist", [0.3, 0.75, 1.1])];
        let pushed = told(&right).unwrap();
        assert!((pushed.d + Vector3::y()).norm() < 1e-9 && (pushed.o.y - 0.65).abs() < 1e-9);
        let left = [("left_elbow", [0.3, 1.0, 1.1]), ("left_wrist", [0.3, 0.75, 1.1])];
        let pulled = told(&left).unwrap();
        assert!((pulled.d - Vector3::y()).norm() < 1e-9 && (pulled.o.y - 0.65).abs() < 1e-9);
        let hangs = [("right_elbow", [0.3, 0.75, 1.3]), ("right_wrist", [0.3, 0.72, 1.1])];
        assert_eq!(told(&hangs), None);
        assert_eq!(told(&[&hangs[..], &left[..]].concat()), Some(pulled));
        let far = [("right_elbow", [0.3, 1.4, 1.1]), ("right_wrist", [0.3, 1.1, 1.1])];
        assert_eq!(told(&far), None);
        assert_eq!(command(&person(&right, 0.12), &hand, (0.1, 0.4)), None, "it is guessed");
        assert_eq!(command(&Value::record([("seen", Value::Bool(false))]), &hand, (0.1, 0.4)), None);
    }
}

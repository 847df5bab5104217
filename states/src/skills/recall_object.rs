//! `RecallObject`: reads an object's pose from memory: the newest detection by this agent or by one that it
//! follows.
//!
//! It does not use the cameras. It ignores poses in the frame of another agent whose own pose is unknown, and the
//! pose of an object that a hand has taken away since.

use std::sync::Arc;

use armarium_knowledge::Origin;
use armarium_memoryx::Snapshot;
use armarium_runtime::skill::{Failure, Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Value};
use nalgebra::Isometry3;

use crate::arm::{Senses, seconds};
use crate::equipment::{self, Equipment};
use crate::inputs::{pose_value, reference};
use crate::motions::failed;
use crate::places::Remembered;

/// Interval of the memory queries, s.
const POLL_INTERVAL: f64 = 0.1;

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new(
        "RecallObject",
        "Finds where an object is in memory, whoever saw it last, and waits for somebody who does.",
    )
    .input("object", Type::String, "Object class in prior knowledge.")
    .optional("max_age", Type::Duration, 10.0, "How long ago it may have been seen.")
    .optional("timeout", Type::Duration, 5.0, "How long to wait for somebody who sees it.")
    .output("object", Type::object(), "The object in memory.")
    .output("pose", Type::Pose, "Its pose in the root frame.")
    .output("told_by", Type::String, "The agent who saw it.");
    equipment::skill(equipment, manifest, run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let class = context.text("object")?;
    let (max_age, timeout) = (context.number("max_age")?, context.number("timeout")?);
    let mut senses = Senses::new(&*equipment.robot, &context);
    let (mut waited, mut asked) = (0.0, f64::NEG_INFINITY);
    loop {
        let (sample, dt) = senses.next().await?;
        waited += dt;
        if waited - asked < POLL_INTERVAL {
            continue;
        }
        asked = waited;
        let known = equipment.memory.segment("ObjectInstances").await.map_err(failed)?;
        match newest(equipment.remembered(), &known, class, sample.stamp_ns, max_age) {
            Ok((snapshot, pose)) => {
                return Ok(Outcome::success()
                    .with("object", reference("Object", &snapshot.id))
                    .with("pose", pose_value(&pose))
                    .with("told_by", Origin::agent_of(snapshot).unwrap_or(&equipment.agent)));
            }
            Err(why) if waited > timeout => {
                return Err(Failure::new(format!("{why}; waited {timeout:.0} s")));
            }
            Err(_) => {}
        }
    }
}

/// The snapshot with the newest reference time among the objects of a class, at `now_ns`, and its pose in the root frame.
fn newest<'k>(
    remembered: Remembered<'_>,
    known: &'k [Arc<Snapshot>],
    class: &str,
    now_ns: u64,
    max_age: f64,
) -> Result<(&'k Snapshot, Isometry3<f64>), Failure> {
    let of_class = known.iter().filter(|s| s.attribute("class").and_then(Value::as_str) == Some(class));
    let newest = of_class.max_by_key(|s| s.referenced_ns).ok_or_else(|| {
        Failure::new(format!(
            "nobody has told where an object `{class}` is; is an agent who sees it followed, and does it run?"
        ))
    })?;
    let (age_s, id) = (seconds(newest.referenced_ns, now_ns), &newest.id);
    if let Some(by) = newest.attribute("attached_to").and_then(Value::as_str) {
        return Err(Failure::new(format!("`{class}` is in the hand `{by}`")));
    }
    if age_s > max_age {
        return Err(Failure::new(format!(
            "the newest that is known of `{class}` (`{id}`) is {age_s:.1} s old, over {max_age:.1} s"
        )));
    }
    let pose = remembered.root_pose(newest).ok_or_else(|| {
        Failure::new(format!(
            "`{id}` has no pose in the root frame: it is not known where the agent stands who saw it"
        ))
    })?;
    Ok((newest, pose))
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use armarium_knowledge::WORLD;
    use armarium_memoryx::{Instance, Snapshot, tokio_clock};
    use armarium_values::transforms::Transforms;
    use armarium_values::{Frame, Pose};
    use parking_lot::RwLock;

    use super::*;

    const SECOND: u64 = 1_000_000_000;

    fn sponge(provider: &str, at_s: u64, frame: &str, x: f64, held: bool) -> Arc<Snapshot> {
        let pose = Value::Pose(Pose::new(frame.into(), &Isometry3::translation(x, 0.0, 0.0)));
        let mut attributes = BTreeMap::from([("class".into(), Value::from("sponge")), ("pose".into(), pose)]);
        if held {
            attributes.insert("attached_to".into(), Value::from("bob/right_hand"));
        }
        if let Some((agent, _)) = provider.split_once('.') {
            attributes.insert("origin".into(), Value::record([("agent", Value::from(agent))]));
        }
        Arc::new(Snapshot {
            id: format!("ObjectInstances/{provider}/sponge").parse().unwrap(),
            version: 1,
            referenced_ns: at_s * SECOND,
            sent_ns: 0,
            arrived_ns: 0,
            instances: vec![Instance::new(attributes)],
        })
    }

    /// [`newest`] of a robot that stands 0.3 m to the right of the world's origin, if it was seen in the last 5 s.
    fn newest<'k>(
        known: &'k [Arc<Snapshot>],
        class: &str,
        now_s: u64,
    ) -> Result<(&'k Snapshot, Isometry3<f64>), Failure> {
        let mut transforms = Transforms::new();
        let stands = Pose::new(WORLD.into(), &Isometry3::translation(0.3, 0.0, 0.0));
        transforms.fix(&Frame::root(), &stands).unwrap();
        let (memory, transforms) =
            (armarium_knowledge::working_memory(tokio_clock()), RwLock::new(transforms));
        super::newest(
            Remembered { memory: &memory, transforms: &transforms },
            known,
            class,
            now_s * SECOND,
            5.0,
        )
    }

    #[tokio::test]
    async fn a_pose_in_the_world_is_one_in_the_root_frame_where_it_is_known_where_the_robot_stands() {
        let known = [sponge("alice.alice", 7, WORLD, 0.5, false)];
        let (_, pose) = newest(&known, "sponge", 9).unwrap();
        assert!((pose.translation.x - 0.2).abs() < 1e-12);
    }

    #[tokio::test]
    async fn whoever_saw_it_last_is_believed() {
        let known = [sponge("alice.alice", 7, "root", 0.2, false), sponge("bob", 3, "root", 0.1, false)];
        let (found, pose) = newest(&known, "sponge", 9).unwrap();
        assert_eq!((Origin::agent_of(found), pose.translation.x), (Some("alice"), 0.2));
        let (found, _) = newest(&known[1..], "sponge", 4).unwrap();
        assert_eq!(Origin::agent_of(found), None);
    }

    #[tokio::test]
    async fn what_does_not_help_is_said() {
        let unknown = |known: &[Arc<Snapshot>], class: &str| newest(known, class, 20).unwrap_err().reason;
        let old = sponge("bob", 3, "root", 0.1, false);
        let never =
            "nobody has told where an object `cup` is; is an agent who sees it followed, and does it run?";
        assert_eq!(unknown(&[Arc::clone(&old)], "cup"), never);
        assert_eq!(
            unknown(&[Arc::clone(&old)], "sponge"),
            "the newest that is known of `sponge` (`ObjectInstances/bob/sponge`) is 17.0 s old, over 5.0 s"
        );
        let held = sponge("bob", 18, "root", 0.1, true);
        assert_eq!(unknown(&[old, held], "sponge"), "`sponge` is in the hand `bob/right_hand`");
        let elsewhere = sponge("alice.alice", 18, "alice/root", 0.1, false);
        assert_eq!(
            unknown(&[elsewhere], "sponge"),
            "`ObjectInstances/alice.alice/sponge` has no pose in the root frame: it is not known where the agent \
             stands who saw it"
        );
    }
}

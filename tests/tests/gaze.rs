//! `GazeSelection` in a run: it looks at what a running skill needs, and says why.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use armarium_host::{Console, RunConfig, SkillFactory, run};
use armarium_memoryx::{Commit, EntityId};
use armarium_runtime::skill::{Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_states::Equipment;
use armarium_values::{Pose, Reference, Type, Value};
use futures::FutureExt as _;
use futures::future::BoxFuture;
use nalgebra::Isometry3;

const CHART: &str = r#"
statechart: Looks
initial: Put
states:
  Put: {skill: PutTrinket, transitions: {success: Both}}
  Both:
    parallel:
      Needs:
        initial: Holding
        states:
          Holding: {skill: NeedsThing, with: {thing: "${Put.thing}"}}
      Looking:
        initial: AtNeeds
        states:
          AtNeeds: {skill: GazeSelection}
    after: {4s: Done}
    transitions: {failure: Failed}
  Done: {final: success}
  Failed: {final: failure}
"#;

/// Puts a thing into memory of a class that nobody knows.
struct PutTrinket(Equipment);

impl Skill for PutTrinket {
    fn manifest(&self) -> SkillManifest {
        SkillManifest::new("PutTrinket", "Puts a thing into memory.").output("thing", Type::object(), "It.")
    }

    fn run(&self, _: SkillContext) -> BoxFuture<'static, SkillResult> {
        let (memory, agent) = (Arc::clone(&self.0.memory), self.0.agent.clone());
        async move {
            let id = EntityId::new("ObjectInstances", &agent, "trinket").unwrap();
            let pose = Value::Pose(Pose::new("root".into(), &Isometry3::translation(-0.3, 0.7, 1.0)));
            let attributes = [("class", Value::from("trinket")), ("pose", pose)];
            memory.commit(vec![Commit::new(id.clone(), 0, attributes)]).await.unwrap();
            let thing = Reference { kind: "Object".into(), id: id.to_string() };
            Ok(Outcome::success().with("thing", Value::Reference(thing)))
        }
        .boxed()
    }
}

/// Needs to know where a thing is, until it is cancelled.
struct NeedsThing;

impl Skill for NeedsThing {
    fn manifest(&self) -> SkillManifest {
        SkillManifest::new("NeedsThing", "Needs to know where a thing is.")
            .input("thing", Type::object(), "The thing.")
            .attends("thing", 0.01, 1.0)
    }

    fn run(&self, context: SkillContext) -> BoxFuture<'static, SkillResult> {
        async move {
            context.cancel.cancelled().await;
            Ok(Outcome::success())
        }
        .boxed()
    }
}

/// Keeps why the eyes turned.
#[derive(Default)]
struct Turns(Mutex<Vec<String>>);

impl Console for Turns {
    fn traced(&self, event: &serde_json::Value) {
        if event["item"]["name"] == "gaze_turned" && event["item"]["what"] == "event" {
            self.0.lock().unwrap().push(event["item"]["data"].to_string());
        }
    }
}

#[test]
fn a_thing_that_a_skill_needs_is_looked_at_also_where_nobody_can_look_for_its_class() {
    let folder = tempfile::tempdir().unwrap();
    let chart = folder.path().join("looks.yaml");
    std::fs::write(&chart, CHART).unwrap();
    let put: SkillFactory =
        Arc::new(|equipment: &Equipment| Arc::new(PutTrinket(equipment.clone())) as Arc<dyn Skill>);
    let needs: SkillFactory = Arc::new(|_: &Equipment| Arc::new(NeedsThing) as Arc<dyn Skill>);
    let config = RunConfig {
        skills: vec![put, needs],
        report: folder.path().join("report"),
        store: folder.path().join("memory.redb"),
        longest: Some(Duration::from_secs(60)),
        ..RunConfig::new(chart)
    };
    let turns = Arc::new(Turns::default());
    let console: Arc<dyn Console> = Arc::clone(&turns) as Arc<dyn Console>;
    let ended = run(&config, &console).unwrap();
    assert_eq!(ended.result.outcome, "success", "{:?} {:?}", ended.result.reason, ended.result.chain);
    let turns = turns.0.lock().unwrap();
    let why = |turn: &String| turn.contains("trinket") && turn.contains("Both.Needs.Holding");
    assert!(turns.iter().any(why), "{turns:?}");
}

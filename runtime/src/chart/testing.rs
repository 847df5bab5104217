//! Skills without a robot, for tests of loader, engine and executor.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use armarium_values::{Type, Unit, Value};
use futures::FutureExt;
use futures::future::BoxFuture;

use super::{ChannelSchema, Checked, Registry, check, load_text};
use crate::program::Program;
use crate::skill::{Failure, Outcome, Skill, SkillContext, SkillManifest, SkillResult};

/// `Act` takes and gives numbers and ends as its input `end` says after its input `for`.
pub(crate) struct Act(pub(crate) &'static str);

impl Skill for Act {
    fn manifest(&self) -> SkillManifest {
        let manifest = SkillManifest::new(self.0, "Does what its inputs say.")
            .optional("force", Type::quantity(Unit::N), 1.0, "Any force.")
            .optional("end", Type::String, "never", "Outcome, `panic`, `stuck` or `never`.")
            .optional("for", Type::Duration, Value::Duration(0.0), "How long it takes.")
            .optional("late", Type::Duration, Value::Duration(0.0), "How long it takes to return.")
            .output("value", Type::FLOAT, "The force again.")
            .event("ping")
            .grace(Duration::from_millis(500));
        if self.0 == "Arm" { manifest.limb("arm_right") } else { manifest.outcome("blocked") }
    }

    fn run(&self, context: SkillContext) -> BoxFuture<'static, SkillResult> {
        let number = |name: &str| context.inputs.get(name).and_then(Value::as_f64).unwrap_or(0.0);
        let (takes, late, force) = (number("for"), number("late"), number("force"));
        let end = context.inputs.get("end").and_then(Value::as_str).unwrap_or("never").to_owned();
        async move {
            let over = async {
                if end == "never" || end == "stuck" {
                    std::future::pending::<()>().await;
                }
                tokio::time::sleep(Duration::from_secs_f64(takes)).await;
            };
            tokio::select! {
                biased;
                () = context.cancel.cancelled() => {
                    if end == "stuck" {
                        std::future::pending::<()>().await;
                    }
                    if late > 0.0 {
                        tokio::time::sleep(Duration::from_secs_f64(late)).await;
                    }
                    return Ok(Outcome::success());
                }
                () = over => {}
            }
            match end.as_str() {
                "failure" => Err(Failure::new("it did not work")),
                "panic" => panic!("out of order"),
                "ping" => {
                    context.events.raise("ping", force.into());
                    context.cancel.cancelled().await;
                    Ok(Outcome::success())
                }
                name => Ok(Outcome::named(name).with("value", force)),
            }
        }
        .boxed()
    }
}

pub(crate) fn registry() -> Registry {
    let skills = ["Act", "Arm"].map(|name| Arc::new(Act(name)) as Arc<dyn Skill>);
    skills.into_iter().collect()
}

pub(crate) fn schema() -> ChannelSchema {
    let wrist = Type::record([("push", Type::list(Type::quantity(Unit::N)))]);
    let hand = Type::record([("gesture", Type::String)]);
    ChannelSchema::new().with("wrist", wrist).with("hand", hand)
}

/// A program from text; findings that are errors end the test.
pub(crate) fn program(text: &str) -> Arc<Program> {
    let checked = check(&load_text("test.yaml", text, &[]), &registry(), &schema());
    let findings: Vec<String> = checked.findings.iter().map(ToString::to_string).collect();
    checked.program.unwrap_or_else(|| panic!("{}", findings.join("\n")))
}

/// A chart and others that it may name, checked.
pub(crate) fn checked(text: &str, others: &BTreeMap<&str, &str>) -> Checked {
    let folder = tempfile::tempdir().unwrap();
    for (name, text) in others {
        std::fs::write(folder.path().join(name), text).unwrap();
    }
    check(&load_text("test.yaml", text, &[folder.path().to_owned()]), &registry(), &schema())
}

/// The findings of a chart and of others that it may name, one line each.
pub(crate) fn findings(text: &str, others: &BTreeMap<&str, &str>) -> String {
    checked(text, others).findings.iter().map(|f| format!("{f}\n")).collect()
}

//! One execution of a skill, at whichever agent it runs. It gives the skill its context, catches its panics, drops
//! events that the manifest does not declare, and reports the end exactly once. The caller decides about cancelling
//! and about when a skill counts as stuck.

use std::any::Any;
use std::collections::BTreeMap;
use std::panic::AssertUnwindSafe;
use std::sync::Arc;

use armarium_values::Value;
use futures::FutureExt;
use futures::future::BoxFuture;
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

use crate::channels::Channels;
use crate::skill::{EventQueue, Failure, Limits, Skill, SkillContext, SkillResult, events};

/// The arguments of a skill's start.
#[derive(Debug)]
pub(crate) struct SkillStart {
    /// Path of the state that runs the skill, or the name that a remote caller knows it by.
    pub(crate) state: String,
    pub(crate) inputs: BTreeMap<String, Value>,
    pub(crate) limits: Limits,
    pub(crate) channels: Channels,
    pub(crate) cancel: CancellationToken,
}

/// A report of a running skill.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Report {
    /// The skill raised an event.
    Event { name: String, data: Value },
    /// Events of this name were dropped because the queue was full.
    Dropped { name: String, count: u64 },
    /// The active states inside the skill.
    Inside(Vec<String>),
    /// How the skill ended; the last report.
    Ended(SkillResult),
}

/// See the module.
pub(crate) struct Activation {
    state: String,
    /// Events that it may raise.
    declared: Vec<String>,
    acting: BoxFuture<'static, Result<SkillResult, Box<dyn Any + Send>>>,
    events: EventQueue,
    inside: watch::Receiver<Vec<String>>,
    result: Option<SkillResult>,
}

impl Activation {
    /// Prepares a skill; it begins at the first call of [`next`](Self::next). `declared` are the events that it may
    /// raise.
    pub(crate) fn new(skill: Arc<dyn Skill>, declared: Vec<String>, start: SkillStart) -> Self {
        let (raising, events) = events();
        let (telling, inside) = watch::channel(Vec::new());
        let state = start.state.clone();
        let attention = start.channels.attention().clone();
        let attending = attention.attend(&state, &skill.manifest().attends, &start.inputs);
        let context = SkillContext {
            state: start.state,
            inputs: start.inputs,
            limits: start.limits,
            cancel: start.cancel,
            channels: start.channels,
            events: raising,
            inside: telling,
        };
        let acting = AssertUnwindSafe(async move {
            let _attending = attending;
            skill.run(context).await
        })
        .catch_unwind()
        .boxed();
        Self { state, declared, acting, events, inside, result: None }
    }

    /// Runs the skill until its next report. Cancel-safe: no report is lost when this future is dropped.
    pub(crate) async fn next(&mut self) -> Report {
        loop {
            if let Some(event) = self.events.take() {
                match self.declared(event) {
                    Some(report) => return report,
                    None => continue,
                }
            }
            if let Some((name, count)) = self.events.take_dropped() {
                tracing::warn!(state = self.state, event = name, count, "events came over the bound");
                return Report::Dropped { name, count };
            }
            if let Some(result) = self.result.take() {
                return Report::Ended(result);
            }
            tokio::select! {
                biased;
                Some(event) = self.events.next() => {
                    if let Some(report) = self.declared(event) {
                        return report;
                    }
                }
                Ok(()) = self.inside.changed() => {
                    return Report::Inside(self.inside.borrow_and_update().clone());
                }
                result = &mut self.acting => {
                    let result = result.unwrap_or_else(|panic| Err(Failure::new(words(panic.as_ref()))));
                    self.result = Some(result);
                }
            }
        }
    }

    /// The report of an event that the skill declares; other events are dropped.
    fn declared(&self, (name, data): (String, Value)) -> Option<Report> {
        if !self.declared.contains(&name) {
            tracing::warn!(
                state = self.state,
                event = name,
                "a skill raised an event that it does not declare"
            );
            return None;
        }
        Some(Report::Event { name, data })
    }
}

fn words(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(|s| (*s).to_owned());
    let text = text.or_else(|| panic.downcast_ref::<String>().cloned());
    format!("the skill panicked: {}", text.as_deref().unwrap_or("no message"))
}

//! The chronicle of a run: what the chart did and when, for the progress line, the report, the recording, the digest,
//! and as marks for the referee.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

use armarium_runtime::exec::TraceSink;
use armarium_runtime::trace::{RunStatus, TraceEvent, TraceItem};
use armarium_simulator::{Handle, Mark, Referee};
use armarium_values::Value;
use armarium_viewer::recorder::LogLevel;
use armarium_viewer::report::StateSpan;

use crate::recording::{RunDigest, SharedRecorder, locked};

/// Lines of the log that the report shows.
const LOG_LINES: usize = 200;

/// What is known of the run so far.
#[derive(Debug, Default)]
pub(crate) struct Story {
    /// The states through time.
    pub(crate) states: Vec<StateSpan>,
    /// What is active now.
    pub(crate) status: RunStatus,
    /// The last lines of the log.
    pub(crate) log: Vec<String>,
    /// The running skills: name and inputs by activation.
    running: BTreeMap<u64, (String, BTreeMap<String, Value>)>,
}

impl Story {
    /// The innermost states at a time, s.
    pub(crate) fn states_at(&self, t_s: f64) -> String {
        let active = |s: &&StateSpan| s.from_s <= t_s && s.to_s.is_none_or(|to| t_s < to);
        let paths: Vec<&str> = self.states.iter().filter(active).map(|s| s.path.as_str()).collect();
        let inner = |path: &&&str| !paths.iter().any(|o| o.len() > path.len() && o.starts_with(**path));
        paths.iter().filter(inner).copied().collect::<Vec<_>>().join(", ")
    }
}

/// A trace sink that writes the story and passes everything on; clones write the same story.
#[derive(Clone)]
pub(crate) struct Chronicle {
    pub(crate) story: Arc<Mutex<Story>>,
    pub(crate) digest: RunDigest,
    pub(crate) recorder: SharedRecorder,
    pub(crate) referee: Referee,
    pub(crate) clock: Handle,
    /// Where log lines go.
    pub(crate) print: Arc<dyn Fn(&str) + Send + Sync>,
    pub(crate) verbose: bool,
}

impl TraceSink for Chronicle {
    fn record(&mut self, event: &TraceEvent) {
        self.digest.add(event);
        let t_ns = self.clock.now_ns();
        if let Some(recorder) = locked(&self.recorder).as_mut() {
            let written = serde_json::to_value(event).map(|json| recorder.event(t_ns, &json));
            if !matches!(written, Ok(Ok(()))) {
                tracing::warn!("an event of the chart was not recorded");
            }
        }
        let mut story = locked(&self.story);
        story.status.update(event);
        self.follow(&mut story, t_ns, &event.item);
    }
}

impl Chronicle {
    fn follow(&self, story: &mut Story, t_ns: u64, item: &TraceItem) {
        let t_s = t_ns as f64 * 1e-9;
        match item {
            TraceItem::Entered { state } => {
                let span = StateSpan { path: state.clone(), from_s: t_s, to_s: None, outcome: None };
                story.states.push(span);
            }
            TraceItem::Exited { state } => {
                if let Some(span) = open(&mut story.states, state) {
                    span.to_s = Some(t_s);
                }
            }
            TraceItem::SkillStarted { activation, skill, inputs, state } => {
                self.say(story, t_s, state, &format!("{skill} begins"));
                self.mark_start(skill, t_ns);
                story.running.insert(*activation, (skill.clone(), inputs.clone()));
            }
            TraceItem::SkillEnded { activation, state, outcome, reason, outputs } => {
                if let Some(span) = open(&mut story.states, state) {
                    span.outcome = Some(outcome.clone());
                }
                let Some((skill, inputs)) = story.running.remove(activation) else { return };
                let why = reason
                    .as_ref()
                    .filter(|_| outcome == "failure")
                    .map_or(String::new(), |r| format!(": {r}"));
                self.say(story, t_s, state, &format!("{skill} ends with {outcome}{why}"));
                if outcome == "success" {
                    self.mark_end(&skill, &inputs, outputs, t_ns);
                }
            }
            TraceItem::Inside { state, leaves } if !leaves.is_empty() => {
                self.say(story, t_s, state, &format!("inside, {}", leaves.join(" | ")));
            }
            TraceItem::Event { name, .. } => self.mark_event(name, t_ns),
            TraceItem::Log { state, text } => self.say(story, t_s, state, text),
            TraceItem::Sent { name, to, .. } => self.say(story, t_s, to, &format!("is sent {name}")),
            TraceItem::Error { message, place } => self.say(story, t_s, place, message),
            TraceItem::Retry { state, attempt, reason } => {
                self.say(story, t_s, state, &format!("try {} after: {reason}", attempt + 1));
            }
            _ => {}
        }
    }

    fn say(&self, story: &mut Story, t_s: f64, who: &str, what: &str) {
        let line = format!("{t_s:8.2} s  {who}: {what}");
        if self.verbose {
            (self.print)(&line);
        }
        if let Some(recorder) = locked(&self.recorder).as_mut() {
            recorder.log((t_s * 1e9) as u64, LogLevel::Info, who, what);
        }
        if story.log.len() >= LOG_LINES {
            story.log.remove(0);
        }
        story.log.push(line);
    }

    /// Tells the referee when the parts of the scenario begin and end; it judges nothing else by the chart.
    fn mark_start(&self, skill: &str, t_ns: u64) {
        match skill {
            "ForceAdaptation" => self.referee.mark(Mark::AdaptationStarted, t_ns),
            "ExecuteMotion" => self.referee.mark(Mark::WipingStarted, t_ns),
            _ => {}
        }
    }

    fn mark_end(
        &self,
        skill: &str,
        inputs: &BTreeMap<String, Value>,
        outputs: &BTreeMap<String, Value>,
        t_ns: u64,
    ) {
        let number = |values: &BTreeMap<String, Value>, name: &str| values.get(name).and_then(Value::as_f64);
        match skill {
            "CloseHand" => self.referee.mark(Mark::GraspClosed, t_ns),
            "MovementImitation" => self.referee.mark(Mark::LearningEnded, t_ns),
            "ForceAdaptation" => {
                let desired_n = number(inputs, "force").unwrap_or_default();
                let cycles = number(outputs, "cycles").unwrap_or_default() as u32;
                self.referee.mark(Mark::AdaptationEnded { desired_n, cycles }, t_ns);
            }
            _ => {}
        }
    }

    fn mark_event(&self, name: &str, t_ns: u64) {
        match name {
            "imitation.steady" => self.referee.mark(Mark::FreeSpaceSteady, t_ns),
            "imitation.over" => self.referee.mark(Mark::AdaptationStarted, t_ns),
            _ => {}
        }
    }
}

fn open<'s>(states: &'s mut [StateSpan], path: &str) -> Option<&'s mut StateSpan> {
    states.iter_mut().rev().find(|span| span.path == path && span.to_s.is_none())
}

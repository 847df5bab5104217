//! The log of a run: the chart's events with their times, for the progress line, the report, the recording and the
//! digest. Marks that skills declare go to the referee.

use std::collections::BTreeMap;
use std::sync::Arc;

use armarium_memoryx::EntityId;
use armarium_runtime::attention::{Attended, Attends};
use armarium_runtime::chart::Registry;
use armarium_runtime::exec::TraceSink;
use armarium_runtime::skill::{Mark, MarkTime};
use armarium_runtime::trace::{RunStatus, TraceEvent, TraceItem};
use armarium_simulator::{Handle, Referee};
use armarium_values::Value;
use armarium_values::report::StateSpan;
use armarium_viewer::recorder::LogLevel;
use parking_lot::Mutex;

use crate::console::Console;
use crate::live::Gate;
use crate::recording::{RunDigest, SharedRecorder};

/// Lines of the log in the report.
const LOG_LINES: usize = 200;

/// The state of the run so far.
#[derive(Debug, Default)]
pub(crate) struct RunLog {
    pub(crate) states: Vec<StateSpan>,
    pub(crate) status: RunStatus,
    /// The newest lines.
    pub(crate) lines: Vec<String>,
    /// What the chart's `log` actions wrote, the newest lines.
    pub(crate) written: Vec<String>,
    /// Events that were dropped and why, the newest lines.
    pub(crate) dropped: Vec<String>,
    /// The inputs that the chart began with.
    pub(crate) inputs: BTreeMap<String, Value>,
    /// The running skills by activation.
    running: BTreeMap<u64, StartedSkill>,
}

#[derive(Debug)]
struct StartedSkill {
    skill: String,
    inputs: BTreeMap<String, Value>,
}

impl RunLog {
    /// The innermost states at a time, s.
    pub(crate) fn states_at(&self, t_s: f64) -> String {
        let active = |s: &&StateSpan| s.from_s <= t_s && s.to_s.is_none_or(|to| t_s < to);
        let paths: Vec<&str> = self.states.iter().filter(active).map(|s| s.path.as_str()).collect();
        let inner = |path: &&&str| !paths.iter().any(|o| o.len() > path.len() && o.starts_with(**path));
        paths.iter().filter(inner).copied().collect::<Vec<_>>().join(", ")
    }
}

/// A trace sink that writes the log and passes everything on; clones write to the same log.
#[derive(Clone)]
pub(crate) struct RunLogger {
    pub(crate) log: Arc<Mutex<RunLog>>,
    pub(crate) digest: RunDigest,
    pub(crate) recorder: SharedRecorder,
    pub(crate) referee: Referee,
    pub(crate) clock: Handle,
    pub(crate) console: Arc<dyn Console>,
    /// What the referee is told of each skill.
    pub(crate) judged: Arc<BTreeMap<String, Judged>>,
    /// The robot whose chart it is; `None` for the first.
    pub(crate) robot: Option<String>,
    /// Holds up the run where a page wants it.
    pub(crate) gate: Option<Gate>,
}

/// What a skill declares that the referee is told when it runs.
#[derive(Debug)]
pub(crate) struct Judged {
    marks: Vec<Mark>,
    /// The inputs that name things of which it needs to know the place.
    attends: Vec<String>,
}

/// What the referee is told of each skill.
pub(crate) fn judged(registry: &Registry) -> Arc<BTreeMap<String, Judged>> {
    let attended = |attends: &Attends| match &attends.what {
        Attended::Input(input) => Some(input.clone()),
        Attended::Pattern(_) => None,
    };
    let judged = registry.manifests().map(|manifest| {
        let attends = manifest.attends.iter().filter_map(attended).collect();
        (manifest.name.clone(), Judged { marks: manifest.marks.clone(), attends })
    });
    Arc::new(judged.filter(|(_, judged)| !judged.marks.is_empty() || !judged.attends.is_empty()).collect())
}

/// The name of the thing in memory that a value names.
fn thing(value: &Value) -> Option<String> {
    let Value::Reference(reference) = value else { return None };
    let id: EntityId = reference.id.parse().ok()?;
    (reference.kind == "Object").then(|| id.entity().to_owned())
}

impl TraceSink for RunLogger {
    fn record(&mut self, event: &TraceEvent) {
        self.digest.add(event);
        let t_ns = self.clock.now_ns();
        if let Ok(json) = serde_json::to_value(event) {
            self.recorder.write(|recorder| match &self.robot {
                Some(robot) => recorder.json(&format!("/{robot}/chart/events"), t_ns, &json),
                None => recorder.event(t_ns, &json),
            });
            if self.robot.is_none() {
                self.console.traced(&json);
            }
        }
        let mut log = self.log.lock();
        log.status.update(event);
        self.follow(&mut log, t_ns, &event.item);
        drop(log);
        if let Some(gate) = &self.gate {
            gate.happened(event);
        }
    }
}

impl RunLogger {
    /// The same for the chart of another robot, in a log of its own. The referee judges only the first robot.
    pub(crate) fn of_other(&self, robot: &str, log: &Arc<Mutex<RunLog>>) -> Self {
        let (log, robot) = (Arc::clone(log), Some(robot.to_owned()));
        Self { log, robot, judged: Arc::default(), gate: None, ..self.clone() }
    }

    /// The name of a state, with the robot's where it is not the first.
    fn whose(&self, state: &str) -> String {
        self.robot.as_ref().map_or_else(|| state.to_owned(), |robot| format!("{robot}: {state}"))
    }

    fn follow(&self, log: &mut RunLog, t_ns: u64, item: &TraceItem) {
        let t_s = t_ns as f64 * 1e-9;
        match item {
            TraceItem::Entered { state } => {
                let span = StateSpan { path: state.clone(), from_s: t_s, to_s: None, outcome: None };
                log.states.push(span);
            }
            TraceItem::Exited { state } => {
                if let Some(span) = open(&mut log.states, state) {
                    span.to_s = Some(t_s);
                }
            }
            TraceItem::SkillStarted { activation, skill, inputs, state } => {
                self.say(log, t_s, state, &format!("{skill} begins"));
                let running = StartedSkill { skill: skill.clone(), inputs: inputs.clone() };
                let attends = self.judged.get(skill).map_or(&[][..], |judged| &judged.attends);
                for thing in attends.iter().filter_map(|input| thing(inputs.get(input)?)) {
                    self.referee.needs(t_ns, *activation, &thing);
                }
                self.mark(&running, &MarkTime::Start, &BTreeMap::new(), t_ns);
                log.running.insert(*activation, running);
            }
            TraceItem::SkillEnded { activation, state, outcome, reason, outputs } => {
                if let Some(span) = open(&mut log.states, state) {
                    span.outcome = Some(outcome.clone());
                }
                let Some(running) = log.running.remove(activation) else { return };
                self.referee.needs_no_more(t_ns, *activation);
                let why = reason.as_ref().filter(|_| outcome == "failure");
                let why = why.map_or(String::new(), |reason| format!(": {reason}"));
                self.say(log, t_s, state, &format!("{} ends with {outcome}{why}", running.skill));
                if outcome == "success" {
                    self.mark(&running, &MarkTime::Success, outputs, t_ns);
                }
                self.mark(&running, &MarkTime::End, outputs, t_ns);
            }
            TraceItem::Started { inputs, .. } => log.inputs.clone_from(inputs),
            TraceItem::Dropped { name, reason } => {
                self.say(log, t_s, name, &format!("this event is dropped: {reason}"));
                keep(&mut log.dropped, format!("{t_s:.2} s {name}: {reason}"));
            }
            TraceItem::Transition { source, event, target } => {
                let event = event.as_deref().unwrap_or("no event");
                let source = self.whose(source);
                let line =
                    format!("{t_s:8.2} s  {source}: {event} -> {}", target.as_deref().unwrap_or("stays"));
                self.console.happened(&line);
            }
            TraceItem::Event { name, from, .. } => {
                if from.is_none() {
                    self.console.happened(&format!("{t_s:8.2} s  event {name}"));
                }
                let at = MarkTime::Event(name.clone());
                log.running.values().for_each(|running| self.mark(running, &at, &BTreeMap::new(), t_ns));
            }
            TraceItem::Inside { state, leaves } if !leaves.is_empty() => {
                self.say(log, t_s, state, &format!("inside, {}", leaves.join(" | ")));
            }
            TraceItem::Log { state, text } => {
                self.say(log, t_s, state, text);
                keep(&mut log.written, format!("{t_s:.2} s {state}: {text}"));
            }
            TraceItem::Sent { name, to, .. } => self.say(log, t_s, to, &format!("is sent {name}")),
            TraceItem::Error { message, place } => self.say(log, t_s, place, message),
            TraceItem::Retry { state, attempt, reason } => {
                self.say(log, t_s, state, &format!("try {} after: {reason}", attempt + 1));
            }
            _ => {}
        }
    }

    fn say(&self, log: &mut RunLog, t_s: f64, who: &str, what: &str) {
        let who = &self.whose(who);
        let line = format!("{t_s:8.2} s  {who}: {what}");
        self.console.happened(&line);
        self.recorder.write(|recorder| {
            recorder.log((t_s * 1e9) as u64, LogLevel::Info, who, what);
            Ok(())
        });
        keep(&mut log.lines, line);
    }

    /// Passes a skill's marks at this point of its activation to the referee and the recording.
    fn mark(&self, running: &StartedSkill, at: &MarkTime, outputs: &BTreeMap<String, Value>, t_ns: u64) {
        let Some(judged) = self.judged.get(&running.skill) else { return };
        for mark in judged.marks.iter().filter(|mark| mark.at == *at) {
            let numbers = mark.numbers_of(&running.inputs, outputs);
            if let Some(known) = armarium_simulator::Milestone::named(&mark.name, &numbers) {
                self.referee.mark(known, t_ns);
            }
            let written = serde_json::json!({"mark": mark.name, "numbers": numbers});
            self.recorder.write(|recorder| recorder.json("/truth/marks", t_ns, &written));
        }
    }
}

/// Adds a line, and forgets the oldest where there are too many.
fn keep(lines: &mut Vec<String>, line: String) {
    if lines.len() >= LOG_LINES {
        lines.remove(0);
    }
    lines.push(line);
}

fn open<'s>(states: &'s mut [StateSpan], path: &str) -> Option<&'s mut StateSpan> {
    states.iter_mut().rev().find(|span| span.path == path && span.to_s.is_none())
}

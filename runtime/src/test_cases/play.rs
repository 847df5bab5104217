//! Plays one case: skills end as the script says, steps happen in their order, and what is expected is compared.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

use armarium_values::Value;
use serde_json::Value as Json;

use super::stand_in::{self, StandInError};
use super::{Case, Ending, Expect, Script, Step, TestFile};
use crate::program::{Kind, Program, StateId};
use crate::skill::InputError;
use crate::stepping::{Coverage, RunningSkill, StepError, Stepper};

/// Why a case fails.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs, reason = "the names of the fields say what they are")]
pub enum CaseError {
    /// An input is not what the chart declares.
    #[error("given {name}: {why}")]
    Given { name: String, why: StandInError },
    /// The inputs do not fit the chart.
    #[error(transparent)]
    Inputs(#[from] InputError),
    /// A step fails; the first has number 1.
    #[error("step {number}: {why}")]
    Step { number: usize, why: Box<Self> },
    /// The chart does not understand what happens.
    #[error(transparent)]
    Refused(#[from] StepError),
    /// A channel's value is not what is declared.
    #[error("channel {channel}: {why}")]
    Channel { channel: String, why: StandInError },
    /// A script's output is not what the skill declares.
    #[error("{skill}: {output}: {why}")]
    Output { skill: String, output: String, why: StandInError },
    /// A script gives an output that the skill does not have.
    #[error("the skill {skill} gives no `{output}`")]
    NoOutput { skill: String, output: String },
    /// Something is not as expected.
    #[error("{what}: {found} instead of {expected}")]
    Unlike { what: String, found: String, expected: String },
    /// The run goes on, with these innermost states active.
    #[error("the run has not ended: {active:?} are active")]
    NotEnded { active: Vec<String> },
    /// The run has ended otherwise.
    #[error("the outcome is `{found}` ({reason}) instead of `{expected}`")]
    Outcome { found: String, reason: String, expected: String },
    /// The run has failed through these states, and no step expects that.
    #[error("the run has failed in {states}: {reason}; if that is meant, add `expect: {{outcome: failure}}`")]
    Failed { states: String, reason: String },
    /// The reason is another one.
    #[error("the reason is `{found}`, without `{expected}`")]
    Reason { found: String, expected: String },
    /// Something was not logged.
    #[error("`{expected}` was not said; what was: {logs:?}")]
    Log { expected: String, logs: Vec<String> },
    /// An event was not sent.
    #[error("`{expected}` was not sent to another agent; what was: {sent:?}")]
    Sent { expected: String, sent: Vec<String> },
}

impl TestFile {
    /// Plays a case of the file. Gives the transitions that were taken, and whether everything was as expected.
    pub fn play(&self, case: &Case, program: &Arc<Program>) -> (Coverage, Result<(), CaseError>) {
        let scripts = [&case.skills, &self.skills, &case.charts, &self.charts];
        let stepper = inputs(program, case)
            .and_then(|given| Ok(Stepper::new(Arc::clone(program), &given, case.profile.as_deref())?));
        let stepper = match stepper {
            Ok(stepper) => stepper,
            Err(error) => return (Coverage::default(), Err(error)),
        };
        let mut player = Player {
            program,
            stepper,
            scripts,
            starts: BTreeMap::new(),
            endings: BTreeMap::new(),
            known: BTreeSet::new(),
            logs: Vec::new(),
            sent: Vec::new(),
        };
        player.stepper.start();
        let result = player.steps(&case.steps);
        (player.stepper.coverage().clone(), result)
    }
}

fn inputs(program: &Program, case: &Case) -> Result<BTreeMap<String, Value>, CaseError> {
    let read = |(name, json): (&String, &Json)| {
        let declared = program.inputs().find(|input| input.name == *name);
        let value = declared.map_or_else(|| Ok(Value::from_json(json)), |d| stand_in::read(&d.ty, json));
        value.map(|v| (name.clone(), v)).map_err(|why| CaseError::Given { name: name.clone(), why })
    };
    case.given.iter().map(read).collect()
}

struct Player<'p> {
    program: &'p Program,
    stepper: Stepper,
    /// The case's scripts, then the file's; those of skills, then those of charts.
    scripts: [&'p BTreeMap<String, Script>; 4],
    /// How often the skill of a state was started, by the key of the script.
    starts: BTreeMap<String, usize>,
    /// What comes: by time and number of the start.
    endings: BTreeMap<(Duration, u64), (RunningSkill, Ending)>,
    known: BTreeSet<u64>,
    logs: Vec<String>,
    /// The names of events that were sent to other agents.
    sent: Vec<String>,
}

impl Player<'_> {
    fn steps(&mut self, steps: &[Step]) -> Result<(), CaseError> {
        self.advance(Duration::ZERO)?;
        for (number, step) in steps.iter().enumerate() {
            let failed = |why| CaseError::Step { number: number + 1, why: Box::new(why) };
            self.step(step).map_err(failed)?;
        }
        self.failure_is_expected(steps)
    }

    /// A run that failed where no step looks at its end is no success of the case; a `final: failure` that steps expect as
    /// active is one.
    fn failure_is_expected(&self, steps: &[Step]) -> Result<(), CaseError> {
        let Some(result) = self.stepper.result().filter(|result| result.outcome == "failure") else {
            return Ok(());
        };
        let is_final = |state: &StateId| matches!(self.program.state(*state).kind, Kind::Final { .. });
        let by_design = self.stepper.leaves().iter().all(is_final);
        let looked = |expect: &Expect| {
            expect.outcome.is_some() || expect.reason.is_some() || by_design && expect.active.is_some()
        };
        if steps.iter().filter_map(|step| step.expect.as_ref()).any(looked) {
            return Ok(());
        }
        Err(CaseError::Failed {
            states: if result.chain.is_empty() {
                self.stepper.snapshot().configuration.join(", ")
            } else {
                result.chain.join(" < ")
            },
            reason: result.reason.clone().unwrap_or_else(|| "it ended so".to_owned()),
        })
    }

    fn step(&mut self, step: &Step) -> Result<(), CaseError> {
        self.advance(duration(step.after))?;
        let data = Value::from_json(&step.data);
        match (&step.event, &step.from) {
            (Some(name), Some(from)) => self.stepper.report(from, name, data)?,
            (Some(name), None) => self.stepper.event(name, data),
            (None, _) => {}
        }
        if let Some(channel) = &step.channel {
            let value = stand_in::channel_value(self.program, channel, &step.value);
            let value = value.map_err(|why| CaseError::Channel { channel: channel.clone(), why })?;
            self.stepper.publish(channel, value, duration(step.age));
        }
        self.advance(Duration::ZERO)?;
        step.expect.as_ref().map_or(Ok(()), |expect| self.compare(expect))
    }

    /// Lets time go by, with what the scripts say on the way.
    fn advance(&mut self, by: Duration) -> Result<(), CaseError> {
        let end = self.stepper.now() + by;
        loop {
            self.plan();
            // What the chart does by itself on the way may start skills, whose endings are planned from then.
            let ending = self.endings.first_key_value().map(|(key, _)| *key);
            let own = self.stepper.next_instant().filter(|at| *at <= end);
            if let Some(at) = own.filter(|at| ending.is_none_or(|(ending, _)| *at < ending)) {
                self.stepper.advance(at.saturating_sub(self.stepper.now()));
                continue;
            }
            let Some(key) = ending.filter(|(at, _)| *at <= end) else { break };
            let Some((running, ending)) = self.endings.remove(&key) else { break };
            self.stepper.advance(key.0.saturating_sub(self.stepper.now()));
            // Time may have taken the state away.
            if !self.stepper.running().iter().any(|r| r.activation == running.activation) {
                continue;
            }
            let data = self.data(&running, &ending)?;
            self.stepper.report(&running.path, &ending.outcome, data)?;
        }
        self.stepper.advance(end.saturating_sub(self.stepper.now()));
        self.plan();
        self.logs.extend(self.stepper.take_logs());
        self.sent.extend(self.stepper.take_sent().into_iter().map(|sent| sent.event));
        Ok(())
    }

    /// Looks up how skills that were started end.
    fn plan(&mut self) {
        for running in self.stepper.running() {
            if !self.known.insert(running.activation) {
                continue;
            }
            let keys = [&running.path, &running.state, &running.skill];
            let found = self.scripts.iter().find_map(|scripts| {
                keys.iter().find_map(|key| scripts.get(*key).map(|script| ((*key).clone(), script)))
            });
            // Without a script, steps say how it ends.
            let Some((key, script)) = found else { continue };
            let count = self.starts.entry(format!("{key} in {}", running.path)).or_default();
            let ending = script.ending(*count);
            *count += 1;
            if ending.outcome == "never" {
                continue;
            }
            let at = self.stepper.now() + duration(ending.after);
            self.endings.insert((at, running.activation), (running, ending));
        }
    }

    /// What a skill gives: what is scripted, and something of the declared type for the rest.
    fn data(&self, running: &RunningSkill, ending: &Ending) -> Result<Value, CaseError> {
        if ending.outcome == "failure" {
            let reason = ending.reason.as_deref().unwrap_or("the script says so");
            return Ok(Value::record([("reason", reason.into())]));
        }
        let outputs = self.stepper.manifest_of(running).map_or(&[][..], |m| &m.outputs);
        let mut fields = BTreeMap::new();
        for output in outputs {
            let value = match ending.outputs.get(&output.name) {
                Some(json) => stand_in::read(&output.ty, json).map_err(|why| {
                    let (skill, output) = (running.skill.clone(), output.name.clone());
                    CaseError::Output { skill, output, why }
                })?,
                None => stand_in::of(&output.ty, &output.name),
            };
            fields.insert(output.name.clone(), value);
        }
        if let Some(name) = ending.outputs.keys().find(|name| !fields.contains_key(*name)) {
            return Err(CaseError::NoOutput { skill: running.skill.clone(), output: name.clone() });
        }
        Ok(Value::Map(fields))
    }

    fn compare(&mut self, expect: &Expect) -> Result<(), CaseError> {
        let snapshot = self.stepper.snapshot();
        if let Some(active) = &expect.active {
            let mut active = active.clone();
            active.sort();
            if active != snapshot.configuration {
                return Err(CaseError::Unlike {
                    what: "active".into(),
                    found: format!("{:?}", snapshot.configuration),
                    expected: format!("{active:?}"),
                });
            }
        }
        for (kind, wanted, found) in
            [("locals", &expect.locals, &snapshot.locals), ("outputs", &expect.outputs, &snapshot.outputs)]
        {
            for (name, wanted) in wanted {
                let found = found.get(name).map(Value::to_json);
                if !found.as_ref().is_some_and(|found| same(found, wanted)) {
                    let found = found.map_or_else(|| "nothing".to_owned(), |f| f.to_string());
                    let (what, expected) = (format!("{kind}.{name}"), wanted.to_string());
                    return Err(CaseError::Unlike { what, found, expected });
                }
            }
        }
        self.compare_end(expect)?;
        if let Some(text) = &expect.log {
            let logs = std::mem::take(&mut self.logs);
            if !logs.iter().any(|line| line.contains(text)) {
                return Err(CaseError::Log { expected: text.clone(), logs });
            }
        }
        if let Some(event) = &expect.sent {
            let sent = std::mem::take(&mut self.sent);
            if !sent.contains(event) {
                return Err(CaseError::Sent { expected: event.clone(), sent });
            }
        }
        Ok(())
    }

    fn compare_end(&self, expect: &Expect) -> Result<(), CaseError> {
        let result = self.stepper.result();
        if let Some(outcome) = &expect.outcome {
            match result {
                None => {
                    let active = self.stepper.snapshot().configuration;
                    return Err(CaseError::NotEnded { active });
                }
                Some(result) if result.outcome != *outcome => {
                    let reason = result.reason.as_deref().unwrap_or("without a reason").to_owned();
                    let (found, expected) = (result.outcome.to_string(), outcome.clone());
                    return Err(CaseError::Outcome { found, reason, expected });
                }
                Some(_) => {}
            }
        }
        if let Some(part) = &expect.reason {
            let reason = result.and_then(|r| r.reason.as_deref()).unwrap_or("");
            if !reason.contains(part) {
                return Err(CaseError::Reason { found: reason.to_owned(), expected: part.clone() });
            }
        }
        Ok(())
    }
}

/// Whether two values are the same; numbers by their value, whatever they are written as.
fn same(a: &Json, b: &Json) -> bool {
    match (a, b) {
        (Json::Number(a), Json::Number(b)) => a.as_f64() == b.as_f64(),
        (Json::Array(a), Json::Array(b)) => a.len() == b.len() && a.iter().zip(b).all(|(a, b)| same(a, b)),
        (Json::Object(a), Json::Object(b)) => {
            a.len() == b.len() && a.iter().all(|(key, a)| b.get(key).is_some_and(|b| same(a, b)))
        }
        // A reference is written as its id.
        (Json::Object(a), Json::String(b)) => a.get("id").and_then(Json::as_str) == Some(b),
        _ => a == b,
    }
}

fn duration(seconds: f64) -> Duration {
    Duration::try_from_secs_f64(seconds).unwrap_or_default()
}

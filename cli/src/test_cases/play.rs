//! Plays one case: skills end as the script says, steps happen in their order, and what is expected is compared.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

use armarium_runtime::chart::Registry;
use armarium_runtime::program::Program;
use armarium_runtime::stepping::{Coverage, RunningSkill, Stepper};
use armarium_values::{Type, Value};
use serde_json::Value as Json;

use super::case::{Case, Expect, Script, Step, Told};
use super::stand_in;

/// Most outcomes at one instant: a chart whose skills end at once may turn in a circle.
const MOST_AT_ONCE: usize = 1000;

/// Plays a case and says why it fails, when it does.
pub(super) fn play(
    program: &Arc<Program>,
    registry: &Registry,
    skills: &BTreeMap<String, Script>,
    case: &Case,
    coverage: &mut Coverage,
) -> Result<(), String> {
    let given = inputs(program, case)?;
    let stepper = Stepper::new(Arc::clone(program), &given, case.profile.as_deref());
    let mut player = Player {
        stepper: stepper.map_err(|e| e.to_string())?,
        registry,
        scripts: [&case.skills, skills],
        starts: BTreeMap::new(),
        endings: BTreeMap::new(),
        known: BTreeSet::new(),
        logs: Vec::new(),
        sent: Vec::new(),
    };
    player.stepper.start();
    let result = player.steps(&case.steps);
    *coverage = player.stepper.coverage().clone();
    result
}

fn inputs(program: &Program, case: &Case) -> Result<BTreeMap<String, Value>, String> {
    let read = |(name, json): (&String, &Json)| {
        let declared = program.inputs().find(|input| input.name == *name);
        let value = declared.map_or_else(|| Ok(Value::from_json(json)), |d| stand_in::read(&d.ty, json));
        value.map(|v| (name.clone(), v)).map_err(|e| format!("given {name}: {e}"))
    };
    case.given.iter().map(read).collect()
}

struct Player<'p> {
    stepper: Stepper,
    registry: &'p Registry,
    /// The case's scripts, then the file's.
    scripts: [&'p BTreeMap<String, Script>; 2],
    /// How often the skill of a state was started, by the key of the script.
    starts: BTreeMap<String, usize>,
    /// What comes: by time and number of the start.
    endings: BTreeMap<(Duration, u64), (RunningSkill, Told)>,
    known: BTreeSet<u64>,
    logs: Vec<String>,
    /// The names of events that were sent to other agents.
    sent: Vec<String>,
}

impl Player<'_> {
    fn steps(&mut self, steps: &[Step]) -> Result<(), String> {
        self.advance(Duration::ZERO)?;
        for (number, step) in steps.iter().enumerate() {
            self.step(step).map_err(|e| format!("step {}: {e}", number + 1))?;
        }
        Ok(())
    }

    fn step(&mut self, step: &Step) -> Result<(), String> {
        if let Some(after) = &step.after {
            self.advance(duration(after)?)?;
        }
        let data = Value::from_json(&step.data);
        match (&step.event, &step.from, &step.channel) {
            (None, None, None) => {}
            (Some(name), None, None) => self.stepper.event(name, data),
            (Some(name), Some(from), None) => {
                self.stepper.report(from, name, data).map_err(|e| e.to_string())?;
            }
            (None, None, Some(channel)) => self.stepper.publish(channel, Value::from_json(&step.value)),
            _ => return Err("a step does one thing: `event`, perhaps with `from`, or `channel`".into()),
        }
        self.advance(Duration::ZERO)?;
        step.expect.as_ref().map_or(Ok(()), |expect| self.compare(expect))
    }

    /// Lets time go by, with what the scripts say on the way.
    fn advance(&mut self, by: Duration) -> Result<(), String> {
        let end = self.stepper.now() + by;
        let mut at_once = (self.stepper.now(), 0);
        loop {
            self.plan()?;
            // What the chart does by itself on the way may start skills, whose endings are planned from then.
            let ending = self.endings.first_key_value().map(|(key, _)| *key);
            let own = self.stepper.next_instant().filter(|at| *at <= end);
            if let Some(at) = own.filter(|at| ending.is_none_or(|(ending, _)| *at < ending)) {
                self.stepper.advance(at.saturating_sub(self.stepper.now()));
                continue;
            }
            let Some(key) = ending.filter(|(at, _)| *at <= end) else { break };
            let Some((running, told)) = self.endings.remove(&key) else { break };
            self.stepper.advance(key.0.saturating_sub(self.stepper.now()));
            // Time may have taken the state away.
            if !self.stepper.running().iter().any(|r| r.activation == running.activation) {
                continue;
            }
            let data = self.data(&running, &told)?;
            self.stepper.report(&running.path, &told.outcome, data).map_err(|e| e.to_string())?;
            at_once = if at_once.0 == key.0 { (key.0, at_once.1 + 1) } else { (key.0, 1) };
            if at_once.1 > MOST_AT_ONCE {
                let state = &running.path;
                return Err(format!(
                    "the chart turns in a circle: `{state}` ends again and again at one instant"
                ));
            }
        }
        self.stepper.advance(end.saturating_sub(self.stepper.now()));
        self.plan()?;
        self.logs.extend(self.stepper.take_logs());
        self.sent.extend(self.stepper.take_sent().into_iter().map(|sent| sent.event));
        Ok(())
    }

    /// Looks up how skills that were started end.
    fn plan(&mut self) -> Result<(), String> {
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
            let told = script.ending(*count).told();
            *count += 1;
            if told.outcome == "never" {
                continue;
            }
            let after = told.after.as_ref().map_or(Ok(Duration::ZERO), |after| duration(after))?;
            let at = self.stepper.now() + after;
            self.endings.insert((at, running.activation), (running, told));
        }
        Ok(())
    }

    /// What a skill gives: what is scripted, and something of the declared type for the rest.
    fn data(&self, running: &RunningSkill, told: &Told) -> Result<Value, String> {
        if told.outcome == "failure" {
            let reason = told.reason.as_deref().unwrap_or("the script says so");
            return Ok(Value::record([("reason", reason.into())]));
        }
        let outputs = self.registry.manifest(&running.skill).map_or(&[][..], |m| &m.outputs);
        let mut fields = BTreeMap::new();
        for output in outputs {
            let value = match told.outputs.get(&output.name) {
                Some(json) => stand_in::read(&output.ty, json)
                    .map_err(|e| format!("{}: {}: {e}", running.skill, output.name))?,
                None => stand_in::of(&output.ty, &output.name),
            };
            fields.insert(output.name.clone(), value);
        }
        if let Some(name) = told.outputs.keys().find(|name| !fields.contains_key(*name)) {
            return Err(format!("the skill {} gives no `{name}`", running.skill));
        }
        Ok(Value::Map(fields))
    }

    fn compare(&mut self, expect: &Expect) -> Result<(), String> {
        let snapshot = self.stepper.snapshot();
        if let Some(active) = &expect.active {
            let mut active = active.clone();
            active.sort();
            if active != snapshot.configuration {
                return Err(format!("active: {:?} instead of {active:?}", snapshot.configuration));
            }
        }
        for (kind, wanted, found) in
            [("locals", &expect.locals, &snapshot.locals), ("outputs", &expect.outputs, &snapshot.outputs)]
        {
            for (name, wanted) in wanted {
                let found = found.get(name).map(Value::to_json);
                if !found.as_ref().is_some_and(|found| same(found, wanted)) {
                    let found = found.map_or_else(|| "nothing".to_owned(), |f| f.to_string());
                    return Err(format!("{kind}.{name}: {found} instead of {wanted}"));
                }
            }
        }
        self.compare_end(expect)?;
        if let Some(text) = &expect.log {
            let logs = std::mem::take(&mut self.logs);
            if !logs.iter().any(|line| line.contains(text)) {
                return Err(format!("`{text}` was not said; what was: {logs:?}"));
            }
        }
        if let Some(event) = &expect.sent {
            let sent = std::mem::take(&mut self.sent);
            if !sent.contains(event) {
                return Err(format!("`{event}` was not sent to another agent; what was: {sent:?}"));
            }
        }
        Ok(())
    }

    fn compare_end(&self, expect: &Expect) -> Result<(), String> {
        let result = self.stepper.result();
        if let Some(outcome) = &expect.outcome {
            match result {
                None => {
                    let active = self.stepper.snapshot().configuration;
                    return Err(format!("the run has not ended: {active:?} are active"));
                }
                Some(result) if result.outcome != *outcome => {
                    let why = result.reason.as_deref().unwrap_or("no reason was given");
                    return Err(format!(
                        "the outcome is `{}` ({why}) instead of `{outcome}`",
                        result.outcome
                    ));
                }
                Some(_) => {}
            }
        }
        if let Some(part) = &expect.reason {
            let reason = result.and_then(|r| r.reason.as_deref()).unwrap_or("");
            if !reason.contains(part) {
                return Err(format!("the reason is `{reason}`, without `{part}`"));
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

fn duration(text: &str) -> Result<Duration, String> {
    let value = Type::Duration.read(text).map_err(|e| e.to_string())?;
    let seconds = value.as_f64().and_then(|s| Duration::try_from_secs_f64(s).ok());
    seconds.ok_or_else(|| format!("`{text}` is not a time to wait"))
}

//! Runs actions and evaluates values of a chart.

use std::collections::BTreeMap;

use armarium_values::Value;
use armarium_values::expr::{MAX_PARTS, MAX_TEXT};

use super::event::{Event, Origin};
use super::state::{RunContext, TimerUse, Turn};
use super::{Effect, Engine, TraceItem};
use crate::program::{Action, ERROR_EXECUTION, Program, SendAction, SourcePlace, StateId, Term};

/// Why a value could not be had while a chart runs.
#[derive(Debug)]
pub(super) struct Failed {
    /// What is wrong, one sentence.
    pub(super) message: String,
    /// The place in the file.
    pub(super) place: String,
}

impl Failed {
    pub(super) fn new(message: impl Into<String>, place: String) -> Self {
        Self { message: message.into(), place }
    }
}

/// Largest number of items that a `foreach` visits.
const MAX_ITEMS: usize = 10_000;
/// Deepest nesting of lists and maps that an expression may return.
const MAX_LEVELS: usize = 60;
/// Largest number of actions per input; nested `foreach` can multiply them.
const MAX_ACTIONS: u32 = 100_000;
/// Largest number of parts that the data of all waiting events may have together.
const MAX_CARRIED: usize = 10 * MAX_PARTS;

impl Turn<'_> {
    fn failed(&self, message: impl Into<String>, place: SourcePlace) -> Failed {
        Failed::new(message, self.program.place(place))
    }
}

impl Engine {
    #[inline]
    fn view<'v>(&'v self, turn: &Turn<'v>) -> RunContext<'v> {
        RunContext { program: turn.program, store: &self.store, runs: &self.runs, sensors: turn.sensors }
    }

    pub(super) fn evaluate(&self, term: &Term, turn: &Turn<'_>) -> Result<Value, Failed> {
        match term {
            Term::Literal(value) => Ok(value.clone()),
            Term::Expr(code) => {
                let view = self.view(turn);
                let value = code.expr.evaluate(&view).map_err(|e| turn.failed(e.message, code.place))?;
                if value.deeper_than(MAX_LEVELS) {
                    let message = format!("lists and maps are nested deeper than {MAX_LEVELS} levels");
                    return Err(turn.failed(message, code.place));
                }
                Ok(value)
            }
            Term::Text(parts) => {
                let mut text = String::new();
                for part in parts {
                    match self.evaluate(part, turn)? {
                        Value::String(s) => text.push_str(&s),
                        other => text.push_str(&other.to_json().to_string()),
                    }
                    if let (Term::Expr(code), true) = (part, text.len() > MAX_TEXT) {
                        let message = format!("the text has more than {MAX_TEXT} bytes");
                        return Err(turn.failed(message, code.place));
                    }
                }
                Ok(Value::String(text))
            }
            Term::List(items) => {
                let mut parts = 0;
                Ok(Value::List(
                    items.iter().map(|t| self.part(t, &mut parts, turn)).collect::<Result<_, _>>()?,
                ))
            }
            Term::Map(entries) => {
                let (mut fields, mut parts) = (BTreeMap::new(), 0);
                for (name, term) in entries {
                    fields.insert(name.clone(), self.part(term, &mut parts, turn)?);
                }
                Ok(Value::Map(fields))
            }
        }
    }

    /// A value inside a list or map. Values made by expressions are bounded here; literals are bounded by the
    /// file's size.
    fn part(&self, term: &Term, parts: &mut usize, turn: &Turn<'_>) -> Result<Value, Failed> {
        let value = self.evaluate(term, turn)?;
        if let Term::Expr(code) = term {
            *parts += value.parts();
            if *parts > MAX_PARTS {
                let message = format!("this makes a value of more than {MAX_PARTS} parts");
                return Err(turn.failed(message, code.place));
            }
        }
        Ok(value)
    }

    /// Runs actions in order. An action that fails raises `error.execution` and ends this list.
    pub(super) fn act(&mut self, actions: &[Action], state: StateId, turn: &mut Turn<'_>) -> bool {
        for action in actions {
            match self.act_one(action, state, turn) {
                Ok(true) => {}
                Ok(false) => return false,
                Err(Failed { message, place }) => {
                    self.error_at(state, &message, place, turn);
                    return false;
                }
            }
        }
        true
    }

    fn act_one(&mut self, action: &Action, state: StateId, turn: &mut Turn<'_>) -> Result<bool, Failed> {
        turn.actions += 1;
        if turn.actions > MAX_ACTIONS {
            let message = format!("more than {MAX_ACTIONS} actions in answer to one event");
            return Err(Failed::new(message, turn.program.path(state).to_owned()));
        }
        match action {
            Action::Assign { slot, declaration, variable, term, place } => {
                let value = self.evaluate(term, turn)?;
                let value = if declaration.holds(&value) {
                    value
                } else {
                    let wrong = |error| turn.failed(format!("`{variable}`: {error}"), *place);
                    declaration.accept(value).map_err(wrong)?
                };
                turn.trace(|p| TraceItem::Assigned {
                    variable: shown(p, state, variable),
                    value: value.clone(),
                });
                if !self.store.assign(*slot, value) {
                    return Err(turn.failed("the chart's variables hold too much", *place));
                }
            }
            Action::Raise { event, data, place } => {
                let data = self.optional(data.as_ref(), turn)?;
                let event = Event::new(*event, data, Origin::Broadcast);
                if self.internal.len() >= super::MAX_QUEUE || !self.can_carry(&event) {
                    return Err(turn.failed("too many events are waiting", *place));
                }
                self.internal.push_back(event);
            }
            Action::Send(send) => self.send(send, turn)?,
            Action::Cancel { id } => {
                let matching = |of: &TimerUse| matches!(of, TimerUse::Send { id: Some(i), .. } if i == id);
                let timers: Vec<u64> = self
                    .timers
                    .iter()
                    .filter(|(_, timer)| matching(&timer.of))
                    .map(|(timer, _)| *timer)
                    .collect();
                for timer in timers {
                    self.timers.remove(&timer);
                    turn.out.push(Effect::CancelTimer { timer });
                }
            }
            Action::Log { term } => {
                let text = match self.evaluate(term, turn)? {
                    Value::String(text) => text,
                    other => other.to_json().to_string(),
                };
                turn.trace(|p| TraceItem::Log { state: p.path(state).to_owned(), text });
            }
            Action::If { condition, then, otherwise } => {
                let view = self.view(turn);
                let holds = turn.program.test(condition, &view);
                let holds = holds.map_err(|e| turn.failed(e.message, condition.place))?;
                return Ok(self.act(if holds { then } else { otherwise }, state, turn));
            }
            Action::Foreach { items, slot, body, place } => {
                let items = match self.evaluate(items, turn)? {
                    Value::List(items) => items,
                    Value::Map(fields) => fields.into_keys().map(Value::String).collect(),
                    other => {
                        let message = format!("expected a list, found {}", other.describe());
                        return Err(turn.failed(message, *place));
                    }
                };
                if items.len() > MAX_ITEMS {
                    return Err(turn.failed(format!("a list of more than {MAX_ITEMS} items"), *place));
                }
                for item in items {
                    self.store.data[*slot as usize] = Some(item);
                    if !self.act(body, state, turn) {
                        return Ok(false);
                    }
                }
                self.store.data[*slot as usize] = None;
            }
        }
        Ok(true)
    }

    fn optional(&self, term: Option<&Term>, turn: &Turn<'_>) -> Result<Value, Failed> {
        term.map_or(Ok(Value::Null), |term| self.evaluate(term, turn))
    }

    fn send(&mut self, send: &SendAction, turn: &mut Turn<'_>) -> Result<(), Failed> {
        let data = self.optional(send.data.as_ref(), turn)?;
        let to = match &send.to {
            None => None,
            Some(term) => Some(self.evaluate(term, turn)?.as_str().unwrap_or_default().to_owned()),
        };
        if to.as_ref().is_some_and(String::is_empty) {
            return Err(turn.failed("`to` names no agent", send.place));
        }
        let event = Event::new(send.event, data, Origin::Broadcast);
        let Some(delay) = &send.delay else {
            self.post(event, to, turn);
            return Ok(());
        };
        let seconds = self.evaluate(delay, turn)?.as_f64().unwrap_or(f64::NAN);
        if !seconds.is_finite() || seconds < 0.0 {
            return Err(turn.failed(format!("{seconds} s is not a time to wait"), send.place));
        }
        if self.timers.len() >= super::MAX_QUEUE || !self.can_carry(&event) {
            return Err(turn.failed("too many delayed events are waiting", send.place));
        }
        self.start_timer(TimerUse::Send { id: send.id.clone(), event, to }, seconds, u64::MAX - 2, turn);
        Ok(())
    }

    /// Whether there is room for the data of an event.
    pub(super) fn can_carry(&self, event: &Event) -> bool {
        if event.parts() == 0 {
            return true;
        }
        let timers = self.timers.values().filter_map(|timer| match &timer.of {
            TimerUse::Send { event, .. } => Some(event),
            _ => None,
        });
        let waiting = self.internal.iter().chain(&self.external).chain(timers);
        waiting.map(Event::parts).sum::<usize>() + event.parts() <= MAX_CARRIED
    }

    /// Routes a sent event: to this chart, or to another agent.
    pub(super) fn post(&mut self, event: Event, to: Option<String>, turn: &mut Turn<'_>) {
        let Some(to) = to else { return self.queue(event, turn) };
        let name = event.name(turn.program).to_owned();
        let data = event.data().clone();
        turn.trace(|_| TraceItem::Sent { name: name.clone(), to: to.clone(), data: data.clone() });
        turn.out.push(Effect::Send { event: name, to, data });
    }

    /// Raises `error.execution` for a failed expression, unless that event is the one being handled.
    pub(super) fn error(&mut self, state: StateId, message: &str, place: SourcePlace, turn: &mut Turn<'_>) {
        let place = turn.program.place(place);
        self.error_at(state, message, place, turn);
    }

    pub(super) fn error_at(&mut self, state: StateId, message: &str, place: String, turn: &mut Turn<'_>) {
        turn.trace(|_| TraceItem::Error { message: message.to_owned(), place: place.clone() });
        if self.store.event.as_ref().is_some_and(|e| e.is_error(turn.program)) {
            return;
        }
        let reason = format!("{message} ({place})");
        let data = Value::record([("reason", reason.into()), ("place", place.into())]);
        self.internal.push_back(Event::new(ERROR_EXECUTION, data, Origin::Error(state)));
    }
}

/// A variable's name, prefixed with the state's chart unless that is the outermost.
fn shown(program: &Program, state: StateId, variable: &str) -> String {
    let owner = program.outward(state).find(|s| program.state(*s).chart_root);
    match owner.and_then(|root| program.tables.parent(root)) {
        Some(owner) if owner != 0 => format!("{}.{variable}", program.path(owner)),
        _ => variable.to_owned(),
    }
}

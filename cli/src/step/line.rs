//! Reads and writes the JSON lines of `step`.

use std::collections::BTreeMap;
use std::io::{self, Write};
use std::time::Duration;

use armarium_runtime::program::{EventId, Program};
use armarium_runtime::stepping::{StepError, Stepper};
use armarium_runtime::test_cases::channel_value;
use armarium_values::Value;
use serde::{Deserialize, Deserializer, Serialize};

/// Longest time that one line can let pass, ms: about 30 years.
const MAX_AFTER_MS: f64 = 1.0e12;

/// A line as it is written.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawLine {
    name: Option<String>,
    #[serde(default)]
    data: serde_json::Value,
    from: Option<String>,
    channel: Option<String>,
    /// `null` is a value: memory holds nothing.
    #[serde(default, deserialize_with = "present")]
    value: Option<serde_json::Value>,
    after_ms: Option<f64>,
}

fn present<'de, D: Deserializer<'de>>(value: D) -> Result<Option<serde_json::Value>, D::Error> {
    serde_json::Value::deserialize(value).map(Some)
}

/// The input of a line to the chart.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct InputLine {
    after: Duration,
    what: LineInput,
}

/// What a line says; the chart's number of an event is there once it was looked up.
#[derive(Clone, Debug, PartialEq)]
enum LineInput {
    Event { name: String, data: Value, number: Option<EventId> },
    Report { from: String, name: String, data: Value },
    Publish { channel: String, value: Value },
    Nothing,
}

impl InputLine {
    /// Whether it is an outcome or a watch of a state.
    pub(super) fn is_report(&self) -> bool {
        matches!(self.what, LineInput::Report { .. })
    }

    /// The same with the event's number, so that it is not looked up each time.
    pub(super) fn looked_up(mut self, program: &Program) -> Self {
        if let LineInput::Event { name, number, .. } = &mut self.what {
            *number = program.event(name);
        }
        self
    }

    /// The event, if the line is only an event that the chart knows, and no time goes by.
    pub(super) fn as_event(&self) -> Option<(EventId, Value)> {
        match &self.what {
            LineInput::Event { number: Some(number), data, .. } if self.after.is_zero() => {
                Some((*number, data.clone()))
            }
            _ => None,
        }
    }

    /// The line's name in the answer.
    pub(super) fn name(&self) -> &str {
        match &self.what {
            LineInput::Event { name, .. } | LineInput::Report { name, .. } => name,
            LineInput::Publish { channel, .. } => channel,
            LineInput::Nothing => "",
        }
    }
}

/// Reads a line; `None` for an empty one.
pub(super) fn read(text: &str) -> Result<Option<InputLine>, String> {
    if text.trim().is_empty() {
        return Ok(None);
    }
    let written: RawLine = serde_json::from_str(text).map_err(|e| e.to_string())?;
    let after_ms = written.after_ms.unwrap_or(0.0);
    if !(0.0..=MAX_AFTER_MS).contains(&after_ms) {
        return Err(format!("`after_ms` is a time from 0 to {MAX_AFTER_MS}, not {after_ms}"));
    }
    let data = Value::from_json(&written.data);
    let what = match (written.name, written.from, written.channel, written.value) {
        (Some(name), None, None, None) => LineInput::Event { name, data, number: None },
        (Some(name), Some(from), None, None) => LineInput::Report { from, name, data },
        (None, None, Some(channel), Some(value)) => {
            LineInput::Publish { channel, value: Value::from_json(&value) }
        }
        (None, None, None, None) if written.after_ms.is_some() => LineInput::Nothing,
        _ => {
            let message =
                "a line has `name`, perhaps with `from` and `data`; or `channel` and `value`; or `after_ms`";
            return Err(message.into());
        }
    };
    Ok(Some(InputLine { after: Duration::from_secs_f64(after_ms / 1000.0), what }))
}

impl InputLine {
    /// The line as a step of a test case.
    pub(super) fn step(&self) -> serde_json::Value {
        match &self.what {
            LineInput::Event { name, data, .. } => event_step(name, None, data),
            LineInput::Report { from, name, data } => event_step(name, Some(from.as_str()), data),
            LineInput::Publish { channel, value } => channel_step(channel, value),
            LineInput::Nothing => serde_json::json!({}),
        }
    }
}

/// An event, or an outcome or watch of a state, as a step of a test case.
pub(super) fn event_step(name: &str, from: Option<&str>, data: &Value) -> serde_json::Value {
    let mut step = serde_json::json!({"event": name});
    if let Some(from) = from {
        step["from"] = from.into();
    }
    if *data != Value::Null {
        step["data"] = data.to_json();
    }
    step
}

/// A channel's value as a step of a test case.
pub(super) fn channel_step(channel: &str, value: &Value) -> serde_json::Value {
    serde_json::json!({"channel": channel, "value": value.to_json()})
}

/// Publishes a value that fits the channel.
pub(super) fn publish(stepper: &mut Stepper, channel: &str, value: &Value) {
    let read = channel_value(stepper.engine().program(), channel, &value.to_json());
    stepper.publish(channel, read.unwrap_or_else(|_| value.clone()), Duration::ZERO);
}

/// Passes a line's input to the chart. Nothing changes where the state is not active, or has no such outcome or watch now.
pub(super) fn apply(stepper: &mut Stepper, input: &InputLine) -> Result<(), StepError> {
    if !input.after.is_zero() {
        stepper.advance(input.after);
    }
    match &input.what {
        LineInput::Event { number: Some(number), data, .. } => stepper.raise(*number, data.clone()),
        LineInput::Event { name, data, .. } => stepper.event(name, data.clone()),
        LineInput::Report { from, name, data } => stepper.report(from, name, data.clone())?,
        LineInput::Publish { channel, value } => publish(stepper, channel, value),
        LineInput::Nothing => {}
    }
    Ok(())
}

/// The active states after an event.
#[derive(Serialize)]
struct Answer<'a> {
    event: Option<&'a str>,
    configuration: Vec<String>,
    states: Vec<String>,
    locals: BTreeMap<String, serde_json::Value>,
    outputs: BTreeMap<String, serde_json::Value>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    log: Vec<String>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    sent: Vec<serde_json::Value>,
    #[serde(skip_serializing_if = "Option::is_none")]
    outcome: Option<&'a str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    reason: Option<&'a str>,
}

fn json(values: BTreeMap<String, Value>) -> BTreeMap<String, serde_json::Value> {
    values.into_iter().map(|(name, value)| (name, value.to_json())).collect()
}

/// Writes the active states after `event`; before the first event it is null.
pub(super) fn write(stepper: &mut Stepper, event: &str, out: &mut dyn Write) -> io::Result<()> {
    let snapshot = stepper.snapshot();
    let log = stepper.take_logs();
    let sent = stepper.take_sent();
    let sent = sent
        .iter()
        .map(|sent| serde_json::json!({"event": sent.event, "to": sent.to, "data": sent.data.to_json()}));
    let answer = Answer {
        event: (!event.is_empty()).then_some(event),
        configuration: snapshot.configuration,
        states: snapshot.states,
        locals: json(snapshot.locals),
        outputs: json(snapshot.outputs),
        log,
        sent: sent.collect(),
        outcome: stepper.result().map(|r| r.outcome.as_str()),
        reason: stepper.result().and_then(|r| r.reason.as_deref()),
    };
    serde_json::to_writer(&mut *out, &answer)?;
    writeln!(out)
}

/// The line of a measurement.
#[derive(Serialize)]
struct Figures {
    events: u64,
    seconds: f64,
    events_per_s: f64,
    configuration: Vec<String>,
    locals: BTreeMap<String, serde_json::Value>,
}

/// Writes the speed and the final states.
pub(super) fn write_figures(
    stepper: &Stepper,
    events: u64,
    seconds: f64,
    out: &mut dyn Write,
) -> io::Result<()> {
    let snapshot = stepper.snapshot();
    let figures = Figures {
        events,
        seconds,
        events_per_s: if seconds > 0.0 { events as f64 / seconds } else { 0.0 },
        configuration: snapshot.configuration,
        locals: json(snapshot.locals),
    };
    serde_json::to_writer(&mut *out, &figures)?;
    writeln!(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_an_event_an_outcome_a_channel_or_time() {
        let what = |text: &str| read(text).map(|input| input.map(|t| t.what));
        assert_eq!(what("  \n"), Ok(None));
        let event = LineInput::Event { name: "t".into(), data: Value::Int(1), number: None };
        assert_eq!(what(r#"{"name": "t", "data": 1}"#), Ok(Some(event)));
        let report = LineInput::Report { from: "A.B".into(), name: "success".into(), data: Value::Null };
        assert_eq!(what(r#"{"name": "success", "from": "A.B"}"#), Ok(Some(report)));
        let publish = LineInput::Publish { channel: "hand".into(), value: Value::Bool(true) };
        assert_eq!(what(r#"{"channel": "hand", "value": true}"#), Ok(Some(publish)));
        let gone = LineInput::Publish { channel: "cup".into(), value: Value::Null };
        assert_eq!(what(r#"{"channel": "cup", "value": null}"#), Ok(Some(gone)));
        assert_eq!(what(r#"{"after_ms": 5}"#), Ok(Some(LineInput::Nothing)));
    }

    #[test]
    fn a_line_that_is_wrong_says_why() {
        for (text, part) in [
            ("{}", "a line has `name`"),
            ("{\"name\": 1}", "invalid type"),
            ("{\"nam\": \"t\"}", "unknown field `nam`"),
            ("{\"name\": \"t\", \"after_ms\": -1}", "`after_ms` is a time"),
            ("{\"name\": \"t\", \"after_ms\": 1e300}", "`after_ms` is a time"),
            ("nonsense", "expected"),
        ] {
            let error = read(text).expect_err(text);
            assert!(error.contains(part), "{text}: {error}");
        }
    }
}

//! Reads and writes the JSON lines of `step`.

use std::collections::BTreeMap;
use std::io::{self, Write};
use std::time::Duration;

use armarium_runtime::program::{EventId, Program};
use armarium_runtime::stepping::{Sent, Stepper};
use armarium_values::Value;
use serde::{Deserialize, Serialize};

/// Longest time that one line can let pass, ms: about 30 years.
const LONGEST_MS: f64 = 1.0e12;

/// A line as it is written.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Written {
    name: Option<String>,
    #[serde(default)]
    data: serde_json::Value,
    from: Option<String>,
    channel: Option<String>,
    value: Option<serde_json::Value>,
    after_ms: Option<f64>,
}

/// The input of a line to the chart.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Told {
    after: Duration,
    what: What,
}

#[derive(Clone, Debug, PartialEq)]
enum What {
    /// With the chart's number of the event, once it was looked up.
    Event {
        name: String,
        data: Value,
        number: Option<EventId>,
    },
    Report {
        from: String,
        name: String,
        data: Value,
    },
    Publish {
        channel: String,
        value: Value,
    },
    Nothing,
}

impl Told {
    /// The same with the event's number, so that it is not looked up each time.
    pub(super) fn looked_up(mut self, program: &Program) -> Self {
        if let What::Event { name, number, .. } = &mut self.what {
            *number = program.event(name);
        }
        self
    }

    /// The line's name in the answer.
    pub(super) fn name(&self) -> &str {
        match &self.what {
            What::Event { name, .. } | What::Report { name, .. } => name,
            What::Publish { channel, .. } => channel,
            What::Nothing => "",
        }
    }
}

/// Reads a line; `None` for an empty one.
///
/// # Errors
/// One sentence for people.
pub(super) fn read(text: &str) -> Result<Option<Told>, String> {
    if text.trim().is_empty() {
        return Ok(None);
    }
    let written: Written = serde_json::from_str(text).map_err(|e| e.to_string())?;
    let after_ms = written.after_ms.unwrap_or(0.0);
    if !(0.0..=LONGEST_MS).contains(&after_ms) {
        return Err(format!("`after_ms` is a time from 0 to {LONGEST_MS}, not {after_ms}"));
    }
    let data = Value::from_json(&written.data);
    let what = match (written.name, written.from, written.channel, written.value) {
        (Some(name), None, None, None) => What::Event { name, data, number: None },
        (Some(name), Some(from), None, None) => What::Report { from, name, data },
        (None, None, Some(channel), Some(value)) => {
            What::Publish { channel, value: Value::from_json(&value) }
        }
        (None, None, None, None) if written.after_ms.is_some() => What::Nothing,
        _ => {
            let message =
                "a line has `name`, perhaps with `from` and `data`; or `channel` and `value`; or `after_ms`";
            return Err(message.into());
        }
    };
    Ok(Some(Told { after: Duration::from_secs_f64(after_ms / 1000.0), what }))
}

/// Passes a line's input to the chart. An outcome of an inactive state is only a warning: as in a run, it is dropped.
pub(super) fn tell(stepper: &mut Stepper, told: &Told, number: usize, err: &mut dyn Write) -> io::Result<()> {
    if !told.after.is_zero() {
        stepper.advance(told.after);
    }
    match &told.what {
        What::Event { number: Some(number), data, .. } => stepper.raise(*number, data.clone()),
        What::Event { name, data, .. } => stepper.event(name, data.clone()),
        What::Report { from, name, data } => {
            if let Err(error) = stepper.report(from, name, data.clone()) {
                writeln!(err, "warning: line {number} of the events: {error}")?;
            }
        }
        What::Publish { channel, value } => stepper.publish(channel, value.clone()),
        What::Nothing => {}
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

fn letter(sent: &Sent) -> serde_json::Value {
    serde_json::json!({"event": sent.event, "to": sent.to, "data": sent.data.to_json()})
}

/// Writes the active states after `event`; before the first event it is null.
pub(super) fn write(stepper: &mut Stepper, event: &str, out: &mut dyn Write) -> io::Result<()> {
    let snapshot = stepper.snapshot();
    let log = stepper.take_logs();
    let answer = Answer {
        event: (!event.is_empty()).then_some(event),
        configuration: snapshot.configuration,
        states: snapshot.states,
        locals: json(snapshot.locals),
        outputs: json(snapshot.outputs),
        log,
        sent: stepper.take_sent().iter().map(letter).collect(),
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
        let what = |text: &str| read(text).map(|told| told.map(|t| t.what));
        assert_eq!(what("  \n"), Ok(None));
        let event = What::Event { name: "t".into(), data: Value::Int(1), number: None };
        assert_eq!(what(r#"{"name": "t", "data": 1}"#), Ok(Some(event)));
        let report = What::Report { from: "A.B".into(), name: "success".into(), data: Value::Null };
        assert_eq!(what(r#"{"name": "success", "from": "A.B"}"#), Ok(Some(report)));
        let publish = What::Publish { channel: "hand".into(), value: Value::Bool(true) };
        assert_eq!(what(r#"{"channel": "hand", "value": true}"#), Ok(Some(publish)));
        assert_eq!(what(r#"{"after_ms": 5}"#), Ok(Some(What::Nothing)));
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

//! Drives a chart by hand: shows the active states, and asks for a line.

use std::io::{self, BufRead, Write};
use std::time::Duration;

use armarium_runtime::stepping::Stepper;
use armarium_runtime::test_cases::StepCheck;
use armarium_values::{Type, Value};

use super::line::{channel_step, event_step, publish};

const HELP: &str = "\
  NAME [JSON]           raise an event, perhaps with data
  NAME@STATE [JSON]     the outcome of the state's skill, or its watch
  CHANNEL := JSON       publish a value on a channel
  +TIME                 let time go by: +500ms, +2s
  vars                  show locals and outputs
  quit                  leave";

/// Asks for lines until the input or the run ends, or the user quits.
pub(super) fn run(
    stepper: &mut Stepper,
    check: &StepCheck<'_>,
    input: &mut dyn BufRead,
    out: &mut dyn Write,
) -> io::Result<()> {
    stepper.start();
    writeln!(out, "{HELP}")?;
    let mut text = String::new();
    loop {
        show(stepper, out)?;
        if stepper.result().is_some() {
            return Ok(());
        }
        write!(out, "> ")?;
        out.flush()?;
        text.clear();
        if input.read_line(&mut text)? == 0 {
            return writeln!(out);
        }
        match text.trim() {
            "" => {}
            "quit" | "q" | "exit" => return Ok(()),
            "help" | "?" => writeln!(out, "{HELP}")?,
            "vars" => variables(stepper, out)?,
            line => {
                if let Err(message) = obey(stepper, check, line) {
                    writeln!(out, "  {message}")?;
                }
            }
        }
    }
}

fn show(stepper: &mut Stepper, out: &mut dyn Write) -> io::Result<()> {
    for line in stepper.take_logs() {
        writeln!(out, "  log: {line}")?;
    }
    for sent in stepper.take_sent() {
        writeln!(out, "  sent to {}: {} {}", sent.to, sent.event, sent.data.to_json())?;
    }
    let snapshot = stepper.snapshot();
    writeln!(out, "[{:.3} s] {}", stepper.now().as_secs_f64(), snapshot.configuration.join(" | "))?;
    for running in stepper.running() {
        writeln!(out, "  {} runs {}", running.state, running.skill)?;
    }
    if let Some(result) = stepper.result() {
        let reason = result.reason.as_ref().map_or_else(String::new, |r| format!(": {r}"));
        writeln!(out, "the run has ended: {}{reason}", result.outcome)?;
    }
    Ok(())
}

fn variables(stepper: &Stepper, out: &mut dyn Write) -> io::Result<()> {
    let snapshot = stepper.snapshot();
    for (kind, values) in [("locals", snapshot.locals), ("outputs", snapshot.outputs)] {
        for (name, value) in values {
            writeln!(out, "  {kind}.{name} = {}", value.to_json())?;
        }
    }
    Ok(())
}

fn obey(stepper: &mut Stepper, check: &StepCheck<'_>, line: &str) -> Result<(), String> {
    if let Some(time) = line.strip_prefix('+') {
        let time = Type::Duration.read(time.trim()).map_err(|e| e.to_string())?;
        let seconds = time.as_f64().and_then(|s| Duration::try_from_secs_f64(s).ok());
        stepper.advance(seconds.ok_or("that is not a time")?);
        return Ok(());
    }
    if let Some((channel, value)) = line.split_once(":=") {
        let (channel, value) = (channel.trim(), json(value)?);
        check.check(&channel_step(channel, &value)).map_err(|e| e.to_string())?;
        publish(stepper, channel, &value);
        return Ok(());
    }
    let (name, data) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
    let data = if data.trim().is_empty() { Value::Null } else { json(data)? };
    let (name, from) = name.split_once('@').map_or((name, None), |(name, from)| (name, Some(from)));
    check.check(&event_step(name, from, &data)).map_err(|e| e.to_string())?;
    match from {
        Some(state) => stepper.report(state, name, data).map_err(|e| e.to_string()),
        None => {
            stepper.event(name, data);
            Ok(())
        }
    }
}

fn json(text: &str) -> Result<Value, String> {
    let value: serde_json::Value = serde_json::from_str(text.trim()).map_err(|e| format!("not JSON: {e}"))?;
    Ok(Value::from_json(&value))
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use armarium_runtime::chart::Registry;

    use super::*;

    const CHART: &str = "statechart: C\nlocals: {n: {type: int, default: 0}}\nevents: {go: {}}\ninitial: A\nstates:\n  A: {transitions: {go: {target: B, do: [{assign: {locals.n: \"${event.data.n}\"}}]}}}\n  B: {after: {2s: Done}}\n  Done: {final: success}\n";

    #[test]
    fn a_person_drives_a_chart_to_its_end() {
        let library = armarium_runtime::chart::load_text("c.yaml", CHART, &[]);
        let checked = armarium_runtime::chart::check(&library, &Default::default(), &Default::default());
        let program = checked.program.expect("it is in order");
        let stepper = Stepper::new(Arc::clone(&program), &Default::default(), None);
        let registry = Registry::default();
        let check = StepCheck::new(&program, &registry);
        let lines = "nonsense {\ngo@Nowhere\ngo@A\ngoo\ngo {\"n\": 7}\nvars\n+soon\n+2s\n";
        let mut out = Vec::new();
        run(&mut stepper.expect("it has no inputs"), &check, &mut lines.as_bytes(), &mut out)
            .expect("memory can be written");
        let text = String::from_utf8(out).expect("text is UTF-8");
        for part in [
            "not JSON",
            "no state `Nowhere`",
            "there is no outcome or watch of `A` called `go`",
            "the chart takes no event `goo` (did you mean `go`?)",
            "[0.000 s] B",
            "locals.n = 7",
            "[2.000 s] Done",
            "the run has ended: success",
        ] {
            assert!(text.contains(part), "{part} in\n{text}");
        }
    }
}

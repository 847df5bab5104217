//! `armarium step CHART`: drives a chart without a robot in virtual time, by JSON lines or by hand at a terminal.
//!
//! `line` reads and writes JSON lines, `interactive` is for people.

mod interactive;
mod line;

use std::fs::File;
use std::io::{self, BufRead, BufReader, Write};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use armarium_runtime::program::Program;
use armarium_runtime::stepping::Stepper;
use armarium_runtime::test_cases::StepCheck;

use crate::console;
use crate::failure::CommandFailure;
use crate::run::parse_input;
use armarium_host::{catalog, charts::read_inputs};

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct StepArgs {
    /// The chart.
    #[arg(value_name = "CHART")]
    pub(crate) chart: PathBuf,
    /// An input of the chart, for instance `contact_force=10` or `patience=30s`; may be repeated.
    #[arg(long = "set", value_name = "INPUT=VALUE", value_parser = parse_input)]
    pub(crate) inputs: Vec<(String, String)>,
    /// The chart's profile whose defaults are used.
    #[arg(long)]
    pub(crate) profile: Option<String>,
    /// Events as JSON lines: `{"name": "t1", "data": .., "after_ms": 100}`; an outcome or watch has `"from": "State"`; a
    /// channel's value is `{"channel": "hand", "value": ..}`. `-` reads them from standard input, where an event that the chart does
    /// not take is a warning; in a file it is an error.
    #[arg(long, value_name = "FILE")]
    pub(crate) events: Option<PathBuf>,
    /// Additional folders in which charts find other charts by name.
    #[arg(long, value_name = "DIR")]
    pub(crate) charts: Vec<PathBuf>,
    /// Ask for events at the terminal.
    #[arg(long, conflicts_with_all = ["events", "repeat", "quiet"])]
    pub(crate) interactive: bool,
    /// Drive the list of events this many times.
    #[arg(long, value_name = "N", default_value_t = 1, requires = "events")]
    pub(crate) repeat: u64,
    /// Print only one line at the end, with the time taken.
    #[arg(long, requires = "events")]
    pub(crate) quiet: bool,
}

/// Drives the chart; results go to `out`, errors to `err`. Returns the exit status: 2 when a file, an argument or an
/// event of a file is invalid, 1 when the run has failed, otherwise 0.
pub(crate) fn run(args: &StepArgs, out: &mut dyn Write, err: &mut dyn Write) -> io::Result<u8> {
    let checked = catalog::load_idle(&args.chart, &args.charts);
    let Some(program) = checked.program else {
        return console::show(&checked.findings, err).map(|()| 2);
    };
    drive(args, &program, out, err).or_else(|failure| failure.say(err))
}

fn drive(
    args: &StepArgs,
    program: &Arc<Program>,
    out: &mut dyn Write,
    err: &mut dyn Write,
) -> Result<u8, CommandFailure> {
    let inputs = read_inputs(&args.inputs, program).map_err(|e| e.to_string())?;
    let stepper = Stepper::new(Arc::clone(program), &inputs, args.profile.as_deref());
    let mut stepper = stepper.map_err(|e| e.to_string())?;
    let registry = catalog::idle_registry();
    let check = StepCheck::new(program, &registry);
    // A program that drives a chart through pipes sees what became of each event.
    let strict = args.events.as_ref().is_some_and(|events| events.as_os_str() != "-");
    let mut refused = RefusedEvents { err, strict, any: false };
    if args.interactive {
        interactive::run(&mut stepper, &check, &mut io::stdin().lock(), out)?;
    } else if args.quiet {
        measure(args, &mut stepper, &check, out, &mut refused)?;
    } else {
        stepper.start();
        line::write(&mut stepper, "", out)?;
        follow(args, &mut stepper, &check, out, &mut refused)?;
    }
    let failed = stepper.result().is_some_and(|result| result.outcome == "failure");
    Ok(if refused.any { 2 } else { u8::from(failed) })
}

/// Drives the list of events, and answers each.
fn follow(
    args: &StepArgs,
    stepper: &mut Stepper,
    check: &StepCheck<'_>,
    out: &mut dyn Write,
    refused: &mut RefusedEvents<'_>,
) -> Result<(), CommandFailure> {
    let Some(events) = &args.events else { return Ok(()) };
    if args.repeat == 1 {
        // Each line is answered before the next is read, so that a program can drive a chart through pipes.
        return each_line(events, |number, text| {
            if let Some(input) = checked(number, text, check, refused)? {
                refused.unless(number, line::apply(stepper, &input))?;
                line::write(stepper, input.name(), out)?;
                out.flush()?;
            }
            Ok(())
        });
    }
    let list = read_all(events, check, refused)?;
    for _ in 0..args.repeat {
        for (number, input) in &list {
            refused.unless(*number, line::apply(stepper, input))?;
            line::write(stepper, input.name(), out)?;
        }
    }
    Ok(())
}

/// Events that the chart does not take: each is said, and the list goes on as a run would, which refuses them to their sender.
struct RefusedEvents<'e> {
    err: &'e mut dyn Write,
    /// Whether they are errors.
    strict: bool,
    /// Whether there was an error.
    any: bool,
}

impl RefusedEvents<'_> {
    fn unless<E: std::fmt::Display>(&mut self, line: usize, result: Result<(), E>) -> io::Result<()> {
        let Err(why) = result else { return Ok(()) };
        self.any |= self.strict;
        let kind = if self.strict { "error" } else { "warning" };
        writeln!(self.err, "{kind}: line {line} of the events: {why}")
    }
}

/// Drives the list `repeat` times and prints the time taken.
#[expect(clippy::disallowed_methods, reason = "it measures the machine")]
fn measure(
    args: &StepArgs,
    stepper: &mut Stepper,
    check: &StepCheck<'_>,
    out: &mut dyn Write,
    refused: &mut RefusedEvents<'_>,
) -> Result<(), CommandFailure> {
    let mut list =
        args.events.as_ref().map_or_else(|| Ok(Vec::new()), |events| read_all(events, check, refused))?;
    let program = Arc::clone(stepper.engine().program());
    list = list.into_iter().map(|(number, input)| (number, input.looked_up(&program))).collect();
    stepper.keep_quiet();
    stepper.start();
    let began = Instant::now();
    match list.iter().map(|(_, input)| input.as_event()).collect::<Option<Vec<_>>>() {
        Some(events) => stepper.repeat(&events, args.repeat),
        None => {
            for _ in 0..args.repeat {
                for (number, input) in &list {
                    refused.unless(*number, line::apply(stepper, input))?;
                }
            }
        }
    }
    let seconds = began.elapsed().as_secs_f64();
    let events = args.repeat.saturating_mul(list.len() as u64);
    line::write_figures(stepper, events, seconds, out)?;
    Ok(())
}

fn read_all(
    events: &PathBuf,
    check: &StepCheck<'_>,
    refused: &mut RefusedEvents<'_>,
) -> Result<Vec<(usize, line::InputLine)>, CommandFailure> {
    let mut list = Vec::new();
    each_line(events, |number, text| {
        list.extend(checked(number, text, check, refused)?.map(|input| (number, input)));
        Ok(())
    })?;
    Ok(list)
}

/// A line that is something the chart understands; `None` for an empty one. An event that the chart does not know is refused, and
/// changes nothing, as in SCXML.
fn checked(
    number: usize,
    text: &str,
    check: &StepCheck<'_>,
    refused: &mut RefusedEvents<'_>,
) -> Result<Option<line::InputLine>, CommandFailure> {
    let input = line::read(text).map_err(|e| wrong(number, &e))?;
    match input.as_ref().map_or(Ok(()), |input| check.check(&input.step())) {
        Err(error) if error.is_unknown_event() && !matches!(input, Some(ref input) if input.is_report()) => {
            refused.unless(number, Err(error))?;
        }
        checked => checked.map_err(|error| wrong(number, &error.to_string()))?,
    }
    Ok(input)
}

fn wrong(number: usize, message: &str) -> CommandFailure {
    CommandFailure::Argument(format!("line {number} of the events: {message}"))
}

/// Calls `work` with each line of a file, or of standard input for `-`, and its number.
fn each_line(
    file: &PathBuf,
    mut work: impl FnMut(usize, &str) -> Result<(), CommandFailure>,
) -> Result<(), CommandFailure> {
    let unreadable = |e: io::Error| CommandFailure::Argument(format!("{}: {e}", file.display()));
    let mut reader: Box<dyn BufRead> = if file.as_os_str() == "-" {
        Box::new(io::stdin().lock())
    } else {
        Box::new(BufReader::new(File::open(file).map_err(unreadable)?))
    };
    let mut text = String::new();
    for number in 1.. {
        text.clear();
        if reader.read_line(&mut text).map_err(unreadable)? == 0 {
            break;
        }
        work(number, &text)?;
    }
    Ok(())
}

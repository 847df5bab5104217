//! `armarium replay RUN`: feeds a recorded run to the engine again, which must pass through the same states.

use std::io::{self, BufRead as _, Write};
use std::path::PathBuf;

use armarium_host::replay::{Replay, ReplayedTurn};
use armarium_values::Type;

use crate::console;

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct ReplayArgs {
    /// A record that `run --record FILE` wrote.
    #[arg(value_name = "RUN")]
    pub(crate) run: PathBuf,
    /// Stop at this time of the run, for instance `12.5s`, and show what was active.
    #[arg(long, value_name = "TIME", value_parser = seconds)]
    pub(crate) until: Option<f64>,
    /// Show each turn and wait for Enter.
    #[arg(long)]
    pub(crate) step: bool,
}

fn seconds(text: &str) -> Result<f64, String> {
    let value = Type::Duration.read(text).map_err(|error| error.to_string())?;
    value.as_f64().ok_or_else(|| "it is a time, for instance 12.5s".into())
}

/// Feeds the record to the engine. Returns the exit status: 0 when it passes through the same states, 1 when it does
/// not, 2 when the record or its chart cannot be used.
pub(crate) fn run(args: &ReplayArgs, out: &mut dyn Write) -> io::Result<u8> {
    let replay = match Replay::open(&args.run) {
        Ok(replay) => replay,
        Err(error) => return console::refuse(&error, out),
    };
    let mut active = String::from("nothing");
    let mut count = 0usize;
    for turn in replay {
        let turn = match turn {
            Ok(turn) => turn,
            Err(error) => return console::refuse(&error, out),
        };
        if args.until.is_some_and(|until| turn.at_s > until) {
            break;
        }
        if !turn.is_same() {
            return show_difference(&turn, out).map(|()| 1);
        }
        if let Some(leaves) = &turn.active {
            active = if leaves.is_empty() { "nothing".into() } else { leaves.join(" | ") };
        }
        count += 1;
        if args.step {
            writeln!(out, "[{:.3} s] {}", turn.at_s, turn.found.join("; "))?;
            out.flush()?;
            if io::stdin().lock().read_line(&mut String::new())? == 0 {
                break;
            }
        }
    }
    writeln!(out, "{count} turns, the same states; active at the end: {active}")?;
    Ok(0)
}

/// Prints the first difference, with the event at which it began.
fn show_difference(turn: &ReplayedTurn, out: &mut dyn Write) -> io::Result<()> {
    let ReplayedTurn { number, at_s, expected, found, .. } = turn;
    let event = expected.iter().chain(found).find(|d| d.starts_with("event "));
    let event = event.map_or("no event", String::as_str);
    writeln!(out, "the replay differs from turn {number} on, at {at_s:.3} s, with {event}")?;
    let same = expected.iter().zip(found).take_while(|(a, b)| a == b).count();
    let rest =
        |list: &[String]| if list.len() > same { list[same..].join("; ") } else { "nothing more".into() };
    writeln!(out, "  in the run: {}", rest(expected))?;
    writeln!(out, "  now:        {}", rest(found))
}

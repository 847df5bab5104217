//! `armarium memory lag`: how far a memory is behind those that it follows.

use std::io::Write;

use super::following::{Lag, lags_of};
use super::reach::OpenedMemory;
use super::show::Printer;
use super::{CommandFailure, MemoryArgs};

/// Prints a line for each agent that is followed. Returns whether all are followed, and nothing is behind.
pub(super) async fn lag(
    reached: &OpenedMemory,
    args: &MemoryArgs,
    shown: &Printer,
    out: &mut dyn Write,
) -> Result<bool, CommandFailure> {
    let (memory, session) = reached.agent()?;
    let lags = lags_of(session, memory, &args.agent).await?;
    if lags.is_empty() && !args.json {
        writeln!(out, "`{}` follows nobody", args.agent)?;
    }
    shown.lags("follows", &lags, out)?;
    Ok(lags.iter().all(Lag::is_up_to_date))
}

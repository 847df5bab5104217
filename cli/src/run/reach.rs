//! How a run reaches other agents, and how they reach it.

use std::io::{self, Write};

use armarium_bus::AliveToken;
use armarium_runtime::exec::{Peers, Subscribers};
use armarium_runtime::remote::{Agents, hear};

use crate::connection::{Connection, be_the_only_one};

/// How a run reaches other agents.
pub(super) struct Reach<'c> {
    pub(super) connection: Option<&'c Connection>,
    pub(super) agents: Option<&'c Agents>,
    pub(super) others: Peers,
}

/// Takes a name, and lets the run hear what other agents send to it, on the connection's threads. Gives what keeps the name.
pub(super) fn listen(
    connection: &Connection,
    name: &str,
    subscribers: &Subscribers,
    out: &mut dyn Write,
) -> io::Result<Result<AliveToken, String>> {
    let (session, threads) = (&connection.session, connection.runtime());
    let alive = match threads.block_on(be_the_only_one(session, name)) {
        Ok(alive) => alive,
        Err(message) => return Ok(Err(message)),
    };
    let (hearing, called, subscribers) = (session.clone(), name.to_owned(), subscribers.clone());
    threads.spawn(async move {
        if let Err(error) = hear(&hearing, &called, subscribers).await {
            tracing::error!("other agents cannot send events to `{called}`: {error}");
        }
    });
    for endpoint in threads.block_on(session.endpoints()) {
        writeln!(out, "{name} listens on {endpoint}")?;
    }
    out.flush()?;
    Ok(Ok(alive))
}

//! How a run reaches other agents, and how they reach the run.

use std::sync::Arc;

use armarium_bus::{AliveToken, SessionConfig};
use armarium_runtime::exec::{Peers, Subscribers, Transport};
use armarium_runtime::remote::{Agents, hear};

use crate::connection::{Connection, take_name};
use crate::console::Console;
use crate::error::HostError;

/// How a run reaches other agents; empty if it needs none.
#[derive(Default)]
pub(crate) struct Network {
    pub(crate) connection: Option<Connection>,
    pub(crate) agents: Option<Agents>,
    pub(crate) peers: Peers,
    /// Reserves the run's name.
    _name: Option<AliveToken>,
}

impl Network {
    /// Opens a session. With a name, the run receives events from other agents, on the session's threads.
    ///
    /// # Errors
    /// [`HostError::NameTaken`]; [`HostError::Session`] when the network fails.
    pub(crate) fn open(
        config: &SessionConfig,
        name: Option<&str>,
        console: &dyn Console,
    ) -> Result<Self, HostError> {
        let connection = Connection::open(config)?;
        let agents = connection.agents(name.unwrap_or("armarium run"));
        let transport: Arc<dyn Transport> = Arc::new(agents.clone());
        let peers = Peers { transport: Some(transport), ..Peers::default() };
        let token = name.map(|name| listen(&connection, name, &peers.subscribers, console)).transpose()?;
        Ok(Self { connection: Some(connection), agents: Some(agents), peers, _name: token })
    }
}

fn listen(
    connection: &Connection,
    name: &str,
    subscribers: &Subscribers,
    console: &dyn Console,
) -> Result<AliveToken, HostError> {
    let (session, threads) = (connection.session(), connection.runtime());
    let token = threads.block_on(take_name(session, name))?;
    let (hearing, own, subscribers) = (session.clone(), name.to_owned(), subscribers.clone());
    threads.spawn(async move {
        if let Err(error) = hear(&hearing, &own, subscribers).await {
            tracing::error!("other agents cannot send events to `{own}`: {error}");
        }
    });
    for endpoint in threads.block_on(session.endpoints()) {
        console.note(&format!("{name} listens on {endpoint}"));
    }
    Ok(token)
}

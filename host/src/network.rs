//! How a run reaches other agents, and how they reach the run.

use std::sync::Arc;

use armarium_bus::{AliveToken, SessionConfig};
use armarium_runtime::exec::{Peers, Subscribers, Transport};
use armarium_runtime::program::Program;
use armarium_runtime::remote::{Agents, receive_events};
use armarium_values::Type;
use serde_json::{Value as Json, json};

use crate::connection::{Connection, take_name};
use crate::console::Console;
use crate::error::HostError;

/// How a run reaches other agents; empty if it needs none.
#[derive(Default)]
pub(crate) struct AgentNetwork {
    pub(crate) connection: Option<Connection>,
    pub(crate) agents: Option<Agents>,
    pub(crate) peers: Peers,
    listening: Option<Listening>,
}

/// The name under which others send events to the run, and where.
struct Listening {
    name: String,
    endpoint: Option<String>,
    /// Reserves the name.
    _token: AliveToken,
}

/// Most events for which it is said how they are sent.
const MAX_EXPLAINED: usize = 12;

/// The command lines that send the events of a chart.
fn commands(program: &Program, name: &str, endpoint: &str) -> Vec<String> {
    let command = |(event, ty): (&str, Option<&Type>)| {
        let data = ty.map_or_else(String::new, |ty| format!(" --data '{}'", example(ty)));
        format!("armarium send {event}{data} --to {name} --connect {endpoint}")
    };
    program.events().take(MAX_EXPLAINED).map(command).collect()
}

impl AgentNetwork {
    /// Opens a session. With a name, the run receives events from other agents, on the session's threads.
    pub(crate) fn open(
        config: &SessionConfig,
        name: Option<&str>,
        console: &dyn Console,
    ) -> Result<Self, HostError> {
        let connection = Connection::open(config)?;
        let agents = connection.agents(name.unwrap_or("armarium run"));
        let transport: Arc<dyn Transport> = Arc::new(agents.clone());
        let peers = Peers { transport: Some(transport), ..Peers::default() };
        let listening =
            name.map(|name| listen(&connection, name, &peers.subscribers, console)).transpose()?;
        Ok(Self { connection: Some(connection), agents: Some(agents), peers, listening })
    }

    /// Says how the events of a chart are sent to the run.
    pub(crate) fn explain_events(&self, program: &Program, console: &dyn Console) {
        if let Some(Listening { name, endpoint: Some(endpoint), .. }) = &self.listening {
            for command in commands(program, name, endpoint) {
                console.note(&format!("  `{command}`"));
            }
        }
    }

    /// Whether others can send events to the run.
    pub(crate) fn listens(&self) -> bool {
        self.listening.is_some()
    }
}

fn listen(
    connection: &Connection,
    name: &str,
    subscribers: &Subscribers,
    console: &dyn Console,
) -> Result<Listening, HostError> {
    let (session, threads) = (connection.session(), connection.runtime());
    let token = threads.block_on(take_name(session, name))?;
    let (hearing, own, subscribers) = (session.clone(), name.to_owned(), subscribers.clone());
    threads.spawn(async move {
        if let Err(error) = receive_events(&hearing, &own, subscribers).await {
            tracing::error!("other agents cannot send events to `{own}`: {error}");
        }
    });
    let endpoints = threads.block_on(session.endpoints());
    for endpoint in &endpoints {
        console.note(&format!("{name} listens on {endpoint}"));
    }
    Ok(Listening { name: name.to_owned(), endpoint: endpoints.into_iter().next(), _token: token })
}

/// Something that fits a type, as an example for people.
fn example(ty: &Type) -> Json {
    match ty {
        Type::Bool => json!(false),
        Type::Int | Type::Duration => json!(0),
        Type::Float(_) => json!(0.0),
        Type::Enum(words) => json!(words.first()),
        Type::List(element) => json!([example(element)]),
        Type::Record(fields) => fields.iter().map(|(name, ty)| (name.clone(), example(ty))).collect(),
        Type::Map(_) => json!({}),
        _ => json!("..."),
    }
}

#[cfg(test)]
mod tests {
    use armarium_runtime::chart::{self, ChannelSchema, Registry};

    use super::*;

    #[test]
    fn it_is_said_how_the_events_of_a_chart_are_sent() {
        let text = "statechart: T\nevents: {go: {}, said: {data: {word: string, loud: bool}}}\ninitial: A\n\
                    states:\n  A: {transitions: {go: B, said: B}}\n  B: {final: success}\n";
        let library = chart::load_text("t.yaml", text, &[]);
        let program = chart::check(&library, &Registry::new(), &ChannelSchema::new()).program.unwrap();
        assert_eq!(
            commands(&program, "bob", "tcp/127.0.0.1:7"),
            [
                "armarium send go --to bob --connect tcp/127.0.0.1:7",
                r#"armarium send said --data '{"loud":false,"word":"..."}' --to bob --connect tcp/127.0.0.1:7"#,
            ]
        );
    }
}

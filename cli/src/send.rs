//! `armarium send EVENT [--to AGENT]`: sends an event to the charts that run at another agent.

use std::io::{self, Write};

use armarium_host::Connection;
use armarium_runtime::exec::{RemoteEvent, Transport as _};
use armarium_values::Value;

use crate::connection_args::{ConnectionArgs, explained};
use crate::console::refuse;

#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    armarium run offer.yaml --name offer --listen tcp/127.0.0.1:7447\n  \
    armarium send give --to offer --connect tcp/127.0.0.1:7447\n  \
    armarium send said --data '{\"word\": \"stop\"}' --to bob/Greet --connect tcp/127.0.0.1:7447")]
pub(crate) struct SendArgs {
    /// The event, as charts declare it under `events:`.
    #[arg(value_name = "EVENT")]
    pub(crate) event: String,
    /// What comes with it, as JSON.
    #[arg(long, value_name = "JSON", value_parser = read_data)]
    pub(crate) data: Option<serde_json::Value>,
    /// The agent, or one of its charts: the name that `run --name` or `agent --name` gave it. It can be left out where one agent
    /// runs.
    #[arg(long, value_name = "AGENT[/CHART]")]
    pub(crate) to: Option<String>,
    #[command(flatten)]
    pub(crate) connection: ConnectionArgs,
}

fn read_data(text: &str) -> Result<serde_json::Value, String> {
    serde_json::from_str(text)
        .map_err(|error| format!("it is no JSON: {error}; texts stand in quotes: '\"stop\"'"))
}

/// Sends the event. Returns the exit status: 0 when a chart took it, 1 when it was refused or nobody answered, 2 when
/// an argument is wrong.
pub(crate) fn run(args: &SendArgs, out: &mut dyn Write) -> io::Result<u8> {
    if !args.connection.is_given() {
        let whom = args.to.as_ref().map_or_else(|| "the agent".to_owned(), |to| format!("`{to}`"));
        writeln!(out, "error: say where {whom} listens: --connect tcp/HOST:PORT (its run prints it)")?;
        return Ok(2);
    }
    let config = match args.connection.config() {
        Ok(config) => config,
        Err(error) => return writeln!(out, "error: {}", explained(&error)).map(|()| 2),
    };
    let connection = match Connection::open(&config) {
        Ok(connection) => connection,
        Err(error) => return refuse(&error, out),
    };
    let agents = connection.agents("armarium send");
    let to = match &args.to {
        Some(to) => to.clone(),
        None => match connection.runtime().block_on(agents.running()) {
            Err(error) => return writeln!(out, "error: {error}").map(|()| 2),
            Ok(running) => match running.into_iter().collect::<Vec<_>>().as_slice() {
                [one] => one.clone(),
                [] => {
                    return writeln!(out, "`{}` was not taken: no agent runs there", args.event).map(|()| 1);
                }
                several => {
                    let names = several.join(", ");
                    writeln!(out, "error: several agents run there: {names}; say which is meant with --to")?;
                    return Ok(2);
                }
            },
        },
    };
    let data = args.data.as_ref().map_or(Value::Null, Value::from_json);
    let event = RemoteEvent { to: to.clone(), event: args.event.clone(), data };
    match connection.runtime().block_on(agents.deliver(event)) {
        Ok(()) => writeln!(out, "`{to}` has `{}`", args.event).map(|()| 0),
        Err(error) => writeln!(out, "`{}` was not taken: {error}", args.event).map(|()| 1),
    }
}

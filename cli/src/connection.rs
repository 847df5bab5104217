//! How this process reaches other agents: the options that say where they are, and a session on threads of its own.
//!
//! Charts in virtual time run on one thread with a clock that stands; the network does not. So the session has a
//! runtime beside.

use std::time::Duration;

use armarium_bus::{AliveToken, Session, SessionConfig, SessionError, keys};
use armarium_runtime::remote::Agents;
use tokio::runtime::Runtime;

/// How long another agent of the same name is looked for.
const LOOKED: Duration = Duration::from_millis(500);

/// Where other agents are.
#[derive(Clone, Debug, Default, clap::Args)]
pub(crate) struct ConnectionArgs {
    /// Where another agent listens, for instance `tcp/127.0.0.1:7447`; may be repeated.
    #[arg(long, value_name = "ENDPOINT")]
    pub(crate) connect: Vec<String>,
    /// Where to listen for other agents; a free port of this machine if not given.
    #[arg(long, value_name = "ENDPOINT")]
    pub(crate) listen: Vec<String>,
    /// Accept addresses beyond this machine.
    #[arg(long)]
    pub(crate) off_loopback: bool,
}

impl ConnectionArgs {
    /// The session's configuration.
    pub(crate) fn config(&self) -> SessionConfig {
        let mut config = SessionConfig::connected_to(&self.connect);
        if !self.listen.is_empty() {
            config.listen.clone_from(&self.listen);
        }
        config.off_loopback = self.off_loopback;
        config
    }
}

/// A session on threads of its own; both end with it.
pub(crate) struct Connection {
    pub(crate) session: Session,
    runtime: Option<Runtime>,
}

impl Connection {
    /// Opens a session when the options ask for one, or when this process is to be called by a name.
    ///
    /// # Errors
    /// One sentence for people.
    pub(crate) fn if_asked(args: &ConnectionArgs, named: bool) -> Result<Option<Self>, String> {
        if args.connect.is_empty() && args.listen.is_empty() && !named {
            return Ok(None);
        }
        Self::open(args).map(Some)
    }

    /// Opens a session.
    ///
    /// # Errors
    /// One sentence for people.
    pub(crate) fn open(args: &ConnectionArgs) -> Result<Self, String> {
        let mut builder = tokio::runtime::Builder::new_multi_thread();
        let runtime = builder.worker_threads(2).enable_all().build().map_err(|e| e.to_string())?;
        let session = runtime.block_on(Session::open(&args.config())).map_err(|error| match error {
            SessionError::OffLoopback { .. } => format!("{error}: --off-loopback"),
            error => error.to_string(),
        })?;
        Ok(Self { session, runtime: Some(runtime) })
    }

    /// The agents that are reached; `caller` is what they are told of who calls.
    pub(crate) fn agents(&self, caller: &str) -> Agents {
        Agents::new(self.session.clone(), caller, self.runtime().handle().clone())
    }

    /// The threads of the session.
    pub(crate) fn runtime(&self) -> &Runtime {
        self.runtime.as_ref().expect("the runtime is only taken when the connection ends")
    }
}

/// Takes an agent's name, unless another process has it.
///
/// # Errors
/// One sentence for people.
pub(crate) async fn be_the_only_one(session: &Session, name: &str) -> Result<AliveToken, String> {
    let words = |error: SessionError| error.to_string();
    if is_there(session, name).await.map_err(words)? {
        return Err(format!("there is an agent called `{name}` already: choose another --name"));
    }
    let key = keys::alive(name, "agent").map_err(|e| e.to_string())?;
    session.alive(&key).await.map_err(words)
}

/// Whether an agent of that name is there.
///
/// # Errors
/// When the name is none, or the session has ended.
pub(crate) async fn is_there(session: &Session, name: &str) -> Result<bool, SessionError> {
    let wrong = |e: keys::KeyError| SessionError::Config { what: e.to_string() };
    let those = keys::alive_pattern(Some(name), Some("agent")).map_err(wrong)?;
    let mut roll = session.watch_alive(&those, 16).await?;
    Ok(matches!(tokio::time::timeout(LOOKED, roll.next()).await, Ok(Some(_))))
}

impl Drop for Connection {
    fn drop(&mut self) {
        if let Some(runtime) = self.runtime.take() {
            // A session that cannot be closed ends with the process.
            let _ = runtime.block_on(self.session.close()).is_ok();
            runtime.shutdown_background();
        }
    }
}

//! A session with other agents on threads of its own, and names that only one agent has.
//!
//! Charts in virtual time run on one thread with a clock that stands; the network does not. So the session has a
//! runtime beside.

use std::time::Duration;

use armarium_bus::{AliveToken, Session, SessionConfig, SessionError, keys};
use armarium_runtime::remote::Agents;
use tokio::runtime::Runtime;

use crate::error::HostError;

/// How long another agent of the same name is looked for.
const PATIENCE: Duration = Duration::from_millis(500);

/// A session on threads of its own; both end with it.
#[derive(Debug)]
pub struct Connection {
    session: Session,
    runtime: Option<Runtime>,
}

impl Connection {
    /// Opens a session.
    ///
    /// # Errors
    /// [`HostError::Session`] when the configuration is wrong or the network refuses.
    pub fn open(config: &SessionConfig) -> Result<Self, HostError> {
        let mut builder = tokio::runtime::Builder::new_multi_thread();
        let runtime = builder.worker_threads(2).enable_all().build()?;
        let session = runtime.block_on(Session::open(config))?;
        Ok(Self { session, runtime: Some(runtime) })
    }

    /// The session.
    #[must_use]
    pub fn session(&self) -> &Session {
        &self.session
    }

    /// The agents that are reached; `caller` is what they are told of who calls.
    #[must_use]
    pub fn agents(&self, caller: &str) -> Agents {
        Agents::new(self.session.clone(), caller, self.runtime().handle().clone())
    }

    /// The threads of the session.
    #[must_use]
    pub fn runtime(&self) -> &Runtime {
        self.runtime.as_ref().expect("the runtime is only taken when the connection ends")
    }
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

/// Takes an agent's name, unless another process has it; it is free again when what this gives is dropped.
///
/// # Errors
/// [`HostError::NameTaken`]; [`HostError::Session`] when the name is none, or the session has ended.
pub async fn take_name(session: &Session, name: &str) -> Result<AliveToken, HostError> {
    if is_there(session, name).await? {
        return Err(HostError::NameTaken { name: name.to_owned() });
    }
    let key = keys::alive(name, "agent").map_err(|error| no_name(&error))?;
    Ok(session.alive(&key).await?)
}

/// Whether an agent of that name is there.
///
/// # Errors
/// When the name is none, or the session has ended.
pub async fn is_there(session: &Session, name: &str) -> Result<bool, SessionError> {
    let pattern = keys::alive_pattern(Some(name), Some("agent")).map_err(|error| no_name(&error))?;
    session.is_alive(&pattern, PATIENCE).await
}

fn no_name(error: &keys::KeyError) -> SessionError {
    SessionError::Config { what: error.to_string() }
}

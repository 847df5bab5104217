//! A session with other agents on its own threads, and agent names that are unique.
//!
//! Charts in virtual time run on one thread with a paused clock, but the network runs in real time. So the session
//! has a runtime of its own.

use std::time::Duration;

use armarium_bus::{AliveToken, Session, SessionConfig, SessionError, keys};
use armarium_runtime::remote::Agents;
use tokio::runtime::Runtime;

use crate::error::HostError;

/// How long to look for another agent with the same name.
const NAME_TIMEOUT: Duration = Duration::from_millis(500);

/// A session on its own threads; dropping this closes both.
#[derive(Debug)]
pub struct Connection {
    session: Session,
    runtime: Option<Runtime>,
}

impl Connection {
    /// Opens a session.
    ///
    /// # Errors
    /// [`HostError::Session`] when the configuration is invalid or the network fails.
    pub fn open(config: &SessionConfig) -> Result<Self, HostError> {
        let mut builder = tokio::runtime::Builder::new_multi_thread();
        let runtime = builder.worker_threads(2).enable_all().build()?;
        let session = runtime.block_on(Session::open(config))?;
        Ok(Self { session, runtime: Some(runtime) })
    }

    /// The session.
    pub fn session(&self) -> &Session {
        &self.session
    }

    /// Access to other agents; they see `caller` as the name of the caller.
    pub fn agents(&self, caller: &str) -> Agents {
        Agents::new(self.session.clone(), caller, self.runtime().handle().clone())
    }

    /// The session's runtime.
    pub fn runtime(&self) -> &Runtime {
        self.runtime.as_ref().expect("the runtime is only taken when the connection ends")
    }
}

impl Drop for Connection {
    fn drop(&mut self) {
        if let Some(runtime) = self.runtime.take() {
            // If the session cannot be closed, it ends with the process.
            let _ = runtime.block_on(self.session.close()).is_ok();
            runtime.shutdown_background();
        }
    }
}

/// Reserves an agent's name, unless another process has it. Dropping the token frees the name.
///
/// # Errors
/// [`HostError::NameTaken`]; [`HostError::Session`] when the name is invalid, or the session has ended.
pub async fn take_name(session: &Session, name: &str) -> Result<AliveToken, HostError> {
    if is_there(session, name).await? {
        return Err(HostError::NameTaken { name: name.to_owned() });
    }
    let key = keys::alive(name, "agent").map_err(|error| no_name(&error))?;
    Ok(session.alive(&key).await?)
}

/// Whether an agent of that name is running.
///
/// # Errors
/// When the name is invalid, or the session has ended.
pub async fn is_there(session: &Session, name: &str) -> Result<bool, SessionError> {
    let pattern = keys::alive_pattern(Some(name), Some("agent")).map_err(|error| no_name(&error))?;
    session.is_alive(&pattern, NAME_TIMEOUT).await
}

fn no_name(error: &keys::KeyError) -> SessionError {
    SessionError::Config { what: error.to_string() }
}

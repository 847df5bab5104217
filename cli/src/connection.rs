//! How this process reaches other agents: the options that say where they are, and a session on threads of its own.
//!
//! Charts in virtual time run on one thread with a clock that stands; the network does not. So the session has a
//! runtime beside.

use std::path::{Path, PathBuf};
use std::time::Duration;

use armarium_bus::{Access, AliveToken, Session, SessionConfig, SessionError, Tls, keys};
use armarium_runtime::remote::Agents;
use tokio::runtime::Runtime;

/// How long another agent of the same name is looked for.
const LOOKED: Duration = Duration::from_millis(500);

/// Where other agents are.
#[derive(Clone, Debug, Default, clap::Args)]
pub(crate) struct ConnectionArgs {
    /// Where another agent listens, for instance `tcp/127.0.0.1:7447`; may be repeated.
    #[arg(long, global = true, value_name = "ENDPOINT")]
    pub(crate) connect: Vec<String>,
    /// Where to listen for other agents; a free port of this machine if not given.
    #[arg(long, global = true, value_name = "ENDPOINT")]
    pub(crate) listen: Vec<String>,
    /// Accept addresses beyond this machine.
    #[arg(long, global = true)]
    pub(crate) off_loopback: bool,
    /// For endpoints `tls/...`: the certificate (PEM) of the authority that both sides trust.
    #[arg(long, global = true, value_name = "FILE", requires_all = ["certificate", "key"])]
    pub(crate) ca: Option<PathBuf>,
    /// The certificate (PEM) that is shown; its common name is the agent's.
    #[arg(long, global = true, value_name = "FILE", requires = "ca")]
    pub(crate) certificate: Option<PathBuf>,
    /// The private key (PEM) of the certificate.
    #[arg(long, global = true, value_name = "FILE", requires = "ca")]
    pub(crate) key: Option<PathBuf>,
}

/// Whom an agent lets in, by the common names of their certificates.
#[derive(Clone, Debug, Default, clap::Args)]
pub(crate) struct AccessArgs {
    /// Somebody who may read this agent's memory; may be repeated. As soon as anybody is named, nobody else may do anything.
    #[arg(long = "reader", value_name = "NAME", requires = "ca")]
    readers: Vec<String>,
    /// Somebody who may read it, and write provider segments that are called as he is; may be repeated.
    #[arg(long = "writer", value_name = "NAME", requires = "ca")]
    writers: Vec<String>,
    /// Somebody who may start this agent's charts and skills; may be repeated.
    #[arg(long = "caller", value_name = "NAME", requires = "ca")]
    callers: Vec<String>,
}

impl AccessArgs {
    /// Whom the agent `own` lets in; `None` when nobody is named, and everybody may do everything.
    pub(crate) fn of(&self, own: &str) -> Option<Access> {
        let access = Access {
            own: own.into(),
            readers: self.readers.clone(),
            writers: self.writers.clone(),
            callers: self.callers.clone(),
        };
        access.is_for_others().then_some(access)
    }
}

impl ConnectionArgs {
    /// Opens a session on this runtime, with access rules if there are any.
    ///
    /// # Errors
    /// As [`Session::open`]; [`explained`] makes a sentence for people of it.
    pub(crate) async fn session(&self, access: Option<&Access>) -> Result<Session, SessionError> {
        Session::open(&self.config(access)?).await
    }

    fn config(&self, access: Option<&Access>) -> Result<SessionConfig, SessionError> {
        let mut config = SessionConfig::connected_to(&self.connect);
        if !self.listen.is_empty() {
            config.listen.clone_from(&self.listen);
        }
        config.off_loopback = self.off_loopback;
        for endpoint in config.listen.iter().chain(&config.connect) {
            self.check(endpoint)?;
        }
        config.tls = self.tls()?;
        let rules = access.map(Access::rules).transpose();
        config.access_control = rules.map_err(|error| SessionError::Config { what: error.to_string() })?;
        Ok(config)
    }

    /// Says of an endpoint what Zenoh would say late or not at all.
    fn check(&self, endpoint: &str) -> Result<(), SessionError> {
        let protocol = endpoint.split_once('/').map(|(protocol, _)| protocol);
        let what = match protocol {
            None | Some("") => format!("`{endpoint}` is no endpoint such as tcp/127.0.0.1:7447"),
            Some("tls" | "quic") if self.ca.is_none() => {
                format!("`{endpoint}` needs certificates: --ca, --certificate and --key")
            }
            Some(_) => return Ok(()),
        };
        Err(SessionError::Config { what })
    }

    fn tls(&self) -> Result<Option<Tls>, SessionError> {
        let (Some(ca), Some(certificate), Some(key)) = (&self.ca, &self.certificate, &self.key) else {
            return Ok(None);
        };
        Ok(Some(Tls {
            root_ca: readable(ca)?,
            certificate: readable(certificate)?,
            private_key: readable(key)?,
            mutual: true,
        }))
    }
}

/// The path of a file that is there.
fn readable(file: &Path) -> Result<String, SessionError> {
    let path = file.display().to_string();
    match std::fs::File::open(file) {
        Ok(_) => Ok(path),
        Err(error) => Err(SessionError::Config { what: format!("`{path}` cannot be read: {error}") }),
    }
}

/// What went wrong, and what to do about it.
pub(crate) fn explained(error: &SessionError) -> String {
    match error {
        SessionError::OffLoopback { .. } => format!("{error}: --off-loopback"),
        error => error.to_string(),
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
        Self::open(args, None).map(Some)
    }

    /// Opens a session, with access rules if there are any.
    ///
    /// # Errors
    /// One sentence for people.
    pub(crate) fn open(args: &ConnectionArgs, access: Option<&Access>) -> Result<Self, String> {
        Self::with(args.config(access))
    }

    /// Opens a session whose images pass through shared memory on one machine.
    ///
    /// # Errors
    /// One sentence for people.
    pub(crate) fn for_images(args: &ConnectionArgs, access: Option<&Access>) -> Result<Self, String> {
        Self::with(args.config(access).map(|config| SessionConfig { shared_memory: true, ..config }))
    }

    fn with(config: Result<SessionConfig, SessionError>) -> Result<Self, String> {
        let config = config.map_err(|error| explained(&error))?;
        let mut builder = tokio::runtime::Builder::new_multi_thread();
        let runtime = builder.worker_threads(2).enable_all().build().map_err(|e| e.to_string())?;
        let session = runtime.block_on(Session::open(&config)).map_err(|error| explained(&error))?;
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
    session.is_alive(&those, LOOKED).await
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

//! The options for connections to other agents, and for their access rights.

use std::net::IpAddr;
use std::path::{Path, PathBuf};

use armarium_bus::{Access, KeyError, Session, SessionConfig, SessionError, Tls};
use armarium_viewer::live::{CertificateError, PageAddress};

/// Connections to other agents.
#[derive(Clone, Debug, Default, clap::Args)]
pub(crate) struct ConnectionArgs {
    /// Endpoint of another agent, for instance `tcp/127.0.0.1:7447`; may be repeated.
    #[arg(long, global = true, value_name = "ENDPOINT")]
    pub(crate) connect: Vec<String>,
    /// Endpoint to listen on for other agents; a free port of this machine if not given.
    #[arg(long, global = true, value_name = "ENDPOINT")]
    pub(crate) listen: Vec<String>,
    /// Accept addresses beyond this machine.
    #[arg(long, global = true)]
    pub(crate) off_loopback: bool,
    /// For endpoints `tls/...`: the certificate (PEM) of the authority that both sides trust.
    #[arg(long, global = true, value_name = "FILE", requires_all = ["certificate", "key"])]
    pub(crate) ca: Option<PathBuf>,
    /// The own certificate (PEM); its common name is the agent's name.
    #[arg(long, global = true, value_name = "FILE", requires = "ca")]
    pub(crate) certificate: Option<PathBuf>,
    /// The private key (PEM) of the certificate.
    #[arg(long, global = true, value_name = "FILE", requires = "ca")]
    pub(crate) key: Option<PathBuf>,
}

/// The peers that an agent admits, by the common names of their certificates.
#[derive(Clone, Debug, Default, clap::Args)]
pub(crate) struct AccessArgs {
    /// A peer that may read this agent's memory; may be repeated. As soon as any peer is named, all others are denied
    /// everything.
    #[arg(long = "reader", value_name = "NAME", requires = "ca")]
    readers: Vec<String>,
    /// A peer that may read the memory, and write provider segments of its own name; may be repeated.
    #[arg(long = "writer", value_name = "NAME", requires = "ca")]
    writers: Vec<String>,
    /// A peer that may start this agent's charts and skills; may be repeated.
    #[arg(long = "caller", value_name = "NAME", requires = "ca")]
    callers: Vec<String>,
    /// A peer that may see this agent's live page, its cameras' images and the states of its robots; may be repeated.
    #[arg(long = "watcher", value_name = "NAME", requires = "ca")]
    watchers: Vec<String>,
}

/// The live page.
#[derive(Clone, Debug, Default, clap::Args)]
pub(crate) struct LiveArgs {
    /// Serve a page that shows what goes on, for browsers of this machine; its address is printed first.
    #[arg(long)]
    pub(crate) live: bool,
    /// The port of the page; 0 is any that is free.
    #[arg(long, value_name = "PORT", default_value_t = 0)]
    live_port: u16,
    /// Serve the page at this address of this machine, for browsers elsewhere too: with TLS (--certificate, --key), and only to who
    /// opens the address that is printed, with its token.
    #[arg(long, value_name = "IP", requires = "certificate")]
    live_address: Option<IpAddr>,
}

impl LiveArgs {
    /// Where the page is served.
    pub(crate) fn address(&self, connection: &ConnectionArgs) -> Result<PageAddress, CertificateError> {
        match (self.live_address, &connection.certificate, &connection.key) {
            (Some(ip), Some(certificate), Some(key)) => {
                PageAddress::beyond((ip, self.live_port).into(), certificate, key)
            }
            _ => Ok(PageAddress::loopback(self.live_port)),
        }
    }
}

impl AccessArgs {
    /// The peers that the agent `own` admits; `None` when none is named, and all may do everything.
    pub(crate) fn of(&self, own: &str) -> Option<Access> {
        let access = Access {
            own: own.into(),
            readers: self.readers.clone(),
            writers: self.writers.clone(),
            callers: self.callers.clone(),
            watchers: self.watchers.clone(),
            ..Access::default()
        };
        access.is_for_others().then_some(access)
    }
}

impl ConnectionArgs {
    /// Whether any option is given.
    pub(crate) fn is_given(&self) -> bool {
        !self.connect.is_empty() || !self.listen.is_empty()
    }

    /// Opens a session on this runtime, with access rules if there are any. Of an error, [`explained`] makes a sentence for people.
    pub(crate) async fn session(&self, access: Option<&Access>) -> Result<Session, SessionError> {
        let mut config = self.config()?;
        let no_name = |error: KeyError| SessionError::Config { what: error.to_string() };
        config.access_control = access.map(Access::rules).transpose().map_err(no_name)?;
        Session::open(&config).await
    }

    /// The options as the configuration of a session; an invalid endpoint or a missing file is refused.
    pub(crate) fn config(&self) -> Result<SessionConfig, SessionError> {
        let mut config = SessionConfig::connected_to(&self.connect);
        if !self.listen.is_empty() {
            config.listen.clone_from(&self.listen);
        }
        config.off_loopback = self.off_loopback;
        for endpoint in config.listen.iter().chain(&config.connect) {
            self.check(endpoint)?;
        }
        config.tls = self.tls()?;
        Ok(config)
    }

    /// Detects errors in an endpoint that Zenoh would report late or not at all.
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

/// The path of an existing file.
fn readable(file: &Path) -> Result<String, SessionError> {
    let path = file.display().to_string();
    match std::fs::File::open(file) {
        Ok(_) => Ok(path),
        Err(error) => Err(SessionError::Config { what: format!("`{path}` cannot be read: {error}") }),
    }
}

/// The error, and how to fix it.
pub(crate) fn explained(error: &SessionError) -> String {
    match error {
        SessionError::OffLoopback { .. } => format!("{error}: --off-loopback"),
        error => error.to_string(),
    }
}

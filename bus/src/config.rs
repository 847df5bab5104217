//! How a session connects and is secured. By default it listens on this machine only, without discovery.

use serde_json::{Value as Json, json};

use crate::error::SessionError;

/// The role of a session on the network.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mode {
    /// Connects to peers and accepts connections.
    #[default]
    Peer,
    /// Connects to one router or peer, and communicates only through it.
    Client,
    /// Forwards messages of others.
    Router,
}

/// Certificates of a TLS session; all are paths of PEM files.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Tls {
    /// The trusted certificate authority.
    pub root_ca: String,
    /// The own certificate.
    pub certificate: String,
    /// The private key of the own certificate.
    pub private_key: String,
    /// Whether peers that connect need a certificate too.
    pub mutual: bool,
}

/// How a session connects and is secured.
#[derive(Clone, Debug, PartialEq)]
pub struct SessionConfig {
    /// The role on the network.
    pub mode: Mode,
    /// Listening endpoints, `tcp/127.0.0.1:0`; port 0 selects a free one. The socket of `unixsock-stream//run/alice/socket` is for
    /// processes of the same user only.
    pub listen: Vec<String>,
    /// Endpoints to connect to, `tcp/127.0.0.1:7447`; it retries forever.
    pub connect: Vec<String>,
    /// Whether addresses beyond this machine are accepted in `listen` and `connect`.
    pub off_loopback: bool,
    /// Whether peers are discovered by multicast; only with `off_loopback`.
    pub multicast: bool,
    /// Whether peers announce other peers, which are then connected too.
    pub gossip: bool,
    /// Whether large payloads go through shared memory on one machine.
    pub shared_memory: bool,
    /// Certificates for `tls/...` endpoints.
    pub tls: Option<Tls>,
    /// Access rules in the format of Zenoh's `access_control`.
    pub access_control: Option<Json>,
    /// Largest message that is received, bytes.
    pub largest_message: usize,
}

impl Default for SessionConfig {
    fn default() -> Self {
        Self {
            mode: Mode::Peer,
            listen: vec!["tcp/127.0.0.1:0".into()],
            connect: Vec::new(),
            off_loopback: false,
            multicast: false,
            gossip: false,
            shared_memory: false,
            tls: None,
            access_control: None,
            largest_message: 64 << 20,
        }
    }
}

impl SessionConfig {
    /// The default, connected to these endpoints.
    pub fn connected_to(endpoints: &[String]) -> Self {
        Self { connect: endpoints.to_vec(), ..Self::default() }
    }

    /// The files of the Unix sockets that it listens on.
    pub(crate) fn sockets(&self) -> impl Iterator<Item = &str> {
        let listen = self.listen.iter().filter(|_| self.mode != Mode::Client);
        let files = listen.filter_map(|endpoint| endpoint.strip_prefix("unixsock-stream/"));
        files.filter_map(|file| file.split(['?', '#']).next())
    }

    /// Zenoh's configuration. Refuses an address off this machine without `off_loopback`.
    pub(crate) fn to_zenoh(&self) -> Result<zenoh::Config, SessionError> {
        if !self.off_loopback {
            if let Some(endpoint) = self.listen.iter().chain(&self.connect).find(|e| !is_loopback(e)) {
                return Err(SessionError::OffLoopback { endpoint: endpoint.clone() });
            }
            if self.multicast {
                return Err(SessionError::OffLoopback { endpoint: "multicast".into() });
            }
        }
        let mode = match self.mode {
            Mode::Peer => "peer",
            Mode::Client => "client",
            Mode::Router => "router",
        };
        let listen = if self.mode == Mode::Client { &Vec::new() } else { &self.listen };
        let mut settings = vec![
            ("mode", json!(mode)),
            ("listen/endpoints", json!(listen)),
            ("connect/endpoints", json!(self.connect)),
            // Opening waits for links, and not for what the others declare: until that is known, everything is sent to them. Where
            // their declarations come at once, Zenoh may miss that they have come, and would wait for its whole delay of 0.5 s.
            // A test puts and asks at once; `cargo bench -p armarium-memoryx -- shared` shows how long opening takes.
            ("open/return_conditions/declares", json!(false)),
            ("scouting/multicast/enabled", json!(self.multicast)),
            ("scouting/gossip/enabled", json!(self.gossip)),
            ("transport/shared_memory/enabled", json!(self.shared_memory)),
            ("transport/link/rx/max_message_size", json!(self.largest_message)),
            // Large payloads have a queue of their own: see `bulk::PRIORITY`.
            ("transport/link/tx/queue/size/data_low", json!(16)),
            (
                "transport/link/tx/queue/congestion_control/drop/max_wait_before_drop_fragments",
                json!(500_000),
            ),
        ];
        if let Some(tls) = &self.tls {
            settings.extend([
                ("transport/link/tls/root_ca_certificate", json!(tls.root_ca)),
                ("transport/link/tls/listen_certificate", json!(tls.certificate)),
                ("transport/link/tls/listen_private_key", json!(tls.private_key)),
                ("transport/link/tls/enable_mtls", json!(tls.mutual)),
            ]);
            if tls.mutual {
                settings.extend([
                    ("transport/link/tls/connect_certificate", json!(tls.certificate)),
                    ("transport/link/tls/connect_private_key", json!(tls.private_key)),
                ]);
            }
        }
        if let Some(rules) = &self.access_control {
            settings.push(("access_control", rules.clone()));
        }
        let mut config = zenoh::Config::default();
        for (name, value) in settings {
            config
                .insert_json5(name, &value.to_string())
                .map_err(|e| SessionError::Config { what: format!("{name}: {e}") })?;
        }
        Ok(config)
    }
}

/// Whether an endpoint `protocol/address[?metadata][#config]` stays on this machine.
fn is_loopback(endpoint: &str) -> bool {
    let Some((protocol, rest)) = endpoint.split_once('/') else { return false };
    if protocol.starts_with("unixsock") || protocol == "unixpipe" {
        return true;
    }
    let address = rest.split(['?', '#']).next().unwrap_or_default();
    let host = address.rsplit_once(':').map_or(address, |(host, _)| host);
    let host = host.trim_start_matches('[').trim_end_matches(']');
    host == "localhost" || host.parse::<std::net::IpAddr>().is_ok_and(|ip| ip.is_loopback())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_this_machine_unless_asked_for() {
        for (endpoint, stays) in [
            ("tcp/127.0.0.1:0", true),
            ("tcp/127.9.9.9:7447#iface=lo", true),
            ("tls/[::1]:7447", true),
            ("tcp/localhost:7447", true),
            ("unixsock-stream//run/alice/socket", true),
            ("tcp/0.0.0.0:7447", false),
            ("tcp/[::]:7447", false),
            ("udp/10.0.0.1:7447", false),
            ("tcp/localhost.example.org:7447", false),
            ("nonsense", false),
        ] {
            assert_eq!(is_loopback(endpoint), stays, "{endpoint}");
            let config = SessionConfig { listen: vec![endpoint.into()], ..SessionConfig::default() };
            assert_eq!(config.to_zenoh().is_ok(), stays, "{endpoint}");
        }
        assert!(SessionConfig { multicast: true, ..SessionConfig::default() }.to_zenoh().is_err());
    }
}

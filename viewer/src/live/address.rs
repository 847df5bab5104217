//! Where a page is served: on this machine, or beyond it. Beyond it, TLS hides what is said, and only who was given the page's address with
//! its token gets an answer; a browser keeps the token as a cookie.

use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::ServerConfig;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::pem::PemObject as _;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};

/// Where a page is to be served.
#[derive(Clone)]
pub struct PageAddress {
    pub(super) socket: SocketAddr,
    /// How it is said that it is who it says, beyond this machine.
    pub(super) tls: Option<TlsAcceptor>,
}

/// Why a certificate cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the names of the fields say what they are")]
pub enum CertificateError {
    /// A file cannot be read, or holds something else.
    #[error("`{}` is no {what} as PEM: {reason}", .file.display())]
    File { file: PathBuf, what: &'static str, reason: String },
    /// The key is that of another certificate, for instance.
    #[error("the certificate and its key cannot be used: {reason}")]
    Pair { reason: String },
}

impl PageAddress {
    /// On this machine. Port 0 is any that is free.
    pub fn loopback(port: u16) -> Self {
        Self { socket: (IpAddr::V4(Ipv4Addr::LOCALHOST), port).into(), tls: None }
    }

    /// At an address of this machine that others can reach, with a certificate (PEM) and its private key.
    ///
    /// # Errors
    /// [`CertificateError`].
    pub fn beyond(socket: SocketAddr, certificate: &Path, key: &Path) -> Result<Self, CertificateError> {
        let wrong = |file: &Path, what| {
            let file = file.to_owned();
            move |error: &dyn std::fmt::Display| CertificateError::File {
                file,
                what,
                reason: error.to_string(),
            }
        };
        let chain =
            CertificateDer::pem_file_iter(certificate).and_then(Iterator::collect::<Result<Vec<_>, _>>);
        let chain = chain.map_err(|error| wrong(certificate, "certificate")(&error))?;
        let secret = PrivateKeyDer::from_pem_file(key).map_err(|error| wrong(key, "private key")(&error))?;
        let pair = |error: tokio_rustls::rustls::Error| CertificateError::Pair { reason: error.to_string() };
        let config = ServerConfig::builder_with_provider(Arc::new(ring::default_provider()));
        let config = config.with_safe_default_protocol_versions().map_err(pair)?;
        let config = config.with_no_client_auth().with_single_cert(chain, secret).map_err(pair)?;
        Ok(Self { socket, tls: Some(TlsAcceptor::from(Arc::new(config))) })
    }

    /// Listens there.
    pub(super) fn listen(&self) -> io::Result<std::net::TcpListener> {
        let listener = std::net::TcpListener::bind(self.socket)?;
        listener.set_nonblocking(true)?;
        Ok(listener)
    }
}

impl Default for PageAddress {
    fn default() -> Self {
        Self::loopback(0)
    }
}

impl std::fmt::Debug for PageAddress {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("PageAddress").field("socket", &self.socket).field("tls", &self.tls.is_some()).finish()
    }
}

impl std::fmt::Display for PageAddress {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.socket.fmt(f)
    }
}

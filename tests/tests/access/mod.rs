//! Mutual TLS and access rules over real sessions: whom a certificate lets in, and with which rights.

mod memory;
mod robot;
mod watching;

use std::path::Path;

use armarium_bus::Tls;
use rcgen::{BasicConstraints, CertificateParams, DnType, IsCa, Issuer, KeyPair};

/// A certificate authority with its folder.
struct Authority<'f> {
    folder: &'f Path,
    issuer: Issuer<'static, KeyPair>,
}

impl<'f> Authority<'f> {
    fn new(folder: &'f Path) -> Self {
        let mut params = CertificateParams::new(Vec::new()).unwrap();
        params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        params.distinguished_name.push(DnType::CommonName, "the authority");
        let key = KeyPair::generate().unwrap();
        std::fs::write(folder.join("ca.pem"), params.self_signed(&key).unwrap().pem()).unwrap();
        Self { folder, issuer: Issuer::new(params, key) }
    }

    /// A certificate for a name on this machine.
    fn tls(&self, name: &str) -> Tls {
        let mut params = CertificateParams::new(vec!["127.0.0.1".to_owned()]).unwrap();
        params.distinguished_name.push(DnType::CommonName, name);
        let key = KeyPair::generate().unwrap();
        let write = |file: String, text: String| {
            let path = self.folder.join(file);
            std::fs::write(&path, text).unwrap();
            path.display().to_string()
        };
        Tls {
            root_ca: self.folder.join("ca.pem").display().to_string(),
            certificate: write(format!("{name}.pem"), params.signed_by(&key, &self.issuer).unwrap().pem()),
            private_key: write(format!("{name}.key"), key.serialize_pem()),
            mutual: true,
        }
    }
}

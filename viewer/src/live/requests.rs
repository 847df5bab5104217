//! Which requests are answered at all: those of the page itself, on this machine.
//!
//! A page of somebody else in the same browser can send requests to loopback. It cannot read the answers, but it could act; and with a
//! name that resolves to this machine (DNS rebinding) it could read, too. So the names of host and origin have to be ours, and
//! who acts has to know the token, which only the page is given.

use std::net::SocketAddr;

use hyper::header::{HOST, HeaderMap, ORIGIN};

/// The header with the token of requests that act.
pub(super) const TOKEN: &str = "x-armarium-token";

/// Why a request is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub(super) enum Refusal {
    #[error("this page is at another address: open the one that `--live` has printed")]
    Host,
    #[error("only the page itself may ask")]
    Origin,
    #[error("who acts needs the token of the page; reload it")]
    Token,
}

/// The names by which the page may be asked for.
#[derive(Clone, Debug)]
pub(super) struct Names(Vec<String>);

impl Names {
    /// Those of a server at this address.
    pub(super) fn of(address: SocketAddr) -> Self {
        let port = address.port();
        Self(vec![address.to_string(), format!("localhost:{port}"), format!("127.0.0.1:{port}")])
    }

    /// Refuses a request of somebody else.
    ///
    /// # Errors
    /// [`Refusal`].
    pub(super) fn check(&self, headers: &HeaderMap) -> Result<(), Refusal> {
        let text =
            |name| headers.get(name).map(|value: &hyper::header::HeaderValue| value.to_str().unwrap_or(""));
        let ours = |host: &str| self.0.iter().any(|name| name.eq_ignore_ascii_case(host));
        if !text(HOST).is_some_and(ours) {
            return Err(Refusal::Host);
        }
        match text(ORIGIN) {
            Some(origin) if !origin.strip_prefix("http://").is_some_and(ours) => Err(Refusal::Origin),
            _ => Ok(()),
        }
    }
}

/// Whether the token is the right one; it takes as long wherever the first difference is.
///
/// # Errors
/// [`Refusal::Token`].
pub(super) fn check_token(headers: &HeaderMap, token: &str) -> Result<(), Refusal> {
    let given = headers.get(TOKEN).map_or(&b""[..], hyper::header::HeaderValue::as_bytes);
    let differs = given.iter().zip(token.as_bytes()).fold(0, |differs, (a, b)| differs | (a ^ b));
    let right = given.len() == token.len() && differs == 0;
    right.then_some(()).ok_or(Refusal::Token)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn headers(list: &[(&'static str, &str)]) -> HeaderMap {
        let entry = |(name, value): &(&'static str, &str)| {
            (hyper::header::HeaderName::from_static(name), value.parse().unwrap())
        };
        list.iter().map(entry).collect()
    }

    #[test]
    fn other_hosts_origins_and_tokens_are_refused() {
        let names = Names::of("127.0.0.1:8123".parse().unwrap());
        let check = |list: &[_]| names.check(&headers(list));
        assert_eq!(check(&[("host", "127.0.0.1:8123")]), Ok(()));
        assert_eq!(check(&[("host", "LOCALHOST:8123"), ("origin", "http://localhost:8123")]), Ok(()));
        for host in ["127.0.0.1", "127.0.0.1:80", "evil.example:8123", ""] {
            assert_eq!(check(&[("host", host)]), Err(Refusal::Host));
        }
        assert_eq!(check(&[]), Err(Refusal::Host));
        for origin in ["http://evil.example", "null", "https://localhost:8123", "http://localhost:1"] {
            assert_eq!(check(&[("host", "localhost:8123"), ("origin", origin)]), Err(Refusal::Origin));
        }
        assert_eq!(check_token(&headers(&[(TOKEN, "abc")]), "abc"), Ok(()));
        for wrong in ["", "ab", "abcd", "abd"] {
            assert_eq!(check_token(&headers(&[(TOKEN, wrong)]), "abc"), Err(Refusal::Token));
        }
        assert_eq!(check_token(&headers(&[]), "abc"), Err(Refusal::Token));
    }
}

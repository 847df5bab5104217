//! Which requests are answered at all.
//!
//! On this machine: those of the page itself. A page of somebody else in the same browser can send requests to loopback. It cannot read the
//! answers, but it could act; and with a name that resolves to this machine (DNS rebinding) it could read, too. So the names of host and
//! origin have to be ours. Beyond this machine: those of who has the token of the address, which a browser keeps as a cookie. And who acts
//! has to know one more token, which only the page is given.

use std::net::SocketAddr;

use hyper::Uri;
use hyper::header::{COOKIE, HOST, HeaderMap, ORIGIN};

/// The header with the token of requests that act.
pub(crate) const TOKEN: &str = "x-armarium-token";

/// Why a request is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum RequestRefusal {
    #[error("this page is at another address: open the one that was printed")]
    Host,
    #[error("only the page itself may ask")]
    Origin,
    #[error("open the whole address that was printed, with its token")]
    Invitation,
    #[error("who acts needs the token of the page; reload it")]
    Token,
}

/// Who is answered.
#[derive(Clone, Debug)]
pub(crate) enum Admission {
    /// Who asks by one of these names of this machine.
    ThisMachine(Vec<String>),
    /// Who has the token, as part of the address or as the value of the cookie of this name.
    Invited { cookie: String, token: String },
}

impl Admission {
    /// That of a server at this address of this machine.
    pub(crate) fn of(address: SocketAddr) -> Self {
        let port = address.port();
        Self::ThisMachine(vec![address.to_string(), format!("localhost:{port}"), format!("127.0.0.1:{port}")])
    }

    /// That of a server which others can reach.
    pub(crate) fn invited(address: SocketAddr, token: String) -> Self {
        Self::Invited { cookie: format!("armarium-{}", address.port()), token }
    }

    /// Refuses a request of somebody else. Returns the cookie that a browser is to keep, if it came with the token in the address.
    pub(crate) fn check(&self, uri: &Uri, headers: &HeaderMap) -> Result<Option<String>, RequestRefusal> {
        let text =
            |name| headers.get(name).map(|value: &hyper::header::HeaderValue| value.to_str().unwrap_or(""));
        let host = text(HOST).ok_or(RequestRefusal::Host)?;
        match self {
            Self::ThisMachine(names) => {
                let ours = |host: &str| names.iter().any(|name| name.eq_ignore_ascii_case(host));
                if !ours(host) {
                    return Err(RequestRefusal::Host);
                }
                match text(ORIGIN) {
                    Some(origin) if !origin.strip_prefix("http://").is_some_and(ours) => {
                        Err(RequestRefusal::Origin)
                    }
                    _ => Ok(None),
                }
            }
            Self::Invited { cookie, token } => {
                if text(ORIGIN).is_some_and(|origin| origin.strip_prefix("https://") != Some(host)) {
                    return Err(RequestRefusal::Origin);
                }
                let given = uri.query().and_then(|query| query.strip_prefix("token="));
                if given.is_some_and(|given| is_same(given.as_bytes(), token)) {
                    return Ok(Some(format!("{cookie}={token}; HttpOnly; Secure; SameSite=Strict; Path=/")));
                }
                let mut kept = text(COOKIE).unwrap_or("").split("; ").filter_map(|pair| pair.split_once('='));
                let kept = kept.find(|(name, _)| name == cookie);
                let known = kept.is_some_and(|(_, given)| is_same(given.as_bytes(), token));
                known.then_some(None).ok_or(RequestRefusal::Invitation)
            }
        }
    }
}

/// Whether the token is the right one; it takes as long wherever the first difference is.
fn is_same(given: &[u8], token: &str) -> bool {
    let differs = given.iter().zip(token.as_bytes()).fold(0, |differs, (a, b)| differs | (a ^ b));
    given.len() == token.len() && differs == 0
}

/// Whether the request comes with the token of who acts.
pub(crate) fn check_token(headers: &HeaderMap, token: &str) -> Result<(), RequestRefusal> {
    let given = headers.get(TOKEN).map_or(&b""[..], hyper::header::HeaderValue::as_bytes);
    is_same(given, token).then_some(()).ok_or(RequestRefusal::Token)
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
        let admission = Admission::of("127.0.0.1:8123".parse().unwrap());
        let check = |list: &[_]| admission.check(&Uri::from_static("/"), &headers(list));
        assert_eq!(check(&[("host", "127.0.0.1:8123")]), Ok(None));
        assert_eq!(check(&[("host", "LOCALHOST:8123"), ("origin", "http://localhost:8123")]), Ok(None));
        for host in ["127.0.0.1", "127.0.0.1:80", "evil.example:8123", ""] {
            assert_eq!(check(&[("host", host)]), Err(RequestRefusal::Host));
        }
        assert_eq!(check(&[]), Err(RequestRefusal::Host));
        for origin in ["http://evil.example", "null", "https://localhost:8123", "http://localhost:1"] {
            assert_eq!(check(&[("host", "localhost:8123"), ("origin", origin)]), Err(RequestRefusal::Origin));
        }
        assert_eq!(check_token(&headers(&[(TOKEN, "abc")]), "abc"), Ok(()));
        for wrong in ["", "ab", "abcd", "abd"] {
            assert_eq!(check_token(&headers(&[(TOKEN, wrong)]), "abc"), Err(RequestRefusal::Token));
        }
        assert_eq!(check_token(&headers(&[]), "abc"), Err(RequestRefusal::Token));
    }

    #[test]
    fn beyond_this_machine_the_token_admits_and_the_cookie_keeps_it() {
        let admission = Admission::invited("192.0.2.7:8123".parse().unwrap(), "abc".into());
        let check = |path: &'static str, list: &[_]| admission.check(&Uri::from_static(path), &headers(list));
        let host = ("host", "robot.example:8123");
        let cookie = check("/?token=abc", &[host]).unwrap().unwrap();
        assert!(cookie.starts_with("armarium-8123=abc; HttpOnly; Secure; SameSite=Strict"), "{cookie}");
        assert_eq!(check("/run", &[host, ("cookie", "other=1; armarium-8123=abc")]), Ok(None));
        for path in ["/", "/?token=", "/?token=abd", "/?x=1&token=abc"] {
            assert_eq!(
                check(path, &[host, ("cookie", "armarium-8123=ab")]),
                Err(RequestRefusal::Invitation),
                "{path}"
            );
        }
        assert_eq!(
            check("/?token=abc", &[host, ("origin", "https://evil.example")]),
            Err(RequestRefusal::Origin)
        );
        assert_eq!(check("/?token=abc", &[]), Err(RequestRefusal::Host));
    }
}

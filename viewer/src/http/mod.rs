//! The server of every page: bounded in connections, sizes and times, answers only whom its [`Admission`] lets in. It knows no page.

mod admission;

use std::convert::Infallible;
use std::io;
use std::sync::Arc;
use std::time::Duration;

use armarium_robot::Throttled;
use http_body_util::combinators::BoxBody;
use http_body_util::{BodyExt as _, Full, Limited};
use hyper::body::{Bytes, Incoming};
use hyper::header::{HeaderName, HeaderValue};
use hyper::service::service_fn;
use hyper::{Request, Response, StatusCode};
use hyper_util::rt::{TokioIo, TokioTimer};
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::sync::Semaphore;
use tokio_io_timeout::TimeoutStream;
use tokio_rustls::TlsAcceptor;

pub(crate) use admission::{Admission, RequestRefusal, check_token};

/// Most connections at a time; more are closed at once.
const MOST_CONNECTIONS: usize = 128;
/// Most bytes of a request's head, and of what is posted.
const MOST_HEAD: usize = 16 << 10;
const MOST_BODY: usize = 64 << 10;
/// How long the head of a request may take, and what is posted.
const HEAD_WITHIN: Duration = Duration::from_secs(10);
/// How long a connection is kept that takes nothing of its answer.
const TAKEN_WITHIN: Duration = Duration::from_secs(10);
/// The headers of every answer.
const HEADERS: [(&str, &str); 5] = [
    ("cache-control", "no-store"),
    ("x-content-type-options", "nosniff"),
    ("referrer-policy", "no-referrer"),
    ("cross-origin-resource-policy", "same-origin"),
    (
        "content-security-policy",
        "default-src 'self'; img-src 'self' data: blob:; style-src 'self' 'unsafe-inline'; frame-ancestors 'self'",
    ),
];

pub(crate) const HTML: &str = "text/html; charset=utf-8";
pub(crate) const SCRIPT: &str = "text/javascript; charset=utf-8";

pub(crate) type Body = BoxBody<Bytes, Infallible>;

/// What a page answers.
pub(crate) trait Site: Send + Sync + 'static {
    /// Answers a request of somebody who is let in, or refuses it.
    fn answer(
        &self,
        request: Request<Incoming>,
    ) -> impl Future<Output = Result<Response<Body>, RequestRefusal>> + Send;
}

/// A page with the requests that it answers.
pub(crate) struct PageServer<S> {
    site: S,
    admission: Admission,
    refused: Throttled,
}

/// A text that nobody can guess.
pub(crate) fn token() -> io::Result<String> {
    let mut bytes = [0; 16];
    getrandom::fill(&mut bytes).map_err(|error| io::Error::other(error.to_string()))?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

impl<S: Site> PageServer<S> {
    pub(crate) fn new(site: S, admission: Admission) -> Arc<Self> {
        Arc::new(Self { site, admission, refused: Throttled::default() })
    }

    /// Answers until it is dropped.
    pub(crate) async fn serve(self: Arc<Self>, listener: tokio::net::TcpListener, tls: Option<TlsAcceptor>) {
        let places = Arc::new(Semaphore::new(MOST_CONNECTIONS));
        loop {
            let Ok((stream, _)) = listener.accept().await else {
                // Too many open files, for instance: it passes.
                tokio::time::sleep(Duration::from_millis(100)).await;
                continue;
            };
            let Ok(place) = Arc::clone(&places).try_acquire_owned() else {
                self.refused
                    .warn(format_args!("a page has {MOST_CONNECTIONS} connections; one more was closed"));
                continue;
            };
            let (server, tls) = (Arc::clone(&self), tls.clone());
            tokio::spawn(async move {
                match tls {
                    None => server.converse(stream).await,
                    Some(tls) => {
                        if let Ok(Ok(stream)) = tokio::time::timeout(HEAD_WITHIN, tls.accept(stream)).await {
                            server.converse(stream).await;
                        }
                    }
                }
                drop(place);
            });
        }
    }

    /// Answers the requests of one connection, until it is closed or too slow.
    async fn converse(self: Arc<Self>, stream: impl AsyncRead + AsyncWrite) {
        let mut stream = TimeoutStream::new(stream);
        stream.set_write_timeout(Some(TAKEN_WITHIN));
        let answering = service_fn(|request| async { Ok::<_, Infallible>(self.answer(request).await) });
        let mut connection = hyper::server::conn::http1::Builder::new();
        connection.timer(TokioTimer::new()).header_read_timeout(HEAD_WITHIN).max_buf_size(MOST_HEAD);
        // A browser that goes away is no error.
        let _ = connection.serve_connection(TokioIo::new(Box::pin(stream)), answering).await.is_ok();
    }

    async fn answer(&self, request: Request<Incoming>) -> Response<Body> {
        let answered = match self.admission.check(request.uri(), request.headers()) {
            Err(refusal) => Err(refusal),
            Ok(Some(cookie)) => Ok(welcome(request.uri().path(), &cookie)),
            Ok(None) => self.site.answer(request).await,
        };
        let mut answer = answered.unwrap_or_else(|refusal| {
            self.refused.warn(format_args!("a page refused a request: {refusal}"));
            plain(StatusCode::FORBIDDEN, refusal.to_string())
        });
        for (name, value) in HEADERS {
            answer.headers_mut().insert(HeaderName::from_static(name), HeaderValue::from_static(value));
        }
        answer
    }
}

/// What is posted by who has the token of the page, read as JSON; inside, the answer to what is too long, too slow or something else.
pub(crate) async fn posted<T: serde::de::DeserializeOwned>(
    request: Request<Incoming>,
    token: &str,
) -> Result<Result<T, Response<Body>>, RequestRefusal> {
    check_token(request.headers(), token)?;
    let whole =
        tokio::time::timeout(HEAD_WITHIN, Limited::new(request.into_body(), MOST_BODY).collect()).await;
    let Ok(Ok(whole)) = whole else {
        let why = format!("what is posted has {MOST_BODY} bytes at most");
        return Ok(Err(plain(StatusCode::PAYLOAD_TOO_LARGE, why)));
    };
    let read = serde_json::from_slice(&whole.to_bytes());
    Ok(read.map_err(|error| plain(StatusCode::BAD_REQUEST, format!("this cannot be read: {error}"))))
}

/// Gives a browser the cookie, and sends it on to the address without the token.
fn welcome(path: &str, cookie: &str) -> Response<Body> {
    let mut answer = plain(StatusCode::SEE_OTHER, String::new());
    for (name, value) in [("location", path), ("set-cookie", cookie)] {
        if let Ok(value) = HeaderValue::from_str(value) {
            answer.headers_mut().insert(HeaderName::from_static(name), value);
        }
    }
    answer
}

pub(crate) fn respond(status: StatusCode, kind: &str, body: Body) -> Response<Body> {
    let mut response = Response::new(body);
    *response.status_mut() = status;
    if let Ok(kind) = HeaderValue::from_str(kind) {
        response.headers_mut().insert("content-type", kind);
    }
    response
}

pub(crate) fn body(status: StatusCode, kind: &str, content: Bytes) -> Response<Body> {
    respond(status, kind, Full::new(content).boxed())
}

pub(crate) fn json(text: String) -> Response<Body> {
    body(StatusCode::OK, "application/json", Bytes::from(text))
}

pub(crate) fn plain(status: StatusCode, text: String) -> Response<Body> {
    body(status, "text/plain; charset=utf-8", Bytes::from(text))
}

#[cfg(test)]
mod tests {
    use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
    use tokio::time::Instant;

    use super::*;

    struct Nothing;

    impl Site for Nothing {
        async fn answer(&self, _: Request<Incoming>) -> Result<Response<Body>, RequestRefusal> {
            Ok(plain(StatusCode::NOT_FOUND, "there is nothing".repeat(1000)))
        }
    }

    fn server() -> Arc<PageServer<Nothing>> {
        PageServer::new(Nothing, Admission::of("127.0.0.1:8123".parse().unwrap()))
    }

    /// How long a connection is kept that sends this and then nothing more, and takes nothing of the answer.
    async fn kept(sent: &[u8]) -> Duration {
        let (mut theirs, ours) = tokio::io::duplex(1 << 10);
        theirs.write_all(sent).await.unwrap();
        let began = Instant::now();
        server().converse(ours).await;
        began.elapsed()
    }

    #[tokio::test(start_paused = true)]
    async fn who_is_slow_does_not_keep_its_place() {
        let soon = TAKEN_WITHIN..TAKEN_WITHIN + Duration::from_secs(2);
        assert!(soon.contains(&kept(b"").await), "without a request");
        assert!(soon.contains(&kept(b"GET / HTTP/1.1\r\nHost: 127.0").await), "with half a head");
        let whole = b"GET /app.js HTTP/1.1\r\nHost: 127.0.0.1:8123\r\n\r\n";
        assert!(soon.contains(&kept(whole).await), "with an answer that it does not read");
    }

    #[tokio::test(start_paused = true)]
    async fn who_asks_for_a_web_socket_gets_a_page_and_its_garbage_ends_the_connection() {
        let (mut theirs, ours) = tokio::io::duplex(1 << 20);
        let head =
            b"GET / HTTP/1.1\r\nHost: 127.0.0.1:8123\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\r\n";
        theirs.write_all(head).await.unwrap();
        theirs.write_all(&[0x81, 0xff, 0xff, 0xff, 0x00, 0x01, 0xfe].repeat(1000)).await.unwrap();
        server().converse(ours).await;
        let mut answer = Vec::new();
        theirs.read_to_end(&mut answer).await.unwrap();
        let answer = String::from_utf8_lossy(&answer);
        assert!(answer.starts_with("HTTP/1.1 404") && !answer.contains("101 Switching"), "{answer}");
    }
}

//! The server of a page: files, questions, news, actions.

use std::convert::Infallible;
use std::io;
use std::sync::Arc;
use std::time::Duration;

use armarium_robot::Throttled;
use http_body_util::combinators::BoxBody;
use http_body_util::{BodyExt as _, Full, Limited, StreamBody};
use hyper::body::{Bytes, Frame, Incoming};
use hyper::header::{HeaderName, HeaderValue};
use hyper::service::service_fn;
use hyper::{Method, Request, Response, StatusCode};
use hyper_util::rt::{TokioIo, TokioTimer};
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::sync::{Semaphore, broadcast};
use tokio_io_timeout::TimeoutStream;
use tokio_rustls::TlsAcceptor;

use super::Action;
use super::assets::ASSETS;
use super::requests::{Admission, Refusal, check_token};
use super::runs::ShownRuns;
use super::shown::PageAnswer;
use crate::report::scoped_style;

/// Most connections at a time; more are closed at once.
const MOST_CONNECTIONS: usize = 128;
/// Most bytes of a request's head, and of what an action says.
const MOST_HEAD: usize = 16 << 10;
const MOST_BODY: usize = 64 << 10;
/// How long the head of a request may take, and what an action says.
const HEAD_WITHIN: Duration = Duration::from_secs(10);
/// How long a connection is kept that takes nothing of its answer.
const TAKEN_WITHIN: Duration = Duration::from_secs(10);
/// How often they are told that nothing is.
const ALIVE: Duration = Duration::from_secs(5);
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

type Body = BoxBody<Bytes, Infallible>;

/// Where one of several runs is asked for, by its number; the list of them is there without the slash at the end.
const RUNS: &str = "/runs/";
/// The page of a run.
const PAGE: &str = include_str!("page/index.html");

struct Shared {
    runs: ShownRuns,
    admission: Admission,
    token: String,
    refused: Throttled,
}

/// Answers until it is dropped.
pub(super) async fn serve(
    listener: std::net::TcpListener,
    tls: Option<TlsAcceptor>,
    admission: Admission,
    runs: ShownRuns,
) {
    let Ok(listener) = tokio::net::TcpListener::from_std(listener) else { return };
    let Ok(token) = token() else { return };
    accept(listener, tls, Arc::new(Shared { runs, admission, token, refused: Throttled::default() })).await;
}

/// A text that nobody can guess.
pub(super) fn token() -> io::Result<String> {
    let mut bytes = [0; 16];
    getrandom::fill(&mut bytes).map_err(|error| io::Error::other(error.to_string()))?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

async fn accept(listener: tokio::net::TcpListener, tls: Option<TlsAcceptor>, shared: Arc<Shared>) {
    let places = Arc::new(Semaphore::new(MOST_CONNECTIONS));
    loop {
        let Ok((stream, _)) = listener.accept().await else {
            // Too many open files, for instance: it passes.
            tokio::time::sleep(Duration::from_millis(100)).await;
            continue;
        };
        let Ok(place) = Arc::clone(&places).try_acquire_owned() else {
            shared
                .refused
                .warn(format_args!("the live page has {MOST_CONNECTIONS} connections; one more was closed"));
            continue;
        };
        let (shared, tls) = (Arc::clone(&shared), tls.clone());
        tokio::spawn(async move {
            match tls {
                None => shared.converse(stream).await,
                Some(tls) => {
                    if let Ok(Ok(stream)) = tokio::time::timeout(HEAD_WITHIN, tls.accept(stream)).await {
                        shared.converse(stream).await;
                    }
                }
            }
            drop(place);
        });
    }
}

impl Shared {
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
        let mut answer = match self.admission.check(request.uri(), request.headers()) {
            Err(refusal) => self.refuse(refusal),
            Ok(Some(cookie)) => welcome(request.uri().path(), &cookie),
            Ok(None) => match *request.method() {
                Method::GET => self.get(&request).await,
                Method::POST => self.post(request).await,
                _ => plain(StatusCode::METHOD_NOT_ALLOWED, "GET or POST".to_owned()),
            },
        };
        for (name, value) in HEADERS {
            answer.headers_mut().insert(HeaderName::from_static(name), HeaderValue::from_static(value));
        }
        answer
    }

    fn refuse(&self, refusal: Refusal) -> Response<Body> {
        self.refused.warn(format_args!("the live page refused a request: {refusal}"));
        plain(StatusCode::FORBIDDEN, refusal.to_string())
    }

    async fn get(&self, request: &Request<Incoming>) -> Response<Body> {
        let path = request.uri().path();
        if let Some((_, kind, content)) = ASSETS.iter().find(|(known, ..)| *known == path) {
            return body(StatusCode::OK, kind, Bytes::from_static(content.as_bytes()));
        }
        if path == "/report.css" {
            return body(StatusCode::OK, "text/css; charset=utf-8", Bytes::from(scoped_style()));
        }
        if path == RUNS.trim_end_matches('/') {
            return json(self.runs.json());
        }
        let whole = request.uri().path_and_query().map_or("/", |whole| whole.as_str());
        let (number, question) = match whole.strip_prefix(RUNS).and_then(|rest| rest.split_once('/')) {
            Some((number, question)) => (number.parse().unwrap_or(u64::MAX), question),
            None => (0, &whole[1..]),
        };
        let Some(run) = self.runs.get(number) else {
            return plain(StatusCode::NOT_FOUND, "there is no such run, or no more".to_owned());
        };
        if question.is_empty() {
            return body(StatusCode::OK, "text/html; charset=utf-8", Bytes::from_static(PAGE.as_bytes()));
        }
        if question == "news" {
            return stream(run.news());
        }
        let PageAnswer { status, kind, about, mut content } = run.answer(question).await;
        if question == "run" && run.may_act() {
            let token = format!("{{\"token\":\"{}\",", self.token);
            content.splice(..1, token.bytes());
        }
        let status = StatusCode::from_u16(status).unwrap_or(StatusCode::BAD_GATEWAY);
        let mut answer = body(status, &kind, Bytes::from(content));
        if let (false, Ok(about)) = (about.is_empty(), HeaderValue::from_str(&about)) {
            answer.headers_mut().insert("x-about", about);
        }
        answer
    }

    async fn post(&self, request: Request<Incoming>) -> Response<Body> {
        let path = request.uri().path();
        let number = match path.strip_prefix(RUNS).and_then(|rest| rest.strip_suffix("/act")) {
            Some(number) => number.parse().ok(),
            None => (path == "/act").then_some(0),
        };
        let Some(run) = number.and_then(|number| self.runs.get(number)).filter(|run| run.may_act()) else {
            let why = "this page only looks: `--live-control` lets it act";
            return plain(StatusCode::FORBIDDEN, why.to_owned());
        };
        if let Err(refusal) = check_token(request.headers(), &self.token) {
            return self.refuse(refusal);
        }
        let whole =
            tokio::time::timeout(HEAD_WITHIN, Limited::new(request.into_body(), MOST_BODY).collect()).await;
        let Ok(Ok(whole)) = whole else {
            return plain(StatusCode::PAYLOAD_TOO_LARGE, format!("an action has {MOST_BODY} bytes at most"));
        };
        let action: Action = match serde_json::from_slice(&whole.to_bytes()) {
            Ok(action) => action,
            Err(error) => return plain(StatusCode::BAD_REQUEST, format!("this is no action: {error}")),
        };
        match run.act(action) {
            Ok(paused) => json(format!("{{\"paused\":{paused}}}")),
            Err(refused) => plain(StatusCode::CONFLICT, refused.to_string()),
        }
    }
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

/// News as server-sent events, until the page goes or is too slow: it then asks for all again.
fn stream(news: broadcast::Receiver<Arc<[u8]>>) -> Response<Body> {
    let next = futures::stream::unfold(news, |mut news| async move {
        let event = match tokio::time::timeout(ALIVE, news.recv()).await {
            Ok(Ok(event)) => [b"data: ", &event[..], b"\n\n"].concat().into(),
            Ok(Err(broadcast::error::RecvError::Lagged(_))) => {
                Bytes::from_static(b"event: missed\ndata: \n\n")
            }
            Ok(Err(broadcast::error::RecvError::Closed)) => return None,
            Err(_) => Bytes::from_static(b": nothing new\n\n"),
        };
        Some((Ok(Frame::data(event)), news))
    });
    let stream = StreamBody::new(next).boxed();
    respond(StatusCode::OK, "text/event-stream", stream)
}

fn respond(status: StatusCode, kind: &str, body: Body) -> Response<Body> {
    let mut response = Response::new(body);
    *response.status_mut() = status;
    if let Ok(kind) = HeaderValue::from_str(kind) {
        response.headers_mut().insert("content-type", kind);
    }
    response
}

fn body(status: StatusCode, kind: &str, content: Bytes) -> Response<Body> {
    respond(status, kind, Full::new(content).boxed())
}

fn json(text: String) -> Response<Body> {
    body(StatusCode::OK, "application/json", Bytes::from(text))
}

fn plain(status: StatusCode, text: String) -> Response<Body> {
    body(status, "text/plain; charset=utf-8", Bytes::from(text))
}

#[cfg(test)]
mod tests {
    use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
    use tokio::time::Instant;

    use super::*;

    fn shared() -> Arc<Shared> {
        let admission = Admission::of("127.0.0.1:8123".parse().unwrap());
        Arc::new(Shared {
            runs: ShownRuns::default(),
            admission,
            token: "abc".into(),
            refused: Throttled::default(),
        })
    }

    /// How long a connection is kept that sends this and then nothing more, and takes nothing of the answer.
    async fn kept(sent: &[u8]) -> Duration {
        let (mut theirs, ours) = tokio::io::duplex(1 << 10);
        theirs.write_all(sent).await.unwrap();
        let began = Instant::now();
        shared().converse(ours).await;
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
        shared().converse(ours).await;
        let mut answer = Vec::new();
        theirs.read_to_end(&mut answer).await.unwrap();
        let answer = String::from_utf8_lossy(&answer);
        assert!(answer.starts_with("HTTP/1.1 404") && !answer.contains("101 Switching"), "{answer}");
    }
}

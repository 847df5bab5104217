//! The server of a page: files, questions, news, actions.

use std::convert::Infallible;
use std::io;
use std::sync::Arc;
use std::time::Duration;

use http_body_util::combinators::BoxBody;
use http_body_util::{BodyExt as _, Full, Limited, StreamBody};
use hyper::body::{Bytes, Frame, Incoming};
use hyper::header::{HeaderName, HeaderValue};
use hyper::service::service_fn;
use hyper::{Method, Request, Response, StatusCode};
use hyper_util::rt::{TokioIo, TokioTimer};
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::sync::{Semaphore, broadcast};
use tokio_rustls::TlsAcceptor;

use super::Action;
use super::assets::ASSETS;
use super::requests::{Admission, check_token};
use super::runs::ShownRuns;
use super::shown::PageAnswer;
use crate::report::scoped_style;

/// Most connections at a time; more are closed at once.
const MOST_CONNECTIONS: usize = 128;
/// Most bytes of a request's head, and of what an action says.
const MOST_HEAD: usize = 16 << 10;
const MOST_BODY: usize = 64 << 10;
/// How long the head of a request may take, and an answer that nobody reads.
const HEAD_WITHIN: Duration = Duration::from_secs(10);
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
    accept(listener, tls, Arc::new(Shared { runs, admission, token })).await;
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
        let Ok(place) = Arc::clone(&places).try_acquire_owned() else { continue };
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
    /// Answers the requests of one connection.
    async fn converse(self: Arc<Self>, stream: impl AsyncRead + AsyncWrite + Unpin) {
        let answering = service_fn(|request| async { Ok::<_, Infallible>(self.answer(request).await) });
        let mut connection = hyper::server::conn::http1::Builder::new();
        connection.timer(TokioTimer::new()).header_read_timeout(HEAD_WITHIN).max_buf_size(MOST_HEAD);
        // A browser that goes away is no error.
        let _ = connection.serve_connection(TokioIo::new(stream), answering).await.is_ok();
    }

    async fn answer(&self, request: Request<Incoming>) -> Response<Body> {
        let mut answer = match self.admission.check(request.uri(), request.headers()) {
            Err(refusal) => plain(StatusCode::FORBIDDEN, refusal.to_string()),
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
            tracing::warn!("a request to act was refused: {refusal}");
            return plain(StatusCode::FORBIDDEN, refusal.to_string());
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

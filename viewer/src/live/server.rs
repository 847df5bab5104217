//! The server of a page: files, questions, news, actions.

use std::convert::Infallible;
use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use http_body_util::combinators::BoxBody;
use http_body_util::{BodyExt as _, Full, Limited, StreamBody};
use hyper::body::{Bytes, Frame, Incoming};
use hyper::header::{HeaderName, HeaderValue};
use hyper::service::service_fn;
use hyper::{Method, Request, Response, StatusCode};
use hyper_util::rt::{TokioIo, TokioTimer};
use tokio::sync::{Semaphore, broadcast};

use super::Action;
use super::assets::ASSETS;
use super::requests::{Names, check_token};
use super::shown::{PageAnswer, ShownRun};
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

/// Where the second of two runs is asked for.
const OTHER: &str = "/other/";

struct Shared {
    runs: Vec<Arc<dyn ShownRun>>,
    names: Names,
    token: String,
}

/// Answers until it is dropped.
pub(super) async fn serve(
    listener: std::net::TcpListener,
    address: SocketAddr,
    runs: Vec<Arc<dyn ShownRun>>,
) {
    let Ok(listener) = tokio::net::TcpListener::from_std(listener) else { return };
    let Ok(token) = token() else { return };
    accept(listener, Arc::new(Shared { runs, names: Names::of(address), token })).await;
}

/// A text that nobody can guess.
fn token() -> io::Result<String> {
    let mut bytes = [0; 16];
    getrandom::fill(&mut bytes).map_err(|error| io::Error::other(error.to_string()))?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

async fn accept(listener: tokio::net::TcpListener, shared: Arc<Shared>) {
    let places = Arc::new(Semaphore::new(MOST_CONNECTIONS));
    loop {
        let Ok((stream, _)) = listener.accept().await else {
            // Too many open files, for instance: it passes.
            tokio::time::sleep(Duration::from_millis(100)).await;
            continue;
        };
        let Ok(place) = Arc::clone(&places).try_acquire_owned() else { continue };
        let shared = Arc::clone(&shared);
        tokio::spawn(async move {
            let answering = service_fn(move |request| {
                let shared = Arc::clone(&shared);
                async move { Ok::<_, Infallible>(shared.answer(request).await) }
            });
            let mut connection = hyper::server::conn::http1::Builder::new();
            connection.timer(TokioTimer::new()).header_read_timeout(HEAD_WITHIN).max_buf_size(MOST_HEAD);
            // A browser that goes away is no error.
            let _ = connection.serve_connection(TokioIo::new(stream), answering).await.is_ok();
            drop(place);
        });
    }
}

impl Shared {
    async fn answer(&self, request: Request<Incoming>) -> Response<Body> {
        let mut answer = match self.names.check(request.headers()) {
            Err(refusal) => plain(StatusCode::FORBIDDEN, refusal.to_string()),
            Ok(()) => match *request.method() {
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
        let whole = request.uri().path_and_query().map_or("/", |whole| whole.as_str());
        let (run, question) = match whole.strip_prefix(OTHER) {
            Some(question) => (self.runs.get(1), question),
            None => (self.runs.first(), &whole[1..]),
        };
        let Some(run) = run else { return plain(StatusCode::NOT_FOUND, "there is only one run".to_owned()) };
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
        let Some(run) = self.runs.first().filter(|run| run.may_act() && request.uri().path() == "/act")
        else {
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

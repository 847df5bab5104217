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

use super::assets::ASSETS;
use super::requests::{Names, check_token};
use super::timeline::{Told, text};
use super::{Action, LiveConfig};
use crate::report::{fragment, scoped_style};

/// Most connections at a time; more are closed at once.
const MOST_CONNECTIONS: usize = 128;
/// Most bytes of a request's head, and of what an action says.
const MOST_HEAD: usize = 16 << 10;
const MOST_BODY: usize = 64 << 10;
/// How long the head of a request may take, and an answer that nobody reads.
const HEAD_WITHIN: Duration = Duration::from_secs(10);
/// How often pages are told what is new.
const NEWS: Duration = Duration::from_millis(40);
/// How often they are told that nothing is.
const ALIVE: Duration = Duration::from_secs(5);
/// News that may wait for a slow page.
const WAITING: usize = 32;
/// Most points of one curve.
const MOST_POINTS: usize = 4000;

/// The headers of every answer.
const HEADERS: [(&str, &str); 5] = [
    ("cache-control", "no-store"),
    ("x-content-type-options", "nosniff"),
    ("referrer-policy", "no-referrer"),
    ("cross-origin-resource-policy", "same-origin"),
    (
        "content-security-policy",
        "default-src 'self'; img-src 'self' data: blob:; style-src 'self' 'unsafe-inline'; frame-ancestors 'none'",
    ),
];

type Body = BoxBody<Bytes, Infallible>;

struct Shared {
    config: LiveConfig,
    names: Names,
    token: String,
    /// News for all pages; the same bytes.
    news: broadcast::Sender<Bytes>,
}

/// Answers until it is dropped.
pub(super) async fn serve(listener: std::net::TcpListener, address: SocketAddr, config: LiveConfig) {
    let Ok(listener) = tokio::net::TcpListener::from_std(listener) else { return };
    let Ok(token) = token() else { return };
    let (news, _) = broadcast::channel(WAITING);
    let shared = Arc::new(Shared { config, names: Names::of(address), token, news });
    let accepting = accept(listener, Arc::clone(&shared));
    tokio::join!(accepting, tell(shared));
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

/// Tells all pages what is new, as long as there are any.
async fn tell(shared: Arc<Shared>) {
    let mut told = Told::default();
    let mut tick = tokio::time::interval(NEWS);
    tick.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    loop {
        tick.tick().await;
        if shared.news.receiver_count() == 0 {
            continue;
        }
        if let Some(news) = shared.config.timeline.news(&mut told) {
            let _ = shared.news.send(Bytes::from(format!("data: {}\n\n", news.json())));
        }
    }
}

impl Shared {
    async fn answer(&self, request: Request<Incoming>) -> Response<Body> {
        let mut answer = match self.names.check(request.headers()) {
            Err(refusal) => plain(StatusCode::FORBIDDEN, refusal.to_string()),
            Ok(()) => match *request.method() {
                Method::GET => self.get(&request),
                Method::POST => self.post(request).await,
                _ => plain(StatusCode::METHOD_NOT_ALLOWED, "GET or POST".to_owned()),
            },
        };
        for (name, value) in HEADERS {
            answer.headers_mut().insert(HeaderName::from_static(name), HeaderValue::from_static(value));
        }
        answer
    }

    fn get(&self, request: &Request<Incoming>) -> Response<Body> {
        let (path, query) = (request.uri().path(), request.uri().query().unwrap_or(""));
        if let Some((_, kind, content)) = ASSETS.iter().find(|(known, ..)| *known == path) {
            return body(StatusCode::OK, kind, Bytes::from_static(content.as_bytes()));
        }
        let asked = |name: &str| field(query, name);
        let number =
            |name: &str| asked(name).and_then(|text| text.parse::<f64>().ok()).filter(|n| n.is_finite());
        let stamp_ns = number("t").map_or(u64::MAX, |t| (t.max(0.0) * 1e9) as u64);
        let timeline = &self.config.timeline;
        match path {
            "/report.css" => body(StatusCode::OK, "text/css; charset=utf-8", Bytes::from(scoped_style())),
            "/run" => json(self.run()),
            "/chart" => match timeline.chart(asked("closed").as_deref()) {
                Some((closed, picture)) => {
                    let mut answer = body(StatusCode::OK, "image/svg+xml", Bytes::from(picture));
                    if let Ok(closed) = HeaderValue::from_str(&closed) {
                        answer.headers_mut().insert("x-closed", closed);
                    }
                    answer
                }
                None => plain(StatusCode::NOT_FOUND, "the chart of this run is not known".to_owned()),
            },
            "/images" => json(text(&timeline.images())),
            "/news" => self.stream(),
            "/poses" => json(text(&timeline.poses(stamp_ns))),
            "/series" => {
                let (Some(topic), Some(name)) = (asked("topic"), asked("name")) else {
                    return plain(StatusCode::BAD_REQUEST, "`topic` and `name` are needed".to_owned());
                };
                let range = [number("from").unwrap_or(0.0), number("to").unwrap_or(f64::MAX)];
                let points = (number("points").unwrap_or(800.0).max(1.0) as usize).min(MOST_POINTS);
                match timeline.series(&topic, &name, range, points / 4) {
                    Some(pieces) => json(text(&pieces)),
                    None => plain(StatusCode::NOT_FOUND, format!("the run has no `{name}` on `{topic}`")),
                }
            }
            "/image" => match asked("topic").and_then(|topic| timeline.image(&topic, stamp_ns)) {
                Some((stamp_ns, jpeg)) => {
                    let mut answer = body(StatusCode::OK, "image/jpeg", Bytes::from_owner(jpeg));
                    answer.headers_mut().insert("x-stamp-ns", HeaderValue::from(stamp_ns));
                    answer
                }
                None => plain(StatusCode::NOT_FOUND, "there is no such image".to_owned()),
            },
            "/report" => {
                let sections = self.config.report.as_ref().map(|report| report()).unwrap_or_default();
                body(StatusCode::OK, "text/html; charset=utf-8", Bytes::from(fragment(&sections)))
            }
            _ => plain(StatusCode::NOT_FOUND, "there is nothing here".to_owned()),
        }
    }

    /// What a page needs at first, with the token if it may act.
    fn run(&self) -> String {
        let all = self.config.timeline.all().json();
        let token = self.config.control.is_some().then_some(&self.token);
        let paused = self.config.control.as_ref().is_some_and(|control| control.is_paused());
        format!("{{\"token\":{},\"paused\":{paused},{}", text(&token), &all[1..])
    }

    /// Server-sent events, until the page goes or is too slow: it then asks for all again.
    fn stream(&self) -> Response<Body> {
        let news = self.news.subscribe();
        let next = futures::stream::unfold(news, |mut news| async move {
            let event = match tokio::time::timeout(ALIVE, news.recv()).await {
                Ok(Ok(event)) => event,
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

    async fn post(&self, request: Request<Incoming>) -> Response<Body> {
        let Some(control) = self.config.control.as_ref().filter(|_| request.uri().path() == "/act") else {
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
        match control.act(action) {
            Ok(()) => json(format!("{{\"paused\":{}}}", control.is_paused())),
            Err(refused) => plain(StatusCode::CONFLICT, refused.to_string()),
        }
    }
}

/// A field of a query, with `%20` and `+` read.
fn field(query: &str, name: &str) -> Option<String> {
    let fields = query.split('&').filter_map(|field| field.split_once('='));
    let (_, value) = fields.into_iter().find(|(known, _)| *known == name)?;
    let mut bytes = value.bytes();
    let mut read = Vec::with_capacity(value.len());
    while let Some(byte) = bytes.next() {
        read.push(match byte {
            b'+' => b' ',
            b'%' => {
                let digit = |byte: u8| char::from(byte).to_digit(16);
                let (high, low) = (digit(bytes.next()?)?, digit(bytes.next()?)?);
                (high * 16 + low) as u8
            }
            other => other,
        });
    }
    String::from_utf8(read).ok()
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
    use super::*;

    #[test]
    fn fields_of_queries_are_read() {
        assert_eq!(field("a=1&topic=%2Frobot%2Fwrench&b=", "topic").as_deref(), Some("/robot/wrench"));
        assert_eq!(field("a=force%5B0%5D+x", "a").as_deref(), Some("force[0] x"));
        for broken in ["a=%", "a=%f", "a=%zz", "b=1", "a=%ff"] {
            assert_eq!(field(broken, "a"), None, "{broken}");
        }
    }
}

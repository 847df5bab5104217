//! What a live page answers: files, questions, news, actions.

use std::sync::Arc;
use std::time::Duration;

use http_body_util::{BodyExt as _, StreamBody};
use hyper::body::{Bytes, Frame, Incoming};
use hyper::header::HeaderValue;
use hyper::{Method, Request, Response, StatusCode};
use tokio::sync::broadcast;

use super::Action;
use super::assets::ASSETS;
use super::runs::ShownRuns;
use super::shown::PageAnswer;
use crate::http::{Body, HTML, RequestRefusal, Site, body, json, plain, posted, respond};
use crate::report::scoped_style;

/// How often they are told that nothing is new.
const ALIVE: Duration = Duration::from_secs(5);

/// Where one of several runs is asked for, by its number; the list of them is there without the slash at the end.
const RUNS: &str = "/runs/";
/// The page of a run.
const PAGE: &str = include_str!("page/index.html");

/// The runs, and the token of who acts on them.
pub(super) struct RunSite {
    pub(super) runs: ShownRuns,
    pub(super) token: String,
}

impl Site for RunSite {
    async fn answer(&self, request: Request<Incoming>) -> Result<Response<Body>, RequestRefusal> {
        match *request.method() {
            Method::GET => Ok(self.get(&request).await),
            Method::POST => self.post(request).await,
            _ => Ok(plain(StatusCode::METHOD_NOT_ALLOWED, "GET or POST".to_owned())),
        }
    }
}

impl RunSite {
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
            return body(StatusCode::OK, HTML, Bytes::from_static(PAGE.as_bytes()));
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

    async fn post(&self, request: Request<Incoming>) -> Result<Response<Body>, RequestRefusal> {
        let path = request.uri().path();
        let number = match path.strip_prefix(RUNS).and_then(|rest| rest.strip_suffix("/act")) {
            Some(number) => number.parse().ok(),
            None => (path == "/act").then_some(0),
        };
        let Some(run) = number.and_then(|number| self.runs.get(number)).filter(|run| run.may_act()) else {
            let why = "this page only looks: `--live-control` lets it act";
            return Ok(plain(StatusCode::FORBIDDEN, why.to_owned()));
        };
        let action: Action = match posted(request, &self.token).await? {
            Ok(action) => action,
            Err(answer) => return Ok(answer),
        };
        Ok(match run.act(action) {
            Ok(()) => plain(StatusCode::OK, "done".to_owned()),
            Err(refused) => plain(StatusCode::CONFLICT, refused.to_string()),
        })
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

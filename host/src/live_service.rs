//! The live page of an agent on another machine: what pages ask there is carried over Zenoh, and so are the news. Who looks from
//! elsewhere cannot act.

use std::sync::Arc;
use std::time::Duration;

use armarium_bus::{Interest, Key, Payload as _, Reply, Session, SessionError, codec, keys, payloads};
use armarium_values::Value;
use armarium_viewer::live::{Action, ActionRefused, PageAnswer, ServedTimeline, ShownRun};
use futures::FutureExt as _;
use futures::future::BoxFuture;
use serde::{Deserialize, Serialize};
use tokio::runtime::Handle;
use tokio::sync::broadcast;
use tokio::sync::broadcast::error::RecvError;
use tokio::task::JoinHandle;

use crate::connection::Connection;
use crate::error::HostError;

payloads! { WireAnswer: "live/answer", 1; }

/// An answer on its way.
#[derive(Serialize, Deserialize)]
struct WireAnswer {
    status: u16,
    kind: String,
    #[serde(default)]
    about: String,
    content: Value,
}

/// What pages ask, and what they are told.
const PAGE: &str = "page";
const NEWS: &str = "news";
/// Questions that may wait.
const MOST_QUESTIONS: usize = 64;
/// Longest question, bytes.
const LONGEST: usize = 16 << 10;
/// News that may wait for somebody slow.
const WAITING: usize = 256;
/// How long an agent may take until it is found.
const FOUND_WITHIN: Duration = Duration::from_secs(5);

/// Shows a run to other machines until it is dropped.
pub(crate) struct LiveOffer(Vec<JoinHandle<()>>);

impl LiveOffer {
    /// Answers pages elsewhere on `{agent}/live/page`, and says what is new on `{agent}/live/news` while somebody listens.
    pub(crate) async fn start(
        (session, threads): (&Session, &Handle),
        agent: &str,
        run: Arc<ServedTimeline>,
    ) -> Result<Self, HostError> {
        let (page, news) = (key(agent, PAGE)?, key(agent, NEWS)?);
        let mut questions = session.declare_queryable(page.clone(), MOST_QUESTIONS).await?;
        let asked = Arc::clone(&run);
        let answering = threads.spawn(async move {
            while let Some(question) = questions.next().await {
                let text = std::str::from_utf8(&question.payload).ok().filter(|text| text.len() <= LONGEST);
                let answer = match text {
                    Some(text) => asked.answer(text).await,
                    None => PageAnswer::refused(400, "a question is a short text"),
                };
                let PageAnswer { status, kind, about, content } = answer;
                let answer = WireAnswer { status, kind, about, content: Value::Bytes(content) };
                let Ok(answer) = codec::encode(&answer) else { continue };
                if let Err(error) = question.reply(&page, &WireAnswer::SCHEMA.encoding(), answer).await {
                    tracing::debug!("a page elsewhere was not answered: {error}");
                }
            }
        });
        let interest = session.interest(&news.clone().into()).await?;
        let session = session.clone();
        let telling = threads.spawn(async move {
            let mut look = tokio::time::interval(Duration::from_millis(200));
            loop {
                look.tick().await;
                if interest.has_subscribers() {
                    tell(&session, &news, &interest, Arc::clone(&run).news()).await;
                }
            }
        });
        Ok(Self(vec![answering, telling]))
    }
}

impl Drop for LiveOffer {
    fn drop(&mut self) {
        self.0.iter().for_each(JoinHandle::abort);
    }
}

fn key(agent: &str, part: &str) -> Result<Key, HostError> {
    keys::live(agent, part).map_err(|error| HostError::from(SessionError::from(error)))
}

/// Says what is new while somebody listens.
async fn tell(session: &Session, key: &Key, interest: &Interest, mut news: broadcast::Receiver<Arc<[u8]>>) {
    while interest.has_subscribers() {
        let said = match tokio::time::timeout(Duration::from_secs(1), news.recv()).await {
            Ok(Ok(said)) => said,
            // Who looks sees by the numbers of events that something is missing.
            Ok(Err(RecvError::Lagged(_))) | Err(_) => continue,
            Ok(Err(RecvError::Closed)) => return,
        };
        if let Err(error) = session.put(key, "application/json", said.to_vec()).await {
            tracing::debug!("news are not told: {error}");
        }
    }
}

/// The run of an agent elsewhere.
#[derive(Debug)]
pub struct RemoteRun {
    session: Session,
    agent: String,
    page: Key,
    news: broadcast::Sender<Arc<[u8]>>,
    hearing: JoinHandle<()>,
}

impl RemoteRun {
    /// Finds the run of an agent, and hears its news.
    ///
    /// # Errors
    /// [`HostError::NoLivePage`] when nobody of that name shows one.
    pub async fn follow(connection: &Connection, agent: &str) -> Result<Arc<Self>, HostError> {
        let session = connection.session().clone();
        let mut told = session.subscribe(key(agent, NEWS)?, WAITING).await?;
        let (news, _) = broadcast::channel(WAITING);
        let sender = news.clone();
        let hearing = connection.runtime().spawn(async move {
            while let Some(message) = told.next().await {
                let _ = sender.send(message.payload.into());
            }
        });
        let run = Arc::new(Self { session, agent: agent.to_owned(), page: key(agent, PAGE)?, news, hearing });
        let finding = async {
            while run.ask("images").await.is_err() {
                tokio::time::sleep(Duration::from_millis(200)).await;
            }
        };
        let missing = |_| HostError::NoLivePage { agent: agent.to_owned() };
        tokio::time::timeout(FOUND_WITHIN, finding).await.map_err(missing)?;
        Ok(run)
    }

    /// Waits until the agent has gone.
    pub async fn gone(&self) {
        let Ok(alive) = keys::alive_pattern(Some(&self.agent), Some("agent")) else { return };
        let timeout = Duration::from_secs(1);
        while self.session.is_alive(&alive, timeout).await.unwrap_or(false) {
            tokio::time::sleep(timeout).await;
        }
    }

    async fn ask(&self, question: &str) -> Result<PageAnswer, SessionError> {
        let asked = ("text/plain", question.as_bytes().to_vec());
        match self.session.query_one(&self.page, "", Some(asked)).await? {
            Reply::Message(message) => {
                let known = WireAnswer::SCHEMA.check(&message.encoding);
                let answer = known.and_then(|()| codec::decode::<WireAnswer>(&message.payload));
                Ok(match answer {
                    Ok(WireAnswer { status, kind, about, content: Value::Bytes(content) }) => {
                        PageAnswer { status, kind, about, content }
                    }
                    Ok(_) => PageAnswer::refused(502, "the agent's answer has no content"),
                    Err(error) => PageAnswer::refused(502, format!("the agent's answer: {error}")),
                })
            }
            Reply::Refusal { .. } => Ok(PageAnswer::refused(502, "the agent refuses")),
        }
    }
}

impl Drop for RemoteRun {
    fn drop(&mut self) {
        self.hearing.abort();
    }
}

impl ShownRun for RemoteRun {
    fn answer<'a>(&'a self, question: &'a str) -> BoxFuture<'a, PageAnswer> {
        let gone = |error: SessionError| PageAnswer::refused(502, format!("`{}`: {error}", self.agent));
        self.ask(question).map(move |asked| asked.unwrap_or_else(gone)).boxed()
    }

    fn news(self: Arc<Self>) -> broadcast::Receiver<Arc<[u8]>> {
        self.news.subscribe()
    }

    fn named(&self) -> (String, Option<String>) {
        (self.agent.clone(), None)
    }

    fn may_act(&self) -> bool {
        false
    }

    fn act(&self, _: Action) -> Result<(), ActionRefused> {
        Err(ActionRefused { reason: "a page of another machine only looks".to_owned() })
    }
}

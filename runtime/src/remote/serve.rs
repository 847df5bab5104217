//! Offers skills to other agents: answers queries, runs the skills that are started, cancels calls that nobody
//! polls.

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use armarium_bus::{IncomingQuery, Key, KeyError, Payload, Session, SessionError, keys};
use parking_lot::Mutex;
use tokio::sync::Semaphore;
use tokio_util::sync::CancellationToken;

use super::MAX_POLL_WAIT;
use super::call::Call;
use super::wire::{Cancel, Manifest, MessageError, Poll, Refusal, Start, Status, packed, unpacked};
use crate::activation::{self, Activation};
use crate::channels::Channels;
use crate::exec::Stop;
use crate::skill::{self, InputError, Skill};

/// Largest number of calls at a time.
const MAX_CALLS: usize = 64;
/// Largest number of queries that are answered at a time; more get no answer.
const MAX_QUERIES: usize = 256;
/// How long the result of a call is kept for its caller.
const RESULT_LIFETIME: Duration = Duration::from_secs(10);

/// Why an agent cannot offer anything.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ServeError {
    /// A name that cannot be part of a key.
    #[error(transparent)]
    Key(#[from] KeyError),
    /// The network failed.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// Two offers have the same name.
    #[error("`{name}` would be offered twice: a chart and a skill, or two charts, have this name")]
    Twice {
        /// The name.
        name: String,
    },
}

/// Why a call is refused.
#[derive(Debug, thiserror::Error)]
enum CallError {
    #[error(transparent)]
    Message(#[from] MessageError),
    #[error("`{encoding}` is no question that is understood here")]
    NotUnderstood { encoding: String },
    #[error("`{name}` is version {here} now, and the caller's chart was checked with version {there}")]
    OtherVersion { name: String, here: String, there: String },
    #[error("`{name}`: {error}")]
    Inputs { name: String, error: InputError },
    #[error("`{agent}` runs {MAX_CALLS} calls already")]
    TooMany { agent: String },
}

/// Answers a query with a message, or with the reason why it is refused.
pub(super) async fn respond<P: Payload>(
    question: &IncomingQuery,
    key: &Key,
    answer: Result<P, impl fmt::Display>,
) {
    let refusal = |error: &dyn fmt::Display| Refusal { reason: error.to_string() };
    let answer = answer.map_err(|error| refusal(&error));
    let sent = match answer.and_then(|message| packed(&message).map_err(|error| refusal(&error))) {
        Ok((encoding, bytes)) => question.reply(key, &encoding, bytes).await,
        Err(refusal) => match packed(&refusal) {
            Ok((encoding, bytes)) => question.refuse(&encoding, bytes).await,
            Err(_) => return,
        },
    };
    if let Err(error) = sent {
        tracing::debug!(%error, "an answer did not reach who asked");
    }
}

/// One skill or chart that is offered.
pub struct Offer {
    skill: Arc<dyn Skill>,
    manifest: Manifest,
    key: Key,
}

/// The skills and charts that an agent offers.
pub struct Offers {
    agent: String,
    offers: BTreeMap<String, Arc<Offer>>,
    instance: String,
    channels: Channels,
    stop: Stop,
}

impl fmt::Debug for Offers {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Offers")
            .field("agent", &self.agent)
            .field("names", &self.offers.keys())
            .finish_non_exhaustive()
    }
}

impl Offers {
    /// An agent that offers nothing yet. `stop` is called when a skill does not return.
    pub fn new(agent: &str, session: &Session, channels: Channels, stop: Stop) -> Self {
        Self { agent: agent.to_owned(), offers: BTreeMap::new(), instance: session.id(), channels, stop }
    }

    /// Offers a skill or a chart under the name of its manifest.
    ///
    /// # Errors
    /// [`ServeError::Twice`] when there is one of that name already; [`ServeError::Key`] for a name that cannot be
    /// part of a key.
    pub fn add(&mut self, skill: Arc<dyn Skill>) -> Result<(), ServeError> {
        let manifest = Manifest::of(&skill.manifest(), &self.instance);
        let name = manifest.name.clone();
        let key = keys::chart(&self.agent, &name)?;
        if self.offers.insert(name.clone(), Arc::new(Offer { skill, manifest, key })).is_some() {
            return Err(ServeError::Twice { name });
        }
        Ok(())
    }

    /// The names that are offered.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.offers.keys().map(String::as_str)
    }
}

struct CallServer {
    offers: Offers,
    calls: Mutex<BTreeMap<String, Arc<Call>>>,
}

/// Answers queries until the session closes. Calls run on the runtime on which this future is awaited. If it is
/// dropped, they end by themselves when their lease expires.
///
/// # Errors
/// [`ServeError`] when nothing can be offered.
pub async fn serve(session: &Session, offers: Offers) -> Result<(), ServeError> {
    let mut questions =
        session.declare_queryable(keys::chart_pattern(Some(&offers.agent), None)?, MAX_QUERIES).await?;
    let server = Arc::new(CallServer { offers, calls: Mutex::default() });
    let places = Arc::new(Semaphore::new(MAX_QUERIES));
    while let Some(question) = questions.next().await {
        let Ok(place) = Arc::clone(&places).try_acquire_owned() else { continue };
        let server = Arc::clone(&server);
        tokio::spawn(async move {
            server.answer(&question).await;
            drop(place);
        });
    }
    Ok(())
}

impl CallServer {
    async fn answer(self: Arc<Self>, question: &IncomingQuery) {
        if question.encoding.is_empty() || question.payload.is_empty() {
            return self.declare(question).await;
        }
        let name = question.key.rsplit('/').next().unwrap_or_default();
        let Some(offer) = self.offers.offers.get(name).map(Arc::clone) else {
            return;
        };
        if let Some(status) = self.status(&offer, question).await.transpose() {
            respond(question, &offer.key, status).await;
        }
    }

    /// Answers with the manifests of the names in the query.
    async fn declare(&self, question: &IncomingQuery) {
        let wanted = question.key.rsplit('/').next().unwrap_or_default();
        for (name, offer) in &self.offers.offers {
            if wanted != name && wanted != "*" && wanted != "**" {
                continue;
            }
            respond(question, &offer.key, Ok::<_, Infallible>(offer.manifest.clone())).await;
        }
    }

    /// The answer to a message about a call; `None` if the message is for another process.
    async fn status(
        self: &Arc<Self>,
        offer: &Arc<Offer>,
        question: &IncomingQuery,
    ) -> Result<Option<Status>, CallError> {
        let (encoding, bytes) = (question.encoding.as_str(), question.payload.as_slice());
        let status = match encoding.split(';').nth(1).unwrap_or_default() {
            "runtime/start" => {
                let start: Start = unpacked(encoding, bytes)?;
                if start.instance != self.offers.instance {
                    return Ok(None);
                }
                self.start(offer, start)?
            }
            "runtime/poll" => {
                let poll: Poll = unpacked(encoding, bytes)?;
                let Some(call) = self.call(&poll.call) else { return Ok(None) };
                let wait = Duration::try_from_secs_f64(poll.wait_s).unwrap_or_default().min(MAX_POLL_WAIT);
                call.poll(poll.seen, wait).await
            }
            "runtime/cancel" => {
                let cancel: Cancel = unpacked(encoding, bytes)?;
                let Some(call) = self.call(&cancel.call) else { return Ok(None) };
                tracing::debug!(call = cancel.call, reason = cancel.reason, "cancelled by its caller");
                call.cancel();
                call.poll(0, Duration::ZERO).await
            }
            _ => return Err(CallError::NotUnderstood { encoding: encoding.chars().take(100).collect() }),
        };
        Ok(Some(status))
    }

    fn call(&self, name: &str) -> Option<Arc<Call>> {
        self.calls.lock().get(name).map(Arc::clone)
    }

    fn start(self: &Arc<Self>, offer: &Arc<Offer>, start: Start) -> Result<Status, CallError> {
        let shown = format!("{}/{}", self.offers.agent, offer.manifest.name);
        if start.version != offer.manifest.version {
            let (here, there) = (offer.manifest.version.clone(), start.version);
            return Err(CallError::OtherVersion { name: shown, here, there });
        }
        let manifest = offer.skill.manifest();
        let inputs = skill::inputs(manifest.inputs.iter(), start.inputs.clone())
            .map_err(|error| CallError::Inputs { name: shown.clone(), error })?;
        let mut calls = self.calls.lock();
        if let Some(call) = calls.get(&start.call) {
            // The caller repeats a start when the first answer was lost.
            return Ok(call.status(0));
        }
        if calls.values().filter(|call| !call.has_ended()).count() >= MAX_CALLS {
            return Err(CallError::TooMany { agent: self.offers.agent.clone() });
        }
        tracing::info!(call = %shown, caller = %start.caller, "started by another agent");
        let cancel = CancellationToken::new();
        let call = Arc::new(Call::new(cancel.clone()));
        let limits = start.limits();
        let channels = self.offers.channels.clone();
        let beginning = activation::SkillStart { state: shown.clone(), inputs, limits, channels, cancel };
        let activation = Activation::new(Arc::clone(&offer.skill), manifest.events, beginning);
        let running = Arc::clone(&call).run(shown, activation, manifest.grace, Arc::clone(&self.offers.stop));
        calls.insert(start.call.clone(), Arc::clone(&call));
        let server = Arc::clone(self);
        tokio::spawn(async move {
            running.await;
            tokio::time::sleep(RESULT_LIFETIME).await;
            server.calls.lock().remove(&start.call);
        });
        Ok(call.status(0))
    }
}

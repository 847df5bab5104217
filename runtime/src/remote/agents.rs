//! Skills and charts of other agents: looked up before a chart is checked, started when a state is entered.

use std::collections::{BTreeMap, BTreeSet};
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::task::{Context, Poll, ready};
use std::time::Duration;

use armarium_bus::{Key, KeyError, Payload, Reply, Session, SessionError, keys};
use armarium_source::suggest;
use futures::FutureExt as _;
use futures::future::BoxFuture;
use tokio::runtime::Handle;
use tokio::task::JoinHandle;
use tokio::time::{Instant, sleep, timeout};

use super::wire::{Cancel, Ended, Manifest, MessageError, Start, Status, answered, packed};
use super::{LEASE, MAX_POLL_WAIT};
use crate::chart::{Refused, Registry};
use crate::skill::{Failure, Skill, SkillContext, SkillManifest, SkillResult};

/// Largest number of manifests per query.
const MAX_MANIFESTS: usize = 4096;
/// Pause between queries while nobody answers.
const RETRY_INTERVAL: Duration = Duration::from_millis(20);
/// Additional grace of a remote state: time for the cancel to arrive, or for a lease to expire.
const EXTRA_GRACE: Duration = Duration::from_millis(1000);

/// Number of calls made by this process.
static CALLS: AtomicU64 = AtomicU64::new(0);

/// The agents that can be reached through a session.
#[derive(Clone, Debug)]
pub struct Agents {
    pub(super) session: Session,
    pub(super) caller: String,
    /// The runtime for calls. Charts run on another one, so that a busy chart does not look like a lost agent.
    pub(super) threads: Handle,
}

impl Agents {
    /// Access to the agents that `session` reaches. `caller` is the name that they see as caller. Calls run on
    /// `threads`, a runtime in real time.
    pub fn new(session: Session, caller: &str, threads: Handle) -> Self {
        Self { session, caller: caller.to_owned(), threads }
    }

    /// The names of the agents that run now.
    ///
    /// # Errors
    /// [`SessionError`] when the session has ended.
    pub async fn running(&self) -> Result<BTreeSet<String>, SessionError> {
        let pattern = keys::alive_pattern(None, Some("agent"));
        let pattern = pattern.map_err(|error| SessionError::Config { what: error.to_string() })?;
        let alive = self.session.all_alive(&pattern, LEASE).await?;
        Ok(alive.iter().filter_map(|key| Some(key.split_once('/')?.0.to_owned())).collect())
    }

    /// Queries the `agent/Name` that charts use, and enters in the registry what exists and why something cannot be
    /// used. Agents that do not answer are queried again until `timeout` has passed.
    pub async fn resolve(&self, names: &BTreeSet<String>, timeout: Duration, registry: &mut Registry) {
        let deadline = Instant::now() + timeout;
        let mut waiting: BTreeSet<&String> = names.iter().collect();
        while !waiting.is_empty() {
            let last = Instant::now() >= deadline;
            let agents: BTreeSet<&str> =
                waiting.iter().filter_map(|name| Some(name.split_once('/')?.0)).collect();
            let mut offered = BTreeMap::new();
            for agent in agents {
                offered.insert(agent.to_owned(), self.offered(agent, None).await);
            }
            waiting.retain(|name| {
                let Some((agent, wanted)) = name.split_once('/') else { return false };
                let Some(found) = offered.get(agent) else { return false };
                match chosen(agent, wanted, found) {
                    Ok(manifest) => {
                        let remote = Remote { agents: self.clone(), name: (*name).clone(), manifest };
                        registry.add_remote(Arc::new(remote));
                        false
                    }
                    Err(Missing::Absent(_)) if !last => true,
                    Err(Missing::Absent(refused) | Missing::Wrong(refused)) => {
                        registry.refuse_remote(name, refused);
                        false
                    }
                }
            });
            if !waiting.is_empty() {
                sleep(RETRY_INTERVAL).await;
            }
        }
    }

    /// The manifests of an agent: all, or those under one name, or why one of them cannot be read.
    async fn offered(&self, agent: &str, name: Option<&str>) -> Vec<Result<Manifest, QueryError>> {
        let Ok(pattern) = keys::chart_pattern(Some(agent), name) else { return Vec::new() };
        match self.session.query(pattern, "", None, MAX_MANIFESTS, LEASE).await {
            Ok(answers) => {
                answers.iter().filter_map(|a| Some(answered(a)?.map_err(QueryError::from))).collect()
            }
            Err(error) => vec![Err(error.into())],
        }
    }

    /// Queries a key of an agent; `None` if there is no answer in time.
    async fn ask<P: Payload>(
        &self,
        agent: &str,
        name: &str,
        message: &P,
        within: Duration,
    ) -> Option<Result<Status, QueryError>> {
        let message =
            keys::chart(agent, name).map_err(QueryError::from).and_then(|key| Ok((key, packed(message)?)));
        let (key, message) = match message {
            Ok(message) => message,
            Err(error) => return Some(Err(error)),
        };
        let answers = self.ask_within(key, &message, within).await.ok()?;
        answers.iter().find_map(answered).map(|status| status.map_err(QueryError::from))
    }

    /// Sends a message as a query; without answers in time there are none.
    pub(super) async fn ask_within(
        &self,
        key: Key,
        (encoding, bytes): &(String, Vec<u8>),
        within: Duration,
    ) -> Result<Vec<Reply>, SessionError> {
        let asked = self.session.query(key, "", Some((encoding, bytes.clone())), 16, within);
        // Zenoh has a timeout as well, but it is late when Zenoh's own threads are delayed.
        timeout(within, asked).await.unwrap_or_else(|_| Ok(Vec::new()))
    }
}

/// Why a query has no status or manifest.
#[derive(Debug, thiserror::Error)]
enum QueryError {
    #[error(transparent)]
    Key(#[from] KeyError),
    #[error(transparent)]
    Message(#[from] MessageError),
    #[error(transparent)]
    Session(#[from] SessionError),
}

/// Why something cannot be used.
enum Missing {
    /// It does not exist yet, but may appear.
    Absent(Refused),
    /// It exists, but cannot be used.
    Wrong(Refused),
}

fn refused(reason: String, help: impl Into<String>) -> Refused {
    Refused { reason, help: Some(help.into()) }
}

/// The only manifest of that name.
fn chosen(agent: &str, wanted: &str, offered: &[Result<Manifest, QueryError>]) -> Result<Manifest, Missing> {
    if offered.is_empty() {
        let help = format!(
            "start it with `armarium agent --name {agent} CHARTS`, and give what it listens on: \
             --connect tcp/HOST:PORT"
        );
        return Err(Missing::Absent(refused(format!("no agent `{agent}` answers"), help)));
    }
    let fitting: Vec<&Manifest> =
        offered.iter().filter_map(|o| o.as_ref().ok()).filter(|m| m.name == wanted).collect();
    match fitting.as_slice() {
        [one] => Ok((*one).clone()),
        [one, two, ..] => Err(Missing::Wrong(refused(
            format!(
                "two agents are called `{agent}` and offer `{wanted}`: the processes {} and {}",
                one.instance, two.instance
            ),
            "end one of them, or start it with another --name",
        ))),
        [] => {
            if let Some(error) = offered.iter().find_map(|o| o.as_ref().err()) {
                let reason = format!("what `{agent}` offers cannot be understood: {error}");
                let help = "both sides have to speak the same version of the messages (docs/wire.md)";
                return Err(Missing::Wrong(refused(reason, help)));
            }
            let names = || offered.iter().filter_map(|o| Some(o.as_ref().ok()?.name.as_str()));
            let help = suggest(wanted, names())
                .unwrap_or_else(|| format!("it offers: {}", names().collect::<Vec<_>>().join(", ")));
            Err(Missing::Absent(refused(format!("`{agent}` does not offer `{wanted}`"), help)))
        }
    }
}

/// A skill or chart of another agent, as a skill of this process.
struct Remote {
    agents: Agents,
    name: String,
    manifest: Manifest,
}

impl Skill for Remote {
    fn manifest(&self) -> SkillManifest {
        self.manifest.skill(&self.name, EXTRA_GRACE)
    }

    fn run(&self, context: SkillContext) -> BoxFuture<'static, SkillResult> {
        let agents = self.agents.clone();
        let threads = agents.threads.clone();
        let (agent, name) = self.name.split_once('/').unwrap_or_default();
        // The session id is unique among processes, the number is unique within this one.
        let number = CALLS.fetch_add(1, Ordering::Relaxed);
        let call = Call {
            agent: agent.to_owned(),
            name: name.to_owned(),
            id: format!("{}-{number}", agents.session.id()),
            version: self.manifest.version.clone(),
            agents,
            heard: Instant::now(),
            dropped: 0,
        };
        Started(threads.spawn(call.run(context))).boxed()
    }
}

/// A running call; dropping it aborts the call.
struct Started(JoinHandle<SkillResult>);

impl Future for Started {
    type Output = SkillResult;

    fn poll(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<SkillResult> {
        let joined = ready!(Pin::new(&mut self.0).poll(context));
        Poll::Ready(joined.unwrap_or_else(|error| Err(Failure::new(format!("the call was lost: {error}")))))
    }
}

impl Drop for Started {
    fn drop(&mut self) {
        self.0.abort();
    }
}

/// A call to another agent.
struct Call {
    agents: Agents,
    agent: String,
    name: String,
    id: String,
    /// The version that the chart was checked with.
    version: String,
    /// When the agent last answered.
    heard: Instant,
    /// Events that the agent has dropped so far.
    dropped: u64,
}

impl Call {
    async fn run(mut self, context: SkillContext) -> SkillResult {
        self.heard = Instant::now();
        self.start(&context).await?;
        let mut seen = 0;
        let mut cancelled = false;
        loop {
            let poll = super::wire::Poll { call: self.id.clone(), seen, wait_s: MAX_POLL_WAIT.as_secs_f64() };
            let asked = self.agents.ask(&self.agent, &self.name, &poll, self.left());
            let answer = tokio::select! {
                biased;
                () = context.cancel.cancelled(), if !cancelled => {
                    cancelled = true;
                    self.cancel(&context.state).await;
                    continue;
                }
                answer = asked => answer,
            };
            match answer {
                Some(Ok(status)) => {
                    self.heard = Instant::now();
                    if let Some(ended) = self.pass_on(status, &mut seen, &context).await {
                        return ended.into();
                    }
                }
                Some(Err(error)) => {
                    return Err(Failure::new(format!("`{}/{}`: {error}", self.agent, self.name)));
                }
                None if self.left().is_zero() => return Err(self.lost()),
                None => sleep(RETRY_INTERVAL.min(self.left())).await,
            }
        }
    }

    /// Remaining time of the lease.
    fn left(&self) -> Duration {
        LEASE.saturating_sub(self.heard.elapsed())
    }

    fn lost(&self) -> Failure {
        let silent = self.heard.elapsed().as_secs_f64();
        Failure::new(format!("the agent `{}` is lost: it has not answered for {silent:.2} s", self.agent))
    }

    /// Finds the process that offers it now, and starts it there.
    async fn start(&mut self, context: &SkillContext) -> Result<(), Failure> {
        let shown = format!("{}/{}", self.agent, self.name);
        let manifest = loop {
            match chosen(&self.agent, &self.name, &self.agents.offered(&self.agent, Some(&self.name)).await) {
                Ok(manifest) => break manifest,
                Err(Missing::Wrong(refused)) => return Err(Failure::new(refused.reason)),
                Err(Missing::Absent(_)) if self.left().is_zero() => return Err(self.lost()),
                Err(Missing::Absent(_)) => sleep(RETRY_INTERVAL).await,
            }
        };
        if manifest.version != self.version {
            return Err(Failure::new(format!(
                "`{shown}` is version {} now; this chart was checked with version {}",
                manifest.version, self.version
            )));
        }
        self.heard = Instant::now();
        let start = Start {
            call: self.id.clone(),
            instance: manifest.instance,
            version: manifest.version,
            caller: format!("{} ({})", self.agents.caller, context.state),
            inputs: context.inputs.clone(),
            force_n: context.limits.force_n,
            speed_m_s: context.limits.speed_m_s,
        };
        match self.agents.ask(&self.agent, &self.name, &start, LEASE).await {
            Some(Ok(_)) => {
                self.heard = Instant::now();
                Ok(())
            }
            Some(Err(error)) => Err(Failure::new(error.to_string())),
            None => Err(self.lost()),
        }
    }

    /// Sends the cancel; further polls then wait for the end.
    async fn cancel(&mut self, state: &str) {
        let cancel = Cancel { call: self.id.clone(), reason: format!("`{state}` is left") };
        while !self.left().is_zero() {
            let within = self.left().min(Duration::from_millis(150));
            if self.agents.ask(&self.agent, &self.name, &cancel, within).await.is_some() {
                self.heard = Instant::now();
                return;
            }
            sleep(RETRY_INTERVAL.min(self.left())).await;
        }
    }

    /// Passes on what is new in a status. Returns how the call ended, once it has.
    async fn pass_on(&mut self, status: Status, seen: &mut u64, context: &SkillContext) -> Option<Ended> {
        for event in status.events.into_iter().filter(|e| e.revision > *seen) {
            context.events.raise(&event.name, event.data);
        }
        if status.dropped > self.dropped {
            let all = format!("events of {}/{}", self.agent, self.name);
            context.events.dropped(&all, status.dropped - self.dropped);
            self.dropped = status.dropped;
        }
        // If a process answers at once instead of waiting for news, pause before the next poll.
        if status.revision <= *seen && status.ended.is_none() {
            sleep(RETRY_INTERVAL).await;
        }
        *seen = status.revision.max(*seen);
        context.inside.send_if_modified(|inside| {
            let changed = *inside != status.leaves;
            *inside = status.leaves;
            changed
        });
        status.ended
    }
}

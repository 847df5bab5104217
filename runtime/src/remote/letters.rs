//! Events from charts to the charts of other agents, over Zenoh: a question on `{agent}/event`, answered by how many
//! charts have heard it.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use armarium_bus::{Session, keys};
use futures::FutureExt as _;
use futures::future::BoxFuture;
use tokio::time::{Instant, sleep, timeout};

use super::LEASE;
use super::agents::Agents;
use super::serve::ServeError;
use super::wire::{Heard, Refusal, Told, answered, packed, unpacked};
use crate::exec::{Hearers, Letter, Post};

/// Questions that may wait.
const MOST_QUESTIONS: usize = 256;
/// Between questions that found nobody.
const AGAIN: Duration = Duration::from_millis(20);
/// Events whose names are remembered, so that one that comes twice is heard once.
const REMEMBERED: usize = 1024;

/// Counts the events that this process has sent.
static SENT: AtomicU64 = AtomicU64::new(0);

impl Post for Agents {
    fn deliver(&self, letter: Letter) -> BoxFuture<'static, Result<(), String>> {
        let agents = self.clone();
        let task = self.threads.spawn(async move { agents.tell(letter).await });
        async move { task.await.unwrap_or_else(|error| Err(format!("it was lost: {error}"))) }.boxed()
    }
}

impl Agents {
    async fn tell(&self, letter: Letter) -> Result<(), String> {
        let (agent, chart) = match letter.to.split_once('/') {
            Some((agent, chart)) => (agent, Some(chart.to_owned())),
            None => (letter.to.as_str(), None),
        };
        let key = keys::event(agent).map_err(|e| e.to_string())?;
        let number = SENT.fetch_add(1, Ordering::Relaxed);
        let told = Told {
            letter: format!("{}-{number}", self.session.id()),
            caller: self.caller.clone(),
            chart: chart.clone(),
            name: letter.event,
            data: letter.data,
        };
        let (encoding, bytes) = packed(&told)?;
        let until = Instant::now() + LEASE;
        loop {
            let left = until.saturating_duration_since(Instant::now());
            let question = Some((encoding.as_str(), bytes.clone()));
            let asked = self.session.ask(key.clone(), "", question, 16, left);
            // Zenoh keeps the time as well, but not where its own threads are held up.
            let answers = match timeout(left, asked).await {
                Ok(answers) => answers.map_err(|e| e.to_string())?,
                Err(_) => Vec::new(),
            };
            let heard: Result<Vec<Heard>, String> = answers.iter().filter_map(answered).collect();
            match heard?.as_slice() {
                [] if left.is_zero() => return Err(format!("no agent `{agent}` answers")),
                [] => sleep(AGAIN.min(left)).await,
                [one] if one.charts > 0 => return Ok(()),
                [_] => return Err(nobody(agent, chart.as_deref())),
                [one, two, ..] => {
                    return Err(format!(
                        "two agents are called `{agent}`, the processes {} and {}, and both have heard it",
                        one.instance, two.instance
                    ));
                }
            }
        }
    }
}

fn nobody(agent: &str, chart: Option<&str>) -> String {
    match chart {
        Some(chart) => format!("`{agent}` runs no chart `{chart}` now"),
        None => format!("`{agent}` runs no chart now"),
    }
}

/// Raises what other agents send to `agent` in the charts that hear it, until the session closes.
///
/// # Errors
/// [`ServeError`] when nothing can be heard.
pub async fn hear(session: &Session, agent: &str, hearers: Hearers) -> Result<(), ServeError> {
    let key = keys::event(agent)?;
    let mut questions = session.answer(key.clone(), MOST_QUESTIONS).await?;
    let mut remembered: VecDeque<(String, u32)> = VecDeque::new();
    let instance = session.id();
    while let Some(question) = questions.next().await {
        let heard = unpacked::<Told>(&question.encoding, &question.payload).and_then(|told| {
            if let Some((_, charts)) = remembered.iter().find(|(letter, _)| *letter == told.letter) {
                return Ok(*charts);
            }
            tracing::debug!(event = %told.name, caller = %told.caller, "another agent sends an event");
            let charts = hearers.raise(told.chart.as_deref(), &told.name, &told.data)?;
            if remembered.len() >= REMEMBERED {
                remembered.pop_front();
            }
            remembered.push_back((told.letter, charts));
            Ok(charts)
        });
        let sent = match heard.and_then(|charts| packed(&Heard { charts, instance: instance.clone() })) {
            Ok((encoding, bytes)) => question.reply(&key, &encoding, bytes).await,
            Err(reason) => match packed(&Refusal { reason }) {
                Ok((encoding, bytes)) => question.refuse(&encoding, bytes).await,
                Err(_) => continue,
            },
        };
        if let Err(error) = sent {
            tracing::debug!(%error, "an answer did not reach who sent an event");
        }
    }
    Ok(())
}

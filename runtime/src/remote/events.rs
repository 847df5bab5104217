//! Events from charts to the charts of other agents, over Zenoh: a query on `{agent}/event`, answered by the number
//! of charts that received the event.

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
use super::wire::{EventMessage, EventReceipt, Refusal, answered, packed, unpacked};
use crate::exec::{RemoteEvent, Subscribers, Transport};

/// Largest number of waiting queries.
const MOST_QUESTIONS: usize = 256;
/// Pause between queries while nobody answers.
const AGAIN: Duration = Duration::from_millis(20);
/// Number of received events that are remembered, so that an event that arrives twice is raised once.
const REMEMBERED: usize = 1024;

/// Number of events that this process has sent.
static SENT: AtomicU64 = AtomicU64::new(0);

impl Transport for Agents {
    fn deliver(&self, sent: RemoteEvent) -> BoxFuture<'static, Result<(), String>> {
        let agents = self.clone();
        let task = self.threads.spawn(async move { agents.tell(sent).await });
        async move { task.await.unwrap_or_else(|error| Err(format!("it was lost: {error}"))) }.boxed()
    }
}

impl Agents {
    async fn tell(&self, sent: RemoteEvent) -> Result<(), String> {
        let (agent, chart) = match sent.to.split_once('/') {
            Some((agent, chart)) => (agent, Some(chart.to_owned())),
            None => (sent.to.as_str(), None),
        };
        let key = keys::event(agent).map_err(|e| e.to_string())?;
        let number = SENT.fetch_add(1, Ordering::Relaxed);
        let message = EventMessage {
            id: format!("{}-{number}", self.session.id()),
            caller: self.caller.clone(),
            chart: chart.clone(),
            name: sent.event,
            data: sent.data,
        };
        let (encoding, bytes) = packed(&message)?;
        let until = Instant::now() + LEASE;
        loop {
            let left = until.saturating_duration_since(Instant::now());
            let question = Some((encoding.as_str(), bytes.clone()));
            let asked = self.session.ask(key.clone(), "", question, 16, left);
            // Zenoh has a timeout as well, but it is late when Zenoh's own threads are delayed.
            let answers = match timeout(left, asked).await {
                Ok(answers) => answers.map_err(|e| e.to_string())?,
                Err(_) => Vec::new(),
            };
            let heard: Result<Vec<EventReceipt>, String> = answers.iter().filter_map(answered).collect();
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

/// Raises events from other agents to `agent` in the subscribed charts, until the session closes.
///
/// # Errors
/// [`ServeError`] when the key cannot be served.
pub async fn hear(session: &Session, agent: &str, subscribers: Subscribers) -> Result<(), ServeError> {
    let key = keys::event(agent)?;
    let mut questions = session.answer(key.clone(), MOST_QUESTIONS).await?;
    let mut remembered: VecDeque<(String, u32)> = VecDeque::new();
    let instance = session.id();
    while let Some(question) = questions.next().await {
        let heard = unpacked::<EventMessage>(&question.encoding, &question.payload).and_then(|message| {
            if let Some((_, charts)) = remembered.iter().find(|(sent, _)| *sent == message.id) {
                return Ok(*charts);
            }
            tracing::debug!(event = %message.name, caller = %message.caller, "another agent sends an event");
            let charts = subscribers.raise(message.chart.as_deref(), &message.name, &message.data)?;
            if charts > 0 {
                if remembered.len() >= REMEMBERED {
                    remembered.pop_front();
                }
                remembered.push_back((message.id, charts));
            }
            Ok(charts)
        });
        let sent = match heard.and_then(|charts| packed(&EventReceipt { charts, instance: instance.clone() }))
        {
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

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use armarium_bus::SessionConfig;
    use armarium_values::Value;
    use tokio::runtime::Handle;

    use super::*;
    use crate::channels::Channels;
    use crate::chart::Registry;
    use crate::chart::testing::program;
    use crate::exec::{ExecOptions, Executor, Peers, RunResult};

    async fn pair() -> (Session, Session) {
        let one = Session::open(&SessionConfig::default()).await.unwrap();
        let two = Session::open(&SessionConfig::connected_to(&one.endpoints().await)).await.unwrap();
        (one, two)
    }

    /// An agent named `name` that runs charts.
    fn agent(session: &Session, name: &'static str) -> Peers {
        let others = Peers {
            transport: Some(Arc::new(Agents::new(session.clone(), name, Handle::current()))),
            subscribers: Subscribers::default(),
        };
        let (session, subscribers) = (session.clone(), others.subscribers.clone());
        tokio::spawn(async move { hear(&session, name, subscribers).await });
        others
    }

    fn run(others: &Peers, chart: &str) -> impl Future<Output = RunResult> + use<> {
        let options = ExecOptions { peers: others.clone(), ..ExecOptions::default() };
        Executor::new(program(chart), Registry::new(), Channels::new(), options).unwrap().run()
    }

    const BOB: &str = "
statechart: Bob
events: {count: {data: {n: int}}, last: {}}
locals: {heard: {type: list<any>, default: []}}
outputs: {heard: {type: list<any>}}
initial: Listen
states:
  Listen:
    transitions:
      count: {do: [{assign: {locals.heard: \"${locals.heard + [event.data.n]}\"}}]}
      last:
        target: Done
        do: [{assign: {outputs.heard: \"${locals.heard}\"}}, {send: {event: thanks, to: alice, data: {n: 3}}}]
  Done: {final: success}
";

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn what_is_sent_is_heard_in_its_order_and_answered() {
        let (one, two) = pair().await;
        let (alice, bob) = (agent(&one, "alice"), agent(&two, "bob"));
        let listening = tokio::spawn(run(&bob, BOB));
        // If Bob does not listen yet, the delivery is retried.
        let result = run(
            &alice,
            "
statechart: Alice
events: {thanks: {data: {n: int}}}
initial: Knock
states:
  Knock:
    enter: [{send: {event: count, to: \"${'b' + 'ob'}\", data: {n: 1}}}]
    transitions: {error.communication: Again}
    after: {300ms: Count}
  Again: {after: {20ms: Knock}}
  Count:
    enter:
      - foreach: {in: [2, 3, 4, 5], as: n, do: [{send: {event: count, to: bob/Bob, data: {n: \"${n}\"}}}]}
      - send: {event: count, to: bob, data: {n: 6}, delay: 10s, id: late}
      - send: {event: last, to: bob/Bob, delay: 50ms}
      - cancel: late
    transitions: {thanks: {target: Done, if: event.data.n == 3}}
  Done: {final: success}
",
        );
        assert_eq!(result.await.outcome, "success");
        let heard = listening.await.unwrap().outputs["heard"].clone();
        assert_eq!(heard, Value::List((1..=5).map(Value::Int).collect()));
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn what_nobody_hears_comes_back() {
        let (one, two) = pair().await;
        let (alice, _bob) = (agent(&one, "alice"), agent(&two, "bob"));
        for (to, said) in [
            ("carol", "no agent `carol` answers"),
            ("bob", "`bob` runs no chart now"),
            ("bob/Dance", "`bob` runs no chart `Dance` now"),
            ("b*b", "cannot be part of a key"),
        ] {
            let result = run(
                &alice,
                &format!(
                    "
statechart: Alice
outputs: {{why: {{type: string}}}}
initial: A
states:
  A:
    enter: [{{send: {{event: hello, to: '{to}'}}}}]
    transitions:
      error.communication: {{target: Done, do: [{{assign: {{outputs.why: \"${{event.data.reason}}\"}}}}]}}
  Done: {{final: success}}
"
                ),
            );
            let why = result.await.outputs["why"].clone();
            let why = why.as_str().unwrap();
            assert!(
                why.starts_with(&format!("`hello` cannot be sent to `{to}`: ")) && why.contains(said),
                "{why}"
            );
        }
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn an_event_that_comes_twice_is_heard_once_and_one_with_a_wrong_type_is_an_error_there() {
        let (one, two) = pair().await;
        let bob = agent(&two, "bob");
        let chart = "
statechart: Bob
events: {count: {data: {n: int}}}
locals: {n: {type: int, default: 0}}
initial: Listen
states:
  Listen:
    transitions:
      count: {do: [{assign: {locals.n: \"${locals.n + 1}\"}}]}
      error.communication: [{if: locals.n == 1, target: Done}, {target: Wrong}]
  Done: {final: success}
  Wrong: {final: failure}
";
        let listening = tokio::spawn(run(&bob, chart));
        let message = |id: &str, data: Value| EventMessage {
            id: id.into(),
            caller: "a test".into(),
            chart: None,
            name: "count".into(),
            data: Value::record([("n", data)]),
        };
        for message in
            [message("x-1", Value::Int(1)), message("x-1", Value::Int(1)), message("x-2", "many".into())]
        {
            let (encoding, bytes) = packed(&message).unwrap();
            // Until a chart receives it.
            loop {
                let question = Some((encoding.as_str(), bytes.clone()));
                let answers = one.ask(keys::event("bob").unwrap(), "", question, 16, LEASE).await.unwrap();
                match answers.iter().find_map(answered::<EventReceipt>) {
                    Some(Ok(heard)) if heard.charts == 1 => break,
                    _ => tokio::task::yield_now().await,
                }
            }
        }
        assert_eq!(listening.await.unwrap().outcome, "success");
    }
}

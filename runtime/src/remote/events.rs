//! Events from charts to the charts of other agents, over Zenoh: a query on `{agent}/event`, answered by the number
//! of charts that received the event.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use armarium_bus::{Session, keys};
use futures::FutureExt as _;
use futures::future::BoxFuture;
use tokio::time::{Instant, sleep};

use super::LEASE;
use super::agents::Agents;
use super::serve::{ServeError, respond};
use super::wire::{EventMessage, EventReceipt, MessageError, answered, packed, unpacked};
use crate::exec::{DeliveryError, Raised, RemoteEvent, Subscribers, Transport};

/// Largest number of waiting queries.
const MAX_QUERIES: usize = 256;
/// Pause between queries while nobody answers.
const RETRY_INTERVAL: Duration = Duration::from_millis(20);
/// Number of received events that are remembered, so that an event that arrives twice is raised once.
const MAX_REMEMBERED: usize = 1024;

/// Number of events that this process has sent.
static SENT: AtomicU64 = AtomicU64::new(0);

impl Transport for Agents {
    fn deliver(&self, sent: RemoteEvent) -> BoxFuture<'static, Result<(), DeliveryError>> {
        let agents = self.clone();
        let task = self.threads.spawn(async move { agents.send_event(sent).await });
        async move { task.await.unwrap_or_else(|error| Err(DeliveryError::Lost(error))) }.boxed()
    }
}

impl Agents {
    async fn send_event(&self, sent: RemoteEvent) -> Result<(), DeliveryError> {
        let (agent, chart) = match sent.to.split_once('/') {
            Some((agent, chart)) => (agent, Some(chart.to_owned())),
            None => (sent.to.as_str(), None),
        };
        let key = keys::event(agent).map_err(DeliveryError::transport)?;
        let number = SENT.fetch_add(1, Ordering::Relaxed);
        let message = EventMessage {
            id: format!("{}-{number}", self.session.id()),
            caller: self.caller.clone(),
            chart: chart.clone(),
            name: sent.event,
            data: sent.data,
        };
        let message = packed(&message).map_err(DeliveryError::transport)?;
        let until = Instant::now() + LEASE;
        loop {
            let left = until.saturating_duration_since(Instant::now());
            let answers =
                self.ask_within(key.clone(), &message, left).await.map_err(DeliveryError::transport)?;
            let receipts: Result<Vec<EventReceipt>, MessageError> =
                answers.iter().filter_map(answered).collect();
            let agent = agent.to_owned();
            match receipts.map_err(DeliveryError::transport)?.as_slice() {
                [] if left.is_zero() => return Err(DeliveryError::NoAgent { agent }),
                [] => sleep(RETRY_INTERVAL.min(left)).await,
                [EventReceipt { dropped: Some(reason), .. }] => {
                    return Err(DeliveryError::Dropped { agent, reason: reason.clone() });
                }
                [one] if one.charts > 0 => return Ok(()),
                [_] => return Err(DeliveryError::NoChart { agent, chart }),
                [one, two, ..] => {
                    let instances = [one.instance.clone(), two.instance.clone()];
                    return Err(DeliveryError::TwoAgents { agent, instances });
                }
            }
        }
    }
}

/// Raises events from other agents to `agent` in the subscribed charts, until the session closes.
///
/// # Errors
/// [`ServeError`] when the key cannot be served.
pub async fn receive_events(
    session: &Session,
    agent: &str,
    subscribers: Subscribers,
) -> Result<(), ServeError> {
    let key = keys::event(agent)?;
    let mut questions = session.declare_queryable(key.clone(), MAX_QUERIES).await?;
    let mut remembered: VecDeque<(String, EventReceipt)> = VecDeque::new();
    let instance = session.id();
    while let Some(question) = questions.next().await {
        let mut receive = async || -> Result<EventReceipt, EventError> {
            let message: EventMessage = unpacked(&question.encoding, &question.payload)?;
            if let Some((_, receipt)) = remembered.iter().find(|(sent, _)| *sent == message.id) {
                return Ok(receipt.clone());
            }
            tracing::debug!(event = %message.name, caller = %message.caller, "another agent sends an event");
            let raised = subscribers.raise(message.chart.as_deref(), &message.name, &message.data).await?;
            let Raised { charts, dropped } = raised;
            let receipt = EventReceipt { charts, dropped, instance: instance.clone() };
            if charts > 0 {
                if remembered.len() >= MAX_REMEMBERED {
                    remembered.pop_front();
                }
                remembered.push_back((message.id, receipt.clone()));
            }
            Ok(receipt)
        };
        let receipt = receive().await;
        respond(&question, &key, receipt).await;
    }
    Ok(())
}

/// Why a received event is refused.
#[derive(Debug, thiserror::Error)]
enum EventError {
    #[error(transparent)]
    Message(#[from] MessageError),
    #[error(transparent)]
    Delivery(#[from] DeliveryError),
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use armarium_values::Value;
    use tokio::runtime::Handle;

    use super::*;
    use crate::channels::Channels;
    use crate::chart::Registry;
    use crate::chart::testing::program;
    use crate::exec::{ExecOptions, Executor, Peers, RunResult};
    use crate::remote::tests::pair;
    use crate::trace::TraceEvent;

    /// An agent named `name` that runs charts.
    fn agent(session: &Session, name: &'static str) -> Peers {
        let others = Peers {
            transport: Some(Arc::new(Agents::new(session.clone(), name, Handle::current()))),
            subscribers: Subscribers::default(),
        };
        let (session, subscribers) = (session.clone(), others.subscribers.clone());
        tokio::spawn(async move { receive_events(&session, name, subscribers).await });
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
    async fn what_no_state_takes_now_is_said_to_the_sender() {
        let (one, two) = pair().await;
        let (alice, bob) = (agent(&one, "alice"), agent(&two, "bob"));
        let chart = "
statechart: Bob
events: {first: {}, then: {}}
initial: A
states:
  A: {transitions: {first: B}}
  B: {transitions: {then: Done}}
  Done: {final: success}
";
        let options = ExecOptions {
            peers: bob.clone(),
            sink: Some(Box::new(|_: &TraceEvent| {})),
            ..ExecOptions::default()
        };
        let running = Executor::new(program(chart), Registry::new(), Channels::new(), options).unwrap().run();
        let listening = tokio::spawn(running);
        let transport = alice.transport.unwrap();
        let send = |event: &str| {
            let (to, event) = ("bob".to_owned(), event.to_owned());
            transport.deliver(RemoteEvent { to, event, data: Value::Null })
        };
        // Until the chart runs.
        let said = loop {
            match send("then").await {
                Err(error @ DeliveryError::Dropped { .. }) => break error.to_string(),
                Err(_) => tokio::task::yield_now().await,
                Ok(()) => panic!("no state takes it"),
            }
        };
        assert!(said.starts_with("`bob` has it, but no active state takes it"), "{said}");
        send("first").await.unwrap();
        send("then").await.unwrap();
        assert_eq!(listening.await.unwrap().outcome, "success");
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
    async fn an_event_that_comes_twice_is_raised_once_and_one_that_does_not_fit_is_refused() {
        let (one, two) = pair().await;
        let bob = agent(&two, "bob");
        let chart = "
statechart: Bob
events: {count: {data: {n: int}}, last: {}}
locals: {n: {type: int, default: 0}}
initial: Listen
states:
  Listen:
    transitions:
      count: {do: [{assign: {locals.n: \"${locals.n + 1}\"}}]}
      last: [{if: locals.n == 1, target: Done}, {target: Wrong}]
  Done: {final: success}
  Wrong: {final: failure}
";
        let listening = tokio::spawn(run(&bob, chart));
        let message = |id: &str, name: &str, data: Value| EventMessage {
            id: id.into(),
            caller: "a test".into(),
            chart: None,
            name: name.into(),
            data: Value::record([("n", data)]),
        };
        for (message, refusal) in [
            (message("x-1", "count", Value::Int(1)), ""),
            (message("x-1", "count", Value::Int(1)), ""),
            (message("x-2", "count", "many".into()), "the data of `count`"),
            (message("x-3", "cont", Value::Int(1)), "did you mean `count`?"),
            (message("x-4", "last", Value::Int(1)), ""),
        ] {
            let (encoding, bytes) = packed(&message).unwrap();
            // Until a chart receives it.
            loop {
                let question = Some((encoding.as_str(), bytes.clone()));
                let answers = one.query(keys::event("bob").unwrap(), "", question, 16, LEASE).await.unwrap();
                match answers.iter().find_map(answered::<EventReceipt>) {
                    Some(Ok(receipt)) if receipt.charts == 1 => {
                        assert_eq!(refusal, "");
                        break;
                    }
                    Some(Err(error)) => {
                        assert!(!refusal.is_empty() && error.to_string().contains(refusal), "{error}");
                        break;
                    }
                    _ => tokio::task::yield_now().await,
                }
            }
        }
        assert_eq!(listening.await.unwrap().outcome, "success");
    }
}

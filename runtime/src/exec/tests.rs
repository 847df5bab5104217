use std::fmt::Write;
use std::time::Duration;

use super::*;
use crate::chart::testing::{program, registry};

/// Runs a chart under virtual time. Returns the result and the trace, one line per item, with times in ms.
async fn run_with<F: Future<Output = ()> + Send + 'static>(
    text: &str,
    channels: Channels,
    control: impl FnOnce(Controller) -> F,
) -> (RunResult, String) {
    let log = Arc::new(Mutex::new(String::new()));
    let lines = Arc::clone(&log);
    let sink = move |event: &TraceEvent| {
        let ms = event.at_ns / 1_000_000;
        let line = match &event.item {
            TraceItem::Configuration { leaves } => leaves.join(" "),
            TraceItem::SkillEnded { state, outcome, .. } => format!("{state}: {outcome}"),
            TraceItem::Log { text, .. } => format!("log {text}"),
            TraceItem::Error { message, .. } => format!("error {message}"),
            _ => return,
        };
        writeln!(lines.lock(), "{ms} {line}").unwrap();
    };
    let options = ExecOptions { sink: Some(Box::new(sink)), ..ExecOptions::default() };
    let executor = Executor::new(program(text), registry(), channels, options).unwrap();
    let controlling = tokio::spawn(control(executor.controller()));
    let result = executor.run().await;
    controlling.abort();
    let log = log.lock().clone();
    (result, log)
}

async fn run(text: &str) -> (RunResult, String) {
    run_with(text, Channels::new(), |_| std::future::pending()).await
}

fn after(ms: u64) -> tokio::time::Sleep {
    tokio::time::sleep(Duration::from_millis(ms))
}

#[tokio::test(start_paused = true)]
async fn a_chart_runs_to_its_end_and_gives_its_outputs() {
    let (result, log) = run("
statechart: T
inputs: {force: {type: float, unit: N, default: 3 N}}
outputs: {got: {type: float}}
initial: A
states:
  A:
    skill: Act
    with: {end: success, for: 100ms, force: \"${inputs.force * 2}\"}
    transitions: {success: {target: Done, do: [{assign: {outputs.got: \"${A.value}\"}}]}}
  Done: {final: success}
")
    .await;
    assert_eq!(result.outcome, "success");
    assert_eq!(result.outputs["got"], Value::Float(6.0));
    assert_eq!(log, "0 A\n100 A: success\n100 Done\n100 \n");
}

#[tokio::test(start_paused = true)]
async fn a_panic_is_a_failure_with_its_message() {
    let (result, _) = run("
statechart: T
initial: A
states: {A: {skill: Act, with: {end: panic}}}
")
    .await;
    assert_eq!(result.outcome, "failure");
    assert_eq!(result.reason.as_deref(), Some("the skill panicked: out of order"));
    assert_eq!(result.chain, ["A", "T"]);
}

#[tokio::test(start_paused = true)]
async fn a_failure_says_which_outcome_led_to_it_and_why() {
    let (result, _) = run("
statechart: T
initial: A
states:
  A:
    initial: X
    states:
      X: {after: {1s: Y}}
      Y: {final: blocked}
    transitions: {blocked: Failed}
  Failed: {final: failure}
")
    .await;
    assert_eq!(result.reason.as_deref(), Some("`A` ended with `blocked`: the time of `A.X` was up"));
}

#[tokio::test(start_paused = true)]
async fn a_timer_cancels_and_waits_for_what_runs_inside() {
    let (result, log) = run("
statechart: T
initial: P
states:
  P:
    parallel:
      L: {skill: Act, with: {late: 200ms}}
      R: {skill: Act, with: {late: 50ms}}
    after: {1s: Failed}
  Failed: {final: failure}
")
    .await;
    assert_eq!(result.outcome, "failure");
    assert_eq!(result.reason.as_deref(), Some("`P` had not ended when its time was up"));
    assert_eq!(log, "0 P.L P.R\n1050 P.R: cancelled\n1200 P.L: cancelled\n1200 Failed\n1200 \n");
}

#[tokio::test(start_paused = true)]
async fn a_skill_that_does_not_return_is_stuck() {
    let text = "
statechart: T
initial: A
states:
  A: {skill: Act, with: {end: stuck}, after: {1s: B}}
  B: {}
";
    let stuck = Arc::new(Mutex::new(Vec::new()));
    let seen = Arc::clone(&stuck);
    let options = ExecOptions {
        on_stuck: Some(Box::new(move |state| seen.lock().push(state.to_owned()))),
        ..ExecOptions::default()
    };
    let began = Instant::now();
    let executor = Executor::new(program(text), registry(), Channels::new(), options).unwrap();
    let result = executor.run().await;
    assert_eq!(result.outcome, "failure");
    assert_eq!(began.elapsed(), Duration::from_millis(1500), "1 s and the grace");
    assert_eq!(*stuck.lock(), ["A"]);
}

#[tokio::test(start_paused = true)]
async fn stopping_cancels_skills_and_waits_for_them() {
    let text = "
statechart: T
initial: A
states: {A: {skill: Act, with: {late: 100ms}, exit: [{log: bye}]}}
";
    let control = |controller: Controller| async move {
        after(300).await;
        controller.stop("Ctrl-C");
    };
    let (result, log) = run_with(text, Channels::new(), control).await;
    assert_eq!((result.outcome.as_str(), result.reason.as_deref()), ("stopped", Some("Ctrl-C")));
    assert_eq!(log, "0 A\n400 A: cancelled\n400 log bye\n400 \n");
}

#[tokio::test(start_paused = true)]
async fn events_come_from_skills_and_from_outside() {
    let text = "
statechart: T
initial: A
states:
  A: {skill: Act, with: {end: ping, force: 4}, transitions: {ping: {target: B, do: [{log: \"${event.data}\"}]}}}
  B: {transitions: {said: {target: Done, if: \"event.data.word == 'go'\"}}}
  Done: {final: success}
events: {said: {}}
";
    let control = |controller: Controller| async move {
        for word in ["stay", "go"] {
            after(100).await;
            assert!(controller.raise("said", Value::record([("word", word.into())])));
        }
    };
    let (result, log) = run_with(text, Channels::new(), control).await;
    assert_eq!(result.outcome, "success");
    assert_eq!(log, "0 A\n0 A: cancelled\n0 log 4.0\n0 B\n200 Done\n200 \n");
}

const WATCHING: &str = "
statechart: T
initial: Watching
states:
  Watching:
    watch:
      pushed: {if: \"norm(channels.wrist.push) > 6.0\", for: 100ms, until: \"norm(channels.wrist.push) < 3.0\"}
      gone: {if: \"channels.hand.gesture == 'fist' && age('hand') > 0.5\"}
    transitions:
      pushed: {do: [{log: pushed}]}
      gone: Done
  Done: {final: success}
";

#[tokio::test(start_paused = true)]
async fn watches_hold_demand_and_fire() {
    let channels = Channels::new();
    let publisher = channels.clone();
    let control = move |_: Controller| async move {
        let push = |x: f64| publisher.publish("wrist", Value::record([("push", vec![x, 0.0, 0.0].into())]));
        after(10).await;
        assert_eq!((*publisher.wanted("wrist").borrow(), *publisher.wanted("hand").borrow()), (1, 1));
        for x in [f64::NAN, 7.0, 5.0, 7.0, 8.0, 9.0, 7.0, 9.0, 2.0, 9.0, 9.0, 9.0] {
            push(x);
            after(50).await;
        }
        publisher.publish("hand", Value::record([("gesture", "fist".into())]));
    };
    let (result, log) = run_with(WATCHING, channels.clone(), control).await;
    assert_eq!(result.outcome, "success");
    assert_eq!(*channels.wanted("wrist").borrow(), 0, "nobody reads any more");
    // 7.0 at 160 ms holds until 260 ms; 9.0 at 460 ms, after 2.0, until 560 ms; the hand is 0.5 s old at 1110 ms.
    let times: Vec<&str> = log.lines().filter(|l| l.contains("pushed")).collect();
    assert_eq!(times, ["260 log pushed", "560 log pushed"], "{log}");
    let done: u64 =
        log.lines().find(|l| l.contains("Done")).unwrap().split(' ').next().unwrap().parse().unwrap();
    assert!((1110..=1140).contains(&done), "{log}");
}

#[tokio::test(start_paused = true)]
async fn the_same_run_has_the_same_trace() {
    let text = "
statechart: T
initial: P
locals: {n: {type: int, default: 0}}
states:
  P:
    parallel:
      L:
        initial: A
        states:
          A: {skill: Act, with: {end: success, for: 7ms}, transitions: {success: {target: A, do: [{assign: {locals.n: \"${locals.n + 1}\"}}]}}}
      R:
        initial: B
        states:
          B: {skill: Act, with: {end: blocked, for: 7ms}, transitions: {blocked: B}}
    always: [{target: Done, if: \"locals.n == 20\"}]
  Done: {final: success}
";
    let first = run(text).await;
    assert_eq!(first.0.outcome, "success");
    for _ in 0..3 {
        assert_eq!(run(text).await, first);
    }
}

/// A chart that knows no other skill than this one.
fn with_skill(skill: impl Skill + 'static, text: &str) -> (Arc<Program>, Registry) {
    let registry = Registry::from_iter([Arc::new(skill) as Arc<dyn Skill>]);
    let library = crate::chart::load_text("test.yaml", text, &[]);
    let checked = crate::chart::check(&library, &registry, &crate::chart::ChannelSchema::new());
    (checked.program.unwrap(), registry)
}

/// Blocks its thread until the flag is set.
struct Block(Arc<std::sync::atomic::AtomicBool>);

impl Skill for Block {
    fn manifest(&self) -> SkillManifest {
        SkillManifest::new("Block", "Does not yield.")
    }
    fn run(&self, _: SkillContext) -> BoxFuture<'static, SkillResult> {
        let free = Arc::clone(&self.0);
        Box::pin(async move {
            while !free.load(std::sync::atomic::Ordering::Relaxed) {
                std::hint::spin_loop();
            }
            Ok(crate::skill::Outcome::success())
        })
    }
}

#[tokio::test(start_paused = true)]
async fn a_skill_that_does_not_yield_is_seen_by_the_wall_clock() {
    let text = "statechart: T\ninitial: A\nstates: {A: {skill: Block, transitions: {success: B}}, B: {}}\n";
    let free = Arc::new(std::sync::atomic::AtomicBool::new(false));
    let (program, registry) = with_skill(Block(Arc::clone(&free)), text);
    let stuck = Arc::new(Mutex::new(Vec::new()));
    let (first, second) = (Arc::clone(&stuck), Arc::clone(&stuck));
    let options = ExecOptions {
        on_stuck: Some(Box::new(move |state| first.lock().push(format!("stop {state}")))),
        ..ExecOptions::default()
    };
    let executor = Executor::new(program, registry, Channels::new(), options).unwrap();
    let hang: OnStuck = Box::new(move |state| {
        second.lock().push(format!("hangs {state}"));
        free.store(true, std::sync::atomic::Ordering::Relaxed);
    });
    let result = executor.hang_after(Duration::from_millis(20), Some(hang)).run().await;
    assert_eq!(*stuck.lock(), ["stop A", "hangs A"]);
    assert_eq!(result.outcome, "failure");
    assert_eq!(result.reason.as_deref(), Some("the skill of `A` has not yielded for 0.02 s"));
}

/// Keeps the engine's inputs and the trace.
#[derive(Clone, Default)]
struct Record(Arc<Mutex<(Vec<InputRecord>, Vec<TraceItem>)>>);

impl TraceSink for Record {
    fn record(&mut self, event: &TraceEvent) {
        self.0.lock().1.push(event.item.clone());
    }
    fn input(&mut self, turn: &InputRecord) {
        self.0.lock().0.push(turn.clone());
    }
}

#[tokio::test(start_paused = true)]
async fn a_recorded_run_replays_with_the_values_that_its_guards_read() {
    let program = program(
        "
statechart: T
initial: A
states:
  A:
    watch: {w: {if: \"norm(channels.wrist.push) > 1.0\", for: 10ms}}
    transitions: {w: [{target: Hard, if: \"norm(channels.wrist.push) > 6.0\"}, B]}
    after: {5s: Hard}
  B: {skill: Act, with: {end: success, for: 1s, force: \"${channels.wrist.push[0]}\"}, transitions: {success: Done}}
  Hard: {final: failure}
  Done: {final: success}
",
    );
    let record = Record::default();
    let channels = Channels::new();
    let options = ExecOptions { sink: Some(Box::new(record.clone())), ..ExecOptions::default() };
    let executor = Executor::new(Arc::clone(&program), registry(), channels.clone(), options).unwrap();
    let publishing = tokio::spawn(async move {
        for push in [0.0, 2.0, 3.0, 2.5] {
            channels.publish("wrist", Value::record([("push", vec![push, 0.0, 0.0].into())]));
            after(20).await;
        }
    });
    let result = executor.run().await;
    publishing.await.unwrap();
    assert_eq!(result.outcome, "success");
    let (turns, told) = record.0.lock().clone();
    assert!(turns.iter().any(|turn| !turn.seen.is_empty()), "the guard's reading is kept");
    let mut engine = Engine::new(program, &BTreeMap::new(), None).unwrap();
    let mut out = Vec::new();
    turns.iter().for_each(|turn| engine.replay(turn, &mut out));
    let replayed: Vec<TraceItem> =
        out.into_iter().filter_map(|e| if let Effect::Trace(item) = e { Some(item) } else { None }).collect();
    assert_eq!(replayed, told);
}

#[tokio::test(start_paused = true)]
async fn a_thousand_charts_run_at_once() {
    let text = "
statechart: T
inputs: {n: {type: int}}
outputs: {got: {type: float}}
initial: A
states:
  A:
    skill: Act
    with: {end: success, for: \"${inputs.n * 0.001}\", force: \"${inputs.n}\"}
    transitions: {success: {target: Done, do: [{assign: {outputs.got: \"${A.value}\"}}]}}
  Done: {final: success}
";
    let program = program(text);
    let start = |n: i64| {
        let inputs = BTreeMap::from([("n".to_owned(), Value::Int(n))]);
        let options = ExecOptions { inputs, ..ExecOptions::default() };
        let executor = Executor::new(Arc::clone(&program), registry(), Channels::new(), options).unwrap();
        tokio::spawn(executor.run())
    };
    let runs: Vec<_> = (0..1000).map(start).collect();
    for (n, run) in runs.into_iter().enumerate() {
        let result = run.await.unwrap();
        assert_eq!((result.outcome.as_str(), &result.outputs["got"]), ("success", &Value::Float(n as f64)));
    }
}

/// A watch from A to B and one from B to A, on a condition that holds.
const ROUND: &str = "
statechart: T
locals: {n: {type: int, default: 1}}
initial: A
states:
  A: {watch: {w: \"locals.n > 0\"}, transitions: {w: B}}
  B: {watch: {w: \"locals.n > 0\"}, transitions: {w: A}}
";

#[tokio::test]
async fn watches_that_lead_to_each_other_end_the_run_by_the_real_clock() {
    let (result, _) = run(ROUND).await;
    assert_eq!(result.outcome, "failure");
    assert_eq!(result.reason.as_deref(), Some("1000 firings of watches without rest: `A`, `B`"));
}

#[tokio::test(start_paused = true)]
async fn skills_that_end_without_time_end_the_run() {
    let (result, _) = run("
statechart: T
initial: A
states:
  A: {skill: Act, with: {end: success}, transitions: {success: B}}
  B: {skill: Act, with: {end: success}, transitions: {success: A}}
")
    .await;
    assert_eq!(result.outcome, "failure");
    assert_eq!(result.reason.as_deref(), Some("10000 skills ended without any time between them: `A`, `B`"));
}

/// Raises events without end, as fast as the queue accepts them.
async fn flood(controller: Controller) {
    loop {
        while controller.raise("noise", Value::Null) {}
        tokio::task::yield_now().await;
    }
}

#[tokio::test]
async fn a_flood_of_events_delays_no_timer_and_no_watch() {
    let text = "
statechart: T
events: {noise: {}}
initial: A
states:
  A: {after: {50ms: B}}
  B: {watch: {fist: {if: \"channels.hand.gesture == 'fist'\", for: 50ms}}, transitions: {fist: Done}}
  Done: {final: success}
";
    let channels = Channels::new();
    channels.publish("hand", Value::record([("gesture", "fist".into())]));
    let running = run_with(text, channels, flood);
    let (result, _) = tokio::time::timeout(Duration::from_secs(20), running).await.expect("it ends");
    assert_eq!(result.outcome, "success");
}

#[tokio::test]
async fn a_flood_of_events_delays_no_stuck_skill() {
    let text = "
statechart: T
events: {noise: {}}
initial: A
states:
  A: {skill: Act, with: {end: stuck}, after: {20ms: B}}
  B: {}
";
    let running = run_with(text, Channels::new(), flood);
    let (result, _) = tokio::time::timeout(Duration::from_secs(20), running).await.expect("it ends");
    assert_eq!(result.reason.as_deref(), Some("the skill of `A` did not return after it was cancelled"));
}

/// Raises events without yielding, so that they cannot be taken meanwhile.
struct Chatter(u64);

impl Skill for Chatter {
    fn manifest(&self) -> SkillManifest {
        SkillManifest::new("Chatter", "Raises many events at once.").event("word")
    }
    fn run(&self, context: SkillContext) -> BoxFuture<'static, SkillResult> {
        (0..self.0).for_each(|_| context.events.raise("word", Value::Null));
        Box::pin(std::future::ready(Ok(crate::skill::Outcome::success())))
    }
}

#[tokio::test(start_paused = true)]
async fn an_event_over_the_bound_is_counted_and_dropped() {
    let text = "
statechart: T
outputs: {heard: {type: int, default: 0}}
initial: A
states:
  A:
    skill: Chatter
    transitions: {word: {do: [{assign: {outputs.heard: \"${outputs.heard + 1}\"}}]}, success: Done}
  Done: {final: success}
";
    let bound = crate::skill::MAX_EVENTS as u64;
    let (program, registry) = with_skill(Chatter(bound + 12), text);
    let dropped = Arc::new(Mutex::new(Vec::new()));
    let seen = Arc::clone(&dropped);
    let sink = move |event: &TraceEvent| {
        if let TraceItem::Dropped { name, reason } = &event.item {
            seen.lock().push(format!("{name}: {reason}"));
        }
    };
    let options = ExecOptions { sink: Some(Box::new(sink)), ..ExecOptions::default() };
    let executor = Executor::new(program, registry, Channels::new(), options).unwrap();
    let result = executor.run().await;
    assert_eq!(result.outputs["heard"], Value::Int(bound as i64));
    assert_eq!(*dropped.lock(), ["word: `A` raised 12 more than may wait"]);
}

#[tokio::test(start_paused = true)]
async fn a_skill_that_this_program_does_not_have_fails_its_state() {
    let program = program("statechart: T\ninitial: A\nstates: {A: {skill: Act}}\n");
    let executor = Executor::new(program, Registry::new(), Channels::new(), ExecOptions::default());
    let result = executor.unwrap().run().await;
    assert_eq!(result.reason.as_deref(), Some("there is no skill `Act` in this program"));
}

/// Publishes on a channel that its chart declares.
struct Measure;

impl Skill for Measure {
    fn manifest(&self) -> SkillManifest {
        SkillManifest::new("Measure", "Measures the battery.").publishes("battery")
    }
    fn run(&self, context: SkillContext) -> BoxFuture<'static, SkillResult> {
        Box::pin(async move {
            for volts in [12.0, 11.5, 10.9] {
                tokio::time::sleep(Duration::from_secs(1)).await;
                context.channels.publish("battery", Value::record([("volts", Value::Float(volts))]));
            }
            context.cancel.cancelled().await;
            Ok(crate::skill::Outcome::success())
        })
    }
}

#[tokio::test(start_paused = true)]
async fn what_a_skill_publishes_on_a_declared_channel_is_seen_by_watches() {
    let text = "
statechart: T
channels: {battery: {type: {volts: {type: float, unit: V}}}}
outputs: {volts: {type: float, unit: V}}
initial: A
states:
  A:
    skill: Measure
    watch: {low: {if: \"channels.battery.volts < 11.0\", for: 500ms}}
    transitions: {low: {target: Done, do: [{assign: {outputs.volts: \"${channels.battery.volts}\"}}]}, success: Done}
  Done: {final: success}
";
    let (program, registry) = with_skill(Measure, text);
    let began = tokio::time::Instant::now();
    let executor = Executor::new(program, registry, Channels::new(), ExecOptions::default()).unwrap();
    let result = executor.run().await;
    assert_eq!(result.outputs["volts"], Value::Float(10.9));
    assert_eq!(began.elapsed(), Duration::from_millis(3500));
}

//! The live page of a run: what it is shown, and what it may do. The page itself is in the viewer; it is told what the recorder is told.
//!
//! Somebody who acts through the page makes time stand still by holding up the run's only thread between two of its steps. So a pause
//! changes nothing of a run in virtual time; in real time there is none.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use armarium_bus::Session;
use armarium_robot::Model;
use armarium_runtime::chart::{self, Outline, Registry};
use armarium_runtime::exec::{Controller, SinkOfRun, TraceSink};
use armarium_runtime::trace::{TraceEvent, TraceItem};
use armarium_simulator::render::{Shape, VisibleForm};
use armarium_simulator::{Simulation, TruthSample, TruthSink, World};
use armarium_states::Equipment;
use armarium_values::Value;
use armarium_viewer::chart::{Unfold, unfold};
use armarium_viewer::live::{
    Action, ActionRefused, Control, LivePage, NewestImage, PageAddress, RunHeader, ServedTimeline, ShownRun,
    ShownRuns, ShownTimeline, Solid, SolidForm, Timeline, solids_of,
};
use armarium_viewer::recorder::Recorder;
use armarium_visionx::StereoFrame;
use futures::FutureExt as _;
use futures::future::BoxFuture;
use parking_lot::{Condvar, Mutex};

use crate::connection::Connection;
use crate::console::{Console, WorldClock};
use crate::error::HostError;
use crate::frame_sampler::{FrameSampler, LEFT_EYE};
use crate::live_service::LiveOffer;
use crate::network::AgentNetwork;
use crate::recording::{SharedRecorder, person_part};
use crate::run_config::{LiveOptions, RunConfig};
use crate::signals::signalled;

/// Topic of what somebody did through the page.
const ACTIONS: &str = "/live/actions";
/// How long the end of a run may take to reach who looks.
const END_WITHIN: Duration = Duration::from_millis(500);
/// Bytes of events that are kept of one chart among many.
const MOST_BYTES_OF_ONE: usize = 256 << 10;
/// The frame of the coach's hand or tool, as the recording names it.
const COACH: &str = "coach";
/// How large the coach's hand is shown, m, and its colour.
const HAND: (f32, [u8; 3]) = (0.045, [224, 172, 138]);

/// The page while the run goes on.
pub(crate) struct Live {
    pub(crate) timeline: Timeline,
    pub(crate) gate: Gate,
    open: Option<OpenPage>,
}

/// A run's page while it is open, here and for agents elsewhere.
pub struct OpenPage {
    run: Arc<ServedTimeline>,
    page: LivePage,
    _offer: Option<LiveOffer>,
    /// What carries it to others.
    network: Option<AgentNetwork>,
}

impl std::fmt::Debug for OpenPage {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("OpenPage").field("url", &self.url()).finish_non_exhaustive()
    }
}

impl OpenPage {
    /// Where it is.
    pub fn url(&self) -> &str {
        self.page.url()
    }

    /// Others see it as long as this lives.
    pub(crate) fn keep(&mut self, network: AgentNetwork) {
        self.network = Some(network);
    }
}

/// Holds up a run's thread while somebody wants time to stand still; clones are the same gate.
#[derive(Clone, Default)]
pub(crate) struct Gate(Arc<(Mutex<GateState>, Condvar)>);

#[derive(Default)]
struct GateState {
    closed: bool,
    /// The run waits in front of it. After it closed, the run may go on for the rest of a step.
    waits: bool,
    /// It closes after the next transition.
    steps: bool,
    /// There was that transition: it closes as soon as time goes on.
    stepped: bool,
    /// It closes when one of these states is entered.
    stops: BTreeSet<String>,
    /// The end of the run opens it for good.
    ended: bool,
}

impl Gate {
    fn change(&self, change: impl FnOnce(&mut GateState)) {
        let (state, changed) = &*self.0;
        change(&mut state.lock());
        changed.notify_all();
    }

    /// Waits while it is closed.
    pub(crate) fn pass(&self) {
        let (state, changed) = &*self.0;
        let mut state = state.lock();
        while state.closed && !state.ended {
            state.waits = true;
            changed.wait(&mut state);
        }
        state.waits = false;
    }

    /// Something happened; it may close the gate.
    pub(crate) fn happened(&self, event: &TraceEvent) {
        self.change(|state| match &event.item {
            TraceItem::Transition { .. } if state.steps => (state.steps, state.stepped) = (false, true),
            TraceItem::Entered { state: entered } if state.stops.contains(entered) => {
                (state.closed, state.steps, state.stepped) = (true, false, false);
            }
            _ => {}
        });
        self.pass();
    }

    fn holds(&self) -> bool {
        let state = self.0.0.lock();
        state.closed && state.waits && !state.ended
    }
}

impl TruthSink for Gate {
    fn sample(&mut self, _: &TruthSample) {
        self.change(|state| {
            if std::mem::take(&mut state.stepped) {
                state.closed = true;
            }
        });
        self.pass();
    }
}

/// What somebody may do through the page.
struct Acting {
    gate: Gate,
    controller: Controller,
    /// Whether time may stand still.
    virtual_time: bool,
    recorder: SharedRecorder,
    clock: armarium_simulator::Handle,
    acted: Arc<Mutex<Vec<String>>>,
}

impl Acting {
    /// Every action stands in the trace, the recording and the report.
    fn note(&self, what: String) {
        let now_ns = self.clock.now_ns();
        let line = format!("{:.2} s {what}", now_ns as f64 * 1e-9);
        let message = serde_json::json!({"what": &what});
        self.recorder.write(|recorder| recorder.json(ACTIONS, now_ns, &message));
        self.acted.lock().push(line);
        // A run that has ended has no trace any more.
        let _ = self.controller.acted(what);
    }
}

impl Control for Acting {
    fn act(&self, action: Action) -> Result<(), ActionRefused> {
        let refused = |reason: &str| Err(ActionRefused { reason: reason.to_owned() });
        let stands_still = matches!(action, Action::Pause | Action::Step | Action::Breakpoints { .. });
        if stands_still && !self.virtual_time {
            return refused("this run is in real time, which cannot stand still; the robot can be stopped");
        }
        match action {
            Action::Pause => {
                self.gate.change(|state| state.closed = true);
                self.note("pause".into());
            }
            Action::GoOn => {
                self.gate.change(|state| state.closed = false);
                self.note("go on".into());
            }
            Action::Step => {
                self.gate.change(|state| (state.closed, state.steps) = (false, true));
                self.note("step".into());
            }
            Action::Breakpoints { states } => {
                self.note(format!("breakpoints: {}", states.join(", ")));
                self.gate.change(|state| state.stops = states.into_iter().collect());
            }
            Action::Event { name, data } => {
                // The run may end with it.
                self.note(format!("event {name}"));
                if !self.controller.raise(name, Value::from_json(&data)) {
                    return refused("the queue of events is full, or the run has ended");
                }
            }
            Action::Outcome { state, outcome } => {
                self.note(format!("outcome {outcome} of {state}"));
                if !self.controller.choose(state, outcome) {
                    return refused("the queue of events is full, or the run has ended");
                }
            }
            Action::Stop => {
                self.note("stop".into());
                self.controller.stop("stopped through the live page");
                self.gate.change(|state| state.closed = false);
            }
            _ => return refused("this program does not know the action"),
        }
        Ok(())
    }

    fn is_paused(&self) -> bool {
        self.gate.holds()
    }
}

impl Live {
    /// Nothing is shown yet. The gate goes into the simulation.
    pub(crate) fn prepare(config: &RunConfig) -> Option<Self> {
        config.live.as_ref()?;
        Some(Self { timeline: Timeline::default(), gate: Gate::default(), open: None })
    }

    /// Opens the page, and says where it is. Others see it too, if the run has a name by which they reach it. Returns what has
    /// been done through the page, as it happens.
    pub(crate) async fn open(
        &mut self,
        options: &LiveOptions,
        (controller, virtual_time): (Controller, bool),
        (recorder, clock): (&SharedRecorder, &armarium_simulator::Handle),
        shown: ShownTimeline,
        others: Option<(&Connection, &str)>,
        console: &dyn Console,
    ) -> Result<Arc<Mutex<Vec<String>>>, HostError> {
        let acted = Arc::<Mutex<Vec<String>>>::default();
        let control = options.control.then(|| {
            Arc::new(Acting {
                gate: self.gate.clone(),
                controller,
                virtual_time,
                recorder: recorder.clone(),
                clock: clock.clone(),
                acted: Arc::clone(&acted),
            }) as Arc<dyn Control>
        });
        let run = ShownTimeline { timeline: self.timeline.clone(), control, ..shown }.served();
        let offer = match others {
            Some((connection, agent)) => {
                let reached = (connection.session(), connection.runtime().handle());
                Some(LiveOffer::start(reached, agent, Arc::clone(&run)).await?)
            }
            None => None,
        };
        let shown = [Arc::clone(&run) as Arc<dyn ShownRun>].into_iter().collect();
        let page = open_page(&options.address, shown, vec![open_at_signals(self.gate.clone()).boxed()])?;
        console.page(page.url());
        self.open = Some(OpenPage { run, page, _offer: offer, network: None });
        Ok(acted)
    }

    /// The run has ended: nothing holds it up any more. Who looks is told, before the program ends.
    pub(crate) fn end(self, ended: serde_json::Value) -> Option<OpenPage> {
        self.gate.change(|state| state.ended = true);
        self.timeline.end(ended);
        if let Some(open) = &self.open {
            open.run.wait_until_told(END_WITHIN);
        }
        self.open
    }
}

/// The page of something that serves others until it is ended, such as an agent: what is recorded of it goes to the page alone.
pub(crate) struct ServiceView {
    pub(crate) recorder: SharedRecorder,
    runs: ShownRuns,
    _page: LivePage,
    _offer: LiveOffer,
}

impl ServiceView {
    /// Opens the page, and says where it is; others see it by the agent's name. It has to be called on the session's threads.
    pub(crate) async fn open(
        address: &PageAddress,
        (title, subtitle): (&str, String),
        outline: Outline,
        (manifests, model): (&Registry, &Model),
        session: &Session,
        console: &dyn Console,
    ) -> Result<Self, HostError> {
        let timeline = Timeline::default();
        timeline.begin(&RunHeader::new((title, subtitle), outline, manifests.manifests(), solids_of(model)));
        let recorder = SharedRecorder::default();
        recorder.begin(Recorder::without_file(Arc::new(timeline.clone()))?);
        let run = ShownTimeline { timeline, ..ShownTimeline::default() }.served();
        let threads = tokio::runtime::Handle::current();
        let offer = LiveOffer::start((session, &threads), title, Arc::clone(&run)).await?;
        let runs: ShownRuns = [run as Arc<dyn ShownRun>].into_iter().collect();
        let page = open_page(address, runs.clone(), Vec::new())?;
        console.page(page.url());
        Ok(Self { recorder, runs, _page: page, _offer: offer })
    }

    /// Shows one more run, of a chart that others have started, and records its events.
    pub(crate) fn add(&self, header: &RunHeader, clock: WorldClock) -> Result<RecordedEvents, HostError> {
        let timeline = Timeline::bounded(MOST_BYTES_OF_ONE);
        timeline.begin(header);
        let recorder = SharedRecorder::default();
        recorder.begin(Recorder::without_file(Arc::new(timeline.clone()))?);
        self.runs.add(ShownTimeline { timeline: timeline.clone(), ..ShownTimeline::default() }.served());
        Ok(RecordedEvents { recorder, clock, ends: Some(timeline) })
    }
}

fn open_page(
    address: &PageAddress,
    runs: ShownRuns,
    beside: Vec<BoxFuture<'static, ()>>,
) -> Result<LivePage, HostError> {
    let refused = |source| HostError::Live { address: address.to_string(), source };
    LivePage::open(address, runs, beside).map_err(refused)
}

/// Shows each run of a chart that others start.
pub(crate) fn shown_runs(
    view: &Arc<ServiceView>,
    outline: Outline,
    manifests: &Registry,
    clock: &WorldClock,
) -> SinkOfRun {
    let title = outline.states.first().map_or_else(String::new, |chart| chart.name.clone());
    let header =
        RunHeader::new((&title, "started by others".into()), outline, manifests.manifests(), Vec::new());
    let (view, clock) = (Arc::clone(view), Arc::clone(clock));
    Arc::new(move || match view.add(&header, Arc::clone(&clock)) {
        Ok(sink) => Some(Box::new(sink) as Box<dyn TraceSink>),
        Err(error) => {
            tracing::warn!("a run is not shown: {error}");
            None
        }
    })
}

/// Records the events of an agent's chart.
pub(crate) struct RecordedEvents {
    pub(crate) recorder: SharedRecorder,
    pub(crate) clock: WorldClock,
    /// The timeline that ends with the chart, where it is of this chart alone.
    pub(crate) ends: Option<Timeline>,
}

impl TraceSink for RecordedEvents {
    fn record(&mut self, event: &TraceEvent) {
        if let Ok(json) = serde_json::to_value(event) {
            self.recorder.write(|recorder| recorder.event((self.clock)(), &json));
        }
        if let (Some(timeline), TraceItem::Finished { outcome, reason, chain, .. }) =
            (&self.ends, &event.item)
        {
            timeline.end(serde_json::json!({"outcome": outcome, "reason": reason, "chain": chain}));
        }
    }
}

/// The outline of a chart with those that it uses unfolded; empty if it cannot be read.
pub(crate) fn outline_of(chart: &Path, folders: &[PathBuf]) -> Outline {
    let library = chart::load(chart, folders);
    let mut outline = Outline { states: Vec::new(), transitions: Vec::new() };
    if let Some(root) = library.charts.get(&library.root) {
        outline = Outline::of(root);
        unfold(&mut outline, &library.charts, &Unfold::All);
    }
    outline
}

/// What does not change during a run, for its page and its recording.
pub(crate) fn header(
    config: &RunConfig,
    (title, subtitle): (&str, String),
    registry: &Registry,
    equipment: &Equipment,
    simulation: Option<&Simulation>,
    bodies: &[String],
) -> RunHeader {
    let outline = outline_of(&config.chart, &config.charts);
    let mut solids = solids_of(equipment.robot.model());
    if let Some(simulation) = simulation {
        let shapes = simulation.shapes();
        solids.extend(shapes.fixed.iter().filter_map(|shape| solid(None, shape)));
        for (body, parts) in bodies.iter().zip(&shapes.bodies) {
            solids.extend(parts.iter().filter_map(|part| solid(Some(body), part)));
        }
        for (person, parts) in shapes.people.iter().enumerate() {
            let part = |(part, shape)| solid(Some(&person_part(person, part)), shape);
            solids.extend(parts.iter().enumerate().filter_map(part));
        }
        let hand = SolidForm::Sphere { size: [HAND.0] };
        let coach = Solid::new(Some(COACH), hand, &nalgebra::Isometry3::identity(), HAND.1);
        solids.push(Solid { passing: true, ..coach });
    }
    RunHeader::new((title, subtitle), outline, registry.manifests(), solids)
}

/// The names of a world's bodies, by which frames are called that move with them.
pub(crate) fn body_names(world: &World) -> Vec<String> {
    world.named_bodies().map(|body| body.name).collect()
}

/// A shape as a viewer shows it; surfaces of triangles are left out.
fn solid(frame: Option<&str>, shape: &Shape) -> Option<Solid> {
    let edges = |half: &nalgebra::Vector3<f64>| [half.x, half.y, half.z].map(|half| 2.0 * half as f32);
    let form = match &shape.geometry {
        VisibleForm::Box { half } | VisibleForm::Tabletop { half, .. } => {
            SolidForm::Box { size: edges(half) }
        }
        VisibleForm::Sphere { radius } => SolidForm::Sphere { size: [*radius as f32] },
        VisibleForm::Cylinder { radius, half_length } => {
            SolidForm::Cylinder { size: [*radius as f32, 2.0 * *half_length as f32] }
        }
        VisibleForm::Capsule { radius, half_length } => {
            SolidForm::Capsule { size: [*radius as f32, 2.0 * *half_length as f32] }
        }
        VisibleForm::Mesh { .. } => return None,
    };
    Some(Solid::new(frame, form, &shape.scene_from_shape, shape.color))
}

/// Who waits at a closed gate hears no signal: this opens it.
async fn open_at_signals(gate: Gate) {
    signalled().await;
    gate.change(|state| state.ended = true);
}

/// The newest frame of the left eye, with what is seen in it. A frame is searched once, however many look.
pub(crate) fn newest_image(frames: Arc<FrameSampler>) -> NewestImage {
    let last = Mutex::new(None::<(u64, Arc<[u8]>)>);
    Arc::new(move |topic| {
        let frame: Arc<StereoFrame> = frames.newest().filter(|_| topic == LEFT_EYE)?;
        let mut last = last.lock();
        if last.as_ref().is_none_or(|(stamp_ns, _)| *stamp_ns != frame.stamp_ns) {
            *last = Some((frame.stamp_ns, frames.marked(&frame)?.into()));
        }
        last.clone()
    })
}

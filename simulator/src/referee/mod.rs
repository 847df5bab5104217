//! The referee: sees the truth, receives marks when the program's phases begin and end, and judges.
//!
//! It keeps a bounded log ([`TruthLog`]). Its probes compute every figure from that by pure functions ([`measure`]), so that the
//! figures can be recomputed from a recording. Each probe is a file: `grasp`, `imitation`, `force`, `wiped`, `gestures`,
//! `coached`, `body_coached`, `bodies`, `people`, `guiding`, `reaching`, `carrying`, `learning_together`, `environment`, `gaze`, `segmentation`, `touch`, `slip`; `probes` is their list. The referee never tells the robot anything.

mod bodies;
mod body_coached;
mod carrying;
mod coached;
mod environment;
mod force;
mod gaze;
mod gestures;
mod grasp;
mod guiding;
mod imitation;
mod learning_together;
mod log;
mod path_change;
mod paths;
mod people;
mod probes;
mod reaching;
mod run;
mod segmentation;
mod slip;
#[cfg(test)]
mod tests;
mod touch;
mod wiped;

use std::collections::BTreeMap;
use std::sync::Arc;

use armarium_values::report::Section;
use log::MAX_FRAMES;
pub use log::{KnownHypothesis, KnownSurface, KnownThing, KnownTouch, Record, TruthLog};
use parking_lot::{Mutex, MutexGuard};
pub use probes::judged_figures;
use run::JudgedRun;
use serde_json::{Map, Value};
pub use wiped::WipedCells;

use crate::truth::{FrameTruth, TruthEvent, TruthSample};
use crate::world::World;

/// The progress of skills, from the marks in their manifests. If a mark is set several times, the last one counts.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Milestone {
    /// The hand has finished closing, and the program assumes that it holds the object.
    GraspClosed,
    /// From here on the robot watches whether what its hand holds slips.
    GraspWatched,
    /// It no longer watches that.
    WatchEnded,
    /// Learning from the demonstration has ended; from here on the robot performs the motion in free space.
    LearningEnded,
    /// The motion in free space has settled: at least one steady period follows.
    FreeSpaceSteady,
    /// The robot leaves free space: it begins to lower what it holds.
    AdaptationStarted,
    /// Force adaptation has ended.
    AdaptationEnded {
        /// The desired force, N.
        desired_n: f64,
        /// Number of cycles that it took.
        cycles: u32,
    },
    /// The background motion runs and the coach may act.
    WipingStarted,
    /// The robot's hand may be led.
    GuidingStarted,
    /// Both hands begin to go to two grasps of one thing.
    ReachingStarted,
    /// They are there, as far as the robot knows.
    GraspsReached,
    /// Both hands press on something.
    LoadTaken,
    /// Both hands begin to carry something.
    CarryingStarted,
    /// They have carried it to where it should be.
    CarryingEnded {
        /// What they feel that it weighs, N.
        weight_n: f64,
    },
    /// They begin to put it down.
    PutDownStarted,
    /// They have put it down and let go.
    PutDownEnded,
    /// Two hands begin to lift and shake what they hold, to learn from it.
    EpochStarted,
    /// They have lifted it and begin to shake it.
    PeriodsStarted,
    /// They have done so to the end.
    EpochEnded,
    /// They have learned.
    LearnedTogether {
        /// How many epochs they had learned from before.
        before: u32,
    },
    /// A hand leaves its place over a thing, to grasp it or to put something on it.
    PrePoseLeft,
    /// The robot begins to play a motion in free space.
    PlayStarted,
    /// It has played it.
    PlayEnded,
    /// The robot has pushed something to see what moves.
    ObjectPushed,
    /// A hand begins to come to a thing, and is to stop when it touches it.
    ApproachStarted,
    /// It has come to the end of its way.
    ApproachEnded,
}

impl Milestone {
    /// The mark of that name with its numbers, as a skill declares it; `None` if this referee does not know it.
    pub fn named(name: &str, numbers: &BTreeMap<String, f64>) -> Option<Self> {
        let number = |name: &str| numbers.get(name).copied().unwrap_or_default();
        Some(match name {
            "grasp_closed" => Self::GraspClosed,
            "grasp_watched" => Self::GraspWatched,
            "watch_ended" => Self::WatchEnded,
            "learning_ended" => Self::LearningEnded,
            "free_space_steady" => Self::FreeSpaceSteady,
            "adaptation_started" => Self::AdaptationStarted,
            "adaptation_ended" => {
                Self::AdaptationEnded { desired_n: number("desired_n"), cycles: number("cycles") as u32 }
            }
            "wiping_started" => Self::WipingStarted,
            "guiding_started" => Self::GuidingStarted,
            "reaching_started" => Self::ReachingStarted,
            "grasps_reached" => Self::GraspsReached,
            "load_taken" => Self::LoadTaken,
            "carrying_started" => Self::CarryingStarted,
            "carrying_ended" => Self::CarryingEnded { weight_n: number("weight_n") },
            "put_down_started" => Self::PutDownStarted,
            "put_down_ended" => Self::PutDownEnded,
            "epoch_started" => Self::EpochStarted,
            "periods_started" => Self::PeriodsStarted,
            "epoch_ended" => Self::EpochEnded,
            "learned_together" => Self::LearnedTogether { before: number("before") as u32 },
            "pre_pose_left" => Self::PrePoseLeft,
            "play_started" => Self::PlayStarted,
            "play_ended" => Self::PlayEnded,
            "object_pushed" => Self::ObjectPushed,
            "approach_started" => Self::ApproachStarted,
            "approach_ended" => Self::ApproachEnded,
            _ => return None,
        })
    }
}

/// A handle to the referee; clones share the same referee.
#[derive(Clone, Debug)]
pub struct Referee {
    shared: Arc<Mutex<Notes>>,
}

#[derive(Debug)]
struct Notes {
    world: World,
    log: TruthLog,
    marks: Vec<(u64, Milestone)>,
    seen: Vec<(u64, Option<String>)>,
}

impl Notes {
    fn run(&self) -> JudgedRun<'_> {
        JudgedRun::new(&self.world, &self.log, &self.marks, &self.seen)
    }
}

/// The figures of a run: what each probe measured, by its name. `seen` is what vision recognised in the frames.
pub fn measure(
    world: &World,
    log: &TruthLog,
    marks: &[(u64, Milestone)],
    seen: &[(u64, Option<String>)],
) -> Map<String, Value> {
    probes::measure(&JudgedRun::new(world, log, marks, seen))
}

/// Adds to a list that must not grow without end.
fn note<T>(list: &mut Vec<T>, most: usize, new: T) {
    if list.len() < most {
        list.push(new);
    }
}

impl Referee {
    /// The referee of a world.
    pub fn new(world: &World) -> Self {
        let notes =
            Notes { world: world.clone(), log: TruthLog::default(), marks: Vec::new(), seen: Vec::new() };
        Self { shared: Arc::new(Mutex::new(notes)) }
    }

    fn notes(&self) -> MutexGuard<'_, Notes> {
        self.shared.lock()
    }

    /// Records a mark of the program at `stamp_ns` of the robot's time.
    pub fn mark(&self, mark: Milestone, stamp_ns: u64) {
        note(&mut self.notes().marks, 10_000, (stamp_ns, mark));
    }

    /// Records what the program's vision recognised in the frame of `stamp_ns`: `fist`, `point_one`, `point_two`,
    /// `open_hand`, or `None` for no hand. To be called for every frame that was processed.
    pub fn gesture_seen(&self, stamp_ns: u64, label: Option<&str>) {
        note(&mut self.notes().seen, MAX_FRAMES, (stamp_ns, label.map(str::to_owned)));
    }

    /// Records what the robot's memory tells of a surface around it at `stamp_ns`: its name, and `None` when it is no longer known.
    pub fn surface_known(&self, stamp_ns: u64, name: &str, known: Option<KnownSurface>) {
        note(&mut self.notes().log.surfaces, MAX_FRAMES, (stamp_ns, name.to_owned(), known));
    }

    /// Records what the robot's memory knows of a thing from `stamp_ns` on, by the thing's name.
    pub fn thing_known(&self, stamp_ns: u64, name: &str, known: KnownThing) {
        note(&mut self.notes().log.things, MAX_FRAMES, (stamp_ns, name.to_owned(), known));
    }

    /// Records what the robot's memory takes for one thing in the picture of `stamp_ns`, by its name there; `None` when it was dropped.
    pub fn hypothesis_known(&self, stamp_ns: u64, name: &str, known: Option<KnownHypothesis>) {
        note(&mut self.notes().log.hypotheses, MAX_FRAMES, (stamp_ns, name.to_owned(), known));
    }

    /// Records that the robot's memory was told of a touch at `stamp_ns`.
    pub fn touch_known(&self, stamp_ns: u64, known: KnownTouch) {
        note(&mut self.notes().log.touches, MAX_FRAMES, (stamp_ns, known));
    }

    /// Records that the robot's memory was told at `stamp_ns` that what a hand held slipped.
    pub fn slip_known(&self, stamp_ns: u64) {
        note(&mut self.notes().log.slips, MAX_FRAMES, stamp_ns);
    }

    /// Records that a skill's activation needs to know the place of a thing in memory from `stamp_ns` on.
    pub fn needs(&self, stamp_ns: u64, activation: u64, thing: &str) {
        self.notes().log.needs(stamp_ns, activation, thing);
    }

    /// Records that an activation has ended, and with it all that it needed.
    pub fn needs_no_more(&self, stamp_ns: u64, activation: u64) {
        self.notes().log.needs_no_more(stamp_ns, activation);
    }

    /// All figures so far, by the names of their probes; those without data are absent.
    pub fn report(&self) -> Value {
        let notes = self.notes();
        measure(&notes.world, &notes.log, &notes.marks, &notes.seen).into()
    }

    /// The report's sections about the run; the figures with their requirements come first. Sections without data
    /// are empty.
    pub fn sections(&self) -> Vec<Section> {
        let notes = self.notes();
        let run = notes.run();
        probes::sections(&run, &probes::measure(&run).into())
    }

    /// The cells of the table that had to be cleaned, and those that were; `None` before adaptation has ended.
    pub fn wiped(&self) -> Option<WipedCells> {
        wiped::wiped(&self.notes().run())
    }

    /// The object that is judged, by its index among the world's bodies: the one in the hand when it closed last; where nothing
    /// was marked so, the one in question at the end.
    pub fn judged_object(&self) -> Option<usize> {
        self.notes().run().judged_object()
    }

    /// A copy of the whole log, for plots.
    pub fn log(&self) -> TruthLog {
        self.notes().log.clone()
    }

    /// The marks so far, with their times, ns.
    pub fn marks(&self) -> Vec<(u64, Milestone)> {
        self.notes().marks.clone()
    }

    pub(crate) fn sample(&self, sample: &TruthSample) {
        self.notes().log.sample(sample);
    }

    pub(crate) fn frame(&self, frame: &FrameTruth) {
        self.notes().log.frame(frame);
    }

    pub(crate) fn event(&self, stamp_ns: u64, event: &TruthEvent) {
        self.notes().log.event(stamp_ns, event);
    }
}

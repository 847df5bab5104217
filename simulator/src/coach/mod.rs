//! The coach: a person who demonstrates the motion when asked, then changes it by pushing the robot's hand and by
//! gestures.
//!
//! The coach hears what the robot says, sees the robot's arm at its true pose, and pushes its hand by a force. The
//! coach's hand and tool are visible to the cameras but have no physics. The coach is stepped every millisecond and
//! seeded.

mod clearance;
mod coaching;
mod demonstration;
mod path;

use nalgebra::{Isometry3, Point3, Vector3};
use rand_chacha::ChaCha8Rng;

pub use coaching::{ActionEvent, ActionKind, EventKind, HandShown};
pub(crate) use demonstration::minimum_jerk;
pub use demonstration::{Performance, ToolShown};
pub use path::{CoachPath, PhaseTracker, Wobble, wrap};

use crate::world::{CoachSpec, DemonstrationSpec};
use coaching::Coaching;

/// The coach's state at an instant.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CoachState {
    /// Pose of the tool's middle, while it is shown.
    pub tool: Option<Isometry3<f64>>,
    /// The bare hand, while it is shown.
    pub hand: Option<HandShown>,
    /// Force on the robot's hand at the TCP, root frame, N.
    pub push: Vector3<f64>,
    /// Phase of the robot's hand on the coach's path while it wipes, 0 to 1.
    pub phase: Option<f64>,
}

/// The wiping arm as the coach sees it, root frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SeenArm {
    /// The TCP, m.
    pub tcp: Point3<f64>,
    /// Its velocity, m/s.
    pub velocity: Vector3<f64>,
    /// The wrist, m.
    pub wrist: Point3<f64>,
    /// The elbow, m.
    pub elbow: Point3<f64>,
}

/// The coach of a world.
#[derive(Clone, Debug)]
pub struct Coach {
    demonstration: Option<DemonstrationSpec>,
    table_height: f64,
    performance: Option<(f64, Performance)>,
    coaching: Coaching,
    rng: ChaCha8Rng,
    state: CoachState,
}

impl Coach {
    /// The coach of a world. `camera` is the position of the robot's cameras, m, to which gestures are shown; `side` is
    /// that of the arm that works: 1 for the robot's right, -1 for its left.
    pub fn new(
        spec: &CoachSpec,
        table_height: f64,
        (camera, side): (Point3<f64>, f64),
        rng: ChaCha8Rng,
    ) -> Self {
        let path = CoachPath::new(&spec.demonstration.clone().unwrap_or_default());
        let mut turns = rng.clone();
        turns.set_stream(rng.get_stream() ^ 1 << 32);
        Self {
            demonstration: spec.demonstration.clone().filter(|d| d.periods > 0),
            table_height,
            performance: None,
            coaching: Coaching::new(spec, path, (camera, side), &mut turns),
            rng,
            state: CoachState::default(),
        }
    }

    /// Processes an utterance of the robot: "show me" starts a demonstration (unless one is running), "wiping"
    /// starts the coaching.
    pub fn hear(&mut self, utterance: &str, t: f64) {
        let words = utterance.to_lowercase();
        if words.contains("show me") {
            let over = self.performance.as_ref().is_none_or(|(from, p)| t > from + p.duration());
            if let Some(demonstration) = self.demonstration.as_ref().filter(|_| over) {
                self.performance =
                    Some((t, Performance::new(demonstration, self.table_height, &mut self.rng)));
            }
        } else if words.contains("wiping") {
            self.coaching.begin(t);
        }
    }

    /// When the robot first said that it wipes, s.
    pub fn wiping_since(&self) -> Option<f64> {
        self.coaching.since()
    }

    /// Acts for one step that ends at `t` s. `arm` is asked when the coach looks at the arm.
    pub fn step(&mut self, t: f64, arm: impl FnOnce() -> SeenArm, dt: f64) -> &CoachState {
        let shown = self.performance.as_ref().and_then(|(from, p)| p.at(t - from));
        self.coaching.step(t, arm, dt, &mut self.state);
        self.state.tool = shown.map(|s| s.root_from_tool);
        &self.state
    }

    /// The events since the last call.
    pub fn take_events(&mut self) -> Vec<ActionEvent> {
        self.coaching.take_events()
    }

    /// Whether all planned actions are done.
    pub fn is_done(&self, t: f64) -> bool {
        self.coaching.is_done(t)
    }
}

//! The coach's section of a world file.

use armarium_source::yaml::Node;
use armarium_source::{Field, Findings, Rule, choice, code, form};
use armarium_visionx::Gesture;
use serde::Serialize;
use serde_json::{Value as Json, json};

use super::{COLOR, MAX_LIST, within};

form! {
    /// The coach.
    pub struct CoachSpec: "a coach" {
        /// What the coach demonstrates with.
        pub tool: ToolSpec = ToolSpec::default();
        /// What the coach demonstrates; `none` is a coach who never does.
        pub demonstration: Option<DemonstrationSpec> = Some(DemonstrationSpec::default()), Rule::OR_NONE;
        /// What the coach does while the robot wipes, in order, each after the one before.
        pub coaching: Vec<CoachingStep> = default_coaching(), Rule::most(MAX_LIST);
        /// When the coach has gone, s from the start of wiping.
        pub ends: f64 = 95.0, Rule::number("s", 0.0, 3600.0);
        /// Where the palm of a gesture looks.
        pub palm: Palm = Palm::Camera;
        /// Whether a gesture arrives when the robot's hand does.
        pub timing: Timing = Timing::Matched;
        /// How fast a hand comes and goes, as a multiple of 0.35 m in 1 s.
        pub speed: f64 = 1.0, Rule::number("", 0.2, 3.0);
    }
}

/// Where the palm of a gesture looks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Palm {
    /// To the robot's cameras, as far as the fingers' direction allows.
    #[default]
    Camera,
    /// Turned from that about the fingers by up to 60 degrees and tilted by up to 25, as the seed draws for each gesture.
    Any,
}
choice!(Palm { "camera" => Self::Camera, "any" => Self::Any });

/// Whether a gesture arrives when the robot's hand does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Timing {
    /// The hand comes when the robot's comes to the coached phase.
    #[default]
    Matched,
    /// It comes when it comes, at its own speed.
    Free,
}
choice!(Timing { "matched" => Self::Matched, "free" => Self::Free });

form! {
    /// The coach's tool: a block of 0.09 x 0.06 x 0.04 m.
    pub struct ToolSpec: "a tool" {
        /// Colour, RGB.
        pub color: [u8; 3] = [40, 170, 60], COLOR;
    }
}

form! {
    /// A swipe that shows where, then a periodic motion about the swipe's middle.
    pub struct DemonstrationSpec: "a demonstration" {
        /// Form of the path.
        pub shape: PathShape = PathShape::Ellipse;
        /// Full width (x) and depth (y) of the path, m; negative: mirrored in that direction.
        pub size: [f64; 2] = [0.10, 0.06], Rule::number("m", -1.0, 1.0);
        /// Periods of the whole path a second (a figure of eight counts once), Hz.
        pub frequency: f64 = 0.5, Rule::number("Hz", 0.05, 5.0);
        /// The swipe across the workspace.
        pub swipe: SwipeSpec = SwipeSpec::default();
        /// Height of the tool's centre above the table's height, m.
        pub height: f64 = 0.20, Rule::number("m", 0.05, 0.8);
        /// How many periods; 0 is a coach who never demonstrates.
        pub periods: u32 = 15, Rule::number("", 0.0, 1000.0);
        /// Unsteadiness of the hand: standard deviation of position as a part of half the path's size, and of speed as a part of
        /// the speed; smooth and seeded.
        pub jitter: f64 = 0.02, Rule::number("", 0.0, 0.3);
    }
}

/// Form of the demonstrated path; `theta` is 2 pi times the phase.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum PathShape {
    /// `x = cx + sx/2 cos theta, y = cy + sy/2 sin theta`.
    #[default]
    Ellipse,
    /// `x = cx + sx/2 cos theta, y = cy + sy/2 sin 2 theta`.
    Eight,
    /// Along the diagonal of `size`: `x = cx + sx/2 cos theta, y = cy + sy/2 cos theta`.
    Line,
}
choice!(PathShape { "ellipse" => Self::Ellipse, "eight" => Self::Eight, "line" => Self::Line });

form! {
    /// The first swipe, from lower left to upper right: it gives the workspace.
    pub struct SwipeSpec: "a swipe", check Self::goes_somewhere {
        /// Start x, y, m.
        pub from: [f64; 2] = [0.20, 0.48], within(3.0);
        /// End x, y, m.
        pub to: [f64; 2] = [0.36, 0.58], within(3.0);
    }
}

impl SwipeSpec {
    fn goes_somewhere(&self, node: &Node, findings: &mut Findings) {
        let [dx, dy] = [self.to[0] - self.from[0], self.to[1] - self.from[1]];
        if libm::hypot(dx, dy) < 0.02 {
            let help = Some("`from` and `to` differ by 2 cm or more".into());
            findings.error_help(code::VALUE, node.span, "the swipe goes nowhere", help);
        }
    }
}

/// One thing that the coach does while the robot wipes.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CoachingStep {
    /// Earliest time, s from the start of wiping.
    pub at: f64,
    /// What.
    #[serde(flatten)]
    pub action: CoachingAction,
}

/// A push or a gesture.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum CoachingAction {
    /// The coach pushes the robot's hand.
    Push {
        /// How.
        push: Push,
    },
    /// The coach shows a gesture beside the path.
    Show(Show),
}

form! {
    /// A push on the hand, once a cycle.
    pub struct Push: "a push" {
        /// Phase of the path, 0 to 1, about which the coach pushes.
        pub phase: f64 = 0.25, Rule::number("", 0.0, 1.0);
        /// How far from that phase, in phase.
        pub arc: f64 = 0.2, Rule::number("", 0.01, 0.5);
        /// Largest force, N.
        pub force: [f64; 3] = [0.0, 12.0, 0.0], Rule::number("N", -500.0, 500.0);
        /// How many cycles.
        pub cycles: u32 = 6, Rule::number("", 1.0, 1000.0);
    }
}

/// A gesture beside the path.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Show {
    /// What the hand shows.
    pub gesture: Gesture,
    /// Phase of the coach's path, 0 to 1, beside which the hand waits.
    pub phase: f64,
    /// From the path's point (at the height of the robot's TCP when it wipes) to the palm, m.
    pub offset: [f64; 3],
    /// How long the hand waits there, s.
    #[serde(rename = "for")]
    pub duration: f64,
    /// Where `point_one` points, and how far the coach means, m.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub direction: Option<[f64; 3]>,
}

form! {
    struct PushStep: "a push of the coach" {
        /// Earliest time, s from the start of wiping.
        at: f64 = 0.0, Rule::number("s", 0.0, 3600.0);
        /// How the coach pushes the robot's hand.
        push: Push;
    }
}

form! {
    struct ShowStep: "a gesture of the coach", check Self::points {
        /// Earliest time, s from the start of wiping.
        at: f64 = 0.0, Rule::number("s", 0.0, 3600.0);
        /// What the hand shows.
        gesture: Gesture;
        /// Phase of the coach's path, 0 to 1, beside which the hand waits.
        phase: f64 = 0.0, Rule::number("", 0.0, 1.0);
        /// From the path's point (at the height of the robot's TCP when it wipes) to the palm, m: `[0.0, 0.12, 0.0]`.
        offset: [f64; 3], within(1.0);
        /// How long the hand waits there, s.
        duration as "for": f64 = 10.0, Rule::number("s", 0.1, 600.0);
        /// Where `point_one` points, and how far the coach means, m: `[0.0, 0.04, 0.0]`.
        direction: Option<[f64; 3]> = None, within(1.0);
    }
}

impl ShowStep {
    fn points(&self, node: &Node, findings: &mut Findings) {
        match (self.gesture, self.direction) {
            (Gesture::PointOne, Some([0.0, 0.0, 0.0])) => {
                findings.error(code::VALUE, node.place("direction"), "the direction has no length");
            }
            (Gesture::PointOne, None) => {
                let help = Some("direction: [0.0, 0.04, 0.0]".into());
                findings.error_help(code::MISSING_KEY, node.span, "`point_one` needs a `direction`", help);
            }
            (Gesture::PointOne, Some(_)) | (_, None) => {}
            (_, Some(_)) => {
                findings.error(code::KEY, node.place("direction"), "only `point_one` has a direction")
            }
        }
    }
}

impl Default for CoachingStep {
    fn default() -> Self {
        Self { at: 0.0, action: CoachingAction::Push { push: Push::default() } }
    }
}

impl Field for CoachingStep {
    fn read(&mut self, node: &Node, _: &Rule, findings: &mut Findings) {
        *self = match (node.get("push"), node.get("gesture")) {
            (Some(_), None) => {
                let mut step = PushStep::default();
                armarium_source::set(&mut step, node, findings);
                Self { at: step.at, action: CoachingAction::Push { push: step.push } }
            }
            (None, Some(_)) => {
                let mut step = ShowStep::default();
                armarium_source::set(&mut step, node, findings);
                let ShowStep { at, gesture, phase, offset, duration, direction } = step;
                Self {
                    at,
                    action: CoachingAction::Show(Show { gesture, phase, offset, duration, direction }),
                }
            }
            _ => {
                let message = "a coaching step has either `push` or `gesture`";
                return findings.error(code::VALUE, node.span, message);
            }
        };
    }
    fn schema(_: &Rule) -> Json {
        json!({"anyOf": [armarium_source::schema::<PushStep>(), armarium_source::schema::<ShowStep>()]})
    }
}

/// The default coaching: a push outwards, a fist that pulls, two fingers that push back, one finger that moves
/// the whole, and the open hand that announces more.
fn default_coaching() -> Vec<CoachingStep> {
    let show = |at, gesture, phase, offset, duration, direction| CoachingStep {
        at,
        action: CoachingAction::Show(Show { gesture, phase, offset, duration, direction }),
    };
    vec![
        CoachingStep { at: 10.0, action: CoachingAction::Push { push: Push::default() } },
        show(30.0, Gesture::Fist, 0.75, [0.0, -0.12, 0.0], 12.0, None),
        show(50.0, Gesture::PointTwo, 0.0, [0.10, 0.0, 0.0], 12.0, None),
        show(70.0, Gesture::PointOne, 0.5, [0.0, 0.12, 0.05], 8.0, Some([0.0, 0.04, 0.0])),
        show(85.0, Gesture::OpenHand, 0.25, [0.0, 0.15, 0.05], 3.0, None),
    ]
}

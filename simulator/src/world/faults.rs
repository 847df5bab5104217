//! What goes wrong in a run: sensors that are broken for a time, and forces on things and hands. It breaks nothing itself.

use armarium_source::{Rule, choice, form};
use nalgebra::Vector3;
use serde::Serialize;

/// What a disturbance names that shoves the hand of the arm that works.
pub const HAND: &str = "hand";
/// What one names that shoves its forearm.
pub const ARM: &str = "arm";

form! {
    /// Sensors that are broken from a time on.
    pub struct Faults: "`faults`" {
        /// What is wrong with the images.
        pub images: ImageFault = ImageFault::None;
        /// What is wrong with the wrist sensor.
        pub wrench: WrenchFault = WrenchFault::None;
        /// From when on, s of the robot's time.
        pub from: f64 = 0.0, Rule::number("s", 0.0, 3600.0);
        /// For how long, s; without it, to the end.
        #[serde(skip_serializing_if = "Option::is_none")]
        pub duration as "for": Option<f64> = None, Rule::number("s", 0.001, 3600.0);
    }
}

impl Faults {
    /// Whether something is broken at a time, s.
    pub fn at(&self, t: f64) -> bool {
        t >= self.from && self.duration.is_none_or(|duration| t < self.from + duration)
    }
}

/// What is wrong with the images.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ImageFault {
    /// Nothing.
    #[default]
    None,
    /// The lenses are covered: every pixel is 0.
    Black,
    /// Left and right are exchanged.
    Swapped,
    /// The last image before the fault is repeated.
    Frozen,
}
choice!(ImageFault {
    "none" => Self::None, "black" => Self::Black, "swapped" => Self::Swapped, "frozen" => Self::Frozen,
});

/// What is wrong with the wrist sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum WrenchFault {
    /// Nothing.
    #[default]
    None,
    /// The last sample before the fault is repeated.
    Frozen,
}
choice!(WrenchFault { "none" => Self::None, "frozen" => Self::Frozen });

form! {
    /// An accident: a force on an object, or on the hand or the forearm of the arm that works.
    pub struct Disturbance: "a disturbance" {
        /// What the time counts from.
        pub after: WorldEvent = WorldEvent::Wiping;
        /// When, s after that.
        pub at: f64 = 1.0, Rule::number("s", 0.0, 3600.0);
        /// Name of an object, `hand` or `arm`.
        pub knock: String = "sponge".into(), Rule::NAME;
        /// Force at its centre, N.
        pub force: [f64; 3] = [90.0, 0.0, 0.0], Rule::number("N", -1000.0, 1000.0);
        /// How long, s; the force rises and falls as half a sine.
        pub duration as "for": f64 = 0.1, Rule::number("s", 0.001, 3600.0);
        /// Whether the force is the same all the time instead.
        pub steady: bool = false;
        /// Where somebody takes it in that time instead, from where it is, m: evenly, with no more force than `force` is long.
        #[serde(skip_serializing_if = "Option::is_none")]
        pub by: Option<[f64; 3]> = None, Rule::number("m", -1.0, 1.0);
        /// The friction of the object in that time, instead of a force, where it is more otherwise: what a hand holds slips out.
        #[serde(skip_serializing_if = "Option::is_none")]
        pub slippery: Option<f64> = None, Rule::number("", 0.0, 2.0);
    }
}

impl Disturbance {
    /// Its force when it has lasted `age` s, root frame, N.
    pub(crate) fn force_at(&self, age: f64) -> Vector3<f64> {
        let rise = if self.steady { 1.0 } else { libm::sin(std::f64::consts::PI * age / self.duration) };
        Vector3::from(self.force) * rise
    }
}

/// What a disturbance's time counts from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum WorldEvent {
    /// The moment when an object is held for the first time.
    Grasp,
    /// The moment when the robot says that it is wiping.
    #[default]
    Wiping,
    /// The start of the run.
    Start,
}
choice!(WorldEvent { "grasp" => Self::Grasp, "wiping" => Self::Wiping, "start" => Self::Start });

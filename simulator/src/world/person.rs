//! What a world file says of people: how tall they are, how firm their hands are, and what they do.
//!
//! A person keeps to this schedule. What the robot does changes nothing in it.

use armarium_source::yaml::Node;
use armarium_source::{Findings, Rule, choice, code, form};
use serde::Serialize;

use super::{COLOR, CoachSpec, within};

/// Most things that one person does.
const MAX_ACTIONS: usize = 1000;
/// Most places of the way along which a hand is led.
const MAX_PLACES: usize = 100;

form! {
    /// Somebody who acts in the scene: either `coach` or `person`.
    pub struct ActorSpec: "an actor", check Self::is_one {
        /// The person who demonstrates and coaches; the same as the world's `coach`.
        #[serde(skip_serializing_if = "Option::is_none")]
        pub coach: Option<CoachSpec> = None;
        /// A person who keeps to a schedule.
        #[serde(skip_serializing_if = "Option::is_none")]
        pub person: Option<PersonSpec> = None;
    }
}

form! {
    /// A person with two arms.
    pub struct PersonSpec: "a person" {
        /// The person's name.
        pub name: String = "person".into(), Rule::NAME;
        /// Where the person stands at first, m.
        pub at: [f64; 2] = [0.0, 1.6], within(5.0);
        /// Which way the person looks: 0 along y, turned about the vertical, degrees.
        pub yaw_deg: f64 = 180.0, Rule::degrees(361.0, "yaw");
        /// Height, m.
        pub height: f64 = 1.75, Rule::number("m", 1.0, 2.2);
        /// Mass that moves with a hand, kg.
        pub hand_mass: f64 = 2.0, Rule::number("kg", 0.5, 5.0);
        /// Stiffness with which an arm holds its hand where it wants it, N/m.
        pub stiffness: f64 = 400.0, Rule::number("N/m", 50.0, 2000.0);
        /// Damping of the hand, N s/m.
        pub damping: f64 = 25.0, Rule::number("", 1.0, 200.0);
        /// Largest force with which an arm pulls its hand to where it wants it, N.
        pub strength: f64 = 100.0, Rule::number("N", 1.0, 1000.0);
        /// Stiffness with which a wrist turns what its hand leads, N m/rad.
        pub wrist: f64 = 10.0, Rule::number("", 0.1, 100.0);
        /// Standard deviation of the tremor of what a hand wants, m.
        pub tremor: f64 = 0.001, Rule::number("m", 0.0, 0.05);
        /// Colour of the clothes above the waist, RGB.
        pub color: [u8; 3] = [70, 90, 140], COLOR;
        /// How far the sleeves reach: to the wrists, or over the shoulders.
        pub sleeves: Sleeves = Sleeves::Long;
        /// What the person does, one after the other.
        pub does: Vec<PersonAction> = Vec::new(), Rule::most(MAX_ACTIONS);
        /// Whether it all begins again at the end.
        pub repeats: bool = false;
    }
}

form! {
    /// One thing that a person does: `walk`, `reach`, `wave` or `lead`; without these, the person waits.
    pub struct PersonAction: "an action of a person", check Self::is_one {
        /// Where the person walks to, m.
        #[serde(skip_serializing_if = "Option::is_none")]
        pub walk: Option<[f64; 2]> = None, within(5.0);
        /// Whether the person walks without turning: steps back or aside.
        pub keeps_facing: bool = false;
        /// What the hand reaches for, m; as far as the arm goes.
        #[serde(skip_serializing_if = "Option::is_none")]
        pub reach: Option<[f64; 3]> = None, within(5.0);
        /// Whether the hand waves beside the head.
        pub wave: bool = false;
        /// The way along which the hand leads that hand of the first robot that is nearest, m from where it takes it.
        pub lead: Vec<[f64; 3]> = Vec::new(), Rule { most: MAX_PLACES, ..within(5.0) };
        /// How far it turns the led hand on the way, about x, y and z, degrees.
        pub turn_deg: [f64; 3] = [0.0; 3], Rule::degrees(180.0, "turn");
        /// How often it leads along the way.
        pub times: u32 = 1, Rule::number("", 1.0, 1000.0);
        /// Whether the other hand does the same with another hand of the robot.
        pub both: bool = false;
        /// Which hand.
        pub hand: Side = Side::Right;
        /// How fast the person walks or the hand moves, m/s.
        pub speed: f64 = 0.6, Rule::number("m/s", 0.05, 3.0);
        /// How long the hand stays, waves or holds the led hand at the end, or the person waits, s.
        pub duration as "for": f64 = 2.0, Rule::number("s", 0.0, 3600.0);
    }
}

/// How far sleeves reach.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Sleeves {
    /// To the wrists.
    #[default]
    Long,
    /// Over the shoulders; the forearms are bare.
    Short,
}
choice!(Sleeves { "long" => Self::Long, "short" => Self::Short });

/// One of two hands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Side {
    /// The right one.
    #[default]
    Right,
    /// The left one.
    Left,
}
choice!(Side { "right" => Self::Right, "left" => Self::Left });

impl Side {
    /// Its index: 0 right, 1 left.
    pub fn index(self) -> usize {
        match self {
            Self::Right => 0,
            Self::Left => 1,
        }
    }

    fn other(self) -> Self {
        match self {
            Self::Right => Self::Left,
            Self::Left => Self::Right,
        }
    }
}

impl ActorSpec {
    fn is_one(&self, node: &Node, findings: &mut Findings) {
        if self.coach.is_some() == self.person.is_some() {
            let help = Some("`- person: {at: [0, 1.6]}`".into());
            findings.error_help(code::VALUE, node.span, "an actor is either a `coach` or a `person`", help);
        }
    }
}

impl PersonAction {
    fn is_one(&self, node: &Node, findings: &mut Findings) {
        let kinds = [self.walk.is_some(), self.reach.is_some(), self.wave, !self.lead.is_empty()];
        if kinds.into_iter().filter(|kind| *kind).count() > 1 {
            let message = "a person does one thing at a time: `walk`, `reach`, `wave` or `lead`";
            findings.error_help(code::VALUE, node.span, message, Some("write one entry for each".into()));
        }
        if self.keeps_facing && self.walk.is_none() {
            let message = "`keeps_facing` is for a person who walks";
            findings.error_help(
                code::VALUE,
                node.place("keeps_facing"),
                message,
                Some("leave it out".into()),
            );
        }
        let turns = self.turn_deg != [0.0; 3];
        if turns && (self.lead.is_empty() || self.times > 1) {
            let message = "what is led once is turned on the way, and nothing else";
            findings.error_help(code::VALUE, node.place("turn_deg"), message, Some("leave it out".into()));
        }
    }
}

impl PersonSpec {
    /// Mirrors the person and what they do across the plane x = 0.
    pub(super) fn mirror(&mut self) {
        let flip = |x: &mut f64| *x = if *x == 0.0 { 0.0 } else { -*x };
        flip(&mut self.at[0]);
        flip(&mut self.yaw_deg);
        for action in &mut self.does {
            action.walk.iter_mut().for_each(|to| flip(&mut to[0]));
            action.reach.iter_mut().chain(&mut action.lead).for_each(|to| flip(&mut to[0]));
            action.turn_deg[1..].iter_mut().for_each(flip);
            action.hand = action.hand.other();
        }
    }
}

//! Observers: tasks that publish sensor data on channels, which charts watch and skills read; what publishes what charts observe of
//! memory; one that tells the robot what memory knows of its surroundings, and one that tells memory where the things are that the robot
//! carries.
//!
//! [`channels`] describes them, with fields, units and rates; `armarium channels` prints it.

mod arrival;
mod carried;
mod hand;
mod memory;
mod person;
mod seen;
mod surroundings;
mod wrist;

use armarium_knowledge::core_segments;
use armarium_memoryx::{Attribute, SegmentSchema};
use armarium_runtime::channels::Channels;
use armarium_runtime::chart::{ChannelDescription, ChannelSchema, MemorySegment};
use armarium_runtime::skill::Parameter;
use armarium_values::{Type, Unit};
use tokio::task::JoinHandle;

use crate::equipment::Equipment;

pub use memory::memory;

/// The channels that the observers and skills of this room publish, and the core segments of memory that charts can observe.
pub fn channels() -> ChannelSchema {
    let schema: ChannelSchema = [hand(), motion(), person(), wrist()].into_iter().collect();
    core_segments().into_iter().fold(schema, |schema, segment| schema.with_segment(described(segment)))
}

fn described(segment: SegmentSchema) -> MemorySegment {
    let attribute = |of: Attribute| Parameter::new(&of.name, of.ty, &of.description);
    // What is copied of another agent's memory says so.
    let origin = Type::record([("agent", Type::String), ("provider", Type::String)]);
    let origin =
        Parameter::new("origin", origin, "of which agent it is, where another agent's memory is followed");
    let attributes = segment.attributes.into_iter().map(attribute).chain([origin]).collect();
    MemorySegment { name: segment.segment, description: segment.description, attributes }
}

fn hand() -> ChannelDescription {
    let gesture = Type::one_of(["none", "fist", "open_hand", "point_one", "point_two"]);
    let channel = ChannelDescription::new("hand", "The coach's hand as the cameras see it.");
    let fields = [
        ("gesture", gesture, "the gesture that is recognised"),
        ("confidence", Type::FLOAT, "0 to 1"),
        ("position", Type::Vector, "of the palm, m"),
        ("direction", Type::Vector, "where it points, unit length"),
        (
            "distance",
            Type::quantity(Unit::M),
            "to the TCP of the arm that executes the motion, or that works",
        ),
        ("hidden", Type::FLOAT, "the share of its outline that is hidden, 0 to 1"),
        (
            "shown",
            Type::map(Type::Any),
            "what it showed clearly: `gesture`, for how long (`for`, s), `position` and `direction` then; and where it was `seen_at` last",
        ),
        ("came_at", Type::quantity(Unit::RAD), "phase of the running motion at which it came to rest"),
    ];
    ChannelDescription {
        rate: "each frame, while a chart or skill reads it".into(),
        publishers: vec!["observer of `hand`".into()],
        ..channel.with_fields(documented(fields))
    }
}

fn motion() -> ChannelDescription {
    let vector = |unit| Type::list(Type::quantity(unit));
    let channel = ChannelDescription::new("motion", "The motion that a skill executes.");
    let fields = [
        ("arm", Type::String, "the arm that executes it"),
        ("phase", Type::quantity(Unit::RAD), "of the motion"),
        ("frequency", Type::quantity(Unit::HZ), "at present"),
        ("position", vector(Unit::M), "of the TCP, three numbers in the root frame"),
        ("velocity", vector(Unit::M_S), "of the TCP, three numbers in the root frame"),
        ("normal_force", Type::quantity(Unit::N), "along the surface's normal"),
        ("normal", Type::list(Type::FLOAT), "of the surface, outward, three numbers in the root frame"),
    ];
    ChannelDescription {
        rate: "each control step of a running motion".into(),
        readers: vec!["observer of `hand`".into()],
        ..channel.with_fields(documented(fields))
    }
}

fn person() -> ChannelDescription {
    let channel = ChannelDescription::new("person", "The person before the robot as the cameras see them.");
    let fields = [
        ("seen", Type::Bool, "whether somebody is seen"),
        ("confidence", Type::FLOAT, "0 to 1"),
        ("position", Type::Vector, "of the middle of the shoulders, m"),
        (
            "keypoints",
            Type::map(Type::Vector),
            "of head, shoulders, elbows and wrists by name, such as `right_wrist`, m",
        ),
        (
            "covariances",
            Type::map(Type::list(Type::FLOAT)),
            "nine numbers for each of these: its covariance, m², row by row",
        ),
    ];
    ChannelDescription {
        rate: "each frame, while a chart or skill reads it".into(),
        publishers: vec!["observer of `person`".into()],
        ..channel.with_fields(documented(fields))
    }
}

fn wrist() -> ChannelDescription {
    let vector = || Type::list(Type::quantity(Unit::N));
    let felt = "What the wrist's force sensor of the arm that executes the motion, or else of the arm that works, feels, compensated for the weight of hand and load.";
    let channel = ChannelDescription::new("wrist", felt);
    let fields = [
        ("force", vector(), "three numbers in the root frame"),
        ("push", vector(), "the part that the task does not explain"),
        ("normal", Type::quantity(Unit::N), "along the surface's normal"),
        ("friction", Type::FLOAT, "coefficient of friction of the contact"),
    ];
    ChannelDescription {
        rate: "200 Hz".into(),
        publishers: vec!["observer of `wrist`".into()],
        ..channel.with_fields(documented(fields))
    }
}

fn documented<const N: usize>(fields: [(&str, Type, &str); N]) -> Vec<Parameter> {
    fields.map(|(name, ty, meaning)| Parameter::new(name, ty, meaning)).into()
}

/// Starts the observers. They end when their handles are aborted or their source closes.
pub fn start(equipment: &Equipment, channels: &Channels) -> Vec<JoinHandle<()>> {
    vec![
        tokio::spawn(wrist::observe(equipment.clone(), channels.clone())),
        tokio::spawn(hand::observe(equipment.clone(), channels.clone())),
        tokio::spawn(person::observe(equipment.clone(), channels.clone())),
        tokio::spawn(surroundings::observe(equipment.clone())),
        tokio::spawn(carried::observe(equipment.clone())),
    ]
}

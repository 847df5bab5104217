//! Observers: tasks that publish sensor data on channels, which charts watch and skills read.
//!
//! | channel | fields | rate |
//! |---|---|---|
//! | `wrist` | `force`, `push`: lists of three (N, root frame); `normal`: N; `friction`: coefficient | 200 Hz |
//! | `hand` | `gesture`, `confidence`, `position` (m), `direction`, `distance` (m, to the TCP), `hidden` (share of the outline) | each frame, while the channel has a reader |
//! | `motion` | `phase` (rad), `frequency` (Hz), `position` (m), `velocity` (m/s), `normal_force` (N) | each control step of a running motion |

mod arrival;
mod hand;
mod wrist;

use std::collections::BTreeMap;

use armarium_runtime::channels::Channels;
use armarium_values::Type;
use tokio::task::JoinHandle;

use crate::equipment::Equipment;

/// The channels that the observers and skills of this room publish, with their fields.
#[must_use]
pub fn channels() -> BTreeMap<String, Type> {
    let vector = || Type::list(Type::FLOAT);
    let gesture = Type::one_of(["none", "fist", "open_hand", "point_one", "point_two"]);
    BTreeMap::from([
        (
            "wrist".to_owned(),
            Type::record([
                ("force", vector()),
                ("push", vector()),
                ("normal", Type::FLOAT),
                ("friction", Type::FLOAT),
            ]),
        ),
        (
            "hand".to_owned(),
            Type::record([
                ("gesture", gesture),
                ("confidence", Type::FLOAT),
                ("position", Type::Vector),
                ("direction", Type::Vector),
                ("distance", Type::FLOAT),
                ("hidden", Type::FLOAT),
            ]),
        ),
        (
            "motion".to_owned(),
            Type::record([
                ("phase", Type::FLOAT),
                ("frequency", Type::FLOAT),
                ("position", vector()),
                ("velocity", vector()),
                ("normal_force", Type::FLOAT),
            ]),
        ),
    ])
}

/// Starts the observers. They end when their handles are aborted or their source closes.
pub fn start(equipment: &Equipment, channels: &Channels) -> Vec<JoinHandle<()>> {
    vec![
        tokio::spawn(wrist::observe(equipment.clone(), channels.clone())),
        tokio::spawn(hand::observe(equipment.clone(), channels.clone())),
    ]
}

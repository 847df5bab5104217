//! Checks the actual dependencies between the rooms, and on external crates, against tables of what is allowed.
//!
//! A new dependency between rooms is a decision: it changes a table here, and the page that explains it
//! (`ARCHITECTURE.md`).

use std::collections::BTreeSet;

use armarium_tests::repository::{self, Room};

/// Each room, and what it may use; `ALL` is every room further up. The rooms stand in order: an arrow goes only to a room
/// further up.
const ALLOWED: [(&str, &[&str]); 17] = [
    ("values", &[]),
    ("source", &["values"]),
    ("bus", &["values"]),
    ("motion", &[]),
    ("runtime", &["values", "source", "bus"]),
    ("robot", &["values", "source", "bus"]),
    ("memoryx", &["values", "bus"]),
    ("knowledge", &["values", "source", "bus", "memoryx"]),
    ("visionx", &["values", "source", "bus"]),
    ("states", &["values", "runtime", "robot", "motion", "memoryx", "knowledge", "visionx"]),
    ("simulator", &["values", "source", "robot", "visionx"]),
    ("viewer", &["values", "runtime", "robot", "visionx"]),
    ("host", ALL),
    ("experiments", &["values", "motion", "robot", "visionx", "simulator", "states", "viewer", "host"]),
    ("editor", &["values", "source", "runtime", "robot", "knowledge", "simulator"]),
    ("cli", ALL),
    ("tests", ALL),
];

/// Every room above in the table.
const ALL: &[&str] = &["*"];

/// Further rooms that a room's own tests may use.
const ALLOWED_IN_TESTS: [(&str, &[&str]); 2] = [
    // Skills are tested on the simulated robot: the tests see the truth, the skill does not.
    ("states", &["simulator"]),
    ("viewer", &["simulator"]),
];

/// Crates from outside that only some rooms may use, each with the reason.
const CONFINED: [(&str, &[&str], &str); 15] = [
    ("zenoh", &["bus"], "the network is known to one room; the others see traits"),
    (
        "parry3d-f64",
        &["robot"],
        "its vectors differ from ours: distances of bodies are asked for in one place",
    ),
    ("rapier3d-f64", &["simulator"], "its vectors differ from ours: they are converted in one place"),
    ("redb", &["memoryx"], "the long-term store is the memory's own affair"),
    ("cel", &["values"], "a young interface: it stays behind one module"),
    ("foxglove", &["viewer"], "recordings are written in one place"),
    ("tiny-skia", &["viewer"], "charts are drawn in one place"),
    ("ttf-parser", &["viewer"], "charts are drawn in one place"),
    ("lsp-server", &["editor"], "editors are served in one place"),
    ("lsp-types", &["editor"], "editors are served in one place"),
    ("clap", &["cli"], "only the program has a command line"),
    ("annotate-snippets", &["cli"], "findings are data; only the program renders them"),
    ("tracing-subscriber", &["cli"], "rooms emit log events; the program decides where they go"),
    ("granit-parser", &["source"], "files that people write are read in one way"),
    ("strsim", &["values"], "what might be meant is guessed in one way"),
];

/// Rooms without tasks and clocks: they may not use tokio.
const PURE: [&str; 2] = ["values", "motion"];

fn allowed(room: &str) -> Vec<&'static str> {
    let Some(place) = ALLOWED.iter().position(|(name, _)| *name == room) else { return Vec::new() };
    match ALLOWED[place].1 {
        uses if uses == ALL => ALLOWED[..place].iter().map(|(name, _)| *name).collect(),
        uses => uses.to_vec(),
    }
}

fn allowed_in_tests(room: &str) -> BTreeSet<&'static str> {
    let more = ALLOWED_IN_TESTS.iter().find(|(name, _)| *name == room).map_or(&[][..], |(_, uses)| uses);
    allowed(room).into_iter().chain(more.iter().copied()).collect()
}

fn wrong_arrows(rooms: &[Room]) -> Vec<String> {
    let mut wrong = Vec::new();
    for room in rooms {
        for used in room.uses.iter().filter_map(|name| name.strip_prefix("armarium-")) {
            if !allowed(&room.name).contains(&used) {
                wrong.push(format!("{} may not use {used}", room.name));
            }
        }
        for used in room.tests_use.iter().filter_map(|name| name.strip_prefix("armarium-")) {
            if used != room.name && !allowed_in_tests(&room.name).contains(used) {
                wrong.push(format!("the tests of {} may not use {used}", room.name));
            }
        }
    }
    wrong
}

fn wrong_crates(rooms: &[Room]) -> Vec<String> {
    let confined = rooms.iter().flat_map(|room| {
        CONFINED
            .iter()
            .filter(|(name, may, _)| room.uses.contains(*name) && !may.contains(&room.name.as_str()))
            .map(|(name, _, why)| format!("{} may not use {name}: {why}", room.name))
    });
    let pure = rooms
        .iter()
        .filter(|room| PURE.contains(&room.name.as_str()) && room.uses.contains("tokio"))
        .map(|room| format!("{} may not use tokio: it knows no task and no clock", room.name));
    confined.chain(pure).collect()
}

#[test]
fn every_room_stands_in_the_table_and_arrows_go_only_upwards() {
    let rooms: BTreeSet<String> = repository::rooms().into_iter().map(|room| room.name).collect();
    let table: BTreeSet<String> = ALLOWED.iter().map(|(name, _)| (*name).to_owned()).collect();
    assert_eq!(rooms, table);
    for (i, (room, _)) in ALLOWED.iter().enumerate() {
        let above: Vec<&str> = ALLOWED[..i].iter().map(|(name, _)| *name).collect();
        assert!(allowed(room).iter().all(|used| above.contains(used)), "an arrow of {room} goes back");
    }
}

#[test]
fn rooms_use_only_what_they_may() {
    assert_eq!(wrong_arrows(&repository::rooms()), Vec::<String>::new());
}

#[test]
fn crates_from_outside_stay_where_they_belong() {
    assert_eq!(wrong_crates(&repository::rooms()), Vec::<String>::new());
}

#[test]
fn a_wrong_arrow_is_found() {
    let room = |name: &str, uses: &[&str], tests_use: &[&str]| Room {
        name: name.to_owned(),
        uses: uses.iter().map(|u| (*u).to_owned()).collect(),
        tests_use: tests_use.iter().map(|u| (*u).to_owned()).collect(),
        ..Room::default()
    };
    let rooms = [
        room("motion", &["armarium-robot", "tokio"], &[]),
        room("states", &["armarium-simulator", "zenoh"], &["armarium-simulator"]),
        room("robot", &[], &["armarium-simulator"]),
    ];
    assert_eq!(
        wrong_arrows(&rooms),
        [
            "motion may not use robot",
            "states may not use simulator",
            "the tests of robot may not use simulator"
        ]
    );
    assert_eq!(wrong_crates(&rooms).len(), 2);
}

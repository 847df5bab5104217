//! What world files may say, and what is refused where.

use std::path::Path;

use armarium_source::{Finding, code};

use super::{CoachingAction, World};

fn parse(file: &Path, text: &str) -> Result<World, Vec<Finding>> {
    World::parse(file, text)
}

fn findings(text: &str) -> Vec<(usize, usize, &'static str)> {
    match parse(Path::new("world.yaml"), text) {
        Ok(_) => Vec::new(),
        Err(found) => found.iter().map(|f| (f.position().0, f.position().1, f.code)).collect(),
    }
}

#[test]
fn an_empty_file_and_one_of_comments_are_mistakes() {
    for text in [" \n", "# nothing\n", "---\n"] {
        let found = parse(Path::new("w"), text).unwrap_err();
        assert!(found[0].message.contains("the file is empty"), "{text:?}: {}", found[0].message);
    }
    let chart = parse(Path::new("w"), "statechart: T\ninitial: A\nstates: {A: {}}\n").unwrap_err();
    assert_eq!((chart.len(), chart[0].message.as_str()), (1, "this is a chart, where a world is needed"));
}

#[test]
fn the_default_world_reads_back_from_its_own_text() {
    let text = serde_json::to_string(&World::default()).unwrap();
    assert_eq!(parse(Path::new("w"), &text).unwrap(), World::default());
}

#[test]
fn values_units_and_forms_are_read() {
    let text = "
world: lab
table: {height: 0.0009 km, tilt: [1 deg, 0.0], bumps: []}
objects: [{name: sponge, yaw: 30 deg, mass: 200 g}]
coach:
  demonstration: none
  coaching: [{at: 3 s, push: {force: [0, 5 N, 0]}}]
";
    let world = parse(Path::new("w"), text).unwrap();
    assert_eq!(world.name, "lab");
    assert!((world.table.height - 0.9).abs() < 1e-12);
    assert!((world.table.tilt_deg[0] - 1.0).abs() < 1e-12);
    assert!((world.objects[0].yaw_deg - 30.0).abs() < 1e-12);
    assert!((world.objects[0].mass - 0.2).abs() < 1e-12);
    assert_eq!(world.coach.demonstration, None);
    let CoachingAction::Push { push } = &world.coach.coaching[0].action else { panic!() };
    assert_eq!(push.force, [0.0, 5.0, 0.0]);
}

#[test]
fn all_findings_come_at_once_with_their_places() {
    let text = "table:\n  hight: 1.0\n  friction: 9\n  size: [1 kg, 1]\ncamera: 3\n";
    assert_eq!(
        findings(text),
        vec![(2, 3, code::KEY), (3, 13, code::VALUE), (4, 10, code::UNIT), (5, 9, code::FORM),]
    );
    let error = &parse(Path::new("w.yaml"), text).unwrap_err()[0];
    assert_eq!(error.help.as_deref(), Some("did you mean `height`?"));
    assert_eq!(&text[error.span.start..error.span.end], "hight");
}

#[test]
fn impossible_worlds_are_refused() {
    assert_eq!(findings("objects: [{at: [2, 2]}]"), vec![(1, 16, code::VALUE)]);
    assert_eq!(findings("coach: {coaching: [{at: 1, gesture: point_one, offset: [0, 0, 0.1]}]}").len(), 1);
    assert_eq!(findings("disturbances: [{knock: spunge}]").len(), 1);
    assert_eq!(findings("disturbances: [{knock: hand, slippery: 0.1}]").len(), 1);
    assert!(findings("disturbances: [{knock: sponge, slippery: 0.1}]").is_empty());
    assert_eq!(findings("objects: [{mass: 2, stiffness: 800, size: [0.1, 0.1, 0.02]}]").len(), 1);
    assert_eq!(findings("objects: [{name: a}, {name: a}]").len(), 1);
    assert_eq!(findings("table: {height: .nan}").len(), 1);
    assert_eq!(findings("a: [").len(), 1);
    assert_eq!(findings("table: {height: 1.0, height: 2.0}").len(), 1);
}

#[test]
fn other_agents_and_covers_are_read_and_read_back() {
    let text = "
robot: {name: bob}
agents: [{name: alice, at: [0.3, 1.4, 1500 mm], looks_at: [0.3, 0.5, 1], rate: 4 Hz, runs: watch.yaml}]
covers: [{at: [0, 0.3, 1.4], size: [0.3, 0.01, 0.2], yaw: 10 deg}]
";
    let world = parse(Path::new("w"), text).unwrap();
    assert_eq!((world.robot.name.as_str(), world.agents[0].name.as_str()), ("bob", "alice"));
    assert_eq!((world.agents[0].at[2], world.agents[0].rate), (1.5, 4.0));
    assert_eq!(world.agents[0].runs.as_deref(), Some("watch.yaml"));
    assert!((world.covers[0].yaw_deg - 10.0).abs() < 1e-9);
    let again = serde_json::to_string(&world).unwrap();
    assert_eq!(parse(Path::new("w"), &again).unwrap(), world);
    for wrong in [
        "agents: [{at: [0, 1, 1]}]",
        "agents: [{name: a/b}]",
        "agents: [{name: a}, {name: a}]",
        "agents: [{name: local}]",
        "robot: {name: a b}",
        "agents: [{name: a, at: [0, 1, 1], looks_at: [0, 1, 1]}]",
        "covers: [{size: [0, 1, 1]}]",
    ] {
        assert_eq!(findings(wrong).len(), 1, "{wrong}");
    }
}

#[test]
fn the_schema_names_every_section_and_both_forms_of_angles() {
    let schema = World::schema();
    let keys = ["world", "robot", "camera", "table", "objects", "coach", "faults", "disturbances"];
    for key in keys.into_iter().chain(["agents", "covers"]) {
        assert!(schema["properties"].get(key).is_some(), "{key}");
    }
    for pointer in [
        "/properties/table/properties/tilt",
        "/properties/objects/items/properties/yaw_deg",
        "/properties/covers/items/properties/yaw",
    ] {
        assert!(schema.pointer(pointer).is_some(), "{pointer}");
    }
    assert_eq!(schema["additionalProperties"], false);
    assert_eq!(schema["properties"]["world"]["default"], "kitchen");
}

#[test]
fn the_world_of_the_other_arm_is_the_mirror_of_this_one() {
    let world = World::default();
    let model = world.model().unwrap();
    let arm = |side: f64| model.arms().find(|arm| model.side_of(arm) == side).unwrap().name.clone();
    let left = world.clone().for_arm(&model, &arm(-1.0));
    assert_eq!((left.name.as_str(), left.table.center), ("kitchen_mirrored", [-0.25, 0.60]));
    assert_eq!((left.table.tilt_deg, left.table.bumps[0].at), ([1.0, 1.5], [-0.28, 0.55]));
    assert_eq!((left.objects[0].at, left.objects[0].yaw_deg), ([-0.35, 0.50], -20.0));
    let (shown, usual) =
        (left.coach.demonstration.as_ref().unwrap(), world.coach.demonstration.as_ref().unwrap());
    let [path, before] = [shown, usual].map(crate::coach::CoachPath::new);
    for k in 0..20 {
        let [[x, y], [was_x, was_y]] = [&path, &before].map(|path| path.point(f64::from(k)));
        assert!(
            (x + was_x).abs() < 1e-12 && (y - was_y).abs() < 1e-12,
            "the same phase at the mirrored place"
        );
    }
    // It can be written as a world file, and mirrored back.
    let text = serde_json::to_string(&left).unwrap();
    assert_eq!(parse(Path::new("w"), &text).unwrap(), left);
    let mut again = left.for_arm(&model, &arm(1.0));
    again.robot.arm = None;
    assert_eq!(again, world);
    let same = world.clone().for_arm(&model, &arm(1.0));
    assert_eq!(same.table, world.table);
}

proptest::proptest! {
    #[test]
    fn no_text_panics(text in "\\PC{0,80}") {
        let _ = parse(Path::new("w"), &text);
    }

    #[test]
    fn no_value_panics(key in "[a-z_]{1,12}", value in "[-a-z0-9.,\\[\\]{}: ]{0,24}") {
        let _ = parse(Path::new("w"), &format!("table: {{{key}: {value}}}\nobjects: [{{{key}: {value}}}]"));
    }
}

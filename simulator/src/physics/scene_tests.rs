//! Tests of bodies and of several robots: what a world file can say besides the sponge on the table.

use std::path::Path;

use nalgebra::Vector3;

use super::{DT, External, Plant};
use crate::start;
use crate::world::{GRAVITY, World};

/// A plant of a world file whose robots stand still.
struct Room {
    plant: Plant,
    standing: Vec<(Vec<f64>, Vec<f64>)>,
    names: Vec<String>,
    external: External,
}

impl Room {
    fn new(world: &str) -> Self {
        let world = World::parse(Path::new("world.yaml"), world).unwrap();
        let robots = start::robots(&world, 1, None).unwrap();
        let standing = robots.iter().map(|r| (r.position.clone(), vec![0.0; r.position.len()])).collect();
        let plant = Plant::new(&world, robots).unwrap();
        let names: Vec<String> =
            start::bodies(&world, plant.table()).into_iter().map(|body| body.spec.name).collect();
        let external = External { objects: vec![Vector3::zeros(); names.len()], ..External::default() };
        Self { plant, standing, names, external }
    }

    fn go(&mut self, seconds: f64) {
        let targets: Vec<_> = self.standing.iter().map(|(q, v)| (&q[..], &v[..])).collect();
        for _ in 0..(seconds / DT) as usize {
            self.plant.step(&targets, &self.external);
        }
    }

    fn index(&self, name: &str) -> usize {
        self.names.iter().position(|other| other == name).unwrap()
    }

    fn at(&self, name: &str) -> Vector3<f64> {
        self.plant.object(self.index(name)).unwrap().translation.vector
    }
}

const LEVEL: &str = "physics: ideal\ntable: {tilt_deg: [0, 0], bumps: [], friction: 0.4}\nobjects: []\n";

#[test]
fn a_body_has_its_mass_from_the_start() {
    let body = "bodies: [{name: crate, size: [0.1, 0.1, 0.1], mass: 1.3 kg, at: [0.2, 0.6]}]";
    let room = Room::new(&format!("{LEVEL}{body}"));
    assert!((room.plant.mass(0).unwrap() - 1.3).abs() < 1e-9, "pads are damped by it");
}

#[test]
fn a_rigid_box_lies_still_and_slides_by_coulombs_law_when_it_is_pushed() {
    let body = "bodies: [{name: crate, size: [0.1, 0.1, 0.1], mass: 1 kg, friction: 0.4, at: [0.2, 0.6]}]";
    let mut room = Room::new(&format!("{LEVEL}{body}"));
    let begin = room.at("crate");
    assert!((begin.z - 1.0).abs() < 1e-9);
    room.go(0.5);
    assert!((room.at("crate") - begin).norm() < 1e-3, "{}", room.at("crate"));
    assert!((room.plant.contact(0).normal - GRAVITY).abs() < 0.1, "{:?}", room.plant.contact(0));
    // Half of what friction holds moves nothing; twice of it accelerates by the difference.
    let friction = 0.4 * GRAVITY;
    room.external.objects[0] = Vector3::x() * (0.5 * friction);
    let before = room.at("crate");
    room.go(0.3);
    assert!((room.at("crate") - before).norm() < 1e-3);
    room.external.objects[0] = Vector3::x() * (2.0 * friction);
    let before = room.at("crate");
    room.go(0.2);
    let way = (room.at("crate") - before).x;
    let expected = 0.5 * friction * 0.2 * 0.2;
    assert!((way / expected - 1.0).abs() < 0.1, "{way} {expected}");
}

#[test]
fn a_door_turns_about_its_hinge_and_a_drawer_slides_within_its_limits() {
    let mut room = Room::new(&format!(
        "{LEVEL}bodies:
  - {{name: door, size: [0.4, 0.02, 0.5], mass: 2 kg, at: [-0.6, 0.6, 1.2],
     hinge: {{axis: [0, 0, 1], through: [-0.2, 0, 0], limits_deg: [0, 90], damping: 0.5}}}}
  - {{name: drawer, size: [0.3, 0.3, 0.1], at: [1.5, 0.6, 0.8], slide: {{axis: [0, 1, 0], limits: [-0.2, 0]}}}}"
    ));
    let (door, drawer) = (room.at("door"), room.at("drawer"));
    room.go(0.5);
    assert!((room.at("door") - door).norm() < 2e-3 && (room.at("drawer") - drawer).norm() < 2e-3);
    let (i, j) = (room.index("door"), room.index("drawer"));
    room.external.objects[i] = Vector3::y() * 5.0;
    room.external.objects[j] = Vector3::y() * -20.0;
    room.go(2.0);
    let turned = room.plant.object(i).unwrap().rotation.euler_angles().2.to_degrees();
    assert!((turned - 90.0).abs() < 3.0, "{turned}");
    let hinge = room.plant.object(i).unwrap() * nalgebra::Point3::new(-0.2, 0.0, 0.0);
    assert!((hinge.coords - (door - Vector3::x() * 0.2)).norm() < 5e-3, "{hinge}");
    let way = room.at("drawer") - drawer;
    assert!((way + Vector3::y() * 0.2).norm() < 5e-3, "{way}");
}

#[test]
fn balls_stay_in_a_cup_that_stands_and_a_tray_carries_it() {
    let mut room = Room::new(&format!(
        "{LEVEL}bodies:
  - {{name: tray, shape: tray, size: [0.4, 0.3, 0.04], mass: 0.8 kg, at: [0.2, 0.6]}}
  - {{name: cup, shape: cup, diameter: 0.08, height: 0.1, mass: 0.2 kg, at: [0.2, 0.6, 1.006],
     contents: {{balls: 12, diameter: 16 mm, mass: 5 g}}}}"
    ));
    assert_eq!(room.names.len(), 14);
    room.go(1.0);
    let cup = room.at("cup");
    assert!((cup - Vector3::new(0.2, 0.6, 1.005)).norm() < 3e-3, "{cup}");
    for n in 1..=12 {
        let ball = room.at(&format!("cup_{n}"));
        assert!((ball - cup).xy().norm() < 0.04 && (ball - cup).z.abs() < 0.06, "{n}: {ball}");
    }
}

#[test]
fn a_fixed_body_stays_and_one_beside_the_table_lies_on_the_floor() {
    let mut room = Room::new(&format!(
        "{LEVEL}bodies:
  - {{name: shelf, motion: static, at: [0.2, 0.6, 1.5]}}
  - {{name: ball, shape: sphere, diameter: 0.2, at: [2, 2]}}
  - {{name: bar, shape: bar, size: [0.8, 0.04, 0.04], mass: 2 kg, at: [-1.5, 1.0]}}"
    ));
    room.external.objects[0] = Vector3::repeat(100.0);
    room.go(0.3);
    assert_eq!(room.at("shelf"), Vector3::new(0.2, 0.6, 1.5));
    assert!((room.at("ball") - Vector3::new(2.0, 2.0, 0.1)).norm() < 2e-3, "{}", room.at("ball"));
    assert!((room.at("bar").z - 0.02).abs() < 2e-3, "{}", room.at("bar"));
}

#[test]
fn a_second_robot_stands_where_its_file_says_and_moves_by_itself() {
    let mut room = Room::new(&format!(
        "{LEVEL}robots: [{{name: helper, model: pillar7, at: [0.3, 1.6], yaw_deg: 180}}]"
    ));
    let [first, second] = [0, 1].map(|robot| room.plant.tcp(robot));
    let alone = Room::new(&format!("{LEVEL}robot: {{model: pillar7}}")).plant.tcp(0);
    let expected =
        nalgebra::Isometry3::new(Vector3::new(0.3, 1.6, 0.0), Vector3::z() * std::f64::consts::PI) * alone;
    assert!((second.translation.vector - expected.translation.vector).norm() < 1e-9, "{second}");
    room.go(0.1);
    assert_eq!(room.plant.awake(), 0);
    room.standing[1].0[0] += 0.3;
    room.go(1.0);
    assert!((room.plant.position(1)[0] - room.standing[1].0[0]).abs() < 1e-3);
    assert!((room.plant.tcp(0).translation.vector - first.translation.vector).norm() < 1e-9);
}

#[test]
fn a_persons_hand_gives_way_as_a_spring_and_nothing_else_of_them_does() {
    let mut room = Room::new(&format!(
        "{LEVEL}actors: [{{person: {{at: [-1, 1], yaw_deg: 0, stiffness: 300 N/m, tremor: 0}}}}]
bodies: [{{name: wall, size: [0.3, 0.3, 1.5], mass: 50 kg, friction: 1.0, at: [-0.75, 1.6]}}]"
    ));
    let spec = crate::world::PersonSpec { at: [-1.0, 1.0], yaw_deg: 0.0, ..Default::default() };
    let mut wanted = crate::person::Posture::standing(&spec);
    room.go(0.2);
    // The hand wants to be 10 cm inside of the wall.
    let wall = room.at("wall") - Vector3::y() * 0.15;
    let goal = nalgebra::Point3::new(wall.x, wall.y + 0.1 - crate::figure::HAND_RADIUS, 1.2);
    let from = wanted.hands[0];
    for i in 1..=1000 {
        wanted.hands[0] = from + (goal - from) * (f64::from(i) / 1000.0);
        room.plant.people_want(&[wanted]);
        room.go(DT);
    }
    for _ in 0..500 {
        room.plant.people_want(&[wanted]);
        room.go(DT);
    }
    let hand = room.plant.person(0)[8].translation.vector;
    assert!((hand.y + crate::figure::HAND_RADIUS - wall.y).abs() < 3e-3, "{hand} {wall}");
}

#[test]
fn a_person_who_holds_the_robots_hand_pulls_it_with_what_its_sensor_feels() {
    let mut room = Room::new(&format!(
        "{LEVEL}actors: [{{person: {{at: [0.4, 1.0], stiffness: 300 N/m, strength: 20 N, tremor: 0}}}}]"
    ));
    let spec = crate::world::PersonSpec { at: [0.4, 1.0], ..Default::default() };
    let mut wanted = crate::person::Posture::standing(&spec);
    let (arm, tcp) = room.plant.tcps(0).enumerate().next().unwrap();
    // The hand comes first, without touching, and takes it then.
    let lead = crate::person::Lead { arm, holds: false, turn: nalgebra::UnitQuaternion::identity() };
    let mut hold = |room: &mut Room, at: Vector3<f64>, holds: bool, seconds: f64| {
        (wanted.hands[0], wanted.leads[0]) = (at.into(), Some(crate::person::Lead { holds, ..lead }));
        for _ in 0..(seconds / DT) as usize {
            room.plant.people_want(&[wanted]);
            room.go(DT);
        }
        room.plant.wrench(0).force
    };
    let at = tcp.translation.vector;
    let free = hold(&mut room, at, false, 5.0);
    assert_eq!(room.plant.led().count(), 0);
    let near = hold(&mut room, at, true, 2.0);
    assert!((near - free).norm() < 0.2, "{near} {free}");
    for (off, expected) in [(0.04, 12.0), (0.3, 20.0)] {
        let felt = hold(&mut room, at + Vector3::x() * off, true, 1.5) - free;
        let led = room.plant.led().next().unwrap();
        // The grip and the arm give a little.
        assert!((led.force.norm() - expected).abs() < 0.15 * expected && led.force.x > 0.0, "{}", led.force);
        assert!((felt.norm() - led.force.norm()).abs() < 0.2, "{felt} {}", led.force);
    }
    let after = hold(&mut room, at, false, 1.0);
    assert!((after - free).norm() < 0.2, "{after} {free}");
}

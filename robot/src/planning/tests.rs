//! The planner where the answer is known: a ball that slides in a plane, walls with and without a gap; and arms over a table.

use std::sync::Arc;

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use super::{CLEARANCE, KnownBox, Nearness, PlanError, Planner};
use crate::bodies::KEPT;
use crate::{Kinematics, Model, description};

/// A ball that slides along x and y, from -1 to 1 m.
const RADIUS: f64 = 0.05;

fn slider() -> Arc<Model> {
    let joint = |name: &str, parent: &str, axis: &str| {
        format!(
            "<joint name='{name}' type='prismatic'><parent link='{parent}'/><child link='{name}'/><axis xyz='{axis}'/>\
             <limit lower='-1' upper='1' velocity='1' effort='1'/></joint>"
        )
    };
    let ball = format!("<collision><geometry><sphere radius='{RADIUS}'/></geometry></collision>");
    let urdf = format!(
        "<robot name='slider'><link name='floor'/><link name='x'/><link name='y'>{ball}</link>{}{}</robot>",
        joint("x", "floor", "1 0 0"),
        joint("y", "x", "0 1 0")
    );
    let file = "robot: slider\ndescription: slider.urdf\ngroups: {arm: {joints: [x, y], tcp: y}}\n";
    description::from_texts(file, &urdf).unwrap().model
}

/// A box that is 10 cm thick along x, about x 0, from one y to another.
fn wall(from: f64, to: f64) -> KnownBox {
    KnownBox {
        name: "wall".into(),
        root_from_box: Isometry3::translation(0.0, 0.5 * (from + to), 0.0),
        size: Vector3::new(0.1, to - from, 1.0),
    }
}

const LEFT: [f64; 2] = [-0.5, 0.0];
const RIGHT: [f64; 2] = [0.5, 0.0];

fn slide(boxes: &[KnownBox], to: [f64; 2], seed: u64) -> Result<Vec<Vec<f64>>, PlanError> {
    Planner::new(&slider(), boxes).plan(&[0, 1], &LEFT, &to, seed)
}

/// Points of a path, at most a millimetre apart for the slider.
fn along(path: &[Vec<f64>], steps: u32) -> impl Iterator<Item = Vec<f64>> {
    path.windows(2).flat_map(move |two| {
        (0..=steps).map(move |k| super::between(&two[0], &two[1], f64::from(k) / f64::from(steps)))
    })
}

/// The exact distance of the ball from a wall along x 0, m.
fn distance_from_wall(q: &[f64], (from, to): (f64, f64)) -> f64 {
    let x = (q[0].abs() - 0.05).max(0.0);
    let y = (from - q[1]).max(q[1] - to).max(0.0);
    libm::hypot(x, y) - RADIUS
}

#[test]
fn a_straight_way_that_is_free_is_the_path() {
    let beside = KnownBox { root_from_box: Isometry3::translation(0.0, 0.4, 0.0), ..wall(-0.2, 0.2) };
    let path = slide(&[beside], RIGHT, 1).unwrap();
    assert_eq!(path, [LEFT.to_vec(), RIGHT.to_vec()]);
}

#[test]
fn what_touches_already_and_comes_no_nearer_is_in_no_way() {
    // The ball stands a millimetre deep in it, and slides along it.
    let under = KnownBox {
        name: "under".into(),
        root_from_box: Isometry3::translation(0.0, -0.249, 0.0),
        size: Vector3::new(3.0, 0.4, 1.0),
    };
    let slide_to = |to| slide(std::slice::from_ref(&under), to, 1);
    assert_eq!(slide_to(RIGHT).unwrap(), [LEFT.to_vec(), RIGHT.to_vec()]);
    assert!(slide_to([0.5, 0.01]).is_ok());
    let Err(PlanError::GoalBlocked(near)) = slide_to([0.5, -0.002]) else { panic!("it goes deeper") };
    assert_eq!(near.second, "under");
}

#[test]
fn a_gap_in_a_wall_is_found_and_the_distance_is_kept() {
    let walls = [(-1.5, 0.5), (0.75, 1.5)];
    for seed in 0..20 {
        let path = slide(&walls.map(|(from, to)| wall(from, to)), RIGHT, seed).unwrap();
        assert_eq!((path[0].as_slice(), path[path.len() - 1].as_slice()), (&LEFT[..], &RIGHT[..]));
        for q in along(&path, 1000) {
            for wall in walls {
                let distance = distance_from_wall(&q, wall);
                assert!(distance > CLEARANCE - super::FINEST, "{seed}: {distance} at {q:?}");
            }
        }
        // Around the edge of the gap it is at least 1.30 m; a path of twice that would be no shortened one.
        let length: f64 =
            path.windows(2).map(|two| libm::hypot(two[1][0] - two[0][0], two[1][1] - two[0][1])).sum();
        assert!((1.3..2.6).contains(&length), "{seed}: {length}");
    }
}

#[test]
fn without_a_gap_or_with_one_too_narrow_there_is_no_way_and_it_is_said_what_is_in_it() {
    // The ball with 25 mm on both sides needs 15 cm.
    for walls in [vec![wall(-1.5, 1.5)], vec![wall(-1.5, 0.3), wall(0.44, 1.5)]] {
        let Err(PlanError::NoWay { checks, straight }) = slide(&walls, RIGHT, 1) else { panic!("a way") };
        assert!((40_000..50_000).contains(&checks), "{checks}");
        assert_eq!((straight.first.as_str(), straight.second.as_str()), ("y", "wall"));
    }
}

#[test]
fn a_goal_in_a_wall_beyond_a_limit_or_that_is_no_number_is_refused() {
    let at = |x: f64| slide(&[wall(-0.2, 0.2)], [x, 0.0], 1).unwrap_err();
    let PlanError::GoalBlocked(Nearness { first, second, distance_m }) = at(0.02) else { panic!() };
    assert_eq!((first.as_str(), second.as_str()), ("y", "wall"));
    assert!((distance_m + 0.08).abs() < 1e-6, "{distance_m}");
    assert_eq!(at(2.0), PlanError::BeyondLimit { joint: "x".into() });
    assert_eq!(at(f64::NAN), PlanError::NotFinite);
}

#[test]
fn a_start_or_a_goal_nearer_than_planned_ones_may_be_left_and_reached() {
    // 10 mm from the wall on either side, and over the wall's end from one to the other.
    let mut planner = Planner::new(&slider(), &[wall(-0.2, 0.2)]);
    let beside = 0.05 + RADIUS + 0.01;
    let path = planner.plan(&[0, 1], &[-beside, 0.0], &[beside, 0.0], 1).unwrap();
    let nearest = along(&path, 1000).map(|q| distance_from_wall(&q, (-0.2, 0.2))).fold(f64::MAX, f64::min);
    assert!(nearest > 0.004 && nearest < 0.0101, "{nearest}");
    assert_eq!(planner.check(&path), Ok(()));
    let through = [vec![-beside, 0.0], vec![beside, 0.0]];
    assert!(matches!(planner.check(&through), Err(PlanError::WayBlocked(_))));
}

#[test]
fn a_goal_before_which_the_guard_would_stop_is_refused() {
    let beside = |gap: f64| [-0.05 - RADIUS - gap, 0.0];
    let mut planner = Planner::new(&slider(), &[wall(-0.2, 0.2)]);
    assert!(planner.plan(&[0, 1], &LEFT, &beside(0.01), 1).is_ok(), "it may be touched");
    planner = planner.stopped_before(&["floor".to_owned(), "wall".to_owned()]);
    let refused = planner.plan(&[0, 1], &LEFT, &beside(0.01), 1);
    assert!(matches!(refused, Err(PlanError::GoalBlocked(_))), "{refused:?}");
    assert!(planner.plan(&[0, 1], &LEFT, &beside(0.023), 1).is_ok());
    // What is nearer at the start is left, and may go along the wall.
    assert!(planner.plan(&[0, 1], &beside(0.01), &LEFT, 1).is_ok());
    assert!(planner.plan(&[0, 1], &beside(0.01), &[beside(0.01)[0], 0.1], 1).is_ok());
}

#[test]
fn what_stops_a_hand_is_told_and_only_of_what_moves() {
    let beside = |gap: f64| [-0.05 - RADIUS - gap, 0.0];
    let mut planner = Planner::new(&slider(), &[wall(-0.2, 0.2)]);
    assert_eq!(planner.stopped_by(&[0, 1], &beside(0.02)), None, "it may be touched");
    planner = planner.stopped_before(&["wall".to_owned()]);
    let near = planner.stopped_by(&[0, 1], &beside(0.02)).unwrap();
    assert!(
        [&near.first, &near.second].contains(&&"wall".to_owned()) && (near.distance_m - 0.02).abs() < 1e-3
    );
    assert_eq!(planner.stopped_by(&[0, 1], &beside(0.05)), None);
    assert_eq!(planner.stopped_by(&[], &beside(0.02)), None);
}

#[test]
fn the_same_question_has_the_same_answer() {
    let walls = [wall(-1.5, 0.5), wall(0.75, 1.5)];
    assert_eq!(slide(&walls, RIGHT, 3), slide(&walls, RIGHT, 3));
    let mut planner = Planner::new(&slider(), &walls);
    let first = planner.plan(&[0, 1], &LEFT, &RIGHT, 3);
    assert_eq!(first, slide(&walls, RIGHT, 3));
    assert_ne!(first, planner.plan(&[0, 1], &LEFT, &RIGHT, 4));
}

/// A table's top in front of the robot.
fn table() -> KnownBox {
    KnownBox {
        name: "table".into(),
        root_from_box: Isometry3::from_parts(
            Point3::new(0.25, 0.65, 0.93).coords.into(),
            UnitQuaternion::from_euler_angles(0.02, -0.01, 0.1),
        ),
        size: Vector3::new(1.0, 0.7, 0.04),
    }
}

#[test]
fn an_arm_goes_around_a_table_its_own_body_and_the_other_arm() {
    let model = Model::shipped("armar3").unwrap();
    let mut planner = Planner::new(&model, &[table()]);
    let mut kinematics = Kinematics::new(&model);
    let joints = model.limb("right_arm").to_vec();
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let mut free = || loop {
        let mut q = model.start().to_vec();
        for &j in &joints {
            q[j] = rng.random_range(model.joints()[j].lower..model.joints()[j].upper);
        }
        if planner.nearest(&q).is_none_or(|near| near.distance_m > CLEARANCE + 0.005) {
            return q;
        }
    };
    let goals: Vec<Vec<f64>> = (0..16).map(|_| free()).collect();
    let (mut around, mut none) = (0, 0);
    for (seed, two) in goals.windows(2).enumerate() {
        match planner.plan(&joints, &two[0], &two[1], seed as u64) {
            Ok(path) => {
                around += usize::from(path.len() > 2);
                for q in along(&path, 200) {
                    kinematics.update(&q);
                    let least = crate::bodies::least_distance(&planner.bodies, &kinematics);
                    assert!(least > KEPT, "{seed}: {least}");
                    for (q, joint) in q.iter().zip(model.joints()) {
                        assert!((joint.lower..=joint.upper).contains(q), "{}", joint.name);
                    }
                }
            }
            Err(PlanError::NoWay { .. }) => none += 1,
            Err(other) => panic!("{other}"),
        }
    }
    assert!(around >= 3 && none <= 3, "{around} around, {none} without a way");
}

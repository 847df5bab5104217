//! Tests the description against the published test vectors, and Jacobians and torques against finite differences.

use std::sync::Arc;

use nalgebra::{Point3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::{Geometry, JointKind, Kinematics, Model, description, pose_error};

fn armar3() -> Arc<Model> {
    Model::shipped("armar3").unwrap()
}

fn random_q(model: &Model, rng: &mut ChaCha8Rng) -> Vec<f64> {
    model.joints().iter().map(|j| rng.random_range(j.lower..=j.upper)).collect()
}

fn origin_mm(model: &Model, q: &[f64], link: &str) -> Vector3<f64> {
    model.link_pose(q, model.require_link(link).unwrap()).translation.vector * 1e3
}

#[track_caller]
fn near(got: Vector3<f64>, expected: [f64; 3], tolerance: f64) {
    let error = (got - Vector3::from(expected)).norm();
    assert!(error <= tolerance, "{got:?} is {error} from {expected:?}");
}

/// Node, origin mm (right arm; the left mirrors x), axis right, axis left, all joints at 0.
type Node = (&'static str, [f64; 3], [f64; 3], [f64; 3]);
const NODES: [Node; 7] = [
    ("shoulder_1", [232.0, 123.0, 1375.0], [-1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]),
    ("shoulder_2", [232.0, 123.0, 1375.0], [0.0, -1.0, 0.0], [0.0, -1.0, 0.0]),
    ("upperarm", [232.0, 123.0, 1375.0], [-0.259, 0.0, 0.966], [0.259, 0.0, 0.966]),
    ("elbow", [312.234, 143.0, 1075.56], [0.966, 0.0, 0.259], [0.966, 0.0, -0.259]),
    ("underarm", [319.478, 143.0, 1077.5], [0.0, -1.0, 0.0], [0.0, -1.0, 0.0]),
    ("wrist_1", [319.478, 383.0, 1077.5], [0.259, 0.0, -0.966], [-0.259, 0.0, -0.966]),
    ("wrist_2", [319.478, 383.0, 1077.5], [-0.966, 0.0, -0.259], [-0.966, 0.0, 0.259]),
];

#[test]
fn the_arms_stand_where_the_published_model_says() {
    let model = armar3();
    let kinematics = Kinematics::new(&model);
    let q = model.zero();
    for (name, origin, right, left) in NODES {
        let mirrored = [-origin[0], origin[1], origin[2]];
        for (side, origin, axis) in [("r", origin, right), ("l", mirrored, left)] {
            let name = format!("{name}_{side}");
            near(origin_mm(&model, &q, &name), origin, 0.006);
            near(*kinematics.axis(model.require_joint(&name).unwrap()), axis, 1e-3);
        }
    }
    near(origin_mm(&model, &q, "tcp_right"), [319.478, 513.0, 1077.504], 0.006);
    near(origin_mm(&model, &q, "tcp_left"), [-319.478, 513.0, 1077.504], 0.006);
    let rotation = model.link_pose(&q, model.link("tcp_right").unwrap()).rotation.to_rotation_matrix();
    let rows = [[0.259, -0.966, 0.0], [0.0, 0.0, 1.0], [-0.966, -0.259, 0.0]];
    for (row, expected) in rows.iter().enumerate() {
        near(rotation.matrix().row(row).transpose(), *expected, 1e-3);
    }
}

#[test]
fn single_joints_move_the_tcp_as_published() {
    let model = armar3();
    for (joint, degrees, expected) in [
        ("elbow_r", -90.0_f64, [415.241, 143.0, 720.112]),
        ("shoulder_1_r", -45.0, [319.478, 609.133, 1440.41]),
        ("shoulder_2_r", 30.0, [456.506, 513.0, 1161.1]),
    ] {
        let mut q = model.zero();
        q[model.require_joint(joint).unwrap()] = degrees.to_radians();
        near(origin_mm(&model, &q, "tcp_right"), expected, 0.1);
    }
}

#[test]
fn the_left_arm_mirrors_the_right() {
    // Mirrored axes have the opposite sense for shoulder 2, upperarm and underarm; their limits are mirrored too.
    let model = armar3();
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let signs = [1.0, -1.0, -1.0, 1.0, -1.0, -1.0, 1.0];
    for _ in 0..20 {
        let mut q = model.zero();
        for ((&r, &l), sign) in model.limb("right_arm").iter().zip(model.limb("left_arm")).zip(signs) {
            q[r] = rng.random_range(-0.4..0.4);
            q[l] = sign * q[r];
        }
        let right = origin_mm(&model, &q, "tcp_right");
        near(origin_mm(&model, &q, "tcp_left"), [-right.x, right.y, right.z], 1e-6);
    }
}

#[test]
fn the_description_has_the_frames_and_masses_it_promises() {
    let model = armar3();
    let q = model.zero();
    let mass = |links: &mut dyn Iterator<Item = crate::LinkId>| -> f64 {
        links.filter_map(|l| model.links()[l.index()].inertial).map(|i| i.mass).sum()
    };
    let hand = mass(&mut model.subtree(model.link("wrist_sensor_right").unwrap()));
    assert!((hand - 1.0).abs() < 1e-9, "the hand weighs {hand} kg");
    let baseline = origin_mm(&model, &q, "camera_right") - origin_mm(&model, &q, "camera_left");
    near(baseline, [93.0, 0.0, 0.0], 1e-6);
    let camera = model.link_pose(&q, model.link("camera_left").unwrap());
    near(camera * Vector3::z(), [0.0, 1.0, 0.0], 1e-9);
    near(camera * Vector3::y(), [0.0, 0.0, -1.0], 1e-9);
    let tcp = model.link_pose(&q, model.link("tcp_right").unwrap());
    let grasp = model.link_pose(&q, model.link("grasp_right").unwrap());
    near(pose_error(&tcp, &grasp).linear, (0.08 * (tcp * Vector3::x())).into(), 1e-9);
    let marker = &model.links()[model.link("hand_marker_right").unwrap().index()].visuals[0];
    assert_eq!((&marker.shape, marker.color), (&Geometry::Sphere { radius: 0.02 }, [200, 30, 160]));
    let fingers = model.limb("right_hand");
    assert!(fingers.iter().all(|&j| model.joints()[j].kind == JointKind::Prismatic));
    for limb in ["torso", "head", "right_arm", "left_arm"] {
        assert!(!model.limb(limb).is_empty(), "{limb}");
    }
}

#[test]
fn jacobians_agree_with_finite_differences() {
    let model = armar3();
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let mut kinematics = Kinematics::new(&model);
    let joints: Vec<usize> = (0..model.joints().len()).collect();
    for link in ["tcp_right", "tcp_left", "camera_left", "finger_left_r"] {
        let link = model.require_link(link).unwrap();
        for _ in 0..10 {
            let q = random_q(&model, &mut rng);
            kinematics.update(&q);
            let here = *kinematics.pose(link);
            assert!((here.to_homogeneous() - model.link_pose(&q, link).to_homogeneous()).norm() < 1e-12);
            let jacobian = kinematics.jacobian(link, &joints);
            let direction: Vec<f64> = joints.iter().map(|_| rng.random_range(-1.0..1.0)).collect();
            let step = 1e-6;
            let at = |sign: f64| -> Vec<f64> {
                q.iter().zip(&direction).map(|(q, d)| q + sign * step * d).collect()
            };
            let moved = pose_error(&model.link_pose(&at(-1.0), link), &model.link_pose(&at(1.0), link));
            let product = jacobian * nalgebra::DVector::from_vec(direction.clone());
            // Central differences: error of the order of step², rounding 1e-16 / step.
            near(moved.linear / (2.0 * step), product.fixed_rows::<3>(0).into_owned().into(), 1e-7);
            near(moved.angular / (2.0 * step), product.fixed_rows::<3>(3).into_owned().into(), 1e-7);
            let twist = kinematics.twist(link, &Point3::origin(), &direction);
            near(twist.linear, product.fixed_rows::<3>(0).into_owned().into(), 1e-12);
        }
    }
}

const FILE: &str = "robot: r\ndescription: robot.urdf\n";

/// A crank whose pin slides twice as far as its slider turns, and the other way.
const MIMIC: &str = r#"<robot name="r"><link name="a"/><link name="b"/><link name="c"/><link name="d"/>
<joint name="pin" type="prismatic"><parent link="b"/><child link="c"/><origin xyz="1 0 0"/><axis xyz="0 1 0"/>
  <mimic joint="middle" multiplier="2" offset="0.1"/></joint>
<joint name="middle" type="revolute"><parent link="c"/><child link="d"/><axis xyz="0 0 1"/>
  <mimic joint="crank" multiplier="-1" offset="0.2"/></joint>
<joint name="crank" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
  <limit lower="-1" upper="1" velocity="1" effort="1"/></joint></robot>"#;

#[test]
fn mimic_joints_follow_their_leaders_and_the_jacobian_knows_it() {
    let read = description::from_texts(FILE, MIMIC).unwrap();
    let model = read.model;
    assert_eq!(model.joints().len(), 1, "followers are no joints of their own");
    let at = |q: f64| model.link_pose(&[q], model.link("d").unwrap());
    let q = 0.3_f64;
    // The pin slides by 2 (0.2 - q) + 0.1, the last link turns by q + (0.2 - q).
    let slide = 2.0 * (0.2 - q) + 0.1;
    near(
        at(q).translation.vector,
        [libm::cos(q) - slide * libm::sin(q), libm::sin(q) + slide * libm::cos(q), 0.0],
        1e-12,
    );
    assert!((at(q).rotation.angle() - 0.2).abs() < 1e-12);
    let column = model.jacobian(&[q], model.link("d").unwrap(), &[0]);
    let moved = pose_error(&at(q - 1e-6), &at(q + 1e-6));
    near(moved.linear / 2e-6, [column[(0, 0)], column[(1, 0)], column[(2, 0)]], 1e-8);
    near(moved.angular / 2e-6, [column[(3, 0)], column[(4, 0)], column[(5, 0)]], 1e-8);
    let said: Vec<String> = read.warnings.iter().map(ToString::to_string).collect();
    assert!(said.iter().all(|said| said.contains("warning[W110]")), "{said:?}");
    assert!(said.iter().any(|said| said.contains("without mass, taken for 0.1 kg: b, c, d")), "{said:?}");
}

#[test]
fn names_that_the_description_does_not_have_are_found_in_the_robot_file() {
    let urdf = MIMIC;
    for (text, says) in [
        (
            "groups: {arm: {joints: [crnk]}}",
            "4:1: error[E029]: the robot has no joint `crnk` (did you mean `crank`?)",
        ),
        ("groups: {arm: {joints: [crank], tcp: e}}", "no link `e`"),
        ("groups: {arm: {chain: [crank, crank], wrench: w}}", "no wrench sensor `w`"),
        ("groups: {arm: {joints: [crank], hand: h}}", "no hand `h`"),
        ("groups: {arm: {joints: [crank], helped_by: [arm]}}", "no other group `arm`"),
        ("groups: {arm: {}}", "the group `arm` has no joints"),
        ("groups: {arm: {joints: [crank, crank]}}", "is there twice"),
        ("start: home", "no posture `home`"),
        ("postures: {home: {crank: 2}}", "2 is beyond the limits of the joint `crank`"),
        ("postures: {home: {crank: 2 mm}}", "turns: an angle is needed"),
        ("hands: {h: {joints: [crank], open: [0, 1]}}", "2 positions for 1 joints"),
        ("hands: {h: {joints: []}}", "the hand `h` has no joints"),
        ("cameras: {eyes: {left: a, right: b, on: head}}", "no group `head`"),
        ("limits: {force: 3 kg}", "not a unit"),
    ] {
        let text = format!("{FILE}\n{text}\n");
        let errors = description::from_texts(&text, urdf).expect_err(&text);
        assert!(
            errors[0].to_string().contains(says.trim_start_matches("4:1: ")),
            "{} should say {says}",
            errors[0]
        );
        assert_eq!(errors[0].position().0, 4, "{}", errors[0]);
    }
}

#[test]
fn broken_descriptions_are_refused_with_the_place() {
    let link = |n: &str| format!("<link name=\"{n}\"/>");
    let joint = |kind: &str, p: &str, c: &str, more: &str| {
        format!("<joint name=\"j\" type=\"{kind}\"><parent link=\"{p}\"/><child link=\"{c}\"/>{more}</joint>")
    };
    let limit = "<axis xyz=\"0 0 1\"/><limit lower=\"-1\" upper=\"1\" velocity=\"1\" effort=\"1\"/>";
    let (a, b) = (link("a"), link("b"));
    for (inside, says) in [
        (format!("{a}{b}"), "two roots"),
        (format!("{a}{}", joint("revolute", "a", "c", limit)), "`c`, which is missing"),
        (format!("{a}{b}{}", joint("magic", "a", "b", limit)), "`magic`"),
        (
            format!("{a}{b}{}", joint("revolute", "a", "b", "<axis xyz=\"0 0 0\"/><limit velocity=\"1\"/>")),
            "no axis",
        ),
        (format!("{a}{b}{}", joint("revolute", "a", "b", "<limit lower=\"1\" upper=\"0\"/>")), "`j` needs"),
        (format!("{a}{b}{}", joint("revolute", "a", "b", "<mimic joint=\"j\"/>")), "mimics itself"),
        (format!("{a}{b}{}", joint("revolute", "a", "b", "<mimic joint=\"k\"/>")), "`k`, which is missing"),
        (format!("<xacro:include xmlns:xacro=\"http://ros.org/wiki/xacro\"/>{a}"), "xacro robot.urdf >"),
        (format!("{a}{}", joint("fixed", "a", "a", "")), "no root"),
        (format!("{a}{a}"), "two links"),
        ("<link".to_owned(), "cannot read"),
    ] {
        let text = format!("<robot name=\"r\">{inside}</robot>");
        let error = description::from_texts(FILE, &text).expect_err(&text)[0].to_string();
        assert!(error.starts_with("robot.urdf:1:") && error.contains(says), "{error} should say {says}");
    }
    let good = format!("<robot name=\"r\">{a}{b}{}</robot>", joint("revolute", "a", "b", limit));
    assert_eq!(description::from_texts(FILE, &good).unwrap().model.joints().len(), 1);
}

/// Two arms of four joints on a lift, one with a gripper whose fingers move together.
fn two_arms() -> String {
    let limit = "<limit lower='-1' upper='2' velocity='1' effort='1'/>";
    let (mut links, mut joints) = (String::from("<link name='base'/><link name='lift'/>"), String::new());
    joints += &format!(
        "<joint name='lift' type='prismatic'><parent link='base'/><child link='lift'/><axis xyz='0 0 1'/>{limit}</joint>"
    );
    for side in ["left", "right"] {
        let mut before = "lift".to_owned();
        for k in 1..=4 {
            let name = format!("{side}_{k}");
            links += &format!("<link name='{name}'/>");
            joints += &format!(
                "<joint name='{name}' type='revolute'><parent link='{before}'/><child link='{name}'/>\
                 <origin xyz='0.2 0 0'/><axis xyz='0 0 1'/>{limit}</joint>"
            );
            before = name;
        }
        links += &format!("<link name='{side}_tool'/>");
        joints += &format!(
            "<joint name='{side}_t' type='fixed'><parent link='{before}'/><child link='{side}_tool'/></joint>"
        );
    }
    for (finger, more) in [("a", limit.to_owned()), ("b", "<mimic joint='a' multiplier='-1'/>".to_owned())] {
        links += &format!("<link name='{finger}'/>");
        joints += &format!(
            "<joint name='{finger}' type='prismatic'><parent link='right_4'/><child link='{finger}'/>{more}</joint>"
        );
    }
    format!("<robot name='two'>{links}{joints}</robot>")
}

#[test]
fn arms_hands_and_what_they_hang_on_are_told_from_a_description() {
    let folder = std::env::temp_dir().join(format!("armarium-guess-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let urdf = folder.join("two.urdf");
    std::fs::write(&urdf, two_arms()).unwrap();
    let model = description::load(&urdf, &[]).unwrap().model;
    let text = description::guessed(&urdf, None, &folder, &[]).unwrap();
    let srdf = folder.join("two.srdf");
    let groups = "<group name='right'><chain base_link='lift' tip_link='right_tool'/></group>\
                  <group name='gripper'><joint name='a'/><joint name='b'/></group>\
                  <end_effector name='e' parent_link='right_tool' group='gripper'/>\
                  <group_state name='ready' group='right'><joint name='right_2' value='0.5'/><joint name='right_3' value='7'/></group_state>\
                  <disable_collisions link1='right_4' link2='left_1' reason='Never'/>\
                  <disable_collisions link1='right_4' link2='of another variant'/>";
    std::fs::write(&srdf, format!("<robot name='two'>{groups}</robot>")).unwrap();
    std::fs::write(folder.join("robot.yaml"), "robot: two\ndescription: two.urdf\nsemantics: two.srdf\n")
        .unwrap();
    let told = description::load(&folder.join("robot.yaml"), &[]).unwrap();
    std::fs::remove_dir_all(&folder).unwrap();

    let arms: Vec<_> =
        model.arms().map(|arm| (arm.name.as_str(), arm.joints.len(), arm.hand.as_deref())).collect();
    assert_eq!(arms, [("right_arm", 4, Some("right_hand")), ("left_arm", 4, None)], "{text}");
    let right = model.find_limb("right_arm").unwrap();
    assert_eq!(
        (right.tcp, right.helped_by.as_slice()),
        (model.link("right_tool"), &["torso".to_owned()][..])
    );
    assert_eq!(model.limb("right_hand"), [model.joint("a").unwrap()]);
    assert_eq!(model.start()[model.joint("left_1").unwrap()], 0.5, "the middle of its range");
    assert_eq!(text.matches("# guessed").count(), text.matches("guessed").count() - 1, "{text}");

    let (model, warnings) = (told.model, told.warnings);
    let right = model.find_limb("right").unwrap();
    assert_eq!(
        (right.joints.len(), right.hand.as_deref(), right.tcp),
        (4, Some("gripper"), model.link("right_tool"))
    );
    let ready = &model.postures()["ready"];
    let at = |joint: &str| ready[model.joint(joint).unwrap()];
    assert_eq!((at("right_2"), at("right_3"), at("left_1")), (0.5, 2.0, 0.0));
    let [right, left] = ["right_4", "left_1"].map(|link| model.require_link(link).unwrap());
    assert!(model.may_touch(right, left) && model.may_touch(left, right) && !model.may_touch(right, right));
    assert!(
        warnings.iter().any(|warning| warning.message.contains("7 is beyond the limits")),
        "{warnings:?}"
    );
}

#[test]
fn bytes_that_are_no_mesh_are_none_and_those_of_one_are() {
    use crate::description::read_mesh;
    let triangle = b"v 0 0 0\nv 1 0 0\nv 0 2 0\nf 1 2 3\n";
    let mesh = read_mesh(triangle, "a.obj", [1.0, 1.0, 0.5]).unwrap();
    assert_eq!((mesh.triangles().len(), mesh.bounds()[1].y), (1, 2.0));
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    for name in ["a.obj", "a.stl", "a.dae", "a.xyz"] {
        for length in [0, 1, 83, 84, 90, 400] {
            let noise: Vec<u8> = (0..length).map(|_| rng.random()).collect();
            assert!(
                read_mesh(&noise, name, [1.0; 3]).is_none_or(|mesh| !mesh.triangles().is_empty()),
                "{name}"
            );
        }
    }
    // A count of triangles that the file does not have must not be believed.
    let mut liar = vec![0; 84];
    liar[80..84].copy_from_slice(&u32::MAX.to_le_bytes());
    assert!(read_mesh(&liar, "a.stl", [1.0; 3]).is_none());
}

//! The physics of the task, end to end: a hand that knows the truth grasps the sponge, presses, wipes and is
//! pushed.
use std::f64::consts::TAU;
use std::sync::Arc;

use armarium_robot::{DifferentialIk, IkConfig, Lease, LeaseLimits, LinkId, Robot, Twist};
use armarium_simulator::world::{Disturbance, ObjectSpec};
use armarium_simulator::{Milestone, Options, Simulation, World};
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector2, Vector3};

/// Moves the right hand of a simulation with knowledge of the truth.
struct TruthfulHand {
    simulation: Simulation,
    robot: Arc<dyn Robot>,
    arm: Lease,
    torso: Lease,
    fingers: Lease,
    ik: DifferentialIk,
    tcp: LinkId,
}

impl TruthfulHand {
    fn new(world: &World, seed: u64) -> Self {
        let simulation = Simulation::new(world, seed, Options::default()).unwrap();
        let robot = simulation.robot();
        let lease = |limb| robot.lease(limb, "test", LeaseLimits::default()).unwrap();
        let (arm, torso, fingers) = (lease("right_arm"), lease("torso"), lease("right_hand"));
        let model = Arc::clone(robot.model());
        let tcp = model.link("tcp_right").unwrap();
        let joints: Vec<usize> = model.limb("torso").iter().chain(model.limb("right_arm")).copied().collect();
        let ik = DifferentialIk::new(&model, tcp, &joints, IkConfig::default());
        Self { simulation, robot, arm, torso, fingers, ik, tcp }
    }

    fn now(&self) -> u64 {
        self.simulation.truth().stamp_ns
    }

    fn force(&self) -> f64 {
        self.simulation.truth().contact.normal
    }

    fn fastest_joint(&self) -> f64 {
        self.simulation.truth().velocity.iter().fold(0.0, |m, v| v.abs().max(m))
    }

    /// One step with a TCP twist and a velocity of the fingers, m/s.
    fn step(&mut self, twist: &Twist, fingers: f64) {
        let q = self.simulation.truth().position.clone();
        if q.is_empty() {
            self.simulation.step();
            return;
        }
        let step = self.ik.step(&q, twist, None);
        let (torso, arm) = step.velocities.split_at(3);
        self.torso.command(torso).unwrap();
        self.arm.command(arm).unwrap();
        self.fingers.command(&[fingers, fingers]).unwrap();
        self.simulation.step();
    }

    /// Moves to a pose at up to 0.2 m/s; returns the remaining distance, m.
    fn go(&mut self, goal: &Isometry3<f64>, seconds: f64, fingers: f64) -> f64 {
        for _ in 0..(seconds * 1e3) as u32 {
            let tcp = self.simulation.truth().tcp;
            let twist = towards(&tcp, goal, 0.2);
            self.step(&twist, fingers);
        }
        (self.simulation.truth().tcp.translation.vector - goal.translation.vector).norm()
    }
}

fn towards(from: &Isometry3<f64>, to: &Isometry3<f64>, fastest: f64) -> Twist {
    let linear = (to.translation.vector - from.translation.vector) * 4.0;
    let angular = (to.rotation * from.rotation.inverse()).scaled_axis() * 4.0;
    let cap = |v: Vector3<f64>, most: f64| v * (most / v.norm().max(most));
    Twist { linear: cap(linear, fastest), angular: cap(angular, 0.6) }
}

/// A pose with the palm down and the pads along the sponge's long sides.
fn above(sponge: &Isometry3<f64>, lift: f64, yaw: f64) -> Isometry3<f64> {
    let x = Vector3::new(0.0, 0.0, -1.0);
    let z = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw) * Vector3::y();
    let axes = nalgebra::Rotation3::from_basis_unchecked(&[x, z.cross(&x), z]);
    let at = sponge.translation.vector + Vector3::z() * (0.08 + lift);
    Isometry3::from_parts(at.into(), UnitQuaternion::from_rotation_matrix(&axes))
}

fn world() -> World {
    let mut world = World::default();
    world.objects[0].at = [0.30, 0.52];
    world.objects[0].yaw_deg = 90.0;
    world
}

fn grasped(world: &World) -> (TruthfulHand, Isometry3<f64>) {
    grasped_object(world, 0)
}

fn grasped_object(world: &World, object: usize) -> (TruthfulHand, Isometry3<f64>) {
    let mut hand = TruthfulHand::new(world, 3);
    hand.step(&Twist::default(), 0.0);
    let object = hand.simulation.truth().objects[object];
    assert!(hand.go(&above(&object, 0.12, 0.0), 6.0, 0.05) < 0.01);
    let grasp = above(&object, 0.0, 0.0);
    assert!(hand.go(&grasp, 3.0, 0.0) < 0.005);
    hand.go(&grasp, 1.5, -0.05);
    assert!(hand.simulation.truth().held);
    hand.simulation.referee().mark(Milestone::GraspClosed, hand.now());
    (hand, grasp)
}

#[test]
fn the_sponge_is_taken_pressed_and_wiped_with() {
    let (mut hand, grasp) = grasped(&world());
    let error = hand.simulation.referee().report()["grasp"]["position_error_m"].as_f64().unwrap();
    assert!(error < 0.01, "{error}");
    hand.go(&above(&grasp, 0.0, 0.0), 2.0, -0.05);
    assert!(hand.simulation.truth().held && hand.force() == 0.0);

    // Down, then a circle at 8 N by a plain integrating force controller on the true force.
    let referee = hand.simulation.referee();
    referee.mark(Milestone::AdaptationStarted, hand.now());
    let center = grasp.translation.vector;
    let (mut z, radius, omega) = (hand.simulation.truth().tcp.translation.z, 0.04, TAU * 0.4);
    let (mut t, mut marked) = (0.0f64, false);
    while t < 24.0 {
        let ramp = (t / 4.0).min(1.0);
        let theta = omega * t;
        let mut goal = grasp;
        goal.translation.x = center.x + ramp * radius * (libm::cos(theta) - 1.0);
        goal.translation.y = center.y + ramp * radius * libm::sin(theta);
        let error = 8.0 - hand.force();
        z -= (error * 3e-3).clamp(-0.02, 0.02) * 1e-3;
        goal.translation.z = z;
        let tcp = hand.simulation.truth().tcp;
        let mut twist = towards(&tcp, &goal, 0.3);
        twist.linear.x += ramp * radius * omega * -libm::sin(theta);
        twist.linear.y += ramp * radius * omega * libm::cos(theta);
        hand.step(&twist, -0.05);
        t += 1e-3;
        if t > 11.0 && !marked {
            marked = true;
            referee.mark(Milestone::AdaptationEnded { desired_n: 8.0, cycles: 2 }, hand.now());
        }
    }
    assert!(hand.simulation.truth().held);
    let report = referee.report();
    let force = |key: &str| report["force"][key].as_f64().unwrap();
    assert!((force("mean_n") - 8.0).abs() < 1.0, "{report}");
    assert!(force("rms_error_n") < 2.0 && force("contact_lost_s") == 0.0, "{report}");
    let friction = hand.simulation.truth().contact.tangential.norm();
    assert!((friction / hand.force() - 0.5).abs() < 0.05, "{friction}");
    // The compensated wrist force includes the table's force through sponge and grip (no tare: bias and drift
    // remain).
    let sensed = hand.robot.sensed().borrow().wrenches[0].external.force;
    let contact = hand.simulation.truth().contact;
    let true_force = contact.tangential + Vector3::z() * contact.normal;
    assert!((sensed - true_force).norm() < 6.0, "{sensed} {true_force}");
    let wiped = hand.simulation.wiped().cells().iter().filter(|c| **c).count();
    assert!(wiped > 1500, "{wiped}");
    let point = Point3::from(hand.simulation.truth().tcp.translation.vector);
    assert!(point.z.is_finite() && hand.tcp.index() > 0);
}

/// The sponge lies aside; a brick is grasped where it used to lie.
#[test]
fn what_was_grasped_is_judged_whatever_its_name_is() {
    let mut world = world();
    let brick = ObjectSpec { name: "brick".into(), ..world.objects[0].clone() };
    let [x, y] = world.objects[0].at;
    world.objects[0].at = [x - 0.25, y + 0.2];
    world.objects.push(brick);
    let (mut hand, grasp) = grasped_object(&world, 1);
    let referee = hand.simulation.referee();
    hand.go(&above(&grasp, 0.0, 0.0), 1.0, -0.05);
    referee.mark(Milestone::AdaptationEnded { desired_n: 8.0, cycles: 2 }, hand.now());
    hand.go(&above(&grasp, 0.02, 0.0), 1.0, -0.05);
    assert_eq!(referee.judged_object(), Some(1));
    let report = referee.report();
    assert_eq!(report["grasp"]["object"], "brick");
    assert!(report["grasp"]["position_error_m"].as_f64().unwrap() < 0.01, "{report}");
    assert!(report["wiped_fraction"].as_f64().unwrap() < 0.5, "{report}");
    assert!(referee.sections().iter().any(|section| section.note.contains("What the brick cleaned")));
    // Before and after the grasp it is known where both are.
    let log = referee.log();
    let place = |object: usize, t: u64| log.object_at(object, t).unwrap().translation.vector;
    let (early, late) = (1_000_000_000, hand.now() - 1_000_000);
    assert!((place(1, early).xy() - Vector2::new(x, y)).norm() < 0.01, "{}", place(1, early));
    for t in [early, late] {
        assert!((place(0, t).xy() - Vector2::new(x - 0.25, y + 0.2)).norm() < 0.01, "{}", place(0, t));
    }
    assert!(place(1, late).z > place(1, early).z + 0.01);
}

#[test]
fn a_knock_takes_the_sponge_out_of_the_hand() {
    let mut world = world();
    world.disturbances = vec![Disturbance { at: 0.5, ..Disturbance::default() }];
    let (mut hand, grasp) = grasped(&world);
    let lifted = above(&grasp, 0.0, 0.0);
    hand.go(&lifted, 2.0, -0.05);
    hand.robot.say("I am wiping.");
    let mut lost = false;
    for _ in 0..1500 {
        let q = hand.simulation.truth().held;
        lost |= !q;
        hand.simulation.step();
    }
    assert!(lost);
}

/// The softest, stiffest, lightest and heaviest objects that a world allows lie still.
#[test]
fn extreme_objects_lie_still() {
    for (mass, stiffness, size) in [
        (0.05, 10_000.0, [0.10, 0.07, 0.04]),
        (0.05, 10_000.0, [0.02, 0.02, 0.02]),
        (2.0, 10_000.0, [0.20, 0.20, 0.20]),
        (0.5, 800.0, [0.10, 0.07, 0.04]),
    ] {
        let mut world = World::default();
        world.objects[0].mass = mass;
        world.objects[0].stiffness = stiffness;
        world.objects[0].size = size;
        world.table.tilt_deg = [4.0, -4.0];
        let mut simulation = Simulation::new(&world, 1, Options::default()).unwrap();
        for _ in 0..2000 {
            simulation.step();
        }
        let before = simulation.truth().object_pose().unwrap().1.translation.vector;
        for _ in 0..1000 {
            simulation.step();
        }
        let moved = simulation.truth().object_pose().unwrap().1.translation.vector - before;
        assert!(moved.norm() < 1e-4, "{mass} {stiffness} {size:?} {moved}");
        let weight = mass * 9.81;
        assert!((simulation.truth().contact.normal / weight - 1.0).abs() < 0.02);
    }
}

/// While pressing on the table and sliding, with a joint at full speed, the commander becomes silent: every joint
/// stands 200 ms later, and the sponge is still held.
#[test]
fn from_full_speed_in_contact_the_arm_stands_too() {
    // Away from the trunk: towards it, the guard slows the elbow down.
    for way in [Vector2::<f64>::x(), -Vector2::<f64>::y()] {
        let (mut hand, mut goal) = grasped(&world());
        while hand.force() < 8.0 {
            goal.translation.z -= 2e-5;
            let tcp = hand.simulation.truth().tcp;
            hand.step(&towards(&tcp, &goal, 0.1), -0.05);
        }
        let mut speed = 0.0;
        while hand.fastest_joint() < 0.95 {
            speed += 2e-3;
            let tcp = hand.simulation.truth().tcp;
            (goal.translation.x, goal.translation.y) = (tcp.translation.x, tcp.translation.y);
            let mut twist = towards(&tcp, &goal, 0.1);
            (twist.linear.x, twist.linear.y) = (way.x * speed, way.y * speed);
            hand.step(&twist, -0.05);
            assert!(speed < 2.0, "the arm has become no faster than {} rad/s", hand.fastest_joint());
        }
        assert!(hand.force() > 2.0, "not in contact any more: {} N", hand.force());
        // The watchdog keeps the last command for 30 ms.
        (0..230).for_each(|_| hand.simulation.step());
        for _ in 0..200 {
            hand.simulation.step();
            assert!(hand.fastest_joint() < 0.01, "{} rad/s", hand.fastest_joint());
        }
        assert!(hand.simulation.truth().held && hand.force() > 2.0, "{} N", hand.force());
    }
}

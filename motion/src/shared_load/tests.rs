use super::*;

const DT: f64 = 1e-3;
const UP: Vector3<f64> = Vector3::new(0.0, 0.0, 1.0);

/// Two hands that follow their targets with a lag, with springs between them and a load that hangs on them.
struct Rig {
    tcps: [Isometry3<f64>; 2],
    /// Where the hands would touch without pressing, from the load's middle, m.
    half: f64,
    /// Of each contact: across, along and turning, N/m and N m/rad.
    stiffness: [f64; 3],
    lag: f64,
    weight: f64,
    /// The share of the weight on the first hand.
    share: f64,
    /// By how much the second hand is wrong about where it is, m.
    wrong: Vector3<f64>,
}

impl Rig {
    fn new(stiffness: f64, lag: f64) -> Self {
        let at = |x: f64| Isometry3::translation(x, 0.45, 1.0);
        Self {
            tcps: [at(0.26), at(-0.26)],
            half: 0.2,
            stiffness: [stiffness, stiffness / 3.0, stiffness * 4e-3],
            lag,
            weight: 15.0,
            share: 0.5,
            wrong: Vector3::zeros(),
        }
    }

    /// As the hands feel it: the load's middle is between both contacts.
    fn hands(&self) -> [HandOnLoad; 2] {
        let face = |i: usize| Vector3::x() * if i == 0 { -0.06 } else { 0.06 };
        let true_tcp = |i: usize| {
            let wrong = if i == 0 { Vector3::zeros() } else { self.wrong };
            Translation3::from(wrong) * self.tcps[i]
        };
        let contact = |i: usize| true_tcp(i) * Point3::from(face(i));
        let apart = contact(0) - contact(1);
        let pressed = (2.0 * self.half - apart.x).max(0.0) / 2.0;
        let turned = (true_tcp(0).rotation * true_tcp(1).rotation.inverse()).scaled_axis() / 2.0;
        [0, 1].map(|i| {
            let (out, share) = if i == 0 { (1.0, self.share) } else { (-1.0, 1.0 - self.share) };
            let along = Vector3::new(0.0, apart.y, apart.z) * (-0.5 * out * self.stiffness[1]);
            let force =
                Vector3::x() * (out * self.stiffness[0] * pressed) + along - UP * (self.weight * share);
            let torque = face(i).cross(&force) - turned * (out * self.stiffness[2]);
            let wrench = Vector6::from_iterator(force.iter().chain(torque.iter()).copied());
            HandOnLoad { tcp: self.tcps[i], contact: self.tcps[i] * Point3::from(face(i)), wrench }
        })
    }

    fn follow(&mut self, step: &SharedLoadStep) {
        let share = DT / (DT + self.lag);
        for (tcp, goal) in self.tcps.iter_mut().zip(&step.hands) {
            let missing = goal.pose.translation.vector - tcp.translation.vector + goal.linear * self.lag;
            tcp.translation.vector += missing * share;
            let turn = (goal.pose.rotation * tcp.rotation.inverse()).scaled_axis() * share;
            tcp.rotation = UnitQuaternion::from_scaled_axis(turn) * tcp.rotation;
        }
    }
}

fn resting(law: &SharedLoad) -> LinePoint {
    LinePoint { pose: *law.taken(), linear: Vector3::zeros(), angular: Vector3::zeros() }
}

/// The squeeze over time, until `seconds` have passed.
fn held(rig: &mut Rig, config: SharedLoadConfig, seconds: f64) -> (Vec<f64>, SharedLoadStep) {
    let mut law = SharedLoad::new(config, &rig.hands()).unwrap();
    let load = resting(&law);
    let mut squeezes = Vec::new();
    let mut last = None;
    for _ in 0..(seconds / DT) as usize {
        let step = law.step(DT, &rig.hands(), &load).unwrap();
        rig.follow(&step);
        squeezes.push(step.forces.squeeze);
        last = Some(step);
    }
    (squeezes, last.unwrap())
}

#[test]
fn the_squeeze_comes_and_stays_on_soft_and_on_hard_loads() {
    for stiffness in [1000.0, 3000.0, 8000.0, 20_000.0] {
        for lag in [0.01, 0.04] {
            let mut rig = Rig::new(stiffness, lag);
            let (squeezes, last) = held(&mut rig, SharedLoadConfig::default(), 12.0);
            let worst = squeezes.iter().copied().fold(0.0, f64::max);
            assert!((last.forces.squeeze - 25.0).abs() < 0.5, "{stiffness} {lag}: {}", last.forces.squeeze);
            assert!(worst < 27.5, "{stiffness} {lag}: {worst} N");
            assert_eq!(last.status, LoadStatus::Held);
        }
    }
}

#[test]
fn what_both_hands_do_is_split_into_what_carries_and_what_presses() {
    let rig = Rig { share: 0.7, ..Rig::new(3000.0, 0.01) };
    let mut hands = rig.hands();
    hands[0].wrench[0] += 40.0;
    hands[1].wrench[0] -= 20.0;
    let forces = LoadForces::of(&hands).unwrap();
    assert!((forces.external - Vector3::new(-20.0, 0.0, 15.0)).norm() < 1e-12, "{forces:?}");
    assert!((forces.squeeze - 30.0).abs() < 1e-12 && (forces.line.x + 1.0).abs() < 1e-12);
    assert!((forces.internal.z - 3.0).abs() < 1e-12);
    assert!((forces.hands[0].0 - 40.0).abs() < 1e-12 && (forces.hands[1].1 - 4.5).abs() < 1e-12);
    assert!(forces.moment.norm() < 1e-12, "a force through the contact has no moment about it: {forces:?}");
}

#[test]
fn hands_that_are_wrong_about_their_places_yield_to_each_other() {
    let wrong = Vector3::new(0.0, 0.004, 0.003);
    let along = |compliance: f64| {
        let mut rig = Rig { wrong, ..Rig::new(6000.0, 0.04) };
        let config = SharedLoadConfig { compliance, ..SharedLoadConfig::default() };
        let (_, last) = held(&mut rig, config, 10.0);
        (last.forces.internal - last.forces.line.into_inner() * last.forces.squeeze).norm()
    };
    let (stiff, yielding) = (along(0.0), along(5e-4));
    assert!((stiff - 0.5 * 2000.0 * wrong.norm()).abs() < 0.1, "{stiff}");
    // 1 / (1 + 2000 N/m * 5e-4 m/N) of it.
    assert!((yielding - stiff / 2.0).abs() < 0.1, "{yielding} of {stiff}");
}

#[test]
fn a_load_that_is_heavier_on_one_side_is_held_without_end() {
    let mut rig = Rig { share: 0.8, weight: 24.0, ..Rig::new(6000.0, 0.04) };
    let mut law = SharedLoad::new(SharedLoadConfig::default(), &rig.hands()).unwrap();
    let load = resting(&law);
    let mut stand = |seconds: usize| {
        for _ in 0..seconds * 1000 {
            let step = law.step(DT, &rig.hands(), &load).unwrap();
            rig.follow(&step);
        }
        (rig.tcps.map(|tcp| tcp.translation.vector), law.wanted)
    };
    let ((soon, wanted), (late, _)) = (stand(10), stand(60));
    assert!((0..2).all(|i| (late[i] - soon[i]).norm() < 1e-4), "{soon:?} {late:?}");
    // The hands yield to half of the 7.2 N by which one would carry more: it carries 15.6 N, which need 32.5 N, more than half of the load.
    assert!((wanted - 32.5).abs() < 0.5, "{wanted}");
}

#[test]
fn both_hands_move_as_the_load_does() {
    let rig = Rig::new(6000.0, 0.04);
    let free = SharedLoadConfig {
        gain: 1e-9,
        compliance: 0.0,
        turning_compliance: 0.0,
        ..SharedLoadConfig::default()
    };
    let hands = rig.hands();
    let mut law = SharedLoad::new(free, &hands).unwrap();
    let moved = Isometry3::new(Vector3::new(0.1, 0.02, 0.15), Vector3::new(0.0, 0.1, 0.4));
    let middle = law.taken().translation;
    let motion = middle * moved * middle.inverse();
    let load = LinePoint {
        pose: motion * law.taken(),
        linear: Vector3::new(0.0, 0.1, 0.0),
        angular: Vector3::new(0.0, 0.0, 0.5),
    };
    let step = law.step(DT, &hands, &load).unwrap();
    for (hand, goal) in hands.iter().zip(&step.hands) {
        let expected = motion * hand.tcp;
        assert!((goal.pose.translation.vector - expected.translation.vector).norm() < 1e-9);
        assert!(goal.pose.rotation.angle_to(&expected.rotation) < 1e-9);
        let lever = goal.pose.translation.vector - load.pose.translation.vector;
        assert!((goal.linear - load.linear - load.angular.cross(&lever)).norm() < 1e-7);
    }
}

#[test]
fn hands_that_grip_yield_to_all_that_is_between_them_and_do_not_squeeze() {
    let wrong = Vector3::new(0.006, 0.004, 0.003);
    let mut rig = Rig { wrong, half: 0.2, ..Rig::new(6000.0, 0.04) };
    // Grips pull as well as they push.
    let pulled = |rig: &Rig| {
        let mut hands = rig.hands();
        let apart = hands[0].contact - hands[1].contact + Vector3::x() * -(2.0 * rig.half);
        let force = (apart - rig.wrong) * -3000.0;
        for (hand, sign) in hands.iter_mut().zip([1.0, -1.0]) {
            let lever = hand.contact.coords - hand.tcp.translation.vector;
            let force = force * sign - UP * (rig.weight / 2.0);
            let torque = lever.cross(&force);
            hand.wrench = Vector6::from_iterator(force.iter().chain(torque.iter()).copied());
        }
        hands
    };
    let mut law = SharedLoad::held(SharedLoadConfig::default(), Holding::Gripping, &pulled(&rig)).unwrap();
    let load = resting(&law);
    let before = LoadForces::of(&pulled(&rig)).unwrap().internal;
    let mut energy = f64::INFINITY;
    for k in 0..10_000 {
        let step = law.step(DT, &pulled(&rig), &load).unwrap();
        assert_eq!((step.wanted, step.status), (0.0, LoadStatus::Held));
        rig.follow(&step);
        if k % 500 == 0 {
            // What is stored in the grips never grows but by what noise of the sum makes.
            let stored = step.forces.internal.norm_squared() / 6000.0;
            assert!(stored < energy + 1e-9, "{k}: {stored} after {energy}");
            energy = stored;
        }
    }
    let after = LoadForces::of(&pulled(&rig)).unwrap().internal;
    // A spring of 2 kN/m yields to one of 6 kN/m: 1 / (1 + 6000 N/m * 5e-4 m/N) of it is left.
    assert!((after - before / 4.0).norm() < 0.3, "{after} of {before}");
}

/// What a load of 2 kg that hangs between both hands and is shoved along its side needs most beyond what they press, N, in the half second.
fn missing_in_a_shove(config: SharedLoadConfig) -> f64 {
    let mut rig = Rig::new(6000.0, 0.0125);
    held(&mut rig, SharedLoadConfig { squeeze: 17.0, ..config.clone() }, 5.0);
    let mut law = SharedLoad::new(SharedLoadConfig { squeeze: 17.0, ..config }, &rig.hands()).unwrap();
    let (load, weight) = (resting(&law), rig.weight);
    let mut worst = 0.0_f64;
    for k in 0..500 {
        // Half a sine of 20 N, 0.2 s long, downwards.
        let t = f64::from(k) * DT;
        rig.weight = weight + if t < 0.2 { 20.0 * libm::sin(std::f64::consts::PI * t / 0.2) } else { 0.0 };
        let step = law.step(DT, &rig.hands(), &load).unwrap();
        let needs = step.forces.hands.iter().map(|(across, along)| along / 0.6 - across);
        worst = needs.fold(worst, f64::max);
        rig.follow(&step);
    }
    worst
}

#[test]
fn with_known_contacts_the_squeeze_comes_within_a_shove() {
    let quick =
        SharedLoadConfig { gain: 35.0 / 6000.0, slip_rate: 1500.0, fastest: 0.15, ..Default::default() };
    let (slow, quick) = (missing_in_a_shove(SharedLoadConfig::default()), missing_in_a_shove(quick));
    assert!(slow > 3.0, "the shove is large enough to matter: {slow} N");
    assert!(quick < 1.0, "{quick} N are missing, {slow} N without knowing the contacts");
}

#[test]
fn a_load_that_is_gone_is_noticed() {
    let mut rig = Rig::new(6000.0, 0.04);
    held(&mut rig, SharedLoadConfig::default(), 5.0);
    let mut law = SharedLoad::new(SharedLoadConfig::default(), &rig.hands()).unwrap();
    let load = resting(&law);
    rig.weight = 0.0;
    rig.half = 0.1;
    let lost = (0..1000).find(|_| law.step(DT, &rig.hands(), &load).unwrap().status == LoadStatus::Lost);
    assert!(lost.is_some_and(|lost| (99..=101).contains(&lost)), "{lost:?}");
}

#[test]
fn a_load_is_pressed_by_its_weight_and_slips_where_the_largest_squeeze_is_too_little() {
    let pressed = |weight: f64| {
        let mut rig = Rig { weight, ..Rig::new(6000.0, 0.04) };
        let config = SharedLoadConfig { squeeze: 10.0, most_squeeze: 40.0, ..SharedLoadConfig::default() };
        held(&mut rig, config, 10.0).1
    };
    // 1.5 m g / (2 mu), with a friction of 0.6.
    for weight in [9.81, 19.62, 29.43] {
        let last = pressed(weight);
        assert!((last.forces.squeeze - 1.25 * weight).abs() < 0.3, "{weight}: {}", last.forces.squeeze);
        assert_eq!(last.status, LoadStatus::Held);
    }
    // Without a margin, 40 N hold 48 N.
    let (heavy, too_heavy) = (pressed(45.0), pressed(52.0));
    assert!(heavy.wanted == 40.0 && heavy.status == LoadStatus::Held);
    assert_eq!(too_heavy.status, LoadStatus::Slips);
}

#[test]
fn what_is_no_input_is_refused() {
    let rig = Rig::new(6000.0, 0.04);
    let mut hands = rig.hands();
    let mut law = SharedLoad::new(SharedLoadConfig::default(), &hands).unwrap();
    let load = resting(&law);
    assert!(law.step(0.0, &hands, &load).is_err());
    hands[0].wrench[4] = f64::NAN;
    assert!(law.step(DT, &hands, &load).is_err());
    hands[0] = hands[1];
    assert!(SharedLoad::new(SharedLoadConfig::default(), &hands).is_err());
    let none = SharedLoadConfig { friction: 0.0, ..SharedLoadConfig::default() };
    assert!(SharedLoad::new(none, &rig.hands()).is_err());
}

#[test]
fn hands_that_do_not_agree_go_each_where_it_believes_the_load() {
    let rig = Rig::new(3000.0, 0.02);
    let mut law = SharedLoad::new(SharedLoadConfig::default(), &rig.hands()).unwrap();
    let rest = resting(&law);
    let higher = LinePoint { pose: Translation3::new(0.0, 0.0, 0.03) * rest.pose, ..rest };
    let mut other = law.clone();
    let agreed = law.step(DT, &rig.hands(), &rest).unwrap();
    let apart = other.step_each(DT, &rig.hands(), &[rest, higher]).unwrap();
    assert_eq!(agreed.hands[0], apart.hands[0]);
    let raised = apart.hands[1].pose.translation.vector - agreed.hands[1].pose.translation.vector;
    assert!((raised - Vector3::z() * 0.03).norm() < 1e-12, "{raised}");
    // The load's frame for a TCP that is where the load puts it is that load.
    let tcp = LinePoint { pose: rig.hands()[1].tcp, ..rest };
    assert!((law.load_of(1, &tcp).pose.translation.vector - rest.pose.translation.vector).norm() < 1e-12);
}

//! `BimanualVisualServo`: brings both hands to two grasps of one thing by observing the thing and both hands with the same cameras.
//!
//! Each hand has the law of single-handed servoing; [`in_step`] makes them arrive together. What is not in view ages, which slows the hand
//! that depends on it, and the head turns to what it has seen last. The cameras' mounting error cancels: where it shows a hand, and how it
//! turns the line between both, against the joints, is where and how it shows the thing.

use armarium_motion::{
    Holding, PositionServo, ServoCommand, ServoConfig, ServoObservation, ServoStatus, in_step,
};
use armarium_robot::{LinkId, Sensed};
use armarium_runtime::skill::{Failure, Mark, Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Unit};
use armarium_visionx::{ObjectLocalizer, ObjectStep, Sight, Sighting, StereoStep};
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};

use crate::arm::{Senses, tcp_of};
use crate::both::{BothArms, moves_both};
use crate::equipment::{self, Equipment};
use crate::grasp::{hand, marker};
use crate::head::{Head, moves_the_head};
use crate::inputs::{Inputs, seen_at, seen_pose};
use crate::motions::failed;
use crate::prior::{class_name, object_class};
use crate::skills::move_tcp::tolerances;
use crate::surface::Surface;

/// Of the thing, as much as this has to be visible: hands and what stands on it cover it.
const VISIBLE: f64 = 0.55;
/// Of a hand's marker, as much as this.
const MARKER_VISIBLE: f64 = 0.8;
/// The weight of a new detection of the thing, of a hand, and of how the mounting turns.
const WEIGHT: f64 = 0.3;
/// Where the cameras turn faster than this, rad/s, the errors of stamps count: such a frame shows no hand.
const STEADY: f64 = 0.5;
/// Both markers show how the mounting turns when they were seen within this, s.
const TOGETHER: f64 = 1.5;
/// How near to the border of the pictures something may be that is to be in view, rad.
const BORDER: f64 = 0.2;
/// A thing that is further than this from where it was, m and rad, has to be seen there this often in a row.
const JUMP: (f64, f64, u32) = (0.04, 0.1, 3);
/// What was not seen for longer than this is looked for, s.
const LOOKED_FOR: f64 = 0.4;
/// And this long ago it has just been seen, s.
const SEEN: f64 = 0.12;
/// What was not seen for longer than this is lost, s.
const LOST_AFTER: f64 = 3.0;
/// Speed of the head, rad/s.
const GAZE_SPEED: f64 = 1.5;
/// A force of this size means that a hand has met something, N.
const STOPPING_FORCE: f64 = 15.0;
/// Where the hands wait for each other they need to be this much less exact.
const WAITING: f64 = 4.0;
/// For how long both hands have to be there, in samples of 1 kHz.
const HOLD: u32 = 150;

/// The class under which the thing is observed, and those of both markers.
const THING: &str = "thing";
const HANDS: [&str; 2] = ["first hand", "second hand"];

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new(
        "BimanualVisualServo",
        "Brings both hands to two grasps of one thing, seeing the thing and both hands with the same cameras.",
    )
    .input("object", Type::object(), "The thing in memory; prior knowledge has two grasps of it.")
    .optional("over", Type::quantity(Unit::M), 0.07, "How far before their grasps the hands wait for each other.")
    .optional("look", Type::Bool, true, "False: by what memory and the joints say alone, for comparison.");
    let manifest = tolerances(manifest, 0.003, 0.03)
        .optional("timeout", Type::Duration, 25.0, "Longest time for each of the two parts.")
        .output(
            "seen_error",
            Type::quantity(Unit::M),
            "The larger distance of a hand from its grasp, as seen.",
        )
        .mark(Mark::at_start("reaching_started"))
        .mark(Mark::at_success("grasps_reached"));
    let manifest = moves_the_head(moves_both(manifest, equipment), equipment);
    equipment::skill(equipment, manifest, run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let looks = context.flag("look")?;
    let mut seen = Seen::new(&equipment, &context, looks).await?;
    let mut senses = Senses::new(&*equipment.robot, &context);
    let over = context.number("over")?;
    let motions = seen.motions(&senses.newest());
    let mut both = BothArms::take_to(&equipment, &context, &motions, Holding::Gripping).await?;
    let mut head = Head::take(&equipment, &context)?;
    let mut distance = 0.0;
    for (over, loosely) in [(over, WAITING), (0.0, 1.0)] {
        let mut servo = Servo::new(&context, loosely)?;
        distance = servo.go((&mut both, &mut head), &mut senses, &mut seen, over).await?;
    }
    Ok(Outcome::success().with("seen_error", distance))
}

/// The law of each hand.
struct Servo {
    laws: [PositionServo; 2],
}

impl Servo {
    /// Both hands are there within the tolerances times `loosely`.
    fn new(context: &SkillContext, loosely: f64) -> Result<Self, Failure> {
        let config = ServoConfig {
            position_tolerance: context.number("position_tolerance")? * loosely,
            rotation_tolerance: context.number("orientation_tolerance")? * loosely,
            // The thing may be moved while they are on their way.
            divergence: 1e9,
            timeout: context.number("timeout")?,
            max_linear: 0.12,
            hold_frames: HOLD,
            lost_after: LOST_AFTER,
            ..ServoConfig::default()
        };
        let law = || PositionServo::new(config.clone()).map_err(failed);
        Ok(Self { laws: [law()?, law()?] })
    }

    /// Servoes to `over` m before the grasps; returns the larger remaining distance, as seen.
    async fn go(
        &mut self,
        (both, head): (&mut BothArms, &mut Head),
        senses: &mut Senses,
        seen: &mut Seen,
        over: f64,
    ) -> Result<f64, Failure> {
        loop {
            let (sample, dt) = senses.next().await?;
            seen.look(&sample)?;
            head.look(&sample, dt, &seen.looks_at(&sample), GAZE_SPEED)?;
            let mut commands =
                [self.command(0, dt, &sample, seen, over)?, self.command(1, dt, &sample, seen, over)?];
            let farthest = commands.iter().map(|c| c.distance).fold(0.0, f64::max);
            if commands.iter().all(|c| c.status == ServoStatus::Converged) {
                return Ok(farthest);
            }
            in_step(&mut commands);
            let back = seen.turn.inverse();
            for (i, command) in commands.iter().enumerate() {
                if !matches!(command.status, ServoStatus::Running | ServoStatus::Converged) {
                    return Err(Failure::new(explain(command, seen.unseen())));
                }
                let arm = both.arm(i);
                let force = arm.force(&sample).map_or(0.0, |force| force.norm());
                if force > STOPPING_FORCE {
                    return Err(Failure::new(format!(
                        "`{}` met something on its way: {force:.0} N at its wrist",
                        arm.limb.name
                    )));
                }
                arm.twist(&sample, back * command.linear, back * command.angular)?;
            }
        }
    }

    fn command(
        &mut self,
        hand: usize,
        dt: f64,
        sample: &Sensed,
        seen: &Seen,
        over: f64,
    ) -> Result<ServoCommand, Failure> {
        let (observation, age) = seen.observation(hand, sample, over);
        self.laws[hand].step_aged(dt, Some((&observation, age))).map_err(failed)
    }
}

fn explain(command: &ServoCommand, unseen: &str) -> String {
    let left = command.distance * 1e3;
    match command.status {
        ServoStatus::Lost => format!("{unseen} was lost from sight while servoing"),
        ServoStatus::Diverged => {
            format!("servoing diverged: a hand moves away from its grasp ({left:.0} mm)")
        }
        _ => format!("servoing took too long: a hand is still {left:.0} mm from its grasp"),
    }
}

/// A hand, as the cameras show it.
struct SeenHand {
    tcp: LinkId,
    marker: LinkId,
    /// `tcp_from_grasp`.
    grasp: Isometry3<f64>,
    /// The thing's pose to where this hand grasps it.
    object_from_grasp: Isometry3<f64>,
    /// From where the joints say the marker is to where it was seen, m.
    shift: Vector3<f64>,
    /// When it was seen last, ns, and whether it was at all.
    at_ns: u64,
    seen: bool,
}

/// What is seen of the thing and of both hands, in the root frame as the cameras show it.
struct Seen {
    equipment: Equipment,
    /// None for one that goes by memory and joints alone.
    sight: Option<Sight>,
    object: Isometry3<f64>,
    object_at_ns: u64,
    /// How often the thing was seen elsewhere, in a row.
    elsewhere: u32,
    hands: [SeenHand; 2],
    /// Where the cameras were in the last frame, and when, ns.
    eyes: Option<(UnitQuaternion<f64>, u64)>,
    /// The hand to which the head has turned.
    turned_to: Option<usize>,
    /// The root frame as the cameras show it, from the true one: how their mounting turns it.
    turn: UnitQuaternion<f64>,
    /// The part of it that the surface under the thing shows, which is taken for level.
    tilt: UnitQuaternion<f64>,
}

impl Seen {
    async fn new(equipment: &Equipment, context: &SkillContext, looks: bool) -> Result<Self, Failure> {
        let id = context.entity("object")?;
        let snapshot = equipment.memory.latest(&id).await.map_err(failed)?;
        let object = equipment.remembered().root_pose(&snapshot);
        let object = object.ok_or_else(|| Failure::new(format!("memory does not know where `{id}` is")))?;
        let class = object_class(&*equipment.memory, class_name(&snapshot)?).await?;
        let surface = Surface::under(equipment.remembered(), &object.translation.vector.into()).await?;
        let model = equipment.robot.model();
        let sample = equipment.robot.sensed().borrow();
        let grasps: Vec<Isometry3<f64>> = class.grasps.iter().map(|grasp| grasp.pose.isometry()).collect();
        let arms: Vec<_> = model.arms().take(2).collect();
        let [first, second] = arms[..] else {
            return Err(Failure::new(format!("the robot `{}` has no two arms", model.name())));
        };
        let tcps = [tcp_of(first)?, tcp_of(second)?].map(|tcp| model.link_pose(&sample.position, tcp));
        let [one, other] = nearest_pair(&object, &grasps, &tcps).ok_or_else(|| {
            Failure::new(format!("prior knowledge has no two grasps of `{}`: one for each hand", class.name))
        })?;
        let seen_hand = |limb, object_from_grasp| -> Result<SeenHand, Failure> {
            Ok(SeenHand {
                tcp: tcp_of(limb)?,
                marker: marker(model, limb)?.link,
                grasp: hand(model, limb)?.grasp_in_tcp,
                object_from_grasp,
                shift: Vector3::zeros(),
                at_ns: sample.stamp_ns,
                seen: false,
            })
        };
        let hands = [seen_hand(first, one)?, seen_hand(second, other)?];
        let localizer = ObjectLocalizer::new(equipment.images.calibration(), class.size, class.color);
        let mut steps: Vec<Box<dyn StereoStep>> =
            vec![Box::new(ObjectStep::new(localizer.standing_on(surface.rotation()), THING))];
        for (limb, name) in [first, second].into_iter().zip(HANDS) {
            let marker = marker(model, limb)?;
            steps.push(Box::new(equipment.track(marker.color, Some(marker.diameter), name)));
        }
        let tilt = if looks { surface.rotation() } else { UnitQuaternion::identity() };
        Ok(Self {
            sight: looks.then(|| equipment.look(steps)),
            equipment: equipment.clone(),
            object,
            object_at_ns: sample.stamp_ns,
            elsewhere: 0,
            hands,
            eyes: None,
            turned_to: None,
            turn: tilt,
            tilt,
        })
    }

    /// From where the hands are to where they grasp, root frame, m.
    fn motions(&self, sample: &Sensed) -> [Vector3<f64>; 2] {
        [0, 1].map(|i| {
            let (seen, _) = self.observation(i, sample, 0.0);
            seen.target.translation.vector - seen.hand.translation.vector
        })
    }

    fn link(&self, sample: &Sensed, link: LinkId) -> Isometry3<f64> {
        self.equipment.robot.model().link_pose(&sample.position, link)
    }

    /// Takes over what the newest frame shows, if there is one.
    fn look(&mut self, sample: &Sensed) -> Result<(), Failure> {
        let Some(sight) = &mut self.sight else {
            self.object_at_ns = sample.stamp_ns;
            self.hands.iter_mut().for_each(|hand| hand.at_ns = sample.stamp_ns);
            return Ok(());
        };
        let Some(frame) = sight.newest().map_err(failed)? else { return Ok(()) };
        let eyes = frame.root_from_left.rotation;
        let (before, at) = self.eyes.replace((eyes, frame.stamp_ns)).unwrap_or((eyes, frame.stamp_ns));
        let passed = frame.stamp_ns.saturating_sub(at).max(1) as f64 * 1e-9;
        self.look_for_object(&frame);
        if eyes.angle_to(&before) > STEADY * passed {
            return Ok(());
        }
        let mut markers = [Vector3::zeros(); 2];
        for (i, name) in HANDS.into_iter().enumerate() {
            let hand = &mut self.hands[i];
            markers[i] = self.equipment.link_at(hand.marker, frame.stamp_ns)?.translation.vector;
            let place =
                frame.of_class(name).filter(|seen| seen.confidence > MARKER_VISIBLE).and_then(seen_at);
            let Some(place) = place else { continue };
            let weight = if hand.seen { WEIGHT } else { 1.0 };
            hand.shift += (place.coords - markers[i] - hand.shift) * weight;
            (hand.at_ns, hand.seen) = (frame.stamp_ns, true);
        }
        let old = |hand: &SeenHand| frame.stamp_ns.saturating_sub(hand.at_ns) as f64 * 1e-9 > TOGETHER;
        if !self.hands.iter().any(|hand| !hand.seen || old(hand)) {
            let seen = (markers[0] + self.hands[0].shift) - (markers[1] + self.hands[1].shift);
            let about = turned(&(self.tilt.inverse() * seen), &(markers[0] - markers[1]));
            let turn = self.tilt * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), about);
            self.turn = self.turn.slerp(&turn, WEIGHT);
        }
        Ok(())
    }

    fn look_for_object(&mut self, frame: &Sighting) {
        let thing = frame.of_class(THING).filter(|thing| thing.confidence > VISIBLE);
        let Some(mut seen) = thing.and_then(seen_pose) else { return };
        // A box looks the same after half a turn.
        let half =
            UnitQuaternion::from_axis_angle(&(seen.rotation * Vector3::z_axis()), std::f64::consts::PI);
        if (half * seen.rotation).angle_to(&self.object.rotation)
            < seen.rotation.angle_to(&self.object.rotation)
        {
            seen.rotation = half * seen.rotation;
        }
        let step = seen.translation.vector - self.object.translation.vector;
        let (near, straight, often) = JUMP;
        let jumps = step.norm() > near || seen.rotation.angle_to(&self.object.rotation) > straight;
        self.elsewhere = if jumps { self.elsewhere + 1 } else { 0 };
        if jumps && self.elsewhere < often {
            return;
        }
        let weight = if jumps { 1.0 } else { WEIGHT };
        self.object.translation.vector += step * weight;
        self.object.rotation = self.object.rotation.slerp(&seen.rotation, weight);
        self.object_at_ns = frame.stamp_ns;
    }

    /// A hand and where it shall be, `over` m before its grasp, and the age of what was seen of either, s.
    fn observation(&self, i: usize, sample: &Sensed, over: f64) -> (ServoObservation, f64) {
        let own = &self.hands[i];
        let (tcp, marker) = (self.link(sample, own.tcp), self.link(sample, own.marker).translation.vector);
        let from_marker = self.turn * (tcp.translation.vector - marker);
        let hand = Isometry3::from_parts((marker + own.shift + from_marker).into(), self.turn * tcp.rotation);
        let grasp = self.object * own.object_from_grasp;
        let back = grasp.rotation * Vector3::x() * -over;
        let mut target = grasp * own.grasp.inverse();
        target.translation.vector += back;
        let age = sample.stamp_ns.saturating_sub(own.at_ns.min(self.object_at_ns)) as f64 * 1e-9;
        // A hand that was never seen stays until it is.
        let age = if own.seen || self.sight.is_none() { age } else { LOST_AFTER };
        (ServoObservation { hand, target }, age)
    }

    /// Where to look: at the middle of everything where that has all in view, else to the hand that has not been seen for longest.
    fn looks_at(&mut self, sample: &Sensed) -> Point3<f64> {
        let hand =
            |i: usize| self.link(sample, self.hands[i].marker).translation.vector + self.hands[i].shift;
        let hands = [hand(0), hand(1)];
        let middle = (hands[0] + hands[1] + self.object.translation.vector) / 3.0;
        let model = self.equipment.robot.model();
        let Some(eye) = model.camera().map(|camera| self.link(sample, camera.left).translation.vector) else {
            return middle.into();
        };
        let [wide, _] = self.equipment.images.calibration().camera.half_angles();
        if hands.iter().all(|hand| (hand - eye).angle(&(middle - eye)) < wide - BORDER) {
            self.turned_to = None;
            return middle.into();
        }
        // Between a hand and the thing, both are in view.
        let beside = |i: usize| (hands[i] + self.object.translation.vector) / 2.0;
        let age = |i: usize| sample.stamp_ns.saturating_sub(self.hands[i].at_ns) as f64 * 1e-9;
        let oldest = if age(0) > age(1) { 0 } else { 1 };
        // What it has turned to it looks at until it has seen that.
        if self.turned_to.is_none_or(|hand| age(hand) < SEEN) {
            self.turned_to = (age(oldest) > LOOKED_FOR).then_some(oldest);
        }
        self.turned_to.map_or(middle, beside).into()
    }

    /// What was not seen for longest.
    fn unseen(&self) -> &'static str {
        let [first, second] = [0, 1].map(|i| self.hands[i].at_ns);
        if self.object_at_ns <= first.min(second) {
            "the thing"
        } else if first <= second {
            "the first hand's marker"
        } else {
            "the second hand's marker"
        }
    }
}

/// The turn about the vertical from one direction to another, rad, as seen from above; the first one is the seen one.
fn turned(seen: &Vector3<f64>, felt: &Vector3<f64>) -> f64 {
    let turn = seen.y.atan2(seen.x) - felt.y.atan2(felt.x);
    turn.sin().atan2(turn.cos())
}

/// The two grasps of a thing that are nearest to both hands, for each of them one.
fn nearest_pair(
    object: &Isometry3<f64>,
    grasps: &[Isometry3<f64>],
    tcps: &[Isometry3<f64>; 2],
) -> Option<[Isometry3<f64>; 2]> {
    let far = |hand: usize, i: usize| {
        let grasp = object * grasps[i];
        (grasp.translation.vector - tcps[hand].translation.vector).norm()
    };
    let pairs =
        (0..grasps.len()).flat_map(|i| (0..grasps.len()).map(move |k| (i, k))).filter(|(i, k)| i != k);
    let nearest = pairs.min_by(|a, b| {
        let sum = |(i, k): &(usize, usize)| far(0, *i) + far(1, *k);
        sum(a).total_cmp(&sum(b))
    });
    nearest.map(|(i, k)| [grasps[i], grasps[k]])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_hand_takes_the_grasp_on_its_side() {
        let at = |x: f64| Isometry3::translation(x, 0.0, 0.06);
        let object = Isometry3::translation(0.05, 0.45, 0.95);
        let hands = [Isometry3::translation(0.42, 0.4, 1.1), Isometry3::translation(-0.42, 0.4, 1.1)];
        let found = nearest_pair(&object, &[at(-0.3), at(0.0), at(0.3)], &hands).unwrap();
        assert_eq!(found, [at(0.3), at(-0.3)]);
        assert!(nearest_pair(&object, &[at(0.3)], &hands).is_none(), "one grasp is not enough");
    }

    #[test]
    fn a_turn_is_the_shortest() {
        let direction = |angle: f64| Vector3::new(angle.cos(), angle.sin(), 0.3);
        assert!((turned(&direction(3.1), &direction(-3.1)) + 0.083_185_307).abs() < 1e-6);
        assert!((turned(&direction(0.2), &direction(0.1)) - 0.1).abs() < 1e-12);
    }
}

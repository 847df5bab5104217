//! What is seen of one thing and of both hands that go to it, as `BimanualVisualServo` needs it.
//!
//! A hand goes by pictures that show its marker and the thing at once: there the errors of the cameras' mounting and of the arm's joints
//! cancel. Rarely are both hands in one picture. So each hand has its own idea of where the thing is, in the frame in which its joints
//! say where it is itself, and the head looks at both hands in turns. What the mounting turns does not cancel; it is found on the way
//! ([`CameraMounting`]).

use armarium_motion::{CameraMounting, MarkerView, ServoObservation};
use armarium_robot::{LinkId, Sensed};
use armarium_runtime::skill::{Failure, SkillContext};
use armarium_visionx::{ObjectLocalizer, ObjectStep, Sight, Sighting, StereoStep};
use nalgebra::{Isometry3, Point3, Translation3, Unit, UnitQuaternion, Vector3};
use tokio::sync::watch;

use crate::arm::{seconds, tcp_of};
use crate::both::arms;
use crate::equipment::Equipment;
use crate::grasp::{hand, marker};
use crate::inputs::{Inputs, seen_at, seen_pose};
use crate::motions::failed;
use crate::surface::ContactPlane;

/// Of the thing, as much as this has to be visible: hands and what stands on it cover it.
const VISIBLE: f64 = 0.35;
/// Of a hand's marker, as much as this: one that an eye sees less of than the other seems to be further away, by up to 20 mm.
const MARKER_VISIBLE: f64 = 0.99;
/// The weight of a new detection.
const WEIGHT: f64 = 0.3;
/// Where the cameras turn faster than this, rad/s, the errors of stamps count: such a frame shows no hand.
const STEADY: f64 = 0.5;
/// How near to the border of the pictures something may be that is to be in view, rad.
const BORDER: f64 = 0.2;
/// A thing that is further than this from where it was, m and rad, has to be seen there this often in a row.
const JUMP: (f64, f64, u32) = (0.015, 0.06, 3);
/// What was not seen for longer than this is looked for, s.
const LOOKED_FOR: f64 = 0.4;
/// And this long ago it has just been seen, s.
const SEEN: f64 = 0.12;
/// What was not seen for longer than this is lost, s.
pub(crate) const LOST_AFTER: f64 = 3.0;
/// After so long without a picture of both, a hand goes by pictures that show only its marker, too, s.
const APART_FOR: f64 = 1.5;
/// A hand is in view when it is this far from the border of the left picture, rad: its marker is in the right one then, too. While the
/// mounting is not known, it has to be further.
const IN_VIEW: [f64; 2] = [0.25, 0.21];
/// Between the thing and a hand, so many places to look at are tried.
const PLACES: usize = 20;

/// The class under which the thing is observed, and those of both markers.
const THING: &str = "thing";
const HANDS: [&str; 2] = ["first hand", "second hand"];

/// A hand, and where it believes the thing to be.
struct SeenHand {
    tcp: LinkId,
    marker: LinkId,
    /// `tcp_from_grasp`.
    grasp: Isometry3<f64>,
    /// The thing's pose to where this hand grasps it.
    object_from_grasp: Isometry3<f64>,
    /// The thing's pose, root frame of the hand's joints; none before one picture has shown both.
    object: Option<Isometry3<f64>>,
    /// When a picture showed both, ns, and how often it showed the thing elsewhere, in a row.
    at_ns: u64,
    elsewhere: u32,
    /// When its marker was seen, ns.
    marker_at_ns: u64,
}

impl SeenHand {
    /// Whether no picture has shown both it and the thing for long.
    fn far(&self, now_ns: u64) -> bool {
        self.object.is_none() || seconds(self.at_ns, now_ns) > APART_FOR
    }
}

/// What is seen of the thing and of both hands.
pub(crate) struct BothSeen {
    equipment: Equipment,
    /// None for one that goes by memory and joints alone.
    sight: Option<Sight>,
    mounting: CameraMounting,
    /// Tells who follows the thing how the cameras are mounted.
    mounting_told: watch::Sender<Isometry3<f64>>,
    /// The thing's pose (root frame), and when it was seen, ns.
    object: Isometry3<f64>,
    object_at_ns: u64,
    hands: [SeenHand; 2],
    /// Where the cameras were in the last frame, and when, ns.
    eyes: Option<(UnitQuaternion<f64>, u64)>,
    /// The hand to which the head has turned.
    turned_to: Option<usize>,
}

impl BothSeen {
    /// Of the thing that the input `object` names. The surface on which it stands in memory is the first that is seen of the mounting.
    pub(crate) async fn new(
        equipment: &Equipment,
        context: &SkillContext,
        looks: bool,
    ) -> Result<Self, Failure> {
        let (class, shown) = equipment.remembered().thing(&context.entity("object")?).await?;
        let surface = ContactPlane::under(equipment.remembered(), &shown.translation.vector.into()).await?;
        let model = equipment.robot.model();
        let sample = equipment.robot.sensed().borrow();
        let left = model.camera().map(|camera| model.link_pose(&sample.position, camera.left));
        let left = left.unwrap_or_default();
        let mut mounting = CameraMounting::default();
        if looks {
            mounting.see_surface(&left, &surface.normal()).map_err(failed)?;
        }
        let object = mounting.from_shown(&left) * shown;
        let [first, second] = arms(model)?;
        let grasps: Vec<Isometry3<f64>> = class.grasps.iter().map(|grasp| grasp.pose.isometry()).collect();
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
                object: (!looks).then_some(object),
                at_ns: sample.stamp_ns,
                elsewhere: 0,
                marker_at_ns: sample.stamp_ns,
            })
        };
        let hands = [seen_hand(first, one)?, seen_hand(second, other)?];
        let localizer = ObjectLocalizer::new(equipment.images.calibration(), class.size, class.color);
        let localizer = localizer.standing_on(surface.rotation());
        let mounting_told = watch::Sender::new(mounting.believed_from_camera());
        let step = ObjectStep::new(localizer, THING).with_table(equipment.images.calibration().camera);
        let step = step.following(shown, left, mounting_told.subscribe());
        let mut steps: Vec<Box<dyn StereoStep>> = vec![Box::new(step)];
        for (limb, name) in [first, second].into_iter().zip(HANDS) {
            let marker = marker(model, limb)?;
            steps.push(Box::new(equipment.track(marker.color, Some(marker.diameter), name)));
        }
        Ok(Self {
            sight: looks.then(|| equipment.look(steps)),
            equipment: equipment.clone(),
            mounting,
            mounting_told,
            object,
            object_at_ns: sample.stamp_ns,
            hands,
            eyes: None,
            turned_to: None,
        })
    }

    /// From where the hands are to where they grasp, root frame, m.
    pub(crate) fn motions(&self, sample: &Sensed) -> [Vector3<f64>; 2] {
        [0, 1].map(|i| {
            let (seen, _) = self.observation(i, sample, 0.0);
            seen.target.translation.vector - seen.hand.translation.vector
        })
    }

    fn link(&self, sample: &Sensed, link: LinkId) -> Isometry3<f64> {
        self.equipment.robot.model().link_pose(&sample.position, link)
    }

    /// Takes over what the newest frame shows, if there is one.
    pub(crate) fn look(&mut self) -> Result<(), Failure> {
        let Some(sight) = &mut self.sight else { return Ok(()) };
        let Some(frame) = sight.newest().map_err(failed)? else { return Ok(()) };
        let eyes = frame.root_from_left.rotation;
        let (before, at) = self.eyes.replace((eyes, frame.stamp_ns)).unwrap_or((eyes, frame.stamp_ns));
        let passed = seconds(at, frame.stamp_ns).max(1e-9);
        let steady = eyes.angle_to(&before) <= STEADY * passed;
        let mut shifts = [None; 2];
        if steady {
            shifts = self.look_for_hands(&frame)?;
        }
        if let Some(table) = frame.of_class("table").and_then(seen_pose) {
            let up = Unit::new_normalize(table.rotation * Vector3::z());
            self.mounting.see_surface(&frame.root_from_left, &up).map_err(failed)?;
        }
        self.mounting_told.send_replace(self.mounting.believed_from_camera());
        let from_shown = self.mounting.from_shown(&frame.root_from_left);
        let object = self.look_for_object(&frame, &from_shown);
        for (i, shift) in shifts.into_iter().enumerate() {
            // What the mounting turns is known when both markers have been seen.
            let Some([shown, there]) = shift.filter(|_| self.mounting.known()) else { continue };
            let shift = Translation3::from(there - from_shown * shown);
            // From far away a hand also goes by a thing that only another picture shows.
            match object {
                Some(object) => self.takes(i, shift * object, frame.stamp_ns),
                None if self.hands[i].far(frame.stamp_ns) => {
                    self.takes(i, shift * self.object, self.object_at_ns)
                }
                None => {}
            }
        }
        Ok(())
    }

    /// Where the frame shows each marker, and where the joints say that it is.
    fn look_for_hands(&mut self, frame: &Sighting) -> Result<[Option<[Point3<f64>; 2]>; 2], Failure> {
        let mut found = [None; 2];
        for (i, name) in HANDS.into_iter().enumerate() {
            let place =
                frame.of_class(name).filter(|seen| seen.confidence > MARKER_VISIBLE).and_then(seen_at);
            let Some(shown) = place else { continue };
            let marker = self.equipment.link_at(self.hands[i].marker, frame.stamp_ns)?;
            let there = Point3::from(marker.translation.vector);
            let view = MarkerView {
                at: frame.stamp_ns as f64 * 1e-9,
                root_from_camera: frame.root_from_left,
                in_camera: frame.root_from_left.inverse() * shown,
                in_root: there,
            };
            self.mounting.see(i, view).map_err(failed)?;
            self.hands[i].marker_at_ns = frame.stamp_ns;
            found[i] = Some([shown, there]);
        }
        Ok(found)
    }

    /// The thing's pose as the frame shows it with the mounting as it is known (root frame).
    fn look_for_object(&mut self, frame: &Sighting, from_shown: &Isometry3<f64>) -> Option<Isometry3<f64>> {
        let thing = frame.of_class(THING).filter(|thing| thing.confidence > VISIBLE);
        let mut seen = from_shown * thing.and_then(seen_pose)?;
        // A box looks the same after half a turn.
        let half =
            UnitQuaternion::from_axis_angle(&(seen.rotation * Vector3::z_axis()), std::f64::consts::PI);
        if (half * seen.rotation).angle_to(&self.object.rotation)
            < seen.rotation.angle_to(&self.object.rotation)
        {
            seen.rotation = half * seen.rotation;
        }
        self.object = seen;
        self.object_at_ns = frame.stamp_ns;
        Some(seen)
    }

    /// A hand takes over that one picture shows it and the thing at `object`. When that has moved, the other hand has to see it, too.
    fn takes(&mut self, i: usize, object: Isometry3<f64>, at_ns: u64) {
        let own = &mut self.hands[i];
        let Some(known) = own.object else {
            (own.object, own.at_ns, own.elsewhere) = (Some(object), at_ns, 0);
            return;
        };
        let (near, straight, often) = JUMP;
        let step = object.translation.vector - known.translation.vector;
        let jumps = step.norm() > near || object.rotation.angle_to(&known.rotation) > straight;
        own.elsewhere = if jumps { own.elsewhere + 1 } else { 0 };
        if jumps && own.elsewhere < often {
            return;
        }
        let weight = if jumps { 1.0 } else { WEIGHT };
        let rotation = known.rotation.slerp(&object.rotation, weight);
        let place = known.translation.vector + step * weight;
        (own.object, own.at_ns, own.elsewhere) =
            (Some(Isometry3::from_parts(place.into(), rotation)), at_ns, 0);
        let other = &mut self.hands[1 - i];
        if jumps && other.at_ns < at_ns {
            other.object = None;
        }
    }

    /// A hand and where it shall be, `over` m before its grasp, and the age of what was seen of either, s.
    pub(crate) fn observation(&self, i: usize, sample: &Sensed, over: f64) -> (ServoObservation, f64) {
        let own = &self.hands[i];
        let hand = self.link(sample, own.tcp);
        let grasp = own.object.unwrap_or(self.object) * own.object_from_grasp;
        let back = Translation3::from(grasp.rotation * Vector3::x() * -over);
        let target = back * (grasp * own.grasp.inverse());
        let age = match (&self.sight, own.object) {
            (None, _) => 0.0,
            (Some(_), Some(_)) => seconds(own.at_ns, sample.stamp_ns),
            // A hand that does not know where the thing is stays until it does.
            (Some(_), None) => LOST_AFTER,
        };
        (ServoObservation { hand, target }, age)
    }

    /// Where to look: at the middle of everything where that has all in view, else to the hand that has not been seen for longest; as the
    /// cameras show it, root frame.
    pub(crate) fn looks_at(&mut self, sample: &Sensed) -> Point3<f64> {
        let hands = [0, 1].map(|i| self.link(sample, self.hands[i].marker).translation.vector);
        let object = self.object.translation.vector;
        let middle = (hands[0] + hands[1] + object) / 3.0;
        let model = self.equipment.robot.model();
        let Some(left) = model.camera().map(|camera| self.link(sample, camera.left)) else {
            return middle.into();
        };
        let shown = |place: Vector3<f64>| self.mounting.from_shown(&left).inverse() * Point3::from(place);
        let eye = left.translation.vector;
        let [wide, _] = self.equipment.images.calibration().camera.half_angles();
        if hands.iter().all(|hand| (hand - eye).angle(&(middle - eye)) < wide - BORDER) {
            self.turned_to = None;
            return shown(middle);
        }
        let age = |i: usize| seconds(self.hands[i].marker_at_ns, sample.stamp_ns);
        let oldest = if age(0) > age(1) { 0 } else { 1 };
        // What it has turned to it looks at until it has seen that.
        if self.turned_to.is_none_or(|hand| age(hand) < SEEN) {
            self.turned_to = (age(oldest) > LOOKED_FOR).then_some(oldest);
        }
        // As near to the thing as a hand is still in view.
        let margin = IN_VIEW[usize::from(self.mounting.known())];
        let beside = |i: usize| {
            let between = |k: usize| object + (hands[i] - object) * (k as f64 / PLACES as f64);
            let shows = |place: &Vector3<f64>| (hands[i] - eye).angle(&(place - eye)) < wide - margin;
            (0..=PLACES).map(between).find(shows).unwrap_or(hands[i])
        };
        shown(self.turned_to.map_or(middle, beside))
    }

    /// The upward normal of the surface on which the thing stands, root frame.
    pub(crate) fn surface_up(&self) -> Vector3<f64> {
        self.mounting.surface_up().into_inner()
    }

    /// What was not seen for longest.
    pub(crate) fn unseen(&self) -> &'static str {
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
}

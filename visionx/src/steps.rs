//! The trackers as processors: a [`StereoStep`] works on one provider of stereo pairs, and [`OfStereo`] turns it
//! into an [`ImageProcessor`]. What a tracker finds is said here, once, as observations for memory.

use std::collections::BTreeMap;
use std::sync::Arc;

use armarium_values::{Frame, Observation, ObservedPlace, Pose, Search, Shown, Value, Vector};
use nalgebra::{Isometry3, Matrix3, Point3, Unit, UnitQuaternion, Vector3};
use tokio::sync::watch;

use crate::annotate;
use crate::camera::{PinholeCamera, StereoCalibration};
use crate::frame::{ImageError, RgbImage, StereoFrame};
use crate::localizer::{ObjectEstimate, ObjectLocalizer};
use crate::marker::{ColorMarkerObjectTracking, MarkerEstimate};
use crate::processor::{ImageProcessor, Seen};
use crate::providers::{RawFrame, StereoPair};
use crate::tabletop::{TableEstimate, Tabletop, TabletopSegmentation};
use crate::tracking::hand::{Gesture, GestureOverTime, HandObservation, HandObserver, ShownGesture};
use crate::tracking::{FingerTipTracking, TrackedFingertip};

/// The frame of the left camera in what a step observes.
const CAMERA: &str = "camera";
/// Variance of a palm's position along each axis, m²: the observer gives none, and the palm's centre is known to
/// about 1 cm.
const PALM: f64 = 1e-4;
/// Variance of the middle of a table's visible part along each axis, m².
pub(crate) const TABLE: f64 = 1e-4;
/// Core segments.
pub(crate) const OBJECTS: &str = "ObjectInstances";
const HANDS: &str = "HumanHands";
pub(crate) const ENVIRONMENT: &str = "EnvironmentModels";

/// A processor of one provider of stereo pairs. A new one is a type with this trait, in any crate: see `examples/brightest.rs`.
pub trait StereoStep: Send {
    /// Its name.
    fn name(&self) -> &str;
    /// What a frame lacks for this step, as a message for people; `None` when it is complete.
    fn missing_input(&self, _frame: &RawFrame) -> Option<String> {
        None
    }
    /// What it finds wherever it is in view: core segments and classes. That it did not find such a thing where it is known to be
    /// speaks against it.
    fn looks_for(&self) -> Vec<(String, String)> {
        Vec::new()
    }
    /// Half the largest edge of what it looks for, m; 0 where that is not known.
    fn reach(&self) -> f64 {
        0.0
    }
    /// Processes a frame. Places are in the frame `camera` of the left camera, or in `root` as the frame's `root_from_left` says.
    fn step(&mut self, frame: &StereoFrame) -> Vec<Observation>;
    /// Draws what it saw in the last frame into its left image.
    fn draw(&self, image: &mut RgbImage);
}

/// Several processors of the same frames, one after the other.
impl StereoStep for Vec<Box<dyn StereoStep>> {
    fn name(&self) -> &str {
        self.first().map_or("", |step| step.name())
    }

    fn missing_input(&self, frame: &RawFrame) -> Option<String> {
        self.iter().find_map(|step| step.missing_input(frame))
    }

    fn looks_for(&self) -> Vec<(String, String)> {
        self.iter().flat_map(|step| step.looks_for()).collect()
    }

    fn reach(&self) -> f64 {
        self.iter().map(|step| step.reach()).fold(0.0, f64::max)
    }

    fn step(&mut self, frame: &StereoFrame) -> Vec<Observation> {
        self.iter_mut().flat_map(|step| step.step(frame)).collect()
    }

    fn draw(&self, image: &mut RgbImage) {
        self.iter().for_each(|step| step.draw(image));
    }
}

/// What a step observes in a frame, with all places in `frame_of_root`, the frame of its `root_from_left`.
pub(crate) fn observations_of(
    step: &mut dyn StereoStep,
    frame: &StereoFrame,
    frame_of_root: &Frame,
) -> Vec<Observation> {
    let (camera, root) = (Frame::from(CAMERA), Frame::root());
    let moved = |seen: Observation| {
        let seen = seen.moved(&camera, &root, &frame.root_from_left);
        match *frame_of_root == root {
            true => seen,
            false => seen.moved(&root, frame_of_root, &Isometry3::identity()),
        }
    };
    step.step(frame).into_iter().map(moved).collect()
}

/// Nearer to the border of an image than this, px, a thing may be cut off.
const BORDER: f64 = 20.0;
/// What is measured nearer than a place by more than this, m, is before it.
const BEFORE: f64 = 0.05;

/// That a step has looked at a frame of these cameras, in the root frame; `None` where it looks for nothing.
///
/// A place is open where a whole thing would be in both pictures with nothing before its middle or its sides, as far as depth tells.
pub(crate) fn search_of(
    step: &dyn StereoStep,
    frame: &Arc<StereoFrame>,
    calibration: &StereoCalibration,
) -> Option<Search> {
    let (classes, reach) = (step.looks_for(), step.reach());
    if classes.is_empty() {
        return None;
    }
    let (shown, StereoCalibration { camera, baseline }) = (Arc::clone(frame), *calibration);
    let view = move |place: &Point3<f64>| {
        let in_left = shown.root_from_left.inverse() * place;
        let Some(px) = camera.project(&in_left).filter(|_| in_left.z > 0.0) else { return Shown::Outside };
        let (width, height) = (f64::from(camera.width), f64::from(camera.height));
        let (half, between) = (camera.focal * reach / in_left.z, camera.focal * baseline / in_left.z);
        let border = BORDER.max(half);
        let (left, right) = (border + between, width - border);
        if px.x < left || px.x > right || px.y < border || px.y > height - border {
            return Shown::Outside;
        }
        let nearer = |x: f64, y: f64, unmeasured: bool| match shown.depth.as_ref() {
            Some(depth) => match depth.at((px.x + x) as u32, (px.y + y) as u32) {
                0.0 => unmeasured,
                depth => f64::from(depth) < in_left.z - BEFORE,
            },
            None => false,
        };
        // Along its edges depth is often not measured, which says nothing.
        let beside = [(half, 0.0), (-half, 0.0), (0.0, half), (0.0, -half)];
        match nearer(0.0, 0.0, true) || beside.iter().any(|&(x, y)| nearer(x, y, false)) {
            true => Shown::Hidden,
            false => Shown::Open,
        }
    };
    Some(Search::new(frame.stamp_ns, classes, &Frame::root(), view))
}

/// Turns a [`StereoStep`] into an [`ImageProcessor`].
pub struct OfStereo<S> {
    step: S,
    pair: StereoPair,
}

impl<S: StereoStep> OfStereo<S> {
    /// A processor of these pairs; `step` was made with their calibration.
    pub fn new(step: S, pair: StereoPair) -> Self {
        Self { step, pair }
    }
}

impl<S: StereoStep> ImageProcessor for OfStereo<S> {
    fn name(&self) -> &str {
        self.step.name()
    }

    fn process(&mut self, frames: &[Arc<RawFrame>]) -> Result<Seen, ImageError> {
        let [frame, ..] = frames else {
            return Err(ImageError::Spoilt { provider: self.name().into(), what: "no frame".into() });
        };
        if let Some(what) = self.step.missing_input(frame) {
            return Err(ImageError::Spoilt { provider: self.pair.provider().into(), what });
        }
        // A provider that does not say where its camera is observes in its own frame.
        let frame_of_root = match frame.root_from_camera {
            Some(_) => Frame::root(),
            None => Frame(frame.frame_id.clone()),
        };
        let pair = Arc::new(self.pair.frame(frame)?);
        let observations = observations_of(&mut self.step, &pair, &frame_of_root);
        let search = search_of(&self.step, &pair, &self.pair.calibration());
        Ok(Seen { observations, search: search.filter(|_| frame.root_from_camera.is_some()) })
    }

    fn annotated(&self, frames: &[Arc<RawFrame>]) -> Option<RgbImage> {
        let mut image = RgbImage::clone(&self.pair.frame(frames.first()?).ok()?.left);
        self.step.draw(&mut image);
        Some(image)
    }
}

fn in_camera(point: &Point3<f64>, covariance: &Matrix3<f64>) -> ObservedPlace {
    ObservedPlace::new(&Frame::from(CAMERA), &point.coords, covariance)
}

fn vector(v: Vector3<f64>) -> Value {
    Value::Vector(Vector::new(Frame::from(CAMERA), &v))
}

/// A level surface as it is observed, of this class.
pub(crate) fn level_seen(class: &str, surface: &TableEstimate, stamp_ns: u64) -> Observation {
    let covariance = Matrix3::identity() * TABLE;
    posed((ENVIRONMENT, class), stamp_ns, &surface.root_from_table, &covariance)
        .with("size", [surface.size[0], surface.size[1], 0.0])
}

/// What has a pose in the root frame, where its place has this covariance, m².
pub(crate) fn posed(
    (segment, class): (&str, &str),
    stamp_ns: u64,
    pose: &Isometry3<f64>,
    covariance: &Matrix3<f64>,
) -> Observation {
    Observation::new(segment, class, stamp_ns)
        .at(ObservedPlace::new(&Frame::root(), &pose.translation.vector, covariance))
        .with("pose", Value::Pose(Pose::new(Frame::root(), pose)))
}

/// A person's hand as `HumanHands/.../hand`, with its `gesture` in this frame, `none` without a hand, and what it has `shown` clearly
/// and for how long.
pub struct HandStep {
    observer: HandObserver,
    over_time: GestureOverTime,
    last: Option<HandObservation>,
}

impl HandStep {
    /// The step around an observer.
    pub fn new(observer: HandObserver) -> Self {
        Self { observer, over_time: GestureOverTime::default(), last: None }
    }
}

impl StereoStep for HandStep {
    fn name(&self) -> &str {
        "hand"
    }

    fn step(&mut self, frame: &StereoFrame) -> Vec<Observation> {
        self.last = self.observer.update(frame);
        let shown = self.over_time.update(frame.stamp_ns, self.last.as_ref(), &frame.root_from_left);
        let observation = Observation::new(HANDS, "hand", frame.stamp_ns).with("shown", said(shown));
        let Some(hand) = &self.last else { return vec![observation.with("gesture", "none")] };
        let tips = hand.fingertips.iter().filter_map(|tip| tip.in_left);
        let seen = observation
            .at(in_camera(&hand.palm_in_left, &(Matrix3::identity() * PALM)))
            .with_confidence(hand.confidence)
            .with("gesture", hand.gesture.name())
            .with("hidden", hand.hidden)
            .with("fingertips", tips.map(|tip| vector(tip.coords)).collect::<Vec<_>>());
        vec![match hand.pointing {
            Some(direction) => seen.with("direction", vector(direction)),
            None => seen,
        }]
    }

    fn draw(&self, image: &mut RgbImage) {
        self.last.iter().for_each(|hand| annotate::hand(image, hand));
    }
}

/// Where something is expected at a time (ns): in the root frame, m.
type Expected = Box<dyn Fn(u64) -> Option<Point3<f64>> + Send>;

/// What a hand has shown, as an attribute.
fn said(shown: &ShownGesture) -> Value {
    let in_root = |v: Vector3<f64>| Value::Vector(Vector::new(Frame::root(), &v));
    let mut fields = BTreeMap::from([
        ("gesture".to_owned(), Value::from(shown.gesture.map_or("none", Gesture::name))),
        ("for".to_owned(), Value::Float(shown.for_s)),
    ]);
    fields.extend(shown.palm.map(|palm| ("position".to_owned(), in_root(palm.coords))));
    fields.extend(shown.direction.map(|direction| ("direction".to_owned(), in_root(direction))));
    fields.extend(shown.seen_at.map(|palm| ("seen_at".to_owned(), in_root(palm.coords))));
    Value::Map(fields)
}

/// A thing of one colour, as `ObjectInstances` of its class. One that is not seen is not observed.
pub struct MarkerStep {
    tracking: ColorMarkerObjectTracking,
    class: String,
    expected: Option<Expected>,
    last: Option<MarkerEstimate>,
}

impl MarkerStep {
    /// The step around a tracker of a thing of this class.
    pub fn new(tracking: ColorMarkerObjectTracking, class: &str) -> Self {
        Self { tracking, class: class.into(), expected: None, last: None }
    }

    /// The same for a level box of these edge lengths, m ([`ColorMarkerObjectTracking::of_level_box`]).
    #[must_use]
    pub fn of_level_box(self, size: impl Into<Vector3<f64>>) -> Self {
        Self { tracking: self.tracking.of_level_box(size), ..self }
    }

    /// The same for a thing that is expected at a place: among several of its colour, the nearest one is followed.
    #[must_use]
    pub fn expected_at(mut self, place: impl Fn(u64) -> Option<Point3<f64>> + Send + 'static) -> Self {
        self.expected = Some(Box::new(place));
        self
    }
}

impl StereoStep for MarkerStep {
    fn name(&self) -> &str {
        "marker"
    }

    fn looks_for(&self) -> Vec<(String, String)> {
        vec![(OBJECTS.into(), self.class.clone())]
    }

    fn step(&mut self, frame: &StereoFrame) -> Vec<Observation> {
        let expected = self.expected.as_ref().and_then(|place| place(frame.stamp_ns));
        let in_left = expected.map(|place| frame.root_from_left.inverse() * place);
        self.last = self.tracking.update(frame, in_left.as_ref());
        let seen = |marker: &MarkerEstimate| {
            Observation::new(OBJECTS, &self.class, frame.stamp_ns)
                .at(in_camera(&marker.point_in_left, &marker.covariance))
                .with_confidence(marker.visible)
        };
        self.last.iter().map(seen).collect()
    }

    fn draw(&self, image: &mut RgbImage) {
        self.last.iter().for_each(|marker| annotate::marker(image, marker));
    }
}

/// A box of known colour and size, as `ObjectInstances` of its class, with its pose. One that is not seen is not observed.
///
/// Where the frames have depth, the table on which it stands is observed, too, as `EnvironmentModels/.../table`: of a box that is followed in
/// each frame, else once, and the box lies along it from then on. What else is level is not observed.
pub struct ObjectStep {
    localizer: ObjectLocalizer,
    /// Finds the table; `None` when it is not looked for, or no more.
    tables: Option<TabletopSegmentation>,
    /// The box that is followed; none where it is looked for anew in each frame.
    followed: Option<FollowedBox>,
    class: String,
    last: Option<ObjectEstimate>,
}

/// A box where it was shown last.
struct FollowedBox {
    /// Its pose, and that of the left camera, in the root frame as the camera is believed to be mounted.
    shown: Isometry3<f64>,
    root_from_left: Isometry3<f64>,
    /// The left camera's true pose in the frame of its believed one, as far as that is known.
    mounting: watch::Receiver<Isometry3<f64>>,
}

impl FollowedBox {
    /// Where a camera that has turned shows a box that has not moved.
    fn expected(&self, root_from_left: &Isometry3<f64>) -> Isometry3<f64> {
        let mounting = *self.mounting.borrow();
        let from_shown = |left: &Isometry3<f64>| left * mounting * left.inverse();
        from_shown(root_from_left).inverse() * from_shown(&self.root_from_left) * self.shown
    }
}

/// What stands on a surface has its underside within this of it, m.
const STANDS: f64 = 0.04;

impl ObjectStep {
    /// The step around a localizer of boxes of this class, on a surface whose tilt the localizer knows.
    pub fn new(localizer: ObjectLocalizer, class: &str) -> Self {
        Self { localizer, tables: None, followed: None, class: class.into(), last: None }
    }

    /// The step for a box on a table that is to be found with it, by depth images of this camera.
    #[must_use]
    pub fn with_table(self, camera: PinholeCamera) -> Self {
        Self { tables: Some(TabletopSegmentation::new(camera)), ..self }
    }

    /// The step for a box that is followed from frame to frame, with its roll and pitch as the images show them: from this pose on, where
    /// the left camera was believed at `root_from_left` (both root frame). A wrong mounting tilts what is shown the other way when the head
    /// turns; `mounting` is the left camera's true pose in the frame of its believed one, as far as that is known. A box that is lost is
    /// looked for anew.
    #[must_use]
    pub fn following(
        self,
        shown: Isometry3<f64>,
        root_from_left: Isometry3<f64>,
        mounting: watch::Receiver<Isometry3<f64>>,
    ) -> Self {
        Self { followed: Some(FollowedBox { shown, root_from_left, mounting }), ..self }
    }

    /// The table under the box, once a box has been found; the box lies along it.
    fn table_at_first(&mut self, frame: &StereoFrame) -> Option<TableEstimate> {
        let first = self.tables.as_ref().and_then(|_| self.localizer.localize(frame))?;
        let tables = self.tables.take()?;
        let table = self.table_under(&tables, frame, &first)?;
        let normal = Unit::new_normalize(table.root_from_table * Vector3::z());
        let tilt = UnitQuaternion::rotation_between_axis(&Vector3::z_axis(), &normal)?;
        self.localizer = self.localizer.clone().standing_on(tilt);
        Some(table)
    }

    /// The table on which a box stands.
    fn table_under(
        &self,
        tables: &TabletopSegmentation,
        frame: &StereoFrame,
        object: &ObjectEstimate,
    ) -> Option<TableEstimate> {
        let Tabletop { table, .. } = tables.segment(frame)?;
        let middle = Point3::from(object.root_from_object.translation.vector);
        let above = (table.root_from_table.inverse() * middle).z;
        ((above - self.localizer.height() / 2.0).abs() <= STANDS).then_some(table)
    }
}

impl StereoStep for ObjectStep {
    fn name(&self) -> &str {
        "object"
    }

    fn looks_for(&self) -> Vec<(String, String)> {
        vec![(OBJECTS.into(), self.class.clone())]
    }

    fn reach(&self) -> f64 {
        self.localizer.reach()
    }

    fn step(&mut self, frame: &StereoFrame) -> Vec<Observation> {
        let first = if self.followed.is_none() { self.table_at_first(frame) } else { None };
        self.last = match &self.followed {
            None => self.localizer.localize(frame),
            Some(followed) => {
                self.localizer.follow(frame, &followed.expected(&frame.root_from_left)).or_else(|| {
                    let anew = self.localizer.localize(frame)?;
                    self.localizer.follow(frame, &anew.root_from_object)
                })
            }
        };
        if let (Some(followed), Some(seen)) = (&mut self.followed, &self.last) {
            (followed.shown, followed.root_from_left) = (seen.root_from_object, frame.root_from_left);
        }
        let seen = |object: &ObjectEstimate| {
            posed((OBJECTS, &self.class), frame.stamp_ns, &object.root_from_object, &object.covariance)
                .with_confidence(object.visible)
        };
        let table = first.or_else(|| self.table_under(self.tables.as_ref()?, frame, self.last.as_ref()?));
        let table = table.map(|table| level_seen("table", &table, frame.stamp_ns));
        table.into_iter().chain(self.last.as_ref().map(seen)).collect()
    }

    fn draw(&self, image: &mut RgbImage) {
        self.last.iter().for_each(|object| annotate::object(image, object));
    }
}

/// The fingertips of a hand, followed: `HumanHands/.../hand` with `fingertips` in space and `tips_px` in the left image.
pub struct FingertipStep {
    tracking: FingerTipTracking,
    last: Vec<TrackedFingertip>,
}

impl FingertipStep {
    /// The step around a tracker.
    pub fn new(tracking: FingerTipTracking) -> Self {
        Self { tracking, last: Vec::new() }
    }
}

impl StereoStep for FingertipStep {
    fn name(&self) -> &str {
        "fingertips"
    }

    fn step(&mut self, frame: &StereoFrame) -> Vec<Observation> {
        self.last = self.tracking.update(frame);
        let tips = self.last.iter().filter_map(|tip| tip.in_left).map(|tip| vector(tip.coords));
        let in_image = self.last.iter().map(|tip| {
            Value::record([
                ("id", Value::Int(i64::try_from(tip.id).unwrap_or(i64::MAX))),
                ("x", Value::Float(tip.px.x)),
                ("y", Value::Float(tip.px.y)),
                ("score", Value::Float(tip.score)),
            ])
        });
        let seen = Observation::new(HANDS, "hand", frame.stamp_ns)
            .with("fingertips", tips.collect::<Vec<_>>())
            .with("tips_px", in_image.collect::<Vec<_>>());
        vec![seen]
    }

    fn draw(&self, image: &mut RgbImage) {
        self.last.iter().for_each(|tip| annotate::circle(image, &tip.px, tip.radius, [255, 0, 255]));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::providers::{ProviderDescription, frame_of};
    use crate::scenes::{CALIBRATION, empty_frames};

    /// Sees one thing, always before the camera, and the table under the robot.
    struct Stub;

    impl StereoStep for Stub {
        fn name(&self) -> &str {
            "stub"
        }

        fn step(&mut self, frame: &StereoFrame) -> Vec<Observation> {
            let ahead = in_camera(&Point3::new(0.0, 0.0, 2.0), &Matrix3::identity());
            let under =
                ObservedPlace::new(&Frame::root(), &Vector3::new(0.5, 0.0, 0.0), &Matrix3::identity());
            [ahead, under].map(|place| Observation::new(OBJECTS, "thing", frame.stamp_ns).at(place)).into()
        }

        fn draw(&self, _: &mut RgbImage) {}
    }

    #[test]
    fn a_box_that_stands_is_expected_where_a_camera_that_turns_shows_it() {
        let mounted = Isometry3::new(Vector3::new(0.02, -0.01, 0.01), Vector3::new(0.05, -0.06, 0.03));
        let stands = Isometry3::new(Vector3::new(0.1, 0.5, 0.95), Vector3::z() * 0.2);
        let camera = |yaw: f64| {
            let turned = UnitQuaternion::from_euler_angles(-2.4, 0.0, yaw);
            Isometry3::from_parts(Vector3::new(0.05 * yaw, 0.2, 1.6).into(), turned)
        };
        let shows = |believed: &Isometry3<f64>| believed * (believed * mounted).inverse() * stands;
        let [before, now] = [camera(-0.3), camera(0.3)];
        let expected = |mounting: Isometry3<f64>| {
            let mounting = watch::Sender::new(mounting).subscribe();
            FollowedBox { shown: shows(&before), root_from_left: before, mounting }.expected(&now)
        };
        assert!((expected(mounted).inverse() * shows(&now)).rotation.angle() < 1e-9);
        let off = expected(Isometry3::identity()).inverse() * shows(&now);
        assert!(off.rotation.angle() > 0.02, "{off}: a wrong mounting tilts it");
    }

    #[test]
    fn places_are_in_the_root_frame_or_in_the_frame_of_a_camera_that_does_not_know_where_it_is() {
        let stereo = Arc::new(empty_frames().swap_remove(0));
        let pair = StereoPair::of(&ProviderDescription::of_stereo("eyes", "left", &CALIBRATION)).unwrap();
        let mut processor = OfStereo::new(Stub, pair);
        let mut seen = |frame: RawFrame| -> Vec<(String, Vector3<f64>)> {
            let seen = processor.process(&[Arc::new(frame)]).unwrap();
            let place = |o: Observation| {
                o.place.map(|place| (place.position.frame.0.clone(), place.position.vector()))
            };
            seen.observations.into_iter().filter_map(place).collect()
        };
        let known = frame_of(&stereo, 1, "left").unwrap();
        let root_from_camera = known.root_from_camera.unwrap();
        let ahead = (root_from_camera * Point3::new(0.0, 0.0, 2.0)).coords;
        let under = Vector3::new(0.5, 0.0, 0.0);
        let root = || "root".to_owned();
        let placed = seen(known.clone());
        assert!((placed[0].1 - ahead).norm() < 1e-12 && placed[0].0 == root());
        assert_eq!(placed[1], (root(), under));
        let nowhere = seen(RawFrame { root_from_camera: None, ..known });
        assert_eq!(nowhere, [("left".to_owned(), Vector3::new(0.0, 0.0, 2.0)), ("left".to_owned(), under)]);
    }
}

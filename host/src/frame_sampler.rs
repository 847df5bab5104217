//! Samples a few camera images of the run for the report, and marks what is detected in them.
//!
//! The sampler is between the cameras and the skills. It keeps a frame every few seconds, and sends some to the
//! recording; it never requests a frame itself. Its pictures are marked with the same detectors as the skills use,
//! which know the colour and size of objects from prior knowledge.

use std::sync::Arc;

use armarium_simulator::World;
use armarium_values::report::Picture;
use armarium_visionx::providers::convert::jpeg;
use armarium_visionx::{
    BodyObserver, ColorModel, HandObserver, ImageError, ImageSource, ObjectLocalizer, PeopleStep, RgbImage,
    StereoCalibration, StereoFrame, StereoStep, annotate, components,
};
use async_trait::async_trait;
use parking_lot::Mutex;

use crate::recording::SharedRecorder;

/// Least time between kept frames, ns.
const MIN_INTERVAL_NS: u64 = 4_000_000_000;
/// Most kept frames; after that, later ones replace every second one.
const MAX_FRAMES: usize = 24;
/// Topic of the left eye in the recording.
pub(crate) const LEFT_EYE: &str = "/camera/left";
/// Patches of the tool's colour with fewer pixels are ignored.
const MIN_PATCH: u32 = 150;

/// Keeps some of the frames that pass through.
pub(crate) struct FrameSampler {
    cameras: Arc<dyn ImageSource>,
    kept: Mutex<Vec<Arc<StereoFrame>>>,
    newest: Mutex<Option<Arc<StereoFrame>>>,
    known: SearchTargets,
    recorder: SharedRecorder,
}

/// What the pictures are searched for.
struct SearchTargets {
    /// Names, edge lengths, m, and colours.
    objects: Vec<(String, [f64; 3], [u8; 3])>,
    tool: ColorModel,
    /// Whether there are people.
    people: bool,
}

impl FrameSampler {
    /// A sampler between these cameras and their readers.
    pub(crate) fn of(cameras: Arc<dyn ImageSource>, world: &World, recorder: SharedRecorder) -> Self {
        let objects = world.objects.iter().map(|o| (o.name.clone(), o.size, o.color)).collect();
        let (tool, people) = (ColorModel::from_rgb(world.coach.tool.color), world.people().next().is_some());
        let known = SearchTargets { objects, tool, people };
        Self { cameras, kept: Mutex::default(), newest: Mutex::default(), known, recorder }
    }

    fn record(&self, frame: &StereoFrame) {
        self.recorder.write(|recorder| recorder.image(LEFT_EYE, frame.stamp_ns, &frame.left));
    }

    /// The frame that passed last.
    pub(crate) fn newest(&self) -> Option<Arc<StereoFrame>> {
        self.newest.lock().clone()
    }

    /// A frame of the left eye as JPEG, with all detections marked.
    pub(crate) fn marked(&self, frame: &StereoFrame) -> Option<Vec<u8>> {
        let picture = self.known.picture(self.cameras.calibration(), frame, &|_| String::new())?;
        Some(picture.data)
    }

    fn look(&self, frame: &Arc<StereoFrame>) {
        *self.newest.lock() = Some(Arc::clone(frame));
        let mut kept = self.kept.lock();
        let due = kept.last().is_none_or(|last| frame.stamp_ns >= last.stamp_ns + MIN_INTERVAL_NS);
        if !due {
            return;
        }
        if kept.len() >= MAX_FRAMES {
            let mut even = false;
            kept.retain(|_| {
                even = !even;
                even
            });
        }
        kept.push(Arc::clone(frame));
    }

    /// The pictures with all detections marked; `state_at` names the robot's states at that time.
    pub(crate) fn pictures(&self, state_at: &dyn Fn(u64) -> String) -> Vec<Picture> {
        let calibration = self.cameras.calibration();
        let kept = self.kept.lock();
        kept.iter().filter_map(|frame| self.known.picture(calibration, frame, state_at)).collect()
    }
}

impl SearchTargets {
    fn picture(
        &self,
        calibration: StereoCalibration,
        frame: &StereoFrame,
        state_at: &dyn Fn(u64) -> String,
    ) -> Option<Picture> {
        let mut image = RgbImage::clone(&frame.left);
        let mut seen = Vec::new();
        for (name, size, color) in &self.objects {
            let Some(found) = ObjectLocalizer::new(calibration, *size, *color).localize(frame) else {
                continue;
            };
            annotate::object(&mut image, &found);
            let at = found.root_from_object.translation.vector;
            seen.push(format!("{name} at ({:.2}, {:.2}, {:.2}) m", at.x, at.y, at.z));
        }
        if let Some(patch) = components(&self.tool.segment(&frame.left), MIN_PATCH).first() {
            annotate::region(&mut image, &patch.bounds, [0, 255, 0]);
            seen.push("the coach's tool".to_owned());
        }
        if self.people {
            let mut step = PeopleStep::new(BodyObserver::new(calibration), |_| Vec::new());
            // It is surer of a person after some frames; what it marks in one is shown.
            step.step(frame);
            step.draw(&mut image);
        }
        if let Some(hand) = HandObserver::new(calibration).update(frame) {
            annotate::hand(&mut image, &hand);
            seen.push(format!("a hand: {}", hand.gesture.to_string().replace('_', " ")));
        }
        let seen = if seen.is_empty() { String::new() } else { format!(" · seen: {}", seen.join(", ")) };
        let caption = format!("{:.1} s · {}{seen}", frame.stamp_ns as f64 * 1e-9, state_at(frame.stamp_ns));
        let data = jpeg(&image).ok()?;
        Some(Picture { caption, data, media_type: "image/jpeg".into() })
    }
}

#[async_trait]
impl ImageSource for FrameSampler {
    fn name(&self) -> &str {
        self.cameras.name()
    }

    fn calibration(&self) -> StereoCalibration {
        self.cameras.calibration()
    }

    async fn next(&self) -> Result<Arc<StereoFrame>, ImageError> {
        let frame = self.cameras.next().await?;
        self.look(&frame);
        self.record(&frame);
        Ok(frame)
    }
}

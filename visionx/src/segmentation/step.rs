//! The segmentation as a processing step: after so many pictures of a standing head it says once what is told apart.

use armarium_values::{Frame, Observation, Pose, Value};
use nalgebra::Vector3;

use super::evidence::told_apart;
use super::hypothesis::{Hypothesis, first_hypotheses};
use super::silhouettes::silhouettes;
use super::top_view::TopView;
use crate::camera::PinholeCamera;
use crate::frame::{DepthImage, RgbImage, StereoFrame};
use crate::mask::PixelRun;
use crate::plane::Plane;
use crate::steps::StereoStep;

/// The core segment of what may be things.
const HYPOTHESES: &str = "ObjectHypotheses";
/// How many pictures are averaged; a depth that is missing in more than half of them is not known.
const PICTURES: usize = 5;

/// Tells apart what stands on a table, beginning with what was known of it before; depth and colour of five pictures are averaged.
///
/// It observes `ObjectHypotheses`, once, each with `pose`, `size`, `color`, `points`, `mask`, `confirmed` and `pushes`.
pub struct SegmentationStep {
    camera: PinholeCamera,
    known: Vec<Hypothesis>,
    pushed: Option<String>,
    /// The number in the name of the newest hypothesis.
    newest: usize,
    pictures: Vec<(DepthImage, RgbImage)>,
    /// What was told apart, and the pixels that show it.
    look: Option<(Vec<Hypothesis>, Vec<Vec<PixelRun>>)>,
}

impl SegmentationStep {
    /// A step for depth images of this camera, which knows nothing.
    pub fn new(camera: PinholeCamera) -> Self {
        Self { camera, known: Vec::new(), pushed: None, newest: 0, pictures: Vec::new(), look: None }
    }

    /// The same, with what was told apart before something was pushed, perhaps one of these; new names count on from `newest`.
    #[must_use]
    pub fn remembering(mut self, known: Vec<Hypothesis>, pushed: Option<String>, newest: usize) -> Self {
        (self.known, self.pushed, self.newest) = (known, pushed, newest);
        self
    }

    fn look(&mut self, frame: &StereoFrame) -> Option<Vec<Observation>> {
        let (depth, colors) = averaged(&self.pictures)?;
        let (view, plane) = TopView::of((&depth, &colors), &self.camera, &frame.root_from_left)?;
        let known = match self.known.is_empty() {
            true => first_hypotheses(&view, &mut self.newest),
            false => told_apart(&self.known, &view, self.pushed.as_deref(), &mut self.newest),
        };
        let masks = silhouettes(&known, (&depth, &colors), &self.camera, &frame.root_from_left, &plane);
        let seen =
            known.iter().zip(&masks).filter_map(|(h, mask)| observation(h, mask, &plane, frame.stamp_ns));
        let seen = seen.collect();
        self.look = Some((known, masks));
        Some(seen)
    }
}

fn observation(
    hypothesis: &Hypothesis,
    mask: &[PixelRun],
    plane: &Plane,
    stamp_ns: u64,
) -> Option<Observation> {
    let (pose, size) = hypothesis.surrounding_box(plane)?;
    let numbers = |numbers: &mut dyn Iterator<Item = i64>| Value::List(numbers.map(Value::Int).collect());
    let mut runs = mask.iter().flat_map(|run| [run.y, run.x0, run.x1].map(i64::from));
    let color = hypothesis.color();
    Some(
        Observation::new(HYPOTHESES, "thing", stamp_ns)
            .named(&hypothesis.name)
            .with("pose", Value::Pose(Pose::new(Frame::root(), &pose)))
            .with("size", Value::from([size.x, size.y, size.z]))
            .with("color", numbers(&mut color.into_iter().map(i64::from)))
            .with("points", Value::Bytes(hypothesis.packed()))
            .with("mask", numbers(&mut runs))
            .with("confirmed", hypothesis.confirmed)
            .with("pushes", i64::from(hypothesis.pushes)),
    )
}

/// Mean colours, and mean depths where they were measured in at least half of the pictures.
fn averaged(pictures: &[(DepthImage, RgbImage)]) -> Option<(DepthImage, RgbImage)> {
    let (first, colors) = pictures.first()?;
    let mut depth = first.clone();
    for (i, mean) in depth.data.iter_mut().enumerate() {
        let all = pictures.iter().map(|(depth, _)| depth.data[i]).filter(|z| *z > 0.0);
        let (n, sum) = all.fold((0usize, 0.0f32), |(n, sum), z| (n + 1, sum + z));
        *mean = if 2 * n >= pictures.len() { sum / n as f32 } else { 0.0 };
    }
    let mut colors = colors.clone();
    for (i, mean) in colors.data_mut().iter_mut().enumerate() {
        let sum: u32 = pictures.iter().map(|(_, colors)| u32::from(colors.data()[i])).sum();
        *mean = (sum / pictures.len() as u32) as u8;
    }
    Some((depth, colors))
}

impl StereoStep for SegmentationStep {
    fn name(&self) -> &str {
        "segmentation"
    }

    fn step(&mut self, frame: &StereoFrame) -> Vec<Observation> {
        let usable = frame.depth.as_ref().and_then(|depth| self.camera.usable(depth));
        let Some(depth) = usable.filter(|_| self.look.is_none()) else { return Vec::new() };
        self.pictures.push((depth.clone(), RgbImage::clone(&frame.left)));
        if self.pictures.len() < PICTURES {
            return Vec::new();
        }
        let seen = self.look(frame).unwrap_or_default();
        self.pictures.clear();
        seen
    }

    fn draw(&self, image: &mut RgbImage) {
        let Some((known, masks)) = &self.look else { return };
        for (n, (hypothesis, mask)) in known.iter().zip(masks).enumerate() {
            let hue =
                [[230, 60, 60], [60, 190, 60], [70, 90, 240], [230, 190, 40], [190, 60, 210], [40, 200, 210]];
            let color = Vector3::from(hue[n % hue.len()]).cast::<f64>();
            let share = if hypothesis.confirmed { 0.6 } else { 0.3 };
            for (x, y) in mask.iter().flat_map(|run| (run.x0..run.x1).map(|x| (x, run.y))) {
                let at = (y * image.width() + x) as usize * 3;
                for (channel, color) in image.data_mut()[at..at + 3].iter_mut().zip(&color) {
                    *channel = (f64::from(*channel) * (1.0 - share) + color * share) as u8;
                }
            }
        }
    }
}

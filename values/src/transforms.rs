//! Where frames were: a tree of frames whose poses change over time, and the transform between any two of them at any time
//! of the last seconds. As ROS's `tf2` does it.
//!
//! A pose that comes is kept with its time ([`Transforms::insert`]); between two times, positions are interpolated linearly and
//! orientations along the shortest turn (slerp). Who can say where frames were without poses being kept, such as a robot from its
//! joints, is a [`FrameSource`]. All times are of one clock, which this does not read. It is bounded in frames and samples.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use nalgebra::Isometry3;

use crate::{Frame, Pose};

/// How long poses are kept, ns.
pub const KEPT_NS: u64 = 10_000_000_000;
/// Most frames, and most poses of one frame: ten seconds at 1 kHz.
const MAX_FRAMES: usize = 1000;
const MAX_SAMPLES: usize = 10_001;

/// Why a transform is not known.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs, reason = "the names of the fields say what they are")]
pub enum TransformError {
    /// Nobody has said where a frame is.
    #[error("nobody has told where the frame `{frame}` is; known are {known}")]
    Unknown { frame: String, known: String },
    /// It is too long ago, by `late_s`.
    #[error(
        "where the frame `{frame}` was {late_s:.3} s before the oldest pose that is kept of it is not known any more"
    )]
    TooOld { frame: String, late_s: f64 },
    /// It is later than what is known, by `early_s`; the answer may come.
    #[error("where the frame `{frame}` is is not yet known: the newest pose of it is {early_s:.3} s older")]
    NotYet { frame: String, early_s: f64 },
    /// Both are known, but nothing connects the frames that they hang on.
    #[error(
        "the frames `{target}` and `{source_frame}` are not connected: they hang on `{target_root}` and `{source_root}`"
    )]
    NotConnected { target: String, source_frame: String, target_root: String, source_root: String },
    /// A pose that cannot be kept.
    #[error("the pose of the frame `{frame}` cannot be kept: {why}")]
    Refused { frame: String, why: &'static str },
}

/// Somebody who knows where some frames were.
pub trait FrameSource: Send + Sync {
    /// The frame that `frame` hangs on, and `frame`'s pose in it at a time; `None` if this source does not know the frame at all.
    ///
    /// # Errors
    /// [`TransformError::TooOld`] and [`TransformError::NotYet`].
    fn parent(&self, frame: &Frame, stamp_ns: u64)
    -> Option<Result<(Frame, Isometry3<f64>), TransformError>>;
    /// The frames that it knows, for messages.
    fn frames(&self) -> Vec<Frame>;
}

/// The poses of one frame in its parent.
#[derive(Debug)]
struct TransformTrack {
    parent: Frame,
    /// By time; a single one at time 0 for a frame that never moves.
    samples: VecDeque<(u64, Isometry3<f64>)>,
    fixed: bool,
}

/// The buffer; see the module.
#[derive(Default)]
pub struct Transforms {
    tracks: BTreeMap<Frame, TransformTrack>,
    sources: Vec<Arc<dyn FrameSource>>,
}

impl std::fmt::Debug for Transforms {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Transforms").field("frames", &self.tracks.keys()).finish_non_exhaustive()
    }
}

impl Transforms {
    /// A buffer without frames.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds somebody who knows where frames were. A frame that was told by [`insert`](Self::insert) or [`fix`](Self::fix) is
    /// taken from there.
    pub fn attach(&mut self, source: Arc<dyn FrameSource>) {
        self.sources.push(source);
    }

    /// Keeps where a frame was at a time: a pose in the frame that it hangs on. A pose that is older than the newest one is put
    /// where it belongs; one of the same time replaces it. Poses more than ten seconds before the newest are forgotten.
    ///
    /// # Errors
    /// [`TransformError::Refused`]: a number is not finite, the frame hangs on another one or on itself, there are too many.
    pub fn insert(&mut self, frame: &Frame, stamp_ns: u64, pose: &Pose) -> Result<(), TransformError> {
        let track = self.track(frame, pose, false)?;
        let at = track.samples.partition_point(|(stamp, _)| *stamp < stamp_ns);
        match track.samples.get_mut(at) {
            Some(sample) if sample.0 == stamp_ns => sample.1 = pose.isometry(),
            _ => track.samples.insert(at, (stamp_ns, pose.isometry())),
        }
        let newest = track.samples.back().map_or(0, |(stamp, _)| *stamp);
        while track.samples.len() > MAX_SAMPLES
            || track.samples.get(1).is_some_and(|(stamp, _)| stamp + KEPT_NS <= newest)
        {
            track.samples.pop_front();
        }
        Ok(())
    }

    /// Says where a frame always is.
    ///
    /// # Errors
    /// As [`insert`](Self::insert).
    pub fn fix(&mut self, frame: &Frame, pose: &Pose) -> Result<(), TransformError> {
        let track = self.track(frame, pose, true)?;
        track.samples = VecDeque::from([(0, pose.isometry())]);
        Ok(())
    }

    fn track(
        &mut self,
        frame: &Frame,
        pose: &Pose,
        fixed: bool,
    ) -> Result<&mut TransformTrack, TransformError> {
        let refused = |why| Err(TransformError::Refused { frame: frame.0.clone(), why });
        if !pose.position.iter().chain(&pose.orientation).all(|x| x.is_finite()) {
            return refused("a number of it is not finite");
        }
        match self.tracks.get(frame) {
            Some(track) if track.parent != pose.frame => return refused("the frame hangs on another one"),
            Some(track) if track.fixed != fixed => return refused("the frame either moves or does not"),
            Some(_) => {}
            None if self.tracks.len() >= MAX_FRAMES => return refused("there are too many frames"),
            None => {
                let mut above = Some(&pose.frame);
                while let Some(next) = above {
                    if next == frame {
                        return refused("the frame would hang on itself");
                    }
                    above = self.tracks.get(next).map(|track| &track.parent);
                }
            }
        }
        let new = || TransformTrack { parent: pose.frame.clone(), samples: VecDeque::new(), fixed };
        Ok(self.tracks.entry(frame.clone()).or_insert_with(new))
    }

    /// `target_from_source` at a time: maps coordinates in the frame `source` into the frame `target`.
    ///
    /// # Errors
    /// [`TransformError`]: a frame is unknown, both are not connected, or it is not known where one was then.
    pub fn transform(
        &self,
        target: &Frame,
        source: &Frame,
        stamp_ns: u64,
    ) -> Result<Isometry3<f64>, TransformError> {
        let ((from_target, lost), (from_source, also)) =
            (self.chain(target, stamp_ns), self.chain(source, stamp_ns));
        for (frame, common_from_target) in &from_target {
            if let Some((_, common_from_source)) = from_source.iter().find(|(other, _)| other == frame) {
                return Ok(common_from_target.inverse() * common_from_source);
            }
        }
        if let Some(lost) = lost.or(also) {
            return Err(lost);
        }
        let root =
            |chain: &[(Frame, Isometry3<f64>)]| chain.last().map_or(String::new(), |(f, _)| f.0.clone());
        let known = |frame: &Frame, chain: &[(Frame, Isometry3<f64>)]| {
            chain.len() > 1 || self.tracks.values().any(|track| track.parent == *frame)
        };
        for (frame, chain) in [(target, &from_target), (source, &from_source)] {
            if !known(frame, chain) {
                return Err(TransformError::Unknown { frame: frame.0.clone(), known: self.known() });
            }
        }
        Err(TransformError::NotConnected {
            target: target.0.clone(),
            source_frame: source.0.clone(),
            target_root: root(&from_target),
            source_root: root(&from_source),
        })
    }

    /// A frame and those that it hangs on, each with the pose of the frame in it, as far as that is known at the time, and why it
    /// is not known further up.
    fn chain(&self, frame: &Frame, stamp_ns: u64) -> (Vec<(Frame, Isometry3<f64>)>, Option<TransformError>) {
        let mut chain = vec![(frame.clone(), Isometry3::identity())];
        while let Some((last, last_from_frame)) = chain.last()
            && chain.len() <= MAX_FRAMES
            && let Some(parent) = self.parent(last, stamp_ns)
        {
            let (parent, parent_from_last) = match parent {
                Ok(parent) => parent,
                Err(lost) => return (chain, Some(lost)),
            };
            if chain.iter().any(|(known, _)| *known == parent) {
                break;
            }
            let parent_from_frame = parent_from_last * last_from_frame;
            chain.push((parent, parent_from_frame));
        }
        (chain, None)
    }

    fn parent(
        &self,
        frame: &Frame,
        stamp_ns: u64,
    ) -> Option<Result<(Frame, Isometry3<f64>), TransformError>> {
        match self.tracks.get(frame) {
            Some(track) => Some(track.at(frame, stamp_ns).map(|pose| (track.parent.clone(), pose))),
            None => self.sources.iter().find_map(|source| source.parent(frame, stamp_ns)),
        }
    }

    fn known(&self) -> String {
        let told = self.tracks.iter().flat_map(|(frame, track)| [frame.clone(), track.parent.clone()]);
        let sourced = self.sources.iter().flat_map(|source| source.frames());
        let names: std::collections::BTreeSet<String> = told.chain(sourced).map(|frame| frame.0).collect();
        names.into_iter().collect::<Vec<_>>().join(", ")
    }
}

impl TransformTrack {
    fn at(&self, frame: &Frame, stamp_ns: u64) -> Result<Isometry3<f64>, TransformError> {
        if self.fixed {
            return Ok(self.samples[0].1);
        }
        let between = bracket(frame, self.samples.len(), |index| self.samples[index].0, stamp_ns)?;
        let [before, after] = between.samples.map(|index| &self.samples[index].1);
        Ok(interpolated(before, after, between.share))
    }
}

/// Two samples between which a time is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bracket {
    /// The sample before and the one after, as indices; one twice at its own time.
    pub samples: [usize; 2],
    /// The share of the way from the first to the second, in `0..=1`.
    pub share: f64,
}

/// The samples of a frame between which a time is. `at` gives the time of each of the `count` samples, ns, in order.
///
/// # Errors
/// [`TransformError::TooOld`] before the first one, [`TransformError::NotYet`] after the last one or where there is none.
pub fn bracket(
    frame: &Frame,
    count: usize,
    at: impl Fn(usize) -> u64,
    stamp_ns: u64,
) -> Result<Bracket, TransformError> {
    let seconds = |ns: u64| ns as f64 * 1e-9;
    let (mut low, mut high) = (0, count);
    while low < high {
        let middle = usize::midpoint(low, high);
        if at(middle) < stamp_ns { low = middle + 1 } else { high = middle }
    }
    if low == count {
        let newest = if low == 0 { 0 } else { at(low - 1) };
        return Err(TransformError::NotYet { frame: frame.0.clone(), early_s: seconds(stamp_ns - newest) });
    }
    let after = at(low);
    if after == stamp_ns {
        return Ok(Bracket { samples: [low, low], share: 0.0 });
    }
    if low == 0 {
        return Err(TransformError::TooOld { frame: frame.0.clone(), late_s: seconds(after - stamp_ns) });
    }
    let before = at(low - 1);
    let share = (stamp_ns - before) as f64 / (after - before) as f64;
    Ok(Bracket { samples: [low - 1, low], share })
}

/// The pose at a share of the way from one to another: the position linear, the orientation along the shortest turn.
fn interpolated(from: &Isometry3<f64>, to: &Isometry3<f64>, share: f64) -> Isometry3<f64> {
    let position = from.translation.vector.lerp(&to.translation.vector, share);
    // Half a turn has no shortest way; any of them is as good.
    let rotation = from.rotation.try_slerp(&to.rotation, share, 1e-9).unwrap_or(from.rotation);
    Isometry3::from_parts(position.into(), rotation)
}

#[cfg(test)]
mod tests {
    use nalgebra::{Point3, UnitQuaternion, Vector3};
    use proptest::prelude::*;

    use super::*;

    const SECOND: u64 = 1_000_000_000;

    fn frame(name: &str) -> Frame {
        name.into()
    }

    fn pose(parent: &str, x: f64, yaw: f64) -> Pose {
        let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
        Pose::new(parent.into(), &Isometry3::from_parts(Vector3::new(x, 0.0, 0.0).into(), turned))
    }

    /// A platform that drives along x at 0.5 m/s, a head on it that turns at 1 rad/s, and a camera fixed on the head.
    fn moving() -> Transforms {
        let mut transforms = Transforms::new();
        for ms in (0..=2000_u32).step_by(20) {
            let t = f64::from(ms) * 1e-3;
            let stamp = u64::from(ms) * 1_000_000;
            transforms.insert(&frame("root"), stamp, &pose("world", 0.5 * t, 0.0)).unwrap();
            transforms.insert(&frame("head"), stamp, &pose("root", 0.1, t)).unwrap();
        }
        transforms.fix(&frame("camera"), &pose("head", 0.2, 0.0)).unwrap();
        transforms
    }

    #[test]
    fn a_pair_of_frames_is_joined_at_any_time() {
        let transforms = moving();
        for t in [0.0_f64, 0.013, 0.5, 1.2345, 2.0] {
            let stamp = (t * 1e9) as u64;
            let world_from_camera = transforms.transform(&frame("world"), &frame("camera"), stamp).unwrap();
            let expected = Point3::new(0.5 * t + 0.1 + 0.2 * libm::cos(t), 0.2 * libm::sin(t), 0.0);
            assert!((world_from_camera * Point3::origin() - expected).norm() < 1e-6, "{t}");
            assert!((world_from_camera.rotation.angle() - t).abs() < 1e-6, "{t}");
            let back = transforms.transform(&frame("camera"), &frame("world"), stamp).unwrap();
            assert!((back * world_from_camera).translation.vector.norm() < 1e-9);
        }
        let same = transforms.transform(&frame("head"), &frame("head"), SECOND).unwrap();
        assert_eq!(same, Isometry3::identity());
    }

    #[test]
    fn what_is_not_known_is_said() {
        let mut transforms = moving();
        let ask = |transforms: &Transforms, target: &str, stamp: u64| {
            transforms.transform(&frame(target), &frame("camera"), stamp).unwrap_err()
        };
        let error = ask(&transforms, "hand", SECOND);
        assert_eq!(
            error.to_string(),
            "nobody has told where the frame `hand` is; known are camera, head, root, world"
        );
        let error = ask(&transforms, "world", 2 * SECOND + SECOND / 2);
        assert_eq!(error, TransformError::NotYet { frame: "head".into(), early_s: 0.5 });
        transforms.insert(&frame("head"), 11 * SECOND, &pose("root", 0.1, 0.0)).unwrap();
        let error = ask(&transforms, "root", SECOND / 2);
        assert!(
            matches!(error, TransformError::TooOld { late_s, .. } if (late_s - 0.5).abs() < 1e-9),
            "{error}"
        );
        transforms.fix(&frame("shelf"), &pose("room", 0.0, 0.0)).unwrap();
        transforms.insert(&frame("root"), 11 * SECOND, &pose("world", 0.0, 0.0)).unwrap();
        let error = ask(&transforms, "shelf", 11 * SECOND);
        assert!(error.to_string().contains("they hang on `room` and"), "{error}");
    }

    #[test]
    fn poses_that_cannot_be_are_refused_and_late_ones_are_put_in_order() {
        let mut transforms = moving();
        let why = |result: Result<(), TransformError>| result.unwrap_err().to_string();
        assert!(why(transforms.insert(&frame("head"), 0, &pose("world", 0.0, 0.0))).contains("another one"));
        assert!(why(transforms.fix(&frame("head"), &pose("root", 0.0, 0.0))).contains("either moves"));
        assert!(why(transforms.fix(&frame("world"), &pose("camera", 0.0, 0.0))).contains("on itself"));
        assert!(why(transforms.insert(&frame("head"), 0, &pose("root", f64::NAN, 0.0))).contains("finite"));
        let mut transforms = Transforms::new();
        for stamp in [0, 2, 1] {
            transforms.insert(&frame("a"), stamp * SECOND, &pose("b", stamp as f64, 0.0)).unwrap();
        }
        let at = transforms.transform(&frame("b"), &frame("a"), SECOND * 3 / 2).unwrap();
        assert_eq!(at.translation.x, 1.5);
    }

    #[test]
    fn it_does_not_grow() {
        let mut transforms = Transforms::new();
        for k in 0..40_000 {
            transforms.insert(&frame("a"), k * 100_000, &pose("b", 0.0, 0.0)).unwrap();
        }
        assert_eq!(transforms.tracks[&frame("a")].samples.len(), MAX_SAMPLES);
        for k in 0..MAX_FRAMES as u64 - 1 {
            transforms.insert(&Frame(format!("f{k}")), 0, &pose("b", 0.0, 0.0)).unwrap();
        }
        assert!(transforms.insert(&frame("more"), 0, &pose("b", 0.0, 0.0)).is_err());
    }

    proptest! {
        #[test]
        fn transforms_chain(stamp in 0..2 * SECOND) {
            let transforms = moving();
            let between = |a: &str, b: &str| transforms.transform(&frame(a), &frame(b), stamp).unwrap();
            let (whole, parts) = (between("world", "camera"), between("world", "root") * between("root", "camera"));
            prop_assert!((whole.inverse() * parts).translation.vector.norm() < 1e-9);
        }
    }
}

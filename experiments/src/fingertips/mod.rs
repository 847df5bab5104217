//! The quality of fingertip tracking and gesture recognition before a simulated camera, the effect of each part of the
//! tracking, and simulated fingertips to learn their motion from. It knows no robot.

mod stage;

use armarium_visionx::HandObserver;
use armarium_visionx::tracking::{
    AdaptiveHoughTransform, FingerARModel, FingerTipSettings, FingerTipTracking, TrackedFingertip,
};
use nalgebra::{Point2, Vector2};

use self::stage::{BACKGROUNDS, CALIBRATION, CHANGES, HandTruth, Stage, TrueTip, blackout};

pub use self::stage::RATE_HZ;

/// Frames of a simulated sequence to learn from, and the first seed of these: those that are judged begin at 0.
const FRAMES_LEARNED: u64 = 120;
const FIRST_SEED_LEARNED: u64 = 1_000;
/// The frames without visibility, in each three seconds.
const BLACKOUT: std::ops::Range<u64> = 75..80;
const PERIOD: u64 = 90;
/// Frames within which a tip must be found again.
const MAX_FRAMES_LOST: u64 = 10;
/// A tip counts as lost farther from its track than this, px, plus this many tip radii.
const LOST: (f64, f64) = (4.0, 1.5);
/// The distance whose radius is used at all distances in the row without the adaptive radius, m.
const FIXED_DEPTH: f64 = 0.6;
/// Standard deviation of the random walk, normalised coordinates a frame: that of a hand at 0.5 m/s, 0.6 m away.
const WALK: f64 = 0.02;

/// A row of the table.
struct Variant {
    name: &'static str,
    settings: FingerTipSettings,
}

/// The result of one variant.
#[derive(Debug, Default)]
struct VariantScore {
    /// Distances of visible tips from the nearest track, px; infinite for lost tips.
    errors: Vec<f64>,
    lost: usize,
    /// Tracks without a tip, and all tracks.
    false_tracks: usize,
    tracks: usize,
    /// Distances from the nearest track at the end of each blackout, px; infinite without a track.
    blind: Vec<f64>,
    /// Frames after each blackout until all tips were tracked again.
    again: Vec<u64>,
}

/// The quality of gesture recognition.
#[derive(Debug, Default)]
struct Gestures {
    steady: usize,
    right: usize,
    /// Frames from the end of a change of gesture until it was recognised.
    noticed: Vec<u64>,
}

/// The quality of one way of tracking. Distances are in pixels; infinite where there is no track.
#[derive(Clone, Debug, PartialEq)]
pub struct TrackingFigures {
    /// The way.
    pub name: &'static str,
    /// Distance of a visible tip from the nearest track: the median, and what 95 % of them do not exceed.
    pub median_px: f64,
    /// See `median_px`.
    pub most_px: f64,
    /// Share of tips within 6 px of a track, 0 to 1.
    pub within: f64,
    /// Share of tips without a track, 0 to 1.
    pub lost: f64,
    /// Share of tracks without a tip, 0 to 1.
    pub wrong: f64,
    /// Frames after five blind ones until all tips were tracked again, at the worst.
    pub again: u64,
    /// Distance at the end of five blind frames, the median.
    pub blind_px: f64,
}

/// The quality of gesture recognition.
#[derive(Clone, Debug, PartialEq)]
pub struct GestureFigures {
    /// Share of steady frames with the right gesture, 0 to 1, and how many frames these are.
    pub right: f64,
    /// See `right`.
    pub steady: usize,
    /// How many changes of gesture were noticed.
    pub changes: usize,
    /// How long after a change the last of them was noticed, s.
    pub latest_s: f64,
}

/// Judges tracking and gestures: `frames` frames of `seeds` hands before each background. `all`: also ways of tracking
/// from which a part is taken away, each beside the whole, which is the first.
#[must_use]
pub fn figures(seeds: u64, frames: u64, all: bool) -> (Vec<TrackingFigures>, GestureFigures) {
    let variants = variants();
    let chosen = if all { &variants[..] } else { &variants[..1] };
    let mut scores: Vec<VariantScore> = chosen.iter().map(|_| VariantScore::default()).collect();
    let mut gestures = Gestures::default();
    for (seed, background) in (0..seeds).flat_map(|s| (0..BACKGROUNDS).map(move |b| (s, b))) {
        play(&Stage::new(seed, background), frames, chosen, &mut scores, &mut gestures);
    }
    let rows = chosen.iter().zip(scores).map(|(variant, score)| score.figures(variant.name)).collect();
    let late = gestures.noticed.iter().max().copied().unwrap_or(0);
    let gestures = GestureFigures {
        right: share(gestures.right, gestures.steady),
        steady: gestures.steady,
        changes: gestures.noticed.len(),
        latest_s: late as f64 / RATE_HZ,
    };
    (rows, gestures)
}

/// The paths of the five fingertips of simulated hand number `sequence`, frame by frame at [`RATE_HZ`], in normalised
/// coordinates of the image; not finite where a tip is not seen.
#[must_use]
pub fn simulated_paths(sequence: u64) -> Vec<Vec<Point2<f64>>> {
    let stage = Stage::new(FIRST_SEED_LEARNED + sequence, sequence % BACKGROUNDS);
    let mut paths = vec![Vec::new(); 5];
    for frame in 0..FRAMES_LEARNED {
        let (_, truth) = stage.frame(frame);
        for (finger, path) in paths.iter_mut().enumerate() {
            let tip = truth.tips.iter().find(|t| t.finger == finger);
            let camera = CALIBRATION.camera;
            path.push(tip.map_or(Point2::new(f64::NAN, f64::NAN), |t| {
                Point2::from((t.px.coords - Vector2::from(camera.center)) / camera.focal)
            }));
        }
    }
    paths
}

fn share(part: usize, of: usize) -> f64 {
    part as f64 / of.max(1) as f64
}

fn variants() -> Vec<Variant> {
    let whole = FingerTipSettings::default();
    let fixed = AdaptiveHoughTransform { fixed_depth: Some(FIXED_DEPTH), ..whole.hough };
    let walk = FingerARModel::random_walk(WALK, RATE_HZ);
    vec![
        Variant { name: "whole", settings: whole },
        Variant { name: "fixed radius", settings: FingerTipSettings { hough: fixed, ..whole } },
        Variant { name: "random walk for AR(2)", settings: FingerTipSettings { model: walk, ..whole } },
        Variant { name: "without mean shift", settings: FingerTipSettings { mean_shift: false, ..whole } },
        Variant {
            name: "random walk, no mean shift",
            settings: FingerTipSettings { model: walk, mean_shift: false, ..whole },
        },
        Variant { name: "candidates without filter", settings: FingerTipSettings { filter: false, ..whole } },
        Variant {
            name: "candidates alone",
            settings: FingerTipSettings { filter: false, mean_shift: false, ..whole },
        },
    ]
}

fn play(
    stage: &Stage,
    frames: u64,
    variants: &[Variant],
    scores: &mut [VariantScore],
    gestures: &mut Gestures,
) {
    let mut tracking: Vec<FingerTipTracking> =
        variants.iter().map(|v| FingerTipTracking::new(CALIBRATION, v.settings)).collect();
    let mut observer = HandObserver::new(CALIBRATION).with_near_hands();
    let mut waiting: Vec<Option<u64>> = vec![None; variants.len()];
    let mut noticed = true;
    for number in 0..frames {
        let (frame, truth) = stage.frame(number);
        let in_period = number % PERIOD;
        let dark = BLACKOUT.contains(&in_period);
        let frame = if dark { blackout(&frame) } else { frame };
        for ((tracking, score), waiting) in tracking.iter_mut().zip(scores.iter_mut()).zip(&mut waiting) {
            let tips = tracking.update(&frame);
            if dark {
                *waiting = Some(0);
                if in_period + 1 == BLACKOUT.end {
                    score.blind.extend(truth.tips.iter().map(|t| distance(&tips, t)));
                }
                continue;
            }
            if let Some(frames) = waiting {
                *frames += 1;
                let there = truth.tips.iter().all(|t| nearest(&tips, t).is_some());
                if there || *frames >= 2 * MAX_FRAMES_LOST {
                    score.again.push(*frames);
                    *waiting = None;
                } else {
                    continue;
                }
            }
            if truth.since >= 2 * CHANGES {
                score.count(&tips, &truth);
            }
        }
        let seen = observer.update(&frame).map(|h| h.gesture);
        if dark || !truth.whole || (BLACKOUT.end..BLACKOUT.end + MAX_FRAMES_LOST).contains(&in_period) {
            continue;
        }
        gestures.count(number, &truth, seen == Some(truth.gesture), &mut noticed);
    }
}

/// The distance of a tip from the nearest track, px; `None` when it is lost.
fn nearest(tips: &[TrackedFingertip], truth: &TrueTip) -> Option<f64> {
    Some(distance(tips, truth)).filter(|d| *d < LOST.0 + LOST.1 * truth.radius)
}

/// The distance of a tip from the nearest track, px; infinite without one.
fn distance(tips: &[TrackedFingertip], truth: &TrueTip) -> f64 {
    tips.iter().map(|t| (t.px - truth.px).norm()).fold(f64::INFINITY, f64::min)
}

impl VariantScore {
    fn count(&mut self, tips: &[TrackedFingertip], truth: &HandTruth) {
        for tip in &truth.tips {
            let distance = nearest(tips, tip);
            self.lost += usize::from(distance.is_none());
            self.errors.push(distance.unwrap_or(f64::INFINITY));
        }
        self.tracks += tips.len();
        let wrong = |t: &&TrackedFingertip| {
            truth.tips.iter().all(|tip| (t.px - tip.px).norm() > LOST.0 + LOST.1 * tip.radius)
        };
        self.false_tracks += if truth.whole { tips.iter().filter(wrong).count() } else { 0 };
    }

    fn figures(mut self, name: &'static str) -> TrackingFigures {
        self.errors.sort_by(f64::total_cmp);
        self.blind.sort_by(f64::total_cmp);
        let n = self.errors.len().max(1);
        let at = |share: f64| self.errors.get((share * n as f64) as usize).copied().unwrap_or(f64::INFINITY);
        TrackingFigures {
            name,
            median_px: at(0.5),
            most_px: at(0.95),
            within: share(self.errors.iter().filter(|e| **e <= 6.0).count(), n),
            lost: share(self.lost, n),
            wrong: share(self.false_tracks, self.tracks),
            again: self.again.iter().max().copied().unwrap_or(0),
            blind_px: self.blind.get(self.blind.len() / 2).copied().unwrap_or(f64::INFINITY),
        }
    }
}

impl Gestures {
    fn count(&mut self, number: u64, truth: &HandTruth, right: bool, noticed: &mut bool) {
        if truth.since == 0 && number > 0 {
            *noticed = false;
        }
        if !*noticed && right {
            self.noticed.push((truth.since + 1).saturating_sub(CHANGES));
            *noticed = true;
        }
        if truth.since >= CHANGES + (0.3 * RATE_HZ) as u64 {
            self.steady += 1;
            self.right += usize::from(right);
        }
    }
}

//! `armarium vision figures`: the quality of fingertip tracking and gesture recognition in the simulator, and the
//! effect of each part of the tracking.

use std::io::{self, Write};

use armarium_visionx::HandObserver;
use armarium_visionx::tracking::{
    AdaptiveHoughTransform, FingerARModel, FingerTipSettings, FingerTipTracking, TrackedFingertip,
};

use super::FiguresArgs;
use super::staged::{BACKGROUNDS, CALIBRATION, CHANGES, RATE_HZ, Stage, TrueTip, Truth, blackout};

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
struct Score {
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

/// Prints the figures. Returns the exit status 0.
pub(super) fn run(args: FiguresArgs, out: &mut dyn Write) -> io::Result<u8> {
    let variants = variants();
    let chosen = if args.whole { &variants[..1] } else { &variants[..] };
    writeln!(
        out,
        "| tracking | median px | 95 % px | within 6 px | lost | wrong tracks | found again, worst frame | after 5 blind frames, median px |"
    )?;
    writeln!(out, "|---|---|---|---|---|---|---|---|")?;
    let mut scores: Vec<Score> = chosen.iter().map(|_| Score::default()).collect();
    let mut gestures = Gestures::default();
    for (seed, background) in (0..args.seeds).flat_map(|s| (0..BACKGROUNDS).map(move |b| (s, b))) {
        play(&Stage::new(seed, background), args.frames, chosen, &mut scores, &mut gestures);
    }
    for (variant, score) in chosen.iter().zip(&mut scores) {
        score.row(variant.name, out)?;
    }
    let late = gestures.noticed.iter().max().copied().unwrap_or(0);
    writeln!(
        out,
        "\ngestures: {:.1} % of {} steady frames right; {} changes, noticed after {:.2} s at the latest",
        100.0 * gestures.right as f64 / gestures.steady.max(1) as f64,
        gestures.steady,
        gestures.noticed.len(),
        late as f64 / RATE_HZ,
    )?;
    Ok(0)
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

fn play(stage: &Stage, frames: u64, variants: &[Variant], scores: &mut [Score], gestures: &mut Gestures) {
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

impl Score {
    fn count(&mut self, tips: &[TrackedFingertip], truth: &Truth) {
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

    fn row(&mut self, name: &str, out: &mut dyn Write) -> io::Result<()> {
        self.errors.sort_by(f64::total_cmp);
        let n = self.errors.len().max(1);
        let at = |share: f64| self.errors.get((share * n as f64) as usize).copied().unwrap_or(f64::INFINITY);
        self.blind.sort_by(f64::total_cmp);
        let blind = self.blind.get(self.blind.len() / 2).copied().unwrap_or(f64::INFINITY);
        let within = self.errors.iter().filter(|e| **e <= 6.0).count();
        let percent = |part: usize, of: usize| 100.0 * part as f64 / of.max(1) as f64;
        writeln!(
            out,
            "| {name} | {:.2} | {:.2} | {:.1} % | {:.2} % | {:.2} % | {} | {} |",
            at(0.5),
            at(0.95),
            percent(within, n),
            percent(self.lost, n),
            percent(self.false_tracks, self.tracks),
            self.again.iter().max().copied().unwrap_or(0),
            if blind.is_finite() { format!("{blind:.1}") } else { "none".into() },
        )
    }
}

impl Gestures {
    fn count(&mut self, number: u64, truth: &Truth, right: bool, noticed: &mut bool) {
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

//! Segments a demonstration: rest, the first swipe, which defines the workspace, and the periodic part after it.
//!
//! Works on tracked positions of the tool: noisy, at the camera's rate, with missing samples. It does not estimate
//! the frequency; [`crate::AdaptiveOscillator`] does.

use std::collections::VecDeque;

use nalgebra::Point3;
use serde::{Deserialize, Serialize};

use crate::constants::POSITIVE;
use crate::error::{MotionError, finite, within};

constants! {
    /// The constants of a [`DemonstrationSegmenter`].
    pub struct SegmenterConfig {
        /// The tool rests when it stays within `rest_radius` of a place for this long, s.
        rest_time: f64 = 0.35, POSITIVE;
        /// Largest RMS distance from the mean that still counts as rest, m; must cover the noise.
        rest_radius: f64 = 0.012, POSITIVE;
        /// How far from rest a motion begins, m.
        departure: f64 = 0.03, POSITIVE;
        /// The shortest swipe, m.
        shortest_swipe: f64 = 0.06, POSITIVE;
        /// The largest deviation from a straight line, as a share of the swipe's length.
        crookedness: f64 = 0.35, POSITIVE;
        /// How far the tool must come back for the swipe to be over, m.
        return_distance: f64 = 0.025, POSITIVE;
        /// The demonstration has ended when the tool rests for this long, s; longer than a slow motion takes to
        /// reverse.
        end_time: f64 = 2.2, POSITIVE;
        /// A gap between samples longer than this restarts the segmentation, s.
        longest_gap: f64 = 1.5, POSITIVE;
    }
}

/// The first swipe of a demonstration.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Swipe {
    /// Where it began, m.
    pub start: Point3<f64>,
    /// Where it ended, m.
    pub end: Point3<f64>,
    /// When it began, s.
    pub start_time: f64,
    /// When it ended, s.
    pub end_time: f64,
}

impl Swipe {
    /// The centre of the workspace, m.
    pub fn centre(&self) -> Point3<f64> {
        nalgebra::center(&self.start, &self.end)
    }

    /// Width (x), depth (y) and height (z) of the workspace, m: start and end are opposite corners.
    pub fn size(&self) -> nalgebra::Vector3<f64> {
        (self.end - self.start).abs()
    }
}

/// The stage of a demonstration.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DemonstrationStage {
    /// No rest was seen yet.
    Waiting,
    /// The tool rests; the swipe may begin.
    Rest,
    /// The tool has left its rest.
    Swiping,
    /// The swipe is over; the periodic part may begin.
    Swiped,
    /// The periodic part is in progress.
    Periodic,
    /// The tool rests again: the demonstration is over.
    Ended,
}

/// The segmentation of a demonstration so far.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Demonstration {
    /// The stage.
    pub stage: DemonstrationStage,
    /// The swipe, once it is over.
    pub swipe: Option<Swipe>,
    /// When the periodic movement began (including the way to it), s.
    pub periodic_since: Option<f64>,
}

/// Divides a demonstration into its parts, sample by sample.
#[derive(Debug, Clone)]
pub struct DemonstrationSegmenter {
    config: SegmenterConfig,
    recent: VecDeque<(f64, Point3<f64>)>,
    known: Demonstration,
    rest: Option<RestingPlace>,
    track: Vec<(f64, Point3<f64>)>,
}

#[derive(Debug, Clone, Copy)]
struct RestingPlace {
    place: Point3<f64>,
    until: f64,
}

/// Largest number of samples of a swipe; longer tracks are not swipes.
const MAX_TRACK: usize = 4000;

impl DemonstrationSegmenter {
    /// A segmenter before its first sample.
    ///
    /// # Errors
    /// When a constant is not positive.
    pub fn new(config: SegmenterConfig) -> Result<Self, MotionError> {
        config.check_ranges()?;
        let known = Demonstration { stage: DemonstrationStage::Waiting, swipe: None, periodic_since: None };
        Ok(Self { config, recent: VecDeque::new(), known, rest: None, track: Vec::new() })
    }

    /// Processes the position `point` (m) of the tool at `time` (s, increasing); returns the segmentation so far.
    ///
    /// # Errors
    /// When a value is not finite or the time does not increase; the sample is ignored.
    pub fn observe(&mut self, time: f64, point: Point3<f64>) -> Result<Demonstration, MotionError> {
        finite("time", &[time])?;
        finite("point", point.coords.as_slice())?;
        let last = self.recent.back().map_or(f64::NEG_INFINITY, |(t, _)| *t);
        if time <= last {
            let high = f64::INFINITY;
            return Err(MotionError::OutOfRange { what: "time", value: time, low: last, high });
        }
        within("time", time, -1e12, 1e12)?;
        if time - last > self.config.longest_gap && self.known.swipe.is_none() {
            self.start_anew();
        }
        self.recent.push_back((time, point));
        let span = self.config.end_time.max(self.config.rest_time);
        while self.recent.front().is_some_and(|(t, _)| time - t > span) {
            self.recent.pop_front();
        }
        self.advance(time, point);
        Ok(self.known)
    }

    /// The segmentation so far.
    pub fn known(&self) -> Demonstration {
        self.known
    }

    fn start_anew(&mut self) {
        self.known.stage = DemonstrationStage::Waiting;
        self.recent.clear();
        self.track.clear();
        self.rest = None;
    }

    fn advance(&mut self, time: f64, point: Point3<f64>) {
        let resting = self.resting(self.config.rest_time);
        match self.known.stage {
            DemonstrationStage::Waiting => {
                if let Some(place) = resting {
                    self.rest = Some(RestingPlace { place, until: time });
                    self.known.stage = DemonstrationStage::Rest;
                }
            }
            DemonstrationStage::Rest => self.at_rest(time, point, resting),
            DemonstrationStage::Swiping => self.swiping(time, point, resting),
            DemonstrationStage::Swiped => self.swiped(time, resting),
            DemonstrationStage::Periodic => {
                if self.resting(self.config.end_time).is_some() {
                    self.known.stage = DemonstrationStage::Ended;
                }
            }
            DemonstrationStage::Ended => {}
        }
    }

    fn at_rest(&mut self, time: f64, point: Point3<f64>, resting: Option<Point3<f64>>) {
        let Some(rest) = &mut self.rest else { return };
        if let Some(place) = resting {
            // The place follows slowly, so that the beginning of the motion does not move it.
            let near = (place - rest.place).norm() < self.config.departure;
            rest.place = if near { rest.place + (place - rest.place) * 0.2 } else { place };
            rest.until = time;
        }
        self.track.push((time, point));
        if self.track.len() > 60 {
            self.track.remove(0);
        }
        let place = rest.place;
        if self.smooth().is_some_and(|p| (p - place).norm() > self.config.departure) {
            self.known.stage = DemonstrationStage::Swiping;
        }
    }

    fn swiping(&mut self, time: f64, point: Point3<f64>, resting: Option<Point3<f64>>) {
        self.track.push((time, point));
        let (Some(rest), Some(now)) = (self.rest, self.smooth()) else { return };
        let farthest = self.track.iter().map(|(_, p)| (p - rest.place).norm()).fold(0.0, f64::max);
        let back = farthest - (now - rest.place).norm() > self.config.return_distance;
        if resting.is_none() && !back && self.track.len() < MAX_TRACK {
            return;
        }
        match self.swipe(rest) {
            Some(swipe) => {
                self.known.swipe = Some(swipe);
                self.known.stage = DemonstrationStage::Swiped;
                self.rest = resting.map(|place| RestingPlace { place, until: time });
                self.known.periodic_since = back.then_some(swipe.end_time);
                if back {
                    self.known.stage = DemonstrationStage::Periodic;
                }
            }
            None => self.start_anew(),
        }
        self.track.clear();
    }

    /// The swipe on the track, if it is long and straight enough.
    fn swipe(&self, rest: RestingPlace) -> Option<Swipe> {
        let distance = |p: &Point3<f64>| (p - rest.place).norm();
        // The farthest samples are averaged, as a single one contains its noise.
        let farthest = self.track.iter().map(|(_, p)| distance(p)).fold(0.0, f64::max);
        let late: Vec<_> = self.track.iter().filter(|(_, p)| farthest - distance(p) < 0.012).collect();
        let sum = late.iter().map(|(_, p)| p.coords).sum::<nalgebra::Vector3<f64>>();
        let end = Point3::from(sum / late.len().max(1) as f64);
        let chord = end - rest.place;
        let length = chord.norm();
        if length < self.config.shortest_swipe {
            return None;
        }
        let end_time = late.first()?.0;
        let off = |p: &Point3<f64>| (p - rest.place).cross(&chord).norm() / length;
        let crooked =
            self.track.iter().filter(|(t, _)| *t <= end_time).map(|(_, p)| off(p)).fold(0.0, f64::max);
        let noise = 2.0 * self.config.rest_radius;
        if crooked > self.config.crookedness * length + noise {
            return None;
        }
        let start_time =
            self.track.iter().rev().find(|(_, p)| distance(p) < self.config.departure).map(|s| s.0);
        Some(Swipe { start: rest.place, end, start_time: start_time.unwrap_or(rest.until), end_time })
    }

    fn swiped(&mut self, time: f64, resting: Option<Point3<f64>>) {
        if let Some(place) = resting {
            self.rest = Some(RestingPlace { place, until: time });
            return;
        }
        let place = self.rest.map(|rest| rest.place);
        let away = |place: Point3<f64>| {
            self.smooth().is_some_and(|p| (p - place).norm() > 0.5 * self.config.departure)
        };
        if place.is_none_or(away) {
            self.known.periodic_since = Some(self.rest.map_or(time, |rest| rest.until));
            self.known.stage = DemonstrationStage::Periodic;
        }
    }

    /// The mean of the last three samples.
    fn smooth(&self) -> Option<Point3<f64>> {
        let n = self.recent.len().min(3);
        let sum = self.recent.iter().rev().take(n).map(|(_, p)| p.coords).sum::<nalgebra::Vector3<f64>>();
        (n > 0).then(|| Point3::from(sum / n as f64))
    }

    /// The mean position over the last `span` s, if the tool has rested there.
    fn resting(&self, span: f64) -> Option<Point3<f64>> {
        let now = self.recent.back()?.0;
        let within = || self.recent.iter().filter(move |(t, _)| now - t <= span);
        let n = within().count() as f64;
        let covered = now - within().next()?.0;
        // A sample may be missing at the beginning of the span.
        if n < 4.0 || covered < span - 0.15 {
            return None;
        }
        let mean = Point3::from(within().map(|(_, p)| p.coords).sum::<nalgebra::Vector3<f64>>() / n);
        let square = within().map(|(_, p)| (p - mean).norm_squared()).sum::<f64>() / n;
        (square.sqrt() <= self.config.rest_radius).then_some(mean)
    }
}

//! Gaze selection: where to look so that what the running skills need is known well enough.
//!
//! After Welke, Schiebener, Asfour and Dillmann, *Gaze selection during manipulation tasks*, ICRA 2013: saliency is the probability that
//! a thing is further from where it is believed to be than the task bears. It grows while the thing is not seen. Unlike there, one view may
//! hold several things, so that all directions between things are tried, and what a view would show is weighed against the turn to it.
//! This module knows no robot: whoever asks says which direction the eyes reach instead of a wanted one.

use nalgebra::{Unit, Vector3};

use crate::constants::POSITIVE;
use crate::error::MotionError;

constants! {
    /// The constants of a [`GazeSelection`].
    pub struct GazeConfig {
        /// Half the angle that a picture holds across, rad.
        across: f64 = 0.44, POSITIVE;
        /// Half the angle that it holds up, rad.
        up: f64 = 0.44, POSITIVE;
        /// Share of the picture, from its middle, within which a thing is seen as well as in the middle.
        core: f64 = 0.6, 0.0..=0.99;
        /// What a turn of one radian costs, in saliency.
        turn_cost: f64 = 0.15, 0.0..=1e3;
        /// By how much another view must be better than the present one, in saliency.
        margin: f64 = 0.15, 0.0..=1e3;
        /// How long a view is kept at least, s.
        dwell: f64 = 0.4, 0.0..=1e3;
    }
}

/// How views are chosen.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum GazeStrategy {
    /// By saliency: the view that serves the needs best.
    #[default]
    Saliency,
    /// One thing after the other, in the order of their names, whatever their needs: for comparison.
    RoundRobin,
    /// The eyes stay where they look: for comparison.
    Fixed,
}

/// A view that the eyes have not come to after so long is left nevertheless by those who go round, s.
const NOT_REACHED: f64 = 2.0;
/// The eyes have come to a view when it is so near, rad.
const ARRIVED: f64 = 0.1;
/// So many things are weighed, those that need it most: the number of views doubles with each.
const MOST_THINGS: usize = 6;

/// A thing that might be looked at.
#[derive(Debug, Clone, PartialEq)]
pub struct GazeTarget {
    /// What tells it from the others, from one choice to the next.
    pub name: String,
    /// From the eyes to it.
    pub direction: Unit<Vector3<f64>>,
    /// How much it needs to be looked at: its [`saliency`] times its weight.
    pub need: f64,
    /// How much it counts for the middle of a view that holds it.
    pub weight: f64,
}

/// The view that was chosen.
#[derive(Debug, Clone, PartialEq)]
pub struct GazeView {
    /// The names of the things for which it was chosen, in order.
    pub of: Vec<String>,
    /// Where to look.
    pub direction: Unit<Vector3<f64>>,
    /// Need that it would serve less the cost of the turn.
    pub score: f64,
    /// Whether it is another one than before.
    pub changed: bool,
}

/// The probability that something is further than `within` m from where it is believed to be, if its place has a standard deviation of
/// `deviation` m along each axis: 1 less the distribution function of Maxwell at their ratio.
pub fn saliency(deviation: f64, within: f64) -> f64 {
    if !(deviation > 0.0 && deviation.is_finite()) {
        return f64::from(u8::from(deviation == f64::INFINITY || within <= 0.0));
    }
    let x = (within / deviation).max(0.0);
    let density = (2.0 / std::f64::consts::PI).sqrt() * x * libm::exp(-x * x / 2.0);
    let inside = libm::erf(x / std::f64::consts::SQRT_2) - density;
    (1.0 - inside).clamp(0.0, 1.0)
}

/// Chooses views one after the other, and keeps one for some time so that the eyes do not swing between two.
#[derive(Debug, Clone, Default)]
pub struct GazeSelection {
    config: GazeConfig,
    strategy: GazeStrategy,
    /// The things of the present view, and for how long it has been kept, s.
    present: Option<(Vec<String>, f64)>,
    /// For how long the eyes have been there, s.
    arrived: f64,
    /// Where they looked at first.
    fixed: Option<Unit<Vector3<f64>>>,
}

impl GazeSelection {
    /// A selection of views that has chosen none yet.
    ///
    /// # Errors
    /// [`MotionError::OutOfRange`] when a constant is outside its range.
    pub fn new(config: GazeConfig, strategy: GazeStrategy) -> Result<Self, MotionError> {
        config.check_ranges()?;
        Ok(Self { config, strategy, ..Self::default() })
    }

    /// Whether a thing in this direction is in the picture of eyes that look along `axis` and are level.
    pub fn in_view(&self, axis: &Unit<Vector3<f64>>, thing: &Unit<Vector3<f64>>) -> bool {
        self.seen(axis, thing) > 0.0
    }

    /// How well a thing is seen, 0 to 1, by eyes that look along `axis` and are level.
    fn seen(&self, axis: &Unit<Vector3<f64>>, thing: &Unit<Vector3<f64>>) -> f64 {
        let across = axis.cross(&Vector3::z()).try_normalize(1e-6).unwrap_or_else(Vector3::x);
        let up = across.cross(axis);
        let ahead = thing.dot(axis);
        let off = [(across, self.config.across), (up, self.config.up)]
            .map(|(side, half)| libm::atan2(thing.dot(&side).abs(), ahead) / half);
        ((1.0 - off[0].max(off[1])) / (1.0 - self.config.core)).clamp(0.0, 1.0)
    }

    /// The direction from which some things are seen together: their middle. A place nearer to where the eyes are would spare turns, but hands at the
    /// border of the picture are read less well.
    fn middle(&self, of: &[&GazeTarget]) -> Option<Unit<Vector3<f64>>> {
        let middle = of.iter().map(|t| t.direction.into_inner() * t.weight.max(1e-3)).sum::<Vector3<f64>>();
        let middle = Unit::try_new(middle, 1e-6)?;
        // A view that cuts off one of its things is none of both.
        of.iter().all(|t| self.in_view(&middle, &t.direction)).then_some(middle)
    }

    /// The view for the next `dt` s, when the eyes look along `axis`; `None` where there is nothing to look at. `reached` is where the eyes
    /// come to look when they are to look along a direction.
    pub fn choose(
        &mut self,
        dt: f64,
        axis: &Unit<Vector3<f64>>,
        targets: &[GazeTarget],
        mut reached: impl FnMut(&Unit<Vector3<f64>>) -> Unit<Vector3<f64>>,
    ) -> Option<GazeView> {
        match self.strategy {
            GazeStrategy::Saliency => {}
            GazeStrategy::RoundRobin => return self.next(dt, axis, targets, reached),
            GazeStrategy::Fixed => {
                let direction = *self.fixed.get_or_insert(*axis);
                return Some(GazeView { of: Vec::new(), direction, score: 0.0, changed: false });
            }
        }
        let mut most: Vec<&GazeTarget> = targets.iter().collect();
        most.sort_by(|a, b| b.need.total_cmp(&a.need).then_with(|| a.name.cmp(&b.name)));
        most.truncate(MOST_THINGS);
        let last = self.present.take();
        let score = |direction: &Unit<Vector3<f64>>| {
            let served: f64 = targets.iter().map(|t| t.need * self.seen(direction, &t.direction)).sum();
            served - self.config.turn_cost * axis.angle(direction)
        };
        let mut views: Vec<GazeView> = (1_u32..1 << most.len())
            .filter_map(|members| {
                let of: Vec<&GazeTarget> =
                    most.iter().enumerate().filter(|(i, _)| members >> i & 1 == 1).map(|(_, t)| *t).collect();
                let direction = self.middle(&of)?;
                let mut of: Vec<String> = of.into_iter().map(|t| t.name.clone()).collect();
                of.sort();
                Some(GazeView { score: score(&direction), of, direction, changed: true })
            })
            .collect();
        views.sort_by(|a, b| {
            b.score
                .total_cmp(&a.score)
                .then_with(|| b.of.len().cmp(&a.of.len()))
                .then_with(|| a.of.cmp(&b.of))
        });
        let mut rescore = |view: &mut GazeView| {
            view.direction = reached(&view.direction);
            view.score = score(&view.direction);
        };
        let mut best = views.first().cloned()?;
        rescore(&mut best);
        for other in views.iter_mut().skip(1) {
            if other.score <= best.score {
                break;
            }
            rescore(other);
            if other.score > best.score {
                best = other.clone();
            }
        }
        let present = last.and_then(|(of, kept)| {
            let mut view = views.into_iter().find(|view| view.of == of)?;
            rescore(&mut view);
            Some((view, kept + dt))
        });
        let keeps = |(view, kept): &(GazeView, f64)| {
            *kept < self.config.dwell || best.score <= view.score + self.config.margin || best.of == view.of
        };
        let (chosen, kept) = match present.filter(keeps) {
            Some((view, kept)) => (GazeView { changed: false, ..view }, kept),
            None => (best, 0.0),
        };
        self.present = Some((chosen.of.clone(), kept));
        Some(chosen)
    }

    /// The thing whose turn it is: each is looked at for the dwell, once the eyes have come to it.
    fn next(
        &mut self,
        dt: f64,
        axis: &Unit<Vector3<f64>>,
        targets: &[GazeTarget],
        mut reached: impl FnMut(&Unit<Vector3<f64>>) -> Unit<Vector3<f64>>,
    ) -> Option<GazeView> {
        let mut all: Vec<&GazeTarget> = targets.iter().collect();
        all.sort_by(|a, b| a.name.cmp(&b.name));
        let (last, kept) = self.present.take().unwrap_or_default();
        let of = |target: &&&GazeTarget| last.first() == Some(&target.name);
        let present = all.iter().find(of).filter(|target| {
            let there = axis.angle(&reached(&target.direction)) < ARRIVED;
            self.arrived = if there { self.arrived + dt } else { 0.0 };
            self.arrived < self.config.dwell && kept + dt < NOT_REACHED
        });
        let after = || all.iter().find(|target| last.first().is_none_or(|name| target.name > *name));
        let target = present.or_else(after).or_else(|| all.first())?;
        let changed = present.is_none();
        if changed {
            self.arrived = 0.0;
        }
        let of = vec![target.name.clone()];
        self.present = Some((of.clone(), if changed { 0.0 } else { kept + dt }));
        Some(GazeView { of, direction: reached(&target.direction), score: target.need, changed })
    }
}

#[cfg(test)]
mod tests;

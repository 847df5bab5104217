//! Tracks up to five fingertips as the nodes of one contour with a particle filter.
//!
//! A particle is a whole contour: the positions of all tips in this frame and in the one before. The learned
//! [`FingerARModel`] moves the contour. The frame's Hough candidates and the distances between neighbours on the
//! contour weight its nodes, so that two nodes do not lock onto one finger. The nodes are weighted and resampled one
//! after the other, because ten coordinates at once would need far more particles. Some samples of each node are drawn
//! at the candidates, so that a lost tip is found again.
//!
//! # Source
//! Do, Asfour, Dillmann 2011 (tips as contour nodes); MacCormick, Isard 2000 (node after node: partitioned sampling);
//! Isard, Blake 1998 (draws from the image: ICondensation).

use armarium_values::random::StandardNormal;
use nalgebra::{Matrix2, Point2, Vector2};
use rand::{Rng, RngExt};

use super::ar_model::FingerARModel;
use super::hough::TipCandidate;
use crate::particles::resample;

/// The filter's input: camera and frame.
#[derive(Clone, Copy, Debug)]
pub struct FilterFrame<'a> {
    /// Focal length and principal point, px.
    pub focal: f64,
    /// Principal point, px.
    pub center: [f64; 2],
    /// Radius of a fingertip, px.
    pub radius: f64,
    /// Centre of the palm, px: tips are ordered around it.
    pub palm: Point2<f64>,
    /// The tip candidates of the frame.
    pub candidates: &'a [TipCandidate],
}

impl FilterFrame<'_> {
    /// A place in normalised image coordinates.
    fn normalised(&self, px: &Point2<f64>) -> Point2<f64> {
        Point2::from((px.coords - Vector2::from(self.center)) / self.focal)
    }
}

/// A node of the contour.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContourNode {
    /// Number of the finger, constant while it is tracked.
    pub id: u64,
    /// Centre of the circle fitted to the fingertip, px.
    pub px: Point2<f64>,
    /// Standard deviation of the particles, px.
    pub deviation: f64,
    /// Frames since its last candidate.
    pub unseen: u32,
}

/// The filter.
#[derive(Clone, Debug)]
pub struct ParticleFilterFingerTracking {
    model: FingerARModel,
    particles: Vec<Contour>,
    nodes: Vec<NodeIdentity>,
    next_id: u64,
    count: usize,
}

/// Positions of all nodes, normalised image coordinates.
#[derive(Clone, Debug, Default)]
struct Contour {
    now: Vec<Point2<f64>>,
    before: Vec<Point2<f64>>,
}

#[derive(Clone, Debug)]
struct NodeIdentity {
    id: u64,
    unseen: u32,
}

/// Share of a node's samples that are drawn at the candidates.
const FROM_IMAGE: f64 = 0.25;
/// Largest distance of a candidate from its node, tip radii.
const MAX_DISTANCE: f64 = 2.5;
/// Likelihood of a tip at a place without a candidate.
const MIN_LIKELIHOOD: f64 = 0.02;
/// Frames after which a node without a candidate is dropped: while the hand is seen, and while it is not.
const MAX_UNSEEN: u32 = 3;
const MAX_UNSEEN_BLIND: u32 = 12;
/// Least score of a candidate that starts a node.
const MIN_START_SCORE: f64 = 0.5;
/// Most tips of a hand.
const MAX_TIPS: usize = 5;

impl ParticleFilterFingerTracking {
    /// A filter of `count` particles without any tips.
    pub fn new(model: FingerARModel, count: usize) -> Self {
        let particles = vec![Contour::default(); count.max(2)];
        Self { model, particles, nodes: Vec::new(), next_id: 1, count }
    }

    /// Drops all tips.
    pub fn clear(&mut self) {
        *self = Self { next_id: self.next_id, ..Self::new(self.model, self.count) };
    }

    /// Predicts the contour for a frame without a detected hand. Returns the number of tips that are still
    /// tracked.
    pub fn predict(&mut self, rng: &mut impl Rng) -> usize {
        self.move_contours(rng);
        self.nodes.iter_mut().for_each(|node| node.unseen += 1);
        self.drop_unseen(MAX_UNSEEN_BLIND);
        self.nodes.len()
    }

    /// Drops the nodes that have been without a candidate in more frames.
    fn drop_unseen(&mut self, most: u32) {
        for i in (0..self.nodes.len()).rev() {
            if self.nodes[i].unseen > most {
                self.remove(i);
            }
        }
    }

    /// Updates the contour with a frame's candidates.
    pub fn update(&mut self, frame: &FilterFrame<'_>, rng: &mut impl Rng) {
        self.move_contours(rng);
        for i in 0..self.nodes.len() {
            self.weigh(i, frame, rng);
        }
        self.count_unseen(frame);
        self.start(frame, rng);
    }

    /// The tips in order around the palm, px.
    pub fn nodes(&self, focal: f64, center: [f64; 2]) -> Vec<ContourNode> {
        let node = |(i, node): (usize, &NodeIdentity)| {
            let (mean, deviation) = self.mean(i);
            let px = Point2::from(mean.coords * focal + Vector2::from(center));
            ContourNode { id: node.id, px, deviation: deviation * focal, unseen: node.unseen }
        };
        self.nodes.iter().enumerate().map(node).collect()
    }

    fn mean(&self, i: usize) -> (Point2<f64>, f64) {
        let n = self.particles.len() as f64;
        let mean = self.particles.iter().fold(Vector2::zeros(), |s, p| s + p.now[i].coords) / n;
        let variance =
            self.particles.iter().map(|p| (p.now[i].coords - mean).norm_squared()).sum::<f64>() / n;
        (Point2::from(mean), (variance / 2.0).sqrt())
    }

    fn move_contours(&mut self, rng: &mut impl Rng) {
        let factor = self.model.noise.cholesky().map_or_else(Matrix2::zeros, |c| c.l());
        for particle in &mut self.particles {
            // Most of a hand's motion is common to its fingers.
            let common = normal2(rng);
            for (now, before) in particle.now.iter_mut().zip(&mut particle.before) {
                let noise = factor * (common * 0.8 + normal2(rng) * 0.6);
                let next = self.model.predict(now, before) + noise;
                *before = std::mem::replace(now, next);
            }
        }
    }

    /// Resamples by the likelihood of one node.
    fn weigh(&mut self, i: usize, frame: &FilterFrame<'_>, rng: &mut impl Rng) {
        let radius = frame.radius / frame.focal;
        let (expected, spread) = self.mean(i);
        let gate = MAX_DISTANCE * radius + 2.0 * spread;
        let near: Vec<(Point2<f64>, f64)> = frame
            .candidates
            .iter()
            .map(|c| (frame.normalised(&c.center), c.score))
            .filter(|(c, _)| (c - expected).norm() < gate)
            .collect();
        if near.is_empty() {
            return;
        }
        let own = nearest(&near, &expected);
        let sigma = (0.18 * radius).max(0.8 / frame.focal);
        let neighbours: Vec<(usize, f64)> = [i.checked_sub(1), (i + 1 < self.nodes.len()).then_some(i + 1)]
            .into_iter()
            .flatten()
            .map(|j| (j, (self.mean(j).0 - expected).norm()))
            .collect();
        let mut weights = Vec::with_capacity(self.particles.len());
        for particle in &mut self.particles {
            if rng.random::<f64>() < FROM_IMAGE {
                particle.now[i] = own + normal2(rng) * (0.5 * sigma);
            }
            let at = particle.now[i];
            let off = |c: &Point2<f64>| (c - at).norm_squared() / (2.0 * sigma * sigma);
            let image: f64 = near.iter().map(|(c, score)| score * libm::exp(-off(c))).sum();
            let contour: f64 = neighbours
                .iter()
                .map(|&(j, distance)| {
                    let off = ((particle.now[j] - at).norm() - distance) / (0.35 * distance + radius);
                    libm::exp(-0.5 * off * off)
                })
                .product();
            weights.push((MIN_LIKELIHOOD + image) * contour.max(1e-6));
        }
        // Whole contours are drawn.
        resample(&mut self.particles, &weights, rng);
    }

    /// Counts the frames in which a node had no candidate, and drops nodes that had none for too long.
    fn count_unseen(&mut self, frame: &FilterFrame<'_>) {
        let nodes = self.nodes(frame.focal, frame.center);
        let mut free: Vec<&TipCandidate> = frame.candidates.iter().collect();
        let mut order: Vec<usize> = (0..nodes.len()).collect();
        order.sort_by_key(|&i| nodes[i].unseen);
        for i in order {
            let distance = |k: &usize| (free[*k].center - nodes[i].px).norm();
            let nearest = (0..free.len()).min_by(|a, b| distance(a).total_cmp(&distance(b)));
            let own = nearest.filter(|k| distance(k) < 1.3 * frame.radius);
            self.nodes[i].unseen = if own.is_some() { 0 } else { self.nodes[i].unseen + 1 };
            own.map(|k| free.remove(k));
        }
        self.drop_unseen(MAX_UNSEEN);
    }

    fn remove(&mut self, i: usize) {
        self.nodes.remove(i);
        for particle in &mut self.particles {
            particle.now.remove(i);
            particle.before.remove(i);
        }
    }

    /// Starts nodes at unassigned candidates; when all nodes are in use, one that lost its finger is
    /// replaced.
    fn start(&mut self, frame: &FilterFrame<'_>, rng: &mut impl Rng) {
        for candidate in frame.candidates.iter().filter(|c| c.score >= MIN_START_SCORE) {
            let nodes = self.nodes(frame.focal, frame.center);
            if nodes.iter().any(|n| (n.px - candidate.center).norm() < 1.3 * frame.radius) {
                continue;
            }
            if self.nodes.len() >= MAX_TIPS {
                let lost = (0..nodes.len()).filter(|&i| nodes[i].unseen > 0).max_by_key(|&i| nodes[i].unseen);
                let Some(lost) = lost else { continue };
                self.remove(lost);
            }
            let nodes = self.nodes(frame.focal, frame.center);
            let turn = |p: &Point2<f64>| libm::atan2(p.y - frame.palm.y, p.x - frame.palm.x);
            let own = turn(&candidate.center);
            let at = nodes.iter().position(|n| turn(&n.px) > own).unwrap_or(nodes.len());
            let place = frame.normalised(&candidate.center);
            self.nodes.insert(at, NodeIdentity { id: self.next_id, unseen: 0 });
            self.next_id += 1;
            for particle in &mut self.particles {
                let start = place + normal2(rng) * (1.0 / frame.focal);
                particle.now.insert(at, start);
                particle.before.insert(at, start);
            }
        }
    }
}

fn nearest(places: &[(Point2<f64>, f64)], to: &Point2<f64>) -> Point2<f64> {
    let distance = |p: &(Point2<f64>, f64)| (p.0 - to).norm();
    places.iter().min_by(|a, b| distance(a).total_cmp(&distance(b))).map_or(*to, |p| p.0)
}

fn normal2(rng: &mut impl Rng) -> Vector2<f64> {
    Vector2::from_fn(|_, _| rng.sample(StandardNormal))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    fn tip(x: f64, y: f64) -> TipCandidate {
        TipCandidate { center: Point2::new(x, y), radius: 8.0, outward: -Vector2::y(), score: 0.9 }
    }

    fn frame(candidates: &[TipCandidate]) -> FilterFrame<'_> {
        let palm = Point2::new(300.0, 300.0);
        FilterFrame { focal: 515.0, center: [320.0, 240.0], radius: 8.0, palm, candidates }
    }

    fn px(filter: &ParticleFilterFingerTracking) -> Vec<ContourNode> {
        filter.nodes(515.0, [320.0, 240.0])
    }

    /// Five tips that move at constant speed.
    fn tips(t: f64) -> Vec<TipCandidate> {
        (0..5).map(|i| tip(220.0 + 35.0 * f64::from(i) + 6.0 * t, 180.0 + 3.0 * t)).collect()
    }

    #[test]
    fn follows_five_tips_through_a_blackout_and_keeps_them_apart() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut filter = ParticleFilterFingerTracking::new(FingerARModel::default(), 200);
        for t in 0..20 {
            filter.update(&frame(&tips(f64::from(t))), &mut rng);
        }
        let ids: Vec<u64> = px(&filter).iter().map(|n| n.id).collect();
        assert_eq!(ids.len(), 5);
        for t in 20..23 {
            assert_eq!(filter.predict(&mut rng), 5, "{t}");
        }
        for t in 23..27 {
            filter.update(&frame(&tips(f64::from(t))), &mut rng);
        }
        let nodes = px(&filter);
        assert_eq!(nodes.iter().map(|n| n.id).collect::<Vec<_>>(), ids);
        for (node, truth) in nodes.iter().zip(tips(26.0)) {
            assert!((node.px - truth.center).norm() < 2.0, "{node:?} {truth:?}");
        }
    }

    #[test]
    fn a_finger_that_closes_is_given_up_and_a_new_one_taken() {
        let mut rng = ChaCha8Rng::seed_from_u64(6);
        let mut filter = ParticleFilterFingerTracking::new(FingerARModel::default(), 100);
        let all = tips(0.0);
        (0..5).for_each(|_| filter.update(&frame(&all), &mut rng));
        (0..6).for_each(|_| filter.update(&frame(&all[1..2]), &mut rng));
        assert_eq!(px(&filter).len(), 1);
        (0..2).for_each(|_| filter.update(&frame(&all[1..3]), &mut rng));
        assert_eq!(px(&filter).len(), 2);
        (0..20).for_each(|_| {
            filter.predict(&mut rng);
        });
        assert!(px(&filter).is_empty());
        filter.update(&frame(&[tip(f64::NAN, 0.0)]), &mut rng);
    }
}

//! The errors of a depth camera: noise and steps that grow with the square of the distance, no depth at edges, at grazing
//! angles, and out of its range.

use armarium_values::random::StandardNormal;
use armarium_visionx::DepthImage;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use crate::world::DepthSpec;

/// Number of random numbers that are drawn once; each row of a picture begins at a random one of them.
const TILE: usize = 1 << 16;
/// Neighbours whose depths differ by more than this share of it have an edge between them.
const EDGE: f32 = 0.05;

/// A depth camera.
#[derive(Clone, Debug)]
pub struct DepthSensor {
    spec: DepthSpec,
    seed: u64,
    /// Standard normal numbers.
    tile: Vec<f32>,
}

impl DepthSensor {
    /// A camera with these errors; `seed` determines the noise.
    pub fn new(spec: &DepthSpec, seed: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed ^ 0xdeb7);
        let drawn = if spec.noise > 0.0 { TILE } else { 0 };
        let tile = (0..drawn).map(|_| random.sample::<f64, _>(StandardNormal) as f32).collect();
        Self { spec: spec.clone(), seed, tile }
    }

    /// What it measures of the true depth along the optical axis, m; 0 where there is none. `focal` is the focal length in
    /// pixels, `frame` the picture's number.
    pub fn sense(&self, truth: DepthImage, focal: f64, frame: u64) -> DepthImage {
        if self.spec == DepthSpec::IDEAL {
            return truth;
        }
        let (w, holes) = (truth.width as usize, self.holes(&truth, focal as f32));
        let mut random = ChaCha8Rng::seed_from_u64(self.seed.rotate_left(7));
        random.set_stream(frame.wrapping_add(1));
        let mut sensed = truth;
        let none = vec![0.0; w];
        for (row, holes) in sensed.data.chunks_exact_mut(w.max(1)).zip(holes.chunks_exact(w.max(1))) {
            let start = random.random_range(0..TILE - w.min(TILE - 1));
            self.sense_row(row, holes, self.tile.get(start..start + w).unwrap_or(&none));
        }
        sensed
    }

    /// One row, without branches, so that the compiler does several pixels at once.
    fn sense_row(&self, row: &mut [f32], holes: &[u8], noise: &[f32]) {
        let ([near, far], sigma, step) =
            (self.spec.range.map(|v| v as f32), self.spec.noise as f32, self.spec.step as f32);
        for ((z, hole), noise) in row.iter_mut().zip(holes).zip(noise) {
            let seen = (*hole == 0) & (*z >= near) & (*z <= far);
            let (measured, step) = (*z + noise * sigma * *z * *z, step * *z * *z);
            // Depths are positive and less than 2^31 steps: the conversion rounds down.
            let whole = (measured / step + 0.5) as i32 as f32 * step;
            let measured = if step > 0.0 { whole } else { measured };
            *z = if seen { measured } else { 0.0 };
        }
    }

    /// 1 for each pixel near an edge, or whose surface is seen under too large an angle.
    fn holes(&self, truth: &DepthImage, focal: f32) -> Vec<u8> {
        let (w, h) = (truth.width as usize, truth.height as usize);
        let mut holes = vec![0; w * h];
        // One pixel is z / focal wide. Squares are compared, as a root for each pixel takes longer than all the rest.
        let slope = match self.spec.grazing_deg < 90.0 {
            true => (libm::tan(self.spec.grazing_deg.to_radians()) as f32 / focal).powi(2),
            false => f32::INFINITY,
        };
        let (reach, edge) = (self.spec.edge as usize, if self.spec.edge > 0 { EDGE } else { f32::INFINITY });
        let mut edges = vec![0; w];
        for v in 0..h.saturating_sub(1) {
            let (row, below) = (&truth.data[v * w..(v + 1) * w], &truth.data[(v + 1) * w..(v + 2) * w]);
            let pixels = row.iter().zip(&row[1..]).zip(below);
            let marks = holes[v * w..(v + 1) * w].iter_mut().zip(&mut edges);
            for (((z, right), below), (hole, is_edge)) in pixels.zip(marks) {
                let (right, below) = (right - z, below - z);
                *is_edge = u8::from((right.abs() > edge * z) | (below.abs() > edge * z));
                *hole |= u8::from(right * right + below * below > slope * (z * z));
            }
            for (u, _) in edges.iter().enumerate().filter(|(_, is_edge)| **is_edge != 0) {
                for y in v.saturating_sub(reach - 1)..=(v + reach).min(h - 1) {
                    let row = y * w;
                    holes[row + u.saturating_sub(reach - 1)..=row + (u + reach).min(w - 1)].fill(1);
                }
            }
        }
        holes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wall(z: f32) -> DepthImage {
        DepthImage { width: 200, height: 100, data: vec![z; 20_000] }
    }

    fn deviation(z: f32) -> f64 {
        let sensor = DepthSensor::new(&DepthSpec { step: 0.0, ..DepthSpec::default() }, 3);
        let sensed = sensor.sense(wall(z), 500.0, 1);
        let squares: f64 = sensed.data.iter().map(|v| f64::from(v - z).powi(2)).sum();
        (squares / 20_000.0).sqrt()
    }

    #[test]
    fn noise_grows_with_the_square_of_the_distance_and_out_of_range_there_is_nothing() {
        assert!((deviation(1.0) / 1.4e-3 - 1.0).abs() < 0.05, "{}", deviation(1.0));
        assert!((deviation(2.0) / 5.6e-3 - 1.0).abs() < 0.05, "{}", deviation(2.0));
        let sensor = DepthSensor::new(&DepthSpec::default(), 3);
        assert!([0.3, 4.5].iter().all(|z| sensor.sense(wall(*z), 500.0, 1).data.iter().all(|v| *v == 0.0)));
        assert_eq!(sensor.sense(wall(1.0), 500.0, 7), sensor.sense(wall(1.0), 500.0, 7));
        assert_ne!(sensor.sense(wall(1.0), 500.0, 7), sensor.sense(wall(1.0), 500.0, 8));
    }

    #[test]
    fn depth_comes_in_steps() {
        let spec = DepthSpec { noise: 0.0, ..DepthSpec::default() };
        let sensed = DepthSensor::new(&spec, 3).sense(wall(1.7), 500.0, 1);
        let step = 2.8e-3 * 1.7f32 * 1.7;
        let steps = sensed.data[0] / step;
        assert!((steps - steps.round()).abs() < 1e-3 && (sensed.data[0] - 1.7).abs() <= step / 2.0);
    }

    #[test]
    fn edges_and_grazing_surfaces_are_holes() {
        let mut step = wall(1.0);
        for row in step.data.chunks_mut(200) {
            row[100..].fill(2.0);
        }
        let ideal = DepthSpec { edge: 1, ..DepthSpec::IDEAL };
        let sensed = DepthSensor::new(&ideal, 3).sense(step, 500.0, 1);
        assert_eq!(sensed.data[98..102], [1.0, 0.0, 0.0, 2.0]);
        // A floor that is seen under 85 degrees: its depth changes by tan(85 deg) / 500 of itself per pixel.
        let mut floor = wall(1.0);
        let growth = 1.0 + libm::tanf(85f32.to_radians()) / 500.0;
        for (v, row) in floor.data.chunks_mut(200).enumerate() {
            row.fill(growth.powi(v as i32));
        }
        let spec = DepthSpec { grazing_deg: 80.0, ..DepthSpec::IDEAL };
        let sensed = DepthSensor::new(&spec, 3).sense(floor.clone(), 500.0, 1);
        assert!(sensed.data[..19_800].iter().take(199).all(|v| *v == 0.0));
        let spec = DepthSpec { grazing_deg: 87.0, ..DepthSpec::IDEAL };
        assert_eq!(DepthSensor::new(&spec, 3).sense(floor.clone(), 500.0, 1), floor);
    }
}

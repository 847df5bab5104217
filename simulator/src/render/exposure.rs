//! Motion blur: what moves in the picture while the shutter is open is drawn at several instants, whose mean is the picture.
//!
//! What stands still is drawn once. The instants are so close that nothing moves farther than a pixel from one to the
//! next, up to [`MOST_INSTANTS`]. Depth is that of the middle of the exposure, and so are shadows.

use std::ops::Range;

use nalgebra::{Isometry3, Point3, UnitQuaternion};

use super::raster::Canvas;
use super::scene::{ExposureMotion, Viewpoint, VisibleScene};
use super::shading::Light;
use super::shadow::Shadow;
use super::{Rendering, draw_shape, faces, nearest_first};

/// Most instants at which what moves is drawn; an odd number.
const MOST_INSTANTS: usize = 15;
/// What moves by less during an exposure is not drawn twice, px: a lens smears as much, which is not drawn either.
const VISIBLE: f64 = 2.0;
/// At the border of a picture, a turn moves things by this many times as many pixels as in the middle: 1 + (x/z)^2.
const BORDER: f64 = 1.6;
/// Nearer than this, motions are estimated as if it were this far away, m.
const NEAREST: f64 = 0.1;
/// The distance at which the room is taken to be for the motion of its picture, m.
const ROOM: f64 = 1.0;

/// What there is to draw of a scene, from one viewpoint.
pub(super) struct Exposure<'a> {
    scene: &'a VisibleScene,
    shadows: &'a [Option<Shadow>],
    viewpoint: &'a Viewpoint,
    /// The shapes that can be drawn, the nearest first, each with its motion in the picture, px.
    order: Vec<(usize, f64)>,
    /// The motion of the room in the picture, px; `None` if it is not drawn.
    room: Option<f64>,
    /// The rows in which what moves can appear.
    rows: Range<usize>,
}

impl ExposureMotion {
    /// Whether nothing moves.
    pub(super) fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// A motion that goes on as from `before` to `now`, `factor` times as far.
    pub fn between(before: &Isometry3<f64>, now: &Isometry3<f64>, factor: f64) -> Self {
        let turn = (now.rotation * before.rotation.inverse()).scaled_axis() * factor;
        let shift = (now.translation.vector - before.translation.vector) * factor;
        let sound = shift.iter().chain(turn.iter()).all(|v| v.is_finite());
        if sound { Self { shift, turn } } else { Self::default() }
    }

    /// Where a thing is that is at `middle` in the middle of the exposure; `at` is from -0.5 (its begin) to 0.5.
    fn at(&self, middle: &Isometry3<f64>, at: f64) -> Isometry3<f64> {
        if self.is_none() {
            return *middle;
        }
        let turn = UnitQuaternion::from_scaled_axis(self.turn * at) * middle.rotation;
        Isometry3::from_parts((middle.translation.vector + self.shift * at).into(), turn)
    }
}

impl VisibleScene {
    fn motion(&self, shape: usize) -> ExposureMotion {
        self.motions.get(shape).copied().unwrap_or_default()
    }
}

impl<'a> Exposure<'a> {
    /// The canvas is the one to draw on; `room` is whether the room is drawn, too.
    pub(super) fn new(
        canvas: &Canvas,
        scene: &'a VisibleScene,
        shadows: &'a [Option<Shadow>],
        viewpoint: &'a Viewpoint,
        room: bool,
    ) -> Self {
        let mut exposure = Self { scene, shadows, viewpoint, order: Vec::new(), room: None, rows: 0..0 };
        for index in nearest_first(scene, &viewpoint.scene_from_camera.inverse()) {
            let (moved, rows) = exposure.moves(canvas, index);
            exposure.order.push((index, moved));
            exposure.rows = match exposure.rows {
                _ if moved <= VISIBLE => exposure.rows,
                none if none.is_empty() => rows,
                some => some.start.min(rows.start)..some.end.max(rows.end),
            };
        }
        if room {
            let ExposureMotion { shift, turn } = viewpoint.motion;
            let moved = (turn.norm() + shift.norm() / ROOM) * viewpoint.camera.focal;
            exposure.room = Some(moved);
            if moved > VISIBLE {
                exposure.rows = canvas.all_rows();
            }
        }
        exposure
    }

    /// Draws the pictures on an empty canvas.
    pub(super) fn draw(&self, mut canvas: Canvas) -> Rendering {
        let motions = self.order.iter().map(|(_, moved)| *moved).chain(self.room);
        let most = motions.fold(0.0, f64::max);
        if most <= VISIBLE {
            self.paint(&mut canvas, 0.0, |_| true);
            return canvas.finish();
        }
        let moves = |moved: f64| moved > VISIBLE;
        let rows = &self.rows;
        self.paint(&mut canvas, 0.0, |moved| !moves(moved));
        let (still, mut other) = (canvas.clone(), canvas.clone());
        self.paint(&mut canvas, 0.0, moves);
        let mut sums: Vec<u16> = canvas.bytes(rows).iter().map(|byte| u16::from(*byte)).collect();
        // An odd number, so that the middle of the exposure is one of them.
        let instants = (((most - 1.0) / 2.0).ceil() as usize * 2 + 1).min(MOST_INSTANTS);
        for instant in (0..instants).filter(|instant| 2 * instant + 1 != instants) {
            other.copy(rows, &still);
            self.paint(&mut other, (instant as f64 + 0.5) / instants as f64 - 0.5, moves);
            sums.iter_mut().zip(other.bytes(rows)).for_each(|(sum, byte)| *sum += u16::from(*byte));
        }
        // The mean, rounded: 16 bits of its reciprocal are exact enough for the sum of 15 bytes.
        let instants = instants as u32;
        let reciprocal = (1 << 16) / instants + 1;
        for (byte, sum) in canvas.bytes(rows).iter_mut().zip(sums) {
            *byte = (((u32::from(sum) + instants / 2) * reciprocal) >> 16) as u8;
        }
        canvas.finish()
    }

    /// Draws what moves so that `chosen` holds, where it is at an instant of the exposure.
    fn paint(&self, canvas: &mut Canvas, at: f64, chosen: impl Fn(f64) -> bool) {
        let camera_from_scene = self.camera_from_scene(at);
        let light = Light::new(&self.scene.light, &camera_from_scene);
        for (index, _) in self.order.iter().filter(|(_, moved)| chosen(*moved)) {
            let shape = &self.scene.shapes[*index];
            let camera_from_shape = camera_from_scene * self.scene_from_shape(*index, at);
            draw_shape(canvas, shape, self.shadows[*index].as_ref(), camera_from_shape, light);
        }
        if self.room.is_some_and(&chosen) {
            faces::room(canvas, &camera_from_scene, &self.scene.background);
        }
    }

    fn camera_from_scene(&self, at: f64) -> Isometry3<f64> {
        self.viewpoint.motion.at(&self.viewpoint.scene_from_camera, at).inverse()
    }

    fn scene_from_shape(&self, index: usize, at: f64) -> Isometry3<f64> {
        self.scene.motion(index).at(&self.scene.shapes[index].scene_from_shape, at)
    }

    /// By how many pixels a shape moves during the exposure, at most, and the rows in which it can appear; 0 for one out of sight.
    fn moves(&self, canvas: &Canvas, index: usize) -> (f64, Range<usize>) {
        if self.viewpoint.motion.is_none() && self.scene.motion(index).is_none() {
            return (0.0, 0..0);
        }
        let corners = self.scene.shapes[index].geometry.corners();
        let poses = [-0.5, 0.5].map(|at| self.camera_from_scene(at) * self.scene_from_shape(index, at));
        let ends = poses.map(|camera_from_shape| corners.map(|corner| camera_from_shape * corner));
        let rows = canvas.rows_of(ends.as_flattened());
        if rows.is_empty() {
            return (0.0, rows);
        }
        // Two bounds: by the ways of the corners, which is far too high for large things when the camera turns; and by the
        // turn and the shift about the camera, which is far too high for distant things that turn.
        let depth = |p: &Point3<f64>| p.z.max(NEAREST);
        let ways = ends[0].iter().zip(&ends[1]).map(|(a, b)| (b - a).norm() / depth(a).min(depth(b)));
        let ways = ways.fold(0.0, f64::max);
        let about = poses[1] * poses[0].inverse();
        let nearest = ends.as_flattened().iter().map(depth).fold(f64::INFINITY, f64::min);
        let about = BORDER * (about.rotation.angle() + about.translation.vector.norm() / nearest);
        (ways.min(about) * self.viewpoint.camera.focal, rows)
    }
}

//! The upper face of a table: grain, bumps, dirt and shadows.

use nalgebra::{Isometry3, Point3, Vector3};

use super::faces::{Face, Local, LocalRun, SIDES};
use super::raster::{Canvas, Colors, Lanes, lanes, nearest};
use super::scene::{Bump, DirtTexture};
use super::shading::{Light, MOTTLING, Shades, brightness, mix};
use super::shadow::Shadow;

/// Relative change of brightness by the grain.
const GRAIN: f32 = 0.10;
/// Texels of mottling per metre, across and along the grain.
const GRAIN_SCALE: [f32; 2] = [90.0, 500.0];
/// Number of iterations for the depth of a bump; each one leaves slope/tan(elevation) of the error.
const BUMP_STEPS: usize = 4;

/// A tabletop in the camera frame, ready to draw.
pub(super) struct Tabletop<'a> {
    /// Its pose.
    pub(super) camera_from_shape: Isometry3<f64>,
    /// Half its edges, m.
    pub(super) half: Vector3<f64>,
    /// Bumps of the upper face.
    pub(super) bumps: &'a [Bump],
    /// The dirt on it.
    pub(super) dirt: Option<&'a DirtTexture>,
    /// The shadow on it.
    pub(super) shadow: &'a Shadow,
}

/// The colours of the upper face.
struct Surface<'a> {
    half: [f32; 2],
    shades: &'a Shades,
    dirt: Option<Dirt<'a>>,
    shadow: &'a Shadow,
}

struct Dirt<'a> {
    texture: &'a DirtTexture,
    shades: Shades,
    cells_per_metre: [f32; 2],
}

/// Draws a tabletop.
pub(super) fn tabletop(canvas: &mut Canvas, table: &Tabletop<'_>, light: Light, shades: &Shades) {
    let (frame, half) = (&table.camera_from_shape, &table.half);
    for side in SIDES.into_iter().filter(|side| *side != (2, 1.0)) {
        if let Some(face) = Face::of_box(frame, half, side, 1.0) {
            let color = shades.at(face.brightness(light));
            face.draw_plain(canvas, color);
        }
    }
    let Some(face) = Face::of_box(frame, half, (2, 1.0), 1.0) else { return };
    let surface = Surface::new(table, shades);
    let local = Local::new(frame);
    let lit = face.brightness(light);
    for bump in table.bumps.iter().filter(|bump| bump.is_drawable()) {
        bump_patch(canvas, table, bump, &surface, light);
    }
    face.draw(canvas, |row, first| {
        let (local, surface) = (local.run(row, first), &surface);
        move |k, near| surface.colors(local.lanes([0, 1], k, near), &lanes(|_| lit))
    });
}

impl<'a> Surface<'a> {
    fn new(table: &Tabletop<'a>, shades: &'a Shades) -> Self {
        let half = [table.half.x as f32, table.half.y as f32];
        let dirt = table.dirt.filter(|dirt| dirt.columns > 0 && dirt.rows > 0).map(|texture| Dirt {
            texture,
            shades: Shades::new(texture.color),
            cells_per_metre: [
                texture.columns as f32 / (2.0 * half[0]),
                texture.rows as f32 / (2.0 * half[1]),
            ],
        });
        Self { half, shades, dirt, shadow: table.shadow }
    }

    /// The colours at some points of the upper face, m, under a brightness.
    #[inline(always)]
    fn colors(&self, [x, y]: [Lanes; 2], brightness: &Lanes) -> Colors {
        let grain =
            MOTTLING.lanes(&x.map(|x| x * GRAIN_SCALE[0] + 8192.0), &y.map(|y| y * GRAIN_SCALE[1] + 8192.0));
        let light = self.shadow.lanes(&x, &y);
        let bright = lanes(|i| brightness[i] * light[i] * (1.0 + GRAIN * grain[i]));
        let clean = self.shades.lanes(&bright);
        let Some(dirt) = &self.dirt else { return clean };
        let cell = |value: f32, half: f32, per_metre: f32| nearest((value + half) * per_metre - 0.5);
        let column = lanes(|i| cell(x[i], self.half[0], dirt.cells_per_metre[0]));
        let row = lanes(|i| cell(y[i], self.half[1], dirt.cells_per_metre[1]));
        let amount = lanes(|i| dirt.texture.cell(column[i] as usize, row[i] as usize));
        if amount.iter().all(|amount| *amount == 0) {
            return clean;
        }
        let dirty = dirt.shades.lanes(&bright);
        lanes(|i| if amount[i] == 0 { clean[i] } else { mix(clean[i], dirty[i], amount[i]) })
    }
}

impl Bump {
    fn is_drawable(&self) -> bool {
        self.height > 0.0
            && self.radius > 0.0
            && [self.at[0], self.at[1], self.height, self.radius].iter().all(|v| v.is_finite())
    }
}

/// Draws the area around one bump, with its height.
fn bump_patch(canvas: &mut Canvas, table: &Tabletop<'_>, bump: &Bump, surface: &Surface<'_>, light: Light) {
    let top = table.half.z;
    let corner = |x: f64, y: f64, z: f64| {
        let (x, y) = (bump.at[0] + x * bump.radius, bump.at[1] + y * bump.radius);
        table.camera_from_shape * Point3::new(x, y, top + z * bump.height)
    };
    let signs = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
    let corners: [_; 8] = std::array::from_fn(|i| corner(signs[i % 4][0], signs[i % 4][1], (i / 4) as f64));
    let Some(bounds) = canvas.hull(&corners) else { return };
    let local = Local::new(&table.camera_from_shape);
    let relief = Relief::new(table, light);
    for row in canvas.rows(bounds) {
        let Some(run) = bounds.columns().pixels() else { continue };
        let local = local.run(&row, run.0);
        let hit = |k: f32| relief.meet(&local, k);
        canvas.fill_lanes(
            row.v,
            run,
            |k| {
                let (t, height) = hit(k);
                if height > 0.0 { 1.0 / t } else { 0.0 }
            },
            |k, near| {
                let [x, y] = local.lanes([0, 1], k, near);
                surface.colors([x, y], &lanes(|i| relief.brightness(x[i], y[i])))
            },
        );
    }
}

/// The uneven face, in single precision.
struct Relief<'a> {
    bumps: &'a [Bump],
    half: [f32; 2],
    top: f32,
    /// Direction towards the light in the tabletop's frame.
    light: [f32; 3],
}

impl<'a> Relief<'a> {
    fn new(table: &Tabletop<'a>, light: Light) -> Self {
        let light = table.camera_from_shape.rotation.inverse() * light.toward;
        Self {
            bumps: table.bumps,
            half: [table.half.x as f32, table.half.y as f32],
            top: table.half.z as f32,
            light: [light.x as f32, light.y as f32, light.z as f32],
        }
    }

    fn height(&self, x: f32, y: f32) -> f32 {
        let (x, y) = (f64::from(x), f64::from(y));
        self.bumps.iter().filter(|bump| bump.is_drawable()).map(|bump| bump.height_at(x, y)).sum::<f64>()
            as f32
    }

    /// Depth and height (0 outside the face) where a ray meets the face, by fixed-point iteration.
    fn meet(&self, local: &LocalRun, k: f32) -> (f32, f32) {
        let mut t = local.depth_of_height(k, self.top);
        let mut height = 0.0;
        for _ in 0..BUMP_STEPS {
            height = self.height(local.at(0, k, t), local.at(1, k, t));
            t = local.depth_of_height(k, self.top + height);
        }
        let inside = local.at(0, k, t).abs() <= self.half[0] && local.at(1, k, t).abs() <= self.half[1];
        (t, if inside { height } else { 0.0 })
    }

    fn brightness(&self, x: f32, y: f32) -> f32 {
        let slope = self.bumps.iter().filter(|bump| bump.is_drawable()).fold([0.0_f32; 2], |sum, bump| {
            let slope = bump.slope_at(f64::from(x), f64::from(y));
            [sum[0] + slope[0] as f32, sum[1] + slope[1] as f32]
        });
        let [x, y, z] = self.light;
        brightness(
            (z - slope[0] * x - slope[1] * y) / (1.0 + slope[0] * slope[0] + slope[1] * slope[1]).sqrt(),
        )
    }
}

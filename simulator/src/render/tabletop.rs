//! The upper face of a table: grain, bumps, dirt and shadows.

use nalgebra::{Isometry3, Point3, Vector3};

use super::faces::{Face, Local, LocalRun, SIDES};
use super::raster::Canvas;
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
            face.draw(canvas, |_, _| move |_, _| color);
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
        let local = local.run(row, first);
        let surface = &surface;
        move |k, near| surface.color(local.at(0, k, 1.0 / near), local.at(1, k, 1.0 / near), lit)
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

    /// The colour at a point of the upper face, m, under a brightness.
    #[inline(always)]
    fn color(&self, x: f32, y: f32, brightness: f32) -> [u8; 3] {
        let grain = MOTTLING.at(x * GRAIN_SCALE[0] + 8192.0, y * GRAIN_SCALE[1] + 8192.0);
        let bright = brightness * self.shadow.light_at(x, y) * (1.0 + GRAIN * grain);
        let clean = self.shades.at(bright);
        let Some(dirt) = &self.dirt else { return clean };
        let column = ((x + self.half[0]) * dirt.cells_per_metre[0]) as usize;
        let row = ((y + self.half[1]) * dirt.cells_per_metre[1]) as usize;
        match dirt.texture.cell(column, row) {
            0 => clean,
            amount => mix(clean, dirt.shades.at(bright), amount),
        }
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
        canvas.fill(
            row.v,
            run,
            |k| {
                let (t, height) = hit(k);
                (if height > 0.0 { 1.0 / t } else { 0.0 }, 0.0)
            },
            |k, near, _| {
                let (x, y) = (local.at(0, k, 1.0 / near), local.at(1, k, 1.0 / near));
                surface.color(x, y, relief.brightness(x, y))
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

//! The upper face of a table: grain, bumps, dirt and shadows.

use nalgebra::{Isometry3, Point3, Vector3};

use super::faces::{Face, Local, LocalRun, SIDES};
use super::raster::{Canvas, Colors, Lanes, each};
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
pub(super) struct DrawnTabletop<'a> {
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
struct FaceColors<'a> {
    half: [f32; 2],
    shades: &'a Shades,
    dirt: Option<Dirt<'a>>,
    shadow: &'a Shadow,
}

struct Dirt<'a> {
    texture: &'a DirtTexture,
    shades: Shades,
    cells_per_metre: [f32; 2],
    /// Where something is dirty at all, m: both corners of a rectangle.
    dirty: [[f32; 2]; 2],
}

/// Draws a tabletop.
pub(super) fn tabletop(canvas: &mut Canvas, table: &DrawnTabletop<'_>, light: Light, shades: &Shades) {
    let (frame, half) = (&table.camera_from_shape, &table.half);
    for side in SIDES.into_iter().filter(|side| *side != (2, 1.0)) {
        if let Some(face) = Face::of_box(frame, half, side, 1.0) {
            let color = shades.at(face.brightness(light));
            face.draw_plain(canvas, color);
        }
    }
    let Some(face) = Face::of_box(frame, half, (2, 1.0), 1.0) else { return };
    let surface = FaceColors::new(table, shades);
    let local = Local::new(frame);
    let lit = face.brightness(light);
    for bump in table.bumps.iter().filter(|bump| bump.is_drawable()) {
        bump_patch(canvas, table, bump, &surface, light);
    }
    face.draw(canvas, |row, first| {
        let (local, surface) = (local.run(row, first), &surface);
        move |k, near| surface.colors(local.points([0, 1], k, near), Lanes::splat(lit))
    });
}

impl<'a> FaceColors<'a> {
    fn new(table: &DrawnTabletop<'a>, shades: &'a Shades) -> Self {
        let half = [table.half.x as f32, table.half.y as f32];
        let dirt = table.dirt.filter(|dirt| dirt.columns > 0 && dirt.rows > 0);
        let dirt = dirt.map(|texture| Dirt::new(texture, half));
        Self { half, shades, dirt, shadow: table.shadow }
    }

    /// The colours at some points of the upper face, m, under a brightness.
    #[inline(always)]
    fn colors(&self, [x, y]: [Lanes; 2], brightness: Lanes) -> Colors {
        let grain = MOTTLING.lanes(x * GRAIN_SCALE[0] + 8192.0, y * GRAIN_SCALE[1] + 8192.0);
        let bright = brightness * self.shadow.lanes(x, y) * (grain * GRAIN + 1.0);
        let clean = self.shades.lanes(bright);
        let Some(dirt) = self.dirt.as_ref().filter(|dirt| dirt.may_be_at(x, y)) else { return clean };
        let cell = |value: Lanes, axis: usize| {
            ((value + self.half[axis]) * dirt.cells_per_metre[axis] - 0.5).fast_round_int().to_array()
        };
        let (column, row) = (cell(x, 0), cell(y, 1));
        let amount = each(|i| u32::from(dirt.texture.cell(column[i] as usize, row[i] as usize)));
        if amount.iter().all(|amount| *amount == 0) {
            return clean;
        }
        let dirty = dirt.shades.lanes(bright);
        each(|i| mix(clean[i], dirty[i], amount[i]))
    }
}

impl<'a> Dirt<'a> {
    /// The dirt on a table with these half edges, m.
    fn new(texture: &'a DirtTexture, half: [f32; 2]) -> Self {
        let cells = [texture.columns, texture.rows];
        let cells_per_metre = std::array::from_fn(|axis| cells[axis] as f32 / (2.0 * half[axis]));
        let (mut low, mut high) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2]);
        for (row, amounts) in texture.cells.chunks_exact(texture.columns).enumerate() {
            let first = amounts.iter().position(|amount| *amount > 0);
            let last = amounts.iter().rposition(|amount| *amount > 0);
            let Some((first, last)) = first.zip(last) else { continue };
            low = [low[0].min(first as f32), low[1].min(row as f32)];
            high = [high[0].max(last as f32), high[1].max(row as f32)];
        }
        // A cell reaches from its number to the next, and rounding a little further.
        let at = |cell: f32, axis: usize| cell / cells_per_metre[axis] - half[axis];
        let dirty = [
            std::array::from_fn(|axis| at(low[axis] - 1.0, axis)),
            std::array::from_fn(|axis| at(high[axis] + 2.0, axis)),
        ];
        Self { texture, shades: Shades::new(texture.color), cells_per_metre, dirty }
    }

    /// Whether one of some points on a line may be dirty, m.
    #[inline(always)]
    fn may_be_at(&self, x: Lanes, y: Lanes) -> bool {
        let [low, high] = &self.dirty;
        !all_beyond(x, low[0], high[0]) && !all_beyond(y, low[1], high[1])
    }
}

/// Whether all values are below `low` or all above `high`; they come in order, rising or falling.
#[inline(always)]
fn all_beyond(values: Lanes, low: f32, high: f32) -> bool {
    let values = values.as_array();
    let (first, last) = (values[0], values[7]);
    first.max(last) < low || first.min(last) > high
}

impl Bump {
    fn is_drawable(&self) -> bool {
        self.height > 0.0
            && self.radius > 0.0
            && [self.at[0], self.at[1], self.height, self.radius].iter().all(|v| v.is_finite())
    }
}

/// Draws the area around one bump, with its height.
fn bump_patch(
    canvas: &mut Canvas,
    table: &DrawnTabletop<'_>,
    bump: &Bump,
    surface: &FaceColors<'_>,
    light: Light,
) {
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
        canvas.fill(
            row.v,
            run,
            |k| {
                let (t, height) = relief.meet(&local, k);
                (height.simd_gt(Lanes::ZERO) & (Lanes::ONE / t), Lanes::ZERO)
            },
            |k, near, _| {
                let at = local.points([0, 1], k, near);
                surface.colors(at, relief.brightness(at))
            },
        );
    }
}

/// The uneven face, in single precision.
struct Relief {
    bumps: Vec<FlatBump>,
    half: [f32; 2],
    top: f32,
    /// Direction towards the light in the tabletop's frame.
    light: [f32; 3],
}

impl Relief {
    fn new(table: &DrawnTabletop<'_>, light: Light) -> Self {
        let light = table.camera_from_shape.rotation.inverse() * light.toward;
        Self {
            bumps: table.bumps.iter().filter(|bump| bump.is_drawable()).map(FlatBump::new).collect(),
            half: [table.half.x as f32, table.half.y as f32],
            top: table.half.z as f32,
            light: [light.x as f32, light.y as f32, light.z as f32],
        }
    }

    fn height(&self, x: Lanes, y: Lanes) -> Lanes {
        self.bumps.iter().fold(Lanes::ZERO, |sum, bump| {
            let falloff = bump.falloff(x, y);
            sum + falloff * falloff * bump.height
        })
    }

    /// Depth and height (0 outside the face) where rays meet the face, by fixed-point iteration.
    #[inline(always)]
    fn meet(&self, local: &LocalRun, k: Lanes) -> (Lanes, Lanes) {
        let mut t = local.depth_of_height(k, Lanes::splat(self.top));
        let mut height = Lanes::ZERO;
        for _ in 0..BUMP_STEPS {
            height = self.height(local.at(0, k, t), local.at(1, k, t));
            t = local.depth_of_height(k, height + self.top);
        }
        let inside =
            local.at(0, k, t).abs().simd_le(self.half[0]) & local.at(1, k, t).abs().simd_le(self.half[1]);
        (t, inside & height)
    }

    fn brightness(&self, [x, y]: [Lanes; 2]) -> Lanes {
        let slope = self.bumps.iter().fold([Lanes::ZERO; 2], |sum, bump| {
            let k = bump.falloff(x, y) * bump.steepness;
            [sum[0] + k * (x - bump.at[0]), sum[1] + k * (y - bump.at[1])]
        });
        let length = (slope[0] * slope[0] + slope[1] * slope[1] + 1.0).sqrt();
        let [x, y, z] = self.light;
        brightness((Lanes::splat(z) - slope[0] * x - slope[1] * y) / length)
    }
}

/// A [`Bump`] in single precision.
struct FlatBump {
    at: [f32; 2],
    height: f32,
    inverse_squared_radius: f32,
    /// Its slope over falloff and distance, 1/m.
    steepness: f32,
}

impl FlatBump {
    fn new(bump: &Bump) -> Self {
        let inverse = 1.0 / (bump.radius * bump.radius);
        Self {
            at: bump.at.map(|at| at as f32),
            height: bump.height as f32,
            inverse_squared_radius: inverse as f32,
            steepness: (-4.0 * bump.height * inverse) as f32,
        }
    }

    /// As [`Bump`]'s.
    fn falloff(&self, x: Lanes, y: Lanes) -> Lanes {
        let (x, y) = (x - self.at[0], y - self.at[1]);
        (Lanes::ONE - (x * x + y * y) * self.inverse_squared_radius).fast_max(Lanes::ZERO)
    }
}

//! Soft shadows on tabletops: the outline of each shape, projected along the light and blurred with its height.
//!
//! A map of a few thousand cells per tabletop, computed once per scene for all cameras. Shadows on other shapes are
//! not drawn.

use nalgebra::{Isometry3, Point2, Point3, Vector3};

use super::raster::{Lanes, each};
use super::scene::{Shape, VisibleForm, VisibleScene};

/// Edge of a cell, m.
const CELL: f64 = 0.01;
/// Largest number of cells along a side; a larger table gets larger cells.
const MAX_CELLS: usize = 256;
/// The share of light that a shape blocks when it touches the table.
const DARKEST: f64 = 0.38;
/// Height over the table at which a shape blocks half of that, m.
const FADING: f64 = 0.25;
/// Half the width of the blurred border for a shape that touches the table, m, and its growth per metre of height.
const BLUR: [f64; 2] = [0.008, 0.25];
/// Shapes higher than this over the table cast no shadow, m.
const MAX_HEIGHT: f64 = 0.8;

/// How much of the light reaches each part of a tabletop.
pub(super) struct Shadow {
    columns: usize,
    rows: usize,
    /// Half the edges of the table, m.
    half: [f32; 2],
    cells_per_metre: [f32; 2],
    /// Light at the corners of the cells, 0 to 1.
    light: Vec<f32>,
    /// For each block of cells, row by row, whether some of it is in the shadow.
    dark: Vec<bool>,
}

/// Cells along each side of a block.
const BLOCK: usize = 8;

/// The outline of a shape on the table.
enum Outline {
    /// A thick line between two points.
    Stroke { from: Point2<f64>, to: Point2<f64>, radius: f64 },
    /// A convex polygon, counter-clockwise.
    Polygon(Vec<Point2<f64>>),
}

impl Shadow {
    /// The shadow of all other shapes on the tabletop at index `table`.
    pub(super) fn on(scene: &VisibleScene, table: usize) -> Self {
        let Some(shape) = scene.shapes.get(table) else { return Self::none(&Vector3::zeros()) };
        let VisibleForm::Tabletop { half, .. } = &shape.geometry else {
            return Self::none(&Vector3::zeros());
        };
        let mut shadow = Self::none(half);
        let table_from_scene = shape.scene_from_shape.inverse();
        let light = table_from_scene.rotation * scene.light;
        let light = light.try_normalize(1e-9).unwrap_or_else(Vector3::z);
        if light.z < 0.2 || shadow.light.is_empty() {
            return shadow;
        }
        let slant = Vector3::new(light.x, light.y, 0.0) / light.z;
        for (_, other) in scene.shapes.iter().enumerate().filter(|(i, _)| *i != table) {
            shadow.throw(other, &(table_from_scene * other.scene_from_shape), &slant, half.z);
        }
        shadow
    }

    fn none(half: &Vector3<f64>) -> Self {
        let cells = |half: f64| ((2.0 * half / CELL).ceil().max(1.0) as usize).min(MAX_CELLS);
        let (columns, rows) = (cells(half.x), cells(half.y));
        let usable = half.x > 0.0 && half.y > 0.0 && half.x.is_finite() && half.y.is_finite();
        let light = if usable { vec![1.0; (columns + 1) * (rows + 1)] } else { Vec::new() };
        let cells_per_metre = [columns as f32 / (2.0 * half.x) as f32, rows as f32 / (2.0 * half.y) as f32];
        let dark = vec![false; (columns / BLOCK + 1) * (rows / BLOCK + 1)];
        Self { columns, rows, half: [half.x as f32, half.y as f32], cells_per_metre, light, dark }
    }

    /// The light at some points of the table, 0 to 1, interpolated. They lie on a line, in order.
    #[inline(always)]
    pub(super) fn lanes(&self, x: Lanes, y: Lanes) -> Lanes {
        let axis = |value: Lanes, half: f32, per_metre: f32, cells: usize| {
            let at = ((value + half) * per_metre).fast_max(Lanes::ZERO);
            let last = Lanes::splat(cells as f32 - 1.0);
            let cell = (at - 0.5).fast_max(Lanes::ZERO).fast_min(last).fast_round_int();
            (cell.to_array(), at - cell.round_float())
        };
        let (column, s) = axis(x, self.half[0], self.cells_per_metre[0], self.columns);
        let (row, t) = axis(y, self.half[1], self.cells_per_metre[1], self.rows);
        if self.is_lit([column[0], column[7]], [row[0], row[7]]) {
            return Lanes::ONE;
        }
        let below = self.columns + 1;
        let corners = each(|i| {
            let first = row[i] as usize * below + column[i] as usize;
            let cell = self.light.get(first..).filter(|cell| cell.len() > below + 1);
            cell.map_or([1.0; 4], |cell| [cell[0], cell[1], cell[below], cell[below + 1]])
        });
        let [a, b, c, d] = std::array::from_fn(|corner| Lanes::new(each(|i| corners[i][corner])));
        let (upper, lower) = (a + (b - a) * s, c + (d - c) * s);
        upper + (lower - upper) * t
    }

    /// Whether all cells are lit that lie between two of them, each given by its column and its row.
    #[inline(always)]
    fn is_lit(&self, columns: [i32; 2], rows: [i32; 2]) -> bool {
        let [near, across] = [columns, rows].map(|[a, b]| (a - b).unsigned_abs() < BLOCK as u32);
        let dark = |column: i32, row: i32| {
            let block = row as usize / BLOCK * (self.columns / BLOCK + 1) + column as usize / BLOCK;
            self.dark.get(block).copied().unwrap_or(false)
        };
        near && across && !columns.iter().any(|column| rows.iter().any(|row| dark(*column, *row)))
    }

    /// Adds the shadow of one shape.
    fn throw(&mut self, shape: &Shape, table_from_shape: &Isometry3<f64>, slant: &Vector3<f64>, top: f64) {
        let Some((outline, height)) = outline(&shape.geometry, table_from_shape, slant, top) else { return };
        if !(0.0..MAX_HEIGHT).contains(&height) {
            return;
        }
        let blur = BLUR[0] + BLUR[1] * height;
        let depth = DARKEST / (1.0 + height / FADING);
        let Some([low, high]) = self.cells(&outline, blur) else { return };
        // The light of a cell is that of its four corners.
        let block = |corner: usize| corner / BLOCK;
        for row in block(low[1].saturating_sub(1))..=block(high[1]) {
            for column in block(low[0].saturating_sub(1))..=block(high[0]) {
                self.dark[row * (self.columns / BLOCK + 1) + column] = true;
            }
        }
        for j in low[1]..=high[1] {
            for i in low[0]..=high[0] {
                let x = i as f64 / f64::from(self.cells_per_metre[0]) - f64::from(self.half[0]);
                let y = j as f64 / f64::from(self.cells_per_metre[1]) - f64::from(self.half[1]);
                let inside = (0.5 - outline.distance(&Point2::new(x, y)) / (2.0 * blur)).clamp(0.0, 1.0);
                let light = 1.0 - depth * inside * inside * (3.0 - 2.0 * inside);
                let cell = &mut self.light[j * (self.columns + 1) + i];
                *cell = cell.min(light as f32);
            }
        }
    }

    /// First and last corner of the cells that an outline covers.
    fn cells(&self, outline: &Outline, margin: f64) -> Option<[[usize; 2]; 2]> {
        let [low, high] = outline.bounds();
        let index = |value: f64, axis: usize, size: usize, round: fn(f64) -> f64| {
            let cell = round((value + f64::from(self.half[axis])) * f64::from(self.cells_per_metre[axis]));
            (cell.is_finite()).then_some(cell.clamp(-1.0, size as f64 + 1.0))
        };
        let mut range = [[0; 2]; 2];
        for (axis, size) in [self.columns, self.rows].into_iter().enumerate() {
            let first = index(low[axis] - margin, axis, size, f64::floor)?;
            let last = index(high[axis] + margin, axis, size, f64::ceil)?;
            if first > size as f64 || last < 0.0 {
                return None;
            }
            (range[0][axis], range[1][axis]) = (first.max(0.0) as usize, (last as usize).min(size));
        }
        Some(range)
    }
}

/// The outline of a shape's shadow on the plane z = `top`, and the height of the shape's lowest point over it.
fn outline(
    geometry: &VisibleForm,
    table_from_shape: &Isometry3<f64>,
    slant: &Vector3<f64>,
    top: f64,
) -> Option<(Outline, f64)> {
    let cast = |p: &Point3<f64>| (p - slant * (p.z - top)).xy();
    let stroke = |half: f64, radius: f64| {
        let ends = [-half, half].map(|z| table_from_shape * Point3::new(0.0, 0.0, z));
        let height = (ends[0].z.min(ends[1].z) - radius - top).max(0.0);
        (ends[0].z.max(ends[1].z) > top)
            .then(|| (Outline::Stroke { from: cast(&ends[0]), to: cast(&ends[1]), radius }, height))
    };
    match geometry {
        VisibleForm::Sphere { radius } => stroke(0.0, *radius),
        VisibleForm::Cylinder { radius, half_length } | VisibleForm::Capsule { radius, half_length } => {
            stroke(*half_length, *radius)
        }
        VisibleForm::Box { .. } | VisibleForm::Mesh { .. } => {
            // A mesh casts the shadow of the box around it.
            let corners = geometry.corners().map(|corner| table_from_shape * corner);
            let heights = corners.iter().map(|c| c.z - top);
            let (low, high) =
                heights.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), z| (l.min(z), h.max(z)));
            let raised = |c: &Point3<f64>| cast(&Point3::new(c.x, c.y, c.z.max(top)));
            (high > 0.0)
                .then(|| (Outline::Polygon(convex_hull(corners.iter().map(raised).collect())), low.max(0.0)))
        }
        VisibleForm::Tabletop { .. } => None,
    }
}

impl Outline {
    /// Signed distance to the border, m; negative inside.
    fn distance(&self, p: &Point2<f64>) -> f64 {
        match self {
            Self::Stroke { from, to, radius } => {
                let (along, offset) = (to - from, p - from);
                let t = (offset.dot(&along) / along.norm_squared().max(1e-12)).clamp(0.0, 1.0);
                (offset - along * t).norm() - radius
            }
            Self::Polygon(corners) => (0..corners.len()).fold(f64::NEG_INFINITY, |most, i| {
                let (a, b) = (corners[i], corners[(i + 1) % corners.len()]);
                let edge = b - a;
                let outward = nalgebra::Vector2::new(edge.y, -edge.x) / edge.norm().max(1e-12);
                most.max(outward.dot(&(p - a)))
            }),
        }
    }

    /// Lower and upper corner of its bounding rectangle.
    fn bounds(&self) -> [Point2<f64>; 2] {
        let (points, margin): (&[Point2<f64>], f64) = match self {
            Self::Stroke { from, to, radius } => (&[*from, *to], *radius),
            Self::Polygon(corners) => (corners, 0.0),
        };
        let start =
            [Point2::new(f64::INFINITY, f64::INFINITY), Point2::new(f64::NEG_INFINITY, f64::NEG_INFINITY)];
        let [low, high] = points.iter().fold(start, |[low, high], p| [low.inf(p), high.sup(p)]);
        let margin = nalgebra::Vector2::repeat(margin);
        [low - margin, high + margin]
    }
}

/// The convex hull, counter-clockwise (Andrew's monotone chain).
fn convex_hull(mut points: Vec<Point2<f64>>) -> Vec<Point2<f64>> {
    points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    let chain = |points: &mut dyn Iterator<Item = &Point2<f64>>| {
        let mut chain: Vec<Point2<f64>> = Vec::new();
        for p in points {
            while let [.., a, b] = chain[..] {
                if (b - a).perp(&(p - a)) > 0.0 {
                    break;
                }
                chain.pop();
            }
            chain.push(*p);
        }
        chain.pop();
        chain
    };
    let mut hull = chain(&mut points.iter());
    hull.extend(chain(&mut points.iter().rev()));
    hull
}

//! Plane faces: cuboids and triangles seen from outside, and the room seen from inside.

use armarium_robot::Mesh;
use nalgebra::{Isometry3, Point3, Vector3};

use super::raster::{Bounds, Canvas, Color, Colors, ColumnRange, Lanes, LinearForm, PixelLine, ScanLine};
use super::scene::Background;
use super::shading::{Light, MOTTLING, Shades};

/// A face is not drawn if the camera's distance from its plane is less than this, m.
const EDGE_ON: f64 = 1e-9;
/// Relative change of brightness of floor and walls by mottling.
const ROOM_MOTTLING: f32 = 0.12;
/// Edge of a floor tile, m.
const TILE: f32 = 0.5;
/// Half the width of the joint between tiles, as a share of a tile's edge.
const JOINT: f32 = 0.012;

/// A convex face with `N` corners in the camera frame.
pub(super) struct Face<const N: usize> {
    corners: [Point3<f64>; N],
    /// Vector that gives 1/depth: its dot product with a ray.
    nearness: Vector3<f64>,
    /// Unit normal towards the viewer's side.
    normal: Vector3<f64>,
}

/// The camera in a shape's frame; it converts depths to the shape's coordinates.
pub(super) struct Local {
    eye: Vector3<f64>,
    axes: [Vector3<f64>; 3],
}

/// [`Local`] along one run of pixels.
#[derive(Clone, Copy)]
pub(super) struct LocalRun {
    eye: [f32; 3],
    along: [PixelLine; 3],
}

impl Local {
    /// The camera in a shape's frame.
    pub(super) fn new(camera_from_shape: &Isometry3<f64>) -> Self {
        let eye = -(camera_from_shape.rotation.inverse() * camera_from_shape.translation.vector);
        let axes = [Vector3::x(), Vector3::y(), Vector3::z()].map(|axis| camera_from_shape.rotation * axis);
        Self { eye, axes }
    }

    /// The same for a run of pixels from `first` on.
    pub(super) fn run(&self, row: &ScanLine, first: usize) -> LocalRun {
        let along = self.axes.map(|axis| row.form(&axis).line(first));
        LocalRun { eye: [self.eye.x as f32, self.eye.y as f32, self.eye.z as f32], along }
    }
}

impl LocalRun {
    /// Coordinate `axis` (0 to 2) of the points at depths `t`, `k` pixels after the first.
    #[inline(always)]
    pub(super) fn at(&self, axis: usize, k: Lanes, t: Lanes) -> Lanes {
        t * self.along[axis].at(k) + self.eye[axis]
    }

    /// Two coordinates of the points `k` pixels after the first, from their inverse depths.
    #[inline(always)]
    pub(super) fn points(&self, axes: [usize; 2], k: Lanes, near: Lanes) -> [Lanes; 2] {
        let depth = Lanes::ONE / near;
        axes.map(|axis| self.at(axis, k, depth))
    }

    /// The depths at which the rays have coordinate 2 equal to `z`.
    #[inline(always)]
    pub(super) fn depth_of_height(&self, k: Lanes, z: Lanes) -> Lanes {
        (z - self.eye[2]) / self.along[2].at(k)
    }
}

impl Face<4> {
    /// The face of a cuboid on the side `sign` of `axis` (0 to 2). `seen_from` is 1 from outside, -1 from inside;
    /// `None` when the camera is on the other side.
    pub(super) fn of_box(
        camera_from_box: &Isometry3<f64>,
        half: &Vector3<f64>,
        (axis, sign): (usize, f64),
        seen_from: f64,
    ) -> Option<Self> {
        let (second, third) = ((axis + 1) % 3, (axis + 2) % 3);
        let corners = [[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]].map(|[a, b]| {
            let mut corner = Point3::origin();
            (corner[axis], corner[second], corner[third]) =
                (sign * half[axis], a * half[second], b * half[third]);
            camera_from_box * corner
        });
        let mut normal = Vector3::zeros();
        normal[axis] = sign * seen_from;
        let normal = camera_from_box.rotation * normal;
        let distance = normal.dot(&corners[0].coords);
        (distance < -EDGE_ON).then(|| Self { corners, nearness: normal / distance, normal })
    }
}

impl Face<3> {
    /// A triangle, seen from either side; `None` when the camera is in its plane.
    fn of_triangle(corners: [Point3<f64>; 3]) -> Option<Self> {
        let normal = (corners[1] - corners[0]).cross(&(corners[2] - corners[0]));
        let length = (normal.x * normal.x + normal.y * normal.y + normal.z * normal.z).sqrt();
        if length <= 1e-15 {
            return None;
        }
        let normal = normal / length;
        let distance = normal.dot(&corners[0].coords);
        let (normal, distance) = if distance > 0.0 { (-normal, -distance) } else { (normal, distance) };
        (distance < -EDGE_ON).then(|| Self { corners, nearness: normal / distance, normal })
    }
}

impl<const N: usize> Face<N> {
    /// Brightness of the face.
    pub(super) fn brightness(&self, light: Light) -> f32 {
        light.on(&self.normal)
    }

    /// 1/depth along a row.
    pub(super) fn nearness(&self, row: &ScanLine) -> LinearForm {
        row.form(&self.nearness)
    }

    /// The rectangle of pixels in which it can appear.
    pub(super) fn bounds(&self, canvas: &Canvas) -> Option<Bounds> {
        canvas.hull(&self.corners)
    }

    /// The half-spaces through the camera and each edge; the face lies in their intersection.
    pub(super) fn edges(&self) -> [Vector3<f64>; N] {
        let middle = self.corners.iter().fold(Vector3::zeros(), |sum, c| sum + c.coords);
        std::array::from_fn(|i| {
            let edge = self.corners[i].coords.cross(&self.corners[(i + 1) % N].coords);
            if edge.dot(&middle) < 0.0 { -edge } else { edge }
        })
    }

    /// Draws the face in one colour.
    pub(super) fn draw_plain(&self, canvas: &mut Canvas, color: Color) {
        self.draw(canvas, |_, _| move |_, _| [color; _]);
    }

    /// Draws the face. `paint` makes the colouring function for a row's run of pixels, chunk by chunk, from the row and the
    /// first column.
    pub(super) fn draw<P: Fn(Lanes, Lanes) -> Colors>(
        &self,
        canvas: &mut Canvas,
        paint: impl Fn(&ScanLine, usize) -> P,
    ) {
        if let Some(bounds) = self.bounds(canvas) {
            self.draw_within(canvas, bounds, paint);
        }
    }

    /// Draws the part of the face within a rectangle.
    fn draw_within<P: Fn(Lanes, Lanes) -> Colors>(
        &self,
        canvas: &mut Canvas,
        bounds: Bounds,
        paint: impl Fn(&ScanLine, usize) -> P,
    ) {
        let edges = self.edges();
        for row in canvas.rows(bounds) {
            let span =
                edges.iter().fold(bounds.columns(), |span: ColumnRange, edge| span.keep(row.form(edge)));
            let Some(run) = span.pixels() else { continue };
            let near = self.nearness(&row).line(run.0);
            let paint = paint(&row, run.0);
            canvas.fill(row.v, run, |k| (near.at(k), Lanes::ZERO), |k, near, _| paint(k, near));
        }
    }
}

/// The six sides of a cuboid.
pub(super) const SIDES: [(usize, f64); 6] = [(0, -1.0), (0, 1.0), (1, -1.0), (1, 1.0), (2, -1.0), (2, 1.0)];

/// Draws a cuboid.
pub(super) fn cuboid(
    canvas: &mut Canvas,
    camera_from_box: &Isometry3<f64>,
    half: &Vector3<f64>,
    light: Light,
    shades: &Shades,
) {
    for side in SIDES {
        if let Some(face) = Face::of_box(camera_from_box, half, side, 1.0) {
            let color = shades.at(face.brightness(light));
            face.draw_plain(canvas, color);
        }
    }
}

/// Draws a surface of triangles.
pub(super) fn mesh(
    canvas: &mut Canvas,
    camera_from_mesh: &Isometry3<f64>,
    mesh: &Mesh,
    light: Light,
    shades: &Shades,
) {
    let turn = camera_from_mesh.rotation.to_rotation_matrix();
    let shift = camera_from_mesh.translation;
    let vertices: Vec<Point3<f64>> = mesh.vertices().iter().map(|v| shift * (turn * v)).collect();
    let pixels: Vec<[f64; 3]> = vertices.iter().map(|vertex| canvas.project(vertex)).collect();
    for triangle in mesh.triangles() {
        let corners = triangle.map(|index| pixels[index as usize]);
        let too_near = corners.iter().any(|[_, _, nearness]| nearness.is_nan());
        let bounds = match too_near {
            false => canvas.between(corners.map(|[u, v, _]| [u, v])),
            true => canvas.hull(&triangle.map(|index| vertices[index as usize])),
        };
        // Most triangles of a fine mesh lie between the centres of pixels.
        let Some(bounds) = bounds else { continue };
        let face = || Face::of_triangle(triangle.map(|index| vertices[index as usize]));
        if bounds.is_narrow() && !too_near {
            dots(canvas, bounds, corners, || face().map(|face| shades.at(face.brightness(light))));
        } else if let Some(face) = face() {
            let color = shades.at(face.brightness(light));
            face.draw_within(canvas, bounds, |_, _| move |_, _| [color; _]);
        }
    }
}

/// Draws a triangle within a narrow rectangle, pixel by pixel: its corners as column, row and 1/depth, which is linear between
/// them. Its colour is looked for where it is to be seen.
fn dots(canvas: &mut Canvas, bounds: Bounds, [a, b, c]: [[f64; 3]; 3], color: impl Fn() -> Option<Color>) {
    let (ab, ac) = ([b[0] - a[0], b[1] - a[1], b[2] - a[2]], [c[0] - a[0], c[1] - a[1], c[2] - a[2]]);
    let per_area = 1.0 / (ab[0] * ac[1] - ab[1] * ac[0]);
    let mut found = None;
    for (v, below_a) in bounds.each_row(a[1]) {
        for (u, beside_a) in bounds.each_column(a[0]) {
            // The shares of b and c; neither is a number where the triangle is a line.
            let of_b = (beside_a * ac[1] - below_a * ac[0]) * per_area;
            let of_c = (ab[0] * below_a - ab[1] * beside_a) * per_area;
            if of_b >= 0.0 && of_c >= 0.0 && of_b + of_c <= 1.0 {
                let near = (a[2] + of_b * ab[2] + of_c * ac[2]) as f32;
                if canvas.is_nearer(v, u, near) {
                    let Some(color) = found.or_else(&color) else { return };
                    found = Some(color);
                    canvas.dot(v, u, near, color);
                }
            }
        }
    }
}

/// Draws the room from inside.
pub(super) fn room(canvas: &mut Canvas, camera_from_scene: &Isometry3<f64>, background: &Background) {
    let half = (background.upper - background.lower) / 2.0;
    let middle = (background.upper + background.lower) / 2.0;
    let camera_from_room = camera_from_scene * nalgebra::Translation3::from(middle);
    let (floor, wall) = (Shades::new(background.floor), Shades::new(background.wall));
    let local = Local::new(&camera_from_room);
    for side in SIDES {
        let Some(face) = Face::of_box(&camera_from_room, &half, side, -1.0) else { continue };
        let across = [(side.0 + 1) % 3, (side.0 + 2) % 3];
        if side == (2, -1.0) {
            face.draw(canvas, |row, first| {
                let (local, floor) = (local.run(row, first), &floor);
                move |k, near| floor_tiles(floor, local.points([0, 1], k, near))
            });
        } else {
            // Walls differ slightly in brightness, so that the room's edges are visible.
            let base = 0.9 + 0.04 * side.0 as f32 + 0.02 * side.1 as f32;
            face.draw(canvas, |row, first| {
                let (local, wall) = (local.run(row, first), &wall);
                move |k, near| {
                    let [x, y] = local.points(across, k, near);
                    wall.lanes(
                        MOTTLING.lanes(x * 60.0 + 8192.0, y * 60.0 + 8192.0) * (0.5 * ROOM_MOTTLING) + base,
                    )
                }
            });
        }
    }
}

/// The floor's colours at some points, m.
#[inline(always)]
fn floor_tiles(floor: &Shades, [x, y]: [Lanes; 2]) -> Colors {
    let mottle = MOTTLING.lanes(x * 100.0 + 8192.0, y * 100.0 + 8192.0) * ROOM_MOTTLING + 0.92;
    let beside = |v: Lanes| {
        let tiles = v * (1.0 / TILE) + 1024.0;
        (tiles - tiles.fast_round_int().round_float()).abs()
    };
    let joint = beside(x).fast_min(beside(y)).simd_lt(JOINT);
    floor.lanes(mottle - (joint & Lanes::splat(0.15)))
}

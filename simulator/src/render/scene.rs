//! What can be drawn: shapes, the room around them, and the camera's pose.
//!
//! Plain data without behaviour, so that the physics can build a scene for each frame. Scene frame: z up, floor at
//! z = 0. All lengths in m.

use std::sync::Arc;

use armarium_robot::Mesh;
use armarium_visionx::{DepthImage, PinholeCamera, RgbImage};
use nalgebra::{Isometry3, Point3, Vector3};

/// One solid of one colour.
#[derive(Clone, Debug, PartialEq)]
pub struct Shape {
    /// Its form, centred on the shape's own frame.
    pub geometry: VisibleForm,
    /// Its pose.
    pub scene_from_shape: Isometry3<f64>,
    /// Its colour in full light, RGB.
    pub color: [u8; 3],
}

impl Shape {
    pub(crate) fn new(geometry: VisibleForm, scene_from_shape: Isometry3<f64>, color: [u8; 3]) -> Self {
        Self { geometry, scene_from_shape, color }
    }
}

/// The forms. Sizes that are not positive and finite draw nothing.
#[derive(Clone, Debug, PartialEq)]
pub enum VisibleForm {
    /// A cuboid.
    Box {
        /// Half its edges, m.
        half: Vector3<f64>,
    },
    /// A ball.
    Sphere {
        /// Its radius, m.
        radius: f64,
    },
    /// A flat-ended cylinder along z.
    Cylinder {
        /// Its radius, m.
        radius: f64,
        /// Half its length, m.
        half_length: f64,
    },
    /// A round-ended cylinder along z.
    Capsule {
        /// Its radius, m.
        radius: f64,
        /// Half the distance of the centres of its ends, m.
        half_length: f64,
    },
    /// A surface of triangles, seen from both sides.
    Mesh {
        /// The triangles.
        mesh: Arc<Mesh>,
    },
    /// A cuboid whose upper face (z = `half.z`) is grained, uneven and dirty, and takes shadows.
    Tabletop {
        /// Half its edges, m.
        half: Vector3<f64>,
        /// Bumps of the upper face.
        bumps: Arc<[Bump]>,
        /// The dirt on it, if any.
        dirt: Option<Arc<DirtTexture>>,
    },
}

/// A smooth round bump of a tabletop: `height (1 - r^2/radius^2)^2` within `radius`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bump {
    /// Its middle in the tabletop's frame, m.
    pub at: [f64; 2],
    /// Its height, m.
    pub height: f64,
    /// Its radius, m.
    pub radius: f64,
}

/// Dirt on a tabletop: a grid over the whole upper face.
#[derive(Clone, Debug, PartialEq)]
pub struct DirtTexture {
    /// Cells along x.
    pub columns: usize,
    /// Cells along y.
    pub rows: usize,
    /// Dirt of each cell, 0 (clean) to 255; x fastest, from the corner (-half.x, -half.y). Missing cells are clean.
    pub cells: Vec<u8>,
    /// The colour of dirt, RGB.
    pub color: [u8; 3],
}

/// The room around everything, seen from inside; its floor is tiled and its walls are mildly mottled.
#[derive(Clone, Debug, PartialEq)]
pub struct Background {
    /// The room's lower corner in the scene, m; its z is the floor.
    pub lower: Vector3<f64>,
    /// The room's upper corner in the scene, m.
    pub upper: Vector3<f64>,
    /// Colour of the floor, RGB.
    pub floor: [u8; 3],
    /// Colour of walls and ceiling, RGB; also of everything outside of the room.
    pub wall: [u8; 3],
}

/// How a thing moves while the shutter is open, in the scene: by the same in each part of the exposure.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ExposureMotion {
    /// Of its frame's origin, m.
    pub shift: Vector3<f64>,
    /// Rotation vector, rad.
    pub turn: Vector3<f64>,
}

/// Everything that is visible, where it is in the middle of the exposure.
#[derive(Clone, Debug, PartialEq)]
pub struct VisibleScene {
    /// The solids, in any order.
    pub shapes: Vec<Shape>,
    /// How each of them moves; those for which there is none stand still.
    pub motions: Vec<ExposureMotion>,
    /// The room.
    pub background: Background,
    /// The direction towards the light, of any length; zero means light from all directions.
    pub light: Vector3<f64>,
}

/// A camera and its pose. Camera frame: z along the optical axis, x right, y down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Viewpoint {
    /// The camera's pose in the middle of the exposure.
    pub scene_from_camera: Isometry3<f64>,
    /// How it moves.
    pub motion: ExposureMotion,
    /// Its intrinsics; pixel centres are at whole coordinates.
    pub camera: PinholeCamera,
}

/// The pictures of a camera.
#[derive(Clone, Debug, PartialEq)]
pub struct Rendering {
    /// The colours, without sensor noise.
    pub image: RgbImage,
    /// Distance along the optical axis, m; 0 where nothing is visible.
    pub depth: DepthImage,
}

impl VisibleForm {
    /// The corners of a box around it.
    pub(super) fn corners(&self) -> [Point3<f64>; 8] {
        let (middle, half) = match self {
            Self::Box { half } => (Point3::origin(), *half),
            Self::Tabletop { half, bumps, .. } => {
                let highest = bumps.iter().map(|bump| bump.height.max(0.0)).sum::<f64>();
                (Point3::origin(), half + Vector3::z() * highest)
            }
            Self::Sphere { radius } => (Point3::origin(), Vector3::repeat(*radius)),
            Self::Cylinder { radius, half_length } => {
                (Point3::origin(), Vector3::new(*radius, *radius, *half_length))
            }
            Self::Capsule { radius, half_length } => {
                (Point3::origin(), Vector3::new(*radius, *radius, half_length + radius))
            }
            Self::Mesh { mesh } => mesh.surrounding_box(),
        };
        std::array::from_fn(|i| {
            let sign = |bit: usize| if i >> bit & 1 == 0 { -1.0 } else { 1.0 };
            middle + Vector3::new(half.x * sign(0), half.y * sign(1), half.z * sign(2))
        })
    }
}

impl Bump {
    /// The height of the bump at a point of the tabletop's frame, m.
    pub fn height_at(&self, x: f64, y: f64) -> f64 {
        self.height * self.falloff(x, y).powi(2)
    }

    /// The slope of the bump along x and y at a point of the tabletop's frame.
    pub fn slope_at(&self, x: f64, y: f64) -> [f64; 2] {
        let k = -4.0 * self.height * self.falloff(x, y) / (self.radius * self.radius);
        if k.is_finite() { [k * (x - self.at[0]), k * (y - self.at[1])] } else { [0.0; 2] }
    }

    fn falloff(&self, x: f64, y: f64) -> f64 {
        let squared = (x - self.at[0]).powi(2) + (y - self.at[1]).powi(2);
        (1.0 - squared / (self.radius * self.radius)).max(0.0)
    }
}

impl DirtTexture {
    /// A grid without dirt.
    pub fn clean(columns: usize, rows: usize, color: [u8; 3]) -> Self {
        Self { columns, rows, cells: vec![0; columns.saturating_mul(rows)], color }
    }

    /// The amount of dirt in a cell; 0 outside the grid.
    pub fn cell(&self, column: usize, row: usize) -> u8 {
        if column >= self.columns || row >= self.rows {
            return 0;
        }
        self.cells.get(row * self.columns + column).copied().unwrap_or(0)
    }
}

impl Default for Background {
    /// A room of 6 by 6 by 3 m around the origin, grey-green floor, pale walls.
    fn default() -> Self {
        Self {
            lower: Vector3::new(-3.0, -3.0, 0.0),
            upper: Vector3::new(3.0, 3.0, 3.0),
            floor: [128, 134, 128],
            wall: [208, 210, 204],
        }
    }
}

impl VisibleScene {
    /// Shapes in the default room, lit from above, behind and to the left.
    pub fn new(shapes: Vec<Shape>) -> Self {
        let light = Vector3::new(-0.35, -0.3, 0.9);
        Self { shapes, motions: Vec::new(), background: Background::default(), light }
    }
}

impl Viewpoint {
    /// A camera at `eye` whose axis goes through `target` and whose x is horizontal in the scene. If it looks
    /// straight up or down, its x is the scene's x.
    pub fn look_at(camera: PinholeCamera, eye: Vector3<f64>, target: Vector3<f64>) -> Self {
        let z = (target - eye).try_normalize(1e-9).unwrap_or_else(Vector3::y);
        let x = z.cross(&Vector3::z()).try_normalize(1e-6).unwrap_or_else(Vector3::x);
        let axes = nalgebra::Rotation3::from_basis_unchecked(&[x, z.cross(&x), z]);
        let scene_from_camera = Isometry3::from_parts(eye.into(), axes.into());
        Self { scene_from_camera, motion: ExposureMotion::default(), camera }
    }

    /// The same camera `baseline` m to the right, parallel: the other eye of a stereo pair.
    pub fn shifted_right(&self, baseline: f64) -> Self {
        let shift = nalgebra::Translation3::new(baseline, 0.0, 0.0);
        let scene_from_camera = self.scene_from_camera * shift;
        let lever = self.scene_from_camera.rotation * shift.vector;
        let motion =
            ExposureMotion { shift: self.motion.shift + self.motion.turn.cross(&lever), ..self.motion };
        Self { scene_from_camera, motion, camera: self.camera }
    }
}

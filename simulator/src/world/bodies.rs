//! What a world file says of bodies: boxes, cylinders, balls, meshes, bars with handles, trays and cups; free, fixed, on a
//! hinge or on a slide.
//!
//! A body is a set of simple parts in its own frame, whose origin is its middle and whose z points up. The same parts are drawn
//! and touch. The `objects` of a world are bodies too: soft boxes on the table. This module does not simulate anything.

use std::f64::consts::{FRAC_PI_2, TAU};
use std::path::Path;

use armarium_robot::description::mesh_file;
use armarium_robot::{Geometry, Visual};
use armarium_source::yaml::{Node, Yaml};
use armarium_source::{Field, Findings, Rule, choice, code, form};
use nalgebra::{Isometry3, Rotation2, UnitQuaternion, Vector2, Vector3};
use serde::Serialize;
use serde_json::{Value as Json, json};

use super::{COLOR, GRAVITY, ObjectSpec, World, within};

/// Most parts of a body's handles.
const MAX_HANDLES: usize = 16;
/// Most balls in one cup or tray.
const MAX_BALLS: f64 = 100.0;
/// Number of flat pieces that make a cup's wall.
const STAVES: u32 = 12;
/// Corners of the outline of what is round.
const ROUND: u32 = 64;
/// How far below a handle's top a hand grips it from above, m.
const BELOW_TOP: f64 = 0.03;
/// Diameter and height of a handle, m.
const HANDLE: [f64; 2] = [0.03, 0.12];

form! {
    /// A thing in the scene.
    pub struct BodySpec: "a body", check Self::fits {
        /// Its name.
        pub name: String, Rule::NAME;
        /// Its form.
        pub shape: BodyShape = BodyShape::Box;
        /// Width (x), depth (y) and height (z) of a box, a bar or a tray, m.
        pub size: [f64; 3] = [0.10, 0.10, 0.10], Rule::number("m", 0.005, 3.0);
        /// Diameter of a cylinder, a sphere or a cup, m.
        pub diameter: f64 = 0.07, Rule::number("m", 0.005, 2.0);
        /// Height of a cylinder or a cup, m.
        pub height: f64 = 0.10, Rule::number("m", 0.005, 2.0);
        /// Thickness of the bottom and the rim of a tray, and of a cup's wall, m.
        pub wall: f64 = 0.005, Rule::number("m", 0.001, 0.05);
        /// The file of a mesh (STL, OBJ, DAE), beside this one; it touches as its convex hull.
        #[serde(skip_serializing_if = "Option::is_none")]
        pub mesh: Option<String> = None, Rule { most: 1000, ..Rule::NAME };
        /// Places of upright handles in the body's frame, m; each is a cylinder, 3 cm thick and 12 cm high. Hands grip them softly,
        /// several at once, and nothing else is held by friction on them.
        pub handles: Vec<[f64; 3]> = Vec::new(), Rule { most: MAX_HANDLES, ..within(2.0) };
        /// Loose balls that lie in a cup or a tray.
        #[serde(skip_serializing_if = "Option::is_none")]
        pub contents: Option<ContentsSpec> = None;
        /// Mass, kg.
        pub mass: f64 = 0.5, Rule::number("kg", 0.01, 100.0);
        /// Coulomb friction; of two bodies that touch, the mean counts.
        pub friction: f64 = 0.5, Rule::number("", 0.0, 2.0);
        /// Stiffness of a box's whole underside against the table, N/m; a body without it is rigid.
        #[serde(skip_serializing_if = "Option::is_none")]
        pub soft: Option<f64> = None, Rule::number("N/m", 800.0, 10_000.0);
        /// Whether it can move: freely, or not at all.
        pub motion: BodyMotion = BodyMotion::Free;
        /// The axis about which it turns, as a door does.
        #[serde(skip_serializing_if = "Option::is_none")]
        pub hinge: Option<HingeSpec> = None;
        /// The axis along which it slides, as a drawer does.
        #[serde(skip_serializing_if = "Option::is_none")]
        pub slide: Option<SlideSpec> = None;
        /// Where it is: `[x, y]` lies on the table, or on the floor beside it; `[x, y, z]` is its middle, m.
        pub at: Place = Place::On([0.25, 0.60]);
        /// Rotation about the vertical, degrees.
        pub yaw_deg: f64 = 0.0, Rule::degrees(361.0, "yaw");
        /// The body on which it stands, a tray's bottom or another's top; `at: [x, y]` and `yaw_deg` are in that body's frame then.
        #[serde(skip_serializing_if = "Option::is_none")]
        pub on: Option<String> = None, Rule::NAME;
        /// The body that it touches: it stands beside that one, on the same surface. `at: [x, y]` is the direction from that one's middle
        /// to its own, and that and `yaw_deg` are in that body's frame then.
        #[serde(skip_serializing_if = "Option::is_none")]
        pub beside: Option<String> = None, Rule::NAME;
        /// Colour, RGB.
        pub color: [u8; 3] = [120, 140, 170], COLOR;
        /// Into how many stripes a box (along x) or a cylinder (along z) is divided, of its two colours in turn.
        pub stripes: u32 = 1, Rule::number("", 1.0, 20.0);
        /// Colour of every second stripe, RGB.
        pub stripe_color: [u8; 3] = [235, 235, 225], COLOR;
        /// Colour of its handles, RGB; without it, that of the rest.
        #[serde(skip_serializing_if = "Option::is_none")]
        pub handle_color: Option<[u8; 3]> = None, COLOR;
    }
}

form! {
    /// Loose balls in a cup or a tray.
    pub struct ContentsSpec: "`contents`" {
        /// How many.
        pub balls: u32 = 1, Rule::number("", 1.0, MAX_BALLS);
        /// Diameter of each, m.
        pub diameter: f64 = 0.02, Rule::number("m", 0.005, 0.2);
        /// Mass of each, kg.
        pub mass: f64 = 0.02, Rule::number("kg", 0.001, 5.0);
        /// Their colour, RGB.
        pub color: [u8; 3] = [200, 60, 40], COLOR;
    }
}

form! {
    /// A hinge.
    pub struct HingeSpec: "a hinge" {
        /// Its axis in the body's frame; it goes through `through`.
        pub axis: [f64; 3] = [0.0, 0.0, 1.0], within(1.0);
        /// A point of the axis in the body's frame, m.
        pub through: [f64; 3] = [0.0; 3], within(2.0);
        /// Least and largest angle, degrees, from where it is at the start.
        pub limits_deg: [f64; 2] = [-180.0, 180.0], Rule::degrees(180.0, "limits");
        /// Damping, N m s/rad.
        pub damping: f64 = 0.1, Rule::number("", 0.0, 1000.0);
    }
}

form! {
    /// A slide.
    pub struct SlideSpec: "a slide" {
        /// Its direction in the body's frame.
        pub axis: [f64; 3] = [0.0, 1.0, 0.0], within(1.0);
        /// Least and largest way from where it is at the start, m.
        pub limits: [f64; 2] = [-0.3, 0.3], within(3.0);
        /// Damping, N s/m.
        pub damping: f64 = 5.0, Rule::number("", 0.0, 10_000.0);
    }
}

/// The form of a body.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum BodyShape {
    /// A box of `size`.
    #[default]
    Box,
    /// An upright cylinder.
    Cylinder,
    /// A ball.
    Sphere,
    /// The mesh of a file.
    Mesh,
    /// A box of `size` with `handles`; by default one at each end.
    Bar,
    /// A bottom with a rim on each side.
    Tray,
    /// An upright cylinder, open at the top.
    Cup,
}
choice!(BodyShape {
    "box" => Self::Box, "cylinder" => Self::Cylinder, "sphere" => Self::Sphere, "mesh" => Self::Mesh,
    "bar" => Self::Bar, "tray" => Self::Tray, "cup" => Self::Cup,
});

/// Whether a body can move.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum BodyMotion {
    /// It can be pushed and carried.
    #[default]
    Free,
    /// It is fixed to the room.
    Static,
}
choice!(BodyMotion { "free" => Self::Free, "static" => Self::Static });

/// Where a body is at the start, root frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Place {
    /// Its middle is above this place; it lies on the table, or on the floor beside it, m.
    On([f64; 2]),
    /// Its middle, m.
    At([f64; 3]),
}

impl Default for Place {
    fn default() -> Self {
        Self::On([0.0; 2])
    }
}

impl Place {
    /// Its x and y, m.
    pub fn xy(&self) -> [f64; 2] {
        match *self {
            Self::On(at) => at,
            Self::At([x, y, _]) => [x, y],
        }
    }

    fn x(&mut self) -> &mut f64 {
        match self {
            Self::On([x, _]) | Self::At([x, _, _]) => x,
        }
    }
}

impl Field for Place {
    fn read(&mut self, node: &Node, _: &Rule, findings: &mut Findings) {
        let rule = within(5.0);
        match &node.value {
            Yaml::List(items) if items.len() == 2 => {
                let mut at = self.xy();
                at.read(node, &rule, findings);
                *self = Self::On(at);
            }
            Yaml::List(items) if items.len() == 3 => {
                let mut at = [0.0; 3];
                at.read(node, &rule, findings);
                *self = Self::At(at);
            }
            _ => findings.form(node, "`[x, y]` or `[x, y, z]`"),
        }
    }
    fn schema(_: &Rule) -> Json {
        let rule = within(5.0);
        json!({"anyOf": [<[f64; 2]>::schema(&rule), <[f64; 3]>::schema(&rule)]})
    }
}

impl From<&ObjectSpec> for BodySpec {
    fn from(object: &ObjectSpec) -> Self {
        let ObjectSpec { name, at, yaw_deg, size, mass, stiffness, color } = object.clone();
        let (at, soft) = (Place::On(at), Some(stiffness));
        Self { name, size, mass, soft, at, yaw_deg, color, ..Self::default() }
    }
}

/// The springs under a soft body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Softness {
    /// Its size, m.
    pub size: [f64; 3],
    /// Its mass, kg.
    pub mass: f64,
    /// Stiffness of its whole underside, N/m.
    pub stiffness: f64,
}

impl BodySpec {
    fn fits(&mut self, node: &Node, findings: &mut Findings) {
        let mut wrong = |key: &str, message: String, help: &str| {
            findings.error_help(code::VALUE, node.place(key), message, Some(help.to_owned()));
        };
        if self.mesh.is_some() != (self.shape == BodyShape::Mesh) {
            wrong(
                "mesh",
                format!("body `{}`: `shape: mesh` and `mesh: FILE` go together", self.name),
                "write both, or neither",
            );
        }
        if self.soft.is_some() && self.shape != BodyShape::Box {
            wrong("soft", format!("body `{}` cannot be soft", self.name), "only a box can");
        }
        if let Some(soft) = self.soft
            && self.mass * GRAVITY > 0.25 * soft * self.size[2]
        {
            wrong(
                "soft",
                format!("body `{}` is too soft: its weight alone presses it flat", self.name),
                "make it lighter, thicker or stiffer",
            );
        }
        if self.contents.is_some() && !matches!(self.shape, BodyShape::Tray | BodyShape::Cup) {
            wrong("contents", format!("nothing can lie in body `{}`", self.name), "it is in a cup or a tray");
        }
        if usize::from(self.motion == BodyMotion::Static)
            + usize::from(self.hinge.is_some())
            + usize::from(self.slide.is_some())
            > 1
        {
            wrong(
                "motion",
                format!("body `{}` moves in more than one way", self.name),
                "one of `motion: static`, `hinge` and `slide`",
            );
        }
        let axes = [self.hinge.as_ref().map(|hinge| hinge.axis), self.slide.as_ref().map(|slide| slide.axis)];
        if axes.iter().flatten().any(|axis| Vector3::from(*axis).norm() < 1e-3) {
            wrong("hinge", format!("the axis of body `{}` has no direction", self.name), "axis: [0, 0, 1]");
        }
        if self.on.is_some() && self.beside.is_some() {
            wrong(
                "beside",
                format!("body `{}` stands on a body and beside one", self.name),
                "one of `on` and `beside`",
            );
        }
        if self.stripes > 1 && !matches!(self.shape, BodyShape::Box | BodyShape::Cylinder) {
            wrong(
                "stripes",
                format!("body `{}` cannot have stripes", self.name),
                "only a box and a cylinder can",
            );
        }
        let wide = match self.shape {
            BodyShape::Tray => self.size[0].min(self.size[1]).min(2.0 * self.size[2]),
            BodyShape::Cup => self.diameter.min(2.0 * self.height),
            _ => f64::INFINITY,
        };
        if wide < 3.0 * self.wall {
            wrong("wall", format!("the wall of body `{}` is too thick for it", self.name), "make it thinner");
        }
        if let Some(mesh) = self.mesh.clone() {
            let beside = findings.source.path.parent().unwrap_or(Path::new("")).join(mesh);
            if mesh_file(&beside).is_none() {
                let help = Some("an STL, OBJ or DAE file in m, beside the world's".into());
                let message = format!("the mesh `{}` is not there, or cannot be read", beside.display());
                findings.error_help(code::REFERENCE, node.place("mesh"), message, help);
            }
            self.mesh = Some(beside.to_string_lossy().into_owned());
        }
    }

    /// Mirrors it across the plane x = 0. A mesh keeps its own form.
    pub(super) fn mirror(&mut self) {
        let flip = |x: &mut f64| *x = if *x == 0.0 { 0.0 } else { -*x };
        flip(self.at.x());
        flip(&mut self.yaw_deg);
        self.handles.iter_mut().for_each(|[x, ..]| flip(x));
        if let Some(slide) = &mut self.slide {
            flip(&mut slide.axis[0]);
        }
        if let Some(hinge) = &mut self.hinge {
            // Rotations mirror as the normals of their planes: those about an axis in the plane change their sign.
            hinge.axis[1..].iter_mut().for_each(flip);
            flip(&mut hinge.through[0]);
        }
    }

    /// Half its extents along its own axes, m, about its middle.
    pub fn half(&self) -> Vector3<f64> {
        match self.shape {
            BodyShape::Box | BodyShape::Bar | BodyShape::Tray => Vector3::from(self.size) / 2.0,
            BodyShape::Cylinder | BodyShape::Cup => {
                Vector3::new(self.diameter, self.diameter, self.height) / 2.0
            }
            BodyShape::Sphere => Vector3::repeat(self.diameter / 2.0),
            BodyShape::Mesh => self.parts().iter().fold(Vector3::zeros(), |half, part| match &part.shape {
                Geometry::Mesh(mesh) => half.sup(&mesh.surrounding_box().1),
                _ => half,
            }),
        }
    }

    /// Its springs, if it is soft.
    pub fn softness(&self) -> Option<Softness> {
        self.soft.map(|stiffness| Softness { size: self.size, mass: self.mass, stiffness })
    }

    /// The parts that are drawn and that touch.
    pub fn parts(&self) -> Vec<Visual> {
        let part = |shape: Geometry, at: Vector3<f64>| Visual {
            shape,
            link_from_shape: Isometry3::from_parts(at.into(), UnitQuaternion::identity()),
            color: self.color,
        };
        let cuboid = |size: Vector3<f64>, at: Vector3<f64>| part(Geometry::Box { size }, at);
        let size = Vector3::from(self.size);
        let mut parts = match self.shape {
            BodyShape::Bar => vec![cuboid(size, Vector3::zeros())],
            BodyShape::Box => self.striped(size.x, Vector3::x(), &|width, at| {
                part(Geometry::Box { size: Vector3::new(width, size.y, size.z) }, at)
            }),
            BodyShape::Cylinder => self.striped(self.height, Vector3::z(), &|length, at| {
                part(Geometry::Cylinder { radius: self.diameter / 2.0, length }, at)
            }),
            BodyShape::Sphere => {
                vec![part(Geometry::Sphere { radius: self.diameter / 2.0 }, Vector3::zeros())]
            }
            BodyShape::Mesh => self.mesh_part().into_iter().collect(),
            BodyShape::Tray => self.tray(&cuboid),
            BodyShape::Cup => self.cup(&part),
        };
        parts.extend(self.handle_parts());
        parts
    }

    /// The middles of its handles in its own frame, m.
    pub fn handle_places(&self) -> Vec<[f64; 3]> {
        let ([x, _, z], [diameter, height]) = (self.size, HANDLE);
        match self.shape {
            BodyShape::Bar if self.handles.is_empty() => {
                [-1.0, 1.0].map(|side| [side * (x / 2.0 - diameter), 0.0, (z + height) / 2.0]).to_vec()
            }
            _ => self.handles.clone(),
        }
    }

    /// How its upright handles are gripped: the frames of a hand's grasp in the body's frame, from straight above (x down), with the
    /// fingers along the body's y.
    pub fn handle_grasps(&self) -> Vec<Isometry3<f64>> {
        let [_, height] = HANDLE;
        let from_above = UnitQuaternion::from_euler_angles(-FRAC_PI_2, FRAC_PI_2, 0.0);
        let grasp = |[x, y, z]: [f64; 3]| {
            let at = Vector3::new(x, y, z + height / 2.0 - BELOW_TOP);
            Isometry3::from_parts(at.into(), from_above)
        };
        self.handle_places().into_iter().map(grasp).collect()
    }

    /// The handles, which are the last of its [`parts`](Self::parts).
    pub fn handle_parts(&self) -> Vec<Visual> {
        let [diameter, length] = HANDLE;
        let handle = |at: [f64; 3]| Visual {
            shape: Geometry::Cylinder { radius: diameter / 2.0, length },
            link_from_shape: Isometry3::from_parts(Vector3::from(at).into(), UnitQuaternion::identity()),
            color: self.handle_color.unwrap_or(self.color),
        };
        self.handle_places().into_iter().map(handle).collect()
    }

    /// The height of what stands on it over its middle, m.
    pub(crate) fn bears_at(&self) -> f64 {
        let half = self.half().z;
        if self.shape == BodyShape::Tray { self.wall - half } else { half }
    }

    /// The stripes along an axis on which its whole length is `length` m.
    fn striped(
        &self,
        length: f64,
        axis: Vector3<f64>,
        part: &dyn Fn(f64, Vector3<f64>) -> Visual,
    ) -> Vec<Visual> {
        let width = length / f64::from(self.stripes);
        let stripe = |n: u32| {
            let at = axis * (width * (f64::from(n) + 0.5) - length / 2.0);
            let color = if n.is_multiple_of(2) { self.color } else { self.stripe_color };
            Visual { color, ..part(width, at) }
        };
        (0..self.stripes).map(stripe).collect()
    }

    /// The corners of a convex outline around it as seen from above, m, about its middle, against the clock.
    pub(crate) fn outline(&self) -> Vec<Vector2<f64>> {
        let half = self.half();
        match self.shape {
            BodyShape::Cylinder | BodyShape::Sphere | BodyShape::Cup => {
                let corner = |n: u32| Rotation2::new(TAU * f64::from(n) / f64::from(ROUND)) * Vector2::x();
                // Around the circle, not in it.
                let radius = half.x / libm::cos(TAU / f64::from(ROUND) / 2.0);
                (0..ROUND).map(|n| corner(n) * radius).collect()
            }
            _ => [(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)]
                .map(|(x, y)| Vector2::new(x * half.x, y * half.y))
                .to_vec(),
        }
    }

    /// The mesh about its middle.
    fn mesh_part(&self) -> Option<Visual> {
        let mesh = mesh_file(Path::new(self.mesh.as_ref()?))?;
        let middle = mesh.surrounding_box().0;
        let link_from_shape = Isometry3::from_parts((-middle.coords).into(), UnitQuaternion::identity());
        Some(Visual { shape: Geometry::Mesh(mesh), link_from_shape, color: self.color })
    }

    fn tray(&self, cuboid: &impl Fn(Vector3<f64>, Vector3<f64>) -> Visual) -> Vec<Visual> {
        let ([x, y, z], wall) = (self.size, self.wall);
        let side = |k: usize, sign: f64| {
            let (mut size, mut at) = (Vector3::new(x, y, z), Vector3::zeros());
            (size[k], at[k]) = (wall, sign * (self.size[k] - wall) / 2.0);
            cuboid(size, at)
        };
        let bottom = cuboid(Vector3::new(x, y, wall), Vector3::z() * ((wall - z) / 2.0));
        vec![bottom, side(0, -1.0), side(0, 1.0), side(1, -1.0), side(1, 1.0)]
    }

    fn cup(&self, part: &impl Fn(Geometry, Vector3<f64>) -> Visual) -> Vec<Visual> {
        let (radius, wall) = (self.diameter / 2.0, self.wall);
        let bottom = Geometry::Cylinder { radius, length: wall };
        let mut parts = vec![part(bottom, Vector3::z() * ((wall - self.height) / 2.0))];
        let width = 2.0 * radius * libm::tan(TAU / f64::from(STAVES) / 2.0);
        parts.extend((0..STAVES).map(|i| {
            let turn =
                UnitQuaternion::from_axis_angle(&Vector3::z_axis(), TAU * f64::from(i) / f64::from(STAVES));
            let at = turn * Vector3::new(radius - wall / 2.0, 0.0, 0.0);
            let stave = Geometry::Box { size: Vector3::new(wall, width, self.height) };
            Visual { link_from_shape: Isometry3::from_parts(at.into(), turn), ..part(stave, at) }
        }));
        parts
    }
}

impl World {
    /// The bodies that the file names: the `objects`, then the `bodies`.
    pub fn named_bodies(&self) -> impl Iterator<Item = BodySpec> + '_ {
        self.objects.iter().map(BodySpec::from).chain(self.bodies.iter().cloned())
    }

    /// The name of a body, by its index among them.
    pub fn body_name(&self, index: usize) -> Option<&str> {
        let objects = self.objects.iter().map(|object| &object.name);
        objects.chain(self.bodies.iter().map(|body| &body.name)).nth(index).map(String::as_str)
    }
}

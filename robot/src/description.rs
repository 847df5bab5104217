//! Reads a robot's description from URDF (up to version 1.2, whose `<limit>` has an acceleration) into a [`Model`].
//!
//! It reads links, primitives with their colours, inertials, and revolute, continuous, prismatic and fixed joints.
//! Meshes are left out (this project draws and collides primitives only). Joints of other kinds, mimic joints,
//! loops, several roots and numbers that are not finite are refused.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Matrix3, Point3, Translation3, Unit, UnitQuaternion, Vector3};

use crate::RobotError;
use crate::model::{
    Collision, Inertial, Joint, JointKind, LimbSpec, Link, LinkId, Model, Primitive, Visual, unknown,
};

const ARMAR3: &str = include_str!("../description/armar3.urdf");

/// Acceleration of joints whose description states none, rad/s² (m/s²).
const DEFAULT_ACCELERATION: f64 = 10.0;

impl Model {
    /// ARMAR-III's upper body: limbs `torso`, `head`, `right_arm`, `left_arm`, `right_hand`.
    #[expect(clippy::missing_panics_doc, reason = "the embedded description is read by a test")]
    pub fn armar3() -> Self {
        Self::from_urdf(ARMAR3)
            .and_then(|model| model.with_limbs(&armar3_limbs()))
            .expect("the embedded description is sound")
    }

    /// Reads a robot from URDF text, without limbs; add them with [`Model::with_limbs`].
    ///
    /// # Errors
    /// [`RobotError::Description`] names the link or joint and what is wrong with it.
    pub fn from_urdf(text: &str) -> Result<Self, RobotError> {
        let robot = urdf_rs::read_from_string(text).map_err(|e| fault(format!("cannot read URDF: {e}")))?;
        Reader::new(&robot)?.read()
    }
}

fn fault(what: String) -> RobotError {
    RobotError::Description { what }
}

fn armar3_limbs() -> Vec<LimbSpec> {
    let limb = |name: &str, joints: &[&str], tcp: Option<&str>, sensor: Option<&str>| LimbSpec {
        name: name.to_owned(),
        joints: joints.iter().map(|&j| j.to_owned()).collect(),
        tcp: tcp.map(str::to_owned),
        sensor: sensor.map(str::to_owned),
    };
    let arm = |side: &str| {
        ["shoulder_1", "shoulder_2", "upperarm", "elbow", "underarm", "wrist_1", "wrist_2"]
            .map(|j| format!("{j}_{side}"))
    };
    let (right, left) = (arm("r"), arm("l"));
    vec![
        limb("torso", &["hip_pitch", "hip_roll", "hip_yaw"], None, None),
        limb(
            "head",
            &["neck_pitch", "neck_roll", "neck_yaw", "head_tilt", "camera_tilt", "eye_pan_l", "eye_pan_r"],
            None,
            None,
        ),
        limb(
            "right_arm",
            &right.each_ref().map(String::as_str),
            Some("tcp_right"),
            Some("wrist_sensor_right"),
        ),
        limb("left_arm", &left.each_ref().map(String::as_str), Some("tcp_left"), None),
        limb("right_hand", &["finger_left_r", "finger_right_r"], None, None),
    ]
}

/// The URDF tree during the walk.
struct Reader<'a> {
    robot: &'a urdf_rs::Robot,
    links: BTreeMap<&'a str, &'a urdf_rs::Link>,
    children: BTreeMap<&'a str, Vec<&'a urdf_rs::Joint>>,
    root: &'a str,
}

impl<'a> Reader<'a> {
    fn new(robot: &'a urdf_rs::Robot) -> Result<Self, RobotError> {
        let mut links = BTreeMap::new();
        for link in &robot.links {
            if links.insert(link.name.as_str(), link).is_some() {
                return Err(fault(format!("two links are named `{}`", link.name)));
            }
        }
        let mut children: BTreeMap<&str, Vec<&urdf_rs::Joint>> = BTreeMap::new();
        let mut parent_of: BTreeMap<&str, &str> = BTreeMap::new();
        for joint in &robot.joints {
            for end in [&joint.parent.link, &joint.child.link] {
                if !links.contains_key(end.as_str()) {
                    return Err(fault(format!(
                        "joint `{}` names the link `{end}`, which is missing",
                        joint.name
                    )));
                }
            }
            if parent_of.insert(&joint.child.link, &joint.name).is_some() {
                return Err(fault(format!("the link `{}` has two parents", joint.child.link)));
            }
            children.entry(&joint.parent.link).or_default().push(joint);
        }
        let mut roots = links.keys().filter(|name| !parent_of.contains_key(*name));
        match (roots.next(), roots.next()) {
            (Some(&root), None) => Ok(Self { robot, links, children, root }),
            (Some(a), Some(b)) => Err(fault(format!("there are two roots, `{a}` and `{b}`"))),
            (None, _) => Err(fault("there is no root link".to_owned())),
        }
    }

    fn read(&self) -> Result<Model, RobotError> {
        let mut model = Model {
            name: self.robot.name.clone(),
            links: Vec::new(),
            joints: Vec::new(),
            limbs: BTreeMap::new(),
            link_ids: BTreeMap::new(),
            joint_ids: BTreeMap::new(),
            supporting: Vec::new(),
        };
        let mut waiting: Vec<(Option<LinkId>, Option<&urdf_rs::Joint>)> = vec![(None, None)];
        while let Some((parent, via)) = waiting.pop() {
            let name = via.map_or(self.root, |joint| &joint.child.link);
            let id = self.add(&mut model, name, parent, via)?;
            for joint in self.children.get(name).into_iter().flatten().rev() {
                waiting.push((Some(id), Some(joint)));
            }
        }
        if model.links.len() < self.links.len() {
            return Err(fault("some links hang in a loop and not on the root".to_owned()));
        }
        Ok(model)
    }

    fn add(
        &self,
        model: &mut Model,
        name: &str,
        parent: Option<LinkId>,
        via: Option<&urdf_rs::Joint>,
    ) -> Result<LinkId, RobotError> {
        let id = LinkId(model.links.len());
        let urdf =
            self.links.get(name).copied().ok_or_else(|| unknown("link", name, model.link_ids.keys()))?;
        let mut supporting = parent.map_or_else(Vec::new, |p| model.supporting[p.0].clone());
        let joint = via.map(|joint| read_joint(joint, id)).transpose()?.flatten();
        let joint = match joint {
            None => None,
            Some(joint) => {
                let index = model.joints.len();
                if model.joint_ids.insert(joint.name.clone(), index).is_some() {
                    return Err(fault(format!("two joints are named `{}`", joint.name)));
                }
                model.joints.push(joint);
                supporting.push(index);
                Some(index)
            }
        };
        let parent_from_link = via.map_or_else(|| Ok(Isometry3::identity()), |j| pose(&j.origin, &j.name))?;
        let (visuals, collisions) = (self.visuals(urdf)?, collisions(urdf)?);
        let inertial = inertial(urdf)?;
        model.supporting.push(supporting);
        model.link_ids.insert(name.to_owned(), id);
        let name = name.to_owned();
        model.links.push(Link { name, parent, joint, parent_from_link, inertial, visuals, collisions });
        Ok(id)
    }

    fn visuals(&self, link: &urdf_rs::Link) -> Result<Vec<Visual>, RobotError> {
        let mut visuals = Vec::new();
        for visual in &link.visual {
            let Some(shape) = shape(&visual.geometry, &link.name)? else { continue };
            let link_from_shape = pose(&visual.origin, &link.name)?;
            visuals.push(Visual { shape, link_from_shape, color: self.color(visual.material.as_ref()) });
        }
        Ok(visuals)
    }

    /// A material's own colour, else that of the robot's material with its name, else grey.
    fn color(&self, material: Option<&urdf_rs::Material>) -> [u8; 3] {
        let named = |m: &urdf_rs::Material| {
            self.robot
                .materials
                .iter()
                .find(|named| named.name == m.name)
                .and_then(|named| named.color.clone())
        };
        let color = material.and_then(|m| m.color.clone().or_else(|| named(m)));
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to 0..=255")]
        let byte = |c: f64| (c.clamp(0.0, 1.0) * 255.0).round() as u8;
        color.map_or([150; 3], |c| [byte(c.rgba[0]), byte(c.rgba[1]), byte(c.rgba[2])])
    }
}

fn read_joint(joint: &urdf_rs::Joint, link: LinkId) -> Result<Option<Joint>, RobotError> {
    use urdf_rs::JointType;
    let name = &joint.name;
    let kind = match joint.joint_type {
        JointType::Fixed => return Ok(None),
        JointType::Revolute | JointType::Continuous => JointKind::Revolute,
        JointType::Prismatic => JointKind::Prismatic,
        ref other => {
            return Err(fault(format!("joint `{name}` is of the kind {other:?}, which is not known")));
        }
    };
    if joint.mimic.is_some() {
        return Err(fault(format!("joint `{name}` mimics another, which is not supported")));
    }
    let axis = Unit::try_new(Vector3::from(joint.axis.xyz.0), 1e-9)
        .filter(|axis| axis.iter().all(|c| c.is_finite()))
        .ok_or_else(|| fault(format!("joint `{name}` has no axis")))?;
    let limit = &joint.limit;
    let endless = joint.joint_type == JointType::Continuous;
    let (lower, upper) =
        if endless { (f64::NEG_INFINITY, f64::INFINITY) } else { (limit.lower, limit.upper) };
    if !(lower <= upper && limit.velocity > 0.0 && limit.acceleration > 0.0) {
        return Err(fault(format!(
            "joint `{name}` needs lower <= upper and a velocity and acceleration over 0"
        )));
    }
    let acceleration = if limit.acceleration.is_finite() { limit.acceleration } else { DEFAULT_ACCELERATION };
    let name = name.clone();
    let (velocity, effort) = (limit.velocity, limit.effort);
    Ok(Some(Joint { name, kind, link, axis, lower, upper, velocity, acceleration, effort }))
}

fn pose(origin: &urdf_rs::Pose, of: &str) -> Result<Isometry3<f64>, RobotError> {
    let (xyz, rpy) = (origin.xyz.0, origin.rpy.0);
    if xyz.iter().chain(&rpy).any(|c| !c.is_finite()) {
        return Err(fault(format!("an origin of `{of}` is not finite")));
    }
    let rotation = UnitQuaternion::from_euler_angles(rpy[0], rpy[1], rpy[2]);
    Ok(Isometry3::from_parts(Translation3::from(Vector3::from(xyz)), rotation))
}

fn shape(geometry: &urdf_rs::Geometry, of: &str) -> Result<Option<Primitive>, RobotError> {
    let shape = match *geometry {
        urdf_rs::Geometry::Box { size } => Primitive::Box { size: Vector3::from(size.0) },
        urdf_rs::Geometry::Cylinder { radius, length } => Primitive::Cylinder { radius, length },
        urdf_rs::Geometry::Sphere { radius } => Primitive::Sphere { radius },
        urdf_rs::Geometry::Capsule { .. } | urdf_rs::Geometry::Mesh { .. } => return Ok(None),
    };
    let sizes = match shape {
        Primitive::Box { size } => [size.x, size.y, size.z],
        Primitive::Cylinder { radius, length } => [radius, radius, length],
        Primitive::Sphere { radius } => [radius; 3],
    };
    if sizes.iter().any(|s| !(s.is_finite() && *s > 0.0)) {
        return Err(fault(format!("a shape of the link `{of}` has a size that is not a length")));
    }
    Ok(Some(shape))
}

fn collisions(link: &urdf_rs::Link) -> Result<Vec<Collision>, RobotError> {
    let mut collisions = Vec::new();
    for collision in &link.collision {
        if let Some(shape) = shape(&collision.geometry, &link.name)? {
            collisions.push(Collision { shape, link_from_shape: pose(&collision.origin, &link.name)? });
        }
    }
    Ok(collisions)
}

fn inertial(link: &urdf_rs::Link) -> Result<Option<Inertial>, RobotError> {
    let (mass, i) = (link.inertial.mass.value, &link.inertial.inertia);
    if mass == 0.0 {
        return Ok(None);
    }
    let in_inertial = Matrix3::new(i.ixx, i.ixy, i.ixz, i.ixy, i.iyy, i.iyz, i.ixz, i.iyz, i.izz);
    if !(mass > 0.0 && mass.is_finite() && in_inertial.iter().all(|c| c.is_finite())) {
        return Err(fault(format!("the inertia of the link `{}` is not physical", link.name)));
    }
    let link_from_inertial = pose(&link.inertial.origin, &link.name)?;
    let rotation = link_from_inertial.rotation.to_rotation_matrix();
    let inertia = rotation.matrix() * in_inertial * rotation.matrix().transpose();
    Ok(Some(Inertial { mass, center: Point3::from(link_from_inertial.translation.vector), inertia }))
}

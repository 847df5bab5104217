//! `LookAt`: turns the head until both eyes look at a point.

use std::sync::Arc;

use armarium_robot::{LinkId, Model};
use armarium_runtime::skill::{Failure, Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Unit};
use nalgebra::{DMatrix, DVector, Point3, Vector3};

use crate::arm::{Senses, lease, link};
use crate::equipment::{self, Equipment};
use crate::inputs::{Inputs, as_point};

/// Damping of the gaze's inverse kinematics, rad.
const DAMPING: f64 = 0.05;

pub(crate) fn skill(equipment: &Equipment) -> Arc<dyn Skill> {
    let manifest = SkillManifest::new("LookAt", "Turns the head until the left eye looks at a point.")
        .input("point", Type::list(Type::FLOAT), "Where to look: x, y, z in the root frame, m.")
        .optional("tolerance", Type::quantity(Unit::RAD), 0.03, "How near the gaze must be.")
        .optional("timeout", Type::Duration, 5.0, "Longest time it may take.")
        .limb("head");
    equipment::skill(equipment, manifest, run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let point =
        as_point(context.value("point")?).ok_or_else(|| Failure::new("`point` needs three numbers"))?;
    let (tolerance, timeout) = (context.number("tolerance")?, context.number("timeout")?);
    let head = lease(&equipment, &context, "head")?;
    let model = equipment.robot.model();
    let joints = model.limb("head");
    let camera = link(model, "camera_left")?;
    let mut senses = Senses::new(&*equipment.robot, &context);
    let (mut elapsed, mut reached_for) = (0.0, 0.0);
    loop {
        let (sample, dt) = senses.next().await?;
        elapsed += dt;
        let gaze = Gaze::at(model, &sample.position, joints, camera, &point);
        reached_for = if gaze.angle < tolerance { reached_for + dt } else { 0.0 };
        if reached_for > 0.3 {
            return Ok(Outcome::success());
        }
        if elapsed > timeout {
            return Err(Failure::new(format!(
                "the eyes are still {:.2} rad off the point after {timeout:.0} s: it is out of the head's range",
                gaze.angle
            )));
        }
        let velocity: Vec<f64> = gaze.turn.iter().map(|d| (4.0 * d).clamp(-1.0, 1.0)).collect();
        head.command(&velocity).map_err(|f| Failure::new(f.to_string()))?;
    }
}

/// By how much the gaze is off, and how the head's joints should turn.
struct Gaze {
    angle: f64,
    turn: DVector<f64>,
}

impl Gaze {
    fn at(model: &Arc<Model>, q: &[f64], joints: &[usize], camera: LinkId, point: &Point3<f64>) -> Self {
        let root_from_camera = model.link_pose(q, camera);
        let axis = root_from_camera * Vector3::z();
        let wanted = (point - Point3::from(root_from_camera.translation.vector)).normalize();
        let error = axis.cross(&wanted);
        let angle = axis.angle(&wanted);
        // The eyes stay parallel, as the stereo calibration holds only there.
        let mut jacobian = DMatrix::zeros(3, joints.len());
        let whole = model.jacobian(q, camera, joints);
        for (column, &joint) in joints.iter().enumerate() {
            if !model.joints()[joint].name.contains("eye") {
                jacobian.set_column(column, &whole.fixed_view::<3, 1>(3, column));
            }
        }
        let gram = &jacobian * jacobian.transpose() + DMatrix::identity(3, 3) * DAMPING * DAMPING;
        let solved = gram.lu().solve(&DVector::from_column_slice(error.as_slice()));
        let turn = solved.map_or_else(|| DVector::zeros(joints.len()), |x| jacobian.transpose() * x);
        Self { angle, turn }
    }
}

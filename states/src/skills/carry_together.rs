//! `CarryTogether`: both hands carry what is between them to another place.

use armarium_motion::{LoadStatus, StraightLine};
use armarium_runtime::skill::{Mark, Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Unit};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

use crate::arm::Senses;
use crate::both::{BothArms, config_held, holding, holds, moves_both, moves_with};
use crate::equipment::{self, Equipment};
use crate::inputs::Inputs;
use crate::motions::failed;

/// The outcomes besides `success`.
const LOST: &str = "lost";
const SLIPS: &str = "slips";
/// How long the load rests at the end, s: its weight is the median of what is felt then, which a short shove does not change.
const RESTS: f64 = 0.5;

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new(
        "CarryTogether",
        "Carries what both hands hold between them on a straight line, without letting it slip or crushing it.",
    )
    .input("by", Type::list(Type::FLOAT), "How far: x, y, z in the root frame, m.")
    .optional("turn", Type::quantity(Unit::RAD), 0.0, "How far it is turned about the vertical.")
    .optional(
        "level",
        Type::Bool,
        false,
        "Whether it is turned on the way so that both hands are at one height, too: for grips that are at one height on it.",
    )
    .optional(
        "up",
        Type::list(Type::FLOAT),
        Vec::<f64>::new(),
        "What is turned to the vertical on the way: the normal of what the load stood on, root frame. Empty: it is not tilted.",
    )
    .optional("speed", Type::quantity(Unit::M_S), 0.1, "Speed on the line.");
    let manifest = holds(manifest)
        .output("force", Type::quantity(Unit::N), "With what the hands press against each other at the end.")
        .output("weight", Type::quantity(Unit::N), "The weight that they carry at the end.")
        .output("middle", Type::list(Type::FLOAT), "Where the middle between both hands is then: x, y, z in the root frame, m.")
        .output("yaw", Type::quantity(Unit::RAD), "The angle about z from the root frame's x axis to the line from the second hand to the first one.")
        .outcome(LOST)
        .outcome(SLIPS)
        .mark(Mark::at_start("carrying_started"))
        .mark(Mark::at_success("carrying_ended").with_output("weight_n", "weight"));
    let manifest = moves_with(moves_both(manifest, equipment), equipment);
    equipment::skill(equipment, manifest, run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let by = context.vector("by")?;
    let mut turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), context.number("turn")?);
    let mut both = BothArms::take(&equipment, &context, &[by], holding(&context)?).await?;
    let mut senses = Senses::new(&*equipment.robot, &context);
    let mut law = both.take_load(&senses.newest(), config_held(&equipment, &context)?)?;
    let from = *law.taken();
    let up = context.vector_if_given("up")?.unwrap_or_else(Vector3::z);
    let upright = UnitQuaternion::rotation_between(&up, &Vector3::z()).unwrap_or_default();
    if context.flag("level")? {
        turn *= level(&(upright * across(&both.faces(&senses.newest()))));
    }
    turn *= upright;
    both.move_with(&equipment, &context, &senses.newest(), &from)?;
    let to = Isometry3::from_parts(Translation3::from(from.translation.vector + by), turn * from.rotation);
    let mut line = StraightLine::new(from, to, context.number("speed")?).map_err(failed)?;
    let (mut felt, mut rested, mut force) = (Vec::new(), 0.0, 0.0);
    loop {
        let (sample, dt) = senses.next().await?;
        let point = line.step(dt).map_err(failed)?;
        let Some(step) = both.carry((&sample, dt), &mut law, &point)? else {
            return Ok(Outcome::named(LOST).with("force", force).with("weight", 0.0));
        };
        force = step.forces.squeeze;
        if step.status == LoadStatus::Slips {
            let weight = step.forces.external.z;
            return Ok(Outcome::named(SLIPS).with("force", force).with("weight", weight));
        }
        if line.rested(0.0) {
            felt.push(step.forces.external.z);
            rested += dt;
        }
        if rested > RESTS {
            both.arrived()?;
            let faces = both.faces(&sample);
            let middle = (faces[0].translation.vector + faces[1].translation.vector) / 2.0;
            let line = across(&faces);
            felt.sort_by(f64::total_cmp);
            let outcome = Outcome::success().with("force", force).with("weight", felt[felt.len() / 2]);
            return Ok(outcome
                .with("middle", <[f64; 3]>::from(middle))
                .with("yaw", libm::atan2(line.y, line.x)));
        }
    }
}

/// From the second hand to the first one.
fn across([first, second]: &[Isometry3<f64>; 2]) -> Vector3<f64> {
    first.translation.vector - second.translation.vector
}

/// What turns this line by the shortest way to the height of its beginning.
fn level(line: &Vector3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::rotation_between(line, &Vector3::new(line.x, line.y, 0.0)).unwrap_or_default()
}

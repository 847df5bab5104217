//! `MovementImitation`: observes the coach's tool and learns the demonstrated periodic motion.
//!
//! The tool is tracked by its colour. Its first swipe defines the workspace. From the periodic part, an adaptive
//! oscillator estimates the frequency while a periodic movement primitive learns the motion online. The robot does
//! not move.

use armarium_motion::{
    DemonstrationSegmenter, DemonstrationStage, Imitation, Motion, MotionError, PeriodicDmp,
    PeriodicDmpConfig, SegmenterConfig, Swipe,
};
use armarium_runtime::skill::{
    Failure, Mark, NameKind, Outcome, Skill, SkillContext, SkillManifest, SkillResult,
};
use armarium_values::{Type, Unit};
use nalgebra::Point3;

use crate::arm::Senses;
use crate::equipment::{self, Equipment};
use crate::inputs::{reference, seen_at};
use crate::motions::{self, failed};
use crate::prior::object_class;

/// The robot's request for a demonstration.
const REQUEST: &str = "Please show me how to wipe.";
/// Number of points of the learned path from which the placed motion is learned again.
const POINTS: usize = 200;

/// A motion was demonstrated inside the workspace if its centre is nearer to the workspace's centre than this, m.
const MAX_OFFSET: f64 = 0.15;
/// A tool that has not been seen for longer than this is gone, s.
const GONE_AFTER: f64 = 2.5;

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new(
        "MovementImitation",
        "Watches the coach's tool and learns the periodic motion that it shows.",
    )
    .input("marker", Type::String, "Object class in prior knowledge that the coach demonstrates with.")
    .names(NameKind::ObjectClass)
    .optional("name", Type::String, "wiping", "Name of the learned motion.")
    .optional("patience", Type::Duration, 30.0, "How long to wait for the demonstration to begin.")
    .optional("periods", Type::Int, 40_i64, "Periods after which the demonstration has been seen enough.")
    .output("motion", Type::motion(), "The learned motion.")
    .output("frequency", Type::quantity(Unit::HZ), "Its frequency.")
    .mark(Mark::at_success("learning_ended"));
    equipment::skill(equipment, manifest, run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let name = context.text("name")?;
    let (swipe, imitation, stamp_ns) = watch(&equipment, &context).await?;
    let (primitive, frequency_hz) = imitation.result().ok_or_else(|| {
        Failure::new(format!(
            "no steady rhythm was found in the demonstration: {:.1} periods were followed, two are needed",
            imitation.periods()
        ))
    })?;
    let placed = place(primitive, frequency_hz, &swipe).map_err(failed)?;
    tracing::debug!(swipe = ?swipe, learned_centre = ?primitive.centre(), centre = ?placed.centre(), "placed the motion");
    let motion = Motion::in_space(name, "root", frequency_hz, placed)
        .map_err(failed)?
        .with_learned_from(format!("a demonstration of {:.0} periods", imitation.periods()));
    let id = motions::address(&equipment.agent, name)?;
    motions::store(&*equipment.memory, &id, &motion, stamp_ns).await?;
    Ok(Outcome::success().with("motion", reference("Motion", &id)).with("frequency", frequency_hz))
}

/// The first swipe of a demonstration, what was learned of its motion, and the robot's time at the end, ns.
async fn watch(equipment: &Equipment, context: &SkillContext) -> Result<(Swipe, Imitation, u64), Failure> {
    let patience = context.number("patience")?;
    let most_periods = context.number("periods")?;
    let marker = context.text("marker")?;
    let class = object_class(&*equipment.memory, marker).await?;
    let diameter = class.size.iter().sum::<f64>() / 3.0;
    let mut segmenter = DemonstrationSegmenter::new(SegmenterConfig::default()).map_err(failed)?;
    let mut imitation = Imitation::with_dofs(3).map_err(failed)?;
    let mut sight =
        equipment.look(equipment.track(class.color, Some(diameter), marker).of_level_box(class.size));
    let mut senses = Senses::new(&*equipment.robot, context);
    equipment.robot.say(REQUEST);
    let (mut last_learned, mut waited) = (None, 0.0);
    loop {
        let (sample, dt) = senses.next().await?;
        waited += dt;
        let known = segmenter.known();
        if waited > patience && known.swipe.is_none() {
            return Err(Failure::new(format!(
                "the coach did not demonstrate within {patience:.0} s: no swipe of a tool of the colour ({}, {}, {}) was seen",
                class.color[0], class.color[1], class.color[2]
            )));
        }
        let Some(frame) = sight.newest().map_err(failed)? else { continue };
        let time = frame.stamp_ns as f64 * 1e-9;
        let place = frame.of_class(marker).and_then(seen_at);
        let known = match place {
            Some(point) => segmenter.observe(time, point).map_err(failed)?,
            None => segmenter.known(),
        };
        if let (DemonstrationStage::Periodic, Some(point)) = (known.stage, place) {
            let since = last_learned.replace(time).map_or(1.0 / 15.0, |t| time - t);
            imitation.observe(since, point.coords.as_slice()).map_err(failed)?;
        }
        let gone = last_learned.is_some_and(|seen| time - seen > GONE_AFTER);
        let ended = known.stage == DemonstrationStage::Ended || gone;
        if ended || imitation.periods() >= most_periods {
            let swipe = known.swipe.ok_or_else(|| Failure::new("the demonstration had no first swipe"))?;
            return Ok((swipe, imitation, sample.stamp_ns));
        }
    }
}

/// The learned motion, placed in the workspace of the first swipe and made level, because the coach does not hold
/// the tool at the table's height. A motion demonstrated inside the workspace keeps its place: many periods locate
/// it better than the two ends of a swipe. Otherwise the motion is moved to the centre of the workspace.
fn place(learned: &PeriodicDmp, frequency_hz: f64, swipe: &Swipe) -> Result<PeriodicDmp, MotionError> {
    let middle: Point3<f64> = swipe.centre();
    let path = learned.steady_path(POINTS)?;
    let half = |d: usize| {
        let values = (0..path.len()).map(|s| path.y[s][d]);
        let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        (low + high) / 2.0
    };
    let mut placed = PeriodicDmp::new(PeriodicDmpConfig::with_dofs(3))?;
    let kernels = learned.kernels().len();
    let mut weights = learned.weights().to_vec();
    weights[2 * kernels..].fill(0.0);
    placed.set_weights(&weights)?;
    let away = [middle.x - half(0), middle.y - half(1)];
    let shift = if libm::hypot(away[0], away[1]) < MAX_OFFSET { [0.0; 2] } else { away };
    placed.set_centre(&[learned.centre()[0] + shift[0], learned.centre()[1] + shift[1], middle.z])?;
    placed.start_on_path(0.0, std::f64::consts::TAU * frequency_hz)?;
    Ok(placed)
}

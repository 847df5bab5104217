//! `GazeSelection`: looks where the skills that run need it, until it is cancelled.
//!
//! What they need stands in their manifests (`attends`), where it is in memory. What has to be seen is looked for by processors that run as
//! long as it is needed; what they find, memory gets.

use std::collections::BTreeMap;
use std::sync::Arc;

use armarium_knowledge::updater::Updater;
use armarium_motion::{GazeConfig, GazeSelection, GazeStrategy, GazeTarget, GazeView, saliency};
use armarium_robot::Sensed;
use armarium_runtime::skill::{Failure, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Value};
use armarium_visionx::{ObjectLocalizer, ObjectStep, Sight};
use nalgebra::{Point3, Unit, Vector3};

use crate::arm::Senses;
use crate::attended::{AttendedPlace, AttendedPlaces};
use crate::equipment::{self, Equipment};
use crate::head::{Head, moves_the_head};
use crate::motions::failed;
use crate::prior::object_class;

/// Time between two choices, s.
const CHOICE: f64 = 0.1;
/// Largest speed of a joint while a view is kept, rad/s: slow, so that images stay usable; and while the eyes go to another one.
const FOLLOWING: f64 = 0.3;
const TURNING: f64 = 1.0;
/// Time constant with which the gaze follows the middle of a view, s.
const TIME_CONSTANT: f64 = 0.5;
/// The eyes have come to a view when it is so near, rad.
const NEAR: f64 = 0.1;
/// A thing that was in view for so long and not found, s, counts less by this factor.
const IN_VAIN: f64 = 1.0;
const COUNTS_THEN: f64 = 0.2;
/// What is not needed any more is looked for a little longer, s.
const LOOKED_FOR: f64 = 2.0;
/// The event that explains a choice.
const TURNED: &str = "gaze_turned";

/// The values of the input `strategy`.
const STRATEGIES: [(&str, GazeStrategy); 3] = [
    ("saliency", GazeStrategy::Saliency),
    ("round_robin", GazeStrategy::RoundRobin),
    ("fixed", GazeStrategy::Fixed),
];

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new(
        "GazeSelection",
        "Looks at what the running skills need to know the place of, the least certain first, and at what is new or moves, until it is cancelled.",
    )
    .formerly("WatchCoach")
    .optional("strategy", Type::one_of(STRATEGIES.map(|(name, _)| name)), STRATEGIES[0].0, "`saliency`; for comparison `round_robin`, what is needed one after the other, or `fixed`, where the eyes look at the start.")
    .optional("motion", Type::Any, Value::Null, "A motion whose middle is looked at as well.")
    .reads("hand")
    .attends("motion", 0.05, 1.0)
    .event(TURNED);
    equipment::skill(equipment, moves_the_head(manifest, equipment), run)
}

async fn run(equipment: Equipment, context: SkillContext) -> SkillResult {
    let mut head = Head::take(&equipment, &context)?;
    let mut senses = Senses::new(&*equipment.robot, &context);
    // A person may come at any time.
    let _frames_are_wanted = context.channels.demand("hand");
    let mut looking = Looking::new(&equipment)?;
    let mut attended = AttendedPlaces::default();
    let strategy = context.text("strategy")?;
    let strategy =
        STRATEGIES.iter().find(|(name, _)| *name == strategy).map_or_else(Default::default, |s| s.1);
    let mut gaze = Gaze::new(&equipment, strategy)?;
    let mut waited = CHOICE;
    loop {
        let (sample, dt) = senses.next().await?;
        waited += dt;
        looking.remember(&equipment).await?;
        if waited >= CHOICE {
            let needs = context.channels.attention().needs();
            let watched = attended.watched(&needs, equipment.remembered(), sample.stamp_ns).await?;
            looking.look_for(&equipment, &watched, waited).await?;
            if let Some(view) = gaze.choose(&head, &sample, &watched, waited)
                && view.changed
            {
                context.events.raise(TURNED, explained(&view, &watched));
            }
            waited = 0.0;
        }
        gaze.follow(&mut head, &sample, dt)?;
    }
}

/// Why the eyes go to a view: what is there, how uncertain its place is, and the states whose skills need it.
fn explained(view: &GazeView, watched: &[AttendedPlace]) -> Value {
    let said = in_view(view, watched).map(|thing| {
        let needed_by = thing.needed_by.iter().map(|state| Value::from(state.as_str())).collect();
        Value::record([
            ("thing", Value::from(thing.name.as_str())),
            ("off_by", Value::Float((thing.deviation * 1e4).round() / 1e4)),
            ("saliency", Value::Float((saliency(thing.deviation, thing.within) * 1e3).round() / 1e3)),
            ("needed_by", Value::List(needed_by)),
        ])
    });
    Value::record([("looks_at", Value::List(said.collect()))])
}

/// What is in a view.
fn in_view<'w>(view: &'w GazeView, watched: &'w [AttendedPlace]) -> impl Iterator<Item = &'w AttendedPlace> {
    view.of.iter().filter_map(|name| watched.iter().find(|thing| thing.name == *name))
}

/// Where the eyes look.
struct Gaze {
    selection: GazeSelection,
    /// The middle of the view, root frame, m, and the point that is looked at on the way there.
    middle: Option<Point3<f64>>,
    looked_at: Option<Point3<f64>>,
    /// When each thing was seen last, ns, and for how long it has been in view since, s.
    in_vain: BTreeMap<String, (u64, f64)>,
    strategy: GazeStrategy,
}

impl Gaze {
    fn new(equipment: &Equipment, strategy: GazeStrategy) -> Result<Self, Failure> {
        let [across, up] = equipment.images.calibration().camera.half_angles();
        let config = GazeConfig { across, up, ..GazeConfig::default() };
        let selection = GazeSelection::new(config, strategy).map_err(failed)?;
        Ok(Self { selection, middle: None, looked_at: None, in_vain: BTreeMap::new(), strategy })
    }

    fn choose(
        &mut self,
        head: &Head,
        sample: &Sensed,
        watched: &[AttendedPlace],
        dt: f64,
    ) -> Option<GazeView> {
        let (eye, axis) = head.eye(&sample.position);
        let mut targets = Vec::new();
        let mut in_vain = BTreeMap::new();
        // Stimuli are for those who choose.
        let chooses = self.strategy == GazeStrategy::Saliency;
        for thing in watched.iter().filter(|thing| chooses || !thing.needed_by.is_empty()) {
            let Some(direction) = Unit::try_new(thing.place - eye, 1e-3) else { continue };
            let before = self.in_vain.get(&thing.name).filter(|(seen_ns, _)| *seen_ns == thing.seen_ns);
            let change = if self.selection.in_view(&axis, &direction) { dt } else { -dt };
            let vain = (before.map_or(0.0, |(_, vain)| *vain) + change).clamp(0.0, 2.0 * IN_VAIN);
            let counts = if thing.class.is_some() && vain > IN_VAIN { COUNTS_THEN } else { 1.0 };
            in_vain.insert(thing.name.clone(), (thing.seen_ns, vain));
            let need = counts * thing.weight * saliency(thing.deviation, thing.within);
            targets.push(GazeTarget { name: thing.name.clone(), direction, need, weight: thing.weight });
        }
        self.in_vain = in_vain;
        let reached = |direction: &Unit<Vector3<f64>>| head.reached(sample, &(eye + direction.into_inner()));
        let view = self.selection.choose(dt, &axis, &targets, reached)?;
        let far: Vec<f64> = in_view(&view, watched).map(|thing| (thing.place - eye).norm()).collect();
        let distance = if far.is_empty() { 1.0 } else { far.iter().sum::<f64>() / far.len() as f64 };
        self.middle = Some(eye + view.direction.into_inner() * distance);
        if view.changed {
            self.looked_at = self.middle;
        }
        Some(view)
    }

    /// Turns the head for `dt` s towards the view.
    fn follow(&mut self, head: &mut Head, sample: &Sensed, dt: f64) -> Result<(), Failure> {
        let (Some(middle), Some(looked_at)) = (self.middle, &mut self.looked_at) else { return Ok(()) };
        *looked_at += (middle - *looked_at) * (dt / TIME_CONSTANT).min(1.0);
        let (eye, axis) = head.eye(&sample.position);
        let off = axis.angle(&(*looked_at - eye));
        let speed = if off < NEAR { FOLLOWING } else { TURNING };
        head.look(sample, dt, looked_at, speed)?;
        Ok(())
    }
}

/// The processors that look for what is needed.
struct Looking {
    /// By class, and how long ago it was needed, s.
    by_class: BTreeMap<String, (Sight, f64)>,
    updater: Updater,
}

impl Looking {
    fn new(equipment: &Equipment) -> Result<Self, Failure> {
        let updater = Updater::new(Arc::clone(&equipment.memory), &equipment.agent).map_err(failed)?;
        Ok(Self { by_class: BTreeMap::new(), updater })
    }

    /// Looks for the classes of what is watched from now on, and no more for what has not been needed for long.
    async fn look_for(
        &mut self,
        equipment: &Equipment,
        watched: &[AttendedPlace],
        dt: f64,
    ) -> Result<(), Failure> {
        self.by_class.values_mut().for_each(|(_, ago)| *ago += dt);
        for class in watched.iter().filter_map(|thing| thing.class.as_ref()) {
            if let Some((_, ago)) = self.by_class.get_mut(class) {
                *ago = 0.0;
                continue;
            }
            // What prior knowledge does not describe is looked at, and nothing here can find it.
            let Ok(known) = object_class(&*equipment.memory, class).await else { continue };
            let calibration = equipment.images.calibration();
            let localizer = ObjectLocalizer::new(calibration, known.size, known.color);
            let step = ObjectStep::new(localizer, class).with_table(calibration.camera);
            self.by_class.insert(class.clone(), (equipment.look(step), 0.0));
        }
        self.by_class.retain(|_, (_, ago)| *ago < LOOKED_FOR);
        Ok(())
    }

    /// Passes on to memory what was seen since the last call.
    async fn remember(&mut self, equipment: &Equipment) -> Result<(), Failure> {
        for (sight, _) in self.by_class.values_mut() {
            let Some(frame) = sight.newest().map_err(failed)? else { continue };
            let (seen, search) =
                equipment.remembered().placed(frame.observations.clone(), frame.search.clone());
            self.updater.update_from(&seen, search.as_ref()).await.map_err(failed)?;
        }
        Ok(())
    }
}

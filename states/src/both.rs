//! Both arms under one skill's command, with the faces of their hands between which they hold a load.

use std::sync::Arc;

use armarium_motion::{
    HandOnLoad, Holding, LinePoint, LoadStatus, SharedLoad, SharedLoadConfig, SharedLoadStep,
};
use armarium_robot::{Limb, Model, Platform, Sensed, Twist};
use armarium_runtime::skill::{Failure, SkillContext, SkillManifest};
use armarium_values::{Type, Unit};
use nalgebra::{Isometry3, Vector3, Vector6};

use crate::arm::{LeasedArm, tcp_of};
use crate::equipment::Equipment;
use crate::grasp::hand;
use crate::hand::aperture;
use crate::motions::failed;
use crate::platform::FollowingPlatform;
use crate::torso::{TurningTorso, helps_both};

/// The inputs that say how a load is held.
const SQUEEZE: &str = "squeeze";
const FRICTION: &str = "friction";
const HOLD: &str = "hold";
pub(crate) const STIFFNESS: &str = "stiffness";
/// Where it is known how stiff the contacts are, the squeeze settles with this rate, 1/s: drives are faster.
const SETTLES: f64 = 35.0;
/// Then it rises at this rate where a hand would slip without more, N/s.
const RISES: f64 = 1500.0;
/// And the hands close with at most this speed, m/s.
const CLOSES: f64 = 0.15;
/// The input that says what moves with both arms, and its values.
const MOVES: &str = "moves";
const ARMS: &str = "arms";
const TORSO: &str = "torso";
const PLATFORM: &str = "platform";
/// What a hand grips is gone when its pads have come nearer to each other by this, m.
const CLOSED: f64 = 0.008;
/// A hand that is further than this from where it should be has not arrived, m.
const OFF: f64 = 0.02;
/// The squeeze stays below this, N, and below this share of the force limit: a hand carries, too.
const MOST_SQUEEZE: f64 = 40.0;
const SQUEEZED: f64 = 0.8;

/// What is so far below the hands is what they work on, m.
const BELOW: f64 = 0.2;
/// Number of places along a motion at which hands may come near to what is there.
const WAYPOINTS: usize = 6;

/// The arms that hold a load together: the robot's first two.
pub(crate) fn arms(model: &Model) -> Result<[&Limb; 2], Failure> {
    let arms: Vec<&Limb> = model.arms().take(2).collect();
    let none = || Failure::new(format!("the robot `{}` has no two arms: groups with a `tcp`", model.name()));
    arms.try_into().map_err(|_| none())
}

/// Says that a skill commands both arms.
pub(crate) fn moves_both(manifest: SkillManifest, equipment: &Equipment) -> SkillManifest {
    let arms = equipment.robot.model().arms().take(2);
    arms.fold(manifest, |manifest, arm| manifest.limb(&arm.name))
}

/// Adds the input that says what moves with both arms.
pub(crate) fn moves_with(manifest: SkillManifest, equipment: &Equipment) -> SkillManifest {
    let what = "What moves with the arms: the `torso` turns, where the robot has one, or the `platform` drives and turns, so that the \
                load stays before the robot.";
    let mut manifest = manifest.optional(MOVES, Type::one_of([ARMS, TORSO, PLATFORM]), ARMS, what);
    let model = equipment.robot.model();
    if let Ok(both) = arms(model) {
        manifest =
            helps_both(both).fold(manifest, |manifest, limb| manifest.limb_by_input(MOVES, TORSO, limb));
    }
    match model.platform() {
        Some(_) => manifest.limb_by_input(MOVES, PLATFORM, Platform::LIMB),
        None => manifest,
    }
}

/// Adds the inputs that say how a load is held.
pub(crate) fn squeezes(manifest: SkillManifest) -> SkillManifest {
    manifest
        .optional(SQUEEZE, Type::quantity(Unit::N), 25.0, "Least force of the hands against each other.")
        .optional(
            FRICTION,
            Type::FLOAT,
            0.6,
            "The friction of hands and load on which it relies: they press with 1.5 times what that needs, as far as they can.",
        )
}

/// Adds the inputs that say how a load is held, by pressing or by grips.
pub(crate) fn holds(manifest: SkillManifest) -> SkillManifest {
    let what = "How the hands hold it: `press` from two sides, or `grip`, each a handle, without a squeeze.";
    let stiff = "How stiff the contacts of hands that press are, as `SqueezeTogether` feels it: then the squeeze rises within a shove. 0: unknown.";
    squeezes(manifest).optional(STIFFNESS, Type::quantity(Unit::N_M), 0.0, stiff).optional(
        HOLD,
        Type::one_of(["press", "grip"]),
        "press",
        what,
    )
}

/// How the hands hold the load.
pub(crate) fn holding(context: &SkillContext) -> Result<Holding, Failure> {
    match context.text(HOLD)? {
        "press" => Ok(Holding::Pressing),
        "grip" => Ok(Holding::Gripping),
        other => Err(Failure::new(format!("`{HOLD}` is `{other}`; hands hold by `press` or `grip`"))),
    }
}

/// The law's constants for these inputs, with the chart's limits.
pub(crate) fn config(equipment: &Equipment, context: &SkillContext) -> Result<SharedLoadConfig, Failure> {
    let limit = equipment.robot.model().limits().force_of(context.limits.force_n);
    let most_squeeze = MOST_SQUEEZE.min(SQUEEZED * limit);
    let (squeeze, friction) = (context.number(SQUEEZE)?, context.number(FRICTION)?);
    if squeeze > most_squeeze {
        return Err(Failure::new(format!(
            "a squeeze of {squeeze:.0} N is too much: the force limit leaves {most_squeeze:.0} N"
        )));
    }
    Ok(SharedLoadConfig { squeeze, most_squeeze, friction, ..SharedLoadConfig::default() })
}

/// The same for a load that the hands hold already: the squeeze is quick where it is known how stiff the contacts are.
pub(crate) fn config_held(
    equipment: &Equipment,
    context: &SkillContext,
) -> Result<SharedLoadConfig, Failure> {
    let config = config(equipment, context)?;
    let stiffness = context.number(STIFFNESS)?;
    if stiffness <= 0.0 {
        return Ok(config);
    }
    Ok(SharedLoadConfig { gain: SETTLES / stiffness, slip_rate: RISES, fastest: CLOSES, ..config })
}

/// What moves with both arms, so that what they hold stays before the robot.
enum Helper {
    Torso(TurningTorso),
    Platform(FollowingPlatform),
}

impl Helper {
    /// The twist with which it carries the TCP of an arm, root frame, m/s and rad/s.
    fn carries(&self, arm: &LeasedArm, sample: &Sensed) -> Twist {
        match self {
            Self::Torso(torso) => arm.limb.tcp.map(|tcp| torso.carries(tcp)).unwrap_or_default(),
            Self::Platform(platform) => platform.carries(sample, &arm.tcp(sample).translation.vector),
        }
    }
}

/// Both arms with their leases.
pub(crate) struct BothArms {
    arms: [LeasedArm; 2],
    /// `tcp_from_face`: the faces with which they press, x out of them; or the middles of their grips.
    faces: [Isometry3<f64>; 2],
    holding: Holding,
    helper: Option<Helper>,
    /// How far a hand was from where it should be in the last step, m.
    off: f64,
    /// The joints of both hands, and the distance of their pads when they were taken, m.
    hands: [(Vec<usize>, f64); 2],
}

impl BothArms {
    /// Leases both arms, without what helps them, for motions by these vectors (root frame, m), to hold something in this way. Their null
    /// spaces keep the posture in which they are.
    pub(crate) async fn take(
        equipment: &Equipment,
        context: &SkillContext,
        motions: &[Vector3<f64>],
        holding: Holding,
    ) -> Result<Self, Failure> {
        let model = Arc::clone(equipment.robot.model());
        let [first, second] = arms(&model)?;
        let face = |limb: &Limb| {
            let hand = hand(&model, limb)?;
            if holding == Holding::Gripping {
                return Ok(hand.grasp_in_tcp);
            }
            let name = &hand.name;
            let none = || format!("the robot file does not say with what `{name}` presses: `press_in_tcp`");
            hand.press_in_tcp.ok_or_else(|| Failure::new(none()))
        };
        let faces = [face(first)?, face(second)?];
        let sample = equipment.robot.sensed().borrow();
        let targets = |limb: &Limb| -> Result<Vec<Isometry3<f64>>, Failure> {
            let below = Vector3::z() * -BELOW;
            let now = model.link_pose(&sample.position, tcp_of(limb)?);
            let steps = motions
                .iter()
                .chain([&below])
                .flat_map(|by| (1..=WAYPOINTS).map(move |k| by * (k as f64 / WAYPOINTS as f64)));
            Ok(steps
                .map(|by| Isometry3::from_parts((now.translation.vector + by).into(), now.rotation))
                .collect())
        };
        let mut arms = [
            LeasedArm::take_limb(equipment, context, first, &targets(first)?).await?,
            LeasedArm::take_limb(equipment, context, second, &targets(second)?).await?,
        ];
        arms.iter_mut().for_each(|arm| arm.pull_towards(&arm.positions(&sample)));
        let hands = [first, second].map(|limb| {
            let joints = limb.hand.as_deref().map_or(&[][..], |hand| model.limb(hand)).to_vec();
            let apart = aperture(&joints, &sample);
            (joints, apart)
        });
        Ok(Self { arms, faces, holding, helper: None, off: 0.0, hands })
    }

    /// From now on what the input says moves with the hands: the torso if the robot has one and nobody else commands it, the platform
    /// or it fails. What they hold is at `root_from_load`.
    pub(crate) fn move_with(
        &mut self,
        equipment: &Equipment,
        context: &SkillContext,
        sample: &Sensed,
        root_from_load: &Isometry3<f64>,
    ) -> Result<(), Failure> {
        self.helper = match context.text(MOVES)? {
            TORSO => {
                let hands = [0, 1].map(|i| self.arms[i].tcp(sample));
                let limbs = [&self.arms[0].limb, &self.arms[1].limb];
                TurningTorso::take(equipment, context, limbs, (sample, &hands)).map(Helper::Torso)
            }
            PLATFORM => {
                let platform = FollowingPlatform::under_load(equipment, context, sample, root_from_load)?;
                Some(Helper::Platform(platform))
            }
            _ => None,
        };
        Ok(())
    }

    /// Takes what they hold over where it is.
    pub(crate) fn take_load(&self, sample: &Sensed, config: SharedLoadConfig) -> Result<SharedLoad, Failure> {
        SharedLoad::held(config, self.holding, &self.on_load(sample)?).map_err(failed)
    }

    /// Moves what they hold to a place, and both arms with it; `None` when it is lost.
    pub(crate) fn carry(
        &mut self,
        (sample, dt): (&Sensed, f64),
        law: &mut SharedLoad,
        load: &LinePoint,
    ) -> Result<Option<SharedLoadStep>, Failure> {
        let step = law.step(dt, &self.on_load(sample)?, load).map_err(failed)?;
        let empty = |(joints, apart): &(Vec<usize>, f64)| aperture(joints, sample) < apart - CLOSED;
        let let_go = self.holding == Holding::Gripping && self.hands.iter().any(empty);
        if let_go || step.status == LoadStatus::Lost {
            return Ok(None);
        }
        match &mut self.helper {
            Some(Helper::Torso(torso)) => {
                torso.follow((sample, dt), &[0, 1].map(|i| self.arms[i].tcp(sample)))?;
            }
            Some(Helper::Platform(platform)) => platform.follow(dt, sample, load)?,
            None => {}
        }
        self.off = self.track(sample, &step.hands)?;
        Ok(Some(step))
    }

    /// `root_from_face` of both hands at a sample.
    pub(crate) fn faces(&self, sample: &Sensed) -> [Isometry3<f64>; 2] {
        [0, 1].map(|i| self.arms[i].tcp(sample) * self.faces[i])
    }

    /// Where the TCP of a hand is when its face is there (root frame).
    pub(crate) fn tcp_at(&self, hand: usize, root_from_face: &Isometry3<f64>) -> Isometry3<f64> {
        root_from_face * self.faces[hand].inverse()
    }

    /// The hands on what is between them.
    pub(crate) fn on_load(&self, sample: &Sensed) -> Result<[HandOnLoad; 2], Failure> {
        let faces = self.faces(sample);
        let one = |i: usize| -> Result<HandOnLoad, Failure> {
            Ok(HandOnLoad {
                tcp: self.arms[i].tcp(sample),
                contact: faces[i].translation.vector.into(),
                wrench: self.arms[i].wrench(sample)?,
            })
        };
        Ok([one(0)?, one(1)?])
    }

    /// That what they carry has come to where it should be: a hand that is 20 mm away has an arm at its limits, or the guard stops it.
    pub(crate) fn arrived(&self) -> Result<(), Failure> {
        if self.off < OFF {
            return Ok(());
        }
        Err(Failure::new(format!(
            "a hand is still {:.0} mm from where it should carry the load; is that where both arms reach?",
            self.off * 1e3
        )))
    }

    /// Moves both TCPs to their targets; returns the larger distance from them, m. Where an arm was taken away, its fault; the other one
    /// stands then, too, as the skill ends.
    pub(crate) fn track(&mut self, sample: &Sensed, targets: &[LinePoint; 2]) -> Result<f64, Failure> {
        let mut farthest = 0.0_f64;
        for (arm, target) in self.arms.iter_mut().zip(targets) {
            let carried = self.helper.as_ref().map(|helper| helper.carries(arm, sample));
            let Twist { linear, angular } = carried.unwrap_or_default();
            let off = arm.track(sample, &target.pose, target.linear - linear, target.angular - angular)?;
            farthest = farthest.max(off);
        }
        Ok(farthest)
    }

    /// Velocity of the middle of a hand's face at a sample, root frame, m/s and rad/s, and the columns of its Jacobian, one per
    /// joint.
    pub(crate) fn twist_and_columns(
        &mut self,
        hand: usize,
        sample: &Sensed,
    ) -> (Vector6<f64>, Vec<Vector6<f64>>) {
        let face = self.faces[hand].translation.vector.into();
        self.arms[hand].twist_and_columns(sample, &face)
    }

    pub(crate) fn arm(&mut self, hand: usize) -> &mut LeasedArm {
        &mut self.arms[hand]
    }

    /// The poses of both TCPs, at rest.
    pub(crate) fn resting(&self, sample: &Sensed) -> [LinePoint; 2] {
        [0, 1].map(|i| at_rest(self.arms[i].tcp(sample)))
    }
}

/// A pose without velocity.
pub(crate) fn at_rest(pose: Isometry3<f64>) -> LinePoint {
    LinePoint { pose, linear: Vector3::zeros(), angular: Vector3::zeros() }
}

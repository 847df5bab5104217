//! The loop under every skill that runs a motion: it integrates the primitive and is the only one to command the
//! arm.
//!
//! It owns the motion while it runs. Changes by others arrive as edits (see `running_motion/`) and are executed
//! from the next control step on. The caller sets the pace, and the height of the hand over the path ([`Height`]).
//!
//! A motion is learned in a level plane. In free space it is played so; on a surface, in the frame of that: its x and y lie in the
//! surface, its z is along the normal. The tool is held to the surface as it was to the one from which it was grasped.

use std::f64::consts::TAU;

use armarium_motion::{ContactFrame, Motion, PeriodicOrientationDmp, SurfaceCorrection};
use armarium_robot::{Limb, Sensed};
use armarium_runtime::channels::Channels;
use armarium_runtime::skill::{Failure, SkillContext};
use armarium_values::Value;
use nalgebra::{Isometry3, Point3, Translation3, Unit, UnitQuaternion, Vector3};

use crate::arm::{LeasedArm, Senses, chosen};
use crate::equipment::Equipment;
use crate::grasp::{hand, held_in_tcp};
use crate::inputs::{Inputs, as_pose};
use crate::motions::failed;
use crate::running_motion::MotionOwner;
use crate::surface::{ContactPlane, from_level};

/// Largest rate of change of the pace (share of the learned frequency), 1/s.
const PACE_RATE: f64 = 1.5;
/// How much steeper than believed a surface may be that is wiped: its rise over the way across, 15 degrees.
const STEEPER: f64 = 0.268;
/// A tool that presses with more than this touches, N.
const TOUCHING: f64 = 1.5;
/// An arm that is this far behind its reference cannot follow the motion, m.
const LOST_TRACK: f64 = 0.06;

/// The grasp of the tool, as reported by the grasping chart.
pub(crate) struct GraspedTool {
    /// `root_from_tcp` when the hand closed: the tool then stood on the table.
    pub(crate) tcp: Isometry3<f64>,
    /// What it stood on, where that is known.
    surface: Option<ContactPlane>,
}

impl GraspedTool {
    /// Reads the input `grasp`.
    pub(crate) fn of(context: &SkillContext) -> Result<Self, Failure> {
        let tcp = context.value("grasp")?.get("tcp").and_then(as_pose);
        let tcp =
            tcp.ok_or_else(|| Failure::new("the input `grasp` does not say where the tool was grasped"))?;
        Ok(Self {
            tcp,
            surface: context.value("grasp")?.get("surface").and_then(as_pose).map(ContactPlane::of),
        })
    }

    /// The height of the TCP over the surface when the tool stood on it, m.
    fn standing(&self, surface: &ContactPlane) -> f64 {
        surface.above(&self.tcp.translation.vector.into())
    }

    /// What the tool stood on: at worst, what the hand faced there.
    fn stood_on(&self, equipment: &Equipment, arm: &Limb) -> Result<ContactPlane, Failure> {
        if let Some(surface) = self.surface {
            return Ok(surface);
        }
        let hand = hand(equipment.robot.model(), arm)?;
        Ok(ContactPlane::new(self.tcp * held_in_tcp(hand), hand.grasps_from(&self.tcp.rotation)))
    }
}

/// Height of the TCP over where it was when the tool stood on the surface, along the normal, m, and its rate, m/s.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Height {
    pub(crate) over: f64,
    pub(crate) rate: f64,
}

/// Where a motion is played.
#[derive(Clone, Copy, Debug)]
struct MotionFrame {
    /// From the motion's x and y and the height over the surface to the TCP.
    root_from_motion: Isometry3<f64>,
    /// The hand's orientation, if the motion has none.
    orientation: UnitQuaternion<f64>,
}

impl MotionFrame {
    /// On the surface through `middle` (root frame, m), where the TCP is in the middle of a motion with the centre x and y when
    /// the tool stands.
    fn new(surface: &ContactPlane, middle: &Point3<f64>, tool: (&GraspedTool, &Unit<Vector3<f64>>)) -> Self {
        let turn = from_level(&surface.normal());
        let (tool, stood_on) = tool;
        let onto = UnitQuaternion::rotation_between_axis(stood_on, &surface.normal()).unwrap_or_default();
        let centre = Translation3::new(-middle.x, -middle.y, 0.0);
        Self {
            root_from_motion: Isometry3::from_parts(middle.coords.into(), turn) * centre,
            orientation: onto * tool.tcp.rotation,
        }
    }

    fn normal(&self) -> Unit<Vector3<f64>> {
        Unit::new_normalize(self.root_from_motion * Vector3::z())
    }

    /// The pose of the TCP at a place of the motion.
    fn pose(&self, [x, y]: [f64; 2], over: f64, turned: Option<&UnitQuaternion<f64>>) -> Isometry3<f64> {
        let orientation = turned.map_or(self.orientation, |turned| self.root_from_motion.rotation * turned);
        Isometry3::from_parts((self.root_from_motion * Point3::new(x, y, over)).coords.into(), orientation)
    }
}

/// A motion and the arm that performs it.
pub(crate) struct Wiper {
    pub(crate) arm: LeasedArm,
    motion: MotionOwner,
    frame: MotionFrame,
    /// The hand's rotation, if the motion has one.
    turning: Option<PeriodicOrientationDmp>,
    pace: f64,
    /// The frame of the contact with the surface.
    contact: ContactFrame,
    channels: Channels,
}

impl Wiper {
    /// Leases the arm, and takes ownership of the motion that the input `motion` refers to, to play it over the surface that
    /// memory knows there, or else over the one from which the tool was grasped.
    pub(crate) async fn take(
        equipment: &Equipment,
        context: &SkillContext,
        tool: &GraspedTool,
    ) -> Result<Self, Failure> {
        let (arm, motion, stood_on) = Self::own(equipment, context, tool).await?;
        let [x, y] = middle_of(motion.motion());
        let here =
            ContactPlane::known_under(equipment.remembered(), &stood_on.at(x, y)).await?.unwrap_or(stood_on);
        let middle = here.at(x, y) + here.normal().scale(tool.standing(&stood_on));
        let frame = MotionFrame::new(&here, &middle, (tool, &stood_on.normal()));
        Self::new(arm, motion, frame, context)
    }

    /// The same in free space: level, as it was shown, and high enough to be nowhere lower over the surface than in the middle.
    pub(crate) async fn take_free(
        equipment: &Equipment,
        context: &SkillContext,
        tool: &GraspedTool,
    ) -> Result<Self, Failure> {
        let mut wiper = Self::take(equipment, context, tool).await?;
        let path = wiper.motion().primitive().steady_path(256).map_err(failed)?;
        let on_surface = |y: &Vec<f64>| (wiper.frame.root_from_motion * Point3::new(y[0], y[1], 0.0)).z;
        let highest = path.y.iter().map(on_surface).fold(f64::NEG_INFINITY, f64::max);
        wiper.frame.root_from_motion = Isometry3::translation(0.0, 0.0, highest);
        Ok(wiper)
    }

    /// The same, over the surface that the motion was fitted to, with what was learned of that.
    pub(crate) async fn take_fitted(
        equipment: &Equipment,
        context: &SkillContext,
        tool: &GraspedTool,
    ) -> Result<(Self, SurfaceCorrection), Failure> {
        let (arm, motion, stood_on) = Self::own(equipment, context, tool).await?;
        let [x, y] = middle_of(motion.motion());
        let fitted = motion.motion().surface().cloned().ok_or_else(|| {
            Failure::new("the motion has not been fitted to a surface; run ForceAdaptation first")
        })?;
        let middle = Point3::new(x, y, motion.motion().primitive().centre()[2]);
        let here = ContactPlane::new(middle, Unit::new_normalize(fitted.normal()));
        let frame = MotionFrame::new(&here, &middle, (tool, &stood_on.normal()));
        Ok((Self::new(arm, motion, frame, context)?, fitted))
    }

    /// The arm, the motion, and what the tool stood on.
    async fn own(
        equipment: &Equipment,
        context: &SkillContext,
        tool: &GraspedTool,
    ) -> Result<(LeasedArm, MotionOwner, ContactPlane), Failure> {
        let motion = equipment.motions.own(&equipment.memory, &context.entity("motion")?).await?;
        // It works on what the tool stood on, with the tool over the motion's middle.
        let [x, y] = middle_of(motion.motion());
        let mut over_middle = tool.tcp;
        let surface = tool.stood_on(equipment, chosen(equipment, context)?)?;
        over_middle.translation =
            (surface.at(x, y) + surface.normal().scale(tool.standing(&surface))).coords.into();
        let arm = LeasedArm::take(equipment, context, &[tool.tcp, over_middle]).await?;
        Ok((arm, motion, surface))
    }

    fn new(
        arm: LeasedArm,
        motion: MotionOwner,
        frame: MotionFrame,
        context: &SkillContext,
    ) -> Result<Self, Failure> {
        let turning = motion.motion().orientation().cloned();
        let channels = context.channels.clone();
        // The tool comes along the normal.
        let contact = ContactFrame::new(&frame.normal()).map_err(failed)?;
        let height = motion.motion().primitive().centre()[2];
        // Coaches see the motion in its own plane.
        motion.set_frame(frame.root_from_motion * Translation3::new(0.0, 0.0, -height));
        Ok(Self { arm, motion, frame, turning, pace: 0.0, contact, channels })
    }

    /// The motion as it was when it began to run.
    pub(crate) fn motion(&self) -> &Motion {
        self.motion.motion()
    }

    /// Releases the arm, which brakes, and writes the changes of the motion to memory, with the learned surface.
    pub(crate) async fn finish(
        self,
        surface: Option<&SurfaceCorrection>,
        learned_from: Option<&str>,
    ) -> Result<(), Failure> {
        drop(self.arm);
        self.motion.finish(surface, learned_from).await
    }

    /// The surface's outward normal, on which it plays.
    pub(crate) fn normal(&self) -> Unit<Vector3<f64>> {
        self.frame.normal()
    }

    /// The height of the TCP over where it was when the tool stood, m.
    pub(crate) fn height(&self, sample: &Sensed) -> f64 {
        let tcp = Point3::from(self.arm.tcp(sample).translation.vector);
        self.frame.root_from_motion.inverse_transform_point(&tcp).z
    }

    /// Keeps with the motion where its middle is when the TCP is `over` m over where it was when the tool stood.
    pub(crate) fn set_height(&mut self, over: f64) -> Result<(), Failure> {
        let [x, y] = self.motion.middle();
        self.motion.set_height((self.frame.root_from_motion * Point3::new(x, y, over)).z)
    }

    /// The pose of the TCP at a place of the motion.
    pub(crate) fn pose_at(&self, place: [f64; 2], over: f64) -> Isometry3<f64> {
        self.frame.pose(place, over, None)
    }

    /// The force with which the tool presses on the surface, N; at touchdown its direction is the first guess of the normal.
    pub(crate) fn touch(&mut self, sample: &Sensed, dt: f64) -> Result<f64, Failure> {
        let force = self.arm.force(sample)?;
        self.contact.touch(dt, &force).map_err(failed)?;
        Ok(self.contact.pressing(&force))
    }

    /// The force with which the tool presses on the surface, N, whose normal follows from where it has wiped.
    pub(crate) fn pressing(&mut self, sample: &Sensed) -> Result<f64, Failure> {
        let force = self.contact.pressing(&self.arm.force(sample)?);
        if force > TOUCHING {
            self.contact.wipe(&self.arm.tcp(sample).translation.vector).map_err(failed)?;
        } else {
            self.contact.lift();
        }
        Ok(force)
    }

    /// The phase, rad.
    pub(crate) fn phase(&self) -> f64 {
        self.motion.state().phase
    }

    /// The present share of the learned frequency.
    pub(crate) fn pace(&self) -> f64 {
        self.pace
    }

    /// Sets the primitive to the point of its steady path that is nearest to the TCP, at rest.
    pub(crate) fn start_nearest(&mut self, sample: &Sensed) -> Result<(), Failure> {
        let tcp = Point3::from(self.arm.tcp(sample).translation.vector);
        let tcp = self.frame.root_from_motion.inverse_transform_point(&tcp);
        let path = self.motion().primitive().steady_path(256).map_err(failed)?;
        let distance = |s: usize| libm::hypot(path.y[s][0] - tcp.x, path.y[s][1] - tcp.y);
        let nearest = (0..path.len()).min_by(|&a, &b| distance(a).total_cmp(&distance(b))).unwrap_or(0);
        self.motion.start_on_path(path.phase(nearest))?;
        if let Some(turning) = &mut self.turning {
            turning.start_on_path(path.phase(nearest), self.motion.motion().omega()).map_err(failed)?;
        }
        self.pace = 0.0;
        Ok(())
    }

    /// How much higher than believed the surface may be at the present point of the path, m.
    pub(crate) fn rise_from(&self, tool: &GraspedTool) -> f64 {
        let (y, at) = (self.motion.state().y, tool.tcp.translation.vector);
        STEEPER * libm::hypot(y[0] - at.x, y[1] - at.y)
    }

    /// Moves the TCP on a straight line to the present point of the path, `over` m over where it was when the tool stood.
    pub(crate) async fn approach(
        &mut self,
        senses: &mut Senses,
        over: f64,
        speed: f64,
    ) -> Result<(), Failure> {
        let goal = self.pose(over);
        self.arm.go(senses, goal, speed, check_track).await
    }

    /// One control step of `dt` s: the phase advances at `pace` times the learned frequency (approached smoothly),
    /// and the TCP follows the path at `height`. Returns the present frequency, rad/s.
    pub(crate) fn step(
        &mut self,
        sample: &Sensed,
        dt: f64,
        pace: f64,
        height: Height,
    ) -> Result<f64, Failure> {
        let change = (pace - self.pace).clamp(-PACE_RATE * dt, PACE_RATE * dt);
        self.pace = (self.pace + change).clamp(0.0, 1.0);
        let omega = self.motion().omega() * self.pace;
        self.motion.step(dt, omega, sample.stamp_ns)?;
        let angular = match &mut self.turning {
            Some(turning) => turning.step(dt, omega).map_err(failed)?.angular_velocity,
            None => Vector3::zeros(),
        };
        let state = self.motion.state();
        let (phase, linear) = (state.phase, Vector3::new(state.yd[0], state.yd[1], height.rate));
        let [linear, angular] = [linear, angular].map(|v| self.frame.root_from_motion * v);
        let goal = self.pose(height.over);
        let error = self.arm.track(sample, &goal, linear, angular)?;
        check_track(error)?;
        self.publish(sample, phase, omega);
        Ok(omega)
    }

    fn pose(&self, over: f64) -> Isometry3<f64> {
        let y = self.motion.state().y;
        let turned = self.turning.as_ref().map(|turning| turning.state().orientation);
        self.frame.pose([y[0], y[1]], over, turned.as_ref())
    }

    fn publish(&mut self, sample: &Sensed, phase: f64, omega: f64) {
        let tcp = self.arm.tcp(sample).translation.vector;
        let velocity = self.arm.tcp_velocity(sample);
        let normal = self.contact.normal();
        let pressing = self.arm.force(sample).map_or(0.0, |force| self.contact.pressing(&force));
        self.channels.publish(
            "motion",
            Value::record([
                ("arm", Value::from(self.arm.limb.name.as_str())),
                ("phase", Value::Float(phase)),
                ("frequency", Value::Float(omega / TAU)),
                ("position", Value::from([tcp.x, tcp.y, tcp.z])),
                ("velocity", Value::from([velocity.x, velocity.y, velocity.z])),
                ("normal_force", Value::Float(pressing)),
                ("normal", Value::from([normal.x, normal.y, normal.z])),
            ]),
        );
    }
}

/// The middle of a motion, x and y in its own frame, m.
fn middle_of(motion: &Motion) -> [f64; 2] {
    let centre = motion.primitive().centre();
    [centre[0], centre[1]]
}

/// Monitors whether the tool still touches the surface.
#[derive(Default)]
pub(crate) struct ContactWatch {
    /// How long there has been no contact, s.
    lost_for: f64,
}

impl ContactWatch {
    /// A force below this is no contact, N.
    const MIN_FORCE: f64 = 0.4;
    /// Longest tolerated loss of contact, s.
    const CONTACT_TIMEOUT: f64 = 1.5;

    /// To be called after each `dt` s with the normal force, N.
    pub(crate) fn check(&mut self, dt: f64, force: f64) -> Result<(), Failure> {
        self.lost_for = if force < Self::MIN_FORCE { self.lost_for + dt } else { 0.0 };
        if self.lost_for > Self::CONTACT_TIMEOUT {
            return Err(Failure::new(
                "the tool has not touched the table for a while: is it still in the hand, and is there a table below?",
            ));
        }
        Ok(())
    }
}

fn check_track(error_m: f64) -> Result<(), Failure> {
    if error_m > LOST_TRACK {
        return Err(Failure::new(format!(
            "the arm is {:.0} mm behind the motion: it is too fast for the arm, or something holds the hand",
            error_m * 1e3
        )));
    }
    Ok(())
}

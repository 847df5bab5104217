//! A motion as skills and memory share it: name, version, units, and the source from which it was learned.
//!
//! A loaded motion is complete: sizes and values are checked, so that its execution cannot fail because of its
//! content. [`MotionSwitch`] changes a running motion from one version to another.

use serde::{Deserialize, Serialize};

use crate::error::{MotionError, positive, size, vector};
use crate::orientation::PeriodicOrientationDmp;
use crate::periodic::{PeriodicDmp, PhaseSample};
use crate::surface_correction::SurfaceCorrection;

/// One degree of freedom of a motion.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct MotionDof {
    /// Its name, for instance `x` or a joint.
    pub name: String,
    /// Its unit, `m` or `rad`.
    pub unit: String,
}

/// A learned periodic motion.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "MotionFields")]
pub struct Motion(MotionFields);

/// What a motion is made of, as it is stored.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct MotionFields {
    name: String,
    version: u32,
    dofs: Vec<MotionDof>,
    frame: String,
    frequency_hz: f64,
    primitive: PeriodicDmp,
    workspace_centre: Vec<f64>,
    #[serde(default)]
    learned_from: String,
    #[serde(default)]
    surface: Option<SurfaceCorrection>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    orientation: Option<PeriodicOrientationDmp>,
}

impl TryFrom<MotionFields> for Motion {
    type Error = MotionError;

    fn try_from(fields: MotionFields) -> Result<Self, MotionError> {
        Self(fields).checked()
    }
}

impl Motion {
    /// Version 1 of the motion `name`: `primitive` at `frequency_hz`, its `dofs` in `frame`. The centre of the
    /// workspace is the primitive's centre.
    ///
    /// # Errors
    /// When the name is empty, the number of `dofs` is not that of the primitive, or the frequency not positive.
    pub fn new(
        name: impl Into<String>,
        frame: impl Into<String>,
        dofs: Vec<MotionDof>,
        frequency_hz: f64,
        primitive: PeriodicDmp,
    ) -> Result<Self, MotionError> {
        let workspace_centre = primitive.centre().to_vec();
        let motion = Self(MotionFields {
            name: name.into(),
            version: 1,
            dofs,
            frame: frame.into(),
            frequency_hz,
            primitive,
            workspace_centre,
            learned_from: String::new(),
            surface: None,
            orientation: None,
        });
        motion.checked()
    }

    /// A motion of x, y, z in metres in `frame`, as [`new`](Self::new).
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn in_space(
        name: impl Into<String>,
        frame: impl Into<String>,
        frequency_hz: f64,
        primitive: PeriodicDmp,
    ) -> Result<Self, MotionError> {
        let dof = |name: &str| MotionDof { name: name.into(), unit: "m".into() };
        Self::new(name, frame, vec![dof("x"), dof("y"), dof("z")], frequency_hz, primitive)
    }

    fn checked(self) -> Result<Self, MotionError> {
        if self.0.name.is_empty() {
            return Err(MotionError::Degenerate { what: "name", why: "it is empty" });
        }
        positive("frequency_hz", self.0.frequency_hz)?;
        size("dofs", self.0.primitive.dofs(), self.0.dofs.len())?;
        vector("workspace_centre", self.0.primitive.dofs(), &self.0.workspace_centre)?;
        Ok(self)
    }

    /// The same with the source from which it was learned, as text.
    #[must_use]
    pub fn with_learned_from(mut self, learned_from: impl Into<String>) -> Self {
        self.0.learned_from = learned_from.into();
        self
    }

    /// The same with the correction along the surface normal that keeps the force.
    #[must_use]
    pub fn with_surface(mut self, surface: Option<SurfaceCorrection>) -> Self {
        self.0.surface = surface;
        self
    }

    /// The same with the orientation of the hand, on the same phase.
    #[must_use]
    pub fn with_orientation(mut self, orientation: Option<PeriodicOrientationDmp>) -> Self {
        self.0.orientation = orientation;
        self
    }

    /// The next version: another primitive of the same degrees of freedom, with the source `learned_from`.
    ///
    /// # Errors
    /// When the degrees of freedom differ.
    pub fn next_version(
        &self,
        primitive: PeriodicDmp,
        learned_from: impl Into<String>,
    ) -> Result<Self, MotionError> {
        let mut next = self.clone();
        next.0.version = self.0.version.saturating_add(1);
        next.0.primitive = primitive;
        next.0.learned_from = learned_from.into();
        next.checked()
    }

    /// The name.
    pub fn name(&self) -> &str {
        &self.0.name
    }

    /// The version, from 1.
    pub fn version(&self) -> u32 {
        self.0.version
    }

    /// The degrees of freedom, in the primitive's order.
    pub fn dofs(&self) -> &[MotionDof] {
        &self.0.dofs
    }

    /// The frame of its positions.
    pub fn frame(&self) -> &str {
        &self.0.frame
    }

    /// Its frequency, Hz.
    pub fn frequency_hz(&self) -> f64 {
        self.0.frequency_hz
    }

    /// Its frequency, rad/s.
    pub fn omega(&self) -> f64 {
        std::f64::consts::TAU * self.0.frequency_hz
    }

    /// The primitive; clone it to run it.
    pub fn primitive(&self) -> &PeriodicDmp {
        &self.0.primitive
    }

    /// The centre of the workspace that the coach gave, one value per degree of freedom.
    pub fn workspace_centre(&self) -> &[f64] {
        &self.0.workspace_centre
    }

    /// The source from which it was learned.
    pub fn learned_from(&self) -> &str {
        &self.0.learned_from
    }

    /// The correction along the surface normal that keeps the force, if it was learned.
    pub fn surface(&self) -> Option<&SurfaceCorrection> {
        self.0.surface.as_ref()
    }

    /// The orientation of the hand, in [`frame`](Self::frame), if the motion has one; otherwise the executor
    /// chooses it.
    pub fn orientation(&self) -> Option<&PeriodicOrientationDmp> {
        self.0.orientation.as_ref()
    }
}

/// Changes a running primitive to another version of its motion. Weights, centre and amplitude approach those of
/// the other version exponentially and are set to them exactly after twelve time constants. Position and velocity
/// stay continuous.
#[derive(Debug, Clone)]
pub struct MotionSwitch {
    weights: Vec<f64>,
    centre: Vec<f64>,
    amplitude: f64,
    time_constant: f64,
    elapsed: f64,
}

impl MotionSwitch {
    /// A switch from `running` to `target` with `time_constant` s. If the target has other kernels or constants,
    /// its path is fitted with those of the running primitive.
    ///
    /// # Errors
    /// When the degrees of freedom differ or the time constant is not positive.
    pub fn new(running: &PeriodicDmp, target: &PeriodicDmp, time_constant: f64) -> Result<Self, MotionError> {
        positive("time_constant", time_constant)?;
        size("dofs", running.dofs(), target.dofs())?;
        let fitted =
            if running.config() == target.config() { target.clone() } else { refit(running, target)? };
        Ok(Self {
            weights: fitted.weights().to_vec(),
            centre: fitted.centre().to_vec(),
            amplitude: fitted.amplitude(),
            time_constant,
            elapsed: 0.0,
        })
    }

    /// Advances the switch of `running` by `dt` s. To be called before each step of `running`; returns whether the
    /// switch is complete. Does not allocate.
    ///
    /// # Errors
    /// When `dt` is not positive or the size of `running` has changed.
    pub fn step(&mut self, running: &mut PeriodicDmp, dt: f64) -> Result<bool, MotionError> {
        positive("dt", dt)?;
        size("weights", self.weights.len(), running.weights().len())?;
        size("dofs", self.centre.len(), running.dofs())?;
        self.elapsed += dt;
        let done = self.elapsed >= 12.0 * self.time_constant;
        let share = if done { 1.0 } else { 1.0 - libm::exp(-dt / self.time_constant) };
        approach(running.weights_mut(), &self.weights, share);
        approach(running.centre_mut(), &self.centre, share);
        let mut amplitude = [running.amplitude()];
        approach(&mut amplitude, &[self.amplitude], share);
        running.set_amplitude(amplitude[0])?;
        Ok(done)
    }
}

/// Moves the values by `share` of the way to the target; 1 sets them exactly.
fn approach(values: &mut [f64], target: &[f64], share: f64) {
    for (v, t) in values.iter_mut().zip(target) {
        *v = if share >= 1.0 { *t } else { *v + (t - *v) * share };
    }
}

/// `target`'s path with the kernels and constants of `running`.
fn refit(running: &PeriodicDmp, target: &PeriodicDmp) -> Result<PeriodicDmp, MotionError> {
    let mut fitted = PeriodicDmp::new(running.config().clone())?;
    let path = target.steady_path(8 * running.kernels().len())?;
    let (alpha, beta) = (target.config().alpha_z, target.config().beta_z);
    let mut forcing = vec![0.0; target.dofs()];
    let mut samples = Vec::with_capacity(path.len());
    for s in 0..path.len() {
        target.forcing_at(path.phase(s), &mut forcing);
        let (y, dy) = (path.y[s].clone(), path.dy[s].clone());
        let pull = |d: usize| alpha * (beta * (target.centre()[d] - y[d]) - dy[d]) + forcing[d];
        let ddy = (0..target.dofs()).map(pull).collect();
        samples.push(PhaseSample { phase: path.phase(s), y, dy, ddy });
    }
    fitted.learn_batch(&samples)?;
    Ok(fitted)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::PeriodicDmpConfig;

    fn primitive(kernels: usize, seed: usize) -> PeriodicDmp {
        let mut dmp =
            PeriodicDmp::new(PeriodicDmpConfig { kernels, ..PeriodicDmpConfig::with_dofs(3) }).unwrap();
        let weights: Vec<f64> =
            (0..3 * kernels).map(|i| libm::sin(i as f64 * 0.7 + seed as f64) * 0.8).collect();
        dmp.set_weights(&weights).unwrap();
        dmp.set_centre(&[0.3, 0.5, 1.0]).unwrap();
        dmp
    }

    #[test]
    fn a_motion_survives_saving() {
        let surface = SurfaceCorrection::new(vec![0.001; 36], 90.0, [0.0, 0.0, 1.0]).unwrap();
        let motion = Motion::in_space("wipe", "root", 0.5, primitive(25, 1))
            .unwrap()
            .with_learned_from("a demonstration")
            .with_surface(Some(surface));
        let text = serde_json::to_string(&motion).unwrap();
        let loaded: Motion = serde_json::from_str(&text).unwrap();
        // JSON numbers may differ in the last bit.
        let (a, b) =
            (loaded.primitive().steady_path(50).unwrap(), motion.primitive().steady_path(50).unwrap());
        assert!((0..50).all(|s| (0..3).all(|d| (a.y[s][d] - b.y[s][d]).abs() < 1e-12)));
        assert_eq!(loaded.surface(), motion.surface());
        assert!(loaded.orientation().is_none() && !text.contains("orientation"), "as it was stored before");
        let mut turning = PeriodicOrientationDmp::new(PeriodicDmpConfig::default()).unwrap();
        let tilt = |k: i32| {
            nalgebra::UnitQuaternion::from_euler_angles(0.2 * libm::sin(0.0628 * f64::from(k)), 0.1, 0.0)
        };
        turning.learn_period(&(0..100).map(tilt).collect::<Vec<_>>()).unwrap();
        let turning = motion.clone().with_orientation(Some(turning));
        let again: Motion = serde_json::from_value(serde_json::to_value(&turning).unwrap()).unwrap();
        let at = |m: &Motion| m.orientation().unwrap().steady_state(0.5).0;
        assert!(at(&again).angle_to(&at(&turning)) < 1e-9);
        let next = loaded.next_version(primitive(25, 2), "a push").unwrap();
        assert_eq!((next.version(), next.name(), next.learned_from()), (2, "wipe", "a push"));
    }

    #[test]
    fn a_broken_motion_is_refused_by_name() {
        let motion = Motion::in_space("wipe", "root", 0.5, primitive(25, 1)).unwrap();
        let good = serde_json::to_value(&motion).unwrap();
        let refuse = |path: &str, value: serde_json::Value, says: &str| {
            let mut bad = good.clone();
            *bad.pointer_mut(path).unwrap() = value;
            let error = serde_json::from_value::<Motion>(bad).unwrap_err().to_string();
            assert!(error.contains(says), "{path}: {error}");
        };
        refuse("/frequency_hz", 0.0.into(), "frequency_hz");
        refuse("/dofs", serde_json::json!([]), "dofs: 3 values needed, 0 given");
        refuse("/primitive/weights", serde_json::json!([1.0]), "weights: 75 values needed");
        refuse("/primitive/gain/3", (-1.0).into(), "gain");
        refuse("/primitive/config/kernels", 1.into(), "kernels");
        refuse("/workspace_centre", serde_json::json!([0.0]), "workspace_centre");
        refuse("/name", "".into(), "name");
    }

    #[test]
    fn a_switch_ends_on_the_other_path_without_a_jump() {
        for kernels in [25, 30] {
            let mut running = primitive(25, 1);
            let target = primitive(kernels, 5);
            running.start_on_path(0.0, 3.0).unwrap();
            let mut switch = MotionSwitch::new(&running, &target, 0.5).unwrap();
            let mut last = running.state().y.to_vec();
            let mut done = false;
            for _ in 0..7000 {
                done = switch.step(&mut running, 0.001).unwrap();
                let y = running.step(0.001, 3.0).unwrap().y;
                assert!((0..3).all(|d| (y[d] - last[d]).abs() < 2e-3));
                last.copy_from_slice(y);
            }
            assert!(done);
            let (a, b) = (running.steady_path(40).unwrap(), target.steady_path(40).unwrap());
            for s in 0..40 {
                assert!((a.y[s][0] - b.y[s][0]).abs() < if kernels == 25 { 1e-12 } else { 1e-3 });
            }
        }
    }
}

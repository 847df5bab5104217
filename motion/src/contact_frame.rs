//! The frame of a contact with a surface of unknown tilt: its outward normal and two tangents.
//!
//! At touchdown the direction of the force is the first guess; with friction that is only nearly the normal. While the tool
//! wipes, the places where it touched say more: a direction in which they are spread is no normal. So a line that was wiped
//! takes one direction from the guess, and an area both. Old places fade with the way that was wiped since.
//!
//! It knows no robot and no force controller; all vectors are in one frame.

use nalgebra::{Matrix3, Unit, Vector3};

use crate::error::{MotionError, positive, vector};

/// Way over which old places fade, m: some cycles of wiping.
const FADING: f64 = 0.6;
/// Way that has to be wiped before places count, m.
const LEAST_WAY: f64 = 0.08;
/// Standard deviation of places in a direction from which on that direction is in the surface, m: more than a tool sinks in.
const SPREAD: f64 = 0.012;
/// Time constant of the first guess, s, and the largest angle by which it may differ from the way in which the tool came, rad.
const GUESS_S: f64 = 0.1;
const GUESS_ANGLE: f64 = 0.26;
/// Largest turn of the normal, rad per m of way.
const TURN: f64 = 4.0;

/// Normal and tangents of a contact; see the module.
#[derive(Clone, Debug, PartialEq)]
pub struct ContactFrame {
    approach: Unit<Vector3<f64>>,
    normal: Unit<Vector3<f64>>,
    force: Vector3<f64>,
    last: Option<Vector3<f64>>,
    way: f64,
    weight: f64,
    mean: Vector3<f64>,
    scatter: Matrix3<f64>,
}

impl ContactFrame {
    /// A contact of which only the direction is known that leads away from the surface, as the tool came: any length.
    ///
    /// # Errors
    /// When it has no length or is not finite.
    pub fn new(outward: &Vector3<f64>) -> Result<Self, MotionError> {
        vector("outward", 3, outward.as_slice())?;
        let approach = Unit::try_new(*outward, 1e-9)
            .ok_or(MotionError::Degenerate { what: "outward", why: "it has no length" })?;
        Ok(Self {
            approach,
            normal: approach,
            force: Vector3::zeros(),
            last: None,
            way: 0.0,
            weight: 0.0,
            mean: Vector3::zeros(),
            scatter: Matrix3::zeros(),
        })
    }

    /// The outward normal.
    pub fn normal(&self) -> Unit<Vector3<f64>> {
        self.normal
    }

    /// Two perpendicular directions in the surface; the first one is as near to x as can be.
    pub fn tangents(&self) -> [Unit<Vector3<f64>>; 2] {
        let n = self.normal.into_inner();
        let near = if n.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
        let first = Unit::new_normalize(near - n * n.dot(&near));
        [first, Unit::new_normalize(n.cross(&first))]
    }

    /// The part of a force that presses, N: along the normal.
    pub fn pressing(&self, force: &Vector3<f64>) -> f64 {
        self.normal.dot(force)
    }

    /// The parts of a vector along the tangents.
    pub fn along(&self, v: &Vector3<f64>) -> [f64; 2] {
        self.tangents().map(|tangent| tangent.dot(v))
    }

    /// Takes the force (N) of `dt` s of the touchdown into account, before anything was wiped.
    ///
    /// # Errors
    /// When `dt` is not positive or the force is not finite; nothing is changed.
    pub fn touch(&mut self, dt: f64, force: &Vector3<f64>) -> Result<(), MotionError> {
        positive("dt", dt)?;
        vector("force", 3, force.as_slice())?;
        self.force += (force - self.force) * (1.0 - libm::exp(-dt / GUESS_S));
        let Some(guess) = Unit::try_new(self.force, 1.0).filter(|_| self.way == 0.0) else { return Ok(()) };
        let angle = self.approach.angle(&guess);
        let share = if angle > GUESS_ANGLE { GUESS_ANGLE / angle } else { 1.0 };
        // Opposite directions have no way between them; such a force is no guess.
        if angle < std::f64::consts::FRAC_PI_2 {
            self.normal = self.approach.slerp(&guess, share);
        }
        Ok(())
    }

    /// Takes a place (m) where the tool touches into account. Does not allocate.
    ///
    /// # Errors
    /// When the place is not finite; nothing is changed.
    pub fn wipe(&mut self, place: &Vector3<f64>) -> Result<(), MotionError> {
        vector("place", 3, place.as_slice())?;
        let step = self.last.replace(*place).map_or(0.0, |last| (place - last).norm());
        if step == 0.0 {
            return Ok(());
        }
        self.way += step;
        let kept = libm::exp(-step / FADING);
        let weight = kept * self.weight + step;
        let off = place - self.mean;
        self.scatter = kept * self.scatter + off * off.transpose() * (kept * self.weight * step / weight);
        self.mean += off * (step / weight);
        self.weight = weight;
        if self.way > LEAST_WAY {
            self.turn(step);
        }
        Ok(())
    }

    /// The tool has left the surface: the next place begins a new way.
    pub fn lift(&mut self) {
        self.last = None;
    }

    /// Turns the normal out of the directions in which the places are spread.
    fn turn(&mut self, step: f64) {
        let eigen = (self.scatter / self.weight).symmetric_eigen();
        let mut normal = self.approach.into_inner();
        let mut directions = 0;
        for (i, variance) in eigen.eigenvalues.iter().enumerate() {
            if *variance > SPREAD * SPREAD {
                let direction = eigen.eigenvectors.column(i);
                normal -= direction * direction.dot(&normal);
                directions += 1;
            }
        }
        // Spread in all directions, or along the way in which the tool came: no surface.
        let Some(found) = Unit::try_new(normal, 0.5).filter(|_| directions < 3) else { return };
        let angle = self.normal.angle(&found);
        if angle > 1e-9 {
            self.normal = self.normal.slerp(&found, (TURN * step / angle).min(1.0));
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::UnitQuaternion;

    use super::*;

    /// A surface that is tilted by these angles about x and y, rad.
    fn tilted(x: f64, y: f64) -> UnitQuaternion<f64> {
        UnitQuaternion::from_euler_angles(x, y, 0.0)
    }

    fn wiped(surface: &UnitQuaternion<f64>, sizes: [f64; 2], noise: f64) -> ContactFrame {
        let mut frame = ContactFrame::new(&Vector3::z()).unwrap();
        for k in 0..4000_u32 {
            let phase = f64::from(k) * 3e-3;
            let sink = noise * libm::sin(7.3 * phase);
            let place =
                Vector3::new(0.5 * sizes[0] * libm::cos(phase), 0.5 * sizes[1] * libm::sin(phase), sink);
            frame.wipe(&(surface * place + Vector3::new(0.3, 0.5, 1.0))).unwrap();
        }
        frame
    }

    #[test]
    fn an_area_that_was_wiped_gives_the_normal() {
        for (x, y) in [(0.21, 0.0), (0.0, -0.21), (0.15, 0.1), (0.0, 0.0)] {
            let surface = tilted(x, y);
            let frame = wiped(&surface, [0.1, 0.06], 0.001);
            let off = frame.normal().angle(&(surface * Vector3::z_axis()));
            assert!(off < 0.01, "{x} {y}: {off}");
            let [first, second] = frame.tangents();
            assert!(first.dot(&second).abs() < 1e-9 && first.dot(&frame.normal()).abs() < 1e-9);
            assert!(first.x > 0.95 && second.y > 0.95, "{first:?} {second:?}");
            let force = surface * Vector3::new(3.0, -1.0, 8.0);
            assert!((frame.pressing(&force) - 8.0).abs() < 0.05);
            let [a, b] = frame.along(&force);
            assert!((a - 3.0).abs() < 0.15 && (b + 1.0).abs() < 0.15, "{a} {b}");
        }
    }

    #[test]
    fn a_line_that_was_wiped_leaves_the_other_direction_as_it_was() {
        let frame = wiped(&tilted(0.2, 0.15), [0.1, 0.0], 0.0005);
        // The line is along the surface's x: the tilt about y is found, that about x is not.
        let line = tilted(0.2, 0.15) * Vector3::x();
        assert!(frame.normal().dot(&line).abs() < 0.01);
        assert!(frame.normal().y.abs() < 0.01, "{:?}", frame.normal());
    }

    #[test]
    fn the_force_at_touchdown_is_the_first_guess_and_is_bounded() {
        let touched = |force: Vector3<f64>| {
            let mut frame = ContactFrame::new(&Vector3::z()).unwrap();
            for _ in 0..1000 {
                frame.touch(1e-3, &force).unwrap();
            }
            frame.normal()
        };
        let normal = tilted(0.1, 0.0) * Vector3::z();
        assert!(touched(normal * 8.0).angle(&Unit::new_normalize(normal)) < 1e-3);
        assert!((touched(Vector3::new(8.0, 0.0, 2.0)).angle(&Vector3::z_axis()) - GUESS_ANGLE).abs() < 1e-6);
        assert_eq!(touched(Vector3::new(0.0, 0.0, -8.0)), Vector3::z_axis());
        assert_eq!(touched(Vector3::new(0.3, 0.0, 0.2)), Vector3::z_axis(), "less than a newton is noise");
    }

    #[test]
    fn what_is_no_number_is_refused_and_changes_nothing() {
        let mut frame = wiped(&tilted(0.1, 0.1), [0.1, 0.06], 0.001);
        let before = frame.clone();
        let nan = Vector3::new(0.0, f64::NAN, 0.0);
        assert!(frame.wipe(&nan).is_err() && frame.touch(1e-3, &nan).is_err());
        assert!(frame.touch(0.0, &Vector3::z()).is_err());
        assert_eq!(frame, before);
        assert!(ContactFrame::new(&Vector3::zeros()).is_err() && ContactFrame::new(&nan).is_err());
    }
}

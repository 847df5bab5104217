//! The soft grip of a hand on a body with handles: springs between the hand and the body, from where it was when the grip began.
//!
//! It is what the elastic fingers of a hand are. The pads' contacts close around the handle without friction; what keeps the handle in
//! its place between them are these springs, which the [`grip`](super::grip) ends when they carry more than the pads' friction does.
//! So several hands can hold one body, and what they do against each other bends their grips.

use nalgebra::{Isometry3, Point3, Vector3};

use super::pad::{Moving, PadReaction};

/// Stiffness of the grip, N/m and N m/rad.
const STIFFNESS: [f64; 2] = [8000.0, 20.0];
/// Damping, N s/m and N m s/rad: a fifth of the critical one of a kilogramme that is 0.3 m wide.
const DAMPING: [f64; 2] = [36.0, 0.25];

/// A grip.
#[derive(Clone, Debug)]
pub(super) struct SoftGrip {
    /// The body, by its index.
    pub(super) body: usize,
    tcp_from_body: Isometry3<f64>,
    /// The middle of the grip, TCP frame and body's frame.
    pub(super) at: Point3<f64>,
    body_at: Point3<f64>,
    /// Force of the body on the hand and its torque about the TCP, in the last step.
    pub(super) reaction: PadReaction,
    /// The torque of the hand on the body about the middle of the grip, N m.
    pub(super) moment: Vector3<f64>,
}

impl SoftGrip {
    /// Grips a body where it is, about a point of the TCP's frame.
    pub(super) fn new(body: usize, at: Point3<f64>, tcp: &Isometry3<f64>, pose: &Isometry3<f64>) -> Self {
        let tcp_from_body = tcp.inverse() * pose;
        let body_at = tcp_from_body.inverse() * at;
        let (reaction, moment) = (PadReaction::default(), Vector3::zeros());
        Self { body, tcp_from_body, at, body_at, reaction, moment }
    }

    /// What it does in this step.
    pub(super) fn step(&mut self, tcp: &Moving, body: &Moving) {
        let [held, grip] = [body.pose * self.body_at, tcp.pose * self.at];
        let off = held - grip;
        let slip = body.velocity_at(&held) - tcp.velocity_at(&grip);
        let force = off * STIFFNESS[0] + slip * DAMPING[0];
        let wanted = tcp.pose.rotation * self.tcp_from_body.rotation;
        let turned = (body.pose.rotation * wanted.inverse()).scaled_axis();
        let turning = turned * STIFFNESS[1] + (body.angular - tcp.angular) * DAMPING[1];
        let lever = grip.coords - tcp.pose.translation.vector;
        self.moment = -turning;
        self.reaction =
            PadReaction { force, torque: turning + lever.cross(&force), normal: 0.0, slipping: 0 };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at_rest(pose: Isometry3<f64>) -> Moving {
        Moving { pose, linear: Vector3::zeros(), angular: Vector3::zeros() }
    }

    #[test]
    fn it_pulls_back_what_is_bent_and_turned() {
        let (tcp, body) = (Isometry3::translation(0.3, 0.5, 1.1), Isometry3::translation(0.0, 0.5, 1.0));
        let mut grip = SoftGrip::new(0, Point3::new(0.0, 0.0, -0.08), &tcp, &body);
        grip.step(&at_rest(tcp), &at_rest(body));
        assert!(grip.reaction.force.norm() < 1e-9 && grip.reaction.torque.norm() < 1e-9);
        let moved = Isometry3::translation(0.0, 0.0, -0.002) * body;
        grip.step(&at_rest(tcp), &at_rest(moved));
        assert!((grip.reaction.force + Vector3::z() * 16.0).norm() < 1e-9, "{:?}", grip.reaction);
        // A turn about the middle of the grip is torque alone.
        let middle = (tcp * grip.at).coords;
        let about = |angle: f64| {
            Isometry3::translation(middle.x, middle.y, middle.z)
                * Isometry3::rotation(Vector3::x() * angle)
                * Isometry3::translation(-middle.x, -middle.y, -middle.z)
        };
        grip.step(&at_rest(tcp), &at_rest(about(0.01) * body));
        assert!(grip.reaction.force.norm() < 1e-9, "{:?}", grip.reaction);
        assert!((grip.moment + Vector3::x() * 0.2).norm() < 1e-9, "{:?}", grip.moment);
    }
}

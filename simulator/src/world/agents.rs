//! What a world file says of other agents' eyes, and of boards that stand in somebody's view.
//!
//! The agents themselves are processes of their own; of them the simulator has only the cameras.

use armarium_source::yaml::Node;
use armarium_source::{Findings, Rule, form};
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};

use super::{COLOR, check_agent_name, within};

form! {
    /// Another agent who looks at the scene with a stereo pair like the robot's.
    pub struct AgentSpec: "an agent", check Self::has_a_name {
        /// Its name, by which other agents call it.
        pub name: String, Rule::NAME;
        /// The middle between its eyes, m.
        pub at: [f64; 3] = [0.0, 1.4, 1.5], within(5.0);
        /// What it looks at, m; the middle of the table where nothing is said.
        pub looks_at: [f64; 3] = [0.25, 0.60, 0.95], within(5.0);
        /// Frames a second.
        pub rate: f64 = 5.0, Rule::number("Hz", 1.0, 120.0);
        /// The chart that its process runs, a file beside the world's; without one, the process is started by hand.
        #[serde(skip_serializing_if = "Option::is_none")]
        pub runs: Option<String> = None, Rule::NAME;
    }
}

form! {
    /// An opaque board that hides what is behind it from all cameras. Nothing collides with it.
    pub struct CoverSpec: "a cover" {
        /// Its middle, m.
        pub at: [f64; 3] = [0.0, 0.4, 1.2], within(5.0);
        /// Width, depth and height, m.
        pub size: [f64; 3] = [0.4, 0.01, 0.3], Rule::number("m", 0.001, 3.0);
        /// Rotation about the vertical, degrees.
        pub yaw_deg: f64 = 0.0, Rule::degrees(361.0, "yaw");
        /// Colour, RGB.
        pub color: [u8; 3] = [110, 112, 118], COLOR;
    }
}

impl CoverSpec {
    /// Its pose in the root frame.
    pub fn root_from_cover(&self) -> Isometry3<f64> {
        Isometry3::new(Vector3::from(self.at), Vector3::z() * self.yaw_deg.to_radians())
    }
}

impl AgentSpec {
    fn has_a_name(&self, node: &Node, findings: &mut Findings) {
        check_agent_name(&self.name, node, findings);
    }

    /// The agent's own root frame in the robot's: on the floor below its eyes, y towards what it looks at, z up.
    pub fn root_from_agent(&self) -> Isometry3<f64> {
        let ahead = self.ahead();
        let yaw = if ahead.xy().norm() < 1e-6 { 0.0 } else { libm::atan2(-ahead.x, ahead.y) };
        Isometry3::new(Vector3::new(self.at[0], self.at[1], 0.0), Vector3::z() * yaw)
    }

    /// Its left camera in the robot's root frame (z forward, x right, y down), with its eyes `baseline` m apart and a
    /// level horizon.
    pub fn root_from_left(&self, baseline: f64) -> Isometry3<f64> {
        let ahead = self.ahead().normalize();
        let right = ahead.cross(&Vector3::z());
        let right = right.try_normalize(1e-6).unwrap_or_else(Vector3::x);
        let axes = Matrix3::from_columns(&[right, ahead.cross(&right), ahead]);
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
        let left = Point3::from(self.at) - right * (baseline / 2.0);
        Isometry3::from_parts(left.into(), rotation)
    }

    fn ahead(&self) -> Vector3<f64> {
        Vector3::from(self.looks_at) - Vector3::from(self.at)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_eyes_look_where_they_should_and_the_root_stands_below_them() {
        let agent = AgentSpec {
            name: "alice".into(),
            at: [0.3, 1.4, 1.5],
            looks_at: [0.4, 0.5, 0.95],
            rate: 5.0,
            runs: None,
        };
        let left = agent.root_from_left(0.1);
        let middle = left * Point3::new(0.05, 0.0, 0.0);
        assert!((middle.coords - Vector3::from(agent.at)).norm() < 1e-12);
        let distance = (Vector3::from(agent.looks_at) - Vector3::from(agent.at)).norm();
        let seen = left * Point3::new(0.05, 0.0, distance);
        assert!((seen.coords - Vector3::from(agent.looks_at)).norm() < 1e-12);
        // A level horizon: the image's right is horizontal, its downward side goes down.
        assert!((left * Vector3::x()).z.abs() < 1e-12 && (left * Vector3::y()).z < 0.0);
        let root = agent.root_from_agent();
        let target = root.inverse() * Point3::from(agent.looks_at);
        assert!(target.x.abs() < 1e-12 && target.y > 0.9 && (target.z - 0.95).abs() < 1e-12);
        // Straight down there is no direction to turn to.
        let above = AgentSpec { looks_at: [0.3, 1.4, 0.9], ..agent };
        assert!((above.root_from_left(0.1) * Vector3::z() + Vector3::z()).norm() < 1e-12);
        assert!(above.root_from_agent().rotation.angle() < 1e-12);
    }
}

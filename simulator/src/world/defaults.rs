//! The default world: the kitchen in which the arm has margin. What a world file does not say is as here.

use super::{
    Arm, Bump, CameraSpec, CoachSpec, CoachingAction, CoachingStep, Demonstration, Disturbance, Faults,
    Gesture, Milestone, MountingError, NoiseSpec, ObjectSpec, Push, RobotModel, RobotSpec, Shape, Show,
    Swipe, TableSpec, ToolSpec, World,
};

impl Default for World {
    fn default() -> Self {
        Self {
            name: "kitchen".into(),
            robot: RobotSpec::default(),
            camera: CameraSpec::default(),
            table: TableSpec::default(),
            objects: vec![ObjectSpec::default()],
            coach: CoachSpec::default(),
            faults: Faults::default(),
            disturbances: Vec::new(),
            agents: Vec::new(),
            covers: Vec::new(),
        }
    }
}

impl Default for RobotSpec {
    fn default() -> Self {
        Self { name: "local".into(), model: RobotModel::Armar3, arm: Arm::Right, noise: NoiseSpec::default() }
    }
}

impl Default for NoiseSpec {
    fn default() -> Self {
        Self { wrench: 0.3, wrench_bias: 1.0, wrench_drift: 0.01, joint: 0.0002 }
    }
}

impl Default for CameraSpec {
    fn default() -> Self {
        Self {
            width: 640,
            height: 480,
            rate: 15.0,
            focal: 515.0,
            baseline: 0.093,
            noise: 2.0,
            mounting_error: MountingError::default(),
        }
    }
}

impl Default for TableSpec {
    fn default() -> Self {
        Self {
            height: 0.95,
            center: [0.25, 0.60],
            size: [1.0, 0.7],
            tilt_deg: [1.0, -1.5],
            bumps: vec![Bump { at: [0.28, 0.55], height: 0.004, radius: 0.05 }],
            friction: 0.5,
            color: [150, 115, 80],
        }
    }
}

impl Default for ObjectSpec {
    fn default() -> Self {
        Self {
            name: "sponge".into(),
            at: [0.35, 0.50],
            yaw_deg: 20.0,
            size: [0.10, 0.07, 0.04],
            mass: 0.15,
            stiffness: 2000.0,
            color: [240, 210, 40],
        }
    }
}

impl Default for CoachSpec {
    fn default() -> Self {
        Self {
            tool: ToolSpec::default(),
            demonstration: Some(Demonstration::default()),
            coaching: default_coaching(),
            ends: 95.0,
        }
    }
}

impl Default for ToolSpec {
    fn default() -> Self {
        Self { color: [40, 170, 60] }
    }
}

impl Default for Demonstration {
    fn default() -> Self {
        Self {
            shape: Shape::Ellipse,
            size: [0.10, 0.06],
            frequency: 0.5,
            swipe: Swipe::default(),
            height: 0.20,
            periods: 15,
            jitter: 0.02,
        }
    }
}

impl Default for Swipe {
    fn default() -> Self {
        Self { from: [0.20, 0.48], to: [0.36, 0.58] }
    }
}

impl Default for Push {
    fn default() -> Self {
        Self { phase: 0.25, arc: 0.2, force: [0.0, 12.0, 0.0], cycles: 6 }
    }
}

impl Default for Disturbance {
    fn default() -> Self {
        Self {
            after: Milestone::Wiping,
            at: 1.0,
            knock: "sponge".into(),
            force: [90.0, 0.0, 0.0],
            duration: 0.1,
        }
    }
}

/// The default coaching: a push outwards, a fist that pulls, two fingers that push back, one finger that moves
/// the whole, and the open hand that announces more.
fn default_coaching() -> Vec<CoachingStep> {
    let show = |at, gesture, phase, offset, duration, direction| CoachingStep {
        at,
        action: CoachingAction::Show(Show { gesture, phase, offset, duration, direction }),
    };
    vec![
        CoachingStep { at: 10.0, action: CoachingAction::Push { push: Push::default() } },
        show(30.0, Gesture::Fist, 0.75, [0.0, -0.12, 0.0], 12.0, None),
        show(50.0, Gesture::PointTwo, 0.0, [0.10, 0.0, 0.0], 12.0, None),
        show(70.0, Gesture::PointOne, 0.5, [0.0, 0.12, 0.05], 8.0, Some([0.0, 0.04, 0.0])),
        show(85.0, Gesture::OpenHand, 0.25, [0.0, 0.15, 0.05], 3.0, None),
    ]
}

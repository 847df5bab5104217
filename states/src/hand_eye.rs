//! The hand-eye correction: what the cameras see, moved to where the arm says it is.
//!
//! The head's kinematics give a believed camera pose; a wrong mounting of some degrees and millimetres moves
//! everything that is seen by centimetres. The robot finds the difference by looking at the marker on its own hand,
//! and keeps it in memory, where every skill that uses the cameras finds it.

use std::collections::BTreeMap;

use armarium_memoryx::{Commit, EntityId, Memory, MemoryError};
use armarium_runtime::skill::Failure;
use nalgebra::Isometry3;

use crate::inputs::{as_pose, pose_value};
use crate::motions::failed;

const SEGMENT: &str = "AgentInstances";
const ENTITY: &str = "hand_eye";

/// `true_from_believed`: takes points in the root frame as the cameras report them to the root frame of the arm.
#[derive(Clone, Copy, Debug)]
pub(crate) struct HandEye {
    true_from_believed: Isometry3<f64>,
}

impl HandEye {
    /// The correction that maps one to the other.
    pub(crate) fn new(true_from_believed: Isometry3<f64>) -> Self {
        Self { true_from_believed }
    }

    /// The newest correction in memory; none has been found yet: the identity.
    pub(crate) async fn load(memory: &dyn Memory, agent: &str) -> Result<Self, Failure> {
        match memory.latest(&address(agent)?).await {
            Ok(snapshot) => {
                let value = snapshot.attribute("true_from_believed");
                let pose = value.and_then(as_pose);
                let pose =
                    pose.ok_or_else(|| Failure::new("the hand-eye correction in memory is no pose"))?;
                Ok(Self::new(pose))
            }
            Err(MemoryError::NotFound { .. }) => Ok(Self::new(Isometry3::identity())),
            Err(error) => Err(failed(error)),
        }
    }

    /// Puts the correction into memory.
    pub(crate) async fn store(
        &self,
        memory: &dyn Memory,
        agent: &str,
        residual_m: f64,
        stamp_ns: u64,
    ) -> Result<(), Failure> {
        let attributes = BTreeMap::from([
            ("true_from_believed".to_owned(), pose_value(&self.true_from_believed)),
            ("residual".to_owned(), residual_m.into()),
        ]);
        let commit = Commit::new(address(agent)?, stamp_ns, attributes);
        memory.commit(vec![commit]).await.map_err(failed)?;
        Ok(())
    }

    /// `root_from_camera` of the arm's root frame, from the believed one.
    pub(crate) fn camera(&self, believed: &Isometry3<f64>) -> Isometry3<f64> {
        self.true_from_believed * believed
    }

    /// A pose that the cameras reported, in the arm's root frame.
    pub(crate) fn pose(&self, believed: &Isometry3<f64>) -> Isometry3<f64> {
        self.true_from_believed * believed
    }
}

fn address(agent: &str) -> Result<EntityId, Failure> {
    EntityId::new(SEGMENT, agent, ENTITY).map_err(failed)
}

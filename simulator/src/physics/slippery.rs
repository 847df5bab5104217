//! Bodies that are slippery for a while.

use rapier3d_f64::prelude as rapier;
use rapier3d_f64::prelude::ColliderHandle;

use super::plant::{External, Object, Plant};

/// A body that is slippery.
#[derive(Clone, Debug)]
pub(super) struct Slippery {
    /// Its friction, where it touches something rougher.
    pub(super) friction: f64,
    /// The friction of its colliders otherwise, in their order.
    rough: Vec<(f64, rapier::CoefficientCombineRule)>,
}

impl Plant {
    /// Gives the bodies that are slippery in this step their friction, and those that are no more the one that they had.
    pub(super) fn make_slippery(&mut self, external: &External) {
        for (body, object) in self.objects.iter_mut().enumerate() {
            let friction = external.slippery.iter().find(|(slippery, _)| *slippery == body).map(|(_, f)| *f);
            if friction == object.slippery.as_ref().map(|slippery| slippery.friction) {
                continue;
            }
            let colliders = &mut self.physics.colliders;
            if let Some(Slippery { rough, .. }) = object.slippery.take() {
                object.colliders.iter().zip(rough).for_each(|(handle, own)| rub(colliders, *handle, own));
            }
            object.slippery = friction.map(|friction| Slippery::with(friction, object, colliders));
        }
    }
}

impl Slippery {
    /// Makes an object slippery.
    fn with(friction: f64, object: &Object, colliders: &mut rapier::ColliderSet) -> Self {
        let slip = |handle: &ColliderHandle| {
            let own = (colliders[*handle].friction(), colliders[*handle].friction_combine_rule());
            rub(colliders, *handle, (friction.min(own.0), rapier::CoefficientCombineRule::Min));
            own
        };
        Self { friction, rough: object.colliders.iter().map(slip).collect() }
    }
}

fn rub(
    colliders: &mut rapier::ColliderSet,
    handle: ColliderHandle,
    (friction, rule): (f64, rapier::CoefficientCombineRule),
) {
    colliders[handle].set_friction(friction);
    colliders[handle].set_friction_combine_rule(rule);
}

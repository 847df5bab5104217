//! What skills read of prior knowledge: colour, size and mass of object classes.

use armarium_memoryx::{Memory, ObjectClass};
use armarium_runtime::skill::Failure;

use crate::motions::failed;

/// The object class of that name.
pub(crate) async fn object_class(memory: &dyn Memory, name: &str) -> Result<ObjectClass, Failure> {
    let known = memory.segment("ObjectClasses").await.map_err(failed)?;
    let found = known.iter().find(|s| s.id.entity() == name).ok_or_else(|| {
        let names: Vec<&str> = known.iter().map(|s| s.id.entity()).collect();
        Failure::new(format!("prior knowledge has no object `{name}`; it has {}", names.join(", ")))
    })?;
    ObjectClass::from_snapshot(found).map_err(failed)
}

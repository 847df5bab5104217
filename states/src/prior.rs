//! Prior knowledge for skills: colour, size and mass of object classes.

use armarium_knowledge::ObjectClass;
use armarium_memoryx::{Memory, Snapshot};
use armarium_runtime::skill::Failure;
use armarium_values::Value;

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

/// The class of an object in memory. It is an attribute, because an object's own name may differ from it.
pub(crate) async fn class_of(memory: &dyn Memory, object: &Snapshot) -> Result<ObjectClass, Failure> {
    let class = object.attribute("class").and_then(Value::as_str);
    let unknown = || Failure::new(format!("memory does not know what `{}` is", object.id));
    object_class(memory, class.ok_or_else(unknown)?).await
}

#[cfg(test)]
mod tests {
    use armarium_knowledge::PriorKnowledge;
    use armarium_memoryx::{Commit, EntityId, tokio_clock};

    use super::*;

    #[tokio::test(start_paused = true)]
    async fn an_object_is_of_its_class_whatever_its_name_is() {
        let memory = armarium_knowledge::working_memory(tokio_clock());
        let mut prior = PriorKnowledge::new();
        prior.add(ObjectClass::new("sponge", [250, 200, 20], [0.1, 0.06, 0.03])).unwrap();
        prior.put_into(&memory).unwrap();
        let id = |name: &str| EntityId::new("ObjectInstances", "bob", name).unwrap();
        let object = |name: &str, class: &str| Commit::new(id(name), 0, [("class", Value::from(class))]);
        let objects = [("the yellow one", "sponge"), ("sponge", "brick")];
        memory.commit(objects.map(|(name, class)| object(name, class)).to_vec()).await.unwrap();
        let class = async |name: &str| class_of(&memory, &memory.latest(&id(name)).await.unwrap()).await;
        assert_eq!(class("the yellow one").await.unwrap().color, [250, 200, 20]);
        let reason = class("sponge").await.unwrap_err().reason;
        assert_eq!(reason, "prior knowledge has no object `brick`; it has sponge");
    }
}

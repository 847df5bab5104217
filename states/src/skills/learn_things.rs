//! `LearnThings`: what has moved as one thing becomes a class of things, so that it is known again.

use armarium_knowledge::ObjectClass;
use armarium_memoryx::{Commit, EntityId};
use armarium_runtime::skill::{Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Value};
use armarium_visionx::segmentation::Appearance;

use crate::equipment::{self, Equipment};
use crate::hypotheses::{LEARNED, hypotheses, learned, name_class, newest};
use crate::motions::failed;

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new(
        "LearnThings",
        "Makes a class in `ObjectClasses/learned` of each thing that SegmentScene has told apart and that moved as one, unless it is known already.",
    )
    .output("learned", Type::list(Type::String), "The names of the new classes.");
    equipment::skill(equipment, manifest, run)
}

async fn run(equipment: Equipment, _: SkillContext) -> SkillResult {
    let before = learned(&equipment).await?;
    let mut number = newest(before.iter().map(|(name, _)| name.as_str()));
    let mut names = Vec::new();
    for known in hypotheses(&equipment).await? {
        if !known.hypothesis.confirmed || known.class.is_some() {
            continue;
        }
        number += 1;
        let name = format!("learned_{number}");
        let mut class = ObjectClass::new(&name, known.hypothesis.color(), known.size);
        class.description = "learned by pushing".into();
        let mut attributes = class.attributes();
        let numbers = Appearance::of(&known.hypothesis).numbers().into_iter().map(Value::Float).collect();
        attributes.insert("appearance".into(), Value::List(numbers));
        attributes.insert("points".into(), Value::Bytes(known.hypothesis.packed()));
        let id = EntityId::new("ObjectClasses", LEARNED, &name).map_err(failed)?;
        equipment.memory.commit(vec![Commit::new(id, known.seen_ns, attributes)]).await.map_err(failed)?;
        name_class(&equipment, &known, &name).await?;
        names.push(Value::from(name));
    }
    Ok(Outcome::success().with("learned", Value::List(names)))
}

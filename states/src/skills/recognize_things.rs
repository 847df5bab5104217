//! `RecognizeThings`: of what was told apart on a table, finds what was learned before, and puts it into memory as a thing of its class.

use armarium_memoryx::{Commit, EntityId};
use armarium_runtime::skill::{Outcome, Skill, SkillContext, SkillManifest, SkillResult};
use armarium_values::{Type, Value};
use armarium_visionx::segmentation::{Appearance, most_alike};

use crate::equipment::{self, Equipment};
use crate::hypotheses::{hypotheses, learned, name_class};
use crate::inputs::pose_value;
use crate::motions::failed;

pub(crate) fn skill(equipment: &Equipment) -> impl Skill + use<> {
    let manifest = SkillManifest::new(
        "RecognizeThings",
        "Finds among the things that SegmentScene has told apart those whose class LearnThings has learned, and puts them into memory as such.",
    )
    .output("recognized", Type::list(Type::String), "The names of their classes.");
    equipment::skill(equipment, manifest, run)
}

async fn run(equipment: Equipment, _: SkillContext) -> SkillResult {
    let (names, looks): (Vec<String>, Vec<Appearance>) = learned(&equipment).await?.into_iter().unzip();
    let mut recognized = Vec::new();
    for known in hypotheses(&equipment).await? {
        let Some(class) = most_alike(&Appearance::of(&known.hypothesis), &looks) else { continue };
        let name = &names[class];
        name_class(&equipment, &known, name).await?;
        let id = EntityId::new("ObjectInstances", &equipment.agent, name).map_err(failed)?;
        let attributes = [("class", Value::from(name.as_str())), ("pose", pose_value(&known.pose))];
        equipment.memory.commit(vec![Commit::new(id, known.seen_ns, attributes)]).await.map_err(failed)?;
        recognized.push(Value::from(name.as_str()));
    }
    Ok(Outcome::success().with("recognized", Value::List(recognized)))
}

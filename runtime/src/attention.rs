//! What the skills that run now need to know the place of.
//!
//! A skill declares it in its manifest ([`SkillManifest::attends`](crate::skill::SkillManifest::attends)); while the skill runs, whoever
//! turns the eyes reads it here. This room knows neither what the values name nor where that is.

use std::collections::BTreeMap;
use std::sync::Arc;

use armarium_values::Value;
use parking_lot::Mutex;

/// What a skill needs to know the place of, as its manifest declares it.
#[derive(Clone, Debug, PartialEq)]
pub struct Attends {
    /// The input whose value names it, or a pattern of memory.
    pub what: Attended,
    /// An error of its place that the skill bears, m.
    pub within: f64,
    /// How much it counts beside what else is needed; 1 is usual.
    pub weight: f64,
}

/// What names a thing that a skill needs to know the place of.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Attended {
    /// The value of the input of this name.
    Input(String),
    /// A pattern of memory, such as `HumanHands/*/*`.
    Pattern(String),
}

/// A need of a skill that runs.
#[derive(Clone, Debug, PartialEq)]
pub struct Need {
    /// Path of the state that runs the skill.
    pub state: String,
    /// The value that names the thing: a reference into memory, a class, a place, or a pattern of memory as text.
    pub thing: Value,
    /// As in [`Attends`].
    pub within: f64,
    /// As in [`Attends`].
    pub weight: f64,
}

/// The needs of all skills that run; clones share them.
#[derive(Clone, Debug, Default)]
pub struct Attention {
    by_skill: Arc<Mutex<BTreeMap<u64, Vec<Need>>>>,
}

/// The needs of one skill, until it is dropped.
#[derive(Debug)]
pub(crate) struct Attending {
    attention: Attention,
    key: u64,
}

impl Drop for Attending {
    fn drop(&mut self) {
        self.attention.by_skill.lock().remove(&self.key);
    }
}

impl Attention {
    /// What is needed now, that of the skill that began first before the others.
    pub fn needs(&self) -> Vec<Need> {
        self.by_skill.lock().values().flatten().cloned().collect()
    }

    /// The needs of a skill that begins.
    pub(crate) fn attend(
        &self,
        state: &str,
        attends: &[Attends],
        inputs: &BTreeMap<String, Value>,
    ) -> Attending {
        let need = |attends: &Attends| {
            let thing = match &attends.what {
                Attended::Input(name) => inputs.get(name)?.clone(),
                Attended::Pattern(pattern) => Value::from(pattern.as_str()),
            };
            Some(Need { state: state.to_owned(), thing, within: attends.within, weight: attends.weight })
        };
        let needs: Vec<Need> = attends.iter().filter_map(need).collect();
        let mut by_skill = self.by_skill.lock();
        let key = by_skill.last_key_value().map_or(0, |(last, _)| last + 1);
        by_skill.insert(key, needs);
        Attending { attention: self.clone(), key }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_need_lasts_as_long_as_its_skill() {
        let attention = Attention::default();
        let attends = [
            Attends { what: Attended::Input("object".into()), within: 0.01, weight: 1.0 },
            Attends { what: Attended::Pattern("HumanHands/*/*".into()), within: 0.05, weight: 0.5 },
            Attends { what: Attended::Input("missing".into()), within: 0.05, weight: 0.5 },
        ];
        let inputs = BTreeMap::from([("object".to_owned(), Value::from("cup"))]);
        let first = attention.attend("Grasp", &attends, &inputs);
        let second = attention.attend("Place", &attends[..1], &inputs);
        let named = |needs: Vec<Need>| -> Vec<(String, Value)> {
            needs.into_iter().map(|need| (need.state, need.thing)).collect()
        };
        let cup = |state: &str| (state.to_owned(), Value::from("cup"));
        let hands = ("Grasp".to_owned(), Value::from("HumanHands/*/*"));
        assert_eq!(named(attention.needs()), [cup("Grasp"), hands, cup("Place")]);
        drop(first);
        assert_eq!(named(attention.clone().needs()), [cup("Place")]);
        drop(second);
        assert!(attention.needs().is_empty());
    }
}

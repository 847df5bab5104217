//! What a chart may name: the skills of this program, and the channels that its observers publish.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;

use armarium_values::Type;

use crate::skill::{Skill, SkillManifest};

/// The skills of a program, by name.
#[derive(Clone, Default)]
pub struct Registry {
    skills: BTreeMap<String, Known>,
    /// What other agents offer, by `agent/Name`; or why it cannot be used.
    remote: BTreeMap<String, Result<Known, Refused>>,
}

/// Why something of another agent cannot be used.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Refused {
    /// What is wrong.
    pub reason: String,
    /// What can be done about it.
    pub help: Option<String>,
}

/// A skill and what it declares.
type Known = (Arc<dyn Skill>, Arc<SkillManifest>);

impl fmt::Debug for Registry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.skills.keys()).finish()
    }
}

impl Registry {
    /// A registry without skills.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a skill under the name of its manifest; one of the same name is replaced.
    pub fn add(&mut self, skill: Arc<dyn Skill>) {
        let manifest = Arc::new(skill.manifest());
        self.skills.insert(manifest.name.clone(), (skill, manifest));
    }

    /// The skill of that name.
    #[must_use]
    pub fn get(&self, name: &str) -> Option<&Arc<dyn Skill>> {
        let remote = || self.remote.get(name)?.as_ref().ok();
        self.skills.get(name).or_else(remote).map(|(skill, _)| skill)
    }

    /// What the skill of that name declares.
    #[must_use]
    pub fn manifest(&self, name: &str) -> Option<&Arc<SkillManifest>> {
        let remote = || self.remote.get(name)?.as_ref().ok();
        self.skills.get(name).or_else(remote).map(|(_, manifest)| manifest)
    }

    /// Adds what another agent offers, under the name of its manifest, `agent/Name`.
    pub fn add_remote(&mut self, skill: Arc<dyn Skill>) {
        let manifest = Arc::new(skill.manifest());
        self.remote.insert(manifest.name.clone(), Ok((skill, manifest)));
    }

    /// Notes that what charts call `agent/Name` cannot be used, and why.
    pub fn refuse_remote(&mut self, name: &str, refused: Refused) {
        self.remote.insert(name.to_owned(), Err(refused));
    }

    /// What is known of `agent/Name`: what it declares, or why it cannot be used; `None` when nobody has asked.
    pub(crate) fn remote(&self, name: &str) -> Option<Result<&Arc<SkillManifest>, &Refused>> {
        Some(self.remote.get(name)?.as_ref().map(|(_, manifest)| manifest))
    }

    /// All manifests, ordered by name.
    pub fn manifests(&self) -> impl Iterator<Item = &SkillManifest> {
        self.skills.values().map(|(_, manifest)| &**manifest)
    }
}

impl FromIterator<Arc<dyn Skill>> for Registry {
    fn from_iter<I: IntoIterator<Item = Arc<dyn Skill>>>(skills: I) -> Self {
        let mut registry = Self::new();
        skills.into_iter().for_each(|skill| registry.add(skill));
        registry
    }
}

/// The channels that observers publish, with the type of their value (usually a record of named fields).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ChannelSchema {
    channels: BTreeMap<String, Type>,
}

impl ChannelSchema {
    /// A schema without channels.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// The same schema with one more channel, for instance
    /// `.with("hand", Type::record([("gesture", Type::String)]))`.
    #[must_use]
    pub fn with(mut self, name: &str, ty: Type) -> Self {
        self.channels.insert(name.to_owned(), ty);
        self
    }

    /// The type of a channel's value.
    #[must_use]
    pub fn get(&self, name: &str) -> Option<&Type> {
        self.channels.get(name)
    }

    /// The names of all channels.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.channels.keys().map(String::as_str)
    }
}

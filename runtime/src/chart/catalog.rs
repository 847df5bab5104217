//! What a chart may name: the skills of this program, and the channels that are published.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::path::Path;
use std::sync::Arc;

use armarium_source::listed;
use armarium_values::Type;

use crate::skill::{NameKind, Parameter, Skill, SkillManifest};

/// The skills of a program, by name.
#[derive(Clone, Default)]
pub struct Registry {
    skills: BTreeMap<String, RegisteredSkill>,
    /// The names of today, by those that charts used before.
    former: BTreeMap<String, String>,
    /// What other agents offer, by `agent/Name`; or why it cannot be used.
    remote: BTreeMap<String, Result<RegisteredSkill, Refused>>,
    names: Option<Arc<dyn KnownNames>>,
}

/// The names that exist before a run: of the robot's postures, of classes of objects. The host of the skills knows them.
pub trait KnownNames: Send + Sync {
    /// The names of a kind that the chart in this file can use; `None` where they are not known before a run.
    fn names(&self, kind: NameKind, chart: &Path) -> Option<BTreeSet<String>>;

    /// Whether this input of the chart is given a value in the run, so that its default is not used.
    fn is_given(&self, _input: &str) -> bool {
        false
    }
}

/// A name that does not exist.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{}; {}", self.message(), listed(known))]
pub struct UnknownName {
    /// What it should name.
    pub kind: NameKind,
    /// The name.
    pub name: String,
    /// Those that exist.
    pub known: BTreeSet<String>,
}

impl UnknownName {
    /// What is wrong, without those that exist.
    pub(crate) fn message(&self) -> String {
        format!("there is no {} `{}`", self.kind, self.name)
    }
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
type RegisteredSkill = (Arc<dyn Skill>, Arc<SkillManifest>);

impl fmt::Debug for Registry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.skills.keys()).finish()
    }
}

impl Registry {
    /// A registry without skills.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a skill under the name of its manifest; one of the same name is replaced.
    pub fn add(&mut self, skill: Arc<dyn Skill>) {
        let manifest = Arc::new(skill.manifest());
        let former = manifest.formerly.iter().map(|former| (former.clone(), manifest.name.clone()));
        self.former.extend(former);
        self.skills.insert(manifest.name.clone(), (skill, manifest));
    }

    /// The skill of that name.
    pub fn get(&self, name: &str) -> Option<&Arc<dyn Skill>> {
        self.registered(name).map(|(skill, _)| skill)
    }

    /// What the skill of that name declares.
    pub fn manifest(&self, name: &str) -> Option<&Arc<SkillManifest>> {
        self.registered(name).map(|(_, manifest)| manifest)
    }

    fn registered(&self, name: &str) -> Option<&RegisteredSkill> {
        let former = || self.skills.get(self.former.get(name)?);
        self.skills.get(name).or_else(former).or_else(|| self.remote.get(name)?.as_ref().ok())
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

    /// The same registry, with the names that inputs of its skills may take.
    #[must_use]
    pub fn with_names(mut self, names: Arc<dyn KnownNames>) -> Self {
        self.names = Some(names);
        self
    }

    /// The names of a kind that the chart in this file can use; `None` where they are not known before a run.
    pub fn names(&self, kind: NameKind, chart: &Path) -> Option<BTreeSet<String>> {
        self.names.as_ref()?.names(kind, chart)
    }

    /// Whether a run gives a value to this input of its chart.
    pub(super) fn is_given(&self, input: &str) -> bool {
        self.names.as_ref().is_some_and(|names| names.is_given(input))
    }

    /// Whether a name exists, as far as that is known.
    ///
    /// # Errors
    /// [`UnknownName`] with those that exist.
    pub fn known_name(&self, kind: NameKind, name: &str, chart: &Path) -> Result<(), UnknownName> {
        match self.names(kind, chart) {
            Some(known) if !known.contains(name) => Err(UnknownName { kind, name: name.into(), known }),
            _ => Ok(()),
        }
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

/// A channel, for the checker and for people.
#[derive(Clone, Debug, PartialEq)]
pub struct ChannelDescription {
    /// Its name.
    pub name: String,
    /// What it tells.
    pub description: String,
    /// How often a value is published, in words; empty where that is not known.
    pub rate: String,
    /// The type of its values: usually a record of `fields`.
    pub ty: Type,
    /// The fields of its values, with what they mean; none where a value has none.
    pub fields: Vec<Parameter>,
    /// Who publishes it, besides the skills whose manifests say so.
    pub publishers: Vec<String>,
    /// Who reads it, besides the skills whose manifests say so.
    pub readers: Vec<String>,
}

impl ChannelDescription {
    /// A channel of which no more is known.
    pub fn new(name: &str, description: &str) -> Self {
        Self {
            name: name.into(),
            description: description.into(),
            rate: String::new(),
            ty: Type::Any,
            fields: Vec::new(),
            publishers: Vec::new(),
            readers: Vec::new(),
        }
    }

    /// The same channel, whose values are records of these fields.
    #[must_use]
    pub fn with_fields(mut self, fields: Vec<Parameter>) -> Self {
        let types = fields.iter().map(|field| (field.name.clone(), field.ty.clone()));
        self.ty = Type::Record(types.collect());
        self.fields = fields;
        self
    }
}

/// A core segment of memory, as charts observe it.
#[derive(Clone, Debug, PartialEq)]
pub struct MemorySegment {
    /// Its name.
    pub name: String,
    /// What it holds.
    pub description: String,
    /// The attributes of its entities, with what they mean.
    pub attributes: Vec<Parameter>,
}

/// What charts may name: the channels of observers and skills, those that charts declare, and the core segments of memory that
/// have declared attributes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ChannelSchema {
    channels: BTreeMap<String, ChannelDescription>,
    segments: BTreeMap<String, MemorySegment>,
}

impl ChannelSchema {
    /// A schema without channels.
    pub fn new() -> Self {
        Self::default()
    }

    /// The same schema with one more channel, for instance
    /// `.with("hand", Type::record([("gesture", Type::String)]))`.
    #[must_use]
    pub fn with(mut self, name: &str, ty: Type) -> Self {
        self.add(ChannelDescription { ty, ..ChannelDescription::new(name, "") });
        self
    }

    /// Adds a channel; one of the same name is replaced.
    pub fn add(&mut self, channel: ChannelDescription) {
        self.channels.insert(channel.name.clone(), channel);
    }

    /// The same schema with one more core segment.
    #[must_use]
    pub fn with_segment(mut self, segment: MemorySegment) -> Self {
        self.segments.insert(segment.name.clone(), segment);
        self
    }

    /// The core segment of that name, if it has declared attributes.
    pub fn segment(&self, name: &str) -> Option<&MemorySegment> {
        self.segments.get(name)
    }

    /// The core segments with declared attributes, ordered by name.
    pub fn segments(&self) -> impl Iterator<Item = &MemorySegment> + Clone {
        self.segments.values()
    }

    /// The type of a channel's value.
    pub fn get(&self, name: &str) -> Option<&Type> {
        self.channels.get(name).map(|channel| &channel.ty)
    }

    /// The names of all channels.
    pub fn names(&self) -> impl Iterator<Item = &str> + Clone {
        self.channels.keys().map(String::as_str)
    }

    /// All channels, ordered by name.
    pub fn described(&self) -> impl Iterator<Item = &ChannelDescription> {
        self.channels.values()
    }
}

impl FromIterator<ChannelDescription> for ChannelSchema {
    fn from_iter<I: IntoIterator<Item = ChannelDescription>>(channels: I) -> Self {
        let mut schema = Self::new();
        channels.into_iter().for_each(|channel| schema.add(channel));
        schema
    }
}

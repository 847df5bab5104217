//! The forms of files as JSON Schemas, walked along a path of keys: what may stand at a place, whatever the kind of file.
//!
//! The schemas come from the same tables of keys as the readers; a kind of file that has such a table needs nothing here.

use std::collections::BTreeMap;

use armarium_runtime::chart::Registry;
use serde_json::{Map, Value as Json};

use crate::cursor::PathStep;
use crate::kind::FileKind;

/// The schemas of all kinds.
#[derive(Debug)]
pub(crate) struct Schemas(BTreeMap<FileKind, Json>);

/// What may stand at a place: one of several forms.
#[derive(Clone, Debug)]
pub(crate) struct Forms<'s> {
    root: &'s Json,
    /// The forms, references followed and choices spread out.
    nodes: Vec<&'s Json>,
    /// The names of definitions that were followed to them: `targets`, `condition`.
    pub(crate) names: Vec<&'s str>,
}

/// A key that may stand in a map.
#[derive(Clone, Copy, Debug)]
pub(crate) struct KeyForm<'s> {
    pub(crate) name: &'s str,
    pub(crate) schema: &'s Json,
    pub(crate) required: bool,
}

impl Schemas {
    pub(crate) fn new(registry: &Registry) -> Self {
        Self(FileKind::ALL.into_iter().map(|(kind, _)| (kind, kind.schema(registry))).collect())
    }

    /// What may stand under a path of keys.
    pub(crate) fn at(&self, kind: FileKind, path: &[PathStep]) -> Forms<'_> {
        let root = &self.0[&kind];
        let mut forms = Forms { root, nodes: Vec::new(), names: Vec::new() };
        forms.spread(root, 0);
        path.iter().fold(forms, |forms, step| forms.step(step))
    }
}

impl<'s> Forms<'s> {
    fn empty(&self) -> Self {
        Self { root: self.root, nodes: Vec::new(), names: Vec::new() }
    }

    fn spread(&mut self, node: &'s Json, depth: usize) {
        if depth > 16 {
            return;
        }
        if let Some(name) = node["$ref"].as_str().and_then(|path| path.strip_prefix("#/$defs/")) {
            self.names.push(name);
            return self.spread(&self.root["$defs"][name], depth + 1);
        }
        self.nodes.push(node);
        for choice in ["anyOf", "oneOf"] {
            let choices = node[choice].as_array().map_or(&[][..], Vec::as_slice);
            choices.iter().for_each(|one| self.spread(one, depth + 1));
        }
    }

    fn step(&self, step: &PathStep) -> Self {
        let mut next = self.empty();
        for node in &self.nodes {
            let found = match step {
                PathStep::Item => node.get("items"),
                PathStep::Key(key) => node["properties"]
                    .get(key)
                    .or_else(|| node.get("additionalProperties").filter(|more| more.is_object())),
            };
            if let Some(found) = found {
                next.spread(found, 0);
            }
        }
        next
    }

    /// Whether a definition was followed to here.
    pub(crate) fn is(&self, name: &str) -> bool {
        self.names.contains(&name)
    }

    /// The keys that a map may have here.
    pub(crate) fn keys(&self) -> Vec<KeyForm<'s>> {
        let mut keys: Vec<KeyForm<'s>> = Vec::new();
        for node in &self.nodes {
            let required: Vec<&str> =
                node["required"].as_array().into_iter().flatten().filter_map(Json::as_str).collect();
            for (name, schema) in node["properties"].as_object().into_iter().flat_map(Map::iter) {
                if !keys.iter().any(|key| key.name == name) {
                    keys.push(KeyForm { name, schema, required: required.contains(&name.as_str()) });
                }
            }
        }
        keys
    }

    /// The words that a value may be, with what they are.
    pub(crate) fn words(&self) -> Vec<(String, &'s str)> {
        let mut words = Vec::new();
        let text = |value: &Json| value.as_str().map_or_else(|| value.to_string(), str::to_owned);
        for node in &self.nodes {
            let doc = node["description"].as_str().unwrap_or("");
            words.extend(node.get("const").map(|word| (text(word), doc)));
            words.extend(node["enum"].as_array().into_iter().flatten().map(|word| (text(word), "")));
            if node["type"] == "boolean" {
                words.extend([("true".to_owned(), ""), ("false".to_owned(), "")]);
            }
        }
        words
    }
}

impl KeyForm<'_> {
    /// What the key says, with its default, bounds and unit.
    pub(crate) fn doc(&self) -> String {
        let mut doc = self.schema["description"].as_str().unwrap_or("").to_owned();
        let bound = |key: &str, text: &str| self.schema.get(key).map(|value| format!("{text} {value}"));
        let more: Vec<String> = [("default", "default"), ("minimum", "at least"), ("maximum", "at most")]
            .into_iter()
            .filter_map(|(key, text)| bound(key, text))
            .collect();
        if !more.is_empty() {
            doc.push_str(&format!("\n\n{}", more.join(", ")));
        }
        if self.required {
            doc.push_str("\n\nIt must be there.");
        }
        doc
    }
}

//! How what messages hold is written and read; exported JSON lines have the same form. It is apart from the types of the memory, so
//! that these can change: a form stays as other programs know it, and what is new in it has a default. Unknown fields are ignored.

use std::collections::BTreeMap;

use armarium_values::{Frame, Value};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::attributes::Attributes;
use crate::entity::{Commit, EntityId, Instance, Snapshot};
use crate::error::MemoryError;
use crate::place::SpatialRegion;
use crate::query::{Cursor, Pattern, Query, Times};

/// Types of the memory, and the forms in which they are written and read.
macro_rules! forms {
    ($($known:ident as $form:ident;)*) => {$(
        impl Serialize for $known {
            fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                $form::serialize(self, serializer)
            }
        }

        impl<'de> Deserialize<'de> for $known {
            fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                $form::deserialize(deserializer)
            }
        }
    )*};
}

forms! {
    Instance as InstanceForm;
    Snapshot as SnapshotForm;
    Commit as CommitForm;
    Pattern as PatternForm;
    Times as TimesForm;
    Cursor as CursorForm;
    Query as QueryForm;
    SpatialRegion as RegionForm;
    MemoryError as ErrorForm;
}

/// An address is a text.
impl Serialize for EntityId {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.as_str())
    }
}

impl<'de> Deserialize<'de> for EntityId {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer)?.parse().map_err(serde::de::Error::custom)
    }
}

/// Attributes are a map.
impl Serialize for Attributes {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.iter())
    }
}

impl<'de> Deserialize<'de> for Attributes {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Ok(BTreeMap::<String, Value>::deserialize(deserializer)?.into())
    }
}

/// Reads `null` as what is left out.
pub(super) fn or_default<'de, D, T>(deserializer: D) -> Result<T, D::Error>
where
    D: Deserializer<'de>,
    T: Deserialize<'de> + Default,
{
    Ok(Option::deserialize(deserializer)?.unwrap_or_default())
}

#[derive(Serialize, Deserialize)]
#[serde(remote = "Instance")]
struct InstanceForm {
    #[serde(default, deserialize_with = "or_default")]
    attributes: Attributes,
    // Not `null`: JSON writes what is not a number so.
    #[serde(default = "certain")]
    confidence: f64,
    #[serde(default, deserialize_with = "or_default", skip_serializing_if = "BTreeMap::is_empty")]
    covariance: BTreeMap<String, Vec<f64>>,
}

fn certain() -> f64 {
    1.0
}

#[derive(Serialize, Deserialize)]
#[serde(remote = "Snapshot")]
struct SnapshotForm {
    id: EntityId,
    version: u64,
    referenced_ns: u64,
    #[serde(default, deserialize_with = "or_default")]
    sent_ns: u64,
    arrived_ns: u64,
    instances: Vec<Instance>,
}

#[derive(Serialize, Deserialize)]
#[serde(remote = "Commit")]
struct CommitForm {
    id: EntityId,
    referenced_ns: u64,
    instances: Vec<Instance>,
    #[serde(default)]
    expected_version: Option<u64>,
}

#[derive(Default, Serialize, Deserialize)]
#[serde(remote = "Pattern", default)]
struct PatternForm {
    segment: Option<String>,
    provider: Option<String>,
    entity: Option<String>,
}

#[derive(Serialize, Deserialize)]
#[serde(remote = "Times", rename_all = "snake_case")]
enum TimesForm {
    Latest,
    All,
    Between(u64, u64),
    At(u64),
    Before(u64),
    Index(i64, i64),
    Versions(u64, u64),
}

#[derive(Serialize, Deserialize)]
#[serde(remote = "Cursor")]
struct CursorForm {
    id: EntityId,
    version: u64,
}

#[derive(Default, Serialize, Deserialize)]
#[serde(remote = "Query", default)]
struct QueryForm {
    #[serde(deserialize_with = "or_default")]
    pattern: Pattern,
    #[serde(deserialize_with = "or_default")]
    times: Times,
    arrived_since: Option<u64>,
    filter: Option<String>,
    region: Option<SpatialRegion>,
    limit: Option<usize>,
    after: Option<Cursor>,
    most: Option<usize>,
    most_bytes: Option<u64>,
    #[serde(deserialize_with = "or_default")]
    removed: bool,
    #[serde(deserialize_with = "or_default")]
    long_term: bool,
}

#[derive(Serialize, Deserialize)]
#[serde(remote = "SpatialRegion", rename_all = "snake_case")]
enum RegionForm {
    Box { frame: Frame, min: [f64; 3], max: [f64; 3] },
    Within { frame: Frame, of: [f64; 3], radius: f64 },
    Nearest { frame: Frame, to: [f64; 3], count: usize },
}

#[derive(Serialize, Deserialize)]
#[serde(remote = "MemoryError", rename_all = "snake_case")]
enum ErrorForm {
    Name { name: String },
    NotFound { id: String },
    Conflict { id: String, expected: u64, actual: u64 },
    Schema { id: String, attribute: String, what: String },
    Confidence { id: String },
    ReadOnly { id: String },
    Forbidden { id: String, writer: String },
    Full { id: String, entities: u64 },
    Query { what: String },
    Future { id: String, ahead_s: u64 },
    TooLarge { id: String, bytes: u64, most: u64 },
    Store { what: String },
    Remote { agent: String, what: String },
}

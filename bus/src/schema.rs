//! The schema of a payload: a name and a version, sent as its encoding.

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::codec::CodecError;

/// The name and version of a payload's type.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Schema {
    /// The name, for instance `memoryx/entity`.
    pub name: &'static str,
    /// Increases with every change that an older reader could not decode.
    pub version: u32,
}

/// A type that is sent as a payload of its own.
pub trait Payload: Serialize + DeserializeOwned {
    /// The schema that the encoding names.
    const SCHEMA: Schema;
}

/// Implements [`Payload`] for types: `payloads! { Type: "room/name", version; ... }`.
#[macro_export]
macro_rules! payloads {
    ($($type:ty: $name:literal, $version:literal;)+) => {
        $(impl $crate::Payload for $type {
            const SCHEMA: $crate::Schema = $crate::Schema::new($name, $version);
        })+
    };
}

impl Schema {
    /// A schema.
    pub const fn new(name: &'static str, version: u32) -> Self {
        Self { name, version }
    }

    /// The encoding that names the schema, `application/cbor;memoryx/entity;v1`.
    pub fn encoding(&self) -> String {
        format!("application/cbor;{};v{}", self.name, self.version)
    }

    /// Checks that an encoding names this schema in this version.
    ///
    /// # Errors
    /// [`CodecError::NoSchema`], [`CodecError::OtherSchema`], [`CodecError::OtherVersion`].
    pub fn check(&self, encoding: &str) -> Result<(), CodecError> {
        let unnamed = || CodecError::NoSchema { encoding: encoding.chars().take(100).collect() };
        let named = encoding.strip_prefix("application/cbor;").ok_or_else(unnamed)?;
        let (name, version) = named.rsplit_once(";v").ok_or_else(unnamed)?;
        let version: u32 = version.parse().map_err(|_| unnamed())?;
        if name != self.name {
            let found = name.chars().take(100).collect();
            return Err(CodecError::OtherSchema { expected: self.name.into(), found });
        }
        if version != self.version {
            let name = self.name.into();
            return Err(CodecError::OtherVersion { name, expected: self.version, found: version });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_payload_is_of_the_schema_that_is_wanted() {
        let schema = Schema::new("memoryx/entity", 1);
        assert_eq!(schema.encoding(), "application/cbor;memoryx/entity;v1");
        assert_eq!(schema.check(&schema.encoding()), Ok(()));
        for (encoding, expected) in [
            (
                "application/cbor;memoryx/entity;v2",
                "the payload is version 2 of `memoryx/entity`; this side understands version 1",
            ),
            ("application/cbor;robot/state;v1", "the payload is a `robot/state`, not a `memoryx/entity`"),
            (
                "application/json",
                "`application/json` does not name a schema as `application/cbor;NAME;vN` does",
            ),
            (
                "application/cbor;memoryx/entity;vx",
                "`application/cbor;memoryx/entity;vx` does not name a schema as `application/cbor;NAME;vN` does",
            ),
        ] {
            assert_eq!(schema.check(encoding).unwrap_err().to_string(), expected);
        }
    }
}

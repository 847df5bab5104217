//! Why a memory refuses: one enum for every memory, in process, on disk and over Zenoh.
//!
//! It is a payload too, so that a remote writer receives the refusal unchanged.

impl From<armarium_bus::KeyError> for MemoryError {
    fn from(error: armarium_bus::KeyError) -> Self {
        Self::Name { name: error.name }
    }
}

/// Why a memory refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum MemoryError {
    /// A name that cannot be part of an address.
    #[error(
        "`{name}` cannot be part of a memory address: names have 1 to 200 bytes, no control characters, \
         none of / * # ? $ and no @ in front"
    )]
    Name {
        /// The name.
        name: String,
    },
    /// There is no such entity.
    #[error("there is no entity `{id}` in memory")]
    NotFound {
        /// The address.
        id: String,
    },
    /// Another writer changed the entity first.
    #[error("`{id}` is at version {actual}, not {expected}: somebody else has changed it")]
    Conflict {
        /// The address.
        id: String,
        /// The version that the writer expected.
        expected: u64,
        /// The newest version.
        actual: u64,
    },
    /// The data do not fit the core segment's schema.
    #[error("`{id}` does not fit the core segment: attribute `{attribute}` {what}")]
    Schema {
        /// The address.
        id: String,
        /// The attribute, with a path where it is nested.
        attribute: String,
        /// What is wrong with it.
        what: String,
    },
    /// A confidence that is not a number from 0 to 1.
    #[error("`{id}` has a confidence that is not a number from 0 to 1")]
    Confidence {
        /// The address.
        id: String,
    },
    /// The provider segment is prior knowledge, which is read-only.
    #[error("`{id}` cannot be written: the provider segment is read-only")]
    ReadOnly {
        /// The address.
        id: String,
    },
    /// The memory accepts only certain writers, and each only in their own provider segments.
    #[error(
        "`{writer}` may not write `{id}`: this memory has access rules, and lets a writer who says his name write provider segments \
         that are called as he is, or begin with his name and a dot, and the agent itself everything"
    )]
    Forbidden {
        /// The address, or the other thing that was requested.
        id: String,
        /// The writer, as far as known.
        writer: String,
    },
    /// The memory has reached its maximum of entities, of all writers or of this one.
    #[error(
        "`{id}` does not fit: the memory holds its maximum of {entities} entities, of all writers or of this one"
    )]
    Full {
        /// The address.
        id: String,
        /// The maximum.
        entities: u64,
    },
    /// An invalid query.
    #[error("the query cannot be answered: {what}")]
    Query {
        /// What is wrong with it.
        what: String,
    },
    /// Data for a time too far in the future.
    #[error("`{id}` speaks of a time {ahead_s} s from now, which this memory does not take")]
    Future {
        /// The address.
        id: String,
        /// How far ahead, s.
        ahead_s: u64,
    },
    /// A commit or an entity that is larger than the memory accepts.
    #[error(
        "`{id}` does not fit: it takes {bytes} bytes, and at most {most} are held of all writers or of this one"
    )]
    TooLarge {
        /// The address.
        id: String,
        /// Its size, about.
        bytes: u64,
        /// The limit.
        most: u64,
    },
    /// The store behind the memory failed.
    #[error("the memory's store failed: {what}")]
    Store {
        /// What happened.
        what: String,
    },
    /// The memory of another agent could not be reached, or sent something that cannot be decoded.
    #[error("the memory of `{agent}` cannot be used: {what}")]
    Remote {
        /// The agent.
        agent: String,
        /// What happened.
        what: String,
    },
}

//! Errors of long-term memory, worded for the user who owns the file.

use super::RecordPlace;
use super::record::RecordError;
use crate::error::MemoryError;

/// Why the file cannot be used, before [`super::LongTermMemory`] adds the file's name.
#[derive(Debug)]
pub(super) enum Fault {
    /// What redb reports.
    Redb(redb::Error),
    /// Data that differ from what was written.
    Damaged(String),
    /// An error that needs no name.
    Other(StoreError),
}

impl Fault {
    pub(super) fn no_record(place: RecordPlace) -> Self {
        Self::Damaged(format!("a record in chunk {} is missing", place.0))
    }
}

impl<E> From<E> for Fault
where
    redb::Error: From<E>,
{
    fn from(error: E) -> Self {
        Self::Redb(error.into())
    }
}

impl From<RecordError> for Fault {
    fn from(error: RecordError) -> Self {
        Self::Damaged(error.to_string())
    }
}

impl From<StoreError> for Fault {
    fn from(error: StoreError) -> Self {
        Self::Other(error)
    }
}

/// An error of long-term memory.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum StoreError {
    /// Another process, or this one, has the file open.
    #[error("long-term memory `{path}` is in use by another process: end that one, or use another file")]
    Locked {
        /// The file.
        path: String,
    },
    /// The file is not a long-term memory, or its header is damaged.
    #[error("`{path}` is no long-term memory: {what}")]
    NotAStore {
        /// The file.
        path: String,
        /// The reason.
        what: String,
    },
    /// The file has another format.
    #[error(
        "`{path}` is of format {found}; this program reads and writes format {supported}: use another file, or the \
         program that wrote it"
    )]
    Format {
        /// The file.
        path: String,
        /// Its format.
        found: u64,
        /// The format of this program.
        supported: u64,
    },
    /// The disk is full.
    #[error("the disk under long-term memory `{path}` is full; nothing of the last commit was kept")]
    Full {
        /// The file.
        path: String,
    },
    /// Data on the disk differ from what was written.
    #[error("long-term memory `{path}` is damaged: {what}")]
    Damaged {
        /// The file.
        path: String,
        /// What is damaged.
        what: String,
    },
    /// The operating system reports an error.
    #[error("long-term memory `{path}` cannot be used: {what}")]
    Failed {
        /// The file.
        path: String,
        /// The system's message.
        what: String,
    },
    /// Somebody else has met damage, and the file was opened again: asking again is answered.
    #[error("long-term memory `{path}` was opened again meanwhile: try once more")]
    Reopened {
        /// The file.
        path: String,
    },
    /// Another snapshot already has this version.
    #[error("long-term memory has another version {version} of `{id}` already")]
    Version {
        /// The entity.
        id: String,
        /// The version.
        version: u64,
    },
    /// An invalid name of a snapshot.
    #[error(
        "`{name}` cannot be the name of a snapshot: names have 1 to 200 bytes and no `/`, `*`, `#`, `?` or `$`"
    )]
    Name {
        /// The name.
        name: String,
    },
    /// There is no named snapshot with this name.
    #[error("long-term memory has no snapshot named `{name}`")]
    NoSuchName {
        /// The name.
        name: String,
    },
    /// At import: a line that is not a snapshot.
    #[error("line {line} cannot be imported: {what}")]
    Import {
        /// The line number, from 1.
        line: u64,
        /// What is wrong with it.
        what: String,
    },
    /// An invalid query.
    #[error("the query cannot be answered: {what}")]
    Query {
        /// What is wrong with it.
        what: String,
    },
}

impl From<StoreError> for MemoryError {
    fn from(error: StoreError) -> Self {
        match error {
            StoreError::Query { what } => Self::Query { what },
            StoreError::Name { name } => Self::Name { name },
            error => Self::Store { what: error.to_string() },
        }
    }
}

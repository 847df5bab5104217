//! Why long-term memory refuses, in words for whoever has the file.

use crate::error::MemoryError;

/// Why long-term memory refuses.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum StoreError {
    /// Another process, or this one, has the file open.
    #[error("long-term memory `{path}` is in use by another process")]
    Locked {
        /// The file.
        path: String,
    },
    /// The file is not a long-term memory, or its beginning is destroyed.
    #[error("`{path}` is no long-term memory: {what}")]
    NotAStore {
        /// The file.
        path: String,
        /// What is said of it.
        what: String,
    },
    /// The file is of another format.
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
    /// Something on the disk is not what was written.
    #[error("long-term memory `{path}` is damaged: {what}")]
    Damaged {
        /// The file.
        path: String,
        /// What is damaged.
        what: String,
    },
    /// The operating system refuses.
    #[error("long-term memory `{path}` cannot be used: {what}")]
    Failed {
        /// The file.
        path: String,
        /// What it says.
        what: String,
    },
    /// Another snapshot has the version already.
    #[error("long-term memory has another version {version} of `{id}` already")]
    Version {
        /// The entity.
        id: String,
        /// The version.
        version: u64,
    },
    /// What cannot be a name.
    #[error(
        "`{name}` cannot be the name of a snapshot: names have 1 to 200 bytes and no `/`, `*`, `#`, `?` or `$`"
    )]
    Name {
        /// It.
        name: String,
    },
    /// There is no named snapshot of that name.
    #[error("long-term memory has no snapshot named `{name}`")]
    NoSuchName {
        /// The name.
        name: String,
    },
    /// A line that is no snapshot, at import.
    #[error("line {line} cannot be imported: {what}")]
    Import {
        /// Counted from 1.
        line: u64,
        /// What is wrong with it.
        what: String,
    },
    /// A question that cannot be asked.
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

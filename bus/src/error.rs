//! Errors of a session. Zenoh's errors are text; they are converted here.

/// An error of a session.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs, reason = "the names of the fields say what they are")]
pub enum SessionError {
    /// The tokio runtime is not multi-threaded.
    #[error("a session needs a multi-threaded tokio runtime")]
    Runtime,
    /// An address off this machine.
    #[error("`{endpoint}` reaches beyond this machine, which has to be asked for")]
    OffLoopback { endpoint: String },
    /// A setting that Zenoh rejects.
    #[error("the session's configuration is not accepted: {what}")]
    Config { what: String },
    /// Zenoh failed.
    #[error("Zenoh failed: {what}")]
    Zenoh { what: String },
    /// No answer within the timeout.
    #[error("nobody answered `{key}` within {seconds} s")]
    NoReply { key: String, seconds: u64 },
    /// More answers than the limit.
    #[error("`{key}` has more answers than the {most} that are accepted")]
    TooManyReplies { key: String, most: usize },
}

impl From<crate::KeyError> for SessionError {
    fn from(error: crate::KeyError) -> Self {
        Self::Config { what: error.to_string() }
    }
}

/// Converts any of Zenoh's errors.
pub(crate) fn failed(error: impl std::fmt::Display) -> SessionError {
    SessionError::Zenoh { what: error.to_string() }
}

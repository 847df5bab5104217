//! Why a session cannot do something. Zenoh's own errors are text; here is where they become one.

/// Why a session cannot do something.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum SessionError {
    /// A session needs threads of its own.
    #[error("a session needs a multi-threaded tokio runtime")]
    Runtime,
    /// An address beyond this machine.
    #[error("`{endpoint}` reaches beyond this machine, which has to be asked for")]
    OffLoopback {
        /// The address.
        endpoint: String,
    },
    /// A setting that Zenoh does not accept.
    #[error("the session's configuration is not accepted: {what}")]
    Config {
        /// The setting and what is said of it.
        what: String,
    },
    /// Zenoh failed.
    #[error("Zenoh failed: {what}")]
    Zenoh {
        /// What it says.
        what: String,
    },
    /// Nobody answered in time.
    #[error("nobody answered `{key}` within {seconds} s")]
    NoAnswer {
        /// What was asked.
        key: String,
        /// How long was waited, s.
        seconds: u64,
    },
    /// More answers than were asked for.
    #[error("`{key}` has more answers than the {most} that are accepted")]
    TooManyAnswers {
        /// What was asked.
        key: String,
        /// How many were accepted.
        most: usize,
    },
}

/// Takes any of Zenoh's errors.
pub(crate) fn failed(error: impl std::fmt::Display) -> SessionError {
    SessionError::Zenoh { what: error.to_string() }
}

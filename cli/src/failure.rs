//! Why a command ends before its work is done, and the exit status that says so.

use std::io::{self, Write};

use armarium_host::HostError;
use armarium_source::Finding;

use crate::console;

/// Why a command ends early.
#[derive(Debug)]
pub(crate) enum CommandFailure {
    /// It cannot be done: status 1.
    Refused(String),
    /// An argument or a file is wrong: status 2.
    Argument(String),
    /// A file is wrong at these places: status 2.
    Findings(Vec<Finding>),
    /// As [`console::refuse`] says it: status 2.
    Host(HostError),
    /// The output cannot be written.
    Output(io::Error),
}

impl CommandFailure {
    /// Says why. Returns the exit status.
    pub(crate) fn say(self, out: &mut dyn Write) -> io::Result<u8> {
        match self {
            Self::Refused(what) => writeln!(out, "error: {what}").map(|()| 1),
            Self::Argument(what) => writeln!(out, "error: {what}").map(|()| 2),
            Self::Findings(findings) => console::show(&findings, out).map(|()| 2),
            Self::Host(error) => console::refuse(&error, out),
            Self::Output(error) => Err(error),
        }
    }
}

impl From<io::Error> for CommandFailure {
    fn from(error: io::Error) -> Self {
        Self::Output(error)
    }
}

impl From<String> for CommandFailure {
    fn from(what: String) -> Self {
        Self::Argument(what)
    }
}

impl From<Vec<Finding>> for CommandFailure {
    fn from(findings: Vec<Finding>) -> Self {
        Self::Findings(findings)
    }
}

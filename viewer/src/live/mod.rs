//! The live page: what a run does, thinks and sees, in a browser of this machine, while it goes on or from its recording.
//!
//! [`LivePage::open`] serves one page on a thread of its own. What it shows is a [`ShownRun`]: usually a [`Timeline`], which the run's
//! recorder writes beside the recording; the run never waits for a page. News go to all pages as server-sent events, encoded once;
//! a page that is slow misses some, sees that, and asks for all again. Nobody acts without the page's token, and only where a
//! [`Control`] is given. Beyond this machine it is served only with TLS, to who has the token of its address ([`PageAddress`]).
//!
//! It knows no engine and no simulator: events are JSON with the time, as in a recording.

mod address;
mod assets;
mod header;
mod recording;
mod runs;
mod server;
mod shown;
mod timeline;
mod track;

use std::io;

use futures::future::BoxFuture;
use serde::Deserialize;
use tokio::sync::oneshot;

use crate::http::{Admission, PageServer, token};
use server::RunSite;

pub use address::{CertificateError, PageAddress};
pub use header::{RunHeader, Solid, SolidForm, solids_of};
pub use recording::{REPORT, ShowError};
pub use runs::ShownRuns;
pub use shown::{NewestImage, PageAnswer, ReportSoFar, ServedTimeline, ShownRun, ShownTimeline};
pub use timeline::{MEMORY, Timeline};

/// What somebody does to a run through its page. States are given by their paths.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(tag = "do", rename_all = "snake_case", deny_unknown_fields)]
#[non_exhaustive]
#[allow(missing_docs, reason = "the names of the fields say what they are")]
pub enum Action {
    /// Time stands still.
    Pause,
    /// It goes on.
    GoOn,
    /// It goes on until the next transition.
    Step,
    /// It pauses where one of these states is entered; replaces those before.
    Breakpoints { states: Vec<String> },
    /// An event for all active states.
    Event {
        name: String,
        #[serde(default)]
        data: serde_json::Value,
    },
    /// The skill of a state is cancelled, and counts as ended with this outcome.
    Outcome {
        state: String,
        /// `success`, `failure`, or one that the skill declares.
        outcome: String,
    },
    /// The robot stops, and the run ends.
    Stop,
}

/// Why an action is refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{reason}")]
pub struct ActionRefused {
    /// For people.
    pub reason: String,
}

/// What a page may do to a run.
pub trait Control: Send + Sync {
    /// Does something.
    ///
    /// # Errors
    /// [`ActionRefused`] with the reason.
    fn act(&self, action: Action) -> Result<(), ActionRefused>;

    /// Whether time stands still already: nothing new is told until it goes on.
    fn is_paused(&self) -> bool;
}

/// A page that is served until this is dropped.
#[derive(Debug)]
pub struct LivePage {
    url: String,
    /// Dropped, it ends the server.
    _ends: oneshot::Sender<()>,
}

impl LivePage {
    /// Serves a page: of a run, of two beside each other, or of as many as are added. What is done `beside` runs on the page's thread.
    ///
    /// # Errors
    /// When the address cannot be listened on.
    pub fn open(at: &PageAddress, runs: ShownRuns, beside: Vec<BoxFuture<'static, ()>>) -> io::Result<Self> {
        let (listener, tls) = (at.listen()?, at.tls.clone());
        let address = listener.local_addr()?;
        let path = if runs.len() == 2 { "compare" } else { "" };
        let (admission, url) = match tls {
            None => (Admission::of(address), format!("http://{address}/{path}")),
            Some(_) => {
                let token = token()?;
                let url = format!("https://{address}/{path}?token={token}");
                (Admission::invited(address, token), url)
            }
        };
        let server = PageServer::new(RunSite { runs, token: token()? }, admission);
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let (ends, ended) = oneshot::channel();
        let serving = move || {
            runtime.block_on(async {
                beside.into_iter().for_each(|task| _ = tokio::spawn(task));
                let Ok(listener) = tokio::net::TcpListener::from_std(listener) else { return };
                tokio::select! {
                    biased;
                    _ = ended => {}
                    () = server.serve(listener, tls) => {}
                }
            });
        };
        std::thread::Builder::new().name("live page".into()).spawn(serving)?;
        Ok(Self { url, _ends: ends })
    }

    /// Where the page is; beyond this machine with the token that admits.
    pub fn url(&self) -> &str {
        &self.url
    }
}

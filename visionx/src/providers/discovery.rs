//! Finds the providers that answer, with their descriptions, including those that cannot be read.

use std::time::Duration;

use armarium_bus::keys::{self, Key, Part};
use armarium_bus::{Bounds, CodecError, Reply, Session, SessionError};

use super::lenient::decode_leniently;
use super::offering::DESCRIPTION;
use super::{MAX_IMAGES, ProviderDescription};

/// Most providers listed.
const MAX_PROVIDERS: usize = 1024;

/// Why a provider cannot be read.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum RemoteError {
    /// No answer, or the session has ended.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// Its answer cannot be decoded.
    #[error(
        "`{provider}` answers, but what it says of itself cannot be read (see docs/wire-images.md): {what}"
    )]
    Description {
        /// `AGENT/PROVIDER`.
        provider: String,
        /// What is wrong with its description.
        what: CodecError,
    },
}

/// A provider that answers.
#[derive(Clone, Debug, PartialEq)]
pub struct FoundProvider {
    /// The agent that publishes it.
    pub agent: String,
    /// Its name in the key.
    pub provider: String,
    /// Its description, or why the description cannot be read.
    pub description: Result<ProviderDescription, CodecError>,
}

/// The providers that answer within `wait`, sorted by agent and name, including those with unreadable
/// descriptions.
///
/// # Errors
/// [`SessionError`].
pub async fn providers(
    session: &Session,
    agent: Part<'_>,
    provider: Part<'_>,
    wait: Duration,
) -> Result<Vec<FoundProvider>, SessionError> {
    let keys = keys::image_pattern(agent, provider)?;
    let answers = session.query(keys, "", None, MAX_PROVIDERS, wait).await?;
    let mut found: Vec<FoundProvider> = answers.iter().filter_map(found).collect();
    found.sort_by(|a, b| (&a.agent, &a.provider).cmp(&(&b.agent, &b.provider)));
    Ok(found)
}

/// The provider of an answer; `None` for a refusal.
fn found(answer: &Reply) -> Option<FoundProvider> {
    let Reply::Message(message) = answer else { return None };
    let mut parts = message.key.split('/');
    let (agent, provider) = (parts.next()?.to_owned(), parts.nth(1)?.to_owned());
    let description = description(&message.encoding, &message.payload);
    Some(FoundProvider { agent, provider, description })
}

/// Decodes the description of an answer.
fn description(encoding: &str, payload: &[u8]) -> Result<ProviderDescription, CodecError> {
    DESCRIPTION.check(encoding)?;
    let description: ProviderDescription = decode_leniently(payload, Bounds::default())?;
    let images = description.images.len();
    let what = || format!("it speaks of {images} images; at most {MAX_IMAGES} are read");
    if images > MAX_IMAGES { Err(CodecError::Content { what: what() }) } else { Ok(description) }
}

/// Queries the description until an answer arrives.
pub(super) async fn describe(
    session: &Session,
    key: &Key,
    name: &str,
    wait: Duration,
) -> Result<ProviderDescription, RemoteError> {
    let asking = async {
        loop {
            // Zenoh may not know the provider yet; a later query may reach it.
            let answers = session.query(key.clone(), "", None, 16, Duration::from_millis(500)).await?;
            let answered: Vec<_> = answers.iter().filter_map(found).map(|found| found.description).collect();
            // Several providers may answer on one key; the first readable description is used.
            if let Some(answer) = answered.iter().find(|a| a.is_ok()).or(answered.first()) {
                let unread = |what| RemoteError::Description { provider: name.to_owned(), what };
                return answer.clone().map_err(unread);
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    };
    let none = SessionError::NoReply { key: key.to_string(), seconds: wait.as_secs() };
    tokio::time::timeout(wait, asking).await.unwrap_or(Err(none.into()))
}

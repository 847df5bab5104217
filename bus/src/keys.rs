//! All keys on Zenoh, as checked types: a [`Key`] names one resource, a [`KeyPattern`] several.
//!
//! ```text
//! {agent}/memory                                   queryable: commit
//! {agent}/memory/by/{writer}                       the same, for a writer who says who he is
//! {agent}/memory/changes/{segment}                 a core segment's changes in their order, several in one message
//! {agent}/memory/changes                           the same of all core segments
//! {agent}/memory/{segment}/{provider}/{entity}     put = update, subscribe = observe, get = query
//! {agent}/image/{provider}                         frames; queryable: what the provider gives
//! {agent}/image/{provider}/{coding}                the same frames as PNG or JPEG
//! {agent}/drive/{driver}/{part}                    joints below a guard: description, sample, targets, claim
//! {agent}/robot/{robot}/{part}                     joints above a guard: description, state, lease, command, do
//! {agent}/chart/{Chart}                            queryable: start, cancel, outcome
//! {agent}/event                                    queryable: an event for the charts that run there
//! {agent}/live/{part}                              the live page: page (queryable), news
//! {agent}/alive/{service}                          liveliness token
//! ```

use std::fmt;

/// Longest name in a key, bytes.
const MAX_NAME_BYTES: usize = 200;

/// A name that cannot be part of a key.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "`{name}` cannot be part of a key: names have 1 to 200 bytes, no control characters, none of / * # ? $ and no \
     @ in front"
)]
pub struct KeyError {
    /// The name, cut to its first characters.
    pub name: String,
}

/// The key of one resource.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Key(String);

/// A key expression that matches several keys.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct KeyPattern(String);

/// Part of a pattern: a name, or `None` for any.
pub type Part<'a> = Option<&'a str>;

/// Checks that `name` can be one part of a key.
///
/// # Errors
/// [`KeyError`] when it cannot.
pub fn check_name(name: &str) -> Result<(), KeyError> {
    let forbidden = |byte: u8| matches!(byte, b'/' | b'*' | b'#' | b'?' | b'$') || byte.is_ascii_control();
    let bad = name.is_empty()
        || name.len() > MAX_NAME_BYTES
        || name.starts_with('@')
        || name.bytes().any(forbidden)
        || (!name.is_ascii() && name.chars().any(char::is_control));
    if bad { Err(KeyError { name: name.chars().take(40).collect() }) } else { Ok(()) }
}

fn key(parts: &[&str]) -> Result<Key, KeyError> {
    parts.iter().try_for_each(|name| check_name(name))?;
    Ok(Key(parts.join("/")))
}

fn pattern(parts: &[Part<'_>]) -> Result<KeyPattern, KeyError> {
    parts.iter().flatten().try_for_each(|name| check_name(name))?;
    Ok(KeyPattern(parts.iter().map(|part| part.unwrap_or("*")).collect::<Vec<_>>().join("/")))
}

/// Functions by their arguments and the parts of the key or pattern that they make of them.
macro_rules! keys {
    ($(
        $(#[doc = $doc:literal])*
        $name:ident($($arg:ident: $of:ty),*) -> $Made:ident = $make:ident[$($part:expr),*];
    )*) => {$(
        $(#[doc = $doc])*
        ///
        /// # Errors
        /// [`KeyError`] when a name cannot be part of a key.
        pub fn $name($($arg: $of),*) -> Result<$Made, KeyError> {
            $make(&[$($part),*])
        }
    )*};
}

keys! {
    /// The queryable for commits with an answer.
    memory_commit(agent: &str) -> Key = key[agent, "memory"];
    /// The queryable for one writer's commits: access rules can admit that writer only.
    memory_by(agent: &str, writer: &str) -> Key = key[agent, "memory", "by", writer];
    /// The queryables for the commits of all named writers.
    memory_by_pattern(agent: &str) -> KeyPattern = pattern[Some(agent), Some("memory"), Some("by"), None];
    /// The key on which a memory publishes its changes in order.
    memory_all_changes(agent: &str) -> Key = key[agent, "memory", "changes"];
    /// The key on which a memory publishes the changes of one core segment in order.
    memory_changes_of(agent: &str, segment: &str) -> Key = key[agent, "memory", "changes", segment];
    /// The keys on which a memory publishes the changes of a core segment, or of each of them.
    memory_changes(agent: &str, segment: Option<&str>) -> KeyPattern
        = pattern[Some(agent), Some("memory"), Some("changes"), segment];
    /// One entity in an agent's memory.
    memory(agent: &str, segment: &str, provider: &str, entity: &str) -> Key
        = key[agent, "memory", segment, provider, entity];
    /// Entities in the memory of one agent or of all.
    memory_pattern(agent: Part<'_>, segment: Part<'_>, provider: Part<'_>, entity: Part<'_>) -> KeyPattern
        = pattern[agent, Some("memory"), segment, provider, entity];
    /// The frames of an image provider.
    image(agent: &str, provider: &str) -> Key = key[agent, "image", provider];
    /// The frames of an image provider as PNG or JPEG files.
    image_coded(agent: &str, provider: &str, coding: &str) -> Key = key[agent, "image", provider, coding];
    /// Matching image providers.
    image_pattern(agent: Part<'_>, provider: Part<'_>) -> KeyPattern = pattern[agent, Some("image"), provider];
    /// A chart or skill of an agent that others may start.
    chart(agent: &str, chart: &str) -> Key = key[agent, "chart", chart];
    /// The queryable for events to an agent's charts.
    event(agent: &str) -> Key = key[agent, "event"];
    /// The charts and skills that agents offer.
    chart_pattern(agent: Part<'_>, chart: Part<'_>) -> KeyPattern = pattern[agent, Some("chart"), chart];
    /// A part of a driver of joints: `description`, `sample`, `targets` or `claim`.
    drive(agent: &str, driver: &str, part: &str) -> Key = key[agent, "drive", driver, part];
    /// A part of a robot behind its guard: `description`, `state`, `lease`, `command` or `do`.
    robot(agent: &str, robot: &str, part: &str) -> Key = key[agent, "robot", robot, part];
    /// A part of an agent's live page: `page` is asked for what the page shows, on `news` it says what is new.
    live(agent: &str, part: &str) -> Key = key[agent, "live", part];
    /// The liveliness token of a service of an agent.
    alive(agent: &str, service: &str) -> Key = key[agent, "alive", service];
    /// The liveliness tokens of matching services.
    alive_pattern(agent: Part<'_>, service: Part<'_>) -> KeyPattern = pattern[agent, Some("alive"), service];
}

impl Key {
    /// A key from outside.
    ///
    /// # Errors
    /// [`KeyError`] with the first invalid part.
    pub fn parse(text: &str) -> Result<Self, KeyError> {
        key(&text.split('/').collect::<Vec<_>>())
    }

    /// The key as a Zenoh key expression.
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// The agent that owns the resource.
    pub fn agent(&self) -> &str {
        self.0.split('/').next().unwrap_or_default()
    }

    /// The last part: entity, provider, chart, run or service.
    pub fn name(&self) -> &str {
        self.0.rsplit('/').next().unwrap_or_default()
    }
}

impl KeyPattern {
    /// The pattern as a Zenoh key expression.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl From<Key> for KeyPattern {
    fn from(key: Key) -> Self {
        Self(key.0)
    }
}

impl fmt::Display for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl fmt::Display for KeyPattern {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_made_of_checked_names() {
        assert_eq!(
            memory("alice", "Motions", "learned", "wipe 1").unwrap().as_str(),
            "alice/memory/Motions/learned/wipe 1"
        );
        assert_eq!(alive_pattern(None, Some("memory")).unwrap().as_str(), "*/alive/memory");
        assert_eq!(
            memory_pattern(Some("a"), Some("Motions"), None, None).unwrap().as_str(),
            "a/memory/Motions/*/*"
        );
        for bad in ["", "a/b", "**", "$*", "a#", "a?", "@alice", "tab\t"] {
            assert!(event(bad).is_err(), "{bad:?} is refused");
            assert!(alive_pattern(Some(bad), None).is_err(), "{bad:?} is refused in patterns");
        }
    }

    #[test]
    fn keys_that_are_accepted_are_key_expressions() {
        for name in ["a", "-", "ä ö", "a.b", "a@b", "x_1", &"n".repeat(200)] {
            let key = memory(name, name, name, name).unwrap();
            assert!(zenoh::key_expr::KeyExpr::new(key.as_str()).is_ok(), "{name:?}");
            assert_eq!(Key::parse(key.as_str()), Ok(key));
        }
        assert!(Key::parse("a//b").is_err());
    }
}

//! Access rules for one agent, in the format of Zenoh's `access_control`.
//!
//! The rules are installed at the agent that they protect, and apply to each of its links. The common name of the
//! certificate identifies the other side of a link, so the rules need [`crate::Tls`] with `mutual`. Everything
//! without a rule is denied: Zenoh drops it silently, and a denied query has no answer.
//!
//! Rules see keys, not payloads. The memory checks what a commit contains; it knows the writer by the key, which only
//! that writer may query (`keys::memory_by`).

use serde_json::{Value as Json, json};

use crate::keys::{KeyError, check_name};

/// The peers that an agent admits. Names are the common names of certificates, which are the names of agents.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Access {
    /// The agent. A peer with its own certificate may do everything.
    pub own: String,
    /// Peers that may read its memory; the agent may follow theirs.
    pub readers: Vec<String>,
    /// Peers that may write provider segments of their own name into its memory, and read it.
    pub writers: Vec<String>,
    /// Peers that may start its charts and skills, and send them events.
    pub callers: Vec<String>,
    /// Peers that may see the states of its robots, the images of its cameras, and its live page.
    pub watchers: Vec<String>,
    /// Peers that may lease and command its robots, and see their states.
    pub commanders: Vec<String>,
    /// Peers whose drivers this agent commands: their samples, under their own names, are taken.
    pub drivers: Vec<String>,
}

/// A rule: name, messages, directions (as this agent sees them) and keys.
struct AccessRule {
    id: String,
    messages: Vec<&'static str>,
    flow: &'static str,
    keys: Vec<String>,
}

/// The messages of a peer that queries or subscribes.
const QUERYING: &[&str] =
    &["query", "declare_subscriber", "declare_liveliness_subscriber", "liveliness_query"];
/// The messages of a peer that publishes or answers.
const PUBLISHING: &[&str] = &["put", "delete", "reply", "declare_queryable", "liveliness_token"];
impl Access {
    /// Whether any peer but the agent itself is admitted.
    pub fn is_for_others(&self) -> bool {
        self.others().next().is_some()
    }

    /// Whether a peer is admitted to anything. What another one says or answers is dropped.
    pub fn admits(&self, peer: &str) -> bool {
        peer == self.own || self.others().any(|other| other == peer)
    }

    /// All peers but the agent itself; some more than once.
    fn others(&self) -> impl Iterator<Item = &String> {
        let lists =
            [&self.readers, &self.writers, &self.callers, &self.watchers, &self.commanders, &self.drivers];
        lists.into_iter().flatten()
    }

    /// The rules, for [`crate::SessionConfig::access_control`].
    ///
    /// # Errors
    /// [`KeyError`] when a name cannot be part of a key.
    pub fn rules(&self) -> Result<Json, KeyError> {
        let own = self.own.as_str();
        check_name(own)?;
        let everything = [PUBLISHING, QUERYING].concat();
        let mut rules = vec![
            rule(own, "everything", &everything, "ingress", ["**".into()]),
            rule(own, "everything_back", &everything, "egress", ["**".into()]),
        ];
        let mut subjects = vec![own];
        for other in self.others() {
            if subjects.contains(&other.as_str()) {
                continue;
            }
            check_name(other)?;
            subjects.push(other);
            rules.extend(self.of(other));
        }
        let policies: Vec<Json> = subjects
            .iter()
            .map(|subject| {
                let prefix = format!("{subject} ");
                let ids: Vec<&str> =
                    rules.iter().map(|r| r.id.as_str()).filter(|id| id.starts_with(&prefix)).collect();
                json!({"rules": ids, "subjects": [subject]})
            })
            .collect();
        let subjects: Vec<Json> =
            subjects.iter().map(|name| json!({"id": name, "cert_common_names": [name]})).collect();
        let rules: Vec<Json> = rules
            .iter()
            .map(|r| {
                json!({
                    "id": r.id, "permission": "allow", "messages": r.messages, "flows": [r.flow], "key_exprs": r.keys,
                })
            })
            .collect();
        Ok(json!({
            "enabled": true, "default_permission": "deny", "rules": rules, "subjects": subjects, "policies": policies,
        }))
    }

    /// The rules for one peer: publish and answer on its own keys, and what this agent's lists allow.
    fn of(&self, other: &str) -> Vec<AccessRule> {
        let own = &self.own;
        let is_in = |list: &[String]| list.iter().any(|name| name == other);
        let himself = || [format!("{other}/**")];
        let mut rules = vec![
            rule(other, "tells", PUBLISHING, "ingress", himself()),
            rule(other, "is_asked", QUERYING, "egress", himself()),
        ];
        if is_in(&self.readers) || is_in(&self.writers) {
            let asked = [
                format!("{own}/memory"),
                format!("{own}/memory/changes"),
                format!("{own}/memory/changes/*"),
                format!("{own}/memory/*/*/*"),
                format!("{own}/alive/*"),
            ];
            rules.push(rule(other, "reads", QUERYING, "ingress", asked));
            let told = [format!("{own}/memory/**"), format!("{own}/alive/*")];
            rules.push(rule(other, "is_told", PUBLISHING, "egress", told));
        }
        if is_in(&self.writers) {
            rules.push(rule(other, "commits", QUERYING, "ingress", [format!("{own}/memory/by/{other}")]));
            rules.push(rule(other, "writes", &["put"], "ingress", [format!("{own}/memory/*/{other}/*")]));
        }
        if is_in(&self.callers) {
            let charts = || [format!("{own}/chart/*"), format!("{own}/event"), format!("{own}/alive/*")];
            rules.push(rule(other, "calls", QUERYING, "ingress", charts()));
            rules.push(rule(other, "is_answered", PUBLISHING, "egress", charts()));
        }
        if is_in(&self.watchers) || is_in(&self.commanders) {
            let seen = || {
                let robots = ["robot/*/description", "robot/*/state"];
                let parts = [&robots[..], &["live/page", "live/news", "image/*", "image/*/*"]].concat();
                parts.iter().map(|part| format!("{own}/{part}")).collect::<Vec<_>>()
            };
            rules.push(rule(other, "watches", QUERYING, "ingress", seen()));
            rules.push(rule(other, "is_shown", PUBLISHING, "egress", seen()));
        }
        if is_in(&self.commanders) {
            let asked = || ["lease", "do"].map(|part| format!("{own}/robot/*/{part}"));
            rules.push(rule(other, "leases", QUERYING, "ingress", asked()));
            rules.push(rule(other, "is_given", PUBLISHING, "egress", asked()));
            let commanded = || [format!("{own}/robot/*/command")];
            rules.push(rule(other, "commands", &["put"], "ingress", commanded()));
            rules.push(rule(other, "is_heard", QUERYING, "egress", commanded()));
        }
        if is_in(&self.drivers) {
            let driven = [format!("{other}/drive/*/targets")];
            rules.push(rule(other, "drives", &["declare_subscriber"], "ingress", driven.clone()));
            rules.push(rule(other, "is_driven", &["put"], "egress", driven));
        }
        rules
    }
}

fn rule(
    subject: &str,
    name: &str,
    messages: &[&'static str],
    flow: &'static str,
    keys: impl Into<Vec<String>>,
) -> AccessRule {
    AccessRule { id: format!("{subject} {name}"), messages: messages.to_vec(), flow, keys: keys.into() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn everybody_is_allowed_what_his_part_needs_and_no_more() {
        let names = |list: &[&str]| list.iter().map(|n| (*n).to_owned()).collect::<Vec<_>>();
        let access = Access {
            own: "alice".into(),
            readers: names(&["bob", "erin"]),
            writers: names(&["carol", "bob"]),
            callers: names(&["dave"]),
            watchers: names(&["frank"]),
            commanders: names(&["grace"]),
            drivers: names(&["heidi"]),
        };
        let rules = access.rules().unwrap();
        assert_eq!(rules["default_permission"], "deny");
        let of = |name: &str| {
            let policies = rules["policies"].as_array().unwrap();
            let policy = policies.iter().find(|p| p["subjects"][0] == name).unwrap();
            let ids = policy["rules"].as_array().unwrap().iter();
            ids.map(|id| id.as_str().unwrap().to_owned()).collect::<Vec<_>>()
        };
        assert_eq!(of("alice"), ["alice everything", "alice everything_back"]);
        let reader = ["erin tells", "erin is_asked", "erin reads", "erin is_told"];
        assert_eq!(of("erin"), reader);
        let writer = ["bob tells", "bob is_asked", "bob reads", "bob is_told", "bob commits", "bob writes"];
        assert_eq!(of("bob"), writer);
        let keys = |id: &str| {
            rules["rules"].as_array().unwrap().iter().find(|r| r["id"] == id).unwrap()["key_exprs"].clone()
        };
        assert!(!keys("erin reads").to_string().contains("/by/"), "who reads has no key to commit on");
        assert_eq!(of("frank"), ["frank tells", "frank is_asked", "frank watches", "frank is_shown"]);
        assert_eq!(of("grace").len(), 8);
        assert_eq!(of("heidi"), ["heidi tells", "heidi is_asked", "heidi drives", "heidi is_driven"]);
        assert!(!keys("frank watches").to_string().contains("command"), "who looks on does not command");
        assert_eq!(of("dave"), ["dave tells", "dave is_asked", "dave calls", "dave is_answered"]);
        let config = crate::SessionConfig { access_control: Some(rules), ..Default::default() };
        assert!(config.to_zenoh().is_ok());
        let bad = Access { own: "a*".into(), ..Access::default() };
        assert!(bad.rules().is_err() && !bad.is_for_others());
        assert!(
            ["alice", "bob", "heidi"].iter().all(|peer| access.admits(peer)) && !access.admits("mallory")
        );
    }
}

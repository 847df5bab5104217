//! Whom an agent follows, as its memory says in the core segment `Following`, and how far it is behind them.

use std::collections::BTreeMap;
use std::time::Duration;

use armarium_bus::{Session, keys};
use armarium_knowledge::{FOLLOWING, Following, Origin};
use armarium_memoryx::{EntityId, Head, Memory, MemoryError, Pattern, Query, RemoteMemory};

use super::CommandFailure;

/// How long other agents in sight may take to answer.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(1);
/// Most entities that the follower lacks and that are looked at, whether they are to be copied at all.
const MAX_LOOKED_AT: usize = 1000;

/// Whom the agent `follower` follows, as its memory says.
async fn followed_by(memory: &dyn Memory, follower: &str) -> Result<Vec<Following>, MemoryError> {
    let own = Query::latest(Pattern::segment(FOLLOWING).of_provider(follower));
    Ok(memory.query(&own).await?.iter().filter_map(|snapshot| Following::of(snapshot)).collect())
}

/// How far an agent is behind another one that it follows.
pub(super) struct Lag {
    /// The other agent than the one that was asked for.
    pub(super) who: String,
    pub(super) following: Following,
    /// Otherwise, why nobody can tell.
    pub(super) behind: Result<Behind, String>,
}

impl Lag {
    pub(super) fn is_up_to_date(&self) -> bool {
        self.behind.as_ref().is_ok_and(|behind| behind.behind == 0)
    }
}

/// How far the agent `own` is behind those whom it follows.
pub(super) async fn lags_of(
    session: &Session,
    memory: &RemoteMemory,
    own: &str,
) -> Result<Vec<Lag>, MemoryError> {
    let mut lags = Vec::new();
    for following in followed_by(memory, own).await? {
        let behind = match &following.looked_for {
            Some(why) => Err(why.clone()),
            None => match RemoteMemory::connect(session, &following.agent).await {
                Ok(leader) => behind(memory, &leader, &following).await.map_err(|error| error.to_string()),
                Err(error) => Err(format!("{error}; --connect has to reach it, too")),
            },
        };
        lags.push(Lag { who: following.agent.clone(), following, behind });
    }
    Ok(lags)
}

/// How far those in sight that follow the agent `own` are behind it. Who does not let himself be read is left out.
pub(super) async fn lags_behind(
    session: &Session,
    memory: &RemoteMemory,
    own: &str,
) -> Result<Vec<Lag>, CommandFailure> {
    let memories = keys::alive_pattern(None, Some("memory")).map_err(MemoryError::from)?;
    let mut lags = Vec::new();
    for key in session.all_alive(&memories, ANSWER_TIMEOUT).await? {
        let Some(name) = key.split('/').next().filter(|name| *name != own) else { continue };
        let Ok(follower) = RemoteMemory::connect(session, name).await else { continue };
        let followings = followed_by(&follower, name).await.unwrap_or_default();
        for following in followings.into_iter().filter(|following| following.agent == own) {
            let behind = match &following.looked_for {
                Some(why) => Err(why.clone()),
                None => behind(&follower, memory, &following).await.map_err(|error| error.to_string()),
            };
            lags.push(Lag { who: name.into(), following, behind });
        }
    }
    Ok(lags)
}

/// What a follower lacks.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Behind {
    /// Entities of which the follower has a version, also an older one.
    pub(super) entities: u64,
    /// Entities of which it has an older version, or nothing.
    pub(super) behind: u64,
    /// Versions that it lacks of them.
    pub(super) versions: u64,
    /// Since when the first of these is there, s.
    pub(super) since_s: f64,
}

/// Compares what the follower has of `leader` with what is there.
async fn behind(
    follower: &dyn Memory,
    leader: &dyn Memory,
    following: &Following,
) -> Result<Behind, MemoryError> {
    let have = copied(follower, &following.agent).await?;
    let (mut heads, mut now_ns) = (BTreeMap::<EntityId, Head>::new(), 0);
    for segment in &following.segments {
        let found = leader.heads(&Pattern::segment(segment)).await?;
        now_ns = now_ns.max(found.now_ns.unwrap_or(found.until_ns));
        heads.extend(found.entities.into_iter().map(|head| (head.id.clone(), head)));
    }
    let mut lacks = Behind::default();
    let (mut since_ns, mut looked_at) = (now_ns, 0);
    for (id, head) in heads {
        let held = have.get(&id);
        lacks.entities += u64::from(held.is_some());
        let version = match held {
            Some(version) if *version >= head.version => continue,
            Some(version) => *version,
            None if head.removed || looked_at == MAX_LOOKED_AT => continue,
            None => {
                looked_at += 1;
                if !is_own(leader, &id).await? {
                    continue;
                }
                head.version.saturating_sub(1)
            }
        };
        lacks.behind += 1;
        lacks.versions += head.version - version;
        since_ns = since_ns.min(head.arrived_ns);
    }
    lacks.since_s = (now_ns - since_ns) as f64 * 1e-9;
    Ok(lacks)
}

/// The newest versions that a follower has of an agent's entities, by their address there.
async fn copied(follower: &dyn Memory, agent: &str) -> Result<BTreeMap<EntityId, u64>, MemoryError> {
    let mut versions = BTreeMap::new();
    let copies = Pattern::any().of_provider(&format!("{agent}.*"));
    for snapshot in follower.query(&Query::latest(copies)).await? {
        if let Some(origin) = Origin::of(&snapshot).filter(|origin| origin.agent == agent) {
            versions.insert(origin.id, origin.version);
        }
    }
    Ok(versions)
}

/// Whether an entity is the leader's own knowledge: what it has copied itself is not copied again.
async fn is_own(leader: &dyn Memory, id: &EntityId) -> Result<bool, MemoryError> {
    match leader.latest(id).await {
        Ok(snapshot) => Ok(!Origin::has(&snapshot)),
        Err(MemoryError::NotFound { .. }) => Ok(false),
        Err(error) => Err(error),
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use armarium_memoryx::{Commit, WorkingMemory, fields};
    use armarium_values::Value;

    use super::*;

    fn memory() -> WorkingMemory {
        armarium_knowledge::working_memory(Arc::new(|| 1_000_000_000))
    }

    fn put<const N: usize>(memory: &WorkingMemory, id: &str, attributes: [(&str, Value); N]) {
        assert!(memory.commit_now(vec![Commit::new(id.parse().unwrap(), 1, attributes)]).is_ok());
    }

    fn origin(agent: &str, version: i64) -> Value {
        Value::Map(fields([
            ("agent", Some(agent.into())),
            ("provider", Some("eye".into())),
            ("version", Some(Value::Int(version))),
        ]))
    }

    fn list(names: &[&str]) -> Value {
        Value::List(names.iter().map(|name| Value::from(*name)).collect())
    }

    #[tokio::test]
    async fn whom_an_agent_follows_is_in_its_memory() {
        let bob = memory();
        let state = |state: &str| ("state", state.into());
        put(
            &bob,
            "Following/bob/alice",
            [
                ("agent", "alice".into()),
                ("segments", list(&["Agents", "*"])),
                state("followed"),
                ("missed", Value::Int(3)),
                ("clock_ahead_s", Value::Float(0.5)),
            ],
        );
        put(
            &bob,
            "Following/bob/carol",
            [("agent", "carol".into()), state("looked for"), ("why", "absent".into())],
        );
        put(&bob, "Following/alice.alice/dave", [("agent", "dave".into()), state("followed")]);
        let alice = Following {
            missed: 3,
            clock_ahead_s: Some(0.5),
            ..Following::new("alice", vec!["Agents".into(), "*".into()])
        };
        let carol = Following { looked_for: Some("absent".into()), ..Following::new("carol", Vec::new()) };
        assert_eq!(followed_by(&bob, "bob").await, Ok(vec![alice, carol]));
    }

    #[tokio::test]
    async fn what_a_follower_lacks_is_older_or_not_there_at_all() {
        let (alice, bob) = (memory(), memory());
        for id in [
            "S/eye/same",
            "S/eye/older",
            "S/eye/older",
            "S/eye/older",
            "S/eye/new",
            "S/eye/gone",
            "T/eye/other",
        ] {
            put(&alice, id, []);
        }
        put(&alice, "S/carol.eye/copied", [("origin", origin("carol", 1))]);
        let removal = Commit::removal("S/eye/gone".parse().unwrap(), 1);
        assert!(alice.commit_now(vec![removal]).is_ok());
        for entity in ["same", "older"] {
            put(&bob, &format!("S/alice.eye/{entity}"), [("origin", origin("alice", 1))]);
        }
        put(&bob, "S/alice.b.eye/new", [("origin", origin("alice.b", 1))]);
        let following = |segments: &[&str]| {
            Following::new("alice", segments.iter().map(|name| (*name).to_owned()).collect())
        };
        for (segments, expected) in [(&["S"][..], (2, 2, 3)), (&["S", "*"], (2, 3, 4)), (&["U"], (0, 0, 0))] {
            let found = behind(&bob, &alice, &following(segments)).await.unwrap();
            assert_eq!((found.entities, found.behind, found.versions), expected, "{segments:?}");
        }
    }
}

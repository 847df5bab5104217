//! How far a memory is behind those that it follows.

use std::collections::BTreeMap;
use std::io::Write;

use armarium_memoryx::{Memory, Pattern, Query, RemoteMemory, Snapshot};
use armarium_values::Value;
use serde_json::json;

use super::reach::{OpenedMemory, wall_clock_ns};
use super::{CommandFailure, MemoryArgs};

/// What is followed of another agent.
#[derive(Default)]
struct Followed {
    /// The newest version that has come, by core segment, provider segment and entity there.
    versions: BTreeMap<(String, String, String), u64>,
    missed: u64,
}

/// Prints, for each agent that is followed, how many entities are behind, by how much, and how far apart the clocks are. Returns whether none is
/// behind.
pub(super) async fn lag(
    reached: &OpenedMemory,
    args: &MemoryArgs,
    out: &mut dyn Write,
) -> Result<bool, CommandFailure> {
    let OpenedMemory::Agent { session, .. } = reached else {
        return Err(CommandFailure::Argument(
            "only a running agent follows others: give --agent instead of --store".into(),
        ));
    };
    let mut agents: BTreeMap<String, Followed> = BTreeMap::new();
    let take = |snapshot: &Snapshot| {
        note(snapshot, &mut agents);
        Ok(())
    };
    let all = Query { removed: true, ..Query::latest(Pattern::any()) };
    reached.each(all, take).await?;
    if agents.is_empty() && !args.json {
        writeln!(out, "`{}` follows nobody, or nothing has come yet", args.agent)?;
    } else if !args.json {
        let titles = ["entities", "behind", "versions", "since, s", "missed", "clock ahead, s"];
        writeln!(out, "{:<24} {}", "follows", titles.map(|title| format!("{title:>15}")).concat())?;
    }
    let mut up_to_date = true;
    for (agent, followed) in agents {
        let leader = match RemoteMemory::connect(session, &agent).await {
            Ok(leader) => leader,
            Err(error) => {
                up_to_date = false;
                match args.json {
                    true => writeln!(out, "{}", json!({"follows": agent, "error": error.to_string()}))?,
                    false => writeln!(out, "{agent:<24} {error}; --connect has to reach it, too")?,
                }
                continue;
            }
        };
        let clock_s = leader.clock_ahead_s(wall_clock_ns).await?;
        let heads = leader.heads(&Pattern::any()).await?;
        let (mut behind, mut versions, mut since_ns) = (0, 0, None);
        for head in &heads.entities {
            let id = [head.id.segment(), head.id.provider(), head.id.entity()].map(str::to_owned).into();
            let Some(have) = followed.versions.get(&id).filter(|have| **have < head.version) else {
                continue;
            };
            behind += 1;
            versions += head.version - have;
            since_ns = Some(since_ns.map_or(head.arrived_ns, |oldest: u64| oldest.min(head.arrived_ns)));
        }
        let now_ns = heads.now_ns.unwrap_or(heads.until_ns);
        let since_s = since_ns.map_or(0.0, |since| now_ns.saturating_sub(since) as f64 * 1e-9);
        up_to_date &= behind == 0;
        let (entities, missed) = (followed.versions.len(), followed.missed);
        match args.json {
            true => writeln!(
                out,
                "{}",
                json!({"follows": agent, "entities": entities, "behind": behind, "versions": versions,
                    "since_s": since_s, "missed": missed, "clock_ahead_s": clock_s})
            )?,
            false => writeln!(
                out,
                "{agent:<24} {entities:>15}{behind:>15}{versions:>15}{since_s:>15.3}{missed:>15}{:>15}",
                clock_s.map_or_else(|| "?".to_owned(), |clock| format!("{clock:.3}"))
            )?,
        }
    }
    Ok(up_to_date)
}

/// Notes where a snapshot came from, if another agent's memory is followed by it.
fn note(snapshot: &Snapshot, agents: &mut BTreeMap<String, Followed>) {
    let Some(origin) = snapshot.attribute("origin") else { return };
    let text = |name: &str| origin.get(name).and_then(Value::as_str).map(str::to_owned);
    let number = |name: &str| origin.get(name).and_then(Value::as_int).and_then(|n| u64::try_from(n).ok());
    let (Some(agent), Some(provider), Some(version)) = (text("agent"), text("provider"), number("version"))
    else {
        return;
    };
    let followed = agents.entry(agent).or_default();
    followed.missed += number("missed").unwrap_or(0);
    followed.versions.insert((snapshot.id.segment().into(), provider, snapshot.id.entity().into()), version);
}

//! `armarium memory serve`: runs the memory of an agent as a process of its own.

use std::io::Write;
use std::path::PathBuf;
use std::sync::Arc;

use armarium_knowledge::{AgentMemory, Followee, MemoryConfig, PriorKnowledge};
use armarium_memoryx::{Policies, Policy};
use clap::Args;

use super::reach::USUAL_ENDPOINT;
use super::{CommandFailure, Inferences, LOCAL, MemoryArgs, keep};
use crate::connection_args::AccessArgs;
use crate::render_findings::lines;
use crate::stopped::stopped;
use armarium_host::connection::take_name;

#[derive(Clone, Debug, Args)]
pub(super) struct MemoryServeArgs {
    /// The agent's name.
    #[arg(long, default_value = LOCAL)]
    name: String,
    #[command(flatten)]
    access: AccessArgs,
    /// A folder of prior knowledge: object classes and scenes, one YAML file each.
    #[arg(long, value_name = "DIR")]
    prior: Option<PathBuf>,
    /// Draw conclusions whenever memory has changed; may be repeated.
    #[arg(long, value_name = "WHAT")]
    infer: Vec<Inferences>,
    /// An agent whose memory is followed as soon as it is available: its `ObjectInstances` and `ObjectRelations`, or the
    /// named core segment (`*`: all of them); may be repeated.
    #[arg(long, value_name = "AGENT[:SEGMENT]")]
    follow: Vec<Followee>,
    /// Fuse followed objects into this provider segment of `ObjectInstances`.
    #[arg(long, value_name = "PROVIDER")]
    fuse_into: Option<String>,
    /// How many newest snapshots working memory holds of each entity.
    #[arg(long, default_value_t = 32, value_parser = at_least_one)]
    history: usize,
    #[command(flatten)]
    kept: keep::KeepArgs,
}

/// Runs until Ctrl-C or the system's request to end.
pub(super) async fn serve(
    args: &MemoryArgs,
    serve: &MemoryServeArgs,
    out: &mut dyn Write,
) -> Result<u8, CommandFailure> {
    if args.agent != LOCAL {
        let what =
            format!("--agent names a memory that runs already; one that is to run has --name {}", args.agent);
        return Err(CommandFailure::Argument(what));
    }
    let mut connection = args.connection.clone();
    if connection.listen.is_empty() {
        connection.listen = vec![USUAL_ENDPOINT.into()];
    }
    let access = serve.access.of(&serve.name);
    let mut config = MemoryConfig::new(&serve.name);
    config.access.clone_from(&access);
    config.infer = serve.infer.iter().map(|what| what.inference()).collect();
    if let Some(folder) = &serve.prior {
        config.prior = PriorKnowledge::load(folder).map_err(|findings| {
            CommandFailure::Argument(format!("prior knowledge cannot be used:\n{}", lines(&findings)))
        })?;
    }
    config.policies =
        serve.kept.policies(Policies::all(Policy::Everything)).map_err(CommandFailure::Argument)?;
    if let (Some(option), None) = (serve.kept.given(), &args.store) {
        return Err(CommandFailure::Argument(format!(
            "{option} says what a file keeps: name the file with --store"
        )));
    }
    config.store.clone_from(&args.store);
    config.limits.history = serve.history;
    config.retention = serve.kept.retention().map_err(CommandFailure::Argument)?;
    config.follow.clone_from(&serve.follow);
    config.fuse_into.clone_from(&serve.fuse_into);
    let session = connection.session(access.as_ref()).await?;
    let _alive = take_name(&session, &serve.name).await?;
    let clock = session.clone();
    let agent = AgentMemory::open(config, Arc::new(move || clock.now_ns()))?;
    let served = agent.share(&session).await?;
    let endpoints = session.endpoints().await.join(" ");
    let kept = args.store.as_ref().map_or_else(|| "not kept".into(), |f| format!("kept in {}", f.display()));
    // Of a large file, working memory has only a part so far.
    let stored = agent.store().map_or(Ok(0), |store| store.stats().map(|stats| stats.entities))?;
    let entities = stored.max(agent.memory().len() as u64);
    writeln!(out, "memory of `{}` at {endpoints}, {entities} entities, {kept}; Ctrl-C ends it", serve.name)?;
    out.flush()?;
    stopped().await;
    drop((served, agent));
    // If the session cannot be closed, it ends with the process.
    let _ = session.close().await.is_ok();
    Ok(0)
}

fn at_least_one(text: &str) -> Result<usize, String> {
    text.parse().ok().filter(|n| *n > 0).ok_or_else(|| "it is a whole number from 1".into())
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;
    use crate::connection_args::ConnectionArgs;

    #[derive(Parser)]
    struct Program {
        #[command(flatten)]
        serve: MemoryServeArgs,
        #[command(flatten)]
        _connection: ConnectionArgs,
    }

    #[test]
    fn whom_to_follow_is_an_agent_and_a_segment() {
        let read = |text: &str| {
            Program::try_parse_from(["serve", "--follow", text]).map(|read| read.serve.follow[0].clone())
        };
        let all_of_alice = Followee { agent: "alice".into(), segment: Some("*".into()) };
        assert_eq!(read("alice:*").ok(), Some(all_of_alice));
        assert_eq!(read("alice").ok(), Some(Followee::of("alice")));
        assert!(read("a/b").is_err() && read("alice:").is_err());
    }
}

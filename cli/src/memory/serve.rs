//! `armarium memory serve`: the memory of an agent as a process of its own.

use std::io::Write;
use std::path::PathBuf;

use armarium_memoryx::{
    AgentConfig, AgentMemory, FollowSettings, Pattern, PriorKnowledge, Retention, check_name,
};
use clap::Args;

use super::reach::USUAL_ENDPOINT;
use super::{Failure, Inferences, MemoryArgs, keep};
use crate::connection::AccessArgs;

#[derive(Clone, Debug, Args)]
pub(super) struct ServeArgs {
    /// The agent's name.
    #[arg(long, default_value = "local")]
    name: String,
    #[command(flatten)]
    access: AccessArgs,
    /// A folder of prior knowledge: object classes and scenes, a YAML file each.
    #[arg(long, value_name = "DIR")]
    prior: Option<PathBuf>,
    /// Conclude something whenever memory has changed; may be repeated.
    #[arg(long, value_name = "WHAT")]
    infer: Vec<Inferences>,
    /// What to follow of others, `AGENT` or `AGENT:SEGMENT`; may be repeated.
    #[arg(long, value_name = "AGENT[:SEGMENT]")]
    follow: Vec<String>,
    /// Fuse followed objects into this provider segment of `ObjectInstances`.
    #[arg(long, value_name = "PROVIDER")]
    fuse_into: Option<String>,
    /// What of a core segment the file keeps: `everything`, `nothing`, `on-change`, `at-most:HZ` or `named:NAME+NAME`; with `,jpeg` or
    /// `,jpeg:QUALITY` its images become JPEG files there. The segment `*` is all others. May be repeated; everything is kept
    /// where nothing is said.
    #[arg(long, value_name = "SEGMENT=POLICY")]
    keep: Vec<String>,
    /// How many newest snapshots working memory holds of each entity.
    #[arg(long, default_value_t = 32)]
    history: usize,
    /// How long long-term memory keeps snapshots, days; for ever if not given.
    #[arg(long, value_name = "DAYS", allow_negative_numbers = true)]
    days: Option<f64>,
    /// Most megabytes that long-term memory keeps.
    #[arg(long, value_name = "MB", allow_negative_numbers = true)]
    megabytes: Option<f64>,
}

/// Runs until Ctrl-C.
pub(super) async fn serve(args: &MemoryArgs, serve: &ServeArgs, out: &mut dyn Write) -> Result<u8, Failure> {
    let mut connection = args.connection.clone();
    if connection.listen.is_empty() {
        connection.listen = vec![USUAL_ENDPOINT.into()];
    }
    let access = serve.access.of(&serve.name);
    let mut config = AgentConfig::new(&serve.name);
    config.guarded = access.is_some();
    config.infer = serve.infer.iter().map(|what| what.inference()).collect();
    if let Some(folder) = &serve.prior {
        config.prior = PriorKnowledge::load(folder).map_err(|error| Failure::Argument(error.to_string()))?;
    }
    config.policies = keep::policies(&serve.keep)?;
    if !serve.keep.is_empty() && args.store.is_none() {
        return Err(Failure::Argument("--keep says what a file keeps: name the file with --store".into()));
    }
    config.store.clone_from(&args.store);
    config.limits.history = serve.history;
    config.retention = retention(serve.days, serve.megabytes)?;
    config.follow = serve.follow.iter().map(|follow| settings(serve, follow)).collect::<Result<_, _>>()?;
    let session = connection.session(access.as_ref()).await?;
    let agent = AgentMemory::start(&session, config).await?;
    let endpoints = session.endpoints().await.join(" ");
    let kept = args.store.as_ref().map_or_else(|| "not kept".into(), |f| format!("kept in {}", f.display()));
    writeln!(
        out,
        "memory of `{}` at {endpoints}, {} entities, {kept}; Ctrl-C ends it",
        serve.name,
        agent.memory().len()
    )?;
    out.flush()?;
    tokio::signal::ctrl_c().await?;
    drop(agent);
    // A session that cannot be closed ends with the process.
    let _ = session.close().await.is_ok();
    Ok(0)
}

fn settings(serve: &ServeArgs, follow: &str) -> Result<FollowSettings, Failure> {
    let (agent, pattern) = match follow.split_once(':') {
        Some((agent, segment)) => (agent, Pattern::segment(segment)),
        None => (follow, Pattern::any()),
    };
    check_name(agent)?;
    Ok(FollowSettings {
        own: serve.name.clone(),
        agent: agent.into(),
        pattern,
        fuse_into: serve.fuse_into.clone(),
    })
}

/// How much is kept, from days and megabytes.
pub(super) fn retention(days: Option<f64>, megabytes: Option<f64>) -> Result<Retention, Failure> {
    let scaled = |number: Option<f64>, unit: f64, what: &str| match number {
        Some(n) if !n.is_finite() || n < 0.0 => Err(Failure::Argument(format!("{what} cannot be {n}"))),
        number => Ok(number.map(|n| (n * unit) as u64)),
    };
    Ok(Retention { age_ns: scaled(days, 86_400e9, "days")?, bytes: scaled(megabytes, 1e6, "megabytes")? })
}

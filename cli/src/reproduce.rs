//! `armarium reproduce NAME`: runs an experiment of the papers, and writes its figures as JSON and its plots as SVG.

use std::io::{self, Write};
use std::path::PathBuf;

use armarium_experiments::{Entry, ExperimentError, ExperimentResult, SettingInfo, all, save};
use armarium_values::expr::nearest;

#[derive(Clone, Debug, clap::Args)]
#[command(after_long_help = long_listing())]
pub(crate) struct ReproduceArgs {
    /// The experiment; without it all are listed.
    #[arg(value_name = "NAME")]
    pub(crate) name: Option<String>,
    /// A setting, for instance `gamma=50`, `o=1.8,-0.6` or `psi=pi/4`; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE", value_parser = split)]
    pub(crate) settings: Vec<(String, String)>,
    /// Folder for NAME.json and the plots; created if it does not exist.
    #[arg(long, value_name = "DIR", default_value = "reproduced")]
    pub(crate) out: PathBuf,
}

/// `key=value` of a command line.
fn split(text: &str) -> Result<(String, String), String> {
    let (key, value) = text.split_once('=').ok_or("write it as KEY=VALUE")?;
    Ok((key.trim().to_owned(), value.trim().to_owned()))
}

/// Runs the experiment. Returns the exit status: 0, 1 when it fails, 2 when its name or a setting is invalid.
pub(crate) fn run(args: &ReproduceArgs, out: &mut dyn Write) -> io::Result<u8> {
    let entries = all();
    let Some(name) = &args.name else {
        write!(out, "{}", listing(&entries))?;
        return Ok(0);
    };
    let Some(entry) = entries.iter().find(|entry| entry.name == *name) else {
        let hint = nearest(name, entries.iter().map(|entry| entry.name));
        let hint =
            hint.map_or("`armarium reproduce` lists them".to_owned(), |n| format!("did you mean `{n}`?"));
        writeln!(out, "error: there is no experiment `{name}`: {hint}")?;
        return Ok(2);
    };
    match entry.run(&args.settings) {
        Ok((inputs, found)) => {
            let files = save(&args.out, entry.name, inputs, &found)?;
            summarise(entry.name, &found, &files, out)?;
            Ok(0)
        }
        Err(error) => {
            writeln!(out, "error: {name}: {error}")?;
            Ok(if matches!(error, ExperimentError::Setting { .. }) { 2 } else { 1 })
        }
    }
}

/// Prints the figures that are short enough for a terminal, and where the others are.
fn summarise(name: &str, found: &ExperimentResult, files: &[PathBuf], out: &mut dyn Write) -> io::Result<()> {
    writeln!(out, "{name}")?;
    for (figure, value) in &found.figures {
        let text = value.to_string();
        let text = if text.len() > 90 { "(in the JSON)" } else { &text };
        writeln!(out, "    {figure:<28} {text}")?;
    }
    for file in files {
        writeln!(out, "wrote {}", file.display())?;
    }
    Ok(())
}

fn listing(entries: &[Entry]) -> String {
    let mut text =
        "Experiments of the papers; `armarium reproduce --help` lists their settings.\n".to_owned();
    for entry in entries {
        text += &format!("    {:<18} {}\n", entry.name, entry.about);
    }
    text
}

fn long_listing() -> String {
    let mut text = "Experiments and their settings with defaults:\n".to_owned();
    for entry in all() {
        text += &format!("\n  {}: {}\n", entry.name, entry.about);
        for SettingInfo { name, default, doc } in &entry.keys {
            text += &format!("    {:<30} {doc}\n", format!("{name}={default}"));
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reproduce(name: Option<&str>, settings: &[(&str, &str)]) -> (u8, String) {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let settings = settings.iter().map(|(k, v)| ((*k).to_owned(), (*v).to_owned())).collect();
        let args = ReproduceArgs { name: name.map(str::to_owned), settings, out: folder.path().to_owned() };
        let mut out = Vec::new();
        let status = run(&args, &mut out).expect("memory can be written");
        (status, String::from_utf8(out).expect("text is UTF-8"))
    }

    #[test]
    fn experiments_are_listed() {
        let (status, text) = reproduce(None, &[]);
        assert_eq!(status, 0);
        assert!(all().iter().all(|entry| text.contains(entry.name)), "{text}");
    }

    #[test]
    fn a_wrong_name_or_setting_is_refused_with_a_suggestion() {
        for entry in all() {
            let (status, text) = reproduce(Some(&format!("{}x", entry.name)), &[]);
            assert_eq!(status, 2);
            assert!(text.contains(&format!("did you mean `{}`?", entry.name)), "{text}");
        }
        assert_eq!(reproduce(Some("flying"), &[]).0, 2);
        assert_eq!(reproduce(Some("servo"), &[("gian", "1")]).0, 2);
    }
}

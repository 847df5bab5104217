//! `armarium new DIR`: creates a chart, a world and a test to start from. Never overwrites a file.

use std::fs::{self, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// Arguments of `new`.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct NewArgs {
    /// The folder to write into; it is created if it does not exist.
    #[arg(value_name = "DIR")]
    pub(crate) dir: PathBuf,
}

/// Name and contents of each file; `NAME` stands for the chart's name.
const FILES: [(&str, &str); 5] = [
    ("chart.yaml", include_str!("template/chart.yaml")),
    ("chart.test.yaml", include_str!("template/chart.test.yaml")),
    ("world.yaml", include_str!("template/world.yaml")),
    ("test.sh", include_str!("template/test.sh")),
    ("README.md", include_str!("template/README.md")),
];

/// Writes the files and prints what to do with them. Returns the exit status: 2 when one of the files exists or
/// cannot be written, otherwise 0.
///
/// # Errors
/// When `out` cannot be written.
pub(crate) fn run(args: &NewArgs, out: &mut dyn Write) -> io::Result<u8> {
    let dir = &args.dir;
    if let Some((name, _)) = FILES.iter().find(|(name, _)| dir.join(name).exists()) {
        writeln!(out, "`{}` exists already; nothing was written", dir.join(name).display())?;
        return Ok(2);
    }
    if let Err(error) = write_all(dir) {
        writeln!(out, "cannot write into `{}`: {error}", dir.display())?;
        return Ok(2);
    }
    let shown = dir.display();
    writeln!(out, "wrote {shown}/chart.yaml, chart.test.yaml, world.yaml, test.sh and README.md; try")?;
    writeln!(out, "    armarium test {shown}/chart.test.yaml")?;
    writeln!(out, "    armarium run {shown}/chart.yaml --world {shown}/world.yaml")?;
    Ok(0)
}

fn write_all(dir: &Path) -> io::Result<()> {
    let chart = chart_name(dir);
    fs::create_dir_all(dir)?;
    for (name, text) in FILES {
        let path = dir.join(name);
        let mut file = OpenOptions::new().write(true).create_new(true).open(&path)?;
        file.write_all(text.replace("NAME", &chart).as_bytes())?;
        if name.ends_with(".sh") {
            make_executable(&path)?;
        }
    }
    Ok(())
}

#[cfg(unix)]
fn make_executable(path: &Path) -> io::Result<()> {
    use std::os::unix::fs::PermissionsExt as _;
    fs::set_permissions(path, fs::Permissions::from_mode(0o755))
}

#[cfg(not(unix))]
fn make_executable(_: &Path) -> io::Result<()> {
    Ok(())
}

/// The folder's name as a chart's name: `my-first chart` becomes `MyFirstChart`.
fn chart_name(dir: &Path) -> String {
    let folder = dir.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let words = folder.split(|c: char| !c.is_ascii_alphanumeric()).filter(|word| !word.is_empty());
    let name: String = words.map(|word| word[..1].to_ascii_uppercase() + &word[1..]).collect();
    match name.chars().next() {
        Some(first) if first.is_ascii_alphabetic() => name,
        _ => format!("Chart{name}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn new(dir: &Path) -> (u8, String) {
        let mut out = Vec::new();
        let status = run(&NewArgs { dir: dir.to_owned() }, &mut out).expect("memory can be written");
        (status, String::from_utf8(out).expect("text is UTF-8"))
    }

    #[test]
    fn names_of_folders_become_names_of_charts() {
        for (folder, name) in
            [("my-first chart", "MyFirstChart"), ("2nd", "Chart2nd"), ("..", "Chart"), ("é", "Chart")]
        {
            assert_eq!(chart_name(Path::new(folder)), name);
        }
    }

    #[test]
    fn what_is_there_is_left_as_it_is() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let dir = folder.path().join("demo");
        assert_eq!(new(&dir).0, 0);
        let chart = dir.join("chart.yaml");
        assert!(fs::read_to_string(&chart).expect("it was written").contains("statechart: Demo\n"));
        fs::remove_file(dir.join("world.yaml")).expect("it was written");
        fs::write(&chart, "mine").expect("it can be written");
        let (status, text) = new(&dir);
        assert_eq!(status, 2);
        assert!(text.contains("chart.yaml` exists already"), "{text}");
        assert!(!dir.join("world.yaml").exists());
        assert_eq!(fs::read_to_string(&chart).expect("it is there"), "mine");
    }

    #[test]
    fn the_world_is_in_order() {
        let text =
            FILES.iter().find(|(name, _)| *name == "world.yaml").map(|(_, text)| *text).unwrap_or_default();
        let world = armarium_simulator::World::parse(Path::new("world.yaml"), text);
        assert!(world.is_ok(), "{world:?}");
    }
}

//! `armarium new DIR`: creates a chart, a world and a test to start from; with `--skill`, a crate with a skill of one's own. Never
//! overwrites a file.

use std::fs::{self, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use armarium_editor::FileKind;

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct NewArgs {
    /// The folder to write into; it is created if it does not exist.
    #[arg(value_name = "DIR")]
    pub(crate) dir: PathBuf,
    /// Writes a Rust crate with a skill, its test, and a program that has it beside the shipped skills.
    #[arg(long)]
    pub(crate) skill: bool,
    /// The folder of Armarium's sources, on which that crate depends.
    #[arg(long, value_name = "DIR", requires = "skill", default_value = concat!(env!("CARGO_MANIFEST_DIR"), "/.."))]
    pub(crate) armarium: PathBuf,
}

/// Name and contents of each file; `NAME` stands for the chart's name.
const CHART: &[(&str, &str)] = &[
    ("chart.yaml", include_str!("template/chart.yaml")),
    ("chart.test.yaml", include_str!("template/chart.test.yaml")),
    ("chart.world.yaml", include_str!("template/world.yaml")),
    ("test.sh", include_str!("template/test.sh")),
    ("README.md", include_str!("template/README.md")),
];

/// The files of a skill; `NAME` is its name, `CRATE` the crate's, `ARMARIUM` the folder of Armarium's sources.
const SKILL: &[(&str, &str)] = &[
    ("Cargo.toml", include_str!("template/skill/Cargo.toml.txt")),
    ("src/lib.rs", include_str!("template/skill/lib.rs.txt")),
    ("src/main.rs", include_str!("template/skill/main.rs.txt")),
    ("chart.yaml", include_str!("template/skill/chart.yaml")),
    ("README.md", include_str!("template/skill/README.md")),
];

/// The schemas that the files of a chart name, for editors without a language server.
const SCHEMAS: [(&str, FileKind); 5] = [
    (".schema/chart.json", FileKind::Chart),
    (".schema/test.json", FileKind::Test),
    (".schema/world.json", FileKind::World),
    (".schema/object.json", FileKind::Object),
    (".schema/scene.json", FileKind::Scene),
];

/// Writes the files and prints what to do with them. Returns the exit status: 2 when one of the files exists or
/// cannot be written, otherwise 0.
pub(crate) fn run(args: &NewArgs, out: &mut dyn Write) -> io::Result<u8> {
    let dir = &args.dir;
    let files = if args.skill { SKILL } else { CHART };
    if let Some((name, _)) = files.iter().find(|(name, _)| dir.join(name).exists()) {
        writeln!(out, "`{}` exists already; nothing was written", dir.join(name).display())?;
        return Ok(2);
    }
    let armarium = match args.armarium.canonicalize() {
        Ok(folder) if !args.skill || folder.join("host/Cargo.toml").exists() => folder,
        _ if !args.skill => PathBuf::new(),
        _ => {
            let shown = args.armarium.display();
            writeln!(
                out,
                "`{shown}` does not hold Armarium's sources: name their folder with `--armarium DIR`"
            )?;
            return Ok(2);
        }
    };
    let written = if args.skill { Ok(()) } else { write_schemas(dir) };
    if let Err(error) = written.and_then(|()| write_all(dir, files, &armarium)) {
        writeln!(out, "cannot write into `{}`: {error}", dir.display())?;
        return Ok(2);
    }
    let (shown, names) = (dir.display(), files.iter().map(|(name, _)| *name).collect::<Vec<_>>().join(", "));
    writeln!(out, "wrote {names} into {shown}; try")?;
    if args.skill {
        writeln!(out, "    cd {shown} && cargo test")?;
        writeln!(out, "    cd {shown} && cargo run --release -- chart.yaml")?;
    } else {
        writeln!(out, "    armarium test {shown}/chart.test.yaml")?;
        writeln!(out, "    armarium run {shown}/chart.yaml")?;
    }
    Ok(0)
}

fn write_schemas(dir: &Path) -> io::Result<()> {
    fs::create_dir_all(dir.join(".schema"))?;
    let registry = armarium_host::catalog::idle_registry();
    for (name, kind) in SCHEMAS {
        let text = serde_json::to_string_pretty(&kind.schema(&registry))?;
        fs::write(dir.join(name), text + "\n")?;
    }
    Ok(())
}

fn write_all(dir: &Path, files: &[(&str, &str)], armarium: &Path) -> io::Result<()> {
    let name = chart_name(dir);
    let crate_name = crate_name(&name);
    for (file, text) in files {
        let path = dir.join(file);
        fs::create_dir_all(path.parent().unwrap_or(dir))?;
        let text = text
            .replace("CRATE_NAME", &crate_name.replace('-', "_"))
            .replace("CRATE", &crate_name)
            .replace("ARMARIUM/", &format!("{}/", armarium.display()))
            .replace("NAME", &name);
        OpenOptions::new().write(true).create_new(true).open(&path)?.write_all(text.as_bytes())?;
        if file.ends_with(".sh") {
            make_executable(&path)?;
        }
    }
    Ok(())
}

/// `MyFirstSkill` as the name of a crate: `my-first-skill`.
fn crate_name(name: &str) -> String {
    let mut result = String::new();
    for c in name.chars() {
        if c.is_ascii_uppercase() && !result.is_empty() {
            result.push('-');
        }
        result.push(c.to_ascii_lowercase());
    }
    result
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
        let status = run(&NewArgs { dir: dir.to_owned(), skill: false, armarium: PathBuf::new() }, &mut out)
            .expect("memory can be written");
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
        fs::remove_file(dir.join("chart.world.yaml")).expect("it was written");
        fs::write(&chart, "mine").expect("it can be written");
        let (status, text) = new(&dir);
        assert_eq!(status, 2);
        assert!(text.contains("chart.yaml` exists already"), "{text}");
        assert!(!dir.join("chart.world.yaml").exists());
        assert_eq!(fs::read_to_string(&chart).expect("it is there"), "mine");
    }

    #[test]
    fn every_file_names_a_schema_that_is_there() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let dir = folder.path().join("demo");
        assert_eq!(new(&dir).0, 0);
        for (file, _) in CHART.iter().filter(|(name, _)| name.ends_with(".yaml")) {
            let text = fs::read_to_string(dir.join(file)).expect("it was written");
            let schema =
                text.lines().next().and_then(|line| line.strip_prefix("# yaml-language-server: $schema="));
            let schema = fs::read_to_string(dir.join(schema.expect("the first line names a schema")));
            let schema: serde_json::Value =
                serde_json::from_str(&schema.expect("it is there")).expect("it is JSON");
            assert_eq!(schema["type"], "object", "{file}");
        }
    }

    #[test]
    fn the_world_is_in_order() {
        let text = CHART
            .iter()
            .find(|(name, _)| *name == "chart.world.yaml")
            .map(|(_, text)| *text)
            .unwrap_or_default();
        let world = armarium_simulator::World::parse(Path::new("world.yaml"), text);
        assert!(world.is_ok(), "{world:?}");
    }
}

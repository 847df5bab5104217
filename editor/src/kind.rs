//! The kinds of files that are understood, and how each is checked: `armarium check` and the language server both do it here.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use armarium_knowledge::prior;
use armarium_robot::description::{self, RobotFile};
use armarium_runtime::chart::{self, ChannelSchema, Library, Registry};
use armarium_runtime::test_cases::TestFile;
use armarium_simulator::World;
use armarium_source::{Files, Finding, Source, outermost};
use serde_json::Value as Json;

/// A kind of file that people write.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum FileKind {
    /// A statechart.
    Chart,
    /// A world of the simulator.
    World,
    /// Test cases of a chart.
    Test,
    /// An object class of prior knowledge.
    Object,
    /// A scene of prior knowledge.
    Scene,
    /// A robot file.
    Robot,
}

/// The skills and channels that charts may name.
#[derive(Clone, Debug)]
pub struct Catalog {
    /// The skills.
    pub registry: Registry,
    /// The channels.
    pub channels: ChannelSchema,
}

/// What checking a file gave.
#[derive(Debug)]
pub struct CheckedFile {
    /// Everything that is wrong, also in files that it names.
    pub findings: Vec<Finding>,
    /// Of a chart: the chart with the charts that it names.
    pub library: Option<Library>,
}

impl FileKind {
    /// Every kind with the key that its files begin with.
    pub const ALL: [(Self, &'static str); 6] = [
        (Self::Chart, "statechart"),
        (Self::World, "world"),
        (Self::Test, "test"),
        (Self::Scene, "scene"),
        (Self::Object, "object"),
        // Worlds have a `robot` too, and say that they are worlds.
        (Self::Robot, "robot"),
    ];

    /// What it is called.
    #[must_use]
    pub fn called(self) -> &'static str {
        match self {
            Self::Chart => "a statechart",
            Self::World => "a world of the simulator",
            Self::Test => "test cases of a chart",
            Self::Object => "an object class of prior knowledge",
            Self::Scene => "a scene of prior knowledge",
            Self::Robot => "a robot file",
        }
    }

    /// What a file is: by a key at its outermost level, or else by its name (`x.world.yaml`, `x.test.yaml`) or by what
    /// charts of other languages begin with. None where nothing says it.
    #[must_use]
    pub fn of(path: &Path, text: &str) -> Option<Self> {
        let has = |key: &str| outermost(text, key).is_some();
        let said = Self::ALL.into_iter().find(|(_, key)| has(key)).map(|(kind, _)| kind);
        let name = path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
        let named = || match name.rsplit_once('.')?.0 {
            stem if stem.ends_with(".world") => Some(Self::World),
            stem if stem.ends_with(".test") => Some(Self::Test),
            _ => None,
        };
        let begun = || {
            let first =
                text.trim_start().get(..10).is_some_and(|word| word.eq_ignore_ascii_case("statechart"));
            (first || has("states") && has("initial")).then_some(Self::Chart)
        };
        said.or_else(named).or_else(begun)
    }

    /// The JSON Schema of its files.
    #[must_use]
    pub fn schema(self, registry: &Registry) -> Json {
        match self {
            Self::Chart => chart::schema(registry),
            Self::World => World::schema(),
            Self::Test => armarium_source::schema::<TestFile>(),
            Self::Object => prior::file::schema(),
            Self::Scene => prior::scene::schema(),
            Self::Robot => armarium_source::schema::<RobotFile>(),
        }
    }
}

/// Finds everything that is wrong with a file: what it says it is, and otherwise as a chart.
///
/// `folders` are those where charts find other charts besides their own. A file that cannot be read is a finding.
#[must_use]
pub fn check(path: &Path, folders: &[PathBuf], files: &dyn Files, catalog: &Catalog) -> CheckedFile {
    match files.read(path) {
        Err(finding) => CheckedFile { findings: vec![*finding], library: None },
        Ok(source) => {
            let kind = FileKind::of(path, &source.text).unwrap_or(FileKind::Chart);
            check_as(kind, source, folders, files, catalog)
        }
    }
}

/// As [`check`], of a text that is known to be of a kind.
#[must_use]
pub(crate) fn check_as(
    kind: FileKind,
    source: Arc<Source>,
    folders: &[PathBuf],
    files: &dyn Files,
    catalog: &Catalog,
) -> CheckedFile {
    let read = match kind {
        FileKind::Chart => {
            let library = chart::load_from(&source.path.clone(), folders, files);
            let findings = chart::check(&library, &catalog.registry, &catalog.channels).findings;
            return CheckedFile { findings, library: Some(library) };
        }
        FileKind::World => World::read(source, 1).map(drop),
        FileKind::Test => check_test(source, folders, files, catalog),
        FileKind::Robot => return CheckedFile { findings: description::check(source, files), library: None },
        FileKind::Object | FileKind::Scene => Err(prior::file::check(&source, files)),
    };
    CheckedFile { findings: read.err().unwrap_or_default(), library: None }
}

/// A file of test cases by itself, and held against its chart.
fn check_test(
    source: Arc<Source>,
    folders: &[PathBuf],
    files: &dyn Files,
    catalog: &Catalog,
) -> Result<(), Vec<Finding>> {
    let Catalog { registry, channels } = catalog;
    let cases = TestFile::read(Arc::clone(&source))?;
    let programs = cases.programs(&source, folders, files, registry, channels)?;
    let findings = TestFile::check(source, &programs, registry);
    if findings.is_empty() { Ok(()) } else { Err(findings) }
}

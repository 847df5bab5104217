//! Finding and reading chart files: a chart and all charts that it names, each once.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use armarium_source::yaml::{self, Named};
use armarium_source::{Disk, Files, Finding, Findings, Source, Span, code, outermost};

use super::model::{Chart, WrittenKind, WrittenState};
use super::read;
use crate::skill::SkillManifest;

/// A chart with all the charts that it names, as far as they could be read.
#[derive(Clone, Debug)]
pub struct Library {
    /// Name of the chart that was asked for.
    pub root: String,
    /// All charts by name.
    pub charts: BTreeMap<String, Arc<Chart>>,
    /// What is wrong with the files.
    pub findings: Vec<Finding>,
    /// Charts that are stood in for, as skills of the same inputs, outputs and outcomes.
    pub(super) stand_ins: BTreeMap<String, Arc<SkillManifest>>,
}

/// Reads a chart file and, from its folder and then `search_dirs`, all charts that it names.
pub fn load(path: &Path, search_dirs: &[PathBuf]) -> Library {
    load_from(path, search_dirs, &Disk)
}

/// As [`load`], with files that may be other than on the disk.
pub fn load_from(path: &Path, search_dirs: &[PathBuf], files: &dyn Files) -> Library {
    let mut library = unread();
    let source = match files.read(path) {
        Ok(source) => source,
        Err(finding) => {
            library.findings.push(*finding);
            return library;
        }
    };
    for missing in search_dirs.iter().filter(|folder| !folder.is_dir()) {
        let source = Arc::new(Source::new(missing, ""));
        let message = "charts are to be looked for in this folder, but it is not there";
        let help = Some("is the path after `--charts` right?".to_owned());
        library.findings.push(Finding::error(source, code::FILE, Span::default(), message, help));
    }
    let folder = path.parent().map_or_else(PathBuf::new, Path::to_path_buf);
    let mut folders = vec![folder];
    folders.extend(search_dirs.iter().cloned());
    library.add_root(source, &folders, files);
    library
}

fn unread() -> Library {
    Library { root: String::new(), charts: BTreeMap::new(), findings: Vec::new(), stand_ins: BTreeMap::new() }
}

/// Reads a chart from text; the charts that it names are looked for in `search_dirs`.
pub fn load_text(name: &str, text: &str, search_dirs: &[PathBuf]) -> Library {
    let mut library = unread();
    library.add_root(Arc::new(Source::new(name, text)), search_dirs, &Disk);
    library
}

fn parse(source: Arc<Source>) -> (Option<Chart>, Vec<Finding>) {
    let mut findings = Findings::new(source);
    let chart = yaml::parse(&mut findings).and_then(|node| read::chart(&node, &mut findings));
    (chart, findings.list)
}

impl Library {
    /// Makes the states that use one of these charts run a skill of its inputs, outputs and outcomes instead, for tests.
    /// Returns the names that no chart has.
    pub fn stand_in<'n>(&mut self, names: impl IntoIterator<Item = &'n String>) -> Vec<&'n String> {
        let mut missing = Vec::new();
        for name in names {
            match self.charts.get(name).filter(|_| *name != self.root) {
                Some(chart) => {
                    self.stand_ins.insert(name.clone(), Arc::new(chart.manifest()));
                }
                None => missing.push(name),
            }
        }
        missing
    }

    /// What the charts want of other agents, as `agent/Name`.
    pub fn remote_names(&self) -> BTreeSet<String> {
        let mut names = BTreeSet::new();
        self.charts.values().for_each(|chart| named_remotes(&chart.root, &mut names));
        names
    }

    fn add_root(&mut self, source: Arc<Source>, folders: &[PathBuf], files: &dyn Files) {
        let (chart, findings) = parse(source);
        self.findings.extend(findings);
        let Some(chart) = chart else { return };
        self.root.clone_from(&chart.name);
        let chart = Arc::new(chart);
        self.charts.insert(chart.name.clone(), Arc::clone(&chart));
        let mut by_name: Option<BTreeMap<String, Vec<PathBuf>>> = None;
        let mut waiting = vec![chart];
        while let Some(chart) = waiting.pop() {
            let mut names = Vec::new();
            named_charts(&chart.root, &mut names);
            for name in names {
                if self.charts.contains_key(&name.text) {
                    continue;
                }
                let by_name = by_name.get_or_insert_with(|| self::files(folders, files));
                if let Some(found) = self.find(&chart, name, by_name, files) {
                    self.charts.insert(found.name.clone(), Arc::clone(&found));
                    waiting.push(found);
                }
            }
        }
    }

    fn find(
        &mut self,
        user: &Chart,
        name: &Named,
        by_name: &BTreeMap<String, Vec<PathBuf>>,
        files: &dyn Files,
    ) -> Option<Arc<Chart>> {
        let mut findings = Findings::new(Arc::clone(&user.source));
        let found = by_name.get(&name.text).map_or(&[][..], Vec::as_slice);
        let result = match found {
            [] => {
                let help = "charts are looked for in the file's folder and in --charts folders".to_owned();
                let message = format!("there is no chart `{}`", name.text);
                let known = by_name.keys().map(String::as_str);
                findings.unknown(code::CHART, (name.span, &name.text), message, known, Some(help));
                None
            }
            [one] => match files.read(one) {
                Err(finding) => {
                    let message = format!("{}: {}", one.display(), finding.message);
                    findings.error_help(code::FILE, name.span, message, finding.help);
                    None
                }
                Ok(source) => {
                    let (chart, list) = parse(source);
                    self.findings.extend(list);
                    chart.map(Arc::new)
                }
            },
            [one, two, ..] => {
                let message =
                    format!("two charts are called `{}`: {} and {}", name.text, one.display(), two.display());
                findings.error(code::CHART, name.span, message);
                None
            }
        };
        self.findings.extend(findings.list);
        result
    }
}

fn named_remotes(state: &WrittenState, names: &mut BTreeSet<String>) {
    if let WrittenKind::Remote(name) = &state.kind {
        names.insert(name.text.clone());
    }
    state.kind.children().iter().for_each(|child| named_remotes(child, names));
}

fn named_charts<'s>(state: &'s WrittenState, names: &mut Vec<&'s Named>) {
    if let WrittenKind::Chart(name) = &state.kind {
        names.push(name);
    }
    state.kind.children().iter().for_each(|child| named_charts(child, names));
}

/// The chart files of folders by the name of their chart; a name in an earlier folder hides later ones.
#[must_use]
pub fn files(folders: &[PathBuf], files: &dyn Files) -> BTreeMap<String, Vec<PathBuf>> {
    let mut result: BTreeMap<String, Vec<PathBuf>> = BTreeMap::new();
    for folder in folders {
        let mut here: BTreeMap<String, Vec<PathBuf>> = BTreeMap::new();
        for path in files.list(folder) {
            if let Some(name) = files.head(&path).and_then(|head| chart_name(&head)) {
                here.entry(name).or_default().push(path);
            }
        }
        for (name, paths) in here {
            result.entry(name).or_insert(paths);
        }
    }
    result
}

/// The name after `statechart:` at the start of a line.
fn chart_name(head: &str) -> Option<String> {
    outermost(head, "statechart").filter(|name| !name.is_empty()).map(str::to_owned)
}

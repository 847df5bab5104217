//! Finding and reading chart files: a chart and all charts that it names, each once.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use armarium_source::yaml::{self, Named};
use armarium_source::{Finding, Findings, Source, code, suggest};

use super::model::{Chart, Kind, State};
use super::read;

/// A chart with all the charts that it names, as far as they could be read.
#[derive(Clone, Debug)]
pub struct Library {
    /// Name of the chart that was asked for.
    pub root: String,
    /// All charts by name.
    pub charts: BTreeMap<String, Arc<Chart>>,
    /// What is wrong with the files.
    pub findings: Vec<Finding>,
}

/// Reads a chart file and, from its folder and then `search_dirs`, all charts that it names.
#[must_use]
pub fn load(path: &Path, search_dirs: &[PathBuf]) -> Library {
    let mut library = Library { root: String::new(), charts: BTreeMap::new(), findings: Vec::new() };
    let source = match Source::read(path) {
        Ok(source) => source,
        Err(finding) => {
            library.findings.push(*finding);
            return library;
        }
    };
    let folder = path.parent().map_or_else(PathBuf::new, Path::to_path_buf);
    let mut folders = vec![folder];
    folders.extend(search_dirs.iter().cloned());
    library.add_root(source, &folders);
    library
}

/// Reads a chart from text; the charts that it names are looked for in `search_dirs`.
#[must_use]
pub fn load_text(name: &str, text: &str, search_dirs: &[PathBuf]) -> Library {
    let mut library = Library { root: String::new(), charts: BTreeMap::new(), findings: Vec::new() };
    library.add_root(Arc::new(Source::new(name, text)), search_dirs);
    library
}

fn parse(source: Arc<Source>) -> (Option<Chart>, Vec<Finding>) {
    let mut findings = Findings::new(source);
    let chart = yaml::parse(&mut findings).and_then(|node| read::chart(&node, &mut findings));
    (chart, findings.list)
}

impl Library {
    /// What the charts want of other agents, as `agent/Name`.
    #[must_use]
    pub fn remote_names(&self) -> BTreeSet<String> {
        let mut names = BTreeSet::new();
        self.charts.values().for_each(|chart| named_remotes(&chart.root, &mut names));
        names
    }

    fn add_root(&mut self, source: Arc<Source>, folders: &[PathBuf]) {
        let (chart, findings) = parse(source);
        self.findings.extend(findings);
        let Some(chart) = chart else { return };
        self.root.clone_from(&chart.name);
        let chart = Arc::new(chart);
        self.charts.insert(chart.name.clone(), Arc::clone(&chart));
        let mut files: Option<BTreeMap<String, Vec<PathBuf>>> = None;
        let mut waiting = vec![chart];
        while let Some(chart) = waiting.pop() {
            let mut names = Vec::new();
            named_charts(&chart.root, &mut names);
            for name in names {
                if self.charts.contains_key(&name.text) {
                    continue;
                }
                let files = files.get_or_insert_with(|| chart_files(folders));
                if let Some(found) = self.find(&chart, name, files) {
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
        files: &BTreeMap<String, Vec<PathBuf>>,
    ) -> Option<Arc<Chart>> {
        let mut findings = Findings::new(Arc::clone(&user.source));
        let found = files.get(&name.text).map_or(&[][..], Vec::as_slice);
        let result = match found {
            [] => {
                let help = suggest(&name.text, files.keys().map(String::as_str)).unwrap_or_else(|| {
                    "charts are looked for in the file's folder and in --charts folders".into()
                });
                let message = format!("there is no chart `{}`", name.text);
                findings.error_help(code::CHART, name.span, message, Some(help));
                None
            }
            [one] => match Source::read(one) {
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

fn named_remotes(state: &State, names: &mut BTreeSet<String>) {
    if let Kind::Remote(name) = &state.kind {
        names.insert(name.text.clone());
    }
    state.kind.children().iter().for_each(|child| named_remotes(child, names));
}

fn named_charts<'s>(state: &'s State, names: &mut Vec<&'s Named>) {
    if let Kind::Chart(name) = &state.kind {
        names.push(name);
    }
    state.kind.children().iter().for_each(|child| named_charts(child, names));
}

/// The chart files of the folders by the name of their chart; a name in an earlier folder hides later ones.
fn chart_files(folders: &[PathBuf]) -> BTreeMap<String, Vec<PathBuf>> {
    let mut result: BTreeMap<String, Vec<PathBuf>> = BTreeMap::new();
    for folder in folders {
        let place = if folder.as_os_str().is_empty() { Path::new(".") } else { folder.as_path() };
        let Ok(entries) = std::fs::read_dir(place) else { continue };
        let mut paths: Vec<PathBuf> = entries.filter_map(|e| Some(e.ok()?.path())).collect();
        paths.sort();
        let mut here: BTreeMap<String, Vec<PathBuf>> = BTreeMap::new();
        for path in paths {
            // Whatever else has such a name (a pipe, a device) is not opened: that could take for ever.
            if path.extension().is_some_and(|e| e == "yaml" || e == "yml")
                && path.is_file()
                && let Some(name) = chart_name(&path)
            {
                here.entry(name).or_default().push(path);
            }
        }
        for (name, paths) in here {
            result.entry(name).or_insert(paths);
        }
    }
    result
}

/// The name after `statechart:` at the start of a line, without reading the rest of the file.
fn chart_name(path: &Path) -> Option<String> {
    let mut head = Vec::new();
    std::fs::File::open(path).ok()?.take(16_384).read_to_end(&mut head).ok()?;
    let text = String::from_utf8_lossy(&head);
    let rest = text.lines().find_map(|line| line.strip_prefix("statechart:"))?;
    let name = rest.split('#').next().unwrap_or("").trim().trim_matches(['"', '\'']);
    (!name.is_empty()).then(|| name.to_owned())
}

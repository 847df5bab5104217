//! Ranges in files: `{from: 2 kg, to: 3 kg}`, `{from: 1, to: 4, step: 1}` and `{one_of: [red, green]}` stand for one value,
//! which is drawn by a seed. What is drawn is the text itself: everything that reads files reads one without ranges.
//!
//! It does not know which keys a form has, nor what a value means.

use std::sync::Arc;

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng as _, SeedableRng as _};

use armarium_values::{Unit, split_quantity};

use crate::finding::{Finding, Findings};
use crate::form::{Form, read};
use crate::remedy::{Edit, Remedy, applied};
use crate::span::Span;
use crate::text::Source;
use crate::yaml::{self, Named, Node, Yaml};
use crate::{Layout, code};

/// A file in which every range has become a value.
#[derive(Clone, Debug)]
pub struct Drawn {
    written: Arc<Source>,
    drawn: Arc<Source>,
    edits: Vec<Edit>,
}

/// Draws a value for each range of a file. The same seed gives the same values; a range added or removed elsewhere in the file
/// does not change them. A file that is no YAML is left as it is.
///
/// # Errors
/// Every range that gives no value: ends that are no numbers, in different units, or in the wrong order; nothing to choose from.
pub fn draw(source: Arc<Source>, seed: u64) -> Result<Drawn, Vec<Finding>> {
    let mut findings = Findings::new(Arc::clone(&source));
    let mut edits = Vec::new();
    if let Some(tree) = yaml::parse(&mut findings) {
        let layout = source.layout();
        let mut drawing = RandomDraws { layout, seed, findings: &mut findings, edits: &mut edits };
        drawing.node(&tree, &mut String::new());
        if !findings.list.is_empty() {
            return Err(findings.list);
        }
    }
    edits.sort_by_key(|edit: &Edit| edit.span.start);
    let drawn = match edits.is_empty() {
        true => Arc::clone(&source),
        false => Arc::new(Source::new(&source.path, applied(&source.text, &edits))),
    };
    Ok(Drawn { written: source, drawn, edits })
}

impl Drawn {
    /// The text without ranges.
    #[must_use]
    pub fn text(&self) -> &str {
        &self.drawn.text
    }

    /// Reads the file. The places of findings are those in the text with the ranges.
    ///
    /// # Errors
    /// Everything that is wrong with it, in the order of the text.
    pub fn read<F: Form>(&self) -> Result<F, Vec<Finding>> {
        read(Arc::clone(&self.drawn))
            .map_err(|findings| findings.into_iter().map(|f| self.placed(f)).collect())
    }

    fn placed(&self, finding: Finding) -> Finding {
        if self.edits.is_empty() || finding.source.path != self.written.path {
            return finding;
        }
        let remedy = finding.remedy.map(|remedy| match remedy {
            Remedy::Remove(key) => Remedy::Remove(self.written_span(key)),
            Remedy::Replace(edits) => {
                let moved = |edit: Edit| Edit { span: self.written_span(edit.span), ..edit };
                Remedy::Replace(edits.into_iter().map(moved).collect())
            }
            Remedy::Add { owner, sections, key, value } => {
                Remedy::Add { owner: owner.map(|owner| self.written_span(owner)), sections, key, value }
            }
        });
        let (span, source) = (self.written_span(finding.span), Arc::clone(&self.written));
        Finding { span, source, remedy, ..finding }
    }

    /// The place in the written text of a place in the drawn one; a drawn value stands for its whole range.
    fn written_span(&self, span: Span) -> Span {
        let (mut start, mut end) = (span.start, span.end);
        // How much longer the written text is up to an edit.
        let mut longer = 0_isize;
        for edit in &self.edits {
            let at = edit.span.start.saturating_add_signed(-longer);
            let after = at + edit.text.len();
            if span.start >= after {
                start = span.start.saturating_add_signed(longer + edit.longer());
            } else if span.start >= at {
                start = edit.span.start;
            } else {
                start = start.min(span.start.saturating_add_signed(longer));
            }
            if span.end > after {
                end = span.end.saturating_add_signed(longer + edit.longer());
            } else if span.end > at {
                end = edit.span.end;
            }
            if after > span.end {
                break;
            }
            longer += edit.longer();
        }
        Span { start, end: end.max(start) }
    }
}

impl Edit {
    /// How many bytes more the replaced text has.
    fn longer(&self) -> isize {
        (self.span.end - self.span.start) as isize - self.text.len() as isize
    }
}

struct RandomDraws<'d> {
    layout: &'d Layout,
    seed: u64,
    findings: &'d mut Findings,
    edits: &'d mut Vec<Edit>,
}

impl RandomDraws<'_> {
    fn node(&mut self, node: &Node, path: &mut String) {
        let inside = path.len();
        match &node.value {
            Yaml::Map(entries) => {
                let keys: Vec<&str> = entries.iter().map(|(key, _)| key.text.as_str()).collect();
                let value = match keys.as_slice() {
                    ["from", "to"] | ["from", "to", "step"] if is_number(&entries[0].1) => {
                        Some(self.between(node, path))
                    }
                    ["one_of"] => Some(self.one_of(&entries[0].1, path)),
                    _ => None,
                };
                let Some(value) = value else {
                    for (key, node) in entries {
                        path.push('/');
                        path.push_str(&key.text);
                        self.node(node, path);
                        path.truncate(inside);
                    }
                    return;
                };
                if let Some(text) = value {
                    self.edits.push(Edit { span: self.written(entries), text });
                }
            }
            Yaml::List(items) => {
                for (at, item) in items.iter().enumerate() {
                    path.push_str(&format!("/{at}"));
                    self.node(item, path);
                    path.truncate(inside);
                }
            }
            _ => {}
        }
    }

    /// Where a range stands: its braces with what is between them, or its lines.
    fn written(&self, entries: &[(Named, Node)]) -> Span {
        let (first, last) = (entries[0].0.span, entries[entries.len() - 1].0.span);
        let mut around = self.layout.brackets.iter().rev();
        let braces = around.find(|b| b.map && b.open < first.start && b.close.is_some_and(|c| c > last.end));
        let entry =
            |key: Span| self.layout.entries.iter().find(|e| e.key.start <= key.start && key.end <= e.key.end);
        match (entry(first), entry(last), braces.and_then(|b| Some((b.open, b.close?)))) {
            (Some(first), Some(last), _) if !first.flow => Span { start: first.key.start, end: last.end },
            (_, _, Some((open, close))) => Span { start: open, end: close + 1 },
            _ => Span { start: first.start, end: last.end },
        }
    }

    /// A value between two others, with their unit.
    fn between(&mut self, range: &Node, path: &str) -> Option<String> {
        let [from, to, step] = ["from", "to", "step"].map(|key| range.get(key));
        let (from, to) = (self.number(from?)?, self.number(to?)?);
        let step = match step {
            Some(step) => Some(self.number(step)?),
            None => None,
        };
        let units = [Some(&from), Some(&to), step.as_ref()].map(|n| n.map(|n| n.unit.as_str()));
        let mut wrong = |what: &str| {
            self.findings.error(code::VALUE, range.span, what);
            None
        };
        if units.iter().flatten().any(|unit| *unit != from.unit) {
            return wrong("the ends of a range are in one unit");
        }
        if from.value > to.value || step.as_ref().is_some_and(|step| step.value <= 0.0) {
            return wrong("a range goes from the smaller to the larger value, with a step greater than 0");
        }
        let share = share(self.seed, path);
        let value = match step {
            Some(Number { value: step, .. }) => {
                let steps = ((to.value - from.value) / step + 1e-9).floor();
                from.value + (share * (steps + 1.0)).floor().min(steps) * step
            }
            None => from.value + share * (to.value - from.value),
        };
        // Five digits of what the range spans say all that is meant.
        let finest = (to.value - from.value).abs().max(1e-12) / 1e5;
        let decimals = (-libm::log10(finest)).ceil().clamp(0.0, 12.0) as usize;
        let text = format!("{value:.decimals$}");
        let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
        Some(if from.unit.is_empty() { text.to_owned() } else { format!("{text} {}", from.unit) })
    }

    /// One of some values, as it is written.
    fn one_of(&mut self, list: &Node, path: &str) -> Option<String> {
        let items = list.items();
        if items.is_empty() {
            self.findings.error(code::FORM, list.span, "`one_of` is a list of values of which one is drawn");
            return None;
        }
        let at = ((share(self.seed, path) * items.len() as f64) as usize).min(items.len() - 1);
        Some(items[at].literal().to_json().to_string())
    }

    fn number(&mut self, node: &Node) -> Option<Number> {
        let found = match &node.value {
            Yaml::Int(value) => Some(Number { value: *value as f64, unit: String::new() }),
            Yaml::Float(value) => Some(Number { value: *value, unit: String::new() }),
            Yaml::String(text) => quantity(text),
            _ => None,
        };
        if found.is_none() {
            self.findings.form(node, "a number, with its unit if it has one,");
        }
        found
    }
}

/// A number as it is written.
struct Number {
    value: f64,
    unit: String,
}

fn quantity(text: &str) -> Option<Number> {
    let (value, unit) = split_quantity(text)?;
    let known = unit.is_empty() || Unit::parse(unit).is_ok();
    known.then(|| Number { value, unit: unit.to_owned() })
}

fn is_number(node: &Node) -> bool {
    match &node.value {
        Yaml::Int(_) | Yaml::Float(_) => true,
        Yaml::String(text) => quantity(text).is_some(),
        _ => false,
    }
}

/// A number from 0 to 1, by the seed and the place in the tree.
fn share(seed: u64, path: &str) -> f64 {
    // FNV-1a.
    let place = path.bytes().fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    });
    let mut random = ChaCha8Rng::seed_from_u64(seed ^ place);
    (random.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drawn(text: &str, seed: u64) -> String {
        draw(Arc::new(Source::new("w.yaml", text)), seed).expect("the ranges are right").text().to_owned()
    }

    #[test]
    fn a_value_lies_in_its_range_and_the_rest_of_the_text_stays() {
        let text = "a: {mass: {from: 2 kg, to: 3 kg}, n: {from: 1, to: 4, step: 1}} # kept\nb: [{one_of: [red, green]}, 5]\n";
        let mut seen = std::collections::BTreeSet::new();
        for seed in 0..200 {
            let text = drawn(text, seed);
            let rest = text.strip_prefix("a: {mass: ").expect("it begins so");
            let (mass, rest) = rest.split_once(" kg, n: ").expect("the unit is kept");
            assert!((2.0..=3.0).contains(&mass.parse::<f64>().expect("a number")), "{text}");
            let (n, rest) = rest.split_once("} # kept\nb: [\"").expect("the comment is kept");
            seen.insert(n.to_owned());
            assert!(rest == "red\", 5]\n" || rest == "green\", 5]\n", "{text}");
        }
        assert_eq!(seen.into_iter().collect::<Vec<_>>(), ["1", "2", "3", "4"]);
        assert!(drawn("a: {from: 1e3 kg, to: 1e3 kg}\n", 1).starts_with("a: 1000 kg"));
        assert_eq!(drawn(text, 7), drawn(text, 7));
        assert_ne!(drawn(text, 7), drawn(text, 8));
    }

    #[test]
    fn a_range_may_stand_in_lines() {
        let text = "a:\n  from: 3 kg # at least\n  to: 3 kg # at most\nb:\n  - from: 2\n    to: 2\n  - 'one_of': [{c: 1}]\nd: {e: {one_of:\n  [5]}}\n";
        assert_eq!(drawn(text, 1), "a:\n  3 kg # at most\nb:\n  - 2\n  - {\"c\":1}\nd: {e: 5}\n");
    }

    #[test]
    fn draws_spread_evenly() {
        let mean = (0..2000).map(|seed| share(seed, "/a/b")).sum::<f64>() / 2000.0;
        // Three standard errors of a uniform number's mean.
        assert!((mean - 0.5).abs() < 3.0 * 0.2887 / 2000.0_f64.sqrt(), "{mean}");
    }

    #[test]
    fn what_is_no_range_is_left_or_said() {
        for text in ["swipe: {from: [0.2, 0.4], to: [0.3, 0.5]}\n", "a: {from: 1}\n", "a: 1\n", "a: [\n"] {
            assert_eq!(drawn(text, 1), text);
        }
        for (text, said) in [
            ("a: {from: 1 kg, to: 2 N}\n", "1:4 the ends of a range are in one unit"),
            ("a: {from: 3, to: 2}\n", "1:4 a range goes from the smaller"),
            ("a: {from: 1, to: 2, step: 0}\n", "1:4 a range goes from the smaller"),
            (
                "a: {from: 1, to: tall}\n",
                "1:18 a number, with its unit if it has one, is needed here, not text",
            ),
            ("a: {one_of: []}\n", "1:13 `one_of` is a list"),
        ] {
            let findings = draw(Arc::new(Source::new("w.yaml", text)), 1).expect_err(text);
            let (line, column) = findings[0].position();
            assert!(
                format!("{line}:{column} {}", findings[0].message).starts_with(said),
                "{text}: {}",
                findings[0]
            );
        }
    }

    #[test]
    fn places_are_those_of_the_written_text() {
        let text = "a: {from: 1.25, to: 1.5}, \nb: {from: 10 kg, to: 20 kg} c\nd: e\n";
        let drawn = draw(Arc::new(Source::new("w.yaml", text.replace(", \n", "\n").replace("} c", "}"))), 3);
        let drawn = drawn.expect("the ranges are right");
        let (written, new) = (&drawn.written.text, drawn.text());
        for word in ["a:", "b:", "d: e"] {
            let start = new.find(word).expect("it is there");
            let span = drawn.written_span(Span { start, end: start + word.len() });
            assert_eq!(&written[span.start..span.end], word);
        }
        let start = new.find("b: ").expect("it is there") + 3;
        let span = drawn.written_span(Span { start, end: start + 2 });
        assert_eq!(&written[span.start..span.end], "{from: 10 kg, to: 20 kg}");
    }
}

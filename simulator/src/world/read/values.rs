//! The values of a world file: numbers with units, vectors, colours, names, lists, and what is said where one is
//! wrong. It knows no section of the file.

use std::ops::RangeInclusive;
use std::path::Path;

use serde_saphyr::{Location, Spanned};

use super::super::WorldError;
use super::super::tree::{Node, Raw};

/// Kinds of numbers and the units that the file may give them in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Unit {
    None,
    Metre,
    Radian,
    Degree,
    Newton,
    Second,
    Hertz,
    Kilogram,
    NewtonPerMetre,
    NewtonPerSecond,
    Pixel,
}

impl Unit {
    /// Symbols with their size in this kind's own unit.
    pub(super) fn symbols(self) -> &'static [(&'static str, f64)] {
        const DEG: f64 = std::f64::consts::PI / 180.0;
        match self {
            Self::None => &[],
            Self::Metre => &[("m", 1.0), ("mm", 1e-3), ("cm", 1e-2)],
            Self::Radian => &[("rad", 1.0), ("deg", DEG)],
            Self::Degree => &[("deg", 1.0), ("rad", 1.0 / DEG)],
            Self::Newton => &[("N", 1.0)],
            Self::Second => &[("s", 1.0), ("ms", 1e-3), ("min", 60.0)],
            Self::Hertz => &[("Hz", 1.0)],
            Self::Kilogram => &[("kg", 1.0), ("g", 1e-3)],
            Self::NewtonPerMetre => &[("N/m", 1.0)],
            Self::NewtonPerSecond => &[("N/s", 1.0)],
            Self::Pixel => &[("px", 1.0)],
        }
    }
}

pub(super) struct Reader<'a> {
    pub(super) file: &'a Path,
    pub(super) text: &'a str,
    pub(super) findings: Vec<WorldError>,
}

/// A mapping whose keys have been checked.
pub(super) struct Section<'n> {
    pub(super) entries: &'n [(Spanned<String>, Node)],
}

impl<'n> Section<'n> {
    pub(super) fn get(&self, key: &str) -> Option<&'n Node> {
        self.entries.iter().find(|(k, _)| k.value == key).map(|(_, v)| v)
    }
}

impl Reader<'_> {
    pub(super) fn find(&mut self, at: Location, code: &'static str, message: String, help: String) {
        let line = usize::try_from(at.line()).unwrap_or(0);
        let column = usize::try_from(at.column()).unwrap_or(0);
        let offset = |v: Option<u64>| v.and_then(|v| usize::try_from(v).ok()).unwrap_or(0);
        let text = self.text.lines().nth(line.saturating_sub(1)).unwrap_or_default();
        self.findings.push(WorldError {
            file: self.file.to_owned(),
            line,
            column,
            span: (offset(at.span().byte_offset()), offset(at.span().byte_len())),
            code,
            message,
            help,
            text: if line == 0 { String::new() } else { text.chars().take(200).collect() },
        });
    }

    pub(super) fn tree(&mut self) -> Option<Node> {
        let options = serde_saphyr::options! { strict_booleans: true, with_snippet: false };
        if self.text.lines().all(|l| l.trim().is_empty() || l.trim_start().starts_with('#')) {
            return Some(Spanned::new(Raw::Map(Vec::new()), Location::UNKNOWN, Location::UNKNOWN));
        }
        match serde_saphyr::from_str_with_options::<Node>(self.text, options) {
            Ok(node) => Some(node),
            Err(e) => {
                let at = e.location().unwrap_or(Location::UNKNOWN);
                let message = e.without_snippet().to_string();
                self.find(at, "world::yaml", message, "the file must be YAML".into());
                None
            }
        }
    }

    pub(super) fn section<'n>(&mut self, node: &'n Node, keys: &[&str]) -> Option<Section<'n>> {
        let entries: &[_] = match &node.value {
            Raw::Map(entries) => entries,
            Raw::Null => &[],
            other => {
                let message = format!("expected a mapping, not {}", other.kind());
                self.find(node.referenced, "world::type", message, format!("its keys: {}", keys.join(", ")));
                return None;
            }
        };
        for (key, _) in entries {
            if !keys.contains(&key.value.as_str()) {
                let help = match nearest(&key.value, keys) {
                    Some(k) => format!("did you mean `{k}`?"),
                    None => format!("known keys: {}", keys.join(", ")),
                };
                self.find(key.referenced, "world::unknown_key", format!("unknown key `{}`", key.value), help);
            }
        }
        Some(Section { entries })
    }

    /// A finite number in `range`, in the kind's own unit.
    pub(super) fn scalar(&mut self, node: &Node, unit: Unit, range: &RangeInclusive<f64>) -> Option<f64> {
        let number = match &node.value {
            Raw::Number(v) => *v,
            Raw::Text(text) => self.quantity(node, text, unit)?,
            other => {
                let message = format!("expected a number, not {}", other.kind());
                self.find(node.referenced, "world::type", message, String::new());
                return None;
            }
        };
        if number.is_finite() && range.contains(&number) {
            return Some(number);
        }
        let symbol = unit.symbols().first().map_or(String::new(), |(s, _)| format!(" {s}"));
        let message = format!("{number} is not possible here");
        let help = format!("it lies between {} and {}{symbol}", range.start(), range.end());
        self.find(node.referenced, "world::value", message, help);
        None
    }

    pub(super) fn quantity(&mut self, node: &Node, text: &str, unit: Unit) -> Option<f64> {
        let trimmed = text.trim();
        let split = trimmed
            .find(|c: char| !(c.is_ascii_digit() || matches!(c, '.' | '-' | '+' | 'e' | 'E')))
            .unwrap_or(trimmed.len());
        let (number, symbol) = (&trimmed[..split], trimmed[split..].trim());
        let Ok(number) = number.trim().parse::<f64>() else {
            let message = format!("expected a number, not `{text}`");
            self.find(node.referenced, "world::type", message, String::new());
            return None;
        };
        if let Some((_, size)) = unit.symbols().iter().find(|(s, _)| *s == symbol) {
            return Some(number * size);
        }
        let known: Vec<_> = unit.symbols().iter().map(|(s, _)| *s).collect();
        let help = if known.is_empty() {
            "this number has no unit".to_owned()
        } else {
            format!("known units here: {}", known.join(", "))
        };
        self.find(node.referenced, "world::unit", format!("`{symbol}` is not a unit of this number"), help);
        None
    }

    pub(super) fn number(
        &mut self,
        node: Option<&Node>,
        into: &mut f64,
        unit: Unit,
        range: RangeInclusive<f64>,
    ) {
        if let Some(v) = node.and_then(|n| self.scalar(n, unit, &range)) {
            *into = v;
        }
    }

    pub(super) fn whole(
        &mut self,
        node: Option<&Node>,
        into: &mut u32,
        unit: Unit,
        range: RangeInclusive<u32>,
    ) {
        let Some(node) = node else { return };
        let range = f64::from(*range.start())..=f64::from(*range.end());
        if let Some(v) = self.scalar(node, unit, &range) {
            if v.fract() == 0.0 {
                *into = v as u32;
            } else {
                self.find(
                    node.referenced,
                    "world::value",
                    format!("{v} is not a whole number"),
                    String::new(),
                );
            }
        }
    }

    pub(super) fn vector<const N: usize>(
        &mut self,
        node: Option<&Node>,
        into: &mut [f64; N],
        unit: Unit,
        range: RangeInclusive<f64>,
    ) {
        let Some(node) = node else { return };
        match &node.value {
            Raw::List(items) if items.len() == N => {
                for (item, slot) in items.iter().zip(into) {
                    self.number(Some(item), slot, unit, range.clone());
                }
            }
            other => {
                let message = match other {
                    Raw::List(items) => format!("expected {N} numbers, not {}", items.len()),
                    other => format!("expected a list of {N} numbers, not {}", other.kind()),
                };
                self.find(node.referenced, "world::type", message, String::new());
            }
        }
    }

    pub(super) fn color(&mut self, node: Option<&Node>, into: &mut [u8; 3]) {
        let mut rgb = into.map(f64::from);
        self.vector(node, &mut rgb, Unit::None, 0.0..=255.0);
        *into = rgb.map(|v| v.round() as u8);
    }

    pub(super) fn text(&mut self, node: Option<&Node>, into: &mut String) {
        let Some(node) = node else { return };
        match &node.value {
            Raw::Text(t) if !t.is_empty() && t.len() <= 100 => into.clone_from(t),
            Raw::Text(_) => {
                let message = "a name has 1 to 100 characters".into();
                self.find(node.referenced, "world::value", message, String::new());
            }
            other => {
                let message = format!("expected text, not {}", other.kind());
                self.find(node.referenced, "world::type", message, String::new());
            }
        }
    }

    pub(super) fn choice<T: Copy>(&mut self, node: Option<&Node>, into: &mut T, choices: &[(&str, T)]) {
        let Some(node) = node else { return };
        let names: Vec<&str> = choices.iter().map(|(n, _)| *n).collect();
        let Raw::Text(text) = &node.value else {
            let message = format!("expected one of {}, not {}", names.join(", "), node.value.kind());
            self.find(node.referenced, "world::type", message, String::new());
            return;
        };
        if let Some((_, v)) = choices.iter().find(|(n, _)| n == text) {
            *into = *v;
            return;
        }
        let help = match nearest(text, &names) {
            Some(n) => format!("did you mean `{n}`? Known: {}", names.join(", ")),
            None => format!("known: {}", names.join(", ")),
        };
        self.find(node.referenced, "world::value", format!("`{text}` is not known here"), help);
    }

    pub(super) fn list<'n>(&mut self, node: &'n Node, most: usize) -> Option<&'n [Node]> {
        match &node.value {
            Raw::Null => Some(&[]),
            Raw::List(items) if items.len() <= most => Some(items),
            Raw::List(items) => {
                let message = format!("{} entries; at most {most} are possible", items.len());
                self.find(node.referenced, "world::value", message, String::new());
                None
            }
            other => {
                let message = format!("expected a list, not {}", other.kind());
                self.find(node.referenced, "world::type", message, String::new());
                None
            }
        }
    }

    /// Degrees under the key `{name}_deg`, or rad (or with a unit) under `name`.
    pub(super) fn angles<const N: usize>(
        &mut self,
        s: &Section<'_>,
        name: &str,
        into: &mut [f64; N],
        most_deg: f64,
    ) {
        let in_degrees = format!("{name}_deg");
        self.vector(s.get(&in_degrees), into, Unit::Degree, -most_deg..=most_deg);
        if let Some(node) = s.get(name) {
            let mut rad = into.map(f64::to_radians);
            let most = most_deg.to_radians();
            self.vector(Some(node), &mut rad, Unit::Radian, -most..=most);
            *into = rad.map(f64::to_degrees);
        }
    }
}

/// The candidate that is nearest to a misspelt word, if it is near.
fn nearest<'c>(word: &str, candidates: &[&'c str]) -> Option<&'c str> {
    let word: String = word.chars().take(64).collect();
    candidates
        .iter()
        .map(|c| (strsim::osa_distance(&word, c), *c))
        .filter(|(d, c)| *d <= 1 + c.chars().count() / 4)
        .min()
        .map(|(_, c)| c)
}

//! What can stand under a key: numbers with units, texts, words of a choice, lists and maps, each with its JSON Schema.

use std::collections::BTreeMap;

use armarium_values::Unit;
use indexmap::IndexMap;
use serde_json::{Value as Json, json};

use crate::code;
use crate::finding::{Findings, suggest};
use crate::yaml::{Node, Yaml};

/// A type that can stand under a key.
pub trait Field: Sized {
    /// Takes over what a node says. Where it cannot be used, `self` stays and a finding is added.
    fn read(&mut self, node: &Node, rule: &Rule, findings: &mut Findings);

    /// The JSON Schema of what is read.
    fn schema(rule: &Rule) -> Json;
}

/// What is asked of a value beyond its type.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rule {
    /// The unit in which a number is kept: `""` for none, any unit of charts, or a word such as `px`.
    pub unit: &'static str,
    /// The unit of a number that is written without one.
    pub bare: &'static str,
    /// The least number, in `unit`; the fewest characters of a text.
    pub min: f64,
    /// The largest number, in `unit`.
    pub max: f64,
    /// The most items of a list, or characters of a text.
    pub most: usize,
    /// Another key for the same angle, which is in rad where no unit is written.
    pub radians: Option<&'static str>,
    /// Whether the word `none` stands for nothing, as `null` does.
    pub none: bool,
}

impl Rule {
    /// Anything that the type allows.
    pub const ANY: Self = Self {
        unit: "",
        bare: "",
        min: f64::NEG_INFINITY,
        max: f64::INFINITY,
        most: usize::MAX,
        radians: None,
        none: false,
    };
    /// A text of 1 to 100 characters.
    pub const NAME: Self = Self { min: 1.0, most: 100, ..Self::ANY };
    /// Nothing, or what the type allows; nothing may be written as `none`.
    pub const OR_NONE: Self = Self { none: true, ..Self::ANY };

    /// Numbers from `min` to `max` in a unit.
    pub const fn number(unit: &'static str, min: f64, max: f64) -> Self {
        Self { unit, bare: unit, min, max, ..Self::ANY }
    }

    /// Finite numbers in a unit.
    pub const fn unit(unit: &'static str) -> Self {
        Self::number(unit, f64::NEG_INFINITY, f64::INFINITY)
    }

    /// Angles in degrees, up to `max` either way; under the key `radians` they may be written in rad.
    pub const fn degrees(max: f64, radians: &'static str) -> Self {
        Self { radians: Some(radians), ..Self::number("deg", -max, max) }
    }

    /// At most so many items.
    pub const fn most(most: usize) -> Self {
        Self { most, ..Self::ANY }
    }

    /// The rule for what stands under the key in rad.
    #[must_use]
    pub const fn in_radians(self) -> Self {
        Self { bare: "rad", radians: None, ..self }
    }

    /// A number in this rule's unit.
    fn quantity(&self, node: &Node, findings: &mut Findings) -> Option<f64> {
        let (number, symbol) = match &node.value {
            Yaml::Int(i) => (*i as f64, self.bare),
            Yaml::Float(f) => (*f, self.bare),
            Yaml::String(text) => {
                let end = |c: char| !(c.is_ascii_digit() || matches!(c, '.' | '-' | '+' | 'e' | 'E'));
                let (number, symbol) =
                    text.trim().split_at(text.trim().find(end).unwrap_or(text.trim().len()));
                let Ok(number) = number.parse::<f64>() else {
                    findings.error(code::FORM, node.span, format!("a number is needed here, not `{text}`"));
                    return None;
                };
                (number, if symbol.is_empty() { self.bare } else { symbol.trim() })
            }
            _ => {
                findings.form(node, "a number");
                return None;
            }
        };
        let kept = self.convert(number, symbol);
        if kept.is_none() {
            let help = if self.unit.is_empty() {
                "this number has no unit".to_owned()
            } else {
                format!("it is a number in {}, or in another unit of that kind", self.unit)
            };
            let message = format!("`{symbol}` is not a unit of this number");
            findings.error_help(code::UNIT, node.span, message, Some(help));
        }
        kept
    }

    fn convert(&self, number: f64, symbol: &str) -> Option<f64> {
        if symbol == self.unit {
            return Some(number);
        }
        let (kept, kept_factor) = Unit::parse(if self.unit.is_empty() { "1" } else { self.unit }).ok()?;
        let (given, factor) = Unit::parse(symbol).ok()?;
        let si = number * factor;
        match self.unit {
            _ if given != kept => None,
            "deg" => Some(si.to_degrees()),
            _ => Some(si / kept_factor),
        }
    }

    fn number_in_range(&self, node: &Node, findings: &mut Findings) -> Option<f64> {
        let number = self.quantity(node, findings)?;
        if number.is_finite() && (self.min..=self.max).contains(&number) {
            return Some(number);
        }
        let unit = if self.unit.is_empty() { String::new() } else { format!(" {}", self.unit) };
        let help = match (self.min.is_finite(), self.max.is_finite()) {
            (true, true) => format!("it lies between {} and {}{unit}", self.min, self.max),
            (true, false) => format!("it is {}{unit} or more", self.min),
            _ => "it is a finite number".into(),
        };
        findings.error_help(code::VALUE, node.span, format!("{number} is not possible here"), Some(help));
        None
    }

    fn number_schema(&self, whole: bool) -> Json {
        let number = if whole { "integer" } else { "number" };
        let mut schema =
            json!({"type": if self.unit.is_empty() { json!(number) } else { json!([number, "string"]) }});
        // The bounds are those of the kept unit.
        if self.bare == self.unit {
            for (key, bound) in [("minimum", self.min), ("maximum", self.max)] {
                if bound.is_finite() {
                    schema[key] = if whole { json!(bound as i64) } else { json!(bound) };
                }
            }
        }
        schema
    }
}

impl Field for f64 {
    fn read(&mut self, node: &Node, rule: &Rule, findings: &mut Findings) {
        if let Some(number) = rule.number_in_range(node, findings) {
            *self = number;
        }
    }
    fn schema(rule: &Rule) -> Json {
        rule.number_schema(false)
    }
}

macro_rules! whole {
    ($($ty:ty),*) => {$(
        impl Field for $ty {
            fn read(&mut self, node: &Node, rule: &Rule, findings: &mut Findings) {
                let (min, max) = (rule.min.max(<$ty>::MIN as f64), rule.max.min(<$ty>::MAX as f64));
                let rule = Rule { min, max, ..*rule };
                match rule.number_in_range(node, findings) {
                    Some(number) if number.fract() == 0.0 => *self = number as $ty,
                    Some(number) => {
                        findings.error(code::VALUE, node.span, format!("{number} is not a whole number"));
                    }
                    None => {}
                }
            }
            fn schema(rule: &Rule) -> Json {
                let least = Rule { min: rule.min.max(<$ty>::MIN as f64), ..*rule };
                least.number_schema(true)
            }
        }
    )*};
}
whole!(u8, u32, usize);

impl Field for bool {
    fn read(&mut self, node: &Node, _: &Rule, findings: &mut Findings) {
        match node.value {
            Yaml::Bool(value) => *self = value,
            _ => findings.form(node, "`true` or `false`"),
        }
    }
    fn schema(_: &Rule) -> Json {
        json!({"type": "boolean"})
    }
}

impl Field for String {
    fn read(&mut self, node: &Node, rule: &Rule, findings: &mut Findings) {
        let Yaml::String(text) = &node.value else { return findings.form(node, "text") };
        let length = text.chars().count();
        if length as f64 >= rule.min && length <= rule.most {
            self.clone_from(text);
        } else {
            let message = format!("a text of {} to {} characters is needed here", rule.min, rule.most);
            findings.error(code::VALUE, node.span, message);
        }
    }
    fn schema(_: &Rule) -> Json {
        json!({"type": "string"})
    }
}

impl<T: Field, const N: usize> Field for [T; N] {
    fn read(&mut self, node: &Node, rule: &Rule, findings: &mut Findings) {
        match &node.value {
            Yaml::List(items) if items.len() == N => {
                self.iter_mut().zip(items).for_each(|(slot, item)| slot.read(item, rule, findings));
            }
            Yaml::List(items) => {
                let message = format!("a list of {N} is needed here, not of {}", items.len());
                findings.error(code::FORM, node.span, message);
            }
            _ => findings.form(node, &format!("a list of {N}")),
        }
    }
    fn schema(rule: &Rule) -> Json {
        json!({"type": "array", "items": T::schema(rule), "minItems": N, "maxItems": N})
    }
}

impl<T: Field + Default> Field for Vec<T> {
    fn read(&mut self, node: &Node, rule: &Rule, findings: &mut Findings) {
        match &node.value {
            Yaml::Null => self.clear(),
            Yaml::List(items) if items.len() <= rule.most => {
                *self = items
                    .iter()
                    .map(|item| fresh(item, &Rule { most: usize::MAX, ..*rule }, findings))
                    .collect();
            }
            Yaml::List(items) => {
                let message = format!("{} entries; at most {} are possible", items.len(), rule.most);
                findings.error(code::LIMIT, node.span, message);
            }
            _ => findings.form(node, "a list"),
        }
    }
    fn schema(rule: &Rule) -> Json {
        let mut schema = json!({"type": "array", "items": T::schema(&Rule { most: usize::MAX, ..*rule })});
        if rule.most < usize::MAX {
            schema["maxItems"] = json!(rule.most);
        }
        schema
    }
}

impl<T: Field + Default> Field for BTreeMap<String, T> {
    fn read(&mut self, node: &Node, rule: &Rule, findings: &mut Findings) {
        match &node.value {
            Yaml::Null => self.clear(),
            Yaml::Map(entries) => {
                *self = entries
                    .iter()
                    .map(|(key, node)| (key.text.clone(), fresh(node, rule, findings)))
                    .collect();
            }
            _ => findings.form(node, "a map"),
        }
    }
    fn schema(rule: &Rule) -> Json {
        json!({"type": "object", "additionalProperties": T::schema(rule)})
    }
}

/// A map that keeps the order of the file.
impl<T: Field + Default> Field for IndexMap<String, T> {
    fn read(&mut self, node: &Node, rule: &Rule, findings: &mut Findings) {
        *self = findings
            .entries(node)
            .iter()
            .map(|(key, node)| (key.text.clone(), fresh(node, rule, findings)))
            .collect();
    }
    fn schema(rule: &Rule) -> Json {
        BTreeMap::<String, T>::schema(rule)
    }
}

fn fresh<T: Field + Default>(node: &Node, rule: &Rule, findings: &mut Findings) -> T {
    let mut value = T::default();
    value.read(node, rule, findings);
    value
}

impl<T: Field + Default> Field for Option<T> {
    fn read(&mut self, node: &Node, rule: &Rule, findings: &mut Findings) {
        *self = match &node.value {
            Yaml::Null => None,
            Yaml::String(word) if rule.none && word == "none" => None,
            _ => Some(fresh(node, rule, findings)),
        };
    }
    fn schema(rule: &Rule) -> Json {
        if rule.none { json!({"anyOf": [T::schema(rule), {"const": "none"}]}) } else { T::schema(rule) }
    }
}

impl<T: Field> Field for Box<T> {
    fn read(&mut self, node: &Node, rule: &Rule, findings: &mut Findings) {
        (**self).read(node, rule, findings);
    }
    fn schema(rule: &Rule) -> Json {
        T::schema(rule)
    }
}

/// Any literal.
impl Field for Json {
    fn read(&mut self, node: &Node, _: &Rule, _: &mut Findings) {
        *self = node.literal().to_json();
    }
    fn schema(_: &Rule) -> Json {
        json!({})
    }
}

/// Reads one of the words of a choice.
pub fn word<T: Copy>(into: &mut T, words: &[(&str, T)], node: &Node, findings: &mut Findings) {
    let names = || words.iter().map(|(name, _)| *name);
    let known = || names().collect::<Vec<_>>().join(", ");
    let Yaml::String(text) = &node.value else { return findings.form(node, &format!("one of {}", known())) };
    match words.iter().find(|(name, _)| name == text) {
        Some((_, value)) => *into = *value,
        None => {
            let near = suggest(text, names()).map_or_else(String::new, |near| format!("{near} "));
            let message = format!("`{text}` is not known here");
            findings.unknown(code::VALUE, (node.span, text), message, names(), None);
            if let Some(finding) = findings.list.last_mut() {
                finding.help = Some(format!("{near}known are: {}", known()));
            }
        }
    }
}

/// Makes an enum a field: `choice!(Shape { "ellipse" => Shape::Ellipse, "line" => Shape::Line });`.
#[macro_export]
macro_rules! choice {
    ($ty:ty { $($word:literal => $value:expr),* $(,)? }) => {
        impl $crate::Field for $ty {
            fn read(&mut self, node: &$crate::yaml::Node, _: &$crate::Rule, findings: &mut $crate::Findings) {
                $crate::word(self, &[$(($word, $value)),*], node, findings);
            }
            fn schema(_: &$crate::Rule) -> $crate::serde_json::Value {
                $crate::serde_json::json!({"enum": [$($word),*]})
            }
        }
    };
}

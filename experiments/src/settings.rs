//! The settings of an experiment: declared once with type, default and meaning, parsed from `key=value`.

use armarium_values::expr::nearest;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};

use super::experiment::ExperimentError;

/// The settings of an experiment; declared with [`settings!`].
pub(crate) trait Settings: Default + Serialize + DeserializeOwned {
    /// Each key, its meaning with unit, and its Rust type as text.
    const KEYS: &'static [(&'static str, &'static str, &'static str)];
}

/// Declares a struct of settings: `/// meaning, unit` and `key: type = default;` for each.
macro_rules! settings {
    ($(#[$about:meta])* $name:ident { $( $(#[doc = $doc:literal])+ $key:ident: $ty:ty = $default:expr; )* }) => {
        $(#[$about])*
        #[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
        #[serde(deny_unknown_fields)]
        pub(crate) struct $name { $( $(#[doc = $doc])+ pub(crate) $key: $ty, )* }
        impl Default for $name {
            fn default() -> Self {
                Self { $( $key: $default, )* }
            }
        }
        impl $crate::settings::Settings for $name {
            const KEYS: &'static [(&'static str, &'static str, &'static str)] =
                &[$( (stringify!($key), concat!($($doc),+), stringify!($ty)), )*];
        }
    };
}
pub(crate) use settings;

/// A setting as listed.
#[derive(Clone, Debug)]
pub struct Key {
    /// Its name.
    pub name: &'static str,
    /// Its default value, as text.
    pub default: String,
    /// Its meaning, with unit.
    pub doc: &'static str,
}

/// All keys of `S`, in the order declared.
pub(crate) fn keys<S: Settings>() -> Vec<Key> {
    let defaults = defaults::<S>();
    S::KEYS
        .iter()
        .map(|(name, doc, _)| Key {
            name,
            default: defaults.get(*name).map_or_else(String::new, shown),
            doc: doc.trim(),
        })
        .collect()
}

fn defaults<S: Settings>() -> Map<String, Value> {
    match serde_json::to_value(S::default()) {
        Ok(Value::Object(map)) => map,
        _ => Map::new(),
    }
}

fn shown(value: &Value) -> String {
    match value {
        Value::Null => "none".to_owned(),
        Value::String(text) => text.clone(),
        Value::Array(list) => list.iter().map(shown).collect::<Vec<_>>().join(","),
        other => other.to_string(),
    }
}

/// The defaults, overwritten by the given settings.
///
/// # Errors
/// [`ExperimentError::Setting`] for an unknown key and for a value of the wrong type.
pub(crate) fn read<S: Settings>(given: &[(String, String)]) -> Result<S, ExperimentError> {
    let mut map = defaults::<S>();
    for (key, text) in given {
        let Some(default) = map.get(key) else {
            let names = S::KEYS.iter().map(|(name, _, _)| *name);
            let why = nearest(key, names.clone()).map_or_else(
                || format!("no such setting; there are {}", names.collect::<Vec<_>>().join(", ")),
                |name| format!("no such setting; did you mean `{name}`?"),
            );
            return Err(ExperimentError::Setting { key: key.clone(), why });
        };
        let value = value(text, default);
        let mut alone = defaults::<S>();
        alone.insert(key.clone(), value.clone());
        if let Err(error) = serde_json::from_value::<S>(Value::Object(alone)) {
            let kind = S::KEYS.iter().find(|(name, _, _)| name == key).map_or("", |(_, _, kind)| kind);
            let needed = needed(kind).unwrap_or_else(|| choice(&error.to_string()));
            let why = if text.is_empty() {
                format!("must be {needed}")
            } else {
                format!("must be {needed}, not `{text}`")
            };
            return Err(ExperimentError::Setting { key: key.clone(), why });
        }
        map.insert(key.clone(), value);
    }
    serde_json::from_value(Value::Object(map))
        .map_err(|error| ExperimentError::Setting { key: "settings".into(), why: error.to_string() })
}

/// The accepted values of a type, in words; `None` for a choice among names.
fn needed(kind: &str) -> Option<String> {
    let numbers = |array: &str| -> Option<String> {
        let count = array.strip_prefix("[f64;")?.strip_suffix(']')?.trim();
        Some(format!("a list of {count} finite numbers, written with commas"))
    };
    match kind {
        "f64" => Some("a finite number".into()),
        "u32" => Some(format!("a whole number from 0 to {}", u32::MAX)),
        "u64" | "usize" => Some("a whole number, 0 or more".into()),
        "bool" => Some("true or false".into()),
        _ => match kind.strip_prefix("Option<").and_then(|rest| rest.strip_suffix('>')) {
            Some(inner) => needed(inner.trim()).map(|inner| format!("{inner}, or none")),
            None => numbers(kind),
        },
    }
}

/// The allowed names, taken from serde's error message.
fn choice(error: &str) -> String {
    match error.split_once("expected ") {
        Some((_, names)) => names.replace("one of ", ""),
        None => "another value".into(),
    }
}

/// Parses a value of the default's type. Invalid text stays a string, which no numeric field accepts.
fn value(text: &str, default: &Value) -> Value {
    match default {
        Value::String(_) => text.into(),
        Value::Bool(_) => match text {
            "true" | "yes" | "1" => true.into(),
            "false" | "no" | "0" => false.into(),
            _ => text.into(),
        },
        Value::Null | Value::Array(_) if text == "none" => Value::Null,
        Value::Array(_) => Value::Array(items(text).map(number).collect()),
        Value::Null if text.contains(',') => Value::Array(items(text).map(number).collect()),
        Value::Number(number) if number.is_u64() => whole(text),
        _ => number(text),
    }
}

/// An integer, also written as `1e3`; invalid text stays a string.
fn whole(text: &str) -> Value {
    let exact = |v: &f64| v.fract() == 0.0 && (0.0..=9e15).contains(v);
    let number = text.parse::<u64>().ok().or_else(|| product(text).filter(exact).map(|v| v as u64));
    number.map_or_else(|| text.into(), Value::from)
}

fn items(text: &str) -> impl Iterator<Item = &str> {
    text.trim_matches(['[', ']', '(', ')']).split(',').map(str::trim)
}

/// A number, or a product such as `pi/4`, `-8/pi`, `2*pi`.
fn number(text: &str) -> Value {
    if let Ok(whole) = text.parse::<u64>() {
        return whole.into();
    }
    product(text).filter(|v| v.is_finite()).map_or_else(|| text.into(), Value::from)
}

fn product(text: &str) -> Option<f64> {
    let (sign, text) = text.strip_prefix('-').map_or((1.0, text), |rest| (-1.0, rest));
    if text.is_empty() {
        return None;
    }
    let mut factors = text.split_inclusive(['*', '/']);
    let mut result = 1.0;
    let mut divide = false;
    factors.try_for_each(|factor| {
        let bare = factor.trim_end_matches(['*', '/']).trim();
        let value = if bare == "pi" { std::f64::consts::PI } else { bare.parse::<f64>().ok()? };
        result = if divide { result / value } else { result * value };
        divide = factor.ends_with('/');
        Some(())
    })?;
    Some(sign * result)
}

#[cfg(test)]
mod tests {
    use super::*;

    settings! {
        /// Some settings.
        Some3 {
            /// A number, m.
            gain: f64 = 2.0;
            /// A point, m.
            point: [f64; 2] = [1.0, 2.0];
            /// Whether.
            on: bool = false;
            /// Perhaps a posture, rad.
            posture: Option<[f64; 3]> = None;
            /// How often.
            cycles: u32 = 4;
            /// How many.
            count: usize = 3;
            /// Which way.
            way: Way = Way::Left;
        }
    }

    #[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
    #[serde(rename_all = "snake_case")]
    pub(crate) enum Way {
        Left,
        Right,
    }

    fn of(given: &[(&str, &str)]) -> Result<Some3, String> {
        let given: Vec<_> = given.iter().map(|(k, v)| ((*k).to_owned(), (*v).to_owned())).collect();
        read(&given).map_err(|e| e.to_string())
    }

    #[test]
    fn values_are_read_by_their_type() {
        let read =
            of(&[("gain", "-8/pi"), ("point", "(1.8, -0.6)"), ("on", "true"), ("cycles", "7")]).unwrap();
        assert_eq!(read.gain, -8.0 / std::f64::consts::PI);
        assert_eq!((read.point, read.on, read.cycles, read.posture), ([1.8, -0.6], true, 7, None));
        assert_eq!(of(&[("posture", "-0.5,0.6,0.6")]).unwrap().posture, Some([-0.5, 0.6, 0.6]));
        assert_eq!(of(&[("posture", "none")]).unwrap(), Some3::default());
        assert_eq!(of(&[("gain", "3")]).unwrap().gain, 3.0);
        assert_eq!(of(&[("cycles", "1e1")]).unwrap().cycles, 10);
        assert_eq!(of(&[("count", "7.0"), ("way", "right")]).unwrap().count, 7);
    }

    #[test]
    fn what_is_wrong_is_said_with_its_key() {
        assert!(of(&[("gian", "1")]).unwrap_err().contains("did you mean `gain`?"));
        assert!(of(&[("zzz", "1")]).unwrap_err().contains("there are gain, point"));
        for (key, text, why) in [
            ("gain", "NaN", "must be a finite number, not `NaN`"),
            ("gain", "1e999", "must be a finite number, not `1e999`"),
            ("gain", "", "must be a finite number"),
            ("point", "1,2,3", "must be a list of 2 finite numbers, written with commas, not `1,2,3`"),
            ("posture", "1,2", "must be a list of 3 finite numbers, written with commas, or none, not `1,2`"),
            ("on", "2", "must be true or false, not `2`"),
            ("cycles", "-3", "must be a whole number from 0 to 4294967295, not `-3`"),
            ("cycles", "2.5", "must be a whole number from 0 to 4294967295, not `2.5`"),
            ("count", "-3", "must be a whole number, 0 or more, not `-3`"),
            ("way", "up", "must be `left` or `right`, not `up`"),
        ] {
            assert_eq!(of(&[(key, text)]).unwrap_err(), format!("{key}: {why}"), "{key}={text}");
        }
    }

    #[test]
    fn keys_are_listed_with_their_defaults() {
        let keys = keys::<Some3>();
        let listed: Vec<_> = keys.iter().map(|k| format!("{}={} {}", k.name, k.default, k.doc)).collect();
        assert_eq!(listed[1], "point=1.0,2.0 A point, m.");
        assert_eq!(listed[3], "posture=none Perhaps a posture, rad.");
    }
}

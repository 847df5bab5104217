//! The settings of an experiment: declared once with type, default and meaning, parsed from `key=value`.

use armarium_values::expr::nearest;
use serde::Serialize;
use serde::de::{DeserializeOwned, IntoDeserializer as _};
use serde_json::{Map, Value};

use super::error::ExperimentError;

/// The settings of an experiment; declared with [`settings!`].
pub(crate) trait ExperimentSettings: Default + Serialize + DeserializeOwned {
    /// Each key, and its meaning with unit.
    const KEYS: &'static [(&'static str, &'static str)];

    /// What the setting `key` takes, in words.
    fn needed(key: &str) -> String;

    /// Refuses the first setting that is outside its range.
    fn check_ranges(&self) -> Result<(), ExperimentError>;
}

/// Declares a struct of settings: `/// meaning, unit` and `key: type = default, range;` for each. The range of a number,
/// or of each number of a list, may be left out.
macro_rules! settings {
    ($(#[$about:meta])* $name:ident {
        $( $(#[doc = $doc:literal])+ $key:ident: $ty:ty = $default:expr $(, $range:expr)?; )*
    }) => {
        $(#[$about])*
        #[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
        #[serde(deny_unknown_fields)]
        pub(crate) struct $name { $( $(#[doc = $doc])+ pub(crate) $key: $ty, )* }
        impl Default for $name {
            fn default() -> Self {
                Self { $( $key: $default, )* }
            }
        }
        impl $crate::settings::ExperimentSettings for $name {
            const KEYS: &'static [(&'static str, &'static str)] =
                &[$( (stringify!($key), concat!($($doc),+)), )*];

            fn needed(key: &str) -> String {
                match key {
                    $( stringify!($key) => <$ty as $crate::settings::Setting>::needed(), )*
                    _ => String::new(),
                }
            }

            fn check_ranges(&self) -> Result<(), $crate::error::ExperimentError> {
                $( $(
                    for number in $crate::settings::Setting::numbers(&self.$key) {
                        $crate::error::within(stringify!($key), number, *$range.start(), *$range.end())?;
                    }
                )? )*
                Ok(())
            }
        }
    };
}
pub(crate) use settings;

/// The type of a setting. The default is that of a choice among names.
pub(crate) trait Setting {
    /// The accepted values, in words.
    fn needed() -> String
    where
        Self: DeserializeOwned,
    {
        let Expected(names) = match Self::deserialize("".into_deserializer()) {
            Err(expected) => expected,
            Ok(_) => Expected(&[]),
        };
        let names: Vec<String> = names.iter().map(|name| format!("`{name}`")).collect();
        names.join(if names.len() == 2 { " or " } else { ", " })
    }

    /// Its numbers.
    fn numbers(&self) -> Vec<f64> {
        Vec::new()
    }
}

/// The names of which serde expected one.
#[derive(Debug, thiserror::Error)]
#[error("one of these names is needed: {0:?}")]
struct Expected(&'static [&'static str]);

impl serde::de::Error for Expected {
    fn custom<T: std::fmt::Display>(_: T) -> Self {
        Self(&[])
    }

    fn unknown_variant(_: &str, expected: &'static [&'static str]) -> Self {
        Self(expected)
    }
}

macro_rules! numbers {
    ($($ty:ty: $needed:expr;)*) => { $(
        impl Setting for $ty {
            fn needed() -> String {
                $needed.into()
            }

            fn numbers(&self) -> Vec<f64> {
                vec![*self as f64]
            }
        }
    )* };
}

numbers! {
    f64: "a finite number";
    u32: format!("a whole number from 0 to {}", u32::MAX);
    u64: "a whole number, 0 or more";
    usize: "a whole number, 0 or more";
}

impl Setting for bool {
    fn needed() -> String {
        "true or false".into()
    }
}

impl<const N: usize> Setting for [f64; N] {
    fn needed() -> String {
        format!("a list of {N} finite numbers, written with commas")
    }

    fn numbers(&self) -> Vec<f64> {
        self.to_vec()
    }
}

impl<T: Setting + DeserializeOwned> Setting for Option<T> {
    fn needed() -> String {
        T::needed() + ", or none"
    }

    fn numbers(&self) -> Vec<f64> {
        self.as_ref().map_or_else(Vec::new, T::numbers)
    }
}

/// A setting as listed.
#[derive(Clone, Debug)]
pub struct SettingInfo {
    /// Its name.
    pub name: &'static str,
    /// Its default value, as text.
    pub default: String,
    /// Its meaning, with unit.
    pub doc: &'static str,
}

/// All keys of `S`, in the order declared.
pub(crate) fn keys<S: ExperimentSettings>() -> Vec<SettingInfo> {
    let defaults = defaults::<S>();
    S::KEYS
        .iter()
        .map(|(name, doc)| SettingInfo {
            name,
            default: defaults.get(*name).map_or_else(String::new, shown),
            doc: doc.trim(),
        })
        .collect()
}

fn defaults<S: ExperimentSettings>() -> Map<String, Value> {
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

/// The defaults, overwritten by the given settings; an unknown key or a value of another type is an error.
pub(crate) fn read<S: ExperimentSettings>(given: &[(String, String)]) -> Result<S, ExperimentError> {
    let mut map = defaults::<S>();
    for (key, text) in given {
        let Some(default) = map.get(key) else {
            let names = S::KEYS.iter().map(|(name, _)| *name);
            let why = nearest(key, names.clone()).map_or_else(
                || format!("no such setting; there are {}", names.collect::<Vec<_>>().join(", ")),
                |name| format!("no such setting; did you mean `{name}`?"),
            );
            return Err(ExperimentError::Setting { key: key.clone(), why });
        };
        let value = value(text, default);
        let mut alone = defaults::<S>();
        alone.insert(key.clone(), value.clone());
        if serde_json::from_value::<S>(Value::Object(alone)).is_err() {
            let given = if text.is_empty() { String::new() } else { format!(", not `{text}`") };
            let why = format!("must be {}{given}", S::needed(key));
            return Err(ExperimentError::Setting { key: key.clone(), why });
        }
        map.insert(key.clone(), value);
    }
    serde_json::from_value(Value::Object(map))
        .map_err(|error| ExperimentError::Setting { key: "settings".into(), why: error.to_string() })
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
        Mixed {
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

    impl Setting for Way {}

    fn of(given: &[(&str, &str)]) -> Result<Mixed, String> {
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
        assert_eq!(of(&[("posture", "none")]).unwrap(), Mixed::default());
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
        let keys = keys::<Mixed>();
        let listed: Vec<_> = keys.iter().map(|k| format!("{}={} {}", k.name, k.default, k.doc)).collect();
        assert_eq!(listed[1], "point=1.0,2.0 A point, m.");
        assert_eq!(listed[3], "posture=none Perhaps a posture, rad.");
    }
}

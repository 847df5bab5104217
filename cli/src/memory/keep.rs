//! Parses what of a memory is kept: `SEGMENT=POLICY[,jpeg[:QUALITY]]`. The rooms of images and of memory do not know
//! each other; this file encodes images in memory as JPEG files.

use std::collections::BTreeMap;

use armarium_memoryx::{Coding, Policies, Policy, Retention, check_name};
use armarium_values::Value;
use armarium_visionx::{JPEG_QUALITY, JpegPixel, encode_jpeg};

/// What a file keeps, and for how long.
#[derive(Clone, Debug, Default, clap::Args)]
pub(crate) struct KeepArgs {
    /// What the file keeps of a core segment: `everything`, `nothing`, `on-change`, `at-most:HZ` or
    /// `named:NAME+NAME`; with `,jpeg` or `,jpeg:QUALITY` its images are stored as JPEG files. The segment `*` is all
    /// others. May be repeated.
    #[arg(long, value_name = "SEGMENT=POLICY")]
    keep: Vec<String>,
    /// How long the file keeps snapshots, days; unlimited if not given. The newest of each entity stays.
    #[arg(long, value_name = "DAYS", allow_negative_numbers = true)]
    days: Option<f64>,
    /// Most megabytes in the file. The newest of each entity stays.
    #[arg(long, value_name = "MB", allow_negative_numbers = true)]
    megabytes: Option<f64>,
}

impl KeepArgs {
    /// The first option that was given.
    pub(crate) fn given(&self) -> Option<&'static str> {
        let given = [
            ("--keep", !self.keep.is_empty()),
            ("--days", self.days.is_some()),
            ("--megabytes", self.megabytes.is_some()),
        ];
        given.into_iter().find(|(_, is_given)| *is_given).map(|(name, _)| name)
    }

    /// The policies from the options; without them `usual`.
    pub(crate) fn policies(&self, usual: Policies) -> Result<Policies, String> {
        policies(usual, &self.keep)
    }

    /// The retention from the options.
    pub(crate) fn retention(&self) -> Result<Retention, String> {
        retention(self.days, self.megabytes)
    }
}

/// The retention, from days and megabytes.
pub(super) fn retention(days: Option<f64>, megabytes: Option<f64>) -> Result<Retention, String> {
    let scaled = |number: Option<f64>, unit: f64, what: &str| match number {
        Some(n) if !n.is_finite() || n < 0.0 => Err(format!("{what} cannot be {n}")),
        number => Ok(number.map(|n| (n * unit) as u64)),
    };
    Ok(Retention { age_ns: scaled(days, 86_400e9, "days")?, bytes: scaled(megabytes, 1e6, "megabytes")? })
}

fn policies(mut policies: Policies, options: &[String]) -> Result<Policies, String> {
    for option in options {
        let wrong = |what: String| format!("--keep {option}: {what}");
        let (segment, words) = option.split_once('=').ok_or_else(|| {
            wrong("it is not SEGMENT=POLICY, for instance Images=everything,jpeg:80".into())
        })?;
        let mut chosen = None;
        for word in words.split(',') {
            match coding(word).map_err(wrong)? {
                Some(_) if segment == "*" => {
                    return Err(wrong("name the core segment whose images become JPEG files".into()));
                }
                Some(coding) => policies = policies.coded(segment, coding),
                None if chosen.is_some() => return Err(wrong(format!("`{word}` is a second policy"))),
                None => chosen = Some(policy(word).map_err(wrong)?),
            }
        }
        if segment == "*" {
            policies.default = chosen.unwrap_or(Policy::Everything);
        } else {
            check_name(segment).map_err(|error| wrong(error.to_string()))?;
            policies = policies.with(segment, chosen.unwrap_or(Policy::Everything));
        }
    }
    Ok(policies)
}

fn policy(word: &str) -> Result<Policy, String> {
    let (name, value) = word.split_once(':').unwrap_or((word, ""));
    match (name, value) {
        ("everything", "") => Ok(Policy::Everything),
        ("nothing", "") => Ok(Policy::Nothing),
        ("on-change", "") => Ok(Policy::OnChange),
        ("at-most", hz) => match hz.parse::<f64>() {
            Ok(hz) if hz.is_finite() && hz > 0.0 => Ok(Policy::AtMost { hz }),
            _ => Err(format!("`{word}` needs a number of snapshots a second, for instance at-most:5")),
        },
        ("named", names) if !names.is_empty() => {
            Ok(Policy::Named(names.split('+').map(Into::into).collect()))
        }
        _ => Err(format!(
            "`{word}` is no policy: everything, nothing, on-change, at-most:HZ, named:NAME+NAME, jpeg or jpeg:QUALITY"
        )),
    }
}

/// The coding that a word names, if any.
fn coding(word: &str) -> Result<Option<Coding>, String> {
    let (name, value) = word.split_once(':').unwrap_or((word, ""));
    if name != "jpeg" {
        return Ok(None);
    }
    let quality = if word == "jpeg" { Ok(JPEG_QUALITY) } else { value.parse() };
    match quality {
        Ok(quality @ 1..=100) => Ok(Some(jpeg(quality))),
        _ => Err(format!("`{word}` needs a quality from 1 to 100, for instance jpeg:{JPEG_QUALITY}")),
    }
}

/// Encodes images as JPEG files; leaves everything else unchanged.
fn jpeg(quality: u8) -> Coding {
    Coding::new(&format!("jpeg:{quality}"), move |value| as_jpeg(value, quality))
}

/// An image in memory is a map of `width`, `height`, `format` (`rgb8` or `gray8`), `coding` (`raw`) and `data`, as
/// for images on the network.
fn as_jpeg(value: &Value, quality: u8) -> Option<Value> {
    let Value::Map(fields) = value else { return None };
    let (Value::Bytes(data), Value::String(coding)) = (fields.get("data")?, fields.get("coding")?) else {
        return None;
    };
    let side = |name: &str| match fields.get(name)? {
        Value::Int(length) => u32::try_from(*length).ok().filter(|length| (1..=65_535).contains(length)),
        _ => None,
    };
    let (width, height) = (side("width")?, side("height")?);
    let pixel = match fields.get("format")? {
        Value::String(format) if format == "rgb8" => JpegPixel::Rgb,
        Value::String(format) if format == "gray8" => JpegPixel::Gray,
        _ => return None,
    };
    if coding != "raw" {
        return None;
    }
    let mut file = Vec::new();
    encode_jpeg(&mut file, data, (width, height), pixel, quality).ok()?;
    let mut kept: BTreeMap<String, Value> =
        fields.iter().filter(|(name, _)| *name != "data").map(|(n, v)| (n.clone(), v.clone())).collect();
    kept.insert("coding".into(), Value::String("jpeg".into()));
    kept.insert("data".into(), Value::Bytes(file));
    Some(Value::Map(kept))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn options(options: &[&str]) -> Result<Policies, String> {
        let options: Vec<String> = options.iter().map(|option| (*option).to_owned()).collect();
        policies(Policies::all(Policy::Everything), &options)
    }

    #[test]
    fn policies_are_said_in_words() {
        let all = |policy| Policies::all(policy);
        let named = Policy::Named(["left".to_owned(), "right".to_owned()].into());
        for (said, expected) in [
            (vec![], all(Policy::Everything)),
            (vec!["*=nothing"], all(Policy::Nothing)),
            (vec!["Images=at-most:2.5"], all(Policy::Everything).with("Images", Policy::AtMost { hz: 2.5 })),
            (
                vec!["*=on-change", "Motions=everything"],
                all(Policy::OnChange).with("Motions", Policy::Everything),
            ),
            (
                vec!["Images=named:left+right,jpeg:70"],
                all(Policy::Everything).with("Images", named).coded("Images", jpeg(70)),
            ),
            (
                vec!["Images=jpeg"],
                all(Policy::Everything).with("Images", Policy::Everything).coded("Images", jpeg(85)),
            ),
        ] {
            assert_eq!(options(&said), Ok(expected), "{said:?}");
        }
        for (said, words) in [
            ("Images", "SEGMENT=POLICY"),
            ("Images=", "is no policy"),
            ("Images=all", "is no policy"),
            ("Images=at-most", "a number of snapshots"),
            ("Images=at-most:NaN", "a number of snapshots"),
            ("Images=at-most:-1", "a number of snapshots"),
            ("Images=jpeg:0", "a quality from 1 to 100"),
            ("Images=jpeg:", "a quality from 1 to 100"),
            ("Images=nothing,everything", "a second policy"),
            ("*=jpeg", "name the core segment"),
            ("a/b=nothing", "cannot be part of a memory address"),
        ] {
            let error = options(&[said]).unwrap_err();
            assert!(error.starts_with("--keep ") && error.contains(words), "{error}");
        }
    }

    fn picture(format: &str, data: Vec<u8>) -> BTreeMap<String, Value> {
        [
            ("width", Value::Int(16)),
            ("height", Value::Int(8)),
            ("format", Value::String(format.into())),
            ("coding", Value::String("raw".into())),
            ("data", Value::Bytes(data)),
        ]
        .map(|(name, value)| (name.to_owned(), value))
        .into()
    }

    #[test]
    fn images_become_files_that_show_the_same() {
        for (format, channels) in [("rgb8", 3), ("gray8", 1)] {
            let pixels: Vec<u8> = (0..16 * 8 * channels).map(|i| 100 + (i / channels % 16) as u8).collect();
            let kept = as_jpeg(&Value::Map(picture(format, pixels.clone())), 90).unwrap();
            let Value::Map(kept) = kept else { panic!("{kept:?}") };
            assert_eq!((&kept["coding"], &kept["width"]), (&Value::String("jpeg".into()), &Value::Int(16)));
            let Value::Bytes(file) = &kept["data"] else { panic!("no bytes") };
            let shown = image::load_from_memory(file).unwrap();
            let shown = if channels == 3 { shown.to_rgb8().into_raw() } else { shown.to_luma8().into_raw() };
            assert!(shown.iter().zip(&pixels).all(|(a, b)| a.abs_diff(*b) < 8), "{format}");
        }
    }

    #[test]
    fn what_is_no_image_stays_as_it_is() {
        let whole = picture("rgb8", vec![0; 16 * 8 * 3]);
        let with = |name: &str, value: Value| {
            let mut fields = whole.clone();
            fields.insert(name.into(), value);
            Value::Map(fields)
        };
        assert!(as_jpeg(&Value::Map(whole.clone()), 85).is_some());
        for other in [
            Value::Int(1),
            Value::Map(BTreeMap::new()),
            with("data", Value::Bytes(vec![0; 7])),
            with("width", Value::Int(-16)),
            with("width", Value::Int(i64::MAX)),
            with("height", Value::Int(0)),
            with("format", Value::String("depth32_f".into())),
            with("coding", Value::String("jpeg".into())),
        ] {
            assert_eq!(as_jpeg(&other, 85), None);
        }
    }
}

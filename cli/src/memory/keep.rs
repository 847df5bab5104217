//! Parses what of a memory is kept: `SEGMENT=POLICY[,jpeg[:QUALITY]]`.

use armarium_host::image_coding::jpeg;
use armarium_memoryx::{Coding, Policies, Policy, Retention, check_name};
use armarium_visionx::JPEG_QUALITY;

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

    pub(crate) fn retention(&self) -> Result<Retention, String> {
        let kept = retention(self.days, self.megabytes)?;
        if kept.bytes == Some(0) {
            return Err("--megabytes 0: even an empty file is larger; name how large it may become".into());
        }
        Ok(kept)
    }
}

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
}

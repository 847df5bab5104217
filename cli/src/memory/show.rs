//! Prints memory: tables for people, one JSON object per line for programs.

use std::collections::BTreeMap;
use std::io::Write;
use std::time::Duration;

use armarium_memoryx::wire::MaintenanceReport;
use armarium_memoryx::{Snapshot, TimeOf};
use armarium_values::Value;
use serde_json::{Value as Json, json};

use super::CommandFailure;
use super::following::Lag;

/// Longest text of attributes in a row, characters.
const MAX_WIDTH: usize = 72;

/// Prints in one of the two formats.
pub(super) struct Printer {
    json: bool,
    rows: u64,
    /// Whose snapshots these are, where several memories are asked, and the width of the longest of these names.
    pub(super) memory: Option<(String, usize)>,
}

impl Printer {
    pub(super) fn new(json: bool) -> Self {
        Self { json, rows: 0, memory: None }
    }

    /// One snapshot in one line.
    pub(super) fn row(&mut self, snapshot: &Snapshot, out: &mut dyn Write) -> Result<(), CommandFailure> {
        if self.json {
            return self.line(snapshot, out);
        }
        let memory = self.memory.as_ref();
        let whose = |text: &str| {
            memory.map_or_else(String::new, |(_, width)| format!("{text:<w$} ", w = (*width).max(6)))
        };
        if self.rows == 0 {
            writeln!(
                out,
                "{}{:<44} {:>7}  {:<23} {:>5}  attributes",
                whose("memory"),
                "entity",
                "version",
                "time (UTC, or of a run)",
                "conf"
            )?;
        }
        let confidence = snapshot.instance().map_or_else(|| "-".into(), |i| format!("{:.2}", i.confidence));
        let attributes = match snapshot.instance() {
            Some(instance) => cut(&brief(instance.attributes.iter())),
            None => "(removed)".into(),
        };
        let (id, time) = (snapshot.id.as_str(), utc(snapshot.referenced_ns));
        let memory = whose(memory.map_or("", |(name, _)| name));
        writeln!(out, "{memory}{id:<44} {:>7}  {time:<23} {confidence:>5}  {attributes}", snapshot.version)?;
        self.rows += 1;
        Ok(())
    }

    /// One snapshot as JSON.
    fn line(&self, snapshot: &Snapshot, out: &mut dyn Write) -> Result<(), CommandFailure> {
        let mut json = json_of(snapshot);
        if let (Some((memory, _)), Json::Object(fields)) = (&self.memory, &mut json) {
            fields.insert("memory".into(), memory.as_str().into());
        }
        Ok(writeln!(out, "{json}")?)
    }

    /// Prints the number of rows.
    pub(super) fn end(&self, count: u64, what: &str, out: &mut dyn Write) -> Result<(), CommandFailure> {
        if self.json { Ok(()) } else { Ok(writeln!(out, "{count} {what}")?) }
    }

    /// One snapshot with all its data.
    pub(super) fn whole(&self, snapshot: &Snapshot, out: &mut dyn Write) -> Result<(), CommandFailure> {
        if self.json {
            return self.line(snapshot, out);
        }
        let whose = self.memory.as_ref().map_or_else(String::new, |(memory, _)| format!("{memory}: "));
        writeln!(out, "{whose}{} version {}", snapshot.id, snapshot.version)?;
        writeln!(
            out,
            "    referenced {}, sent {}, arrived {}",
            utc(snapshot.referenced_ns),
            utc(snapshot.sent_ns),
            utc(snapshot.arrived_ns)
        )?;
        if snapshot.is_removed() {
            writeln!(out, "    removed")?;
        }
        for instance in &snapshot.instances {
            writeln!(out, "    confidence {:.3}", instance.confidence)?;
            for (name, value) in instance.attributes.iter() {
                writeln!(out, "        {name} = {value}")?;
                if let Some(rows) = instance.covariance.get(name) {
                    writeln!(out, "            covariance {rows:?}")?;
                }
            }
        }
        Ok(())
    }

    pub(super) fn counts(
        &self,
        counts: &BTreeMap<String, u64>,
        out: &mut dyn Write,
    ) -> Result<(), CommandFailure> {
        if self.json {
            return Ok(writeln!(out, "{}", json!(counts))?);
        }
        for (name, count) in counts {
            writeln!(out, "{:<18} {count}", name.replace('_', " "))?;
        }
        Ok(())
    }

    /// The words of a report, then its numbers.
    pub(super) fn words(
        &self,
        report: &MaintenanceReport,
        out: &mut dyn Write,
    ) -> Result<(), CommandFailure> {
        if self.json {
            return Ok(writeln!(out, "{}", json!({"counts": report.counts, "words": report.words}))?);
        }
        for word in &report.words {
            writeln!(out, "{word}")?;
        }
        self.counts(&report.counts, out)
    }

    /// What each owner of provider segments takes in each core segment, and how much it has written since `before`, this long ago.
    pub(super) fn owners(
        &self,
        before: &BTreeMap<String, u64>,
        now: &BTreeMap<String, u64>,
        since: Duration,
        out: &mut dyn Write,
    ) -> Result<(), CommandFailure> {
        if !self.json {
            writeln!(
                out,
                "{:<24} {:<24} {:>10} {:>14} {:>12}",
                "owner", "segment", "entities", "bytes", "updates/s"
            )?;
        }
        for name in now.keys().filter_map(|name| name.strip_suffix("/entities")) {
            let count = |counts: &BTreeMap<String, u64>, what: &str| {
                counts.get(&format!("{name}/{what}")).copied().unwrap_or(0)
            };
            // An earlier program says it of all core segments together.
            let (owner, segment) = name.split_once('/').unwrap_or((name, "*"));
            let (entities, bytes) = (count(now, "entities"), count(now, "bytes"));
            let written = count(now, "updates").saturating_sub(count(before, "updates"));
            let rate = (written as f64 / since.as_secs_f64()).round() as u64;
            if self.json {
                let row = json!({
                    "owner": owner, "segment": segment, "entities": entities, "bytes": bytes, "updates_per_s": rate
                });
                writeln!(out, "{row}")?;
            } else {
                writeln!(out, "{owner:<24} {segment:<24} {entities:>10} {bytes:>14} {rate:>12}")?;
            }
        }
        Ok(())
    }

    /// How far followers are behind. `title` says what the names in the first column do.
    pub(super) fn lags(&self, title: &str, lags: &[Lag], out: &mut dyn Write) -> Result<(), CommandFailure> {
        if !self.json && !lags.is_empty() {
            let titles = ["entities", "behind", "versions", "since, s", "missed", "clock ahead, s"];
            writeln!(out, "{title:<24} {:<10}{}", "state", titles.map(|t| format!("{t:>15}")).concat())?;
        }
        for Lag { who, following, behind } in lags {
            let (behind, why) = (behind.as_ref().ok(), behind.as_ref().err());
            let clock_s = following.clock_ahead_s;
            if self.json {
                let row = json!({
                    title.replace(' ', "_"): who, "state": following.state(), "why": why,
                    "entities": behind.map(|b| b.entities), "behind": behind.map(|b| b.behind),
                    "versions": behind.map(|b| b.versions), "since_s": behind.map(|b| b.since_s),
                    "missed": following.missed, "clock_ahead_s": clock_s,
                });
                writeln!(out, "{row}")?;
                continue;
            }
            let known = |text: Option<String>| text.unwrap_or_else(|| "?".into());
            let columns = [
                known(behind.map(|b| b.entities.to_string())),
                known(behind.map(|b| b.behind.to_string())),
                known(behind.map(|b| b.versions.to_string())),
                known(behind.map(|b| format!("{:.3}", b.since_s))),
                following.missed.to_string(),
                known(clock_s.map(|clock| format!("{clock:.3}"))),
            ];
            let columns = columns.map(|column| format!("{column:>15}")).concat();
            let why = why.map_or_else(String::new, |why| format!("  {why}"));
            writeln!(out, "{who:<24} {:<10}{columns}{why}", following.state())?;
        }
        Ok(())
    }

    /// Numbers by name as OpenMetrics text.
    ///
    /// # Source
    /// OpenMetrics 1.0, "Text format".
    pub(super) fn metrics(
        &self,
        agent: &str,
        counts: &BTreeMap<String, u64>,
        out: &mut dyn Write,
    ) -> Result<(), CommandFailure> {
        let label = agent.replace('\\', r"\\").replace('"', "\\\"");
        for (name, count) in counts {
            let (kind, total) = if name.ends_with("updates") { ("counter", "_total") } else { ("gauge", "") };
            writeln!(out, "# TYPE armarium_memory_{name} {kind}")?;
            writeln!(out, "armarium_memory_{name}{total}{{agent=\"{label}\"}} {count}")?;
        }
        Ok(writeln!(out, "# EOF")?)
    }

    /// Prints how many changes were lost because printing was too slow.
    pub(super) fn lagged(&self, count: u64, out: &mut dyn Write) -> Result<(), CommandFailure> {
        if self.json {
            return Ok(writeln!(out, "{}", json!({ "missed": count }))?);
        }
        Ok(writeln!(out, "({count} changes came faster than they could be shown)")?)
    }
}

pub(super) fn json_of(snapshot: &Snapshot) -> Json {
    let instances = snapshot.instances.iter().map(|instance| {
        let attributes: BTreeMap<&str, Json> =
            instance.attributes.iter().map(|(name, value)| (name, value.to_json())).collect();
        json!({
            "confidence": instance.confidence,
            "attributes": attributes,
            "covariance": instance.covariance,
        })
    });
    json!({
        "id": snapshot.id.as_str(),
        "version": snapshot.version,
        "referenced_ns": snapshot.referenced_ns,
        "referenced_clock": if snapshot.clock() == TimeOf::Run { "run" } else { "day" },
        "sent_ns": snapshot.sent_ns,
        "arrived_ns": snapshot.arrived_ns,
        "removed": snapshot.is_removed(),
        "instances": instances.collect::<Vec<_>>(),
    })
}

fn brief<'a>(attributes: impl Iterator<Item = (&'a str, &'a Value)>) -> String {
    attributes.map(|(name, value)| format!("{name}={value}")).collect::<Vec<_>>().join(" ")
}

fn cut(text: &str) -> String {
    if text.chars().count() <= MAX_WIDTH {
        return text.to_owned();
    }
    let mut short: String = text.chars().take(MAX_WIDTH - 1).collect();
    short.push('…');
    short
}

/// A time, ns since 1970, as UTC. Times of a clock with another epoch are printed in seconds.
fn utc(ns: u64) -> String {
    let (seconds, milliseconds) = (ns / 1_000_000_000, ns / 1_000_000 % 1000);
    if TimeOf::of(ns) == TimeOf::Run {
        return format!("{seconds}.{milliseconds:03} s of a run");
    }
    let (days, rest) = (seconds / 86_400, seconds % 86_400);
    let (year, month, day) = civil(days);
    let (hour, minute, second) = (rest / 3600, rest / 60 % 60, rest % 60);
    format!("{year}-{month:02}-{day:02} {hour:02}:{minute:02}:{second:02}.{milliseconds:03}")
}

/// Year, month and day of a number of days since 1970-01-01.
///
/// # Source
/// Hinnant, "chrono-Compatible Low-Level Date Algorithms", `civil_from_days`.
fn civil(days: u64) -> (u64, u64, u64) {
    let shifted = days + 719_468;
    let (era, day_of_era) = (shifted / 146_097, shifted % 146_097);
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let shifted_month = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * shifted_month + 2) / 5 + 1;
    let month = if shifted_month < 10 { shifted_month + 3 } else { shifted_month - 9 };
    (year_of_era + era * 400 + u64::from(month <= 2), month, day)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_open_metrics() {
        let counts = [("working_bytes", 7), ("working_updates", 3)];
        let counts = counts.map(|(name, count)| (name.to_owned(), count)).into();
        let mut out = Vec::new();
        assert!(Printer::new(false).metrics("a\"b", &counts, &mut out).is_ok());
        let expected = "# TYPE armarium_memory_working_bytes gauge\n\
                        armarium_memory_working_bytes{agent=\"a\\\"b\"} 7\n\
                        # TYPE armarium_memory_working_updates counter\n\
                        armarium_memory_working_updates_total{agent=\"a\\\"b\"} 3\n\
                        # EOF\n";
        assert_eq!(String::from_utf8(out).unwrap(), expected);
    }

    fn said(print: impl FnOnce(&mut Vec<u8>) -> Result<(), CommandFailure>) -> String {
        let mut out = Vec::new();
        assert!(print(&mut out).is_ok());
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn owners_are_listed_by_core_segment() {
        let counts = |updates: u64| {
            let counts =
                [("eye/S/entities", 2), ("eye/S/bytes", 90), ("eye/S/updates", updates), ("me/entities", 1)];
            BTreeMap::from(counts.map(|(name, count)| (name.to_owned(), count)))
        };
        let print = |json| {
            let (before, now) = (counts(10), counts(40));
            said(|out| Printer::new(json).owners(&before, &now, Duration::from_secs(2), out))
        };
        let rows: Vec<String> = print(false)
            .lines()
            .skip(1)
            .map(|row| row.split_whitespace().collect::<Vec<_>>().join(" "))
            .collect();
        assert_eq!(rows, ["eye S 2 90 15", "me * 1 0 0"]);
        assert!(
            print(true)
                .starts_with(r#"{"bytes":90,"entities":2,"owner":"eye","segment":"S","updates_per_s":15}"#)
        );
    }

    #[test]
    fn times_are_dates() {
        assert_eq!(utc(1_500_000_000), "1.500 s of a run");
        assert_eq!(utc(951_782_400_000_000_000), "2000-02-29 00:00:00.000");
        assert_eq!(utc(1_763_736_362_123_456_789), "2025-11-21 14:46:02.123");
    }
}

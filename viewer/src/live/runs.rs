//! The runs of one page: one, two to compare, or as many as something runs that serves others.

use std::collections::BTreeMap;
use std::sync::Arc;

use parking_lot::Mutex;
use serde_json::json;

use super::shown::ShownRun;

/// Most runs that are kept; of more, the oldest that have ended go.
const MOST_RUNS: usize = 1000;

/// Runs by their number, from 0; clones are the same.
#[derive(Clone, Default)]
pub struct ShownRuns(Arc<Mutex<Numbered>>);

#[derive(Default)]
struct Numbered {
    runs: BTreeMap<u64, Arc<dyn ShownRun>>,
    next: u64,
}

impl std::fmt::Debug for ShownRuns {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("ShownRuns").field(&self.len()).finish()
    }
}

impl ShownRuns {
    /// Adds one.
    pub fn add(&self, run: Arc<dyn ShownRun>) {
        let mut numbered = self.0.lock();
        let number = numbered.next;
        numbered.next += 1;
        numbered.runs.insert(number, run);
        if numbered.runs.len() > MOST_RUNS {
            // The first is what the page is of.
            let ended = numbered.runs.iter().skip(1).find(|(_, run)| run.named().1.is_some());
            if let Some(oldest) = ended.map(|(number, _)| *number) {
                numbered.runs.remove(&oldest);
            }
        }
    }

    pub(super) fn get(&self, number: u64) -> Option<Arc<dyn ShownRun>> {
        self.0.lock().runs.get(&number).cloned()
    }

    /// How many there are.
    pub(super) fn len(&self) -> usize {
        self.0.lock().runs.len()
    }

    /// The list for pages: numbers, titles, outcomes.
    pub(super) fn json(&self) -> String {
        let runs: Vec<_> =
            self.0.lock().runs.iter().map(|(number, run)| (*number, Arc::clone(run))).collect();
        let listed = runs.iter().map(|(number, run)| {
            let (title, outcome) = run.named();
            json!({"number": number, "title": title, "outcome": outcome})
        });
        listed.collect::<serde_json::Value>().to_string()
    }
}

impl FromIterator<Arc<dyn ShownRun>> for ShownRuns {
    fn from_iter<I: IntoIterator<Item = Arc<dyn ShownRun>>>(list: I) -> Self {
        let runs = Self::default();
        list.into_iter().for_each(|run| runs.add(run));
        runs
    }
}

#[cfg(test)]
mod tests {
    use std::io::{BufRead as _, BufReader, Write as _};
    use std::net::TcpStream;
    use std::time::Duration;

    use super::*;
    use crate::live::{LivePage, PageAddress, ShownTimeline, Timeline};
    use crate::recorder::{MessageSink as _, RunMessage};

    fn ask(page: &LivePage, path: &str) -> BufReader<TcpStream> {
        let address = page.url().trim_start_matches("http://").trim_end_matches('/');
        let mut stream = TcpStream::connect(address).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
        write!(stream, "GET {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n").unwrap();
        BufReader::new(stream)
    }

    fn content(page: &LivePage, path: &str) -> String {
        let text = std::io::read_to_string(ask(page, path)).unwrap();
        text.split_once("\r\n\r\n").unwrap().1.to_owned()
    }

    /// A transition, as the recorder tells it.
    fn happens(timeline: &Timeline, number: usize) {
        let text = format!(r#"{{"item":{{"what":"transition","source":"S{number}"}}}}"#);
        timeline.take(7, &RunMessage::Json { topic: "/chart/events", text: &text });
    }

    #[test]
    fn a_thousand_charts_are_shown_each_with_its_own_news() {
        let timelines: Vec<Timeline> = (0..MOST_RUNS).map(|_| Timeline::bounded(1 << 10)).collect();
        let shown = |timeline: &Timeline| {
            let shown = ShownTimeline { timeline: timeline.clone(), ..ShownTimeline::default() };
            shown.served() as Arc<dyn ShownRun>
        };
        let runs: ShownRuns = timelines.iter().map(shown).collect();
        let page = LivePage::open(&PageAddress::loopback(0), runs.clone(), Vec::new()).unwrap();
        let listed: serde_json::Value = serde_json::from_str(&content(&page, "/runs")).unwrap();
        assert_eq!(listed.as_array().unwrap().len(), MOST_RUNS);
        // Some are looked at while all go on.
        let looked: Vec<usize> = (0..MOST_RUNS).step_by(20).collect();
        let mut readers: Vec<_> = looked.iter().map(|n| ask(&page, &format!("/runs/{n}/news"))).collect();
        for reader in &mut readers {
            let mut line = String::new();
            while line != "\r\n" {
                line.clear();
                reader.read_line(&mut line).unwrap();
            }
        }
        timelines.iter().enumerate().for_each(|(number, timeline)| happens(timeline, number));
        for (number, reader) in looked.iter().zip(&mut readers) {
            let mut line = String::new();
            while !line.contains("\"events\":[[") {
                line.clear();
                assert_ne!(reader.read_line(&mut line).unwrap(), 0, "news of run {number}");
            }
            assert!(line.contains(&format!("\"S{number}\"")), "{line}");
        }
        assert!(content(&page, "/runs/777/run").contains("\"S777\""));
        // One more: the oldest that has ended goes, but never the first.
        timelines[0].end(json!({"outcome": "success"}));
        timelines[5].end(json!({"outcome": "success"}));
        runs.add(shown(&Timeline::default()));
        assert!(content(&page, "/runs/5/run").contains("no more") && runs.len() == MOST_RUNS);
        assert!(content(&page, "/run").contains("success"));
    }
}

//! A run as pages ask for it: answers by path and query, and news as they come. The run is one of this process
//! ([`ShownTimeline`]) or that of another one, to which the questions are carried.

use std::sync::Arc;
use std::time::Duration;

use armarium_values::report::Section;
use futures::FutureExt as _;
use futures::future::BoxFuture;
use parking_lot::{Condvar, Mutex};
use tokio::sync::{OwnedMutexGuard, broadcast};

use super::timeline::{PagePosition, Timeline, text};
use super::{Action, ActionRefused, Control};
use crate::report::fragment;

/// How often pages are told what is new.
const NEWS: Duration = Duration::from_millis(40);
/// News that wait for a page that is slow.
const WAITING: usize = 32;
/// Points of a curve at most.
const MOST_POINTS: usize = 4000;
const JSON: &str = "application/json";
const TEXT: &str = "text/plain; charset=utf-8";

/// An answer to a page.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PageAnswer {
    /// As in HTTP.
    pub status: u16,
    /// Its media type.
    pub kind: String,
    /// What else there is to say of it: the time of an image, ns, or the states that a chart has closed.
    pub about: String,
    /// The answer itself.
    pub content: Vec<u8>,
}

impl PageAnswer {
    /// An answer that was found.
    fn found(kind: &str, content: impl Into<Vec<u8>>) -> Self {
        Self { status: 200, kind: kind.to_owned(), about: String::new(), content: content.into() }
    }

    /// A refusal with its reason.
    #[must_use]
    pub fn refused(status: u16, reason: impl Into<String>) -> Self {
        Self { status, kind: TEXT.to_owned(), about: String::new(), content: reason.into().into_bytes() }
    }
}

/// A run that pages can be shown.
pub trait ShownRun: Send + Sync {
    /// Answers a question: a path without the slash in front, and a query after `?`.
    fn answer<'a>(&'a self, question: &'a str) -> BoxFuture<'a, PageAnswer>;

    /// What is new from now on, as JSON; the same bytes for all pages. To be called in a tokio runtime.
    fn news(self: Arc<Self>) -> broadcast::Receiver<Arc<[u8]>>;

    /// What it is called where there are several: its title, and its outcome when it has ended.
    fn named(&self) -> (String, Option<String>);

    /// Whether pages may act on it.
    fn may_act(&self) -> bool;

    /// Acts on it. What comes of it is told as news.
    fn act(&self, action: Action) -> Result<(), ActionRefused>;
}

/// Gives the sections of a run's report as far as they are known.
pub type ReportSoFar = Arc<dyn Fn() -> Vec<Section> + Send + Sync>;

/// Gives the newest image of a topic with its time, ns: what the camera sees now, with what was found in it.
pub type NewestImage = Arc<dyn Fn(&str) -> Option<(u64, Arc<[u8]>)> + Send + Sync>;

/// The run of a timeline.
#[derive(Clone, Default)]
pub struct ShownTimeline {
    /// What is known of it.
    pub timeline: Timeline,
    /// Its report, until the timeline has the whole.
    pub report: Option<ReportSoFar>,
    /// What its cameras see now; otherwise the newest image of the timeline is shown.
    pub image: Option<NewestImage>,
    /// Who acts; without it, pages only look.
    pub control: Option<Arc<dyn Control>>,
}

impl std::fmt::Debug for ShownTimeline {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("ShownTimeline")
    }
}

impl ShownTimeline {
    /// The run, which tells its news while somebody looks.
    #[must_use]
    pub fn served(self) -> Arc<ServedTimeline> {
        let (news, telling, end) = (broadcast::channel(WAITING).0, <_>::default(), <_>::default());
        Arc::new(ServedTimeline { shown: self, news, telling, end })
    }
}

/// The run of a timeline with those who are told its news.
#[derive(Debug)]
pub struct ServedTimeline {
    shown: ShownTimeline,
    news: broadcast::Sender<Arc<[u8]>>,
    /// Held by the task that tells the news.
    telling: Arc<tokio::sync::Mutex<PagePosition>>,
    /// Whether pages have been told the end.
    end: (Mutex<bool>, Condvar),
}

impl ServedTimeline {
    /// Waits until pages have been told that the run has ended, if there are any.
    pub fn wait_until_told(&self, longest: Duration) {
        let mut told = self.end.0.lock();
        if self.news.receiver_count() > 0 {
            self.end.1.wait_while_for(&mut told, |told| !*told, longest);
        }
    }

    /// Tells all pages what is new, as long as there are any.
    async fn tell(&self, mut told: OwnedMutexGuard<PagePosition>) {
        let mut tick = tokio::time::interval(NEWS);
        tick.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        loop {
            tick.tick().await;
            if told.end {
                // A moment ago: it has been sent.
                *self.end.0.lock() = true;
                self.end.1.notify_all();
            }
            if self.news.receiver_count() == 0 {
                return;
            }
            if let Some(news) = self.shown.timeline.news(&mut told, self.is_paused()) {
                // Who looked may have gone.
                let _ = self.news.send(news.json().into_bytes().into());
            }
        }
    }

    fn is_paused(&self) -> bool {
        self.shown.control.as_ref().is_some_and(|control| control.is_paused())
    }

    fn find(&self, question: &str) -> PageAnswer {
        let (path, query) = question.split_once('?').unwrap_or((question, ""));
        let asked = |name: &str| field(query, name);
        let number =
            |name: &str| asked(name).and_then(|text| text.parse::<f64>().ok()).filter(|n| n.is_finite());
        let asked_ns = number("t").map(|t| (t.max(0.0) * 1e9) as u64);
        let stamp_ns = asked_ns.unwrap_or(u64::MAX);
        let timeline = &self.shown.timeline;
        match path {
            "run" => PageAnswer::found(JSON, timeline.all(self.is_paused()).json()),
            "chart" => match timeline.chart(asked("closed").as_deref()) {
                Some((about, picture)) => PageAnswer { about, ..PageAnswer::found("image/svg+xml", picture) },
                None => PageAnswer::refused(404, "the chart of this run is not known"),
            },
            "images" => PageAnswer::found(JSON, text(&timeline.images())),
            "poses" => PageAnswer::found(JSON, text(&timeline.poses(stamp_ns))),
            "memory" => PageAnswer::found(JSON, timeline.memory(stamp_ns)),
            "history" => match asked("entity").and_then(|id| timeline.history(&id)) {
                Some(history) => PageAnswer::found(JSON, history),
                None => PageAnswer::refused(404, "memory has no such entity"),
            },
            "series" => {
                let (Some(topic), Some(name)) = (asked("topic"), asked("name")) else {
                    return PageAnswer::refused(400, "`topic` and `name` are needed");
                };
                let range = [number("from").unwrap_or(0.0), number("to").unwrap_or(f64::MAX)];
                let points = (number("points").unwrap_or(800.0).max(1.0) as usize).min(MOST_POINTS);
                match timeline.series(&topic, &name, range, points / 4) {
                    Some(pieces) => PageAnswer::found(JSON, text(&pieces)),
                    None => PageAnswer::refused(404, format!("the run has no `{name}` on `{topic}`")),
                }
            }
            "image" => {
                let topic = asked("topic").unwrap_or_default();
                let newest = self.shown.image.as_ref().filter(|_| asked_ns.is_none());
                let found = newest.and_then(|newest| newest(&topic));
                match found.or_else(|| timeline.image(&topic, stamp_ns)) {
                    Some((stamp_ns, jpeg)) => PageAnswer {
                        about: stamp_ns.to_string(),
                        ..PageAnswer::found("image/jpeg", jpeg.to_vec())
                    },
                    None => PageAnswer::refused(404, "there is no such image"),
                }
            }
            "report" => PageAnswer::found("text/html; charset=utf-8", fragment(&self.sections())),
            "figures" => {
                let sections = self.sections();
                PageAnswer::found(JSON, text(&sections.iter().flat_map(Section::figures).collect::<Vec<_>>()))
            }
            _ => PageAnswer::refused(404, "there is nothing here"),
        }
    }

    /// The whole report, or what is known of it.
    fn sections(&self) -> Arc<[Section]> {
        let so_far = || self.shown.report.as_ref().map(|report| report()).unwrap_or_default().into();
        self.shown.timeline.reported().unwrap_or_else(so_far)
    }
}

impl ShownRun for ServedTimeline {
    fn answer<'a>(&'a self, question: &'a str) -> BoxFuture<'a, PageAnswer> {
        async move { self.find(question) }.boxed()
    }

    fn news(self: Arc<Self>) -> broadcast::Receiver<Arc<[u8]>> {
        let receiver = self.news.subscribe();
        tokio::spawn(async move {
            // One task tells all. It may have been about to end when somebody came: so it looks once more.
            while self.news.receiver_count() > 0
                && let Ok(told) = Arc::clone(&self.telling).try_lock_owned()
            {
                self.tell(told).await;
            }
        });
        receiver
    }

    fn named(&self) -> (String, Option<String>) {
        self.shown.timeline.named()
    }

    fn may_act(&self) -> bool {
        self.shown.control.is_some()
    }

    fn act(&self, action: Action) -> Result<(), ActionRefused> {
        let Some(control) = &self.shown.control else {
            let reason = "this page only looks: `--live-control` lets it act".to_owned();
            return Err(ActionRefused { reason });
        };
        control.act(action)
    }
}

/// A field of a query, with `%20` and `+` read.
fn field(query: &str, name: &str) -> Option<String> {
    let fields = query.split('&').filter_map(|field| field.split_once('='));
    let (_, value) = fields.into_iter().find(|(known, _)| *known == name)?;
    let mut bytes = value.bytes();
    let mut read = Vec::with_capacity(value.len());
    while let Some(byte) = bytes.next() {
        read.push(match byte {
            b'+' => b' ',
            b'%' => {
                let digit = |byte: u8| char::from(byte).to_digit(16);
                let (high, low) = (digit(bytes.next()?)?, digit(bytes.next()?)?);
                (high * 16 + low) as u8
            }
            other => other,
        });
    }
    String::from_utf8(read).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_of_queries_are_read() {
        assert_eq!(field("a=1&topic=%2Frobot%2Fwrench&b=", "topic").as_deref(), Some("/robot/wrench"));
        assert_eq!(field("a=force%5B0%5D+x", "a").as_deref(), Some("force[0] x"));
        for broken in ["a=%", "a=%f", "a=%zz", "b=1", "a=%ff"] {
            assert_eq!(field(broken, "a"), None, "{broken}");
        }
    }
}

//! A live progress line: simulated time, active states, force, speed factor.
//!
//! On a terminal the line is redrawn in place and log lines appear above it; elsewhere a line is written from time
//! to time. The caller passes the time and the writer: this file reads no clock.

use std::io::{self, Write};
use std::sync::Arc;

use parking_lot::Mutex;

/// The content of the line.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ProgressLine {
    /// Simulated time since the run's start, s.
    pub simulated_s: f64,
    /// Wall-clock time since the run's start, s.
    pub wall_s: f64,
    /// Paths of the active states; the innermost are enough.
    pub states: Vec<String>,
    /// Contact force as sensed by the robot, N.
    pub force_n: Option<f64>,
}

impl ProgressLine {
    /// The line without decoration.
    ///
    /// The factor is simulated time over wall-clock time: 2 is twice real time.
    pub fn line(&self) -> String {
        let minutes = (self.simulated_s / 60.0).floor().max(0.0);
        let seconds = self.simulated_s - 60.0 * minutes;
        let mut line = format!("{minutes:02.0}:{seconds:04.1}  {}", states(&self.states));
        if let Some(force) = self.force_n.filter(|f| f.is_finite()) {
            line.push_str(&format!("  {force:5.1} N"));
        }
        if self.wall_s > 0.0 {
            line.push_str(&format!("  {:.1}x", self.simulated_s / self.wall_s));
        }
        line
    }
}

/// Innermost states only, with their common prefix written once: `Wipe: Execution.Wiping |
/// Coaching.Watching`.
fn states(paths: &[String]) -> String {
    let inner: Vec<&str> = paths
        .iter()
        .filter(|path| {
            !paths.iter().any(|o| o.strip_prefix(path.as_str()).is_some_and(|rest| rest.starts_with('.')))
        })
        .map(String::as_str)
        .collect();
    let root = |path: &str| path.split('.').next().map(str::to_owned);
    match inner.split_first() {
        Some((first, rest)) if !rest.is_empty() && rest.iter().all(|path| root(path) == root(first)) => {
            let name = root(first).unwrap_or_default();
            let tails: Vec<&str> = inner
                .iter()
                .map(|path| path.strip_prefix(&name).unwrap_or(path).trim_start_matches('.'))
                .collect();
            format!("{name}: {}", tails.join(" | "))
        }
        _ => inner.join(" | "),
    }
}

struct Inner {
    out: Box<dyn Write + Send>,
    terminal: bool,
    shown: Option<String>,
    next_wall_s: f64,
    next_simulated_s: f64,
    partial: Vec<u8>,
}

/// The live line; clones write to the same output.
#[derive(Clone)]
pub struct Progress {
    inner: Arc<Mutex<Inner>>,
}

impl std::fmt::Debug for Progress {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Progress").finish_non_exhaustive()
    }
}

/// Shortest time between two redraws on a terminal, s of wall-clock time.
const REDRAW_S: f64 = 0.1;
/// Simulated time between two lines on other outputs, s.
const LINE_S: f64 = 10.0;
/// Returns to the line's start and erases the line.
const ERASE: &str = "\r\x1b[2K";

impl Progress {
    /// A line on `out`; `terminal`: whether it can be redrawn in place.
    pub fn new(out: Box<dyn Write + Send>, terminal: bool) -> Self {
        let inner = Inner {
            out,
            terminal,
            shown: None,
            next_wall_s: 0.0,
            next_simulated_s: 0.0,
            partial: Vec::new(),
        };
        Self { inner: Arc::new(Mutex::new(inner)) }
    }

    /// Whether an update at this time would be shown; check it before computing an expensive status.
    pub fn due(&self, simulated_s: f64, wall_s: f64) -> bool {
        self.inner.lock().due(simulated_s, wall_s)
    }

    /// Shows the status, unless the last update was very recent. Write errors are ignored.
    pub fn update(&self, status: &ProgressLine) {
        let mut inner = self.inner.lock();
        if inner.due(status.simulated_s, status.wall_s) {
            inner.next_wall_s = status.wall_s + REDRAW_S;
            inner.next_simulated_s = status.simulated_s + LINE_S;
            drop(inner.show(status.line()));
        }
    }

    /// Writes a line above the live one.
    pub fn print(&self, line: &str) {
        drop(self.inner.lock().print(line.as_bytes()));
    }

    /// Ends the live line; the final status remains on a line of its own.
    pub fn finish(&self, status: &ProgressLine) {
        let mut inner = self.inner.lock();
        drop(inner.show(status.line()).and_then(|()| {
            let terminal = inner.terminal;
            inner.shown = None;
            if terminal { writeln!(inner.out) } else { Ok(()) }
        }));
    }
}

/// Text written here (log lines, for instance) appears above the live line.
impl Write for Progress {
    fn write(&mut self, data: &[u8]) -> io::Result<usize> {
        let mut inner = self.inner.lock();
        inner.partial.extend_from_slice(data);
        while let Some(end) = inner.partial.iter().position(|byte| *byte == b'\n') {
            let line: Vec<u8> = inner.partial.drain(..=end).collect();
            inner.print(line.trim_ascii_end())?;
        }
        Ok(data.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.inner.lock().out.flush()
    }
}

impl Inner {
    fn due(&self, simulated_s: f64, wall_s: f64) -> bool {
        if self.terminal { wall_s >= self.next_wall_s } else { simulated_s >= self.next_simulated_s }
    }

    fn show(&mut self, line: String) -> io::Result<()> {
        if self.terminal {
            self.draw(&line)?;
            self.shown = Some(line);
        } else {
            writeln!(self.out, "{line}")?;
        }
        self.out.flush()
    }

    /// Disables wrapping while drawing, so that a narrow terminal cuts the line.
    fn draw(&mut self, line: &str) -> io::Result<()> {
        write!(self.out, "{ERASE}\x1b[?7l{line}\x1b[?7h")
    }

    fn print(&mut self, line: &[u8]) -> io::Result<()> {
        let shown = self.shown.take();
        if shown.is_some() {
            self.out.write_all(ERASE.as_bytes())?;
        }
        self.out.write_all(line)?;
        self.out.write_all(b"\n")?;
        if let Some(shown) = shown {
            self.draw(&shown)?;
            self.shown = Some(shown);
        }
        self.out.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Clone, Default)]
    struct Page(Arc<Mutex<Vec<u8>>>);

    impl Write for Page {
        fn write(&mut self, data: &[u8]) -> io::Result<usize> {
            self.0.lock().extend_from_slice(data);
            Ok(data.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    impl Page {
        fn text(&self) -> String {
            String::from_utf8(self.0.lock().clone()).expect("text is UTF-8")
        }
    }

    fn at(simulated_s: f64, wall_s: f64) -> ProgressLine {
        let states = ["Wipe", "Wipe.Execution.Wiping", "Wipe.Coaching.Watching"].map(str::to_owned).to_vec();
        ProgressLine { simulated_s, wall_s, states, force_n: Some(7.94) }
    }

    #[test]
    fn the_line_says_time_states_force_and_speed() {
        assert_eq!(
            at(83.25, 40.0).line(),
            "01:23.2  Wipe: Execution.Wiping | Coaching.Watching    7.9 N  2.1x"
        );
        let one = ProgressLine { states: vec!["Learn".into()], ..ProgressLine::default() };
        assert_eq!(one.line(), "00:00.0  Learn");
    }

    #[test]
    fn without_a_terminal_a_line_comes_every_ten_simulated_seconds() {
        let page = Page::default();
        let progress = Progress::new(Box::new(page.clone()), false);
        (0..=250).for_each(|i| progress.update(&at(f64::from(i) * 0.1, f64::from(i))));
        assert_eq!(page.text().lines().count(), 3);
        assert!(!page.text().contains('\x1b'));
    }

    #[test]
    fn a_log_line_stands_above_the_live_line() {
        let page = Page::default();
        let mut progress = Progress::new(Box::new(page.clone()), true);
        progress.update(&ProgressLine { states: vec!["A".into()], ..ProgressLine::default() });
        progress.write_all(b"one\nhalf").expect("writing to memory succeeds");
        let drawn = format!("{ERASE}\x1b[?7l00:00.0  A\x1b[?7h");
        assert_eq!(page.text(), format!("{drawn}{ERASE}one\n{drawn}"));
        assert!(!progress.due(0.0, 0.05) && progress.due(0.0, 0.11));
    }
}

//! Results of tests as JUnit XML, which CI systems read. Nothing is played here.
//!
//! The elements and attributes are those that Jenkins, GitLab and GitHub's reporters read: `testsuites`, `testsuite`,
//! `testcase` with `time` in seconds, `failure` for what is not as expected, `error` for what could not be tried.

use std::fmt::Write as _;
use std::io;
use std::path::Path;
use std::time::Duration;

/// The results of one file.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Suite {
    pub(crate) file: String,
    pub(crate) cases: Vec<CaseResult>,
}

/// The result of one case.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct CaseResult {
    /// What it shows.
    pub(crate) name: String,
    /// How long it took by the wall's clock.
    pub(crate) took: Duration,
    pub(crate) verdict: Verdict,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Verdict {
    /// As expected.
    Passed,
    /// Otherwise than expected.
    Failed(String),
    /// It could not be tried: everything that is wrong, one line each.
    Error(String),
}

impl Suite {
    /// How many cases went so.
    pub(crate) fn count(&self, is: impl Fn(&Verdict) -> bool) -> usize {
        self.cases.iter().filter(|case| is(&case.verdict)).count()
    }

    fn numbers(suites: &[Self]) -> String {
        let sum = |is: &dyn Fn(&Verdict) -> bool| suites.iter().map(|suite| suite.count(is)).sum::<usize>();
        let took: Duration = suites.iter().flat_map(|suite| &suite.cases).map(|case| case.took).sum();
        format!(
            "tests=\"{}\" failures=\"{}\" errors=\"{}\" skipped=\"0\" time=\"{:.3}\"",
            sum(&|_| true),
            sum(&|verdict| matches!(verdict, Verdict::Failed(_))),
            sum(&|verdict| matches!(verdict, Verdict::Error(_))),
            took.as_secs_f64()
        )
    }
}

/// Writes the results to a file; makes its folder where it is missing.
pub(crate) fn write(file: &Path, suites: &[Suite]) -> io::Result<()> {
    if let Some(folder) = file.parent().filter(|folder| !folder.as_os_str().is_empty()) {
        std::fs::create_dir_all(folder)?;
    }
    std::fs::write(file, xml(suites))
}

fn xml(suites: &[Suite]) -> String {
    let mut out = String::from("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n");
    // Writing into a `String` cannot fail.
    let _ = writeln!(out, "<testsuites name=\"armarium test\" {}>", Suite::numbers(suites));
    for suite in suites {
        let file = escaped(&suite.file);
        let numbers = Suite::numbers(std::slice::from_ref(suite));
        let _ = writeln!(out, "  <testsuite name=\"{file}\" file=\"{file}\" {numbers}>");
        for case in &suite.cases {
            let (name, class) = (escaped(&case.name), escaped(class(&suite.file)));
            let took = case.took.as_secs_f64();
            let _ = write!(
                out,
                "    <testcase name=\"{name}\" classname=\"{class}\" file=\"{file}\" time=\"{took:.3}\""
            );
            let (element, text) = match &case.verdict {
                Verdict::Passed => {
                    out.push_str("/>\n");
                    continue;
                }
                Verdict::Failed(text) => ("failure", text),
                Verdict::Error(text) => ("error", text),
            };
            let message = escaped(text.lines().next().unwrap_or(""));
            let _ = writeln!(
                out,
                ">\n      <{element} message=\"{message}\" type=\"{element}\">{}</{element}>\n    </testcase>",
                escaped(text)
            );
        }
        out.push_str("  </testsuite>\n");
    }
    out.push_str("</testsuites>\n");
    out
}

/// A file's name without its endings: readers take a dot in it for the end of a package's name.
fn class(file: &str) -> &str {
    let file = file.strip_suffix(".yaml").or_else(|| file.strip_suffix(".yml")).unwrap_or(file);
    file.strip_suffix(".test").unwrap_or(file)
}

/// Text for an element or an attribute. What XML 1.0 cannot hold is replaced; ends of lines are kept, also in attributes.
fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\n' => out.push_str("&#10;"),
            '\t' => out.push_str("&#9;"),
            '\r' => out.push_str("&#13;"),
            '\0'..=' ' if c != ' ' => out.push('\u{fffd}'),
            '\u{fffe}' | '\u{ffff}' => out.push('\u{fffd}'),
            c => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_are_counted_and_texts_are_kept() {
        let case =
            |name: &str, verdict| CaseResult { name: name.into(), took: Duration::from_millis(12), verdict };
        let suites = [
            Suite {
                file: "a/b.test.yaml".into(),
                cases: vec![
                    case("it <works> & \"ends\"", Verdict::Passed),
                    case("no\u{1}\u{ffff}\u{1b}[0m", Verdict::Failed("step 1: a < b\nmore".into())),
                ],
            },
            Suite { file: "c.yaml".into(), cases: vec![case("all", Verdict::Error("E001".into()))] },
        ];
        assert_eq!(
            xml(&suites),
            "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n\
             <testsuites name=\"armarium test\" tests=\"3\" failures=\"1\" errors=\"1\" skipped=\"0\" time=\"0.036\">\n  \
             <testsuite name=\"a/b.test.yaml\" file=\"a/b.test.yaml\" tests=\"2\" failures=\"1\" errors=\"0\" skipped=\"0\" time=\"0.024\">\n    \
             <testcase name=\"it &lt;works&gt; &amp; &quot;ends&quot;\" classname=\"a/b\" file=\"a/b.test.yaml\" time=\"0.012\"/>\n    \
             <testcase name=\"no\u{fffd}\u{fffd}\u{fffd}[0m\" classname=\"a/b\" file=\"a/b.test.yaml\" time=\"0.012\">\n      \
             <failure message=\"step 1: a &lt; b\" type=\"failure\">step 1: a &lt; b&#10;more</failure>\n    \
             </testcase>\n  </testsuite>\n  \
             <testsuite name=\"c.yaml\" file=\"c.yaml\" tests=\"1\" failures=\"0\" errors=\"1\" skipped=\"0\" time=\"0.012\">\n    \
             <testcase name=\"all\" classname=\"c\" file=\"c.yaml\" time=\"0.012\">\n      \
             <error message=\"E001\" type=\"error\">E001</error>\n    </testcase>\n  </testsuite>\n</testsuites>\n"
        );
    }
}

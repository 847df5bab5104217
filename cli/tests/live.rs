//! The live page: what it answers, what it refuses, that it changes nothing of a run; and the page itself in a real browser.
//!
//! The browser is Debian's Chromium, driven by `playwright-core` (npm); `ARMARIUM_NODE_MODULES` names the folder of the npm packages. Without
//! them these tests say that they were not run; with `ARMARIUM_COMPLETE` they fail.

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use serde_json::Value as Json;

/// Long enough for a browser to see it, and with states inside of states.
const SWINGS: &str = "
statechart: Swings
initial: Begins
locals: {times: {type: int, default: 0}}
events: {enough: {description: The robot has swung enough.}}
states:
  Begins: {always: Swing}
  Swing:
    initial: There
    states:
      There: {skill: MoveJoints, with: {posture: wipe}, transitions: {success: Back}}
      Back:
        skill: MoveJoints
        with: {posture: home}
        exit: {assign: {locals.times: '${locals.times + 1}'}}
        transitions: {success: There}
    transitions: {enough: Done}
    after: {90s: Done}
  Done: {final: success}
";
/// The same for as long as somebody needs to look at it: who has seen enough stops it.
fn long_swings() -> String {
    SWINGS.replace("90s", "2h")
}
const FAILS: &str = "
statechart: Fails
initial: Outer
states:
  Outer:
    initial: Inner
    states:
      Inner: {skill: MoveTcpBy, with: {offset: [0, 0, 5]}}
    transitions: {success: Done}
  Done: {final: success}
";

/// A run with a page.
struct Run {
    child: Child,
    url: String,
    folder: tempfile::TempDir,
    said: BufReader<std::process::ChildStderr>,
    /// What was said before the address.
    before: String,
}

impl Run {
    fn start(chart: &str, options: &[&str]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("chart.yaml");
        std::fs::write(&file, chart).unwrap();
        let mut command = Command::new(env!("CARGO_BIN_EXE_armarium"));
        command.arg("run").arg(&file).args(options).current_dir(folder.path());
        let mut child = command.stdin(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        let mut said = BufReader::new(child.stderr.take().unwrap());
        let (mut url, mut before) = (String::new(), String::new());
        while !(url.starts_with("http://127.0.0.1:") || url.starts_with("https://127.0.0.1:")) {
            before.push_str(&std::mem::take(&mut url));
            assert_ne!(said.read_line(&mut url).unwrap(), 0, "it has printed no address: {before}");
        }
        Self { child, url: url.trim().to_owned(), folder, said, before }
    }

    fn address(&self) -> &str {
        self.url.trim_start_matches("http://").trim_end_matches('/')
    }

    /// Sends a request as it is. Returns what is answered until the connection ends or for a second.
    fn ask(&self, request: &str) -> String {
        let mut stream = TcpStream::connect(self.address()).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(1))).unwrap();
        let _ = stream.write_all(request.as_bytes());
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
        String::from_utf8_lossy(&answer).into_owned()
    }

    fn get(&self, path: &str, more: &str) -> String {
        let host = self.address();
        self.ask(&format!("GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n{more}\r\n"))
    }

    /// The header of who may act.
    fn token(&self) -> String {
        let all = self.get("/run", "");
        let known: Json = serde_json::from_str(all.split_once("\r\n\r\n").unwrap().1).unwrap();
        format!("X-Armarium-Token: {}\r\n", known["token"].as_str().unwrap())
    }

    fn act(&self, token: &str, body: &str) -> String {
        let (host, length) = (self.address(), body.len());
        self.ask(&format!(
            "POST /act HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n{token}Content-Length: {length}\r\n\r\n{body}"
        ))
    }

    /// Waits for its end. Returns its report.
    fn report(mut self) -> Json {
        let mut rest = String::new();
        self.said.read_to_string(&mut rest).unwrap();
        self.child.wait().unwrap();
        let file = self.folder.path().join("report/report.json");
        serde_json::from_str(&std::fs::read_to_string(file).unwrap_or_else(|error| panic!("{error}: {rest}")))
            .unwrap()
    }
}

impl Drop for Run {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[test]
fn a_run_is_the_same_with_readers_that_never_read_reload_and_ask_for_all() {
    let without = {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("chart.yaml");
        std::fs::write(&file, SWINGS).unwrap();
        let mut run = Command::new(env!("CARGO_BIN_EXE_armarium"));
        let done = run.arg("run").arg(&file).current_dir(folder.path()).output().unwrap();
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        let report = std::fs::read_to_string(folder.path().join("report/report.json")).unwrap();
        serde_json::from_str::<Json>(&report).unwrap()
    };
    let run = Run::start(SWINGS, &["--live"]);
    let host = run.address().to_owned();
    // Some who ask for news and never read them.
    let _stalled: Vec<TcpStream> = (0..10)
        .map(|_| {
            let mut stream = TcpStream::connect(&host).unwrap();
            stream.write_all(format!("GET /news HTTP/1.1\r\nHost: {host}\r\n\r\n").as_bytes()).unwrap();
            stream
        })
        .collect();
    for _ in 0..3 {
        let all = run.get("/run", "");
        assert!(all.starts_with("HTTP/1.1 200"), "{all}");
        let body: Json = serde_json::from_str(all.split_once("\r\n\r\n").unwrap().1).unwrap();
        assert_eq!(body["header"]["title"], "Swings");
        assert!(body["header"]["states"]["Swing.There"]["skill"] == "MoveJoints" && body["token"].is_null());
    }
    let report = run.report();
    assert_eq!(report["trace_sha256"], without["trace_sha256"]);
    assert_eq!(report["acted"], serde_json::json!([]));
}

#[test]
fn strangers_are_refused_and_harm_nothing() {
    // In real time it lasts until all has been tried.
    let run = Run::start(SWINGS, &["--live-control", "--speed", "1"]);
    let host = run.address().to_owned();
    let status = |answer: &str| answer.split(' ').nth(1).unwrap_or("none").to_owned();
    assert_eq!(status(&run.get("/", "")), "200");
    assert_eq!(status(&run.ask("GET / HTTP/1.1\r\nHost: evil.example\r\nConnection: close\r\n\r\n")), "403");
    assert_eq!(status(&run.get("/run", "Origin: http://evil.example\r\n")), "403");
    for path in ["/../../etc/passwd", "/%2e%2e/etc/passwd", "/style.css/../run", "//"] {
        assert_eq!(status(&run.get(path, "")), "404", "{path}");
    }
    for path in ["/series", "/series?topic=x", "/image?topic=%zz", "/poses?t=nan", "/chart?closed=%00"] {
        let answer = run.get(path, "");
        assert!(["200", "400", "404"].contains(&status(&answer).as_str()), "{path}: {answer}");
    }
    let act = |token: &str, body: &str| run.act(token, body);
    assert_eq!(status(&act("", r#"{"do":"stop"}"#)), "403");
    assert_eq!(status(&act("X-Armarium-Token: 0123\r\n", r#"{"do":"stop"}"#)), "403");
    let token = run.token();
    assert_eq!(status(&act(&token, "nonsense")), "400");
    let large = format!(
        "POST /act HTTP/1.1\r\nHost: {host}\r\n{token}Content-Length: 1000000000\r\n\r\n{}",
        "x".repeat(100_000)
    );
    assert!(["413", "none"].contains(&status(&run.ask(&large)).as_str()));
    assert!(["400", "none"].contains(&status(&run.ask("\u{1}\u{2} garbage\r\n\r\n")).as_str()));
    assert_eq!(
        status(&run.ask(&format!("GET / HTTP/1.1\r\nHost: {host}\r\nX: {}\r\n\r\n", "y".repeat(100_000)))),
        "431"
    );
    // Far more connections than there is room for; afterwards there is room again.
    let crowd: Vec<_> = (0..1_000).filter_map(|_| TcpStream::connect(&host).ok()).collect();
    drop(crowd);
    // As soon as the server has seen that they are gone.
    assert!((0..10_000).any(|_| status(&run.get("/", "")) == "200"));
    assert_eq!(status(&act(&token, r#"{"do":"event","name":"enough"}"#)), "200");
    let report = run.report();
    assert_eq!(report["outcome"], "success");
    assert!(report["acted"][0].as_str().unwrap().ends_with("event enough"), "{}", report["acted"]);
}

#[test]
fn a_run_that_stands_still_hears_the_request_to_end() {
    let run = Run::start(SWINGS, &["--live-control"]);
    assert!(run.act(&run.token(), r#"{"do":"pause"}"#).starts_with("HTTP/1.1 200"));
    std::process::Command::new("kill").args(["-TERM", &run.child.id().to_string()]).status().unwrap();
    let report = run.report();
    assert_eq!(report["outcome"], "stopped");
    assert_eq!(report["reason"], "stopped by the system (SIGTERM)");
}

#[test]
fn a_recording_that_is_none_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("run.mcap");
    for content in [&b""[..], b"no recording", b"\x89MCAP0\r\n\x04\xff\xff\xff\xff\xff\xff\xff\x7f"] {
        std::fs::write(&file, content).unwrap();
        let shown = Command::new(env!("CARGO_BIN_EXE_armarium")).arg("view").arg(&file).output().unwrap();
        assert_eq!(shown.status.code(), Some(2));
        assert!(String::from_utf8_lossy(&shown.stdout).contains("is no recording of a run"));
    }
}

/// The folder of the npm packages and the browser.
fn browser() -> Option<(PathBuf, PathBuf)> {
    let modules = std::env::var_os("ARMARIUM_NODE_MODULES").map(PathBuf::from);
    let modules = modules.filter(|folder| {
        ["playwright-core", "axe-core", "@foxglove/ws-protocol", "ws"]
            .iter()
            .all(|name| folder.join(name).is_dir())
    });
    let chromium = ["/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome"];
    let chromium = chromium.iter().map(PathBuf::from).find(|file| file.is_file());
    if modules.is_none() || chromium.is_none() {
        crate::outside::not_run(
            "a browser needs Debian's chromium, and the npm packages playwright-core, axe-core, @foxglove/ws-protocol and ws in ARMARIUM_NODE_MODULES",
        );
    }
    modules.zip(chromium)
}

/// Plays a scenario of `live/page.mjs` at an address. Its pictures stay where `ARMARIUM_PICTURES` says.
fn play(scenario: &str, url: &str) -> Option<Json> {
    let folder = tempfile::tempdir().unwrap();
    let pictures = std::env::var_os("ARMARIUM_PICTURES").map_or(folder.path().to_owned(), PathBuf::from);
    play_into(scenario, url, &pictures, url)
}

/// As [`play`], with its pictures in a folder, and the address of a page that may stop the run.
fn play_into(scenario: &str, url: &str, pictures: &Path, actor: &str) -> Option<Json> {
    let (modules, chromium) = browser()?;
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/live/page.mjs");
    let mut node = Command::new("node");
    let played = node
        .arg(script)
        .arg(modules)
        .arg(chromium)
        .args([scenario, url])
        .arg(pictures)
        .arg(actor)
        .output()
        .unwrap();
    let (out, err) = (String::from_utf8_lossy(&played.stdout), String::from_utf8_lossy(&played.stderr));
    assert!(played.status.success(), "{scenario}: {err}");
    Some(serde_json::from_str(&out).unwrap())
}

#[test]
fn a_browser_follows_a_run_to_its_end_and_looks_back() {
    let run = Run::start(&long_swings(), &["--live-control", "--live-hold", "--speed", "1"]);
    let Some(found) = play("follow", &run.url) else { return };
    let during: Vec<&str> = found["during"].as_array().unwrap().iter().filter_map(Json::as_str).collect();
    assert!(
        during.contains(&"Swing") && during.iter().any(|state| state.starts_with("Swing.")),
        "{during:?}"
    );
    assert_eq!(found["outcome"], "stopped");
    assert!(found["entities"].as_u64().unwrap() > 0, "memory has prior knowledge");
}

/// `armarium view`, until it is dropped.
struct View {
    child: Child,
    url: String,
    /// It would end where nobody reads what it says.
    _said: BufReader<std::process::ChildStdout>,
}

impl View {
    fn start(arguments: &[&str]) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_armarium"));
        command.arg("view").args(arguments).stdin(Stdio::null()).stdout(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let mut url = String::new();
        let mut said = BufReader::new(child.stdout.take().unwrap());
        said.read_line(&mut url).unwrap();
        assert!(url.starts_with("http://127.0.0.1:"), "{url}");
        Self { child, url: url.trim().to_owned(), _said: said }
    }
}

impl Drop for View {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[test]
fn a_browser_shows_two_recordings_beside_each_other() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("chart.yaml"), SWINGS).unwrap();
    for (report, time) in [("one", "3s"), ("two", "4s")] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_armarium"));
        command.args(["run", "chart.yaml", "--for", time, "--report", report]).current_dir(folder.path());
        assert_eq!(command.output().unwrap().status.code(), Some(1), "stopped");
    }
    let file = |report: &str| folder.path().join(report).join("run.mcap").display().to_string();
    let view = View::start(&[&file("one"), &file("two")]);
    let Some(found) = play("compare", &view.url) else { return };
    assert!(found["status"].as_str().unwrap().contains("the same 3 transitions"), "{found}");
}

#[test]
fn a_browser_follows_a_run_of_another_agent() {
    let run = Run::start(&long_swings(), &["--name", "bob", "--live-control", "--live-hold"]);
    let heard = run.before.lines().find_map(|line| line.split_once("listens on ")).expect("it says where");
    let view = View::start(&["bob", "--connect", heard.1.trim()]);
    let folder = tempfile::tempdir().unwrap();
    let Some(found) = play_into("follow", &view.url, folder.path(), &run.url) else { return };
    assert_eq!(found["outcome"], "stopped");
    assert!(found["entities"].as_u64().unwrap() > 0, "memory has prior knowledge");
}

#[test]
fn beyond_this_machine_only_who_was_given_the_address_looks() {
    let folder = tempfile::tempdir().unwrap();
    let made = rcgen::generate_simple_self_signed(["127.0.0.1".to_owned()]).unwrap();
    let [certificate, key] = ["certificate.pem", "key.pem"].map(|name| folder.path().join(name));
    std::fs::write(&certificate, made.cert.pem()).unwrap();
    std::fs::write(&key, made.signing_key.serialize_pem()).unwrap();
    let [certificate, key] = [certificate, key].map(|file| file.display().to_string());
    let secured = ["--ca", &certificate, "--certificate", &certificate, "--key", &key];
    let options = [&["--live-control", "--live-hold", "--live-address", "127.0.0.1"], &secured[..]].concat();
    let run = Run::start(&long_swings(), &options);
    assert!(run.url.starts_with("https://") && run.url.contains("/?token="), "{}", run.url);
    let Some(found) = play("invited", &run.url) else { return };
    assert_eq!(found["outcome"], "stopped");
    let address = run.url.trim_start_matches("https://").split('/').next().unwrap().to_owned();
    let mut plain = TcpStream::connect(&address).unwrap();
    plain.set_read_timeout(Some(Duration::from_secs(1))).unwrap();
    plain.write_all(format!("GET /run HTTP/1.1\r\nHost: {address}\r\n\r\n").as_bytes()).unwrap();
    let mut said = Vec::new();
    let _ = plain.read_to_end(&mut said);
    assert!(!String::from_utf8_lossy(&said).contains("HTTP"), "without TLS nothing is said");
}

/// How much two pictures of a view differ: means over blocks of 32 pixels, so that fonts and smoothing do not count. The mean of the
/// differences (of 255), and the share of blocks that differ by more than 40.
fn difference(a: &Path, b: &Path) -> (f64, f64) {
    let blocks = |file: &Path| {
        let picture =
            image::open(file).unwrap_or_else(|error| panic!("{}: {error}", file.display())).to_rgb8();
        image::imageops::resize(&picture, 43, 24, image::imageops::FilterType::Triangle)
    };
    let (a, b) = (blocks(a), blocks(b));
    let levels: Vec<f64> = a.iter().zip(b.iter()).map(|(a, b)| f64::from(a.abs_diff(*b))).collect();
    let share = levels.iter().filter(|level| **level > 40.0).count() as f64 / levels.len() as f64;
    (levels.iter().sum::<f64>() / levels.len() as f64, share)
}

/// A finished run looks as it did. With `GOLDEN=write` the pictures are written again: look at them.
#[test]
fn every_view_looks_as_it_did() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("chart.yaml"), SWINGS).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_armarium"));
    command.args(["run", "chart.yaml", "--for", "4s"]).current_dir(folder.path());
    assert_eq!(command.output().unwrap().status.code(), Some(1), "stopped");
    let view = View::start(&[&folder.path().join("report/run.mcap").display().to_string()]);
    let Some(taken) = play_into("views", &view.url, folder.path(), &view.url) else { return };
    let kept = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/live/views");
    let names: Vec<&str> = taken.as_array().unwrap().iter().filter_map(Json::as_str).collect();
    assert_eq!(names.len(), 7, "{names:?}");
    for name in &names {
        let (now, before) = (folder.path().join(format!("{name}.png")), kept.join(format!("{name}.png")));
        if std::env::var("GOLDEN").is_ok_and(|what| what == "write") {
            std::fs::create_dir_all(&kept).unwrap();
            let picture = image::open(&now).unwrap().to_rgb8();
            let (width, height) = (picture.width() / 2, picture.height() / 2);
            image::imageops::resize(&picture, width, height, image::imageops::FilterType::Triangle)
                .save(&before)
                .unwrap();
        }
        let (mean, share) = difference(&now, &before);
        assert!(
            mean < 5.0 && share < 0.05,
            "{name} differs: {mean:.1} in the mean, {share:.2} of the blocks"
        );
    }
    // Views differ by more than that from each other: the comparison can fail.
    for other in &names[1..] {
        let (mean, share) =
            difference(&kept.join(format!("{other}.png")), &kept.join(format!("{}.png", names[0])));
        assert!(mean > 5.0 || share > 0.05, "{other}: {mean:.1}, {share:.2}");
    }
}

#[test]
fn hands_are_labelled_in_a_browser_and_detectors_are_scored() {
    let folder = tempfile::tempdir().unwrap();
    let photographs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../visionx/tests/photographs");
    for (name, copy) in
        [("real_point_one.jpg", "a.jpg"), ("real_fist.jpg", "b.jpg"), ("real_fist.jpg", "c.jpg")]
    {
        std::fs::copy(photographs.join(name), folder.path().join(copy)).unwrap();
    }
    let labels = folder.path().join("labels.jsonl");
    let [images, file] = [folder.path(), &labels].map(|path| path.display().to_string());
    let mut command = Command::new(env!("CARGO_BIN_EXE_armarium"));
    command.args(["vision", "label", &images, "--labels", &file]).stdin(Stdio::null()).stdout(Stdio::piped());
    let mut page = command.spawn().unwrap();
    let mut said = BufReader::new(page.stdout.take().unwrap());
    let mut url = String::new();
    said.read_line(&mut url).unwrap();
    let found = play("label", url.split(' ').next().unwrap());
    page.kill().unwrap();
    page.wait().unwrap();
    let Some(found) = found else { return };
    assert_eq!(found["problem"], "");
    assert!(found["count"].as_str().unwrap().contains("2 labelled"), "{found}");
    let score = Command::new(env!("CARGO_BIN_EXE_armarium"))
        .args(["vision", "score", &images, "--labels", &file, "--json"])
        .output()
        .unwrap();
    let score: Json = serde_json::from_slice(&score.stdout).unwrap();
    let learned = &score["learned"];
    assert_eq!(
        (&learned["hands"], &learned["found"], &learned["right_gestures"]),
        (&1.into(), &1.into(), &1.into())
    );
    // There is a hand in the second image, but somebody said that there is none.
    assert_eq!((&learned["without"], &learned["false_hands"]), (&1.into(), &1.into()));
    assert!(learned["errors"][0].as_f64().unwrap() < 0.1, "{score}");
}

#[test]
fn foxglove_follows_a_run() {
    let run = Run::start(SWINGS, &["--live", "--foxglove", "0", "--speed", "1", "--for", "60s"]);
    let address = run.before.split_whitespace().find(|word| word.starts_with("ws://127.0.0.1:"));
    let address = address.unwrap_or_else(|| panic!("it is said where: {}", run.before));
    let Some((modules, _)) = browser() else { return };
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/live/foxglove.mjs");
    let wanted = ["/robot/joints foxglove.JointStates", "/tf foxglove.FrameTransform"];
    let told = Command::new("node").arg(script).arg(modules).arg(address).args(wanted).output().unwrap();
    let (out, err) = (String::from_utf8_lossy(&told.stdout), String::from_utf8_lossy(&told.stderr));
    assert!(told.status.success(), "{err}");
    let came: Json = serde_json::from_str(&out).unwrap();
    for topic in wanted {
        assert!(came[topic].as_u64().unwrap_or(0) > 20, "{topic}: {came}");
    }
}

#[test]
fn a_browser_pauses_steps_and_goes_on() {
    let run = Run::start(&long_swings(), &["--live-control", "--live-hold"]);
    let Some(found) = play("act", &run.url) else { return };
    assert!(found["stopped"].as_array().unwrap().contains(&"Swing.Back".into()), "{found}");
    assert_eq!(found["outcome"], "failure");
    assert!(found["problem"].as_str().unwrap().contains("somebody chose that it fails"), "{found}");
    let trace = run.get("/run", "");
    assert!(trace.contains(r#""action":"outcome failure of Swing.There""#), "it is in the trace");
}

#[test]
fn the_page_is_for_everybody() {
    let run = Run::start(FAILS, &["--live-hold"]);
    let Some(found) = play("access", &run.url) else { return };
    assert_eq!(found["axe"], serde_json::json!([]), "axe finds nothing serious");
    let problem = found["problem"].as_str().unwrap();
    assert!(problem.contains("4949 mm") && problem.contains("Outer.Inner < Outer < Fails"), "{problem}");
    assert!(found["failed"].as_array().unwrap().contains(&"Outer.Inner".into()), "{found}");
}

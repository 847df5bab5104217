//! Two processes on loopback: an agent that offers charts, and a run that starts them. One of them is killed, stopped,
//! or cut off, and the other notices within a second.

#![allow(clippy::disallowed_methods, reason = "it waits for other processes on threads of its own")]

use std::io::{BufRead as _, BufReader, Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::path::Path;
use std::process::{Child, ChildStdout, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};

use tempfile::TempDir;

use crate::outside::not_run;

/// What `bob` offers.
const DANCE: &str = "
statechart: Dance
inputs: {steps: {type: int}, pace: {type: float, unit: m/s, default: 0.2 m/s}}
outputs: {danced: {type: int}}
initial: Turning
states:
  Turning:
    after: [{for: 50ms, target: Done, do: [{assign: {outputs.danced: \"${inputs.steps * 2}\"}}]}]
  Done: {final: success}
";
const WAIT: &str = "
statechart: Wait
initial: Waiting
states:
  Waiting: {}
";

/// A process and what it says, line by line.
pub(super) struct Running {
    child: Child,
    lines: Receiver<String>,
    said: Vec<String>,
}

/// Sends what a stream says, line by line.
fn listen(stream: impl Read + Send + 'static, lines: Sender<String>) {
    std::thread::spawn(move || {
        for line in BufReader::new(stream).lines().map_while(Result::ok) {
            // Nobody listens any more once the test is over.
            let _ = lines.send(line).is_ok();
        }
    });
}

impl Running {
    pub(super) fn start(folder: &Path, args: &[&str]) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_armarium"))
            .args(args)
            .current_dir(folder)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the program can be started");
        let (sender, lines) = channel();
        let out: ChildStdout = child.stdout.take().unwrap();
        listen(out, sender.clone());
        listen(child.stderr.take().unwrap(), sender);
        Self { child, lines, said: Vec::new() }
    }

    /// Waits for a line with this text; fails with all that was said when the process ends before.
    pub(super) fn wait_for(&mut self, text: &str) -> String {
        loop {
            let Ok(line) = self.lines.recv() else {
                panic!("`{text}` was not said:\n{}", self.said.join("\n"));
            };
            self.said.push(line.clone());
            if line.contains(text) {
                return line;
            }
        }
    }

    /// Waits for the end; gives the exit status and all that was said.
    pub(super) fn end(mut self) -> (Option<i32>, String) {
        let status = self.child.wait().expect("the process was started").code();
        self.said.extend(self.lines.iter());
        (status, std::mem::take(&mut self.said).join("\n"))
    }

    pub(super) fn signal(&self, name: &str) {
        let kill = format!("kill -{name} {}", self.child.id());
        assert!(Command::new("sh").args(["-c", &kill]).status().unwrap().success());
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // It may have ended.
        let _ = self.child.kill().and_then(|()| self.child.wait()).is_ok();
    }
}

/// A folder with the charts of both.
fn folder(main: &str) -> TempDir {
    let folder = tempfile::tempdir().expect("a temporary folder");
    std::fs::create_dir(folder.path().join("bob")).unwrap();
    std::fs::write(folder.path().join("bob/dance.yaml"), DANCE).unwrap();
    std::fs::write(folder.path().join("bob/wait.yaml"), WAIT).unwrap();
    std::fs::write(folder.path().join("main.yaml"), main).unwrap();
    folder
}

/// An agent that offers the charts, and where it listens.
fn agent(folder: &Path) -> (Running, String) {
    let mut bob =
        Running::start(folder, &["agent", "--name", "bob", "bob", "--store", "bob.redb", "--verbose"]);
    let line = bob.wait_for("listens on ");
    let endpoint = line.split("listens on ").nth(1).unwrap().trim().to_owned();
    (bob, endpoint)
}

fn run(folder: &Path, endpoint: &str) -> Running {
    let args = [
        "run",
        "main.yaml",
        "--connect",
        endpoint,
        "--store",
        "own.redb",
        "--verbose",
        "--record",
        "run.jsonl",
    ];
    Running::start(folder, &args)
}

#[test]
fn the_live_page_of_an_agent_lists_the_charts_that_others_start() {
    let main = "statechart: Main\ninitial: Work\nstates: {Work: {remote: bob/Dance, with: {steps: 3}, transitions: {success: Done}}, Done: {final: success}}\n";
    let folder = folder(main);
    let args = ["agent", "--name", "bob", "bob", "--store", "bob.redb", "--verbose", "--live"];
    let mut bob = Running::start(folder.path(), &args);
    let page = bob.wait_for("http://127.0.0.1:");
    let address = page.trim().trim_start_matches("http://").trim_end_matches('/').to_owned();
    let line = bob.wait_for("listens on ");
    let endpoint = line.split("listens on ").nth(1).unwrap().trim().to_owned();
    for _ in 0..2 {
        let (status, said) = run(folder.path(), &endpoint).end();
        assert_eq!(status, Some(0), "{said}");
    }
    let ask = |path: &str| {
        let mut stream = TcpStream::connect(&address).unwrap();
        write!(stream, "GET {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n").unwrap();
        std::io::read_to_string(stream).unwrap()
    };
    let listed = ask("/runs");
    assert_eq!(listed.matches(r#"{"number":"#).count(), 3, "{listed}");
    assert!(
        listed.contains(r#""title":"bob""#) && listed.matches(r#""title":"Dance""#).count() == 2,
        "{listed}"
    );
    let second = ask("/runs/2/run");
    assert!(second.contains(r#""outcome":"success""#) && second.contains("Turning"), "{second}");
    assert!(ask("/runs/2/").contains("<title>Armarium</title>"));
}

const WAITING: &str = "statechart: Main\ninitial: Work\nstates: {Work: {remote: bob/Wait}}\n";

/// The seconds of silence in the reason that a lost agent gives.
fn silence(said: &str) -> f64 {
    let after = said.split("the agent `bob` is lost: it has not answered for ").nth(1);
    let seconds = after.and_then(|rest| rest.split(' ').next()?.parse().ok());
    seconds.unwrap_or_else(|| panic!("the agent is not lost:\n{said}"))
}

#[test]
fn a_chart_of_another_process_takes_inputs_gives_outputs_and_is_seen() {
    let folder = folder(
        "
statechart: Main
outputs: {n: {type: int}}
initial: Work
states:
  Work:
    remote: bob/Dance
    with: {steps: 21}
    transitions:
      success: [{if: \"Work.danced == 42\", target: Done, do: [{assign: {outputs.n: \"${Work.danced}\"}}]}, {target: Wrong}]
      failure: Wrong
  Done:  {final: success}
  Wrong: {final: failure}
",
    );
    let (_bob, endpoint) = agent(folder.path());
    let (status, said) = run(folder.path(), &endpoint).end();
    assert_eq!(status, Some(0), "{said}");
    assert!(said.contains("Work: inside, Turning"), "{said}");

    // What was recorded passes through the same states again, without the other process.
    let (status, said) = Running::start(folder.path(), &["replay", "run.jsonl"]).end();
    assert_eq!(status, Some(0), "{said}");
    assert!(said.contains("the same states"), "{said}");
}

#[test]
fn charts_of_two_processes_send_each_other_events() {
    let folder = folder(
        "
statechart: Main
events: {bye: {data: {word: string}}}
initial: Both
states:
  Both:
    parallel:
      Work: {remote: bob/Listen}
      Talk:
        initial: Knock
        states:
          Knock:
            enter: [{send: {event: hello, to: bob/Listen, data: {word: hi}}}]
            transitions: {error.communication: Again}
          Again: {after: {50ms: Knock}}
    transitions: {bye: {target: Done, if: event.data.word == 'hi'}, failure: Failed}
  Done:   {final: success}
  Failed: {final: failure}
",
    );
    let listen = "
statechart: Listen
events: {hello: {data: {word: string}}}
initial: Listening
states:
  Listening:
    transitions:
      hello: {target: Done, do: [{send: {event: bye, to: alice, data: {word: \"${event.data.word}\"}}}]}
  Done: {final: success}
";
    std::fs::write(folder.path().join("bob/listen.yaml"), listen).unwrap();
    let (_bob, endpoint) = agent(folder.path());
    let args =
        ["run", "main.yaml", "--name", "alice", "--connect", &endpoint, "--store", "own.redb", "--verbose"];
    let (status, said) = Running::start(folder.path(), &args).end();
    assert_eq!(status, Some(0), "{said}");
    assert!(said.contains("alice listens on tcp/127.0.0.1:"), "{said}");
    assert!(said.contains("bob/Listen: is sent hello"), "{said}");
}

#[test]
fn the_memory_of_an_agent_is_read_and_written_and_survives_its_end() {
    let folder = folder(WAITING);
    let (bob, endpoint) = agent(folder.path());
    let memory = |endpoint: &str, args: &[&str]| {
        let args = [args, &["--agent", "bob", "--connect", endpoint, "--json"]].concat();
        Running::start(folder.path(), &[&["memory"], &args[..]].concat()).end()
    };
    let (status, said) = memory(&endpoint, &["ls"]);
    assert_eq!(status, Some(0), "{said}");
    assert!(said.contains("ObjectClasses"), "what the robot knows beforehand:\n{said}");
    for (id, attribute) in [("Notes/alice/table", "clean=true"), ("ObjectInstances/alice/cup", "class=cup")] {
        let (status, said) = memory(&endpoint, &["put", id, "--set", attribute]);
        assert_eq!(status, Some(0), "{said}");
    }
    let (status, said) = memory(&endpoint, &["put", "Notes/alice/table", "--time", "9000000000000000000"]);
    assert!(status == Some(1) && said.contains("from now"), "{said}");
    let twice = ["memory", "serve", "--name", "bob", "--connect", &endpoint, "--listen", "tcp/127.0.0.1:0"];
    let (status, said) = Running::start(folder.path(), &twice).end();
    assert!(status == Some(1) && said.contains("already"), "{said}");

    bob.signal("KILL");
    assert_eq!(bob.end().0, None);
    let (_bob, endpoint) = agent(folder.path());
    let (status, said) = memory(&endpoint, &["get", "Notes/alice/table"]);
    assert_eq!(status, Some(0), "{said}");
    assert!(said.contains("clean"), "{said}");
    // The world that was seen begins anew; what was seen of it can be asked for.
    let (status, said) = memory(&endpoint, &["get", "ObjectInstances/alice/cup"]);
    assert_eq!(status, Some(1), "{said}");
    let (status, said) = memory(&endpoint, &["get", "ObjectInstances/alice/cup", "--history"]);
    assert!(status == Some(0) && said.contains("cup"), "{said}");
}

/// Checks that the run notices within a second that `lose` has taken its agent away. `endpoint` is where the run reaches it.
fn is_lost(folder: &Path, endpoint: &str, lose: impl FnOnce()) {
    let mut main = run(folder, endpoint);
    main.wait_for("inside, Waiting");
    lose();
    let (status, said) = main.end();
    assert_eq!(status, Some(1), "{said}");
    assert!(silence(&said) < 1.0, "{said}");
}

#[test]
fn an_agent_that_is_killed_is_lost_within_a_second() {
    let folder = folder(WAITING);
    let (bob, endpoint) = agent(folder.path());
    is_lost(folder.path(), &endpoint, || bob.signal("KILL"));
}

#[test]
fn an_agent_that_is_stopped_is_lost_within_a_second_and_ends_what_it_ran_when_it_goes_on() {
    let folder = folder(WAITING);
    let (mut bob, endpoint) = agent(folder.path());
    is_lost(folder.path(), &endpoint, || bob.signal("STOP"));
    bob.signal("CONT");
    bob.wait_for("its caller is gone");
}

#[test]
fn an_agent_that_is_cut_off_is_lost_within_a_second_on_both_sides() {
    let folder = folder(WAITING);
    let (mut bob, endpoint) = agent(folder.path());
    let cable = Cable::to(endpoint.trim_start_matches("tcp/"));
    is_lost(folder.path(), &cable.endpoint, || cable.cut.store(true, Ordering::SeqCst));
    bob.wait_for("its caller is gone");
}

#[test]
fn a_chart_whose_caller_is_killed_cancels_itself() {
    let folder = folder(WAITING);
    let (mut bob, endpoint) = agent(folder.path());
    let mut main = run(folder.path(), &endpoint);
    main.wait_for("inside, Waiting");
    main.signal("KILL");
    bob.wait_for("its caller is gone");
}

#[test]
fn a_name_is_taken_once_and_wrong_uses_are_said_before_anything_runs() {
    let folder =
        folder("statechart: Main\ninitial: W\nstates: {W: {remote: bob/Dance, with: {steps: many}}}\n");
    let (_bob, endpoint) = agent(folder.path());
    let (status, said) = run(folder.path(), &endpoint).end();
    assert_eq!(status, Some(2), "{said}");
    assert!(said.contains("expected int"), "{said}");
    let other = ["agent", "--name", "bob", "--connect", &endpoint, "--store", "other.redb"];
    let (status, said) = Running::start(folder.path(), &other).end();
    assert_eq!(status, Some(2), "{said}");
    assert!(said.contains("there is an agent called `bob` already"), "{said}");
    let (status, said) = Running::start(folder.path(), &["run", "main.yaml"]).end();
    assert_eq!(status, Some(2), "{said}");
    assert!(said.contains("--connect"), "{said}");
}

/// A connection through this process that can be cut: both ends stay open, and hear nothing any more.
struct Cable {
    endpoint: String,
    cut: Arc<AtomicBool>,
    ends: Arc<Mutex<Vec<TcpStream>>>,
}

impl Cable {
    fn to(address: &str) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let endpoint = format!("tcp/{}", listener.local_addr().unwrap());
        let (cut, ends) = (Arc::new(AtomicBool::new(false)), Arc::new(Mutex::new(Vec::new())));
        let (address, cutting, kept) = (address.to_owned(), Arc::clone(&cut), Arc::clone(&ends));
        std::thread::spawn(move || {
            for one in listener.incoming().map_while(Result::ok) {
                let Ok(two) = TcpStream::connect(&address) else { return };
                for (from, to) in [(&one, &two), (&two, &one)] {
                    let (from, to) = (from.try_clone().unwrap(), to.try_clone().unwrap());
                    let cut = Arc::clone(&cutting);
                    std::thread::spawn(move || carry(from, to, &cut));
                }
                kept.lock().unwrap().extend([one, two]);
            }
        });
        Self { endpoint, cut, ends }
    }
}

impl Drop for Cable {
    fn drop(&mut self) {
        for end in self.ends.lock().unwrap().iter() {
            // It may be closed already.
            let _ = end.shutdown(Shutdown::Both).is_ok();
        }
    }
}

fn carry(mut from: TcpStream, mut to: TcpStream, cut: &AtomicBool) {
    let mut bytes = [0; 4096];
    while let Ok(n @ 1..) = from.read(&mut bytes) {
        if !cut.load(Ordering::SeqCst) && to.write_all(&bytes[..n]).is_err() {
            return;
        }
    }
}

/// A Python with the packages `eclipse-zenoh` and `cbor2`, where there is one.
fn python() -> Option<std::ffi::OsString> {
    std::env::var_os("ARMARIUM_PYTHON").filter(|program| {
        let tried = Command::new(program).args(["-c", "import zenoh, cbor2"]).stderr(Stdio::null()).status();
        tried.is_ok_and(|status| status.success())
    })
}

#[test]
fn a_skill_may_live_in_python() {
    let Some(python) = python() else {
        return not_run("ARMARIUM_PYTHON names no Python with the packages eclipse-zenoh and cbor2");
    };
    let folder = folder(
        "
statechart: Main
locals: {heard: {type: int, default: 0}}
initial: Sum
states:
  Sum:
    remote: eve/Sum
    with: {numbers: [1.5, 2, 38.5], takes: 100ms}
    transitions:
      summing: {do: [{assign: {locals.heard: \"${event.data}\"}}]}
      success: [{if: \"Sum.sum == 42.0 && locals.heard == 3\", target: Slow}, {target: Wrong}]
  Slow:
    remote: eve/Sum
    with: {numbers: [1.0], takes: 1h}
    after: {100ms: Empty}
  Empty:
    remote: eve/Sum
    with: {numbers: []}
    transitions: {failure: Done}
  Done:  {final: success}
  Wrong: {final: failure}
",
    );
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/python/offer_skill.py");
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let endpoint = format!("tcp/127.0.0.1:{port}");
    let mut eve = Command::new(python)
        .arg(script)
        .arg(&endpoint)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .expect("Python can be started");
    let mut ready = String::new();
    BufReader::new(eve.stdout.take().unwrap()).read_line(&mut ready).unwrap();
    let (status, said) = run(folder.path(), &endpoint).end();
    drop(eve.stdin.take());
    let left = eve.wait().expect("it was started");
    assert_eq!(ready.trim(), "eve is ready");
    assert_eq!(status, Some(0), "{said}");
    assert!(said.contains("Sum: inside, adding"), "{said}");
    assert!(said.contains("there is nothing to sum"), "{said}");
    assert!(left.success(), "{left}");
}

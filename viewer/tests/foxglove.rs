//! Foxglove's WebSocket beside a recording: read by hand, as a client of the protocol would.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{BufRead as _, BufReader, Write as _};
use std::net::TcpStream;

use armarium_viewer::recorder::Recorder;
use nalgebra::Isometry3;

const REQUEST: &str = "GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
    Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\
    Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n";

/// The next text that a server sends; anything else is passed over.
fn text(stream: &mut impl std::io::Read) -> String {
    loop {
        let mut head = [0; 2];
        stream.read_exact(&mut head).expect("the server goes on");
        let wide = match head[1] {
            126 => 2,
            127 => 8,
            _ => 0,
        };
        let mut length = [0; 8];
        stream.read_exact(&mut length[8 - wide..]).expect("a length");
        let length = if wide == 0 { u64::from(head[1]) } else { u64::from_be_bytes(length) };
        let mut payload = vec![0; usize::try_from(length).expect("a length that fits")];
        stream.read_exact(&mut payload).expect("a payload");
        if head[0] & 0x0f == 1 {
            return String::from_utf8(payload).expect("text");
        }
    }
}

fn write_some(recorder: &mut Recorder) {
    recorder.pose("/truth/tcp", 7, &Isometry3::identity());
    recorder.joints(7, &["a".to_owned()], &[0.1], &[0.2]);
    recorder.event(7, &serde_json::json!({"entered": "Wipe"})).expect("an object encodes");
}

/// Within a runtime like that of a run, whose clock stands still.
#[tokio::test(start_paused = true)]
async fn foxglove_is_told_the_topics_of_the_recording() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("run.mcap");
    let mut recorder = Recorder::create(&path, BTreeMap::new()).expect("the folder can be written");
    let address = recorder.serve_foxglove(0).expect("a port is free");
    write_some(&mut recorder);
    let mut stream = TcpStream::connect(address.trim_start_matches("ws://")).expect("it listens");
    stream.write_all(REQUEST.as_bytes()).expect("it reads");
    let mut stream = BufReader::new(stream);
    let mut head = String::new();
    while !head.ends_with("\r\n\r\n") {
        assert_ne!(stream.read_line(&mut head).expect("an answer"), 0, "{head}");
    }
    assert!(head.starts_with("HTTP/1.1 101"), "{head}");
    let mut told = BTreeSet::new();
    while !told.contains("/chart/events") {
        let message: serde_json::Value = serde_json::from_str(&text(&mut stream)).expect("JSON");
        let channels = message["channels"].as_array().cloned().unwrap_or_default();
        told.extend(channels.iter().filter_map(|channel| channel["topic"].as_str()).map(str::to_owned));
    }
    recorder.finish().expect("the file can be written");
    let data = std::fs::read(&path).expect("the recording exists");
    let summary = mcap::Summary::read(&data).expect("it is whole").expect("there is a summary");
    let recorded: BTreeSet<String> = summary.channels.values().map(|channel| channel.topic.clone()).collect();
    // Topics without a message are told, but not in the file.
    assert!(told.is_superset(&recorded), "{told:?} {recorded:?}");
    assert!(recorded.contains("/truth/tcp") && recorded.contains("/robot/joints"), "{recorded:?}");
}

#[test]
fn a_port_that_is_taken_is_named() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let taken = std::net::TcpListener::bind("127.0.0.1:0").expect("a port is free");
    let port = taken.local_addr().expect("it has an address").port();
    let mut recorder = Recorder::create(&folder.path().join("run.mcap"), BTreeMap::new())
        .expect("the folder can be written");
    let refused = recorder.serve_foxglove(port).expect_err("it is taken").to_string();
    assert!(refused.contains(&port.to_string()), "{refused}");
}

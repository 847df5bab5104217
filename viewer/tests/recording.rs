//! Reads the recorder's file back with the MCAP library: every message, its time, its values; also after a crash.

use std::collections::BTreeMap;
use std::path::PathBuf;

use armarium_viewer::recorder::{LogLevel, Recorder, RecorderOptions, TrueContact, WrenchSample};
use armarium_visionx::RgbImage;
use foxglove::{Decode, messages as fg};
use nalgebra::{Isometry3, Vector3};

const MS: u64 = 1_000_000;

fn tcp(i: u64) -> Isometry3<f64> {
    let phase = i as f64 * 1e-3;
    Isometry3::new(
        Vector3::new(0.3 + 0.05 * libm::cos(phase), 0.5 + 0.05 * libm::sin(phase), 1.0),
        Vector3::z() * phase,
    )
}

/// Records `n` ms of every kind of message.
fn record(path: &std::path::Path, n: u64) -> Recorder {
    let metadata = BTreeMap::from([("seed".to_owned(), "7".to_owned())]);
    let options = RecorderOptions { image_period_ns: 500 * MS, ..RecorderOptions::default() };
    let mut recorder = Recorder::create_with(path, metadata, options).expect("the folder can be written");
    let names: Vec<String> = (0..17).map(|i| format!("Joint {i}")).collect();
    let grey = RgbImage::from_rgb(64, 48, vec![90; 64 * 48 * 3]).expect("the size fits");
    for i in 0..n {
        let (t, x) = (i * MS, libm::sin(i as f64 * 0.013));
        recorder.pose("/truth/tcp", t, &tcp(i));
        recorder.pose("/truth/sponge", t, &tcp(i + 5));
        recorder.contact(t, &TrueContact { normal_n: 8.0 + x, tangential_n: 4.0 }).expect("numbers encode");
        recorder.joints(t, &names, &[x; 17], &[0.5; 17]);
        recorder
            .wrench(t, &WrenchSample { force: [x, 0.0, 8.0], ..Default::default() })
            .expect("numbers encode");
        if i % 100 == 0 {
            recorder.event(t, &serde_json::json!({"entered": "Wipe"})).expect("an object encodes");
            recorder.image("/camera/left", t, &grey).expect("a small image encodes");
            recorder.log(t, LogLevel::Warning, "Wipe", "slippery");
        }
    }
    recorder
}

fn read(path: &std::path::Path, cut: Option<usize>) -> BTreeMap<String, Vec<(u64, Vec<u8>)>> {
    let data = std::fs::read(path).expect("the recording exists");
    let data = &data[..cut.unwrap_or(data.len())];
    let options = if cut.is_some() { mcap::read::Options::IgnoreEndMagic.into() } else { Default::default() };
    let mut topics: BTreeMap<String, Vec<(u64, Vec<u8>)>> = BTreeMap::new();
    for message in mcap::MessageStream::new_with_options(data, options).expect("it is an MCAP file") {
        match message {
            Ok(m) => {
                topics.entry(m.channel.topic.clone()).or_default().push((m.log_time, m.data.into_owned()))
            }
            Err(e) => {
                assert!(cut.is_some(), "a finished recording is whole: {e}");
                break;
            }
        }
    }
    topics
}

fn temp() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("run.mcap");
    (folder, path)
}

#[test]
fn every_message_comes_back_with_its_time_and_values() {
    let (_folder, path) = temp();
    record(&path, 1500).finish().expect("the file can be written");
    let topics = read(&path, None);
    let counts: BTreeMap<&str, usize> = topics.iter().map(|(topic, m)| (topic.as_str(), m.len())).collect();
    let expected = BTreeMap::from([
        ("/camera/left", 3),
        ("/chart/events", 15),
        ("/log", 15),
        ("/robot/joints", 1500),
        ("/robot/wrench", 1500),
        ("/tf", 150),
        ("/truth/contact", 1500),
        ("/truth/sponge", 1500),
        ("/truth/tcp", 1500),
    ]);
    assert_eq!(counts, expected);

    let (t, data) = &topics["/truth/tcp"][1234];
    let pose = fg::PoseInFrame::decode(data.as_slice()).expect("it has Foxglove's schema");
    let position = pose.pose.and_then(|p| p.position).expect("a pose has a position");
    assert_eq!((*t, pose.frame_id.as_str()), (1234 * MS, "root"));
    let expected = tcp(1234).translation.vector;
    // Poses are rounded to a micrometre, contact forces to a millinewton.
    assert!((Vector3::new(position.x, position.y, position.z) - expected).amax() < 0.5e-6);

    let (_, data) = &topics["/truth/contact"][100];
    let contact: TrueContact = serde_json::from_slice(data).expect("it is the JSON of a contact");
    assert!((contact.normal_n - 8.0 - libm::sin(1.3_f64)).abs() < 0.51e-3);
    assert_eq!(contact.tangential_n, 4.0);

    let joints = fg::JointStates::decode(topics["/robot/joints"][1].1.as_slice()).expect("Foxglove's schema");
    assert_eq!(joints.joints.len(), 17);
    assert_eq!((joints.joints[3].name.as_str(), joints.joints[3].velocity), ("Joint 3", Some(0.5)));

    let jpeg =
        fg::CompressedImage::decode(topics["/camera/left"][1].1.as_slice()).expect("Foxglove's schema");
    let image = image::load_from_memory(&jpeg.data).expect("it is a JPEG").to_rgb8();
    assert!(image.pixels().all(|p| p.0.iter().all(|v| v.abs_diff(90) <= 2)));
}

#[test]
fn the_metadata_and_json_schemas_are_in_the_file() {
    let (_folder, path) = temp();
    record(&path, 10).finish().expect("the file can be written");
    let data = std::fs::read(&path).expect("the recording exists");
    let summary = mcap::Summary::read(&data).expect("the summary is whole").expect("there is a summary");
    let schemas: BTreeMap<&str, &str> =
        summary.schemas.values().map(|s| (s.name.as_str(), s.encoding.as_str())).collect();
    assert_eq!(schemas.get("armarium.Contact"), Some(&"jsonschema"));
    assert_eq!(schemas.get("foxglove.PoseInFrame"), Some(&"protobuf"));
    for schema in summary.schemas.values().filter(|s| s.encoding == "jsonschema") {
        let schema: serde_json::Value = serde_json::from_slice(&schema.data).expect("a schema is JSON");
        assert_eq!(schema["type"], "object");
    }
    let metadata = mcap::read::metadata(&data, &summary.metadata_indexes[0]).expect("metadata can be read");
    assert_eq!(metadata.metadata.get("seed").map(String::as_str), Some("7"));
}

#[test]
fn a_crash_loses_at_most_the_last_moments() {
    let (_folder, path) = temp();
    let recorder = record(&path, 7000);
    // The file now has the content that a killed program leaves.
    let on_disk = std::fs::metadata(&path).expect("the file exists").len();
    let topics = read(&path, Some(usize::try_from(on_disk).expect("it fits into memory")));
    assert!(topics["/truth/tcp"].len() >= 5000, "{} of 7000 poses", topics["/truth/tcp"].len());
    drop(recorder);
    assert_eq!(read(&path, None)["/truth/tcp"].len(), 7000);
}

#[test]
fn a_file_cut_anywhere_gives_what_came_before() {
    let (_folder, path) = temp();
    let options = RecorderOptions { chunk_bytes: 4096, ..RecorderOptions::default() };
    let mut recorder =
        Recorder::create_with(&path, BTreeMap::new(), options).expect("the folder can be written");
    (0..2000).for_each(|i| recorder.pose("/truth/tcp", i * MS, &tcp(i)));
    recorder.finish().expect("the file can be written");
    let size = std::fs::metadata(&path).expect("the file exists").len() as usize;
    for cut in [size / 3, size / 2, size - 100] {
        let poses = read(&path, Some(cut)).remove("/truth/tcp").unwrap_or_default();
        assert!(poses.len() > 400, "{} after {cut} of {size} bytes", poses.len());
        assert!(poses.iter().enumerate().all(|(i, (t, _))| *t == i as u64 * MS));
    }
}

#[test]
fn a_recording_that_cannot_be_created_says_where() {
    let error = Recorder::create(std::path::Path::new("/no/such/folder/run.mcap"), BTreeMap::new())
        .expect_err("there is no such folder");
    assert!(error.to_string().contains("/no/such/folder/run.mcap"));
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_the_cause_that_is_named() {
    use std::error::Error as _;

    let mut recorder = Recorder::create(std::path::Path::new("/dev/full"), BTreeMap::new())
        .expect("what is written first is collected");
    let broken = (0..1000_u64).find_map(|second| {
        recorder.log(second * 1_000_000_000, LogLevel::Info, "A", "on and on");
        recorder.health().err()
    });
    let error = broken.expect("nothing can be written there");
    let causes = std::iter::successors(error.source(), |cause| (*cause).source());
    let said: Vec<String> = causes.map(ToString::to_string).collect();
    assert!(said.iter().any(|cause| cause.contains("No space left")), "{said:?}");
}

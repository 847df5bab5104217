//! `armarium image` with real processes: what one offers, others list, show, record and play; and a provider that is
//! killed harms nobody.
use std::collections::BTreeSet;
use std::io::{BufRead, BufReader, Lines};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Output, Stdio};
use std::time::Duration;

use armarium_bus::{Session, SessionConfig};
use armarium_visionx::annotate::png;
use armarium_visionx::providers::convert::depth_png;
use armarium_visionx::providers::{
    Delivery, ImageCoding, ImageProvider, PixelFormat, RawImage, RemoteProvider,
};
use armarium_visionx::{RgbImage, files};

const WAIT: Duration = Duration::from_secs(60);

/// A process that is ended when the test is, and what it says: it could not go on if nobody read that.
struct Process {
    child: Child,
    _says: Lines<BufReader<ChildStdout>>,
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.child.kill().is_ok();
        let _ = self.child.wait().is_ok();
    }
}

fn armarium(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_armarium"));
    command.args(arguments).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

/// Plays files, and says where.
fn play(arguments: &[&str]) -> (Process, String) {
    let mut child = armarium(&[&["image", "play"], arguments].concat()).spawn().unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let endpoint = loop {
        let line = lines.next().expect("it says where it listens").unwrap();
        if let Some(endpoint) = line.trim().strip_prefix("listens on ") {
            break endpoint.to_owned();
        }
    };
    (Process { child, _says: lines }, endpoint)
}

fn done(arguments: &[&str]) -> Output {
    let output = armarium(arguments).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{arguments:?}: {said}");
    output
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// Three flat pictures.
fn pictures(folder: &Path) {
    for (name, value) in [("a.png", 10u8), ("b.png", 20), ("c.png", 30)] {
        let image = RgbImage::from_rgb(64, 48, vec![value; 64 * 48 * 3]).unwrap();
        std::fs::write(folder.join(name), png(&image).unwrap()).unwrap();
    }
}

#[test]
fn what_is_played_is_listed_shown_counted_recorded_and_played_again() {
    let folder = tempfile::tempdir().unwrap();
    pictures(folder.path());
    let files = folder.path().to_str().unwrap();
    let (_playing, endpoint) = play(&[files, "--name", "alice", "--loop", "--rate", "50"]);
    let connect = ["--connect", endpoint.as_str()];

    let listed = said(&done(&[&["image", "ls"][..], &connect].concat()));
    assert!(listed.contains("alice/files") && listed.contains("image: 64 x 48"), "{listed}");

    let shown = folder.path().join("shown");
    let arguments = ["image", "view", "alice/files", "--png", shown.to_str().unwrap(), "--frames", "2"];
    done(&[&arguments[..], &connect].concat());
    let images = files::images_in(std::slice::from_ref(&shown)).unwrap();
    assert_eq!(images.len(), 2);
    assert!([10, 20, 30].contains(&files::read_image(&images[0]).unwrap().pixel(5, 5)[0]));

    let counted =
        done(&[&["image", "stats", "alice/files", "--seconds", "2", "--json"][..], &connect].concat());
    let counted: serde_json::Value = serde_json::from_slice(&counted.stdout).unwrap();
    assert!(counted["frames"].as_u64().unwrap() > 2, "{counted}");
    assert_eq!(counted["bytes_per_frame"], 64 * 48 * 3);

    let recording = folder.path().join("r.mcap");
    let to = recording.to_str().unwrap();
    let recorded =
        done(&[&["image", "record", "alice/files", "-o", to, "--frames", "6"][..], &connect].concat());
    assert!(said(&recorded).contains("6 frames, 0 missed"), "{}", said(&recorded));

    let (_again, endpoint) = play(&[to, "--name", "bob", "--speed", "2", "--loop"]);
    let counted = done(&["image", "stats", "bob/files", "--seconds", "1", "--json", "--connect", &endpoint]);
    assert!(said(&counted).contains("\"sizes\":[[[64,48]]]"), "{}", said(&counted));
    let counted = done(&["image", "stats", to, "--json"]);
    assert!(said(&counted).contains("\"frames\":6"), "{}", said(&counted));
}

#[test]
fn what_is_wrong_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let wrong = |arguments: &[&str], status: i32, word: &str| {
        let output = armarium(&[&["image"], arguments].concat()).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(status), "{said}");
        assert!(said.contains(word), "{said}");
    };
    let broken = folder.path().join("broken.mcap");
    std::fs::write(&broken, b"no recording").unwrap();
    wrong(&["play", broken.to_str().unwrap()], 2, "no recording that can be read");
    wrong(&["play", folder.path().to_str().unwrap()], 2, "no PNG or JPEG file");
    wrong(&["stats", "nonsense"], 2, "AGENT/PROVIDER");
    wrong(&["view", "nobody/eyes", "--connect", "tcp/10.0.0.1:7447"], 2, "--off-loopback");
    pictures(folder.path());
    wrong(&["calibrate-check", folder.path().to_str().unwrap()], 2, "no image `left`");
    let files = folder.path().to_str().unwrap();
    wrong(&["play", files, "--speed", "0"], 2, "greater than 0");
    let photo = folder.path().join("a.png");
    wrong(&["process", photo.to_str().unwrap()], 2, "a.png` gives no stereo pairs");
    wrong(&["play", broken.to_str().unwrap(), files], 2, "cannot be mixed");
    wrong(&["record", "nobody/eyes", "-o", broken.to_str().unwrap()], 2, "--force");
    assert_eq!(std::fs::read(&broken).unwrap(), b"no recording");
    std::fs::rename(&photo, folder.path().join("a_depth.png")).unwrap();
    wrong(&["stats", files], 2, "no depth image");
}

#[test]
fn depth_is_written_so_that_it_can_be_played_and_a_table_needs_its_place() {
    let folder = tempfile::tempdir().unwrap();
    let metres: Vec<u8> = [0.5f32, 0.0, 1.234, 4.5].iter().flat_map(|z| z.to_le_bytes()).collect();
    let depth = RawImage::new("depth", PixelFormat::Depth32F, (2, 2), metres).unwrap();
    let depth = depth_png(&depth).unwrap().unwrap();
    let left = png(&RgbImage::from_rgb(2, 2, vec![9; 12]).unwrap()).unwrap();
    for (name, bytes) in [("0_left", &left), ("0_right", &left), ("0_depth", &depth)] {
        std::fs::write(folder.path().join(format!("{name}.png")), bytes).unwrap();
    }
    calibrated(folder.path(), "");
    let (files, shown) = (folder.path().to_str().unwrap(), folder.path().join("shown"));
    done(&["image", "view", files, "--png", shown.to_str().unwrap()]);
    let (_, _, read) = files::read_depth(&shown.join("000001_depth.png")).unwrap();
    assert_eq!(read, [500u16, 0, 1234, 4500].iter().flat_map(|mm| mm.to_le_bytes()).collect::<Vec<_>>());

    let tabletop = || armarium(&["image", "process", files, "--look", "tabletop"]).output().unwrap();
    let output = tabletop();
    let complaint = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{complaint}");
    assert!(
        complaint.contains("root_from_camera") && said(&output).contains("\"unusable\":1"),
        "{complaint}"
    );
    calibrated(folder.path(), "root_from_camera: {rotation: [0, 0, 0, 1], translation: [0, 0, 1]}\n");
    assert!(tabletop().status.success());
}

/// The shared memory of a process.
fn segments(process: u32) -> BTreeSet<PathBuf> {
    let maps = std::fs::read_to_string(format!("/proc/{process}/maps")).unwrap_or_default();
    let paths = maps.lines().filter_map(|line| line.split_whitespace().nth(5));
    paths.filter(|path| path.starts_with("/dev/shm/")).map(PathBuf::from).collect()
}

/// Pairs of several sizes and colours, calibrated for the first; how many there are, and how many of them fit.
fn pairs(folder: &Path) -> (u64, u64) {
    let sizes = [(64, 48), (1, 1), (64, 1), (1, 48), (65, 47), (320, 240), (64, 48)];
    let mut noise = 1u32;
    let mut write = |name: String, size: (u32, u32), value: u8| {
        let mut pixel = || {
            noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            if value == 7 { (noise >> 24) as u8 } else { value }
        };
        let image =
            RgbImage::from_rgb(size.0, size.1, (0..size.0 * size.1 * 3).map(|_| pixel()).collect()).unwrap();
        std::fs::write(folder.join(name), png(&image).unwrap()).unwrap();
    };
    for (i, size) in sizes.into_iter().enumerate() {
        for value in [0, 7, 255] {
            for eye in ["left", "right"] {
                write(format!("{i}_{value}_{eye}.png"), size, value);
            }
        }
    }
    // Eyes of unlike size, and one that is broken.
    write("8_left.png".into(), (64, 48), 9);
    write("8_right.png".into(), (64, 40), 9);
    std::fs::write(folder.join("9_left.png"), b"\x89PNG\r\n\x1a\n broken").unwrap();
    write("9_right.png".into(), (64, 48), 9);
    calibrated(folder, "");
    (3 * sizes.len() as u64 + 2, 6)
}

/// Two parallel cameras, and what else is said of them.
fn calibrated(folder: &Path, more: &str) {
    let camera = |shift: f64| {
        format!(
            "{{focal: [50, 50], center: [32, 24], distortion: {{k1: 0, k2: 0, p1: 0, p2: 0, k3: 0}}, \
             reference_from_camera: {{rotation: [0, 0, 0, 1], translation: [{shift}, 0, 0]}}}}"
        )
    };
    let text = format!("left: {}\nright: {}\n{more}", camera(0.0), camera(0.1));
    std::fs::write(folder.join("calibration.yaml"), text).unwrap();
}

#[test]
fn black_white_noise_tiny_broken_and_unfit_pictures_are_counted_by_every_command() {
    let folder = tempfile::tempdir().unwrap();
    let (all, fit) = pairs(folder.path());
    let files = folder.path().to_str().unwrap();
    for look in ["hand", "fingertips", "marker"] {
        let processed = said(&done(&["image", "process", files, "--look", look]));
        let counts: serde_json::Value = serde_json::from_str(processed.lines().last().unwrap()).unwrap();
        // A broken message is not counted as a frame; a frame of the wrong size is counted as unusable.
        assert_eq!(counts["frames"], all - 1, "{look}: {counts}");
        assert_eq!(counts["unusable"], all - fit, "{look}: {counts}");
        assert_eq!(processed.lines().count() as u64, fit + 1, "{look}: {processed}");
    }
    let counted = done(&["image", "stats", files, "--json"]);
    let counted: serde_json::Value = serde_json::from_slice(&counted.stdout).unwrap();
    assert_eq!((&counted["frames"], &counted["spoilt"]), (&(all - 1).into(), &1.into()), "{counted}");
    let shown = folder.path().join("shown");
    let written = said(&done(&["image", "view", files, "--png", shown.to_str().unwrap(), "--frames", "99"]));
    assert_eq!(files::images_in(&[shown]).unwrap().len() as u64, 2 * (all - 1));
    assert!(written.contains("warning: ") && written.contains("9_left.png"), "{written}");
    let checked = armarium(&["image", "calibrate-check", files, "--frames", "99"]).output().unwrap();
    assert_eq!(checked.status.code(), Some(1), "there is nothing to see in them");
    for what in ["gesture", "fingertips", "skin", "marker"] {
        let looked = armarium(&["vision", what, "--json", files]).output().unwrap();
        assert_eq!(looked.status.code(), Some(2), "one is broken");
        assert_eq!(said(&looked).lines().filter(|line| line.contains("\"error\"")).count(), 1);
        assert_eq!(said(&looked).lines().count() as u64, 2 * all);
    }
}

/// What is long enough to hold frames: the rest is Zenoh's bookkeeping.
fn holds_frames(segment: &Path) -> bool {
    std::fs::metadata(segment).is_ok_and(|file| file.len() >= 4 << 20)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_provider_that_is_killed_and_started_again_is_seen_again_and_leaves_no_memory_behind() {
    let folder = tempfile::tempdir().unwrap();
    pictures(folder.path());
    let files = folder.path().to_str().unwrap();
    let (mut playing, endpoint) = play(&[files, "--name", "carol", "--loop", "--rate", "50"]);
    let config =
        SessionConfig { shared_memory: true, ..SessionConfig::connected_to(std::slice::from_ref(&endpoint)) };
    let session = Session::open(&config).await.unwrap();
    let (delivery, coding) = (Delivery::Newest, ImageCoding::Raw);
    let reader = RemoteProvider::connect(&session, "carol", "files", delivery, coding, WAIT).await.unwrap();
    for _ in 0..3 {
        tokio::time::timeout(WAIT, reader.next()).await.unwrap().unwrap();
    }
    assert!(reader.statistics().shared.get() > 0);
    let mut left = BTreeSet::new();
    for life in 2..=4 {
        let mapped = segments(playing.child.id());
        assert!(mapped.iter().any(|segment| holds_frames(segment)), "its frames are in shared memory");
        left.extend(mapped);
        playing.child.kill().unwrap();
        playing.child.wait().unwrap();
        (playing, _) = play(&[files, "--name", "carol", "--loop", "--rate", "50", "--listen", &endpoint]);
        while reader.statistics().lives.get() < life {
            tokio::time::timeout(WAIT, reader.next()).await.expect("the reader goes on").unwrap();
        }
        let held: Vec<&PathBuf> = left.iter().filter(|segment| holds_frames(segment)).collect();
        assert!(held.is_empty(), "the reader lives, and has let go of its dead provider's frames: {held:?}");
    }
    drop(playing);
    drop(reader);
    session.close().await.unwrap();
    // What this process still maps of Zenoh's bookkeeping goes when it ends.
    armarium_bus::bulk::remove_orphans();
    let own = segments(std::process::id());
    let still: Vec<&PathBuf> = left.difference(&own).filter(|path| path.exists()).collect();
    assert!(still.is_empty(), "left behind: {still:?}");
}

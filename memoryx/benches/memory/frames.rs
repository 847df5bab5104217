//! Images in long-term memory: noisy frames of 640x480 pixels, raw and as JPEG. Each must be durable before the next
//! is due.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use armarium_memoryx::{
    Coding, Commit, EntityId, LongTermMemory, MemoryLimits, Pattern, Policies, Policy, Query, Times,
    WorkingMemory,
};
use armarium_values::Value;
use image::{ExtendedColorType, ImageEncoder, codecs::jpeg::JpegEncoder};

use super::{Meter, at_most, median, on_file, resident_mb, say};

const WIDTH: usize = 640;
const HEIGHT: usize = 480;
const BYTES: usize = WIDTH * HEIGHT * 3;
/// Frames a second.
const HZ: u32 = 30;

/// A camera that sees a lit wall and a dark box, with noise of about four grey levels in each pixel of each frame.
struct Camera {
    scene: Vec<u8>,
    noise: Vec<i8>,
}

impl Camera {
    fn new() -> Self {
        let mut state = 1_u64;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 60) as i8
        };
        // Sums of uniform numbers are about normally distributed; the standard deviation of these is 4.0.
        let noise = (0..BYTES + 100_003).map(|_| {
            let sum = i16::from(random()) + i16::from(random()) + i16::from(random()) - 22;
            (sum / 2) as i8
        });
        let noise = noise.collect();
        let scene = (0..BYTES).map(|i| {
            let (x, y, channel) = (i / 3 % WIDTH, i / 3 / WIDTH, i % 3);
            let is_box = (200..380).contains(&x) && (150..400).contains(&y);
            if is_box { 40 + 30 * channel as u8 } else { (60 + x / 8 + y / 10 + 10 * channel) as u8 }
        });
        Self { scene: scene.collect(), noise }
    }

    fn frame(&self, number: usize) -> Vec<u8> {
        let noise = &self.noise[number * 7919 % 100_003..];
        self.scene.iter().zip(noise).map(|(s, n)| s.saturating_add_signed(*n)).collect()
    }
}

/// RGB pixels as a JPEG file.
fn jpeg(value: &Value) -> Option<Value> {
    let Value::Bytes(pixels) = value else { return None };
    let mut file = Vec::new();
    let encoder = JpegEncoder::new_with_quality(&mut file, 85);
    encoder.write_image(pixels, WIDTH as u32, HEIGHT as u32, ExtendedColorType::Rgb8).ok()?;
    Some(Value::Bytes(file))
}

fn policies(coded: bool) -> Policies {
    let policies = Policies::all(Policy::Everything);
    if coded { policies.coded("Images", Coding::new("jpeg:85", jpeg)) } else { policies }
}

/// Commits frames durably and prints the figures; `paced`: one frame every thirtieth of a second.
#[allow(clippy::disallowed_methods, reason = "figures are of the wall clock")]
fn take(path: PathBuf, count: u64, coded: bool, paced: bool) {
    let what = if coded { "JPEG" } else { "raw" };
    let camera = Camera::new();
    let id = EntityId::new("Images", "camera", "left").expect("a name");
    let (store, memory) = on_file(&path, policies(coded), MemoryLimits::default());
    let period = Duration::from_secs(1) / HZ;
    let (mut waits, mut late, mut refused) = (Vec::new(), 0_u64, 0_u64);
    let start = Meter::start();
    for number in 0..count {
        let due = period * u32::try_from(number).unwrap_or(u32::MAX);
        match due.checked_sub(start.elapsed()).filter(|_| paced) {
            Some(early) => std::thread::sleep(early),
            // The next frame was due before this one was stored.
            None => late += u64::from(paced && start.elapsed() > due + period),
        }
        let pixels = Value::Bytes(camera.frame(number as usize));
        let update = Commit::new(id.clone(), number * 1_000_000_000 / u64::from(HZ), [("pixels", pixels)]);
        let begun = Meter::start();
        refused += u64::from(memory.commit_now(vec![update]).is_err());
        waits.push(begun.elapsed());
    }
    let seconds = start.elapsed().as_secs_f64();
    let each_ms = start.processor_us() / count as f64 / 1e3;
    let longest = waits.iter().max().map_or(0.0, |wait| wait.as_secs_f64() * 1e3);
    let stats = store.stats().expect("it can be read");
    let lost = count - stats.snapshots;
    say(
        &format!("{count} noisy 640x480 RGB frames, durable one by one, {what}"),
        count as f64 / seconds,
        "/s",
        "asked: 30",
    );
    at_most("  lost, and refused", (lost + refused) as f64, "", 0.0);
    say("  taken a frame late or more", late as f64, "", "");
    at_most("  commit, median", median(waits) / 1e3, "ms", 33.0);
    say("  commit, longest", longest, "ms", "");
    say("  processor time a frame, its making included", each_ms, "ms", "");
    say("  kept a frame", stats.bytes as f64 / count as f64 / 1e3, "kB", "");
    say("  resident set", resident_mb(), "MB", "");
    if !paced {
        // A copy of an open file stands for the file of a killed process.
        let killed = path.with_extension("killed");
        std::fs::copy(&path, &killed).expect("room");
        let gb = std::fs::metadata(&killed).map_or(0, |file| file.len()) as f64 / 1e9;
        let start = Meter::start();
        drop(LongTermMemory::open(&killed).expect("a file"));
        let ms = start.elapsed().as_secs_f64() * 1e3;
        at_most(&format!("  opened after a kill, a file of {gb:.2} GB"), ms, "ms", 1000.0);
        let _ = std::fs::remove_file(killed);
    }
    drop((memory, store));
    opened(&path, count, coded);
}

/// Opens the stored file, and reads one frame from its middle.
fn opened(path: &Path, count: u64, coded: bool) {
    let start = Meter::start();
    let store = LongTermMemory::open(path).expect("a file");
    let memory = WorkingMemory::new(Arc::new(|| 0));
    store.load_into(&memory, Pattern::any()).expect("it can be read");
    say(
        "  opened again, newest frame loaded",
        start.elapsed().as_secs_f64() * 1e3,
        "ms",
        "asked: under 1000",
    );
    let start = Meter::start();
    let at = count / 2 * 1_000_000_000 / u64::from(HZ);
    let found = store.query(&Query::latest(Pattern::any()).times(Times::At(at))).expect("it can be read");
    say("  one frame out of the middle", start.elapsed().as_secs_f64() * 1e3, "ms", "");
    let wanted = Camera::new().frame((count / 2) as usize);
    let kept = found.first().and_then(|s| s.attribute("pixels")).expect("a frame was kept");
    let bytes = if let Value::Bytes(bytes) = kept { bytes.as_slice() } else { &[] };
    let pixels = if coded {
        image::load_from_memory(bytes).expect("a JPEG").to_rgb8().into_raw()
    } else {
        bytes.to_vec()
    };
    let square: f64 = wanted.iter().zip(&pixels).map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2)).sum();
    say("  its error, root mean square", (square / BYTES as f64).sqrt(), "of 255", "");
}

pub(super) fn as_fast_as_they_go(folder: &Path) {
    for coded in [false, true] {
        let path = folder.join(if coded { "jpeg.redb" } else { "raw.redb" });
        take(path.clone(), 60 * u64::from(HZ), coded, false);
        // Free the two gigabytes before the next part.
        let _ = std::fs::remove_file(path);
    }
}

/// Ten minutes at 30 frames a second; the word `raw` or `jpeg` selects one kind.
pub(super) fn ten_minutes(wanted: &[String]) {
    for coded in [false, true] {
        let name = if coded { "jpeg" } else { "raw" };
        let other = if coded { "raw" } else { "jpeg" };
        if wanted.iter().any(|word| word == other) && !wanted.iter().any(|word| word == name) {
            continue;
        }
        let folder = tempfile::tempdir().expect("a folder");
        take(folder.path().join("images.redb"), 600 * u64::from(HZ), coded, true);
    }
}

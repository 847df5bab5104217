use super::super::writing::RecordingWriter;
use super::super::{PixelFormat, RawImage};
use super::*;

const ALL: Pace = Pace { speed: None, repeat: false };

fn frame(number: u64) -> RawFrame {
    let depth: Vec<u8> = (0..6u32).flat_map(|i| (i as f32 * 0.1).to_le_bytes()).collect();
    RawFrame {
        number,
        stamp_ns: number * 50_000_000,
        frame_id: "eye".into(),
        root_from_camera: None,
        images: vec![
            RawImage::new("left", PixelFormat::Rgb8, (3, 2), vec![number as u8; 18]).unwrap(),
            RawImage::new("depth", PixelFormat::Depth32F, (3, 2), depth).unwrap(),
        ],
    }
}

fn description(name: &str) -> ProviderDescription {
    ProviderDescription::of_stereo(name, "eye", &crate::scenes::CALIBRATION)
}

fn record(path: &Path) {
    let mut recording = RecordingWriter::create(path).unwrap();
    for name in ["eyes", "other"] {
        recording.add_provider(&description(name)).unwrap();
    }
    for number in 1..=5 {
        recording.add("eyes", &frame(number)).unwrap();
        recording.add("other", &frame(number)).unwrap();
    }
    assert!(recording.add("none", &frame(1)).is_err());
    assert_eq!(recording.frames(), 10);
    recording.finish().unwrap();
}

async fn stamps(provider: &RecordingProvider, most: usize) -> Vec<u64> {
    let mut stamps = Vec::new();
    while let Ok(frame) = provider.next().await {
        stamps.push(frame.stamp_ns / 1_000_000);
        if stamps.len() == most {
            break;
        }
    }
    stamps
}

#[tokio::test(start_paused = true)]
async fn what_was_recorded_is_given_again_at_its_pace() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    record(&path);
    assert_eq!(recorded(&path).unwrap()["other"], (5, 50_000_000, 250_000_000));
    let provider = RecordingProvider::open(&path, Some("other"), ALL).await.unwrap();
    assert_eq!(provider.description(), description("other"));
    for number in 1..=5 {
        assert_eq!(*provider.next().await.unwrap(), frame(number));
    }
    assert!(matches!(provider.next().await, Err(ImageError::Gone { .. })));

    let pace = Pace { speed: Some(0.5), repeat: true };
    let provider = RecordingProvider::open(&path, None, pace).await.unwrap();
    let began = Instant::now();
    assert_eq!(stamps(&provider, 8).await, [50, 100, 150, 200, 250, 290, 340, 390]);
    let elapsed = began.elapsed().as_secs_f64();
    assert!((elapsed - 0.68).abs() < 0.01, "340 ms at half speed: {elapsed}");
}

#[tokio::test(start_paused = true)]
async fn a_recording_that_was_cut_off_gives_what_is_there_and_none_gives_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let (path, cut) = (folder.path().join("a.mcap"), folder.path().join("b.mcap"));
    record(&path);
    let whole = std::fs::read(&path).unwrap();
    for end in (0..whole.len()).step_by(whole.len() / 60) {
        std::fs::write(&cut, &whole[..end]).unwrap();
        if let Ok(provider) = RecordingProvider::open(&cut, None, ALL).await {
            assert!(stamps(&provider, 9).await.len() <= 5);
        }
    }
    std::fs::write(&cut, b"not a recording").unwrap();
    assert!(matches!(recorded(&cut), Err(RecordingError::Mcap { .. })));
    assert!(RecordingProvider::open(&cut, None, ALL).await.is_err());
    assert!(RecordingProvider::open(&folder.path().join("none"), None, ALL).await.is_err());
    let nothing = RecordingProvider::open(&path, Some("third"), ALL).await.map(|_| ()).unwrap_err();
    assert!(nothing.to_string().contains("/image/eyes, /image/other"), "{nothing}");
}

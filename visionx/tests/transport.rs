//! Frames between two real Zenoh sessions on loopback: through shared memory, over the network, compressed, lost and
//! requested again, of changing size, and damaged.
use std::sync::Arc;
use std::time::Duration;

use armarium_bus::{Session, SessionConfig, keys};
use armarium_visionx::providers::{
    Delivery, FrameSender, ImageCoding, ImageProvider, Offered, PixelFormat, ProviderDescription, RawFrame,
    RawImage, RemoteError, RemoteProvider, channel, offer, providers,
};

const WAIT: Duration = Duration::from_secs(30);

/// Two sessions, the second connected to the first.
async fn pair(shared: [bool; 2]) -> (Session, Session) {
    let config = |shared_memory| SessionConfig { shared_memory, ..SessionConfig::default() };
    let one = Session::open(&config(shared[0])).await.unwrap();
    let connected = SessionConfig { connect: one.endpoints().await, ..config(shared[1]) };
    let two = Session::open(&connected).await.unwrap();
    (one, two)
}

fn image(role: &str, format: PixelFormat, size: (u32, u32), value: u8) -> RawImage {
    RawImage::new(role, format, size, vec![value; format.bytes(size.0, size.1).unwrap()]).unwrap()
}

fn frame(value: u8, size: (u32, u32)) -> RawFrame {
    let images = vec![
        image("left", PixelFormat::Rgb8, size, value),
        image("right", PixelFormat::Gray8, size, value),
        image("depth", PixelFormat::Depth16, size, value),
    ];
    RawFrame { stamp_ns: u64::from(value), frame_id: "eye".into(), images, ..RawFrame::default() }
}

async fn offered(session: &Session) -> (FrameSender, Offered) {
    let description =
        ProviderDescription { name: "eyes".into(), about: "a test".into(), ..ProviderDescription::default() };
    let (sender, provider) = channel(description);
    (sender, offer(session, "alice", Arc::new(provider)).await.unwrap())
}

async fn connected(session: &Session, delivery: Delivery, coding: ImageCoding) -> RemoteProvider {
    RemoteProvider::connect(session, "alice", "eyes", delivery, coding, WAIT).await.unwrap()
}

/// The next frame; sends the frame again until the two sessions have found each other.
async fn first(sender: &FrameSender, reader: &RemoteProvider, frame: &RawFrame) -> Arc<RawFrame> {
    loop {
        sender.send(frame.clone());
        if let Ok(frame) = tokio::time::timeout(Duration::from_millis(200), reader.next()).await {
            return frame.unwrap();
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn frames_pass_through_shared_memory_or_the_network_with_their_sizes() {
    for shared in [[true, true], [true, false]] {
        let (one, two) = pair(shared).await;
        let (sender, _offered) = offered(&one).await;
        let reader = connected(&two, Delivery::Newest, ImageCoding::Raw).await;
        assert_eq!(reader.description().about, "a test");
        let found = providers(&two, None, None, Duration::from_secs(2)).await.unwrap();
        assert_eq!((found.len(), found[0].agent.as_str()), (1, "alice"));
        first(&sender, &reader, &frame(1, (64, 48))).await;
        for (value, size) in [(2, (640, 480)), (3, (1, 1)), (4, (1921, 1081)), (5, (7, 3))] {
            let sent = frame(value, size);
            // A busy machine may drop live frames, the large ones on the network first.
            let arriving = async {
                loop {
                    let got = first(&sender, &reader, &sent).await;
                    if got.stamp_ns == sent.stamp_ns {
                        return got;
                    }
                }
            };
            let got = tokio::time::timeout(WAIT, arriving).await.unwrap();
            assert_eq!((&got.images, got.stamp_ns), (&sent.images, sent.stamp_ns));
            assert_eq!(got.frame_id, "eye");
        }
        let counts = reader.statistics();
        assert_eq!(counts.shared.get() > 0, shared[1], "{counts:?}");
        assert_eq!((counts.lives.get(), counts.malformed.get()), (1, 0));
        assert!(counts.latency.mean_s() <= counts.latency.worst_s());
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_reader_on_a_thin_link_gets_files() {
    let (one, two) = pair([true, false]).await;
    let (sender, _offered) = offered(&one).await;
    let sent = frame(9, (32, 24));
    for coding in [ImageCoding::Png, ImageCoding::Jpeg] {
        let reader = connected(&two, Delivery::Newest, coding).await;
        let got = first(&sender, &reader, &sent).await;
        assert_eq!(got.images, sent.images, "a flat picture survives JPEG too");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_recorder_gets_all_frames_and_a_stalled_one_counts_what_it_missed() {
    let (one, two) = pair([true, true]).await;
    let (sender, _offered) = offered(&one).await;
    let reader = connected(&two, Delivery::All { waiting: 100 }, ImageCoding::Raw).await;
    let stalled = connected(&two, Delivery::Newest, ImageCoding::Raw).await;
    let begin = first(&sender, &reader, &frame(0, (64, 48))).await.number;
    // Slower than the provider passes them on, faster than any reader takes them.
    let mut last = begin;
    for value in 1..=40 {
        sender.send(frame(value, (64, 48)));
        let got = tokio::time::timeout(WAIT, reader.next()).await.unwrap().unwrap();
        last = got.number;
    }
    let counts = reader.statistics();
    assert_eq!(counts.missed.get(), 0, "{counts:?}");
    assert_eq!(counts.received.get(), last - begin + 1);
    // The last frames may still be on their way to this reader, but the first ones are dropped.
    let newest = async {
        let mut numbers = Vec::new();
        while numbers.last().is_none_or(|number| *number < last) {
            numbers.push(stalled.next().await.unwrap().number);
        }
        numbers
    };
    let numbers = tokio::time::timeout(WAIT, newest).await.unwrap();
    assert!(numbers.len() < 40, "a reader that comes back gets the newest, not all {numbers:?}");
    let given = last - numbers[0] + 1;
    assert_eq!(stalled.statistics().missed.get(), given - numbers.len() as u64, "{numbers:?}");
    assert!(stalled.newest().await.is_none());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_a_full_queue_pushed_out_is_asked_for_again() {
    let (one, two) = pair([true, true]).await;
    let (sender, _offered) = offered(&one).await;
    let reader = connected(&two, Delivery::All { waiting: 2 }, ImageCoding::Raw).await;
    let watching = connected(&two, Delivery::Newest, ImageCoding::Raw).await;
    let begin = first(&sender, &watching, &frame(0, (64, 48))).await.number;
    while reader.newest().await.is_none_or(|frame| frame.number < begin) {
        tokio::task::yield_now().await;
    }
    // Eight frames, each received by the other reader, while this reader does not read.
    for value in 1..=8 {
        sender.send(frame(value, (64, 48)));
        tokio::time::timeout(WAIT, watching.next()).await.unwrap().unwrap();
    }
    let mut numbers = Vec::new();
    while numbers.last() != Some(&(begin + 8)) {
        numbers.push(tokio::time::timeout(WAIT, reader.next()).await.unwrap().unwrap().number);
    }
    assert_eq!(numbers, (begin + 1..=begin + 8).collect::<Vec<_>>());
    let counts = reader.statistics();
    assert!(counts.again.get() >= 5 && counts.missed.get() == 0, "{counts:?}");
}

/// Answers queries on `alice/{name}` with a description whose rate is an integer.
async fn described(session: &Session, name: &str, encoding: &'static str) -> tokio::task::JoinHandle<()> {
    let key = keys::image("alice", name).unwrap();
    let said = r#"{"name": "other", "about": "", "frame_id": "", "rate_hz": 30, "images": []}"#;
    let said: serde_json::Value = serde_json::from_str(said).unwrap();
    let said = armarium_bus::encode(&said).unwrap();
    let mut questions = session.declare_queryable(key.clone(), 16).await.unwrap();
    tokio::spawn(async move {
        while let Some(question) = questions.next().await {
            question.reply(&key, encoding, said.clone()).await.unwrap();
        }
    })
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn whole_numbers_are_read_as_floats_and_what_cannot_be_read_is_said() {
    let (one, two) = pair([false, false]).await;
    let whole = described(&one, "whole", "application/cbor;image/description;v1").await;
    let newer = described(&one, "newer", "application/cbor;image/description;v2").await;
    let connect =
        |name| RemoteProvider::connect(&two, "alice", name, Delivery::Newest, ImageCoding::Raw, WAIT);
    assert_eq!(connect("whole").await.unwrap().description().rate_hz, Some(30.0));
    let Err(RemoteError::Description { provider, what }) = connect("newer").await else {
        panic!("another version is not read");
    };
    assert_eq!(provider, "alice/newer");
    assert!(what.to_string().contains("version 2"), "{what}");
    let found = providers(&two, None, None, Duration::from_secs(2)).await.unwrap();
    assert_eq!(found.iter().map(|f| f.provider.as_str()).collect::<Vec<_>>(), ["newer", "whole"]);
    assert!(found[0].description.is_err() && found[1].description.is_ok(), "{found:?}");
    whole.abort();
    newer.abort();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_is_no_frame_is_counted_and_the_next_is_read() {
    let (one, two) = pair([true, true]).await;
    let (sender, _offered) = offered(&one).await;
    let reader = connected(&two, Delivery::All { waiting: 64 }, ImageCoding::Raw).await;
    first(&sender, &reader, &frame(0, (8, 8))).await;
    let before = reader.statistics().malformed.get();
    let key = keys::image("alice", "eyes").unwrap();
    let junk = one.bulk_sender(&key, "application/octet-stream;image/frame;v1").await.unwrap();
    junk.wanted().await;
    let attachments = [vec![], vec![0xff; 40], vec![0xa0], vec![0x9f; 100]];
    // Messages of several senders arrive in any order, and on a busy machine some are lost.
    let counting = async {
        while reader.statistics().malformed.get() - before < 5 {
            for attachment in attachments.clone() {
                junk.send(junk.slot(1000), attachment).await.unwrap();
            }
            one.put(&key, "application/cbor;other;v1", vec![1, 2, 3]).await.unwrap();
            let got = first(&sender, &reader, &frame(7, (8, 8))).await;
            assert_eq!(got.images, frame(7, (8, 8)).images);
        }
    };
    tokio::time::timeout(WAIT, counting).await.expect("what is no frame is counted");
}

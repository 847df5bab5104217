//! The latency of a frame from provider to processor and the throughput in frames per second, beside raw Zenoh shared
//! memory and a plain copy: `cargo bench -p armarium-visionx --bench transport`.
//!
//! Two sessions in one process are connected over TCP on loopback, with shared memory; each message is one RGB image.
//! Raw: allocate, copy the image in, put; receive. Ours: hand the frame to the provider's channel; receive it from a
//! `RemoteProvider`. Latency is measured at one frame every 2 ms (1 kHz would saturate a busy machine), throughput with
//! four frames in flight. Raw and ours alternate, so that other load on the machine affects both alike.

#![expect(clippy::disallowed_methods, reason = "it measures the machine")]
#![allow(clippy::print_stdout, clippy::unwrap_used, reason = "a program for people")]

use std::sync::Arc;
use std::time::{Duration, Instant};

use armarium_bus::{Session, SessionConfig};
use armarium_visionx::providers::{
    Delivery, FrameSender, ImageCoding, ImageProvider, Offered, PixelFormat, ProviderDescription, RawFrame,
    RawImage, RemoteProvider, channel, offer,
};
use zenoh::Wait;
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::shm::{GarbageCollect, PosixShmProviderBackend, ShmProvider, ShmProviderBuilder};

const ROUNDS: usize = 5;
const LATENCIES: usize = 100;
const FRAMES: usize = 400;
const WINDOW: usize = 4;

struct Raw {
    pool: ShmProvider<PosixShmProviderBackend>,
    publisher: Publisher<'static>,
    subscriber: Subscriber<zenoh::handlers::FifoChannelHandler<zenoh::sample::Sample>>,
}

impl Raw {
    async fn send(&self, pixels: &[u8]) {
        let mut buffer = self.pool.alloc(pixels.len()).with_policy::<GarbageCollect>().wait().unwrap();
        buffer.copy_from_slice(pixels);
        self.publisher.put(buffer).await.unwrap();
    }

    async fn receive(&self) -> usize {
        let sample = self.subscriber.recv_async().await.unwrap();
        assert!(sample.payload().as_shm().is_some());
        sample.payload().len()
    }
}

async fn pair() -> (Session, Session) {
    let config = SessionConfig { shared_memory: true, ..SessionConfig::default() };
    let one = Session::open(&config).await.unwrap();
    let two = Session::open(&SessionConfig { connect: one.endpoints().await, ..config }).await.unwrap();
    (one, two)
}

async fn raw(one: &Session, two: &Session, bytes: usize) -> Raw {
    let pool = ShmProviderBuilder::default_backend(bytes * 8).wait().unwrap();
    let key = format!("raw/{bytes}");
    let publisher = one.zenoh().declare_publisher(key.clone()).express(true).await.unwrap();
    let subscriber = two.zenoh().declare_subscriber(key).await.unwrap();
    while !publisher.matching_status().await.unwrap().matching() {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    Raw { pool, publisher, subscriber }
}

async fn ours(one: &Session, two: &Session, frame: &RawFrame) -> (FrameSender, RemoteProvider, Offered) {
    let name = format!("eyes{}", frame.bytes());
    let (sender, provider) =
        channel(ProviderDescription { name: name.clone(), ..ProviderDescription::default() });
    let offered = offer(one, "bench", Arc::new(provider)).await.unwrap();
    let wait = Duration::from_secs(20);
    let (delivery, coding) = (Delivery::Newest, ImageCoding::Raw);
    let reader = RemoteProvider::connect(two, "bench", &name, delivery, coding, wait).await.unwrap();
    loop {
        sender.send(frame.clone());
        if tokio::time::timeout(Duration::from_millis(100), reader.next()).await.is_ok() {
            return (sender, reader, offered);
        }
    }
}

fn median(mut times: Vec<f64>) -> f64 {
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}

async fn bench(one: &Session, two: &Session, (width, height): (u32, u32)) {
    let pixels: Vec<u8> = (0..width * height * 3).map(|i| i as u8).collect();
    let image = RawImage::new("left", PixelFormat::Rgb8, (width, height), pixels.clone()).unwrap();
    let frame = RawFrame { images: vec![image], ..RawFrame::default() };
    let (raw, (sender, reader, _offered)) = (raw(one, two, pixels.len()).await, ours(one, two, &frame).await);
    let mut into = vec![0u8; pixels.len()];
    let mut copy = || {
        into.copy_from_slice(std::hint::black_box(&pixels));
        std::hint::black_box(&mut into);
    };
    // Of a copy, raw Zenoh and a provider.
    let [mut latencies, mut rates] = [(); 2].map(|()| [const { Vec::new() }; 3]);
    let ms = |since: Instant| since.elapsed().as_secs_f64() * 1e3;
    let mut tick = tokio::time::interval(Duration::from_millis(2));
    for _ in 0..ROUNDS {
        for _ in 0..LATENCIES {
            tick.tick().await;
            let began = Instant::now();
            copy();
            latencies[0].push(ms(began));
            let began = Instant::now();
            raw.send(&pixels).await;
            assert_eq!(raw.receive().await, pixels.len());
            latencies[1].push(ms(began));
            tick.tick().await;
            let began = Instant::now();
            sender.send(frame.clone());
            assert_eq!(reader.next().await.unwrap().bytes(), pixels.len());
            latencies[2].push(ms(began));
        }
        let began = Instant::now();
        (0..FRAMES).for_each(|_| copy());
        rates[0].push(FRAMES as f64 / began.elapsed().as_secs_f64());
        let began = Instant::now();
        for i in 0..FRAMES {
            raw.send(&pixels).await;
            if i >= WINDOW {
                raw.receive().await;
            }
        }
        for _ in 0..WINDOW {
            raw.receive().await;
        }
        rates[1].push(FRAMES as f64 / began.elapsed().as_secs_f64());
        // The provider keeps only the newest frame. The processor drains the queue, so the received frames
        // are counted.
        let before = reader.statistics().received.get();
        let began = Instant::now();
        let giving = async {
            while began.elapsed() < Duration::from_millis(400) {
                sender.send(frame.clone());
                tokio::task::yield_now().await;
            }
        };
        let taking =
            async { while tokio::time::timeout(Duration::from_millis(100), reader.next()).await.is_ok() {} };
        let taking = tokio::time::timeout(Duration::from_millis(400), taking);
        let _ = tokio::join!(giving, taking).1.is_ok();
        rates[2].push((reader.statistics().received.get() - before) as f64 / 0.4);
    }
    println!("| {width} x {height} | memcpy | raw Zenoh shared memory | provider to processor |");
    let [copy, raw, ours] = latencies.map(median);
    println!("| latency, median, ms | {copy:.3} | {raw:.3} | {ours:.3} ({:.2} x raw) |", ours / raw);
    let [copy, raw, ours] = rates.map(median);
    println!("| frames/s | {copy:.0} | {raw:.0} | {ours:.0} |");
}

fn main() {
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
    runtime.block_on(async {
        let (one, two) = pair().await;
        for size in [(640, 480), (1920, 1080)] {
            bench(&one, &two, size).await;
        }
    });
}

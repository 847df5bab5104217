//! A page on this machine that shows a provider live: the images of each frame side by side, as JPEG, the newest
//! frame only. It answers `GET` of `/` and of `/frame`, which waits for the next frame, and only requests from this
//! machine.

use std::sync::Arc;
use std::time::Duration;

use armarium_visionx::providers::convert::{jpeg, rgb_of};
use armarium_visionx::providers::{ImageProvider, RawFrame, RemoteProvider};
use armarium_visionx::{ImageError, RgbImage};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{Semaphore, watch};

/// Longest accepted request, bytes.
const MAX_REQUEST: usize = 8192;
/// How long a browser may take to send a request, and a frame to arrive.
const TIMEOUT: Duration = Duration::from_secs(10);
/// How often a frame is taken even if no browser requests it.
const IDLE_INTERVAL: Duration = Duration::from_secs(5);
/// Most browsers at a time.
const MAX_BROWSERS: usize = 16;
/// Most pixels of a picture.
const MAX_PIXELS: u64 = 64_000_000;
/// The page: it requests the next frame when it has received the last.
const PAGE: &str = include_str!("page.html");

type LatestJpeg = watch::Receiver<(u64, Arc<Vec<u8>>)>;

/// Answers browsers at `listener` until the future is dropped. After the provider has ended, the page keeps its last frame.
/// `remote` is the provider's remote end, if it is in another process.
pub async fn serve(
    listener: TcpListener,
    provider: Arc<dyn ImageProvider>,
    remote: Option<Arc<RemoteProvider>>,
) {
    let (sender, newest) = watch::channel((0, Arc::new(Vec::new())));
    let (want, wanted) = watch::channel(None);
    let places = Arc::new(Semaphore::new(MAX_BROWSERS));
    let answering = async {
        loop {
            let Ok((stream, _)) = listener.accept().await else { continue };
            let Ok(place) = Arc::clone(&places).acquire_owned().await else { return };
            let (newest, want) = (newest.clone(), want.clone());
            tokio::spawn(async move {
                // A browser that disconnects early is not an error.
                let _ = tokio::time::timeout(TIMEOUT * 2, answer(stream, newest, want)).await.is_ok();
                drop(place);
            });
        }
    };
    tokio::join!(pull(provider, remote, sender, wanted), answering);
}

/// Keeps the newest frame as a picture. It encodes a frame when a browser has received the last and requests another.
/// Without requests it still encodes one every few seconds, because a waiting frame would hold the shared memory of a
/// provider that has ended.
async fn pull(
    provider: Arc<dyn ImageProvider>,
    remote: Option<Arc<RemoteProvider>>,
    to: watch::Sender<(u64, Arc<Vec<u8>>)>,
    mut wanted: watch::Receiver<Option<u64>>,
) {
    let (mut count, mut told) = (0, false);
    loop {
        let want = wanted.wait_for(|seen| seen.is_some_and(|seen| seen >= count));
        let next = match tokio::time::timeout(IDLE_INTERVAL, want).await.map(|want| want.is_ok()) {
            Ok(true) => provider.next().await,
            Ok(false) => return,
            Err(_) => {
                let Some(remote) = &remote else { continue };
                let Some(frame) = remote.newest().await else { continue };
                Ok(frame)
            }
        };
        match next {
            Ok(frame) => {
                let make = move || (picture(&frame), frame.is_intact());
                // A frame that was overwritten meanwhile is not shown.
                let Ok((made, true)) = tokio::task::spawn_blocking(make).await else { continue };
                if let Some(picture) = made {
                    count += 1;
                    to.send_replace((count, Arc::new(picture)));
                } else if !std::mem::replace(&mut told, true) {
                    tracing::warn!("a frame cannot be shown: it has only lists of points, or is too large");
                }
            }
            Err(ImageError::Gone { .. }) => return,
            Err(error) => tracing::warn!("{error}"),
        }
    }
}

/// The images of a frame side by side; `None` if there is none, or if the picture is too large: a wide image beside a
/// high one gives a picture far larger than both.
fn picture(frame: &RawFrame) -> Option<Vec<u8>> {
    let images: Vec<RgbImage> = frame.images.iter().filter_map(rgb_of).collect();
    let height = images.iter().map(RgbImage::height).max()?;
    let width = images.iter().try_fold(0u32, |sum, image| sum.checked_add(image.width()))?;
    if u64::from(width) * u64::from(height) > MAX_PIXELS {
        return None;
    }
    let mut data = Vec::with_capacity(width as usize * height as usize * 3);
    for y in 0..height {
        for image in &images {
            let row = image.width() as usize * 3;
            let start = y as usize * row;
            match image.data().get(start..start + row) {
                Some(pixels) => data.extend(pixels),
                None => data.resize(data.len() + row, 0),
            }
        }
    }
    jpeg(&RgbImage::from_rgb(width, height, data).ok()?).ok()
}

async fn answer(
    mut stream: TcpStream,
    mut newest: LatestJpeg,
    want: watch::Sender<Option<u64>>,
) -> std::io::Result<()> {
    let Some(path) = request(&mut stream).await? else {
        return respond(&mut stream, "400 Bad Request", "text/plain", b"").await;
    };
    let (path, seen) = path.split_once('?').unwrap_or((&path, ""));
    match path {
        "/" => respond(&mut stream, "200 OK", "text/html; charset=utf-8", PAGE.as_bytes()).await,
        "/frame" => {
            // The number of a page from an earlier run is not valid here: it has seen none of these frames.
            let seen: u64 = seen.parse().unwrap_or(0);
            let seen = if seen > newest.borrow().0 { 0 } else { seen };
            want.send_modify(|wanted| *wanted = (*wanted).max(Some(seen)));
            let next = newest.wait_for(|(count, _)| *count > seen);
            let found = match tokio::time::timeout(TIMEOUT, next).await {
                Ok(Ok(found)) => Ok(found.clone()),
                Ok(Err(_)) => Err("410 Gone"),
                Err(_) => Err("204 No Content"),
            };
            let (count, picture) = match found {
                Ok(found) => found,
                Err(status) => return respond(&mut stream, status, "text/plain", b"").await,
            };
            let kind = format!("image/jpeg\r\nX-Frame: {count}");
            respond(&mut stream, "200 OK", &kind, &picture).await
        }
        _ => respond(&mut stream, "404 Not Found", "text/plain", b"").await,
    }
}

/// The path of a `GET` request to this machine; `None` for anything else.
async fn request(stream: &mut TcpStream) -> std::io::Result<Option<String>> {
    let mut bytes = Vec::new();
    let mut piece = [0; 1024];
    while !bytes.windows(4).any(|end| end == b"\r\n\r\n") {
        let read = stream.read(&mut piece).await?;
        bytes.extend(&piece[..read]);
        if read == 0 || bytes.len() > MAX_REQUEST {
            return Ok(None);
        }
    }
    Ok(path_of(&String::from_utf8_lossy(&bytes)))
}

/// Other sites must not read the pictures through the browser: the request must name this machine.
fn path_of(request: &str) -> Option<String> {
    let mut lines = request.split("\r\n");
    let path = lines.next()?.strip_prefix("GET ")?.split(' ').next()?.to_owned();
    let host = lines.find_map(|line| {
        let (name, value) = line.split_once(':')?;
        name.eq_ignore_ascii_case("host").then(|| value.trim().to_owned())
    })?;
    let name = host.rsplit_once(':').map_or(host.as_str(), |(name, _)| name);
    matches!(name, "127.0.0.1" | "localhost").then_some(path)
}

async fn respond(stream: &mut TcpStream, status: &str, kind: &str, body: &[u8]) -> std::io::Result<()> {
    let head = format!(
        "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {}\r\nCache-Control: no-store\r\n\
         Connection: close\r\n\r\n",
        body.len()
    );
    stream.write_all(head.as_bytes()).await?;
    stream.write_all(body).await?;
    stream.shutdown().await
}

#[cfg(test)]
mod tests {
    use super::*;
    use armarium_visionx::files::decode_image;
    use armarium_visionx::providers::{PixelFormat, RawImage};

    #[test]
    fn only_requests_to_this_machine_are_answered() {
        let request = |host: &str| format!("GET /frame?3 HTTP/1.1\r\nAccept: */*\r\nHost: {host}\r\n\r\n");
        assert_eq!(path_of(&request("127.0.0.1:8080")).as_deref(), Some("/frame?3"));
        assert_eq!(path_of(&request("localhost")).as_deref(), Some("/frame?3"));
        for wrong in ["evil.example", "127.0.0.1.evil.example:80", ""] {
            assert_eq!(path_of(&request(wrong)), None, "{wrong}");
        }
        assert_eq!(path_of("POST / HTTP/1.1\r\nHost: localhost\r\n\r\n"), None);
        assert_eq!(path_of("GET / HTTP/1.1\r\n\r\n"), None);
    }

    #[test]
    fn images_of_a_frame_stand_side_by_side_whatever_their_size() {
        let image = |role: &str, format, size: (u32, u32), bytes| {
            RawImage::new(role, format, size, vec![200u8; bytes]).expect("the bytes fit")
        };
        let frame = RawFrame {
            images: vec![
                image("left", PixelFormat::Rgb8, (40, 30), 3600),
                image("points", PixelFormat::Points32F, (2, 1), 24),
                image("gray", PixelFormat::Gray8, (10, 20), 200),
            ],
            ..RawFrame::default()
        };
        let shown = decode_image(&picture(&frame).expect("there are pictures")).expect("it is a JPEG");
        assert_eq!((shown.width(), shown.height()), (50, 30));
        assert!(shown.pixel(45, 25)[0] < 40 && shown.pixel(45, 5)[0] > 160);
        assert!(picture(&RawFrame::default()).is_none());
        let bars = RawFrame {
            images: vec![
                image("wide", PixelFormat::Gray8, (65_000, 1), 65_000),
                image("high", PixelFormat::Gray8, (1, 65_000), 65_000),
            ],
            ..RawFrame::default()
        };
        assert!(picture(&bars).is_none(), "130 kB are not shown as 12 GB");
    }
}

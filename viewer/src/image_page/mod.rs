//! A page on this machine that shows a provider live: the images of each frame side by side, as JPEG, the newest
//! frame only. It answers `GET` of `/` and of `/frame`, which waits for the next frame, and only requests from this
//! machine.

use std::sync::Arc;
use std::time::Duration;

use armarium_visionx::providers::convert::{jpeg, rgb_of};
use armarium_visionx::providers::{ImageProvider, RawFrame, RemoteProvider};
use armarium_visionx::{ImageError, RgbImage};
use hyper::body::{Bytes, Incoming};
use hyper::header::HeaderValue;
use hyper::{Request, Response, StatusCode};
use tokio::net::TcpListener;
use tokio::sync::watch;

use crate::http::{Admission, Body, HTML, PageServer, RequestRefusal, SCRIPT, Site, body, plain};

/// How long a frame may take to arrive.
const TIMEOUT: Duration = Duration::from_secs(10);
/// How often a frame is taken even if no browser requests it.
const IDLE_INTERVAL: Duration = Duration::from_secs(5);
const MAX_PIXELS: u64 = 64_000_000;
/// The page: it requests the next frame when it has received the last.
const PAGE: &str = include_str!("page.html");
const PAGE_SCRIPT: &str = include_str!("page.js");

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
    let Ok(address) = listener.local_addr() else { return };
    let server = PageServer::new(ImageSite { newest, want }, Admission::of(address));
    tokio::join!(pull(provider, remote, sender, wanted), server.serve(listener, None));
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

/// The newest frame as a picture, and where it is said that one is wanted.
struct ImageSite {
    newest: LatestJpeg,
    want: watch::Sender<Option<u64>>,
}

impl Site for ImageSite {
    async fn answer(&self, request: Request<Incoming>) -> Result<Response<Body>, RequestRefusal> {
        Ok(match request.uri().path() {
            "/" => body(StatusCode::OK, HTML, Bytes::from_static(PAGE.as_bytes())),
            "/page.js" => body(StatusCode::OK, SCRIPT, Bytes::from_static(PAGE_SCRIPT.as_bytes())),
            // The number of a page from an earlier run is not valid here: it has seen none of these frames.
            "/frame" => {
                self.frame(request.uri().query().and_then(|seen| seen.parse().ok()).unwrap_or(0)).await
            }
            _ => plain(StatusCode::NOT_FOUND, String::new()),
        })
    }
}

impl ImageSite {
    /// The next frame after the one with this number.
    async fn frame(&self, seen: u64) -> Response<Body> {
        let mut newest = self.newest.clone();
        let seen = if seen > newest.borrow().0 { 0 } else { seen };
        self.want.send_modify(|wanted| *wanted = (*wanted).max(Some(seen)));
        let next = newest.wait_for(|(count, _)| *count > seen);
        let (count, picture) = match tokio::time::timeout(TIMEOUT, next).await {
            Ok(Ok(found)) => found.clone(),
            Ok(Err(_)) => return plain(StatusCode::GONE, String::new()),
            Err(_) => return plain(StatusCode::NO_CONTENT, String::new()),
        };
        let mut answer = body(StatusCode::OK, "image/jpeg", Bytes::from(picture.to_vec()));
        answer.headers_mut().insert("x-frame", HeaderValue::from(count));
        answer
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use armarium_visionx::files::decode_image;
    use armarium_visionx::providers::{PixelFormat, RawImage};

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

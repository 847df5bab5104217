//! A page of this machine on which somebody clicks hands in images: wrist, knuckle, fingertips and gesture. Each label is kept at once.

use std::io;

use armarium_visionx::Gesture;
use armarium_visionx::tracking::{HandLabels, LabelledHand};
use hyper::body::{Bytes, Incoming};
use hyper::{Method, Request, Response, StatusCode};
use parking_lot::Mutex;
use serde::Deserialize;
use tokio::net::TcpListener;

use crate::http::{
    Admission, Body, HTML, PageServer, RequestRefusal, SCRIPT, Site, body, json, plain, posted, token,
};

const PAGE: &str = include_str!("page.html");
const PAGE_SCRIPT: &str = include_str!("page.js");

/// Gives an image as a file.
pub type ImageFile = Box<dyn Fn(usize) -> Option<Vec<u8>> + Send + Sync>;
/// Keeps labels.
pub type KeepLabels = Box<dyn Fn(&HandLabels) -> io::Result<()> + Send + Sync>;

/// The images to label, and where labels go.
pub struct ImagesToLabel {
    /// The images' names, in the order in which they are shown.
    pub names: Vec<String>,
    /// The labels that there are already.
    pub labels: HandLabels,
    /// An image by its place in the order, as a JPEG file; `None` where it cannot be read.
    pub image: ImageFile,
    /// Keeps all labels.
    pub keep: KeepLabels,
}

/// Answers browsers at `listener` until the future is dropped.
///
/// # Errors
/// When the listener has no address, or the machine gives no random numbers.
pub async fn serve(listener: TcpListener, images: ImagesToLabel) -> io::Result<()> {
    let admission = Admission::of(listener.local_addr()?);
    let ImagesToLabel { names, labels, image, keep } = images;
    let site = LabelSite { names, labels: Mutex::new(labels), image, keep, token: token()? };
    PageServer::new(site, admission).serve(listener, None).await;
    Ok(())
}

struct LabelSite {
    names: Vec<String>,
    labels: Mutex<HandLabels>,
    image: ImageFile,
    keep: KeepLabels,
    token: String,
}

/// What the page posts.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Label {
    image: usize,
    hand: Option<LabelledHand>,
}

impl Site for LabelSite {
    async fn answer(&self, request: Request<Incoming>) -> Result<Response<Body>, RequestRefusal> {
        if request.method() == Method::POST {
            return Ok(match posted(request, &self.token).await? {
                Ok(label) => self.label(label),
                Err(answer) => answer,
            });
        }
        let number = || request.uri().query().and_then(|number| number.parse().ok());
        Ok(match request.uri().path() {
            "/" => body(StatusCode::OK, HTML, Bytes::from_static(PAGE.as_bytes())),
            "/page.js" => body(StatusCode::OK, SCRIPT, Bytes::from_static(PAGE_SCRIPT.as_bytes())),
            "/images" => json(self.all()),
            "/image" => match number().and_then(|number| (self.image)(number)) {
                Some(jpeg) => body(StatusCode::OK, "image/jpeg", Bytes::from(jpeg)),
                None => plain(StatusCode::NOT_FOUND, "this image cannot be read".to_owned()),
            },
            _ => plain(StatusCode::NOT_FOUND, String::new()),
        })
    }
}

impl LabelSite {
    fn all(&self) -> String {
        let labels = self.labels.lock();
        let label = |name: &String| labels.0.get(name).map(|hand| serde_json::json!({ "hand": hand }));
        let images: Vec<_> =
            self.names.iter().map(|name| serde_json::json!({ "name": name, "label": label(name) })).collect();
        let gestures = Gesture::ALL.map(Gesture::name);
        serde_json::json!({ "images": images, "gestures": gestures, "token": self.token }).to_string()
    }

    fn label(&self, label: Label) -> Response<Body> {
        let Some(name) = self.names.get(label.image) else {
            return plain(StatusCode::NOT_FOUND, "there is no such image".to_owned());
        };
        if label.hand.as_ref().is_some_and(|hand| !(hand.size() > 0.0 && hand.size().is_finite())) {
            let why = "the wrist and the knuckle are at the same place";
            return plain(StatusCode::BAD_REQUEST, why.to_owned());
        }
        let mut labels = self.labels.lock();
        let mut changed = labels.clone();
        changed.0.insert(name.clone(), label.hand);
        match (self.keep)(&changed) {
            Ok(()) => {
                *labels = changed;
                json("{}".to_owned())
            }
            Err(error) => {
                plain(StatusCode::INTERNAL_SERVER_ERROR, format!("the labels cannot be written: {error}"))
            }
        }
    }
}

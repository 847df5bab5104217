//! The detections in an image, as a line of JSON or of text.

use std::io::{self, Write};

use armarium_visionx::Region;
use serde::Serialize;

/// A rectangle, px of the file.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct PixelRectangle {
    x: u32,
    y: u32,
    w: u32,
    h: u32,
}

/// A fingertip, px of the file.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct Tip {
    pub(super) x: f64,
    pub(super) y: f64,
    pub(super) score: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) id: Option<u64>,
}

/// A hand in an image; without one, `gesture` and `hand` are null. `gesture` is also null for a hand that shows none.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct HandLine {
    pub(super) file: String,
    pub(super) gesture: Option<String>,
    pub(super) confidence: f64,
    pub(super) hand: Option<PixelRectangle>,
    pub(super) fingertips: Vec<Tip>,
}

/// The pixels of the hand in an image.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct SkinLine {
    pub(super) file: String,
    pub(super) confidence: f64,
    pub(super) hand: Option<PixelRectangle>,
    /// Fraction of the image.
    pub(super) share: f64,
}

/// An object of one colour; without one, `marker` is null.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct MarkerLine {
    pub(super) file: String,
    pub(super) marker: Option<MarkerPlace>,
}

/// The place of an object of one colour, px of the file.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct MarkerPlace {
    pub(super) x: f64,
    pub(super) y: f64,
    pub(super) area: u32,
    pub(super) bounds: PixelRectangle,
}

/// A file that is not a readable image.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct ErrorLine {
    pub(super) file: String,
    pub(super) error: String,
}

impl From<Region> for PixelRectangle {
    fn from(r: Region) -> Self {
        Self { x: r.x, y: r.y, w: r.width, h: r.height }
    }
}

/// Rounds: pixels to a tenth, scores to a hundredth.
pub(super) fn rounded(value: f64, digits: i32) -> f64 {
    let scale = 10f64.powi(digits);
    (value * scale).round() / scale
}

pub(super) fn json(line: &impl Serialize, out: &mut dyn Write) -> io::Result<()> {
    serde_json::to_writer(&mut *out, line)?;
    writeln!(out)
}

impl HandLine {
    pub(super) fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let Some(hand) = &self.hand else { return writeln!(out, "{}: no hand", self.file) };
        let gesture = self.gesture.as_deref().unwrap_or("no gesture");
        let tips: Vec<String> = self.fingertips.iter().map(|t| format!("({:.0}, {:.0})", t.x, t.y)).collect();
        write!(
            out,
            "{}: {gesture} {:.2}, hand {} x {} at ({}, {})",
            self.file, self.confidence, hand.w, hand.h, hand.x, hand.y
        )?;
        let tips = if tips.is_empty() {
            "no stretched finger".to_owned()
        } else {
            format!("fingertips {}", tips.join(" "))
        };
        writeln!(out, ", {tips}")
    }
}

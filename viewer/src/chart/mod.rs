//! Draws a statechart: SVG and PNG with its own layout, and Graphviz, Mermaid and PlantUML for other tools.
//!
//! States are nested boxes, the transitions between them arrows in layers (`layers`). A transition is drawn between the
//! two sibling boxes that contain its source and its target, with the inner names in its label. Transitions to a final
//! state that many states go to are written into the states that they leave, with the target's name in its colour.
//! Other transitions (without a target, to the state itself, to an ancestor or descendant, or across regions) are text
//! in the state. So no line crosses a box and no label touches another. [`fold`], [`close`] and [`unfold`] choose how much is shown.
//! This module reads and writes no files.

mod detail;
mod dot;
mod font;
mod geometry;
mod graph;
mod layers;
mod nested;
mod png;
mod scene;
mod source;
mod svg;
#[cfg(test)]
mod tests;

use armarium_runtime::chart::Outline;

pub use detail::{Unfold, close, fold, levels, unfold};

/// Width and height of a screen, px.
const SCREEN: (f64, f64) = (1920.0, 1080.0);

/// A form in which a chart is drawn or written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Format {
    /// A picture for browsers and documents.
    Svg,
    /// A picture of pixels.
    Png,
    /// Graphviz.
    Dot,
    /// Mermaid's `stateDiagram-v2`, as Mermaid 11 reads it.
    Mermaid,
    /// PlantUML.
    PlantUml,
    /// States and transitions as JSON.
    Json,
}

/// The colours of a picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum Theme {
    /// SVG: what its reader prefers; PNG: light.
    #[default]
    Auto,
    /// Dark on light.
    Light,
    /// Light on dark.
    Dark,
}

/// Why a chart cannot be drawn.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs, reason = "the names of the fields say what they are")]
pub enum DrawError {
    /// The texts of a PNG of bounded size could not be read; width and height are those of the picture, px.
    #[error("the picture, {width} by {height} px, is too large for PNG; write SVG, or fold states")]
    TooLarge { width: f64, height: f64 },
    /// The image could not be encoded.
    #[error("the image cannot be encoded")]
    Png { source: image::ImageError },
}

/// The chart in a form, as the content of a file. `theme` applies to SVG and PNG.
///
/// # Errors
/// [`DrawError`], for PNG.
pub fn render(outline: &Outline, format: Format, theme: Theme) -> Result<Vec<u8>, DrawError> {
    Ok(match format {
        Format::Svg => svg::svg(&scene::ChartPicture::of(outline), theme).into_bytes(),
        Format::Png => png::png(&scene::ChartPicture::of(outline), theme)?,
        Format::Dot => dot::dot(outline).into_bytes(),
        Format::Mermaid => source::mermaid(outline).into_bytes(),
        Format::PlantUml => source::plantuml(outline).into_bytes(),
        Format::Json => json(outline),
    })
}

/// How many levels of states a picture shows that fits a screen, or two screens one below the other; `None` where all of them do,
/// or where fewer do not help.
#[must_use]
pub fn levels_that_fit(outline: &Outline) -> Option<usize> {
    let fits = |outline: &Outline| {
        let size = scene::ChartPicture::of(outline).size;
        size.width <= SCREEN.0 && size.height <= 2.0 * SCREEN.1
    };
    if fits(outline) {
        return None;
    }
    (1..levels(outline)).rev().find(|depth| fits(&fold(outline, *depth)))
}

fn json(outline: &Outline) -> Vec<u8> {
    let mut text = serde_json::to_vec_pretty(outline).expect("an outline has only names as keys");
    text.push(b'\n');
    text
}

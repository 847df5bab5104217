//! Draws a statechart: SVG with its own layout, and Mermaid and PlantUML for other tools.
//!
//! [`svg`] draws states as nested boxes and the transitions between them in layers. A transition is drawn between the
//! two sibling boxes that contain its source and its target, with the inner names in its label. Other transitions
//! (without a target, to the state itself, to an ancestor or descendant, or across regions) are written as text into
//! the state. So no line crosses a box and no label overlaps another. This module reads and writes no files.

mod graph;
mod layers;
mod measure;
mod nested;
mod source;
mod svg;
#[cfg(test)]
mod tests;

pub use source::{mermaid, plantuml};
pub use svg::svg;

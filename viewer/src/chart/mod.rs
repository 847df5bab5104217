//! A statechart as a picture: SVG with a layout of its own, and Mermaid and PlantUML for other tools.
//!
//! [`svg`] draws states as nested boxes and the transitions between them in layers. A transition is drawn where its
//! source and its target lie side by side: between the boxes that hold them, with the inner names in its label. What
//! leads nowhere else (without target, into the state itself or to what is around or inside it, or across regions) is
//! written into the state. So no line crosses a box and no label lies on another. Nothing is read or written here.

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

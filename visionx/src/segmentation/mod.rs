//! Unknown things on a table, told apart by what moves together when something is pushed.
//!
//! - [`TopView`]: what rises from the table, seen from above, on a grid of cells with height and colour.
//! - [`Hypothesis`]: what may be one thing. [`first_hypotheses`]: of a single look, by height and colour.
//! - [`told_apart`]: what hypotheses become after something was pushed: kept, split, merged, dropped.
//! - `motion`: rigid motions in the plane of the table, by iterated closest points with colour. `labels`: which cell made which motion.
//! - [`PushChoice`]: which push tells the most. `silhouettes`: the pixels that show each hypothesis.
//! - [`Appearance`]: by what a thing is known again.
//! - [`SegmentationStep`]: all of it as a processing step.
//!
//! # Source
//! Schiebener, Ude, Asfour: Physical interaction for segmentation of unknown textured and non-textured rigid objects, ICRA 2014.
//! Differs in: the motions are those of things that stand and stay on a table (two directions and a turn), and the evidence is counted on
//! a grid seen from above, by which a place that is free now refutes a motion, too.

mod appearance;
mod evidence;
mod hypothesis;
mod labels;
mod motion;
mod push;
mod silhouettes;
mod step;
#[cfg(test)]
mod tests;
mod top_view;

pub use appearance::{Appearance, most_alike};
pub use evidence::told_apart;
pub use hypothesis::{Hypothesis, first_hypotheses};
pub use push::{PlannedPush, PushChoice};
pub use step::SegmentationStep;
pub use top_view::{TopCell, TopView};

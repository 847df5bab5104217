//! SCXML as a source of charts: a document becomes a chart in the project's own language, as text for people to go
//! on with.
//!
//! Carried over: states, parallel states, final states with data, histories, initial states with one or several
//! targets and with actions, transitions with several event descriptors, internal and targetless ones, `onentry` and
//! `onexit`, `raise`, `send` with delay, id, parameters and content, `cancel`, `log`, `if`, and expressions made of
//! `In()`, literals, `_event`, comparison and logic. What cannot be carried over (a data model, scripts, `invoke`) is an [`ImportError`]
//! that names it with its line; all of them are found at once. Nothing is run here.
//!
//! Start reading at [`scxml`]; `read` gives the tree, `expression` one expression, `write` the chart's text.

mod expression;
mod names;
mod read;
#[cfg(test)]
mod tests;
mod write;
mod yaml;

use std::collections::BTreeMap;

/// Largest document, bytes.
pub const MAX_BYTES: usize = 10_000_000;

/// A chart that was made of an SCXML document.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Imported {
    /// The chart's text.
    pub yaml: String,
    /// The names of states that the language does not allow: SCXML's by the chart's.
    pub renamed: BTreeMap<String, String>,
}

/// Something that cannot be carried over.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, thiserror::Error)]
#[error("line {line}: {message}")]
pub struct ImportError {
    /// Line in the document, from 1.
    pub line: u32,
    /// What it is, and why it cannot be.
    pub message: String,
}

/// Makes a chart of an SCXML document. `name` is the chart's name where the document gives none.
///
/// # Errors
/// Everything that cannot be carried over, in the document's order.
///
/// # Source
/// W3C State Chart XML (SCXML), Recommendation of 2015-09-01.
pub fn scxml(text: &str, name: &str) -> Result<Imported, Vec<ImportError>> {
    let mut errors = Vec::new();
    let result = read::document(text, &mut errors).and_then(|document| {
        let names = names::Names::of(&document, name);
        let yaml = write::chart(&document, &names, &mut errors);
        (errors.is_empty()).then(|| Imported { yaml, renamed: names.renamed(&document) })
    });
    errors.sort();
    errors.dedup();
    result.filter(|_| errors.is_empty()).ok_or(errors)
}

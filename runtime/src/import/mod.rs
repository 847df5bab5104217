//! Imports SCXML: converts a document to a chart in the project's own language, as text that people can edit
//! further.
//!
//! Converted: states, parallel states, final states with data, histories, initial states with one or several
//! targets and with actions, transitions with several event descriptors, internal and targetless ones, `onentry`
//! and `onexit`, `raise`, `send` with delay, id, parameters and content, `cancel`, `log`, `if`, and expressions
//! made of `In()`, literals, `_event`, comparison and logic. Everything else (a data model, scripts, `invoke`) is
//! an [`ImportError`] with its line; all of them are reported together. Nothing is run here.
//!
//! Start reading at [`scxml`]. `read` gives the tree, `expression` converts one expression, `write` produces the
//! chart's text.

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

/// A chart that was converted from an SCXML document.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Imported {
    /// The chart's text.
    pub yaml: String,
    /// States whose names the language does not allow: SCXML's id by the chart's name.
    pub renamed: BTreeMap<String, String>,
}

/// A part of the document that cannot be converted.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, thiserror::Error)]
#[error("line {line}: {message}")]
pub struct ImportError {
    /// Line in the document, from 1.
    pub line: u32,
    /// What it is, and why it cannot be converted.
    pub message: String,
}

/// Converts an SCXML document to a chart. `name` is the chart's name if the document has none.
///
/// # Errors
/// Everything that cannot be converted, in the document's order.
///
/// # Source
/// W3C State Chart XML (SCXML), Recommendation of 2015-09-01.
pub fn scxml(text: &str, name: &str) -> Result<Imported, Vec<ImportError>> {
    let mut errors = Vec::new();
    let result = read::document(text, &mut errors).and_then(|document| {
        let names = names::ScxmlNames::of(&document, name);
        let yaml = write::chart(&document, &names, &mut errors);
        (errors.is_empty()).then(|| Imported { yaml, renamed: names.renamed(&document) })
    });
    errors.sort();
    errors.dedup();
    result.filter(|_| errors.is_empty()).ok_or(errors)
}

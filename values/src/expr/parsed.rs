//! Parsed expressions. A tree depends on the text alone, and an editor compiles the same texts after each edit: trees are kept.

use std::collections::BTreeMap;
use std::sync::Arc;

use cel::common::ast::SourceInfo;
use cel::{IdedExpr, ParseErrors};
use parking_lot::Mutex;

/// Most bytes of the texts whose trees are kept.
const MAX_KEPT: usize = 1 << 20;

/// A tree, and where its parts are in the text.
pub(super) type Parsed = Arc<(IdedExpr, SourceInfo)>;

static KEPT: Mutex<ParsedCache> = Mutex::new(ParsedCache { trees: BTreeMap::new(), bytes: 0 });

struct ParsedCache {
    trees: BTreeMap<String, Parsed>,
    bytes: usize,
}

/// The tree of a text.
pub(super) fn parse(text: &str) -> Result<Parsed, ParseErrors> {
    if let Some(parsed) = KEPT.lock().trees.get(text) {
        return Ok(Arc::clone(parsed));
    }
    // An environment without macros leaves `list.all(x, p)` as an ordinary call.
    let parser = cel::Env::default().parser().enable_optional_syntax(false);
    let parsed = Arc::new(parser.parse_with_source_info(text)?);
    let mut kept = KEPT.lock();
    if kept.bytes + text.len() > MAX_KEPT {
        kept.trees.clear();
        kept.bytes = 0;
    }
    kept.bytes += text.len();
    kept.trees.insert(text.to_owned(), Arc::clone(&parsed));
    Ok(parsed)
}

//! The files of the page. They are part of the program: nothing is fetched from elsewhere.

use crate::http::{HTML, SCRIPT};

/// A file's path, media type and content.
pub(super) type Asset = (&'static str, &'static str, &'static str);

pub(super) const ASSETS: [Asset; 11] = [
    ("/compare", HTML, include_str!("page/compare.html")),
    ("/compare.js", SCRIPT, include_str!("page/compare.js")),
    ("/style.css", "text/css; charset=utf-8", include_str!("page/style.css")),
    ("/app.js", SCRIPT, include_str!("page/app.js")),
    ("/run.js", SCRIPT, include_str!("page/run.js")),
    ("/words.js", SCRIPT, include_str!("page/words.js")),
    ("/chart.js", SCRIPT, include_str!("page/chart.js")),
    ("/time.js", SCRIPT, include_str!("page/time.js")),
    ("/world.js", SCRIPT, include_str!("page/world.js")),
    ("/memory.js", SCRIPT, include_str!("page/memory.js")),
    ("/report.js", SCRIPT, include_str!("page/report.js")),
];

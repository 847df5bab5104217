//! Estimates the width of text from Helvetica's character widths, with a reserve for substitute fonts.

/// Height of a line of text, px.
pub(super) const LINE: f64 = 15.0;
/// Size of the text, px.
pub(super) const SIZE: f64 = 12.0;
/// Longest line, characters; longer lines are cut.
const LONGEST: usize = 64;
/// Width of DejaVu Sans and Liberation Sans relative to Helvetica.
const WIDER: f64 = 1.14;

/// Width of a line, px.
pub(super) fn width(text: &str) -> f64 {
    let em = |c: char| match c {
        'i' | 'j' | 'l' | '\'' | '|' => 0.24,
        ' ' | 't' | 'f' | 'r' | '.' | ',' | ':' | ';' | '!' | '/' | '(' | ')' | '[' | ']' | '-' => 0.31,
        'm' | 'M' | 'W' | 'w' | '@' | '%' => 0.86,
        '>' | '<' | '=' | '+' | '~' => 0.6,
        c if c.is_ascii_uppercase() || c == '&' => 0.7,
        c if c.is_ascii() => 0.55,
        _ => 1.0,
    };
    text.chars().map(em).sum::<f64>() * SIZE * WIDER
}

/// Cuts a line to the longest allowed length.
pub(super) fn cut(text: &str) -> String {
    let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
    if text.chars().count() <= LONGEST {
        return text;
    }
    text.chars().take(LONGEST - 1).chain(['…']).collect()
}

//! The font of the pictures: Arimo, whose characters are as wide as those of Arial, Helvetica and Liberation Sans.

use std::sync::LazyLock;

use ttf_parser::Face;

/// Height of a line of text, px.
pub(super) const LINE: f64 = 15.0;
/// Size of the text, px.
pub(super) const SIZE: f64 = 12.0;
/// Lines that a long text may have; the rest is cut.
const MAX_LINES: usize = 5;

static REGULAR: LazyLock<Face<'static>> = LazyLock::new(|| parse(include_bytes!("font/Arimo-Regular.ttf")));
static BOLD: LazyLock<Face<'static>> = LazyLock::new(|| parse(include_bytes!("font/Arimo-Bold.ttf")));

fn parse(bytes: &'static [u8]) -> Face<'static> {
    Face::parse(bytes, 0).expect("the font is part of the program")
}

/// The weight of a text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Weight {
    Regular,
    Bold,
}

pub(super) fn face(weight: Weight) -> &'static Face<'static> {
    match weight {
        Weight::Regular => &REGULAR,
        Weight::Bold => &BOLD,
    }
}

/// Width of a character relative to the size of the text. Characters that the font lacks count as square.
pub(super) fn advance(c: char, weight: Weight) -> f64 {
    let face = face(weight);
    let width = face.glyph_index(c).and_then(|glyph| face.glyph_hor_advance(glyph));
    width.map_or(1.0, |units| f64::from(units) / f64::from(face.units_per_em()))
}

/// Width of a line, px.
pub(super) fn width(text: &str, weight: Weight) -> f64 {
    text.chars().map(|c| advance(c, weight)).sum::<f64>() * SIZE
}

/// Breaks a text into lines of at most `limit` px: between words, and inside a word that is longer than a line. What is
/// left after the last allowed line is cut and marked with an ellipsis.
pub(super) fn wrap(text: &str, limit: f64) -> Vec<String> {
    let fits = |line: &str| width(line, Weight::Regular) <= limit;
    let mut lines = vec![String::new()];
    for word in text.split_whitespace() {
        let line = lines.last_mut().expect("there is always a line");
        let longer = if line.is_empty() { word.to_owned() } else { format!("{line} {word}") };
        if fits(&longer) {
            *line = longer;
            continue;
        }
        if !line.is_empty() {
            lines.push(String::new());
        }
        for c in word.chars() {
            let line = lines.last_mut().expect("there is always a line");
            line.push(c);
            if !fits(line) && line.chars().count() > 1 {
                line.pop();
                lines.push(c.to_string());
            }
        }
        if lines.len() > MAX_LINES {
            break;
        }
    }
    if lines.len() > MAX_LINES {
        lines.truncate(MAX_LINES);
        lines[MAX_LINES - 1].push('…');
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_texts_are_broken_between_words_and_inside_long_words_and_cut_at_last() {
        assert_eq!(wrap("one two three", width("one two", Weight::Regular)), ["one two", "three"]);
        assert_eq!(wrap("iiiiii", width("iiii", Weight::Regular)), ["iiii", "ii"]);
        let long = wrap(&"word ".repeat(100), 40.0);
        assert_eq!((long.len(), long[MAX_LINES - 1].as_str()), (MAX_LINES, "word…"));
        assert_eq!(wrap("", 40.0), [""]);
        assert_eq!(wrap("表表", 1.0), ["表", "表"]);
    }
}

//! Places in a text: bytes here, lines and UTF-16 columns on the wire; and the edits that arrive there.

use armarium_source::Span;
use lsp_types::{Position, Range, TextDocumentContentChangeEvent};

/// Where the lines of a text begin.
#[derive(Clone, Debug)]
pub(crate) struct Lines(Vec<usize>);

impl Lines {
    pub(crate) fn of(text: &str) -> Self {
        let bytes = text.as_bytes();
        let mut starts = vec![0];
        for (at, byte) in bytes.iter().enumerate() {
            if *byte == b'\n' || *byte == b'\r' && bytes.get(at + 1) != Some(&b'\n') {
                starts.push(at + 1);
            }
        }
        Self(starts)
    }

    /// The byte of a position. One beyond its line is the line's end, one inside a character its beginning.
    pub(crate) fn offset(&self, text: &str, position: Position) -> usize {
        let line = position.line as usize;
        let Some(start) = self.0.get(line) else { return text.len() };
        let end = self.0.get(line + 1).copied().unwrap_or(text.len());
        let content = text[*start..end].trim_end_matches(['\n', '\r']);
        let mut column = 0;
        for (at, c) in content.char_indices() {
            column += c.len_utf16();
            if column > position.character as usize {
                return start + at;
            }
        }
        start + content.len()
    }

    pub(crate) fn position(&self, text: &str, byte: usize) -> Position {
        let mut byte = byte.min(text.len());
        while !text.is_char_boundary(byte) {
            byte -= 1;
        }
        let line = self.0.partition_point(|start| *start <= byte).saturating_sub(1);
        let column: usize = text[self.0[line]..byte].chars().map(char::len_utf16).sum();
        Position::new(number(line), number(column))
    }

    pub(crate) fn range(&self, text: &str, span: Span) -> Range {
        Range::new(self.position(text, span.start), self.position(text, span.end.max(span.start)))
    }

    pub(crate) fn span(&self, text: &str, range: Range) -> Span {
        let (start, end) = (self.offset(text, range.start), self.offset(text, range.end));
        Span { start, end: end.max(start) }
    }
}

fn number(n: usize) -> u32 {
    u32::try_from(n).unwrap_or(u32::MAX)
}

/// A text after the changes of a client, one after the other, and its lines.
pub(crate) fn changed(
    (text, lines): (&str, &Lines),
    changes: Vec<TextDocumentContentChangeEvent>,
) -> (String, Lines) {
    changes.into_iter().fold((text.to_owned(), lines.clone()), |(mut text, lines), change| {
        match change.range {
            None => text = change.text,
            Some(range) => {
                let Span { start, end } = lines.span(&text, range);
                text.replace_range(start..end, &change.text);
            }
        }
        let lines = Lines::of(&text);
        (text, lines)
    })
}

/// What two texts have in common at their beginning and end: where a place of one is in the other.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Shift {
    before: usize,
    from_end: usize,
    to_end: usize,
}

impl Shift {
    pub(crate) fn between(from: &str, to: &str) -> Self {
        let (a, b) = (from.as_bytes(), to.as_bytes());
        let before = a.iter().zip(b).take_while(|(a, b)| a == b).count();
        let rest = a[before..].iter().rev().zip(b[before..].iter().rev());
        let after = rest.take_while(|(a, b)| a == b).count();
        Self { before, from_end: a.len() - after, to_end: b.len() - after }
    }

    /// The same place in the other text; none inside of what differs. A place between the equal beginning and the equal end is put after the new text.
    pub(crate) fn map(self, at: usize) -> Option<usize> {
        if at >= self.from_end {
            Some(at - self.from_end + self.to_end)
        } else {
            (at <= self.before).then_some(at)
        }
    }

    /// The same part of the other text, without what is new at its ends.
    pub(crate) fn span(self, span: Span) -> Option<Span> {
        let start = self.map(span.start)?;
        let end = if span.end <= self.before { span.end } else { self.map(span.end)? };
        (start <= end).then_some(Span { start, end })
    }

    pub(crate) fn back(self) -> Self {
        Self { before: self.before, from_end: self.to_end, to_end: self.from_end }
    }

    /// What differs: in the one text and in the other, between whole characters.
    pub(crate) fn differing(self, from: &str, to: &str) -> (Span, Span) {
        let start = (0..=self.before).rev().find(|at| from.is_char_boundary(*at)).unwrap_or(0);
        let rest = (self.from_end..=from.len()).find(|at| from.is_char_boundary(*at)).unwrap_or(from.len());
        let after = rest - self.from_end;
        (Span { start, end: rest }, Span { start, end: (self.to_end + after).min(to.len()) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_count_utf16() {
        let text = "é: 1\r\n😀x: 2\rlast";
        let lines = Lines::of(text);
        for (line, column, byte) in [
            (0, 0, 0),
            (0, 1, 2),
            (0, 9, 5),
            (1, 0, 7),
            (1, 1, 7),
            (1, 2, 11),
            (1, 3, 12),
            (2, 4, 20),
            (9, 0, 20),
        ] {
            assert_eq!(lines.offset(text, Position::new(line, column)), byte, "{line}:{column}");
        }
        for byte in [0, 2, 3, 7, 11, 12, 16, 20] {
            let position = lines.position(text, byte);
            assert_eq!(lines.offset(text, position), byte, "{position:?}");
        }
        assert_eq!(lines.position(text, 9), Position::new(1, 0), "inside a character");
    }

    #[test]
    fn changes_are_made_one_after_the_other() {
        let change = |range: Option<(u32, u32, u32, u32)>, text: &str| TextDocumentContentChangeEvent {
            range: range.map(|(a, b, c, d)| Range::new(Position::new(a, b), Position::new(c, d))),
            range_length: None,
            text: text.into(),
        };
        let changes = vec![
            change(Some((0, 3, 0, 4)), "two"),
            change(Some((0, 2, 0, 2)), "😀"),
            change(Some((0, 4, 0, 7)), "2"),
            change(Some((5, 0, 7, 0)), "\nend"),
        ];
        let after = |text: &str, changes| changed((text, &Lines::of(text)), changes).0;
        assert_eq!(after("a: 1", changes), "a:😀2o\nend");
        assert_eq!(after("a", vec![change(None, "b")]), "b");
    }

    #[test]
    fn places_are_found_again_beside_what_differs() {
        let shift = Shift::between("abc def", "abc  xy def");
        assert_eq!([0, 4, 7].map(|at| shift.map(at)), [Some(0), Some(8), Some(11)]);
        let shift = Shift::between("a12b", "a3b");
        assert_eq!([1, 2, 3, 4].map(|at| shift.map(at)), [Some(1), None, Some(2), Some(3)]);
        assert_eq!(shift.back().map(3), Some(4));
    }
}

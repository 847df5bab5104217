//! Where the entries of a YAML text stand, and how far each reaches: what edits, completion and formatting need, and what the
//! tree of [`crate::yaml`] does not say.
//!
//! It is made of any text, broken ones too: whatever cannot be YAML is read in some way, and what follows it is found again by
//! its indentation. It knows no values.

use crate::span::Span;

/// An entry of a map, or an item of a list.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LayoutEntry {
    /// Its key with the quotes; of an item its dash, between brackets its first byte.
    pub key: Span,
    /// The end of its value, exclusive, without what follows it in its line.
    pub end: usize,
    /// The entry in whose value it stands.
    pub parent: Option<usize>,
    /// Bytes before the key in its line.
    pub column: usize,
    /// Whether it stands between brackets.
    pub flow: bool,
    /// Whether it is an item of a list.
    pub item: bool,
    /// Where its value begins, if that is in the key's line and no entry of its own.
    pub value: Option<usize>,
}

/// A map or a list between brackets.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Brackets {
    /// The byte of the first bracket.
    pub open: usize,
    /// The byte of the last; none where it is missing.
    pub close: Option<usize>,
    /// Where the search for the last bracket ended.
    pub end: usize,
    /// Whether it is a map.
    pub map: bool,
    /// The entry whose value it is.
    pub entry: Option<usize>,
}

/// All entries of a text, in its order.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Layout {
    /// The entries, parents before children.
    pub entries: Vec<LayoutEntry>,
    /// What stands between brackets.
    pub brackets: Vec<Brackets>,
    /// Comments, from their `#` to the end of the line.
    pub comments: Vec<Span>,
    /// Scalars in quotes, and blocks of text after `|` and `>`: their inside is text.
    pub texts: Vec<Span>,
}

impl Layout {
    /// The layout of a text.
    #[must_use]
    pub fn of(text: &str) -> Self {
        let mut scanner =
            Scanner { text: text.as_bytes(), at: 0, line: (0, 0), layout: Self::default(), open: Vec::new() };
        while scanner.at < scanner.text.len() {
            scanner.line();
        }
        scanner.close(0);
        scanner.layout
    }

    /// The entry whose key begins at a byte.
    #[must_use]
    pub fn at(&self, key: usize) -> Option<usize> {
        self.entries.binary_search_by_key(&key, |entry| entry.key.start).ok()
    }

    /// The entries in the value of an entry; of the whole text for `None`.
    pub fn children(&self, of: Option<usize>) -> impl DoubleEndedIterator<Item = usize> + '_ {
        let first = of.map_or(0, |of| of + 1);
        let end = of.map_or(usize::MAX, |of| self.entries[of].end);
        let after = self.entries[first..].partition_point(|entry| entry.key.start < end);
        (first..first + after).filter(move |at| self.entries[*at].parent == of)
    }

    /// The key of an entry without its quotes; nothing for an item.
    #[must_use]
    pub fn key<'t>(&self, text: &'t str, entry: usize) -> &'t str {
        let entry = &self.entries[entry];
        let key = if entry.item { "" } else { text.get(entry.key.start..entry.key.end).unwrap_or("") };
        let inner = |quote: char| key.strip_prefix(quote)?.strip_suffix(quote);
        inner('"').or_else(|| inner('\'')).unwrap_or(key)
    }

    /// The child of an entry with that key.
    #[must_use]
    pub fn child(&self, text: &str, of: Option<usize>, key: &str) -> Option<usize> {
        self.children(of).find(|at| !self.entries[*at].item && self.key(text, *at) == key)
    }

    /// The entry and those around it, innermost first.
    pub fn outward(&self, entry: usize) -> impl Iterator<Item = usize> + '_ {
        std::iter::successors(Some(entry), |at| self.entries[*at].parent)
    }
}

struct Scanner<'t> {
    text: &'t [u8],
    at: usize,
    /// A byte, and where its line begins.
    line: (usize, usize),
    layout: Layout,
    /// Entries whose end is not known yet, outermost first.
    open: Vec<usize>,
}

impl Scanner<'_> {
    fn peek(&self) -> Option<u8> {
        self.text.get(self.at).copied()
    }

    fn next_is(&self, ahead: usize, wanted: impl Fn(u8) -> bool) -> bool {
        self.text.get(self.at + ahead).is_none_or(|byte| wanted(*byte))
    }

    fn at_line_end(&self) -> bool {
        self.peek().is_none_or(|byte| byte == b'\n' || byte == b'\r')
    }

    fn spaces(&mut self) {
        while matches!(self.peek(), Some(b' ' | b'\t')) {
            self.at += 1;
        }
    }

    /// Goes to the beginning of the next line, past a comment.
    fn rest_of_line(&mut self) {
        self.comment();
        while self.peek().is_some_and(|byte| byte != b'\n') {
            self.at += 1;
        }
        self.at += 1;
    }

    /// Skips spaces and a comment; not the end of the line.
    fn comment(&mut self) {
        let before = self.at;
        self.spaces();
        let apart = self.at > before || self.at == 0 || matches!(self.text[self.at - 1], b'\n' | b' ' | b',');
        if self.peek() == Some(b'#') && apart {
            let start = self.at;
            while !self.at_line_end() {
                self.at += 1;
            }
            self.layout.comments.push(Span { start, end: self.at });
        }
    }

    /// Bytes before a byte in its line. It is searched from the byte of which it was asked last: lines may be very long.
    fn column(&mut self, at: usize) -> usize {
        let (from, start) = if at < self.line.0 { (0, 0) } else { self.line };
        let newline = self.text[from..at].iter().rposition(|byte| *byte == b'\n');
        let start = newline.map_or(start, |newline| from + newline + 1);
        self.line = (at, start);
        at - start
    }

    fn enter(&mut self, key: Span, flow: bool, item: bool) {
        let column = self.column(key.start);
        let parent = self.open.last().copied();
        let entry = LayoutEntry { key, end: key.end, parent, column, flow, item, value: None };
        self.open.push(self.layout.entries.len());
        self.layout.entries.push(entry);
    }

    /// Closes entries until `count` are open.
    fn close(&mut self, count: usize) {
        while self.open.len() > count {
            let Some(closed) = self.open.pop() else { return };
            let end = self.layout.entries[closed].end;
            self.reaches(end);
        }
    }

    /// The innermost open entry reaches to here.
    fn reaches(&mut self, end: usize) {
        if let Some(entry) = self.open.last() {
            let entry = &mut self.layout.entries[*entry];
            entry.end = entry.end.max(end);
        }
    }

    /// Closes what cannot hold an entry that begins in that column.
    fn leave(&mut self, column: usize, item: bool) {
        let holds = |entry: &usize| {
            let entry = &self.layout.entries[*entry];
            entry.column < column || entry.column == column && item && !entry.item
        };
        let count = self.open.iter().rposition(holds).map_or(0, |at| at + 1);
        self.close(count);
    }

    fn line(&mut self) {
        let start = self.at;
        self.spaces();
        let marker = self.at == start && matches!(self.text.get(start..start + 3), Some(b"---" | b"..."));
        if self.at_line_end() || marker || self.peek() == Some(b'#') || self.text[start] == b'%' {
            return self.rest_of_line();
        }
        self.node();
        self.rest_of_line();
    }

    /// Entries that begin in this line, one inside the other, and the last one's value.
    fn node(&mut self) {
        loop {
            let (start, column) = (self.at, self.column(self.at));
            if self.peek() == Some(b'-') && self.next_is(1, |byte| byte.is_ascii_whitespace()) {
                self.leave(column, true);
                self.at += 1;
                self.enter(Span { start, end: self.at }, false, true);
                self.spaces();
                if self.at_line_end() || self.peek() == Some(b'#') {
                    return;
                }
                continue;
            }
            let key = self.key_ahead();
            self.leave(column, false);
            if let Some(end) = key {
                self.enter(Span { start, end }, false, false);
                self.at = end;
                self.spaces();
                self.at += 1;
                self.reaches(self.at);
                self.spaces();
                if self.at_line_end() || self.peek() == Some(b'#') {
                    return;
                }
            }
            return self.value();
        }
    }

    /// The end of the key that begins here, if one does: in this line, with a colon behind it.
    fn key_ahead(&self) -> Option<usize> {
        let rest = &self.text[self.at..];
        let line = rest.iter().position(|byte| matches!(byte, b'\n' | b'\r')).unwrap_or(rest.len());
        let rest = &rest[..line];
        let ends = |at: usize| rest.get(at + 1).is_none_or(u8::is_ascii_whitespace);
        match rest.first()? {
            quote @ (b'"' | b'\'') => {
                let end = closing_quote(rest, *quote)?;
                let colon = end + rest[end..].iter().position(|byte| !matches!(byte, b' ' | b'\t'))?;
                (rest[colon] == b':' && ends(colon)).then_some(self.at + end)
            }
            b'{' | b'[' | b'#' | b'|' | b'>' => None,
            _ => {
                let colon = (0..rest.len()).find(|at| {
                    rest[*at] == b':' && ends(*at)
                        || rest[*at] == b'#' && *at > 0 && matches!(rest[at - 1], b' ' | b'\t')
                })?;
                let end = rest[..colon].iter().rposition(|byte| !matches!(byte, b' ' | b'\t'))? + 1;
                (rest[colon] == b':').then_some(self.at + end)
            }
        }
    }

    /// The column of the innermost open block entry, whose parts begin to the right of it; -1 for the whole text.
    fn margin(&self) -> isize {
        let entry = self.open.iter().rev().map(|at| &self.layout.entries[*at]).find(|entry| !entry.flow);
        entry.map_or(-1, |entry| isize::try_from(entry.column).unwrap_or(isize::MAX))
    }

    /// A value that begins in this line.
    fn value(&mut self) {
        if let Some(entry) = self.open.last() {
            self.layout.entries[*entry].value.get_or_insert(self.at);
        }
        loop {
            match self.peek() {
                Some(b'{' | b'[') => self.flow(),
                Some(quote @ (b'"' | b'\'')) => self.quoted(quote, self.margin()),
                Some(b'|' | b'>') => self.block_text(),
                Some(b'&' | b'!' | b'*') => {
                    while self.peek().is_some_and(|byte| !byte.is_ascii_whitespace()) {
                        self.at += 1;
                    }
                    self.reaches(self.at);
                    self.spaces();
                    if !self.at_line_end() && self.peek() != Some(b'#') {
                        continue;
                    }
                }
                _ => self.plain(),
            }
            return;
        }
    }

    /// Plain text to the end of the line, and the lines that go on with it.
    fn plain(&mut self) {
        let margin = self.margin();
        loop {
            let start = self.at;
            while !(self.at_line_end() || self.peek() == Some(b'#') && self.at > start && self.after_space())
            {
                self.at += 1;
            }
            let end = self.text[start..self.at].iter().rposition(|byte| !matches!(byte, b' ' | b'\t'));
            self.at = start + end.map_or(0, |at| at + 1);
            self.reaches(self.at);
            let here = self.at;
            self.spaces();
            if self.peek() == Some(b'#') || !self.goes_on(margin) {
                self.at = here;
                return;
            }
        }
    }

    fn after_space(&self) -> bool {
        matches!(self.text[self.at - 1], b' ' | b'\t')
    }

    /// Whether the next line that is not blank goes on with a plain text; then its first byte is gone to.
    fn goes_on(&mut self, margin: isize) -> bool {
        let here = self.at;
        while self.at_line_end() && self.at < self.text.len() {
            self.at += 1;
            let start = self.at;
            self.spaces();
            if self.at_line_end() {
                continue;
            }
            let column = isize::try_from(self.at - start).unwrap_or(isize::MAX);
            let dash = self.peek() == Some(b'-') && self.next_is(1, |byte| byte.is_ascii_whitespace());
            if column > margin && !dash && self.peek() != Some(b'#') && self.key_ahead().is_none() {
                return true;
            }
            break;
        }
        self.at = here;
        false
    }

    /// Text in quotes, over lines that are right of the margin.
    fn quoted(&mut self, quote: u8, margin: isize) {
        let start = self.at;
        let end = match closing_quote(&self.text[start..], quote) {
            Some(len) => start + len,
            None => self.text.len(),
        };
        // A quote that is missing must not take the rest of the file with it.
        let lost = lines(&self.text[start..end]).skip(1).find(|line| {
            let line = &self.text[start + line.start..start + line.end];
            let column = line.iter().take_while(|byte| **byte == b' ').count();
            isize::try_from(column).unwrap_or(isize::MAX) <= margin
                && line.iter().any(|b| !b.is_ascii_whitespace())
        });
        self.at = lost.map_or(end, |line| (start + line.start).saturating_sub(1));
        self.layout.texts.push(Span { start, end: self.at });
        self.reaches(self.at);
    }

    /// The lines of a text after `|` or `>`.
    fn block_text(&mut self) {
        let margin = self.margin();
        let start = self.at;
        while !self.at_line_end() {
            self.at += 1;
        }
        self.reaches(self.at);
        let mut end = self.at;
        let mut indent = None;
        for line in lines(&self.text[self.at..]).skip(1) {
            let (from, to) = (self.at + line.start, self.at + line.end);
            let text = &self.text[from..to];
            let column = text.iter().take_while(|byte| **byte == b' ').count();
            if text.iter().all(u8::is_ascii_whitespace) {
                // Spaces beyond the indentation are text.
                if indent.is_some_and(|indent| column > indent) {
                    end = to;
                }
                continue;
            }
            indent.get_or_insert(column);
            if isize::try_from(column).unwrap_or(isize::MAX) <= margin {
                break;
            }
            end = to;
        }
        self.at = end;
        self.layout.texts.push(Span { start, end });
        self.reaches(end);
    }

    /// What stands between brackets, to the one that closes it.
    fn flow(&mut self) {
        let margin = self.margin();
        // The brackets that are open, and how many entries were when each began.
        let mut around: Vec<(usize, usize)> = Vec::new();
        while let Some(byte) = self.peek() {
            match byte {
                b'\n' if self.flow_is_lost(margin) => break,
                b' ' | b'\t' | b'\r' | b'\n' => self.at += 1,
                b'#' if self.after_space() || self.text[self.at - 1] == b'\n' => self.comment(),
                b'{' | b'[' => {
                    self.item_before(&around);
                    around.push((self.layout.brackets.len(), self.open.len()));
                    let entry = self.open.last().copied();
                    let (open, map) = (self.at, byte == b'{');
                    self.layout.brackets.push(Brackets { open, close: None, end: open + 1, map, entry });
                    self.at += 1;
                    self.reaches(self.at);
                }
                b'}' | b']' => {
                    let Some((bracket, count)) = around.pop() else { break };
                    self.close(count);
                    self.layout.brackets[bracket].close = Some(self.at);
                    self.at += 1;
                    self.layout.brackets[bracket].end = self.at;
                    self.reaches(self.at);
                    if around.is_empty() {
                        return;
                    }
                }
                b',' => {
                    if let Some((_, count)) = around.last() {
                        self.close(*count);
                    }
                    self.at += 1;
                }
                _ => self.flow_token(&around, margin),
            }
        }
        for (bracket, count) in around.into_iter().rev() {
            self.close(count);
            self.layout.brackets[bracket].end = self.at;
        }
    }

    /// Whether the next line cannot belong to what stands between brackets: it is not right of the margin.
    fn flow_is_lost(&self, margin: isize) -> bool {
        let rest = &self.text[self.at + 1..];
        let column = rest.iter().take_while(|byte| **byte == b' ').count();
        let blank = rest.get(column).is_none_or(|byte| matches!(byte, b'\n' | b'\r' | b'#'));
        let closes = matches!(rest.get(column), Some(b'}' | b']'));
        !blank && !closes && isize::try_from(column).unwrap_or(isize::MAX) <= margin
    }

    /// Begins an item where a value stands directly in a list.
    fn item_before(&mut self, around: &[(usize, usize)]) {
        let Some((bracket, count)) = around.last() else { return };
        if !self.layout.brackets[*bracket].map && self.open.len() == *count {
            self.enter(Span { start: self.at, end: self.at + 1 }, true, true);
        }
        if let Some(entry) = self.open.get(*count) {
            self.layout.entries[*entry].value.get_or_insert(self.at);
        }
    }

    /// A scalar between brackets: a key, if a colon follows, or a value.
    fn flow_token(&mut self, around: &[(usize, usize)], margin: isize) {
        let start = self.at;
        if let Some(quote @ (b'"' | b'\'')) = self.peek() {
            self.quoted(quote, margin);
            if self.at == start {
                self.at += 1;
            }
        } else {
            while let Some(byte) = self.peek() {
                let colon = byte == b':'
                    && self.next_is(1, |next| {
                        next.is_ascii_whitespace() || matches!(next, b',' | b'[' | b']' | b'{' | b'}')
                    });
                let comment = byte == b'#' && self.at > start && self.after_space();
                if colon || comment || matches!(byte, b',' | b'[' | b']' | b'{' | b'}' | b'\n' | b'\r') {
                    break;
                }
                self.at += 1;
            }
        }
        let end = start
            + self.text[start..self.at]
                .iter()
                .rposition(|b| !matches!(b, b' ' | b'\t'))
                .map_or(0, |at| at + 1);
        let after = self.at;
        self.spaces();
        let colon = self.peek() == Some(b':');
        let Some((_, count)) = around.last() else {
            self.at = after.max(start + 1);
            return;
        };
        if colon && self.open.len() == *count {
            self.enter(Span { start, end: end.max(start) }, true, false);
            self.at += 1;
            self.reaches(self.at);
            return;
        }
        self.at = after;
        let bracket = around.last().map(|(bracket, _)| *bracket);
        if bracket.is_some_and(|bracket| self.layout.brackets[bracket].map) && self.open.len() == *count {
            // A key without a value, as in `{a, b}`, or one that is being written.
            self.enter(Span { start, end }, true, false);
        } else {
            let here = std::mem::replace(&mut self.at, start);
            self.item_before(around);
            self.at = here;
            if let Some(entry) = self.open.get(*count) {
                self.layout.entries[*entry].value.get_or_insert(start);
            }
            self.reaches(end);
        }
        if self.at == start {
            self.at += 1;
        }
    }
}

/// The length of a text in quotes, with both.
fn closing_quote(text: &[u8], quote: u8) -> Option<usize> {
    let mut at = 1;
    while let Some(byte) = text.get(at) {
        match *byte {
            b'\\' if quote == b'"' => at += 1,
            byte if byte == quote && quote == b'\'' && text.get(at + 1) == Some(&quote) => at += 1,
            byte if byte == quote => return Some(at + 1),
            _ => {}
        }
        at += 1;
    }
    None
}

/// The lines of a text, without their ends.
fn lines(text: &[u8]) -> impl Iterator<Item = Span> + '_ {
    let mut start = 0;
    text.split(|byte| *byte == b'\n').map(move |line| {
        let span = Span { start, end: start + line.len() };
        start = span.end + 1;
        span
    })
}

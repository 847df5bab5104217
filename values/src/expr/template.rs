//! Text with `${...}` in it: split into literal text and expressions, without parsing these.

/// A part of a text.
#[derive(Clone, Debug, PartialEq, Eq)]
#[allow(missing_docs, reason = "the names of the fields say what they are")]
pub enum Piece {
    /// Literal text, with `$${` already turned into `${`.
    Text(String),
    /// The expression between the braces, and the byte at which it begins in the text.
    Expr { source: String, offset: usize },
}

/// A `${` without its `}`.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("this `${{` has no `}}`")]
pub struct TemplateError {
    /// The byte at which it begins.
    pub offset: usize,
}

/// Splits a text into its parts. A text without expressions is one part, an empty text none.
///
/// # Errors
/// [`TemplateError`] for an expression that does not end.
pub fn split(text: &str) -> Result<Vec<Piece>, TemplateError> {
    let mut pieces = Vec::new();
    let mut literal = String::new();
    let mut rest = 0;
    while let Some(found) = text[rest..].find("${") {
        let at = rest + found;
        if text[rest..at].ends_with('$') {
            literal.push_str(&text[rest..at]);
            literal.push('{');
            rest = at + 2;
            continue;
        }
        literal.push_str(&text[rest..at]);
        if !literal.is_empty() {
            pieces.push(Piece::Text(std::mem::take(&mut literal)));
        }
        let start = at + 2;
        let end = closing(&text[start..]).ok_or(TemplateError { offset: at })? + start;
        pieces.push(Piece::Expr { source: text[start..end].to_owned(), offset: start });
        rest = end + 1;
    }
    literal.push_str(&text[rest..]);
    if !literal.is_empty() {
        pieces.push(Piece::Text(literal));
    }
    Ok(pieces)
}

/// The byte of the brace that closes an expression; skips braces in strings and of map literals.
fn closing(text: &str) -> Option<usize> {
    let (mut depth, mut quote, mut escaped) = (0_usize, None, false);
    for (at, c) in text.char_indices() {
        match quote {
            Some(_) if escaped => escaped = false,
            Some(_) if c == '\\' => escaped = true,
            Some(q) if c == q => quote = None,
            Some(_) => {}
            None => match c {
                '\'' | '"' => quote = Some(c),
                '{' => depth += 1,
                '}' if depth == 0 => return Some(at),
                '}' => depth -= 1,
                _ => {}
            },
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_split_at_expressions() {
        let text = |s: &str| Piece::Text(s.into());
        let expr = |s: &str, offset| Piece::Expr { source: s.into(), offset };
        for (given, expected) in [
            ("", vec![]),
            ("plain", vec![text("plain")]),
            ("${a}", vec![expr("a", 2)]),
            ("n = ${a + 1}!", vec![text("n = "), expr("a + 1", 6), text("!")]),
            ("$${a}", vec![text("${a}")]),
            ("${'}' + {\"k\": 1}.k}", vec![expr("'}' + {\"k\": 1}.k", 2)]),
        ] {
            assert_eq!(split(given).unwrap(), expected, "{given}");
        }
        assert_eq!(split("a ${b"), Err(TemplateError { offset: 2 }));
    }
}

//! Why a text is no expression, in words for people: the parser's own messages name its tokens. The usual slips of those who know
//! Python, C or YAML better than CEL are recognised; nothing is parsed here.

use super::{ExprError, ExprErrorKind as Kind};
use crate::unit::Unit;

/// What an expression looks like, where nothing better is known.
const EXAMPLE: &str = "expressions are written like `inputs.force > 2.0 && channels.hand.gesture == 'fist'`";

/// A piece of an expression.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Token<'s> {
    kind: TokenKind,
    text: &'s str,
    start: usize,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum TokenKind {
    Word,
    Number,
    Text,
    /// A text whose second quote is missing.
    OpenText,
    Operator,
    Open,
    Close,
    /// A character that no expression has.
    Foreign,
}

/// Explains a text that the parser refused at byte `at`.
pub(super) fn explain(source: &str, at: usize) -> ExprError {
    let tokens = tokens(source);
    open_text(&tokens)
        .or_else(|| magnitude(source, &tokens))
        .or_else(|| foreign(&tokens))
        .or_else(|| brackets(&tokens))
        .or_else(|| neighbours(&tokens))
        .or_else(|| half_choice(&tokens))
        .or_else(|| too_large(&tokens))
        .unwrap_or_else(|| {
            let end = source[at..].chars().next().map_or(source.len(), |c| at + c.len_utf8());
            let start = at.min(source.len().saturating_sub(1));
            said((start, end), "this is not an expression", EXAMPLE)
        })
}

/// Refuses `//`: in CEL what follows is a comment, so that `a // b` would be `a` without a word.
pub(super) fn comment(source: &str) -> Option<ExprError> {
    let found = source.contains("//").then(|| tokens(source))?;
    let token = *found.iter().find(|token| token.text == "//")?;
    let error =
        explained(token, "there is no operator `//`", "divide with `/`: whole numbers give a whole number");
    Some(ExprError { near: Some((error.start, error.end, "/".into())), ..error })
}

fn said((start, end): (usize, usize), message: impl Into<String>, help: impl Into<String>) -> ExprError {
    let (message, help) = (message.into(), Some(help.into()));
    ExprError { kind: Kind::Syntax, message, help, start, end, near: None }
}

fn explained(token: Token<'_>, message: impl Into<String>, help: impl Into<String>) -> ExprError {
    said((token.start, token.start + token.text.len()), message, help)
}

/// As [`explained`], where another text in the token's place puts it right.
fn rewritten(token: Token<'_>, message: impl Into<String>, write: &str) -> ExprError {
    let error = explained(token, message, format!("write `{write}`"));
    ExprError { near: Some((error.start, error.end, write.to_owned())), ..error }
}

/// `a ? b`.
fn half_choice(tokens: &[Token<'_>]) -> Option<ExprError> {
    let open = *tokens.iter().find(|token| token.text == "?")?;
    let whole = tokens.iter().any(|token| token.text == ":");
    (!whole).then(|| {
        explained(
            open,
            "this `?` has no `:`",
            "write `condition ? value : other value`, or the condition alone",
        )
    })
}

fn too_large(tokens: &[Token<'_>]) -> Option<ExprError> {
    let infinite = |token: &&Token<'_>| {
        token.kind == TokenKind::Number && token.text.parse::<f64>().is_ok_and(f64::is_infinite)
    };
    let token = *tokens.iter().find(infinite)?;
    Some(explained(token, "this number is too large", "numbers go up to about 1.8e308"))
}

fn open_text(tokens: &[Token<'_>]) -> Option<ExprError> {
    let open = *tokens.iter().find(|token| token.kind == TokenKind::OpenText)?;
    let quote = &open.text[..1];
    let error = explained(open, "this text has no end", format!("close it with {quote}"));
    Some(ExprError {
        near: Some((error.start, error.end, format!("{}{quote}", open.text.trim_end()))),
        ..error
    })
}

/// `|x|`: a bar where a value begins, and another one after it.
fn magnitude(source: &str, tokens: &[Token<'_>]) -> Option<ExprError> {
    let bar = |token: &Token<'_>| token.text == "|";
    let begins = |at: usize| at == 0 || matches!(tokens[at - 1].kind, TokenKind::Operator | TokenKind::Open);
    let open = (0..tokens.len()).find(|at| bar(&tokens[*at]) && begins(*at))?;
    let close = tokens[open + 1..].iter().find(|token| bar(token))?;
    let inner = source[tokens[open].start + 1..close.start].trim();
    let (start, end) = (tokens[open].start, close.start + 1);
    let write = format!("abs({inner})");
    let help = format!("write `{write}`, or `norm({inner})` for the length of a vector");
    let near = Some((start, end, write));
    Some(ExprError { near, ..said((start, end), "`|...|` is no operator here", help) })
}

/// Operators and words of other languages.
fn foreign(tokens: &[Token<'_>]) -> Option<ExprError> {
    // What is written, how it is said, and what to write instead.
    const OTHERWISE: [(&str, &str, &str); 19] = [
        ("=", "`=` does not compare", "=="),
        (":=", "`:=` gives no value here: `assign` does", "=="),
        ("===", "there is no operator `===`", "=="),
        ("!==", "there is no operator `!==`", "!="),
        ("<>", "there is no operator `<>`", "!="),
        ("=>", "there is no operator `=>`", ">="),
        ("=<", "there is no operator `=<`", "<="),
        ("&", "there is no operator `&`", "&&"),
        ("|", "there is no operator `|`", "||"),
        ("and", "`and` is no operator here", "&&"),
        ("or", "`or` is no operator here", "||"),
        ("xor", "`xor` is no operator here", "!="),
        ("not", "`not` is no operator here", "!"),
        ("AND", "`AND` is no operator here", "&&"),
        ("OR", "`OR` is no operator here", "||"),
        ("XOR", "`XOR` is no operator here", "!="),
        ("NOT", "`NOT` is no operator here", "!"),
        ("is", "`is` is no operator here", "=="),
        ("equals", "`equals` is no operator here", "=="),
    ];
    for (at, token) in tokens.iter().enumerate() {
        let field = at > 0 && tokens[at - 1].text == ".";
        let next = tokens.get(at + 1).map_or("", |next| next.text);
        if token.text == "not" && next == "in" {
            return Some(explained(*token, "`not in` is no operator here", "write `!(a in b)`"));
        }
        if matches!(token.text, "**" | "^") {
            let message = format!("there is no operator `{}`", token.text);
            return Some(explained(*token, message, "multiply with `*`"));
        }
        if let Some((_, message, write)) = OTHERWISE.iter().find(|(text, ..)| *text == token.text && !field)
            && matches!(token.kind, TokenKind::Operator | TokenKind::Word)
        {
            return Some(rewritten(*token, *message, write));
        }
        if matches!(token.text, "+=" | "-=" | "++" | "--") {
            return Some(explained(
                *token,
                "an expression changes nothing",
                "values are changed by `assign`",
            ));
        }
        if token.kind == TokenKind::Foreign {
            let message = format!("an expression has no `{}`", token.text);
            let help = match token.text {
                "$" => "inside of an expression names stand without `${}`",
                ";" => "an expression is one value, without `;`",
                _ => EXAMPLE,
            };
            return Some(explained(*token, message, help));
        }
    }
    None
}

fn brackets(tokens: &[Token<'_>]) -> Option<ExprError> {
    let closing = |open: &str| match open {
        "(" => ")",
        "[" => "]",
        _ => "}",
    };
    let mut open: Vec<Token<'_>> = Vec::new();
    for token in tokens {
        match token.kind {
            TokenKind::Open => open.push(*token),
            TokenKind::Close => match open.pop() {
                Some(before) if closing(before.text) == token.text => {}
                Some(before) => {
                    let message = format!("`{}` is closed by `{}`", before.text, token.text);
                    return Some(rewritten(*token, message, closing(before.text)));
                }
                None => {
                    let message = format!("this `{}` closes nothing", token.text);
                    let error = explained(*token, message, "remove it, or add the bracket that it closes");
                    return Some(ExprError { near: Some((error.start, error.end, String::new())), ..error });
                }
            },
            _ => {}
        }
    }
    let last = *open.last()?;
    let help = format!("add the missing `{}`", closing(last.text));
    let error = explained(last, format!("this `{}` is not closed", last.text), help);
    let missing: String = open.iter().rev().map(|open| closing(open.text)).collect();
    let end = tokens.last()?;
    let rest = (end.start, end.start + end.text.len(), format!("{}{missing}", end.text));
    Some(ExprError { near: Some(rest), ..error })
}

/// Two values without an operator between them, or an operator without a value.
fn neighbours(tokens: &[Token<'_>]) -> Option<ExprError> {
    let operand = |token: &Token<'_>| {
        matches!(token.kind, TokenKind::Word | TokenKind::Number | TokenKind::Text) && token.text != "in"
    };
    let binary = |token: &Token<'_>| token.kind == TokenKind::Operator && !matches!(token.text, "!" | "-");
    for pair in tokens.windows(2) {
        let [left, right] = pair else { continue };
        let ends = operand(left) || left.kind == TokenKind::Close;
        if left.kind == TokenKind::Number && right.kind == TokenKind::Word && right.text != "in" {
            return Some(number_with_unit(*left, *right));
        }
        if ends && operand(right) {
            let message = format!("there is no operator between `{}` and `{}`", left.text, right.text);
            return Some(explained(*right, message, EXAMPLE));
        }
        let starts_nothing = binary(left) || left.kind == TokenKind::Open || left.text == "!";
        if starts_nothing && binary(right) {
            return Some(explained(*right, format!("there is no value before `{}`", right.text), EXAMPLE));
        }
        if binary(left) && right.kind == TokenKind::Close {
            return Some(explained(*left, format!("there is no value after `{}`", left.text), EXAMPLE));
        }
    }
    let (first, last) = (tokens.first()?, tokens.last()?);
    if last.text == "%" {
        let help = "`%` gives the rest of a division; a share is a number, as `0.5` for 50 %";
        return Some(explained(*last, "there is no value after `%`", help));
    }
    if last.kind == TokenKind::Operator || last.text == "in" {
        return Some(explained(*last, format!("there is no value after `{}`", last.text), EXAMPLE));
    }
    binary(first).then(|| explained(*first, format!("there is no value before `{}`", first.text), EXAMPLE))
}

fn number_with_unit(number: Token<'_>, unit: Token<'_>) -> ExprError {
    let end = unit.start + unit.text.len();
    let si = Unit::parse(unit.text).ok().zip(number.text.parse::<f64>().ok());
    let help = match si {
        Some(((si, factor), value)) => format!("write it in SI units, here {si}: `{:?}`", value * factor),
        None => "write the number alone, in SI units".to_owned(),
    };
    let near = si.map(|((_, factor), value)| (number.start, end, format!("{:?}", value * factor)));
    ExprError { near, ..said((number.start, end), "numbers in expressions have no units", help) }
}

fn tokens(source: &str) -> Vec<Token<'_>> {
    let mut tokens = Vec::new();
    let mut at = 0;
    while let Some(first) = source[at..].chars().next() {
        let rest = &source[at..];
        let run = |of: &dyn Fn(char) -> bool| rest.find(|c| !of(c)).unwrap_or(rest.len());
        let (kind, length) = match first {
            c if c.is_whitespace() => {
                at += c.len_utf8();
                continue;
            }
            '\'' | '"' => match text_length(rest, first) {
                Some(length) => (TokenKind::Text, length),
                None => (TokenKind::OpenText, rest.len()),
            },
            c if c.is_alphabetic() || c == '_' => {
                (TokenKind::Word, run(&|c| c.is_alphanumeric() || c == '_'))
            }
            c if c.is_ascii_digit() => (TokenKind::Number, number_length(rest)),
            '(' | '[' | '{' => (TokenKind::Open, 1),
            ')' | ']' | '}' => (TokenKind::Close, 1),
            '.' | ',' | '?' => (TokenKind::Operator, 1),
            c if "=!<>&|+-*/%:^".contains(c) => (TokenKind::Operator, operator_length(rest)),
            c => (TokenKind::Foreign, c.len_utf8()),
        };
        tokens.push(Token { kind, text: &rest[..length], start: at });
        at += length;
    }
    tokens
}

/// The length of a text with its quotes, which a backslash escapes.
fn text_length(rest: &str, quote: char) -> Option<usize> {
    let mut escaped = false;
    for (at, c) in rest.char_indices().skip(1) {
        match c {
            _ if escaped => escaped = false,
            '\\' => escaped = true,
            c if c == quote => return Some(at + 1),
            _ => {}
        }
    }
    None
}

/// `12`, `0.5`, `1e-3`.
fn number_length(rest: &str) -> usize {
    let bytes = rest.as_bytes();
    let digits = |from: usize| from + bytes[from..].iter().take_while(|b| b.is_ascii_digit()).count();
    let mut end = digits(0);
    if bytes.get(end) == Some(&b'.') && bytes.get(end + 1).is_some_and(u8::is_ascii_digit) {
        end = digits(end + 1);
    }
    if matches!(bytes.get(end), Some(b'e' | b'E')) {
        let sign = usize::from(matches!(bytes.get(end + 1), Some(b'+' | b'-')));
        if bytes.get(end + 1 + sign).is_some_and(u8::is_ascii_digit) {
            end = digits(end + 1 + sign);
        }
    }
    end
}

/// The longest operator, of this language or another.
fn operator_length(rest: &str) -> usize {
    const LONG: [&str; 18] = [
        "===", "!==", "==", "!=", "<=", ">=", "=>", "=<", ":=", "<>", "&&", "||", "**", "//", "+=", "-=",
        "++", "--",
    ];
    LONG.iter().find(|operator| rest.starts_with(**operator)).map_or(1, |operator| operator.len())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Each text, the part of it that is marked, and what is said.
    #[test]
    fn usual_slips_are_explained_at_their_place() {
        let cases = [
            ("a = 2", "=", "`=` does not compare (write `==`)"),
            ("a === 2", "===", "there is no operator `===` (write `==`)"),
            ("a and b", "and", "`and` is no operator here (write `&&`)"),
            ("not a", "not", "`not` is no operator here (write `!`)"),
            ("a & b", "&", "there is no operator `&` (write `&&`)"),
            ("a > 6 N", "6 N", "numbers in expressions have no units (write it in SI units, here N: `6.0`)"),
            (
                "a > 5 cm",
                "5 cm",
                "numbers in expressions have no units (write it in SI units, here m: `0.05`)",
            ),
            (
                "a > 5 apples",
                "5 apples",
                "numbers in expressions have no units (write the number alone, in SI units)",
            ),
            ("(a > 2", "(", "this `(` is not closed (add the missing `)`)"),
            ("a > 2)", ")", "this `)` closes nothing (remove it, or add the bracket that it closes)"),
            ("a == 'go", "'go", "this text has no end (close it with ')"),
            ("${a} > 2", "$", "an expression has no `$` (inside of an expression names stand without `${}`)"),
            ("a => 2", "=>", "there is no operator `=>` (write `>=`)"),
            ("a =< 2", "=<", "there is no operator `=<` (write `<=`)"),
            ("a := 2", ":=", "`:=` gives no value here: `assign` does (write `==`)"),
            ("a not in b", "not", "`not in` is no operator here (write `!(a in b)`)"),
            ("a xor b", "xor", "`xor` is no operator here (write `!=`)"),
            ("a ^ 2", "^", "there is no operator `^` (multiply with `*`)"),
            ("a > 1e999", "1e999", "this number is too large (numbers go up to about 1.8e308)"),
            (
                "a ? b",
                "?",
                "this `?` has no `:` (write `condition ? value : other value`, or the condition alone)",
            ),
            ("a += 1", "+=", "an expression changes nothing (values are changed by `assign`)"),
        ];
        for (source, marked, said) in cases {
            let error = explain(source, 0);
            let help = error.help.unwrap_or_default();
            assert_eq!(format!("{} ({help})", error.message), said, "{source}");
            assert_eq!(&source[error.start..error.end], marked, "{source}");
        }
        for (source, said) in [
            ("a b", "there is no operator between `a` and `b`"),
            ("a >", "there is no value after `>`"),
            ("&& a", "there is no value before `&&`"),
            ("a && || b", "there is no value before `||`"),
            ("a.b.", "there is no value after `.`"),
        ] {
            assert_eq!(explain(source, 0).message, said, "{source}");
        }
    }

    #[test]
    fn no_text_is_too_strange() {
        for source in ["é", "😀", "a\n=\nb", "'", "\\", "((((", "\"\\", "1e", "1.", "..", "a.'b"] {
            let error = explain(source, 0);
            assert!(source.get(error.start..error.end).is_some(), "{source}: {error:?}");
        }
    }
}

//! What a plain scalar means: the core schema of YAML 1.2 (section 10.3.2). In addition, numbers may have `_` between their digits,
//! and integers may be binary (`0b101`).

use crate::tree::Yaml;

/// The meaning of a plain scalar.
pub(crate) enum Resolved {
    /// Null, a bool or a number.
    Value(Yaml),
    /// A text.
    Text,
    /// Infinity, not a number, or a number that is too large.
    NotFinite,
}

pub(crate) fn resolve(text: &str) -> Resolved {
    let is = |word: &str| text.eq_ignore_ascii_case(word);
    match text.as_bytes().first() {
        None | Some(b'~') if text.len() < 2 => Resolved::Value(Yaml::Null),
        Some(b'n' | b'N') if is("null") => Resolved::Value(Yaml::Null),
        Some(b't' | b'T') if is("true") => Resolved::Value(Yaml::Bool(true)),
        Some(b'f' | b'F') if is("false") => Resolved::Value(Yaml::Bool(false)),
        Some(b'0'..=b'9' | b'+' | b'-' | b'.') => number(text),
        _ => Resolved::Text,
    }
}

fn number(text: &str) -> Resolved {
    let (negative, digits) = match text.as_bytes()[0] {
        b'-' => (true, &text[1..]),
        b'+' => (false, &text[1..]),
        _ => (false, text),
    };
    if let Some(magnitude) = integer(digits) {
        // A whole number that is too large for 64 bits is a float.
        let exact = i64::try_from(if negative { -magnitude } else { magnitude });
        let float = if negative { -(magnitude as f64) } else { magnitude as f64 };
        return Resolved::Value(exact.map_or(Yaml::Float(float), Yaml::Int));
    }
    if matches!(digits.to_ascii_lowercase().as_str(), ".inf" | ".nan") {
        return Resolved::NotFinite;
    }
    let mut bytes = digits.bytes();
    let begins = match bytes.next() {
        Some(b'.') => bytes.next().is_some_and(|b| b.is_ascii_digit()),
        Some(first) => first.is_ascii_digit(),
        None => false,
    };
    match text.parse::<f64>() {
        Ok(value) if begins && value.is_finite() => Resolved::Value(Yaml::Float(value)),
        Ok(_) if begins => Resolved::NotFinite,
        _ => Resolved::Text,
    }
}

/// A whole number without sign; `None` for one with leading zeros, as it might be meant as octal.
fn integer(digits: &str) -> Option<i128> {
    let (radix, digits) = match digits.as_bytes() {
        [b'0', b'x' | b'X', ..] => (16, &digits[2..]),
        [b'0', b'o' | b'O', ..] => (8, &digits[2..]),
        [b'0', b'b' | b'B', ..] => (2, &digits[2..]),
        [b'0', _, ..] => return None,
        _ => (10, digits),
    };
    let misplaced = digits.starts_with('_') || digits.ends_with('_') || digits.contains("__");
    if misplaced || !digits.bytes().all(|b| b == b'_' || (b as char).is_digit(radix)) {
        return None;
    }
    let plain = digits.contains('_').then(|| digits.replace('_', ""));
    i128::from_str_radix(plain.as_deref().unwrap_or(digits), radix).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shown(text: &str) -> String {
        match resolve(text) {
            Resolved::Value(value) => format!("{value:?}"),
            Resolved::Text => "text".to_owned(),
            Resolved::NotFinite => "not finite".to_owned(),
        }
    }

    #[test]
    fn scalars_mean_what_the_core_schema_says() {
        for (text, meaning) in [
            ("", "Null"),
            ("~", "Null"),
            ("NULL", "Null"),
            ("True", "Bool(true)"),
            ("false", "Bool(false)"),
            ("yes", "text"),
            ("0", "Int(0)"),
            ("-12", "Int(-12)"),
            ("+7", "Int(7)"),
            ("0x1F", "Int(31)"),
            ("0o17", "Int(15)"),
            ("0b101", "Int(5)"),
            ("1_000", "Int(1000)"),
            ("1__0", "text"),
            ("_1", "text"),
            ("007", "Float(7.0)"),
            ("9223372036854775807", "Int(9223372036854775807)"),
            ("9223372036854775808", "Float(9.223372036854776e18)"),
            ("0.5", "Float(0.5)"),
            (".5", "Float(0.5)"),
            ("5.", "Float(5.0)"),
            ("-1e-3", "Float(-0.001)"),
            ("1e999", "not finite"),
            (".inf", "not finite"),
            ("-.INF", "not finite"),
            (".nan", "not finite"),
            ("inf", "text"),
            ("nan", "text"),
            ("-", "text"),
            (".", "text"),
            ("...", "text"),
            ("1.2.3", "text"),
            ("6 N", "text"),
            ("-x", "text"),
            ("~a", "text"),
            ("2026-11-22", "text"),
        ] {
            assert_eq!(shown(text), meaning, "{text:?}");
        }
    }
}

//! Scalars in YAML and CEL, quoted where they could be read as another type.

/// Whether a text can be written without quotes: a word that YAML does not read as a number, a bool or null.
fn plain(text: &str) -> bool {
    const WORDS: [&str; 8] = ["true", "false", "null", "yes", "no", "on", "off", "y"];
    let lower = text.to_ascii_lowercase();
    let first = text.chars().next().is_some_and(|c| c.is_ascii_alphabetic() || c == '_');
    let stem = text.strip_suffix(".*").unwrap_or(text);
    let inner = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '.' | '-');
    first && stem.chars().all(inner) && !WORDS.contains(&lower.as_str()) && lower != "n"
}

/// A text as a YAML scalar.
pub(super) fn scalar(text: &str) -> String {
    if plain(text) { text.to_owned() } else { quoted(text) }
}

/// A text as a double-quoted YAML scalar.
pub(super) fn quoted(text: &str) -> String {
    let mut result = String::from("\"");
    for c in text.chars() {
        match c {
            '"' => result.push_str("\\\""),
            '\\' => result.push_str("\\\\"),
            '\n' => result.push_str("\\n"),
            '\t' => result.push_str("\\t"),
            ' '..='~' => result.push(c),
            c if c.is_alphanumeric() => result.push(c),
            c => result.push_str(&format!("\\U{:08X}", u32::from(c))),
        }
    }
    result.push('"');
    result
}

/// A literal text: `${` in it does not begin an expression.
pub(super) fn literal(text: &str) -> String {
    scalar(&text.replace("${", "$${"))
}

/// JSON as YAML on one line; its texts are literal.
pub(super) fn json(value: &serde_json::Value) -> String {
    use serde_json::Value as Json;
    match value {
        Json::Null | Json::Bool(_) | Json::Number(_) => value.to_string(),
        Json::String(text) => literal(text),
        Json::Array(items) => format!("[{}]", items.iter().map(json).collect::<Vec<_>>().join(", ")),
        Json::Object(fields) => {
            let field = |(name, value): (&String, &Json)| format!("{}: {}", scalar(name), json(value));
            format!("{{{}}}", fields.iter().map(field).collect::<Vec<_>>().join(", "))
        }
    }
}

/// A text as a CEL string.
pub(super) fn cel_string(text: &str) -> String {
    let mut result = String::from("'");
    for c in text.chars() {
        match c {
            '\'' | '\\' => result.extend(['\\', c]),
            '\n' => result.push_str("\\n"),
            '\r' => result.push_str("\\r"),
            '\t' => result.push_str("\\t"),
            c => result.push(c),
        }
    }
    result.push('\'');
    result
}

/// One line of a text, for a comment.
pub(super) fn comment(text: &str) -> String {
    text.chars().map(|c| if c.is_control() { ' ' } else { c }).take(200).collect()
}

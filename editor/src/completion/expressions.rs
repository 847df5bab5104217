//! What an expression may go on with.

use armarium_source::Span;
use armarium_values::{Type, expr};

use super::{Completing, Icon, Proposal};
use crate::cursor::{PathStep, TextCursor};

impl Completing<'_> {
    /// What an expression may go on with; `written` is its text before the place.
    pub(super) fn expression(&self, cursor: &TextCursor, written: &str) -> (Vec<Proposal>, Span) {
        let span = cursor.word;
        let in_quotes = |function: &str| {
            let at = written.rfind(&format!("{function}("))?;
            let inner = written[at + function.len() + 1..].trim_start().strip_prefix(['\'', '"'])?;
            (!inner.contains(['\'', '"'])).then_some(inner)
        };
        let event = self.event_type(cursor);
        let proposals = self.scoped(cursor, |scope| {
            if in_quotes("active").is_some() {
                return self.targets(&TextCursor { path: Vec::new(), ..cursor.clone() }, scope);
            }
            let channels = scope.library.channels_of(scope.chart, &self.workspace.catalog.channels);
            let roots = scope.roots(&channels, event);
            if in_quotes("age").is_some() {
                return channels.names().map(|name| Proposal::new(name, Icon::FIELD)).collect();
            }
            let of_chain = |chain: &[&str]| {
                let (root, fields) = chain.split_first()?;
                let ty = roots.iter().find(|(name, ..)| name == root).map(|(_, ty, _)| ty.clone());
                fields.iter().fold(ty, |ty, part| {
                    ty?.fields().into_iter().find(|(name, _)| name == part).map(|(_, ty)| ty)
                })
            };
            if let Some(compared) = compared_before(written) {
                return words(of_chain(&chain_before(compared)).as_ref());
            }
            let chain = chain_before(written);
            let field = |(name, ty): (&str, Type)| Proposal::new(name, Icon::FIELD).detail(ty.to_string());
            match chain.split_last() {
                Some((_, chain)) if !chain.is_empty() => {
                    of_chain(chain).map_or_else(Vec::new, |ty| ty.fields().into_iter().map(field).collect())
                }
                _ => {
                    let root = |(name, _, doc): (String, Type, String)| {
                        Proposal::new(name, Icon::VARIABLE).detail(doc).rank(1)
                    };
                    let mut all: Vec<Proposal> = roots.into_iter().map(root).collect();
                    all.extend(expr::functions().map(|function| self.function(&function)));
                    all.extend(["true", "false"].map(|word| Proposal::new(word, Icon::KEYWORD)));
                    all
                }
            }
        });
        (proposals.unwrap_or_default(), span)
    }

    fn function(&self, function: &expr::Signature) -> Proposal {
        let proposal =
            Proposal::new(function.name, Icon::FUNCTION).detail(function.form).doc(function.doc).rank(4);
        match self.snippets {
            true => proposal.snippet(format!("{}($1)", function.name)),
            false => proposal,
        }
    }

    /// What comes with the event that the place's transition answers.
    fn event_type(&self, cursor: &TextCursor) -> Type {
        let mut path = cursor.path.iter();
        let event = path
            .find(|step| matches!(step, PathStep::Key(key) if key == "transitions"))
            .and_then(|_| path.next());
        let Some(PathStep::Key(event)) = event else { return Type::Any };
        let declared = self.scoped(cursor, |scope| {
            let all = scope.library.charts.values().flat_map(|chart| chart.events());
            all.filter(|(name, _)| name == event).find_map(|(_, ty)| ty.cloned())
        });
        declared.flatten().unwrap_or(Type::Any)
    }
}

/// The text of the expression that a value's text ends in, up to there; none where it ends outside of one.
pub(super) fn expression_before(text: &str, condition: bool) -> Option<&str> {
    if let Some(open) = text.rfind("${").filter(|at| !text[..*at].ends_with('$')) {
        let inner = &text[open + 2..];
        let (mut depth, mut quote) = (0_i32, None);
        for c in inner.chars() {
            match (quote, c) {
                (None, '\'' | '"') => quote = Some(c),
                (Some(open), c) if open == c => quote = None,
                (None, '{') => depth += 1,
                (None, '}') => depth -= 1,
                _ => {}
            }
        }
        return (depth >= 0).then_some(inner);
    }
    condition.then(|| text.trim_start().trim_start_matches(['"']))
}

/// What a text compares with the text in quotes that it ends in: `hand.gesture` of `hand.gesture == 'fi`.
fn compared_before(text: &str) -> Option<&str> {
    let open = text.rfind(['\'', '"'])?;
    // A quote that closes another is the second of its kind.
    let mark = &text[open..=open];
    if text.matches(mark).count().is_multiple_of(2) {
        return None;
    }
    let before = text[..open].trim_end();
    let before = before.strip_suffix("==").or_else(|| before.strip_suffix("!="))?;
    Some(before.trim_end())
}

/// The values of a type that has few, as they are written.
pub(super) fn words(ty: Option<&Type>) -> Vec<Proposal> {
    let words = match ty {
        Some(Type::Enum(words)) => words.clone(),
        Some(Type::Bool) => vec!["true".into(), "false".into()],
        _ => Vec::new(),
    };
    words.into_iter().map(|word| Proposal::new(word, Icon::ENUM_MEMBER).rank(0)).collect()
}

/// The dotted name that a text ends in, part by part; the last may be empty.
fn chain_before(text: &str) -> Vec<&str> {
    let part = |c: char| c.is_alphanumeric() || matches!(c, '_' | '.');
    let len: usize = text.chars().rev().take_while(|c| part(*c)).map(char::len_utf8).sum();
    text[text.len() - len..].split('.').collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_expression_that_is_being_written_is_found() {
        assert_eq!(expression_before("\"${inputs.", false), Some("inputs."));
        assert_eq!(expression_before("\"${a} and ${b + ", false), Some("b + "));
        assert_eq!(expression_before("\"${a}", false), None);
        assert_eq!(expression_before("\"$${a", false), None);
        assert_eq!(expression_before("\"norm(ch", true), Some("norm(ch"));
        assert_eq!(chain_before("1 + channels.wrist.p"), ["channels", "wrist", "p"]);
        assert_eq!(chain_before("f("), [""]);
    }
}

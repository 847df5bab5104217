//! Values and expressions, compiled in their scope: types and units are held against what is declared.

use armarium_source::yaml::{Node, Yaml};
use armarium_source::{Findings, Remedy, Source, Span, code};
use armarium_values::expr::{Expr, ExprErrorKind, Piece, split};
use armarium_values::{Fit, Type, Value};

use super::literals::fitting;
use super::scope::Scope;
use crate::program::{Code, Term};

/// Compiles an `if:` or `until:`, which is always an expression.
pub(super) fn condition(node: &Node, scope: &Scope<'_, '_>, findings: &mut Findings) -> Option<Code> {
    let text = match &node.value {
        Yaml::Bool(b) => b.to_string(),
        Yaml::String(s) => s.clone(),
        other => {
            let message = format!("an expression is needed here, not {}", other.describe());
            let help = "YAML reads `{`, `[`, `!` and `#` itself: put the expression into quotes".to_owned();
            findings.error_help(code::FORM, node.span, message, Some(help));
            if let Some(remedy) = quoted(node, &findings.source) {
                findings.remedy(remedy);
            }
            return None;
        }
    };
    let (inner, offset) = match split(&text).as_deref() {
        Ok([Piece::Expr { source, offset }]) => (source.clone(), *offset),
        _ => (text, 0),
    };
    let code = expression(&inner, offset, node.span, scope, findings)?;
    match Type::Bool.fit(code.expr.ty()) {
        Fit::Yes | Fit::Perhaps => Some(code),
        _ => {
            let message = format!("a condition is true or false; this is {}", code.expr.ty());
            findings.error(code::TYPE, node.span, message);
            None
        }
    }
}

/// Quotes for a condition that YAML reads as something else: `{a > 3}`, `!a`.
fn quoted(node: &Node, source: &Source) -> Option<Remedy> {
    let (text, layout) = (&source.text, source.layout());
    let entry = layout.entries.iter().rfind(|entry| {
        entry.key.start < node.span.start && entry.value.is_some_and(|value| value <= node.span.start)
    })?;
    let span = Span { start: entry.value?, end: entry.end };
    let written = text.get(span.start..span.end)?;
    let expression = match written.strip_prefix('{').and_then(|inner| inner.strip_suffix('}')) {
        Some(inner) => inner.trim(),
        None => written.trim(),
    };
    let quote = if expression.contains('"') { '\'' } else { '"' };
    let plain = !expression.is_empty() && !expression.contains([quote, '\n']) && !expression.contains(": ");
    plain.then(|| Remedy::replace(span, format!("{quote}{expression}{quote}")))
}

/// Compiles one expression that begins `offset` bytes into the text at `span`.
fn expression(
    text: &str,
    offset: usize,
    span: Span,
    scope: &Scope<'_, '_>,
    findings: &mut Findings,
) -> Option<Code> {
    let compiled = Expr::compile(text, scope);
    for (start, end, symbol) in scope.found.borrow_mut().drain(..) {
        let file = &findings.source.text;
        let at = inner_span(file, text, offset, span, offset + start, offset + end);
        scope.names.refer(scope.site.source, at, || Some(symbol));
    }
    match compiled {
        Ok(expr) => Some(Code { expr, place: scope.site.place(span) }),
        Err(error) => {
            let (start, end) = (offset + error.start, offset + error.end);
            let at = inner_span(&findings.source.text, text, offset, span, start, end);
            let code = match error.kind {
                ExprErrorKind::Syntax => code::EXPRESSION,
                ExprErrorKind::TooLarge => code::LIMIT,
                ExprErrorKind::UnknownName => code::VARIABLE,
                ExprErrorKind::UnknownChannel => code::CHANNEL,
                ExprErrorKind::UnknownState => code::STATE,
                ExprErrorKind::UnknownFunction => code::FUNCTION,
                ExprErrorKind::Type => code::TYPE,
                ExprErrorKind::Unit => code::UNIT,
            };
            findings.error_help(code, at, error.message, error.help);
            if let Some((start, end, near)) = error.near {
                let file = &findings.source.text;
                let at = inner_span(file, text, offset, span, offset + start, offset + end);
                // A text in an expression has the quotes that those around it are not.
                let near = if file[span.start..].starts_with('\'') { near.replace('\'', "\"") } else { near };
                if file.get(at.start..at.end) == text.get(start..end) {
                    findings.remedy(Remedy::replace(at, near));
                }
            }
            None
        }
    }
}

/// The place in the file of a part of a scalar: exact where the scalar stands in the file as it reads.
fn inner_span(file: &str, text: &str, offset: usize, span: Span, start: usize, end: usize) -> Span {
    let raw = file.get(span.start..span.end.min(file.len())).unwrap_or("");
    // The same expression may stand before it.
    let Some(found) = raw.get(offset..).and_then(|rest| rest.find(text)) else { return span };
    let base = span.start + offset + found;
    let (start, end) = (base + start - offset, base + end - offset);
    Span { start, end: end.max(start + 1) }
}

/// Compiles a value: literals with expressions anywhere in them, held against the type that is declared.
pub(super) fn value(node: &Node, ty: &Type, scope: &Scope<'_, '_>, findings: &mut Findings) -> Option<Term> {
    let (term, found) = term(node, scope, findings)?;
    if let Term::Literal(literal) = term {
        return fitting(literal, node, ty, findings).map(Term::Literal);
    }
    match ty.fit(&found) {
        Fit::Yes | Fit::Perhaps => Some(term),
        Fit::OtherUnit => {
            findings.error(code::UNIT, node.span, format!("expected {ty}, found {found}"));
            None
        }
        // Text becomes a reference where one is declared.
        Fit::No if matches!((ty, &found), (Type::Reference(_), Type::String | Type::Enum(_))) => Some(term),
        Fit::No => {
            findings.error(code::TYPE, node.span, format!("expected {ty}, found {found}"));
            None
        }
    }
}

fn term(node: &Node, scope: &Scope<'_, '_>, findings: &mut Findings) -> Option<(Term, Type)> {
    match &node.value {
        Yaml::String(text) => self::text(text, node.span, scope, findings),
        Yaml::List(items) => {
            let terms: Vec<_> = items.iter().map(|n| term(n, scope, findings)).collect();
            let terms: Vec<(Term, Type)> = terms.into_iter().collect::<Option<_>>()?;
            if terms.iter().all(|(t, _)| matches!(t, Term::Literal(_))) {
                return Some((Term::Literal(unescape(node.literal())), Type::Any));
            }
            let list = terms.into_iter().map(|(t, _)| t).collect();
            Some((Term::List(list), Type::list(Type::Any)))
        }
        Yaml::Map(entries) => {
            let mut terms = Vec::new();
            for (key, node) in entries {
                terms.push((key.text.clone(), term(node, scope, findings)?.0));
            }
            if terms.iter().all(|(_, t)| matches!(t, Term::Literal(_))) {
                return Some((Term::Literal(unescape(node.literal())), Type::Any));
            }
            Some((Term::Map(terms), Type::map(Type::Any)))
        }
        _ => Some((Term::Literal(node.literal()), Type::Any)),
    }
}

/// Text with expressions in it; a text that is one expression keeps its type.
fn text(text: &str, span: Span, scope: &Scope<'_, '_>, findings: &mut Findings) -> Option<(Term, Type)> {
    let pieces = match split(text) {
        Ok(pieces) => pieces,
        Err(error) => {
            let written = findings.source.text.get(span.start..span.end).unwrap_or("").to_owned();
            let help = Some("add the missing `}`".to_owned());
            findings.error_help(code::EXPRESSION, span, error.to_string(), help);
            // Before the quote that ends the text.
            let inner = written.trim_end_matches(['"', '\'']).len();
            if written.get(1..inner).is_some_and(|inner| inner.contains("${")) || written.starts_with("${") {
                let at = Span { start: span.start + inner, end: span.start + inner };
                findings.remedy(Remedy::replace(at, "}"));
            }
            return None;
        }
    };
    match pieces.as_slice() {
        [] => Some((Term::Literal(Value::String(String::new())), Type::Any)),
        [Piece::Text(text)] => Some((Term::Literal(Value::String(text.clone())), Type::Any)),
        [Piece::Expr { source: inner, offset }] => {
            let code = expression(inner, *offset, span, scope, findings)?;
            let ty = code.expr.ty().clone();
            Some((Term::Expr(code), ty))
        }
        pieces => {
            let mut parts = Vec::new();
            for piece in pieces {
                parts.push(match piece {
                    Piece::Text(text) => Term::Literal(Value::String(text.clone())),
                    Piece::Expr { source: inner, offset } => {
                        Term::Expr(expression(inner, *offset, span, scope, findings)?)
                    }
                });
            }
            Some((Term::Text(parts), Type::String))
        }
    }
}

/// `$${` in the texts of a literal is `${`.
fn unescape(literal: Value) -> Value {
    match literal {
        Value::String(s) => Value::String(s.replace("$${", "${")),
        Value::List(items) => Value::List(items.into_iter().map(unescape).collect()),
        Value::Map(fields) => Value::Map(fields.into_iter().map(|(k, v)| (k, unescape(v))).collect()),
        other => other,
    }
}

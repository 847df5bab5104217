//! The checker's rules that need no source place: names of operators, compatibility of types, names of types.

use cel::IdedExpr;
use cel::common::ast::Expr as Cel;

use super::eval::Macro;
use super::operate::{Arithmetic, Comparison};
use crate::types::Type;

pub(super) fn dotted(expr: &IdedExpr) -> Option<(Vec<&str>, Vec<u64>)> {
    let (mut names, mut ids, mut at) = (Vec::new(), Vec::new(), expr);
    loop {
        match &at.expr {
            Cel::Ident(name) => {
                names.push(name.as_str());
                ids.push(at.id);
                names.reverse();
                ids.reverse();
                return Some((names, ids));
            }
            Cel::Select(select) if !select.test => {
                names.push(select.field.as_str());
                ids.push(at.id);
                at = &select.operand;
            }
            _ => return None,
        }
    }
}

pub(super) fn comprehension(name: &str, arguments: usize) -> Option<Macro> {
    match (name, arguments) {
        ("all", 2) => Some(Macro::All),
        ("exists", 2) => Some(Macro::Exists),
        ("exists_one" | "existsOne", 2) => Some(Macro::ExistsOne),
        ("filter", 2) => Some(Macro::Filter),
        ("map", 2) => Some(Macro::Map),
        _ => None,
    }
}

pub(super) fn comparison(name: &str) -> Option<Comparison> {
    Some(match name {
        "_<_" => Comparison::Less,
        "_<=_" => Comparison::LessEqual,
        "_>_" => Comparison::Greater,
        "_>=_" => Comparison::GreaterEqual,
        "_==_" => Comparison::Equal,
        "_!=_" => Comparison::NotEqual,
        _ => return None,
    })
}

pub(super) fn arithmetic(name: &str) -> Option<Arithmetic> {
    Some(match name {
        "_+_" => Arithmetic::Add,
        "_-_" => Arithmetic::Subtract,
        "_*_" => Arithmetic::Multiply,
        "_/_" => Arithmetic::Divide,
        "_%_" => Arithmetic::Remainder,
        _ => return None,
    })
}

pub(super) fn is_text(ty: &Type) -> bool {
    matches!(ty, Type::String | Type::Enum(_))
}

/// The common type of two alternatives.
pub(super) fn join(a: &Type, b: &Type) -> Type {
    match (a, b) {
        (a, b) if a == b => a.clone(),
        (Type::Enum(x), Type::Enum(y)) => Type::Enum(x.iter().chain(y).cloned().collect()),
        (x, y) if is_text(x) && is_text(y) => Type::String,
        (Type::Int, other @ (Type::Float(_) | Type::Duration))
        | (other @ (Type::Float(_) | Type::Duration), Type::Int) => other.clone(),
        (Type::Float(Some(u)), Type::Float(None)) | (Type::Float(None), Type::Float(Some(u))) => {
            Type::Float(Some(*u))
        }
        (Type::List(x), Type::List(y)) => Type::list(join(x, y)),
        (Type::Map(x), Type::Map(y)) => Type::map(join(x, y)),
        _ => Type::Any,
    }
}

pub(super) fn article(ty: &Type) -> String {
    match ty {
        Type::Enum(words) if words.len() == 1 => format!("the string \"{}\"", words[0]),
        Type::Int => "an int".into(),
        Type::Enum(_) => ty.to_string(),
        _ => format!("a {ty}"),
    }
}

pub(super) fn mismatch(expected: &Type, found: &Type) -> String {
    format!("expected {}, found {}", article(expected), article(found))
}

//! Checks operators: units of numbers, and comparisons between comparable types.

use cel::IdedExpr;

use super::check::{Checked, Checker};
use super::eval::ExprNode;
use super::operate::{Arithmetic, Comparison};
use super::typing::{arithmetic, article, comparison, is_text, join};
use super::{ExprError, ExprErrorKind as Kind, nearest};
use crate::types::{Fit, Type};
use crate::unit::Unit;

impl Checker<'_> {
    pub(super) fn number(&self, id: u64, ty: &Type) -> Result<Type, ExprError> {
        match ty {
            Type::Any | Type::Int | Type::Float(_) => Ok(ty.clone()),
            Type::Duration => Ok(Type::quantity(Unit::S)),
            other => Err(self.error(id, Kind::Type, format!("expected a number, found {}", article(other)))),
        }
    }

    pub(super) fn binary(&mut self, id: u64, name: &str, a: &IdedExpr, b: &IdedExpr) -> Checked {
        let ((x, tx), (y, ty)) = (self.check(a)?, self.check(b)?);
        let pos = self.pos(id);
        if let Some(op) = comparison(name) {
            if matches!(op, Comparison::Equal | Comparison::NotEqual) {
                self.comparable(id, &tx, &ty)?;
            } else if !(is_text(&tx) && is_text(&ty)) {
                let (tx, ty) = (self.number(a.id, &tx)?, self.number(b.id, &ty)?);
                self.same_unit(id, &tx, &ty)?;
            }
            return Ok((ExprNode::Compare(op, Box::new((x, y)), pos), Type::Bool));
        }
        let op = arithmetic(name).unwrap_or(Arithmetic::Add);
        let result = self.arithmetic_type(id, op, (a.id, &tx), (b.id, &ty))?;
        Ok((ExprNode::Arithmetic(op, Box::new((x, y)), pos), result))
    }

    fn arithmetic_type(
        &self,
        id: u64,
        op: Arithmetic,
        (a, ta): (u64, &Type),
        (b, tb): (u64, &Type),
    ) -> Result<Type, ExprError> {
        if op == Arithmetic::Add {
            match (ta, tb) {
                (x, y) if is_text(x) && is_text(y) => return Ok(Type::String),
                (Type::List(x), Type::List(y)) => return Ok(Type::list(join(x, y))),
                (Type::Any, _) | (_, Type::Any) => return Ok(Type::Any),
                _ => {}
            }
        }
        if matches!(op, Arithmetic::Add | Arithmetic::Subtract) {
            match (ta, tb) {
                (Type::Vector, Type::Vector) => return Ok(Type::Vector),
                (Type::Vector, Type::Any) | (Type::Any, Type::Vector) => return Ok(Type::Any),
                _ => {}
            }
        }
        let (ta, tb) = (self.number(a, ta)?, self.number(b, tb)?);
        Ok(match (op, &ta, &tb) {
            (_, Type::Any, _) | (_, _, Type::Any) => Type::Any,
            (_, Type::Int, Type::Int) => Type::Int,
            (Arithmetic::Multiply, Type::Float(Some(u)), Type::Float(Some(v))) => Type::Float(u.times(*v)),
            (Arithmetic::Divide, Type::Float(Some(u)), Type::Float(Some(v))) => Type::Float(u.per(*v)),
            (Arithmetic::Divide, _, Type::Float(Some(v))) => Type::Float(Unit::ONE.per(*v)),
            _ => {
                if !matches!(op, Arithmetic::Multiply | Arithmetic::Divide) {
                    self.same_unit(id, &ta, &tb)?;
                }
                match (&ta, &tb) {
                    (Type::Float(Some(u)), _) | (_, Type::Float(Some(u))) => Type::Float(Some(*u)),
                    _ => Type::FLOAT,
                }
            }
        })
    }

    pub(super) fn same_unit(&self, id: u64, a: &Type, b: &Type) -> Result<(), ExprError> {
        match (a, b) {
            (Type::Float(Some(u)), Type::Float(Some(v))) if u != v => {
                Err(self.error(id, Kind::Unit, format!("a number in {u} against one in {v}")))
            }
            _ => Ok(()),
        }
    }

    pub(super) fn comparable(&self, id: u64, a: &Type, b: &Type) -> Result<(), ExprError> {
        if let (Type::Enum(words), Type::Enum(others)) = (a, b) {
            let (literal, words) = if words.len() == 1 { (&words[0], others) } else { (&others[0], words) };
            if words.len() > 1 && !words.contains(literal) {
                let message = format!("`{literal}` is not one of {}", words.join(", "));
                let mut error = self.error(id, Kind::Type, message);
                error.help = nearest(literal, words.iter().map(String::as_str))
                    .map(|near| format!("did you mean `{near}`?"));
                return Err(error);
            }
            return Ok(());
        }
        let numeric = |t: &Type| matches!(t, Type::Int | Type::Float(_) | Type::Duration);
        if numeric(a) && numeric(b) {
            return self.same_unit(id, &self.number(id, a)?, &self.number(id, b)?);
        }
        if a.fit(b) == Fit::No && b.fit(a) == Fit::No {
            let message = format!("{} is never equal to {}", article(a), article(b));
            return Err(self.error(id, Kind::Type, message));
        }
        Ok(())
    }
}

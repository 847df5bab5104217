//! Operators on values at evaluation.

use std::cmp::Ordering;

use super::eval::{EvalError, Pos, Val};
use super::{MAX_ITEMS, MAX_PARTS, MAX_TEXT};
use crate::{Value, Vector};

type Result<T> = std::result::Result<T, EvalError>;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Arithmetic {
    Add,
    Subtract,
    Multiply,
    Divide,
    Remainder,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Comparison {
    Less,
    LessEqual,
    Greater,
    GreaterEqual,
    Equal,
    NotEqual,
}

impl Comparison {
    /// Whether the comparison is true for two values in this order; NaN has no order.
    #[inline]
    pub(super) fn holds(self, order: Option<Ordering>) -> bool {
        match self {
            Self::Less => order == Some(Ordering::Less),
            Self::LessEqual => matches!(order, Some(Ordering::Less | Ordering::Equal)),
            Self::Greater => order == Some(Ordering::Greater),
            Self::GreaterEqual => matches!(order, Some(Ordering::Greater | Ordering::Equal)),
            Self::Equal => order == Some(Ordering::Equal),
            Self::NotEqual => order != Some(Ordering::Equal),
        }
    }
}

pub(super) fn has_nan(value: &Value) -> bool {
    match value {
        Value::Float(f) | Value::Duration(f) => f.is_nan(),
        Value::Vector(v) => v.components.iter().any(|c| c.is_nan()),
        Value::List(items) => items.iter().any(has_nan),
        _ => false,
    }
}

pub(super) fn field<'v>(of: Val<'v>, name: &str, pos: Pos) -> Result<Val<'v>> {
    let missing = || pos.error(format!("there is no `{name}` in {}", of.describe()));
    match &of {
        Val::Ref(Value::Map(fields)) => fields.get(name).map(Val::of).ok_or_else(missing),
        Val::Ref(value) => value.part(name).map(Val::own).ok_or_else(missing),
        Val::Owned(value) => match &**value {
            Value::Map(fields) => fields.get(name).cloned().map(Val::own).ok_or_else(missing),
            value => value.part(name).map(Val::own).ok_or_else(missing),
        },
        _ => Err(missing()),
    }
}

pub(super) fn index<'v>(of: Val<'v>, key: &Val<'v>, pos: Pos) -> Result<Val<'v>> {
    if let Some(name) = key.text() {
        return field(of, name, pos);
    }
    let Val::Int(i) = key else {
        return Err(pos.error(format!("expected a whole number, found {}", key.describe())));
    };
    let at = usize::try_from(*i).ok();
    let outside = |n: usize| pos.error(format!("there is no item {i} in a list of {n}"));
    match &of {
        Val::Ref(Value::List(items)) => {
            at.and_then(|i| items.get(i)).map(Val::of).ok_or_else(|| outside(items.len()))
        }
        _ => match of.as_value() {
            Some(Value::List(items)) => {
                at.and_then(|i| items.get(i)).cloned().map(Val::own).ok_or_else(|| outside(items.len()))
            }
            Some(Value::Vector(v)) => {
                at.and_then(|i| v.components.get(i)).map(|c| Val::Float(*c)).ok_or_else(|| outside(3))
            }
            _ => Err(pos.error(format!("{} has no items", of.describe()))),
        },
    }
}

pub(super) fn negate<'v>(of: &Val<'v>, pos: Pos) -> Result<Val<'v>> {
    match of {
        Val::Int(i) => i.checked_neg().map(Val::Int).ok_or_else(|| pos.error("the number is out of range")),
        Val::Float(f) => Ok(Val::Float(-f)),
        other => Err(pos.error(format!("expected a number, found {}", other.describe()))),
    }
}

pub(super) fn compare(op: Comparison, a: &Val<'_>, b: &Val<'_>, pos: Pos) -> Result<bool> {
    use Comparison as C;
    let order = match (a, b) {
        (Val::Int(a), Val::Int(b)) => Some(a.cmp(b)),
        (Val::Bool(a), Val::Bool(b)) => Some(a.cmp(b)),
        _ => match (a.number(), b.number()) {
            (Some(a), Some(b)) => a.partial_cmp(&b),
            _ => match (a.text(), b.text()) {
                (Some(a), Some(b)) => Some(a.cmp(b)),
                _ if matches!(op, C::Equal | C::NotEqual) => {
                    return Ok(equal(a, b) == (op == C::Equal));
                }
                _ => {
                    let (a, b) = (a.describe(), b.describe());
                    return Err(pos.error(format!("{a} and {b} have no order")));
                }
            },
        },
    };
    Ok(op.holds(order))
}

pub(super) fn equal(a: &Val<'_>, b: &Val<'_>) -> bool {
    match (a, b) {
        (Val::Null, Val::Null) => true,
        _ => match (a.as_value(), b.as_value()) {
            (Some(a), Some(b)) => a == b,
            _ => false,
        },
    }
}

pub(super) fn arithmetic<'v>(op: Arithmetic, a: Val<'v>, b: Val<'v>, pos: Pos) -> Result<Val<'v>> {
    use Arithmetic as A;
    if let (Val::Int(a), Val::Int(b)) = (&a, &b) {
        let result = match op {
            A::Add => a.checked_add(*b),
            A::Subtract => a.checked_sub(*b),
            A::Multiply => a.checked_mul(*b),
            A::Divide | A::Remainder if *b == 0 => return Err(pos.error("division by zero")),
            A::Divide => a.checked_div(*b),
            A::Remainder => a.checked_rem(*b),
        };
        return result.map(Val::Int).ok_or_else(|| pos.error("the whole number is out of range"));
    }
    if let (Some(a), Some(b)) = (a.number(), b.number()) {
        return Ok(Val::Float(match op {
            A::Add => a + b,
            A::Subtract => a - b,
            A::Multiply => a * b,
            A::Divide => a / b,
            A::Remainder => a % b,
        }));
    }
    if let (A::Add | A::Subtract, Some(Value::Vector(x)), Some(Value::Vector(y))) =
        (op, a.as_value(), b.as_value())
    {
        if x.frame != y.frame {
            let (x, y) = (&x.frame.0, &y.frame.0);
            return Err(pos.error(format!("a vector in the frame `{x}` and one in `{y}` do not go together")));
        }
        let sign = if op == A::Add { 1.0 } else { -1.0 };
        let sum = std::array::from_fn(|axis| x.components[axis] + sign * y.components[axis]);
        return Ok(Val::own(Value::Vector(Vector { frame: x.frame.clone(), components: sum })));
    }
    if op == A::Add {
        if let (Some(a), Some(b)) = (a.text(), b.text()) {
            if a.len() + b.len() > MAX_TEXT {
                return Err(pos.over_limit(format!("the text has more than {MAX_TEXT} bytes")));
            }
            return Ok(Val::own(Value::String([a, b].concat())));
        }
        if let (Some(Value::List(x)), Some(Value::List(y))) = (a.as_value(), b.as_value()) {
            if x.len() + y.len() > MAX_ITEMS as usize {
                return Err(pos.over_limit(format!("the list has more than {MAX_ITEMS} items")));
            }
            if x.iter().chain(y).map(Value::parts).sum::<usize>() > MAX_PARTS {
                return Err(pos.over_limit(format!("the list has more than {MAX_PARTS} parts")));
            }
            return Ok(Val::own(Value::List(x.iter().chain(y).cloned().collect())));
        }
    }
    Err(pos.error(format!("{} and {} do not go together here", a.describe(), b.describe())))
}

pub(super) fn contains(item: &Val<'_>, of: &Val<'_>, pos: Pos) -> Result<bool> {
    match of.as_value() {
        Some(Value::List(items)) => {
            let same = |v: &Value| compare(Comparison::Equal, item, &Val::of(v), pos);
            items.iter().try_fold(false, |found, v| Ok(found || same(v)?))
        }
        Some(Value::Map(fields)) => Ok(item.text().is_some_and(|name| fields.contains_key(name))),
        _ => Err(pos.error(format!("expected a list or a map, found {}", of.describe()))),
    }
}

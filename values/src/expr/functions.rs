//! The functions of expressions as one table: name, number of arguments, result type. Their implementation is here
//! too.

use super::eval::Val;
use crate::Value;
use crate::types::Type;

/// A function that expressions may call.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Function {
    Norm,
    Dot,
    Abs,
    Min,
    Max,
    Sqrt,
    Sin,
    Cos,
    Tan,
    Asin,
    Acos,
    Atan2,
    Exp,
    Ln,
    Pow,
    Floor,
    Ceil,
    Round,
    Clamp,
    IsNan,
    Size,
    Int,
    Float,
    Text,
    Bool,
    Contains,
    StartsWith,
    EndsWith,
    Motion,
    Object,
}

use Function as F;

/// Name, function, fewest and most arguments.
pub(super) const TABLE: &[(&str, Function, usize, usize)] = &[
    ("norm", F::Norm, 1, 1),
    ("dot", F::Dot, 2, 2),
    ("abs", F::Abs, 1, 1),
    ("min", F::Min, 1, 8),
    ("max", F::Max, 1, 8),
    ("sqrt", F::Sqrt, 1, 1),
    ("sin", F::Sin, 1, 1),
    ("cos", F::Cos, 1, 1),
    ("tan", F::Tan, 1, 1),
    ("asin", F::Asin, 1, 1),
    ("acos", F::Acos, 1, 1),
    ("atan2", F::Atan2, 2, 2),
    ("exp", F::Exp, 1, 1),
    ("ln", F::Ln, 1, 1),
    ("pow", F::Pow, 2, 2),
    ("floor", F::Floor, 1, 1),
    ("ceil", F::Ceil, 1, 1),
    ("round", F::Round, 1, 1),
    ("clamp", F::Clamp, 3, 3),
    ("is_nan", F::IsNan, 1, 1),
    ("size", F::Size, 1, 1),
    ("int", F::Int, 1, 1),
    ("float", F::Float, 1, 1),
    ("double", F::Float, 1, 1),
    ("string", F::Text, 1, 1),
    ("bool", F::Bool, 1, 1),
    ("contains", F::Contains, 2, 2),
    ("startsWith", F::StartsWith, 2, 2),
    ("endsWith", F::EndsWith, 2, 2),
    ("Motion", F::Motion, 1, 1),
    ("Object", F::Object, 1, 1),
];

/// The argument types of a function, for the checker.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Takes {
    Numbers,
    Vectors,
    /// Numbers, or one list of numbers.
    NumbersOrList,
    Strings,
    Sized,
    Anything,
}

impl Function {
    pub(super) fn takes(self) -> Takes {
        match self {
            F::Norm | F::Dot => Takes::Vectors,
            F::Min | F::Max => Takes::NumbersOrList,
            F::Contains | F::StartsWith | F::EndsWith | F::Motion | F::Object => Takes::Strings,
            F::Size => Takes::Sized,
            F::Int | F::Float | F::Text | F::Bool => Takes::Anything,
            _ => Takes::Numbers,
        }
    }

    /// The type of the result from the types of the arguments.
    pub(super) fn result(self, arguments: &[Type]) -> Type {
        match self {
            F::Abs | F::Min | F::Max | F::Clamp => same_number(arguments),
            F::Norm => match &arguments[0] {
                Type::List(element) => match **element {
                    Type::Float(unit) => Type::Float(unit),
                    _ => Type::FLOAT,
                },
                _ => Type::FLOAT,
            },
            F::Size | F::Int => Type::Int,
            F::Text => Type::String,
            F::Bool | F::IsNan | F::Contains | F::StartsWith | F::EndsWith => Type::Bool,
            F::Motion => Type::motion(),
            F::Object => Type::object(),
            _ => Type::FLOAT,
        }
    }

    /// The result, or an error message about the arguments.
    pub(super) fn call<'v>(self, a: &[Val<'v>]) -> Result<Val<'v>, String> {
        let number =
            |i: usize| a[i].number().ok_or_else(|| format!("expected a number, found {}", a[i].describe()));
        let text =
            |i: usize| a[i].text().ok_or_else(|| format!("expected a string, found {}", a[i].describe()));
        Ok(match self {
            F::Norm => Val::Float(vector(&a[0])?.iter().map(|x| x * x).sum::<f64>().sqrt()),
            F::Dot => {
                let (x, y) = (vector(&a[0])?, vector(&a[1])?);
                if x.len() != y.len() {
                    return Err(format!("vectors of {} and of {} components", x.len(), y.len()));
                }
                Val::Float(x.iter().zip(&y).map(|(x, y)| x * y).sum())
            }
            F::Abs => match &a[0] {
                Val::Int(i) => Val::Int(i.checked_abs().ok_or("the number is out of range")?),
                _ => Val::Float(number(0)?.abs()),
            },
            F::Min => extreme(a, |x, best| x < best)?,
            F::Max => extreme(a, |x, best| x > best)?,
            F::Sqrt => Val::Float(number(0)?.sqrt()),
            F::Sin => Val::Float(number(0)?.sin()),
            F::Cos => Val::Float(number(0)?.cos()),
            F::Tan => Val::Float(number(0)?.tan()),
            F::Asin => Val::Float(number(0)?.asin()),
            F::Acos => Val::Float(number(0)?.acos()),
            F::Atan2 => Val::Float(number(0)?.atan2(number(1)?)),
            F::Exp => Val::Float(number(0)?.exp()),
            F::Ln => Val::Float(number(0)?.ln()),
            F::Pow => Val::Float(number(0)?.powf(number(1)?)),
            F::Floor => Val::Float(number(0)?.floor()),
            F::Ceil => Val::Float(number(0)?.ceil()),
            F::Round => Val::Float(number(0)?.round()),
            F::Clamp => clamp(a, number(0)?, number(1)?, number(2)?)?,
            F::IsNan => Val::Bool(number(0)?.is_nan()),
            F::Size => Val::Int(i64::try_from(size(&a[0])?).unwrap_or(i64::MAX)),
            F::Int => Val::Int(to_int(&a[0])?),
            F::Float => Val::Float(to_float(&a[0])?),
            F::Text => Val::Owned(Box::new(Value::String(to_text(&a[0])))),
            F::Bool => match (&a[0], a[0].text()) {
                (Val::Bool(b), _) => Val::Bool(*b),
                (_, Some("true")) => Val::Bool(true),
                (_, Some("false")) => Val::Bool(false),
                _ => return Err(format!("{} is neither true nor false", a[0].describe())),
            },
            F::Contains => Val::Bool(text(0)?.contains(text(1)?)),
            F::StartsWith => Val::Bool(text(0)?.starts_with(text(1)?)),
            F::EndsWith => Val::Bool(text(0)?.ends_with(text(1)?)),
            F::Motion => reference("Motion", text(0)?),
            F::Object => reference("Object", text(0)?),
        })
    }
}

fn same_number(arguments: &[Type]) -> Type {
    let numbers = arguments.iter().map(|t| if let Type::List(element) = t { element } else { t });
    let mut result = Type::Int;
    for ty in numbers {
        result = match (&result, ty) {
            (_, &Type::Any) => return Type::Any,
            (Type::Float(Some(u)), _) | (_, Type::Float(Some(u))) => Type::Float(Some(*u)),
            (Type::Int, Type::Int) => Type::Int,
            _ => Type::FLOAT,
        };
    }
    result
}

fn clamp<'v>(a: &[Val<'v>], x: f64, low: f64, high: f64) -> Result<Val<'v>, String> {
    if low > high || low.is_nan() || high.is_nan() {
        return Err(format!("the bounds {low} and {high} are not in order"));
    }
    if let (Val::Int(x), Val::Int(low), Val::Int(high)) = (&a[0], &a[1], &a[2]) {
        return Ok(Val::Int(*x.clamp(low, high)));
    }
    Ok(Val::Float(x.clamp(low, high)))
}

fn reference<'v>(kind: &str, id: &str) -> Val<'v> {
    Val::Owned(Box::new(Value::Reference(crate::Reference { kind: kind.into(), id: id.into() })))
}

fn vector(value: &Val<'_>) -> Result<Vec<f64>, String> {
    let wrong = || format!("expected a vector or a list of numbers, found {}", value.describe());
    match value.as_value() {
        Some(Value::Vector(v)) => Ok(v.components.to_vec()),
        Some(Value::List(items)) => items.iter().map(Value::as_f64).collect::<Option<_>>().ok_or_else(wrong),
        _ => Err(wrong()),
    }
}

fn extreme<'v>(a: &[Val<'v>], better: impl Fn(f64, f64) -> bool) -> Result<Val<'v>, String> {
    let listed: Vec<Val<'_>>;
    let items: &[Val<'_>] = match (a, a[0].as_value()) {
        ([_], Some(Value::List(items))) => {
            listed = items.iter().map(Val::of).collect();
            &listed
        }
        _ => a,
    };
    let mut best: Option<(f64, &Val<'_>)> = None;
    for item in items {
        let x = item.number().ok_or_else(|| format!("expected a number, found {}", item.describe()))?;
        if x.is_nan() {
            return Ok(Val::Float(f64::NAN));
        }
        if best.as_ref().is_none_or(|(b, _)| better(x, *b)) {
            best = Some((x, item));
        }
    }
    match best {
        Some((_, Val::Int(i))) => Ok(Val::Int(*i)),
        Some((x, _)) => Ok(Val::Float(x)),
        None => Err("an empty list has no least or greatest item".into()),
    }
}

fn size(value: &Val<'_>) -> Result<usize, String> {
    match (value.text(), value.as_value()) {
        (Some(s), _) => Ok(s.chars().count()),
        (_, Some(Value::List(items))) => Ok(items.len()),
        (_, Some(Value::Map(fields))) => Ok(fields.len()),
        (_, Some(Value::Bytes(bytes))) => Ok(bytes.len()),
        _ => Err(format!("{} has no size", value.describe())),
    }
}

fn to_int(value: &Val<'_>) -> Result<i64, String> {
    let wrong = || format!("{} is not a whole number in range", value.describe());
    match (value, value.text()) {
        (Val::Int(i), _) => Ok(*i),
        (Val::Bool(b), _) => Ok(i64::from(*b)),
        (_, Some(s)) => s.trim().parse().map_err(|_| wrong()),
        _ => {
            let f = value.number().ok_or_else(wrong)?.trunc();
            if f.abs() < 9.2e18 { Ok(f as i64) } else { Err(wrong()) }
        }
    }
}

fn to_float(value: &Val<'_>) -> Result<f64, String> {
    let wrong = || format!("{} is not a number", value.describe());
    match value.text() {
        Some(s) => s.trim().parse().map_err(|_| wrong()),
        None => value.number().ok_or_else(wrong),
    }
}

/// The value as text for people; maps and lists as JSON.
pub(super) fn to_text(value: &Val<'_>) -> String {
    match value {
        Val::Null => "null".into(),
        Val::Bool(b) => b.to_string(),
        Val::Int(i) => i.to_string(),
        Val::Float(f) => f.to_string(),
        Val::Str(s) => (*s).to_owned(),
        Val::Ref(Value::String(s)) => s.clone(),
        Val::Ref(v) => v.to_json().to_string(),
        Val::Owned(v) => match &**v {
            Value::String(s) => s.clone(),
            v => v.to_json().to_string(),
        },
    }
}

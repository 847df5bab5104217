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

/// Name, function, fewest and most arguments, how it is written, and what it gives.
type Row = (&'static str, Function, usize, usize, &'static str, &'static str);

pub(super) const TABLE: &[Row] = &[
    ("norm", F::Norm, 1, 1, "norm(v)", "The length of a vector or a list of numbers, in their unit."),
    ("dot", F::Dot, 2, 2, "dot(a, b)", "The scalar product of two vectors of the same length."),
    ("abs", F::Abs, 1, 1, "abs(x)", "The number without its sign."),
    ("min", F::Min, 1, 8, "min(a, b, ...)", "The least of up to 8 numbers, or of a list."),
    ("max", F::Max, 1, 8, "max(a, b, ...)", "The greatest of up to 8 numbers, or of a list."),
    ("sqrt", F::Sqrt, 1, 1, "sqrt(x)", "The square root."),
    ("sin", F::Sin, 1, 1, "sin(x)", "The sine; x in rad."),
    ("cos", F::Cos, 1, 1, "cos(x)", "The cosine; x in rad."),
    ("tan", F::Tan, 1, 1, "tan(x)", "The tangent; x in rad."),
    ("asin", F::Asin, 1, 1, "asin(x)", "The arc sine, rad."),
    ("acos", F::Acos, 1, 1, "acos(x)", "The arc cosine, rad."),
    ("atan2", F::Atan2, 2, 2, "atan2(y, x)", "The angle of the point (x, y), rad."),
    ("exp", F::Exp, 1, 1, "exp(x)", "e to the power x."),
    ("ln", F::Ln, 1, 1, "ln(x)", "The natural logarithm."),
    ("pow", F::Pow, 2, 2, "pow(x, y)", "x to the power y."),
    ("floor", F::Floor, 1, 1, "floor(x)", "The next whole number below."),
    ("ceil", F::Ceil, 1, 1, "ceil(x)", "The next whole number above."),
    ("round", F::Round, 1, 1, "round(x)", "The nearest whole number."),
    ("clamp", F::Clamp, 3, 3, "clamp(x, low, high)", "x, but not below `low` and not above `high`."),
    ("is_nan", F::IsNan, 1, 1, "is_nan(x)", "Whether it is not a number."),
    ("size", F::Size, 1, 1, "size(x)", "How many items a list or map, or characters a text has."),
    ("int", F::Int, 1, 1, "int(x)", "As a whole number; what follows the point is cut off."),
    ("float", F::Float, 1, 1, "float(x)", "As a number."),
    ("double", F::Float, 1, 1, "double(x)", "As a number; the same as `float`."),
    ("string", F::Text, 1, 1, "string(x)", "As text."),
    ("bool", F::Bool, 1, 1, "bool(x)", "As true or false."),
    ("contains", F::Contains, 2, 2, "contains(text, part)", "Whether a text has another one in it."),
    ("startsWith", F::StartsWith, 2, 2, "startsWith(text, part)", "Whether a text begins with another one."),
    ("endsWith", F::EndsWith, 2, 2, "endsWith(text, part)", "Whether a text ends with another one."),
    ("Motion", F::Motion, 1, 1, "Motion(name)", "The motion of that name in memory."),
    ("Object", F::Object, 1, 1, "Object(name)", "The object of that name in memory."),
];

/// The function that other languages call `name`.
pub(super) fn foreign_function(name: &str) -> Option<&'static str> {
    match name {
        "len" | "length" | "count" => Some("size"),
        "fabs" => Some("abs"),
        "log" => Some("ln"),
        "str" => Some("string"),
        "isnan" | "isNaN" => Some("is_nan"),
        "arcsin" => Some("asin"),
        "arccos" => Some("acos"),
        "In" | "in_state" => Some("active"),
        _ => None,
    }
}

/// What functions besides those of the table look like: they take names, not values, or are written behind a list.
const OTHERS: [(&str, &str, &str); 8] = [
    ("age", "age('channel')", "How long ago a channel was published, s."),
    ("active", "active('State')", "Whether a state is active."),
    ("has", "has(a.b)", "Whether a map has a field."),
    ("all", "list.all(x, condition)", "Whether the condition holds for all items."),
    ("exists", "list.exists(x, condition)", "Whether it holds for one item at least."),
    ("exists_one", "list.exists_one(x, condition)", "Whether it holds for exactly one item."),
    ("filter", "list.filter(x, condition)", "The items for which it holds."),
    ("map", "list.map(x, value)", "A value for each item."),
];

/// A function as people see it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Signature {
    /// Its name.
    pub name: &'static str,
    /// How it is written, with its arguments.
    pub form: &'static str,
    /// What it gives, one sentence.
    pub doc: &'static str,
}

/// The functions that expressions may call.
pub fn functions() -> impl Iterator<Item = Signature> {
    let table = TABLE.iter().map(|(name, .., form, doc)| (*name, *form, *doc));
    table.chain(OTHERS).map(|(name, form, doc)| Signature { name, form, doc })
}

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

/// Why a function refuses its arguments.
#[derive(Debug, thiserror::Error)]
pub(super) enum ArgumentError {
    #[error("expected {expected}, found {found}")]
    Type { expected: &'static str, found: String },
    #[error("{found} {wrong}")]
    Value { found: String, wrong: &'static str },
    #[error("vectors of {0} and of {1} components")]
    Lengths(usize, usize),
    #[error("the bounds {0} and {1} are not in order")]
    Bounds(f64, f64),
    #[error("the number is out of range")]
    Range,
    #[error("an empty list has no least or greatest item")]
    Empty,
}

impl ArgumentError {
    fn expected(expected: &'static str, found: &Val<'_>) -> Self {
        Self::Type { expected, found: found.describe().to_string() }
    }

    fn value(found: &Val<'_>, wrong: &'static str) -> Self {
        Self::Value { found: found.describe().to_string(), wrong }
    }
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
    pub(super) fn call<'v>(self, a: &[Val<'v>]) -> Result<Val<'v>, ArgumentError> {
        let number = |i: usize| a[i].number().ok_or_else(|| ArgumentError::expected("a number", &a[i]));
        let text = |i: usize| a[i].text().ok_or_else(|| ArgumentError::expected("a string", &a[i]));
        Ok(match self {
            F::Norm => Val::Float(vector(&a[0])?.iter().map(|x| x * x).sum::<f64>().sqrt()),
            F::Dot => {
                let (x, y) = (vector(&a[0])?, vector(&a[1])?);
                if x.len() != y.len() {
                    return Err(ArgumentError::Lengths(x.len(), y.len()));
                }
                Val::Float(x.iter().zip(&y).map(|(x, y)| x * y).sum())
            }
            F::Abs => match &a[0] {
                Val::Int(i) => Val::Int(i.checked_abs().ok_or(ArgumentError::Range)?),
                _ => Val::Float(number(0)?.abs()),
            },
            F::Min => extreme(a, |x, best| x < best)?,
            F::Max => extreme(a, |x, best| x > best)?,
            F::Sqrt => Val::Float(number(0)?.sqrt()),
            F::Sin => Val::Float(libm::sin(number(0)?)),
            F::Cos => Val::Float(libm::cos(number(0)?)),
            F::Tan => Val::Float(libm::tan(number(0)?)),
            F::Asin => Val::Float(libm::asin(number(0)?)),
            F::Acos => Val::Float(libm::acos(number(0)?)),
            F::Atan2 => Val::Float(libm::atan2(number(0)?, number(1)?)),
            F::Exp => Val::Float(libm::exp(number(0)?)),
            F::Ln => Val::Float(libm::log(number(0)?)),
            F::Pow => Val::Float(libm::pow(number(0)?, number(1)?)),
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
                _ => return Err(ArgumentError::value(&a[0], "is neither true nor false")),
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

fn clamp<'v>(a: &[Val<'v>], x: f64, low: f64, high: f64) -> Result<Val<'v>, ArgumentError> {
    if low > high || low.is_nan() || high.is_nan() {
        return Err(ArgumentError::Bounds(low, high));
    }
    if let (Val::Int(x), Val::Int(low), Val::Int(high)) = (&a[0], &a[1], &a[2]) {
        return Ok(Val::Int(*x.clamp(low, high)));
    }
    Ok(Val::Float(x.clamp(low, high)))
}

fn reference<'v>(kind: &str, id: &str) -> Val<'v> {
    Val::Owned(Box::new(Value::Reference(crate::Reference { kind: kind.into(), id: id.into() })))
}

fn vector(value: &Val<'_>) -> Result<Vec<f64>, ArgumentError> {
    let wrong = || ArgumentError::expected("a vector or a list of numbers", value);
    match value.as_value() {
        Some(Value::Vector(v)) => Ok(v.components.to_vec()),
        Some(Value::List(items)) => items.iter().map(Value::as_f64).collect::<Option<_>>().ok_or_else(wrong),
        _ => Err(wrong()),
    }
}

fn extreme<'v>(a: &[Val<'v>], better: impl Fn(f64, f64) -> bool) -> Result<Val<'v>, ArgumentError> {
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
        let x = item.number().ok_or_else(|| ArgumentError::expected("a number", item))?;
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
        None => Err(ArgumentError::Empty),
    }
}

fn size(value: &Val<'_>) -> Result<usize, ArgumentError> {
    match (value.text(), value.as_value()) {
        (Some(s), _) => Ok(s.chars().count()),
        (_, Some(Value::List(items))) => Ok(items.len()),
        (_, Some(Value::Map(fields))) => Ok(fields.len()),
        (_, Some(Value::Bytes(bytes))) => Ok(bytes.len()),
        _ => Err(ArgumentError::value(value, "has no size")),
    }
}

fn to_int(value: &Val<'_>) -> Result<i64, ArgumentError> {
    let wrong = || ArgumentError::value(value, "is not a whole number in range");
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

fn to_float(value: &Val<'_>) -> Result<f64, ArgumentError> {
    let wrong = || ArgumentError::value(value, "is not a number");
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

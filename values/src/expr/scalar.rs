//! The fast path of evaluation: numbers and bools in registers, without allocation. Where it gives no value
//! (another type, an error, a channel), the evaluation in `eval` gives the result or the error.

use super::eval::{EvalContext, ExprNode};
use super::functions::Function as F;
use super::operate::{Arithmetic, Comparison};
use crate::Value;

/// A value that fits into registers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Scalar {
    Bool(bool),
    Int(i64),
    Float(f64),
}

use Scalar::{Bool, Float, Int};

impl Scalar {
    fn number(self) -> Option<f64> {
        match self {
            Int(i) => Some(i as f64),
            Float(f) => Some(f),
            Bool(_) => None,
        }
    }

    fn truth(self) -> Option<bool> {
        if let Bool(b) = self { Some(b) } else { None }
    }
}

/// The value, if the fast path can compute it.
pub(super) fn scalar<C: EvalContext + ?Sized>(node: &ExprNode, context: &C) -> Option<Scalar> {
    Some(match node {
        ExprNode::Bool(b) => Bool(*b),
        ExprNode::Int(i) => Int(*i),
        ExprNode::Float(f) => Float(*f),
        ExprNode::Data(slot, _) => match context.data(*slot)? {
            Value::Bool(b) => Bool(*b),
            Value::Int(i) => Int(*i),
            Value::Float(f) | Value::Duration(f) => Float(*f),
            _ => return None,
        },
        ExprNode::Active(state) => Bool(context.active(*state)),
        ExprNode::Age(channel, _) => Float(context.age(*channel)?),
        ExprNode::Not(of, _) => Bool(!scalar(of, context)?.truth()?),
        ExprNode::Negate(of, _) => match scalar(of, context)? {
            Int(i) => Int(i.checked_neg()?),
            Float(f) => Float(-f),
            Bool(_) => return None,
        },
        ExprNode::And(pair, _) => {
            Bool(scalar(&pair.0, context)?.truth()? && scalar(&pair.1, context)?.truth()?)
        }
        ExprNode::Or(pair, _) => {
            Bool(scalar(&pair.0, context)?.truth()? || scalar(&pair.1, context)?.truth()?)
        }
        ExprNode::Choose(of, _) => {
            let chosen = if scalar(&of.0, context)?.truth()? { &of.1 } else { &of.2 };
            return scalar(chosen, context);
        }
        ExprNode::Compare(op, pair, _) => Bool(compare(*op, &pair.0, &pair.1, context)?),
        ExprNode::Arithmetic(op, pair, _) => {
            arithmetic(*op, scalar(&pair.0, context)?, scalar(&pair.1, context)?)?
        }
        ExprNode::Call(function, arguments, _) => return call(*function, arguments, context),
        _ => return None,
    })
}

fn text<'v, C: EvalContext + ?Sized>(node: &'v ExprNode, context: &'v C) -> Option<&'v str> {
    match node {
        ExprNode::Text(s) => Some(s),
        ExprNode::EventName => Some(context.event_name().unwrap_or("")),
        ExprNode::Data(slot, _) => context.data(*slot)?.as_str(),
        _ => None,
    }
}

fn compare<C: EvalContext + ?Sized>(op: Comparison, a: &ExprNode, b: &ExprNode, context: &C) -> Option<bool> {
    let order = if let (Some(a), Some(b)) = (text(a, context), text(b, context)) {
        Some(a.cmp(b))
    } else {
        match (scalar(a, context)?, scalar(b, context)?) {
            (Int(a), Int(b)) => Some(a.cmp(&b)),
            (Bool(a), Bool(b)) => Some(a.cmp(&b)),
            (a, b) => a.number()?.partial_cmp(&b.number()?),
        }
    };
    Some(op.holds(order))
}

fn arithmetic(op: Arithmetic, a: Scalar, b: Scalar) -> Option<Scalar> {
    use Arithmetic as A;
    Some(match (a, b) {
        (Int(a), Int(b)) => Int(match op {
            A::Add => a.checked_add(b)?,
            A::Subtract => a.checked_sub(b)?,
            A::Multiply => a.checked_mul(b)?,
            A::Divide => a.checked_div(b)?,
            A::Remainder => a.checked_rem(b)?,
        }),
        (a, b) => {
            let (a, b) = (a.number()?, b.number()?);
            Float(match op {
                A::Add => a + b,
                A::Subtract => a - b,
                A::Multiply => a * b,
                A::Divide => a / b,
                A::Remainder => a % b,
            })
        }
    })
}

fn call<C: EvalContext + ?Sized>(function: F, arguments: &[ExprNode], context: &C) -> Option<Scalar> {
    let [of] = arguments else { return None };
    let of = scalar(of, context)?;
    if let (F::Abs, Int(i)) = (function, of) {
        return Some(Int(i.checked_abs()?));
    }
    let x = of.number()?;
    Some(Float(match function {
        F::Abs => x.abs(),
        F::Sqrt => x.sqrt(),
        F::Sin => libm::sin(x),
        F::Cos => libm::cos(x),
        F::Tan => libm::tan(x),
        F::Exp => libm::exp(x),
        F::Ln => libm::log(x),
        F::Floor => x.floor(),
        F::Ceil => x.ceil(),
        F::Round => x.round(),
        _ => return None,
    }))
}

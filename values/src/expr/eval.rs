//! The tree of a checked expression, and its evaluation. Scalars are computed without allocation.

use std::cell::Cell;
use std::collections::BTreeMap;

use super::functions::Function;
use super::operate::{Arithmetic, Comparison, arithmetic, compare, contains, field, has_nan, index, negate};
use super::{MAX_ITEMS, MAX_PARTS};
use crate::Value;
use crate::value::text_parts;

/// Supplies the values of names during an evaluation; what a context does not supply has no value.
pub trait EvalContext {
    /// The value in a numbered slot; `None` when it has none yet.
    fn data(&self, _slot: u32) -> Option<&Value> {
        None
    }
    /// The newest value of a channel, or of its field `path`; `None` when the channel was never published or lacks
    /// the field.
    fn channel(&self, _channel: u32, _path: &[String]) -> Option<Value> {
        None
    }
    /// Seconds since a channel was published; `None` when it never was.
    fn age(&self, _channel: u32) -> Option<f64> {
        None
    }
    /// The name of the event that is being processed.
    fn event_name(&self) -> Option<&str> {
        None
    }
    /// The data of the event that is being processed.
    fn event_data(&self) -> Option<&Value> {
        None
    }
    /// Whether a state is active.
    fn active(&self, _state: u32) -> bool {
        false
    }
}

/// Why an evaluation failed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{message}")]
pub struct EvalError {
    /// What happened, one sentence.
    pub message: String,
    /// Start in the source, bytes.
    pub start: usize,
    /// End in the source, bytes, exclusive.
    pub end: usize,
    /// Whether the cause is a channel without a value or a number that is NaN.
    pub absent: bool,
    /// Whether the cause is a number that is NaN.
    pub nan: bool,
    /// Whether the evaluation ended because it exceeds a limit.
    pub limit: bool,
}

/// A range in the source, bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Pos {
    pub(super) start: u16,
    pub(super) end: u16,
}

impl Pos {
    pub(super) fn error(self, message: impl Into<String>) -> EvalError {
        let (start, end) = (usize::from(self.start), usize::from(self.end));
        EvalError { message: message.into(), start, end, absent: false, nan: false, limit: false }
    }

    /// An error because a limit is exceeded.
    pub(super) fn over_limit(self, message: impl Into<String>) -> EvalError {
        EvalError { limit: true, ..self.error(message) }
    }

    fn absent(self, message: impl Into<String>) -> EvalError {
        EvalError { absent: true, ..self.error(message) }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Macro {
    All,
    Exists,
    ExistsOne,
    Filter,
    Map,
}

/// A node of the tree.
#[derive(Clone, Debug)]
pub(super) enum ExprNode {
    Null,
    Bool(bool),
    Int(i64),
    Float(f64),
    Text(String),
    Data(u32, Pos),
    Channel(u32, Vec<String>, Pos),
    EventName,
    EventData,
    /// A comprehension's variable, counted from the innermost.
    Bound(usize),
    Age(u32, Pos),
    Active(u32),
    Field(Box<ExprNode>, String, Pos),
    Has(Box<ExprNode>, String),
    Index(Box<(ExprNode, ExprNode)>, Pos),
    Not(Box<ExprNode>, Pos),
    Negate(Box<ExprNode>, Pos),
    And(Box<(ExprNode, ExprNode)>, Pos),
    Or(Box<(ExprNode, ExprNode)>, Pos),
    Choose(Box<(ExprNode, ExprNode, ExprNode)>, Pos),
    Compare(Comparison, Box<(ExprNode, ExprNode)>, Pos),
    Arithmetic(Arithmetic, Box<(ExprNode, ExprNode)>, Pos),
    In(Box<(ExprNode, ExprNode)>, Pos),
    Call(Function, Vec<ExprNode>, Pos),
    List(Vec<ExprNode>),
    Record(Vec<(ExprNode, ExprNode)>, Pos),
    Macro(Macro, Box<(ExprNode, ExprNode)>, Pos),
}

impl ExprNode {
    /// See [`Expr::wanted_text`](super::Expr::wanted_text).
    pub(super) fn wanted_text(&self, slot: u32) -> Option<&str> {
        match self {
            Self::And(both, _) => both.0.wanted_text(slot).or_else(|| both.1.wanted_text(slot)),
            Self::Compare(Comparison::Equal, both, _) => match &**both {
                (Self::Data(read, _), Self::Text(text)) | (Self::Text(text), Self::Data(read, _))
                    if *read == slot =>
                {
                    Some(text)
                }
                _ => None,
            },
            _ => None,
        }
    }
}

/// An intermediate value: scalars by copy, others borrowed where possible.
#[derive(Clone, Debug)]
pub(super) enum Val<'v> {
    Null,
    Bool(bool),
    Int(i64),
    Float(f64),
    Str(&'v str),
    Ref(&'v Value),
    Owned(Box<Value>),
}

impl<'v> Val<'v> {
    pub(super) fn of(value: &'v Value) -> Self {
        match value {
            Value::Null => Self::Null,
            Value::Bool(b) => Self::Bool(*b),
            Value::Int(i) => Self::Int(*i),
            Value::Float(f) | Value::Duration(f) => Self::Float(*f),
            Value::String(s) => Self::Str(s),
            other => Self::Ref(other),
        }
    }

    pub(super) fn own(value: Value) -> Self {
        match value {
            Value::Null => Self::Null,
            Value::Bool(b) => Self::Bool(b),
            Value::Int(i) => Self::Int(i),
            Value::Float(f) | Value::Duration(f) => Self::Float(f),
            other => Self::Owned(Box::new(other)),
        }
    }

    fn into_value(self) -> Value {
        match self {
            Self::Null => Value::Null,
            Self::Bool(b) => Value::Bool(b),
            Self::Int(i) => Value::Int(i),
            Self::Float(f) => Value::Float(f),
            Self::Str(s) => Value::String(s.to_owned()),
            Self::Ref(v) => v.clone(),
            Self::Owned(v) => *v,
        }
    }

    pub(super) fn number(&self) -> Option<f64> {
        match self {
            Self::Int(i) => Some(*i as f64),
            Self::Float(f) => Some(*f),
            _ => None,
        }
    }

    pub(super) fn text(&self) -> Option<&str> {
        match self {
            Self::Str(s) => Some(s),
            _ => self.as_value().and_then(Value::as_str),
        }
    }

    /// The value, unless it is a scalar.
    pub(super) fn as_value(&self) -> Option<&Value> {
        match self {
            Self::Ref(v) => Some(v),
            Self::Owned(v) => Some(v),
            _ => None,
        }
    }

    pub(super) fn describe(&self) -> String {
        self.clone().into_value().describe()
    }
}

/// Comprehension variables, innermost first.
struct BoundVariables<'v> {
    value: &'v Value,
    outer: Option<&'v BoundVariables<'v>>,
}

struct Evaluation<'v, C: ?Sized> {
    context: &'v C,
    /// A NaN from a channel counts as absent.
    observing: bool,
    items: Cell<u32>,
    /// Parts of the lists and maps built so far.
    parts: Cell<usize>,
}

type Result<T> = std::result::Result<T, EvalError>;

pub(super) fn evaluate<C: EvalContext + ?Sized>(node: &ExprNode, context: &C) -> Result<Value> {
    Evaluation::new(context, false).value(node, None).map(Val::into_value)
}

pub(super) fn test<C: EvalContext + ?Sized>(node: &ExprNode, context: &C, observing: bool) -> Result<bool> {
    Evaluation::new(context, observing).truth(node, None, Pos::default())
}

impl<'v, C: EvalContext + ?Sized> Evaluation<'v, C> {
    fn new(context: &'v C, observing: bool) -> Self {
        Self { context, observing, items: Cell::new(0), parts: Cell::new(0) }
    }
}

impl<C: EvalContext + ?Sized> Evaluation<'_, C> {
    /// Counts and converts a value that becomes part of a larger one.
    fn part(&self, value: Val<'_>, pos: Pos) -> Result<Value> {
        let parts = match &value {
            Val::Ref(value) => value.parts(),
            Val::Owned(value) => value.parts(),
            Val::Str(text) => text_parts(text),
            _ => 1,
        };
        self.parts.set(self.parts.get().saturating_add(parts));
        if self.parts.get() > MAX_PARTS {
            return Err(pos.over_limit(format!("this makes a value of more than {MAX_PARTS} parts")));
        }
        Ok(value.into_value())
    }

    fn truth(&self, node: &ExprNode, frame: Option<&BoundVariables<'_>>, pos: Pos) -> Result<bool> {
        match self.value(node, frame)? {
            Val::Bool(b) => Ok(b),
            other => Err(pos.error(format!("expected a bool, found {}", other.describe()))),
        }
    }

    fn value<'v>(&'v self, node: &'v ExprNode, frame: Option<&'v BoundVariables<'v>>) -> Result<Val<'v>> {
        match node {
            ExprNode::Null => Ok(Val::Null),
            ExprNode::Bool(b) => Ok(Val::Bool(*b)),
            ExprNode::Int(i) => Ok(Val::Int(*i)),
            ExprNode::Float(f) => Ok(Val::Float(*f)),
            ExprNode::Text(s) => Ok(Val::Str(s)),
            ExprNode::Data(slot, pos) => {
                self.context.data(*slot).map(Val::of).ok_or_else(|| pos.error("this has no value yet"))
            }
            ExprNode::Channel(channel, path, pos) => self.channel(*channel, path, *pos),
            ExprNode::EventName => Ok(self.context.event_name().map_or(Val::Str(""), Val::Str)),
            ExprNode::EventData => Ok(self.context.event_data().map_or(Val::Null, Val::of)),
            ExprNode::Bound(depth) => Ok(bound(frame, *depth)),
            ExprNode::Age(channel, pos) => {
                let age = self.context.age(*channel).map(Val::Float);
                age.ok_or_else(|| pos.absent("nothing has been published here yet"))
            }
            ExprNode::Active(state) => Ok(Val::Bool(self.context.active(*state))),
            ExprNode::Field(of, name, pos) => field(self.value(of, frame)?, name, *pos),
            ExprNode::Has(of, name) => Ok(Val::Bool(match self.value(of, frame) {
                Ok(value) => field(value, name, Pos::default()).is_ok(),
                Err(_) => false,
            })),
            ExprNode::Index(pair, pos) => {
                index(self.value(&pair.0, frame)?, &self.value(&pair.1, frame)?, *pos)
            }
            ExprNode::Not(of, pos) => Ok(Val::Bool(!self.truth(of, frame, *pos)?)),
            ExprNode::Negate(of, pos) => negate(&self.value(of, frame)?, *pos),
            ExprNode::And(pair, pos) => {
                Ok(Val::Bool(self.truth(&pair.0, frame, *pos)? && self.truth(&pair.1, frame, *pos)?))
            }
            ExprNode::Or(pair, pos) => {
                Ok(Val::Bool(self.truth(&pair.0, frame, *pos)? || self.truth(&pair.1, frame, *pos)?))
            }
            ExprNode::Choose(of, pos) => {
                let chosen = if self.truth(&of.0, frame, *pos)? { &of.1 } else { &of.2 };
                self.value(chosen, frame)
            }
            ExprNode::Compare(op, pair, pos) => {
                let (a, b) = (self.value(&pair.0, frame)?, self.value(&pair.1, frame)?);
                compare(*op, &a, &b, *pos).map(Val::Bool)
            }
            ExprNode::Arithmetic(op, pair, pos) => {
                let (a, b) = (self.value(&pair.0, frame)?, self.value(&pair.1, frame)?);
                arithmetic(*op, a, b, *pos)
            }
            ExprNode::In(pair, pos) => {
                let (a, b) = (self.value(&pair.0, frame)?, self.value(&pair.1, frame)?);
                contains(&a, &b, *pos).map(Val::Bool)
            }
            ExprNode::Call(function, arguments, pos) => {
                let values = arguments.iter().map(|a| self.value(a, frame)).collect::<Result<Vec<_>>>()?;
                function.call(&values).map_err(|error| pos.error(error.to_string()))
            }
            ExprNode::List(items) => {
                let part = |n| self.part(self.value(n, frame)?, Pos::default());
                let values = items.iter().map(part);
                Ok(Val::own(Value::List(values.collect::<Result<_>>()?)))
            }
            ExprNode::Record(entries, pos) => self.record(entries, frame, *pos),
            ExprNode::Macro(kind, parts, pos) => self.comprehend(*kind, &parts.0, &parts.1, frame, *pos),
        }
    }

    fn channel<'v>(&'v self, channel: u32, path: &[String], pos: Pos) -> Result<Val<'v>> {
        let Some(value) = self.context.channel(channel, path) else {
            return Err(pos.absent("nothing has been published here yet"));
        };
        if self.observing && has_nan(&value) {
            return Err(EvalError { nan: true, ..pos.absent("the published number is NaN") });
        }
        Ok(Val::own(value))
    }

    fn record<'v>(
        &'v self,
        entries: &'v [(ExprNode, ExprNode)],
        frame: Option<&'v BoundVariables<'v>>,
        pos: Pos,
    ) -> Result<Val<'v>> {
        let mut fields = BTreeMap::new();
        for (key, value) in entries {
            let key = self.value(key, frame)?;
            let Some(name) = key.text() else {
                return Err(pos.error(format!("the keys of a map are strings, found {}", key.describe())));
            };
            let value = self.part(self.value(value, frame)?, pos)?;
            if fields.insert(name.to_owned(), value).is_some() {
                return Err(pos.error(format!("the key `{name}` is there twice")));
            }
        }
        Ok(Val::own(Value::Map(fields)))
    }

    fn comprehend<'v>(
        &'v self,
        kind: Macro,
        range: &'v ExprNode,
        body: &'v ExprNode,
        frame: Option<&'v BoundVariables<'v>>,
        pos: Pos,
    ) -> Result<Val<'v>> {
        let range = self.value(range, frame)?;
        let keys: Vec<Value>;
        let items: &[Value] = match range.as_value() {
            Some(Value::List(items)) => items,
            Some(Value::Map(fields)) => {
                keys = fields.keys().map(|k| Value::String(k.clone())).collect();
                &keys
            }
            _ => return Err(pos.error(format!("expected a list, found {}", range.describe()))),
        };
        let (mut found, mut kept) = (0_usize, Vec::new());
        for item in items {
            self.items.set(self.items.get() + 1);
            if self.items.get() > MAX_ITEMS {
                return Err(pos.over_limit(format!("more than {MAX_ITEMS} items were visited")));
            }
            let inner = BoundVariables { value: item, outer: frame };
            if kind == Macro::Map {
                kept.push(self.part(self.value(body, Some(&inner))?, pos)?);
                continue;
            }
            let holds = self.truth(body, Some(&inner), pos)?;
            found += usize::from(holds);
            match kind {
                Macro::All if !holds => return Ok(Val::Bool(false)),
                Macro::Exists if holds => return Ok(Val::Bool(true)),
                Macro::Filter if holds => kept.push(self.part(Val::of(item), pos)?),
                _ => {}
            }
        }
        Ok(match kind {
            Macro::All => Val::Bool(true),
            Macro::Exists => Val::Bool(false),
            Macro::ExistsOne => Val::Bool(found == 1),
            Macro::Filter | Macro::Map => Val::own(Value::List(kept)),
        })
    }
}

fn bound<'v>(mut frame: Option<&'v BoundVariables<'v>>, depth: usize) -> Val<'v> {
    for _ in 0..depth {
        frame = frame.and_then(|f| f.outer);
    }
    frame.map_or(Val::Null, |f| Val::of(f.value))
}

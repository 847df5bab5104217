//! Expressions: CEL text, checked against declared types at load time and compiled to a compact tree, which is
//! evaluated.
//!
//! The crate `cel` only parses. An [`Environment`] resolves names once, at load time; an [`EvalContext`] supplies their
//! values at each evaluation. Inside expressions durations are seconds, and integers are promoted to floats where
//! needed. This module knows states and channels by their numbers only, and no files.

mod check;
mod check_operators;
mod eval;
mod functions;
mod operate;
mod parsed;
mod scalar;
mod syntax;
mod template;
mod typing;

pub use eval::{EvalContext, EvalError};
pub use functions::{Signature, functions};
pub use template::{Piece, TemplateError, split};

use crate::Value;
use crate::types::Type;
use scalar::Scalar;

/// Longest expression that is parsed, bytes: it bounds the stack use of the external parser.
pub const MAX_SOURCE: usize = 4096;
/// Most list items that all comprehensions of one evaluation visit together.
pub const MAX_ITEMS: u32 = 10_000;
/// Most parts ([`Value::parts`]) of all values that one evaluation builds.
pub const MAX_PARTS: usize = 100_000;
/// Longest text that an evaluation builds, bytes.
pub const MAX_TEXT: usize = 1_000_000;

/// Where a name's value is found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Slot {
    /// A numbered slot for inputs, locals, outputs.
    Data(u32),
    /// The newest value of a channel.
    Channel(u32),
    /// The name of the event that is being processed.
    EventName,
    /// The data of the event that is being processed.
    EventData,
}

/// A resolved dotted name.
#[derive(Clone, Debug, PartialEq)]
pub struct Variable {
    /// Where its value is.
    pub slot: Slot,
    /// Its declared type.
    pub ty: Type,
    /// How many parts of the dotted name are the variable; the rest are fields of its value.
    pub used: usize,
}

/// The kind of name that was looked up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unknown {
    /// A variable, or a field of it.
    Name,
    /// A channel.
    Channel,
    /// A state.
    State,
}

/// A name that cannot be resolved.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Unresolved {
    /// The kind of name that was looked up.
    pub kind: Unknown,
    /// The problem, one sentence.
    pub message: String,
    /// How to fix it.
    pub help: Option<String>,
    /// What may be meant: text for the parts of the name that it replaces.
    pub near: Option<String>,
}

impl Unresolved {
    /// A name that stands for nothing. What may be meant is proposed; otherwise `help` is the help.
    #[must_use]
    pub fn new(kind: Unknown, message: String, near: Option<String>, help: Option<String>) -> Self {
        let help = near.as_ref().map(|near| format!("did you mean `{near}`?")).or(help);
        Self { kind, message, help, near }
    }
}

/// A name of an expression that was resolved. Places are bytes of the expression, the second exclusive.
#[derive(Clone, Copy, Debug)]
#[allow(missing_docs, reason = "the names of the fields say what they are")]
pub enum Found<'a> {
    /// A dotted name, the first parts of which are a variable; each part has a place.
    Variable { parts: &'a [&'a str], places: &'a [(usize, usize)], variable: &'a Variable },
    /// A channel whose name is given as text; its place is without the quotes.
    Channel { name: &'a str, place: (usize, usize) },
    /// A state whose path is given as text; its place is without the quotes.
    State { path: &'a str, place: (usize, usize) },
    /// A function.
    Function { name: &'a str, place: (usize, usize) },
}

/// Resolves the names in an expression.
pub trait Environment {
    /// The variable that the first parts of a dotted name denote.
    ///
    /// # Errors
    /// [`Unresolved`] when no such name is in scope.
    fn variable(&self, path: &[&str]) -> Result<Variable, Unresolved>;
    /// The number of a channel.
    ///
    /// # Errors
    /// [`Unresolved`] when there is no such channel.
    fn channel(&self, name: &str) -> Result<u32, Unresolved>;
    /// The number of a state, by its name or path.
    ///
    /// # Errors
    /// [`Unresolved`] when there is no such state.
    fn state(&self, path: &str) -> Result<u32, Unresolved>;
    /// Is told of every name that was resolved, for who asks what names stand for.
    fn found(&self, _name: Found<'_>) {}
}

/// The kind of an error in an expression.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExprErrorKind {
    /// It is not CEL.
    Syntax,
    /// It is longer or deeper than the limit.
    TooLarge,
    /// An unknown name.
    UnknownName,
    /// There is no such channel.
    UnknownChannel,
    /// There is no such state.
    UnknownState,
    /// No function has this name and number of arguments.
    UnknownFunction,
    /// A value of the wrong type.
    Type,
    /// A value in a unit of the wrong kind.
    Unit,
}

/// An error found at load time.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{message}")]
pub struct ExprError {
    /// The kind of error.
    pub kind: ExprErrorKind,
    /// The problem, one sentence.
    pub message: String,
    /// How to fix it.
    pub help: Option<String>,
    /// Start in the source, bytes.
    pub start: usize,
    /// End in the source, bytes, exclusive.
    pub end: usize,
    /// What may be meant: bytes of the source, the second exclusive, and the text for them.
    pub near: Option<(usize, usize, String)>,
}

/// What an expression reads; it says when a watch must be evaluated again.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Reads {
    /// Channels, each once, in order.
    pub channels: Vec<u32>,
    /// Whether it reads the age of a channel, so that its value changes with time alone.
    pub age: bool,
    /// Whether it reads data or states of the chart.
    pub data: bool,
    /// The numbered slots that it reads, each once, in order.
    pub slots: Vec<u32>,
    /// Whether it reads the event.
    pub event: bool,
}

/// What an expression sees that reads nothing.
struct Nothing;

impl EvalContext for Nothing {}

/// A checked expression, ready to be evaluated.
#[derive(Clone, Debug)]
pub struct Expr {
    source: String,
    ty: Type,
    reads: Reads,
    /// Whether the fast path may be able to evaluate it.
    quick: bool,
    root: eval::ExprNode,
}

impl Expr {
    /// Parses and checks `source`.
    ///
    /// # Errors
    /// [`ExprError`] with the place of the first error.
    pub fn compile(source: &str, environment: &dyn Environment) -> Result<Self, ExprError> {
        check::compile(source, environment)
    }

    /// The text that a slot has to be equal to for the expression to be true, where its form shows that: `slot == 'text'`, alone
    /// or joined to others by `&&`. An index can then find what to evaluate it for.
    pub fn wanted_text(&self, slot: u32) -> Option<&str> {
        self.root.wanted_text(slot)
    }

    /// The source text.
    pub fn source(&self) -> &str {
        &self.source
    }

    /// The type of its value.
    pub fn ty(&self) -> &Type {
        &self.ty
    }

    /// The numbered slot that it reads, where it is a variable and nothing else.
    pub fn variable(&self) -> Option<u32> {
        match self.root {
            eval::ExprNode::Data(slot, _) => Some(slot),
            _ => None,
        }
    }

    /// Its value, where it reads nothing and can be evaluated.
    pub fn constant(&self) -> Option<Value> {
        (self.reads == Reads::default()).then(|| self.evaluate(&Nothing).ok()).flatten()
    }

    /// What it reads.
    pub fn reads(&self) -> &Reads {
        &self.reads
    }

    /// Evaluates the expression.
    ///
    /// # Errors
    /// [`EvalError`] with the place, for instance for a missing value or a division by zero.
    pub fn evaluate<C: EvalContext + ?Sized>(&self, context: &C) -> Result<Value, EvalError> {
        if self.quick {
            match scalar::scalar(&self.root, context) {
                Some(Scalar::Bool(b)) => return Ok(Value::Bool(b)),
                Some(Scalar::Int(i)) => return Ok(Value::Int(i)),
                Some(Scalar::Float(f)) => return Ok(Value::Float(f)),
                None => {}
            }
        }
        self.interpret(context)
    }

    /// As [`evaluate`](Self::evaluate), without the fast path: the reference for its tests.
    ///
    /// # Errors
    /// [`EvalError`] with the place.
    pub fn interpret<C: EvalContext + ?Sized>(&self, context: &C) -> Result<Value, EvalError> {
        eval::evaluate(&self.root, context)
    }

    /// Evaluates a condition; a value that is not a bool is an error.
    ///
    /// # Errors
    /// [`EvalError`] with the place.
    pub fn test<C: EvalContext + ?Sized>(&self, context: &C) -> Result<bool, EvalError> {
        if self.quick
            && let Some(Scalar::Bool(b)) = scalar::scalar(&self.root, context)
        {
            return Ok(b);
        }
        eval::test(&self.root, context, false)
    }

    /// Evaluates a condition; a channel that was never published, or a NaN, makes it false.
    ///
    /// # Errors
    /// [`EvalError`] with the place, for every other failure.
    pub fn observe<C: EvalContext + ?Sized>(&self, context: &C) -> Result<bool, EvalError> {
        match self.look(context) {
            Err(error) if error.absent => Ok(false),
            other => other,
        }
    }

    /// Evaluates a condition, for an observer that needs the reason of a failure.
    ///
    /// # Errors
    /// [`EvalError`] with the place; `absent` when a channel was never published, and `nan` when its number is NaN.
    pub fn look<C: EvalContext + ?Sized>(&self, context: &C) -> Result<bool, EvalError> {
        eval::test(&self.root, context, true)
    }
}

/// The candidate most similar to a misspelt name, if one is similar enough.
pub fn nearest<'a>(name: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let limit = (name.chars().count() / 3).max(1);
    let short = |word: &str| word.chars().take(64).collect::<String>().to_lowercase();
    let (name, written) = (&short(name), name);
    candidates
        .into_iter()
        .map(|c| (strsim::osa_distance(name, &short(c)), c))
        .filter(|(d, c)| *d <= limit && *c != written)
        .min_by_key(|(d, _)| *d)
        .map(|(_, c)| c)
}

#[cfg(test)]
mod tests;

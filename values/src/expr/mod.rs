//! Expressions: CEL text, checked against declared types at load time and compiled to a compact tree, which is
//! evaluated.
//!
//! The crate `cel` only parses. An [`Environment`] resolves names once, at load time; a [`World`] supplies their
//! values at each evaluation. Inside expressions durations are seconds, and integers are promoted to floats where
//! needed. This module knows states and channels by their numbers only, and no files.

mod check;
mod check_operators;
mod eval;
mod functions;
mod operate;
mod scalar;
mod template;
mod typing;

pub use eval::{EvalError, World};
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

/// A checked expression, ready to be evaluated.
#[derive(Clone, Debug)]
pub struct Expr {
    source: String,
    ty: Type,
    reads: Reads,
    /// Whether the fast path may be able to evaluate it.
    quick: bool,
    root: eval::Node,
}

impl Expr {
    /// Parses and checks `source`.
    ///
    /// # Errors
    /// [`ExprError`] with the place of the first error.
    pub fn compile(source: &str, environment: &dyn Environment) -> Result<Self, ExprError> {
        check::compile(source, environment)
    }

    /// The source text.
    #[must_use]
    pub fn source(&self) -> &str {
        &self.source
    }

    /// The type of its value.
    #[must_use]
    pub fn ty(&self) -> &Type {
        &self.ty
    }

    /// What it reads.
    #[must_use]
    pub fn reads(&self) -> &Reads {
        &self.reads
    }

    /// Evaluates the expression.
    ///
    /// # Errors
    /// [`EvalError`] with the place, for instance for a missing value or a division by zero.
    pub fn evaluate<W: World + ?Sized>(&self, world: &W) -> Result<Value, EvalError> {
        if self.quick {
            match scalar::scalar(&self.root, world) {
                Some(Scalar::Bool(b)) => return Ok(Value::Bool(b)),
                Some(Scalar::Int(i)) => return Ok(Value::Int(i)),
                Some(Scalar::Float(f)) => return Ok(Value::Float(f)),
                None => {}
            }
        }
        self.interpret(world)
    }

    /// As [`evaluate`](Self::evaluate), without the fast path: the reference for its tests.
    ///
    /// # Errors
    /// [`EvalError`] with the place.
    pub fn interpret<W: World + ?Sized>(&self, world: &W) -> Result<Value, EvalError> {
        eval::evaluate(&self.root, world)
    }

    /// Evaluates a condition; a value that is not a bool is an error.
    ///
    /// # Errors
    /// [`EvalError`] with the place.
    pub fn test<W: World + ?Sized>(&self, world: &W) -> Result<bool, EvalError> {
        if self.quick
            && let Some(Scalar::Bool(b)) = scalar::scalar(&self.root, world)
        {
            return Ok(b);
        }
        eval::test(&self.root, world, false)
    }

    /// Evaluates a condition; a channel that was never published, or a NaN, makes it false.
    ///
    /// # Errors
    /// [`EvalError`] with the place, for every other failure.
    pub fn observe<W: World + ?Sized>(&self, world: &W) -> Result<bool, EvalError> {
        match self.look(world) {
            Err(error) if error.absent => Ok(false),
            other => other,
        }
    }

    /// Evaluates a condition, for an observer that needs the reason of a failure.
    ///
    /// # Errors
    /// [`EvalError`] with the place; `absent` when a channel was never published, and `nan` when its number is NaN.
    pub fn look<W: World + ?Sized>(&self, world: &W) -> Result<bool, EvalError> {
        eval::test(&self.root, world, true)
    }
}

/// The candidate most similar to a misspelt name, if one is similar enough.
#[must_use]
pub fn nearest<'a>(name: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let limit = (name.chars().count() / 3).max(1);
    let short = |word: &str| word.chars().take(64).collect::<String>().to_lowercase();
    let name = &short(name);
    candidates
        .into_iter()
        .map(|c| (strsim::osa_distance(name, &short(c)), c))
        .filter(|(d, c)| *d <= limit && *c != name)
        .min_by_key(|(d, _)| *d)
        .map(|(_, c)| c)
}

#[cfg(test)]
mod tests;

//! Expressions: CEL text, checked against declared types at load, and a compact tree that is evaluated.
//!
//! The crate `cel` only parses. What a name means is asked of an [`Environment`] once, at load; what it holds is
//! asked of a [`World`] each time. Inside expressions durations are seconds and whole numbers are promoted to
//! floats where a float is met. Nothing here knows states, channels or files beyond their numbers.

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

/// Longest expression that is parsed, bytes: the parser's stack is not ours.
pub const MAX_SOURCE: usize = 4096;
/// Most list items that all comprehensions of one evaluation together may visit.
pub const MAX_ITEMS: u32 = 10_000;
/// Most parts ([`Value::parts`]) of what one evaluation puts together.
pub const MAX_PARTS: usize = 100_000;
/// Longest text that an evaluation puts together, bytes.
pub const MAX_TEXT: usize = 1_000_000;

/// Where a name's value is found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Slot {
    /// A numbered place for inputs, locals, outputs.
    Data(u32),
    /// The newest value of a channel.
    Channel(u32),
    /// The name of the event that is being processed.
    EventName,
    /// The data of the event that is being processed.
    EventData,
}

/// What a dotted name stands for.
#[derive(Clone, Debug, PartialEq)]
pub struct Variable {
    /// Where its value is.
    pub slot: Slot,
    /// Its declared type.
    pub ty: Type,
    /// How many parts of the dotted name were used up; what is left are fields of the value.
    pub used: usize,
}

/// What a name was looked up as.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unknown {
    /// A variable, or a field of it.
    Name,
    /// A channel.
    Channel,
    /// A state.
    State,
}

/// A name that stands for nothing.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Unresolved {
    /// What it was looked up as.
    pub kind: Unknown,
    /// What is wrong, one sentence.
    pub message: String,
    /// What to do about it.
    pub help: Option<String>,
}

/// What names mean where an expression stands.
pub trait Environment {
    /// The variable that the first parts of a dotted name stand for.
    ///
    /// # Errors
    /// [`Unresolved`] when nothing of that name is in scope.
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

/// What kind of mistake an expression has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExprErrorKind {
    /// It is not CEL.
    Syntax,
    /// It is longer or deeper than is allowed.
    TooLarge,
    /// A name stands for nothing.
    UnknownName,
    /// There is no such channel.
    UnknownChannel,
    /// There is no such state.
    UnknownState,
    /// A function of that name and number of arguments does not exist.
    UnknownFunction,
    /// A value of another type is needed.
    Type,
    /// A value in another unit is needed.
    Unit,
}

/// A mistake found at load.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{message}")]
pub struct ExprError {
    /// What kind of mistake.
    pub kind: ExprErrorKind,
    /// What is wrong, one sentence.
    pub message: String,
    /// What to do about it.
    pub help: Option<String>,
    /// Bytes of the source that the mistake is about.
    pub start: usize,
    /// End of the bytes, exclusive.
    pub end: usize,
}

/// What an expression reads, so that watches know when to look again.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Reads {
    /// Channels, each once, in order.
    pub channels: Vec<u32>,
    /// Whether it reads the age of a channel, so that it changes with time alone.
    pub age: bool,
    /// Whether it reads data or states of the chart.
    pub data: bool,
    /// The numbered places that it reads, each once, in order.
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
    /// Whether it may have a value that fits into registers.
    quick: bool,
    root: eval::Node,
}

impl Expr {
    /// Parses and checks `source`.
    ///
    /// # Errors
    /// [`ExprError`] with the place of the first mistake.
    pub fn compile(source: &str, environment: &dyn Environment) -> Result<Self, ExprError> {
        check::compile(source, environment)
    }

    /// The text it was compiled from.
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

    /// Its value now.
    ///
    /// # Errors
    /// [`EvalError`] with the place, for instance a value that is not there yet or a division by zero.
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

    /// As [`evaluate`](Self::evaluate), the long way: what the quick way is held against.
    ///
    /// # Errors
    /// [`EvalError`] with the place.
    pub fn interpret<W: World + ?Sized>(&self, world: &W) -> Result<Value, EvalError> {
        eval::evaluate(&self.root, world)
    }

    /// Its truth now; anything but a bool is an error.
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

    /// Its truth now, where a channel that was never published or a number that is NaN makes it false.
    ///
    /// # Errors
    /// [`EvalError`] with the place, for every other failure.
    pub fn observe<W: World + ?Sized>(&self, world: &W) -> Result<bool, EvalError> {
        match self.look(world) {
            Err(error) if error.absent => Ok(false),
            other => other,
        }
    }

    /// Its truth now, for an observer that wants to know why nothing can be said.
    ///
    /// # Errors
    /// [`EvalError`] with the place; `absent` where a channel was never published, and `nan` where its number is NaN.
    pub fn look<W: World + ?Sized>(&self, world: &W) -> Result<bool, EvalError> {
        eval::test(&self.root, world, true)
    }
}

/// The candidate nearest to a misspelt name, if one is near enough to be meant.
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

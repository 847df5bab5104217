//! Values and expressions in their scope: names looked up from a state outward, types and units held against
//! what is declared.

use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;

use armarium_values::expr::{
    Environment, Expr, ExprErrorKind, Piece, Slot, Unresolved, Variable, nearest, split,
};
use armarium_values::{Fit, Type, Value};

use super::catalog::ChannelSchema;
use super::finding::{Findings, Span, code};
use super::yaml::{Node, Yaml};
use crate::engine::program::{Code, Instance, Place, StateId, Term};

/// Mistakes for which the nearest name is looked for.
pub(crate) const MAX_HELP: usize = 200;
/// Names of one state that are compared.
pub(crate) const MAX_NAMES: usize = 1000;

/// What the compiler knows of a state before its expressions are compiled.
#[derive(Debug)]
pub(crate) struct Outline {
    pub(crate) name: String,
    pub(crate) parent: Option<StateId>,
    pub(crate) instance: u32,
    /// Whether it is the inside of a `statechart:` state.
    pub(crate) chart_root: bool,
    pub(crate) outputs: Vec<(String, u32, Type)>,
    /// Whether it gives more than is known: then its first output is a map of all.
    pub(crate) open: bool,
}

/// Everything that names can stand for.
#[derive(Debug)]
pub(crate) struct Names<'c> {
    pub(crate) outlines: Vec<Outline>,
    /// Children by parent and name.
    pub(crate) children: BTreeMap<(StateId, String), StateId>,
    pub(crate) instances: Vec<Instance>,
    pub(crate) schema: &'c ChannelSchema,
    pub(crate) channels: RefCell<Vec<String>>,
    /// How often somebody asked for what might be meant.
    pub(crate) asked: Cell<usize>,
}

impl Names<'_> {
    /// A state by its path, looked up from `from` outward within its chart.
    pub(crate) fn find(&self, from: StateId, path: &[&str]) -> Option<StateId> {
        self.find_prefix(from, path).filter(|(_, used)| *used == path.len()).map(|(state, _)| state)
    }

    /// The state that the first parts of a path name, and how many parts those are.
    fn find_prefix(&self, from: StateId, path: &[&str]) -> Option<(StateId, usize)> {
        let first = (*path.first()?).to_owned();
        let mut around = from;
        let start = loop {
            if let Some(child) = self.children.get(&(around, first.clone())) {
                break *child;
            }
            let outline = &self.outlines[around as usize];
            if outline.chart_root {
                return None;
            }
            around = outline.parent?;
        };
        let (mut state, mut used) = (start, 1);
        while let Some(name) = path.get(used) {
            match self.children.get(&(state, (*name).to_owned())) {
                Some(child)
                    if self.outlines[*child as usize].instance == self.outlines[from as usize].instance =>
                {
                    state = *child;
                    used += 1;
                }
                _ => break,
            }
        }
        Some((state, used))
    }

    /// The names that can be looked up from `from`, nearest first, to suggest one; a file with very many mistakes or
    /// names is not searched again and again.
    pub(crate) fn visible(&self, from: StateId) -> Vec<&str> {
        let mut names = Vec::new();
        self.asked.set(self.asked.get() + 1);
        if self.asked.get() > MAX_HELP {
            return names;
        }
        let mut around = Some(from);
        while let Some(state) = around {
            let range = (state, String::new())..(state + 1, String::new());
            let children = self.children.range(range).take(MAX_NAMES);
            names.extend(children.map(|((_, name), _)| name.as_str()));
            let outline = &self.outlines[state as usize];
            around = if outline.chart_root { None } else { outline.parent };
        }
        names
    }

    fn channel_number(&self, name: &str) -> Result<u32, Unresolved> {
        if self.schema.get(name).is_none() {
            let help = match nearest(name, self.schema.names()) {
                Some(near) => format!("did you mean `{near}`?"),
                None => format!("channels are: {}", self.schema.names().collect::<Vec<_>>().join(", ")),
            };
            return Err(Unresolved { message: format!("there is no channel `{name}`"), help: Some(help) });
        }
        let mut channels = self.channels.borrow_mut();
        let at = channels.iter().position(|c| c == name).unwrap_or_else(|| {
            channels.push(name.to_owned());
            channels.len() - 1
        });
        Ok(u32::try_from(at).unwrap_or(u32::MAX))
    }
}

/// The scope of one expression.
pub(crate) struct Scope<'s, 'c> {
    pub(crate) names: &'s Names<'c>,
    pub(crate) state: StateId,
    /// Loop variables, innermost last.
    pub(crate) bound: &'s [(String, u32)],
    /// The type of `event.data`, where the event is one that declares it.
    pub(crate) event_data: Option<&'s Type>,
}

fn unresolved<T>(message: String, help: Option<String>) -> Result<T, Unresolved> {
    Err(Unresolved { message, help })
}

impl Environment for Scope<'_, '_> {
    fn variable(&self, path: &[&str]) -> Result<Variable, Unresolved> {
        let names = self.names;
        let instance = &names.instances[names.outlines[self.state as usize].instance as usize];
        let found = |slot, ty, used| Ok(Variable { slot, ty, used });
        if let Some((_, slot)) = self.bound.iter().rev().find(|(name, _)| name == path[0]) {
            return found(Slot::Data(*slot), Type::Any, 1);
        }
        let declared = match path[0] {
            "inputs" => Some(&instance.inputs),
            "locals" => Some(&instance.locals),
            "outputs" => Some(&instance.outputs),
            _ => None,
        };
        if let Some(variables) = declared {
            let Some(name) = path.get(1) else {
                return unresolved(format!("`{}` needs a name after it", path[0]), None);
            };
            if let Some(v) = variables.iter().find(|v| v.declaration.name == **name) {
                return found(Slot::Data(v.slot), v.declaration.ty.clone(), 2);
            }
            let help = nearest(name, variables.iter().map(|v| v.declaration.name.as_str()))
                .map(|near| format!("did you mean `{}.{near}`?", path[0]));
            return unresolved(format!("the chart has no `{}.{name}`", path[0]), help);
        }
        match (path[0], path.get(1)) {
            ("event", Some(&"name")) => return found(Slot::EventName, Type::String, 2),
            ("event", Some(&"data")) => {
                return found(Slot::EventData, self.event_data.cloned().unwrap_or(Type::Any), 2);
            }
            ("event", _) => return unresolved("an event has `event.name` and `event.data`".into(), None),
            ("channels", Some(name)) => {
                let number = names.channel_number(name)?;
                let ty = names.schema.get(name).cloned().unwrap_or(Type::Any);
                return found(Slot::Channel(number), ty, 2);
            }
            ("channels", None) => return unresolved("`channels` needs a name after it".into(), None),
            _ => {}
        }
        self.output(path)
    }

    fn channel(&self, name: &str) -> Result<u32, Unresolved> {
        self.names.channel_number(name)
    }

    fn state(&self, path: &str) -> Result<u32, Unresolved> {
        let parts: Vec<&str> = path.split('.').collect();
        self.names.find(self.state, &parts).map_or_else(
            || {
                let help =
                    nearest(path, self.names.visible(self.state)).map(|n| format!("did you mean `{n}`?"));
                unresolved(format!("there is no state `{path}` here"), help)
            },
            Ok,
        )
    }
}

impl Scope<'_, '_> {
    fn output(&self, path: &[&str]) -> Result<Variable, Unresolved> {
        let names = self.names;
        let Some((state, used)) = names.find_prefix(self.state, path) else {
            let known = ["inputs", "locals", "outputs", "event", "channels"];
            let help = nearest(path[0], known.into_iter().chain(names.visible(self.state)))
                .map(|near| format!("did you mean `{near}`?"));
            return unresolved(format!("there is no `{}` here", path[0]), help);
        };
        let outputs = &names.outlines[state as usize].outputs;
        let shown = path[..used].join(".");
        let Some(name) = path.get(used) else {
            return unresolved(format!("`{shown}` is a state; its outputs are `{shown}.name`"), None);
        };
        if let (true, Some((_, slot, ty))) = (names.outlines[state as usize].open, outputs.first()) {
            return Ok(Variable { slot: Slot::Data(*slot), ty: ty.clone(), used });
        }
        match outputs.iter().find(|(output, ..)| output == name) {
            Some((_, slot, ty)) => Ok(Variable { slot: Slot::Data(*slot), ty: ty.clone(), used: used + 1 }),
            None => {
                let known: Vec<&str> = outputs.iter().map(|(name, ..)| name.as_str()).collect();
                let help = match (nearest(name, known.iter().copied()), known.is_empty()) {
                    (Some(near), _) => format!("did you mean `{shown}.{near}`?"),
                    (None, true) => format!("`{shown}` gives nothing"),
                    (None, false) => format!("it gives: {}", known.join(", ")),
                };
                unresolved(format!("`{shown}` has no output `{name}`"), Some(help))
            }
        }
    }
}

/// Compiles an `if:` or `until:`, which is always an expression.
pub(crate) fn condition(
    node: &Node,
    scope: &Scope<'_, '_>,
    source: u32,
    findings: &mut Findings,
) -> Option<Code> {
    let text = match &node.value {
        Yaml::Bool(b) => b.to_string(),
        Yaml::String(s) => s.clone(),
        other => {
            let message = format!("an expression is needed here, not {}", other.describe());
            findings.error(code::FORM, node.span, message);
            return None;
        }
    };
    let (inner, offset) = match split(&text).as_deref() {
        Ok([Piece::Expr { source, offset }]) => (source.clone(), *offset),
        _ => (text, 0),
    };
    let code = expression(&inner, offset, node.span, scope, source, findings)?;
    match Type::Bool.fit(code.expr.ty()) {
        Fit::Yes | Fit::Perhaps => Some(code),
        _ => {
            let message = format!("a condition is true or false; this is {}", code.expr.ty());
            findings.error(code::TYPE, node.span, message);
            None
        }
    }
}

/// Compiles one expression that begins `offset` bytes into the text at `span`.
fn expression(
    text: &str,
    offset: usize,
    span: Span,
    scope: &Scope<'_, '_>,
    source: u32,
    findings: &mut Findings,
) -> Option<Code> {
    match Expr::compile(text, scope) {
        Ok(expr) => {
            let byte = u32::try_from(span.start).unwrap_or(u32::MAX);
            Some(Code { expr, place: Place { source, byte } })
        }
        Err(error) => {
            let (start, end) = (offset + error.start, offset + error.end);
            let at = inner_span(&findings.source.text, text, offset, span, start, end);
            let code = match error.kind {
                ExprErrorKind::Syntax => code::EXPRESSION,
                ExprErrorKind::TooLarge => code::LIMIT,
                ExprErrorKind::UnknownName if error.message.contains("channel") => code::CHANNEL,
                ExprErrorKind::UnknownName if error.message.contains("state `") => code::STATE,
                ExprErrorKind::UnknownName => code::VARIABLE,
                ExprErrorKind::UnknownFunction => code::FUNCTION,
                ExprErrorKind::Type => code::TYPE,
                ExprErrorKind::Unit => code::UNIT,
            };
            findings.error_help(code, at, error.message, error.help);
            None
        }
    }
}

/// The place in the file of a part of a scalar: exact where the scalar stands in the file as it reads.
fn inner_span(file: &str, text: &str, offset: usize, span: Span, start: usize, end: usize) -> Span {
    let raw = file.get(span.start..span.end.min(file.len())).unwrap_or("");
    let Some(found) = raw.find(text) else { return span };
    let base = span.start + found;
    let (start, end) = (base + start - offset, base + end - offset);
    Span { start, end: end.max(start + 1) }
}

/// Compiles a value: literals with expressions anywhere in them, held against the type that is declared.
pub(crate) fn value(
    node: &Node,
    ty: &Type,
    scope: &Scope<'_, '_>,
    source: u32,
    findings: &mut Findings,
) -> Option<Term> {
    let (term, found) = term(node, scope, source, findings)?;
    if let Term::Literal(literal) = term {
        return match ty.convert(literal) {
            Ok(value) => Some(Term::Literal(value)),
            Err(error) => {
                let unit = matches!(error, armarium_values::ConvertError::Unit { .. });
                let code = if unit { code::UNIT } else { code::TYPE };
                findings.error(code, node.span, error.to_string());
                None
            }
        };
    }
    match ty.fit(&found) {
        Fit::Yes | Fit::Perhaps => Some(term),
        Fit::OtherUnit => {
            findings.error(code::UNIT, node.span, format!("expected {ty}, found {found}"));
            None
        }
        // Text becomes a reference where one is declared.
        Fit::No if matches!((ty, &found), (Type::Reference(_), Type::String | Type::Enum(_))) => Some(term),
        Fit::No => {
            findings.error(code::TYPE, node.span, format!("expected {ty}, found {found}"));
            None
        }
    }
}

fn term(node: &Node, scope: &Scope<'_, '_>, source: u32, findings: &mut Findings) -> Option<(Term, Type)> {
    match &node.value {
        Yaml::String(text) => self::text(text, node.span, scope, source, findings),
        Yaml::List(items) => {
            let terms: Vec<_> = items.iter().map(|n| term(n, scope, source, findings)).collect();
            let terms: Vec<(Term, Type)> = terms.into_iter().collect::<Option<_>>()?;
            if terms.iter().all(|(t, _)| matches!(t, Term::Literal(_))) {
                return Some((Term::Literal(super::read::literal(node).unescape()), Type::Any));
            }
            let list = terms.into_iter().map(|(t, _)| t).collect();
            Some((Term::List(list), Type::list(Type::Any)))
        }
        Yaml::Map(entries) => {
            let mut terms = Vec::new();
            for (key, node) in entries {
                terms.push((key.text.clone(), term(node, scope, source, findings)?.0));
            }
            if terms.iter().all(|(_, t)| matches!(t, Term::Literal(_))) {
                return Some((Term::Literal(super::read::literal(node).unescape()), Type::Any));
            }
            Some((Term::Map(terms), Type::map(Type::Any)))
        }
        _ => Some((Term::Literal(super::read::literal(node)), Type::Any)),
    }
}

/// Text with expressions in it; a text that is one expression keeps its type.
fn text(
    text: &str,
    span: Span,
    scope: &Scope<'_, '_>,
    source: u32,
    findings: &mut Findings,
) -> Option<(Term, Type)> {
    let pieces = match split(text) {
        Ok(pieces) => pieces,
        Err(error) => {
            findings.error(code::EXPRESSION, span, error.to_string());
            return None;
        }
    };
    match pieces.as_slice() {
        [] => Some((Term::Literal(Value::String(String::new())), Type::Any)),
        [Piece::Text(text)] => Some((Term::Literal(Value::String(text.clone())), Type::Any)),
        [Piece::Expr { source: inner, offset }] => {
            let code = expression(inner, *offset, span, scope, source, findings)?;
            let ty = code.expr.ty().clone();
            Some((Term::Expr(code), ty))
        }
        pieces => {
            let mut parts = Vec::new();
            for piece in pieces {
                parts.push(match piece {
                    Piece::Text(text) => Term::Literal(Value::String(text.clone())),
                    Piece::Expr { source: inner, offset } => {
                        Term::Expr(expression(inner, *offset, span, scope, source, findings)?)
                    }
                });
            }
            Some((Term::Text(parts), Type::String))
        }
    }
}

/// `$${` in the texts of a literal is `${`.
trait Unescape {
    fn unescape(self) -> Self;
}

impl Unescape for Value {
    fn unescape(self) -> Self {
        match self {
            Self::String(s) => Self::String(s.replace("$${", "${")),
            Self::List(items) => Self::List(items.into_iter().map(Self::unescape).collect()),
            Self::Map(fields) => Self::Map(fields.into_iter().map(|(k, v)| (k, v.unescape())).collect()),
            other => other,
        }
    }
}

//! From CEL's syntax tree to our own: resolves names, checks types and units, and locates errors.

use cel::IdedExpr;
use cel::common::ast::{CallExpr, EntryExpr, Expr as Cel, LiteralValue, SelectExpr, SourceInfo};

use super::eval::{ExprNode, Macro, Pos};
use super::functions::{Function, TABLE, Takes, foreign_function};
use super::typing::{arithmetic, article, comparison, comprehension, dotted, is_text, join, mismatch};
use super::{
    Environment, Expr, ExprError, ExprErrorKind as Kind, Found, MAX_SOURCE, Reads, Slot, Unknown, Unresolved,
    nearest,
};
use super::{parsed, syntax};
use crate::types::{Fit, Type};
use crate::unit::Unit;

/// Deepest nesting of an expression; evaluating and dropping deeper ones would need much stack.
const MAX_DEPTH: usize = 200;
/// Deepest nesting that the parser reads. Its own error says so in words only.
const PARSED_DEPTH: usize = 95;
/// Deepest nesting of comprehensions.
const MAX_COMPREHENSIONS: usize = 3;

pub(super) fn compile(source: &str, environment: &dyn Environment) -> Result<Expr, ExprError> {
    if source.len() > MAX_SOURCE {
        return Err(whole(source, Kind::TooLarge, format!("an expression may have {MAX_SOURCE} bytes")));
    }
    if source.trim().is_empty() {
        return Err(whole(source, Kind::Syntax, "there is no expression here".into()));
    }
    if let Some(error) = syntax::comment(source) {
        return Err(error);
    }
    let parsed = parsed::parse(source).map_err(|e| syntax(source, &e))?;
    let (tree, places) = &*parsed;
    let mut checker =
        Checker { source, places, environment, bound: Vec::new(), reads: Reads::default(), depth: 0 };
    let (root, ty) = checker.check(tree)?;
    checker.reads.channels.sort_unstable();
    checker.reads.channels.dedup();
    checker.reads.slots.sort_unstable();
    checker.reads.slots.dedup();
    // Channels hold records and lists, so the fast path does not read them.
    let scalar = matches!(ty, Type::Bool | Type::Int | Type::Float(_) | Type::Duration);
    let quick = scalar && checker.reads.channels.is_empty();
    Ok(Expr { source: source.to_owned(), ty, reads: checker.reads, quick, root })
}

fn whole(source: &str, kind: Kind, message: String) -> ExprError {
    ExprError { kind, message, help: None, start: 0, end: source.len(), near: None }
}

fn syntax(source: &str, errors: &cel::ParseErrors) -> ExprError {
    let Some(first) = errors.errors.first() else {
        return whole(source, Kind::Syntax, "this is not an expression".into());
    };
    if nesting(source) > PARSED_DEPTH {
        return whole(source, Kind::TooLarge, "the expression is nested too deeply".into());
    }
    let (line, column) = first.pos;
    let line_start: usize =
        source.split_inclusive('\n').take(usize::try_from(line - 1).unwrap_or(0)).map(str::len).sum();
    let column = usize::try_from(column).unwrap_or(0).saturating_sub(1);
    let start = boundary(source, (line_start + column).min(source.len()));
    syntax::explain(source, start)
}

/// The deepest nesting of brackets and choices (`a ? b : c`) outside of quotes.
fn nesting(source: &str) -> usize {
    let (mut depth, mut deepest, mut outer, mut quote) = (0_usize, 0, vec![0], None);
    let mut chars = source.chars();
    while let Some(c) = chars.next() {
        match (quote, c) {
            (Some(_), '\\') => drop(chars.next()),
            (Some(open), _) if c == open => quote = None,
            (Some(_), _) => {}
            (None, '\'' | '"') => quote = Some(c),
            (None, '(' | '[' | '{' | '?') => {
                depth += 1;
                deepest = deepest.max(depth);
                if c != '?' {
                    outer.push(depth);
                }
            }
            (None, ',') => depth = outer.last().copied().unwrap_or(0),
            (None, ')' | ']' | '}') => depth = outer.pop().unwrap_or(0).saturating_sub(1),
            (None, _) => {}
        }
    }
    deepest
}

fn boundary(source: &str, mut at: usize) -> usize {
    while !source.is_char_boundary(at) {
        at -= 1;
    }
    at
}

pub(super) struct Checker<'a> {
    source: &'a str,
    places: &'a SourceInfo,
    environment: &'a dyn Environment,
    /// Variables of the enclosing comprehensions, outermost first.
    bound: Vec<(String, Type)>,
    reads: Reads,
    depth: usize,
}

pub(super) type Checked = Result<(ExprNode, Type), ExprError>;

impl Checker<'_> {
    fn span(&self, id: u64) -> (usize, usize) {
        let (start, stop) = self.places.offset_for(id).unwrap_or((0, 0));
        let start = boundary(self.source, (start as usize).min(self.source.len()));
        let mut end = (stop as usize + 1).clamp(start, self.source.len());
        while !self.source.is_char_boundary(end) {
            end += 1;
        }
        (start, end)
    }

    /// The parser places a dotted name at its last dot: all of the name.
    fn whole_name(&self, (start, end): (usize, usize)) -> (usize, usize) {
        if !self.source[start..].starts_with('.') {
            return (start, end);
        }
        let part = |c: char| c.is_alphanumeric() || c == '_' || c == '.';
        let before = self.source[..start].trim_end_matches(part).len();
        let after = self.source[start..].find(|c| !part(c)).map_or(self.source.len(), |at| start + at);
        (before, end.max(after))
    }

    pub(super) fn pos(&self, id: u64) -> Pos {
        let (start, end) = self.span(id);
        Pos { start: u16::try_from(start).unwrap_or(0), end: u16::try_from(end).unwrap_or(0) }
    }

    /// From the first byte of `of` to the end of the token `id`: the source text of a dotted name.
    fn range(&self, of: &IdedExpr, id: u64) -> (usize, usize) {
        let mut first = of;
        while let Cel::Select(select) = &first.expr {
            first = &select.operand;
        }
        let (start, _) = self.span(first.id);
        let (_, end) = self.span(id);
        (start.min(end), end)
    }

    pub(super) fn error(&self, id: u64, kind: Kind, message: impl Into<String>) -> ExprError {
        let (start, end) = self.whole_name(self.span(id));
        ExprError { kind, message: message.into(), help: None, start, end, near: None }
    }

    fn unresolved(&self, span: (usize, usize), unresolved: Unresolved) -> ExprError {
        let Unresolved { kind, message, help, near } = unresolved;
        let near = near.map(|near| (span.0, span.1, near));
        let kind = match kind {
            Unknown::Name => Kind::UnknownName,
            Unknown::Channel => Kind::UnknownChannel,
            Unknown::State => Kind::UnknownState,
        };
        ExprError { kind, message, help, start: span.0, end: span.1, near }
    }

    /// The same of a name in quotes, which stands at `place` inside of them: that part is what may be meant otherwise.
    fn unresolved_text(&self, id: u64, place: (usize, usize), unresolved: Unresolved) -> ExprError {
        let near = unresolved.near.clone().map(|near| (place.0, place.1, near));
        ExprError { near, ..self.unresolved(self.span(id), unresolved) }
    }

    pub(super) fn check(&mut self, expr: &IdedExpr) -> Checked {
        self.depth += 1;
        if self.depth > MAX_DEPTH {
            return Err(self.error(expr.id, Kind::TooLarge, "this is nested too deeply"));
        }
        let checked = self.check_inner(expr);
        self.depth -= 1;
        checked
    }

    fn check_inner(&mut self, expr: &IdedExpr) -> Checked {
        match &expr.expr {
            Cel::Literal(literal) => self.literal(expr.id, literal),
            Cel::Ident(_) | Cel::Select(_) => self.path(expr),
            Cel::Call(call) => self.call(expr.id, call),
            Cel::List(list) => {
                let items = list.elements.iter().map(|e| self.check(e)).collect::<Result<Vec<_>, _>>()?;
                let element = items.iter().map(|(_, ty)| ty.clone()).reduce(|a, b| join(&a, &b));
                let ty = Type::list(element.unwrap_or(Type::Any));
                Ok((ExprNode::List(items.into_iter().map(|(node, _)| node).collect()), ty))
            }
            Cel::Map(map) => {
                let mut entries = Vec::new();
                let mut element: Option<Type> = None;
                for entry in &map.entries {
                    let EntryExpr::MapEntry(entry) = &entry.expr else { continue };
                    let (key, key_type) = self.check(&entry.key)?;
                    self.want(entry.key.id, &Type::String, &key_type)?;
                    let (value, ty) = self.check(&entry.value)?;
                    element = Some(element.map_or(ty.clone(), |e| join(&e, &ty)));
                    entries.push((key, value));
                }
                Ok((ExprNode::Record(entries, self.pos(expr.id)), Type::map(element.unwrap_or(Type::Any))))
            }
            Cel::Struct(_) | Cel::Comprehension(_) | Cel::Unspecified => {
                Err(self.error(expr.id, Kind::Syntax, "this form of CEL is not supported here"))
            }
        }
    }

    fn literal(&self, id: u64, literal: &LiteralValue) -> Checked {
        Ok(match literal {
            LiteralValue::Boolean(b) => (ExprNode::Bool(*b.inner()), Type::Bool),
            LiteralValue::Int(i) => (ExprNode::Int(*i.inner()), Type::Int),
            LiteralValue::UInt(u) => {
                let i = i64::try_from(*u.inner())
                    .map_err(|_| self.error(id, Kind::Type, "the number is out of range"))?;
                (ExprNode::Int(i), Type::Int)
            }
            LiteralValue::Double(f) => (ExprNode::Float(*f.inner()), Type::FLOAT),
            LiteralValue::String(s) => {
                (ExprNode::Text(s.inner().to_owned()), Type::Enum(vec![s.inner().to_owned()]))
            }
            LiteralValue::Null => (ExprNode::Null, Type::Any),
            LiteralValue::Bytes(_) => {
                return Err(self.error(id, Kind::Syntax, "byte strings are not supported here"));
            }
        })
    }

    /// A dotted name: a comprehension's variable or a variable of the environment, and a path of fields in it.
    fn path(&mut self, expr: &IdedExpr) -> Checked {
        let Some((names, ids)) = dotted(expr) else {
            let Cel::Select(select) = &expr.expr else {
                return Err(self.error(expr.id, Kind::Syntax, "this is not a name"));
            };
            return self.select(expr.id, select);
        };
        let bound = self.bound.iter().rev().position(|(name, _)| name == names[0]);
        let (mut node, mut ty, used) = if let Some(depth) = bound {
            (ExprNode::Bound(depth), self.bound[self.bound.len() - 1 - depth].1.clone(), 1)
        } else {
            let found = self.environment.variable(&names);
            let variable = found.map_err(|mut e| {
                // What is proposed stands for the first parts, or puts a section before the first one; the others stay.
                if let Some(near) = &mut e.near {
                    let is_last = near.rsplit('.').next() == Some(names[0]);
                    let rest = names.iter().skip(if is_last { 1 } else { near.split('.').count() });
                    rest.for_each(|field| near.extend([".", field]));
                }
                let places = self.places(self.range(expr, ids[0]).0, &names);
                self.unresolved((places[0].0, places[places.len() - 1].1), e)
            })?;
            let places = self.places(self.range(expr, ids[0]).0, &names);
            self.environment.found(Found::Variable { parts: &names, places: &places, variable: &variable });
            let pos = self.range_pos(expr, ids[variable.used.clamp(1, ids.len()) - 1]);
            (self.read(variable.slot, pos), variable.ty, variable.used.max(1))
        };
        for (name, id) in names.iter().zip(&ids).skip(used) {
            ty = self.field_type(*id, &ty, name)?;
            node = match node {
                ExprNode::Channel(channel, mut path, pos) => {
                    path.push((*name).to_owned());
                    ExprNode::Channel(channel, path, Pos { end: self.pos(*id).end, ..pos })
                }
                node => ExprNode::Field(Box::new(node), (*name).to_owned(), self.range_pos(expr, *id)),
            };
        }
        Ok((node, ty))
    }

    /// The places of names that stand one after the other from `at` on.
    fn places(&self, mut at: usize, names: &[&str]) -> Vec<(usize, usize)> {
        let place = |name: &&str| {
            let start = at + self.source[at..].find(*name).unwrap_or(0);
            at = (start + name.len()).min(self.source.len());
            (start, at)
        };
        names.iter().map(place).collect()
    }

    /// The place of a text that is given in quotes, without them.
    fn quoted(&self, id: u64, text: &str) -> (usize, usize) {
        let (start, end) = self.span(id);
        self.source[start..end].find(text).map_or((start, end), |at| (start + at, start + at + text.len()))
    }

    /// The place of a function's name: before the bracket of its call.
    fn named(&self, id: u64, name: &str) -> Option<(usize, usize)> {
        let (_, end) = self.span(id);
        let calls = |at: &usize| self.source[at + name.len()..].trim_start().starts_with('(');
        let at = self
            .source
            .match_indices(name)
            .map(|(at, _)| at)
            .filter(calls)
            .take_while(|at| *at < end)
            .last()?;
        Some((at, at + name.len()))
    }

    fn range_pos(&self, expr: &IdedExpr, id: u64) -> Pos {
        let (start, end) = self.range(expr, id);
        Pos { start: u16::try_from(start).unwrap_or(0), end: u16::try_from(end).unwrap_or(0) }
    }

    fn read(&mut self, slot: Slot, pos: Pos) -> ExprNode {
        match slot {
            Slot::Data(n) => {
                self.reads.data = true;
                self.reads.slots.push(n);
                ExprNode::Data(n, pos)
            }
            Slot::Channel(n) => {
                self.reads.channels.push(n);
                ExprNode::Channel(n, Vec::new(), pos)
            }
            Slot::EventName => {
                self.reads.event = true;
                ExprNode::EventName
            }
            Slot::EventData => {
                self.reads.event = true;
                ExprNode::EventData
            }
        }
    }

    fn select(&mut self, id: u64, select: &SelectExpr) -> Checked {
        let (node, ty) = self.check(&select.operand)?;
        let ty = self.field_type(id, &ty, &select.field)?;
        Ok((ExprNode::Field(Box::new(node), select.field.clone(), self.pos(id)), ty))
    }

    fn field_type(&self, id: u64, of: &Type, name: &str) -> Result<Type, ExprError> {
        let fields = match of {
            Type::Any => return Ok(Type::Any),
            Type::Map(element) => return Ok((**element).clone()),
            other => other.fields(),
        };
        if fields.is_empty() && !matches!(of, Type::Record(_)) {
            return Err(self.error(id, Kind::Type, format!("{} has no fields", article(of))));
        }
        if let Some((_, ty)) = fields.iter().find(|(known, _)| *known == name) {
            return Ok(ty.clone());
        }
        let mut error = self.error(id, Kind::UnknownName, format!("there is no field `{name}` here"));
        let known: Vec<&str> = fields.iter().map(|(known, _)| *known).collect();
        let near = nearest(name, known.iter().copied());
        error.help = Some(match near {
            Some(near) => format!("did you mean `{near}`?"),
            None => format!("there are: {}", known.join(", ")),
        });
        error.near = near.map(|near| {
            let (start, end) = self.places(error.start, &[name])[0];
            (start, end, near.to_owned())
        });
        Err(error)
    }

    fn want(&self, id: u64, expected: &Type, found: &Type) -> Result<(), ExprError> {
        match expected.fit(found) {
            Fit::Yes | Fit::Perhaps => Ok(()),
            Fit::OtherUnit => Err(self.error(id, Kind::Unit, mismatch(expected, found))),
            Fit::No => Err(self.error(id, Kind::Type, mismatch(expected, found))),
        }
    }

    fn call(&mut self, id: u64, call: &CallExpr) -> Checked {
        let name = call.func_name.as_str();
        if let Some(target) = &call.target {
            if let Some(kind) = comprehension(name, call.args.len()) {
                return self.comprehend(id, kind, target, &call.args);
            }
            let arguments: Vec<&IdedExpr> = std::iter::once(&**target).chain(&call.args).collect();
            return self.function(id, name, &arguments);
        }
        let args: Vec<&IdedExpr> = call.args.iter().collect();
        match (name, args.as_slice()) {
            ("_&&_", [_, ..]) => self.logic(id, &args, ExprNode::And),
            ("_||_", [_, ..]) => self.logic(id, &args, ExprNode::Or),
            ("!_", [of]) => {
                let (node, ty) = self.check(of)?;
                self.want(of.id, &Type::Bool, &ty).map_err(|error| {
                    let help = "`!` turns a condition round; a number or a text is compared, as in `a == 0`";
                    ExprError { help: Some(help.to_owned()), ..error }
                })?;
                Ok((ExprNode::Not(Box::new(node), self.pos(id)), Type::Bool))
            }
            ("-_", [of]) => {
                let (node, ty) = self.check(of)?;
                let ty = self.number(of.id, &ty)?;
                Ok((ExprNode::Negate(Box::new(node), self.pos(id)), ty))
            }
            ("_?_:_", [condition, then, otherwise]) => {
                let (condition_node, ty) = self.check(condition)?;
                self.want(condition.id, &Type::Bool, &ty)?;
                let ((a, ta), (b, tb)) = (self.check(then)?, self.check(otherwise)?);
                let parts = Box::new((condition_node, a, b));
                Ok((ExprNode::Choose(parts, self.pos(id)), join(&ta, &tb)))
            }
            ("_[_]", [of, key]) => self.index(id, of, key),
            ("@in", [item, of]) => {
                let ((a, ta), (b, tb)) = (self.check(item)?, self.check(of)?);
                match &tb {
                    Type::List(element) => self.comparable(id, &ta, element)?,
                    Type::Map(_) | Type::Record(_) => self.want(item.id, &Type::String, &ta)?,
                    Type::Any => {}
                    other => {
                        return Err(self.error(id, Kind::Type, format!("{} has no items", article(other))));
                    }
                }
                Ok((ExprNode::In(Box::new((a, b)), self.pos(id)), Type::Bool))
            }
            (_, [a, b]) if arithmetic(name).is_some() || comparison(name).is_some() => {
                self.binary(id, name, a, b)
            }
            ("age", [channel]) => {
                let text = self.text(channel)?;
                let found = self.environment.channel(text);
                let place = self.quoted(channel.id, text);
                let channel = found.map_err(|e| self.unresolved_text(channel.id, place, e))?;
                self.environment.found(Found::Channel { name: text, place });
                self.function_found(id, name);
                self.reads.channels.push(channel);
                self.reads.age = true;
                Ok((ExprNode::Age(channel, self.pos(id)), Type::quantity(Unit::S)))
            }
            ("active", [state]) => {
                let text = self.text(state)?;
                let found = self.environment.state(text);
                let place = self.quoted(state.id, text);
                let number = found.map_err(|e| self.unresolved_text(state.id, place, e))?;
                self.environment.found(Found::State { path: text, place });
                self.function_found(id, name);
                self.reads.data = true;
                Ok((ExprNode::Active(number), Type::Bool))
            }
            ("has", [of]) => {
                let Cel::Select(select) = &of.expr else {
                    return Err(self.error(of.id, Kind::Type, "`has` takes a field, as in `has(a.b)`"));
                };
                let (node, _) = self.check(&select.operand)?;
                Ok((ExprNode::Has(Box::new(node), select.field.clone()), Type::Bool))
            }
            _ => self.function(id, name, &args),
        }
    }

    fn text<'e>(&self, expr: &'e IdedExpr) -> Result<&'e str, ExprError> {
        match &expr.expr {
            Cel::Literal(LiteralValue::String(s)) => Ok(s.inner()),
            of => {
                let mut error = self.error(expr.id, Kind::Type, "a name in quotes is needed here");
                if let Cel::Ident(name) = of {
                    error.help = Some(format!("write `'{name}'`"));
                }
                Err(error)
            }
        }
    }

    fn logic(
        &mut self,
        id: u64,
        args: &[&IdedExpr],
        make: fn(Box<(ExprNode, ExprNode)>, Pos) -> ExprNode,
    ) -> Checked {
        let mut joined: Option<ExprNode> = None;
        for arg in args {
            let (node, ty) = self.check(arg)?;
            self.want(arg.id, &Type::Bool, &ty)?;
            joined = Some(match joined {
                None => node,
                Some(before) => make(Box::new((before, node)), self.pos(id)),
            });
        }
        Ok((joined.unwrap_or(ExprNode::Bool(true)), Type::Bool))
    }

    fn index(&mut self, id: u64, of: &IdedExpr, key: &IdedExpr) -> Checked {
        let ((x, tx), (k, tk)) = (self.check(of)?, self.check(key)?);
        let result = match &tx {
            Type::List(element) => {
                self.want(key.id, &Type::Int, &tk)?;
                (**element).clone()
            }
            Type::Vector => {
                self.want(key.id, &Type::Int, &tk)?;
                Type::FLOAT
            }
            Type::Map(element) => {
                self.want(key.id, &Type::String, &tk)?;
                (**element).clone()
            }
            Type::Any | Type::Record(_) => Type::Any,
            other => return Err(self.error(id, Kind::Type, format!("{} has no items", article(other)))),
        };
        Ok((ExprNode::Index(Box::new((x, k)), self.pos(id)), result))
    }

    fn comprehend(&mut self, id: u64, kind: Macro, range: &IdedExpr, args: &[IdedExpr]) -> Checked {
        let Cel::Ident(name) = &args[0].expr else {
            return Err(self.error(args[0].id, Kind::Syntax, "the name of a variable is needed here"));
        };
        if self.bound.len() >= MAX_COMPREHENSIONS {
            let message = format!("more than {MAX_COMPREHENSIONS} comprehensions inside one another");
            return Err(self.error(id, Kind::TooLarge, message));
        }
        let (range_node, range_type) = self.check(range)?;
        let element = match &range_type {
            Type::List(element) => (**element).clone(),
            Type::Any => Type::Any,
            Type::Map(_) | Type::Record(_) => Type::String,
            other => return Err(self.error(id, Kind::Type, format!("{} has no items", article(other)))),
        };
        self.bound.push((name.clone(), element.clone()));
        let body = self.check(&args[1]);
        self.bound.pop();
        let (body_node, body_type) = body?;
        let result = match kind {
            Macro::Map => Type::list(body_type),
            Macro::Filter => {
                self.want(args[1].id, &Type::Bool, &body_type)?;
                Type::list(element)
            }
            _ => {
                self.want(args[1].id, &Type::Bool, &body_type)?;
                Type::Bool
            }
        };
        Ok((ExprNode::Macro(kind, Box::new((range_node, body_node)), self.pos(id)), result))
    }

    fn function_found(&self, id: u64, name: &str) {
        if let Some(place) = self.named(id, name) {
            self.environment.found(Found::Function { name, place });
        }
    }

    fn function(&mut self, id: u64, name: &str, args: &[&IdedExpr]) -> Checked {
        let Some((_, function, least, most, ..)) = TABLE.iter().find(|(known, ..)| *known == name) else {
            let message = format!("there is no function `{name}`");
            let mut error = self.error(id, Kind::UnknownFunction, message);
            let known = TABLE.iter().map(|(known, ..)| *known).chain(["age", "active", "has"]);
            let near = foreign_function(name).or_else(|| nearest(name, known));
            error.help = near.map(|near| format!("did you mean `{near}`?"));
            error.near =
                near.zip(self.named(id, name)).map(|(near, (start, end))| (start, end, near.to_owned()));
            return Err(error);
        };
        self.function_found(id, name);
        if args.len() < *least || args.len() > *most {
            let message = format!("`{name}` takes {least} argument(s), not {}", args.len());
            return Err(self.error(id, Kind::UnknownFunction, message));
        }
        let mut nodes = Vec::with_capacity(args.len());
        let mut types = Vec::with_capacity(args.len());
        for arg in args {
            let (node, ty) = self.check(arg)?;
            self.argument(arg.id, *function, &ty)?;
            nodes.push(node);
            types.push(ty);
        }
        if matches!(function, Function::Min | Function::Max | Function::Clamp) {
            for ty in &types[1..] {
                self.same_unit(id, &types[0], ty)?;
            }
        }
        Ok((ExprNode::Call(*function, nodes, self.pos(id)), function.result(&types)))
    }

    fn argument(&self, id: u64, function: Function, ty: &Type) -> Result<(), ExprError> {
        let numbers = |t: &Type| matches!(t, Type::Any | Type::Int | Type::Float(_) | Type::Duration);
        let list = |t: &Type| matches!(t, Type::List(element) if numbers(element));
        let (fits, expected) = match function.takes() {
            Takes::Numbers => (numbers(ty), "a number"),
            Takes::NumbersOrList => (numbers(ty) || list(ty), "a number or a list of numbers"),
            Takes::Vectors => {
                (list(ty) || matches!(ty, Type::Vector | Type::Any), "a vector or a list of numbers")
            }
            Takes::Strings => (is_text(ty) || *ty == Type::Any, "a string"),
            Takes::Sized => {
                let sized = matches!(
                    ty,
                    Type::Any | Type::List(_) | Type::Map(_) | Type::Record(_) | Type::Bytes | Type::Vector
                );
                (sized || is_text(ty), "a list, a map or a string")
            }
            Takes::Anything => (true, ""),
        };
        if fits {
            return Ok(());
        }
        Err(self.error(id, Kind::Type, format!("expected {expected}, found {}", article(ty))))
    }
}

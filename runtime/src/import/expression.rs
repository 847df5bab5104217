//! Converts one expression: the part of ECMAScript that needs no data model, to CEL.
//!
//! Supported: literals, `In('id')`, `_event.name`, `_event.data.x`, `_name`, `_sessionid`, `!`, `&&`, `||`,
//! comparison and the concatenation of texts. Expressions of literals only are computed here, by ECMAScript's
//! rules.

use super::yaml::cel_string;

/// Deepest nesting of parentheses and signs.
const MAX_DEPTH: usize = 40;
/// Longest expression, bytes.
const MAX_LEN: usize = 4096;

/// A parsed expression.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Expr {
    Null,
    Bool(bool),
    Number(f64),
    Text(String),
    /// Whether this state is active.
    In(String),
    /// `event.name`, `event.data.x`.
    Event(String),
    Not(Box<Expr>),
    Binary(&'static str, Box<Expr>, Box<Expr>),
}

/// The names that an expression may use.
pub(super) struct ScxmlScope<'s> {
    /// The chart's name: SCXML's `_name`, and the id of its only session.
    pub(super) chart: &'s str,
    /// The path of a state by its id.
    pub(super) path: &'s dyn Fn(&str) -> Option<String>,
}

impl Expr {
    /// For a literal: whether ECMAScript treats it as true.
    pub(super) fn truth(&self) -> Option<bool> {
        match self {
            Self::Null => Some(false),
            Self::Bool(b) => Some(*b),
            Self::Number(n) => Some(*n != 0.0 && !n.is_nan()),
            Self::Text(s) => Some(!s.is_empty()),
            _ => None,
        }
    }

    /// For a literal: its text by ECMAScript's conversion.
    pub(super) fn words(&self) -> Option<String> {
        match self {
            Self::Null => Some("null".into()),
            Self::Bool(b) => Some(b.to_string()),
            Self::Number(n) => Some(n.to_string()),
            Self::Text(s) => Some(s.clone()),
            _ => None,
        }
    }

    /// The expression as CEL.
    pub(super) fn cel(&self) -> String {
        match self {
            Self::Null => "null".into(),
            Self::Bool(b) => b.to_string(),
            Self::Number(n) => n.to_string(),
            Self::Text(s) => cel_string(s),
            Self::In(path) => format!("active({})", cel_string(path)),
            Self::Event(path) => format!("event.{path}"),
            Self::Not(inner) => match **inner {
                Self::In(_) | Self::Event(_) | Self::Bool(_) => format!("!{}", inner.cel()),
                _ => format!("!({})", inner.cel()),
            },
            Self::Binary(op, a, b) => {
                let side = |e: &Self| match e {
                    Self::Binary(inner, ..) if inner != op || !matches!(*op, "&&" | "||" | "+") => {
                        format!("({})", e.cel())
                    }
                    _ => e.cel(),
                };
                format!("{} {op} {}", side(a), side(b))
            }
        }
    }
}

/// Why an expression cannot be carried over.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(super) enum ExpressionError {
    #[error("an expression has more than {MAX_LEN} bytes")]
    TooLong,
    #[error("the expression `{text}` cannot be carried over: {why}")]
    Refused { text: String, why: Untranslatable },
}

/// What is wrong in an expression.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(super) enum Untranslatable {
    #[error("`{0}` is not understood")]
    Character(char),
    #[error("`{0}` is not understood here")]
    Unexpected(String),
    #[error("`{0}` is not a number")]
    Number(String),
    #[error("`{0}` needs a data model")]
    DataModel(String),
    #[error("`_event.{0}` is not known here: `name` and `data` are")]
    EventField(String),
    /// The rest needs no name.
    #[error("{0}")]
    Form(&'static str),
}

use Untranslatable::Form;

/// Parses an expression that needs no data model.
pub(super) fn parse(text: &str, scope: &ScxmlScope<'_>) -> Result<Expr, ExpressionError> {
    if text.len() > MAX_LEN {
        return Err(ExpressionError::TooLong);
    }
    let parse = || {
        let tokens = tokens(text)?;
        let mut parser = Parser { tokens: &tokens, at: 0, scope };
        let expr = parser.or(0)?;
        match parser.tokens.get(parser.at) {
            None => Ok(expr),
            Some(token) => Err(Untranslatable::Unexpected(token.show())),
        }
    };
    parse().map_err(|why| ExpressionError::Refused { text: text.trim().to_owned(), why })
}

#[derive(Clone, Debug, PartialEq)]
enum ScxmlToken {
    Name(String),
    Number(f64),
    Text(String),
    Op(&'static str),
}

impl ScxmlToken {
    fn show(&self) -> String {
        match self {
            Self::Name(n) => n.clone(),
            Self::Number(n) => n.to_string(),
            Self::Text(s) => format!("'{s}'"),
            Self::Op(op) => (*op).to_owned(),
        }
    }
}

const OPERATORS: [&str; 17] =
    ["===", "!==", "==", "!=", "<=", ">=", "&&", "||", "<", ">", "!", "(", ")", "+", "-", ".", ","];

fn tokens(text: &str) -> Result<Vec<ScxmlToken>, Untranslatable> {
    let mut result = Vec::new();
    let mut rest = text.trim_start();
    while let Some(first) = rest.chars().next() {
        let next_digit = rest.chars().nth(1).is_some_and(|c| c.is_ascii_digit());
        let used = if first == '\'' || first == '"' {
            let (token, used) = quoted(rest, first)?;
            result.push(ScxmlToken::Text(token));
            used
        } else if first.is_ascii_digit() || (first == '.' && next_digit) {
            let end = rest.find(|c: char| !(c.is_ascii_alphanumeric() || c == '.')).unwrap_or(rest.len());
            let number = rest[..end].parse().map_err(|_| Untranslatable::Number(rest[..end].to_owned()))?;
            result.push(ScxmlToken::Number(number));
            end
        } else if first.is_alphabetic() || first == '_' || first == '$' {
            let name = |c: char| c.is_alphanumeric() || c == '_' || c == '$';
            let end = rest.find(|c| !name(c)).unwrap_or(rest.len());
            result.push(ScxmlToken::Name(rest[..end].to_owned()));
            end
        } else {
            let op = OPERATORS.into_iter().find(|op| rest.starts_with(op));
            let op = op.ok_or(Untranslatable::Character(first))?;
            result.push(ScxmlToken::Op(op));
            op.len()
        };
        rest = rest[used..].trim_start();
    }
    Ok(result)
}

/// A quoted text and its length in bytes, with the quotes.
fn quoted(text: &str, quote: char) -> Result<(String, usize), Untranslatable> {
    let mut result = String::new();
    let mut chars = text.char_indices().skip(1);
    while let Some((at, c)) = chars.next() {
        match c {
            c if c == quote => return Ok((result, at + 1)),
            '\\' => match chars.next().map(|(_, c)| c) {
                Some('n') => result.push('\n'),
                Some('t') => result.push('\t'),
                Some('r') => result.push('\r'),
                Some(c @ ('\\' | '\'' | '"' | '/')) => result.push(c),
                _ => return Err(Form("an escape in a text is not understood")),
            },
            c => result.push(c),
        }
    }
    Err(Form("a text has no end"))
}

struct Parser<'t> {
    tokens: &'t [ScxmlToken],
    at: usize,
    scope: &'t ScxmlScope<'t>,
}

impl Parser<'_> {
    fn take(&mut self, ops: &[&'static str]) -> Option<&'static str> {
        match self.tokens.get(self.at) {
            Some(ScxmlToken::Op(op)) if ops.contains(op) => {
                self.at += 1;
                Some(op)
            }
            _ => None,
        }
    }

    fn or(&mut self, depth: usize) -> Result<Expr, Untranslatable> {
        if depth > MAX_DEPTH {
            return Err(Form("it is nested too deep"));
        }
        self.logic("||", true, |parser| parser.logic("&&", false, |parser| parser.comparison(depth)))
    }

    /// Operands joined by `op`; a literal whose truth is `decides` is the result whatever stands on its right.
    fn logic(
        &mut self,
        op: &'static str,
        decides: bool,
        mut operand: impl FnMut(&mut Self) -> Result<Expr, Untranslatable>,
    ) -> Result<Expr, Untranslatable> {
        let mut left = operand(self)?;
        while self.take(&[op]).is_some() {
            let right = operand(self)?;
            left = match left.truth() {
                Some(truth) if truth == decides => left,
                Some(_) => right,
                None => Expr::Binary(op, Box::new(left), Box::new(right)),
            };
        }
        Ok(left)
    }

    fn comparison(&mut self, depth: usize) -> Result<Expr, Untranslatable> {
        let left = self.sum(depth)?;
        let Some(op) = self.take(&["===", "!==", "==", "!=", "<=", ">=", "<", ">"]) else { return Ok(left) };
        let right = self.sum(depth)?;
        compare(op, left, right)
    }

    fn sum(&mut self, depth: usize) -> Result<Expr, Untranslatable> {
        let mut left = self.unary(depth)?;
        while let Some(op) = self.take(&["+", "-"]) {
            let right = self.unary(depth)?;
            left = add(op, left, right)?;
        }
        Ok(left)
    }

    fn unary(&mut self, depth: usize) -> Result<Expr, Untranslatable> {
        if depth > MAX_DEPTH {
            return Err(Form("it is nested too deep"));
        }
        match self.take(&["!", "-", "("]) {
            Some("!") => {
                let inner = self.unary(depth + 1)?;
                Ok(match (inner.truth(), inner) {
                    (Some(truth), _) => Expr::Bool(!truth),
                    (None, inner) => Expr::Not(Box::new(inner)),
                })
            }
            Some("-") => match self.unary(depth + 1)? {
                Expr::Number(n) => Ok(Expr::Number(-n)),
                _ => Err(Form("`-` stands before a number only")),
            },
            Some(_) => {
                let inner = self.or(depth + 1)?;
                self.take(&[")"]).ok_or(Form("a `)` is missing"))?;
                Ok(inner)
            }
            None => self.primary(),
        }
    }

    fn primary(&mut self) -> Result<Expr, Untranslatable> {
        let token = self.tokens.get(self.at).ok_or(Form("it ends too early"))?;
        self.at += 1;
        match token {
            ScxmlToken::Number(n) => Ok(Expr::Number(*n)),
            ScxmlToken::Text(s) => Ok(Expr::Text(s.clone())),
            ScxmlToken::Op(op) => Err(Untranslatable::Unexpected((*op).to_owned())),
            ScxmlToken::Name(name) => match name.as_str() {
                "true" => Ok(Expr::Bool(true)),
                "false" => Ok(Expr::Bool(false)),
                "null" | "undefined" => Ok(Expr::Null),
                "_name" | "_sessionid" => Ok(Expr::Text(self.scope.chart.to_owned())),
                "In" => self.in_state(),
                "_event" => self.event(),
                other => Err(Untranslatable::DataModel(other.to_owned())),
            },
        }
    }

    fn in_state(&mut self) -> Result<Expr, Untranslatable> {
        self.take(&["("]).ok_or(Form("`In` is written `In('state')`"))?;
        let Some(ScxmlToken::Text(id)) = self.tokens.get(self.at).cloned() else {
            return Err(Form("`In` takes the id of a state as text"));
        };
        self.at += 1;
        self.take(&[")"]).ok_or(Form("a `)` is missing"))?;
        // A state that does not exist is never active.
        Ok((self.scope.path)(id.trim()).map_or(Expr::Bool(false), Expr::In))
    }

    fn event(&mut self) -> Result<Expr, Untranslatable> {
        let mut path: Vec<String> = Vec::new();
        while self.take(&["."]).is_some() {
            let Some(ScxmlToken::Name(part)) = self.tokens.get(self.at) else {
                return Err(Form("a name is needed after `.`"));
            };
            path.push(part.clone());
            self.at += 1;
        }
        match path.first().map(String::as_str) {
            Some("name") if path.len() == 1 => Ok(Expr::Event("name".into())),
            Some("data") => Ok(Expr::Event(path.join("."))),
            Some(other) => Err(Untranslatable::EventField(other.to_owned())),
            None => Err(Form("`_event` is used with `.name` or `.data`")),
        }
    }
}

fn compare(op: &'static str, left: Expr, right: Expr) -> Result<Expr, Untranslatable> {
    use Expr::{Bool, Number, Text};
    let cel = match op {
        "===" => "==",
        "!==" => "!=",
        other => other,
    };
    let same = match (&left, &right) {
        (Number(a), Number(b)) => {
            let holds = match cel {
                "<" => a < b,
                ">" => a > b,
                "<=" => a <= b,
                ">=" => a >= b,
                "==" => a == b,
                _ => a != b,
            };
            return Ok(Bool(holds));
        }
        (Text(_) | Bool(_) | Expr::Null, Text(_) | Bool(_) | Expr::Null)
            if std::mem::discriminant(&left) == std::mem::discriminant(&right) =>
        {
            Some(left == right)
        }
        _ if left.words().is_some() && right.words().is_some() => {
            (op == "===" || op == "!==").then_some(false)
        }
        _ => return Ok(Expr::Binary(cel, Box::new(left), Box::new(right))),
    };
    match (same, cel) {
        (Some(same), "==") => Ok(Bool(same)),
        (Some(same), "!=") => Ok(Bool(!same)),
        _ => Err(Form("values of different kinds are compared")),
    }
}

fn add(op: &'static str, left: Expr, right: Expr) -> Result<Expr, Untranslatable> {
    match (op, &left, &right) {
        ("+", Expr::Number(a), Expr::Number(b)) => Ok(Expr::Number(a + b)),
        ("-", Expr::Number(a), Expr::Number(b)) => Ok(Expr::Number(a - b)),
        ("+", Expr::Text(_), _) | ("+", _, Expr::Text(_)) => match (left.words(), right.words()) {
            (Some(a), Some(b)) => Ok(Expr::Text(a + &b)),
            _ => Ok(Expr::Binary("+", Box::new(left), Box::new(right))),
        },
        ("+", Expr::Binary("+", ..) | Expr::Event(_), Expr::Event(_)) => {
            Ok(Expr::Binary("+", Box::new(left), Box::new(right)))
        }
        _ => Err(Form("only numbers and texts are added")),
    }
}

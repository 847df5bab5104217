use std::collections::BTreeMap;

use super::*;
use crate::{Frame, Unit, Value, Vector};

/// Names are looked up in one table; slot numbers are its order.
struct Fixture(Vec<(&'static str, Type, Option<Value>)>);

impl Environment for Fixture {
    fn variable(&self, path: &[&str]) -> Result<Variable, Unresolved> {
        if path[0] == "channels" {
            let wrist = Type::record([("push", Type::list(Type::quantity(Unit::N)))]);
            return Ok(Variable { slot: Slot::Channel(0), ty: wrist, used: 2 });
        }
        if path == ["event", "data"] {
            return Ok(Variable { slot: Slot::EventData, ty: Type::Any, used: 2 });
        }
        let at = self.0.iter().position(|(name, ..)| *name == path[0]);
        at.map(|i| Variable { slot: Slot::Data(i as u32), ty: self.0[i].1.clone(), used: 1 }).ok_or_else(
            || {
                let message = format!("there is no `{}`", path.join("."));
                let help =
                    nearest(path[0], self.0.iter().map(|(n, ..)| *n)).map(|n| format!("did you mean `{n}`?"));
                Unresolved { kind: Unknown::Name, message, help, near: None }
            },
        )
    }
    fn channel(&self, name: &str) -> Result<u32, Unresolved> {
        let missing = || Unresolved::new(Unknown::Channel, "no channel".into(), None, None);
        (name == "wrist").then_some(0).ok_or_else(missing)
    }
    fn state(&self, _: &str) -> Result<u32, Unresolved> {
        Ok(3)
    }
}

impl EvalContext for Fixture {
    fn data(&self, slot: u32) -> Option<&Value> {
        self.0[slot as usize].2.as_ref()
    }
    fn channel(&self, _: u32, path: &[String]) -> Option<Value> {
        let value = self.0.iter().find(|(name, ..)| *name == "wrist")?.2.clone()?;
        path.iter().try_fold(value, |v, name| v.get(name).cloned())
    }
    fn age(&self, _: u32) -> Option<f64> {
        Some(0.25)
    }
    fn event_name(&self) -> Option<&str> {
        Some("said")
    }
    fn event_data(&self) -> Option<&Value> {
        None
    }
    fn active(&self, state: u32) -> bool {
        state == 3
    }
}

fn fixture() -> Fixture {
    let push: Value = vec![3.0, 4.0, 0.0].into();
    Fixture(vec![
        ("n", Type::Int, Some(Value::Int(7))),
        ("x", Type::FLOAT, Some(Value::Float(2.5))),
        ("force", Type::quantity(Unit::N), Some(Value::Float(8.0))),
        ("length", Type::quantity(Unit::M), Some(Value::Float(0.5))),
        ("patience", Type::Duration, Some(Value::Duration(60.0))),
        ("gesture", Type::one_of(["fist", "open_hand"]), Some("fist".into())),
        ("later", Type::FLOAT, None),
        ("items", Type::list(Type::Int), Some(Value::List((1..=4).map(Value::Int).collect()))),
        ("wrist", Type::Any, Some(Value::Map(BTreeMap::from([("push".to_owned(), push)])))),
    ])
}

fn eval(source: &str) -> Value {
    let fixture = fixture();
    let expr = Expr::compile(source, &fixture).unwrap_or_else(|e| panic!("{source}: {e}"));
    expr.evaluate(&fixture).unwrap_or_else(|e| panic!("{source}: {e}"))
}

#[test]
fn expressions_have_their_values() {
    for (source, expected) in [
        ("n + 1", Value::Int(8)),
        ("n / 2", Value::Int(3)),
        ("n * x", Value::Float(17.5)),
        ("1 + 2 * 3 - 4 % 3", Value::Int(6)),
        ("patience > 59", Value::Bool(true)),
        ("force > 6.0 && !(x < 1)", Value::Bool(true)),
        ("gesture == 'fist' || later > 1.0", Value::Bool(true)),
        ("norm(channels.wrist.push)", Value::Float(5.0)),
        ("age('wrist') < 0.3", Value::Bool(true)),
        ("active('A.B')", Value::Bool(true)),
        ("items[2] in items", Value::Bool(true)),
        ("items.exists(i, i > 3) && items.all(i, items.exists(j, j == i))", Value::Bool(true)),
        ("size(items.filter(i, i % 2 == 0)) + items.map(i, i * i)[3]", Value::Int(18)),
        ("{'a': 1, 'b': 2}.b", Value::Int(2)),
        ("has(channels.wrist.push)", Value::Bool(true)),
        ("string(n) + 'th'", "7th".into()),
        ("x > 2 ? 'big' : 'small'", "big".into()),
        ("min(n, 3) + max([1, 9])", Value::Int(12)),
        ("clamp(x, 0, 1)", Value::Float(1.0)),
        ("'abc'.contains('b')", Value::Bool(true)),
        ("-n", Value::Int(-7)),
        ("Motion('wipe').id", "wipe".into()),
    ] {
        assert_eq!(eval(source), expected, "{source}");
    }
}

#[test]
fn mistakes_are_found_at_load_with_their_place() {
    use ExprErrorKind as K;
    for (source, kind, at) in [
        ("force > length", K::Unit, ">"),
        ("force + length", K::Unit, "+"),
        ("forse > 1.0", K::UnknownName, "forse"),
        ("x && true", K::Type, "x"),
        ("gesture == 'fits'", K::Type, "=="),
        ("norm(channels.wrist.pusk)", K::UnknownName, "channels.wrist.pusk"),
        ("nrm(items)", K::UnknownFunction, "("),
        ("age('wirst') < 1", K::UnknownChannel, "'wirst'"),
        ("1 +", K::Syntax, ""),
        ("x.y", K::Type, "x.y"),
        ("gesture + 1", K::Type, "gesture"),
    ] {
        let error = Expr::compile(source, &fixture()).expect_err(source);
        assert_eq!(error.kind, kind, "{source}: {error}");
        assert!(
            source[error.start..error.end].starts_with(at),
            "{source}: {:?}",
            &source[error.start..error.end]
        );
    }
    let help = Expr::compile("forse", &fixture()).unwrap_err().help;
    assert_eq!(help.as_deref(), Some("did you mean `force`?"));
}

#[test]
fn failures_while_it_runs_are_errors() {
    let fixture = fixture();
    for source in ["later + 1.0", "n / 0", "items[9]", "9223372036854775807 + n", "int('x')"] {
        let expr = Expr::compile(source, &fixture).unwrap();
        assert!(expr.evaluate(&fixture).is_err(), "{source}");
    }
}

#[test]
fn absent_and_nan_channels_are_false() {
    let mut fixture = fixture();
    let expr = Expr::compile("!(norm(channels.wrist.push) > 6.0)", &fixture).unwrap();
    assert_eq!(expr.observe(&fixture), Ok(true));
    fixture.0[8].2 = Some(Value::record([("push", vec![f64::NAN, 0.0, 0.0].into())]));
    assert_eq!(expr.observe(&fixture), Ok(false));
    fixture.0[8].2 = None;
    assert_eq!(expr.observe(&fixture), Ok(false));
    assert!(expr.test(&fixture).is_err());
}

#[test]
fn vectors_of_one_frame_are_added_and_subtracted() {
    let at = |frame: &str, components| Value::Vector(Vector { frame: Frame::from(frame), components });
    let mut fixture = fixture();
    fixture.0.push(("here", Type::Vector, Some(at("root", [1.0, 2.0, 3.0]))));
    fixture.0.push(("there", Type::Vector, Some(at("root", [1.0, 5.0, 7.0]))));
    fixture.0.push(("away", Type::Any, Some(at("world", [0.0; 3]))));
    let of = |source: &str| {
        let expr = Expr::compile(source, &fixture).unwrap_or_else(|e| panic!("{source}: {e}"));
        expr.evaluate(&fixture).map_err(|error| error.message)
    };
    assert_eq!(of("norm(there - here)"), Ok(Value::Float(5.0)));
    assert_eq!(of("(there + here).z"), Ok(Value::Float(10.0)));
    let apart = "a vector in the frame `root` and one in `world` do not go together";
    assert_eq!(of("here - away"), Err(apart.into()));
    assert!(Expr::compile("here * 2", &fixture).is_err() && Expr::compile("here - 1", &fixture).is_err());
}

#[test]
fn hostile_expressions_are_refused_in_bounded_time() {
    for source in [
        "(".repeat(4000),
        "1+".repeat(2000) + "1",
        "[".repeat(2000),
        "a.".repeat(2000) + "b",
        "x ? ".repeat(1000),
        "\u{1F600}".repeat(1000),
        "a".repeat(5000),
        "`".to_owned(),
        "'\\u{110000}'".to_owned(),
        "99999999999999999999".to_owned(),
        String::new(),
    ] {
        assert!(Expr::compile(&source, &fixture()).is_err(), "{}", &source[..source.len().min(20)]);
    }
    let kind = |source: &str| Expr::compile(source, &fixture()).unwrap_err().kind;
    let brackets = |depth: usize| "(".repeat(depth) + "1" + &")".repeat(depth);
    assert!(Expr::compile(&brackets(95), &fixture()).is_ok());
    for source in [brackets(96), brackets(1000), "true ? 1 : ".repeat(100) + "1"] {
        assert_eq!(kind(&source), ExprErrorKind::TooLarge, "{source}");
    }
    assert_eq!(kind("("), ExprErrorKind::Syntax);
    let nested = "items.all(a, items.all(b, items.all(c, items.all(d, true))))";
    assert_eq!(kind(nested), ExprErrorKind::TooLarge);
}

#[test]
fn comprehensions_are_bounded() {
    let mut fixture = fixture();
    fixture.0[7].2 = Some(Value::List(vec![Value::Int(1); 200]));
    let expr = Expr::compile("items.all(a, items.all(b, a == b))", &fixture).unwrap();
    assert!(expr.test(&fixture).unwrap_err().message.contains("10000"));
}

mod agreement {
    //! The fast path and the full evaluation agree; and both agree with the interpreter of the crate `cel` where that
    //! gives a value of the same kind.

    use proptest::prelude::*;

    use super::*;

    fn number() -> impl Strategy<Value = String> {
        let leaf = prop_oneof![
            (-20_i64..20).prop_map(|i| if i < 0 { format!("({i})") } else { i.to_string() }),
            Just("n".to_owned()),
            Just("big".to_owned()),
            Just("later".to_owned()),
        ];
        leaf.prop_recursive(4, 24, 2, |inner| {
            let pair = (inner.clone(), prop::sample::select(vec!["+", "-", "*", "/", "%"]), inner.clone());
            prop_oneof![
                4 => pair.prop_map(|(a, op, b)| format!("({a} {op} {b})")),
                1 => inner.prop_map(|a| format!("(-{a})")),
            ]
        })
    }

    fn truth() -> impl Strategy<Value = String> {
        let leaf = prop_oneof![
            4 => (number(), prop::sample::select(vec!["<", "<=", ">", ">=", "==", "!="]), number())
                .prop_map(|(a, op, b)| format!("({a} {op} {b})")),
            1 => prop::sample::select(vec!["true", "false", "active('A')", "flag", "gesture == 'fist'", "x < 2.0", "sqrt(x) > 1.5"])
                .prop_map(|s| format!("({s})")),
        ];
        leaf.prop_recursive(4, 16, 2, |inner| {
            let pair = (inner.clone(), prop::sample::select(vec!["&&", "||", "=="]), inner.clone());
            prop_oneof![
                3 => pair.prop_map(|(a, op, b)| format!("({a} {op} {b})")),
                1 => inner.clone().prop_map(|a| format!("!{a}")),
                1 => (inner.clone(), inner.clone(), inner).prop_map(|(a, b, c)| format!("({a} ? {b} : {c})")),
            ]
        })
    }

    fn context(n: i64, big: i64, flag: bool, x: f64) -> Fixture {
        let mut fixture = fixture();
        fixture.0[0].2 = Some(Value::Int(n));
        fixture.0[1].2 = Some(Value::Float(x));
        fixture.0[6] = ("later", Type::Int, None);
        fixture.0.push(("big", Type::Int, Some(Value::Int(big))));
        fixture.0.push(("flag", Type::Bool, Some(Value::Bool(flag))));
        fixture
    }

    /// The result of the crate's interpreter, if it has one.
    fn oracle(source: &str, n: i64, big: i64, flag: bool) -> Option<cel::Value> {
        let program = cel::Program::compile(source).ok()?;
        let mut context = cel::Context::default();
        context.add_variable("n", n).ok()?;
        context.add_variable("big", big).ok()?;
        context.add_variable("flag", flag).ok()?;
        program.execute(&context).ok()
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 1000, failure_persistence: None, ..ProptestConfig::default() })]

        #[test]
        fn numbers_agree(source in number(), n in -9_i64..9, big in prop_oneof![Just(i64::MAX), Just(i64::MIN), 0_i64..3]) {
            let context = context(n, big, true, 1.0);
            let expr = Expr::compile(&source, &context).unwrap();
            let value = expr.evaluate(&context);
            prop_assert_eq!(&value, &expr.interpret(&context), "{}", source);
            if let Some(cel::Value::Int(expected)) = oracle(&source, n, big, true) {
                prop_assert_eq!(value, Ok(Value::Int(expected)), "{}", source);
            }
        }

        #[test]
        fn truths_agree(source in truth(), n in -9_i64..9, big in 0_i64..3, flag: bool, x in prop_oneof![Just(f64::NAN), 0.0..4.0]) {
            let context = context(n, big, flag, x);
            let expr = Expr::compile(&source, &context).unwrap();
            let value = expr.evaluate(&context);
            prop_assert_eq!(&value, &expr.interpret(&context), "{}", source);
            prop_assert_eq!(value.clone(), expr.test(&context).map(Value::Bool), "{}", source);
            // Its `&&` and `||` evaluate both sides before they fail: the results must agree only where ours has a
            // value.
            if let (Some(cel::Value::Bool(expected)), Ok(value)) = (oracle(&source, n, big, flag), value) {
                prop_assert_eq!(value, Value::Bool(expected), "{}", source);
            }
        }
    }
}

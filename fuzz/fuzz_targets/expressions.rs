//! Any text as an expression: it is refused, or the quick way and the long way agree; it never panics.
#![no_main]

use armarium_values::expr::{Environment, Expr, Slot, Unknown, Unresolved, Variable, World};
use armarium_values::{Type, Value};
use libfuzzer_sys::fuzz_target;

/// A few variables of several types.
struct Fixture(Vec<(&'static str, Type, Option<Value>)>);

impl Environment for Fixture {
    fn variable(&self, path: &[&str]) -> Result<Variable, Unresolved> {
        let at = self.0.iter().position(|(name, ..)| path.first() == Some(name));
        let unknown =
            || Unresolved { kind: Unknown::Name, message: "there is no such name".into(), help: None };
        let at = at.ok_or_else(unknown)?;
        Ok(Variable { slot: Slot::Data(at as u32), ty: self.0[at].1.clone(), used: 1 })
    }
    fn channel(&self, _: &str) -> Result<u32, Unresolved> {
        Ok(0)
    }
    fn state(&self, _: &str) -> Result<u32, Unresolved> {
        Ok(0)
    }
}

impl World for Fixture {
    fn data(&self, slot: u32) -> Option<&Value> {
        self.0.get(slot as usize)?.2.as_ref()
    }
    fn channel(&self, _: u32, _: &[String]) -> Option<Value> {
        None
    }
    fn age(&self, _: u32) -> Option<f64> {
        Some(0.5)
    }
    fn event_name(&self) -> Option<&str> {
        Some("said")
    }
    fn event_data(&self) -> Option<&Value> {
        None
    }
    fn active(&self, _: u32) -> bool {
        true
    }
}

fuzz_target!(|source: &str| {
    let list = Value::List((1..=4).map(Value::Int).collect());
    let fixture = Fixture(vec![
        ("n", Type::Int, Some(Value::Int(7))),
        ("x", Type::FLOAT, Some(Value::Float(2.5))),
        ("flag", Type::Bool, Some(Value::Bool(true))),
        ("word", Type::String, Some("fist".into())),
        ("items", Type::list(Type::Int), Some(list)),
        ("anything", Type::Any, Some(Value::record([("a", Value::Null)]))),
        ("later", Type::FLOAT, None),
    ]);
    let Ok(expr) = Expr::compile(source, &fixture) else { return };
    let (quick, long) = (expr.evaluate(&fixture), expr.interpret(&fixture));
    // By their text, as NaN is not equal to itself.
    assert_eq!(format!("{quick:?}"), format!("{long:?}"), "{source}");
    let _ = expr.observe(&fixture);
});

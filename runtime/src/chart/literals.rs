//! Literals held against their types: numbers that are too large, times without a unit. What is said here needs no other name of
//! a chart; expressions are in `expressions`.

use armarium_source::yaml::{Node, Yaml};
use armarium_source::{Findings, Remedy, Severity, code};
use armarium_values::{ConvertError, Type, Value};

use super::suspicious::is_path;

/// Times without a unit that are longer than this were probably meant in milliseconds, s.
const LONG_S: f64 = 100.0;

/// The literal of a node as a value of a type; `None` where it is none, which is added to `findings`.
pub(super) fn literal(node: &Node, ty: &Type, findings: &mut Findings) -> Option<Value> {
    fitting(node.literal(), node, ty, findings)
}

/// As [`literal`], for the `literal` that was read from `node`.
pub(super) fn fitting(literal: Value, node: &Node, ty: &Type, findings: &mut Findings) -> Option<Value> {
    match ty.convert(literal) {
        Ok(value) if !is_finite(&value) => {
            let help = Some("numbers go up to about 1.8e308".to_owned());
            findings.error_help(code::VALUE, node.span, "this number is too large", help);
            None
        }
        Ok(value) => {
            if let Value::Duration(seconds) = value {
                unit_of_time(node, seconds, findings);
            }
            Some(value)
        }
        Err(ConvertError::NotInEnum { expected, found }) => {
            let message = format!("`{found}` is not one of {}", expected.join(", "));
            let words = expected.iter().map(String::as_str);
            findings.unknown(code::TYPE, (node.span, &found), message, words, None);
            None
        }
        Err(error) => {
            let unit = matches!(error, ConvertError::Unit { .. });
            let is_no_time = *ty == Type::Duration && matches!(error, ConvertError::Type { .. });
            let help = is_no_time.then(|| "a time is a number with its unit: `1.5s`, `200ms`".to_owned());
            let code = if unit { code::UNIT } else { code::TYPE };
            findings.error_help(code, node.span, error.to_string(), help);
            if let Yaml::String(text) = &node.value
                && is_path(text)
            {
                let meant = format!("\"${{{text}}}\"");
                findings.list.last_mut().into_iter().for_each(|error| {
                    error.help = Some(format!("write `{meant}` if its value is meant"));
                });
                findings.remedy(Remedy::replace(node.span, meant));
            }
            None
        }
    }
}

/// Warns of a long time that is written without its unit.
pub(crate) fn unit_of_time(node: &Node, seconds: f64, findings: &mut Findings) {
    let has_unit = matches!(&node.value, Yaml::String(text) if text.trim().parse::<f64>().is_err());
    if seconds > LONG_S && !has_unit {
        let help = format!("write the unit: `{seconds}s`, or `{seconds}ms` if milliseconds are meant");
        let message = format!("this is {seconds} s");
        findings.add(Severity::Warning, code::SUSPICIOUS, node.span, message, Some(help));
        findings.remedy(Remedy::replace(node.span, format!("{seconds}ms")));
    }
}

/// Refuses a time below 0.
pub(super) fn negative_time(node: &Node, findings: &mut Findings) {
    let source = std::sync::Arc::clone(&findings.source);
    let written = source.text.get(node.span.start..node.span.end).unwrap_or("").trim_end();
    let help = Some("times are 0 or more".to_owned());
    findings.error_help(code::VALUE, node.span, format!("`{written}`: a duration is not negative"), help);
    if let Some(positive) = written.strip_prefix('-') {
        findings.remedy(Remedy::replace(node.span, positive));
    }
}

/// Whether all numbers in a value are finite.
fn is_finite(value: &Value) -> bool {
    match value {
        Value::Float(x) | Value::Duration(x) => x.is_finite(),
        Value::List(items) => items.iter().all(is_finite),
        Value::Map(fields) => fields.values().all(is_finite),
        _ => true,
    }
}

//! Physical units: symbols are parsed once, values are kept in SI. The radian counts as a base unit, so that `deg/s`
//! and `Hz` are different.

use std::fmt;

use serde::{Deserialize, Serialize};

/// A coherent SI unit, as exponents of metre, kilogram, second, radian and ampere.
///
/// Written as a list of these numbers; the last one is left out where it is 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(into = "Vec<i8>", try_from = "Vec<i8>")]
pub struct Unit([i8; 5]);

impl From<Unit> for Vec<i8> {
    fn from(unit: Unit) -> Self {
        let used = if unit.0[4] == 0 { 4 } else { 5 };
        unit.0[..used].to_vec()
    }
}

/// A list of exponents that is no unit.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a unit is the exponents of m, kg, s, rad and A: 4 or 5 numbers, not {found}")]
pub struct UnitExponents {
    /// How many numbers there are.
    pub found: usize,
}

impl TryFrom<Vec<i8>> for Unit {
    type Error = UnitExponents;

    fn try_from(exponents: Vec<i8>) -> Result<Self, UnitExponents> {
        match exponents[..] {
            [m, kg, s, rad] => Ok(Self([m, kg, s, rad, 0])),
            [m, kg, s, rad, a] => Ok(Self([m, kg, s, rad, a])),
            _ => Err(UnitExponents { found: exponents.len() }),
        }
    }
}

/// An unknown unit symbol.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{symbol}` is not a unit that is known here; units look like `N`, `mm`, `m/s`, `deg/s`, `N/m`")]
pub struct UnknownUnit {
    /// The symbol as written.
    pub symbol: String,
}

/// Symbols with their unit and the factor to SI.
const ATOMS: &[(&str, [i8; 5], f64)] = &[
    ("m", [1, 0, 0, 0, 0], 1.0),
    ("km", [1, 0, 0, 0, 0], 1e3),
    ("cm", [1, 0, 0, 0, 0], 1e-2),
    ("mm", [1, 0, 0, 0, 0], 1e-3),
    ("um", [1, 0, 0, 0, 0], 1e-6),
    ("µm", [1, 0, 0, 0, 0], 1e-6),
    ("kg", [0, 1, 0, 0, 0], 1.0),
    ("g", [0, 1, 0, 0, 0], 1e-3),
    ("s", [0, 0, 1, 0, 0], 1.0),
    ("ms", [0, 0, 1, 0, 0], 1e-3),
    ("us", [0, 0, 1, 0, 0], 1e-6),
    ("µs", [0, 0, 1, 0, 0], 1e-6),
    ("min", [0, 0, 1, 0, 0], 60.0),
    ("h", [0, 0, 1, 0, 0], 3600.0),
    ("rad", [0, 0, 0, 1, 0], 1.0),
    ("mrad", [0, 0, 0, 1, 0], 1e-3),
    ("deg", [0, 0, 0, 1, 0], std::f64::consts::PI / 180.0),
    ("°", [0, 0, 0, 1, 0], std::f64::consts::PI / 180.0),
    ("Hz", [0, 0, -1, 0, 0], 1.0),
    ("kHz", [0, 0, -1, 0, 0], 1e3),
    ("N", [1, 1, -2, 0, 0], 1.0),
    ("mN", [1, 1, -2, 0, 0], 1e-3),
    ("kN", [1, 1, -2, 0, 0], 1e3),
    ("Nm", [2, 1, -2, 0, 0], 1.0),
    ("J", [2, 1, -2, 0, 0], 1.0),
    ("W", [2, 1, -3, 0, 0], 1.0),
    ("V", [2, 1, -3, 0, -1], 1.0),
    ("mV", [2, 1, -3, 0, -1], 1e-3),
    ("A", [0, 0, 0, 0, 1], 1.0),
    ("mA", [0, 0, 0, 0, 1], 1e-3),
    ("Ah", [0, 0, 1, 0, 1], 3600.0),
    ("mAh", [0, 0, 1, 0, 1], 3.6),
    ("Pa", [-1, 1, -2, 0, 0], 1.0),
    ("kPa", [-1, 1, -2, 0, 0], 1e3),
    ("1", [0, 0, 0, 0, 0], 1.0),
    ("%", [0, 0, 0, 0, 0], 1e-2),
];

/// The symbol with which each unit is printed.
const NAMES: &[([i8; 5], &str)] = &[
    ([0, 0, 0, 0, 0], "1"),
    ([1, 0, 0, 0, 0], "m"),
    ([0, 1, 0, 0, 0], "kg"),
    ([0, 0, 1, 0, 0], "s"),
    ([0, 0, 0, 1, 0], "rad"),
    ([0, 0, -1, 0, 0], "Hz"),
    ([1, 0, -1, 0, 0], "m/s"),
    ([1, 0, -2, 0, 0], "m/s^2"),
    ([0, 0, -1, 1, 0], "rad/s"),
    ([1, 1, -2, 0, 0], "N"),
    ([2, 1, -2, 0, 0], "N m"),
    ([0, 1, -2, 0, 0], "N/m"),
    ([0, 1, -1, 0, 0], "N s/m"),
    ([2, 1, -3, 0, 0], "W"),
    ([2, 1, -3, 0, -1], "V"),
    ([0, 0, 0, 0, 1], "A"),
    ([-1, 1, -2, 0, 0], "Pa"),
];

impl Unit {
    /// No unit: a ratio or a count.
    pub const ONE: Self = Self([0, 0, 0, 0, 0]);
    /// Metre.
    pub const M: Self = Self([1, 0, 0, 0, 0]);
    /// Kilogram.
    pub const KG: Self = Self([0, 1, 0, 0, 0]);
    /// Second.
    pub const S: Self = Self([0, 0, 1, 0, 0]);
    /// Radian.
    pub const RAD: Self = Self([0, 0, 0, 1, 0]);
    /// Radians a second.
    pub const RAD_S: Self = Self([0, 0, -1, 1, 0]);
    /// Hertz.
    pub const HZ: Self = Self([0, 0, -1, 0, 0]);
    /// Metre per second.
    pub const M_S: Self = Self([1, 0, -1, 0, 0]);
    /// Newton.
    pub const N: Self = Self([1, 1, -2, 0, 0]);
    /// Newton metre.
    pub const NM: Self = Self([2, 1, -2, 0, 0]);
    /// Newton per metre.
    pub const N_M: Self = Self([0, 1, -2, 0, 0]);

    /// The symbols of single units; products and quotients of them are units, too.
    pub fn symbols() -> impl Iterator<Item = &'static str> {
        ATOMS.iter().map(|(symbol, ..)| *symbol)
    }

    /// Parses a symbol such as `N`, `mm`, `m/s^2` or `N m`; returns the SI unit and the factor to it.
    ///
    /// # Errors
    /// [`UnknownUnit`] when a part of the symbol is unknown.
    pub fn parse(symbol: &str) -> Result<(Self, f64), UnknownUnit> {
        let unknown = || UnknownUnit { symbol: symbol.trim().to_owned() };
        let (mut dims, mut factor) = ([0_i8; 5], 1.0);
        let (mut sign, mut atom, mut any) = (1_i32, String::new(), false);
        for c in symbol.trim().chars().chain(std::iter::once(' ')) {
            if !matches!(c, '/' | '*' | '·' | ' ') {
                atom.push(c);
                continue;
            }
            if !atom.is_empty() {
                let (d, f, power) = parse_atom(&atom).ok_or_else(unknown)?;
                for (to, from) in dims.iter_mut().zip(d) {
                    let sum = i32::from(*to) + i32::from(from) * power * sign;
                    *to = i8::try_from(sum).map_err(|_| unknown())?;
                }
                factor *= f.powi(power * sign);
                (sign, any) = (1, true);
                atom.clear();
            }
            if c == '/' {
                if !any || sign < 0 {
                    return Err(unknown());
                }
                sign = -1;
            }
        }
        if any && sign > 0 { Ok((Self(dims), factor)) } else { Err(unknown()) }
    }

    /// The unit of a product, if it is determined; with angles it is not (an arc is a length).
    #[must_use]
    pub fn times(self, other: Self) -> Option<Self> {
        self.combine(other, 1)
    }

    /// The unit of a quotient, if it is determined.
    #[must_use]
    pub fn per(self, other: Self) -> Option<Self> {
        self.combine(other, -1)
    }

    fn combine(self, other: Self, sign: i8) -> Option<Self> {
        if self.0[3] != 0 || other.0[3] != 0 {
            return None;
        }
        let mut dims = self.0;
        for (to, from) in dims.iter_mut().zip(other.0) {
            *to = to.checked_add(from.checked_mul(sign)?)?;
        }
        Some(Self(dims))
    }
}

fn parse_atom(text: &str) -> Option<([i8; 5], f64, i32)> {
    let (symbol, power) = if let Some((symbol, power)) = text.split_once('^') {
        (symbol, power.parse::<i32>().ok().filter(|p| (-9..=9).contains(p))?)
    } else if let Some(symbol) = text.strip_suffix('²') {
        (symbol, 2)
    } else if let Some(symbol) = text.strip_suffix('³') {
        (symbol, 3)
    } else {
        (text, 1)
    };
    ATOMS.iter().find(|(name, ..)| *name == symbol).map(|(_, dims, factor)| (*dims, *factor, power))
}

impl fmt::Display for Unit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some((_, name)) = NAMES.iter().find(|(dims, _)| *dims == self.0) {
            return f.write_str(name);
        }
        let mut first = true;
        for (name, power) in ["m", "kg", "s", "rad", "A"].iter().zip(self.0).filter(|(_, p)| *p != 0) {
            if !first {
                f.write_str(" ")?;
            }
            first = false;
            if power == 1 { f.write_str(name)? } else { write!(f, "{name}^{power}")? }
        }
        Ok(())
    }
}

/// Parses a number with a unit, such as `40 N`, `0.4 m/s` or `100ms`, and converts it to SI. `None` when the text
/// does not begin with a number; a number alone has no unit.
///
/// # Errors
/// [`UnknownUnit`] when a number is followed by text that is not a unit.
pub fn parse_quantity(text: &str) -> Option<Result<(f64, Option<Unit>), UnknownUnit>> {
    let (number, symbol) = split_quantity(text)?;
    if symbol.is_empty() {
        return Some(Ok((number, None)));
    }
    Some(Unit::parse(symbol).map(|(unit, factor)| (number * factor, Some(unit))))
}

/// The number that a text begins with and the unit's symbol after it, as they are written; the symbol may be empty.
pub fn split_quantity(text: &str) -> Option<(f64, &str)> {
    let text = text.trim();
    let (number, symbol) = text.split_at(number_prefix(text)?);
    Some((number.parse().ok()?, symbol.trim()))
}

/// The length of the longest prefix that is a decimal number.
fn number_prefix(text: &str) -> Option<usize> {
    let bytes = text.as_bytes();
    let digits = |mut i: usize| {
        while bytes.get(i).is_some_and(u8::is_ascii_digit) {
            i += 1;
        }
        i
    };
    let start = usize::from(matches!(bytes.first(), Some(b'+' | b'-')));
    let mut end = digits(start);
    let mut any = end > start;
    if bytes.get(end) == Some(&b'.') {
        let after = digits(end + 1);
        any |= after > end + 1;
        end = after;
    }
    if any && matches!(bytes.get(end), Some(b'e' | b'E')) {
        let sign = usize::from(matches!(bytes.get(end + 1), Some(b'+' | b'-')));
        let after = digits(end + 1 + sign);
        if after > end + 1 + sign {
            end = after;
        }
    }
    any.then_some(end)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn si(text: &str) -> (f64, String) {
        let (value, unit) = parse_quantity(text).unwrap().unwrap();
        (value, unit.map_or_else(String::new, |u| u.to_string()))
    }

    #[test]
    fn quantities_become_si() {
        for (text, value, unit) in [
            ("40 N", 40.0, "N"),
            ("15 mm", 0.015, "m"),
            ("0.4 m/s", 0.4, "m/s"),
            ("60s", 60.0, "s"),
            ("100ms", 0.1, "s"),
            ("-2.5e1 cm", -0.25, "m"),
            ("180 deg", std::f64::consts::PI, "rad"),
            ("9.81 m/s^2", 9.81, "m/s^2"),
            ("2 N/mm", 2000.0, "N/m"),
            ("3 N m", 3.0, "N m"),
            ("11.8 V", 11.8, "V"),
            ("2 V A", 2.0, "W"),
            ("500 mAh", 1800.0, "s A"),
            ("7", 7.0, ""),
        ] {
            let (got, got_unit) = si(text);
            assert!((got - value).abs() <= 1e-12 * value.abs(), "{text}: {got}");
            assert_eq!(got_unit, unit, "{text}");
        }
    }

    #[test]
    fn a_unit_is_written_with_the_exponents_that_it_needs() {
        for (symbol, written) in [("N", "[1,1,-2,0]"), ("rad/s", "[0,0,-1,1]"), ("V", "[2,1,-3,0,-1]")] {
            let (unit, _) = Unit::parse(symbol).unwrap();
            assert_eq!(serde_json::to_string(&unit).unwrap(), written);
            assert_eq!(serde_json::from_str::<Unit>(written).unwrap(), unit);
        }
        assert!(serde_json::from_str::<Unit>("[1,2,3]").is_err());
    }

    #[test]
    fn what_is_no_unit_is_refused() {
        assert!(parse_quantity("fast").is_none());
        for text in ["4 parsec", "4 /s", "4 m//s", "4 m/", "4 m^99"] {
            assert!(parse_quantity(text).unwrap().is_err(), "{text}");
        }
    }
}

//! The attributes of an instance: values by name, stored compactly.
//!
//! A memory holds a million of these, most of them with one to five values. A sorted slice takes a tenth of the bytes
//! of a tree. Attributes are immutable; [`Attributes::to_map`] returns a map that can be edited.

use std::collections::BTreeMap;
use std::fmt;

use armarium_values::Value;

/// Values by name, ordered by name.
#[derive(Clone, Default, PartialEq)]
pub struct Attributes(Box<[(Box<str>, Value)]>);

impl Attributes {
    /// The value of that name.
    pub fn get(&self, name: &str) -> Option<&Value> {
        let at = self.0.binary_search_by(|(n, _)| (**n).cmp(name)).ok()?;
        self.0.get(at).map(|(_, value)| value)
    }

    /// All names with their values, ordered by name.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = (&str, &Value)> {
        self.0.iter().map(|(name, value)| (&**name, value))
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// A copy as a map.
    pub fn to_map(&self) -> BTreeMap<String, Value> {
        self.iter().map(|(name, value)| (name.to_owned(), value.clone())).collect()
    }

    /// A copy with one value added or replaced.
    pub fn with(&self, name: &str, value: Value) -> Self {
        let mut map = self.to_map();
        map.insert(name.to_owned(), value);
        map.into()
    }

    /// From pairs in any order; the later of two with one name wins.
    pub fn from_pairs(mut pairs: Vec<(Box<str>, Value)>) -> Self {
        if !pairs.is_sorted_by(|a, b| a.0 < b.0) {
            let map: BTreeMap<Box<str>, Value> = pairs.into_iter().collect();
            pairs = map.into_iter().collect();
        }
        Self(pairs.into_boxed_slice())
    }
}

/// A map of the fields that have a value.
pub fn fields<const N: usize>(fields: [(&str, Option<Value>); N]) -> BTreeMap<String, Value> {
    fields.into_iter().filter_map(|(name, value)| Some((name.to_owned(), value?))).collect()
}

impl From<BTreeMap<String, Value>> for Attributes {
    fn from(map: BTreeMap<String, Value>) -> Self {
        Self(map.into_iter().map(|(name, value)| (name.into_boxed_str(), value)).collect())
    }
}

impl<const N: usize> From<[(&str, Value); N]> for Attributes {
    fn from(pairs: [(&str, Value); N]) -> Self {
        Self::from_pairs(pairs.into_iter().map(|(name, value)| (name.into(), value)).collect())
    }
}

impl fmt::Debug for Attributes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_map().entries(self.iter()).finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn they_are_a_map_ordered_by_name() {
        let attributes = Attributes::from([("b", Value::Int(2)), ("a", Value::Int(1)), ("b", Value::Int(3))]);
        assert_eq!(attributes.get("b"), Some(&Value::Int(3)));
        assert_eq!(attributes.get("c"), None);
        assert_eq!(attributes.iter().map(|(n, _)| n).collect::<Vec<_>>(), ["a", "b"]);
        assert_eq!(Attributes::from(attributes.to_map()), attributes);
        assert_eq!(attributes.with("c", Value::Null).len(), 3);
        let bytes = armarium_bus::encode(&attributes).unwrap();
        assert_eq!(bytes, armarium_bus::encode(&attributes.to_map()).unwrap());
        assert_eq!(armarium_bus::decode::<Attributes>(&bytes).unwrap(), attributes);
    }
}

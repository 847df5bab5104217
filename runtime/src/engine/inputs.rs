//! The inputs of a chart: given values, then the profile's, then the defaults.

use std::collections::BTreeMap;

use armarium_values::Value;

use crate::program::Program;
use crate::skill::{self, InputError};

pub(super) fn inputs(
    program: &Program,
    given: &BTreeMap<String, Value>,
    profile: Option<&str>,
) -> Result<BTreeMap<String, Value>, InputError> {
    let mut values = match profile {
        None => BTreeMap::new(),
        Some(name) => program.profiles.get(name).cloned().ok_or_else(|| InputError::Profile {
            name: name.to_owned(),
            known: program.profiles.keys().cloned().collect::<Vec<_>>().join(", "),
        })?,
    };
    values.extend(given.clone());
    skill::inputs(program.instances[0].inputs.iter().map(|v| &v.declaration), values)
}

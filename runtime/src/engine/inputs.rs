//! What a chart is started with: given values, then the profile's, then the defaults.

use std::collections::BTreeMap;

use armarium_values::Value;

use super::InputError;
use crate::finding::suggest;
use crate::program::{Program, Variable};

pub(super) fn inputs(
    program: &Program,
    given: &BTreeMap<String, Value>,
    profile: Option<&str>,
) -> Result<Vec<Value>, InputError> {
    let variables = &program.instances[0].inputs;
    let nothing = BTreeMap::new();
    let profile = match profile {
        None => &nothing,
        Some(name) => program.profiles.get(name).ok_or_else(|| InputError::Profile {
            name: name.to_owned(),
            known: program.profiles.keys().cloned().collect::<Vec<_>>().join(", "),
        })?,
    };
    let names = || variables.iter().map(|v| v.declaration.name.as_str());
    if let Some(name) = given.keys().find(|name| !names().any(|known| known == *name)) {
        let help = suggest(name, names());
        return Err(InputError::Unknown { name: name.clone(), help });
    }
    let one = |variable: &Variable| {
        let name = &variable.declaration.name;
        let value = given.get(name).or_else(|| profile.get(name)).cloned();
        match value {
            None => variable.declaration.default.clone().ok_or(InputError::Missing { name: name.clone() }),
            Some(value) => variable
                .declaration
                .accept(value)
                .map_err(|error| InputError::Value { name: name.clone(), message: error.to_string() }),
        }
    };
    variables.iter().map(one).collect()
}

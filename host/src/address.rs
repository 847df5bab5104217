//! How something that an agent offers is named on a command line: `AGENT/NAME`.

/// What an agent offers under a name: images, a driver.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Address {
    /// The agent that offers it.
    pub agent: String,
    /// Its name there.
    pub name: String,
}

/// Text that is no address.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("write it as AGENT/NAME, for instance bob/alice")]
pub struct AddressError;

impl std::str::FromStr for Address {
    type Err = AddressError;

    fn from_str(text: &str) -> Result<Self, AddressError> {
        match text.split('/').collect::<Vec<_>>().as_slice() {
            [agent, name] if !agent.is_empty() && !name.is_empty() => {
                Ok(Self { agent: (*agent).into(), name: (*name).into() })
            }
            _ => Err(AddressError),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_an_agent_and_a_name() {
        let address = Address { agent: "bob".into(), name: "alice".into() };
        assert_eq!("bob/alice".parse(), Ok(address));
        for wrong in ["bob", "/alice", "bob/", "a/b/c"] {
            assert!(wrong.parse::<Address>().is_err(), "{wrong}");
        }
    }
}

//! How values are encoded on their way into long-term memory, possibly with loss: images as JPEG files, for instance.
//! It knows no codec: a room that knows both images and memory supplies the function.

use std::fmt;
use std::sync::Arc;

use armarium_values::Value;

use crate::attributes::Attributes;
use crate::entity::{Instance, Snapshot};

/// Encodes one attribute; `None` leaves it unchanged.
type Code = Arc<dyn Fn(&Value) -> Option<Value> + Send + Sync>;

/// A codec for attributes in long-term memory. Working memory holds them unchanged; what is read from long-term
/// memory is encoded.
#[derive(Clone)]
pub struct Coding {
    name: String,
    code: Code,
}

impl Coding {
    /// `code` returns the stored form of an attribute, or `None` to leave it unchanged. Equal values must give equal
    /// bytes every time.
    pub fn new(name: &str, code: impl Fn(&Value) -> Option<Value> + Send + Sync + 'static) -> Self {
        Self { name: name.into(), code: Arc::new(code) }
    }

    /// The snapshot as it is stored.
    pub(super) fn of(&self, snapshot: &Arc<Snapshot>) -> Arc<Snapshot> {
        let mut is_changed = false;
        let mut coded = |(name, value): (&str, &Value)| {
            let new = (self.code)(value);
            is_changed |= new.is_some();
            (name.into(), new.unwrap_or_else(|| value.clone()))
        };
        let instance = |instance: &Instance| Instance {
            attributes: Attributes::from_pairs(instance.attributes.iter().map(&mut coded).collect()),
            confidence: instance.confidence,
            covariance: instance.covariance.clone(),
        };
        let instances = snapshot.instances.iter().map(instance).collect();
        if !is_changed {
            return Arc::clone(snapshot);
        }
        // Field by field, because a clone of the whole would copy the values that are replaced.
        Arc::new(Snapshot {
            id: snapshot.id.clone(),
            version: snapshot.version,
            referenced_ns: snapshot.referenced_ns,
            sent_ns: snapshot.sent_ns,
            arrived_ns: snapshot.arrived_ns,
            instances,
        })
    }
}

/// Codings are compared by name.
impl PartialEq for Coding {
    fn eq(&self, other: &Self) -> bool {
        self.name == other.name
    }
}

impl fmt::Debug for Coding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Coding").field(&self.name).finish()
    }
}

//! How values are coded on their way into long-term memory, with loss where that is wanted: images as JPEG files, for
//! instance. Knows no code itself: whoever knows both images and memory gives the function.

use std::fmt;
use std::sync::Arc;

use armarium_values::Value;

use crate::attributes::Attributes;
use crate::entity::{Instance, Snapshot};

/// Codes one attribute; `None` leaves it as it is.
type Code = Arc<dyn Fn(&Value) -> Option<Value> + Send + Sync>;

/// A way to code attributes before they are kept. Working memory holds them as they came; what comes back out of
/// long-term memory is coded.
#[derive(Clone)]
pub struct Coding {
    name: String,
    code: Code,
}

impl Coding {
    /// `code` gives what an attribute is kept as, or `None` for what it leaves as it is. The same value has to become the
    /// same bytes every time.
    pub fn new(name: &str, code: impl Fn(&Value) -> Option<Value> + Send + Sync + 'static) -> Self {
        Self { name: name.into(), code: Arc::new(code) }
    }

    /// The snapshot as it is kept.
    pub(super) fn of(&self, snapshot: &Arc<Snapshot>) -> Arc<Snapshot> {
        let mut is_changed = false;
        let mut coded = |(name, value): (&str, &Value)| {
            let new = (self.code)(value);
            is_changed |= new.is_some();
            (name.into(), new.unwrap_or_else(|| value.clone()))
        };
        let instances = snapshot.instances.iter().map(|instance| Instance {
            attributes: Attributes::from_pairs(instance.attributes.iter().map(&mut coded).collect()),
            confidence: instance.confidence,
            covariance: instance.covariance.clone(),
        });
        let instances = instances.collect();
        if !is_changed {
            return Arc::clone(snapshot);
        }
        // Field by field: to copy the whole would copy what is replaced.
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

/// Codings are told apart by their names.
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

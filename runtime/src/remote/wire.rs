//! The messages between the agent that starts a skill and the one that offers it.
//!
//! All are queries on the key `{agent}/chart/{Name}`; the schema in the payload's encoding tells them apart. A
//! query without payload is answered by the [`Manifest`]; [`Start`], [`Poll`] and [`Cancel`] are answered by a
//! [`Status`], or refused with a [`Refusal`]. [`EventMessage`] carries an event to an agent's charts, on
//! `{agent}/event`, and is answered by [`EventReceipt`].

use std::collections::BTreeMap;
use std::time::Duration;

use armarium_bus::{Payload, Reply, Schema, codec};
use armarium_values::{Type, Value};
use serde::{Deserialize, Serialize};

use crate::skill::{DeclaredAt, Failure, Limits, Outcome, Parameter, SkillManifest, SkillResult};

/// What an agent offers under one name.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// The name, without the agent's.
    pub name: String,
    /// Id of the process that offers it; a new one each time an agent is started.
    pub instance: String,
    /// Fingerprint of this manifest; it changes when anything in it changes.
    pub version: String,
    /// For people.
    #[serde(default)]
    pub description: String,
    /// Inputs.
    #[serde(default)]
    pub inputs: Vec<WireParameter>,
    /// Outputs with its outcome.
    #[serde(default)]
    pub outputs: Vec<WireParameter>,
    /// Outcomes beyond `success` and `failure`.
    #[serde(default)]
    pub outcomes: Vec<String>,
    /// Events that it raises while it runs.
    #[serde(default)]
    pub events: Vec<String>,
    /// Limbs that it commands; limbs of the agent that offers it.
    #[serde(default)]
    pub limbs: Vec<String>,
    /// Limbs that it commands by the value of an input: for each such input, the limbs that each of its values names.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub limbs_by_input: BTreeMap<String, BTreeMap<String, Vec<String>>>,
    /// How long it may take to return after a cancel, s; 1 if it does not say.
    #[serde(default = "usual_grace_s")]
    pub grace_s: f64,
}

/// An input or output.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct WireParameter {
    /// Its name.
    pub name: String,
    /// Its type.
    #[serde(rename = "type")]
    pub ty: Type,
    /// Value of an input that is not given; `None` for a required input.
    #[serde(default)]
    pub default: Option<Value>,
    /// Smallest number that is allowed, SI.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub minimum: Option<f64>,
    /// Largest number that is allowed, SI.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub maximum: Option<f64>,
    /// For people.
    #[serde(default)]
    pub description: String,
}

impl From<&Parameter> for WireParameter {
    fn from(parameter: &Parameter) -> Self {
        // Names are known where the skill is: another agent has other ones.
        let Parameter { name, ty, default, minimum, maximum, names: _, description } = parameter.clone();
        Self { name, ty, default, minimum, maximum, description }
    }
}

impl From<&WireParameter> for Parameter {
    fn from(parameter: &WireParameter) -> Self {
        let WireParameter { name, ty, default, minimum, maximum, description } = parameter.clone();
        Self { name, ty, default, minimum, maximum, names: None, description }
    }
}

/// Starts a skill or chart.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Start {
    /// The caller's unique id of this call.
    pub call: String,
    /// Id of the process that is addressed, from the manifest. Other processes do not answer.
    pub instance: String,
    /// The version that the caller has checked its chart against.
    pub version: String,
    /// Who calls, for people.
    #[serde(default)]
    pub caller: String,
    /// The inputs by name.
    #[serde(default)]
    pub inputs: BTreeMap<String, Value>,
    /// Largest wrist force that the caller's chart allows, N.
    #[serde(default)]
    pub force_n: Option<f64>,
    /// Largest TCP speed that the caller's chart allows, m/s.
    #[serde(default)]
    pub speed_m_s: Option<f64>,
}

/// Asks for what is new, and renews the caller's lease.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Poll {
    /// Id of the call.
    pub call: String,
    /// The newest revision that the caller has received.
    #[serde(default)]
    pub seen: u64,
    /// How long the answer may be delayed while nothing is new, s.
    #[serde(default)]
    pub wait_s: f64,
}

/// Cancels a call. The caller continues to poll until the call has ended.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Cancel {
    /// Id of the call.
    pub call: String,
    /// Why, for people.
    #[serde(default)]
    pub reason: String,
}

/// The state of a call.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Status {
    /// Increases with each change.
    #[serde(default)]
    pub revision: u64,
    /// The innermost active states of a chart, in its order.
    #[serde(default)]
    pub leaves: Vec<String>,
    /// The events that were raised after the revision that the caller has received.
    #[serde(default)]
    pub events: Vec<RaisedEvent>,
    /// Number of events dropped so far because the queue was full.
    #[serde(default)]
    pub dropped: u64,
    /// How it ended, once it has.
    #[serde(default)]
    pub ended: Option<Ended>,
}

/// An event that a skill has raised.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RaisedEvent {
    /// The revision in which it was raised.
    pub revision: u64,
    /// Its name.
    pub name: String,
    /// What comes with it.
    #[serde(default)]
    pub data: Value,
}

/// How a call ended.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Ended {
    /// `success`, `failure`, or one of the manifest's outcomes.
    pub outcome: String,
    /// Why, for a failure.
    #[serde(default)]
    pub reason: Option<String>,
    /// Outputs by name.
    #[serde(default)]
    pub outputs: BTreeMap<String, Value>,
}

/// Sends an event to the charts of an agent.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EventMessage {
    /// The sender's unique id of this event.
    #[serde(alias = "letter")]
    pub id: String,
    /// Who sends it, for people.
    #[serde(default)]
    pub caller: String,
    /// The chart that receives it; `None` for all running charts.
    #[serde(default)]
    pub chart: Option<String>,
    /// The event's name.
    pub name: String,
    /// What comes with it.
    #[serde(default)]
    pub data: Value,
}

/// The receipt of an event.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EventReceipt {
    /// How many charts received it.
    pub charts: u32,
    /// Why it changed nothing, where none of them took it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dropped: Option<String>,
    /// The process that answers.
    #[serde(default)]
    pub instance: String,
}

/// Why a query is refused.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Refusal {
    /// One sentence for the user.
    pub reason: String,
}

impl Payload for Manifest {
    const SCHEMA: Schema = Schema::new("runtime/manifest", 1);
}
impl Payload for Start {
    const SCHEMA: Schema = Schema::new("runtime/start", 1);
}
impl Payload for Poll {
    const SCHEMA: Schema = Schema::new("runtime/poll", 1);
}
impl Payload for Cancel {
    const SCHEMA: Schema = Schema::new("runtime/cancel", 1);
}
impl Payload for Status {
    const SCHEMA: Schema = Schema::new("runtime/status", 1);
}
impl Payload for EventMessage {
    const SCHEMA: Schema = Schema::new("runtime/event", 1);
}
impl Payload for EventReceipt {
    const SCHEMA: Schema = Schema::new("runtime/receipt", 1);
}
impl Payload for Refusal {
    const SCHEMA: Schema = Schema::new("runtime/refusal", 1);
}

/// The schema of a receipt as earlier versions name it.
const EARLIER_RECEIPT: Schema = Schema::new("runtime/heard", 1);

fn usual_grace_s() -> f64 {
    SkillManifest::new("", "").grace.as_secs_f64()
}

/// Bounds of a message that is read: size in bytes, number of items, depth of nesting.
const BOUNDS: codec::Bounds = codec::Bounds { bytes: 4 << 20, items: 200_000, depth: 40 };

/// Why there is no message.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum MessageError {
    /// It cannot be encoded; or it is another message, of another version, or invalid.
    #[error(transparent)]
    Codec(#[from] codec::CodecError),
    /// The other side refuses, for this reason.
    #[error("{reason}")]
    Refused {
        /// One sentence for the user.
        reason: String,
    },
}

/// Encodes a message. Returns the encoding, which names the schema, and the bytes.
///
/// # Errors
/// [`MessageError::Codec`].
pub fn packed<P: Payload>(message: &P) -> Result<(String, Vec<u8>), MessageError> {
    Ok((P::SCHEMA.encoding(), codec::encode(message)?))
}

/// Decodes a message of the expected schema.
///
/// # Errors
/// [`MessageError::Codec`]: another schema, another version, or invalid bytes.
pub fn unpacked<P: Payload>(encoding: &str, bytes: &[u8]) -> Result<P, MessageError> {
    let earlier = P::SCHEMA == EventReceipt::SCHEMA && EARLIER_RECEIPT.check(encoding).is_ok();
    if !earlier {
        P::SCHEMA.check(encoding)?;
    }
    Ok(codec::decode_within(bytes, BOUNDS)?)
}

/// Reads an answer: the message, or why there is none. `None` if it only says that nobody answered (an error of
/// Zenoh's own).
pub fn answered<P: Payload>(answer: &Reply) -> Option<Result<P, MessageError>> {
    match answer {
        Reply::Message(message) => Some(unpacked(&message.encoding, &message.payload)),
        Reply::Refusal { encoding, payload } if encoding.starts_with("application/cbor;") => {
            Some(Err(match unpacked::<Refusal>(encoding, payload) {
                Ok(Refusal { reason }) => {
                    MessageError::Refused { reason: reason.chars().take(1000).collect() }
                }
                Err(error) => error,
            }))
        }
        Reply::Refusal { .. } => None,
    }
}

impl Manifest {
    /// The manifest of a skill that a process offers.
    pub fn of(skill: &SkillManifest, instance: &str) -> Self {
        let mut manifest = Self {
            name: skill.name.clone(),
            instance: String::new(),
            version: String::new(),
            description: skill.description.clone(),
            inputs: skill.inputs.iter().map(WireParameter::from).collect(),
            outputs: skill.outputs.iter().map(WireParameter::from).collect(),
            outcomes: skill.outcomes.clone(),
            events: skill.events.clone(),
            limbs: skill.limbs.clone(),
            limbs_by_input: skill.limbs_by_input.clone(),
            grace_s: skill.grace.as_secs_f64(),
        };
        // If CBOR cannot encode it, it cannot be offered either; sending the manifest then reports the error.
        manifest.version = fingerprint(&codec::encode(&manifest).unwrap_or_default());
        instance.clone_into(&mut manifest.instance);
        manifest
    }

    /// The skill's manifest in a chart that calls it `name`. `beyond` is added to the grace.
    pub fn skill(&self, name: &str, beyond: Duration) -> SkillManifest {
        let grace = Duration::try_from_secs_f64(self.grace_s).unwrap_or_default();
        let mut skill = SkillManifest::new(name, &self.description).grace(grace.min(MAX_GRACE) + beyond);
        skill.declared_at = DeclaredAt::default();
        skill.inputs = self.inputs.iter().map(Parameter::from).collect();
        skill.outputs = self.outputs.iter().map(Parameter::from).collect();
        skill.outcomes.clone_from(&self.outcomes);
        skill.events.clone_from(&self.events);
        let agent = name.split('/').next().unwrap_or_default();
        let of_agent = |limbs: &mut Vec<String>| {
            limbs.iter_mut().for_each(|limb| *limb = format!("{agent}/{limb}"));
        };
        (skill.limbs, skill.limbs_by_input) = (self.limbs.clone(), self.limbs_by_input.clone());
        of_agent(&mut skill.limbs);
        skill.limbs_by_input.values_mut().flat_map(BTreeMap::values_mut).for_each(of_agent);
        skill
    }
}

/// Upper bound on the grace in a received manifest.
const MAX_GRACE: Duration = Duration::from_secs(60);

/// FNV-1a with 64 bits, as hexadecimal digits. It distinguishes versions and is no protection against tampering.
fn fingerprint(bytes: &[u8]) -> String {
    let step = |hash: u64, byte: &u8| (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3);
    format!("{:016x}", bytes.iter().fold(0xcbf2_9ce4_8422_2325, step))
}

impl Start {
    /// The bounds of the caller's chart.
    pub fn limits(&self) -> Limits {
        Limits { force_n: self.force_n, speed_m_s: self.speed_m_s }
    }
}

impl From<SkillResult> for Ended {
    fn from(result: SkillResult) -> Self {
        match result {
            Ok(outcome) => Self { outcome: outcome.name, reason: None, outputs: outcome.outputs },
            Err(failure) => {
                Self { outcome: "failure".into(), reason: Some(failure.reason), outputs: BTreeMap::new() }
            }
        }
    }
}

impl From<Ended> for SkillResult {
    fn from(ended: Ended) -> Self {
        if ended.outcome == "failure" {
            let reason = ended.reason.unwrap_or_else(|| "it failed without saying why".into());
            return Err(Failure::new(reason));
        }
        Ok(Outcome { name: ended.outcome, outputs: ended.outputs })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_version_tells_declarations_apart_and_not_processes() {
        let skill = SkillManifest::new("S", "Acts.").input("x", Type::Int, "Any.");
        let one = Manifest::of(&skill, "p1");
        assert_eq!(one.version, Manifest::of(&skill, "p2").version);
        assert_ne!(one.version, Manifest::of(&skill.clone().outcome("odd"), "p1").version);
        let back: Manifest = {
            let (encoding, bytes) = packed(&one).unwrap();
            unpacked(&encoding, &bytes).unwrap()
        };
        assert_eq!(back, one);
        assert_eq!(back.skill("bob/S", Duration::ZERO).inputs, skill.inputs);
        // The offset basis and one step of FNV-1a, from its published test vectors.
        assert_eq!(fingerprint(b""), "cbf29ce484222325");
        assert_eq!(fingerprint(b"a"), "af63dc4c8601ec8c");
    }

    #[test]
    fn bounds_go_over_the_wire_and_fields_of_others_are_left_alone() {
        let bounded =
            Parameter { minimum: Some(1.0), maximum: Some(9.5), ..Parameter::new("x", Type::FLOAT, "") };
        let mut skill = SkillManifest::new("S", "Acts.");
        skill.inputs = vec![bounded.clone(), Parameter::new("y", Type::Int, "")];
        let (encoding, bytes) = packed(&Manifest::of(&skill, "p")).unwrap();
        let back: Manifest = unpacked(&encoding, &bytes).unwrap();
        assert_eq!(back.skill("bob/S", Duration::ZERO).inputs, skill.inputs);
        // A parameter from an agent that knows no bounds and has an additional field.
        let other = serde_json::json!({"name": "x", "type": bounded.ty, "colour": "green"});
        let read: WireParameter = serde_json::from_value(other).unwrap();
        assert_eq!(Parameter::from(&read), Parameter::new("x", Type::FLOAT, ""));
    }

    #[test]
    fn another_version_or_message_is_named() {
        let (encoding, bytes) = packed(&Refusal { reason: "no".into() }).unwrap();
        let later = encoding.replace(";v1", ";v2");
        let wrong = unpacked::<Refusal>(&later, &bytes).unwrap_err().to_string();
        assert!(wrong.contains("version 2"), "{wrong}");
        assert!(unpacked::<Status>(&encoding, &bytes).unwrap_err().to_string().contains("runtime/refusal"));
    }

    #[test]
    fn fields_that_are_absent_have_their_defaults_and_earlier_names_are_read() {
        fn read<P: Payload>(json: serde_json::Value) -> P {
            unpacked(&P::SCHEMA.encoding(), &codec::encode(&json).unwrap()).unwrap()
        }
        use serde_json::json;
        let manifest: Manifest = read(json!({"name": "S", "instance": "p", "version": "1"}));
        assert_eq!(manifest.skill("bob/S", Duration::ZERO), SkillManifest::new("bob/S", ""));
        let start: Start = read(json!({"call": "c", "instance": "p", "version": "1"}));
        assert!(start.caller.is_empty() && start.inputs.is_empty());
        let poll: Poll = read(json!({"call": "c"}));
        assert_eq!((poll.seen, poll.wait_s), (0, 0.0));
        assert_eq!(read::<Cancel>(json!({"call": "c"})).reason, "");
        let status: Status = read(json!({"events": [{"revision": 1, "name": "e"}]}));
        assert_eq!((status.revision, &status.events[0].data), (0, &Value::Null));
        let event: EventMessage = read(json!({"letter": "x-1", "name": "e"}));
        assert_eq!((event.id.as_str(), &event.data), ("x-1", &Value::Null));
        let (_, bytes) = packed(&EventReceipt { charts: 2, dropped: None, instance: "p".into() }).unwrap();
        let earlier: EventReceipt = unpacked("application/cbor;runtime/heard;v1", &bytes).unwrap();
        assert_eq!(earlier.charts, 2);
    }
}

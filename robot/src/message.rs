//! Messages as bytes with the schema that their encoding names.

use armarium_bus::{CodecError, Payload, codec};

/// Decodes a payload whose encoding names the type.
pub(crate) fn read<T: Payload>(encoding: &str, payload: &[u8]) -> Result<T, CodecError> {
    T::SCHEMA.check(encoding)?;
    codec::decode(payload)
}

/// Encoding and payload; the messages of this room can be encoded.
pub(crate) fn written<T: Payload>(message: &T) -> (String, Vec<u8>) {
    (T::SCHEMA.encoding(), codec::encode(message).expect("numbers, texts and lists can be encoded"))
}

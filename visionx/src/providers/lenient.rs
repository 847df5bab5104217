//! CBOR of other programs: a whole number where a float is wanted, as many languages write 30.0, is that float.

use armarium_bus::codec::decode_within;
use armarium_bus::{Bounds, CodecError};
use serde::de::DeserializeOwned;

/// Decodes a value within bounds.
///
/// # Errors
/// [`CodecError`] when the bytes are no `T` either way; it speaks of what does not fit, whole numbers aside.
pub(super) fn decode_leniently<T: DeserializeOwned>(bytes: &[u8], bounds: Bounds) -> Result<T, CodecError> {
    let strict = match decode_within(bytes, bounds) {
        Err(error @ CodecError::Content { .. }) => error,
        decided => return decided,
    };
    // JSON's numbers become floats where floats are wanted. What JSON cannot say is as wrong as before.
    let value: serde_json::Value = decode_within(bytes, bounds).map_err(|_| strict)?;
    serde_json::from_value(value).map_err(|e| CodecError::Content { what: e.to_string() })
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;

    #[test]
    fn whole_numbers_are_floats_where_floats_are_wanted_and_words_are_not() {
        let whole = armarium_bus::encode(&BTreeMap::from([("hz", 30u8)])).unwrap();
        let read: BTreeMap<String, f64> = decode_leniently(&whole, Bounds::default()).unwrap();
        assert_eq!(read["hz"], 30.0);
        let exact: BTreeMap<String, u64> = decode_leniently(&whole, Bounds::default()).unwrap();
        assert_eq!(exact["hz"], 30);
        let word = armarium_bus::encode(&BTreeMap::from([("hz", "fast")])).unwrap();
        let error = decode_leniently::<BTreeMap<String, f64>>(&word, Bounds::default()).unwrap_err();
        assert!(error.to_string().contains("fast"), "{error}");
        assert!(decode_leniently::<f64>(&[0xff, 0xff], Bounds::default()).is_err());
    }
}

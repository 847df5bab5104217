//! CBOR from other programs: an integer is accepted where a float is expected, because many languages write
//! 30.0 as 30.

use armarium_bus::codec::decode_within;
use armarium_bus::{Bounds, CodecError};
use serde::de::DeserializeOwned;

/// Decodes a value within bounds; an error is that of the bytes as they are, without integers in place of floats.
pub(super) fn decode_leniently<T: DeserializeOwned>(bytes: &[u8], bounds: Bounds) -> Result<T, CodecError> {
    let strict = match decode_within(bytes, bounds) {
        Err(error @ CodecError::Content { .. }) => error,
        decided => return decided,
    };
    // JSON converts integers to floats where floats are expected. A value that JSON cannot represent gives
    // the strict error.
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

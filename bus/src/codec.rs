//! The CBOR codec for everything that leaves a process.
//!
//! Encoding is deterministic: definite lengths, shortest integers, floats always as 64 bits with their exact bits,
//! fields in the order of declaration, ordered maps in their order. Equal values give equal bytes, so that hashes of
//! encodings can be compared. Structures are maps by field name and variants are `"name"` or `{"name": content}`, so
//! that any CBOR library can read and write them.
//!
//! Decoding first checks the bytes, without recursion or allocation. It refuses input that is truncated, too large,
//! too deep or followed by more bytes. Only then does it build values.

use serde::Serialize;
use serde::de::DeserializeOwned;

/// Limits of decoding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bounds {
    /// Longest encoding, bytes.
    pub bytes: usize,
    /// Most items; containers and their members count.
    pub items: usize,
    /// Deepest nesting of containers.
    pub depth: usize,
}

/// Upper limit of [`Bounds::depth`].
const MAX_DEPTH: usize = 128;

impl Default for Bounds {
    fn default() -> Self {
        Self { bytes: 64 << 20, items: 4 << 20, depth: 64 }
    }
}

/// Why encoding or decoding failed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs, reason = "the names of the fields say what they are")]
pub enum CodecError {
    /// The value's own serialisation failed.
    #[error("the value cannot be encoded: {what}")]
    Encode { what: String },
    /// More bytes than the limit.
    #[error("{bytes} bytes are more than the {most} that are accepted")]
    TooLong { bytes: usize, most: usize },
    /// The encoding ends inside an item.
    #[error("the encoding ends too early")]
    Truncated,
    /// More items than the limit.
    #[error("more than {most} items")]
    TooMany { most: usize },
    /// Containers nested deeper than the limit.
    #[error("nested deeper than {most} levels, at byte {at}")]
    TooDeep { most: usize, at: usize },
    /// Bytes that are not CBOR, or a kind of CBOR that is not used here.
    #[error("byte {at} starts no item that is understood here")]
    Malformed { at: usize },
    /// Something follows the item.
    #[error("{bytes} bytes follow the encoded item")]
    Trailing { bytes: usize },
    /// An item of another type than expected.
    #[error("the content does not fit: {what}")]
    Content { what: String },
    /// An encoding that is not CBOR with a schema.
    #[error("`{encoding}` does not name a schema as `application/cbor;NAME;vN` does")]
    NoSchema { encoding: String },
    /// Another schema than expected.
    #[error("the payload is a `{found}`, not a `{expected}`")]
    OtherSchema { expected: String, found: String },
    /// Another version of the schema.
    #[error("the payload is version {found} of `{name}`; this side understands version {expected}")]
    OtherVersion { name: String, expected: u32, found: u32 },
}

/// Encodes a value.
///
/// # Errors
/// [`CodecError::Encode`] when the value's own serialisation fails.
pub fn encode<T: Serialize + ?Sized>(value: &T) -> Result<Vec<u8>, CodecError> {
    minicbor_serde::to_vec(value).map_err(|e| CodecError::Encode { what: e.to_string() })
}

/// Decodes a value within [`Bounds::default`].
///
/// # Errors
/// [`CodecError`] when the bytes are invalid, or are not a `T`.
pub fn decode<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, CodecError> {
    decode_within(bytes, Bounds::default())
}

/// Decodes a value within bounds.
///
/// # Errors
/// As [`decode`].
pub fn decode_within<T: DeserializeOwned>(bytes: &[u8], bounds: Bounds) -> Result<T, CodecError> {
    check(bytes, bounds)?;
    let mut deserializer = minicbor_serde::Deserializer::new(bytes);
    let value = T::deserialize(&mut deserializer).map_err(|e| CodecError::Content { what: e.to_string() })?;
    let used = deserializer.decoder().position();
    if used == bytes.len() { Ok(value) } else { Err(CodecError::Trailing { bytes: bytes.len() - used }) }
}

/// Checks that the bytes are exactly one CBOR item within bounds. Strings may be invalid UTF-8; decoding checks that.
///
/// # Errors
/// [`CodecError`] with the reason.
pub fn check(bytes: &[u8], bounds: Bounds) -> Result<(), CodecError> {
    if bytes.len() > bounds.bytes {
        return Err(CodecError::TooLong { bytes: bytes.len(), most: bounds.bytes });
    }
    let most = bounds.depth.min(MAX_DEPTH);
    // Items still expected in each open container; `None` where a break ends it.
    let mut open = [None; MAX_DEPTH];
    let mut depth = 0;
    let (mut at, mut items) = (0, 0);
    loop {
        let start = at;
        let head = ItemHeader::read(bytes, &mut at)?;
        items += 1;
        if items > bounds.items {
            return Err(CodecError::TooMany { most: bounds.items });
        }
        let opened = match head {
            ItemHeader::Scalar => None,
            ItemHeader::Bytes(length) => {
                let end = usize::try_from(length).ok().and_then(|n| at.checked_add(n));
                at = end.filter(|end| *end <= bytes.len()).ok_or(CodecError::Truncated)?;
                None
            }
            ItemHeader::Container(n) => Some(n),
            ItemHeader::Break if depth > 0 && open[depth - 1].is_none() => {
                depth -= 1;
                None
            }
            ItemHeader::Break => return Err(CodecError::Malformed { at: start }),
        };
        match opened {
            Some(Some(0)) | None => {}
            Some(n) if depth < most => {
                open[depth] = n;
                depth += 1;
                continue;
            }
            Some(_) => return Err(CodecError::TooDeep { most, at: start }),
        }
        // One item has ended, and perhaps the containers around it.
        loop {
            match depth.checked_sub(1).map(|inner| &mut open[inner]) {
                None if at == bytes.len() => return Ok(()),
                None => return Err(CodecError::Trailing { bytes: bytes.len() - at }),
                Some(None) => break,
                Some(Some(left)) => {
                    *left -= 1;
                    if *left > 0 {
                        break;
                    }
                    depth -= 1;
                }
            }
        }
    }
}

/// The content of an item's head.
enum ItemHeader {
    Scalar,
    Bytes(u64),
    /// The number of its items; `None` where a break ends it.
    Container(Option<u64>),
    Break,
}

impl ItemHeader {
    fn read(bytes: &[u8], at: &mut usize) -> Result<Self, CodecError> {
        let start = *at;
        let malformed = CodecError::Malformed { at: start };
        let first = *bytes.get(start).ok_or(CodecError::Truncated)?;
        *at += 1;
        let argument = match first & 0x1f {
            n @ 0..=23 => Some(u64::from(n)),
            n @ 24..=27 => {
                let width = 1usize << (n - 24);
                let digits = bytes.get(*at..*at + width).ok_or(CodecError::Truncated)?;
                *at += width;
                Some(digits.iter().fold(0, |value, digit| value << 8 | u64::from(*digit)))
            }
            31 => None,
            _ => return Err(malformed),
        };
        match (first >> 5, argument) {
            (0 | 1, Some(_)) => Ok(Self::Scalar),
            (2 | 3, Some(length)) => Ok(Self::Bytes(length)),
            // Chunks are items of their own.
            (2..=5, None) => Ok(Self::Container(None)),
            (4, n) => Ok(Self::Container(n)),
            (5, Some(n)) => n.checked_mul(2).map(|n| Self::Container(Some(n))).ok_or(malformed),
            // A tag is a container of one item.
            (6, Some(_)) => Ok(Self::Container(Some(1))),
            (7, Some(_)) => Ok(Self::Scalar),
            (7, None) => Ok(Self::Break),
            _ => Err(malformed),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use armarium_values::{Frame, Pose, Value};
    use proptest::prelude::*;

    use super::*;

    fn values() -> impl Strategy<Value = Value> {
        let leaf = prop_oneof![
            Just(Value::Null),
            any::<bool>().prop_map(Value::Bool),
            any::<i64>().prop_map(Value::Int),
            any::<f64>().prop_filter("NaN is not equal to itself", |f| !f.is_nan()).prop_map(Value::Float),
            ".{0,12}".prop_map(Value::String),
            proptest::collection::vec(any::<u8>(), 0..20).prop_map(Value::Bytes),
            any::<[f32; 3]>().prop_filter("finite", |p| p.iter().all(|x| x.is_finite())).prop_map(|p| {
                Value::Pose(Pose {
                    frame: Frame::root(),
                    position: p.map(f64::from),
                    orientation: [0.0, 0.0, 0.0, 1.0],
                })
            }),
        ];
        leaf.prop_recursive(4, 40, 6, |inner| {
            prop_oneof![
                proptest::collection::vec(inner.clone(), 0..6).prop_map(Value::List),
                proptest::collection::btree_map(".{0,5}", inner, 0..6).prop_map(Value::Map),
            ]
        })
    }

    proptest! {
        #[test]
        fn values_come_back(value in values()) {
            let bytes = encode(&value).unwrap();
            prop_assert_eq!(&encode(&value.clone()).unwrap(), &bytes);
            prop_assert_eq!(decode::<Value>(&bytes).unwrap(), value);
        }

        #[test]
        fn no_bytes_panic(bytes in proptest::collection::vec(any::<u8>(), 0..64)) {
            let _ = decode::<Value>(&bytes);
            let _ = decode::<BTreeMap<String, f64>>(&bytes);
        }

        #[test]
        fn every_cut_is_noticed(value in values(), at in any::<proptest::sample::Index>()) {
            let bytes = encode(&value).unwrap();
            let cut = at.index(bytes.len());
            prop_assert_eq!(check(&bytes[..cut], Bounds::default()), Err(CodecError::Truncated));
        }

        #[test]
        fn one_changed_byte_never_panics(value in values(), at in any::<proptest::sample::Index>(), with in any::<u8>()) {
            let mut bytes = encode(&value).unwrap();
            let at = at.index(bytes.len());
            bytes[at] = with;
            let _ = decode::<Value>(&bytes);
        }
    }

    #[test]
    fn the_bytes_are_the_ones_of_rfc_8949() {
        let cases: [(Value, &[u8]); 6] = [
            (Value::Bytes(vec![1, 2]), b"\xa1\x65bytes\x42\x01\x02"),
            (Value::Null, b"\x64null"),
            (Value::Int(10), b"\xa1\x63int\x0a"),
            (Value::Int(-500), b"\xa1\x63int\x39\x01\xf3"),
            (Value::Float(1.1), b"\xa1\x65float\xfb\x3f\xf1\x99\x99\x99\x99\x99\x9a"),
            (Value::List(vec![Value::Bool(true)]), b"\xa1\x64list\x81\xa1\x64bool\xf5"),
        ];
        for (value, bytes) in cases {
            assert_eq!(encode(&value).unwrap(), bytes, "{value:?}");
        }
    }

    #[test]
    fn hostile_bytes_are_named() {
        let bounds = Bounds { bytes: 1000, items: 20, depth: 4 };
        let cases: [(&[u8], CodecError); 12] = [
            (b"", CodecError::Truncated),
            (b"\x81", CodecError::Truncated),
            (b"\x9b\xff\xff\xff\xff\xff\xff\xff\xff", CodecError::Truncated),
            (b"\xbb\xff\xff\xff\xff\xff\xff\xff\xff", CodecError::Malformed { at: 0 }),
            (b"\x5b\xff\xff\xff\xff\xff\xff\xff\xff", CodecError::Truncated),
            (b"\x1c", CodecError::Malformed { at: 0 }),
            (b"\xff", CodecError::Malformed { at: 0 }),
            (b"\x81\xff", CodecError::Malformed { at: 1 }),
            (b"\x00\x00", CodecError::Trailing { bytes: 1 }),
            (b"\x81\x81\x81\x81\x81\x00", CodecError::TooDeep { most: 4, at: 4 }),
            (&[0x98, 30], CodecError::Truncated),
            (&[0; 1001], CodecError::TooLong { bytes: 1001, most: 1000 }),
        ];
        for (bytes, error) in cases {
            assert_eq!(check(bytes, bounds), Err(error), "{bytes:02x?}");
        }
        let many = [[0x98, 30].as_slice(), &[0; 30]].concat();
        assert_eq!(check(&many, bounds), Err(CodecError::TooMany { most: 20 }));
        assert_eq!(check(b"\x9f\x01\x9f\xff\xff", bounds), Ok(()));
        assert_eq!(check(b"\x80", bounds), Ok(()));
        let deep = vec![0x81; 1 << 20];
        assert_eq!(decode::<Value>(&deep), Err(CodecError::TooDeep { most: 64, at: 64 }));
    }
}

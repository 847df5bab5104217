//! The Zenoh session and its security, key expressions, the CBOR codec, timestamps, liveliness.

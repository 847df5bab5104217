//! Any bytes as a frame: as one message, and as header and payload of their own. They are refused, or are a frame that
//! survives being packed again; nothing panics.
#![no_main]

use std::sync::Arc;

use armarium_visionx::providers::PixelOwner;
use armarium_visionx::providers::convert::{depth_of, rgb_of};
use armarium_visionx::providers::wire::{Header, pack, unpack};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    if let Ok((header, frame)) = unpack(bytes.to_vec()) {
        for image in &frame.images {
            let _ = (rgb_of(image), depth_of(image));
        }
        if let Ok(packed) = pack(&frame, header.epoch, header.sent_ns) {
            let (_, again) = unpack(packed).expect("what was packed can be unpacked");
            assert_eq!(again.images.len(), frame.images.len());
        }
    }
    let middle = usize::from(bytes.first().copied().unwrap_or(0)).min(bytes.len());
    let (said, payload) = bytes.split_at(middle);
    if let Ok(header) = Header::decode(said) {
        let owner: Arc<dyn PixelOwner> = Arc::new(payload.to_vec());
        let _ = header.frame(&owner);
    }
});

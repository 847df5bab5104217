//! Reads the image, and nothing else, of a message with the schema `foxglove.CompressedImage`.

/// The field `data` (2) of a protobuf message, the encoding of `foxglove.CompressedImage`.
pub(super) fn image_field(mut message: &[u8]) -> Option<&[u8]> {
    while !message.is_empty() {
        let tag = varint(&mut message)?;
        match tag & 7 {
            0 => {
                varint(&mut message)?;
            }
            1 => message = message.get(8..)?,
            5 => message = message.get(4..)?,
            2 => {
                let length = usize::try_from(varint(&mut message)?).ok()?;
                let field = message.get(..length)?;
                if tag >> 3 == 2 {
                    return Some(field);
                }
                message = &message[length..];
            }
            _ => return None,
        }
    }
    None
}

fn varint(bytes: &mut &[u8]) -> Option<u64> {
    let mut value = 0u64;
    for shift in (0..64).step_by(7) {
        let (&byte, rest) = bytes.split_first()?;
        *bytes = rest;
        value |= u64::from(byte & 0x7f) << shift;
        if byte & 0x80 == 0 {
            return Some(value);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_image_is_taken_out_of_its_message() {
        let message = [0x08, 0x96, 0x01, 0x22, 1, b'f', 0x12, 3, 7, 8, 9, 0x1a, 0];
        assert_eq!(image_field(&message), Some(&[7u8, 8, 9][..]));
        for cut in 0..10 {
            assert_eq!(image_field(&message[..cut]), None, "{cut}");
        }
        assert_eq!(image_field(&[0xff; 40]), None);
    }
}

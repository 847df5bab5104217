//! A sequence of images: a folder of files, or the compressed images of a recording (MCAP).

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read as _;
use std::path::{Path, PathBuf};

use armarium_visionx::Image;
use armarium_visionx::files::{decode_image, images_in, read_image};

/// Largest recording that is read, bytes.
const MOST_BYTES: u64 = 2 << 30;
/// The schema of an image in a recording.
const IMAGE_SCHEMA: &str = "foxglove.CompressedImage";

/// The images of a sequence, none decoded yet.
pub(super) enum Sequence {
    Files(Vec<PathBuf>),
    Recording { bytes: Vec<u8>, topic: String },
}

/// An image of a sequence and its name; or why it is none.
pub(super) type Step = (String, Result<Image, String>);

impl Sequence {
    /// The sequence in a folder, or of one topic of a recording: the one that is named, or the first with images.
    pub(super) fn open(path: &Path, topic: Option<&str>) -> Result<Self, String> {
        let shown = path.display();
        if path.is_dir() {
            let files = images_in(&[path.to_owned()]).map_err(|(p, e)| format!("{}: {e}", p.display()))?;
            return Ok(Self::Files(files));
        }
        let mut bytes = Vec::new();
        let file = File::open(path).map_err(|e| format!("{shown}: {e}"))?;
        file.take(MOST_BYTES + 1).read_to_end(&mut bytes).map_err(|e| format!("{shown}: {e}"))?;
        if bytes.len() as u64 > MOST_BYTES {
            return Err(format!("{shown}: is longer than {MOST_BYTES} bytes"));
        }
        let topics = topics(&bytes).map_err(|e| format!("{shown}: is no folder and no recording: {e}"))?;
        let chosen = topics.keys().find(|t| topic.is_none_or(|wanted| wanted == t.as_str()));
        let topic = chosen.cloned().ok_or_else(|| format!("{shown}: there are no such images in it"))?;
        Ok(Self::Recording { bytes, topic })
    }

    /// Hands each image to `take`, in order, until it says that it wants no more.
    pub(super) fn each(&self, mut take: impl FnMut(Step) -> bool) -> Result<(), String> {
        match self {
            Self::Files(files) => {
                for file in files {
                    let image = read_image(file).map_err(|e| e.to_string());
                    if !take((file.display().to_string(), image)) {
                        break;
                    }
                }
                Ok(())
            }
            Self::Recording { bytes, topic } => {
                for message in mcap::MessageStream::new(bytes).map_err(|e| e.to_string())? {
                    let message = message.map_err(|e| e.to_string())?;
                    if message.channel.topic != *topic {
                        continue;
                    }
                    let image = image_field(&message.data)
                        .ok_or_else(|| "is no compressed image".to_owned())
                        .and_then(|data| decode_image(data).map_err(|e| e.to_string()));
                    if !take((format!("{topic}@{}", message.log_time), image)) {
                        break;
                    }
                }
                Ok(())
            }
        }
    }
}

/// The topics with images, and how many they have.
fn topics(bytes: &[u8]) -> Result<BTreeMap<String, usize>, mcap::McapError> {
    let mut topics = BTreeMap::new();
    for message in mcap::MessageStream::new(bytes)? {
        let message = message?;
        let schema = message.channel.schema.as_ref().map(|s| s.name.as_str());
        if schema == Some(IMAGE_SCHEMA) {
            *topics.entry(message.channel.topic.clone()).or_insert(0) += 1;
        }
    }
    Ok(topics)
}

/// The field `data` (2) of a protobuf message, the encoding of [`IMAGE_SCHEMA`].
fn image_field(mut message: &[u8]) -> Option<&[u8]> {
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

    #[test]
    fn what_is_no_sequence_is_refused() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        assert!(Sequence::open(folder.path(), None).is_err());
        let file = folder.path().join("a.mcap");
        std::fs::write(&file, b"not a recording").expect("it can be written");
        assert!(Sequence::open(&file, None).is_err());
        assert!(Sequence::open(&folder.path().join("none"), None).is_err());
    }
}

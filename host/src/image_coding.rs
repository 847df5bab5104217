//! Images that a memory keeps are stored as JPEG files. The rooms of images and of memory do not know each other.

use std::collections::BTreeMap;

use armarium_memoryx::Coding;
use armarium_values::Value;
use armarium_visionx::{JpegPixel, encode_jpeg};

/// Encodes images as JPEG files of this quality, 1 to 100; leaves everything else unchanged.
pub fn jpeg(quality: u8) -> Coding {
    Coding::new(&format!("jpeg:{quality}"), move |value| as_jpeg(value, quality))
}

/// The JPEG file of an image in memory: as it is stored, or of this quality, 1 to 100, if it is raw. `None` for a value that is no
/// image. An image in memory is a map of `width`, `height`, `format` (`rgb8` or `gray8`), `coding` (`raw` or `jpeg`) and `data`, as
/// for images on the network.
pub fn jpeg_file(value: &Value, quality: u8) -> Option<Vec<u8>> {
    let Value::Bytes(data) = value.get("data")? else { return None };
    match value.get("coding")?.as_str()? {
        "jpeg" => return Some(data.clone()),
        "raw" => {}
        _ => return None,
    }
    let side = |name: &str| {
        let length = u32::try_from(value.get(name)?.as_int()?).ok();
        length.filter(|length| (1..=65_535).contains(length))
    };
    let pixel = match value.get("format")?.as_str()? {
        "rgb8" => JpegPixel::Rgb,
        "gray8" => JpegPixel::Gray,
        _ => return None,
    };
    let mut file = Vec::new();
    encode_jpeg(&mut file, data, (side("width")?, side("height")?), pixel, quality).ok()?;
    Some(file)
}

fn as_jpeg(value: &Value, quality: u8) -> Option<Value> {
    let Value::Map(fields) = value else { return None };
    let is_raw = fields.get("coding")?.as_str() == Some("raw");
    let file = is_raw.then(|| jpeg_file(value, quality)).flatten()?;
    let mut kept: BTreeMap<String, Value> =
        fields.iter().filter(|(name, _)| *name != "data").map(|(n, v)| (n.clone(), v.clone())).collect();
    kept.insert("coding".into(), Value::String("jpeg".into()));
    kept.insert("data".into(), Value::Bytes(file));
    Some(Value::Map(kept))
}

#[cfg(test)]
mod tests {
    use armarium_visionx::files::decode_image;

    use super::*;

    fn picture(format: &str, data: Vec<u8>) -> BTreeMap<String, Value> {
        [
            ("width", Value::Int(16)),
            ("height", Value::Int(8)),
            ("format", Value::String(format.into())),
            ("coding", Value::String("raw".into())),
            ("data", Value::Bytes(data)),
        ]
        .map(|(name, value)| (name.to_owned(), value))
        .into()
    }

    #[test]
    fn images_become_files_that_show_the_same() {
        for (format, channels) in [("rgb8", 3), ("gray8", 1)] {
            let pixels: Vec<u8> = (0..16 * 8 * channels).map(|i| 100 + (i / channels % 16) as u8).collect();
            let kept = as_jpeg(&Value::Map(picture(format, pixels.clone())), 90).unwrap();
            let Value::Map(kept) = kept else { panic!("{kept:?}") };
            assert_eq!((&kept["coding"], &kept["width"]), (&Value::String("jpeg".into()), &Value::Int(16)));
            let Value::Bytes(file) = &kept["data"] else { panic!("no bytes") };
            let shown = decode_image(file).unwrap();
            let shown = shown.data().iter().step_by(3 / channels);
            assert!(shown.zip(&pixels).all(|(a, b)| a.abs_diff(*b) < 8), "{format}");
        }
    }

    #[test]
    fn what_is_no_image_stays_as_it_is() {
        let whole = picture("rgb8", vec![0; 16 * 8 * 3]);
        let with = |name: &str, value: Value| {
            let mut fields = whole.clone();
            fields.insert(name.into(), value);
            Value::Map(fields)
        };
        assert!(as_jpeg(&Value::Map(whole.clone()), 85).is_some());
        for other in [
            Value::Int(1),
            Value::Map(BTreeMap::new()),
            with("data", Value::Bytes(vec![0; 7])),
            with("width", Value::Int(-16)),
            with("width", Value::Int(i64::MAX)),
            with("height", Value::Int(0)),
            with("format", Value::String("depth32_f".into())),
            with("coding", Value::String("jpeg".into())),
        ] {
            assert_eq!(as_jpeg(&other, 85), None);
        }
    }
}

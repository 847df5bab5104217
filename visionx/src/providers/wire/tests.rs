use proptest::prelude::*;

use super::*;
use crate::annotate::png;
use crate::frame::RgbImage;

fn frame() -> RawFrame {
    let pose = Isometry3::new(nalgebra::Vector3::new(0.1, -2.0, 3.0), nalgebra::Vector3::new(0.3, 0.1, -1.0));
    RawFrame {
        number: 9,
        stamp_ns: 123_456_789,
        frame_id: "camera_left".into(),
        root_from_camera: Some(pose),
        images: vec![
            RawImage::new("left", PixelFormat::Rgb8, (2, 1), vec![1, 2, 3, 4, 5, 6]).unwrap(),
            RawImage::new("depth", PixelFormat::Depth16, (1, 2), vec![7, 0, 8, 1]).unwrap(),
            RawImage::new("points", PixelFormat::Points32F, (1, 1), vec![0; 12]).unwrap(),
        ],
    }
}

#[test]
fn a_frame_survives_packing_to_the_last_bit() {
    for frame in [frame(), RawFrame::default()] {
        let (header, back) = unpack(pack(&frame, 4, 5).unwrap()).unwrap();
        assert_eq!(back, frame);
        assert_eq!((header.epoch, header.sent_ns, header.version), (4, 5, VERSION));
    }
}

#[test]
fn a_message_that_is_cut_or_longer_is_an_error() {
    let whole = pack(&frame(), 1, 1).unwrap();
    for end in 0..whole.len() {
        assert!(unpack(whole[..end].to_vec()).is_err(), "cut at {end}");
    }
    let mut longer = whole;
    longer.push(0);
    assert!(matches!(unpack(longer), Err(WireError::Length { .. })));
}

#[test]
fn a_coded_image_of_another_size_than_its_header_says_is_refused_before_it_is_decoded() {
    let image = RgbImage::from_rgb(4, 3, vec![50; 36]).unwrap();
    let file = png(&image).unwrap();
    let said = |size: (u32, u32)| Header {
        images: vec![ImageHeader {
            role: "left".into(),
            format: PixelFormat::Rgb8,
            coding: ImageCoding::Png,
            width: size.0,
            height: size.1,
            bytes: file.len() as u64,
        }],
        ..Header::raw(&RawFrame::default(), 1, 1)
    };
    let owner: Arc<dyn PixelOwner> = Arc::new(file.clone());
    assert_eq!(said((4, 3)).frame(&owner).unwrap().images[0].bytes(), image.data());
    assert!(matches!(said((3, 4)).frame(&owner), Err(WireError::Other(_))));
    // The PNG's header claims a size that its data do not have. It is not decoded, because the size differs.
    let bomb: Arc<dyn PixelOwner> =
        Arc::new([&file[..16], &[0, 0, 0x40, 0, 0, 0, 0x10, 0], &file[24..]].concat());
    assert!(said((4, 3)).frame(&bomb).is_err());
}

#[test]
fn headers_that_no_frame_can_have_are_refused() {
    let header = Header::raw(&frame(), 1, 1);
    let owner: Arc<dyn PixelOwner> = Arc::new(vec![0u8; 22]);
    assert!(header.frame(&owner).is_ok());
    for spoil in [
        |h: &mut Header| h.version = 2,
        |h: &mut Header| h.root_from_camera = Some([0.0; 7]),
        |h: &mut Header| h.root_from_camera = Some([f64::NAN, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]),
        |h: &mut Header| h.images[1].role = "left".into(),
        |h: &mut Header| h.images[1].role = String::new(),
        |h: &mut Header| h.frame_id = "x".repeat(201),
        |h: &mut Header| h.images = vec![h.images[0].clone(); 17],
    ] {
        let mut wrong = header.clone();
        spoil(&mut wrong);
        assert!(Header::decode(&wrong.encode().unwrap()).is_err(), "{wrong:?}");
    }
    for spoil in [
        |h: &mut Header| h.images[0].bytes = u64::MAX,
        |h: &mut Header| (h.images[0].bytes, h.images[1].bytes) = (u64::MAX, 7),
        |h: &mut Header| (h.images[0].bytes, h.images[1].bytes) = (5, 5),
        |h: &mut Header| h.images[0].width = u32::MAX,
        |h: &mut Header| h.images[0].coding = ImageCoding::Png,
        |h: &mut Header| h.images[2].coding = ImageCoding::Jpeg,
        |h: &mut Header| h.images.clear(),
    ] {
        let mut wrong = header.clone();
        spoil(&mut wrong);
        assert!(wrong.frame(&owner).is_err(), "{wrong:?}");
    }
    assert!(matches!(unpack(vec![1, 0, 0, 0, 0xff]), Err(WireError::Header(_))));
}

proptest! {
    #[test]
    fn whatever_the_bytes_nothing_panics(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
        let _ = unpack(bytes.clone()).is_ok();
        let _ = Header::decode(&bytes).is_ok();
    }

    #[test]
    fn a_spoilt_message_is_an_error_or_another_frame(at in 0usize..400, flip in 1u8..) {
        let mut bytes = pack(&frame(), 1, 2).unwrap();
        let at = at % bytes.len();
        bytes[at] ^= flip;
        if let Ok((header, frame)) = unpack(bytes) {
            let sum: u64 = header.images.iter().map(|i| i.bytes).sum();
            prop_assert_eq!(frame.bytes() as u64, sum);
        }
    }
}

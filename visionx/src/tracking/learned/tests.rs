use nalgebra::{Point3, Rotation3, Vector3};

use super::square::{Outside, Square};
use super::*;
use crate::Gesture;

/// A hand whose fingers are bent by these angles at each of their three joints, degrees. Its thumb stands out, or lies at the fingers.
fn hand(thumb_stands_out: bool, angles: [f64; 4]) -> HandLandmarks {
    let mut in_hand = [Point3::origin(); 21];
    for (finger, angle) in HandLandmarks::FINGERS[1..].iter().zip(angles) {
        let side = (finger[0] as f64 - 9.0) * 0.004;
        let mut along = Vector3::new(side, -0.09, 0.0).normalize();
        in_hand[finger[0]] = Point3::from(along * 0.09);
        for joint in finger.windows(2) {
            along = Rotation3::from_axis_angle(&Vector3::x_axis(), angle.to_radians()) * along;
            in_hand[joint[1]] = in_hand[joint[0]] + along * 0.03;
        }
    }
    let tip =
        if thumb_stands_out { Point3::new(-0.08, -0.07, 0.0) } else { in_hand[6] + Vector3::x() * -0.02 };
    let base = Point3::new(-0.02, -0.03, 0.0);
    (1..=4).for_each(|i| in_hand[i] = base + (tip - base) * ((i - 1) as f64 / 3.0));
    HandLandmarks { points: in_hand.map(|p| Point2::new(1000.0 * p.x, 1000.0 * p.y)), in_hand, presence: 1.0 }
}

#[test]
fn gestures_are_how_fingers_are_held() {
    let (flat, held, folded) = (10.0, 39.0, 55.0);
    for (thumb_stands_out, fingers, gesture) in [
        (false, [folded; 4], Some(Gesture::Fist)),
        (false, [flat, folded, folded, folded], Some(Gesture::PointOne)),
        (true, [flat, folded, folded, folded], Some(Gesture::PointOne)),
        (false, [40.0, folded, folded, folded], Some(Gesture::PointOne)),
        (false, [flat, flat, folded, folded], Some(Gesture::PointTwo)),
        // The thumb holds the folded fingers.
        (false, [flat, flat, held, held], Some(Gesture::PointTwo)),
        (false, [flat; 4], Some(Gesture::OpenHand)),
        (true, [flat; 4], Some(Gesture::OpenHand)),
        (true, [30.0; 4], Some(Gesture::OpenHand)),
        // Thumbs up; the little finger alone; three fingers.
        (true, [folded; 4], None),
        (false, [folded, folded, folded, flat], None),
        (false, [flat, flat, flat, folded], None),
    ] {
        let posture = FingerPosture::of(&hand(thumb_stands_out, fingers));
        assert!((posture.bends[1] - 3.0 * fingers[1]).abs() < 1e-6, "{posture:?}");
        assert_eq!(posture.thumb > 0.5, thumb_stands_out, "{posture:?}");
        assert_eq!(posture.gesture().map(|(gesture, _)| gesture), gesture, "{fingers:?}: {posture:?}");
        assert!(posture.likelihoods().iter().sum::<f64>() <= 1.0 + 1e-12);
    }
}

#[test]
fn the_square_of_the_next_image_turns_and_grows_with_the_hand() {
    let hand = hand(true, [10.0; 4]);
    let square = hand.square().unwrap();
    assert!(square.down.y > 0.99, "the fingers are up: {square:?}");
    let (turn, shift) = (nalgebra::Rotation2::new(0.7), Vector2::new(30.0, -20.0));
    let moved = HandLandmarks { points: hand.points.map(|p| turn * p * 2.0 + shift), ..hand };
    let expected = turn * square.center * 2.0 + shift;
    let seen = moved.square().unwrap();
    assert!((seen.center - expected).norm() < 1e-9 && (seen.side - 2.0 * square.side).abs() < 1e-9);
    assert!((seen.down - turn * square.down).norm() < 1e-9);
    let nothing = HandLandmarks { points: [Point2::origin(); 21], ..moved };
    assert_eq!(nothing.square(), None);
}

/// An image whose red is the column and whose green is the row.
fn ramp(width: u32, height: u32) -> RgbImage {
    let data = (0..height).flat_map(|y| (0..width).flat_map(move |x| [x as u8, y as u8, 7])).collect();
    RgbImage::from_rgb(width, height, data).unwrap()
}

#[test]
fn a_square_is_sampled_where_it_is() {
    let image = ramp(120, 90);
    for (side, angle) in [(16.0, 0.0f64), (40.0, 0.4), (60.0, 2.0)] {
        let down = Vector2::new(-libm::sin(angle), libm::cos(angle));
        let square = Square { center: Point2::new(60.0, 45.0), side, down };
        let pixels = square.sample(&image, 20, Outside::Nearest);
        for (i, color) in pixels.as_chunks::<3>().0.iter().enumerate() {
            let [x, y] = [i % 20, i / 20].map(|at| (at as f64 + 0.5) / 20.0);
            let at = square.in_image(x, y);
            // Half a pixel where the nearest pixels are averaged.
            let limit = if side > 40.0 { 0.51 } else { 1e-3 };
            assert!((f64::from(color[0]) * 255.0 - at.x).abs() < limit, "{side}: {color:?} at {at}");
            assert!((f64::from(color[1]) * 255.0 - at.y).abs() < limit, "{side}: {color:?} at {at}");
        }
    }
    let around = Square::around(&image).sample(&image, 12, Outside::Black);
    assert_eq!(&around[..3], [0.0; 3], "above a wide image is nothing");
    assert!((around[3 * 12 * 6 + 2] - 7.0 / 255.0).abs() < 1e-6);
    let far = Square { center: Point2::new(-500.0, 1e6), side: 20.0, down: Vector2::y() };
    let corner = far.sample(&image, 2, Outside::Nearest);
    assert!(
        corner[..3].iter().zip([0.0, 89.0, 7.0]).all(|(value, of)| (value * 255.0 - of).abs() < 1e-3),
        "{corner:?}"
    );
    assert_eq!(far.sample(&image, 2, Outside::Black), [0.0; 12]);
}

#[test]
fn an_upright_square_is_sampled_like_any_other() {
    let (image, border) = (ramp(120, 90), 64_u32);
    let mut black_around = RgbImage::from_rgb(248, 218, vec![0; 248 * 218 * 3]).unwrap();
    for (x, y) in (0..120).flat_map(|x| (0..90).map(move |y| (x, y))) {
        let at = 3 * ((y + border) * 248 + x + border) as usize;
        black_around.data_mut()[at..at + 3].copy_from_slice(&image.pixel(x, y));
    }
    for (center, side) in [([60.0, 45.0], 60.0), ([59.5, 44.5], 120.0), ([20.25, 80.5], 100.0)] {
        let square = Square { center: center.into(), side, down: Vector2::y() };
        let moved = Square { center: square.center + Vector2::repeat(f64::from(border)), ..square };
        // Its border is not reached, so this looks at each place by itself.
        let expected = moved.sample(&black_around, 20, Outside::Nearest);
        assert_eq!(square.sample(&image, 20, Outside::Black), expected, "{center:?}");
    }
}

//! How far points have turned about an axis, in the least-squares sense.

use nalgebra::Vector2;

/// The angle, rad, by which points that were `from` (as seen from the axis, m) have to be turned to be as near as can be to where they are
/// `to`. Zero where they do not say.
///
/// # Source
/// The planar case of Arun, Huang and Blostein 1987, about a given centre: the sum of squares is least where the sum of `from x to` cos is
/// the sum of `from . to` sin.
pub fn planar_turn(from: &[Vector2<f64>], to: &[Vector2<f64>]) -> f64 {
    let sum = |product: fn(&Vector2<f64>, &Vector2<f64>) -> f64| -> f64 {
        from.iter().zip(to).map(|(a, b)| product(a, b)).sum()
    };
    let (across, along) = (sum(|a, b| a.perp(b)), sum(|a, b| a.dot(b)));
    if across == 0.0 && along <= 0.0 { 0.0 } else { libm::atan2(across, along) }
}

#[cfg(test)]
mod tests {
    use nalgebra::Rotation2;
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn it_finds_a_turn_and_no_other_is_nearer(angle in -3.0..3.0_f64, x in 0.1..1.0_f64, y in -0.5..0.5_f64, off in -0.02..0.02_f64) {
            let from = [Vector2::new(x, y), Vector2::new(-x, y + 0.1)];
            let exact = from.map(|p| Rotation2::new(angle) * p);
            prop_assert!((planar_turn(&from, &exact) - angle).abs() < 1e-9);
            let to = [exact[0] + Vector2::new(off, -off), exact[1] * 1.1];
            let far = |turn: f64| from.iter().zip(&to).map(|(a, b)| (Rotation2::new(turn) * a - b).norm_squared()).sum::<f64>();
            let found = planar_turn(&from, &to);
            for other in [-0.05, -0.001, 0.001, 0.05] {
                prop_assert!(far(found) <= far(found + other) + 1e-12);
            }
        }
    }

    #[test]
    fn what_says_nothing_turns_nothing() {
        assert_eq!(planar_turn(&[], &[]), 0.0);
        assert_eq!(planar_turn(&[Vector2::zeros()], &[Vector2::x()]), 0.0);
    }
}

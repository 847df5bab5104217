//! Minimisation without derivatives, for costs that are not smooth.

use nalgebra::SVector;

/// Nelder and Mead's simplex method (1965, with the usual coefficients 1, 2, 1/2, 1/2) from `start` with first steps
/// `steps`, at most `evaluations` calls. Returns the best point and its cost. A cost that is NaN counts as infinite.
pub(crate) fn simplex<const N: usize>(
    mut cost: impl FnMut(&SVector<f64, N>) -> f64,
    start: &SVector<f64, N>,
    steps: &SVector<f64, N>,
    evaluations: usize,
) -> (SVector<f64, N>, f64) {
    let mut calls = 0;
    let mut evaluate = |x: SVector<f64, N>| {
        calls += 1;
        let c = cost(&x);
        ((x, if c.is_nan() { f64::INFINITY } else { c }), calls)
    };
    let mut points = vec![evaluate(*start).0];
    for i in 0..N {
        let mut x = *start;
        x[i] += steps[i];
        points.push(evaluate(x).0);
    }
    loop {
        points.sort_by(|a, b| a.1.total_cmp(&b.1));
        let worst = points[N];
        let center = points[..N].iter().map(|p| p.0).sum::<SVector<f64, N>>() / N as f64;
        let (reflected, calls) = evaluate(center + (center - worst.0));
        if calls >= evaluations || (worst.1 - points[0].1).abs() < 1e-9 {
            return points[0];
        }
        points[N] = if reflected.1 < points[0].1 {
            let (expanded, _) = evaluate(center + (center - worst.0) * 2.0);
            if expanded.1 < reflected.1 { expanded } else { reflected }
        } else if reflected.1 < points[N - 1].1 {
            reflected
        } else {
            let towards = if reflected.1 < worst.1 { reflected.0 } else { worst.0 };
            let (contracted, _) = evaluate(center + (towards - center) * 0.5);
            if contracted.1 < worst.1.min(reflected.1) {
                contracted
            } else {
                let best = points[0].0;
                for p in &mut points[1..] {
                    *p = evaluate(best + (p.0 - best) * 0.5).0;
                }
                points[N]
            }
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Vector2, Vector4};

    #[test]
    fn finds_minima() {
        let bowl = |x: &Vector4<f64>| (x - Vector4::new(1.0, -2.0, 0.5, 3.0)).norm_squared();
        let (x, c) = simplex(bowl, &Vector4::zeros(), &Vector4::repeat(0.5), 600);
        assert!(c < 1e-6, "{x} {c}");
        let valley = |x: &Vector2<f64>| 100.0 * (x[1] - x[0] * x[0]).powi(2) + (1.0 - x[0]).powi(2);
        let (x, c) = simplex(valley, &Vector2::new(-1.2, 1.0), &Vector2::repeat(0.3), 600);
        assert!(c < 1e-6, "{x} {c}");
    }

    #[test]
    fn a_cost_that_is_not_a_number_ends() {
        let (_, c) = simplex(|_: &Vector2<f64>| f64::NAN, &Vector2::zeros(), &Vector2::repeat(1.0), 50);
        assert!(c.is_infinite());
    }
}

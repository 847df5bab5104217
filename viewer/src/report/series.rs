//! Reduces long signals to a screen's resolution without losing peaks.

/// A signal's line in pieces, split where a value is not finite. Times outside of `range` are dropped.
///
/// Each of `buckets` equal time intervals keeps its first, smallest, largest and last value, which draws the same
/// picture as all values.
///
/// # Source
/// Jugel et al. 2014, "M4: A Visualization-Oriented Time Series Data Aggregation", section 4.
pub(crate) fn thinned(t: &[f64], y: &[f64], range: [f64; 2], buckets: usize) -> Vec<Vec<[f64; 2]>> {
    let mut pieces = Vec::new();
    let mut piece: Vec<[f64; 2]> = Vec::new();
    for (&t, &y) in t.iter().zip(y) {
        if !(range[0]..=range[1]).contains(&t) {
            continue;
        }
        if y.is_finite() {
            piece.push([t, y]);
        } else if !piece.is_empty() {
            pieces.push(std::mem::take(&mut piece));
        }
    }
    if !piece.is_empty() {
        pieces.push(piece);
    }
    let width = (range[1] - range[0]) / buckets.max(1) as f64;
    pieces.iter().map(|piece| thin(piece, range[0], width)).collect()
}

fn thin(piece: &[[f64; 2]], start: f64, width: f64) -> Vec<[f64; 2]> {
    let bucket = |p: &[f64; 2]| ((p[0] - start) / width).floor() as i64;
    piece.chunk_by(|a, b| bucket(a) == bucket(b)).flat_map(extremes).collect()
}

fn extremes(group: &[[f64; 2]]) -> Vec<[f64; 2]> {
    if group.len() <= 4 {
        return group.to_vec();
    }
    let order = |&i: &usize, &j: &usize| group[i][1].total_cmp(&group[j][1]);
    let last = group.len() - 1;
    let mut kept = [Some(0), (0..group.len()).min_by(order), (0..group.len()).max_by(order), Some(last)]
        .map(|i| i.unwrap_or(0));
    kept.sort_unstable();
    let mut out: Vec<[f64; 2]> = kept.into_iter().map(|i| group[i]).collect();
    out.dedup();
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_single_peak_survives_and_the_line_is_short() {
        let t: Vec<f64> = (0..100_000).map(|i| f64::from(i) * 1e-3).collect();
        let mut y = vec![1.0; t.len()];
        y[54_321] = 9.0;
        let pieces = thinned(&t, &y, [0.0, 100.0], 500);
        assert_eq!(pieces.len(), 1);
        assert!(pieces[0].len() <= 2000);
        assert!(pieces[0].contains(&[t[54_321], 9.0]));
        assert_eq!((pieces[0][0], pieces[0][pieces[0].len() - 1]), ([t[0], 1.0], [t[99_999], 1.0]));
        assert!(pieces[0].is_sorted_by(|a, b| a[0] <= b[0]));
    }

    #[test]
    fn nan_interrupts_the_line() {
        let pieces = thinned(&[0.0, 1.0, 2.0, 3.0], &[1.0, f64::NAN, 2.0, 3.0], [0.0, 3.0], 10);
        assert_eq!(pieces, [vec![[0.0, 1.0]], vec![[2.0, 2.0], [3.0, 3.0]]]);
    }

    #[test]
    fn an_empty_range_draws_nothing_wrong() {
        assert!(thinned(&[], &[], [0.0, 0.0], 10).is_empty());
        assert_eq!(thinned(&[1.0], &[2.0], [1.0, 1.0], 0).len(), 1);
    }
}

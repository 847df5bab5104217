//! Distances in a grid of cells: straight ones, and those along paths that stay within a shape. Knows nothing of hands.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};

use crate::mask::Mask;

/// Steps to a cell's neighbours, columns and rows, and their lengths, fifths of a cell.
const STEPS: [(isize, isize, u32); 16] = [
    (1, 0, 5),
    (-1, 0, 5),
    (0, 1, 5),
    (0, -1, 5),
    (1, 1, 7),
    (1, -1, 7),
    (-1, 1, 7),
    (-1, -1, 7),
    (2, 1, 11),
    (2, -1, 11),
    (-2, 1, 11),
    (-2, -1, 11),
    (1, 2, 11),
    (1, -2, 11),
    (-1, 2, 11),
    (-1, -2, 11),
];

/// How far each cell is from the nearest of those `at_base`, along paths within `cells`, cells; what cannot be reached
/// is left out. No cell lies in the two outermost columns of the grid. So the end of a bent finger is farther than its knuckle.
///
/// # Source
/// Borgefors 1986: chamfer distances with steps of 5, 7 and 11 fifths, 2 % off at most; by Dijkstra's search.
pub(super) fn along(cells: &[usize], at_base: impl Fn(usize) -> bool, width: usize) -> BTreeMap<usize, f32> {
    let mut fifths: BTreeMap<usize, u32> = cells.iter().map(|&i| (i, u32::MAX)).collect();
    let mut open = BinaryHeap::new();
    for &i in cells.iter().filter(|&&i| at_base(i)) {
        fifths.insert(i, 0);
        open.push(Reverse((0, i)));
    }
    while let Some(Reverse((d, i))) = open.pop() {
        if fifths.get(&i).is_some_and(|known| *known < d) {
            continue;
        }
        for (dx, dy, step) in STEPS {
            let Some(next) = i.checked_add_signed(dy * width as isize + dx) else { continue };
            if let Some(known) = fifths.get_mut(&next).filter(|known| d + step < **known) {
                *known = d + step;
                open.push(Reverse((d + step, next)));
            }
        }
    }
    fifths.into_iter().filter(|(_, d)| *d < u32::MAX).map(|(i, d)| (i, d as f32 / 5.0)).collect()
}

/// The Euclidean distance of every cell from the nearest that is `source`, cells; infinite where there is none.
///
/// # Source
/// Felzenszwalb, Huttenlocher 2012: lower envelope of parabolas, along rows and then columns. Differs in: the first
/// pass is two sweeps, because its input is binary.
pub(super) fn distances(mask: &Mask, source: impl Fn(u8) -> bool) -> Vec<f32> {
    let (w, h) = (mask.width(), mask.height());
    let mut squared: Vec<f32> =
        mask.data().iter().map(|&v| if source(v) { 0.0 } else { f32::INFINITY }).collect();
    for row in squared.chunks_exact_mut(w.max(1)) {
        let mut sweep = |order: &mut dyn Iterator<Item = usize>| {
            let mut run = f32::INFINITY;
            for x in order {
                run = if row[x] == 0.0 { 0.0 } else { run + 1.0 };
                row[x] = row[x].min(run);
            }
        };
        sweep(&mut (0..w));
        sweep(&mut (0..w).rev());
        row.iter_mut().for_each(|d| *d *= *d);
    }
    let mut column = vec![0.0; h];
    let (mut sites, mut starts) = (vec![0usize; h], vec![0.0f32; h + 1]);
    for x in 0..w {
        (0..h).for_each(|y| column[y] = squared[y * w + x]);
        envelope(&column, &mut sites, &mut starts, |y, d| squared[y * w + x] = d.sqrt());
    }
    squared
}

/// The lower envelope of the parabolas `f[i] + (y - i)^2` at every `y`.
fn envelope(f: &[f32], sites: &mut [usize], starts: &mut [f32], mut put: impl FnMut(usize, f32)) {
    let mut n = 0;
    for (q, fq) in f.iter().enumerate().filter(|(_, v)| v.is_finite()) {
        let meet = |p: usize| (fq - f[p] + (q * q) as f32 - (p * p) as f32) / (2.0 * (q as f32 - p as f32));
        while n > 0 && meet(sites[n - 1]) <= starts[n - 1] {
            n -= 1;
        }
        starts[n] = if n == 0 { f32::NEG_INFINITY } else { meet(sites[n - 1]) };
        sites[n] = q;
        n += 1;
    }
    let mut k = 0;
    for y in 0..f.len() {
        while k + 1 < n && starts[k + 1] < y as f32 {
            k += 1;
        }
        let d = y as f32 - sites[k] as f32;
        put(y, if n == 0 { f32::INFINITY } else { f[sites[k]] + d * d });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mask::Region;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn distances_agree_with_brute_force(bits in proptest::collection::vec(0u8..8, 11 * 7)) {
            let mut mask = Mask::empty(Region::whole(11, 7));
            mask.data_mut().iter_mut().zip(&bits).for_each(|(m, b)| *m = u8::from(*b == 0));
            let found = distances(&mask, |v| v != 0);
            for (i, d) in found.iter().enumerate() {
                let (x, y) = ((i % 11) as f32, (i / 11) as f32);
                let expected = (0..77)
                    .filter(|&j| mask.data()[j] != 0)
                    .map(|j| ((j % 11) as f32 - x).hypot((j / 11) as f32 - y))
                    .fold(f32::INFINITY, f32::min);
                prop_assert!((d - expected).abs() < 1e-4 || *d == expected);
            }
        }
    }

    #[test]
    fn a_path_goes_round_the_corner() {
        // Three cells of a row and two below the last of them, in a grid eight cells wide.
        let [a, b, c, d, e, apart] = [(2, 2), (3, 2), (4, 2), (4, 3), (4, 4), (1, 5)].map(|(x, y)| 8 * y + x);
        let lengths = along(&[a, b, c, d, e, apart], |i| i == a, 8);
        let expected = BTreeMap::from([(a, 0.0), (b, 1.0), (c, 2.0), (d, 2.2), (e, 3.2)]);
        assert_eq!(lengths, expected, "the last cannot be reached");
    }
}

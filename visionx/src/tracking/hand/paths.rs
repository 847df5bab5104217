//! Geodesic distances in a grid of cells, along paths inside a shape. Knows nothing of hands.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};

/// Steps to a cell's neighbours (column, row), and their lengths, fifths of a cell.
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

/// The distance of each cell from the nearest `at_base`, along paths within `cells`, in cells; unreachable cells are
/// left out. Thus the end of a bent finger is farther away than its knuckle. The two outermost columns of the grid must
/// be empty.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_goes_round_the_corner() {
        // Three cells of a row and two below the last of them, in a grid eight cells wide.
        let [a, b, c, d, e, apart] = [(2, 2), (3, 2), (4, 2), (4, 3), (4, 4), (1, 5)].map(|(x, y)| 8 * y + x);
        let lengths = along(&[a, b, c, d, e, apart], |i| i == a, 8);
        let expected = BTreeMap::from([(a, 0.0), (b, 1.0), (c, 2.0), (d, 2.2), (e, 3.2)]);
        assert_eq!(lengths, expected, "the last cannot be reached");
    }
}

//! The assignment problem: assigns each row to one column, each column at most once, with the least sum of costs.

/// The cost of an impossible pair: more than any sum of real costs.
const IMPOSSIBLE_COST: f64 = 1e12;

/// Returns the column of each row. There must be at least as many columns as rows. A cost that is not finite marks an
/// impossible pair; such a pair may still be assigned if nothing else is left.
///
/// # Source
/// Kuhn 1955, Munkres 1957, with potentials and shortest augmenting paths: O(rows² columns).
pub fn assign(costs: &[Vec<f64>]) -> Vec<usize> {
    let (rows, columns) = (costs.len(), costs.first().map_or(0, Vec::len));
    if rows == 0 || columns < rows || costs.iter().any(|row| row.len() != columns) {
        return Vec::new();
    }
    let cost = |row: usize, column: usize| {
        Some(costs[row][column]).filter(|c| c.is_finite()).unwrap_or(IMPOSSIBLE_COST)
    };
    // Column 0 means none; `row_of` counts rows from 1.
    let (mut of_row, mut of_column) = (vec![0.0; rows + 1], vec![0.0; columns + 1]);
    let mut row_of = vec![0_usize; columns + 1];
    for row in 1..=rows {
        row_of[0] = row;
        let mut at = 0;
        let mut least = vec![f64::INFINITY; columns + 1];
        let mut before = vec![0_usize; columns + 1];
        let mut done = vec![false; columns + 1];
        while row_of[at] != 0 {
            done[at] = true;
            let (from, mut step, mut next) = (row_of[at], f64::INFINITY, 0);
            for column in (1..=columns).filter(|c| !done[*c]) {
                let reduced = cost(from - 1, column - 1) - of_row[from] - of_column[column];
                if reduced < least[column] {
                    (least[column], before[column]) = (reduced, at);
                }
                if least[column] < step {
                    (step, next) = (least[column], column);
                }
            }
            for column in 0..=columns {
                if done[column] {
                    of_row[row_of[column]] += step;
                    of_column[column] -= step;
                } else {
                    least[column] -= step;
                }
            }
            at = next;
        }
        while at != 0 {
            row_of[at] = row_of[before[at]];
            at = before[at];
        }
    }
    let mut assigned = vec![0; rows];
    for column in 1..=columns {
        if row_of[column] > 0 {
            assigned[row_of[column] - 1] = column - 1;
        }
    }
    assigned
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// The least cost, by trying all assignments.
    fn least(costs: &[Vec<f64>], row: usize, used: &mut Vec<bool>) -> f64 {
        if row == costs.len() {
            return 0.0;
        }
        let mut best = f64::INFINITY;
        for column in 0..used.len() {
            if !used[column] {
                used[column] = true;
                best = best.min(costs[row][column] + least(costs, row + 1, used));
                used[column] = false;
            }
        }
        best
    }

    proptest! {
        #[test]
        fn no_other_assignment_costs_less(
            costs in (1usize..5, 0usize..3).prop_flat_map(|(rows, more)| {
                proptest::collection::vec(proptest::collection::vec(0.0..10.0, rows + more), rows)
            })
        ) {
            let assigned = assign(&costs);
            let mut columns = assigned.clone();
            columns.sort_unstable();
            columns.dedup();
            prop_assert_eq!(columns.len(), costs.len());
            let sum: f64 = assigned.iter().enumerate().map(|(row, column)| costs[row][*column]).sum();
            let best = least(&costs, 0, &mut vec![false; costs[0].len()]);
            prop_assert!((sum - best).abs() < 1e-9, "{sum} {best}");
        }
    }

    #[test]
    fn pairs_that_cannot_be_are_avoided() {
        assert_eq!(assign(&[vec![f64::INFINITY, 3.0], vec![1.0, f64::INFINITY]]), [1, 0]);
        assert_eq!(assign(&[]), Vec::<usize>::new());
        assert_eq!(assign(&[vec![1.0], vec![1.0]]), Vec::<usize>::new());
    }
}

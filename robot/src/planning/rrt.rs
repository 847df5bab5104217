//! RRT-Connect: two trees of free configurations, from the start and from the goal, that grow towards each other; and the
//! shortening of what they find. It knows only the planner's questions: how long is a line, and how much of it is free.

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use super::{Planner, between};

/// Most configurations that a search looks at, and most that the shortening does.
const SEARCHED: usize = 40_000;
const SHORTENED: usize = 10_000;
/// Tries to replace a piece of the path by a straight line.
const SHORTCUTS: usize = 150;
/// Longest way of a body along one branch, and the shortest that is worth one, m.
const BRANCH: f64 = 0.5;
const TWIG: f64 = 0.01;

/// A tree of configurations; each with the index of the one that it grew from.
struct RrtTree(Vec<(Vec<f64>, usize)>);

impl RrtTree {
    fn nearest(&self, planner: &Planner, q: &[f64]) -> usize {
        let far = |(node, _): &(Vec<f64>, usize)| planner.length(node, q);
        let lengths = self.0.iter().map(far).enumerate();
        lengths.min_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |(index, _)| index)
    }

    /// Grows one branch from a node towards `q`. Returns the new node, and whether `q` was reached.
    fn grow(&mut self, planner: &mut Planner, node: usize, q: &[f64]) -> Option<(usize, bool)> {
        let from = self.0[node].0.clone();
        let length = planner.length(&from, q);
        let to = between(&from, q, (BRANCH / length).min(1.0));
        let free = planner.free_share(&from, &to);
        let whole = free >= 1.0;
        if !whole && free * length.min(BRANCH) < TWIG {
            return None;
        }
        self.0.push((between(&from, &to, free), node));
        Some((self.0.len() - 1, whole && length <= BRANCH))
    }

    /// The configurations from the root of the tree to a node.
    fn branch(&self, mut node: usize) -> Vec<Vec<f64>> {
        let mut branch = vec![self.0[node].0.clone()];
        while self.0[node].1 != node {
            node = self.0[node].1;
            branch.push(self.0[node].0.clone());
        }
        branch.reverse();
        branch
    }
}

/// A path between two free configurations, if one is found.
pub(super) fn search(
    planner: &mut Planner,
    joints: &[usize],
    from: &[f64],
    to: &[f64],
    seed: u64,
) -> Option<Vec<Vec<f64>>> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let ranges: Vec<(usize, (f64, f64))> = joints.iter().map(|&j| (j, planner.range(j, from[j]))).collect();
    let mut trees = [RrtTree(vec![(from.to_vec(), 0)]), RrtTree(vec![(to.to_vec(), 0)])];
    let most = planner.checks + SEARCHED;
    let mut swapped = false;
    while planner.checks < most {
        let mut sample = from.to_vec();
        for &(j, (lower, upper)) in &ranges {
            sample[j] = rng.random_range(lower..=upper);
        }
        let [grown, other] = &mut trees;
        let nearest = grown.nearest(planner, &sample);
        if let Some((new, _)) = grown.grow(planner, nearest, &sample) {
            let target = grown.0[new].0.clone();
            let mut node = other.nearest(planner, &target);
            while planner.checks < most
                && let Some((next, reached)) = other.grow(planner, node, &target)
            {
                if reached {
                    let (mut path, mut rest) = (grown.branch(new), other.branch(next));
                    // Both end in the same configuration.
                    rest.pop();
                    path.extend(rest.into_iter().rev());
                    if swapped {
                        path.reverse();
                    }
                    return Some(shorten(planner, path, &mut rng));
                }
                if planner.length(&other.0[node].0, &other.0[next].0) < TWIG {
                    break;
                }
                node = next;
            }
        }
        trees.swap(0, 1);
        swapped = !swapped;
    }
    None
}

/// Replaces pieces between two random points of the path by straight lines where these are free and shorter.
fn shorten(planner: &mut Planner, mut path: Vec<Vec<f64>>, rng: &mut ChaCha8Rng) -> Vec<Vec<f64>> {
    let most = planner.checks + SHORTENED;
    for _ in 0..SHORTCUTS {
        if path.len() < 3 || planner.checks > most {
            break;
        }
        let [a, b]: [f64; 2] = std::array::from_fn(|_| rng.random());
        let (first, second) = (at(planner, &path, a.min(b)), at(planner, &path, a.max(b)));
        if first.0 == second.0 || planner.free_share(&first.1, &second.1) < 1.0 {
            continue;
        }
        let mut shorter = path[..=first.0].to_vec();
        shorter.extend([first.1, second.1]);
        shorter.extend_from_slice(&path[second.0 + 1..]);
        shorter.dedup();
        path = shorter;
    }
    path
}

/// The point at a share of a path's length, and the index of the corner before it.
fn at(planner: &Planner, path: &[Vec<f64>], share: f64) -> (usize, Vec<f64>) {
    let lengths: Vec<f64> = path.windows(2).map(|two| planner.length(&two[0], &two[1])).collect();
    let mut left = share * lengths.iter().sum::<f64>();
    for (index, length) in lengths.iter().enumerate() {
        if left <= *length && *length > 0.0 {
            return (index, between(&path[index], &path[index + 1], left / length));
        }
        left -= length;
    }
    (path.len() - 2, path[path.len() - 1].clone())
}

//! Layered layout of boxes and arrows: boxes in ranks from top to bottom, labels in ranks between them. The order in
//! each rank keeps crossings few; the positions are close to those of connected boxes.
//!
//! # Source
//! Sugiyama, Tagawa, Toda 1981; ranks of labels as in Gansner, Koutsofios, North, Vo 1993. Positions within a rank are
//! the least-squares positions under the rank's order (pool adjacent violators).

/// The size of a box or label before placement, px.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Size {
    pub(super) width: f64,
    pub(super) height: f64,
}

/// An arrow between two boxes, with the size of its label.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Link {
    pub(super) from: usize,
    pub(super) to: usize,
    pub(super) label: Size,
}

/// The route of an arrow and the position of its label.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Route {
    /// Straight pieces from rank to rank: x, and y from top to bottom; from the source to the target.
    pub(super) points: Vec<(f64, f64)>,
    /// Centre of the label.
    pub(super) label: (f64, f64),
}

/// A layout: the upper left corners of the boxes, the arrows, and the total size.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Drawing {
    pub(super) corners: Vec<(f64, f64)>,
    pub(super) routes: Vec<Route>,
    pub(super) size: Size,
}

/// Space between boxes of a rank, px.
const GAP: f64 = 26.0;
/// Space between ranks, px.
const RISE: f64 = 18.0;
/// Iterations of the ordering.
const SWEEPS: usize = 12;
/// Iterations of the positioning.
const ROUNDS: usize = 40;

/// An item of a rank: a box, or a point where an arrow passes, one of which holds its label.
#[derive(Clone, Copy, Debug)]
struct Item {
    size: Size,
    rank: usize,
    x: f64,
}

struct Layers {
    /// Number of boxes; they are the first items.
    boxes: usize,
    items: Vec<Item>,
    ranks: Vec<Vec<usize>>,
    /// Neighbours in the rank above and below.
    above: Vec<Vec<usize>>,
    below: Vec<Vec<usize>>,
    /// For each link its items from top to bottom, and whether it points up.
    chains: Vec<(Vec<usize>, bool)>,
    /// The item that holds each link's label.
    labels: Vec<usize>,
}

/// Lays out boxes and links. Links from a box to itself are ignored.
pub(super) fn draw(boxes: &[Size], links: &[Link]) -> Drawing {
    if boxes.is_empty() {
        return Drawing::default();
    }
    let mut layers = Layers::of(boxes, links);
    layers.order();
    layers.place();
    layers.finish(boxes.len())
}

impl Layers {
    fn of(boxes: &[Size], links: &[Link]) -> Self {
        let down = downward(boxes.len(), links);
        let ranks = ranks(boxes.len(), links, &down);
        let mut items: Vec<Item> =
            boxes.iter().zip(&ranks).map(|(size, rank)| Item { size: *size, rank: *rank, x: 0.0 }).collect();
        let (mut chains, mut labels) = (Vec::new(), Vec::new());
        for (link, down) in links.iter().zip(&down) {
            let (top, bottom) = if *down { (link.from, link.to) } else { (link.to, link.from) };
            let mut chain = vec![top];
            let (first, last) = (ranks[top] + 1, ranks[bottom]);
            // The label is near the source, where readers expect it.
            let at = if *down { first } else { last.saturating_sub(1).max(first) };
            for rank in first..last {
                let passing = Size { width: 6.0, height: 0.0 };
                items.push(Item { size: if rank == at { link.label } else { passing }, rank, x: 0.0 });
                if rank == at {
                    labels.push(items.len() - 1);
                }
                chain.push(items.len() - 1);
            }
            if link.from == link.to {
                labels.push(top);
            }
            chain.push(bottom);
            chains.push((chain, !*down));
        }
        let mut layers = Self {
            boxes: boxes.len(),
            ranks: vec![Vec::new(); items.iter().map(|i| i.rank).max().unwrap_or(0) + 1],
            above: vec![Vec::new(); items.len()],
            below: vec![Vec::new(); items.len()],
            items,
            chains,
            labels,
        };
        layers.connect();
        layers
    }

    fn connect(&mut self) {
        for (at, item) in self.items.iter().enumerate() {
            self.ranks[item.rank].push(at);
        }
        for (chain, _) in &self.chains {
            for pair in chain.windows(2).filter(|p| p[0] != p[1]) {
                self.below[pair[0]].push(pair[1]);
                self.above[pair[1]].push(pair[0]);
            }
        }
    }

    // Ordering within the ranks.

    fn order(&mut self) {
        let mut best = (self.crossings(), self.ranks.clone());
        for sweep in 0..SWEEPS {
            let place = self.positions();
            let last = self.ranks.len().saturating_sub(1);
            for step in 0..=last {
                let rank = if sweep % 2 == 0 { step } else { last - step };
                self.sort(rank, sweep % 2 == 0, &place);
            }
            let crossings = self.crossings();
            if crossings < best.0 {
                best = (crossings, self.ranks.clone());
            }
        }
        self.ranks = best.1;
    }

    fn positions(&self) -> Vec<f64> {
        let mut place = vec![0.0; self.items.len()];
        for rank in &self.ranks {
            for (at, item) in rank.iter().enumerate() {
                place[*item] = at as f64;
            }
        }
        place
    }

    /// Sorts a rank by the mean position of the neighbours above (or below); an item without neighbours keeps
    /// its position.
    fn sort(&mut self, rank: usize, downward: bool, place: &[f64]) {
        let mut current = place.to_vec();
        for rank in &self.ranks {
            for (at, item) in rank.iter().enumerate() {
                current[*item] = at as f64;
            }
        }
        let neighbours = if downward { &self.above } else { &self.below };
        let key = |item: &usize| {
            let near = &neighbours[*item];
            if near.is_empty() {
                return current[*item];
            }
            near.iter().map(|n| current[*n]).sum::<f64>() / near.len() as f64
        };
        self.ranks[rank].sort_by(|a, b| key(a).total_cmp(&key(b)));
    }

    fn crossings(&self) -> usize {
        let place = self.positions();
        let mut count = 0;
        for rank in &self.ranks {
            let mut ends: Vec<(usize, usize)> = Vec::new();
            for (at, item) in rank.iter().enumerate() {
                ends.extend(self.below[*item].iter().map(|b| (at, place[*b] as usize)));
            }
            // Counts crossing pairs; the cap bounds the time for a very wide rank.
            let ends = &ends[..ends.len().min(2000)];
            for (i, a) in ends.iter().enumerate() {
                count += ends[i + 1..]
                    .iter()
                    .filter(|b| (a.0 < b.0 && a.1 > b.1) || (a.0 > b.0 && a.1 < b.1))
                    .count();
            }
        }
        count
    }

    // Positions within the ranks.

    fn place(&mut self) {
        for rank in self.ranks.clone() {
            let mut x = 0.0;
            for item in rank {
                let width = self.items[item].size.width;
                self.items[item].x = x + width / 2.0;
                x += width + GAP;
            }
        }
        for round in 0..ROUNDS {
            let last = self.ranks.len() - 1;
            for step in 0..=last {
                let rank = if round % 2 == 0 { step } else { last - step };
                self.pull(rank, round);
            }
        }
        let left = self.items.iter().map(|i| i.x - i.size.width / 2.0).fold(f64::INFINITY, f64::min);
        self.items.iter_mut().for_each(|i| i.x -= left);
    }

    /// Moves a rank's items towards the mean of their neighbours, keeping their order and without overlap.
    fn pull(&mut self, rank: usize, round: usize) {
        let members = &self.ranks[rank];
        let mut offset = 0.0;
        let mut wanted: Vec<(f64, f64)> = Vec::new();
        let mut offsets = Vec::new();
        for (at, item) in members.iter().enumerate() {
            if at > 0 {
                let before = self.items[members[at - 1]].size.width;
                offset += (before + self.items[*item].size.width) / 2.0 + GAP;
            }
            offsets.push(offset);
            let both = round > 3;
            let above = self.above[*item].iter().filter(|_| both || round.is_multiple_of(2));
            let below = self.below[*item].iter().filter(|_| both || !round.is_multiple_of(2));
            let near = above.chain(below).map(|n| (self.items[*n].x, self.stiffness(*item, *n)));
            let (sum, weight) = near.fold((0.0, 0.0), |(sum, all), (x, w)| (sum + x * w, all + w));
            let (mean, weight) =
                if weight == 0.0 { (self.items[*item].x, 0.1) } else { (sum / weight, weight) };
            wanted.push((mean - offset, weight));
        }
        let fitted = increasing(&wanted);
        for ((item, x), offset) in self.ranks[rank].clone().into_iter().zip(fitted).zip(offsets) {
            self.items[item].x = x + offset;
        }
    }

    /// Space below a rank: more where arrows run far sideways.
    fn rise(&self, rank: &[usize]) -> f64 {
        let aside = |item: &usize| {
            let below = self.below[*item].iter().map(|b| (self.items[*b].x - self.items[*item].x).abs());
            below.fold(0.0, f64::max)
        };
        RISE + (rank.iter().map(aside).fold(0.0, f64::max) / 12.0).min(50.0)
    }

    /// Weight for keeping a segment of an arrow vertical: largest where it only passes.
    fn stiffness(&self, a: usize, b: usize) -> f64 {
        let passing = |item: usize| item >= self.boxes;
        match (passing(a), passing(b)) {
            (true, true) => 8.0,
            (false, false) => 1.0,
            _ => 2.0,
        }
    }

    fn finish(self, boxes: usize) -> Drawing {
        let mut tops = Vec::new();
        let mut heights = Vec::new();
        let mut y = 0.0;
        for rank in &self.ranks {
            let height = rank.iter().map(|i| self.items[*i].size.height).fold(0.0, f64::max);
            tops.push(y);
            heights.push(height);
            y += height + self.rise(rank);
        }
        let corner = |i: usize| {
            let item = self.items[i];
            (item.x - item.size.width / 2.0, tops[item.rank])
        };
        let ports = self.ports(boxes);
        let mut routes = Vec::new();
        for (number, (chain, up)) in self.chains.iter().enumerate() {
            let label = self.items[self.labels.get(number).copied().unwrap_or(chain[0])];
            let label = (label.x, tops[label.rank] + heights[label.rank] / 2.0);
            let mut points = Vec::new();
            let end = chain.len() - 1;
            for (step, item) in chain.iter().enumerate() {
                let of = self.items[*item];
                let (top, bottom) = (tops[of.rank], tops[of.rank] + heights[of.rank]);
                if step == 0 {
                    let x = ports.bottom[number];
                    points.extend([(x, top + of.size.height), (x, bottom)]);
                } else if step == end {
                    points.push((ports.top[number], top));
                } else {
                    points.extend([(of.x, top), (of.x, bottom)]);
                }
            }
            points.dedup();
            if *up {
                points.reverse();
            }
            routes.push(Route { points, label });
        }
        let right = self.items.iter().map(|i| i.x + i.size.width / 2.0).fold(0.0, f64::max);
        let last = self.ranks.last().map_or(RISE, |rank| self.rise(rank));
        let size = Size { width: right, height: (y - last).max(0.0) };
        Drawing { corners: (0..boxes).map(corner).collect(), routes, size }
    }

    /// The points where links leave the lower side of their upper box and enter the upper side of their lower box,
    /// spread over the side in the order of their other ends.
    fn ports(&self, boxes: usize) -> Ports {
        let mut ports = Ports { bottom: vec![0.0; self.chains.len()], top: vec![0.0; self.chains.len()] };
        for at in 0..boxes {
            for lower in [true, false] {
                let mut list: Vec<(f64, usize)> = Vec::new();
                for (number, (chain, _)) in self.chains.iter().enumerate() {
                    let (end, next) = if lower {
                        (chain[0], chain[1])
                    } else {
                        (chain[chain.len() - 1], chain[chain.len() - 2])
                    };
                    if end == at && next != at {
                        list.push((self.items[next].x, number));
                    }
                }
                list.sort_by(|a, b| a.0.total_cmp(&b.0));
                let of = self.items[at];
                let room = (of.size.width - 24.0).max(0.0);
                let step = (room / list.len().max(1) as f64).min(28.0);
                let middle = (list.len() as f64 - 1.0) / 2.0;
                for (place, (_, number)) in list.iter().enumerate() {
                    let x = of.x + (place as f64 - middle) * step;
                    if lower { ports.bottom[*number] = x } else { ports.top[*number] = x }
                }
            }
        }
        ports
    }
}

struct Ports {
    bottom: Vec<f64>,
    top: Vec<f64>,
}

/// Which links point down, after those that close a cycle are reversed; by a depth-first search in the given order.
fn downward(boxes: usize, links: &[Link]) -> Vec<bool> {
    let mut down = vec![true; links.len()];
    let mut out: Vec<Vec<usize>> = vec![Vec::new(); boxes];
    links.iter().enumerate().for_each(|(n, l)| out[l.from].push(n));
    // 0 unvisited, 1 on the current path, 2 done.
    let mut state = vec![0u8; boxes];
    for root in 0..boxes {
        let mut stack = vec![(root, 0)];
        if state[root] != 0 {
            continue;
        }
        state[root] = 1;
        while let Some((at, next)) = stack.pop() {
            let Some(number) = out[at].get(next) else {
                state[at] = 2;
                continue;
            };
            stack.push((at, next + 1));
            let to = links[*number].to;
            match state[to] {
                0 => {
                    state[to] = 1;
                    stack.push((to, 0));
                }
                1 => down[*number] = false,
                _ => {}
            }
        }
    }
    down
}

/// Ranks by the longest path from a box without incoming links; boxes have even ranks, labels lie between.
fn ranks(boxes: usize, links: &[Link], down: &[bool]) -> Vec<usize> {
    let ends: Vec<(usize, usize)> = links
        .iter()
        .zip(down)
        .filter(|(l, _)| l.from != l.to)
        .map(|(l, down)| if *down { (l.from, l.to) } else { (l.to, l.from) })
        .collect();
    let mut rank = vec![0; boxes];
    let mut waiting: Vec<usize> = vec![0; boxes];
    let mut out: Vec<Vec<usize>> = vec![Vec::new(); boxes];
    for (a, b) in &ends {
        out[*a].push(*b);
        waiting[*b] += 1;
    }
    let mut free: std::collections::VecDeque<usize> = (0..boxes).filter(|b| waiting[*b] == 0).collect();
    while let Some(at) = free.pop_front() {
        for to in &out[at] {
            rank[*to] = rank[*to].max(rank[at] + 2);
            waiting[*to] -= 1;
            if waiting[*to] == 0 {
                free.push_back(*to);
            }
        }
    }
    rank
}

/// The increasing sequence nearest to `(value, weight)` pairs by least squares (isotonic regression).
fn increasing(wanted: &[(f64, f64)]) -> Vec<f64> {
    let mut pools: Vec<(f64, f64, usize)> = Vec::new();
    for (value, weight) in wanted {
        pools.push((*value, *weight, 1));
        while let [.., a, b] = pools.as_slice()
            && a.0 > b.0
        {
            let weight = a.1 + b.1;
            let merged = ((a.0 * a.1 + b.0 * b.1) / weight, weight, a.2 + b.2);
            pools.truncate(pools.len() - 2);
            pools.push(merged);
        }
    }
    pools.into_iter().flat_map(|(value, _, count)| std::iter::repeat_n(value, count)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_increasing_sequence_is_found() {
        assert_eq!(increasing(&[(3.0, 1.0), (1.0, 1.0), (5.0, 1.0)]), [2.0, 2.0, 5.0]);
        assert_eq!(increasing(&[(3.0, 3.0), (1.0, 1.0)]), [2.5, 2.5]);
    }

    #[test]
    fn a_circle_is_opened_at_the_link_that_closes_it() {
        let link = |from, to| Link { from, to, label: Size::default() };
        let links = [link(0, 1), link(1, 2), link(2, 0), link(0, 0)];
        let down = downward(3, &links);
        assert_eq!(down[..3], [true, true, false]);
        assert_eq!(ranks(3, &links, &down), [0, 2, 4]);
    }
}

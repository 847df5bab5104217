//! Layered layout of boxes and arrows: boxes in ranks from top to bottom, or from left to right, labels in ranks between
//! them. Arrows to a common target share one line (a lane) and one head. The order in each rank keeps crossings few; the
//! positions are close to those of connected boxes.
//!
//! # Source
//! Sugiyama, Tagawa, Toda 1981; ranks of labels as in Gansner, Koutsofios, North, Vo 1993; ranks of bounded width as in
//! Coffman, Graham 1972. Positions within a rank are the least-squares positions under the rank's order (pool adjacent
//! violators).

use std::collections::BTreeMap;

use super::geometry::{LineStep, Point, Size};

/// An arrow between two boxes, with the size of its label; an arrow without a label has an empty one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Link {
    pub(super) from: usize,
    pub(super) to: usize,
    pub(super) label: Size,
}

/// The line of an arrow and the position of its label.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Route {
    /// From the source to the base of the head, with a gap for the label.
    pub(super) line: Vec<LineStep>,
    /// The base of the head, and its tip at the target.
    pub(super) head: (Point, Point),
    /// Centre of the label.
    pub(super) label: Point,
}

impl Route {
    /// Moves the arrow with its label.
    pub(super) fn move_by(&mut self, by: Point) {
        let moved = |p: Point| (p.0 + by.0, p.1 + by.1);
        self.line.iter_mut().for_each(|step| *step = step.map(moved));
        self.head = (moved(self.head.0), moved(self.head.1));
        self.label = moved(self.label);
    }
}

/// A layout: the upper left corners of the boxes, the arrows, and the total size.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct GraphLayout {
    pub(super) corners: Vec<Point>,
    pub(super) routes: Vec<Route>,
    pub(super) size: Size,
}

/// The direction in which arrows point that do not go back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Direction {
    Down,
    Right,
}

/// Length of an arrow's head, px.
pub(super) const HEAD: f64 = 8.0;
/// Space around a label along its arrow and beside it, px.
const LABEL_MARGIN: Size = Size { width: 4.0, height: 3.0 };
/// Space between neighbours in a rank, px: between boxes, and where one is a label or a line.
const GAPS: (f64, f64) = (26.0, 14.0);
/// Space between ranks, px.
const RISE: f64 = 10.0;
/// Least distance of two arrows at a box, px.
const PORTS: f64 = 14.0;
/// Distance of two arrows at a box below which those that leave become one, px.
const CROWDED: f64 = 6.0;
/// Iterations of the ordering.
const SWEEPS: usize = 12;
/// Iterations of the positioning.
const ROUNDS: usize = 40;

/// An item of a rank: a box, a label, or a point where a lane passes.
#[derive(Clone, Copy, Debug)]
struct Item {
    size: Size,
    rank: usize,
    x: f64,
}

/// The items of a link from top to bottom.
struct Chain {
    items: Vec<usize>,
    /// Whether the link points up.
    up: bool,
    label: Option<usize>,
}

struct Layers {
    /// Number of boxes; they are the first items.
    boxes: usize,
    items: Vec<Item>,
    ranks: Vec<Vec<usize>>,
    /// Neighbours in the rank above and below, and how strongly each pulls.
    above: Vec<Vec<(usize, f64)>>,
    below: Vec<Vec<(usize, f64)>>,
    chains: Vec<Chain>,
}

/// Lays out boxes and links between different boxes. No rank of boxes is wider than `breadth` px (across the direction),
/// unless one box is.
pub(super) fn draw(boxes: &[Size], links: &[Link], direction: Direction, breadth: f64) -> GraphLayout {
    match direction {
        Direction::Down => draw_down(boxes, links, breadth),
        Direction::Right => {
            let boxes: Vec<Size> = boxes.iter().map(|b| b.turned()).collect();
            let links: Vec<Link> = links.iter().map(|l| Link { label: l.label.turned(), ..*l }).collect();
            turned(draw_down(&boxes, &links, breadth))
        }
    }
}

/// The drawing with its axes exchanged.
fn turned(drawing: GraphLayout) -> GraphLayout {
    let turn = |(x, y): Point| (y, x);
    let route = |route: Route| Route {
        line: route.line.into_iter().map(|step| step.map(turn)).collect(),
        head: (turn(route.head.0), turn(route.head.1)),
        label: turn(route.label),
    };
    GraphLayout {
        corners: drawing.corners.into_iter().map(turn).collect(),
        routes: drawing.routes.into_iter().map(route).collect(),
        size: drawing.size.turned(),
    }
}

fn draw_down(boxes: &[Size], links: &[Link], breadth: f64) -> GraphLayout {
    if boxes.is_empty() {
        return GraphLayout::default();
    }
    let mut layers = Layers::of(boxes, links, breadth);
    layers.order();
    layers.place();
    layers.finish()
}

impl Layers {
    fn of(boxes: &[Size], links: &[Link], breadth: f64) -> Self {
        let down = downward(boxes.len(), links);
        let ranks = ranks(boxes, links, &down, breadth);
        let mut items: Vec<Item> =
            boxes.iter().zip(&ranks).map(|(size, rank)| Item { size: *size, rank: *rank, x: 0.0 }).collect();
        let mut add = |size: Size, rank: usize| {
            items.push(Item { size, rank, x: 0.0 });
            items.len() - 1
        };
        let (mut chains, mut lanes) = (Vec::new(), BTreeMap::new());
        for (link, down) in links.iter().zip(&down) {
            let (top, bottom) = if *down { (link.from, link.to) } else { (link.to, link.from) };
            // The label is at the end that fewer links share; the rest of the link is a lane of the other end.
            let leaving = links.iter().filter(|l| l.from == link.from).count();
            let at_source = leaving <= links.iter().filter(|l| l.to == link.to).count();
            let label_rank = if at_source == *down { ranks[top] + 1 } else { ranks[bottom] - 1 };
            let end = if at_source { link.to } else { link.from };
            let mut label = None;
            let mut chain = vec![top];
            for rank in ranks[top] + 1..ranks[bottom] {
                if rank == label_rank && link.label != Size::default() {
                    let size = Size {
                        width: link.label.width + 2.0 * LABEL_MARGIN.width,
                        height: link.label.height + 2.0 * LABEL_MARGIN.height,
                    };
                    label = Some(add(size, rank));
                    chain.extend(label);
                } else {
                    let lane = lanes.entry((end, at_source, rank));
                    chain.push(*lane.or_insert_with(|| add(Size::default(), rank)));
                }
            }
            chain.push(bottom);
            chains.push(Chain { items: chain, up: !*down, label });
        }
        let mut layers = Self {
            boxes: boxes.len(),
            ranks: vec![Vec::new(); items.iter().map(|i| i.rank).max().unwrap_or(0) + 1],
            above: vec![Vec::new(); items.len()],
            below: vec![Vec::new(); items.len()],
            items,
            chains,
        };
        layers.connect();
        layers
    }

    fn connect(&mut self) {
        for (at, item) in self.items.iter().enumerate() {
            self.ranks[item.rank].push(at);
        }
        for chain in &self.chains {
            // Lanes are kept straight first, then the way ahead; arrows back and past other states bend for them.
            let at_box = match (chain.up, chain.items.len()) {
                (true, _) => 0.1,
                (false, ..=3) => 4.0,
                (false, _) => 0.5,
            };
            for pair in chain.items.windows(2) {
                let pull = if pair.iter().all(|item| *item >= self.boxes) { 8.0 } else { at_box };
                if self.below[pair[0]].iter().all(|(item, _)| *item != pair[1]) {
                    self.below[pair[0]].push((pair[1], pull));
                    self.above[pair[1]].push((pair[0], pull));
                }
            }
        }
    }

    // Ordering within the ranks.

    fn order(&mut self) {
        let mut best = (self.crossings(), self.ranks.clone());
        for sweep in 0..SWEEPS {
            let last = self.ranks.len().saturating_sub(1);
            for step in 0..=last {
                let rank = if sweep % 2 == 0 { step } else { last - step };
                self.sort(rank, sweep % 2 == 0);
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
    fn sort(&mut self, rank: usize, downward: bool) {
        let current = self.positions();
        let neighbours = if downward { &self.above } else { &self.below };
        let key = |item: &usize| {
            let near = &neighbours[*item];
            if near.is_empty() {
                return current[*item];
            }
            near.iter().map(|(n, _)| current[*n]).sum::<f64>() / near.len() as f64
        };
        self.ranks[rank].sort_by(|a, b| key(a).total_cmp(&key(b)));
    }

    fn crossings(&self) -> usize {
        let place = self.positions();
        let mut count = 0;
        for rank in &self.ranks {
            let mut ends: Vec<(usize, usize)> = Vec::new();
            for (at, item) in rank.iter().enumerate() {
                ends.extend(self.below[*item].iter().map(|(b, _)| (at, place[*b] as usize)));
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
            for (at, item) in rank.iter().enumerate() {
                x += if at > 0 { self.distance(rank[at - 1], *item) } else { 0.0 };
                self.items[*item].x = x;
            }
        }
        let last = self.ranks.len() - 1;
        for round in 0..ROUNDS {
            let down = round % 2 == 0;
            for step in 0..=last {
                let settled = round > 3;
                self.pull(if down { step } else { last - step }, down || settled, !down || settled);
            }
        }
        // What follows goes straight on from what is above it: a bend is where it is needed, not a bit in each rank.
        (0..=last).for_each(|rank| self.pull(rank, true, false));
        let left = self.items.iter().map(|i| i.x - i.size.width / 2.0).fold(f64::INFINITY, f64::min);
        self.items.iter_mut().for_each(|i| i.x -= left);
    }

    /// Distance of the centres of two neighbours in a rank, px.
    fn distance(&self, left: usize, right: usize) -> f64 {
        let gap = if left < self.boxes && right < self.boxes { GAPS.0 } else { GAPS.1 };
        (self.items[left].size.width + self.items[right].size.width) / 2.0 + gap
    }

    /// Moves a rank's items towards the mean of their neighbours, keeping their order and without overlap.
    fn pull(&mut self, rank: usize, to_above: bool, to_below: bool) {
        let members = &self.ranks[rank];
        let mut offset = 0.0;
        let mut wanted: Vec<(f64, f64)> = Vec::new();
        let mut offsets = Vec::new();
        for (at, item) in members.iter().enumerate() {
            if at > 0 {
                offset += self.distance(members[at - 1], *item);
            }
            offsets.push(offset);
            let above = self.above[*item].iter().filter(|_| to_above);
            let below = self.below[*item].iter().filter(|_| to_below);
            let near = above.chain(below).map(|(n, pull)| (self.items[*n].x, *pull));
            let (sum, weight) = near.fold((0.0, 0.0), |(sum, all), (x, w)| (sum + x * w, all + w));
            // What nothing pulls stays beside its neighbour.
            let beside = wanted.last().map_or(self.items[*item].x - offset, |(x, _)| *x);
            wanted.push(if weight == 0.0 { (beside, 1e-3) } else { (sum / weight - offset, weight) });
        }
        let fitted = increasing(&wanted);
        for ((item, x), offset) in self.ranks[rank].clone().into_iter().zip(fitted).zip(offsets) {
            self.items[item].x = x + offset;
        }
    }

    /// Space below a rank: more where arrows run far sideways.
    fn rise(&self, rank: &[usize]) -> f64 {
        let aside = |item: &usize| {
            let below = self.below[*item].iter().map(|(b, _)| (self.items[*b].x - self.items[*item].x).abs());
            below.fold(0.0, f64::max)
        };
        RISE + (rank.iter().map(aside).fold(0.0, f64::max) / 12.0).min(50.0)
    }

    fn finish(self) -> GraphLayout {
        let (mut tops, mut heights, mut y) = (Vec::new(), Vec::new(), 0.0);
        for (number, rank) in self.ranks.iter().enumerate() {
            let height = rank.iter().map(|i| self.items[*i].size.height).fold(0.0, f64::max);
            // Boxes have room for the heads above and below them.
            let height = height + if number.is_multiple_of(2) { 2.0 * HEAD } else { 0.0 };
            tops.push(y);
            heights.push(height);
            y += height + self.rise(rank);
        }
        let corner = |i: usize| {
            let item = self.items[i];
            (item.x - item.size.width / 2.0, tops[item.rank] + HEAD)
        };
        let ports = self.ports();
        let route = |(chain, port): (&Chain, &(f64, f64))| self.route(chain, *port, &tops, &heights);
        let routes = self.chains.iter().zip(&ports).map(route).collect();
        let right = self.items.iter().map(|i| i.x + i.size.width / 2.0).fold(0.0, f64::max);
        let last = self.ranks.last().map_or(0.0, |rank| self.rise(rank));
        let size = Size { width: right, height: (y - last).max(0.0) };
        GraphLayout { corners: (0..self.boxes).map(corner).collect(), routes, size }
    }

    /// The line of a chain: vertical within the ranks, curved between them.
    fn route(&self, chain: &Chain, port: (f64, f64), tops: &[f64], heights: &[f64]) -> Route {
        // Vertical strokes from top to bottom; none stands for the gap of the label.
        let mut strokes: Vec<Option<(f64, f64, f64)>> = Vec::new();
        let ends = (chain.items[0], chain.items[chain.items.len() - 1]);
        let from = tops[self.items[ends.0].rank] + HEAD + self.items[ends.0].size.height;
        let to = tops[self.items[ends.1].rank] + HEAD;
        let mut middle = ((port.0 + port.1) / 2.0, (from + to) / 2.0);
        for item in &chain.items {
            let of = self.items[*item];
            let (top, bottom) = (tops[of.rank], tops[of.rank] + heights[of.rank]);
            if *item == ends.0 {
                strokes.push(Some((port.0, if chain.up { from + HEAD } else { from }, bottom)));
            } else if *item == ends.1 {
                strokes.push(Some((port.1, top, if chain.up { to } else { top })));
            } else if chain.label == Some(*item) {
                middle = (of.x, (top + bottom) / 2.0);
                let half = of.size.height / 2.0 - LABEL_MARGIN.height / 2.0;
                strokes.push(Some((of.x, top, middle.1 - half)));
                strokes.push(None);
                strokes.push(Some((of.x, middle.1 + half, bottom)));
            } else {
                strokes.push(Some((of.x, top, bottom)));
            }
        }
        let (base, tip) = if chain.up { (from + HEAD, from) } else { (to - HEAD, to) };
        let x = if chain.up { port.0 } else { port.1 };
        if chain.up {
            strokes.reverse();
            strokes.iter_mut().flatten().for_each(|s| *s = (s.0, s.2, s.1));
        }
        Route { line: line(&strokes), head: ((x, base), (x, tip)), label: middle }
    }

    /// For each chain, where it leaves the lower side of its upper box and enters the upper side of its lower box. All
    /// links that arrive at a side do so at one point. Points are near the next item of their link, at a distance from
    /// each other.
    fn ports(&self) -> Vec<(f64, f64)> {
        // For each side (box, whether it is the lower one): the next items, by the lane that they belong to.
        let mut sides: BTreeMap<(usize, bool), BTreeMap<Option<usize>, Vec<f64>>> = BTreeMap::new();
        let key = |chain: &Chain, lower: bool| {
            let last = chain.items.len() - 1;
            let (end, next) = if lower { (0, 1) } else { (last, last - 1) };
            let arrives = lower == chain.up;
            ((chain.items[end], lower), (!arrives).then_some(chain.items[next]), chain.items[next])
        };
        for chain in &self.chains {
            for lower in [true, false] {
                let (side, lane, next) = key(chain, lower);
                sides.entry(side).or_default().entry(lane).or_default().push(self.items[next].x);
            }
        }
        let mut points = BTreeMap::new();
        for (side, lanes) in sides {
            let of = self.items[side.0];
            let room = (of.size.width - PORTS).max(0.0);
            // Where there is no room for all links that leave, they leave as one.
            let crowded = (lanes.len() - 1) as f64 * CROWDED > room;
            let mut ports: Vec<(f64, Vec<Option<usize>>)> = Vec::new();
            let (leaving, arriving): (Vec<_>, Vec<_>) =
                lanes.into_iter().partition(|(lane, _)| lane.is_some());
            let mean = |list: &[f64]| list.iter().sum::<f64>() / list.len() as f64;
            ports.extend(arriving.iter().map(|(lane, x)| (mean(x), vec![*lane])));
            if crowded {
                let all: Vec<f64> = leaving.iter().flat_map(|(_, x)| x.clone()).collect();
                ports.push((mean(&all), leaving.iter().map(|(lane, _)| *lane).collect()));
            } else {
                ports.extend(leaving.iter().map(|(lane, x)| (mean(x), vec![*lane])));
            }
            ports.sort_by(|a, b| a.0.total_cmp(&b.0));
            let gaps = (ports.len() - 1) as f64;
            let apart = PORTS.min(room / gaps.max(1.0));
            let left = of.x - room / 2.0;
            let slack = (room - apart * gaps).max(0.0);
            let wanted: Vec<(f64, f64)> =
                ports.iter().enumerate().map(|(n, (x, _))| (x - n as f64 * apart, 1.0)).collect();
            for (n, (x, (_, lanes))) in increasing(&wanted).into_iter().zip(&ports).enumerate() {
                let x = x.clamp(left, left + slack) + n as f64 * apart;
                points.extend(lanes.iter().map(|lane| ((side, *lane), x)));
            }
        }
        let point = |chain: &Chain, lower: bool| {
            let (side, lane, _) = key(chain, lower);
            points[&(side, lane)]
        };
        self.chains.iter().map(|chain| (point(chain, true), point(chain, false))).collect()
    }
}

/// Strokes as one line with curves between them, vertical at their ends.
fn line(strokes: &[Option<(f64, f64, f64)>]) -> Vec<LineStep> {
    let mut steps: Vec<LineStep> = Vec::new();
    let mut last: Option<Point> = None;
    for stroke in strokes {
        let Some((x, from, to)) = *stroke else {
            last = None;
            continue;
        };
        match last {
            None => steps.push(LineStep::Move((x, from))),
            Some((before, _)) if (before - x).abs() < 0.05 => steps.push(LineStep::Line((x, from))),
            Some((before, y)) => {
                let middle = (y + from) / 2.0;
                steps.push(LineStep::Curve((before, middle), (x, middle), (x, from)));
            }
        }
        steps.push(LineStep::Line((x, to)));
        last = Some((x, to));
    }
    steps
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

/// Ranks by the longest path from a box without incoming links; boxes have even ranks, labels lie between. A box for
/// which a rank has no room goes further down; boxes without links are in the last.
fn ranks(boxes: &[Size], links: &[Link], down: &[bool], breadth: f64) -> Vec<usize> {
    let mut rank = vec![0; boxes.len()];
    let mut waiting: Vec<usize> = vec![0; boxes.len()];
    let mut out: Vec<Vec<usize>> = vec![Vec::new(); boxes.len()];
    for (link, down) in links.iter().zip(down) {
        let (top, bottom) = if *down { (link.from, link.to) } else { (link.to, link.from) };
        out[top].push(bottom);
        waiting[bottom] += 1;
    }
    let linked = |b: &usize| waiting[*b] > 0 || !out[*b].is_empty();
    let (roots, alone): (Vec<usize>, Vec<usize>) =
        (0..boxes.len()).filter(|b| waiting[*b] == 0).partition(linked);
    let mut filled: Vec<f64> = Vec::new();
    let mut settle = |at: usize, least: usize| {
        let mut level = least / 2;
        loop {
            filled.resize(filled.len().max(level + 1), 0.0);
            if filled[level] == 0.0 || filled[level] + boxes[at].width <= breadth {
                filled[level] += boxes[at].width + GAPS.0;
                return level * 2;
            }
            level += 1;
        }
    };
    let mut last = 0;
    let mut free = std::collections::VecDeque::from(roots);
    while let Some(at) = free.pop_front() {
        rank[at] = settle(at, rank[at]);
        last = last.max(rank[at]);
        for to in &out[at] {
            rank[*to] = rank[*to].max(rank[at] + 2);
            waiting[*to] -= 1;
            if waiting[*to] == 0 {
                free.push_back(*to);
            }
        }
    }
    for at in alone {
        rank[at] = settle(at, last);
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
        let links = [link(0, 1), link(1, 2), link(2, 0)];
        let down = downward(3, &links);
        assert_eq!(down, [true, true, false]);
        assert_eq!(ranks(&[Size::default(); 3], &links, &down, 100.0), [0, 2, 4]);
    }

    #[test]
    fn a_full_rank_sends_boxes_further_down_and_boxes_without_links_are_in_the_last() {
        let wide = [Size { width: 50.0, height: 10.0 }; 5];
        let link = |to| Link { from: 0, to, label: Size::default() };
        assert_eq!(ranks(&wide, &[1, 2, 3].map(link), &[true; 3], 130.0), [0, 2, 2, 4, 4]);
    }
}

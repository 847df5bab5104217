//! Nested boxes: each state's content is laid out first, and the state's box gets its size. The content of a state runs
//! down or to the right, whichever fits the picture better.

use armarium_runtime::chart::{Outline, OutlineKind};

use super::font::{LINE, Weight, width};
use super::geometry::{Point, Rect, Size};
use super::graph::{Exit, Graph};
use super::layers::{Direction, Drawing, Link, Route, draw};

/// Space between a box and its content, px.
pub(super) const PAD: f64 = 12.0;
/// Space between regions, px.
const GAP: f64 = 12.0;
/// Diameter of the dot at a composite's entry, px.
pub(super) const DOT: f64 = 10.0;
/// Diameter of a history symbol, px.
const HISTORY: f64 = 28.0;
/// Height of the frame around the name of an exit's target, px; its width is that of the name with `PILL_PAD` beside it.
pub(super) const PILL: f64 = LINE + 2.0;
pub(super) const PILL_PAD: f64 = 6.0;
/// Space above an exit, px.
pub(super) const EXIT_GAP: f64 = 3.0;

/// A laid-out state; coordinates are relative to the whole picture once all are placed.
#[derive(Clone, Debug, Default)]
pub(super) struct Placed {
    pub(super) state: usize,
    pub(super) frame: Rect,
    pub(super) title: String,
    /// The kind of state, under the title; may be empty.
    pub(super) subtitle: String,
    pub(super) notes: Vec<String>,
    pub(super) exits: Vec<Exit>,
    pub(super) inside: Vec<Placed>,
    /// The arrows between the states inside: the lines of the label, and the route.
    pub(super) arrows: Vec<(Vec<String>, Route)>,
    /// The corner of the initial state's dot.
    pub(super) dot: Option<Point>,
}

/// Lays out a state with its descendants, at most `breadth` px wide if it can; its corner is at the origin.
pub(super) fn lay_out(outline: &Outline, graph: &Graph, state: usize, breadth: f64) -> Placed {
    let of = &outline.states[state];
    let mut placed = head(outline, graph, state);
    let inner_breadth = breadth - 2.0 * PAD;
    let inside: Vec<Placed> =
        of.children.iter().map(|c| lay_out(outline, graph, *c, inner_breadth)).collect();
    if inside.is_empty() {
        return placed;
    }
    let top = placed.frame.size.height;
    let inner = match of.kind {
        OutlineKind::Parallel => regions(&mut placed, inside, inner_breadth),
        _ => states(outline, graph, &mut placed, inside, inner_breadth),
    };
    placed.frame.size.width = placed.frame.size.width.max(inner.width + 2.0 * PAD);
    placed.frame.size.height = top + inner.height + PAD;
    // Content narrower than the title is centred.
    let offset = ((placed.frame.size.width - inner.width) / 2.0, top);
    placed.inside.iter_mut().for_each(|inner| inner.move_by(offset));
    placed.move_arrows(offset);
    placed
}

/// How badly a size fits. Screens are wide and pages long: height counts more, unless the picture is wider than `breadth`.
fn cost(size: Size, breadth: f64) -> f64 {
    (size.width + 3.0 * size.height) * (1.0 + 100.0 * (size.width / breadth - 1.0).max(0.0))
}

/// A state without its content.
fn head(outline: &Outline, graph: &Graph, state: usize) -> Placed {
    let of = &outline.states[state];
    let subtitle = match &of.kind {
        OutlineKind::Skill(name) => format!("skill {name}"),
        OutlineKind::Chart(name) => format!("chart {name}"),
        OutlineKind::Remote(name) => format!("remote {name}"),
        OutlineKind::Final(outcome) if *outcome != of.name.to_lowercase() => outcome.clone(),
        _ => String::new(),
    };
    let mut placed = Placed {
        state,
        title: of.name.clone(),
        subtitle,
        notes: graph.notes.get(&state).cloned().unwrap_or_default(),
        exits: graph.exits.get(&state).cloned().unwrap_or_default(),
        ..Placed::default()
    };
    placed.frame.size = if let OutlineKind::History { deep } = of.kind {
        placed.title = if deep { "H*".into() } else { "H".into() };
        Size { width: HISTORY, height: HISTORY }
    } else {
        let labels = placed.exits.iter().map(|exit| label_size(&exit.label).width).fold(0.0, f64::max);
        let exits = placed.exits.iter().map(|exit| exit_size(outline, exit));
        let exits = exits.fold(Size::default(), |all, one| Size {
            width: all.width.max(labels + PILL_PAD + one.width),
            height: all.height + one.height + EXIT_GAP,
        });
        let lines = placed.notes.iter().chain([&placed.subtitle]).map(|n| width(n, Weight::Regular));
        let widest = lines.chain([width(&placed.title, Weight::Bold), exits.width]).fold(0.0, f64::max);
        let lines = 1 + usize::from(!placed.subtitle.is_empty()) + placed.notes.len();
        Size { width: (widest + 2.0 * PAD).max(56.0), height: lines as f64 * LINE + exits.height + 12.0 }
    };
    placed
}

/// The name of an exit's target, as it is written beside the exit.
pub(super) fn exit_target(outline: &Outline, exit: &Exit) -> String {
    format!("→ {}", outline.states[exit.target].name)
}

fn exit_size(outline: &Outline, exit: &Exit) -> Size {
    let target = width(&exit_target(outline, exit), Weight::Regular) + 2.0 * PILL_PAD;
    Size { width: target, height: (exit.label.len() as f64 * LINE).max(PILL) }
}

/// Regions in rows: as many in a row as give the best shape.
fn regions(placed: &mut Placed, inside: Vec<Placed>, breadth: f64) -> Size {
    let rows = |count: usize| {
        let (mut corners, mut size) = (Vec::new(), Size::default());
        for row in inside.chunks(count) {
            let (mut x, top) = (0.0, if corners.is_empty() { 0.0 } else { size.height + GAP });
            for region in row {
                corners.push((x, top));
                size.height = size.height.max(top + region.frame.size.height);
                x += region.frame.size.width + GAP;
            }
            size.width = size.width.max(x - GAP);
        }
        (corners, size)
    };
    let all = (1..=inside.len()).map(rows);
    let (corners, size) = all
        .min_by(|a, b| cost(a.1, breadth).total_cmp(&cost(b.1, breadth)))
        .expect("a parallel state with regions has a row");
    placed.inside = inside;
    placed.inside.iter_mut().zip(corners).for_each(|(region, corner)| region.move_by(corner));
    size
}

/// States in layers, with the dot of the initial state.
fn states(outline: &Outline, graph: &Graph, placed: &mut Placed, inside: Vec<Placed>, breadth: f64) -> Size {
    let state = placed.state;
    let place = |child: usize| outline.states[state].children.iter().position(|c| *c == child);
    let mut boxes: Vec<Size> = inside.iter().map(|p| p.frame.size).collect();
    let dot = boxes.len();
    let (mut links, mut labels) = (Vec::new(), Vec::new());
    let mut link = |from: usize, to: usize, label: Vec<String>| {
        links.push(Link { from, to, label: label_size(&label) });
        labels.push(label);
    };
    for target in &outline.states[state].initial {
        let mut outward = std::iter::successors(Some(*target), |s| outline.states[*s].parent);
        let Some(to) = outward.find_map(place) else { continue };
        let below = outline.states[state].children[to] != *target;
        let label = if below { vec![format!("› {}", outline.path(*target))] } else { Vec::new() };
        link(dot, to, label);
    }
    for arrow in graph.arrows.get(&state).into_iter().flatten() {
        if let (Some(from), Some(to)) = (place(arrow.from), place(arrow.to)) {
            link(from, to, arrow.label.clone());
        }
    }
    let begins = links.first().is_some_and(|link: &Link| link.from == dot);
    if begins {
        boxes.push(Size { width: DOT, height: DOT });
    }
    let drawn = [Direction::Down, Direction::Right].map(|direction| draw(&boxes, &links, direction, breadth));
    let [down, right] = &drawn;
    let better = usize::from(cost(right.size, breadth) < cost(down.size, breadth));
    let Drawing { corners, routes, size } = drawn[better].clone();
    placed.inside = inside;
    placed.inside.iter_mut().zip(&corners).for_each(|(inner, corner)| inner.move_by(*corner));
    placed.arrows = labels.into_iter().zip(routes).collect();
    placed.dot = begins.then(|| corners[dot]);
    size
}

/// The extent of the lines of a label; nothing for none.
pub(super) fn label_size(label: &[String]) -> Size {
    let widest = label.iter().map(|line| width(line, Weight::Regular)).fold(0.0, f64::max);
    Size { width: widest, height: label.len() as f64 * LINE }
}

impl Placed {
    /// Moves a state with its descendants.
    pub(super) fn move_by(&mut self, by: Point) {
        self.frame = self.frame.moved(by);
        self.inside.iter_mut().for_each(|inner| inner.move_by(by));
        self.move_arrows(by);
    }

    fn move_arrows(&mut self, by: Point) {
        let moved = |p: Point| (p.0 + by.0, p.1 + by.1);
        for (_, route) in &mut self.arrows {
            route.line.iter_mut().for_each(|step| *step = step.map(moved));
            route.head = (moved(route.head.0), moved(route.head.1));
            route.label = moved(route.label);
        }
        self.dot = self.dot.map(moved);
    }
}

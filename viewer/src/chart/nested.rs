//! Nested boxes: each state's content is laid out first, and the state's box gets its size. The content of a state runs
//! down or to the right, whichever fits the picture better.

use armarium_runtime::chart::{Outline, OutlineKind};

use super::font::{LINE, Weight, width};
use super::geometry::{Point, Rect, Size};
use super::graph::{Exit, Graph, outward};
use super::layers::{Direction, GraphLayout, Link, Route, draw};

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

/// Regions in rows.
fn regions(placed: &mut Placed, inside: Vec<Placed>, breadth: f64) -> Size {
    let sizes: Vec<Size> = inside.iter().map(|region| region.frame.size).collect();
    let (corners, size) = in_rows(&sizes, breadth);
    placed.inside = inside;
    placed.inside.iter_mut().zip(corners).for_each(|(region, corner)| region.move_by(corner));
    size
}

/// The corners of frames in rows, as many in a row as give the best shape, and the size of all.
fn in_rows(sizes: &[Size], breadth: f64) -> (Vec<Point>, Size) {
    let rows = |count: usize| {
        let (mut corners, mut all) = (Vec::new(), Size::default());
        for row in sizes.chunks(count) {
            let (mut x, top) = (0.0, if corners.is_empty() { 0.0 } else { all.height + GAP });
            for size in row {
                corners.push((x, top));
                all.height = all.height.max(top + size.height);
                x += size.width + GAP;
            }
            all.width = all.width.max(x - GAP);
        }
        (corners, all)
    };
    let all = (1..=sizes.len()).map(rows);
    all.min_by(|a, b| cost(a.1, breadth).total_cmp(&cost(b.1, breadth))).unwrap_or_default()
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
        let Some(to) = outward(outline, *target).find_map(place) else { continue };
        let below = outline.states[state].children[to] != *target;
        let label = if below { vec![format!("› {}", outline.path(*target))] } else { Vec::new() };
        link(dot, to, label);
    }
    for arrow in graph.arrows.get(&state).into_iter().flatten() {
        if let (Some(from), Some(to)) = (place(arrow.from), place(arrow.to)) {
            link(from, to, arrow.label.clone());
        }
    }
    let begins = links.first().filter(|link| link.from == dot).map(|link| link.to);
    if begins.is_some() {
        boxes.push(Size { width: DOT, height: DOT });
    }
    let mut column: Vec<usize> = outline.states[state].children.iter().map(|c| graph.column(*c)).collect();
    column.extend(begins.map(|begins| column[begins]));
    let drawn = columns(&column, &boxes, &links, breadth);
    let sizes: Vec<Size> = drawn.iter().map(|(_, _, drawing)| drawing.size).collect();
    let (corners, size) = in_rows(&sizes, breadth);
    placed.inside = inside;
    let mut routes = vec![Route::default(); links.len()];
    for ((members, arrows, drawing), corner) in drawn.into_iter().zip(corners) {
        for (member, at) in members.into_iter().zip(drawing.corners) {
            let at = (at.0 + corner.0, at.1 + corner.1);
            match placed.inside.get_mut(member) {
                Some(inner) => inner.move_by(at),
                None => placed.dot = Some(at),
            }
        }
        for (arrow, mut route) in arrows.into_iter().zip(drawing.routes) {
            route.move_by(corner);
            routes[arrow] = route;
        }
    }
    placed.arrows = labels.into_iter().zip(routes).collect();
    size
}

/// The drawings of columns, each with its boxes and its links: those between boxes of one column. `column` is that of each box.
fn columns(
    column: &[usize],
    boxes: &[Size],
    links: &[Link],
    breadth: f64,
) -> Vec<(Vec<usize>, Vec<usize>, GraphLayout)> {
    let count = column.iter().max().map_or(0, |last| last + 1);
    let mut columns = vec![(Vec::new(), Vec::new()); count];
    let mut place = vec![0; boxes.len()];
    for (member, at) in column.iter().enumerate() {
        place[member] = columns[*at].0.len();
        columns[*at].0.push(member);
    }
    for (number, link) in links.iter().enumerate().filter(|(_, link)| column[link.from] == column[link.to]) {
        columns[column[link.from]].1.push(number);
    }
    let one = |(members, arrows): (Vec<usize>, Vec<usize>)| {
        let sizes: Vec<Size> = members.iter().map(|member| boxes[*member]).collect();
        let inside = |number: &usize| {
            let link = links[*number];
            Link { from: place[link.from], to: place[link.to], ..link }
        };
        let links: Vec<Link> = arrows.iter().map(inside).collect();
        let [down, right] =
            [Direction::Down, Direction::Right].map(|direction| draw(&sizes, &links, direction, breadth));
        let better = if cost(right.size, breadth) < cost(down.size, breadth) { right } else { down };
        (members, arrows, better)
    };
    columns.into_iter().map(one).collect()
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
        self.arrows.iter_mut().for_each(|(_, route)| route.move_by(by));
        self.dot = self.dot.map(|dot| (dot.0 + by.0, dot.1 + by.1));
    }
}

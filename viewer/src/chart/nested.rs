//! Nested boxes: each state's content is laid out first, and the state's box gets its size.

use armarium_runtime::chart::{Outline, OutlineKind};

use super::graph::{Arrow, Graph};
use super::layers::{Drawing, Link, Route, Size, draw};
use super::measure::{LINE, width};

/// Space between a box and its content, px.
const PAD: f64 = 14.0;
/// Diameter of the dot at a composite's entry, px.
pub(super) const DOT: f64 = 10.0;
/// Diameter of a history symbol, px.
const HISTORY: f64 = 28.0;

/// A laid-out state; coordinates are relative to the whole picture once all are placed.
#[derive(Clone, Debug)]
pub(super) struct Placed {
    pub(super) state: usize,
    pub(super) x: f64,
    pub(super) y: f64,
    pub(super) size: Size,
    pub(super) title: String,
    /// The kind of state, under the title; may be empty.
    pub(super) subtitle: String,
    pub(super) notes: Vec<String>,
    pub(super) inside: Vec<Placed>,
    pub(super) arrows: Vec<(Arrow, Route)>,
    /// Lines between regions: x, start y, end y.
    pub(super) partings: Vec<(f64, f64, f64)>,
    /// The dot of the initial state.
    pub(super) dot: Option<(f64, f64)>,
}

/// Lays out a state with its descendants; its corner is at the origin.
pub(super) fn lay_out(outline: &Outline, graph: &Graph, state: usize) -> Placed {
    let of = &outline.states[state];
    let mut placed = head(outline, graph, state);
    let inside: Vec<Placed> = of.children.iter().map(|c| lay_out(outline, graph, *c)).collect();
    if inside.is_empty() {
        return placed;
    }
    let top = placed.size.height;
    let inner = match of.kind {
        OutlineKind::Parallel => regions(&mut placed, inside, top),
        _ => states(outline, graph, &mut placed, inside, top),
    };
    placed.size.width = placed.size.width.max(inner.width + 2.0 * PAD);
    placed.size.height = top + inner.height + PAD;
    // Content narrower than the title is centred.
    let shift = (placed.size.width - inner.width) / 2.0 - PAD;
    if shift > 0.0 {
        placed.inside.iter_mut().for_each(|inner| move_by(inner, shift, 0.0));
        move_arrows(&mut placed, shift, 0.0);
    }
    placed
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
    let notes = graph.notes.get(&state).cloned().unwrap_or_default();
    let history = matches!(of.kind, OutlineKind::History { .. });
    let title = match &of.kind {
        OutlineKind::History { deep: true } => "H*".into(),
        OutlineKind::History { deep: false } => "H".into(),
        _ => of.name.clone(),
    };
    let lines = 1 + usize::from(!subtitle.is_empty()) + notes.len();
    let widest = notes.iter().map(|n| width(n)).chain([width(&title) * 1.08, width(&subtitle)]);
    let size = if history {
        Size { width: HISTORY, height: HISTORY }
    } else {
        let width = widest.fold(0.0, f64::max) + 2.0 * PAD;
        Size { width: width.max(56.0), height: lines as f64 * LINE + 14.0 }
    };
    let (inside, arrows, partings) = (Vec::new(), Vec::new(), Vec::new());
    Placed { state, x: 0.0, y: 0.0, size, title, subtitle, notes, inside, arrows, partings, dot: None }
}

/// Regions side by side, separated by lines.
fn regions(placed: &mut Placed, inside: Vec<Placed>, top: f64) -> Size {
    let height = inside.iter().map(|r| r.size.height).fold(0.0, f64::max);
    let mut x = PAD;
    let count = inside.len();
    for (at, mut region) in inside.into_iter().enumerate() {
        move_by(&mut region, x, top);
        x += region.size.width;
        if at + 1 < count {
            placed.partings.push((x + PAD, top - 4.0, top + height + PAD - 6.0));
            x += 2.0 * PAD;
        }
        placed.inside.push(region);
    }
    Size { width: x - PAD, height }
}

/// States in layers, with the dot of the initial state.
fn states(outline: &Outline, graph: &Graph, placed: &mut Placed, inside: Vec<Placed>, top: f64) -> Size {
    let state = placed.state;
    let arrows = graph.arrows.get(&state).cloned().unwrap_or_default();
    let at = |child: usize| inside.iter().position(|p| p.state == child);
    // The dot comes first, so that the initial state is on top.
    let mut boxes = vec![Size { width: DOT, height: DOT }];
    boxes.extend(inside.iter().map(|p| p.size));
    let mut links = Vec::new();
    let mut shown = Vec::new();
    for target in &outline.states[state].initial {
        let child = std::iter::successors(Some(*target), |s| outline.states[*s].parent)
            .find(|s| outline.states[*s].parent == Some(state));
        let Some((child, to)) = child.and_then(|c| at(c).map(|to| (c, to + 1))) else { continue };
        if links.iter().any(|l: &Link| l.to == to) {
            continue;
        }
        let inner =
            if child == *target { Vec::new() } else { vec![format!("▸ {}", outline.path(*target))] };
        let arrow = Arrow { from: usize::MAX, to: child, label: inner };
        links.push(Link { from: 0, to, label: label_size(&arrow) });
        shown.push(arrow);
    }
    for arrow in arrows {
        if let (Some(from), Some(to)) = (at(arrow.from), at(arrow.to)) {
            links.push(Link { from: from + 1, to: to + 1, label: label_size(&arrow) });
            shown.push(arrow);
        }
    }
    let Drawing { corners, routes, size } = draw(&boxes, &links);
    let shift = |(x, y): (f64, f64)| (x + PAD, y + top);
    for (mut inner, corner) in inside.into_iter().zip(corners[1..].iter()) {
        let (x, y) = shift(*corner);
        move_by(&mut inner, x, y);
        placed.inside.push(inner);
    }
    for (arrow, route) in shown.into_iter().zip(routes) {
        let points = route.points.into_iter().map(shift).collect();
        placed.arrows.push((arrow, Route { points, label: shift(route.label) }));
    }
    let initial = !outline.states[state].initial.is_empty();
    placed.dot = initial.then(|| shift(corners[0]));
    size
}

fn label_size(arrow: &Arrow) -> Size {
    if arrow.label.is_empty() {
        return Size { width: 6.0, height: 0.0 };
    }
    let widest = arrow.label.iter().map(|l| width(l)).fold(0.0, f64::max);
    Size { width: widest + 10.0, height: arrow.label.len() as f64 * LINE }
}

/// Moves a state with its descendants.
pub(super) fn move_by(placed: &mut Placed, dx: f64, dy: f64) {
    placed.x += dx;
    placed.y += dy;
    placed.inside.iter_mut().for_each(|inner| move_by(inner, dx, dy));
    move_arrows(placed, dx, dy);
}

fn move_arrows(placed: &mut Placed, dx: f64, dy: f64) {
    for (_, route) in &mut placed.arrows {
        route.points.iter_mut().for_each(|p| *p = (p.0 + dx, p.1 + dy));
        route.label = (route.label.0 + dx, route.label.1 + dy);
    }
    for parting in &mut placed.partings {
        *parting = (parting.0 + dx, parting.1 + dy, parting.2 + dy);
    }
    if let Some(dot) = &mut placed.dot {
        *dot = (dot.0 + dx, dot.1 + dy);
    }
}

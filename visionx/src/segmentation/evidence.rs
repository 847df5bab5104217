//! What hypotheses become after something was pushed: kept, split, merged, dropped.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::Isometry2;

use super::hypothesis::{Hypothesis, LEAST, of_rest, patches, spread};
use super::labels::{STAYED, labels};
use super::motion::ViewChange;
use super::top_view::{CellIndex, Occupancy, TopCell, TopView, around, mean_of, middle_of, place_of};

/// Fewer changed cells are noise.
const CHANGED: usize = 20;
/// Most motions after one push.
const MOTIONS: usize = 4;
/// A motion that brings the middle of what moved less far than this, m, and turns it less, rad, is rejected.
const LITTLE: (f64, f64) = (0.010, 0.10);
/// A part of a hypothesis with less than this share of it is no part.
const PART: f64 = 0.12;
/// Parts with as many cells between them moved as one thing.
const TOGETHER: i32 = 4;
/// What moved as one is no thing yet while a larger share of it than this is seen not to be where it would have come.
const ASTRAY: f64 = 0.08;
/// What moved as one is no thing yet while it is less convex than this, as two things side by side are, or a piece of one; but after so
/// many pushes it is: as often as `ChoosePush` pushes one at most, if it is not told otherwise.
const CONVEX: f64 = 0.97;
const PUSHED_ENOUGH: u32 = 3;
/// Room around what is compared, cells.
const MARGIN: i32 = 50;

/// A part of a hypothesis that made one motion.
struct Part {
    of: usize,
    label: usize,
    cells: BTreeMap<CellIndex, TopCell>,
}

/// What `known` becomes by a look at the table after `pushed` was pushed; new hypotheses are named from `next` on.
///
/// What has moved by one motion is one thing, and confirmed if all around it did otherwise, all of it is where the motion brings it, and it
/// is convex or was pushed three times; a hypothesis of which a part moved and a part did not is split; what is not there any more is dropped. Hypotheses that moved together are
/// one from now on, and not confirmed, as one may have pushed the other: that, the next push tells.
pub fn told_apart(
    known: &[Hypothesis],
    after: &TopView,
    pushed: Option<&str>,
    next: &mut usize,
) -> Vec<Hypothesis> {
    let counted = |before: &Hypothesis| {
        let pushes = before.pushes + u32::from(pushed == Some(&before.name));
        Hypothesis { pushes, ..before.clone() }
    };
    let known: &[Hypothesis] = &known.iter().map(counted).collect::<Vec<_>>();
    let before = remembered(known, after);
    let change = ViewChange::between(&before, after);
    let motions = motions(&change);
    let parts: Vec<Part> = known
        .iter()
        .enumerate()
        .flat_map(|(of, hypothesis)| parts(of, hypothesis, &change, &motions))
        .collect();
    let mut things = things(known, parts, next);
    for (thing, label) in &mut things {
        if let Some(k) = label.checked_sub(1).filter(|_| !was_confirmed(known, &thing.name)) {
            thing.confirmed &= astray(thing, &motions[k], after) < ASTRAY;
        }
    }
    let mut again = seen_again(things, &motions, after, next);
    for thing in again.iter_mut().filter(|thing| !was_confirmed(known, &thing.name)) {
        thing.confirmed &= thing.convexity() > CONVEX || thing.pushes >= PUSHED_ENOUGH;
    }
    again
}

/// What hypotheses say of the table, over what was seen of it later; where they say nothing it was free.
fn remembered(known: &[Hypothesis], after: &TopView) -> TopView {
    let places = || known.iter().flat_map(|hypothesis| hypothesis.cells.keys());
    let extent = |f: fn(&CellIndex) -> i32| {
        let all = places().copied().chain(after.occupied().map(|(place, _)| place));
        all.map(|place| f(&place)).fold((i32::MAX, i32::MIN), |(a, b), v| (a.min(v), b.max(v)))
    };
    let (x, y) = (extent(|place| place.0), extent(|place| place.1));
    if x.0 > x.1 {
        return TopView::unknown((0, 0), (-1, -1));
    }
    let (low, high) = ((x.0 - MARGIN, y.0 - MARGIN), (x.1 + MARGIN, y.1 + MARGIN));
    let mut view = TopView::unknown(low, high);
    for place in (low.1..=high.1).flat_map(|y| (low.0..=high.0).map(move |x| (x, y))) {
        view.set(place, Occupancy::Free);
    }
    for (place, top) in known.iter().flat_map(|hypothesis| &hypothesis.cells) {
        view.set(*place, Occupancy::Occupied(*top));
    }
    view
}

/// The motions that explain a change, the one that explains the most first.
fn motions(change: &ViewChange<'_>) -> Vec<Isometry2<f64>> {
    let mut motions = Vec::new();
    let mut left = change.without(&Isometry2::identity());
    while left.size() >= CHANGED && motions.len() < MOTIONS {
        let Some(motion) = left.best_motion() else { break };
        let rest = left.without(&motion);
        if left.size() - rest.size() < CHANGED {
            break;
        }
        let middle = mean_of(left.gone.iter().map(|gone| gone.place));
        let way = middle.map_or(0.0, |middle| (motion * middle - middle).norm());
        if way > LITTLE.0 || motion.rotation.angle().abs() > LITTLE.1 {
            motions.push(motion);
        }
        left = rest;
    }
    motions
}

/// The parts of a hypothesis that made different motions. One that is confirmed has no parts.
fn parts(
    of: usize,
    hypothesis: &Hypothesis,
    change: &ViewChange<'_>,
    motions: &[Isometry2<f64>],
) -> Vec<Part> {
    let least = match hypothesis.confirmed {
        true => usize::MAX,
        false => LEAST.max((hypothesis.cells.len() as f64 * PART) as usize),
    };
    let mut parts: BTreeMap<usize, BTreeMap<CellIndex, TopCell>> = BTreeMap::new();
    for (place, label) in labels(&hypothesis.cells, change, (motions, least)) {
        parts.entry(label).or_default().insert(place, hypothesis.cells[&place]);
    }
    parts.into_iter().map(|(label, cells)| Part { of, label, cells }).collect()
}

/// The things that parts are, each with its motion: parts with one motion that are near each other are one.
fn things(known: &[Hypothesis], parts: Vec<Part>, next: &mut usize) -> Vec<(Hypothesis, usize)> {
    let is_split: BTreeSet<usize> = parts
        .iter()
        .filter(|a| parts.iter().any(|b| a.of == b.of && a.label != b.label))
        .map(|part| part.of)
        .collect();
    // A part that keeps the name of its hypothesis: the largest.
    let mut largest: BTreeMap<usize, usize> = BTreeMap::new();
    for part in &parts {
        let most = largest.entry(part.of).or_default();
        *most = (*most).max(part.cells.len());
    }
    let mut named = BTreeSet::new();
    let mut things: Vec<(Hypothesis, usize)> = Vec::new();
    for part in parts {
        let whole = &known[part.of];
        let moved = part.label != STAYED;
        let joined = moved && !whole.confirmed;
        let other = things.iter_mut().find(|(thing, label)| {
            joined
                && *label == part.label
                && !was_confirmed(known, &thing.name)
                && thing.is_near(&part.cells, TOGETHER)
        });
        if let Some((thing, _)) = other {
            thing.cells.extend(part.cells);
            thing.pushes = thing.pushes.max(whole.pushes);
            thing.confirmed = false;
            continue;
        }
        let keeps = part.cells.len() == largest[&part.of] && named.insert(part.of);
        let name = if keeps { whole.name.clone() } else { fresh(next) };
        let confirmed = moved || (whole.confirmed && !is_split.contains(&part.of));
        let pushes = if keeps { whole.pushes } else { 0 };
        things.push((Hypothesis { name, cells: part.cells, confirmed, pushes }, part.label));
    }
    things
}

fn was_confirmed(known: &[Hypothesis], name: &str) -> bool {
    known.iter().any(|before| before.confirmed && before.name == name)
}

/// The share of a thing's surface, as far as its place after a motion is seen, that is not there.
fn astray(thing: &Hypothesis, motion: &Isometry2<f64>, after: &TopView) -> f64 {
    let places = thing.cells.iter().map(|(place, top)| (place_of(&(motion * middle_of(*place))), top));
    let seen: Vec<_> = places.filter(|(place, _)| after.at(*place) != Occupancy::Unknown).collect();
    let astray = seen.iter().filter(|(place, top)| !after.shows(*place, top)).count();
    astray as f64 / seen.len().max(1) as f64
}

fn fresh(next: &mut usize) -> String {
    *next += 1;
    format!("thing_{next}")
}

/// The things with the surfaces that were seen now, and what is new. What is hidden now is where it should be.
fn seen_again(
    things: Vec<(Hypothesis, usize)>,
    motions: &[Isometry2<f64>],
    after: &TopView,
    next: &mut usize,
) -> Vec<Hypothesis> {
    let surface: BTreeMap<CellIndex, TopCell> =
        after.occupied().filter(|(place, top)| after.is_surface(*place, top)).collect();
    let mut expected: BTreeMap<CellIndex, (usize, f64)> = BTreeMap::new();
    for (i, (thing, label)) in things.iter().enumerate() {
        let motion = label.checked_sub(1).map_or_else(Isometry2::identity, |k| motions[k]);
        for (place, top) in &thing.cells {
            let at = motion * middle_of(*place);
            for near in around(place_of(&at), 1) {
                let off = (middle_of(near) - at).norm();
                let fits = surface.get(&near).is_some_and(|seen| seen.is_like(top));
                if fits && expected.get(&near).is_none_or(|(_, before)| off < *before) {
                    expected.insert(near, (i, off));
                }
            }
        }
    }
    let mut of: BTreeMap<CellIndex, usize> = expected.into_iter().map(|(place, (i, _))| (place, i)).collect();
    let sources = |of: &BTreeMap<CellIndex, usize>| of.iter().map(|(place, i)| (*place, *i)).collect();
    let alike =
        |a: CellIndex, b: CellIndex| surface.get(&a).zip(surface.get(&b)).is_some_and(|(a, b)| a.is_like(b));
    // A thing is in one place: what would be elsewhere, too, goes with the surface around it.
    let elsewhere = all_but_the_largest(&of);
    of.retain(|place, _| !elsewhere.contains(place));
    of.extend(spread(sources(&of), alike));
    let new = of_rest(after, &of.keys().copied().collect(), next);
    let taken: BTreeSet<CellIndex> = new.iter().flat_map(|thing| thing.cells.keys().copied()).collect();
    of.extend(spread(sources(&of), |_, to| surface.contains_key(&to) && !taken.contains(&to)));
    let mut again: Vec<Hypothesis> =
        things.into_iter().map(|(thing, _)| Hypothesis { cells: BTreeMap::new(), ..thing }).collect();
    for (place, i) in of {
        again[i].cells.insert(place, surface[&place]);
    }
    again.retain(|thing| thing.cells.len() >= LEAST);
    again.extend(new);
    again
}

/// The cells of each label that are not in its largest patch.
fn all_but_the_largest(labels: &BTreeMap<CellIndex, usize>) -> BTreeSet<CellIndex> {
    let patches = patches(labels);
    let mut largest: BTreeMap<usize, usize> = BTreeMap::new();
    for (label, patch) in &patches {
        let most = largest.entry(*label).or_default();
        *most = (*most).max(patch.len());
    }
    patches
        .into_iter()
        .filter(|(label, patch)| patch.len() < largest[label])
        .flat_map(|(_, patch)| patch)
        .collect()
}

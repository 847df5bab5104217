//! Which cell made which motion.
//!
//! A cell that is gone has moved by a motion that finds it again; one whose place after a motion is free has not made that motion; one where
//! something is that cannot have come by a motion has stayed; and what has come where nothing was has come from somewhere. What may still have
//! done several things, as the middle of a surface that slid by less than its own length, did as the nearest decided cell. The simplest
//! explanation counts: what few cells need, none has done.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::Isometry2;

use super::hypothesis::{patches, spread};
use super::motion::{Feature, ViewChange, matches};
use super::top_view::{CellIndex, TopCell, middle_of, place_of};

/// Stayed where it was; motions count from 1.
pub(super) const STAYED: usize = 0;

/// The motion of each cell: [`STAYED`], or one more than the index of its motion. Each motion is needed by at least `least` cells that
/// none of the others explains; where that is not so of any, all cells made the one that the most cells need.
pub(super) fn labels(
    cells: &BTreeMap<CellIndex, TopCell>,
    change: &ViewChange<'_>,
    (motions, least): (&[Isometry2<f64>], usize),
) -> BTreeMap<CellIndex, usize> {
    let possible: BTreeMap<CellIndex, BTreeSet<usize>> =
        cells.iter().map(|(place, top)| (*place, possible(*place, top, change, motions))).collect();
    let needed = needed(&possible, motions.len(), least);
    let mut decided: BTreeMap<CellIndex, usize> =
        possible.iter().filter_map(|(place, labels)| Some((*place, only(&(labels & &needed))?))).collect();
    fill(&mut decided, cells);
    // Specks go with what is around them.
    let specks = specks(&decided, least);
    if specks.len() < decided.len() {
        decided.retain(|place, _| !specks.contains(place));
        fill(&mut decided, cells);
    }
    for place in cells.keys() {
        decided.entry(*place).or_insert(STAYED);
    }
    decided
}

/// What a cell may have done.
fn possible(
    place: CellIndex,
    top: &TopCell,
    change: &ViewChange<'_>,
    motions: &[Isometry2<f64>],
) -> BTreeSet<usize> {
    let feature = Feature { place, top: *top, edge: false };
    let moves = (1..=motions.len()).filter(|label| matches(change.after, &motions[label - 1], &feature));
    let moves: BTreeSet<usize> = moves.collect();
    if !change.after.shows(place, top) {
        return moves;
    }
    // What is here now must have come by some motion, if it has not stayed.
    if !motions.iter().any(|motion| matches(change.before, &motion.inverse(), &feature)) {
        return BTreeSet::from([STAYED]);
    }
    // What has come where nothing was before has come from here.
    let came = |label: &usize| {
        let there = place_of(&(motions[label - 1] * middle_of(place)));
        !change.before.shows(there, top)
    };
    let came: BTreeSet<usize> = moves.iter().copied().filter(came).collect();
    match came.is_empty() {
        true => moves.into_iter().chain([STAYED]).collect(),
        false => came,
    }
}

/// The labels without which at least so many cells have none; at least one of all.
fn needed(possible: &BTreeMap<CellIndex, BTreeSet<usize>>, motions: usize, least: usize) -> BTreeSet<usize> {
    let mut needed: BTreeSet<usize> = (STAYED..=motions).collect();
    while needed.len() > 1 {
        let mut alone = vec![0; motions + 1];
        for label in possible.values().filter_map(|labels| only(&(labels & &needed))) {
            alone[label] += 1;
        }
        let Some(weakest) = needed.iter().copied().min_by_key(|label| (alone[*label], usize::MAX - label))
        else {
            break;
        };
        if alone[weakest] >= least {
            break;
        }
        needed.remove(&weakest);
    }
    needed
}

fn only(labels: &BTreeSet<usize>) -> Option<usize> {
    labels.first().copied().filter(|_| labels.len() == 1)
}

/// Gives each cell that is not decided the label of the nearest one of its surface that is, or of the nearest one.
fn fill(decided: &mut BTreeMap<CellIndex, usize>, cells: &BTreeMap<CellIndex, TopCell>) {
    let alike =
        |a: CellIndex, b: CellIndex| cells.get(&a).zip(cells.get(&b)).is_some_and(|(a, b)| a.is_like(b));
    let sources = |decided: &BTreeMap<CellIndex, usize>| {
        decided.iter().map(|(place, label)| (*place, *label)).collect()
    };
    decided.extend(spread(sources(decided), alike));
    decided.extend(spread(sources(decided), |_, to| cells.contains_key(&to)));
}

/// The cells of connected patches of one label that have fewer than `least` cells.
fn specks(labels: &BTreeMap<CellIndex, usize>, least: usize) -> BTreeSet<CellIndex> {
    let patches = patches(labels).into_iter();
    patches.filter(|(_, patch)| patch.len() < least).flat_map(|(_, patch)| patch).collect()
}

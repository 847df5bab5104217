//! Which cell made which motion.
//!
//! A cell that is gone has moved by the motion that finds it again; one whose place after a motion is free has not made that motion; one where
//! something is that cannot have come by a motion has stayed. What may have stayed or moved, as in the middle of a plain surface that slid by
//! less than its own length, did as the nearest cell of the same surface that is decided.

use std::collections::BTreeMap;

use nalgebra::Isometry2;

use super::hypothesis::spread;
use super::motion::{Change, Feature, matches};
use super::top_view::{Place, TopCell};

/// Stayed where it was; motions count from 1.
pub(super) const STAYED: usize = 0;

/// The motion of each cell: [`STAYED`], or one more than the index of its motion.
pub(super) fn labels(
    cells: &BTreeMap<Place, TopCell>,
    change: &Change<'_>,
    motions: &[Isometry2<f64>],
) -> BTreeMap<Place, usize> {
    let mut decided: BTreeMap<Place, usize> = cells
        .iter()
        .filter_map(|(place, top)| Some((*place, decision(*place, top, change, motions)?)))
        .collect();
    let alike = |a: Place, b: Place| cells.get(&a).zip(cells.get(&b)).is_some_and(|(a, b)| a.is_like(b));
    let sources =
        |decided: &BTreeMap<Place, usize>| decided.iter().map(|(place, label)| (*place, *label)).collect();
    decided.extend(spread(sources(&decided), alike));
    decided.extend(spread(sources(&decided), |_, to| cells.contains_key(&to)));
    for place in cells.keys() {
        decided.entry(*place).or_insert(STAYED);
    }
    decided
}

/// The motion of a cell, where there is no other.
fn decision(place: Place, top: &TopCell, change: &Change<'_>, motions: &[Isometry2<f64>]) -> Option<usize> {
    let feature = Feature { place, top: *top, edge: false };
    let can_stay = change.after.shows(place, top);
    let can_move: Vec<usize> =
        (0..motions.len()).filter(|&k| matches(change.after, &motions[k], &feature)).collect();
    if !can_stay {
        return match can_move[..] {
            [only] => Some(only + 1),
            _ => None,
        };
    }
    // What is here now must have come by some motion, if it has not stayed.
    let could_come = motions.iter().any(|motion| matches(change.before, &motion.inverse(), &feature));
    if can_move.is_empty() || !could_come {
        return Some(STAYED);
    }
    // Where nothing was before, something has come: by this motion, from here.
    let came = |k: &&usize| {
        let there = super::top_view::place_of(&(motions[**k] * super::top_view::middle_of(place)));
        !change.before.shows(there, top)
    };
    match can_move.iter().filter(came).collect::<Vec<_>>()[..] {
        [only] => Some(only + 1),
        _ => None,
    }
}

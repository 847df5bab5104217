//! Finds the entities of a core segment by class and by place, so that a query for either does not look at all of them. It says who may be
//! in the answer; whether an entity is, [`CheckedQuery`] decides. It knows the newest snapshots only.

use std::sync::Arc;

use armarium_values::Frame;
use imbl::{OrdMap, OrdSet};

use crate::checked_query::CheckedQuery;
use crate::entity::{EntityId, Snapshot};
use crate::place::{SpatialRegion, distance, place_of};
use crate::query::Times;

/// Edge of the cells that space is divided into, m.
const CELL_M: f64 = 0.25;
/// A region of more cells than this part of all that are occupied is no help: everything is looked at.
const MOST_OF_OCCUPIED: usize = 2;

/// A cell of space in one frame.
type Cell = (Arc<str>, [i32; 3]);

/// Who is where, and of which class.
#[derive(Clone, Default)]
pub(super) struct Index {
    classes: OrdMap<Arc<str>, OrdSet<EntityId>>,
    cells: OrdMap<Cell, OrdSet<EntityId>>,
}

/// The cell of a point; those that are very far away share the outermost cells.
fn cell_of(place: &[f64; 3]) -> [i32; 3] {
    // The conversion saturates.
    place.map(|x| (x / CELL_M).floor() as i32)
}

fn place(snapshot: &Snapshot) -> Option<(&str, [i32; 3])> {
    let (frame, place) = place_of(snapshot)?;
    Some((&frame.0, cell_of(&place)))
}

impl Index {
    /// An entity has a new newest snapshot, or none any more.
    pub(super) fn change(&mut self, id: &EntityId, before: Option<&Snapshot>, after: Option<&Snapshot>) {
        let classes = [before, after].map(|snapshot| snapshot?.attribute("class")?.as_str());
        if classes[0] != classes[1] {
            classes[0].inspect(|class| take_out(&mut self.classes, *class, id));
            classes[1].inspect(|class| put_in(&mut self.classes, (*class).into(), id));
        }
        let places = [before, after].map(|snapshot| snapshot.and_then(place));
        if places[0] != places[1] {
            let cell = |(frame, cell): (&str, [i32; 3])| -> Cell { (frame.into(), cell) };
            places[0].inspect(|place| take_out(&mut self.cells, &cell(*place), id));
            places[1].inspect(|place| put_in(&mut self.cells, cell(*place), id));
        }
    }

    /// The entities that may be in the answer, in order of address; `None` when the index does not help. `newest` gives an entity's newest
    /// snapshot.
    pub(super) fn candidates<'s>(
        &self,
        asked: &CheckedQuery<'_>,
        newest: impl Fn(&EntityId) -> Option<&'s Arc<Snapshot>>,
    ) -> Option<OrdSet<EntityId>> {
        if asked.query.times != Times::Latest || asked.query.removed {
            return None;
        }
        let of_class = asked.wanted_class().map(|class| self.classes.get(class).cloned().unwrap_or_default());
        let there = asked.query.region.as_ref().and_then(|region| match region {
            SpatialRegion::Box { frame, min, max } => self.within(frame, *min, *max),
            SpatialRegion::Within { frame, of, radius } => {
                self.within(frame, of.map(|x| x - radius), of.map(|x| x + radius))
            }
            SpatialRegion::Nearest { frame, to, count } => {
                let is_one = |id: &EntityId, radius: f64| {
                    let near = newest(id).filter(|snapshot| asked.fits(snapshot)).and_then(|s| place_of(s));
                    near.is_some_and(|(_, place)| distance(&place, to) <= radius)
                };
                self.nearest(frame, *to, *count, is_one)
            }
        });
        match (of_class, there) {
            (Some(few), Some(there)) => Some(few.intersection(there)),
            (few, there) => few.or(there),
        }
    }

    /// Those in the cells that a box touches; `None` when these are too many.
    fn within(&self, frame: &Frame, from: [f64; 3], to: [f64; 3]) -> Option<OrdSet<EntityId>> {
        let (from, to) = (cell_of(&from), cell_of(&to));
        let columns = [0, 1].map(|i| (i64::from(to[i]) - i64::from(from[i]) + 1).unsigned_abs());
        let most = (self.cells.len() / MOST_OF_OCCUPIED).max(64) as u64;
        if columns[0].saturating_mul(columns[1]) > most {
            return None;
        }
        let frame: Arc<str> = frame.0.as_str().into();
        let mut found = OrdSet::new();
        for x in from[0]..=to[0] {
            for y in from[1]..=to[1] {
                let column = (Arc::clone(&frame), [x, y, from[2]])..=(Arc::clone(&frame), [x, y, to[2]]);
                for (_, ids) in self.cells.range(column) {
                    found.extend(ids.iter().cloned());
                }
            }
        }
        Some(found)
    }

    /// Those in a box around a point which surely holds the nearest `count` of those that `is_one` takes within a radius; `None`
    /// when the box gets too large.
    fn nearest(
        &self,
        frame: &Frame,
        to: [f64; 3],
        count: usize,
        is_one: impl Fn(&EntityId, f64) -> bool,
    ) -> Option<OrdSet<EntityId>> {
        let mut radius = CELL_M;
        loop {
            let found = self.within(frame, to.map(|x| x - radius), to.map(|x| x + radius))?;
            if found.iter().filter(|id| is_one(id, radius)).take(count).count() == count {
                return Some(found);
            }
            radius *= 2.0;
        }
    }
}

fn put_in<K: Ord + Clone>(sets: &mut OrdMap<K, OrdSet<EntityId>>, key: K, id: &EntityId) {
    sets.entry(key).or_default().insert(id.clone());
}

fn take_out<K, B>(sets: &mut OrdMap<K, OrdSet<EntityId>>, key: &B, id: &EntityId)
where
    K: Ord + Clone + std::borrow::Borrow<B>,
    B: Ord + ?Sized,
{
    if let Some(set) = sets.get_mut(key) {
        set.remove(id);
        if set.is_empty() {
            sets.remove(key);
        }
    }
}

//! Usual places: where an object of a class is likely found, learned from long-term memory's history of earlier days.
//!
//! 1. Every sighting of an object that was not carried counts until the object's next sighting, ten minutes at most.
//!    The time spent in each cell of 5 cm is summed by class, frame and day.
//! 2. Days count equally: a day's times are divided by their sum, over all places of the class.
//! 3. DP-means clusters the cells into places of 30 cm radius; the number of places results from it.
//! 4. With `d_k` days' worth of time in place `k` of `K`, out of `D` days, the probability of the place is
//!    `(d_k + 1/2) / (D + (K + 1)/2)`: a rest always remains for a new place, and a single day gives no certainty.
//!
//! Days are those of UTC. Today is not counted, so that today's observations can test the conclusions of the morning.
//!
//! # Source
//! DP-means: Kulis and Jordan 2012, "Revisiting k-means: new algorithms via Bayesian nonparametrics", algorithm 1.
//! The estimate: Krichevsky and Trofimov 1981, with one more outcome for a new place.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

use armarium_memoryx::{EntityId, Memory, MemoryError, Pattern, Query, Snapshot, pages, place_of};
use armarium_values::{Frame, Value, Vector};
use async_trait::async_trait;
use nalgebra::{Matrix3, Vector3};

use super::{Conclusion, Inference, joined};
use crate::updater::OBJECT_INSTANCES;

/// The core segment of usual places.
pub const USUAL_PLACES: &str = "UsualPlaces";
/// Snapshots per query.
const PAGE_SIZE: usize = 4096;
/// A day, ns.
const DAY_NS: u64 = 86_400_000_000_000;
/// The longest and the shortest time that a sighting counts, s.
const COUNTS_S: (f64, f64) = (600.0, 1.0);
/// The side of a cell, m.
const CELL: f64 = 0.05;
/// Radius of a place, m.
const PLACE_RADIUS: f64 = 0.3;
/// Most rounds of clustering; each lowers the cost, and clustering ends when nothing changes.
const MAX_ROUNDS: usize = 100;
/// Cells farther from the origin are ignored, m.
const MAX_DISTANCE: f64 = 1e6;

/// Concludes [`USUAL_PLACES`] from the history of `ObjectInstances`.
#[derive(Clone, Debug)]
pub struct UsualPlaces;

/// The sightings in a cell.
#[derive(Clone, Debug, Default)]
struct Cell {
    seconds: f64,
    /// The sum of the positions, each weighted with its seconds, m s.
    places: Vector3<f64>,
    sightings: u64,
    last_ns: u64,
    /// The newest version of each entity that was seen there.
    sources: BTreeMap<EntityId, u64>,
}

/// A cell of one day with its fraction of the day's time.
struct DayShare<'s> {
    cell: &'s Cell,
    place: Vector3<f64>,
    weight: f64,
    day: u64,
}

/// The cells of a class in a frame, by day and coordinates.
type Cells = BTreeMap<(u64, [i64; 3]), Cell>;

/// All sightings, by class and frame.
type Sightings = BTreeMap<(String, String), Cells>;

/// Counts a snapshot of a day before today, which held until the next one of its entity at `until_ns`.
fn count(sightings: &mut Sightings, snapshot: &Snapshot, until_ns: u64, today_ns: u64) {
    let text = |name: &str| snapshot.attribute(name).and_then(Value::as_str);
    let carried =
        text("motion_model").is_some_and(|model| model != "static") || text("attached_to").is_some();
    let (Some((frame, place)), Some(class)) = (place_of(snapshot), text("class")) else { return };
    let is_near = place.iter().all(|x| x.abs() <= MAX_DISTANCE);
    if carried || !is_near || snapshot.referenced_ns >= today_ns {
        return;
    }
    let held_s = until_ns.saturating_sub(snapshot.referenced_ns) as f64 * 1e-9;
    let seconds = held_s.min(COUNTS_S.0).max(COUNTS_S.1);
    let seen = sightings.entry((class.to_owned(), frame.0.clone())).or_default();
    let at = place.map(|x| (x / CELL).floor() as i64);
    let cell = seen.entry((snapshot.referenced_ns / DAY_NS, at)).or_default();
    cell.seconds += seconds;
    cell.places += Vector3::from(place) * seconds;
    cell.sightings += 1;
    cell.last_ns = cell.last_ns.max(snapshot.referenced_ns);
    cell.sources.insert(snapshot.id.clone(), snapshot.version);
}

/// The cells with their fractions of their days, the largest first.
fn shares(cells: &Cells) -> Vec<DayShare<'_>> {
    let mut days: BTreeMap<u64, f64> = BTreeMap::new();
    for ((day, _), cell) in cells {
        *days.entry(*day).or_insert(0.0) += cell.seconds;
    }
    let mut shares = Vec::with_capacity(cells.len());
    for ((day, _), cell) in cells {
        let weight = cell.seconds / days.get(day).copied().unwrap_or(cell.seconds);
        shares.push(DayShare { cell, place: cell.places / cell.seconds, weight, day: *day });
    }
    shares.sort_by(|a, b| b.weight.total_cmp(&a.weight));
    shares
}

/// Clusters the cells into places by DP-means.
fn clustered<'s>(shares: &'s [DayShare<'s>]) -> Vec<Vec<&'s DayShare<'s>>> {
    let mut centres: Vec<Vector3<f64>> = Vec::new();
    let mut of: Vec<usize> = vec![usize::MAX; shares.len()];
    for _ in 0..MAX_ROUNDS {
        let mut changed = false;
        for (share, of) in shares.iter().zip(&mut of) {
            let far = |centre: &Vector3<f64>| (centre - share.place).norm();
            let nearest = (0..centres.len()).min_by(|a, b| far(&centres[*a]).total_cmp(&far(&centres[*b])));
            let place =
                nearest.filter(|nearest| far(&centres[*nearest]) <= PLACE_RADIUS).unwrap_or_else(|| {
                    centres.push(share.place);
                    centres.len() - 1
                });
            changed |= std::mem::replace(of, place) != place;
        }
        if !changed {
            break;
        }
        let members = grouped(shares, &of, centres.len());
        for (centre, members) in centres.iter_mut().zip(&members) {
            *centre = mean(members).unwrap_or(*centre);
        }
    }
    grouped(shares, &of, centres.len()).into_iter().filter(|members| !members.is_empty()).collect()
}

fn grouped<'s>(shares: &'s [DayShare<'s>], of: &[usize], count: usize) -> Vec<Vec<&'s DayShare<'s>>> {
    let mut members = vec![Vec::new(); count];
    for (share, of) in shares.iter().zip(of) {
        members[*of].push(share);
    }
    members
}

fn weight(members: &[&DayShare<'_>]) -> f64 {
    members.iter().map(|share| share.weight).sum()
}

fn mean(members: &[&DayShare<'_>]) -> Option<Vector3<f64>> {
    let sum: Vector3<f64> = members.iter().map(|share| share.place * share.weight).sum();
    (!members.is_empty()).then(|| sum / weight(members))
}

/// The covariance of a place, m², row by row: the spread of its cells, and the spread within a cell.
fn covariance(members: &[&DayShare<'_>], mean: &Vector3<f64>) -> Vec<f64> {
    let within = Matrix3::identity() * (CELL * CELL / 12.0);
    let of = |share: &&DayShare<'_>| (share.place - mean) * (share.place - mean).transpose() * share.weight;
    let rows: Matrix3<f64> = within + members.iter().map(of).sum::<Matrix3<f64>>() / weight(members);
    rows.as_slice().to_vec()
}

/// The evidence of a place: the newest version of each entity.
fn because(members: &[&DayShare<'_>]) -> Vec<(EntityId, u64)> {
    let mut newest: BTreeMap<&EntityId, u64> = BTreeMap::new();
    for (id, version) in members.iter().flat_map(|share| &share.cell.sources) {
        let known = newest.entry(id).or_insert(0);
        *known = version.max(known).to_owned();
    }
    newest.into_iter().map(|(id, version)| (id.clone(), version)).collect()
}

/// The conclusions about one class in one frame.
fn places(class: &str, frame: &str, seen: &Cells) -> Vec<Conclusion> {
    let shares = shares(seen);
    let days = shares.iter().map(|share| share.day).collect::<BTreeSet<_>>().len();
    let mut places = clustered(&shares);
    places.sort_by(|a, b| weight(b).total_cmp(&weight(a)));
    let rest = (places.len() as f64 + 1.0) / 2.0;
    let conclusion = |(i, members): (usize, &Vec<&DayShare<'_>>)| {
        let mean = mean(members)?;
        let number = |n: u64| Value::Int(i64::try_from(n).unwrap_or(i64::MAX));
        let own_days = members.iter().map(|share| share.day).collect::<BTreeSet<_>>().len();
        let last_ns = members.iter().map(|share| share.cell.last_ns).max().unwrap_or(0);
        let attributes = [
            ("class", class.into()),
            ("position", Value::Vector(Vector::new(Frame(frame.to_owned()), &mean))),
            ("days", number(own_days as u64)),
            ("of_days", number(days as u64)),
            ("sightings", number(members.iter().map(|share| share.cell.sightings).sum())),
            ("last_seen_ns", number(last_ns)),
        ];
        Some(Conclusion {
            segment: USUAL_PLACES.into(),
            entity: joined(&[class, frame, &(i + 1).to_string()]),
            attributes: attributes.map(|(name, value)| (name.to_owned(), value)).into(),
            covariance: BTreeMap::from([("position".to_owned(), covariance(members, &mean))]),
            confidence: (weight(members) + 0.5) / (days as f64 + rest),
            referenced_ns: last_ns,
            because: because(members),
        })
    };
    places.iter().enumerate().filter_map(conclusion).collect()
}

#[async_trait]
impl Inference for UsualPlaces {
    fn name(&self) -> &str {
        "usual_places"
    }

    fn watches(&self) -> Vec<Pattern> {
        vec![Pattern::segment(OBJECT_INSTANCES)]
    }

    fn pause(&self) -> Duration {
        Duration::from_secs(600)
    }

    async fn conclude(&self, memory: &dyn Memory, now_ns: u64) -> Result<Vec<Conclusion>, MemoryError> {
        let today_ns = now_ns / DAY_NS * DAY_NS;
        let mut sightings = Sightings::default();
        let mut last: Option<Arc<Snapshot>> = None;
        // The histories of the entities, one after the other, each in order of version.
        let mut pieces =
            pages(Query::history(Pattern::segment(OBJECT_INSTANCES)).with_long_term(), PAGE_SIZE);
        while let Some(piece) = pieces.next(memory).await? {
            for next in piece {
                if let Some(last) = &last {
                    let until_ns = if last.id == next.id { next.referenced_ns } else { u64::MAX };
                    count(&mut sightings, last, until_ns.min(today_ns), today_ns);
                }
                last = Some(next);
            }
        }
        if let Some(last) = &last {
            count(&mut sightings, last, today_ns, today_ns);
        }
        let found = sightings.iter().map(|((class, frame), seen)| places(class, frame, seen));
        Ok(found.flatten().collect())
    }
}

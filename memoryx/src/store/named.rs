//! Named snapshots of the whole working memory, which can be loaded again.

use std::collections::BTreeSet;
use std::fmt;
use std::sync::Arc;

use redb::ReadableTable;

use super::error::Fault;
use super::read::query_error;
use super::{LongTermMemory, NAMED, StoreError};
use crate::entity::{Commit, EntityId, Snapshot, check_name};
use crate::error::MemoryError;
use crate::query::{Pattern, Query};
use crate::working::WorkingMemory;

/// Entities that are looked at in one transaction, so that no commit waits long.
const PART: usize = 500;

/// The list entry of a named snapshot.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NamedSnapshot {
    /// Its name.
    pub name: String,
    /// When it was taken, ns.
    pub taken_ns: u64,
    /// How many entities it holds.
    pub entities: u64,
}

/// How an entity differs between two snapshots of working memory.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum EntityChange {
    /// It is there only afterwards.
    Added(EntityId),
    /// It was there only before.
    Removed(EntityId),
    /// These attributes of its first hypothesis differ; none when something else does.
    Changed(EntityId, Vec<String>),
}

impl fmt::Display for EntityChange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Added(id) => write!(f, "+ {id}"),
            Self::Removed(id) => write!(f, "- {id}"),
            Self::Changed(id, attributes) => write!(f, "~ {id} {}", attributes.join(" ")),
        }
    }
}

/// The attributes that differ.
fn differing(a: &Snapshot, b: &Snapshot) -> Vec<String> {
    let names = [a, b].into_iter().filter_map(|snapshot| snapshot.instance());
    let names: BTreeSet<&str> =
        names.flat_map(|instance| instance.attributes.iter().map(|(name, _)| name)).collect();
    let differs = |name: &&str| a.attribute(name) != b.attribute(name);
    names.into_iter().filter(differs).map(str::to_owned).collect()
}

impl LongTermMemory {
    /// Stores the present content of working memory under a name, durably; it replaces an older snapshot of that
    /// name. The content is kept until [`Self::forget_named`]. Returns the number of entities.
    ///
    /// # Errors
    /// [`StoreError::Name`] for an invalid name; as [`Self::persist`].
    pub fn save_named(&self, name: &str, memory: &WorkingMemory) -> Result<usize, StoreError> {
        check_name(name).map_err(|_| StoreError::Name { name: short(name) })?;
        let _alone = self.upkeep.lock();
        let held = memory.query_now(&Query::latest(Pattern::any())).map_err(query_error)?;
        let mut list = memory.now_ns().to_le_bytes().to_vec();
        for part in held.chunks(PART) {
            self.write(|writer, memo| {
                let mut new = false;
                for snapshot in part {
                    // A snapshot that is already stored may be encoded, and stays so.
                    if !writer.holds(&snapshot.id, snapshot.version, memo)? {
                        new |= writer.add(snapshot, memo, false)?;
                    }
                }
                Ok(((), new))
            })?;
        }
        self.read(|reader| {
            for snapshot in &held {
                let number = reader.entity(&snapshot.id)?.map_or(0, |entity| entity.number);
                list.extend_from_slice(&number.to_le_bytes());
                list.extend_from_slice(&snapshot.version.to_le_bytes());
            }
            Ok(())
        })?;
        // The list is written after its content: a crash in between leaves the older list.
        self.replace_list(name, Some(&list))?;
        Ok(held.len())
    }

    /// Stores a list under a name, or removes it. Returns whether there was one.
    fn replace_list(&self, name: &str, list: Option<&[u8]>) -> Result<bool, StoreError> {
        let before = self.list(name)?;
        let pinned: Vec<_> = entries(before.as_deref().unwrap_or_default()).collect();
        self.write(|writer, _| {
            match list {
                Some(list) => drop(writer.named.insert(name, list)?),
                None => drop(writer.named.remove(name)?),
            }
            Ok(((), list.is_some() || before.is_some()))
        })?;
        for part in pinned.chunks(PART) {
            self.write(|writer, _| writer.unpin(part).map(|any| ((), any)))?;
        }
        Ok(before.is_some())
    }

    fn list(&self, name: &str) -> Result<Option<Vec<u8>>, StoreError> {
        self.read_tables(|transaction| {
            let table = transaction.open_table(NAMED)?;
            Ok(table.get(name)?.map(|v| v.value().to_vec()))
        })
    }

    /// The content of a named snapshot, ordered by address.
    ///
    /// # Errors
    /// [`StoreError::NoSuchName`]; [`StoreError::Damaged`] and others when it cannot be read.
    pub fn named(&self, name: &str) -> Result<Vec<Arc<Snapshot>>, StoreError> {
        let list = self.list(name)?.ok_or_else(|| no_such(name))?;
        self.read(|reader| {
            let ids = reader.addresses()?;
            let missing = || Fault::Damaged(format!("the snapshot `{name}` names what is not there"));
            let mut found = Vec::new();
            for (number, version) in entries(&list) {
                let id = ids.get(&number).ok_or_else(missing)?;
                let row = reader.index.get((number, version))?.ok_or_else(missing)?;
                found.push(reader.snapshot(id, row.value())?);
            }
            found.sort_by(|a, b| a.id.cmp(&b.id));
            Ok(found)
        })
    }

    /// Restores the content of a named snapshot in working memory: entities that differ get its data as a new
    /// version, and entities that it does not contain are removed, so that no version count goes back. Read-only
    /// segments stay unchanged. Returns how many entities were changed.
    ///
    /// # Errors
    /// As [`Self::named`] and [`crate::Memory::commit`]; nothing is changed then.
    pub fn load_named(&self, name: &str, memory: &WorkingMemory) -> Result<usize, MemoryError> {
        let wanted = self.named(name)?;
        let held = memory.query_now(&Query::latest(Pattern::any()))?;
        let mut updates = Vec::new();
        for snapshot in &wanted {
            if of(&held, &snapshot.id).is_none_or(|now| now.instances != snapshot.instances) {
                let (id, instances) = (snapshot.id.clone(), snapshot.instances.clone());
                updates.push(Commit::of(id, snapshot.referenced_ns, instances));
            }
        }
        let gone = held.iter().filter(|s| of(&wanted, &s.id).is_none());
        updates.extend(gone.map(|s| Commit::removal(s.id.clone(), memory.now_ns())));
        updates.retain(|update| !memory.is_read_only(&update.id));
        let count = updates.len();
        memory.commit_now(updates)?;
        Ok(count)
    }

    /// What has changed from a named snapshot to another one, or to the present content of working memory: a line for each entity,
    /// ordered by address.
    ///
    /// # Errors
    /// As [`Self::named`].
    pub fn compare_named(
        &self,
        from: &str,
        to: Option<&str>,
        memory: &WorkingMemory,
    ) -> Result<Vec<EntityChange>, MemoryError> {
        let before = self.named(from)?;
        let after = match to {
            Some(name) => self.named(name)?,
            None => memory.query_now(&Query::latest(Pattern::any()))?,
        };
        let ids: BTreeSet<&EntityId> = before.iter().chain(&after).map(|snapshot| &snapshot.id).collect();
        let change = |id: &EntityId| match (of(&before, id), of(&after, id)) {
            (None, Some(_)) => Some(EntityChange::Added(id.clone())),
            (Some(_), None) => Some(EntityChange::Removed(id.clone())),
            (Some(a), Some(b)) if a.instances != b.instances => {
                Some(EntityChange::Changed(id.clone(), differing(a, b)))
            }
            _ => None,
        };
        Ok(ids.into_iter().filter_map(change).collect())
    }

    /// All named snapshots, ordered by name.
    ///
    /// # Errors
    /// When they cannot be read.
    pub fn list_named(&self) -> Result<Vec<NamedSnapshot>, StoreError> {
        self.lists(|name, list| NamedSnapshot {
            name: name.to_owned(),
            taken_ns: list.first_chunk().map_or(0, |bytes| u64::from_le_bytes(*bytes)),
            entities: entries(list).count() as u64,
        })
    }

    /// Forgets a named snapshot; the next [`Self::retain`] frees what no other one contains.
    ///
    /// # Errors
    /// [`StoreError::NoSuchName`]; when the disk fails.
    pub fn forget_named(&self, name: &str) -> Result<(), StoreError> {
        let _alone = self.upkeep.lock();
        let was = self.replace_list(name, None)?;
        if was { Ok(()) } else { Err(no_such(name)) }
    }

    /// The content of all named snapshots, by entity number and version.
    pub(super) fn pinned(&self) -> Result<BTreeSet<(u64, u64)>, StoreError> {
        Ok(self.lists(|_, list| entries(list).collect::<Vec<_>>())?.into_iter().flatten().collect())
    }

    fn lists<T>(&self, read: impl Fn(&str, &[u8]) -> T) -> Result<Vec<T>, StoreError> {
        self.read_tables(|transaction| {
            let table = transaction.open_table(NAMED)?;
            let rows = table.iter()?;
            let lists = rows.map(|row| row.map(|(name, list)| read(name.value(), list.value())));
            Ok(lists.collect::<Result<_, _>>()?)
        })
    }
}

/// The snapshot of an entity in a list that is ordered by address.
fn of<'l>(list: &'l [Arc<Snapshot>], id: &EntityId) -> Option<&'l Arc<Snapshot>> {
    list.binary_search_by(|snapshot| snapshot.id.cmp(id)).ok().and_then(|at| list.get(at))
}

fn no_such(name: &str) -> StoreError {
    StoreError::NoSuchName { name: short(name) }
}

fn short(name: &str) -> String {
    name.chars().take(200).collect()
}

/// Entity numbers and versions of a list.
fn entries(list: &[u8]) -> impl Iterator<Item = (u64, u64)> {
    let number = |bytes: &[u8]| bytes.first_chunk().map_or(0, |b| u64::from_le_bytes(*b));
    list.get(8..).unwrap_or_default().chunks_exact(16).map(move |entry| (number(entry), number(&entry[8..])))
}

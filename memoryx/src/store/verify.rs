//! Verification of a long-term memory: everything is read and compared with its checksums and indices.

use std::collections::BTreeMap;

use redb::{Key, ReadableTable, ReadableTableMetadata, Value};
use sha2::{Digest, Sha256};

use super::error::Fault;
use super::read::{Reader, row_at};
use super::record::{self, Hash, RecordError, Records};
use super::{AGES, BLOB_USES, BLOBS, GIVEN, KEPT, LongTermMemory, META, NAMED, REMOVED, StoreError, Totals};

/// Damages that a verification lists individually.
const MAX_LISTED: usize = 100;

/// The result of a verification.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Verification {
    /// Snapshots that are as they were written.
    pub intact: u64,
    /// Snapshots and index entries that are damaged.
    pub damaged: u64,
    /// Descriptions of the first of them.
    pub damages: Vec<String>,
}

impl Verification {
    /// Whether everything is as it was written.
    pub fn is_intact(&self) -> bool {
        self.damaged == 0
    }

    fn damage(&mut self, what: String) {
        self.damaged += 1;
        if self.damages.len() < MAX_LISTED {
            self.damages.push(what);
        }
    }
}

impl LongTermMemory {
    /// Reads and checks everything: the checksums of blocks and records, the hashes of large values, and the consistency of the
    /// indices. Commits go on meanwhile, and are not looked at. Changes nothing.
    ///
    /// # Errors
    /// When the file cannot be read at all.
    pub fn verify(&self) -> Result<Verification, StoreError> {
        let mut found = Verification::default();
        let Err(error) = self.read_all(&mut found) else { return Ok(found) };
        let StoreError::Damaged { what, .. } = error else { return Err(error) };
        // What else is damaged, and how much is not, is seen past the damage.
        found = Verification::default();
        found.damage(what);
        match self.salvage(|| self.read_all(&mut found)) {
            Err(StoreError::Damaged { what, .. }) => found.damage(what),
            salvaged => salvaged?,
        }
        Ok(found)
    }

    fn read_all(&self, found: &mut Verification) -> Result<(), StoreError> {
        self.read_tables(|transaction| {
            let mut uses = BTreeMap::new();
            verify_records(&Reader::new(transaction)?, &mut uses, found)?;
            let Totals { snapshots, .. } = Totals::read(&transaction.open_table(META)?)?;
            if snapshots != found.intact {
                found.damage(format!("{snapshots} snapshots are counted, {} are intact", found.intact));
            }
            for row in transaction.open_table(BLOBS)?.iter()? {
                let (hash, content) = row?;
                if Sha256::digest(content.value()).as_slice() != hash.value() {
                    found.damage("a large value is not as it was written".into());
                }
            }
            for row in transaction.open_table(BLOB_USES)?.iter()? {
                let (hash, count) = row?;
                if uses.remove(hash.value()) != Some(count.value()) {
                    found.damage("the uses of a large value are not counted as they are".into());
                }
            }
            uses.iter().for_each(|_| found.damage("a large value is missing".into()));
            // Their blocks have checksums.
            count_rows(&transaction.open_table(AGES)?)?;
            count_rows(&transaction.open_table(KEPT)?)?;
            count_rows(&transaction.open_table(REMOVED)?)?;
            count_rows(&transaction.open_table(GIVEN)?)?;
            count_rows(&transaction.open_table(NAMED)?)
        })
    }
}

fn count_rows<K: Key + 'static, V: Value + 'static>(table: &impl ReadableTable<K, V>) -> Result<(), Fault> {
    table.iter()?.try_for_each(|row| row.map(|_| ())).map_err(Fault::from)
}

fn verify_records(
    reader: &Reader,
    uses: &mut BTreeMap<Vec<u8>, u64>,
    found: &mut Verification,
) -> Result<(), Fault> {
    let ids = reader.addresses()?;
    let mut records = 0;
    for row in reader.chunks.iter()? {
        let (number, chunk) = row?;
        let (number, bytes) = (number.value(), chunk.value());
        for (at, record) in (Records { chunk: bytes, at: 0 }) {
            let (head, record) = match record {
                Ok(record) => record,
                Err(what) => {
                    found.damage(what.to_string());
                    break;
                }
            };
            if reader.is_forgotten(number, at, head)? {
                continue;
            }
            let blobs: Vec<Hash> = record::blobs_of(record, head).unwrap_or_default();
            blobs.into_iter().for_each(|hash| *uses.entry(hash.to_vec()).or_default() += 1);
            let row = row_at(&reader.index, head, number, at)?;
            let is_indexed = row.is_some_and(|row| row.2 as usize == head.length);
            let id = ids.get(&head.number).ok_or(RecordError::NoAddress { number: head.number });
            match id.and_then(|id| record::decode(id, head, record, &|_| Ok(Vec::new()))) {
                Ok(_) if is_indexed => found.intact += 1,
                Ok(s) => found.damage(format!("version {} of `{}` is not in the index", s.version, s.id)),
                Err(what) => found.damage(what.to_string()),
            }
            records += 1;
        }
    }
    let indexed = reader.index.len()?;
    if indexed != records {
        found.damage(format!("{records} records have {indexed} entries in the index"));
    }
    Ok(())
}

//! Verification of a long-term memory: everything is read and compared with its checksums and indices.

use redb::{ReadTransaction, ReadableDatabase, ReadableTable, ReadableTableMetadata};

use super::{LATEST, LongTermMemory, SNAPSHOTS, StoreError, TIMES, record};

/// Damages that a verification lists one by one.
const LISTED: usize = 100;

/// What a verification has found.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Verification {
    /// Snapshots that were read and are as they were written.
    pub intact: u64,
    /// Snapshots and index entries that are not.
    pub damaged: u64,
    /// The first of them in words.
    pub damages: Vec<String>,
}

impl Verification {
    /// Whether everything is as it was written.
    #[must_use]
    pub fn is_intact(&self) -> bool {
        self.damaged == 0
    }

    fn damage(&mut self, what: String) {
        self.damaged += 1;
        if self.damages.len() < LISTED {
            self.damages.push(what);
        }
    }
}

impl LongTermMemory {
    /// Reads everything and checks it: redb's own checksums, each record's checksum and content, and that the
    /// indices agree. Waits until nobody else uses the memory. Changes nothing that is intact.
    ///
    /// # Errors
    /// When the file cannot be read at all.
    pub fn verify(&self) -> Result<Verification, StoreError> {
        let mut found = Verification::default();
        let pages = self.with_alone(|database| database.check_integrity().map_err(|e| self.fault(e)));
        match pages {
            Ok(true) => {}
            Ok(false) => found.damage("pages of the file were not as they were written".into()),
            Err(StoreError::Damaged { what, .. }) => found.damage(what),
            Err(error) => return Err(error),
        }
        self.with(|database| {
            let transaction = database.begin_read().map_err(|e| self.fault(e))?;
            self.verify_tables(&transaction, &mut found)
        })?;
        Ok(found)
    }

    fn verify_tables(
        &self,
        transaction: &ReadTransaction,
        found: &mut Verification,
    ) -> Result<(), StoreError> {
        let snapshots = transaction.open_table(SNAPSHOTS).map_err(|e| self.fault(e))?;
        let times = transaction.open_table(TIMES).map_err(|e| self.fault(e))?;
        let latest = transaction.open_table(LATEST).map_err(|e| self.fault(e))?;
        for row in snapshots.iter().map_err(|e| self.fault(e))? {
            let (key, value) = row.map_err(|e| self.fault(e))?;
            match record::decode(key.value(), value.value()) {
                Err(what) => found.damage(what),
                Ok(snapshot) => {
                    let time = record::time_key(&snapshot.id, snapshot.referenced_ns, snapshot.version);
                    let timed = times.get(time.as_slice()).map_err(|e| self.fault(e))?.is_some();
                    let entity = record::entity_key(&snapshot.id);
                    let newest = latest.get(entity.as_slice()).map_err(|e| self.fault(e))?;
                    let newest = newest.is_some_and(|v| v.value() >= snapshot.version);
                    if timed && newest {
                        found.intact += 1;
                    } else {
                        found.damage(format!(
                            "version {} of `{}` is not in the index",
                            snapshot.version, snapshot.id
                        ));
                    }
                }
            }
        }
        let (rows, timed) =
            (snapshots.len().map_err(|e| self.fault(e))?, times.len().map_err(|e| self.fault(e))?);
        if rows != timed {
            found.damage(format!("{rows} snapshots have {timed} entries in the index of times"));
        }
        Ok(())
    }
}

//! A copy of the whole file while it is in use: of one moment, whatever is committed meanwhile.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use redb::{Builder, Database, Key, ReadTransaction, ReadableTable, TableDefinition, Value};

use super::checked;
use super::error::Fault;
use super::{
    AGES, BLOB_USES, BLOBS, CHUNKS, ENTITIES, GIVEN, INDEX, KEPT, LongTermMemory, META, NAMED, REMOVED,
    StoreError,
};

/// Bytes that one transaction copies, with so many for each row: little enough that no commit waits long for the disk.
pub(super) const COPIED_BYTES: usize = 256 << 10;
const ROW_BYTES: usize = 64;

impl LongTermMemory {
    /// Copies everything into a new file beside this one, and returns its path. Commits go on meanwhile, and are not in the copy.
    ///
    /// # Errors
    /// [`StoreError::Failed`] when `name` is more than the name of a file, there is such a file, this memory has no file, or the disk fails.
    pub fn back_up(&self, name: &str) -> Result<PathBuf, StoreError> {
        let only_a_name = Path::new(name).file_name().is_some_and(|file| file == name);
        if !only_a_name {
            return Err(self
                .failed(&format!("the copy lies beside it, so `{name}` must be the name of a file alone")));
        }
        let own = self.path.as_ref().ok_or_else(|| self.failed("it has no file"))?;
        let whole = own.with_file_name(name);
        if whole.exists() {
            return Err(self.failed(&format!("there is a file `{}` already", whole.display())));
        }
        // It has its name when it is whole.
        let unfinished = own.with_file_name(format!("{name}.unfinished"));
        let copied = self.read_tables(|from| {
            // What is left of an earlier try.
            let _ = std::fs::remove_file(&unfinished).is_ok();
            let (to, _) =
                checked::open(&unfinished, &Builder::new(), &Arc::default()).map_err(redb::Error::from)?;
            copy(from, &to, INDEX)?;
            copy(from, &to, CHUNKS)?;
            copy(from, &to, AGES)?;
            copy(from, &to, KEPT)?;
            copy_all_but_records(from, &to)
        });
        let copied = copied.and_then(|()| {
            std::fs::rename(&unfinished, &whole).map_err(|error| self.failed(&format!("the copy: {error}")))
        });
        if copied.is_err() {
            let _ = std::fs::remove_file(&unfinished).is_ok();
        }
        copied.map(|()| whole)
    }
}

/// Copies what is not of records: names, blobs, versions, and what the file says of itself.
pub(super) fn copy_all_but_records(from: &ReadTransaction, to: &Database) -> Result<(), Fault> {
    copy(from, to, ENTITIES)?;
    copy(from, to, BLOBS)?;
    copy(from, to, BLOB_USES)?;
    copy(from, to, REMOVED)?;
    copy(from, to, GIVEN)?;
    copy(from, to, NAMED)?;
    copy(from, to, META)
}

fn copy<K: Key + 'static, V: Value + 'static>(
    from: &ReadTransaction,
    to: &Database,
    table: TableDefinition<'_, K, V>,
) -> Result<(), Fault> {
    let from = from.open_table(table)?;
    let mut rows = from.iter()?.peekable();
    loop {
        let transaction = to.begin_write()?;
        {
            let mut copied = transaction.open_table(table)?;
            let mut bytes = 0;
            while let Some(row) = rows.next_if(|_| bytes < COPIED_BYTES) {
                let (key, value) = row?;
                bytes += ROW_BYTES + V::as_bytes(&value.value()).as_ref().len();
                copied.insert(key.value(), value.value())?;
            }
        }
        transaction.commit()?;
        if rows.peek().is_none() {
            return Ok(());
        }
    }
}

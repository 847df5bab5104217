//! Maintenance of a long-term memory: carries out the requests of [`crate::wire::Maintain`].

use std::collections::BTreeMap;

use crate::error::MemoryError;
use crate::store::{EntityChange, LongTermMemory, Retention};
use crate::wire::{Maintain, MaintenanceReport};
use crate::working::WorkingMemory;

/// Carries out a request. Blocks on the disk.
///
/// # Errors
/// [`MemoryError::Store`] when the disk or the file fails; [`MemoryError::Schema`] and [`MemoryError::Confidence`]
/// for invalid snapshots; as [`WorkingMemory::commit_now`] when a named snapshot is loaded.
pub fn carry_out(
    request: Maintain,
    store: Option<&LongTermMemory>,
    memory: &WorkingMemory,
) -> Result<MaintenanceReport, MemoryError> {
    let counted = |counts: &[(&str, u64)]| MaintenanceReport {
        counts: counts.iter().map(|(name, count)| ((*name).to_owned(), *count)).collect::<BTreeMap<_, _>>(),
        words: Vec::new(),
    };
    if matches!(request, Maintain::Usage) {
        return Ok(MaintenanceReport { counts: memory.usage(), words: Vec::new() });
    }
    let mut working = vec![
        ("working_entities", memory.len() as u64),
        ("working_bytes", memory.bytes()),
        ("working_updates", memory.updates()),
    ];
    if memory.is_partial() {
        // More of the file is still being read.
        working.push(("working_is_partial", 1));
    }
    let Some(store) = store else {
        let what = "it has no file: start the agent with --store FILE".into();
        let is_stats = matches!(request, Maintain::Stats);
        return if is_stats { Ok(counted(&working)) } else { Err(MemoryError::Store { what }) };
    };
    Ok(match request {
        Maintain::Stats | Maintain::Usage => {
            let stats = store.stats()?;
            let kept = [
                ("entities", stats.entities),
                ("snapshots", stats.snapshots),
                ("bytes", stats.bytes),
                ("file_bytes", stats.file_bytes),
            ];
            counted(&[&kept[..], &working[..]].concat())
        }
        Maintain::Verify => {
            let found = store.verify()?;
            let report = counted(&[("intact", found.intact), ("damaged", found.damaged)]);
            MaintenanceReport { words: found.damages, ..report }
        }
        Maintain::Compact => {
            let found = store.verify()?;
            if !found.is_intact() {
                let what = format!(
                    "{} places of it are damaged, so nothing was moved: export what is intact, and import it into a new file",
                    found.damaged
                );
                return Err(MemoryError::Store { what });
            }
            let before = store.stats()?.file_bytes;
            store.compact()?;
            counted(&[("file_bytes_before", before), ("file_bytes", store.stats()?.file_bytes)])
        }
        Maintain::Save { name } => counted(&[("entities", store.save_named(&name, memory)? as u64)]),
        Maintain::Load { name } => counted(&[("changed", store.load_named(&name, memory)? as u64)]),
        Maintain::Forget { name } => {
            store.forget_named(&name)?;
            MaintenanceReport::default()
        }
        Maintain::Names => {
            let names = store.list_named()?;
            let counts = names.iter().map(|n| (n.name.clone(), n.entities)).collect();
            MaintenanceReport { counts, words: names.into_iter().map(|n| n.name).collect() }
        }
        Maintain::Compare { name, to } => {
            let changes = store.compare_named(&name, to.as_deref(), memory)?;
            let many =
                |of: fn(&EntityChange) -> bool| changes.iter().filter(|change| of(change)).count() as u64;
            let added = many(|change| matches!(change, EntityChange::Added(_)));
            let removed = many(|change| matches!(change, EntityChange::Removed(_)));
            let changed = changes.len() as u64 - added - removed;
            let report = counted(&[("added", added), ("removed", removed), ("changed", changed)]);
            MaintenanceReport { words: changes.iter().map(ToString::to_string).collect(), ..report }
        }
        Maintain::BackUp { name } => {
            let copy = store.back_up(&name)?;
            let bytes = std::fs::metadata(&copy).map_or(0, |about| about.len());
            let report = counted(&[("file_bytes", bytes)]);
            MaintenanceReport { words: vec![copy.display().to_string()], ..report }
        }
        Maintain::Retain { age_ns, bytes } => {
            let dropped = store.retain(Retention { age_ns, bytes }, memory.now_ns())?;
            let over = ("bytes_over", dropped.over);
            counted(&[("dropped", dropped.snapshots), ("freed_bytes", dropped.bytes), over])
        }
        Maintain::Keep { snapshots } => {
            snapshots.iter().try_for_each(|snapshot| memory.check_kept(snapshot))?;
            counted(&[("kept", store.persist(&snapshots)? as u64)])
        }
    })
}

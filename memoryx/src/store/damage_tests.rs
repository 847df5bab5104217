//! Long-term memory in files that are damaged: cut short, with flipped bits, of something else.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::checked;
use super::tests::{snapshot, store};
use super::*;
use crate::query::Times;
use crate::working::WorkingMemory;

/// The part of the file whose every byte is spoiled once.
const HEADER_BYTES: usize = 512;

/// A closed file with snapshots of one entity.
pub(super) fn file_with(snapshots: u64) -> (tempfile::TempDir, PathBuf) {
    let (folder, path, store) = store();
    let all: Vec<_> = (1..=snapshots).map(|v| snapshot("S/p/e", v, v, v as i64)).collect();
    store.persist(&all).unwrap();
    (folder, path)
}

#[test]
fn a_cut_file_is_an_error() {
    let (folder, path) = file_with(500);
    let bytes = std::fs::read(&path).unwrap();
    for part in [1, 10, 100, 511, 512, 4095, 4096, 5000, bytes.len() / 2, bytes.len() - 4096, bytes.len() - 1]
    {
        let cut = folder.path().join("cut.redb");
        std::fs::write(&cut, &bytes[..part]).unwrap();
        let found = LongTermMemory::open(&cut).and_then(|store| store.verify());
        match found {
            Err(StoreError::NotAStore { .. } | StoreError::Damaged { .. } | StoreError::Failed { .. }) => {}
            Ok(verification) if !verification.is_intact() => {}
            other => panic!("a file cut to {part} of {} bytes gave {other:?}", bytes.len()),
        }
    }
}

/// Export writes the intact snapshots of a damaged file, and reports that others are missing.
#[test]
fn what_is_intact_is_exported_past_what_is_damaged() {
    let (_folder, path) = file_with(500);
    let mut whole = Vec::new();
    let count = LongTermMemory::open(&path).unwrap().export(&Pattern::any(), &mut whole).unwrap();
    let mut bytes = std::fs::read(&path).unwrap();
    // The damage is in the content of a record in the middle: the record's checksum detects it.
    let name = b"value";
    let places: Vec<_> =
        bytes.windows(name.len()).enumerate().filter(|(_, w)| w == name).map(|(i, _)| i).collect();
    bytes[places[places.len() / 2]] ^= 1;
    std::fs::write(&path, &bytes).unwrap();
    let store = LongTermMemory::open(&path).unwrap();
    let mut rest = Vec::new();
    let error = store.export(&Pattern::any(), &mut rest).unwrap_err();
    assert!(matches!(&error, StoreError::Damaged { what, .. } if what.contains("were written")), "{error}");
    let lines = |text: &[u8]| text.iter().filter(|byte| **byte == b'\n').count() as u64;
    assert_eq!((lines(&whole), lines(&rest)), (count, count - 1));
    let memory = WorkingMemory::new(Arc::new(|| 1));
    let before = std::fs::read(&path).unwrap();
    assert!(crate::maintain::carry_out(crate::wire::Maintain::Compact, Some(&store), &memory).is_err());
    drop(store);
    assert_eq!(before.len(), std::fs::read(&path).unwrap().len());
}

/// A bit that is flipped anywhere is noticed by whoever reads what it spoils: a query says so, or answers as if nothing was.
#[test]
fn a_flipped_bit_is_noticed_when_what_it_spoils_is_read() {
    let (folder, path) = file_with(200);
    let store = LongTermMemory::open(&path).unwrap();
    let more = (0..300).map(|n| snapshot(&format!("S/p/other{n}"), 1, n, 1));
    store.persist(&more.collect::<Vec<_>>()).unwrap();
    let memory = WorkingMemory::new(Arc::new(|| 1));
    store.load_into(&memory, Pattern::any()).unwrap();
    store.save_named("morning", &memory).unwrap();
    drop(store);
    let bytes = std::fs::read(&path).unwrap();
    let queries = [
        Query::latest(Pattern::any()),
        Query::history(Pattern::any()),
        Query::history(Pattern::segment("S").named("e")).times(Times::At(77)),
        Query::history(Pattern::segment("S").named("other12")),
    ];
    let ask = |file: &Path| -> Result<Vec<_>, StoreError> {
        let store = LongTermMemory::open(file)?;
        let mut answers: Vec<_> = queries.iter().map(|query| store.query(query)).collect();
        answers.push(store.named("morning"));
        let given = |id: &str| store.last_given(&id.parse().unwrap());
        given("S/p/e").and_then(|e| Ok((e, given("S/p/new")?))).map(|found| (answers, found)).map(|a| vec![a])
    };
    let expected = ask(&path).unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let file = folder.path().join("flipped.redb");
    let (mut noticed, mut spoiled) = (0, 0);
    // Every part of the file: each 512 bytes once, and the first ones, where the header is, each.
    let places = (0..HEADER_BYTES).chain((HEADER_BYTES..bytes.len()).step_by(512));
    for place in places {
        let place = if place < HEADER_BYTES { place } else { place + random.random_range(0..512) };
        let mut flipped = bytes.clone();
        flipped[place.min(bytes.len() - 1)] ^= 1 << random.random_range(0..8);
        std::fs::write(&file, &flipped).unwrap();
        let verified = LongTermMemory::open(&file).and_then(|store| store.verify());
        spoiled += u32::from(!verified.is_ok_and(|verified| verified.is_intact()));
        std::fs::write(&file, &flipped).unwrap();
        match ask(&file) {
            Err(error) => {
                let is_damage = matches!(error, StoreError::Damaged { .. } | StoreError::NotAStore { .. });
                assert!(is_damage, "{error} at byte {place}");
                noticed += 1;
            }
            Ok(found) => {
                for ((found, given), (expected, expected_given)) in found.into_iter().zip(&expected) {
                    assert_eq!(given, *expected_given, "bit at {place}");
                    for (found, expected) in found.into_iter().zip(expected) {
                        match found {
                            Ok(found) => assert_eq!(&Ok(found), expected, "bit at {place}"),
                            Err(StoreError::Damaged { .. }) => noticed += 1,
                            Err(error) => panic!("{error} at byte {place}"),
                        }
                    }
                }
            }
        }
    }
    assert!(noticed > 20 && spoiled > 20, "{noticed} noticed, {spoiled} found by verification");
}

#[test]
fn other_files_are_refused_and_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("text.redb");
    std::fs::write(&path, "name: value\n".repeat(1000)).unwrap();
    assert!(matches!(LongTermMemory::open(&path), Err(StoreError::NotAStore { .. })));
    assert_eq!(std::fs::read_to_string(&path).unwrap(), "name: value\n".repeat(1000));

    let empty = folder.path().join("empty.redb");
    std::fs::write(&empty, "").unwrap();
    assert!(matches!(LongTermMemory::open(&empty), Err(StoreError::NotAStore { .. })));
    assert_eq!(std::fs::metadata(&empty).unwrap().len(), 0);

    let path = folder.path().join("other.redb");
    let other = Database::create(&path).unwrap();
    let write = other.begin_write().unwrap();
    write.open_table(TableDefinition::<u64, u64>::new("something")).unwrap();
    write.commit().unwrap();
    drop(other);
    assert!(matches!(LongTermMemory::open(&path), Err(StoreError::NotAStore { .. })));

    for other_format in [1, 4] {
        let path = folder.path().join(format!("format{other_format}.redb"));
        drop(LongTermMemory::open(&path).unwrap());
        let (newer, _) = checked::open(&path, &redb::Builder::new(), &Arc::default()).unwrap();
        let write = newer.begin_write().unwrap();
        write.open_table(META).unwrap().insert("format", other_format).unwrap();
        write.commit().unwrap();
        drop(newer);
        let path_text = path.display().to_string();
        let error = StoreError::Format { path: path_text, found: other_format, supported: FORMAT };
        assert_eq!(LongTermMemory::open(&path).unwrap_err(), error);
    }
}

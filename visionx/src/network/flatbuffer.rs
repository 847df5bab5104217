//! Reads FlatBuffers, the container of TFLite files: tables whose fields are found through an offset table. Every offset is
//! checked against the file's length, so a damaged file is an error.

use super::NetworkError;

/// A table in a file.
#[derive(Clone, Copy, Debug)]
pub(super) struct Table<'a> {
    bytes: &'a [u8],
    /// Where the table begins.
    at: usize,
    /// The offsets of its fields, relative to `at`; two bytes each.
    fields: &'a [u8],
}

/// Most elements of a list of tables, in any file that is accepted.
const MOST_TABLES: usize = 8192;

fn damaged() -> NetworkError {
    NetworkError::Damaged
}

/// `N` bytes at a place.
fn array<const N: usize>(bytes: &[u8], at: usize) -> Result<[u8; N], NetworkError> {
    let end = at.checked_add(N).ok_or_else(damaged)?;
    bytes.get(at..end).and_then(|bytes| bytes.try_into().ok()).ok_or_else(damaged)
}

/// The place that a relative offset stored at `at` refers to.
fn follow(bytes: &[u8], at: usize) -> Result<usize, NetworkError> {
    at.checked_add(u32::from_le_bytes(array(bytes, at)?) as usize).ok_or_else(damaged)
}

impl<'a> Table<'a> {
    /// The outermost table of a file.
    pub(super) fn root(bytes: &'a [u8]) -> Result<Self, NetworkError> {
        Self::at(bytes, follow(bytes, 0)?)
    }

    fn at(bytes: &'a [u8], at: usize) -> Result<Self, NetworkError> {
        let back = i64::from(i32::from_le_bytes(array(bytes, at)?));
        let vtable = usize::try_from(at as i64 - back).map_err(|_| damaged())?;
        let length = usize::from(u16::from_le_bytes(array(bytes, vtable)?));
        let fields = bytes.get(vtable..vtable.saturating_add(length)).and_then(|v| v.get(4..));
        Ok(Self { bytes, at, fields: fields.ok_or_else(damaged)? })
    }

    /// Where the field with this number is; `None` when the file leaves it out.
    fn field(&self, number: usize) -> Option<usize> {
        let offset = u16::from_le_bytes(array(self.fields, 2 * number).ok()?);
        (offset != 0).then(|| self.at + usize::from(offset))
    }

    /// A number of one byte.
    pub(super) fn byte(&self, number: usize) -> Result<Option<u8>, NetworkError> {
        self.field(number).map(|at| array(self.bytes, at).map(|[b]| b)).transpose()
    }

    /// A number of four bytes.
    pub(super) fn int(&self, number: usize) -> Result<Option<i32>, NetworkError> {
        self.field(number).map(|at| array(self.bytes, at).map(i32::from_le_bytes)).transpose()
    }

    /// A table inside this one.
    pub(super) fn table(&self, number: usize) -> Result<Option<Self>, NetworkError> {
        let Some(at) = self.field(number) else { return Ok(None) };
        Self::at(self.bytes, follow(self.bytes, at)?).map(Some)
    }

    /// The bytes of a list of elements of `size` bytes; empty when the file leaves it out.
    pub(super) fn list(&self, number: usize, size: usize) -> Result<&'a [u8], NetworkError> {
        self.place_of_list(number, size).map(|(_, bytes)| bytes)
    }

    fn place_of_list(&self, number: usize, size: usize) -> Result<(usize, &'a [u8]), NetworkError> {
        let Some(at) = self.field(number) else { return Ok((0, &[])) };
        let at = follow(self.bytes, at)?;
        let length = (u32::from_le_bytes(array(self.bytes, at)?) as usize).checked_mul(size);
        let end = length.and_then(|length| length.checked_add(at + 4)).ok_or_else(damaged)?;
        Ok((at + 4, self.bytes.get(at + 4..end).ok_or_else(damaged)?))
    }

    /// A list of numbers of four bytes.
    pub(super) fn ints(&self, number: usize) -> Result<Vec<i32>, NetworkError> {
        Ok(ints(self.list(number, 4)?))
    }

    /// A list of tables.
    pub(super) fn tables(&self, number: usize) -> Result<Vec<Self>, NetworkError> {
        let (at, bytes) = self.place_of_list(number, 4)?;
        let count = bytes.len() / 4;
        if count > MOST_TABLES {
            return Err(NetworkError::TooLarge { what: "number of tables", is: count, most: MOST_TABLES });
        }
        (0..count).map(|i| Self::at(self.bytes, follow(self.bytes, at + 4 * i)?)).collect()
    }
}

/// Bytes as numbers of four bytes.
pub(super) fn ints(bytes: &[u8]) -> Vec<i32> {
    bytes.as_chunks::<4>().0.iter().map(|b| i32::from_le_bytes(*b)).collect()
}

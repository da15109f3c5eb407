//! The bytes of an input file: mapped into memory when large, read when small.

use std::fs::File;
use std::io::Read;
use std::ops::{Deref, Range};
use std::path::Path;

use memmap2::{Advice, Mmap};

use crate::ReadError;

/// Files of at least this many bytes are mapped.
const MAP_FROM: u64 = 1 << 20;

/// The whole content of an input.
pub(crate) enum Input<'a> {
    Mapped(Mmap),
    Read(Vec<u8>),
    Given(&'a [u8]),
}

impl Input<'_> {
    /// Opens a file.
    pub(crate) fn open(path: &Path) -> Result<Self, ReadError> {
        let mut file = File::open(path)?;
        let meta = file.metadata()?;
        if meta.is_dir() {
            return Err(ReadError::new("this is a folder, not a file").with_remedy("name a file in it"));
        }
        if meta.len() < MAP_FROM || !meta.is_file() {
            let mut bytes = Vec::new();
            file.read_to_end(&mut bytes)?;
            return Ok(Self::Read(bytes));
        }
        // SAFETY: the map is read-only and only ever seen as bytes whose value no invariant depends on: readers check
        // what they read. A file that another program shortens meanwhile ends the process with a bus error, as it
        // does in every program that maps its input; a file that is overwritten gives a damaged mesh or an error.
        let map = unsafe { Mmap::map(&file) }?;
        // advice is advice: where the system knows none, reading still works
        let _ = map.advise(Advice::Sequential);
        Ok(Self::Mapped(map))
    }

    /// Tells that a range has been read for the last time, so that its pages need not stay in memory.
    pub(crate) fn release(&self, range: Range<usize>) {
        #[cfg(unix)]
        if let Self::Mapped(map) = self {
            let page = 1 << 16;
            let (start, end) = (range.start.next_multiple_of(page), range.end / page * page);
            if start < end {
                // SAFETY: the map is backed by the file and never written to, so dropped pages come back unchanged
                // from the file if they are read again.
                let _ = unsafe { map.unchecked_advise_range(memmap2::UncheckedAdvice::DontNeed, start, end - start) };
            }
        }
        #[cfg(not(unix))]
        let _ = range;
    }
}

impl Deref for Input<'_> {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        match self {
            Self::Mapped(map) => map,
            Self::Read(bytes) => bytes,
            Self::Given(bytes) => bytes,
        }
    }
}

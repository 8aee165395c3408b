//! The structure of a snapshot buffer: what its writer says about the records, and where everything
//! lies in the segment. Also the header that tells it to any reader. It knows no files.
//!
//! The header is the first page of the segment, in words of 64 bits in the order of the host:
//!
//! | word | what |
//! |---|---|
//! | 0 | `SORMASNP` |
//! | 1 | version of this format, 1 |
//! | 2 | bytes of the segment |
//! | 3, 4, 5 | slots; floats of a record; the most opaque bytes of a record |
//! | 6 | clock of the stamps: 0 the host's monotonic one, 1 a virtual one |
//! | 7 | bytes of the description, which begins at word 512 |
//! | 16 | generation: how many writers there have been |
//! | 17, 18 | process id of the writer and when that process started, clock ticks since the host did |
//! | 19 | 1 a writer is there, 2 it ended orderly, 3 another segment has taken the place of this one |
//! | 20 | start of the writer's app, ns of the host's monotonic clock |
//! | 24 | number of the latest whole record |
//! | 32 | bell: 1 while a reader waits |
//!
//! The slots follow the description at the next multiple of 64 bytes, and each is a multiple of 64 bytes
//! long. A slot is a sequence word, the stamp in ns, the generation of the writer and the number of
//! opaque bytes. Four spare words, the floats and the bytes follow.

use super::error::SnapshotError;
use super::protocol::{Load, Ring, SLOT_HEAD, Store, WORD};

pub(super) const MAGIC: u64 = u64::from_ne_bytes(*b"SORMASNP");
pub(super) const VERSION: u64 = 1;
/// Bytes of the header.
pub(super) const HEADER: usize = 4096;

const LINE: usize = 8;
const DESCRIPTION: usize = HEADER / WORD;
pub(super) const GENERATION: usize = 16;
pub(super) const PID: usize = 17;
pub(super) const PID_START: usize = 18;
pub(super) const STATE: usize = 19;
pub(super) const ORIGIN: usize = 20;
const HEAD: usize = 24;
pub(super) const BELL: usize = 32;

pub(super) const WRITING: u64 = 1;
pub(super) const CLOSED: u64 = 2;
pub(super) const REPLACED: u64 = 3;

/// The most slots of a buffer.
pub const MOST_SLOTS: usize = 1 << 20;
/// The most floats of a record.
pub const MOST_FLOATS: usize = 1 << 20;
/// The most opaque bytes of a record.
pub const MOST_BYTES: usize = 1 << 28;
/// The most bytes of a description.
pub const MOST_DESCRIPTION: usize = 1 << 16;
/// The most bytes of a whole segment: 4 GiB.
pub const MOST_SEGMENT: usize = 1 << 32;

/// What a writer says about its records.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Layout {
    /// How many records the buffer keeps; 1 to [`MOST_SLOTS`]. One slot is single buffering, in which a
    /// reader may find nothing to read while the writer is in it.
    pub slots: usize,
    /// Floats of each record, up to [`MOST_FLOATS`].
    pub floats: usize,
    /// The most opaque bytes of a record, up to [`MOST_BYTES`]; a record may have fewer.
    pub bytes: usize,
    /// What the floats are: a line for each, `name unit`; or empty. Free for the writer to say.
    pub description: String,
}

impl Layout {
    /// A buffer of so many slots, with `floats` floats in each record and no opaque bytes.
    #[must_use]
    pub fn new(slots: usize, floats: usize) -> Self {
        Self {
            slots,
            floats,
            bytes: 0,
            description: String::new(),
        }
    }

    /// With up to `bytes` opaque bytes in each record.
    #[must_use]
    pub fn bytes(mut self, bytes: usize) -> Self {
        self.bytes = bytes;
        self
    }

    /// With the names and units of the floats, a line for each.
    #[must_use]
    pub fn described(mut self, description: impl Into<String>) -> Self {
        self.description = description.into();
        self
    }

    /// The name that the description gives to a float: the first word of its line.
    #[must_use]
    pub fn name_of(&self, float: usize) -> Option<&str> {
        self.description
            .lines()
            .nth(float)?
            .split_whitespace()
            .next()
    }

    /// Whether a buffer can have this layout.
    ///
    /// # Errors
    /// A number that is beyond its limits, with these.
    pub fn check(&self) -> Result<(), SnapshotError> {
        self.geometry().map(drop)
    }

    /// Where everything lies.
    pub(super) fn geometry(&self) -> Result<Geometry, SnapshotError> {
        let within = |what: &'static str, value: usize, low: usize, high: usize| {
            if (low..=high).contains(&value) {
                return Ok(());
            }
            Err(SnapshotError::Layout {
                what,
                value,
                low,
                high,
            })
        };
        let description = self.description.len();
        within("slots", self.slots, 1, MOST_SLOTS)?;
        within("floats", self.floats, 0, MOST_FLOATS)?;
        within("bytes", self.bytes, 0, MOST_BYTES)?;
        within("bytes of description", description, 0, MOST_DESCRIPTION)?;
        let first = (DESCRIPTION + description.div_ceil(WORD)).next_multiple_of(LINE);
        let stride = (SLOT_HEAD + self.floats + self.bytes.div_ceil(WORD)).next_multiple_of(LINE);
        // Below 2^20 * 2^26 words: no overflow.
        let bytes = (first + self.slots * stride) * WORD;
        within("bytes in all", bytes, 0, MOST_SEGMENT)?;
        let ring = Ring {
            head: HEAD,
            first,
            stride,
            slots: self.slots as u64,
            floats: self.floats,
            bytes: self.bytes,
        };
        Ok(Geometry { ring, bytes })
    }
}

/// Where everything lies in a segment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Geometry {
    pub(super) ring: Ring,
    /// Bytes of the whole segment.
    pub(super) bytes: usize,
}

/// The part of the header that never changes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Header {
    pub(super) layout: Layout,
    /// Whether the stamps are of a virtual clock.
    pub(super) virtual_time: bool,
    pub(super) geometry: Geometry,
}

impl Header {
    pub(super) fn new(layout: Layout, virtual_time: bool) -> Result<Self, SnapshotError> {
        let geometry = layout.geometry()?;
        Ok(Self {
            layout,
            virtual_time,
            geometry,
        })
    }

    pub(super) fn write(&self, memory: &impl Store) {
        let layout = &self.layout;
        memory.store_bytes(DESCRIPTION, layout.description.as_bytes());
        memory.store(2, self.geometry.bytes as u64);
        memory.store(3, layout.slots as u64);
        memory.store(4, layout.floats as u64);
        memory.store(5, layout.bytes as u64);
        memory.store(6, u64::from(self.virtual_time));
        memory.store(7, layout.description.len() as u64);
        memory.store(1, VERSION);
        memory.store(0, MAGIC);
    }

    /// Reads the header of a segment of `bytes` bytes, of which at least the first page is in `memory`.
    /// Everything that is used later is checked here, once, and copied. The description may lie
    /// beyond that page; see [`Self::read_description`].
    pub(super) fn read(
        memory: &impl Load,
        bytes: u64,
        path: &std::path::Path,
    ) -> Result<Self, SnapshotError> {
        let path = || path.to_owned();
        if memory.load(0) != MAGIC {
            return Err(SnapshotError::NoSnapshots { path: path() });
        }
        let version = memory.load(1);
        if version != VERSION {
            return Err(SnapshotError::Version {
                path: path(),
                version,
            });
        }
        let word = |at: usize| usize::try_from(memory.load(at)).unwrap_or(usize::MAX);
        let mut layout = Layout::new(word(3), word(4)).bytes(word(5));
        let description = word(7);
        let damaged = |why: String| SnapshotError::Damaged { path: path(), why };
        if description > MOST_DESCRIPTION {
            return Err(damaged(format!("a description of {description} bytes")));
        }
        // Its length is what the geometry depends on; its text comes when it can be reached.
        layout.description = " ".repeat(description);
        let geometry = layout
            .geometry()
            .map_err(|error| damaged(error.to_string()))?;
        if bytes < geometry.bytes as u64 {
            let needs = geometry.bytes;
            return Err(damaged(format!(
                "it has {bytes} bytes, and its records need {needs}"
            )));
        }
        Ok(Self {
            layout,
            virtual_time: memory.load(6) != 0,
            geometry,
        })
    }

    /// Reads the description, now that the whole segment is in `memory`.
    pub(super) fn read_description(&mut self, memory: &impl Load) {
        let mut text = vec![0; self.layout.description.len()];
        memory.load_bytes(DESCRIPTION, &mut text);
        self.layout.description = String::from_utf8_lossy(&text).into_owned();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_layout_that_nothing_could_hold_is_refused_with_the_limits() {
        let wrong = |layout: Layout| layout.geometry().unwrap_err().to_string();
        assert_eq!(
            wrong(Layout::new(0, 1)),
            "slots must be 1 to 1048576, not 0"
        );
        assert!(wrong(Layout::new(1, usize::MAX)).starts_with("floats must be 0 to"));
        let huge = Layout::new(MOST_SLOTS, MOST_FLOATS).bytes(MOST_BYTES);
        assert!(wrong(huge).starts_with("bytes in all must be 0 to"));
    }

    proptest! {
        #[test]
        fn slots_lie_apart_from_the_header_and_inside_the_segment(
            slots in 1_usize..50, floats in 0_usize..50, bytes in 0_usize..500, text in 0_usize..99,
        ) {
            let layout = Layout::new(slots, floats).bytes(bytes).described("x".repeat(text));
            let Geometry { ring, bytes: all } = layout.geometry().unwrap();
            prop_assert!(ring.first * WORD >= HEADER + text);
            prop_assert!(ring.stride * WORD >= SLOT_HEAD * WORD + floats * 8 + bytes);
            prop_assert_eq!((ring.first % LINE, ring.stride % LINE), (0, 0));
            prop_assert_eq!((ring.first + slots * ring.stride) * WORD, all);
        }
    }
}

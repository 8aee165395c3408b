//! Where segments lie: a folder of the user's alone in `/dev/shm`, in it one for each app, in that a file for
//! each buffer. Also: which segments there are, and which of them nobody wants any more.

use super::error::SnapshotError;
use super::layout::{self, HEADER, Header};
use super::memory::View;
use super::protocol::Load;
use super::record::host_ns;
use crate::process::Process;
use ctos::time::Clock;
use rustix::fs::{Mode, OFlags};
use std::fs::{DirBuilder, File};
use std::io::{self, ErrorKind};
use std::os::unix::fs::{DirBuilderExt, MetadataExt};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Memory that all processes of the host share.
const SHARED: &str = "/dev/shm";
/// A segment without a writer into which nothing was written for so long is stale.
pub const STALE_AFTER: Duration = Duration::from_secs(600);
/// So begin the names of segments that are being made.
const UNFINISHED: &str = ".new-";

/// The folder of an app's segments.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Place {
    folder: PathBuf,
}

/// A segment that lies in a folder.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct Segment {
    /// The name of the buffer.
    pub name: String,
    /// How many writers it has had.
    pub generation: u64,
    /// The process that wrote last.
    pub writer: Process,
    /// Whether that process is still there to write.
    pub is_written: bool,
    /// The number of the latest record.
    pub head: u64,
    /// How long ago the latest record was written; `None` when there is none, or when its stamp is of a
    /// virtual clock.
    pub age: Option<Duration>,
}

impl Place {
    /// The folder of this user's segments of an app, made when it is not there.
    ///
    /// # Errors
    /// The app's name cannot be one, the folder is somebody else's, or the system refuses.
    pub fn of_app(app: &str) -> Result<Self, SnapshotError> {
        let user = rustix::process::getuid().as_raw();
        Self::under(&Path::new(SHARED).join(format!("sorma-{user}")), app)
    }

    /// The folder of an app's segments under another folder than the usual one.
    ///
    /// # Errors
    /// As [`of_app`](Self::of_app).
    pub fn under(root: &Path, app: &str) -> Result<Self, SnapshotError> {
        let app = checked(app)?;
        private_folder(root)?;
        let folder = root.join(app);
        private_folder(&folder)?;
        Ok(Self { folder })
    }

    pub(super) fn path(&self, name: &str) -> Result<PathBuf, SnapshotError> {
        Ok(self.folder.join(checked(name)?))
    }

    /// A name for a segment that is being made. Two that are made at once, also by one process, differ.
    pub(super) fn unfinished(&self, attempt: u32) -> PathBuf {
        let pid = Process::this().pid;
        self.folder.join(format!("{UNFINISHED}{pid}-{attempt}"))
    }

    /// The segments of the app, by name. What is no segment is passed over.
    ///
    /// # Errors
    /// The folder cannot be read.
    pub fn segments(&self) -> Result<Vec<Segment>, SnapshotError> {
        let clock = Clock::real();
        let mut segments = Vec::new();
        for name in self.names()? {
            let path = self.folder.join(&name);
            segments.extend(inspect(&path, &name, &clock));
        }
        Ok(segments)
    }

    /// Removes the segments that are stale: their writer is gone, and nothing was written for
    /// [`STALE_AFTER`]; or they were never finished. Readers that have one open keep it. Answers the names.
    ///
    /// # Errors
    /// The folder cannot be read.
    pub fn remove_stale(&self) -> Result<Vec<String>, SnapshotError> {
        self.remove_unwritten(STALE_AFTER)
    }

    /// As [`remove_stale`](Self::remove_stale), with another age.
    ///
    /// # Errors
    /// The folder cannot be read.
    pub fn remove_unwritten(&self, older_than: Duration) -> Result<Vec<String>, SnapshotError> {
        let clock = Clock::real();
        let mut removed = Vec::new();
        for name in self.names()? {
            let path = self.folder.join(&name);
            // The maker or writer of a segment holds its lock.
            let Ok(file) = open(&path, OFlags::RDWR) else {
                continue;
            };
            if file.try_lock().is_err() || !is_at(&file, &path) {
                continue;
            }
            let is_old = match inspect(&path, &name, &clock) {
                Some(segment) => segment.age.is_none_or(|age| age >= older_than),
                None => name.starts_with(UNFINISHED),
            };
            if is_old && std::fs::remove_file(&path).is_ok() {
                removed.push(name);
            }
        }
        Ok(removed)
    }

    fn names(&self) -> Result<Vec<String>, SnapshotError> {
        let listed = std::fs::read_dir(&self.folder)
            .map_err(|source| system(&self.folder, "cannot be listed", source))?;
        let mut names: Vec<String> = listed
            .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
            .collect();
        names.sort_unstable();
        Ok(names)
    }
}

fn inspect(path: &Path, name: &str, clock: &Clock) -> Option<Segment> {
    let file = open(path, OFlags::RDONLY).ok()?;
    let length = file.metadata().ok()?.len();
    let view = View::new(&file, HEADER).ok()?;
    let header = Header::read(&view, length, path).ok()?;
    let ring = header.geometry.ring;
    let head = ring.head(&view);
    let writer = writer_of(&view);
    let whole = View::new(&file, header.geometry.bytes).ok()?;
    let (mut floats, mut bytes) = (Vec::new(), Vec::new());
    let stamp = match ring.read(&whole, head, &mut floats, &mut bytes) {
        super::protocol::Taken::Whole(mark) if head > 0 && !header.virtual_time => {
            Some(mark.stamp_ns)
        }
        _ => None,
    };
    Some(Segment {
        name: name.to_owned(),
        generation: view.load(layout::GENERATION),
        writer,
        is_written: view.load(layout::STATE) == layout::WRITING && writer.is_alive(),
        head,
        age: stamp.map(|stamp| Duration::from_nanos(host_ns(clock).saturating_sub(stamp))),
    })
}

/// The process that a header names as its writer.
pub(super) fn writer_of(memory: &impl Load) -> Process {
    Process {
        pid: u32::try_from(memory.load(layout::PID)).unwrap_or(0),
        start: memory.load(layout::PID_START),
    }
}

/// Opens a segment, which must be a file of this user's.
pub(super) fn open(path: &Path, access: OFlags) -> Result<File, SnapshotError> {
    let flags = access | OFlags::CLOEXEC | OFlags::NOFOLLOW | OFlags::NONBLOCK;
    let file = rustix::fs::open(path, flags, Mode::empty()).map_err(|error| {
        let source = io::Error::from(error);
        match source.kind() {
            ErrorKind::NotFound => SnapshotError::Missing {
                path: path.to_owned(),
            },
            _ => system(path, "cannot be opened", source),
        }
    })?;
    let file = File::from(file);
    let meta = file
        .metadata()
        .map_err(|source| system(path, "cannot be looked at", source))?;
    let user = rustix::process::getuid().as_raw();
    if !meta.is_file() || meta.uid() != user {
        return Err(SnapshotError::NotOurs {
            path: path.to_owned(),
            why: "this is no file of this user's",
        });
    }
    Ok(file)
}

/// Whether an open file is still the one of that name.
pub(super) fn is_at(file: &File, path: &Path) -> bool {
    let (Ok(open), Ok(named)) = (file.metadata(), std::fs::symlink_metadata(path)) else {
        return false;
    };
    (open.dev(), open.ino()) == (named.dev(), named.ino())
}

/// Makes sure of a folder that is there for this user alone.
fn private_folder(folder: &Path) -> Result<(), SnapshotError> {
    match DirBuilder::new().mode(0o700).create(folder) {
        Err(error) if error.kind() != ErrorKind::AlreadyExists => {
            return Err(system(folder, "cannot be made", error));
        }
        _ => {}
    }
    let meta = std::fs::symlink_metadata(folder)
        .map_err(|source| system(folder, "cannot be looked at", source))?;
    let not_ours = |why| {
        Err(SnapshotError::NotOurs {
            path: folder.to_owned(),
            why,
        })
    };
    if !meta.is_dir() {
        return not_ours("this is no folder");
    }
    if meta.uid() != rustix::process::getuid().as_raw() {
        return not_ours("this folder belongs to another user");
    }
    if meta.mode() & 0o077 != 0 {
        return not_ours("this folder is open to other users");
    }
    Ok(())
}

fn checked(name: &str) -> Result<&str, SnapshotError> {
    let letter = |letter: char| letter.is_ascii_alphanumeric() || "_-.".contains(letter);
    let fits = (1..=100).contains(&name.len());
    if fits && !name.starts_with('.') && name.chars().all(letter) {
        Ok(name)
    } else {
        Err(SnapshotError::Name(name.chars().take(120).collect()))
    }
}

pub(super) fn system(path: &Path, what: &'static str, source: io::Error) -> SnapshotError {
    SnapshotError::System {
        path: path.to_owned(),
        what,
        source,
    }
}

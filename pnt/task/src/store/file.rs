//! A store as a redb file. A thread of its own writes and syncs; redb's commits are whole or absent after
//! a crash, and its checksums tell a damaged file.

use std::{
    fs,
    io::{self, Read as _},
    os::unix::fs::OpenOptionsExt,
    panic::AssertUnwindSafe,
    path::{Path, PathBuf},
    sync::{Arc, mpsc},
    thread,
};

use redb::{
    Database, DatabaseError, ReadableDatabase as _, ReadableTable as _, StorageError,
    TableDefinition, TableError,
};
use tokio::sync::oneshot;

use super::{Change, Contents, FORMAT, Owner, StoreError};

/// Whose file it is, and its format.
const ABOUT: TableDefinition<'_, &str, &str> = TableDefinition::new("about");
/// What it holds.
const DATA: TableDefinition<'_, &str, &[u8]> = TableDefinition::new("data");

/// Memory for pages that were read, bytes: a store is small.
const CACHE: usize = 1 << 20;

type Committed = oneshot::Sender<Result<(), StoreError>>;

enum Job {
    Commit(Vec<Change>, Committed),
    /// Answered when all before it are done.
    Flush(mpsc::Sender<()>),
}

pub(super) struct File {
    path: PathBuf,
    database: Arc<Database>,
    jobs: mpsc::Sender<Job>,
}

impl File {
    pub(super) fn open(path: &Path, owner: &Owner) -> Result<Self, StoreError> {
        // The database checks what it reads; should it panic on rubbish nevertheless, that is rubbish.
        let opened = std::panic::catch_unwind(AssertUnwindSafe(|| open(path, owner)));
        let database = opened.unwrap_or_else(|_| Err(damaged(path, "its pages make no sense")))?;
        let database = Arc::new(database);
        let (jobs, queue) = mpsc::channel();
        let (writer, place) = (Arc::clone(&database), path.to_owned());
        thread::Builder::new()
            .name(format!("store/{}", owner.name))
            .spawn(move || write(&writer, &place, &queue))
            .map_err(|error| failed(path, "cannot start its thread", &error))?;
        Ok(Self {
            path: path.to_owned(),
            database,
            jobs,
        })
    }

    pub(super) fn load(&self) -> Result<Contents, StoreError> {
        let (done, wait) = mpsc::channel();
        if self.jobs.send(Job::Flush(done)).is_ok() {
            // An error means that the thread is gone, and with it every commit.
            let _ = wait.recv();
        }
        let read = AssertUnwindSafe(|| contents(&self.database));
        match std::panic::catch_unwind(read) {
            Ok(Ok(contents)) => Ok(contents),
            Ok(Err(error)) => Err(damaged(&self.path, &error)),
            Err(_) => Err(damaged(&self.path, "its pages make no sense")),
        }
    }

    pub(super) async fn commit(&self, changes: Vec<Change>) -> Result<(), StoreError> {
        let gone = || failed(&self.path, "cannot write", "its thread has ended");
        let (done, wait) = oneshot::channel();
        let sent = self.jobs.send(Job::Commit(changes, done));
        sent.map_err(|_| gone())?;
        wait.await.map_err(|_| gone())?
    }
}

fn failed(path: &Path, what: &'static str, reason: impl ToString) -> StoreError {
    StoreError::Failed {
        path: path.to_owned(),
        what,
        reason: reason.to_string(),
    }
}

fn damaged(path: &Path, reason: impl ToString) -> StoreError {
    StoreError::Damaged {
        path: path.to_owned(),
        reason: reason.to_string(),
    }
}

fn open(path: &Path, owner: &Owner) -> Result<Database, StoreError> {
    if let Some(folder) = path.parent() {
        let made = fs::create_dir_all(folder);
        made.map_err(|error| failed(path, "cannot make its folder", error))?;
    }
    let unmade = is_unmade(path).map_err(|error| failed(path, "cannot open", error))?;
    if unmade {
        make(path, owner)?;
    }
    let opened = Database::builder().set_cache_size(CACHE).open(path);
    let database = opened.map_err(|error| refused(path, error))?;
    let about = about(&database).map_err(|error| damaged(path, error))?;
    match about {
        Some((format, _)) if format != FORMAT.to_string() => Err(StoreError::Format {
            path: path.to_owned(),
            found: format,
        }),
        Some((_, found)) if found != owner.to_string() => Err(StoreError::Foreign {
            path: path.to_owned(),
            found,
            expected: owner.to_string(),
        }),
        Some(_) => Ok(database),
        None => {
            let claimed = claim(&database, owner);
            claimed.map_err(|error| failed(path, "cannot write", error))?;
            Ok(database)
        }
    }
}

/// Whether no store was ever made there: no file, or one of zeros alone. A process that dies while it makes a
/// database leaves zeros in its place. A database that has a commit has a header.
fn is_unmade(path: &Path) -> io::Result<bool> {
    let mut file = match fs::File::open(path) {
        Ok(file) => file,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(true),
        Err(error) => return Err(error),
    };
    let mut part = vec![0; 1 << 16];
    loop {
        match file.read(&mut part)? {
            0 => return Ok(true),
            n if part.iter().take(n).any(|byte| *byte != 0) => return Ok(false),
            _ => {}
        }
    }
}

/// Makes the store beside its place and renames it: a process that dies meanwhile leaves no half of one
/// there.
fn make(path: &Path, owner: &Owner) -> Result<(), StoreError> {
    let beside = path.with_added_extension("new");
    match fs::remove_file(&beside) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => {
            return Err(failed(
                path,
                "cannot remove what an earlier process left beside it",
                error,
            ));
        }
        _ => {}
    }
    let mut options = fs::OpenOptions::new();
    // What a net knows is its user's own, from the first byte on.
    let file = options
        .write(true)
        .create_new(true)
        .mode(0o600)
        .open(&beside);
    file.map_err(|error| failed(path, "cannot make", error))?;
    let made = Database::builder().set_cache_size(CACHE).create(&beside);
    let database = made.map_err(|error| refused(path, error))?;
    claim(&database, owner).map_err(|error| failed(path, "cannot write", error))?;
    drop(database);
    let renamed = fs::rename(&beside, path).and_then(|()| match path.parent() {
        // The new name survives a loss of power only once the folder is written.
        Some(folder) if folder != Path::new("") => fs::File::open(folder)?.sync_all(),
        _ => Ok(()),
    });
    renamed.map_err(|error| failed(path, "cannot make", error))
}

fn refused(path: &Path, error: DatabaseError) -> StoreError {
    match error {
        DatabaseError::DatabaseAlreadyOpen => StoreError::InUse {
            path: path.to_owned(),
        },
        DatabaseError::UpgradeRequired(found) => StoreError::Format {
            path: path.to_owned(),
            found: format!("redb {found}"),
        },
        DatabaseError::Storage(StorageError::Io(error))
            if error.kind() != io::ErrorKind::InvalidData
                && error.kind() != io::ErrorKind::UnexpectedEof =>
        {
            failed(path, "cannot open", error)
        }
        error => damaged(path, error),
    }
}

/// Format and owner; none in a file that was just made.
fn about(database: &Database) -> Result<Option<(String, String)>, redb::Error> {
    let reading = database.begin_read()?;
    let table = match reading.open_table(ABOUT) {
        Ok(table) => table,
        Err(TableError::TableDoesNotExist(_)) => return Ok(None),
        Err(error) => return Err(error.into()),
    };
    let word = |key| -> Result<String, redb::Error> {
        let value = table.get(key)?;
        Ok(value.map_or_else(String::new, |value| value.value().to_owned()))
    };
    Ok(Some((word("format")?, word("owner")?)))
}

fn claim(database: &Database, owner: &Owner) -> Result<(), redb::Error> {
    let writing = database.begin_write()?;
    {
        let mut table = writing.open_table(ABOUT)?;
        table.insert("format", FORMAT.to_string().as_str())?;
        table.insert("owner", owner.to_string().as_str())?;
        writing.open_table(DATA)?;
    }
    writing.commit()?;
    Ok(())
}

fn contents(database: &Database) -> Result<Contents, redb::Error> {
    let reading = database.begin_read()?;
    let table = reading.open_table(DATA)?;
    let mut contents = Contents::new();
    for entry in table.iter()? {
        let (name, value) = entry?;
        contents.insert(name.value().to_owned(), value.value().to_owned());
    }
    Ok(contents)
}

/// The thread of a store, until nobody has it any more.
fn write(database: &Database, path: &Path, queue: &mpsc::Receiver<Job>) {
    while let Ok(job) = queue.recv() {
        match job {
            Job::Flush(done) => drop(done.send(())),
            Job::Commit(changes, done) => {
                let written = written(database, changes);
                let written = written.map_err(|error| failed(path, "cannot write", error));
                // A task that has ended meanwhile waits no more.
                let _ = done.send(written);
            }
        }
    }
}

fn written(database: &Database, changes: Vec<Change>) -> Result<(), redb::Error> {
    let writing = database.begin_write()?;
    {
        let mut table = writing.open_table(DATA)?;
        for (name, value) in changes {
            match value {
                Some(value) => table.insert(name.as_str(), value.as_slice())?,
                None => table.remove(name.as_str())?,
            };
        }
    }
    writing.commit()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn owner(name: &str) -> Owner {
        Owner {
            kind: "net".to_owned(),
            name: name.to_owned(),
        }
    }

    fn commit(file: &File, changes: &[(&str, Option<&[u8]>)]) {
        let changes = changes.iter();
        let changes = changes.map(|(name, value)| ((*name).to_owned(), value.map(<[u8]>::to_vec)));
        let committed = futures_util::FutureExt::boxed(file.commit(changes.collect()));
        wait(committed).unwrap();
    }

    /// Waits on this thread.
    fn wait<T>(future: impl Future<Output = T>) -> T {
        tokio::runtime::Builder::new_current_thread()
            .build()
            .unwrap()
            .block_on(future)
    }

    #[test]
    fn what_was_committed_is_there_when_the_file_is_opened_again() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("deep/n.redb");
        let file = File::open(&path, &owner("n")).unwrap();
        // It is its user's alone.
        let mode = std::os::unix::fs::MetadataExt::mode(&fs::metadata(&path).unwrap());
        assert_eq!(mode & 0o777, 0o600);
        commit(&file, &[("a", Some(b"1")), ("b", Some(b"2"))]);
        commit(&file, &[("a", Some(b"3")), ("b", None)]);
        let expected = Contents::from([("a".to_owned(), b"3".to_vec())]);
        assert_eq!(file.load().unwrap(), expected);
        assert!(matches!(
            File::open(&path, &owner("n")),
            Err(StoreError::InUse { .. })
        ));
        drop(file);
        // The thread closes the file when it sees that nobody is left.
        let again = loop {
            match File::open(&path, &owner("n")) {
                Err(StoreError::InUse { .. }) => thread::yield_now(),
                other => break other.unwrap(),
            }
        };
        assert_eq!(again.load().unwrap(), expected);
    }

    #[test]
    fn a_store_whose_maker_died_before_its_first_commit_is_made_anew() {
        // What kills in the midst of making one have left, and what they may leave beside it.
        for left in [vec![0; 1_056_768], Vec::new()] {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("n.redb");
            fs::write(&path, left).unwrap();
            fs::write(folder.path().join("n.redb.new"), [1, 2, 3]).unwrap();
            let file = File::open(&path, &owner("n")).unwrap();
            commit(&file, &[("a", Some(b"1"))]);
            assert_eq!(file.load().unwrap().len(), 1);
            assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
        }
    }

    #[test]
    fn a_store_whose_header_alone_was_overwritten_with_zeros_is_refused_and_kept() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("n.redb");
        {
            let database = Database::create(&path).unwrap();
            claim(&database, &owner("n")).unwrap();
        }
        let mut bytes = fs::read(&path).unwrap();
        bytes[..320].fill(0);
        fs::write(&path, &bytes).unwrap();
        assert!(matches!(
            File::open(&path, &owner("n")),
            Err(StoreError::Damaged { .. })
        ));
        assert_eq!(fs::read(&path).unwrap(), bytes);
    }

    #[test]
    fn the_file_of_another_net_is_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("n.redb");
        {
            let database = Database::create(&path).unwrap();
            claim(&database, &owner("m")).unwrap();
        }
        let error = File::open(&path, &owner("n")).err().unwrap().to_string();
        assert!(
            error.contains("holds the state of net `m`, not of net `n`"),
            "{error}"
        );
    }

    #[test]
    fn a_file_that_is_cut_short_overwritten_or_foreign_is_refused_or_whole_and_never_half_loaded() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("n.redb");
        {
            let database = Database::create(&path).unwrap();
            claim(&database, &owner("n")).unwrap();
            let value = vec![7_u8; 5000];
            let changes = vec![
                ("a".to_owned(), Some(value.clone())),
                ("b".to_owned(), Some(value)),
            ];
            written(&database, changes).unwrap();
        }
        let good = fs::read(&path).unwrap();
        let whole = |contents: &Contents| {
            contents.len() == 2 && contents.values().all(|value| *value == vec![7_u8; 5000])
        };
        let step = good.len() / 40;
        let mut refused = 0;
        for cut in (1..40).map(|part| part * step) {
            for overwritten in [false, true] {
                let mut bytes = good.clone();
                if overwritten {
                    let end = (cut + 700).min(bytes.len());
                    bytes[cut..end].fill(0xa5);
                } else {
                    bytes.truncate(cut);
                }
                let torn = folder.path().join(format!("{cut}{overwritten}.redb"));
                fs::write(&torn, &bytes).unwrap();
                match File::open(&torn, &owner("n")).and_then(|file| file.load()) {
                    Ok(contents) => assert!(whole(&contents), "cut at {cut}: {contents:?}"),
                    Err(error) => {
                        refused += 1;
                        assert!(error.to_string().contains(".redb"), "{error}");
                    }
                }
            }
        }
        assert!(refused > 30, "{refused}");
        let foreign = folder.path().join("foreign.redb");
        fs::write(&foreign, "net n\nplace a\n").unwrap();
        let error = File::open(&foreign, &owner("n")).err().unwrap();
        assert!(matches!(error, StoreError::Damaged { .. }), "{error}");
    }
}

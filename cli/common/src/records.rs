//! The files of a record, by the names that a person gives. A name may have files of several runs: nothing is
//! overwritten.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use ctos::record::noted;

/// What the clocks of two processes of a run may differ by, ns: those of other hosts are compared.
const CLOCKS_NS: u64 = 100_000_000;

/// The files in the order of their names and parts, so that lines of one moment keep theirs. The name that `--record` was
/// given stands for the files that the processes of its newest run have made of it. A file stands for itself and for
/// the parts in which its run went on.
#[must_use]
pub fn files(named: &[PathBuf]) -> Vec<PathBuf> {
    let files = named.iter().flat_map(|file| of_one_run(file));
    let mut files: Vec<PathBuf> = files.map(|file| file.path).collect();
    files.sort_by_key(|file| (stem_and_part(file), file.clone()));
    files.dedup();
    files
}

/// The files in their order, where they are of one run.
///
/// # Errors
/// In words: they are of several.
pub fn of_a_run(named: &[PathBuf]) -> Result<Vec<PathBuf>, String> {
    let files = files(named);
    let read: Vec<File> = files.iter().map(|file| File::read(file)).collect();
    let mut each = read.iter().map(|file| (file, file.newest_of(&read)));
    match each.find(|(file, newest)| file.is_of(newest) == Some(false)) {
        None => Ok(files),
        Some((other, newest)) => Err(format!(
            "{} and {} are of two runs, which have nothing to do with each other; name files of one, or the name that \
             `--record` was given, which stands for its newest run",
            other.path.display(),
            newest.path.display(),
        )),
    }
}

/// All files that were made of the name of a record, of whatever run.
#[must_use]
pub fn made_of(file: &Path) -> Vec<PathBuf> {
    let name = file.file_name().and_then(|name| name.to_str());
    let Some(stem) = name.and_then(|name| name.strip_suffix("mcap")) else {
        return Vec::new();
    };
    let folder = file
        .parent()
        .filter(|folder| !folder.as_os_str().is_empty());
    let Ok(entries) = folder.unwrap_or(Path::new(".")).read_dir() else {
        return Vec::new();
    };
    let names = entries.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
    let names = names.filter(|name| name.starts_with(stem) && name.ends_with("mcap"));
    names.map(|name| file.with_file_name(name)).collect()
}

fn of_one_run(file: &Path) -> Vec<File> {
    let read = |found: Vec<PathBuf>| found.into_iter().map(|file| File::read(&file));
    if file.exists() {
        // And those in which it goes on.
        let (stem, part) = stem_and_part(file);
        let this = File::read(file);
        let others = read(made_of(Path::new(&format!("{stem}.mcap"))));
        let mut found: Vec<File> = others
            .filter(|other| {
                let (of, number) = stem_and_part(&other.path);
                of == stem && number > part && other.is_of(&this) == Some(true)
            })
            .collect();
        found.push(this);
        return found;
    }
    let found: Vec<File> = read(made_of(file)).collect();
    let of_newest = |file: &&File| file.is_of(file.newest_of(&found)) != Some(false);
    match found.is_empty() {
        true => vec![File::read(file)],
        false => found.iter().filter(of_newest).cloned().collect(),
    }
}

/// A file and what its writer noted; nothing where it does not say.
#[derive(Debug, Clone)]
struct File {
    path: PathBuf,
    noted: BTreeMap<String, String>,
}

impl File {
    fn read(path: &Path) -> Self {
        Self {
            path: path.to_owned(),
            noted: noted(path).unwrap_or_default(),
        }
    }

    fn changed(&self) -> impl Ord + use<> {
        self.path.metadata().and_then(|found| found.modified()).ok()
    }

    /// The newest file of its host, whose clock it has.
    fn newest_of<'a>(&'a self, files: &'a [Self]) -> &'a Self {
        let here = files
            .iter()
            .filter(|other| other.noted.get("host") == self.noted.get("host"));
        here.max_by_key(|file| file.changed()).unwrap_or(self)
    }

    /// Whether both are of one run; `None` where that cannot be told, as of other hosts.
    fn is_of(&self, other: &Self) -> Option<bool> {
        let said = |key: &str| (self.noted.get(key), other.noted.get(key));
        // What was merged is of any number of runs.
        if self.noted.is_empty() || other.noted.is_empty() || said("file") != (None, None) {
            return None;
        }
        let (here, there) = said("origin_ns");
        match (here, there) {
            (Some(here), Some(there)) => {
                let (host, of) = said("host");
                let apart = here.parse::<u64>().ok()?.abs_diff(there.parse().ok()?);
                (host == of).then_some(apart <= CLOCKS_NS)
            }
            // On a virtual clock a run is one process, which says with which part it began.
            (None, None) => {
                let (first, of) = said("first");
                let stem = |file: &Self| stem_and_part(&file.path).0;
                Some(first == of && stem(self) == stem(other))
            }
            _ => Some(false),
        }
    }
}

/// `r.a` and 2 of `r.a.part2.mcap`.
fn stem_and_part(file: &Path) -> (String, u64) {
    let name = file.to_string_lossy().into_owned();
    let name = name.strip_suffix(".mcap").unwrap_or(&name);
    let numbered = name.rsplit_once(".part");
    match numbered.and_then(|(stem, part)| Some((stem, part.parse().ok()?))) {
        Some((stem, part)) => (stem.to_owned(), part),
        None => (name.to_owned(), 1),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_come_in_the_order_of_their_numbers() {
        let given = ["r.b.mcap", "r.a.part10.mcap", "r.a.part2.mcap", "r.a.mcap"];
        let sorted = files(&given.map(PathBuf::from));
        let expected = ["r.a.mcap", "r.a.part2.mcap", "r.a.part10.mcap", "r.b.mcap"];
        assert_eq!(sorted, expected.map(PathBuf::from));
    }

    #[test]
    fn the_name_of_a_run_stands_for_the_files_of_its_processes_unless_it_is_one_itself() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let of = |name: &str| files(&[path(name)]);
        assert_eq!(of("run.mcap"), [path("run.mcap")]);
        for name in [
            "run.cell.mcap",
            "run.boot.mcap",
            "running.cell.mcap",
            "run.txt",
        ] {
            std::fs::write(path(name), "").unwrap();
        }
        assert_eq!(
            of("run.mcap"),
            [path("run.boot.mcap"), path("run.cell.mcap")]
        );
        assert_eq!(of("run.cell.mcap"), [path("run.cell.mcap")]);
        std::fs::write(path("run.mcap"), "").unwrap();
        assert_eq!(of("run.mcap"), [path("run.mcap")]);
    }

    /// A file of a record that says nothing but of which run it is.
    fn record(path: &Path, noted: &[(&str, &str)]) {
        let mut writer = mcap::Writer::new(std::fs::File::create(path).unwrap()).unwrap();
        let pairs = noted.iter();
        let metadata = pairs.map(|(key, value)| ((*key).to_owned(), (*value).to_owned()));
        let name = "ctos.run".to_owned();
        let metadata = metadata.collect();
        let metadata = mcap::records::Metadata { name, metadata };
        writer.write_metadata(&metadata).unwrap();
        writer.finish().unwrap();
    }

    #[test]
    fn a_name_stands_for_the_newest_run_alone_and_files_of_two_runs_are_refused_as_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let real = |name: &str, origin: &str| {
            record(
                &path(name),
                &[("origin_ns", origin), ("host", "h"), ("first", "1")],
            );
        };
        real("run.desk.mcap", "1000000000");
        real("run.shelf.mcap", "1000000000");
        let names = |names: &[&str]| names.iter().map(|name| path(name)).collect::<Vec<_>>();
        assert_eq!(
            of_a_run(&[path("run.mcap")]),
            Ok(names(&["run.desk.mcap", "run.shelf.mcap"]))
        );
        // A second run, one process of which has written two parts; its clock was compared anew.
        real("run.desk.part2.mcap", "9000000000");
        real("run.desk.part3.mcap", "9000400000");
        // A file of another host has a clock of its own.
        record(&path("run.far.mcap"), &[("origin_ns", "5"), ("host", "f")]);
        // The clock of a file system is coarse.
        for name in ["run.desk.part2.mcap", "run.desk.part3.mcap", "run.far.mcap"] {
            let file = std::fs::File::options().write(true).open(path(name));
            let (file, later) = (file.unwrap(), std::time::Duration::from_secs(1));
            let now = file.metadata().unwrap().modified().unwrap();
            file.set_modified(now + later).unwrap();
        }
        let second = names(&["run.desk.part2.mcap", "run.desk.part3.mcap", "run.far.mcap"]);
        assert_eq!(of_a_run(&[path("run.mcap")]), Ok(second));
        let parts = names(&["run.desk.part2.mcap", "run.desk.part3.mcap"]);
        assert_eq!(of_a_run(&[path("run.desk.part2.mcap")]), Ok(parts));
        assert_eq!(
            of_a_run(&[path("run.desk.mcap")]),
            Ok(names(&["run.desk.mcap"]))
        );
        let both = of_a_run(&names(&["run.desk.mcap", "run.desk.part2.mcap"]));
        assert!(both.unwrap_err().contains("are of two runs"));
    }

    #[test]
    fn parts_of_virtual_runs_are_told_apart_by_where_they_begin() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        for (name, first) in [
            ("run.mcap", "1"),
            ("run.part2.mcap", "1"),
            ("run.part3.mcap", "3"),
        ] {
            record(&path(name), &[("app", "tea"), ("first", first)]);
        }
        let first = ["run.mcap", "run.part2.mcap"].map(path);
        assert_eq!(of_a_run(&[path("run.mcap")]), Ok(first.to_vec()));
        let third = path("run.part3.mcap");
        assert_eq!(of_a_run(std::slice::from_ref(&third)), Ok(vec![third]));
    }
}

//! The files of a record, by the names that a person gives.

use std::path::{Path, PathBuf};

/// The files in the order of their names and parts, so that lines of one moment keep theirs. The name that `--record` was
/// given stands for the files that the processes of the run have made of it.
#[must_use]
pub fn files(named: &[PathBuf]) -> Vec<PathBuf> {
    let mut files: Vec<PathBuf> = named.iter().flat_map(|file| of_processes(file)).collect();
    files.sort_by_key(|file| {
        let name = file.to_string_lossy().into_owned();
        let (stem, part) = match name.rsplit_once(".part") {
            Some((stem, rest)) => {
                let number = rest.split('.').next().and_then(|part| part.parse().ok());
                (stem.to_owned(), number.unwrap_or(0_u64))
            }
            None => (name.trim_end_matches(".mcap").to_owned(), 1),
        };
        (stem, part)
    });
    files
}

/// `run.boot.mcap`, `run.cell.mcap` and so on for a `run.mcap` that is not there; the file itself where there are none.
fn of_processes(file: &Path) -> Vec<PathBuf> {
    let itself = || vec![file.to_owned()];
    let name = file.file_name().and_then(|name| name.to_str());
    let Some(stem) = name.and_then(|name| name.strip_suffix("mcap")) else {
        return itself();
    };
    let folder = file
        .parent()
        .filter(|folder| !folder.as_os_str().is_empty());
    let Ok(entries) = folder.unwrap_or(Path::new(".")).read_dir() else {
        return itself();
    };
    let names = entries.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
    let names = names.filter(|name| name.starts_with(stem) && name.ends_with(".mcap"));
    let found: Vec<PathBuf> = names.map(|name| file.with_file_name(name)).collect();
    match found.is_empty() || file.exists() {
        true => itself(),
        false => found,
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
}

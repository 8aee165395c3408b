//! Writing the results of a calibration: a ROS `camera_info` file per camera and the poses of all.

use std::{
    fs::File,
    io::{self, Write as _},
    path::{Path, PathBuf},
};

use ctos::task::HandlerError;
use vss::{
    calibrate::Calibration,
    camera_info::{CameraInfo, CameraPose, poses_to_yaml},
};

/// Writes `NAME.yaml` per camera and `poses.yaml` into `folder`, and returns their paths. Files that
/// were there before are replaced, each in one step, only when all new ones are complete on the disk.
///
/// # Errors
/// The file that could not be written and why; what was there before is then still there.
pub(crate) fn write(
    folder: &Path,
    cameras: &[(String, Calibration)],
) -> Result<Vec<PathBuf>, HandlerError> {
    let mut texts = Vec::new();
    for (name, calibration) in cameras {
        let info = CameraInfo::of(name, calibration).to_yaml()?;
        texts.push((folder.join(format!("{name}.yaml")), info));
    }
    let poses: Vec<CameraPose> = cameras
        .iter()
        .map(|(name, calibration)| CameraPose::of(name, calibration))
        .collect();
    texts.push((folder.join("poses.yaml"), poses_to_yaml(&poses)?));
    let written = replace_all(folder, &texts);
    written.map_err(|(path, error)| {
        HandlerError::new(format!("cannot write `{}`: {error}", path.display()))
    })?;
    Ok(texts.into_iter().map(|(path, _)| path).collect())
}

fn replace_all(folder: &Path, texts: &[(PathBuf, String)]) -> Result<(), (PathBuf, io::Error)> {
    std::fs::create_dir_all(folder).map_err(|error| (folder.to_owned(), error))?;
    let half = |path: &Path| path.with_extension("yaml.part");
    let complete = texts.iter().try_for_each(|(path, text)| {
        let half = half(path);
        complete(&half, text).map_err(|error| (half, error))
    });
    let replaced = complete.and_then(|()| {
        texts.iter().try_for_each(|(path, _)| {
            std::fs::rename(half(path), path).map_err(|error| (path.clone(), error))
        })
    });
    if replaced.is_err() {
        for (path, _) in texts {
            // What was not written, or is in place already, is not there to remove.
            let _ = std::fs::remove_file(half(path));
        }
    }
    replaced
}

fn complete(path: &Path, text: &str) -> io::Result<()> {
    let mut file = File::create(path)?;
    file.write_all(text.as_bytes())?;
    file.sync_all()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn texts(folder: &Path, content: &str) -> Vec<(PathBuf, String)> {
        ["east.yaml", "west.yaml", "poses.yaml"]
            .map(|name| (folder.join(name), format!("{content} {name}")))
            .into()
    }

    fn listing(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> = std::fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn all_files_are_replaced_and_nothing_else_is_left() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path().join("deep/er");
        for content in ["old", "new"] {
            replace_all(&folder, &texts(&folder, content)).unwrap();
        }
        for (path, text) in texts(&folder, "new") {
            assert_eq!(std::fs::read_to_string(path).unwrap(), text);
        }
        assert_eq!(listing(&folder), ["east.yaml", "poses.yaml", "west.yaml"]);
    }

    #[test]
    fn when_one_file_cannot_be_written_all_old_ones_are_kept() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        replace_all(folder, &texts(folder, "old")).unwrap();
        // A folder where the last part file should go; it fails for any user, root included.
        let blocked = folder.join("poses.yaml.part");
        std::fs::create_dir(&blocked).unwrap();
        let (path, _) = replace_all(folder, &texts(folder, "new")).unwrap_err();
        assert_eq!(path, blocked);
        for (path, text) in texts(folder, "old") {
            assert_eq!(std::fs::read_to_string(path).unwrap(), text);
        }
        std::fs::remove_dir(&blocked).unwrap();
        assert_eq!(listing(folder), ["east.yaml", "poses.yaml", "west.yaml"]);
    }
}

//! Where the control sockets of the apps of one user are.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use ctos_link::transport::private_folder;

/// A control socket in the folder.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Socket {
    /// The app's name, as far as a file's name can hold it.
    pub app: String,
    /// The process that booted it.
    pub pid: u32,
    /// The file.
    pub path: PathBuf,
}

/// The folder: `$XDG_RUNTIME_DIR/ctos`, or `ctos-UID` in the folder for temporary files.
#[must_use]
pub fn folder() -> PathBuf {
    match std::env::var_os("XDG_RUNTIME_DIR").map(PathBuf::from) {
        Some(folder) if folder.is_absolute() => folder.join("ctos"),
        _ => std::env::temp_dir().join(format!("ctos-{}", uid())),
    }
}

/// [`folder`], made if it is missing.
///
/// # Errors
/// When it cannot be made, or does not belong to this user alone.
pub fn prepared_folder() -> io::Result<PathBuf> {
    let folder = folder();
    private_folder(&folder, uid())?;
    Ok(folder)
}

pub(crate) fn uid() -> u32 {
    rustix::process::getuid().as_raw()
}

/// The socket of app `name`, booted by process `pid`, in `folder`.
pub(crate) fn socket(folder: &Path, name: &str, pid: u32) -> Socket {
    let plain = |letter: char| {
        if letter.is_ascii_alphanumeric() || "_.".contains(letter) {
            letter
        } else {
            '_'
        }
    };
    let app: String = name.chars().take(64).map(plain).collect();
    let path = folder.join(format!("{app}-{pid}.sock"));
    Socket { app, pid, path }
}

/// The sockets in `folder`, by name. Those whose process has ended are removed.
pub fn sockets(folder: &Path) -> Vec<Socket> {
    // Without a folder there is no app.
    let Ok(entries) = fs::read_dir(folder) else {
        return Vec::new();
    };
    let mut sockets: Vec<Socket> = entries
        .filter_map(|entry| parse(&entry.ok()?.path()))
        .filter(|socket| {
            let alive = is_alive(socket.pid);
            if !alive {
                // Another client may have removed it just now.
                let _ = fs::remove_file(&socket.path);
            }
            alive
        })
        .collect();
    sockets.sort();
    sockets
}

fn parse(path: &Path) -> Option<Socket> {
    let stem = path.file_name()?.to_str()?.strip_suffix(".sock")?;
    let (app, number) = stem.rsplit_once('-')?;
    let pid: u32 = number.parse().ok()?;
    // Another number than that of a process, as we write it, makes it a file of somebody else's.
    let is_ours = pid > 0 && i32::try_from(pid).is_ok() && pid.to_string() == number;
    is_ours.then(|| Socket {
        app: app.to_owned(),
        pid,
        path: path.to_owned(),
    })
}

fn is_alive(pid: u32) -> bool {
    let pid = i32::try_from(pid)
        .ok()
        .and_then(rustix::process::Pid::from_raw);
    pid.is_some_and(|pid| {
        !matches!(
            rustix::process::test_kill_process(pid),
            Err(rustix::io::Errno::SRCH)
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use ctos_link::transport::socket_name;

    #[test]
    fn a_socket_is_found_by_what_its_name_says_and_stale_ones_go() {
        let folder = tempfile::tempdir().unwrap();
        let own = std::process::id();
        let mine = socket(folder.path(), "my app/../x", own);
        assert_eq!(mine.app, "my_app_.._x");
        fs::write(&mine.path, "").unwrap();
        // No process has the largest number.
        let stale = socket(folder.path(), "gone", i32::MAX as u32);
        fs::write(&stale.path, "").unwrap();
        fs::write(folder.path().join("note.txt"), "").unwrap();
        fs::write(folder.path().join("odd-x.sock"), "").unwrap();
        assert_eq!(sockets(folder.path()), [mine]);
        assert!(!stale.path.exists());
        assert!(folder.path().join("note.txt").exists());
    }

    #[test]
    fn no_socket_of_a_chassis_is_taken_for_that_of_an_app_that_has_ended() {
        let folder = tempfile::tempdir().unwrap();
        // Noise of digits alone: one is a number that no process can have, one that none has.
        let names = [
            [0, 0x40, 0x94, 0x32, 0x70, 0x46],
            [0, 0x21, 0x47, 0x48, 0x36, 0x47],
        ]
        .map(|noise| socket_name("boot", noise));
        let others = [
            "boot-004094327046.sock",
            "boot-4094327046.sock",
            "boot-002147483647.sock",
        ];
        let files = names.iter().map(String::as_str).chain(others);
        let paths: Vec<_> = files.map(|file| folder.path().join(file)).collect();
        for path in &paths {
            fs::write(path, "").unwrap();
        }
        assert_eq!(sockets(folder.path()), []);
        assert!(paths.iter().all(|path| path.exists()));
    }
}

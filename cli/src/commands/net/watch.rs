//! `ctos net watch`: checks a net at every save.

use std::{
    ffi::OsStr, mem::MaybeUninit, os::unix::ffi::OsStrExt as _, path::PathBuf, process::Command,
};

use clap::Args;
use rustix::fs::inotify;

use cli_common::{exit, show};

/// Check a net at every save, until Ctrl-C
///
/// With `--replace` a net that is sound is put in the place of a running one, as by `ctos net replace`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  ctos net watch queue.net
  ctos net watch queue.net --app app.toml --replace queue")]
pub struct WatchArgs {
    /// The net
    pub file: PathBuf,
    /// Check it together with the nets of this app
    #[arg(long, value_name = "APP")]
    pub app: Option<PathBuf>,
    /// The running net that each sound one replaces
    #[arg(long, value_name = "NET")]
    pub replace: Option<String>,
}

/// Runs the command.
#[must_use]
pub fn run(args: &WatchArgs) -> u8 {
    match watch(args) {
        Ok(()) => exit::OK,
        Err(error) => {
            show::say(&format!(
                "error: `{}` cannot be watched: {error}",
                args.file.display()
            ));
            exit::FAILED
        }
    }
}

fn watch(args: &WatchArgs) -> std::io::Result<()> {
    let name = args.file.file_name().unwrap_or_default();
    let folder = match args.file.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => std::path::Path::new("."),
    };
    // The folder and not the file: editors put a new file in the place of the old one.
    let events = inotify::init(inotify::CreateFlags::CLOEXEC)?;
    let written = inotify::WatchFlags::CLOSE_WRITE | inotify::WatchFlags::MOVED_TO;
    inotify::add_watch(&events, folder, written)?;
    look(args)?;
    let mut buffer = [MaybeUninit::uninit(); 4096];
    let mut reader = inotify::Reader::new(&events, &mut buffer);
    loop {
        let event = reader.next()?;
        let saved = event
            .file_name()
            .is_some_and(|saved| OsStr::from_bytes(saved.to_bytes()) == name);
        if saved {
            look(args)?;
        }
    }
}

/// Checks the net as it is now, and replaces the running one by it.
fn look(args: &WatchArgs) -> std::io::Result<()> {
    let file = args.file.display();
    let mut check: Vec<&OsStr> = vec!["check".as_ref(), args.file.as_os_str()];
    if let Some(app) = &args.app {
        check.extend([OsStr::new("--app"), app.as_os_str()]);
    }
    if !ends_well(&check)? {
        show::say(&format!("{file}: not sound"));
        return Ok(());
    }
    show::say(&format!("{file}: sound"));
    if let Some(net) = &args.replace
        && !ends_well(&["replace".as_ref(), net.as_ref(), args.file.as_os_str()])?
    {
        show::say(&format!("{file}: `{net}` runs on as it was"));
    }
    Ok(())
}

/// Runs a command of `ctos net` as a process of its own, so that Ctrl-C ends both.
fn ends_well(arguments: &[&OsStr]) -> std::io::Result<bool> {
    let mut command = Command::new(std::env::current_exe()?);
    let status = command.arg("net").args(arguments).status()?;
    Ok(status.success())
}

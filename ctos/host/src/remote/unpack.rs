//! The files of an app on the agent's host: whether this program can run the app, and the folder in which
//! they are laid down.

use std::{
    collections::BTreeMap,
    fs::Permissions,
    os::unix::fs::PermissionsExt,
    path::{Path, PathBuf},
};

use tempfile::TempDir;
use tokio::process::Command;

use super::{
    run::Common,
    wire::{AppFiles, HandlerView},
};
use ctos_config::Selection;
use ctos_core::registry::Registry;

/// The app's files, laid down.
pub(super) struct Unpacked {
    /// Of this user alone.
    folder: TempDir,
    selection: Selection,
    variables: BTreeMap<String, Option<String>>,
    options: Vec<String>,
    record: Option<PathBuf>,
}

impl Unpacked {
    /// Lays the files down, in a folder that only this user may enter.
    ///
    /// # Errors
    /// Why the app cannot run here; nothing is left then.
    pub(super) fn new(common: &Common, files: AppFiles) -> Result<Self, String> {
        lacking(&common.registry, &files.handlers)?;
        let folder = tempfile::Builder::new()
            .prefix("ctos-run-")
            .permissions(Permissions::from_mode(0o700))
            .tempdir_in(&common.folder)
            .map_err(|error| format!("the agent cannot make a folder for the app: {error}"))?;
        let selection = files.bundle.unpack(folder.path());
        let selection = selection.map_err(|error| error.to_string())?;
        let record = files.recorded.then(|| {
            let name = folder.path().file_name().unwrap_or_default().to_owned();
            common.folder.join(name).with_extension("mcap")
        });
        Ok(Self {
            folder,
            selection,
            variables: files.bundle.variables,
            options: files.options,
            record,
        })
    }

    /// Removes the folder with all that is in it.
    pub(super) fn remove(self) {
        let path = self.folder.path().to_owned();
        if let Err(error) = self.folder.close() {
            tracing::warn!(folder = %path.display(), error = %error, "the folder of a run stays");
        }
    }

    /// How a chassis of the app is started, as far as it is the same for all.
    pub(super) fn command(&self, common: &Common) -> Command {
        let mut command = Command::new(&common.program);
        command.arg("chassis").arg(&self.selection.file);
        for profile in &self.selection.profiles {
            command.args(["--profile", profile]);
        }
        for set in self.selection.sets.iter().chain(&common.key_arguments) {
            command.args(["--set", set]);
        }
        if let Some(record) = &self.record {
            command.args(["--set", &set_path("record.file", record)]);
        }
        for (name, value) in &self.variables {
            match value {
                Some(value) => command.env(name, value),
                None => command.env_remove(name),
            };
        }
        command.args(&self.options);
        command
    }
}

/// What is said behind `--set`, so that `key` is `path`.
pub(super) fn set_path(key: &str, path: &Path) -> String {
    // A JSON string is a TOML string.
    format!("{key}={}", serde_json::Value::from(path.to_string_lossy()))
}

/// What of `wanted` this program lacks.
///
/// # Errors
/// The first thing.
fn lacking(registry: &Registry, wanted: &[HandlerView]) -> Result<(), String> {
    for handler in wanted {
        let name = &handler.name;
        let Some(kind) = registry.kind(name) else {
            return Err(format!(
                "its program has no event handler `{name}`; start there the agent of the program that boots: `PROGRAM agent`"
            ));
        };
        let has = |(code, command): &(u16, String)| {
            let mut known = kind.commands().iter();
            known.any(|known| known.code == *code && known.name == command)
        };
        let differs = handler.commands.iter().find(|command| !has(command));
        if let Some((code, command)) = differs {
            return Err(format!(
                "its program has another version of the event handler `{name}`, without the command `{command}` ({code:#06x}); install the same program on both"
            ));
        }
        if kind.commands().len() != handler.commands.len() {
            return Err(format!(
                "its program has another version of the event handler `{name}`, with further commands; install the same program on both"
            ));
        }
    }
    Ok(())
}

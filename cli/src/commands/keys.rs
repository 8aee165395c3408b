//! `ctos keys`: makes and lists the keys for connections beyond this host.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use ctos::security::{KeyError, Listed, Role, list_keys, make_key};

use cli_common::{exit, show};

/// Make and list keys for connections beyond this host
///
/// A chassis that listens where others can reach it, an agent or a tool on another host proves who it is by a key. All
/// keys of an installation are signed by one authority, which is made with the first key of a folder.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  ctos keys new keys/cell --role boot
  ctos keys new keys/panel
  ctos keys list keys")]
pub struct KeysArgs {
    /// What to do
    #[command(subcommand)]
    pub command: KeysCommand,
}

/// What can be done with keys.
#[derive(Debug, Subcommand)]
pub enum KeysCommand {
    /// Make a key, and the folder's authority if it has none
    New {
        /// Folder and name of the key
        #[arg(value_name = "FOLDER/NAME")]
        path: PathBuf,
        /// What its holder may do: watch, call, control or boot, each including those before it
        #[arg(long, default_value_t = Role::Watch)]
        role: Role,
    },
    /// List the keys of a folder with their roles
    List {
        /// The folder
        #[arg(default_value = "keys")]
        folder: PathBuf,
        /// Print a JSON list
        #[arg(long)]
        json: bool,
    },
}

/// Runs the command.
#[must_use]
pub fn run(args: &KeysArgs) -> u8 {
    let done = match &args.command {
        KeysCommand::New { path, role } => new(path.clone(), *role),
        KeysCommand::List { folder, json } => list_keys(folder).map(|keys| list(&keys, *json)),
    };
    match done {
        Ok(()) => exit::OK,
        Err(error) => {
            show::say(&format!("error: {error}"));
            exit::FAILED
        }
    }
}

fn new(path: PathBuf, role: Role) -> Result<(), KeyError> {
    let key = make_key(&path, role)?;
    let key = key.display();
    show::say(&format!(
        "made {key}.pem and {key}.key with the role `{role}`; keep the second one, and ca.key, to yourself"
    ));
    Ok(())
}

fn list(keys: &[Listed], json: bool) {
    let text = if json {
        let rows = keys.iter().map(|key| {
            serde_json::json!({
                "name": key.identity.name,
                "role": key.identity.role.to_string(),
                "path": key.path,
                "private": key.private,
            })
        });
        serde_json::Value::from_iter(rows).to_string()
    } else {
        let rows = keys.iter().map(|key| {
            let private = if key.private {
                ""
            } else {
                "  (certificate only)"
            };
            format!("{:<8} {}{private}", key.identity.role, key.path.display())
        });
        rows.collect::<Vec<_>>().join("\n")
    };
    // A reader that went away has what it wanted.
    let _ = show::data(&text);
}

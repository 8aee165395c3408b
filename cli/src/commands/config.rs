//! `ctos config`: what counts in the end, every key with its default, and the schema.

mod shown;
#[cfg(test)]
mod tests;

use clap::{Args, Subcommand};
use ctos::config::{DEFAULTS, Origin};

use cli_common::{exit, show};

use crate::{commands::args::AppArgs, program};
use shown::Shown;

/// Show what a configuration comes to, every key there is, or the schema for editors
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  ctos config show configs/calibrate.toml --set seed=7
  ctos config show configs/calibrate.toml --json | grep '\"origin\":\"default\"'
  ctos config defaults > app.toml
  ctos config schema > ctos.schema.json")]
pub struct ConfigArgs {
    /// What to show
    #[command(subcommand)]
    pub what: What,
}

/// What `ctos config` shows.
#[derive(Debug, Subcommand)]
pub enum What {
    /// Show the merged configuration of an app, each value with where it comes from
    ///
    /// The output is a configuration that makes the same app by itself. Values of environment variables that the
    /// files name are part of it.
    Show(ShowArgs),
    /// Print every key with its default and what it means
    Defaults,
    /// Print the JSON schema (draft-07) of a configuration, for editors
    Schema,
}

/// Show the merged configuration of an app, each value with where it comes from
#[derive(Debug, Args)]
pub struct ShowArgs {
    /// Which app
    #[command(flatten)]
    pub app: AppArgs,
    /// Print one JSON object per value
    #[arg(long)]
    pub json: bool,
}

/// Runs the command.
#[must_use]
pub fn run(args: &ConfigArgs) -> u8 {
    let text = match &args.what {
        What::Show(args) => match merged(args) {
            Ok(text) => text,
            Err(code) => return code,
        },
        What::Defaults => DEFAULTS.to_owned(),
        What::Schema => format!("{:#}", program::schema()),
    };
    // A closed pipe means that the reader has what it wanted.
    let _ = show::data(text.trim_end_matches('\n'));
    exit::OK
}

fn merged(args: &ShowArgs) -> Result<String, u8> {
    let app = program::app(&args.app.selection()).map_err(|findings| {
        show::findings(findings);
        exit::CONFIG
    })?;
    if !args.json {
        return Ok(shown::toml(&app));
    }
    let values = shown::values(&app);
    let lines = values.iter().map(value_json).collect::<Vec<_>>();
    Ok(lines.join("\n"))
}

/// A value as one line of JSON.
fn value_json(shown: &Shown<'_>) -> String {
    let mut object = serde_json::json!({
        "key": shown.path,
        "value": serde_json::Value::from(shown.value),
    });
    let (origin, profile, place) = match &shown.origin {
        Origin::Default => ("default", None, None),
        Origin::File(place) => ("file", None, Some(place)),
        Origin::Profile { name, place } => ("profile", Some(name), Some(place)),
        Origin::Set(place) => ("set", None, Some(place)),
    };
    object["origin"] = origin.into();
    if let Some(profile) = profile {
        object["profile"] = profile.as_str().into();
    }
    if let Some(place) = place {
        object["place"] = show::place_json(place);
    }
    object.to_string()
}

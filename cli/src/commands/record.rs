//! `--record FILE`: what it means for the configuration.

use std::path::Path;

/// The `--set` text that records to `file`, which is relative to where the command was given.
///
/// # Errors
/// When the present folder is gone.
pub(crate) fn setting(file: &Path) -> std::io::Result<String> {
    let file = std::path::absolute(file)?;
    let text = serde_json::Value::from(file.to_string_lossy());
    // A JSON string is a TOML string.
    Ok(format!("record.file={text}"))
}

//! `ctos net convert`.

use std::{
    fs::Permissions,
    io::{self, Write as _},
    os::unix::fs::PermissionsExt as _,
    path::{Path, PathBuf},
};

use clap::{Args, ValueEnum};
use ctos::diagnostic::Findings;
use pnt::{
    format::{self, Format, NetFile},
    pnml, tina,
};

use cli_common::{exit, show};

/// A form in which a net is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Form {
    /// Net text
    Text,
    /// PNML (ISO/IEC 15909-2)
    Pnml,
    /// The text of TINA
    Tina,
}

/// Write a net in another form
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  ctos net convert model.pnml model.net
  ctos net convert configs/nets/dispatcher.net dispatcher.pnml
  ctos net convert model.pnml - --to tina")]
pub struct ConvertArgs {
    /// The net, in any form
    #[arg(value_name = "IN")]
    pub input: PathBuf,
    /// The file to write, or `-` for standard output
    #[arg(value_name = "OUT")]
    pub output: PathBuf,
    /// The form, if OUT ends neither in `.net` (net text) nor in `.pnml` or `.xml` (PNML)
    #[arg(long, value_enum, value_name = "FORM")]
    pub to: Option<Form>,
    /// Print a JSON object about what was written
    #[arg(long, conflicts_with = "quiet")]
    pub json: bool,
    /// Show errors only
    #[arg(short, long)]
    pub quiet: bool,
}

impl ConvertArgs {
    fn form(&self) -> Option<Form> {
        let by_name = || match self.output.extension()?.to_str()? {
            "net" => Some(Form::Text),
            "pnml" | "xml" => Some(Form::Pnml),
            _ => None,
        };
        self.to.or_else(by_name)
    }
}

/// Runs the command.
#[must_use]
pub fn run(args: &ConvertArgs) -> u8 {
    let Some(form) = args.form() else {
        show::say(
            "error: the name of OUT does not say which form to write; add `--to text`, `--to pnml` or `--to tina`",
        );
        return exit::USAGE;
    };
    let (file, text) = match converted(&args.input, form) {
        Ok(converted) => converted,
        Err(findings) => {
            show::findings(findings);
            return exit::CONFIG;
        }
    };
    if !args.quiet {
        let mut warnings = file.warnings.clone();
        if form == Form::Pnml {
            warnings.extend(pnml::only_here(&file.draft));
        }
        show::findings(warnings);
        if let Some(lost) = lost(&file, form) {
            show::say(&format!("note: {lost}"));
        }
    }
    if let Err(error) = put(&args.output, &text) {
        // A reader that went away has what it wanted.
        if error.kind() == io::ErrorKind::BrokenPipe {
            return exit::OK;
        }
        show::say(&format!(
            "error: `{}` cannot be written: {error}",
            args.output.display()
        ));
        return exit::FAILED;
    }
    if args.json {
        let object = serde_json::json!({
            "net": file.draft.name.text,
            "read_as": file.format.to_string(),
            "written_to": args.output.display().to_string(),
            "places": file.draft.places.len(),
            "transitions": file.draft.transitions.len(),
        });
        let _ = show::data(&object.to_string());
    }
    exit::OK
}

/// The file and its net in another form.
fn converted(input: &Path, form: Form) -> Result<(NetFile, String), Findings> {
    let file = format::read(input)?;
    // What is written must be a net by itself.
    file.compile()?;
    let text = match form {
        Form::Text => file.draft.to_string(),
        Form::Pnml => pnml::write(&file)?,
        Form::Tina => tina::write(&file.draft)?,
    };
    Ok((file, text))
}

/// What the file has and the form has no words for.
fn lost(file: &NetFile, form: Form) -> Option<String> {
    if form == Form::Pnml || file.format != Format::Pnml {
        return None;
    }
    let drawn = file.positions.places.len() + file.positions.transitions.len();
    let elements = file
        .kept
        .places
        .values()
        .chain(file.kept.transitions.values());
    let own = elements.chain([&file.kept.net]).map(|kept| kept.own.len());
    let sections = own.sum::<usize>() + file.kept.page.len();
    (drawn + sections > 0).then(|| {
        format!("positions ({drawn}) and sections of other tools and graphics ({sections}) are kept by PNML only")
    })
}

/// Writes a whole file or nothing: what was there before stays until the new one is complete.
fn put(output: &Path, text: &str) -> io::Result<()> {
    if output == Path::new("-") {
        let mut stdout = io::stdout().lock();
        stdout.write_all(text.as_bytes())?;
        return stdout.flush();
    }
    let folder = output.parent().filter(|folder| *folder != Path::new(""));
    let mut whole = tempfile::Builder::new()
        // As any file: what the umask leaves of this.
        .permissions(Permissions::from_mode(0o666))
        .tempfile_in(folder.unwrap_or(Path::new(".")))?;
    whole.write_all(text.as_bytes())?;
    whole.persist(output)?;
    Ok(())
}

//! `ctos net convert`.

use std::{
    fs::Permissions,
    io::{self, Write as _},
    os::unix::fs::PermissionsExt as _,
    path::{Path, PathBuf},
};

use clap::Args;
use ctos::diagnostic::Findings;
use pnt::{
    format::{self, Format, NetFile},
    pnml, tina,
};

use cli_common::{exit, form::Form, show};

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
    /// The form, if the name of OUT does not say it: .net is net text; .pnml and .xml are PNML; .svg, .dot and .mmd
    /// are drawings
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
    /// Writes a net to standard output in a form.
    #[must_use]
    pub fn to_output(input: &Path, form: Form) -> Self {
        Self {
            input: input.to_owned(),
            output: PathBuf::from("-"),
            to: Some(form),
            json: false,
            quiet: false,
        }
    }
}

/// Runs the command; `draw` draws the net of a file.
#[must_use]
pub fn run(args: &ConvertArgs, draw: impl Fn(&Path, Form) -> Result<String, Findings>) -> u8 {
    let Some(form) = args.to.or_else(|| Form::of_file(&args.output)) else {
        show::say(
            "error: the name of OUT does not say which form to write; add `--to FORM`, for example `--to text` or `--to pnml`",
        );
        return exit::USAGE;
    };
    let (file, text) = match converted(&args.input, form, draw) {
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
fn converted(
    input: &Path,
    form: Form,
    draw: impl Fn(&Path, Form) -> Result<String, Findings>,
) -> Result<(NetFile, String), Findings> {
    let file = format::read(input)?;
    // What is written must be a net by itself.
    file.compile()?;
    let text = match form {
        Form::Text => file.draft.to_string(),
        Form::Pnml => pnml::write(&file)?,
        Form::Tina => tina::write(&file.draft)?,
        Form::Svg | Form::Dot | Form::Mermaid => draw(input, form)? + "\n",
    };
    Ok((file, text))
}

/// What the file has and the form has no words for.
fn lost(file: &NetFile, form: Form) -> Option<String> {
    if form == Form::Pnml || form.is_drawing() || file.format != Format::Pnml {
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

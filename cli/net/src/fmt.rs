//! `ctos net fmt`.

use std::{
    fs,
    io::{self, Read as _, Write as _},
    path::{Path, PathBuf},
};

use clap::Args;
use ctos::diagnostic::{Finding, Findings, Source};
use pnt::{
    format::{self, Format},
    text,
};

use cli_common::{exit, show};

/// Lay out net text in the one usual way
///
/// Comments and the order of lines stay; a file that cannot be read stays as it is.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  ctos net fmt configs/nets/*.net
  ctos net fmt --check configs/nets/*.net
  ctos net fmt - < draft.net")]
pub struct FmtArgs {
    /// The nets, or `-` for standard input to standard output
    #[arg(value_name = "FILE", required = true)]
    pub files: Vec<PathBuf>,
    /// Change nothing; name the files that would be changed, and end with exit code 1 if there are any
    #[arg(long)]
    pub check: bool,
}

/// Runs the command.
#[must_use]
pub fn run(args: &FmtArgs) -> u8 {
    let mut findings = Findings::new();
    let mut code = exit::OK;
    for file in &args.files {
        match one(file, args.check) {
            Ok(true) if args.check => {
                code = code.max(exit::FAILED);
                if show::data(&file.display().to_string()).is_err() {
                    return exit::OK;
                }
            }
            Ok(_) => {}
            Err(Failed::Findings(found)) => {
                code = code.max(exit::CONFIG);
                findings.extend(found);
            }
            Err(Failed::Write(error)) => {
                code = code.max(exit::FAILED);
                show::say(&format!("error: `{}`: {error}", file.display()));
            }
        }
    }
    if !findings.is_empty() {
        show::findings(findings);
    }
    code
}

enum Failed {
    Findings(Findings),
    Write(io::Error),
}

/// Lays out one file; whether it was otherwise before.
fn one(file: &Path, check: bool) -> Result<bool, Failed> {
    let standard = file == Path::new("-");
    let source = if standard {
        let mut text = String::new();
        io::stdin()
            .read_to_string(&mut text)
            .map_err(Failed::Write)?;
        Source::new("standard input", text)
    } else {
        Source::read(file).map_err(|finding| Failed::Findings(finding.into()))?
    };
    let form = format::sniff(source.text());
    if form != Format::Text {
        let text = format!(
            "`{}` is {form}, and only net text is laid out",
            source.name()
        );
        let finding = Finding::error("pnt::text::symbol", text).at(source.at(0..0));
        return Err(Failed::Findings(
            finding
                .help("`ctos net convert` makes net text of it")
                .into(),
        ));
    }
    let folder = file.parent().unwrap_or(Path::new("")).to_owned();
    let text = text::formatted(&source).map_err(|found| {
        // A file that cannot be laid out has all of its mistakes shown, as a check does.
        let mut include = |other: &str| Source::read(&folder.join(other));
        Failed::Findings(
            format::read_with(&source, &mut include)
                .err()
                .unwrap_or(found),
        )
    })?;
    let other = text != source.text();
    if standard && !check {
        let written = io::stdout().write_all(text.as_bytes());
        // A reader that went away has what it wanted.
        written.or_else(|error| match error.kind() {
            io::ErrorKind::BrokenPipe => Ok(()),
            _ => Err(Failed::Write(error)),
        })?;
    } else if other && !check {
        rewrite(file, &text).map_err(Failed::Write)?;
    }
    Ok(other)
}

/// Writes the whole file or leaves it as it is, with the permissions it has.
fn rewrite(file: &Path, text: &str) -> io::Result<()> {
    // What a link leads to is rewritten, not the link.
    let file = fs::canonicalize(file)?;
    let folder = file.parent().unwrap_or(Path::new("."));
    let mut whole = tempfile::NamedTempFile::new_in(folder)?;
    whole.write_all(text.as_bytes())?;
    whole
        .as_file()
        .set_permissions(fs::metadata(&file)?.permissions())?;
    whole.persist(&file)?;
    Ok(())
}

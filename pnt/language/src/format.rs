//! Nets in files, whatever their form: net text, PNML, TINA's `.net`. The form is seen from the
//! content, never from the file's name. Nothing is half read: a file gives a whole net or findings.

pub(crate) mod file;

use std::{fs, io::Read as _, path::Path};

use ctos::diagnostic::{Finding, Findings, Source};

use crate::{compile, net::Net, pnml, text, tina};
pub use file::{Format, NetFile, Positions};

/// The longest file that is read, bytes.
const LONGEST: u64 = 256 << 20;

/// The longest PNML file, bytes. The largest public models of robots and factories have a tenth of it, and reading
/// one takes some fifteen times as much memory.
const LONGEST_PNML: usize = 16 << 20;

/// The longest line of net text or TINA text, bytes; people and programs write shorter ones.
const LONGEST_LINE: usize = 1 << 20;

/// The net of a file of any form, ready to be analysed, and what should be known about it.
///
/// # Errors
/// All findings about the file and the net.
pub fn load(path: &Path) -> Result<(Net, Findings), Findings> {
    let file = read(path)?;
    let net = file.compile()?;
    Ok((net, file.warnings))
}

/// The net of a file as far as it can be read, and all findings about it. A net with errors serves only to see how
/// it fits to others.
#[must_use]
pub fn load_all(path: &Path) -> (Option<Net>, Findings) {
    let source = match source(path) {
        Ok(source) => source,
        Err(found) => return (None, found),
    };
    let folder = path.parent().unwrap_or(Path::new("")).to_owned();
    let mut include = |file: &str| Source::read(&folder.join(file));
    let found = match read_with(&source, &mut include) {
        Ok(file) => match file.compile() {
            Ok(net) => return (Some(net), file.warnings),
            Err(found) => found,
        },
        Err(found) => found,
    };
    let text = sniff(source.text()) == Format::Text && endless_line(&source).is_none();
    let net = text.then(|| compile::as_far_as_known(&compile::read(&source, &mut include).draft));
    (net.filter(|net| !net.name().is_empty()), found)
}

/// Reads a file.
///
/// # Errors
/// All findings about the file and what it holds.
pub fn read(path: &Path) -> Result<NetFile, Findings> {
    let folder = path.parent().unwrap_or(Path::new("")).to_owned();
    read_with(&source(path)?, &mut |file| Source::read(&folder.join(file)))
}

/// The text of a file.
fn source(path: &Path) -> Result<Source, Findings> {
    let name = path.display().to_string();
    let unreadable = |error: &std::io::Error| {
        Finding::error(
            "ctos::file::unreadable",
            format!("`{name}` cannot be read: {error}"),
        )
        .help("check the path and the permissions")
    };
    let mut bytes = Vec::new();
    let file = fs::File::open(path).map_err(|error| unreadable(&error))?;
    file.take(LONGEST + 1)
        .read_to_end(&mut bytes)
        .map_err(|error| unreadable(&error))?;
    too_long(&name, &bytes)?;
    decode(&name, &bytes)
}

/// Reads what a file called `name` holds; it can include no others.
///
/// # Errors
/// All findings about it.
pub fn read_bytes(name: &str, bytes: &[u8]) -> Result<NetFile, Findings> {
    too_long(name, bytes)?;
    read_source(&decode(name, bytes)?)
}

fn too_long(name: &str, bytes: &[u8]) -> Result<(), Finding> {
    if bytes.len() as u64 <= LONGEST {
        return Ok(());
    }
    let limit = LONGEST >> 20;
    let text = format!("`{name}` is longer than {limit} MiB, which no net is");
    Err(Finding::error("pnt::file::size", text).help("is it the right file?"))
}

/// Reads a text that is decoded already and can include no others.
///
/// # Errors
/// All findings about it.
pub fn read_source(source: &Source) -> Result<NetFile, Findings> {
    read_with(source, &mut text::no_include)
}

/// Reads a text that is decoded already; `include` gives the texts of the files that it includes.
///
/// # Errors
/// All findings about it.
pub fn read_with(source: &Source, include: text::Include<'_>) -> Result<NetFile, Findings> {
    let format = sniff(source.text());
    if format == Format::Pnml {
        let length = source.text().len();
        if length > LONGEST_PNML {
            let (limit, size) = (LONGEST_PNML >> 20, length.div_ceil(1 << 20));
            let text = format!(
                "`{}` has {size} MiB of PNML, and at most {limit} MiB are read",
                source.name()
            );
            let help = "is it the right file? A net of this size can be written as net text or in the form of TINA";
            let finding = Finding::error("pnt::file::size", text).at(source.at(0..0));
            return Err(finding.help(help).into());
        }
        return pnml::read(source);
    }
    if let Some(finding) = endless_line(source) {
        return Err(finding.into());
    }
    let draft = match format {
        Format::Tina => tina::read(source)?,
        _ => {
            let read = compile::read(source, include);
            if read.findings.has_errors() {
                return Err(read.findings);
            }
            read.draft
        }
    };
    Ok(NetFile {
        format,
        draft,
        positions: Positions::default(),
        kept: pnml::Kept::default(),
        warnings: Findings::new(),
    })
}

/// The form of a text: XML begins with `<`; else the first line with a keyword decides.
#[must_use]
pub fn sniff(text: &str) -> Format {
    if text.trim_start().starts_with('<') {
        return Format::Pnml;
    }
    for line in text.lines() {
        let word = line.split_whitespace().next().unwrap_or_default();
        if tina::KEYWORDS.contains(&word) {
            return Format::Tina;
        }
        // `net` begins a line in both.
        if word != "net" && text::is_keyword(word) {
            return Format::Text;
        }
    }
    Format::Text
}

fn endless_line(source: &Source) -> Option<Finding> {
    let mut start = 0;
    for line in source.text().split_inclusive('\n') {
        if line.len() > LONGEST_LINE {
            let text = format!(
                "this line is {} bytes long; no line of a net is",
                line.len()
            );
            return Some(
                Finding::error("pnt::file::size", text)
                    .at(source.at(start..start))
                    .help("is it the right file?"),
            );
        }
        start += line.len();
    }
    None
}

/// The text of a file: UTF-8, UTF-16 with or without its mark, or what an XML declaration says.
fn decode(name: &str, bytes: &[u8]) -> Result<Source, Findings> {
    let encoding = encoding(name, bytes)?;
    // Latin-1 itself, not the code page that the web takes it for.
    let text = if encoding.latin1 {
        encoding_rs::mem::decode_latin1(bytes)
    } else {
        let (text, _) = encoding.of.decode_with_bom_removal(bytes);
        text
    };
    let text = text.strip_prefix('\u{feff}').unwrap_or(&text).to_owned();
    let source = Source::new(name, text);
    let broken = if encoding.of == encoding_rs::UTF_8 && !encoding.latin1 {
        std::str::from_utf8(bytes).is_err()
    } else {
        source.text().contains('\u{fffd}')
    };
    match source.text().find('\u{fffd}').filter(|_| broken) {
        None => Ok(source),
        Some(at) => {
            let text = format!("`{name}` is not {} text here", encoding.of.name());
            Err(Finding::error("pnt::file::encoding", text)
                .at(source.at(at..at))
                .help("write it as UTF-8, or say in the XML declaration what it is")
                .into())
        }
    }
}

struct Encoded {
    of: &'static encoding_rs::Encoding,
    latin1: bool,
}

fn encoding(name: &str, bytes: &[u8]) -> Result<Encoded, Finding> {
    let plain = |of| Encoded { of, latin1: false };
    if let Some((marked, _)) = encoding_rs::Encoding::for_bom(bytes) {
        return Ok(plain(marked));
    }
    match bytes {
        [b'<', 0, ..] => return Ok(plain(encoding_rs::UTF_16LE)),
        [0, b'<', ..] => return Ok(plain(encoding_rs::UTF_16BE)),
        _ => {}
    }
    let Some(label) = declared(bytes) else {
        return Ok(plain(encoding_rs::UTF_8));
    };
    if ["iso-8859-1", "latin1", "latin-1"].contains(&label.to_ascii_lowercase().as_str()) {
        return Ok(Encoded {
            of: encoding_rs::WINDOWS_1252,
            latin1: true,
        });
    }
    match encoding_rs::Encoding::for_label(label.as_bytes()) {
        // A declaration that can be read as bytes is not in UTF-16, whatever it says.
        Some(of) if of == encoding_rs::UTF_16LE || of == encoding_rs::UTF_16BE => {
            Ok(plain(encoding_rs::UTF_8))
        }
        Some(of) => Ok(plain(of)),
        None => {
            let text = format!("`{name}` says that it is in `{label}`, which is no known encoding");
            Err(Finding::error("pnt::file::encoding", text).help("write it as UTF-8"))
        }
    }
}

/// The encoding that an XML declaration names.
fn declared(bytes: &[u8]) -> Option<String> {
    let head = bytes.get(..bytes.len().min(256))?;
    let head = String::from_utf8_lossy(head);
    let declaration = head.strip_prefix("<?xml")?.split_once("?>")?.0;
    let (_, value) = declaration.split_once("encoding")?;
    let value = value.trim_start().strip_prefix('=')?.trim_start();
    let quote = value.chars().next().filter(|c| ['"', '\''].contains(c))?;
    let (label, _) = value.strip_prefix(quote)?.split_once(quote)?;
    Some(label.to_owned())
}

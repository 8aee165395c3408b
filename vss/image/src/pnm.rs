//! PNM: portable bitmaps, greymaps and pixmaps, plain (P1 to P3) and binary (P4 to P6), as netpbm describes them.

use crate::{
    Format, Note, Picture, ReadError,
    samples::{scaled, unpacked},
    sides,
};

const FORMAT: &str = "PNM";

fn broken(what: impl Into<String>) -> ReadError {
    let what = what.into();
    ReadError::Broken {
        format: FORMAT,
        what,
    }
}

fn truncated(what: impl Into<String>) -> ReadError {
    let what = what.into();
    ReadError::Truncated {
        format: FORMAT,
        what,
    }
}

/// What stands before the samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Header {
    /// 1 to 6.
    kind: u8,
    width: usize,
    height: usize,
    /// The largest sample.
    most: u16,
    /// Bytes of the header, with what ends it.
    length: usize,
}

impl Header {
    /// Reads it from the beginning of `bytes`.
    pub(crate) fn read(bytes: &[u8]) -> Result<Self, ReadError> {
        let kind = match bytes {
            [b'P', digit @ b'1'..=b'6', next, ..]
                if next.is_ascii_whitespace() || *next == b'#' =>
            {
                digit - b'0'
            }
            [b'P', b'7', ..] => {
                return Err(ReadError::Unsupported {
                    format: FORMAT,
                    what: "it is a PAM (P7)".to_owned(),
                });
            }
            [_, _] => return Err(truncated("it ends after its first two bytes")),
            _ => return Err(broken("its header is none")),
        };
        let mut text = Text { bytes, at: 2 };
        let width = text.number("width")?;
        let height = text.number("height")?;
        let (width, height) = sides(FORMAT, width, height)?;
        let most = match kind {
            1 | 4 => 1,
            _ => text.number("largest sample")?,
        };
        let most = u16::try_from(most).ok().filter(|most| *most > 0);
        let most = most.ok_or_else(|| broken("its largest sample is not within 1 to 65535"))?;
        let mut header = Self {
            kind,
            width,
            height,
            most,
            length: text.at,
        };
        // One white space ends the header. Two characters end a line of texts from other systems.
        header.length += match bytes.get(text.at..) {
            Some([b'\r', b'\n', rest @ ..]) if header.raster() != Some(rest.len() + 1) => 2,
            Some([next, ..]) if next.is_ascii_whitespace() => 1,
            Some([]) | None => return Err(truncated("it ends after its header")),
            _ => return Err(broken("no white space ends its header")),
        };
        Ok(header)
    }

    fn channels(self) -> usize {
        if self.kind.is_multiple_of(3) { 3 } else { 1 }
    }

    fn sample_bytes(self) -> usize {
        if self.most > 255 { 2 } else { 1 }
    }

    /// Bytes of the samples, where their number is known: those of plain kinds are texts.
    fn raster(self) -> Option<usize> {
        match self.kind {
            1..=3 => None,
            4 => Some(self.width.div_ceil(8) * self.height),
            _ => Some(self.width * self.height * self.channels() * self.sample_bytes()),
        }
    }

    /// Bytes of the whole picture.
    pub(crate) fn whole(self) -> Option<usize> {
        Some(self.length + self.raster()?)
    }
}

/// Words and numbers between white space and comments.
struct Text<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl Text<'_> {
    /// Goes to the next byte that is neither white space nor of a comment.
    fn next(&mut self) -> Option<u8> {
        loop {
            match *self.bytes.get(self.at)? {
                b'#' => {
                    let rest = self.bytes.get(self.at..).unwrap_or_default();
                    let line = rest.iter().position(|byte| matches!(byte, b'\n' | b'\r'));
                    self.at += line.unwrap_or(rest.len());
                }
                space if space.is_ascii_whitespace() => self.at += 1,
                other => return Some(other),
            }
        }
    }

    fn number(&mut self, what: &str) -> Result<u64, ReadError> {
        if self.next().is_none() {
            return Err(truncated(format!("it ends before its {what}")));
        }
        let start = self.at;
        let mut number = 0_u64;
        while let Some(digit) = self.bytes.get(self.at).filter(|byte| byte.is_ascii_digit()) {
            number = number
                .saturating_mul(10)
                .saturating_add(u64::from(digit - b'0'));
            self.at += 1;
        }
        if self.at == start {
            let found = self.bytes.get(start).copied().unwrap_or_default();
            let found = found.escape_ascii();
            return Err(broken(format!(
                "`{found}` stands at byte {start} where a number should ({what})"
            )));
        }
        Ok(number)
    }
}

/// Reads a PNM.
///
/// # Errors
/// It is broken, truncated, too large, or something comes after it.
pub(crate) fn read(bytes: &[u8]) -> Result<Picture, ReadError> {
    let header = Header::read(bytes)?;
    let rest = bytes.get(header.length..).unwrap_or_default();
    let (samples, end) = match header.raster() {
        Some(length) => {
            let raster = rest.get(..length).ok_or_else(|| {
                truncated(format!(
                    "its samples are {length} bytes, and {} are there",
                    rest.len()
                ))
            })?;
            (binary(header, raster)?, header.length + length)
        }
        None => plain(header, bytes)?,
    };
    let after = bytes.get(end..).unwrap_or_default();
    if after.iter().any(|byte| !byte.is_ascii_whitespace()) {
        let count = after.len();
        return Err(broken(format!(
            "{count} bytes come after its {} x {} pixels: its header is wrong, or there are several pictures",
            header.width, header.height
        )));
    }
    let scales = header.most != 255 && header.kind % 3 != 1;
    Ok(Picture {
        width: header.width,
        height: header.height,
        format: match header.channels() {
            3 => Format::Rgb8,
            _ => Format::Grey8,
        },
        pixels: samples,
        notes: scales
            .then_some(Note::Scaled(header.most))
            .into_iter()
            .collect(),
    })
}

/// A sample as a byte; in bitmaps 1 is black.
fn sample(header: Header, sample: u32, nth: usize) -> Result<u8, ReadError> {
    let most = u32::from(header.most);
    if sample > most {
        let pixel = nth / header.channels();
        let (u, v) = (pixel % header.width, pixel / header.width);
        return Err(broken(format!(
            "the sample {sample} of pixel {u}, {v} is above its largest one, {most}"
        )));
    }
    let bright = if header.kind % 3 == 1 {
        most - sample
    } else {
        sample
    };
    Ok(scaled(bright, most))
}

fn binary(header: Header, raster: &[u8]) -> Result<Vec<u8>, ReadError> {
    if header.kind == 4 {
        let rows = raster.chunks_exact(header.width.div_ceil(8));
        let bits = rows.flat_map(|row| unpacked(row, 1, header.width));
        return Ok(bits.map(|black| if black == 1 { 0 } else { 255 }).collect());
    }
    let samples = raster.chunks_exact(header.sample_bytes());
    let numbers = samples.map(|bytes| {
        bytes
            .iter()
            .fold(0, |sum, byte| sum << 8 | u32::from(*byte))
    });
    let bytes = numbers
        .enumerate()
        .map(|(nth, number)| sample(header, number, nth));
    bytes.collect()
}

/// Samples as texts, and where they end.
fn plain(header: Header, bytes: &[u8]) -> Result<(Vec<u8>, usize), ReadError> {
    let mut text = Text {
        bytes,
        at: header.length,
    };
    let count = header.width * header.height * header.channels();
    // Every sample takes a byte at least: no more is reserved than was sent.
    let mut samples = Vec::with_capacity(count.min(bytes.len()));
    for nth in 0..count {
        let what = || truncated(format!("{nth} of its {count} samples are there"));
        let first = text.next().ok_or_else(what)?;
        let number = match (header.kind, first) {
            // Bits need no space between them.
            (1, b'0'..=b'9') => {
                text.at += 1;
                u32::from(first - b'0')
            }
            _ => u32::try_from(text.number("sample")?).unwrap_or(u32::MAX),
        };
        samples.push(sample(header, number, nth)?);
    }
    Ok((samples, text.at))
}

//! BMP: the bitmaps of Windows and OS/2 with headers of 12 to 124 bytes; palettes, bit fields and run lengths.

use crate::{
    Format, Note, Picture, ReadError,
    samples::{scaled, unpacked},
    sides,
};

const FORMAT: &str = "BMP";

fn broken(what: impl Into<String>) -> ReadError {
    let what = what.into();
    ReadError::Broken {
        format: FORMAT,
        what,
    }
}

fn unsupported(what: impl Into<String>) -> ReadError {
    let what = what.into();
    ReadError::Unsupported {
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

/// Numbers at places of a file, the lowest byte first.
struct Bytes<'a>(&'a [u8]);

impl Bytes<'_> {
    fn u16(&self, at: usize) -> Result<u16, ReadError> {
        let bytes = self.0.get(at..).and_then(|rest| rest.first_chunk());
        bytes
            .map(|bytes| u16::from_le_bytes(*bytes))
            .ok_or_else(short)
    }

    fn u32(&self, at: usize) -> Result<u32, ReadError> {
        let bytes = self.0.get(at..).and_then(|rest| rest.first_chunk());
        bytes
            .map(|bytes| u32::from_le_bytes(*bytes))
            .ok_or_else(short)
    }
}

fn short() -> ReadError {
    truncated("it ends within its header")
}

/// How pixels are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Compression {
    None,
    RunLengths,
    BitFields,
}

struct Header {
    width: usize,
    height: usize,
    /// The first row is the top one.
    downwards: bool,
    /// Bits of a pixel.
    bits: usize,
    compression: Compression,
    /// Where the palette begins, its entries, and bytes of each.
    palette: (usize, usize, usize),
    /// Where the pixels begin.
    pixels: usize,
    /// Bits of red, green and blue in a pixel of 16 or 32.
    masks: [u32; 3],
}

/// Headers of this many bytes or more hold bit fields.
const WITH_MASKS: usize = 52;

impl Header {
    fn read(file: &Bytes<'_>) -> Result<Self, ReadError> {
        let size_of = |number: u32| usize::try_from(number).unwrap_or(usize::MAX);
        let pixels = size_of(file.u32(10)?);
        let length = size_of(file.u32(14)?);
        let old = length == 12;
        let (width, height, planes, bits) = if old {
            let sides = (i64::from(file.u16(18)?), i64::from(file.u16(20)?));
            (sides.0, sides.1, file.u16(22)?, file.u16(24)?)
        } else if [40, 52, 56, 64, 108, 124].contains(&length) {
            let signed = |number: u32| i64::from(number.cast_signed());
            let sides = (signed(file.u32(18)?), signed(file.u32(22)?));
            (sides.0, sides.1, file.u16(26)?, file.u16(28)?)
        } else {
            return Err(broken(format!("its header claims {length} bytes")));
        };
        if width < 0 || planes != 1 {
            return Err(broken(format!(
                "its width is {width} and it has {planes} planes"
            )));
        }
        let sides = sides(FORMAT, width.unsigned_abs(), height.unsigned_abs())?;
        let bits = usize::from(bits);
        let method = if old { 0 } else { file.u32(30)? };
        let compression = match (method, bits, length) {
            (0, 1 | 4 | 8 | 16 | 24 | 32, _) => Compression::None,
            (1, 8, _) | (2, 4, _) if height > 0 => Compression::RunLengths,
            // OS/2 gives 3 another meaning.
            (3 | 6, 16 | 32, 40 | 52 | 56 | 108 | 124) => Compression::BitFields,
            _ => {
                return Err(unsupported(format!(
                    "{bits} bits a pixel, compression {method}"
                )));
            }
        };
        let masks = match (compression, bits) {
            (Compression::BitFields, _) => [file.u32(54)?, file.u32(58)?, file.u32(62)?],
            (_, 16) => [0x7c00, 0x03e0, 0x001f],
            _ => [0x00ff_0000, 0x0000_ff00, 0x0000_00ff],
        };
        // The bit fields of a short header stand behind it.
        let fields = match (compression, method) {
            (Compression::BitFields, 3) if length < WITH_MASKS => 12,
            (Compression::BitFields, _) if length < WITH_MASKS => 16,
            _ => 0,
        };
        let begins = 14 + length + fields;
        if pixels < begins {
            return Err(broken("its pixels stand within its header"));
        }
        let entry = if old { 3 } else { 4 };
        let palette = if bits > 8 {
            0
        } else {
            let used = if old { 0 } else { size_of(file.u32(46)?) };
            let all = 1 << bits;
            if used > all {
                return Err(broken(format!(
                    "its palette of {bits} bits claims {used} colours"
                )));
            }
            let there = (pixels - begins) / entry;
            (if used == 0 { all } else { used }).min(there)
        };
        Ok(Self {
            width: sides.0,
            height: sides.1,
            downwards: height < 0,
            bits,
            compression,
            palette: (begins, palette, entry),
            pixels,
            masks,
        })
    }

    /// The rows from the top, each as long as its pixels.
    fn rows<'a>(&self, data: &'a [u8]) -> Result<Vec<&'a [u8]>, ReadError> {
        let length = (self.width * self.bits).div_ceil(8);
        let stored = length.div_ceil(4) * 4;
        // What fills up the last row may be missing.
        let needed = stored * (self.height - 1) + length;
        if data.len() < needed {
            let there = data.len();
            return Err(truncated(format!(
                "its pixels are {needed} bytes, and {there} are there"
            )));
        }
        let rows = data.chunks(stored).take(self.height);
        let mut rows: Vec<&[u8]> = rows.filter_map(|row| row.get(..length)).collect();
        if !self.downwards {
            rows.reverse();
        }
        Ok(rows)
    }
}

/// Reads a BMP.
///
/// # Errors
/// It is broken, truncated, too large or of another kind.
pub(crate) fn read(bytes: &[u8]) -> Result<Picture, ReadError> {
    let header = Header::read(&Bytes(bytes))?;
    let data = bytes.get(header.pixels..).unwrap_or_default();
    let (mut format, mut pixels) = match (header.compression, header.bits) {
        (Compression::RunLengths, _) => indexed(&header, bytes, &runs(&header, data)?)?,
        (_, ..=8) => {
            let rows = header.rows(data)?;
            // Memory for all pixels is taken once: growing would take twice as much.
            let mut indices = Vec::with_capacity(header.width * header.height);
            for row in rows {
                indices.extend(unpacked(row, header.bits, header.width));
            }
            indexed(&header, bytes, &indices)?
        }
        (_, 24) => {
            let mut pixels = Vec::with_capacity(header.width * header.height * 3);
            for row in header.rows(data)? {
                let colours = row.chunks_exact(3);
                pixels.extend(colours.flat_map(|bgr| [bgr[2], bgr[1], bgr[0]]));
            }
            (Format::Rgb8, pixels)
        }
        _ => (Format::Rgb8, fields(&header, &header.rows(data)?)?),
    };
    if format == Format::Rgb8 && header.bits <= 8 && is_grey(&pixels) {
        pixels = pixels.iter().step_by(3).copied().collect();
        format = Format::Grey8;
    }
    // Whether the fourth byte of a pixel means anything is not said in most files.
    let transparent = header.bits == 32 && header.compression == Compression::BitFields;
    Ok(Picture {
        width: header.width,
        height: header.height,
        format,
        pixels,
        notes: transparent
            .then_some(Note::Transparency)
            .into_iter()
            .collect(),
    })
}

fn is_grey(pixels: &[u8]) -> bool {
    pixels
        .chunks_exact(3)
        .all(|rgb| rgb[0] == rgb[1] && rgb[1] == rgb[2])
}

/// The colours of indices.
fn indexed(header: &Header, bytes: &[u8], indices: &[u8]) -> Result<(Format, Vec<u8>), ReadError> {
    let (begins, count, entry) = header.palette;
    let palette = bytes
        .get(begins..begins + count * entry)
        .ok_or_else(short)?;
    let palette: Vec<[u8; 3]> = palette
        .chunks_exact(entry)
        .map(|bgr| [bgr[2], bgr[1], bgr[0]])
        .collect();
    let mut pixels = Vec::with_capacity(indices.len() * 3);
    for (nth, index) in indices.iter().enumerate() {
        let colour = palette.get(usize::from(*index)).ok_or_else(|| {
            let (u, v) = (nth % header.width, nth / header.width);
            broken(format!(
                "pixel {u}, {v} has colour {index} of a palette of {count} colours"
            ))
        })?;
        pixels.extend_from_slice(colour);
    }
    Ok((Format::Rgb8, pixels))
}

/// The colours of pixels whose bits belong to red, green and blue.
fn fields(header: &Header, rows: &[&[u8]]) -> Result<Vec<u8>, ReadError> {
    let mut fields = [(0, 0); 3];
    for (field, mask) in fields.iter_mut().zip(header.masks) {
        let shift = mask.trailing_zeros() % 32;
        let most = mask >> shift;
        if mask == 0 || most & most.wrapping_add(1) != 0 {
            return Err(broken(format!("{mask:#010x} is no field of bits")));
        }
        *field = (shift, most);
    }
    let mut pixels = Vec::with_capacity(header.width * header.height * 3);
    for pixel in rows
        .iter()
        .flat_map(|row| row.chunks_exact(header.bits / 8))
    {
        let value = pixel
            .iter()
            .rev()
            .fold(0, |sum, byte| sum << 8 | u32::from(*byte));
        let colour = fields.map(|(shift, most)| scaled(value >> shift & most, most));
        pixels.extend_from_slice(&colour);
    }
    Ok(pixels)
}

/// The indices that run lengths stand for. All pixels must be given one.
fn runs(header: &Header, data: &[u8]) -> Result<Vec<u8>, ReadError> {
    const UNSET: u16 = u16::MAX;
    let mut indices = vec![UNSET; header.width * header.height];
    let mut data = data.iter().copied();
    let (mut u, mut row) = (0, 0);
    let mut next = || data.next().ok_or_else(|| truncated("its runs have no end"));
    loop {
        let (count, value) = (next()?, next()?);
        let mut put = |index: u8| {
            // Rows are counted from below.
            let inside = u < header.width && row < header.height;
            let place = inside.then(|| (header.height - 1 - row) * header.width + u);
            let place = place.and_then(|place| indices.get_mut(place));
            *place.ok_or_else(|| broken("a run leaves the picture"))? = u16::from(index);
            u += 1;
            Ok(())
        };
        match (count, value) {
            (0, 0) => (u, row) = (0, row + 1),
            (0, 1) => break,
            (0, 2) => {
                u += usize::from(next()?);
                row += usize::from(next()?);
            }
            (0, count) if header.bits == 8 => {
                for _ in 0..count {
                    put(next()?)?;
                }
                if count % 2 == 1 {
                    next()?;
                }
            }
            (0, count) => {
                for nth in 0..count.div_ceil(2) {
                    let pair = next()?;
                    put(pair >> 4)?;
                    if 2 * nth + 1 < count {
                        put(pair & 15)?;
                    }
                }
                if count.div_ceil(2) % 2 == 1 {
                    next()?;
                }
            }
            (count, value) if header.bits == 8 => (0..count).try_for_each(|_| put(value))?,
            (count, pair) => {
                for nth in 0..count {
                    put(if nth % 2 == 0 { pair >> 4 } else { pair & 15 })?;
                }
            }
        }
    }
    let missing = indices.iter().filter(|index| **index == UNSET).count();
    if missing > 0 {
        return Err(broken(format!(
            "its runs leave {missing} pixels without a colour"
        )));
    }
    Ok(indices
        .iter()
        .map(|index| u8::try_from(*index).unwrap_or(u8::MAX))
        .collect())
}

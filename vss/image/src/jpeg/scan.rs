//! Walks through a JPEG without decoding it: its segments, and every code of every scan (ITU-T T.81, annexes B, F, G).
//! So it is known whether all scans are whole and the end was reached.

use super::{broken, exif, sides, truncated, unsupported};
use crate::ReadError;

/// A picture has at most so many scans: each costs the time of a picture.
pub(super) const MOST: usize = 100;

/// Blocks have so many coefficients.
const COEFFICIENTS: usize = 64;

/// What a walk finds.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Found {
    pub(super) width: usize,
    pub(super) height: usize,
    /// 1 or 3.
    pub(super) components: usize,
    /// The Exif orientation, if it is another one than "as stored".
    pub(super) orientation: Option<u16>,
    /// Where the end-of-image marker ends.
    pub(super) end: usize,
}

/// One colour of a frame.
struct Component {
    id: u8,
    /// Blocks of an interleaved unit across and down.
    across: usize,
    down: usize,
    /// Blocks of a row of an interleaved scan.
    stride: usize,
    /// Which coefficients of each block are not zero; for progressive frames only.
    filled: Vec<u64>,
    /// The lowest bit that is known of each coefficient; none at first.
    known: [Option<u8>; COEFFICIENTS],
}

struct Frame {
    progressive: bool,
    width: usize,
    height: usize,
    components: Vec<Component>,
    /// Interleaved units across and down.
    units: (usize, usize),
}

/// A canonical Huffman code.
#[derive(Debug, Clone)]
struct Codes {
    /// For each length: the first code, the place of its value, and how many there are.
    lengths: [(u32, usize, usize); 16],
    values: Vec<u8>,
}

impl Codes {
    /// From the counts of codes of 1 to 16 bits, and the values in their order.
    fn new(counts: &[u8], values: &[u8]) -> Result<Self, ReadError> {
        let mut lengths = [(0, 0, 0); 16];
        let (mut code, mut place) = (0_u32, 0);
        for (bits, (length, count)) in (1..).zip(lengths.iter_mut().zip(counts)) {
            let count = usize::from(*count);
            *length = (code, place, count);
            code += u32::try_from(count).unwrap_or(u32::MAX);
            place += count;
            if code > 1 << bits {
                return Err(broken("a Huffman table has more codes than bits allow"));
            }
            code <<= 1;
        }
        Ok(Self {
            lengths,
            values: values.to_vec(),
        })
    }
}

/// The bits of a scan, up to a marker.
struct Bits<'a> {
    bytes: &'a [u8],
    at: usize,
    buffer: u32,
    left: u32,
}

impl Bits<'_> {
    fn bit(&mut self) -> Result<u32, ReadError> {
        if self.left == 0 {
            let byte = self.bytes.get(self.at).copied();
            let next = self.bytes.get(self.at + 1).copied();
            self.at += match (byte, next) {
                (None, _) => return Err(truncated("it ends within a scan")),
                (Some(0xff), Some(0)) => 2,
                (Some(0xff), _) => return Err(truncated("a scan ends before its last block")),
                _ => 1,
            };
            self.buffer = u32::from(byte.unwrap_or_default());
            self.left = 8;
        }
        self.left -= 1;
        Ok(self.buffer >> self.left & 1)
    }

    fn bits(&mut self, count: u32) -> Result<u32, ReadError> {
        (0..count).try_fold(0, |number, _| Ok(number << 1 | self.bit()?))
    }

    fn value(&mut self, codes: &Codes) -> Result<u8, ReadError> {
        let mut code = 0_u32;
        for (first, place, count) in codes.lengths {
            code = code << 1 | self.bit()?;
            let nth = usize::try_from(code.wrapping_sub(first)).unwrap_or(usize::MAX);
            if nth < count {
                let value = codes.values.get(place + nth);
                return value
                    .copied()
                    .ok_or_else(|| broken("a Huffman table lacks values"));
            }
        }
        Err(broken("a scan holds a code that its Huffman table lacks"))
    }

    /// Goes over a restart marker, which must come here.
    fn restart(&mut self, nth: usize) -> Result<(), ReadError> {
        self.left = 0;
        let expected = 0xd0 + u8::try_from(nth % 8).unwrap_or_default();
        match self.bytes.get(self.at..) {
            Some([0xff, marker, ..]) if *marker == expected => {
                self.at += 2;
                Ok(())
            }
            Some([_, _, ..]) => Err(broken(format!(
                "restart marker {nth} is not where it should be"
            ))),
            _ => Err(truncated("it ends within a scan")),
        }
    }
}

/// What a scan says of itself.
struct Scan {
    /// Which components it holds, and their tables for first and other coefficients.
    components: Vec<(usize, usize, usize)>,
    /// The first and the last coefficient.
    band: (usize, usize),
    /// The bit that was known before (0: none), and the one that is known after it.
    bits: (u8, u8),
}

#[derive(Default)]
struct Walk {
    frame: Option<Frame>,
    first: [Option<Codes>; 4],
    other: [Option<Codes>; 4],
    restart: usize,
    orientation: Option<u16>,
    scans: usize,
}

/// Walks through the file.
pub(super) fn walk(bytes: &[u8]) -> Result<Found, ReadError> {
    let mut walk = Walk::default();
    let mut at = 2;
    loop {
        let marker = match bytes.get(at..) {
            Some([0xff, 0xff, ..]) => {
                at += 1;
                continue;
            }
            Some([0xff, marker, ..]) => *marker,
            Some([_, _, ..]) => return Err(broken(format!("no marker stands at byte {at}"))),
            _ => return Err(truncated("its end-of-image marker is missing")),
        };
        at += 2;
        match marker {
            0xd9 => return walk.end(at),
            0x01 | 0xd0..=0xd7 => continue,
            0xd8 | 0x00 => return Err(broken(format!("marker {marker:#04x} stands at byte {at}"))),
            _ => {}
        }
        let length = bytes.get(at..).and_then(|rest| rest.first_chunk());
        let length = length.map(|two| usize::from(u16::from_be_bytes(*two)));
        let length = length.ok_or_else(|| truncated("it ends within a segment"))?;
        let content = bytes.get(at + 2..at + length.max(2));
        let content = content.ok_or_else(|| truncated("it ends within a segment"))?;
        if length < 2 {
            return Err(broken(format!("a segment at byte {at} has no length")));
        }
        at += length;
        match marker {
            0xc4 => walk.tables(content)?,
            0xc0..=0xc2 => walk.start(content, marker == 0xc2)?,
            0xc3 | 0xc5..=0xc7 | 0xc9..=0xcb | 0xcd..=0xcf => {
                let what = "it is lossless, hierarchical, or has arithmetic codes";
                return Err(unsupported(what));
            }
            0xdc => return Err(unsupported("its height stands behind its first scan")),
            0xdd => {
                let two = content
                    .first_chunk()
                    .ok_or_else(|| short("restart interval"))?;
                walk.restart = usize::from(u16::from_be_bytes(*two));
            }
            0xe1 => walk.orientation = walk.orientation.or_else(|| exif::orientation(content)),
            0xda => {
                let mut bits = Bits {
                    bytes,
                    at,
                    buffer: 0,
                    left: 0,
                };
                walk.scan(content, &mut bits)?;
                at = bits.at;
            }
            _ => {}
        }
    }
}

fn short(what: &str) -> ReadError {
    broken(format!("its {what} is too short"))
}

impl Walk {
    fn end(self, end: usize) -> Result<Found, ReadError> {
        let frame = self.frame.ok_or_else(|| broken("it has no frame"))?;
        // Scans that were never sent cannot be told from lost ones.
        let mut bits = frame.components.iter().flat_map(|one| one.known);
        if bits.any(|bit| bit != Some(0)) {
            return Err(truncated(
                "scans are missing before its end-of-image marker",
            ));
        }
        Ok(Found {
            width: frame.width,
            height: frame.height,
            components: frame.components.len(),
            orientation: self.orientation,
            end,
        })
    }

    /// Huffman tables.
    fn tables(&mut self, mut content: &[u8]) -> Result<(), ReadError> {
        while let [about, rest @ ..] = content {
            let counts = rest.get(..16).ok_or_else(|| short("Huffman table"))?;
            let values = counts
                .iter()
                .map(|count| usize::from(*count))
                .sum::<usize>();
            let values = rest
                .get(16..16 + values)
                .ok_or_else(|| short("Huffman table"))?;
            let tables = if about >> 4 == 0 {
                &mut self.first
            } else {
                &mut self.other
            };
            let table = tables.get_mut(usize::from(about & 15));
            let table = table.filter(|_| about >> 4 < 2);
            *table.ok_or_else(|| broken("a Huffman table has a number above 3"))? =
                Some(Codes::new(counts, values)?);
            content = rest.get(16 + values.len()..).unwrap_or_default();
        }
        Ok(())
    }

    /// The start of a frame.
    fn start(&mut self, content: &[u8], progressive: bool) -> Result<(), ReadError> {
        let [depth, h1, h0, w1, w0, count, rest @ ..] = content else {
            return Err(short("frame header"));
        };
        if self.frame.is_some() {
            return Err(broken("it has two frames"));
        }
        if *depth != 8 {
            return Err(unsupported(format!("it has {depth} bits a sample")));
        }
        let side = |high: &u8, low: &u8| u64::from(u16::from_be_bytes([*high, *low]));
        let (width, height) = sides(super::FORMAT, side(w1, w0), side(h1, h0))?;
        match count {
            1 | 3 => {}
            4 => return Err(unsupported("it has four colours (CMYK or YCCK)")),
            _ => return Err(unsupported(format!("it has {count} components"))),
        }
        let rest = rest.get(..3 * usize::from(*count));
        let rest = rest.ok_or_else(|| short("frame header"))?;
        let mut components: Vec<Component> = rest
            .chunks_exact(3)
            .map(|three| Component {
                id: three[0],
                across: usize::from(three[1] >> 4),
                down: usize::from(three[1] & 15),
                stride: 0,
                filled: Vec::new(),
                known: [None; COEFFICIENTS],
            })
            .collect();
        let possible =
            |one: &Component| (1..=4).contains(&one.across) && (1..=4).contains(&one.down);
        if !components.iter().all(possible) {
            return Err(broken("a component is sampled 0 or more than 4 times"));
        }
        let most = |of: fn(&Component) -> usize| components.iter().map(of).max().unwrap_or(1);
        let (across, down) = (most(|one| one.across), most(|one| one.down));
        let units = (width.div_ceil(8 * across), height.div_ceil(8 * down));
        for one in &mut components {
            one.stride = units.0 * one.across;
            if progressive {
                one.filled = vec![0; one.stride * units.1 * one.down];
            }
        }
        self.frame = Some(Frame {
            progressive,
            width,
            height,
            components,
            units,
        });
        Ok(())
    }

    /// What a scan's header says.
    fn header(&self, content: &[u8], frame: &Frame) -> Result<Scan, ReadError> {
        let (count, rest) = content.split_first().ok_or_else(|| short("scan header"))?;
        let count = usize::from(*count);
        let (pairs, [begin, end, bits]) = match (rest.get(..2 * count), rest.get(2 * count..)) {
            (Some(pairs), Some([begin, end, bits])) => (pairs, [*begin, *end, *bits]),
            _ => return Err(short("scan header")),
        };
        let components = pairs.chunks_exact(2).map(|pair| {
            let place = frame.components.iter().position(|one| one.id == pair[0]);
            let place = place.ok_or_else(|| broken("a scan names an unknown component"))?;
            Ok((place, usize::from(pair[1] >> 4), usize::from(pair[1] & 15)))
        });
        let scan = Scan {
            components: components.collect::<Result<_, ReadError>>()?,
            band: (usize::from(begin), usize::from(end)),
            bits: (bits >> 4, bits & 15),
        };
        let (begin, end) = scan.band;
        let possible = if frame.progressive {
            let whole = begin == 0 && end == 0 || count == 1 && (1..=end).contains(&begin);
            whole && end < COEFFICIENTS && (bits >> 4 == 0 || bits >> 4 == (bits & 15) + 1)
        } else {
            (begin, end, bits) == (0, COEFFICIENTS - 1, 0)
        };
        let mut places: Vec<usize> = scan.components.iter().map(|one| one.0).collect();
        places.sort_unstable();
        places.dedup();
        if !possible || places.len() != count || count == 0 {
            return Err(broken("a scan's header contradicts itself"));
        }
        Ok(scan)
    }

    fn scan(&mut self, content: &[u8], bits: &mut Bits<'_>) -> Result<(), ReadError> {
        self.scans += 1;
        if self.scans > MOST {
            return Err(unsupported(format!("it has more than {MOST} scans")));
        }
        let mut frame = self
            .frame
            .take()
            .ok_or_else(|| broken("a scan comes before its frame"))?;
        let scan = self.header(content, &frame)?;
        // What is known afterwards of each coefficient; a refinement needs what it refines.
        for (place, ..) in &scan.components {
            for k in scan.band.0..=scan.band.1 {
                let known = &mut frame.components[*place].known[k];
                let before = (scan.bits.0 > 0).then_some(scan.bits.0);
                if *known != before {
                    return Err(broken("its scans come in no possible order"));
                }
                *known = Some(scan.bits.1);
            }
        }
        let interleaved = scan.components.len() > 1;
        let (across, down) = match scan.components.first() {
            // A scan of one component has the blocks that hold pixels, and no others.
            Some((place, ..)) if !interleaved => {
                let one = &frame.components[*place];
                let most = |of: fn(&Component) -> usize| {
                    frame.components.iter().map(of).max().unwrap_or(1)
                };
                let blocks = |side: usize, own: usize, most: usize| (side * own).div_ceil(8 * most);
                (
                    blocks(frame.width, one.across, most(|one| one.across)),
                    blocks(frame.height, one.down, most(|one| one.down)),
                )
            }
            _ => frame.units,
        };
        let mut run = 0;
        for nth in 0..across * down {
            if self.restart > 0 && nth > 0 && nth % self.restart == 0 {
                bits.restart(nth / self.restart - 1)?;
                run = 0;
            }
            let (column, row) = (nth % across, nth / across);
            for (place, first, other) in &scan.components {
                let tables = (self.first.get(*first), self.other.get(*other));
                let tables = (
                    tables.0.and_then(Option::as_ref),
                    tables.1.and_then(Option::as_ref),
                );
                let one = &mut frame.components[*place];
                let (wide, high) = if interleaved {
                    (one.across, one.down)
                } else {
                    (1, 1)
                };
                for block in 0..wide * high {
                    let (u, v) = (column * wide + block % wide, row * high + block / wide);
                    if frame.progressive {
                        let filled = one.filled.get_mut(v * one.stride + u);
                        let filled = filled.ok_or_else(|| broken("a block lies outside"))?;
                        progressive(bits, &scan, tables, filled, &mut run)?;
                    } else {
                        sequential(bits, tables)?;
                    }
                }
            }
        }
        bits.left = 0;
        self.frame = Some(frame);
        Ok(())
    }
}

/// Tables for first and other coefficients, where there are such.
type Tables<'a> = (Option<&'a Codes>, Option<&'a Codes>);

fn needed(table: Option<&Codes>) -> Result<&Codes, ReadError> {
    table.ok_or_else(|| broken("a scan's Huffman table is missing"))
}

/// Goes over a block of a sequential scan (annex F.2.2).
fn sequential(bits: &mut Bits<'_>, tables: Tables<'_>) -> Result<(), ReadError> {
    first(bits, tables)?;
    let codes = needed(tables.1)?;
    let mut k = 1;
    while k < COEFFICIENTS {
        let value = bits.value(codes)?;
        let (run, size) = (usize::from(value >> 4), u32::from(value & 15));
        match (run, size) {
            (15, 0) => k += 16,
            (_, 0) => break,
            _ => {
                k += run + 1;
                bits.bits(size)?;
            }
        }
        if k > COEFFICIENTS {
            return Err(broken("a block has more than 64 coefficients"));
        }
    }
    Ok(())
}

/// Goes over the first coefficient.
fn first(bits: &mut Bits<'_>, tables: Tables<'_>) -> Result<(), ReadError> {
    let size = u32::from(bits.value(needed(tables.0)?)?);
    if size > 15 {
        return Err(broken("a first coefficient has more than 15 bits"));
    }
    bits.bits(size)?;
    Ok(())
}

/// Goes over a block of a progressive scan (annex G.1.2), and keeps which of its coefficients are not zero. `run` counts the
/// blocks that hold nothing more.
fn progressive(
    bits: &mut Bits<'_>,
    scan: &Scan,
    tables: Tables<'_>,
    filled: &mut u64,
    run: &mut u32,
) -> Result<(), ReadError> {
    let (begin, end) = scan.band;
    let refines = scan.bits.0 > 0;
    if begin == 0 {
        return if refines {
            bits.bit().map(drop)
        } else {
            first(bits, tables)
        };
    }
    let codes = needed(tables.1)?;
    let mut k = begin;
    while *run == 0 && k <= end {
        let value = bits.value(codes)?;
        let (mut zeros, size) = (usize::from(value >> 4), u32::from(value & 15));
        if size == 0 && zeros < 15 {
            let count = u32::try_from(zeros).unwrap_or_default();
            *run = (1 << count) + bits.bits(count)?;
            break;
        }
        if refines {
            if size > 1 {
                return Err(broken("a refinement has more than one bit"));
            }
            bits.bits(size)?;
            // Known coefficients on the way have a bit each, and do not count as zeros.
            while k <= end {
                if *filled >> k & 1 == 1 {
                    bits.bit()?;
                } else if zeros == 0 {
                    break;
                } else {
                    zeros -= 1;
                }
                k += 1;
            }
        } else {
            bits.bits(size)?;
            k += zeros;
        }
        if k > end && size > 0 {
            return Err(broken("a block has more coefficients than its scan"));
        }
        if size > 0 {
            *filled |= 1 << k;
        }
        k += 1;
    }
    if *run > 0 {
        *run -= 1;
        if refines {
            let rest = (k..=end).filter(|k| *filled >> k & 1 == 1).count();
            bits.bits(u32::try_from(rest).unwrap_or_default())?;
        }
    }
    Ok(())
}

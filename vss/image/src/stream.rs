//! Pictures one after the other in a stream of bytes: PNG, binary PNM, or raw pixels.

use std::io::{ErrorKind, Read};

use crate::{FILE_MOST, Format, Picture, ReadError, pnm, read, sides};

/// What the stream is made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Whole PNG files.
    Png,
    /// Binary PBM, PGM or PPM files (P4, P5, P6), with white space between them at the most.
    Pnm,
    /// Pixels of one size and format, without anything between pictures.
    Raw {
        /// Pixels of a row.
        width: usize,
        /// Rows.
        height: usize,
        /// What a pixel is.
        format: Format,
    },
}

/// Why no more pictures come.
#[derive(Debug, thiserror::Error)]
pub enum StreamError {
    /// What came is no picture. What follows it cannot be told from it.
    #[error("picture {number} of the stream: {error}")]
    Picture {
        /// Which one, from 0.
        number: u64,
        /// What is wrong.
        error: ReadError,
    },
    /// The stream cannot be read.
    #[error("the stream cannot be read after picture {number}: {error}")]
    Io {
        /// Which one, from 0.
        number: u64,
        /// What the system says.
        error: std::io::Error,
    },
}

/// Reads pictures from a stream. After an error nothing more comes.
#[derive(Debug)]
pub struct Stream<R> {
    from: R,
    kind: Kind,
    number: u64,
    ended: bool,
}

/// What goes wrong while a picture is read.
enum Wrong {
    Picture(ReadError),
    Io(std::io::Error),
}

impl From<ReadError> for Wrong {
    fn from(error: ReadError) -> Self {
        Self::Picture(error)
    }
}

impl<R: Read> Stream<R> {
    /// Reads from `from`, which should have a buffer.
    pub fn new(from: R, kind: Kind) -> Self {
        Self {
            from,
            kind,
            number: 0,
            ended: false,
        }
    }

    fn next_picture(&mut self) -> Result<Option<Picture>, Wrong> {
        match self.kind {
            Kind::Png => self.png(),
            Kind::Pnm => self.pnm(),
            Kind::Raw {
                width,
                height,
                format,
            } => self.raw(width, height, format),
        }
    }

    /// Adds `count` bytes, and fails where they are not all there.
    fn more(
        &mut self,
        bytes: &mut Vec<u8>,
        count: usize,
        format: &'static str,
    ) -> Result<(), Wrong> {
        let large = FILE_MOST.saturating_sub(bytes.len() as u64);
        if count as u64 > large {
            let what = format!("it is longer than {FILE_MOST} bytes");
            return Err(ReadError::Broken { format, what }.into());
        }
        // Memory is taken as bytes come, and not for what is announced.
        let read = self.from.by_ref().take(count as u64).read_to_end(bytes);
        match read {
            Ok(read) if read == count => Ok(()),
            Ok(read) => {
                let what = format!("the stream ends after {read} of {count} bytes");
                Err(ReadError::Truncated { format, what }.into())
            }
            Err(error) => Err(Wrong::Io(error)),
        }
    }

    /// The next byte, or nothing at the end.
    fn byte(&mut self) -> Result<Option<u8>, Wrong> {
        let mut one = [0];
        loop {
            match self.from.read(&mut one) {
                Ok(0) => return Ok(None),
                Ok(_) => return Ok(Some(one[0])),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(Wrong::Io(error)),
            }
        }
    }

    fn png(&mut self) -> Result<Option<Picture>, Wrong> {
        let Some(first) = self.byte()? else {
            return Ok(None);
        };
        let mut bytes = vec![first];
        self.more(&mut bytes, 7, "PNG")?;
        if !matches!(bytes.as_slice(), [0x89, b'P', b'N', b'G', ..]) {
            return Ok(Some(read(&bytes)?));
        }
        loop {
            let at = bytes.len();
            self.more(&mut bytes, 8, "PNG")?;
            let head = bytes.get(at..).unwrap_or_default();
            let length = head
                .first_chunk()
                .map_or(0, |four| u32::from_be_bytes(*four));
            let last = head.ends_with(b"IEND");
            let length = usize::try_from(length).unwrap_or(usize::MAX);
            self.more(&mut bytes, length.saturating_add(4), "PNG")?;
            if last {
                return Ok(Some(read(&bytes)?));
            }
        }
    }

    fn pnm(&mut self) -> Result<Option<Picture>, Wrong> {
        const HEADER_MOST: usize = 4096;
        let mut bytes = Vec::new();
        loop {
            match self.byte()? {
                None if bytes.is_empty() => return Ok(None),
                None => return Ok(Some(read(&bytes)?)),
                Some(space) if bytes.is_empty() && space.is_ascii_whitespace() => continue,
                Some(byte) => bytes.push(byte),
            }
            // Until white space ends it a number may go on.
            if bytes.len() < HEADER_MOST && !bytes.last().is_some_and(u8::is_ascii_whitespace) {
                continue;
            }
            match pnm::Header::read(&bytes) {
                Ok(header) => {
                    let Some(whole) = header.whole() else {
                        let what = "plain ones (P1 to P3) have no length in a stream".to_owned();
                        return Err(ReadError::Unsupported {
                            format: "PNM",
                            what,
                        }
                        .into());
                    };
                    let rest = whole - bytes.len();
                    let ends_line = bytes.ends_with(b"\r");
                    let at = bytes.len();
                    self.more(&mut bytes, rest, "PNM")?;
                    // Two characters ended the header's line: what was taken for the first pixel is the second one.
                    if ends_line && bytes.get(at) == Some(&b'\n') {
                        bytes.remove(at);
                        self.more(&mut bytes, 1, "PNM")?;
                    }
                    return Ok(Some(read(&bytes)?));
                }
                Err(ReadError::Truncated { .. }) if bytes.len() < HEADER_MOST => {}
                Err(error) => return Err(error.into()),
            }
        }
    }

    fn raw(
        &mut self,
        width: usize,
        height: usize,
        format: Format,
    ) -> Result<Option<Picture>, Wrong> {
        let (width, height) = sides("raw picture", width as u64, height as u64)?;
        let Some(first) = self.byte()? else {
            return Ok(None);
        };
        let mut pixels = vec![first];
        let count = width * height * format.bytes();
        self.more(&mut pixels, count - 1, "raw picture")?;
        Ok(Some(Picture {
            width,
            height,
            format,
            pixels,
            notes: Vec::new(),
        }))
    }
}

impl<R: Read> Iterator for Stream<R> {
    type Item = Result<Picture, StreamError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.ended {
            return None;
        }
        let number = self.number;
        match self.next_picture() {
            Ok(Some(picture)) => {
                self.number += 1;
                Some(Ok(picture))
            }
            Ok(None) => {
                self.ended = true;
                None
            }
            Err(wrong) => {
                self.ended = true;
                Some(Err(match wrong {
                    Wrong::Picture(error) => StreamError::Picture { number, error },
                    Wrong::Io(error) => StreamError::Io { number, error },
                }))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::png;

    /// A reader that gives a byte at a time, as a pipe may.
    struct Slow<'a>(&'a [u8]);

    impl Read for Slow<'_> {
        fn read(&mut self, to: &mut [u8]) -> std::io::Result<usize> {
            let count = to.len().min(1);
            self.0.read(&mut to[..count])
        }
    }

    fn pictures(bytes: &[u8], kind: Kind) -> Vec<Result<Picture, String>> {
        let stream = Stream::new(Slow(bytes), kind);
        let found: Vec<_> = stream
            .take(20)
            .map(|one| one.map_err(|error| error.to_string()))
            .collect();
        let whole: Vec<_> = Stream::new(bytes, kind)
            .take(20)
            .map(|one| one.map_err(|error| error.to_string()))
            .collect();
        assert_eq!(found, whole);
        found
    }

    #[test]
    fn pictures_come_one_after_the_other_whatever_they_are() {
        let mut pngs = Vec::new();
        for grey in [1_u8, 2, 3] {
            png::write(&mut pngs, 2, 1, &[grey, 10]).unwrap();
        }
        // The second header ends with two characters, and the third picture begins with one of them.
        let pnms = b"P5 2 1 255\n\x01\x0a\n P5\r\n2 1\r\n255\r\n\x02\x0aP5 2 1\n255 \x03\x0a";
        let raw = [1, 10, 2, 10, 3, 10];
        let size = Kind::Raw {
            width: 2,
            height: 1,
            format: Format::Grey8,
        };
        for (bytes, kind) in [(&pngs[..], Kind::Png), (pnms, Kind::Pnm), (&raw, size)] {
            let found = pictures(bytes, kind);
            let pixels: Vec<_> = found.into_iter().map(|one| one.unwrap().pixels).collect();
            assert_eq!(pixels, [[1, 10], [2, 10], [3, 10]], "{kind:?}");
        }
    }

    #[test]
    fn a_stream_that_ends_within_a_picture_says_which_and_then_ends() {
        let mut pngs = Vec::new();
        png::write(&mut pngs, 2, 1, &[1, 2]).unwrap();
        let whole = pngs.len();
        png::write(&mut pngs, 2, 1, &[1, 2]).unwrap();
        for end in whole + 1..pngs.len() {
            let found = pictures(&pngs[..end], Kind::Png);
            assert_eq!(found.len(), 2);
            let text = found[1].clone().unwrap_err();
            assert!(
                text.starts_with("picture 1 of the stream: ") && text.contains("cut off"),
                "{text}"
            );
        }
        let pnms = b"P5 2 1 255\n12P6 1 1 255\n123";
        for end in 14..pnms.len() {
            let found = pictures(&pnms[..end], Kind::Pnm);
            assert!(found.len() == 2 && found[1].is_err(), "{end}");
        }
        let raw = Kind::Raw {
            width: 1,
            height: 1,
            format: Format::Rgb8,
        };
        assert!(pictures(b"1234", raw)[1].is_err());
        assert!(pictures(b"", raw).is_empty());
    }

    #[test]
    fn what_is_no_picture_or_claims_to_be_huge_is_an_error() {
        for (bytes, kind, what) in [
            (&b"not a picture"[..], Kind::Png, "none of the formats"),
            (
                b"\x89PNG\r\n\x1a\n\xff\xff\xff\xffIDAT",
                Kind::Png,
                "longer than",
            ),
            (b"P2 1 1 255 7", Kind::Pnm, "have no length in a stream"),
            (b"P5 99999 99999 255\n", Kind::Pnm, "99999 x 99999"),
            (b"Q5 1 1 255\n", Kind::Pnm, "header is none"),
        ] {
            let found = pictures(bytes, kind);
            let text = found[0].clone().unwrap_err();
            assert!(found.len() == 1 && text.contains(what), "{text}");
        }
        let endless = [&b"P5 #"[..], &[b'a'; 5000]].concat();
        assert!(pictures(&endless, Kind::Pnm)[0].is_err());
        let large = Kind::Raw {
            width: 1 << 20,
            height: 1 << 20,
            format: Format::Rgb8,
        };
        assert!(pictures(b"1", large)[0].is_err());
    }
}

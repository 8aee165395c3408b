//! What a picture is and where pictures come from. This module names no simulator.
//!
//! Pixel centres are at whole numbers, the first pixel is (0, 0), u runs right and v down.

pub mod buffer;

use std::{borrow::Cow, time::Duration};

use ctos::Blob;
use nalgebra::Isometry3;
use serde::{Deserialize, Serialize, Serializer};

/// How the bytes of a picture are pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum PixelFormat {
    /// A byte for each pixel.
    #[default]
    Grey8,
    /// Red, green and blue, a byte each.
    Rgb8,
}

impl PixelFormat {
    /// Bytes of a pixel.
    #[must_use]
    pub const fn bytes(self) -> usize {
        match self {
            Self::Grey8 => 1,
            Self::Rgb8 => 3,
        }
    }
}

/// The link that carried a camera.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Carried {
    /// Its name, with that of its arm: `puma.link6`.
    pub link: String,
    /// Its pose at the stamp of the picture, m.
    pub world_t_link: Isometry3<f64>,
}

/// Where a Vision Module left the pixels of a frame: a record of a snapshot buffer.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Left {
    /// The app that owns the buffer.
    pub app: String,
    /// The buffer's name.
    pub buffer: String,
    /// The record's number.
    pub record: u64,
}

/// A picture, 8 bit, row after row.
///
/// Cloning shares the pixels. Inside a chassis a frame moves between tasks as a pointer. To another chassis its pixels go with
/// the message, unless they were [left](Self::left) in a snapshot buffer: then whoever needs them
/// [fetches](Self::fetched) them from there.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Frame {
    /// The camera's name; empty when no camera took it.
    pub camera: String,
    /// Counts the frames of this source from 0.
    pub number: u64,
    /// Width, px.
    pub width: usize,
    /// Height, px.
    pub height: usize,
    /// What the bytes of `pixels` are.
    pub format: PixelFormat,
    /// `width * height` pixels, first row first.
    pub pixels: Blob,
    /// The middle of the exposure, since the start of the app.
    pub stamp: Duration,
    /// How long the exposure was.
    pub exposure: Duration,
    /// What carried the camera, if a link did and its pose is known.
    pub carrier: Option<Carried>,
    /// Where its pixels were left, too, if they were.
    pub left: Option<Left>,
    /// When its source had given it, since the start of the app: exposure and transfer were over then. Only the camera's own chassis
    /// knows.
    #[serde(skip)]
    pub received: Option<Duration>,
}

/// As derived, without pixels that were left where the receiver finds them, and without what only the camera's chassis knows.
impl Serialize for Frame {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        #[derive(Serialize)]
        #[serde(rename = "Frame")]
        struct Sent<'a> {
            camera: &'a str,
            number: u64,
            width: usize,
            height: usize,
            format: PixelFormat,
            pixels: &'a Blob,
            stamp: Duration,
            exposure: Duration,
            carrier: &'a Option<Carried>,
            left: &'a Option<Left>,
        }
        let nothing = Blob::default();
        let sent = Sent {
            camera: &self.camera,
            number: self.number,
            width: self.width,
            height: self.height,
            format: self.format,
            pixels: if self.left.is_some() {
                &nothing
            } else {
                &self.pixels
            },
            stamp: self.stamp,
            exposure: self.exposure,
            carrier: &self.carrier,
            left: &self.left,
        };
        sent.serialize(serializer)
    }
}

impl Frame {
    /// A grey picture that no camera took, with the number 0 and the stamp 0.
    #[must_use]
    pub fn grey8(width: usize, height: usize, pixels: impl Into<Blob>) -> Self {
        Self {
            camera: String::new(),
            number: 0,
            width,
            height,
            format: PixelFormat::Grey8,
            pixels: pixels.into(),
            stamp: Duration::ZERO,
            exposure: Duration::ZERO,
            carrier: None,
            left: None,
            received: None,
        }
    }

    /// A picture in colour that no camera took, with the number 0 and the stamp 0.
    #[must_use]
    pub fn rgb8(width: usize, height: usize, pixels: impl Into<Blob>) -> Self {
        Self {
            format: PixelFormat::Rgb8,
            ..Self::grey8(width, height, pixels)
        }
    }

    /// Whether there are as many bytes as width, height and format say.
    #[must_use]
    pub fn is_whole(&self) -> bool {
        let pixels = self.width.checked_mul(self.height);
        let bytes = pixels.and_then(|pixels| pixels.checked_mul(self.format.bytes()));
        bytes == Some(self.pixels.len())
    }

    /// The grey values, first row first: those of the picture, or of its colours by ITU-R BT.709.
    #[must_use]
    pub fn grey(&self) -> Cow<'_, [u8]> {
        match self.format {
            PixelFormat::Grey8 => Cow::Borrowed(&self.pixels),
            PixelFormat::Rgb8 => {
                let (pixels, _) = self.pixels.as_chunks();
                Cow::Owned(pixels.iter().map(luma).collect())
            }
        }
    }

    /// The same as a grey picture. One that is grey keeps its pixels where they stand.
    #[must_use]
    pub fn into_grey(mut self) -> Self {
        if let Cow::Owned(grey) = self.grey() {
            self.pixels = grey.into();
            self.format = PixelFormat::Grey8;
        }
        self
    }

    /// The grey value at column `u` and row `v`, or `None` outside the picture.
    #[must_use]
    pub fn get(&self, u: usize, v: usize) -> Option<u8> {
        let bytes = self.at(u, v)?;
        match self.format {
            PixelFormat::Grey8 => bytes.first().copied(),
            PixelFormat::Rgb8 => bytes.first_chunk().map(luma),
        }
    }

    /// Red, green and blue at column `u` and row `v`, or `None` outside the picture. In a grey picture they are equal.
    #[must_use]
    pub fn rgb(&self, u: usize, v: usize) -> Option<[u8; 3]> {
        let bytes = self.at(u, v)?;
        match self.format {
            PixelFormat::Grey8 => bytes.first().map(|grey| [*grey; 3]),
            PixelFormat::Rgb8 => bytes.first_chunk().copied(),
        }
    }

    /// The bytes of a pixel.
    fn at(&self, u: usize, v: usize) -> Option<&[u8]> {
        if u >= self.width {
            return None;
        }
        let bytes = self.format.bytes();
        let start = v
            .checked_mul(self.width)?
            .checked_add(u)?
            .checked_mul(bytes)?;
        self.pixels.get(start..start.checked_add(bytes)?)
    }
}

/// The luma of a colour (ITU-R BT.709, item 3.2), rounded.
fn luma([red, green, blue]: &[u8; 3]) -> u8 {
    let [red, green, blue] = [red, green, blue].map(|value| u32::from(*value));
    ((2126 * red + 7152 * green + 722 * blue + 5000) / 10_000) as u8
}

/// What is wrong with a camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Doubt {
    /// Its frames have new numbers and the same pixels.
    Frozen,
    /// A frame comes again, or an earlier one.
    Repeated,
    /// Its stamps do not go on as time does.
    TimeJump,
    /// Its pictures have another size or format than at first.
    Size,
    /// Nothing shines.
    Black,
    /// There is nothing to see but one even grey.
    Covered,
}

impl Doubt {
    /// Its name in logs.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Frozen => "frozen",
            Self::Repeated => "repeated",
            Self::TimeJump => "time_jump",
            Self::Size => "size",
            Self::Black => "black",
            Self::Covered => "covered",
        }
    }
}

/// Why no picture came.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum FrameError {
    /// The source reports a fault.
    #[error("frame source `{camera}`: {reason}")]
    Fault {
        /// The camera's name.
        camera: String,
        /// What it says.
        reason: String,
    },
    /// The pixels were left in a snapshot buffer and are not there any more.
    #[error("the pixels of frame {number} of camera `{camera}` are gone: {reason}")]
    Gone {
        /// The camera's name.
        camera: String,
        /// The frame's number.
        number: u64,
        /// Why.
        reason: String,
    },
    /// The camera does what no good camera does: what is measured in its pictures may be wrong.
    #[error("camera `{camera}` is not to be believed ({}): {reason}", doubt.name())]
    Doubtful {
        /// The camera's name.
        camera: String,
        /// What it does.
        doubt: Doubt,
        /// In words.
        reason: String,
    },
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_colour_is_as_bright_as_bt_709_says_and_grey_stays_grey() {
        // Item 3.2 of the recommendation: 0.2126 R + 0.7152 G + 0.0722 B.
        let colours = [
            [255, 0, 0],
            [0, 255, 0],
            [0, 0, 255],
            [255; 3],
            [90, 20, 200],
        ];
        let frame = Frame::rgb8(5, 1, colours.concat());
        assert_eq!(*frame.grey(), [54, 182, 18, 255, 48]);
        for grey in 0..=255 {
            assert_eq!(luma(&[grey; 3]), grey);
        }
        assert_eq!(frame.get(1, 0), Some(182));
        assert_eq!(frame.rgb(4, 0), Some([90, 20, 200]));
        assert_eq!((frame.get(5, 0), frame.get(0, 1)), (None, None));
        let grey = frame.clone().into_grey();
        assert_eq!(
            (grey.format, &*grey.pixels),
            (PixelFormat::Grey8, &*frame.grey())
        );
        assert_eq!(grey.rgb(0, 0), Some([54; 3]));
    }

    #[test]
    fn a_grey_picture_is_not_copied() {
        let frame = Frame::grey8(2, 2, vec![1, 2, 3, 4]);
        assert!(matches!(frame.grey(), Cow::Borrowed(_)));
        let place = frame.pixels.as_ptr();
        assert_eq!(frame.into_grey().pixels.as_ptr(), place);
    }

    #[test]
    fn a_frame_knows_whether_it_is_whole_whatever_its_size_says() {
        assert!(Frame::grey8(2, 2, vec![0; 4]).is_whole());
        assert!(Frame::rgb8(2, 2, vec![0; 12]).is_whole());
        assert!(!Frame::rgb8(2, 2, vec![0; 4]).is_whole());
        let huge = Frame::rgb8(usize::MAX, usize::MAX, vec![0; 3]);
        assert!(!huge.is_whole());
        assert_eq!(huge.get(1, usize::MAX), None);
        assert_eq!(Frame::grey8(0, 0, Vec::new()).get(0, 0), None);
    }
}

//! What a picture is and where pictures come from. This module names no simulator.
//!
//! Pixel centres are at whole numbers, the first pixel is (0, 0), u runs right and v down.

use std::{sync::Arc, time::Duration};

use serde::{Deserialize, Serialize};

/// A grey picture, 8 bit, row after row.
///
/// Cloning shares the pixels; inside a chassis a frame moves between tasks as a pointer.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Frame {
    /// Width, px.
    pub width: usize,
    /// Height, px.
    pub height: usize,
    /// `width * height` grey values, first row first.
    #[serde(with = "pixel_bytes")]
    pub pixels: Arc<[u8]>,
    /// When the exposure ended, since the start of the app.
    pub stamp: Duration,
    /// Counts the frames of this source from 0.
    pub number: u64,
}

impl Frame {
    /// The grey value at column `u` and row `v`, or `None` outside the picture.
    #[must_use]
    pub fn get(&self, u: usize, v: usize) -> Option<u8> {
        if u >= self.width {
            return None;
        }
        self.pixels.get(v.checked_mul(self.width)? + u).copied()
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
}

/// Pixels on the wire, between chassis: their bytes.
mod pixel_bytes {
    use super::{Arc, Deserialize, Serialize};

    pub(super) fn serialize<S: serde::Serializer>(
        pixels: &Arc<[u8]>,
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        pixels.as_ref().serialize(serializer)
    }

    pub(super) fn deserialize<'de, D: serde::Deserializer<'de>>(
        deserializer: D,
    ) -> Result<Arc<[u8]>, D::Error> {
        Vec::<u8>::deserialize(deserializer).map(Arc::from)
    }
}

//! What a picture is and where pictures come from. This module names no simulator.
//!
//! Pixel centres are at whole numbers, the first pixel is (0, 0), u runs right and v down.

use std::time::Duration;

use ctos::Blob;
use serde::{Deserialize, Serialize};

/// A grey picture, 8 bit, row after row.
///
/// Cloning shares the pixels. Inside a chassis a frame moves between tasks as a pointer; between chassis that
/// share memory its pixels are read where they stand.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Frame {
    /// Width, px.
    pub width: usize,
    /// Height, px.
    pub height: usize,
    /// `width * height` grey values, first row first.
    pub pixels: Blob,
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

//! Pictures as files, for people to look at.

use std::path::{Path, PathBuf};

/// Why a picture could not be written.
#[derive(Debug, thiserror::Error)]
#[error("cannot write the picture `{}`: {reason}", path.display())]
pub struct PictureError {
    path: PathBuf,
    reason: image::ImageError,
}

/// Writes `width * height` grey values, first row first, as a PNG.
///
/// # Errors
/// When the file cannot be written or the number of values does not fit.
pub fn write_png(
    path: &Path,
    width: usize,
    height: usize,
    pixels: &[u8],
) -> Result<(), PictureError> {
    let side = |length: usize| u32::try_from(length).unwrap_or(u32::MAX);
    // The library panics on a wrong number of values, so that is ruled out first.
    let result = if width.checked_mul(height) == Some(pixels.len()) {
        image::save_buffer(
            path,
            pixels,
            side(width),
            side(height),
            image::ExtendedColorType::L8,
        )
    } else {
        Err(image::ImageError::Parameter(
            image::error::ParameterError::from_kind(
                image::error::ParameterErrorKind::DimensionMismatch,
            ),
        ))
    };
    result.map_err(|reason| PictureError {
        path: path.to_owned(),
        reason,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_reads_back_as_written_and_a_wrong_size_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        write_png(&path, 3, 2, &[0, 50, 100, 150, 200, 255]).unwrap();
        let read = image::open(&path).unwrap().to_luma8();
        assert_eq!(read.dimensions(), (3, 2));
        assert_eq!(read.into_raw(), [0, 50, 100, 150, 200, 255]);
        assert!(write_png(&path, 3, 3, &[0; 6]).is_err());
    }
}

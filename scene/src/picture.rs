//! Small pictures for viewers.

/// No side of a picture for viewers is longer, px.
pub const MOST_SIDE: usize = 320;

/// A grey picture of `width` by `height` px whose sides are at most `most` long: each of its pixels is the mean of a square
/// of so many pixels as are needed. What is left over at the right and at the bottom is left out. `None` when `pixels` are
/// not as many as width and height say, or when nothing is left.
#[must_use]
pub fn thinned(
    (width, height): (usize, usize),
    pixels: &[u8],
    most: usize,
) -> Option<([u32; 2], Vec<u8>)> {
    if most == 0 || width.checked_mul(height)? != pixels.len() {
        return None;
    }
    let by = width.max(height).div_ceil(most).max(1);
    let (columns, rows) = (width / by, height / by);
    if columns == 0 || rows == 0 {
        return None;
    }
    let size = [u32::try_from(columns).ok()?, u32::try_from(rows).ok()?];
    if by == 1 {
        return Some((size, pixels.to_vec()));
    }
    let count = u32::try_from(by * by).ok()?;
    let mut small = Vec::with_capacity(columns * rows);
    let mut sums = vec![0_u32; columns];
    for band in pixels.chunks_exact(width * by) {
        sums.fill(0);
        for row in band.chunks_exact(width) {
            for (sum, square) in sums.iter_mut().zip(row.chunks_exact(by)) {
                *sum += square.iter().map(|value| u32::from(*value)).sum::<u32>();
            }
        }
        // A mean of bytes is a byte.
        small.extend(sums.iter().map(|sum| ((sum + count / 2) / count) as u8));
    }
    Some((size, small))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_small_picture_has_the_means_of_its_squares_and_fits() {
        let pixels: Vec<u8> = (0..7 * 5).map(|at| at as u8).collect();
        let (size, small) = thinned((7, 5), &pixels, 4).unwrap();
        assert_eq!(size, [3, 2]);
        // (0 + 1 + 7 + 8) / 4, and so on to the right and down.
        assert_eq!(small, [4, 6, 8, 18, 20, 22]);
        assert_eq!(thinned((7, 5), &pixels, 7).unwrap().1, pixels);
    }

    #[test]
    fn what_is_no_picture_or_leaves_nothing_is_none() {
        assert_eq!(thinned((2, 2), &[0; 3], 4), None);
        assert_eq!(thinned((usize::MAX, 2), &[0; 3], 4), None);
        assert_eq!(thinned((0, 0), &[], 4), None);
        assert_eq!(thinned((9, 1), &[0; 9], 3), None);
        assert_eq!(thinned((2, 2), &[0; 4], 0), None);
    }
}

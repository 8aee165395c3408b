//! Samples of any depth as bytes.

/// The `count` samples of `bits` (1, 2, 4, 8) that stand in a row, the first in the highest bits.
pub(crate) fn unpacked(row: &[u8], bits: usize, count: usize) -> impl Iterator<Item = u8> + '_ {
    let per_byte = 8 / bits.clamp(1, 8);
    let mask = u8::MAX >> (8 - bits.clamp(1, 8));
    let samples = row.iter().flat_map(move |byte| {
        (0..per_byte).map(move |nth| (byte >> (8 - bits * (nth + 1))) & mask)
    });
    samples.take(count)
}

/// A sample of 0 to `most` as one of 0 to 255, rounded.
pub(crate) fn scaled(sample: u32, most: u32) -> u8 {
    let most = u64::from(most.max(1));
    u8::try_from((u64::from(sample) * 255 + most / 2) / most).unwrap_or(u8::MAX)
}

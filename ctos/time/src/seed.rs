//! How one seed becomes many: a number for each thing that is drawn. Knows nothing of what draws.

/// Mixes a seed with words (FNV-1a over their bytes), the same on every machine.
#[must_use]
pub fn mix(seed: u64, words: &[&str]) -> u64 {
    let mut hash = 0xcbf2_9ce4_8422_2325_u64 ^ seed;
    for byte in words.iter().flat_map(|word| word.bytes().chain([0])) {
        hash = (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
    }
    hash ^ seed.rotate_left(32)
}

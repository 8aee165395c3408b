//! The orientation in an Exif segment (Exif 2.3, tag 0x0112).

/// The orientation of a segment's content, where it is not 1, "as stored". What cannot be read says nothing.
pub(super) fn orientation(content: &[u8]) -> Option<u16> {
    let tiff = content.strip_prefix(b"Exif\0\0")?;
    let little = match tiff.get(..2)? {
        b"II" => true,
        b"MM" => false,
        _ => return None,
    };
    let u16_at = |at: usize| {
        let two = *tiff.get(at..)?.first_chunk::<2>()?;
        Some(if little {
            u16::from_le_bytes(two)
        } else {
            u16::from_be_bytes(two)
        })
    };
    let u32_at = |at: usize| {
        let four = *tiff.get(at..)?.first_chunk::<4>()?;
        let number = if little {
            u32::from_le_bytes(four)
        } else {
            u32::from_be_bytes(four)
        };
        usize::try_from(number).ok()
    };
    let folder = u32_at(4)?;
    let entries = usize::from(u16_at(folder)?);
    for entry in 0..entries {
        let at = folder.checked_add(2 + 12 * entry)?;
        if u16_at(at)? == 0x0112 {
            let found = u16_at(at.checked_add(8)?)?;
            return (found != 1).then_some(found);
        }
    }
    None
}

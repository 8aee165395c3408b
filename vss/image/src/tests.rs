//! Pictures that others wrote, pictures made by hand from the descriptions of their formats, and every way of being wrong.

use ::png::{BitDepth, ColorType, Encoder};
use proptest::prelude::*;

use super::*;

fn kept(name: &str) -> Vec<u8> {
    std::fs::read(format!(
        "{}/tests/corpus/{name}",
        env!("CARGO_MANIFEST_DIR")
    ))
    .unwrap()
}

/// What the kept pictures show: the program that wrote them was given these values.
fn shown(format: Format, u: usize, v: usize) -> Vec<u8> {
    let (u, v) = (i32::try_from(u).unwrap(), i32::try_from(v).unwrap());
    let values = match format {
        Format::Grey8 => vec![40 + 4 * u + 3 * v],
        Format::Rgb8 => vec![40 + 4 * u, 60 + 6 * v, 200 - 3 * u - 2 * v],
    };
    let values = values.into_iter().map(|value| value.clamp(0, 255));
    values.map(|value| u8::try_from(value).unwrap()).collect()
}

/// The largest difference from what a kept picture shows.
fn difference(picture: &Picture) -> u8 {
    let places = (0..picture.height).flat_map(|v| (0..picture.width).map(move |u| (u, v)));
    let expected = places.flat_map(|(u, v)| shown(picture.format, u, v));
    let pairs = picture.pixels.iter().zip(expected);
    pairs
        .map(|(found, expected)| found.abs_diff(expected))
        .max()
        .unwrap()
}

#[test]
fn lossless_pictures_of_another_program_are_read_exactly() {
    for (name, format) in [
        ("png/grey.png", Format::Grey8),
        ("png/rgb.png", Format::Rgb8),
        ("png/wide.png", Format::Grey8),
        ("bmp/grey.bmp", Format::Grey8),
        ("bmp/rgb.bmp", Format::Rgb8),
        ("pnm/grey.pgm", Format::Grey8),
        ("pnm/rgb.ppm", Format::Rgb8),
    ] {
        let picture = read(&kept(name)).unwrap();
        assert_eq!((picture.width, picture.height), (7, 5), "{name}");
        assert_eq!(picture.format, format, "{name}");
        assert_eq!(difference(&picture), 0, "{name}");
        let notes = if name.contains("wide") {
            vec![Note::Scaled(65_535)]
        } else {
            vec![]
        };
        assert_eq!(picture.notes, notes, "{name}");
    }
}

const JPEGS: [(&str, Format, u8); 8] = [
    ("grey", Format::Grey8, 3),
    ("grey-progressive", Format::Grey8, 3),
    ("rgb-444", Format::Rgb8, 5),
    ("rgb-444-progressive-restart", Format::Rgb8, 5),
    // Colours are stored for every second pixel here.
    ("rgb-422", Format::Rgb8, 16),
    ("rgb-440", Format::Rgb8, 16),
    ("rgb-420-restart", Format::Rgb8, 16),
    ("rgb-420-progressive", Format::Rgb8, 16),
];

#[test]
fn every_kind_of_jpeg_of_another_program_is_read_within_its_losses() {
    for (name, format, most) in JPEGS {
        let picture = read(&kept(&format!("jpeg/{name}.jpg"))).unwrap();
        assert_eq!((picture.width, picture.height), (37, 19), "{name}");
        assert_eq!(picture.format, format, "{name}");
        let found = difference(&picture);
        assert!(found <= most, "{name}: {found}");
    }
}

#[test]
fn a_jpeg_that_is_cut_anywhere_is_an_error_even_with_an_end_put_behind_it() {
    for (name, ..) in JPEGS {
        let bytes = kept(&format!("jpeg/{name}.jpg"));
        assert!(bytes.ends_with(&[0xff, 0xd9]));
        for end in 0..bytes.len() - 1 {
            assert!(read(&bytes[..end]).is_err(), "{name}, {end}");
            if end < bytes.len() - 2 {
                let ended = [&bytes[..end], &[0xff, 0xd9]].concat();
                assert!(read(&ended).is_err(), "{name}, {end} and an end");
            }
        }
        let error = read(&bytes[..bytes.len() - 2]).unwrap_err();
        assert!(
            matches!(error, ReadError::Truncated { .. }),
            "{name}: {error}"
        );
        // What comes after the end is somebody else's.
        let more = [&bytes[..], b"a preview"].concat();
        assert_eq!(read(&more), read(&bytes));
    }
}

#[test]
fn the_orientation_of_a_jpeg_is_told_and_not_obeyed() {
    let bytes = kept("jpeg/grey.jpg");
    let plain = read(&bytes).unwrap();
    assert!(plain.notes.is_empty());
    for (order, orientation) in [("II", 6), ("MM", 3), ("II", 1)] {
        let two = |number: u16| match order {
            "II" => number.to_le_bytes(),
            _ => number.to_be_bytes(),
        };
        let four = |number: u32| match order {
            "II" => number.to_le_bytes(),
            _ => number.to_be_bytes(),
        };
        let mut content = b"Exif\0\0".to_vec();
        content.extend_from_slice(order.as_bytes());
        content.extend(two(42));
        content.extend(four(8));
        content.extend(two(1));
        content.extend([two(0x0112), two(3)].concat());
        content.extend(four(1));
        content.extend([two(orientation), two(0)].concat());
        let mut tagged = bytes[..2].to_vec();
        tagged.extend([0xff, 0xe1]);
        tagged.extend(u16::try_from(content.len() + 2).unwrap().to_be_bytes());
        tagged.extend(content);
        tagged.extend(&bytes[2..]);
        let found = read(&tagged).unwrap();
        assert_eq!(found.pixels, plain.pixels);
        let expected = (orientation != 1).then_some(Note::Orientation(orientation));
        assert_eq!(found.notes, Vec::from_iter(expected));
    }
}

/// A JPEG up to its frame, which has so many bits, rows, columns and components.
fn frame(marker: u8, bits: u8, (width, height): (u16, u16), components: u8) -> Vec<u8> {
    let mut bytes = vec![0xff, 0xd8, 0xff, marker, 0, 8 + 3 * components, bits];
    bytes.extend(height.to_be_bytes());
    bytes.extend(width.to_be_bytes());
    bytes.push(components);
    bytes.extend((1..=components).flat_map(|id| [id, 0x11, 0]));
    bytes
}

#[test]
fn other_kinds_of_jpeg_are_refused_by_name() {
    let says = |bytes: &[u8], what: &str| {
        let text = read(bytes).unwrap_err().to_string();
        assert!(text.contains(what), "{text}");
    };
    says(&frame(0xc0, 8, (8, 8), 4), "four colours (CMYK");
    says(&frame(0xc1, 12, (8, 8), 1), "12 bits a sample");
    says(&frame(0xc9, 8, (8, 8), 1), "arithmetic");
    says(&frame(0xc0, 8, (0xffff, 0xffff), 3), "65535 x 65535");
    says(&frame(0xc0, 8, (8, 0), 1), "8 x 0");
    says(&frame(0xc0, 8, (8, 8), 1), "end-of-image marker is missing");
}

fn encoded(color: ColorType, depth: BitDepth, data: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = Encoder::new(&mut bytes, 2, 1);
    encoder.set_color(color);
    encoder.set_depth(depth);
    if color == ColorType::Indexed {
        encoder.set_palette(&[0, 0, 0, 250, 240, 230][..]);
    }
    let mut writer = encoder.write_header().unwrap();
    writer.write_image_data(data).unwrap();
    writer.finish().unwrap();
    bytes
}

#[test]
fn a_written_png_reads_back_as_written_and_a_wrong_size_is_an_error() {
    let pixels = [0, 50, 100, 150, 200, 255];
    let mut bytes = Vec::new();
    png::write(&mut bytes, 3, 2, &pixels).unwrap();
    let found = read(&bytes).unwrap();
    assert_eq!((found.width, found.height), (3, 2));
    assert_eq!(
        (found.format, &found.pixels[..]),
        (Format::Grey8, &pixels[..])
    );
    let mut bytes = Vec::new();
    png::write_as(&mut bytes, 2, 1, Format::Rgb8, &pixels).unwrap();
    assert_eq!(read(&bytes).unwrap().pixels, pixels);
    for (width, height) in [(3, 3), (0, 0), (usize::MAX, 1)] {
        assert!(png::write(Vec::new(), width, height, &pixels).is_err());
    }
}

#[test]
fn every_kind_of_png_is_read_and_becomes_grey_by_its_luminance() {
    use BitDepth::{Eight, Four, One, Sixteen, Two};
    use ColorType::{Grayscale, GrayscaleAlpha, Indexed, Rgb, Rgba};
    let cases: [(ColorType, BitDepth, &[u8], [u8; 2]); 10] = [
        (Grayscale, One, &[0b0100_0000], [0, 255]),
        (Grayscale, Two, &[0b0110_0000], [85, 170]),
        (Grayscale, Four, &[0x1f], [17, 255]),
        (Grayscale, Sixteen, &[255, 255, 0, 129], [255, 1]),
        (GrayscaleAlpha, Eight, &[10, 0, 20, 255], [10, 20]),
        (Rgb, Eight, &[255, 0, 0, 0, 255, 0], [54, 182]),
        (Rgb, Sixteen, &[255; 12], [255, 255]),
        (Rgba, Eight, &[0, 0, 255, 9, 77, 77, 77, 0], [18, 77]),
        (Indexed, One, &[0b0100_0000], [0, 241]),
        (Indexed, Eight, &[1, 0], [241, 0]),
    ];
    for (color, depth, data, expected) in cases {
        let found = read(&encoded(color, depth, data)).unwrap();
        let transparent = matches!(color, GrayscaleAlpha | Rgba);
        assert_eq!(found.notes.contains(&Note::Transparency), transparent);
        assert_eq!(
            found.notes.contains(&Note::Scaled(65_535)),
            depth == Sixteen
        );
        assert_eq!(found.into_grey(), expected, "{color:?} {depth:?}");
    }
}

/// The same PNG with right checksums of its chunks.
pub(crate) fn with_mended_checksums(bytes: &[u8]) -> Vec<u8> {
    let mut mended = bytes.to_vec();
    let mut at = 8;
    while let Some(length) = bytes.get(at..).and_then(|rest| rest.first_chunk()) {
        let length = usize::try_from(u32::from_be_bytes(*length)).unwrap();
        let end = at + 8 + length.min(1 << 20);
        let Some(chunk) = bytes.get(at + 4..end) else {
            break;
        };
        let sum = chunk.iter().fold(u32::MAX, |sum, byte| {
            (0..8).fold(sum ^ u32::from(*byte), |sum, _| {
                (sum >> 1) ^ (0xedb8_8320 * (sum & 1))
            })
        });
        if let Some(place) = mended.get_mut(end..end + 4) {
            place.copy_from_slice(&(!sum).to_be_bytes());
        }
        at = end + 4;
    }
    mended
}

#[test]
fn a_png_with_any_wrong_byte_or_missing_end_is_an_error() {
    let whole = encoded(ColorType::Rgb, BitDepth::Eight, &[1; 6]);
    assert_eq!(with_mended_checksums(&whole), whole);
    for end in 0..whole.len() {
        assert!(read(&whole[..end]).is_err(), "{end}");
    }
    for at in 0..whole.len() {
        let mut bytes = whole.clone();
        bytes[at] ^= 0x10;
        assert!(read(&bytes).is_err(), "{at}");
    }
    // The checksum of the samples counts, too, and not only that of their chunk.
    let at = whole.windows(4).position(|four| four == b"IEND").unwrap() - 9;
    let mut bytes = whole.clone();
    bytes[at] ^= 1;
    assert!(read(&with_mended_checksums(&bytes)).is_err());
}

#[test]
fn a_colour_that_a_palette_lacks_is_an_error_with_its_pixel() {
    let bytes = encoded(ColorType::Indexed, BitDepth::Eight, &[0, 2]);
    let text = read(&bytes).unwrap_err().to_string();
    assert!(
        text.contains("pixel 1, 0 has colour 2 of a palette of 2 colours"),
        "{text}"
    );
    let text = read(&bmp(8, (2, -1), 0, &[[0; 4], [9; 4]], &[0, 3, 0, 0]))
        .unwrap_err()
        .to_string();
    assert!(
        text.contains("pixel 1, 0 has colour 3 of a palette of 2 colours"),
        "{text}"
    );
}

#[test]
fn files_of_a_few_bytes_that_claim_to_be_huge_are_refused_before_memory_is_taken() {
    let mut png = Vec::new();
    let header = Encoder::new(&mut png, 1 << 30, 1 << 30).write_header();
    header
        .unwrap()
        .write_chunk(::png::chunk::IDAT, &[])
        .unwrap();
    let huge = [
        png,
        frame(0xc0, 8, (65_500, 65_500), 1),
        bmp(24, (i32::MAX, i32::MIN), 0, &[], &[]),
        b"P5 4294967297 4294967297 255\n".to_vec(),
        b"P1 99999999999999999999999 1 ".to_vec(),
    ];
    for bytes in huge {
        let error = read(&bytes).unwrap_err();
        assert!(matches!(error, ReadError::Large { .. }), "{error}");
        assert!(error.to_string().contains("make it smaller"));
    }
}

/// A BMP with a header of 40 bytes.
fn bmp(
    bits: u16,
    (width, height): (i32, i32),
    method: u32,
    palette: &[[u8; 4]],
    data: &[u8],
) -> Vec<u8> {
    let mut bytes = b"BM".to_vec();
    let begins = 54 + 4 * u32::try_from(palette.len()).unwrap();
    for number in [0, 0, begins, 40] {
        bytes.extend(number.to_le_bytes());
    }
    bytes.extend([width.to_le_bytes(), height.to_le_bytes()].concat());
    bytes.extend([1_u16.to_le_bytes(), bits.to_le_bytes()].concat());
    let used = if bits > 8 {
        0
    } else {
        u32::try_from(palette.len()).unwrap()
    };
    for number in [method, 0, 0, 0, used, 0] {
        bytes.extend(number.to_le_bytes());
    }
    bytes.extend(palette.concat());
    bytes.extend(data);
    bytes
}

const COLOURS: [[u8; 4]; 4] = [[1, 2, 3, 0], [4, 5, 6, 0], [7, 8, 9, 0], [10, 11, 12, 0]];

/// Pictures with run lengths of 8 and 4 bits.
pub(crate) fn runs() -> Vec<Vec<u8>> {
    // Of the lower row two runs, the upper one as it is: 1 1 2 and 3 2 1 0.
    let eight = [2, 1, 2, 2, 0, 0, 0, 4, 3, 2, 1, 0, 0, 1];
    let four = [2, 0x11, 2, 0x22, 0, 0, 0, 4, 0x32, 0x10, 0, 1];
    vec![
        bmp(8, (4, 2), 1, &COLOURS, &eight),
        bmp(4, (4, 2), 2, &COLOURS, &four),
    ]
}

#[test]
fn every_kind_of_bmp_is_read() {
    let of = |indices: &[usize]| -> Vec<u8> {
        let colours = indices.iter().flat_map(|index| {
            let [blue, green, red, _] = COLOURS[*index];
            [red, green, blue]
        });
        colours.collect()
    };
    // One bit: the lower row comes first, and a negative height turns that round.
    let rows = [0b0100_0000, 0, 0, 0, 0b1000_0000, 0, 0, 0];
    let upwards = read(&bmp(1, (2, 2), 0, &COLOURS[..2], &rows)).unwrap();
    assert_eq!(upwards.pixels, of(&[1, 0, 0, 1]));
    let downwards = read(&bmp(1, (2, -2), 0, &COLOURS[..2], &rows)).unwrap();
    assert_eq!(downwards.pixels, of(&[0, 1, 1, 0]));
    // Four and eight bits.
    let four = bmp(4, (3, 1), 0, &COLOURS, &[0x12, 0x30, 0, 0]);
    assert_eq!(read(&four).unwrap().pixels, of(&[1, 2, 3]));
    let eight = bmp(8, (3, 1), 0, &COLOURS, &[3, 0, 2, 0]);
    assert_eq!(read(&eight).unwrap().pixels, of(&[3, 0, 2]));
    // A palette of greys makes a grey picture.
    let grey = read(&bmp(8, (2, 1), 0, &[[7; 4], [9; 4]], &[1, 0, 0, 0])).unwrap();
    assert_eq!(
        (grey.format, &grey.pixels[..]),
        (Format::Grey8, &[9, 7][..])
    );
    // Run lengths.
    for bytes in runs() {
        assert_eq!(read(&bytes).unwrap().pixels, of(&[3, 2, 1, 0, 1, 1, 2, 2]));
    }
    // 16 bits: five of each colour, or as fields say; the fields come before the pixels.
    let sixteen = read(&bmp(16, (2, 1), 0, &[], &[0x1f, 0x7c, 0xe0, 0x03])).unwrap();
    assert_eq!(sixteen.pixels, [255, 0, 255, 0, 255, 0]);
    let masks = [[0, 0xf8, 0, 0], [0xe0, 0x07, 0, 0], [0x1f, 0, 0, 0]];
    let fields = read(&bmp(16, (2, 1), 3, &masks, &[0, 0x80, 0x10, 0x04])).unwrap();
    assert_eq!(fields.pixels, [132, 0, 0, 0, 130, 132]);
    // 24 and 32.
    let colour = bmp(24, (1, 2), 0, &[], &[3, 2, 1, 0, 6, 5, 4]);
    assert_eq!(read(&colour).unwrap().pixels, [4, 5, 6, 1, 2, 3]);
    let colour = bmp(32, (2, 1), 0, &[], &[3, 2, 1, 0, 6, 5, 4, 0]);
    assert_eq!(read(&colour).unwrap().pixels, [1, 2, 3, 4, 5, 6]);
}

#[test]
fn a_bmp_that_is_cut_anywhere_is_an_error() {
    let mut whole = runs();
    whole.push(bmp(24, (1, 2), 0, &[], &[3, 2, 1, 0, 6, 5, 4]));
    whole.push(bmp(1, (2, 2), 0, &COLOURS[..2], &[0; 5]));
    for bytes in whole {
        assert!(read(&bytes).is_ok());
        for end in 0..bytes.len() {
            assert!(read(&bytes[..end]).is_err(), "{end}");
        }
    }
}

#[test]
fn what_is_wrong_in_a_bmp_is_told() {
    let says = |bytes: &[u8], what: &str| {
        let text = read(bytes).unwrap_err().to_string();
        assert!(text.contains(what), "{text}");
    };
    says(
        &bmp(8, (4, 1), 1, &COLOURS, &[5, 0, 0, 1]),
        "a run leaves the picture",
    );
    says(
        &bmp(8, (4, 1), 1, &COLOURS, &[3, 0, 0, 1]),
        "leave 1 pixels without a colour",
    );
    says(
        &bmp(8, (4, -1), 1, &COLOURS, &[4, 0, 0, 1]),
        "compression 1",
    );
    says(&bmp(24, (4, 1), 4, &[], &[0; 12]), "compression 4");
    says(&bmp(2, (4, 1), 0, &COLOURS, &[0; 4]), "2 bits a pixel");
    says(&bmp(24, (-4, 1), 0, &[], &[0; 12]), "width is -4");
    says(&bmp(24, (0, 1), 0, &[], &[]), "0 x 1");
    says(&bmp(1, (2, 1), 0, &COLOURS, &[0; 4]), "claims 4 colours");
    let masks = [[0x0f, 0x0f, 0, 0], [0xe0, 0x07, 0, 0], [0x1f, 0, 0, 0]];
    says(&bmp(16, (2, 1), 3, &masks, &[0; 4]), "no field of bits");
}

#[test]
fn every_kind_of_pnm_is_read_with_comments_and_either_end_of_line() {
    let cases: [(&[u8], Format, &[u8]); 13] = [
        (
            b"P1\n# a comment\n3 2\n0 1 0\n1 1 0\n",
            Format::Grey8,
            &[255, 0, 255, 0, 0, 255],
        ),
        (b"P1 3 2 010110", Format::Grey8, &[255, 0, 255, 0, 0, 255]),
        (
            b"P2 # width\n2 # height\n1\n15\n0 15 ",
            Format::Grey8,
            &[0, 255],
        ),
        (b"P2\r\n2 1\r\n255\r\n7\r\n8\r\n", Format::Grey8, &[7, 8]),
        (b"P3 1 1 255 1 2 3", Format::Rgb8, &[1, 2, 3]),
        (
            b"P4 9 2\n\x80\x80\x00\x7f",
            Format::Grey8,
            &[
                0, 255, 255, 255, 255, 255, 255, 255, 0, 255, 255, 255, 255, 255, 255, 255, 255,
                255,
            ],
        ),
        (b"P5 2 1 255\n\n#", Format::Grey8, &[10, 35]),
        (b"P5 2 1 255\r\n\n#", Format::Grey8, &[10, 35]),
        // Here the second character of the end of line is a pixel, for else one would be missing.
        (b"P5 2 1 255\r\n#", Format::Grey8, &[10, 35]),
        (b"P5 2 1 100\n\x32\x64", Format::Grey8, &[128, 255]),
        (b"P5 2 1 65535\n\x00\x81\xff\xff", Format::Grey8, &[1, 255]),
        (b"P5 1 1 1023\n\x02\x00", Format::Grey8, &[128]),
        (b"P6 1 1 255\n\x01\x02\x03\n", Format::Rgb8, &[1, 2, 3]),
    ];
    for (bytes, format, pixels) in cases {
        let found = read(bytes).unwrap();
        let name = bytes.escape_ascii();
        assert_eq!(
            (found.format, &found.pixels[..]),
            (format, pixels),
            "{name}"
        );
        let scaled = [15, 100, 1023, 65_535].iter().find(|most| {
            bytes
                .escape_ascii()
                .to_string()
                .contains(&format!("{most}\\n"))
        });
        assert_eq!(
            found.notes,
            Vec::from_iter(scaled.map(|most| Note::Scaled(*most))),
            "{name}"
        );
    }
}

#[test]
fn a_wrong_pnm_is_an_error_that_says_what_is_wrong() {
    for (bytes, what) in [
        (&b"P5"[..], "ends after its first two bytes"),
        (b"P5 2", "before its height"),
        (b"P5 2 1 255", "ends after its header"),
        (b"P5 2 1 255\n1", "samples are 2 bytes, and 1 are there"),
        (b"P5 2 1 255\n123", "1 bytes come after its 2 x 1 pixels"),
        (b"P5 2 1 0\n12", "not within 1 to 65535"),
        (b"P5 2 1 65536\n12", "not within 1 to 65535"),
        (
            b"P5 2 1 10\n\x01\x0b",
            "sample 11 of pixel 1, 0 is above its largest one, 10",
        ),
        (
            b"P5 a 1 10\n12",
            "`a` stands at byte 3 where a number should (width)",
        ),
        (b"P5 -2 1 10\n12", "`-` stands at byte 3"),
        (b"P5 0 1 255\n", "0 x 1 pixels"),
        (b"P2 2 1 255\n7", "1 of its 2 samples are there"),
        (b"P2 2 1 255\n7 x", "`x` stands at byte 13"),
        (b"P1 2 1 02", "sample 2 of pixel 1, 0"),
        (b"P3 1 1 255 1 2 3 4", "come after its 1 x 1 pixels"),
        (b"P7\nWIDTH 1\n", "PAM"),
        (b"PF\n1 1\n", "none of the formats"),
        (b"GIF89a", "`GIF89a`"),
        (b"", "empty"),
    ] {
        let text = read(bytes).unwrap_err().to_string();
        assert!(text.contains(what), "{}: {text}", bytes.escape_ascii());
    }
}

proptest! {
    #[test]
    fn a_greymap_of_any_depth_and_size_reads_back_scaled(
        width in 1..9_usize,
        samples in proptest::collection::vec(0..=u16::MAX, 1..40),
        most in 1..=u16::MAX,
    ) {
        let height = samples.len() / width;
        prop_assume!(height > 0);
        let samples: Vec<u16> = samples[..width * height].iter().map(|one| one % most).collect();
        let mut plain = format!("P2 {width} {height} {most}\n");
        let mut binary = format!("P5 {width} {height} {most}\n").into_bytes();
        for sample in &samples {
            plain += &format!("{sample} ");
            let bytes = sample.to_be_bytes();
            binary.extend(if most > 255 { &bytes[..] } else { &bytes[1..] });
        }
        let found = read(&binary).unwrap();
        prop_assert_eq!(&found, &read(plain.as_bytes()).unwrap());
        for (found, sample) in found.pixels.iter().zip(&samples) {
            let exact = f64::from(*sample) * 255.0 / f64::from(most);
            prop_assert!((f64::from(*found) - exact).abs() <= 0.5 + 1e-9);
        }
    }
}

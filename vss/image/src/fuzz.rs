//! Every reader, fed with mutations of a kept corpus: any bytes are a whole picture or an error. The driver is `mutate`'s.

use mutate::Mutator;

use crate::{PIXELS_MOST, Picture, ReadError, read, tests::with_mended_checksums};

fn play(name: &str, own: Vec<Vec<u8>>, target: impl Fn(&[u8])) {
    let mutator = Mutator {
        corpus: concat!(env!("CARGO_MANIFEST_DIR"), "/tests/corpus").into(),
        words: &[
            "BM", "P1\n", "P6\r\n", "# a\n", " 65535\n", "IDAT", "IEND", "PLTE", "tRNS", "acTL",
            "Exif\0\0",
        ],
        longest: 4096,
        seconds: 2.0,
        targets: 5,
    };
    mutator.play(name, own, target);
}

/// What is read is whole.
fn whole(found: Result<Picture, ReadError>) {
    match found {
        Ok(picture) => {
            let pixels = picture.width * picture.height;
            assert!((1..=PIXELS_MOST).contains(&pixels));
            assert_eq!(picture.pixels.len(), pixels * picture.format.bytes());
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    }
}

#[test]
fn png_takes_any_bytes() {
    play("png", Vec::new(), |bytes| {
        whole(read(bytes));
        // Few mutations come past the checksums.
        whole(read(&with_mended_checksums(bytes)));
    });
}

#[test]
fn jpeg_takes_any_bytes() {
    play("jpeg", Vec::new(), |bytes| whole(read(bytes)));
}

#[test]
fn bmp_takes_any_bytes() {
    play("bmp", crate::tests::runs(), |bytes| whole(read(bytes)));
}

#[test]
fn pnm_takes_any_bytes() {
    let plain = [
        "P1\n2 2\n0110",
        "P2 2 1 9\n1 9",
        "P3\n1 1\n255 1 2 3",
        "P4 9 1\n\u{1}\u{1}",
    ];
    let own = plain.map(|text| text.as_bytes().to_vec());
    play("pnm", own.into(), |bytes| whole(read(bytes)));
}

#[test]
fn streams_take_any_bytes() {
    use crate::{
        Format,
        stream::{Kind, Stream},
    };
    let mut pngs = Vec::new();
    for grey in [1, 2] {
        crate::png::write(&mut pngs, 2, 1, &[grey, 3]).unwrap();
    }
    let own = vec![
        pngs,
        b"P5 2 1 255\n12 P6\r\n1 1\r\n255\r\n123P4 9 1\n12".to_vec(),
    ];
    let raw = Kind::Raw {
        width: 3,
        height: 2,
        format: Format::Rgb8,
    };
    play("stream", own, |bytes| {
        for kind in [Kind::Png, Kind::Pnm, raw] {
            for picture in Stream::new(bytes, kind).flatten() {
                whole(Ok(picture));
            }
        }
    });
}

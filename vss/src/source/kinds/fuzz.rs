//! What frame sources read, fed with mutations: tables of stamps, names of pictures, records of apps, and the records of snapshot
//! buffers. Any bytes are whole frames or an error. The driver is `mutate`'s; streams of pictures are fed in `vss-image`.

use std::{fs, path::Path, time::Duration};

use base64::{Engine as _, engine::general_purpose::STANDARD};
use ctos::message::Command as _;
use mutate::Mutator;

use super::{
    directory::{Listed, from_table, stamp_of},
    recording::{frame_of, frames},
};
use crate::{
    command::SnapNow,
    frame::{
        Frame,
        buffer::{FLOATS, frame},
    },
};

fn play(name: &str, own: Vec<Vec<u8>>, target: impl Fn(&[u8])) {
    let mutator = Mutator {
        corpus: concat!(env!("CARGO_MANIFEST_DIR"), "/tests/corpus").into(),
        words: &[
            "nan", "-1", "1e300", ",", "\n", "# ", "../", "\u{feff}", "camera ", "link ", "\"ok\"",
            "/reply/",
        ],
        longest: 1 << 16,
        seconds: 2.0,
        targets: 4,
    };
    mutator.play(name, own, target);
}

#[test]
fn tables_of_stamps_take_any_text() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["a.pgm", "b.pgm"] {
        fs::write(folder.path().join(name), b"P5 1 1 255 1").unwrap();
    }
    let own = "name,stamp_s\n# first\na.pgm,0.5\nb.pgm,7\n";
    play("stamps", vec![own.into()], |bytes| {
        fs::write(folder.path().join("stamps.csv"), bytes).unwrap();
        match from_table(folder.path(), "stamps.csv") {
            Ok(listed) => {
                let stamp = |one: &Listed| one.1.unwrap();
                assert!(listed.is_sorted_by(|one, other| stamp(one) < stamp(other)));
            }
            Err(why) => assert!(why.contains("stamps.csv"), "{why}"),
        }
    });
}

#[test]
fn stamps_in_names_take_any_text() {
    let own = ["left_1.250.png", "1520531832.1.png", "cam0_000123456.pgm"];
    let own = own.map(|name| name.as_bytes().to_vec());
    play("names", own.into(), |bytes| {
        let name = String::from_utf8_lossy(bytes);
        if let Err(why) = stamp_of(Path::new(&*name)) {
            assert!(why.contains("no stamp"), "{why}");
        }
    });
}

/// The kept input is a record of an app with a camera `left`.
#[test]
fn records_take_any_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    let left = Frame {
        camera: "left".to_owned(),
        stamp: Duration::from_millis(40),
        ..Frame::rgb8(2, 1, vec![1, 2, 3, 4, 5, 6])
    };
    let reply = format!(
        r#"{{"code":{},"result":"ok","bytes":"{}"}}"#,
        u32::from(SnapNow::CODE),
        STANDARD.encode(postcard::to_allocvec(&left).unwrap())
    );
    assert_eq!(frame_of(reply.as_bytes()), Some(left));
    let kept = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/corpus/record/app.mcap");
    assert_eq!(frames(Path::new(kept), "left").unwrap().len(), 2);
    play("record", vec![reply.into_bytes()], |bytes| {
        assert!(frame_of(bytes).is_none_or(|frame| frame.is_whole()));
        fs::write(&path, bytes).unwrap();
        match frames(&path, "left") {
            Ok(frames) => assert!(frames.iter().all(Frame::is_whole) && !frames.is_empty()),
            Err(why) => assert!(why.contains("run.mcap"), "{why}"),
        }
    });
}

/// Floats, pixels, and the description of a buffer that another program wrote.
#[test]
fn records_of_buffers_take_any_bytes() {
    let mut floats = [0.0_f64; FLOATS.len()];
    floats[..4].copy_from_slice(&[7.0, 3.0, 2.0, 1.0]);
    floats[12] = 1.0;
    let mut own: Vec<u8> = floats.iter().flat_map(|x| x.to_le_bytes()).collect();
    own.extend([1, 2, 3, 4, 5, 6]);
    own.extend((FLOATS.join("\n") + "\ncamera left\nlink puma.link6\n").as_bytes());
    let parts = |bytes: &[u8]| {
        let (head, rest) = bytes.split_at_checked(8 * FLOATS.len())?;
        let floats: Vec<f64> = head
            .chunks_exact(8)
            .map(|float| f64::from_le_bytes(float.try_into().unwrap()))
            .collect();
        let (pixels, text) = rest.split_at_checked(6)?;
        frame(&String::from_utf8_lossy(text), &floats, pixels.to_vec())
    };
    assert!(parts(&own).is_some_and(|frame| frame.is_whole() && frame.carrier.is_some()));
    play("buffer", vec![own], |bytes| {
        if let Some(frame) = parts(bytes) {
            let _ = (frame.is_whole(), frame.get(1, 1), frame.grey().len());
        }
    });
}

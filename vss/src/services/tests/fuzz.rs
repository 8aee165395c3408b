//! Every reader of tables and of cameras' files, fed with mutations of a good one: any text is an answer of finite numbers or
//! an error. The driver is `mutate`'s; pictures are fed in `vss-image`.

use mutate::Mutator;

use super::*;
use crate::{
    camera_info::{CameraInfo, CameraPose, poses_from_yaml, poses_to_yaml},
    frame::Frame,
};

/// A table of a class: what is set before, what reads it, and a good one. `FILE` is its path.
struct Reader {
    name: &'static str,
    asked: &'static [&'static str],
    good: String,
}

fn reader(name: &'static str, asked: &'static [&'static str], good: &str) -> Reader {
    Reader {
        name,
        asked,
        good: good.to_owned(),
    }
}

fn readers() -> Vec<Reader> {
    let lights = table(&camera(LENS), 14, 0.2, 1);
    let more = |header: &str, again: fn(&str, &str) -> String| {
        let rows = lights.lines().skip(1).map(|row| {
            let pixel: Vec<&str> = row.rsplitn(3, ',').collect();
            again(row, &format!("{},{}", pixel[1], pixel[0]))
        });
        let rows: Vec<String> = rows.collect();
        format!("{header}\n{}\n", rows.join("\n"))
    };
    let poses = "1,0,0,0.1,0,1,0,0,0,0,1,0.5,1,0,0,0,0,1,0,0,0,0,1,0.7\n\
                 0,-1,0,0.1,1,0,0,0,0,0,1,0.5,0,1,0,0,-1,0,0,0,0,0,1,0.7\n\
                 1,0,0,0.1,0,0,-1,0,0,1,0,0.5,1,0,0,0,0,0,1,0,0,-1,0,0.7\n";
    vec![
        reader(
            "resect",
            &["resect CTRL -size 640 480 -sd on", "resect EXEC TMSG FILE"],
            &lights,
        ),
        reader(
            "stereo",
            &["stereo CTRL -size 640 480", "stereo EXEC TMSG FILE"],
            &more("X,Y,Z,uL,vL,uR,vR", |row, pixel| format!("{row},{pixel}")),
        ),
        reader(
            "bundle",
            &[
                "bundle CTRL -size 640 480 -lights on",
                "bundle EXEC TMSG FILE",
            ],
            &more("X,Y,Z,u1,v1,u2,v2", |row, pixel| format!("{row},{pixel}")),
        ),
        reader(
            "pose",
            &[
                "pose CTRL -lens 800 805 322 238 0 0 0 0 0",
                "pose EXEC TMSG FILE",
            ],
            &lights,
        ),
        reader("handeye", &["handeye EXEC TMSG FILE"], poses),
        reader(
            "planecal",
            &[
                "planecal CTRL -size 320 240 -model none",
                "planecal EXEC TMSG FILE",
            ],
            "view,X,Y,u,v\n1,0,0,5,5\n1,0.1,0,90,9\n1,0.1,0.1,95,80\n1,0,0.1,9,82\n2,0,0,9,5\n2,0.1,0,90,19\n",
        ),
        reader(
            "psom",
            &[
                "psom CTRL -train FILE -params 1",
                "psom EXEC value FMSG 1 0.5",
            ],
            "s,x,y\n0,1,2\n1,2,2.5\n2,4,1e3\n",
        ),
        reader(
            "abg",
            &[
                "abg CTRL -lambda 0.5 -period 0.1",
                "abg EXEC TMSG 'filter FILE'",
            ],
            "t,z\n0,1\n0.1,1.2\n0.2,\n0.35,1.1\n",
        ),
        reader(
            "clockfit",
            &["clockfit EXEC TMSG FILE"],
            "0,5.001,5.002,0.003\n1,6.001,6.002,1.003\n2,7.001,7.002,2.004\n3,8.001,8.002,3.003\n",
        ),
        reader(
            "laser plane",
            &["laser EXEC TMSG 'plane FILE'"],
            "X,Y,Z\n0,0,1\n1,0,1\n0,1,1\n1,1,1.001\n",
        ),
        reader(
            "laser calibrate",
            &["laser EXEC TMSG 'calibrate FILE'"],
            "a,b,X,Y,Z\n0,0,0,0,1\n0.1,0,0.2,0,1\n0,0.1,0,0.2,1\n0.1,0.1,0.2,0.2,1\n-0.1,0.1,-0.2,0.2,1\n",
        ),
        reader(
            "colour",
            &["colour CTRL -train FILE"],
            "class,r,g,b\nred,200,10,10\nred,190,20,10\nblue,10,10,200\nblue,20,10,190\n",
        ),
        reader(
            "colour watch",
            &["colour CTRL -watch FILE"],
            "u,v,radius,r,g,b\n3,3,1,200,10,10\n9,4,0,10,10,200\n",
        ),
        reader(
            "board train",
            &[
                "board CTRL -train FILE",
                "findBrdMarker CTRL -train FILE -class white",
            ],
            "class,r,g,b\nwhite,240,240,230\nwhite,250,250,250\nblack,10,10,10\nblack,20,10,10\ndark,90,60,40\ndark,80,60,50\n",
        ),
    ]
}

#[test]
fn tables_of_any_text_are_answered_with_finite_numbers_or_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("table.csv");
    let readers = readers();
    let mutator = Mutator {
        corpus: concat!(env!("CARGO_MANIFEST_DIR"), "/tests/corpus").into(),
        words: &[
            "nan", "inf", "-0", "1e308", "1e-308", ",,", "\n\n", "# a\n", "\u{feff}", "X", "(mm)",
            "\r",
        ],
        longest: 4096,
        seconds: 2.0,
        targets: u32::try_from(readers.len()).unwrap(),
    };
    for reader in &readers {
        let sorm = manager();
        let ask_all = || -> Vec<Transport> {
            let lines = reader.asked.iter();
            lines
                .map(|line| ask(&sorm, &line.replace("FILE", &path.display().to_string())))
                .collect()
        };
        fs::write(&path, &reader.good).unwrap();
        for reply in ask_all() {
            let known = reply.is_ok()
                || matches!(
                    reader.name,
                    "planecal" | "stereo" | "bundle" | "handeye" | "laser calibrate"
                );
            assert!(known, "{}: {:?}", reader.name, reply.reports);
        }
        mutator.play(
            reader.name,
            vec![reader.good.clone().into_bytes()],
            |bytes| {
                fs::write(&path, bytes).unwrap();
                for reply in ask_all() {
                    let told = format!("{}: {:?}", reader.name, reply.reports);
                    assert!(!told.contains("panicked"), "{told}");
                    assert!(
                        reply.floats.iter().all(|x| x.is_finite()),
                        "{told} {:?}",
                        reply.floats
                    );
                    assert!(reply.is_ok() || !reply.reports.is_empty(), "{told}");
                }
            },
        );
    }
}

#[test]
fn files_of_cameras_and_frames_of_messages_take_any_bytes() {
    let mutator = Mutator {
        corpus: concat!(env!("CARGO_MANIFEST_DIR"), "/tests/corpus").into(),
        words: &[
            "nan", ".inf", "- ", ": ", "[", "]", "\n  ", "&a", "*a", "<<: ", "!!binary", "data:",
            "---\n",
        ],
        longest: 8192,
        seconds: 1.0,
        targets: 3,
    };
    let lens = include_bytes!("../../../../configs/handeye-wrist.yaml");
    mutator.play("lens", vec![lens.to_vec()], |bytes| {
        let text = String::from_utf8_lossy(bytes);
        if let Ok(info) = CameraInfo::from_yaml(&text) {
            let i = info.intrinsics;
            let numbers = [i.fx, i.fy, i.cx, i.cy, info.distortion.k1];
            assert!(numbers.iter().all(|x| x.is_finite()), "{numbers:?}");
        }
    });
    let pose = CameraPose {
        name: "left".to_owned(),
        rotation: UnitQuaternion::identity(),
        centre: Point3::new(0.1, 0.2, 2.0),
        position_sd_m: [1e-3; 3],
        rotation_sd_rad: [1e-3; 3],
        intrinsics_sd_px: [0.1; 4],
        distortion_sd: [1e-3; 5],
        focal_sd_rel: 1e-3,
        rms_px: 0.1,
    };
    let poses = poses_to_yaml(&[pose]).unwrap();
    assert!(poses_from_yaml(&poses).is_ok());
    mutator.play("poses", vec![poses.into_bytes()], |bytes| {
        let text = String::from_utf8_lossy(bytes);
        if let Err(error) = poses_from_yaml(&text) {
            assert!(!error.to_string().is_empty());
        }
    });
    let mut frame = Frame::grey8(3, 2, vec![1, 2, 3, 4, 5, 6]);
    frame.camera = "left".to_owned();
    let frame = postcard::to_allocvec(&frame).unwrap();
    mutator.play("frame", vec![frame], |bytes| {
        if let Ok(frame) = postcard::from_bytes::<Frame>(bytes) {
            let _ = (frame.is_whole(), frame.grey().len(), frame.get(7, 9));
        }
    });
}

/// A chequered board of 8 x 8 px squares with two discs, and a ball.
fn small_board() -> Vec<u8> {
    let mut bytes = b"P5 80 80 255\n".to_vec();
    for at in 0..80 * 80 {
        let (u, v) = (at % 80, at / 80);
        let inside = (8..72).contains(&u) && (8..72).contains(&v);
        let far = |x: f64, y: f64| (f64::from(u) - x).hypot(f64::from(v) - y);
        bytes.push(match () {
            () if far(19.5, 11.5) < 3.0 || far(75.0, 75.0) < 3.5 => 250,
            () if far(11.5, 67.5) < 3.0 => 5,
            () if inside && (u / 8 + v / 8) % 2 == 0 => 200,
            () if inside => 90,
            () => 40,
        });
    }
    bytes
}

#[test]
fn pictures_of_any_bytes_are_answered_by_every_class_that_takes_one() {
    let folder = tempfile::tempdir().unwrap();
    let (path, table) = (
        folder.path().join("picture"),
        folder.path().join("table.csv"),
    );
    fs::write(
        &table,
        "class,r,g,b\nred,200,10,10\nred,190,20,10\nblue,10,10,200\nblue,20,10,190\n",
    )
    .unwrap();
    let sorm = manager();
    for line in [
        format!("colour CTRL -train {}", table.display()),
        "spot CTRL -fit on".to_owned(),
        "corners CTRL -inner 7 7".to_owned(),
    ] {
        let reply = ask(&sorm, &line);
        assert!(reply.is_ok(), "{line}: {:?}", reply.reports);
    }
    let mutator = Mutator {
        corpus: concat!(env!("CARGO_MANIFEST_DIR"), "/tests/corpus").into(),
        words: &["P5 ", "P6 ", "65535\n", "255\n", "80 ", "9 ", "# ", "BM"],
        longest: 8192,
        seconds: 2.0,
        targets: 1,
    };
    let asked = [
        "blobs EXEC TMSG FILE",
        "blobs EXEC tree FILE",
        "blobs EXEC expect FILE",
        "spot EXEC TMSG FILE",
        "colour EXEC TMSG FILE",
        "board EXEC TMSG FILE",
        "board EXEC marker FILE",
        "board EXEC disk FILE FMSG 2 0.5 0.5",
        "findBrdMarker EXEC TMSG FILE",
        "getDisk EXEC FILE FMSG 2 0.5 0.5",
        "getDisk EXEC near FILE FMSG 3 19 11 3",
        "diskFind EXEC FILE",
        "corners EXEC TMSG FILE",
        "lines EXEC TMSG FILE",
        "lines EXEC points FILE",
    ];
    mutator.play("picture", vec![small_board()], |bytes| {
        fs::write(&path, bytes).unwrap();
        for line in asked {
            let reply = ask(&sorm, &line.replace("FILE", &path.display().to_string()));
            let told = format!("{line}: {:?}", reply.reports);
            assert!(!told.contains("panicked"), "{told}");
            assert!(
                reply.floats.iter().all(|x| x.is_finite()),
                "{told} {:?}",
                reply.floats
            );
            assert!(reply.is_ok() || !reply.reports.is_empty(), "{told}");
        }
    });
}

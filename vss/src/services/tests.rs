//! The classes `spot` and `resect` by their textual requests: known answers, and every wrong file.

use super::*;
use crate::{
    camera::{Camera, Distortion, Intrinsics},
    spot::noise_sd,
};
use futures_util::FutureExt as _;
use nalgebra::{Point3, Rotation3, UnitQuaternion, Vector3};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use sorma::{Dictionary, Reply};
use std::{fmt::Write as _, fs};

fn manager() -> Sorm {
    let sorm = Sorm::new(Dictionary::new());
    register(&sorm);
    sorm
}

fn ask(sorm: &Sorm, line: &str) -> Transport {
    let told = sorm.tell(&sorma::Alone, line, "").now_or_never().unwrap();
    told.parse::<Reply>().unwrap().body
}

/// The code and text of the error that ends a request, whose reply holds nothing else.
fn refused(sorm: &Sorm, line: &str) -> (i32, String) {
    let reply = ask(sorm, line);
    assert!(!reply.is_ok(), "{line}");
    assert!(reply.floats.is_empty() && reply.ints.is_empty() && reply.text.is_empty());
    (reply.code, reply.reports.last().unwrap().text.clone())
}

/// A folder with a file in it, and the file's path.
fn file(name: &str, bytes: &[u8]) -> (tempfile::TempDir, String) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    fs::write(&path, bytes).unwrap();
    let path = path.display().to_string();
    (folder, path)
}

fn camera(distortion: Distortion) -> Camera {
    let eye = Point3::new(0.2, -0.1, 2.2);
    let view = Rotation3::face_towards(&(Point3::origin() - eye), &-Vector3::y());
    Camera {
        rotation: UnitQuaternion::from_rotation_matrix(&view).inverse(),
        centre: eye,
        intrinsics: Intrinsics {
            fx: 800.0,
            fy: 805.0,
            cx: 322.0,
            cy: 238.0,
        },
        distortion,
    }
}

const LENS: Distortion = Distortion {
    k1: -0.25,
    k2: 0.12,
    p1: 1e-3,
    p2: -5e-4,
    k3: -0.02,
};

/// What `resect` should answer, rms left out.
fn expected(camera: &Camera) -> [f64; 15] {
    let (i, d) = (camera.intrinsics, camera.distortion);
    // The rotation vector from the matrix, by a way of its own.
    let r = camera.rotation.to_rotation_matrix();
    let angle = (0.5 * (r.matrix().trace() - 1.0)).acos();
    let skew = |a: usize, b: usize| r[(a, b)] - r[(b, a)];
    let axis = Vector3::new(skew(2, 1), skew(0, 2), skew(1, 0)) / (2.0 * angle.sin());
    let w = axis * angle;
    let t = -(r * camera.centre.coords);
    [
        i.fx, i.fy, i.cx, i.cy, d.k1, d.k2, d.p1, d.p2, d.k3, w.x, w.y, w.z, t.x, t.y, t.z,
    ]
}

fn table(camera: &Camera, n: usize, sd: f64, seed: u64) -> String {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut text = String::from("X,Y,Z,u,v\n");
    let mut rows = 0;
    while rows < n {
        let point = Point3::new(
            rng.random_range(-0.5..0.5),
            rng.random_range(-0.4..0.4),
            rng.random_range(-0.3..0.3),
        );
        let Some(pixel) = camera.project(&point) else {
            continue;
        };
        let mut noise = || -> f64 {
            let drawn: f64 = rng.sample(StandardNormal);
            sd * drawn
        };
        let (u, v) = (pixel.x + noise(), pixel.y + noise());
        if !is_inside(u, v) {
            continue;
        }
        let (x, y, z) = (point.x, point.y, point.z);
        writeln!(text, "{x:?},{y:?},{z:?},{u:?},{v:?}").unwrap();
        rows += 1;
    }
    text
}

/// Whether a place is in a picture of 640 x 480 px.
fn is_inside(u: f64, v: f64) -> bool {
    (0.0..639.0).contains(&u) && (0.0..479.0).contains(&v)
}

#[test]
fn every_model_gives_back_the_camera_that_made_the_table() {
    let plain = |k1, k2| Distortion {
        k1,
        k2,
        ..Distortion::default()
    };
    let cases = [
        ("none", Distortion::default()),
        ("k1", plain(-0.2, 0.0)),
        ("k1k2", plain(-0.25, 0.12)),
        ("brown5", LENS),
    ];
    for (model, lens) in cases {
        let truth = camera(lens);
        let (_folder, path) = file("lights.csv", table(&truth, 80, 0.0, 3).as_bytes());
        let sorm = manager();
        assert!(ask(&sorm, &format!("resect CTRL -size 640 480 -model {model}")).is_ok());
        let reply = ask(&sorm, &format!("resect EXEC TMSG {path}"));
        assert!(reply.is_ok(), "{:?}", reply.reports);
        assert_eq!((reply.floats.len(), reply.ints.len()), (16, 0));
        for (index, (found, truth)) in reply.floats.iter().zip(expected(&truth)).enumerate() {
            let off = (found - truth).abs();
            assert!(
                off < 1e-5 * (1.0 + truth.abs()),
                "{model} {index}: {found} {truth}"
            );
        }
        assert!(reply.floats[15] < 1e-6, "rms {}", reply.floats[15]);
    }
}

#[test]
fn the_rms_is_that_of_the_noise_and_outliers_are_named_by_line() {
    let mut text = table(&camera(LENS), 200, 0.4, 5);
    text.push_str("0.1,0.1,0.1,20.0,30.0\n");
    let (_folder, path) = file("lights.csv", text.as_bytes());
    let sorm = manager();
    ask(&sorm, "resect CTRL -size 640 480");
    let reply = ask(&sorm, &format!("resect EXEC {path}"));
    assert!(reply.is_ok());
    // Two coordinates of 0.4 px each.
    assert!((reply.floats[15] / (0.4 * 2_f64.sqrt()) - 1.0).abs() < 0.1);
    let report = &reply.reports[0];
    assert_eq!(report.code, code::REJECTED);
    assert!(
        report.text.contains(&format!("{path}:202:1 is off by")),
        "{}",
        report.text
    );
}

/// With what is known of lenses, intervals of all numbers cover the truth, and those of pose and pinhole are not too wide: 50
/// points with much noise say less of k3 than a lens does.
#[test]
fn the_answered_intervals_cover_the_truth_where_points_say_little_of_the_lens() {
    let truth = camera(LENS);
    let sorm = manager();
    ask(&sorm, "resect CTRL -size 640 480 -sd on");
    let (mut squares, mut within, mut count) = ([0.0; 15], 0, 0);
    let runs = 60;
    for seed in 0..runs {
        let (_folder, path) = file("lights.csv", table(&truth, 50, 0.5, 250 + seed).as_bytes());
        let reply = ask(&sorm, &format!("resect EXEC {path}"));
        assert_eq!(reply.floats.len(), 31, "{:?}", reply.reports);
        let errors = reply.floats.iter().zip(expected(&truth));
        for (k, ((found, truth), sd)) in errors.zip(&reply.floats[16..]).enumerate() {
            let ratio = (found - truth) / sd;
            squares[k] += ratio * ratio / runs as f64;
            within += usize::from(ratio.abs() < 1.96);
            count += 1;
        }
    }
    let pose_and_pinhole = (0..4).chain(9..15);
    for k in pose_and_pinhole {
        let rms = squares[k].sqrt();
        assert!((0.7..1.3).contains(&rms), "{k}: {rms}");
    }
    let share = within as f64 / f64::from(count);
    assert!((0.93..0.985).contains(&share), "{share}");
}

/// A lens as lenses are expected to be: its terms are drawn with the standard deviations that `resect` has for them. Over
/// lenses of any other kind its standard deviations are those of no error.
fn drawn_lens(seed: u64) -> Camera {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let square = (0.5 * 640_f64.hypot(480.0) / camera(LENS).focal()).powi(2);
    loop {
        let mut drawn = |sd: f64| sd * rng.sample::<f64, _>(StandardNormal);
        let lens = camera(Distortion {
            k1: drawn(0.5 / square),
            k2: drawn(0.25 / square.powi(2)),
            p1: drawn(3e-3),
            p2: drawn(3e-3),
            k3: drawn(0.05 / square.powi(3)),
        });
        // What folds the picture over is no lens.
        if lens.is_monotonic_over(640, 480) {
            return lens;
        }
    }
}

/// Over many lenses and tables, the errors of all 15 numbers have the size that is answered.
#[test]
fn the_answered_standard_deviations_are_those_of_the_errors() {
    let sorm = manager();
    ask(&sorm, "resect CTRL -size 640 480 -sd on");
    let (mut squares, mut within, mut count) = ([0.0; 15], 0, 0);
    let runs = 40;
    for seed in 0..runs {
        let truth = drawn_lens(seed);
        let (_folder, path) = file("lights.csv", table(&truth, 100, 0.3, 50 + seed).as_bytes());
        let reply = ask(&sorm, &format!("resect EXEC {path}"));
        assert_eq!(reply.floats.len(), 31, "{:?}", reply.reports);
        let errors = reply.floats.iter().zip(expected(&truth));
        for (k, ((found, truth), sd)) in errors.zip(&reply.floats[16..]).enumerate() {
            let ratio = (found - truth) / sd;
            squares[k] += ratio * ratio / runs as f64;
            within += usize::from(ratio.abs() < 1.96);
            count += 1;
        }
    }
    for (k, square) in squares.iter().enumerate() {
        assert!(
            (0.6..1.4).contains(&square.sqrt()),
            "{k}: {}",
            square.sqrt()
        );
    }
    let share = within as f64 / f64::from(count);
    assert!((0.91..0.99).contains(&share), "{share}");
}

#[test]
fn a_table_that_is_nearly_flat_is_told_to_say_little() {
    let mut text = String::from("X,Y,Z,u,v\n");
    for line in table(&camera(LENS), 100, 0.5, 9).lines().skip(1) {
        let numbers: Vec<f64> = line.split(',').map(|x| x.parse().unwrap()).collect();
        let point = Point3::new(numbers[0], numbers[1], numbers[2] / 60.0);
        let pixel = camera(LENS).project(&point).unwrap();
        // The noise of the table stays.
        let seen = camera(LENS)
            .project(&Point3::new(numbers[0], numbers[1], numbers[2]))
            .unwrap();
        let (u, v) = (pixel.x + numbers[3] - seen.x, pixel.y + numbers[4] - seen.y);
        writeln!(text, "{},{},{},{u},{v}", point.x, point.y, point.z).unwrap();
    }
    let (_folder, path) = file("flat.csv", text.as_bytes());
    let sorm = manager();
    ask(&sorm, "resect CTRL -size 640 480");
    let reply = ask(&sorm, &format!("resect EXEC {path}"));
    assert!(reply.is_ok());
    let told = reply
        .reports
        .iter()
        .find(|report| report.code == code::NO_CAMERA);
    assert!(
        told.unwrap().text.contains("nearly in one plane"),
        "{:?}",
        reply.reports
    );
}

#[test]
fn columns_may_stand_in_any_order_and_a_table_without_header_has_the_usual_one() {
    let text = table(&camera(LENS), 60, 0.0, 3);
    let swapped: String = text
        .lines()
        .map(|line| {
            let [x, y, z, u, v]: [&str; 5] =
                line.split(',').collect::<Vec<_>>().try_into().unwrap();
            format!(" {v}, {z} ,{u},{x},{y}, \r\n")
        })
        .collect();
    let swapped = format!("\u{feff}# lights\n\n{swapped}");
    let bare = text.split_once('\n').unwrap().1.to_owned();
    let sorm = manager();
    ask(&sorm, "resect CTRL -size 640 480");
    let of = |text: &str| {
        let (_folder, path) = file("lights.csv", text.as_bytes());
        let reply = ask(&sorm, &format!("resect EXEC {path}"));
        assert!(reply.is_ok(), "{:?}", reply.reports);
        reply.floats
    };
    assert_eq!(of(&text), of(&swapped));
    assert_eq!(of(&text), of(&bare));
}

#[test]
fn wrong_tables_are_refused_with_line_and_column() {
    let sorm = manager();
    let (_folder, path) = file("a.csv", table(&camera(LENS), 20, 0.0, 3).as_bytes());
    let (code, text) = refused(&sorm, &format!("resect EXEC {path}"));
    assert_eq!(code, sorma::report::code::VALUE);
    assert_eq!(
        text,
        "the size of the pictures is not known: set it with CTRL -size W H"
    );
    ask(&sorm, "resect CTRL -size 640 480");
    let wrong = |text: &[u8]| {
        let (_folder, path) = file("a.csv", text);
        let (code, text) = refused(&sorm, &format!("resect EXEC {path}"));
        (code, text.replace(&path, "a.csv"))
    };
    let cases: [(&str, &str); 6] = [
        ("", "a.csv:1:1: error: the table is empty"),
        (
            "X,Y,Z,u\n1,2,3,4\n",
            "a.csv:1:1: error: the header lacks v: it is `X,Y,Z,u`",
        ),
        (
            "X,Y,Z,u,v,U\n",
            "a.csv:1:11: error: the column `u` stands twice in the header",
        ),
        (
            "X,Y,Z,u,v\n1,2,3,4,5\n1,2, nan,4,x\n",
            "a.csv:3:6: error: Z must be a finite number, not `nan`",
        ),
        (
            "X,Y,Z,u,v\n1,2,3\n",
            "a.csv:2:1: error: 3 values stand here, and 5 in the first line",
        ),
        (
            "no table at all\n",
            "a.csv:1:1: error: the header lacks X, Y, Z, u, v: it is `no table at all`",
        ),
    ];
    for (given, expected) in cases {
        let (code, text) = wrong(given.as_bytes());
        assert_eq!(code, code::TABLE);
        assert!(text.starts_with(expected), "{given:?}: {text}");
    }
    let both = wrong(b"X,Y,Z,u,v\n1,2, nan,4,x\n").1;
    assert!(
        both.contains("\na.csv:2:12: error: v must be a finite number, not `x`"),
        "{both}"
    );
    let many = "X,Y,Z,u,v\n".to_owned() + &"a,1,1,1,1\n".repeat(1000);
    assert!(wrong(many.as_bytes()).1.ends_with("and 980 more"));
    assert_eq!(wrong(b"X,Y,Z,u,v\n\xff\n").0, code::FILE);
}

#[test]
fn tables_from_which_no_camera_follows_are_refused_with_the_reason() {
    let sorm = manager();
    ask(&sorm, "resect CTRL -size 640 480");
    let good = table(&camera(LENS), 40, 0.0, 3);
    let rows: Vec<&str> = good.lines().collect();
    let wrong = |text: &str| {
        let (_folder, path) = file("a.csv", text.as_bytes());
        let (code, text) = refused(&sorm, &format!("resect EXEC {path}"));
        assert_eq!(code, code::NO_CAMERA);
        text.replace(&path, "a.csv")
    };
    let few = wrong(&rows[..6].join("\n"));
    assert!(
        few.starts_with("a.csv: 5 points; a calibration needs at least 8"),
        "{few}"
    );
    let few = wrong(&rows[..11].join("\n"));
    assert!(
        few.starts_with("a.csv: 10 usable points; a camera with 15 parameters needs at least 11"),
        "{few}"
    );
    let flat: Vec<String> = rows
        .iter()
        .map(|row| {
            let mut fields: Vec<&str> = row.split(',').collect();
            if fields[2] != "Z" {
                fields[2] = "0.1";
            }
            fields.join(",")
        })
        .collect();
    let flat = wrong(&flat.join("\n"));
    assert!(
        flat.starts_with("a.csv: the light positions lie in one plane"),
        "{flat}"
    );
    let outside = wrong(&format!("{good}0,0,0,700,100\n"));
    assert!(
        outside.starts_with(
            "a.csv:42:1: the point is seen at (700.0, 100.0), outside the picture of 640 x 480 px"
        ),
        "{outside}"
    );
}

/// Each way in which a table can be wrong without being no table, by the word that names it.
#[test]
fn every_degenerate_table_is_named() {
    let sorm = manager();
    ask(&sorm, "resect CTRL -size 640 480");
    let good = table(&camera(LENS), 60, 0.1, 3);
    let rows: Vec<[f64; 5]> = good
        .lines()
        .skip(1)
        .map(|row| {
            let numbers: Vec<f64> = row.split(',').map(|x| x.parse().unwrap()).collect();
            numbers.try_into().unwrap()
        })
        .collect();
    let changed = |change: &dyn Fn(usize, &mut [f64; 5])| {
        let mut text = String::from("X,Y,Z,u,v\n");
        for (index, row) in rows.iter().enumerate() {
            let mut row = *row;
            change(index, &mut row);
            let [x, y, z, u, v] = row;
            writeln!(text, "{x},{y},{z},{u},{v}").unwrap();
        }
        text
    };
    let lens = camera(LENS);
    let curve = |t: f64| {
        let (away, eye) = (1.0 - t / 3.0, lens.centre);
        Point3::new(
            0.45 * t * away + eye.x * t / 3.0,
            0.3 * (1.0 - 2.0 * t * t) * away + eye.y * t / 3.0,
            eye.z * t * t * t / 27.0,
        )
    };
    let cases: [(&str, String, &str); 16] = [
        ("coplanar", changed(&|_, r| r[2] = 0.1), "lie in one plane"),
        (
            "collinear",
            changed(&|_, r| (r[1], r[2]) = (r[0], 0.5 * r[0])),
            "lie on one line",
        ),
        (
            "one point",
            changed(&|_, r| (r[0], r[1], r[2]) = (0.1, 0.2, 0.3)),
            "are one point",
        ),
        (
            "mirrored world",
            changed(&|_, r| r[0] = -r[0]),
            "is mirrored",
        ),
        (
            "v upwards",
            changed(&|_, r| r[4] = 479.0 - r[4]),
            "v counted upwards",
        ),
        (
            "shuffled",
            changed(&|k, r| (r[3], r[4]) = (rows[(7 * k + 3) % 60][3], rows[(7 * k + 3) % 60][4])),
            "of the same lights in the same rows",
        ),
        (
            "millimetres",
            changed(&|_, r| (0..3).for_each(|k| r[k] *= 1e3)),
            "are these millimetres",
        ),
        (
            "centimetres",
            changed(&|_, r| (0..3).for_each(|k| r[k] *= 1e2)),
            "are these millimetres or centimetres",
        ),
        (
            "u and v swapped",
            changed(&|_, r| r.swap(3, 4)),
            "with u and v swapped",
        ),
        (
            "NaN",
            good.replacen("0.", "nan", 1),
            "must be a finite number",
        ),
        (
            "too few",
            good.lines().take(7).collect::<Vec<_>>().join("\n"),
            "needs at least 8",
        ),
        (
            "off the image",
            changed(&|k, r| {
                if k == 5 {
                    r[3] = 700.0
                }
            }),
            ":7:1: the point is seen at (700.0",
        ),
        (
            "empty cell",
            format!("{good}1,2,,4,5\n"),
            ":62:5: error: Z must be a finite number, not ``",
        ),
        (
            "empty last cell",
            format!("{good}1,2,3,4,\n"),
            ":62:9: error: v must be a finite number, not ``",
        ),
        (
            "unit in a cell",
            format!("{good}1,2,3 mm,4,5\n"),
            ":62:5: error: Z must be a finite number, not `3 mm`",
        ),
        (
            "unit in the header",
            good.replacen("X,", "X [mm],", 1),
            ":1:1: error: the header names the unit `mm`",
        ),
    ];
    for (name, text, named) in cases {
        let (_folder, path) = file("a.csv", text.as_bytes());
        let (_, told) = refused(&sorm, &format!("resect EXEC {path}"));
        assert!(told.contains(named), "{name}: {told}");
    }
    // A picture that is as high as wide, or swapping would put some off it.
    ask(&sorm, "resect CTRL -size 640 640");
    let swapped = changed(&|_, r| r.swap(3, 4));
    let (_folder, path) = file("a.csv", swapped.as_bytes());
    let (_, told) = refused(&sorm, &format!("resect EXEC {path}"));
    assert!(told.contains("swapped u and v"), "{told}");
    let mut text = String::from("X,Y,Z,u,v\n");
    for k in 0..60 {
        let p = curve(f64::from(k) / 30.0 - 1.0);
        let seen = lens.project(&p).unwrap();
        writeln!(text, "{},{},{},{},{}", p.x, p.y, p.z, seen.x, seen.y).unwrap();
    }
    let (_folder, path) = file("a.csv", text.as_bytes());
    let (_, told) = refused(&sorm, &format!("resect EXEC {path}"));
    assert!(told.contains("twisted cubic"), "{told}");
    // What lies behind the camera is left out, by its line.
    ask(&sorm, "resect CTRL -size 640 480");
    let behind = Point3::new(0.1, 0.1, 4.5);
    let seen = lens.project_unchecked(&behind).unwrap();
    let text = format!("{good}0.1,0.1,4.5,{},{}\n", seen.x, seen.y);
    let (_folder, path) = file("a.csv", text.as_bytes());
    let reply = ask(&sorm, &format!("resect EXEC {path}"));
    let told = &reply.reports[0].text;
    assert!(told.contains(":62:1 lies behind the camera"), "{told}");
}

/// A PNG of Gaussian spots with the given heights over a background of 20 (or under one of 220).
fn spots_png(places: &[(f64, f64)], dark: bool) -> Vec<u8> {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let pixel = |u: u32, v: u32, noise: f64| {
        let height: f64 = places
            .iter()
            .map(|(x, y)| {
                let square = (f64::from(u) - x).powi(2) + (f64::from(v) - y).powi(2);
                150.0 * (-0.5 * square / 4.0).exp()
            })
            .sum();
        let grey = if dark { 220.0 - height } else { 20.0 + height };
        (grey + noise).round().clamp(0.0, 255.0) as u8
    };
    let places = (0..90).flat_map(|v| (0..120).map(move |u| (u, v)));
    let pixels: Vec<u8> = places
        .map(|(u, v)| pixel(u, v, rng.sample(StandardNormal)))
        .collect();
    assert!(noise_sd(&pixels, 120) < 2.0);
    let mut bytes = Vec::new();
    crate::png::write(&mut bytes, 120, 90, &pixels).unwrap();
    bytes
}

#[test]
fn spots_of_a_picture_are_found_to_a_fraction_of_a_pixel() {
    let places = [(30.25, 20.5), (80.7, 25.1), (55.5, 70.3)];
    for dark in [false, true] {
        let (_folder, path) = file("a picture.png", &spots_png(&places, dark));
        let sorm = manager();
        if dark {
            assert!(ask(&sorm, "spot CTRL -polarity dark").is_ok());
        }
        let reply = ask(&sorm, &format!("spot EXEC TMSG {path}"));
        assert!(reply.is_ok(), "{:?}", reply.reports);
        assert_eq!((reply.ints.as_slice(), reply.floats.len()), (&[3][..], 9));
        for (found, (u, v)) in reply.floats.chunks(3).zip(places) {
            assert!(
                (found[0] - u).hypot(found[1] - v) < 0.05,
                "{found:?} {u} {v}"
            );
            // Half height at 1.1774 widths of 2 px.
            assert!((found[2] - 17.4).abs() < 4.0, "{found:?}");
        }
        ask(&sorm, "spot CTRL -min-area 1000");
        let none = ask(&sorm, &format!("spot EXEC TMSG {path}"));
        assert!(none.is_ok() && none.ints == [0] && none.floats.is_empty());
        assert!(none.reports[0].text.contains("has no spot: 3 things"));
        ask(
            &sorm,
            "spot CTRL -min-area 1 -threshold 255 -polarity bright",
        );
        assert_eq!(ask(&sorm, &format!("spot EXEC TMSG {path}")).ints, [0]);
        ask(&sorm, "spot CTRL -threshold auto -most 1 -polarity bright");
        if !dark {
            let (_, text) = refused(&sorm, &format!("spot EXEC TMSG {path}"));
            assert!(text.contains("has 3 spots, more than -most 1"), "{text}");
        }
    }
}

#[test]
fn a_fit_answers_six_numbers_and_the_flags_of_each_spot() {
    let places = [(30.25, 40.5), (90.75, 20.125)];
    let (_folder, path) = file("a.png", &spots_png(&places, false));
    let sorm = manager();
    assert!(ask(&sorm, "spot CTRL -fit on").is_ok());
    let reply = ask(&sorm, &format!("spot EXEC TMSG {path}"));
    assert_eq!(
        (reply.floats.len(), reply.ints.as_slice()),
        (12, &[2, 0, 0][..])
    );
    for (u, v) in places {
        let near = reply
            .floats
            .chunks(6)
            .find(|spot| (spot[0] - u).hypot(spot[1] - v) < 0.2);
        let [_, _, sigma, amplitude, sd_u, sd_v] = near.unwrap() else {
            panic!("{:?}", reply.floats);
        };
        assert!(*sigma > 0.5 && *amplitude > 10.0, "{near:?}");
        assert!(
            (0.0..0.1).contains(sd_u) && (0.0..0.1).contains(sd_v),
            "{near:?}"
        );
    }
    ask(&sorm, "spot CTRL -fit off");
    assert_eq!(
        ask(&sorm, &format!("spot EXEC TMSG {path}")).floats.len(),
        6
    );
}

#[test]
fn a_file_that_is_no_picture_is_refused_and_so_is_no_file() {
    let sorm = manager();
    let (folder, path) = file("a.png", b"not a picture");
    let (code, text) = refused(&sorm, &format!("spot EXEC {path}"));
    assert_eq!(code, code::FILE);
    assert!(text.starts_with(&format!(
        "`{path}` is no picture that can be read (PNG, JPEG, PNM, BMP): "
    )));
    let mut cut = spots_png(&[(30.0, 30.0)], false);
    cut.truncate(cut.len() / 2);
    fs::write(&path, cut).unwrap();
    assert_eq!(refused(&sorm, &format!("spot EXEC {path}")).0, code::FILE);
    let forms = [
        ("spot", "after EXEC stands one of camera NAME, FILE"),
        ("resect", "after EXEC stands FILE"),
    ];
    for (class, forms) in forms {
        ask(&sorm, "resect CTRL -size 4 4");
        let (_, text) = refused(&sorm, &format!("{class} EXEC {path}.gone"));
        assert!(
            text.starts_with(&format!("cannot read `{path}.gone`: ")),
            "{text}"
        );
        let place = folder.path().display();
        let (_, text) = refused(&sorm, &format!("{class} EXEC {place}"));
        assert_eq!(text, format!("`{place}` is no file"));
        assert_eq!(refused(&sorm, &format!("{class} EXEC")).1, forms);
        let (_, text) = refused(&sorm, &format!("{class} EXEC {path} FMSG 1 2"));
        assert_eq!(text, "EXEC FILE takes no floats (FMSG), not 1");
    }
    let (number, text) = refused(&sorm, "spot EXEC camera west");
    assert_eq!(number, code::CAMERA);
    assert!(text.contains("no camera `west` here"), "{text}");
    let (_, text) = refused(&sorm, "spot CTRL -threshold 256");
    assert_eq!(
        text,
        "-threshold: must be `auto`, or it must be a whole number from 0 to 255 grey values, not `256`"
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn any_table_is_read_or_refused_with_a_place(text in "[XYZuv,0-9.\n #a-]{0,80}") {
        let source = ctos::diagnostic::Source::new("t", text.as_str());
        let columns = table::Columns { names: &["X", "Y", "Z", "u", "v"], count: None, may_be_empty: &["u"], help: "" };
        match table::read(&source, &columns) {
            Ok(table) => prop_assert_eq!(table.numbers.len(), 5 * table.at.len()),
            Err(findings) => prop_assert!(findings.iter().all(|finding| finding.place.is_some())),
        }
    }
}

mod fuzz;
mod maps;
mod objects;
mod pictures;
mod planes;
mod ratios;
mod refusals;
mod rigs;

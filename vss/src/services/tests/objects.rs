//! The classes that tell what a picture or a table shows of known things: trees of blobs and blobs that are expected, `pose`,
//! `bundle`, `findBrdMarker`, `getDisk`.

use super::*;
use nalgebra::{Isometry3, Vector2};

/// A PGM of rows of text: `#` is 200, all else 10.
fn drawn(rows: &[&str]) -> Vec<u8> {
    let mut pgm = format!("P5\n{} {}\n255\n", rows[0].len(), rows.len()).into_bytes();
    let pixels = rows.concat().into_bytes();
    pgm.extend(pixels.iter().map(|one| if *one == b'#' { 200 } else { 10 }));
    pgm
}

#[test]
fn a_tree_of_blobs_tells_holes_and_what_lies_in_them() {
    let rows = [
        "..............",
        ".#########....",
        ".#.......#....",
        ".#.##..#.#.##.",
        ".#.##....#.##.",
        ".#.......#....",
        ".#########....",
        "..............",
    ];
    let (_folder, path) = file("a.pgm", &drawn(&rows));
    let sorm = manager();
    let plain = ask(&sorm, &format!("blobs EXEC TMSG {path}"));
    let tree = ask(&sorm, &format!("blobs EXEC tree {path}"));
    assert!(tree.is_ok(), "{:?}", tree.reports);
    // 4 components and 1 hole; what lies in the hole is in hole 0, and that is of component 0.
    assert_eq!(tree.ints, [4, 1, -1, 0, 0, -1, 0]);
    assert_eq!(tree.floats.len(), 60);
    assert_eq!(plain.floats, tree.floats[..48]);
    assert_eq!((tree.floats[48], tree.floats[59]), (23.0, -1.0));
    let expected = "component 0: 26 px at 5.00, 3.50\n  hole 0: 23 px at 5.17, 3.52\n    component 1: 4 px at 3.50, 3.50\n    component 2: 1 px at 7.00, 3.00\ncomponent 3: 4 px at 11.50, 3.50";
    assert_eq!(tree.text, expected);
    // What is too small is no part of it.
    assert!(ask(&sorm, "blobs CTRL -min 2").is_ok());
    let tree = ask(&sorm, &format!("blobs EXEC tree {path}"));
    assert_eq!(tree.ints, [3, 1, -1, 0, -1, 0]);
    assert!(ask(&sorm, "blobs CTRL -min 1000").is_ok());
    let none = ask(&sorm, &format!("blobs EXEC tree {path}"));
    assert_eq!((&none.ints[..], none.text.as_str()), (&[0, 0][..], ""));
}

/// Without the ring between them, what lies in its hole lies in the hole around the ring.
#[test]
fn what_lies_in_a_small_component_stays_in_what_is_around_that() {
    let mut rows = vec!["#".repeat(40)];
    rows.extend((1..29).map(|_| format!("#{}#", ".".repeat(38))));
    rows.push("#".repeat(40));
    let mut put = |v: usize, u: usize, text: &str| rows[v].replace_range(u..u + text.len(), text);
    for v in 10..17 {
        put(v, 10, "#.....#");
    }
    put(9, 10, "#######");
    put(17, 10, "#######");
    for v in 11..16 {
        put(v, 12, "...");
    }
    for v in 12..15 {
        put(v, 12, "###");
    }
    let rows: Vec<&str> = rows.iter().map(String::as_str).collect();
    let (_folder, path) = file("a.pgm", &drawn(&rows));
    let sorm = manager();
    let all = ask(&sorm, &format!("blobs EXEC tree {path}"));
    assert_eq!(all.ints, [3, 2, -1, 0, 1, 0, 1]);
    // The dot is smaller than the ring: only the other way round is there something to drop.
    assert!(ask(&sorm, "blobs CTRL -min 9").is_ok());
    assert_eq!(
        ask(&sorm, &format!("blobs EXEC tree {path}")).ints,
        all.ints
    );
    assert!(ask(&sorm, "blobs CTRL -min 10").is_ok());
    assert_eq!(
        ask(&sorm, &format!("blobs EXEC tree {path}")).ints,
        [2, 2, -1, 0, 0, 1]
    );
}

#[test]
fn blobs_are_held_against_what_is_expected() {
    let (width, height) = (120, 90);
    let inside = |u: f64, v: f64| {
        let disc = |x: f64, y: f64, r: f64| (u - x).hypot(v - y) < r;
        disc(30.0, 30.0, 9.0)
            || disc(2.0, 60.0, 9.0)
            || ((70.0..90.0).contains(&u) && (20.0..40.0).contains(&v))
            || disc(100.0, 70.0, 3.0)
            || (disc(60.0, 70.0, 9.0) && !disc(60.0, 70.0, 4.0))
    };
    let mut pgm = format!("P5\n{width} {height}\n255\n").into_bytes();
    pgm.extend((0..width * height).map(|at| {
        let (u, v) = (f64::from(at % width), f64::from(at / width));
        if inside(u, v) { 220 } else { 20 }
    }));
    let (_folder, path) = file("a.pgm", &pgm);
    let sorm = manager();
    assert!(ask(&sorm, "blobs CTRL -area 100 500").is_ok());
    let reply = ask(&sorm, &format!("blobs EXEC expect {path}"));
    assert!(reply.is_ok(), "{:?}", reply.reports);
    // By their first pixels: square, disc, clipped, ring, small.
    assert_eq!(reply.ints[..3], [5, 16, 0]);
    assert_eq!(reply.ints[3] & 1, 1);
    assert_eq!(reply.ints[4..], [16 | 32, 2]);
    assert_eq!(reply.floats.len(), 60);
    let report = reply.reports.last().unwrap();
    assert_eq!(report.code, code::UNEXPECTED);
    assert!(
        report
            .text
            .contains("4 of 5 components are not as expected"),
        "{report:?}"
    );
    assert!(report.text.contains("component 2 at") && report.text.contains("touches the border"));
    assert!(ask(&sorm, "blobs CTRL -holes 1 -area 100 400").is_ok());
    let ring = ask(&sorm, &format!("blobs EXEC expect {path}"));
    assert_eq!((ring.ints[2], ring.ints[4]), (32, 0));
    assert!(ask(&sorm, "blobs CTRL -holes any").is_ok());
}

fn matches(pose: &Isometry3<f64>, sd: f64, seed: u64) -> String {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let lens = camera(LENS);
    let object = Camera {
        rotation: pose.rotation,
        centre: pose.inverse() * Point3::origin(),
        ..lens
    };
    let mut text = String::from("X,Y,Z,u,v\n");
    for _ in 0..25 {
        let mut within = |side: f64| side * (rng.random::<f64>() - 0.5);
        let point = Point3::new(within(0.2), within(0.15), within(0.1));
        let pixel = object.project(&point).unwrap();
        let mut noise = || sd * rng.sample::<f64, _>(StandardNormal);
        let pixel = pixel + Vector2::new(noise(), noise());
        writeln!(
            text,
            "{},{},{},{},{}",
            point.x, point.y, point.z, pixel.x, pixel.y
        )
        .unwrap();
    }
    text
}

#[test]
fn pose_answers_where_an_object_stands_with_standard_deviations_and_names_wrong_rows() {
    let truth = Isometry3::new(Vector3::new(0.05, -0.02, 0.8), Vector3::new(0.4, -0.3, 0.9));
    let sorm = manager();
    let mut text = matches(&truth, 0.3, 1);
    text.push_str("0.01,0.02,0.03,30.0,40.0\n");
    let (_folder, path) = file("object.csv", text.as_bytes());
    let (number, why) = refused(&sorm, &format!("pose EXEC {path}"));
    assert_eq!(number, sorma::report::code::VALUE);
    assert!(why.contains("-lens FX FY"), "{why}");
    let set = "pose CTRL -lens 800 805 322 238 -0.25 0.12 0.001 -0.0005 -0.02";
    assert!(ask(&sorm, set).is_ok());
    let reply = ask(&sorm, &format!("pose EXEC TMSG {path}"));
    assert!(reply.is_ok(), "{:?}", reply.reports);
    assert_eq!((reply.floats.len(), &reply.ints[..]), (13, &[25][..]));
    let turn = truth.rotation.scaled_axis();
    let expected: Vec<f64> = turn
        .iter()
        .chain(truth.translation.vector.iter())
        .copied()
        .collect();
    for (k, truth) in expected.iter().enumerate() {
        let (found, sd) = (reply.floats[k], reply.floats[6 + k]);
        assert!(
            (found - truth).abs() < 4.0 * sd && sd < 0.02,
            "{k}: {found} {truth} {sd}"
        );
    }
    assert!((reply.floats[12] / (0.3 * 2_f64.sqrt()) - 1.0).abs() < 0.35);
    let report = &reply.reports[0];
    assert_eq!(report.code, code::REJECTED);
    assert!(report.text.contains(":27:1"), "{report:?}");
    let (_folder, path) = file(
        "object.csv",
        b"X,Y,Z,u,v\n0,0,0,300,200\n1,0,0,310,200\n0,1,0,300,210\n",
    );
    let (number, why) = refused(&sorm, &format!("pose EXEC {path}"));
    assert_eq!(number, code::NO_POSE);
    assert!(why.contains("3 matches"), "{why}");
    let (number, _) = refused(&sorm, "pose EXEC nowhere.csv");
    assert_eq!(number, code::FILE);
}

#[test]
fn bundle_answers_cameras_and_lights_of_one_table() {
    let one = camera(LENS);
    let mut other = one;
    other.rotation = UnitQuaternion::new(Vector3::new(0.05, 0.2, -0.1)) * one.rotation;
    other.centre = one.centre + Vector3::new(0.4, 0.1, 0.05);
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut text = String::from("X,Y,Z,u1,v1,u2,v2\n");
    let mut lights = Vec::new();
    for row in 0..60 {
        let mut within = |side: f64| side * (rng.random::<f64>() - 0.5);
        let light = Point3::new(within(1.0), within(0.8), within(0.6));
        lights.push(light);
        let mut drawn = |sd: f64| sd * rng.sample::<f64, _>(StandardNormal);
        let told = light + Vector3::from_fn(|_, _| drawn(1e-3));
        write!(text, "{},{},{}", told.x, told.y, told.z).unwrap();
        for (nth, camera) in [&one, &other].into_iter().enumerate() {
            let pixel = camera.project(&light).unwrap();
            let pixel = pixel + Vector2::new(drawn(0.2), drawn(0.2));
            let inside = (0.0..639.0).contains(&pixel.x) && (0.0..479.0).contains(&pixel.y);
            if inside && (row + nth) % 7 != 0 {
                write!(text, ",{},{}", pixel.x, pixel.y).unwrap();
            } else {
                text.push_str(",,");
            }
        }
        text.push('\n');
    }
    let sorm = manager();
    let (_folder, path) = file("rig.csv", text.as_bytes());
    assert!(
        ask(
            &sorm,
            "bundle CTRL -size 640 480 -robot-sd 0.001 -lights on"
        )
        .is_ok()
    );
    let reply = ask(&sorm, &format!("bundle EXEC TMSG {path}"));
    assert!(reply.is_ok(), "{:?}", reply.reports);
    assert_eq!(
        (reply.floats.len(), &reply.ints[..]),
        (63 + 360, &[2, 60][..])
    );
    for (nth, camera) in [one, other].iter().enumerate() {
        let mut truth = expected(camera);
        // The same turn the other way round, if that is nearer.
        let turn = Vector3::new(truth[9], truth[10], truth[11]);
        let found = Vector3::from_row_slice(&reply.floats[30 * nth + 9..30 * nth + 12]);
        let other = turn * (1.0 - std::f64::consts::TAU / turn.norm());
        if (other - found).norm() < (turn - found).norm() {
            truth[9..12].copy_from_slice(other.as_slice());
        }
        for (k, truth) in truth.iter().enumerate() {
            let (found, sd) = (reply.floats[30 * nth + k], reply.floats[30 * nth + 15 + k]);
            assert!(
                (found - truth).abs() < 4.5 * sd,
                "{nth} {k}: {found} {truth} {sd}"
            );
        }
    }
    assert!(
        (reply.floats[61] / 0.2 - 1.0).abs() < 0.3,
        "{}",
        reply.floats[61]
    );
    assert!(
        (reply.floats[62] / 1e-3 - 1.0).abs() < 0.4,
        "{}",
        reply.floats[62]
    );
    for (light, numbers) in lights.iter().zip(reply.floats[63..].chunks_exact(6)) {
        for k in 0..3 {
            assert!((light[k] - numbers[k]).abs() < 5.0 * numbers[3 + k]);
        }
    }
    // A robot that is worse than was said is told.
    assert!(ask(&sorm, "bundle CTRL -robot-sd 0.0002").is_ok());
    let reply = ask(&sorm, &format!("bundle EXEC TMSG {path}"));
    let told = |text: &str| {
        reply
            .reports
            .iter()
            .any(|report| report.text.contains(text))
    };
    assert!(told("not -robot-sd 2.00e-4 m"), "{:?}", reply.reports);
    for (wrong, says) in [
        (
            "X,Y,Z,u1,v1,u2\n1,2,3,4,5,6\n",
            "the header is `X,Y,Z,u1,v1,u2`",
        ),
        ("X,Y,Z,u2,v2\n1,2,3,4,5\n", "the header is"),
        ("X,Y,Z,u1,v1\n1,2,3,4,\n", "only one of u1 and v1 is there"),
        ("X,Y,Z,u1,v1\n1,2,,4,5\n", "Z must be a finite number"),
    ] {
        let (_folder, path) = file("rig.csv", wrong.as_bytes());
        let (number, text) = refused(&sorm, &format!("bundle EXEC {path}"));
        assert_eq!(number, code::TABLE, "{wrong}");
        assert!(text.contains(says), "{text}");
    }
    let (_folder, path) = file("rig.csv", b"X,Y,Z,u1,v1\n1,2,3,4,5\n");
    let (number, text) = refused(&sorm, &format!("bundle EXEC {path}"));
    assert_eq!(number, code::NO_CAMERA);
    assert!(
        text.contains("camera 1") && text.contains("1 points"),
        "{text}"
    );
}

#[test]
fn what_is_wrong_in_the_table_of_the_second_camera_is_told_at_its_line() {
    let sorm = manager();
    assert!(ask(&sorm, "bundle CTRL -size 640 480").is_ok());
    let mut text = String::from("X,Y,Z,u1,v1,u2,v2\n");
    for (nth, row) in table(&camera(LENS), 40, 0.0, 3).lines().skip(1).enumerate() {
        let (at, pixel) = row
            .match_indices(',')
            .nth(2)
            .map(|(k, _)| row.split_at(k))
            .unwrap();
        match nth {
            // What camera 2 did not see.
            0..10 => writeln!(text, "{at}{pixel},,").unwrap(),
            20 => writeln!(text, "{at}{pixel},700,20").unwrap(),
            _ => writeln!(text, "{at}{pixel}{pixel}").unwrap(),
        }
    }
    let (_folder, path) = file("rig.csv", text.as_bytes());
    let (number, said) = refused(&sorm, &format!("bundle EXEC {path}"));
    assert_eq!(number, code::NO_CAMERA);
    assert!(
        said.contains("camera 2: ") && said.contains("rig.csv:22:1"),
        "{said}"
    );
}

/// A board in perspective with four round markers around it, light on a darker table.
fn marked_board(lens: &Camera) -> (Vec<u8>, [[f64; 2]; 4]) {
    let (width, height) = (640, 480);
    let places = [[-0.8, -0.8], [8.8, -0.8], [8.8, 8.8], [-0.8, 8.8]];
    let mut pgm = format!("P5\n{width} {height}\n255\n").into_bytes();
    for v in 0..height {
        for u in 0..width {
            let mut sum = 0.0;
            for nth in 0..9 {
                let at = Vector2::new(
                    u as f64 + f64::from(nth % 3 - 1) / 3.0,
                    v as f64 + f64::from(nth / 3 - 1) / 3.0,
                );
                // Where the ray meets the board, squares of 5 cm.
                let ray = lens.rotation.inverse() * lens.ray(at).unwrap();
                let met = lens.centre - ray * (lens.centre.z / ray.z);
                let (x, y) = (met.x / 0.05, met.y / 0.05);
                let inside = (0.0..8.0).contains(&x) && (0.0..8.0).contains(&y);
                let marker = places
                    .iter()
                    .any(|[file, rank]| (x - file).hypot(y - rank) < 0.3);
                let disc = (x - 2.53).hypot(y - 0.48) < 0.36;
                sum += match () {
                    () if marker => 250.0,
                    () if disc => 20.0,
                    () if inside && (x.floor() + y.floor()) % 2.0 == 0.0 => 60.0,
                    () if inside => 180.0,
                    () => 110.0,
                };
            }
            pgm.push((sum / 9.0_f64).round() as u8);
        }
    }
    (pgm, places)
}

#[test]
fn four_markers_tell_where_the_board_lies_and_how_well() {
    // From White's side, tilted; x of the picture runs along rank 1.
    let eye = Point3::new(0.23, -0.25, 0.75);
    let view = Rotation3::face_towards(&(Point3::new(0.2, 0.18, 0.0) - eye), &-Vector3::y());
    let lens = Camera {
        rotation: UnitQuaternion::from_rotation_matrix(&view).inverse(),
        centre: eye,
        intrinsics: Intrinsics {
            fx: 640.0,
            fy: 640.0,
            cx: 320.0,
            cy: 240.0,
        },
        distortion: Distortion::default(),
    };
    let (pgm, places) = marked_board(&lens);
    let (_folder, path) = file("board.pgm", &pgm);
    let sorm = manager();
    let at: Vec<String> = places.iter().flatten().map(ToString::to_string).collect();
    let set = format!(
        "findBrdMarker CTRL -threshold 215 -area 30 2000 -at {}",
        at.join(" ")
    );
    assert!(ask(&sorm, &set).is_ok());
    let reply = ask(&sorm, &format!("findBrdMarker EXEC TMSG {path}"));
    assert!(reply.is_ok(), "{:?}", reply.reports);
    assert_eq!(reply.floats.len(), 30);
    let seen = |x: f64, y: f64| lens.project(&Point3::new(0.05 * x, 0.05 * y, 0.0)).unwrap();
    for (k, [file, rank]) in [[0.0, 0.0], [8.0, 0.0], [8.0, 8.0], [0.0, 8.0]]
        .into_iter()
        .enumerate()
    {
        let truth = seen(file, rank);
        let (u, v) = (reply.floats[9 + 2 * k], reply.floats[10 + 2 * k]);
        assert!(
            (u - truth.x).hypot(v - truth.y) < 0.5,
            "{k}: {u} {v} {truth}"
        );
        let marker = &reply.floats[18 + 3 * k..21 + 3 * k];
        let truth = seen(places[k][0], places[k][1]);
        assert!(
            (marker[0] - truth.x).hypot(marker[1] - truth.y) < 0.2,
            "{marker:?} {truth}"
        );
        assert!((0.005..0.3).contains(&marker[2]), "{marker:?}");
    }
    assert!(
        reply.ints[0] >= 45 && reply.floats[17] < 0.5,
        "{:?} {}",
        reply.ints,
        reply.floats[17]
    );
    // With the lens the pose of the board.
    assert!(
        ask(
            &sorm,
            "findBrdMarker CTRL -lens 640 640 320 240 0 0 0 0 0 -square 0.05"
        )
        .is_ok()
    );
    let reply = ask(&sorm, &format!("findBrdMarker EXEC TMSG {path}"));
    assert_eq!(reply.floats.len(), 42);
    let pose = lens.camera_from_world();
    let turn = pose.rotation.scaled_axis();
    let truth: Vec<f64> = turn
        .iter()
        .chain(pose.translation.vector.iter())
        .copied()
        .collect();
    for (k, truth) in truth.iter().enumerate() {
        let (found, sd) = (reply.floats[30 + k], reply.floats[36 + k]);
        assert!(
            (found - truth).abs() < f64::max(5.0 * sd, 2e-4),
            "{k}: {found} {truth} {sd}"
        );
        assert!(sd < 5e-3);
    }
    // Nothing there, or the board's squares alone.
    assert!(ask(&sorm, "findBrdMarker CTRL -threshold 253").is_ok());
    let (number, text) = refused(&sorm, &format!("findBrdMarker EXEC {path}"));
    assert_eq!(number, code::MARKERS);
    assert!(text.contains("0 things look like markers"), "{text}");
    // The disc on c1.
    let disk = ask(&sorm, &format!("getDisk EXEC {path} FMSG 2 2.5 0.5"));
    assert!(disk.is_ok(), "{:?}", disk.reports);
    let truth = seen(2.53, 0.48);
    assert_eq!((disk.floats.len(), &disk.ints[..]), (9, &[2][..]));
    let off = (disk.floats[0] - truth.x).hypot(disk.floats[1] - truth.y);
    assert!(off < 0.4, "{:?} {truth}", disk.floats);
    assert!((disk.floats[3] - 2.53).abs() < 0.02 && (disk.floats[4] - 0.48).abs() < 0.02);
    assert!(disk.floats[5..].iter().all(|sd| *sd > 0.0 && *sd < 0.3));
    let (number, _) = refused(&sorm, &format!("getDisk EXEC {path} FMSG 2 4.5 2.5"));
    assert_eq!(number, code::BOARD);
    let near = format!(
        "getDisk EXEC near {path} FMSG 3 {} {} 19",
        truth.x + 4.0,
        truth.y - 3.0
    );
    let near = ask(&sorm, &near);
    assert!(near.is_ok(), "{:?}", near.reports);
    assert_eq!((near.floats.len(), &near.ints[..]), (5, &[2][..]));
    let (number, text) = refused(&sorm, &format!("getDisk EXEC near {path} FMSG 3 100 100 1"));
    assert_eq!(number, sorma::report::code::VALUE);
    assert!(text.contains("3 px and more"), "{text}");
}

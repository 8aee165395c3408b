//! The classes `stereo`, `triangulate`, `handeye` and `diskFind` by their textual requests.

use super::*;
use nalgebra::Isometry3;

#[test]
fn two_cameras_and_their_standard_deviations_come_from_one_table() {
    let rig = |seed: u64| {
        let left = drawn_lens(2 * seed);
        let mut right = left;
        right.rotation = UnitQuaternion::new(Vector3::new(0.05, 0.2, -0.1)) * left.rotation;
        right.centre = left.centre + Vector3::new(0.4, 0.1, 0.05);
        right.intrinsics.fx = 820.0;
        right.distortion = drawn_lens(2 * seed + 1).distortion;
        (left, right)
    };
    let expected_of = |left: &Camera, right: &Camera| -> Vec<f64> {
        let (l, r) = (expected(left), expected(right));
        let between = right.camera_from_world() * left.camera_from_world().inverse();
        let turn = between.rotation.scaled_axis();
        [
            &l[..9],
            &r[..9],
            turn.as_slice(),
            between.translation.vector.as_slice(),
        ]
        .concat()
    };
    let sorm = manager();
    ask(&sorm, "stereo CTRL -size 640 480");
    let (mut squares, runs) = (vec![0.0; 24], 30);
    for seed in 0..runs {
        let (left, right) = rig(seed);
        let truth = expected_of(&left, &right);
        let mut rng = ChaCha8Rng::seed_from_u64(1000 + seed);
        let mut text = String::from("X,Y,Z,uL,vL,uR,vR\n");
        for row in table(&left, 150, 0.3, seed).lines().skip(1) {
            let numbers: Vec<f64> = row.split(',').map(|x| x.parse().unwrap()).collect();
            let point = Point3::new(numbers[0], numbers[1], numbers[2]);
            let Some(seen) = right.project(&point) else {
                continue;
            };
            let mut noise = || -> f64 { 0.3 * rng.sample::<f64, _>(StandardNormal) };
            let (u, v) = (seen.x + noise(), seen.y + noise());
            if is_inside(u, v) {
                writeln!(text, "{row},{u},{v}").unwrap();
            }
        }
        let (_folder, path) = file("stereo.csv", text.as_bytes());
        let reply = ask(&sorm, &format!("stereo EXEC {path}"));
        assert_eq!(reply.floats.len(), 49, "{:?}", reply.reports);
        for (k, square) in squares.iter_mut().enumerate() {
            let ratio = (reply.floats[k] - truth[k]) / reply.floats[24 + k];
            *square += ratio * ratio / runs as f64;
        }
        assert!((reply.floats[48] / (0.3 * 2_f64.sqrt()) - 1.0).abs() < 0.2);
    }
    for (k, square) in squares.iter().enumerate() {
        assert!(
            (0.5..1.5).contains(&square.sqrt()),
            "{k}: {}",
            square.sqrt()
        );
    }
}

fn rows(pose: &Isometry3<f64>) -> String {
    let matrix = pose.to_homogeneous();
    let numbers: Vec<String> = (0..12)
        .map(|k| matrix[(k / 4, k % 4)].to_string())
        .collect();
    numbers.join(",")
}

/// Poses of a tool that looks down, and what the camera on it sees of a target below, which is moved up by `up`, m.
fn poses(up: f64) -> String {
    let tool_t_camera = Isometry3::new(Vector3::new(0.02, -0.04, 0.1), Vector3::new(0.1, 0.2, 1.4));
    let base_t_target = Isometry3::new(
        Vector3::new(0.7, 0.0, 0.1 + up),
        Vector3::new(3.0, 0.1, 0.2),
    );
    let mut text = String::new();
    for k in 0..8 {
        let angle = f64::from(k);
        let turn = Vector3::new(
            0.5 * angle.sin(),
            0.6 * (2.0 * angle).cos(),
            0.3 * angle.cos(),
        );
        let down = Isometry3::rotation(Vector3::new(std::f64::consts::PI, 0.0, 0.0));
        let base_t_tool =
            Isometry3::new(Vector3::new(0.5, 0.1 * angle.sin(), 0.6), Vector3::zeros())
                * down
                * Isometry3::rotation(turn);
        let camera_t_target = (base_t_tool * tool_t_camera).inverse() * base_t_target;
        writeln!(text, "{},{}", rows(&base_t_tool), rows(&camera_t_target)).unwrap();
    }
    text
}

#[test]
fn a_camera_on_a_tool_is_found_and_a_matrix_that_is_no_rotation_is_told_by_line() {
    let text = poses(0.0);
    let sorm = manager();
    let header: Vec<String> = (0..24).map(|k| format!("m{k}")).collect();
    for text in [text.clone(), format!("{}\n{text}", header.join(","))] {
        let (_folder, path) = file("poses.csv", text.as_bytes());
        let reply = ask(&sorm, &format!("handeye EXEC {path}"));
        assert!(reply.is_ok(), "{:?}", reply.reports);
        assert_eq!(reply.floats.len(), 14);
        let expected = [0.1, 0.2, 1.4, 0.02, -0.04, 0.1];
        for (found, expected) in reply.floats.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-9, "{:?}", reply.floats);
        }
    }
    let (_, rest) = text.split_once(',').unwrap();
    let (_folder, path) = file("poses.csv", format!("1.O,{rest}").as_bytes());
    let (_, said) = refused(&sorm, &format!("handeye EXEC {path}"));
    assert!(
        said.contains("must be a finite number, not `1.O`"),
        "{said}"
    );
    let wrong = format!("1.5,{rest}");
    let (_folder, path) = file("poses.csv", wrong.as_bytes());
    let (_, said) = refused(&sorm, &format!("handeye EXEC {path}"));
    assert!(
        said.contains("poses.csv:1:1: the matrix of base_T_tool is no rotation"),
        "{said}"
    );
    let (_folder, path) = file("poses.csv", b"1,2,3\n");
    let (_, said) = refused(&sorm, &format!("handeye EXEC {path}"));
    assert!(said.contains("3 columns stand here, not 24"), "{said}");
}

/// Two cameras beside one another that saw the same points, `apart` m from one another.
fn beside(apart: f64) -> (Camera, Camera) {
    let left = camera(LENS);
    let right = Camera {
        centre: left.centre + Vector3::new(apart, 0.0, 0.0),
        ..left
    };
    (left, right)
}

#[test]
fn a_pair_that_stands_at_one_place_is_told() {
    let sorm = manager();
    ask(&sorm, "stereo CTRL -size 640 480");
    for (apart, told) in [(0.0, true), (0.25, false)] {
        let (left, right) = beside(apart);
        let mut text = String::from("X,Y,Z,uL,vL,uR,vR\n");
        for row in table(&left, 120, 0.1, 3).lines().skip(1) {
            let numbers: Vec<f64> = row.split(',').map(|x| x.parse().unwrap()).collect();
            let seen = right.project(&Point3::new(numbers[0], numbers[1], numbers[2]));
            if let Some(seen) = seen.filter(|seen| is_inside(seen.x, seen.y)) {
                // Some noise of its own.
                let off = 0.2 * (numbers[3] * 7.0).sin();
                writeln!(text, "{row},{},{}", seen.x + off, seen.y - off).unwrap();
            }
        }
        let (_folder, path) = file("pair.csv", text.as_bytes());
        let reply = ask(&sorm, &format!("stereo EXEC {path}"));
        assert!(reply.is_ok(), "{:?}", reply.reports);
        let warned = reply.reports.iter();
        let warned = warned.filter(|report| report.text.contains("from one place"));
        assert_eq!(warned.count(), usize::from(told), "{:?}", reply.reports);
    }
}

fn numbers(camera: &Camera) -> String {
    expected(camera).map(|x| x.to_string()).join(" ")
}

#[test]
fn points_follow_from_pairs_of_pixels_and_what_is_no_pair_is_told_by_line() {
    let (left, right) = beside(0.4);
    let sorm = manager();
    let (_, said) = refused(&sorm, "triangulate EXEC pair FMSG 4 1 2 3 4");
    assert!(
        said.contains("set -left to what `resect` answers"),
        "{said}"
    );
    ask(
        &sorm,
        &format!(
            "triangulate CTRL -left {} -right {} -sd 0.2",
            numbers(&left),
            numbers(&right)
        ),
    );
    let points = [(0.1, 0.05, -0.2), (-0.2, 0.15, 0.1), (0.0, -0.1, 0.0)];
    let mut text = String::from("uL,vL,uR,vR\n");
    for (x, y, z) in points {
        let pixel = |camera: &Camera| camera.project(&Point3::new(x, y, z)).unwrap();
        let (l, r) = (pixel(&left), pixel(&right));
        writeln!(text, "{},{},{},{}", l.x, l.y, r.x, r.y).unwrap();
        let reply = ask(
            &sorm,
            &format!(
                "triangulate EXEC pair FMSG 4 {} {} {} {}",
                l.x, l.y, r.x, r.y
            ),
        );
        let found = &reply.floats;
        assert!(reply.reports.is_empty() && found.len() == 8, "{reply:?}");
        for (found, truth) in found.iter().zip([x, y, z]) {
            assert!((found - truth).abs() < 1e-7, "{reply:?}");
        }
        // Z² / (f b) times the noise of a disparity: facts, section 3.
        let depth = (left.centre.z - z).powi(2) / (800.0 * 0.4) * 0.2 * 2_f64.sqrt();
        assert!((found[5] / depth - 1.0).abs() < 0.2, "{} {depth}", found[5]);
    }
    // Rows of other points: rays that miss one another, and parallel ones.
    text.push_str("320,240,250,300\n");
    let (l, far) = (left, Point3::new(0.1, 0.1, -1e6));
    let far = l.project(&far).unwrap();
    writeln!(text, "{},{},{},{}", far.x, far.y, far.x, far.y).unwrap();
    let (_folder, path) = file("pairs.csv", text.as_bytes());
    let reply = ask(&sorm, &format!("triangulate EXEC {path}"));
    assert!(reply.is_ok(), "{:?}", reply.reports);
    assert_eq!(reply.ints, [0, 1, 2, 3]);
    assert_eq!(reply.floats.len(), 32);
    let said = &reply.reports.last().unwrap().text;
    assert!(
        said.contains("pairs.csv:5:1: the rays miss each other"),
        "{said}"
    );
    assert!(
        said.contains("pairs.csv:6:1: the rays are parallel"),
        "{said}"
    );
    let (_folder, path) = file(
        "pairs.csv",
        format!("{},{},{0},{1}\n", far.x, far.y).as_bytes(),
    );
    let (number, said) = refused(&sorm, &format!("triangulate EXEC {path}"));
    assert!(
        number == code::NO_POINT && said.contains("parallel"),
        "{said}"
    );
}

#[test]
fn a_gripper_is_corrected_by_the_disc_in_a_picture() {
    let seen = |x: f64, y: f64| {
        (
            320.0 + 2000.0 * x + 300.0 * y,
            240.0 - 1900.0 * y + 200.0 * x,
        )
    };
    let mut text = String::from("x,y,u,v,radius\n");
    for (x, y) in [
        (-0.015, -0.015),
        (0.015, -0.015),
        (-0.015, 0.015),
        (0.015, 0.015),
    ] {
        let (u, v) = seen(x, y);
        writeln!(text, "{x},{y},{u},{v},58").unwrap();
    }
    let sorm = manager();
    let (_, said) = refused(&sorm, "diskFind EXEC seen FMSG 3 320 240 58");
    assert!(said.contains("CTRL -train FILE"), "{said}");
    let (_folder, examples) = file("examples.csv", text.as_bytes());
    let trained = ask(
        &sorm,
        &format!("diskFind CTRL -train {examples} -radius 58"),
    );
    assert!(trained.is_ok(), "{:?}", trained.reports);
    let (x, y) = (0.006, -0.009);
    let (u, v) = seen(x, y);
    let reply = ask(&sorm, &format!("diskFind EXEC seen FMSG 3 {u} {v} 58"));
    let [bx, by, sx, sy, error] = reply.floats[..] else {
        panic!("{reply:?}");
    };
    assert!((bx + x).abs() < 1e-9 && (by + y).abs() < 1e-9, "{reply:?}");
    // 0.3 px at 2000 px/m, and the noise of the examples.
    for sd in [sx, sy] {
        assert!((1.3e-4..3e-4).contains(&sd), "{sd}");
    }
    assert!(error < 1e-9, "{error}");
    let back = ask(&sorm, &format!("diskFind EXEC expected FMSG 2 {x} {y}"));
    for (found, truth) in back.floats.iter().zip([u, v, 58.0]) {
        assert!((found - truth).abs() < 1e-6, "{back:?}");
    }
    // Another height, another disc.
    let (number, said) = refused(&sorm, &format!("diskFind EXEC seen FMSG 3 {u} {v} 50"));
    assert!(
        number == code::NO_MAP && said.contains("not the one that was taught"),
        "{said}"
    );
    let mut picture = b"P5 640 480 255\n".to_vec();
    picture.extend((0..640 * 480).map(|at| {
        let far = (f64::from(at % 640) - u).hypot(f64::from(at / 640) - v);
        (60.0 + 150.0 * (58.5 - far).clamp(0.0, 1.0)) as u8
    }));
    let (_folder, path) = file("hand.pgm", &picture);
    let reply = ask(&sorm, &format!("diskFind EXEC {path}"));
    assert!(reply.is_ok() && reply.floats.len() == 10, "{reply:?}");
    assert!(
        (reply.floats[0] + x).abs() < 2e-4 && (reply.floats[1] + y).abs() < 2e-4,
        "{reply:?}"
    );
    assert!(
        (reply.floats[5] - u).hypot(reply.floats[6] - v) < 0.3,
        "{reply:?}"
    );
    let (_folder, path) = file(
        "dark.pgm",
        &[b"P5 640 480 255\n".as_slice(), &[60; 640 * 480]].concat(),
    );
    let (number, said) = refused(&sorm, &format!("diskFind EXEC {path}"));
    assert!(
        number == code::BOARD && said.contains("no disc of about 58 px"),
        "{said}"
    );
    // Three examples are none, and the map that was there stays.
    let three: Vec<&str> = text.lines().take(4).collect();
    let (_folder, few) = file("few.csv", three.join("\n").as_bytes());
    let (_, said) = refused(&sorm, &format!("diskFind CTRL -train {few}"));
    assert!(said.contains("3 examples; the map has 4"), "{said}");
    assert!(ask(&sorm, &format!("diskFind EXEC seen FMSG 3 {u} {v} 58")).is_ok());
}

#[test]
fn a_target_behind_the_camera_and_samples_that_say_little_are_told() {
    let sorm = manager();
    let (_folder, path) = file("poses.csv", poses(2.0).as_bytes());
    let (_, said) = refused(&sorm, &format!("handeye EXEC {path}"));
    assert!(
        said.contains("poses.csv:1:1: the target is -") && said.contains("behind it"),
        "{said}"
    );
    // In decimetres the camera sits a metre off.
    let tenfold: Vec<String> = poses(0.0)
        .lines()
        .map(|row| {
            let numbers = row.split(',').enumerate().map(|(k, one)| {
                let one: f64 = one.parse().unwrap();
                let shift = k % 4 == 3;
                (if shift { 10.0 * one } else { one }).to_string()
            });
            numbers.collect::<Vec<_>>().join(",")
        })
        .collect();
    let (_folder, path) = file("poses.csv", tenfold.join("\n").as_bytes());
    let reply = ask(&sorm, &format!("handeye EXEC {path}"));
    assert!(reply.is_ok(), "{:?}", reply.reports);
    let said = reply.said();
    assert!(said.contains("would sit 1.10 m from the tool"), "{said}");
    // With noise and hardly any turns.
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut text = String::new();
    for row in poses(0.0).lines().take(5) {
        let numbers: Vec<f64> = row.split(',').map(|one| one.parse().unwrap()).collect();
        let numbers = numbers.iter().enumerate().map(|(k, one)| {
            let noise: f64 = rng.sample(StandardNormal);
            (if k % 4 == 3 { one + 0.03 * noise } else { *one }).to_string()
        });
        writeln!(text, "{}", numbers.collect::<Vec<_>>().join(",")).unwrap();
    }
    let (_folder, path) = file("poses.csv", text.as_bytes());
    let said = ask(&sorm, &format!("handeye EXEC {path}")).said();
    assert!(
        said.contains("determine the camera's place poorly"),
        "{said}"
    );
}

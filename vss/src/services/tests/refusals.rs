//! Tables, pictures and options with which something is wrong that was once taken without a word, or told without a place.

use super::*;
use sorma::request::MOST_NUMBERS;

/// A picture of `side` x `side` px in which every second pixel of every second row is bright.
fn dots(side: usize) -> Vec<u8> {
    let mut pgm = format!("P5\n{side} {side}\n255\n").into_bytes();
    let dot = |k: usize| (k % side).is_multiple_of(2) && (k / side).is_multiple_of(2);
    pgm.extend((0..side * side).map(|k| if dot(k) { 255 } else { 10 }));
    pgm
}

#[test]
fn more_components_or_spots_than_a_line_holds_are_told_with_file_number_and_what_to_do() {
    let sorm = manager();
    let (_folder, path) = file("dots.pgm", &dots(300));
    for words in ["", "tree ", "expect "] {
        let (code, said) = refused(&sorm, &format!("blobs EXEC TMSG {words}{path}"));
        assert_eq!(code, super::code::NO_SPOT);
        for part in [
            path.as_str(),
            "22500 components",
            "-most 20000",
            "-min",
            "-threshold",
        ] {
            assert!(said.contains(part), "{part}: {said}");
        }
    }
    // Whoever asks for all of them is told what a line holds.
    assert!(ask(&sorm, "blobs CTRL -most 30000").is_ok());
    let said = ask(&sorm, &format!("blobs EXEC TMSG {path}")).said();
    let most = MOST_NUMBERS.to_string();
    for part in [
        path.as_str(),
        "270000 floats",
        most.as_str(),
        "ask for less",
    ] {
        assert!(said.contains(part), "{part}: {said}");
    }
    assert!(ask(&sorm, "spot CTRL -threshold 200 -min-area 1").is_ok());
    let (code, said) = refused(&sorm, &format!("spot EXEC TMSG {path}"));
    assert_eq!(code, super::code::NO_SPOT);
    for part in [path.as_str(), "22500 spots", "-most 10000", "-min-area"] {
        assert!(said.contains(part), "{part}: {said}");
    }
}

const PAIR: &str = "triangulate CTRL -left 500 500 250 250 0 0 0 0 0 0 0 0 0 0 0";

#[test]
fn pairs_of_pixels_that_are_none_and_cameras_at_one_place_are_named() {
    let sorm = manager();
    let right = |pose: &str| format!("{PAIR} -right 500 500 250 250 0 0 0 0 0 {pose}");
    assert!(ask(&sorm, &right("0 -0.2 0 -0.196 0 -0.04")).is_ok());
    let (_folder, path) = file("pairs.csv", b"uL,vL,uR,vR\n");
    let (_, said) = refused(&sorm, &format!("triangulate EXEC {path}"));
    assert!(said.contains("pairs.csv: the table has no rows"), "{said}");
    let (_, said) = refused(&sorm, "triangulate EXEC pair FMSG 4 1e5 250 -1e5 250");
    assert!(
        said.contains("more than 80 degrees beside the camera's axis"),
        "{said}"
    );
    let (_, said) = refused(&sorm, "triangulate EXEC pair FMSG 4 1e300 250 250 250");
    assert!(said.len() < 300, "{said}");
    assert!(ask(&sorm, &right("0 0 0 0 0 0")).is_ok());
    let (_, said) = refused(&sorm, "triangulate EXEC pair FMSG 4 250 250 240 250");
    assert!(said.contains("both cameras stand at one place"), "{said}");
    assert!(ask(&sorm, &right("0 -0.2 0 -196 0 -40")).is_ok());
    let (_, said) = refused(&sorm, "triangulate EXEC pair FMSG 4 250 250 240 250");
    assert!(
        said.contains("-right says that the world's origin is 200 m from the camera"),
        "{said}"
    );
}

#[test]
fn rows_that_repeat_others_number_for_number_are_told_by_line() {
    let sorm = manager();
    ask(&sorm, "resect CTRL -size 640 480");
    let once = table(&camera(LENS), 60, 0.1, 7);
    let rows: Vec<&str> = once.lines().skip(1).collect();
    let twice = format!("{once}{}\n{}\n", rows[3], rows[4]);
    for (text, told) in [(once.as_str(), false), (twice.as_str(), true)] {
        let (_folder, path) = file("lights.csv", text.as_bytes());
        let said = ask(&sorm, &format!("resect EXEC {path}")).said();
        let part = "2 of 62 rows repeat an earlier one";
        assert_eq!(said.contains(part), told, "{said}");
        assert_eq!(said.contains("lights.csv:62:1"), told, "{said}");
    }
}

#[test]
fn a_model_of_enormous_coordinates_is_told_to_be_one() {
    let sorm = manager();
    ask(&sorm, "pose CTRL -lens 500 500 250 250 0 0 0 0 0");
    let text = "X,Y,Z,u,v\n0,0,0,1,2\n1e200,0,0,3,4\n0,1e200,0,5,6\n0,0,1e200,7,9\n";
    let (_folder, path) = file("model.csv", text.as_bytes());
    let (_, said) = refused(&sorm, &format!("pose EXEC {path}"));
    assert!(
        said.contains("model.csv: a point of the model is 1.0e200 m"),
        "{said}"
    );
}

/// Views of a board of 6 x 5 corners, whose places are multiplied by `scale`.
fn board_views(scale: f64, name: impl Fn(usize) -> f64) -> String {
    let lens = camera(Distortion::default());
    let mut text = String::from("view,X,Y,u,v\n");
    let turns = [[0.5, 0.1], [-0.5, 0.2], [0.1, 0.5], [-0.2, -0.5]];
    for (view, [a, b]) in turns.into_iter().enumerate() {
        let turn = UnitQuaternion::new(Vector3::new(a, b, 0.1));
        let seen = Camera {
            rotation: turn,
            centre: turn.inverse() * Point3::new(0.08, 0.06, -0.6),
            ..lens
        };
        for k in 0..30 {
            let (x, y) = (0.03 * f64::from(k % 6), 0.03 * f64::from(k / 6));
            let pixel = seen.project(&Point3::new(x, y, 0.0)).unwrap();
            let name = name(view);
            writeln!(
                text,
                "{name},{},{},{},{}",
                scale * x,
                scale * y,
                pixel.x,
                pixel.y
            )
            .unwrap();
        }
    }
    text
}

#[test]
fn boards_in_other_units_and_views_without_whole_numbers_are_refused() {
    let sorm = manager();
    ask(&sorm, "planecal CTRL -size 640 480 -model none");
    let told = |text: &str| {
        let (_folder, path) = file("board.csv", text.as_bytes());
        ask(&sorm, &format!("planecal EXEC {path}")).said()
    };
    assert_eq!(told(&board_views(1.0, |view| view as f64)), "");
    let said = told(&board_views(1e3, |view| view as f64));
    assert!(said.contains("are these millimetres"), "{said}");
    let said = told(&board_views(1e-3, |view| view as f64));
    assert!(said.contains("all corners lie within 1.5e-4 m"), "{said}");
    let said = told(&board_views(1.0, |view| view as f64 + 0.5));
    assert!(said.contains("board.csv:2:1: the view is 0.5"), "{said}");
    let said = told(&board_views(1.0, |view| view as f64 * 1e300));
    assert!(said.contains("numbered by whole numbers"), "{said}");
}

#[test]
fn times_that_are_most_likely_in_another_unit_are_told() {
    let sorm = manager();
    ask(&sorm, "abg CTRL -lambda 0.5 -period 0.1");
    for (step, told) in [(0.1, false), (1.0, false), (100.0, true), (1e-4, true)] {
        let rows = (0..20).map(|k| format!("{:?},0.5\n", step * f64::from(k)));
        let text = format!("t,z\n{}", rows.collect::<String>());
        let (_folder, path) = file("track.csv", text.as_bytes());
        let reply = ask(&sorm, &format!("abg EXEC TMSG filter {path}"));
        assert_eq!(reply.floats.len(), 80);
        assert_eq!(
            reply.said().contains("are times in s"),
            told,
            "{step}: {}",
            reply.said()
        );
    }
    // 2 ms there and back, and the same in milliseconds.
    for (unit, told) in [(1.0, false), (1e3, true)] {
        let row = |k: f64| [k, k + 0.001, k + 0.001, k + 0.002].map(|t| (unit * t).to_string());
        let rows = (0..20).map(|k| row(f64::from(k)).join(",") + "\n");
        let text = format!("t1,t2,t3,t4\n{}", rows.collect::<String>());
        let (_folder, path) = file("clocks.csv", text.as_bytes());
        let reply = ask(&sorm, &format!("clockfit EXEC TMSG {path}"));
        assert!(reply.is_ok(), "{:?}", reply.reports);
        assert_eq!(
            reply.said().contains("are these milliseconds"),
            told,
            "{}",
            reply.said()
        );
    }
}

#[test]
fn what_is_outside_of_a_picture_is_told_in_pixels() {
    let sorm = manager();
    let (_folder, path) = file("dots.pgm", &dots(100));
    let (_, said) = refused(
        &sorm,
        &format!("getDisk EXEC TMSG near {path} FMSG 3 500 20 10"),
    );
    assert!(
        said.contains("100 x 100 px, and 500.0, 20.0 is outside of it"),
        "{said}"
    );
}

/// It stands 2 m above the origin and looks down.
const SCANNER: &str = "laser CTRL -pose 3.141592653589793 0 0 0 0 2 -offset 0.02 -gain 0.1 0.1 -camera 500 500 250 250 0 0 0 0 0 3.141592653589793 0 0 -0.5 0 2";

#[test]
fn commands_beams_and_tables_that_no_scanner_has_are_named_with_their_place() {
    let sorm = manager();
    assert!(ask(&sorm, SCANNER).is_ok());
    let told = |line: &str| {
        let reply = ask(&sorm, line);
        (reply.is_ok(), reply.said())
    };
    let (ok, said) = told("laser EXEC beam FMSG 2 1e9 0");
    assert!(!ok && said.contains("more than 80 degrees"), "{said}");
    for place in ["0 0 5", "1e300 0 0"] {
        let (ok, said) = told(&format!("laser EXEC aim FMSG 3 {place}"));
        assert!(
            !ok && said.contains("the place is not before the scanner"),
            "{said}"
        );
    }
    // A spot that is not of the beam.
    let (ok, said) = told("laser EXEC spot FMSG 4 0 0 125 400");
    assert!(ok && said.contains("miss each other by"), "{said}");
    let (ok, said) = told("laser EXEC spot FMSG 4 0 0 125 250");
    assert!(ok && said.is_empty(), "{said}");
    let aimed = |x: f64, y: f64, z: f64| {
        let reply = ask(&sorm, &format!("laser EXEC aim FMSG 3 {x} {y} {z}"));
        (reply.floats[0], reply.floats[1])
    };
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let mut rows: Vec<[f64; 5]> = Vec::new();
    for k in 0..40 {
        let (x, y) = (0.15 * f64::from(k % 5) - 0.3, 0.1 * f64::from(k / 5) - 0.3);
        let z = if k % 2 == 0 { 0.0 } else { 0.4 };
        let (a, b) = aimed(x, y, z);
        let mut noise = || -> f64 { 1e-4 * rng.sample::<f64, _>(StandardNormal) };
        rows.push([a, b, x + noise(), y + noise(), z + noise()]);
    }
    let calibrated = |rows: &[[f64; 5]]| {
        let text = rows
            .iter()
            .map(|row| row.map(|one| format!("{one:?}")).join(","));
        let text = format!("a,b,X,Y,Z\n{}\n", text.collect::<Vec<_>>().join("\n"));
        let (_folder, path) = file("met.csv", text.as_bytes());
        told(&format!("laser EXEC TMSG calibrate {path}"))
    };
    assert_eq!(calibrated(&rows), (true, String::new()));
    let changed = |by: &dyn Fn(usize, &mut [f64; 5])| {
        let mut rows = rows.clone();
        for (k, row) in rows.iter_mut().enumerate() {
            by(k, row);
        }
        calibrated(&rows)
    };
    let (ok, said) = changed(&|_, row| row[2..].iter_mut().for_each(|one| *one *= 1e3));
    assert!(
        !ok && said.contains("met.csv: ") && said.contains("millimetres"),
        "{said}"
    );
    let (ok, said) = changed(&|k, row| row[0] *= if k == 3 { 1e6 } else { 1.0 });
    assert!(
        !ok && said.contains("met.csv:5:1: the command turns the beam"),
        "{said}"
    );
    let (ok, said) = changed(&|_, row| row.swap(0, 1));
    assert!(
        !ok && said.contains("no scanner near the start explains"),
        "{said}"
    );
    let (ok, said) = changed(&|_, row| row[2] = -row[2]);
    assert!(
        ok && said.contains("the gain of the first mirror has another sign"),
        "{said}"
    );
    let (ok, said) = changed(&|k, row| row[3] += if k == 7 { 0.05 } else { 0.0 });
    assert!(ok && said.contains("met.csv:9:1 by 0.0"), "{said}");
    let (_, said) = calibrated(&rows[..3]);
    assert!(
        said.contains("met.csv: 3 points; 8 or more are needed"),
        "{said}"
    );
    // On one plane, some millimetres beside it.
    let flat = rows.iter().filter(|row| row[4] < 0.2).enumerate();
    let flat = flat.map(|(k, row)| {
        let off = if k.is_multiple_of(3) { 4e-3 } else { -2e-3 };
        [row[0], row[1], row[2] + off, row[3] - off, row[4]]
    });
    let (ok, said) = calibrated(&flat.collect::<Vec<_>>());
    assert!(
        !ok || said.contains("determine the scanner poorly"),
        "{said}"
    );
}

//! The classes `blobs`, `psom`, `abg` and `clockfit` by their textual requests.

use super::*;

fn floats(reply: &Transport) -> &[f64] {
    assert!(reply.is_ok(), "{:?}", reply.reports);
    &reply.floats
}

fn picture(rows: &[&str]) -> (tempfile::TempDir, String) {
    let grey = |mark: u8| match mark {
        b'.' => 10,
        b'o' => 100,
        _ => 200,
    };
    let pixels: Vec<u8> = rows.concat().bytes().map(grey).collect();
    let mut bytes = Vec::new();
    crate::png::write(&mut bytes, rows[0].len(), rows.len(), &pixels).unwrap();
    file("blobs.png", &bytes)
}

#[test]
fn blobs_have_their_moments_boxes_and_holes_in_the_order_of_their_first_pixels() {
    let (_folder, path) = picture(&[
        "..###.....", //
        "..#.#...##", //
        "..###..o..", //
        "..........",
    ]);
    let sorm = manager();
    let reply = ask(&sorm, &format!("blobs EXEC {path}"));
    assert_eq!(reply.ints, [2]);
    let ring = [8.0, 3.0, 1.0, 0.75, 0.0, 0.75, 2.0, 0.0, 4.0, 2.0, 0.0, 0.0];
    let bar = [2.0, 8.5, 1.0, 0.25, 0.0, 0.0, 8.0, 1.0, 9.0, 1.0, 1.0, 1.0];
    assert_eq!(floats(&reply), [ring, bar].concat());
    // The grey pixel touches the bar at a corner.
    ask(&sorm, "blobs CTRL -threshold 99");
    assert_eq!(ask(&sorm, &format!("blobs EXEC {path}")).ints, [2]);
    ask(&sorm, "blobs CTRL -connectivity 4");
    assert_eq!(ask(&sorm, &format!("blobs EXEC {path}")).ints, [3]);
    ask(&sorm, "blobs CTRL -min 3");
    assert_eq!(ask(&sorm, &format!("blobs EXEC {path}")).ints, [1]);
}

#[test]
fn a_threshold_itself_is_background_bright_and_dark() {
    let (_folder, path) = picture(&["#o.", "#o."]);
    let sorm = manager();
    let count = |options: &str| {
        ask(&sorm, &format!("blobs CTRL {options}"));
        let reply = ask(&sorm, &format!("blobs EXEC {path}"));
        floats(&reply)
            .chunks(12)
            .map(|blob| blob[0])
            .collect::<Vec<f64>>()
    };
    assert_eq!(count("-threshold 99"), [4.0]);
    assert_eq!(count("-threshold 100"), [2.0]);
    assert_eq!(count("-threshold 200"), Vec::<f64>::new());
    assert_eq!(count("-threshold 255"), Vec::<f64>::new());
    assert_eq!(count("-threshold 100 -dark on"), [2.0]);
    assert_eq!(count("-threshold 101"), [4.0]);
    assert_eq!(count("-threshold 0"), Vec::<f64>::new());
    assert_eq!(count("-threshold 0 -dark off"), [6.0]);
}

#[test]
fn a_map_is_trained_completed_differentiated_and_saved_by_text() {
    let mut text = "a,b,x,y\n".to_owned();
    for (a, b) in [(1, 0), (0, 0), (2, 0), (0, 3), (2, 3), (1, 3)] {
        writeln!(text, "{a},{b},{},{}", a * a + b, 2 * a).unwrap();
    }
    let (folder, path) = file("nodes.csv", text.as_bytes());
    let sorm = manager();
    let (code, said) = refused(&sorm, "psom EXEC complete FMSG 4 1 1 1 1");
    assert_eq!(code, code::NO_MAP, "{said}");
    assert!(ask(&sorm, &format!("psom CTRL -train {path} -params 2")).is_ok());
    let reply = ask(&sorm, "psom EXEC complete FMSG 4 2.75 3 1 1");
    for (found, expected) in floats(&reply).iter().zip([2.75, 3.0, 1.5, 0.5, 0.0]) {
        assert!((found - expected).abs() < 1e-9, "{reply:?}");
    }
    assert_eq!(reply.floats.len(), 5);
    let reply = ask(&sorm, "psom EXEC jacobian FMSG 2 1.5 0.5");
    for (found, expected) in floats(&reply).iter().zip([3.0, 1.0, 2.0, 0.0]) {
        assert!((found - expected).abs() < 1e-12, "{reply:?}");
    }
    let saved = folder.path().join("saved.csv").display().to_string();
    assert!(ask(&sorm, &format!("psom EXEC save {saved}")).is_ok());
    assert!(
        fs::read_to_string(&saved)
            .unwrap()
            .starts_with("a,b,x,y\n0.0,0.0,0.0,0.0\n")
    );
    let other = manager();
    assert!(ask(&other, &format!("psom CTRL -train {saved} -params 2")).is_ok());
    let again = ask(&other, "psom EXEC value FMSG 2 1.5 0.5");
    assert!((floats(&again)[0] - 2.75).abs() < 1e-12);
}

#[test]
fn a_table_that_is_no_map_is_told_and_the_map_that_was_there_stays() {
    let sorm = manager();
    let (_folder, good) = file("good.csv", b"s,x\n0,1\n1,2\n");
    let (_other, hole) = file("hole.csv", b"s,t,x\n0,0,1\n1,0,2\n0,1,3\n");
    let (_third, bare) = file("bare.csv", b"0,1\n1,2\n");
    assert!(ask(&sorm, &format!("psom CTRL -train {good} -params 1")).is_ok());
    for (line, words) in [
        (
            format!("psom CTRL -train {hole} -params 2"),
            "no row for [1.0, 1.0]",
        ),
        (format!("psom CTRL -train {bare} -params 1"), "bare.csv:1:1"),
        (
            "psom CTRL -train nowhere.csv -params 1".to_owned(),
            "nowhere.csv",
        ),
        (format!("psom CTRL -train {good} -params 2"), "no component"),
    ] {
        let (_, said) = refused(&sorm, &line);
        assert!(said.contains(words), "{said}");
        assert_eq!(
            floats(&ask(&sorm, "psom EXEC value FMSG 1 0.5")),
            [1.5],
            "{line}"
        );
    }
    let (_, said) = refused(&sorm, "psom EXEC complete FMSG 3 1 2 3");
    assert!(said.contains("takes 2 floats here"), "{said}");
    let far = ask(&sorm, "psom EXEC complete FMSG 2 9 1");
    assert_eq!(far.reports[0].code, code::NO_MAP, "{far:?}");
    // A local map says so as well.
    ask(&sorm, "psom CTRL -local 2");
    let far = ask(&sorm, "psom EXEC complete FMSG 2 9 1");
    assert_eq!(far.reports[0].code, code::NO_MAP, "{far:?}");
}

#[test]
fn the_filter_answers_gains_and_follows_a_table_with_gaps() {
    let sorm = manager();
    let (_, said) = refused(&sorm, "abg EXEC gains");
    assert!(said.contains("no manoeuvring index"), "{said}");
    ask(&sorm, "abg CTRL -lambda 1 -period 0.1");
    let gains = floats(&ask(&sorm, "abg EXEC gains")).to_vec();
    let (alpha, beta, gamma) = (gains[0], gains[1], gains[2]);
    assert!((gamma * gamma / (1.0 - alpha) - 1.0).abs() < 1e-12);
    // The same index from the two standard deviations.
    ask(&sorm, "abg CTRL -sigma-w 50 -sigma-v 0.5");
    assert_eq!(floats(&ask(&sorm, "abg EXEC gains")), gains);
    let (_folder, path) = file("track.csv", b"t,z\n0,1\n0.1,2\n0.2,\n0.4,3\n");
    let found = floats(&ask(&sorm, &format!("abg EXEC filter {path}"))).to_vec();
    let after = [1.0 + alpha, beta / 0.1, gamma / 0.01];
    let gap = [
        after[0] + 0.1 * after[1] + 0.005 * after[2],
        after[1] + 0.1 * after[2],
        after[2],
    ];
    let before = gap[0] + 0.2 * gap[1] + 0.02 * gap[2];
    // The interval is twice the period, and so the index four times as large.
    let wide = crate::tracking::Gains::of(4.0).unwrap();
    let last = before + wide.alpha * (3.0 - before);
    let expected = [
        [1.0, 0.0, 0.0, 1.0],
        [after[0], after[1], after[2], 1.0],
        [gap[0], gap[1], gap[2], gap[0]],
    ];
    for (found, expected) in found.iter().zip(expected.concat()) {
        assert!((found - expected).abs() < 1e-12, "{found} {expected}");
    }
    assert!((found[12] - last).abs() < 1e-12 && (found[15] - before).abs() < 1e-12);
}

#[test]
fn tables_that_no_filter_follows_are_refused_with_the_place() {
    let sorm = manager();
    ask(&sorm, "abg CTRL -lambda 1");
    for (text, words) in [
        ("t,z\n0,\n1,2\n", "track.csv:2:1: the first row has no z"),
        ("t,z\n0,1\n0,2\n", "track.csv:3:1: t is 0.0 s, not after"),
        ("t,z\n0,1\n,2\n", "t must be a finite number, not ``"),
        ("t,x\n0,1\n", "the header lacks z"),
        ("t,z\n", "track.csv: the table has no rows"),
        (
            "t,z\n0,1\n1e300,2\n",
            "track.csv:3:1: no filter follows over the 1e300 s",
        ),
    ] {
        let (_folder, path) = file("track.csv", text.as_bytes());
        let (_, said) = refused(&sorm, &format!("abg EXEC filter {path}"));
        assert!(said.contains(words), "{said}");
    }
    let (_, said) = refused(&sorm, "abg CTRL -lambda 1 -sigma-v 2");
    assert!(said.contains("give one or the other"), "{said}");
}

/// Exchanges of two clocks whose difference is known, with delays that are sometimes long and never even.
fn exchanges(offset: f64, drift: f64, seed: u64) -> (String, f64) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut text = "t1,t2,t3,t4\n".to_owned();
    let mut last = 0.0;
    for number in 0..100 {
        let t1 = f64::from(number);
        let mut way = || {
            1e-3 + if rng.random_bool(0.2) {
                rng.random_range(0.0..0.1)
            } else {
                rng.random_range(0.0..1e-4)
            }
        };
        let (there, back) = (t1 + way(), way());
        let server = |t: f64| t + offset + drift * t;
        let t4 = there + 2e-3 + back;
        writeln!(
            text,
            "{t1:.9},{:.9},{:.9},{t4:.9}",
            server(there),
            server(there + 2e-3)
        )
        .unwrap();
        last = offset + drift * t4;
    }
    (text, last)
}

#[test]
fn the_difference_of_clocks_is_within_its_bound_and_the_drift_is_found() {
    let sorm = manager();
    for (seed, offset, drift) in [(1, 3.25, 50e-6), (2, -1e5, -120e-6), (3, 1.7e9, 0.0)] {
        let (text, truth) = exchanges(offset, drift, seed);
        let (_folder, path) = file("clocks.csv", text.as_bytes());
        let reply = ask(&sorm, &format!("clockfit EXEC {path}"));
        let [difference, rate, bound] = floats(&reply) else {
            panic!("{reply:?}");
        };
        // The bound holds although times near 1.7e9 s have steps of 0.24 us.
        assert!(
            (difference - truth).abs() <= *bound,
            "{difference} {truth} {bound}"
        );
        assert!(
            *bound < 3e-3 && (rate - drift).abs() < 3e-6,
            "{bound} {rate}"
        );
        assert!(reply.reports.is_empty(), "{reply:?}");
    }
}

#[test]
fn clocks_that_drift_faster_than_was_said_are_fitted_all_the_same_and_told() {
    let sorm = manager();
    let (text, truth) = exchanges(0.5, 2e-3, 7);
    let (_folder, path) = file("clocks.csv", text.as_bytes());
    let reply = ask(&sorm, &format!("clockfit EXEC {path}"));
    let [difference, rate, bound] = floats(&reply) else {
        panic!("{reply:?}");
    };
    assert!(
        (difference - truth).abs() <= *bound && (rate - 2e-3).abs() < 3e-5,
        "{reply:?}"
    );
    assert_eq!(reply.reports[0].code, code::CLOCKS);
    let (_other, path) = file("clocks.csv", b"t1,t2,t3,t4\n0,5,4,1\n");
    let (_, said) = refused(&sorm, &format!("clockfit EXEC {path}"));
    assert!(
        said.contains("clocks.csv:2:1: the times run backwards"),
        "{said}"
    );
    // No reply is here sooner than the server had the request.
    for longer in ["0,5,5.5,0.2", "1.7e9,5,5.001,1700000000.0"] {
        let text = format!("t1,t2,t3,t4\n0,5.001,5.001,0.002\n{longer}\n");
        let (_other, path) = file("clocks.csv", text.as_bytes());
        let (_, said) = refused(&sorm, &format!("clockfit EXEC {path}"));
        assert!(
            said.contains("clocks.csv:3:1: the server had the request for longer"),
            "{said}"
        );
    }
}

use std::{fmt::Write as _, fs};

use futures_util::FutureExt as _;
use sorma::{Dictionary, Reply, Sorm};

use super::*;

fn ask(sorm: &Sorm, line: &str) -> Transport {
    let told = sorm.tell(&sorma::Alone, line, "").now_or_never().unwrap();
    told.parse::<Reply>().unwrap().body
}

fn floats(sorm: &Sorm, line: &str) -> Vec<f64> {
    let reply = ask(sorm, line);
    assert!(reply.is_ok(), "{line}: {:?}", reply.reports);
    reply.floats
}

#[test]
fn a_scanner_is_pointed_triangulated_and_calibrated_by_lines_of_text() {
    let sorm = Sorm::new(Dictionary::new());
    super::super::register(&sorm);
    // It stands 2 m above the origin and looks down, as the camera beside it does.
    ask(
        &sorm,
        "laser CTRL -pose 3.141592653589793 0 0 0 0 2 -offset 0.02 -gain 0.1 0.1",
    );
    let command = floats(&sorm, "laser EXEC aim FMSG 3 0.3 -0.2 0");
    let beam = floats(
        &sorm,
        &format!("laser EXEC beam FMSG 2 {} {}", command[0], command[1]),
    );
    let along = -beam[2] / beam[5];
    assert!((beam[0] + along * beam[3] - 0.3).abs() < 1e-9, "{beam:?}");
    assert!((beam[1] + along * beam[4] + 0.2).abs() < 1e-9, "{beam:?}");
    let unset = ask(&sorm, "laser EXEC spot FMSG 4 0 0 250 250");
    assert!(unset.reports[0].text.contains("-camera"), "{unset:?}");
    ask(
        &sorm,
        "laser CTRL -camera 500 500 250 250 0 0 0 0 0 3.141592653589793 0 0 -0.5 0 2",
    );
    // It stands at (0.5, 0, 2): the point is 0.2 m to its left in x, and y is turned.
    let (u, v) = (250.0 + 500.0 * -0.2 / 2.0, 250.0 + 500.0 * 0.2 / 2.0);
    let line = format!(
        "laser EXEC spot FMSG 4 {} {} {u} {v}",
        command[0], command[1]
    );
    let met = floats(&sorm, &line);
    for (met, truth) in met.iter().zip([0.3, -0.2, 0.0, 0.0]) {
        assert!((met - truth).abs() < 1e-9, "{met}");
    }
    // Depth by a base of 0.5 m from 2 m: Z^2 / (f b) of a pixel's standard deviation.
    assert_eq!(met.len(), 8);
    assert!((met[6] / 1.6e-3 - 1.0).abs() < 0.05, "{met:?}");
    assert!(met[7] > 1e-4, "{met:?}");
    let alone = ask(&sorm, "laser EXEC point FMSG 3 0.3 -0.2 0");
    assert!(alone.reports[0].text.contains("attach to one"), "{alone:?}");
    let met = floats(&sorm, &format!("laser EXEC line FMSG 6 0 0 1 0 {u} {v}"));
    assert!(
        (met[0] - 0.3).abs() < 1e-9 && (met[1] + 0.2).abs() < 1e-9 && (met[3] - 4e-4).abs() < 1e-6,
        "{met:?}"
    );
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| {
        let path = folder.path().join(name);
        fs::write(&path, text).unwrap();
        path.display().to_string()
    };
    let (mut samples, mut points) = (String::from("a,b,X,Y,Z\n"), String::from("X,Y,Z\n"));
    for k in 0..24 {
        let (x, y) = (0.2 * f64::from(k % 4) - 0.3, 0.15 * f64::from(k / 4) - 0.3);
        let z = if k % 2 == 0 { 0.0 } else { 0.4 };
        let at = floats(&sorm, &format!("laser EXEC aim FMSG 3 {x} {y} {z}"));
        let _ = writeln!(samples, "{:?},{:?},{x:?},{y:?},{z:?}", at[0], at[1]);
        let _ = writeln!(points, "{x:?},0.25,{z:?}");
    }
    let plane = floats(
        &sorm,
        &format!("laser EXEC plane {}", write("p.csv", &points)),
    );
    assert!(
        (plane[1].abs() - 1.0).abs() < 1e-9 && (plane[1] * plane[3] - 0.25).abs() < 1e-9,
        "{plane:?}"
    );
    // From a start that is off.
    ask(
        &sorm,
        "laser CTRL -pose 3.1 0.02 0.01 0.02 0 1.95 -offset 0.01 -gain 0.095 0.105",
    );
    let found = floats(
        &sorm,
        &format!("laser EXEC calibrate {}", write("s.csv", &samples)),
    );
    assert_eq!(found.len(), 22);
    assert!(found[11] < 1e-6, "{found:?}");
    let few = ask(
        &sorm,
        &format!(
            "laser EXEC calibrate {}",
            write("f.csv", "a,b,X,Y,Z\n0,0,0,0,0\n")
        ),
    );
    assert!(few.reports[0].text.contains("8 or more"), "{few:?}");
}

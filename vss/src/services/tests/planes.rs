//! The classes `corners` and `planecal` by their textual requests, and OpenCV's answers to the same.

#[path = "../../../tools/src/chequer/rendered.rs"]
mod rendered;

use super::*;
use rendered::{camera as before_board, rendered, truth};
use std::process::Command;

/// Pictures of a board of 8 x 5 inner corners whose fields are 1 wide.
fn turns() -> [Vector3<f64>; 6] {
    [
        Vector3::new(0.5, 0.1, 0.05),
        Vector3::new(-0.5, 0.1, 0.3),
        Vector3::new(0.1, 0.55, -0.2),
        Vector3::new(0.05, -0.5, 0.1),
        Vector3::new(0.35, 0.4, -0.4),
        Vector3::new(-0.3, 0.35, 0.2),
    ]
}

fn png(turn: Vector3<f64>, seed: u64) -> Vec<u8> {
    let picture = rendered(&before_board(turn, 22.0, 8, 5), 8, 5, 2.0, seed);
    let mut bytes = Vec::new();
    crate::png::write(&mut bytes, 320, 240, &picture.grey()).unwrap();
    bytes
}

/// The corners of each picture by the class, as a table for `planecal`; fields are 30 mm wide.
fn corners(sorm: &Sorm) -> (String, Vec<Vec<f64>>) {
    assert!(ask(sorm, "corners CTRL -inner 8 5").is_ok());
    let (mut text, mut all) = (String::from("view,X,Y,u,v\n"), Vec::new());
    for (view, turn) in turns().into_iter().enumerate() {
        let (_folder, path) = file("board.png", &png(turn, view as u64));
        let reply = ask(sorm, &format!("corners EXEC TMSG {path}"));
        assert_eq!(
            (reply.floats.len(), reply.ints.as_slice()),
            (160, &[8, 5][..]),
            "{:?}",
            reply.reports
        );
        let truth = truth(&before_board(turn, 22.0, 8, 5), 8, 5);
        for (k, (corner, truth)) in reply.floats.chunks(4).zip(truth).enumerate() {
            let &[u, v, sd_u, sd_v] = corner else {
                panic!("{corner:?}");
            };
            let off = (u - truth.x).hypot(v - truth.y);
            assert!(
                off < 0.2 && sd_u < 0.1 && sd_v < 0.1,
                "{view} {k}: {corner:?} {truth}"
            );
            let (x, y) = (0.03 * (k % 8) as f64, 0.03 * (k / 8) as f64);
            writeln!(text, "{view},{x},{y},{u:?},{v:?}").unwrap();
        }
        all.push(reply.floats.clone());
    }
    (text, all)
}

#[test]
fn a_camera_comes_from_pictures_of_a_board() {
    let sorm = manager();
    let (text, _) = corners(&sorm);
    let (_folder, path) = file("views.csv", text.as_bytes());
    assert!(
        refused(&sorm, &format!("planecal EXEC {path}"))
            .1
            .contains("-size W H")
    );
    ask(&sorm, "planecal CTRL -size 320 240 -model k1k2");
    let reply = ask(&sorm, &format!("planecal EXEC TMSG {path}"));
    assert_eq!(reply.floats.len(), 19 + 12 * 6, "{:?}", reply.reports);
    assert_eq!(reply.ints, [6, 0, 1, 2, 3, 4, 5]);
    let truth = before_board(turns()[0], 22.0, 8, 5).intrinsics;
    for (k, truth) in [truth.fx, truth.fy, truth.cx, truth.cy]
        .into_iter()
        .enumerate()
    {
        let (found, sd) = (reply.floats[k], reply.floats[9 + k]);
        // Two terms of the lens are not in this model, and shift the principal point.
        assert!(
            (found - truth).abs() < 4.0 * sd + 0.01 * truth,
            "{k}: {found} {sd} {truth}"
        );
    }
    assert!(reply.floats[18] < 0.1, "{}", reply.floats[18]);
    // The first view: 22 fields of 30 mm away.
    let z = reply.floats[19 + 5];
    assert!((0.55..0.75).contains(&z), "{z}");
    let wrong = |text: &str| {
        let (_folder, path) = file("views.csv", text.as_bytes());
        let (_, told) = refused(&sorm, &format!("planecal EXEC {path}"));
        told
    };
    let mm = wrong("view,X,Y,u,v\n1,0,0,5,5\n1,30,0,9,9\n");
    assert!(
        mm.contains(":3:1: a corner at (30, 0) m") && mm.contains("millimetres"),
        "{mm}"
    );
    let off = wrong("view,X,Y,u,v\n1,0,0,5,500\n");
    assert!(off.contains("outside the picture of 320 x 240"), "{off}");
    let few = wrong("view,X,Y,u,v\n1,0,0,5,5\n");
    assert!(
        few.contains("1 views; a calibration from a plane needs 3"),
        "{few}"
    );
    let (_folder, path) = file("grey.png", &spots_png(&[(30.0, 30.0)], false));
    let (number, told) = refused(&sorm, &format!("corners EXEC {path}"));
    assert_eq!(number, code::NO_CORNERS, "{told}");
}

/// Both tasks by OpenCV, on the same pictures and tables.
const JUDGE: &str = "
import sys, cv2, numpy as np
folder = sys.argv[1]
rows = np.loadtxt(folder + '/views.csv', delimiter=',', skiprows=1)
ids = sorted(set(rows[:, 0]))
obj = [np.c_[rows[rows[:, 0] == i][:, 1:3], np.zeros((rows[:, 0] == i).sum())].astype(np.float32) for i in ids]
img = [rows[rows[:, 0] == i][:, 3:5].astype(np.float32) for i in ids]
rms, K, d, _, _ = cv2.calibrateCamera(obj, img, (320, 240), None, None)
print(rms, K[0, 0], K[1, 1], K[0, 2], K[1, 2], *d.ravel())
for i in range(len(ids)):
    ok, c = cv2.findChessboardCornersSB(cv2.imread(f'{folder}/{i}.png', 0), (8, 5))
    print(*c.ravel()) if ok else print()
";

#[test]
#[ignore = "needs OpenCV: CTOS_PYTHON names a Python that has cv2"]
fn opencv_finds_the_same_camera_and_no_better_corners() {
    let sorm = manager();
    let (text, ours) = corners(&sorm);
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path();
    fs::write(place.join("views.csv"), &text).unwrap();
    for (view, turn) in turns().into_iter().enumerate() {
        fs::write(place.join(format!("{view}.png")), png(turn, view as u64)).unwrap();
    }
    let python = std::env::var("CTOS_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let told = Command::new(python)
        .arg("-c")
        .arg(JUDGE)
        .arg(place)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&told.stderr);
    assert!(told.status.success(), "{said}");
    let lines: Vec<Vec<f64>> = String::from_utf8_lossy(&told.stdout)
        .lines()
        .map(|line| line.split(' ').filter_map(|x| x.parse().ok()).collect())
        .collect();
    ask(&sorm, "planecal CTRL -size 320 240 -model brown5");
    let reply = ask(
        &sorm,
        &format!("planecal EXEC TMSG {}", place.join("views.csv").display()),
    );
    assert!(
        (reply.floats[18] / lines[0][0] - 1.0).abs() < 1e-3,
        "{} {:?}",
        reply.floats[18],
        lines[0]
    );
    for (k, theirs) in lines[0].iter().skip(1).enumerate() {
        let (found, sd) = (reply.floats[k], reply.floats[9 + k]);
        assert!(
            (found - theirs).abs() < 0.1 * sd,
            "{k}: {found} {theirs} {sd}"
        );
    }
    let (mut own, mut their) = (0.0, 0.0);
    for (view, turn) in turns().into_iter().enumerate() {
        let truth = truth(&before_board(turn, 22.0, 8, 5), 8, 5);
        let theirs: Vec<&[f64]> = lines[1 + view].chunks(2).collect();
        assert_eq!(theirs.len(), 40, "view {view}");
        for (k, at) in truth.iter().enumerate() {
            own += (ours[view][4 * k] - at.x).powi(2) + (ours[view][4 * k + 1] - at.y).powi(2);
            // Its order may begin at the other end.
            let off = |one: &&[f64]| (one[0] - at.x).powi(2) + (one[1] - at.y).powi(2);
            their += theirs.iter().map(off).fold(f64::INFINITY, f64::min);
        }
    }
    assert!(
        own <= 1.1 * their,
        "rms px: {} and {}",
        (own / 240.0).sqrt(),
        (their / 240.0).sqrt()
    );
}

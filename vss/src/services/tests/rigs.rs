//! The classes `stereo` and `handeye` by their textual requests.

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

#[test]
fn a_camera_on_a_tool_is_found_and_a_matrix_that_is_no_rotation_is_told_by_line() {
    let tool_t_camera = Isometry3::new(Vector3::new(0.02, -0.04, 0.1), Vector3::new(0.1, 0.2, 1.4));
    let base_t_target = Isometry3::new(Vector3::new(0.7, 0.0, 0.1), Vector3::new(3.0, 0.1, 0.2));
    let mut text = String::new();
    for k in 0..8 {
        let angle = f64::from(k);
        let turn = Vector3::new(
            0.5 * angle.sin(),
            0.6 * (2.0 * angle).cos(),
            0.3 * angle.cos(),
        );
        let base_t_tool = Isometry3::new(Vector3::new(0.5, 0.1 * angle.sin(), 0.6), turn);
        let camera_t_target = (base_t_tool * tool_t_camera).inverse() * base_t_target;
        writeln!(text, "{},{}", rows(&base_t_tool), rows(&camera_t_target)).unwrap();
    }
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

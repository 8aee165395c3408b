//! A drawn board before cameras of known lens and place: which way it lies, and when that is not known.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "helpers of tests, outside test functions"
)]

use nalgebra::{
    Isometry3, Point2, Point3, Rotation3, Translation3, UnitQuaternion, Vector2, Vector3,
};
use vss::{
    camera::{Camera, Distortion, Intrinsics},
    frame::Frame,
};
use vss_board::pose::{BoardForm, NoBoard, View, find_board};

const SIZE: (usize, usize) = (480, 360);
const FIELD: f64 = 0.06;
const FORM: BoardForm = BoardForm {
    field_m: FIELD,
    dot: [-0.255, -0.21],
    about_z: 0.42,
};
const DOT_RADIUS: f64 = 0.01;

fn camera(eye: Point3<f64>) -> Camera {
    let view = Rotation3::face_towards(&(Point3::new(0.6, 0.0, 0.42) - eye), &-Vector3::z());
    Camera {
        rotation: UnitQuaternion::from_rotation_matrix(&view).inverse(),
        centre: eye,
        intrinsics: Intrinsics {
            fx: 525.0,
            fy: 525.0,
            cx: 240.0,
            cy: 180.0,
        },
        distortion: Distortion::default(),
    }
}

fn cameras() -> [Camera; 2] {
    [
        camera(Point3::new(0.2, -0.5, 1.3)),
        camera(Point3::new(0.9, 0.6, 1.4)),
    ]
}

fn board(x: f64, y: f64, z: f64, yaw: f64) -> Isometry3<f64> {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
    Isometry3::from_parts(Translation3::new(x, y, z), turn)
}

/// What is where on the board's surface, as a grey value.
type Look = fn(Point2<f64>) -> f64;

/// Fields, the rim around them, the dot beside the first field, and the table.
fn as_made(at: Point2<f64>) -> f64 {
    let (file, rank) = (at.x / FIELD + 4.0, at.y / FIELD + 4.0);
    let inside = |x: f64| (0.0..8.0).contains(&x);
    if inside(file) && inside(rank) {
        let dark = (file.floor() + rank.floor()).rem_euclid(2.0) < 0.5;
        if dark { 50.0 } else { 200.0 }
    } else if (at - Point2::from(FORM.dot)).norm() < DOT_RADIUS {
        220.0
    } else if at.x.abs() < 0.27 && at.y.abs() < 0.27 {
        90.0
    } else {
        130.0
    }
}

/// A leaf covers the dot, and light falls on the opposite rim.
fn misleading(at: Point2<f64>) -> f64 {
    let dot = Point2::from(FORM.dot);
    if (at - dot).norm() < DOT_RADIUS {
        90.0
    } else if (at + dot.coords).coords.norm() < DOT_RADIUS {
        245.0
    } else {
        as_made(at)
    }
}

fn view(name: &str, camera: Camera, board: &Isometry3<f64>, look: Look) -> View {
    let (width, height) = SIZE;
    let (eye, back) = (camera.centre, board.inverse());
    let grey = |u: f64, v: f64| {
        let ray = camera.rotation.inverse() * camera.ray(Vector2::new(u, v)).unwrap();
        let (eye, ray) = (back * eye, back * ray);
        look((eye - ray * (eye.z / ray.z)).xy())
    };
    let pixels = (0..width * height).map(|at| {
        let (u, v) = ((at % width) as f64, (at / width) as f64);
        let parts = (0..4).map(|k| {
            let (du, dv) = (f64::from(k % 2) / 2.0, f64::from(k / 2) / 2.0);
            grey(u + du - 0.25, v + dv - 0.25)
        });
        (parts.sum::<f64>() / 4.0).round() as u8
    });
    View {
        frame: Frame {
            camera: name.to_owned(),
            ..Frame::grey8(width, height, pixels.collect::<Vec<u8>>())
        },
        camera,
        position_sd: 0.0,
        rotation_sd: 0.0,
    }
}

fn views(board: &Isometry3<f64>, looks: [Look; 2]) -> Vec<View> {
    let [left, right] = cameras();
    vec![
        view("left", left, board, looks[0]),
        view("right", right, board, looks[1]),
    ]
}

/// The dot is looked for where the corners say that the board is, not where it was expected.
#[test]
fn a_board_that_lies_higher_than_expected_is_turned_the_right_way() {
    for (z, yaw) in [(0.42, 0.3), (0.47, 0.3), (0.45, 2.0), (0.40, -2.4)] {
        let truth = board(0.6, 0.05, z, yaw);
        let found = find_board(&views(&truth, [as_made; 2]), &FORM);
        let found = found.unwrap_or_else(|error| panic!("{z} {yaw}: {error}"));
        let off = truth.inverse() * found.base_t_board;
        assert!(
            off.translation.vector.norm() < 5e-4 && off.rotation.angle() < 2e-3,
            "{z} {yaw}: {off} {found:?}"
        );
        assert_eq!(found.cameras, ["left", "right"]);
    }
}

#[test]
fn cameras_that_see_the_dot_on_opposite_sides_tell_no_way() {
    let truth = board(0.6, 0.0, 0.42, 0.2);
    for looks in [[as_made, misleading as Look], [misleading, as_made]] {
        let found = find_board(&views(&truth, looks), &FORM);
        assert_eq!(found, Err(NoBoard::Turned));
    }
}

/// A camera that was pushed by two centimetres contradicts the other one.
#[test]
fn a_camera_that_is_no_more_where_it_was_is_told() {
    let truth = board(0.6, 0.0, 0.42, 0.2);
    let mut pushed = views(&truth, [as_made; 2]);
    pushed[1].camera.centre.x += 0.02;
    let found = find_board(&pushed, &FORM);
    assert!(
        matches!(found, Err(NoBoard::Contradiction(..))),
        "{found:?}"
    );
}

#[test]
fn measures_that_are_none_are_refused() {
    let truth = board(0.6, 0.0, 0.42, 0.2);
    let views = views(&truth, [as_made; 2]);
    for wrong in [0.0, -0.06, f64::NAN, f64::INFINITY] {
        let form = BoardForm {
            field_m: wrong,
            ..FORM
        };
        let refused = find_board(&views, &form);
        assert!(
            matches!(refused, Err(NoBoard::Field(_))),
            "{wrong}: {refused:?}"
        );
    }
    assert!(matches!(find_board(&[], &FORM), Err(NoBoard::Unseen(..))));
}

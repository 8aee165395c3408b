//! Where board and discs lie, and what came of a carry.

use nalgebra::{Isometry3, Point2, Translation3, UnitQuaternion, Vector3};

use super::person::{Answer, Seen, Step};

/// The surface of the board.
pub(super) fn board(x: f64, y: f64, yaw_deg: f64) -> Isometry3<f64> {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw_deg.to_radians());
    Isometry3::from_parts(Translation3::new(x, y, 0.42), turn)
}

/// Moves board and disc: the disc's middle is so far from the middle of a field, along columns and rows, m.
pub(super) fn laid(surface: &Isometry3<f64>, field: [f64; 2], off: [f64; 2]) -> Vec<Step> {
    vec![
        Step::Put("board", surface * Translation3::new(0.0, 0.0, -0.01)),
        Step::Put("disc", disc_on(surface, field, off)),
    ]
}

pub(super) fn disc_on(
    surface: &Isometry3<f64>,
    [column, row]: [f64; 2],
    off: [f64; 2],
) -> Isometry3<f64> {
    let (x, y) = ((column - 4.5) * 0.06 + off[0], (row - 4.5) * 0.06 + off[1]);
    // A hair above, to come to rest.
    surface * Translation3::new(x, y, 0.0052)
}

/// Puts the blue disc there, too.
pub(super) fn other(surface: &Isometry3<f64>, field: [f64; 2]) -> Step {
    Step::Put("other_disc", disc_on(surface, field, [0.0; 2]))
}

/// How far the disc is turned from how it lay on the board, about whatever axis, rad. It was laid there along the board.
pub(super) fn turned(answer: &Answer) -> f64 {
    (answer.board.rotation.inverse() * answer.disc.rotation).angle()
}

/// How far the disc is from the middle of a field, m, wherever the board is.
pub(super) fn error(answer: &Answer, [column, row]: [f64; 2]) -> f64 {
    let at = answer.board.inverse() * answer.disc;
    let field = Point2::new((column - 4.5) * 0.06, (row - 4.5) * 0.06);
    (Point2::from(at.translation.vector.xy()) - field).norm()
}

/// Nothing but the jaws was pressed on, and these no harder than they press.
pub(super) fn nothing_was_hit(seen: &Seen) {
    let touches = seen.touches.lock().unwrap();
    for (link, most) in &*touches {
        let is_jaw = link.starts_with("gripper.jaw");
        assert!(is_jaw && *most < 60.0, "{touches:?}");
    }
}

/// The fields that the arm reaches well on a board.
pub(super) fn reached(surface: &Isometry3<f64>) -> Vec<[f64; 2]> {
    let numbers = || (1..=8).map(f64::from);
    let all = numbers().flat_map(|column| numbers().map(move |row| [column, row]));
    let near = |field: &[f64; 2]| {
        let far = disc_on(surface, *field, [0.0; 2])
            .translation
            .vector
            .xy()
            .norm();
        (0.36..0.70).contains(&far)
    };
    all.filter(near).collect()
}

//! What viewers see of what the cameras saw: the board with its fields, and the things on it and beside it.

use ctos::task::Context;
use nalgebra::{Isometry3, Translation3};
use scene::{Part, Pose, Solid};

use super::{board::Board, sight::Overview, thing::Thing};
use crate::{
    dom::DomStore,
    drawn::{LAID, Laid},
};

const LIGHT: [u8; 3] = [214, 204, 184];
const DARK: [u8; 3] = [92, 116, 98];
/// How far the dark fields stand out of the board, m.
const RAISED_M: f64 = 2e-4;
/// The rim around the fields, in sides of a field.
const RIM: f64 = 0.5;

/// Shows it from now on. What could not be shown is logged.
pub(super) async fn show(
    cx: &Context,
    store: &DomStore,
    (board, thing): (&Board, &Thing),
    seen: &Overview,
) {
    if let Err(unshown) = store.store(cx, LAID, &laid(board, thing, seen)).await {
        tracing::warn!(%unshown, "what the cameras saw could not be shown");
    }
}

fn laid(board: &Board, thing: &Thing, seen: &Overview) -> Laid {
    let surface = board.pose();
    let fields = f64::from(board.fields);
    let half = 0.5 * (fields + 2.0 * RIM) * board.field_m;
    let whole = Part {
        name: "board".to_owned(),
        kind: "board, as seen".to_owned(),
        solids: vec![block(
            [0.0, 0.0, -0.5 * board.thick_m],
            [half, half, 0.5 * board.thick_m],
        )],
        colour: LIGHT,
        ..Part::default()
    };
    let middle = |number: u32| (f64::from(number) - 0.5 * (fields - 1.0)) * board.field_m;
    let all = (0..board.fields).flat_map(|column| (0..board.fields).map(move |row| (column, row)));
    let dark = all.filter(|(column, row)| (column + row) % 2 == 0);
    let side = 0.5 * board.field_m;
    let dark =
        dark.map(|(column, row)| block([middle(column), middle(row), 0.0], [side, side, RAISED_M]));
    let dark = Part {
        parent: Some("board".to_owned()),
        solids: dark.collect(),
        colour: DARK,
        ..Part::default()
    };
    let at = pose(&surface);
    let mut laid = vec![(whole, at), (dark, at)];
    for (number, disc) in (1..).zip(&seen.discs) {
        let colour = thing.colour.get(disc.colour);
        let name = colour.map_or("", |colour| colour.name.as_str());
        let part = Part {
            name: format!("{name} {} {number}", thing.name)
                .trim_start()
                .to_owned(),
            kind: format!("{}, as seen", thing.name),
            solids: vec![Solid::Cylinder {
                pose: Pose {
                    at: [0.0, 0.0, 0.5 * thing.height_m],
                    ..Pose::default()
                },
                half: 0.5 * thing.height_m,
                radius: 0.5 * thing.width_m,
            }],
            // Levels are from 0 to 255.
            colour: colour.map_or(LIGHT, |colour| colour.rgb.map(|level| level as u8)),
            ..Part::default()
        };
        laid.push((part, pose(&(surface * Translation3::from(disc.at)))));
    }
    laid
}

fn block(at: [f64; 3], half: [f64; 3]) -> Solid {
    let pose = Pose {
        at,
        ..Pose::default()
    };
    Solid::Block { pose, half }
}

fn pose(at: &Isometry3<f64>) -> Pose {
    Pose {
        at: at.translation.vector.into(),
        turn: at.rotation.coords.into(),
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;
    use vss_board::discs::SeenDisc;

    use super::*;
    use crate::carry::tests::world::{BOARD, disc, on};

    #[test]
    fn a_disc_that_was_seen_on_a_field_is_drawn_there_in_its_colour_on_a_board_with_half_its_fields_dark()
     {
        let field = "3,4".parse().unwrap();
        let seen = Overview {
            board: vss_board::pose::BoardPose {
                base_t_board: BOARD.pose(),
                sd: [0.0; 6],
                rms_px: 0.0,
                corners: 98,
                cameras: Vec::new(),
            },
            discs: vec![SeenDisc {
                at: BOARD.on_board(&field, disc().height_m),
                colour: 1,
                rms_px: 0.0,
                sd_m: 0.0,
                cameras: 2,
            }],
            bare: Vec::new(),
            doubts: Vec::new(),
        };
        let laid = laid(&BOARD, &disc(), &seen);
        assert_eq!(laid[1].0.solids.len(), 32);
        let (part, pose) = &laid[2];
        assert_eq!(
            (part.name.as_str(), part.colour),
            ("blue disc 1", [45, 75, 190])
        );
        assert!((Point3::from(pose.at) - on("3,4")).norm() < 1e-12);
    }
}

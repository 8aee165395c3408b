//! The Transform Coordinator of the checkers player: the functions of `nets/checkers/transform.net`, which bring together places on the board and on the table.

use pnt::library::{Acted, Action, Library};

use crate::{
    coordinator::{Functions, InRoom},
    wire,
};

/// The functions.
#[derive(Debug, Clone)]
pub struct Transform;

impl Functions for Transform {
    const HANDLER: &'static str = "checkers.transform";

    fn add(library: Library<InRoom>) -> Library<InRoom> {
        library.action("adapt", adapt).action("locate", locate)
    }
}

/// Where the board is, by its markers.
async fn adapt(action: Action<InRoom>) -> Acted {
    let InRoom { store, .. } = InRoom::of(&action);
    let marks: [[f64; 2]; 2] = wire::fetch(action.cx(), &store, wire::MARKS).await?;
    let pose = wire::Pose::of_markers(marks);
    wire::keep(action.cx(), &store, wire::BOARD, &pose).await
}

/// Where the ends of the errand are on the table.
async fn locate(action: Action<InRoom>) -> Acted {
    let InRoom { store, .. } = InRoom::of(&action);
    let cx = action.cx();
    let errand: wire::Errand = wire::fetch(cx, &store, wire::ERRAND).await?;
    let pose: wire::Pose = wire::fetch(cx, &store, wire::BOARD).await?;
    let points = [errand.from.on_table(&pose), errand.to.on_table(&pose)];
    wire::keep(cx, &store, wire::POINTS, &points).await
}

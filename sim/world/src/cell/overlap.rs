//! What an object of the cell is in at the start, where it must not be.

use nalgebra::Isometry3;
use rapier3d_f64::parry::query;

use super::{Cell, Origin};
use crate::{
    engine,
    shapes::{Shape, Solid},
};

/// Solids may touch, and rounding may put one into the other by so much, m.
const TOUCH: f64 = 1e-4;

/// For each object that is in something: its index, what it is in, and how deep, m.
pub fn find(cell: &Cell) -> Vec<(usize, String, f64)> {
    let scene = cell.start();
    let placed: Vec<_> = cell.bodies.iter().zip(&scene.bodies).collect();
    let mut found = Vec::new();
    for (place, (spec, body)) in placed.iter().enumerate() {
        let Origin::Object(index) = spec.origin else {
            continue;
        };
        let mut worst: Option<(String, f64)> = None;
        let mut against = |name: &str, shape: &Solid, pose: &Isometry3<f64>| {
            for own in &body.shapes {
                let depth = depth((&own.solid, &body.pose), (shape, pose));
                if depth > TOUCH && worst.as_ref().is_none_or(|(_, least)| depth > *least) {
                    worst = Some((name.to_owned(), depth));
                }
            }
        };
        // Of two objects, the later one is in the way.
        for (_, other) in &placed[..place] {
            for Shape { solid, .. } in &other.shapes {
                against(&format!("`{}`", other.name), solid, &other.pose);
            }
        }
        for Shape { solid, .. } in &cell.room {
            against("a piece of furniture", solid, &Isometry3::identity());
        }
        against("the floor", &engine::FLOOR, &Isometry3::identity());
        if let Some((name, depth)) = worst {
            found.push((index, name, depth));
        }
    }
    found
}

/// How deep one solid is in another, m; nothing when they are apart.
fn depth(one: (&Solid, &Isometry3<f64>), other: (&Solid, &Isometry3<f64>)) -> f64 {
    let placed = |(solid, pose): (&Solid, &Isometry3<f64>)| {
        let (shape, at) = engine::shape(solid);
        (engine::pose(&(pose * at)), shape)
    };
    let ((pose1, shape1), (pose2, shape2)) = (placed(one), placed(other));
    let contact = query::contact(&pose1, &*shape1, &pose2, &*shape2, 0.0);
    // Every pair of these forms has an answer.
    contact.ok().flatten().map_or(0.0, |contact| -contact.dist)
}

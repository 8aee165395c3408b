//! The map from a ball's blob to its place, trained and asked with pictures of the simulated camera.

#![allow(
    clippy::unwrap_used,
    reason = "helpers of tests, outside test functions"
)]

use ctos::diagnostic::Source;
use nalgebra::{Point3, Vector3};
use sim::{camera::Renderer, cell::Cell, scene::SceneState};
use vss::{
    components::components,
    target_map::{EXAMPLES, Seen, TargetMap},
};

const BALL: f64 = 0.04;

/// A camera 1.4 m above the floor, a bright ball, and a dark hand's breadth that can be put before it.
fn cell() -> Cell {
    let text = format!(
        "
        [room]
        floor_grey = 20.0
        [[camera]]
        name = 'above'
        width = 500
        height = 500
        fx = 600.0
        fy = 600.0
        cx = 249.5
        cy = 249.5
        k1 = -0.12
        k2 = 0.03
        p1 = 5e-4
        p2 = -4e-4
        k3 = 0.0
        position = [0.02, 0.01, 1.4]
        look_at = [0.0, 0.0, 0.0]
        up = [0.0, 1.0, 0.0]
        blur = 1.0
        read_noise = 2.0
        shot_noise = 0.02
        [[object]]
        name = 'ball'
        shape = 'sphere'
        radius = {BALL}
        mass = 0.1
        grey = 190
        position = [0.0, 0.0, 0.5]
        [[object]]
        name = 'hand'
        shape = 'box'
        size = [0.1, 0.1, 0.01]
        mass = 0.1
        grey = 30
        position = [2.0, 2.0, 0.5]
        "
    );
    Cell::parse(&Source::new("cell.toml", text)).unwrap()
}

/// The largest blob of a picture.
fn seen(renderer: &mut Renderer, scene: &SceneState, number: u64) -> Seen {
    let pixels = renderer.render(scene, number);
    let found = components(&pixels, 500, 100);
    let largest = found.iter().max_by_key(|blob| blob.area).unwrap();
    Seen::of(largest)
}

fn with_ball(cell: &Cell, place: Point3<f64>) -> SceneState {
    let mut scene = cell.start();
    scene.bodies[0].pose.translation = place.into();
    scene
}

#[test]
fn a_ball_is_located_from_its_blob_and_a_covered_one_is_told_by_the_error() {
    let cell = cell();
    let mut renderer = Renderer::new(&cell, &cell.cameras[0], 5);
    let at = |x: f64, y: f64, z: f64| Point3::new(0.12 * x, 0.12 * y, 0.4 + 0.08 * z);
    let mut number = 0;
    let mut look = |scene: &SceneState| {
        number += 1;
        seen(&mut renderer, scene, number)
    };
    let examples: Vec<_> = (0..EXAMPLES)
        .map(|index| {
            let node = |index: usize| index as f64 - 1.0;
            let place = at(node(index / 9), node(index / 3 % 3), node(index % 3));
            (place, look(&with_ball(&cell, place)))
        })
        .collect();
    let sd = Seen {
        u: 0.05,
        v: 0.05,
        radius: 0.05,
        spread: 0.05,
    };
    let mut map = TargetMap::train(&examples.try_into().unwrap(), &sd, 20.0).unwrap();
    let (mut across, mut along) = (0.0_f64, 0.0_f64);
    for step in 0..60 {
        let k = f64::from(step);
        let place = at(0.9 * k.sin(), 0.9 * (1.7 * k).cos(), 0.9 * (2.3 * k).sin());
        let found = map.locate(&look(&with_ball(&cell, place))).unwrap();
        assert!(found.good, "{place}: {found:?}");
        let off = found.place - place;
        across = across.max(off.xy().norm());
        along = along.max(off.z.abs());
    }
    // 1 m away a pixel is 1.7 mm, and 0.05 px of a radius of 24 px are 2 mm of depth.
    assert!(across < 1.5e-3 && along < 6e-3, "{across} {along}");
    for place in [at(0.0, 0.0, 0.0), at(0.5, -0.6, 0.7)] {
        let mut covered = with_ball(&cell, place);
        // Its edge runs past the middle of the ball, above it.
        let hand = place + Vector3::new(0.055, 0.0, 0.06);
        covered.bodies[1].pose.translation = hand.into();
        let found = map.locate(&look(&covered)).unwrap();
        assert!(!found.good && found.error > 50.0, "{place}: {found:?}");
    }
    // Something else of another size.
    let mut other = with_ball(&cell, at(0.0, 0.0, 0.0));
    other.bodies[0].shapes[0] = sim::shapes::Shape {
        solid: sim::shapes::Solid::Block {
            centre: Point3::origin(),
            half: Vector3::new(0.08, 0.02, 0.02),
        },
        ..other.bodies[0].shapes[0]
    };
    let found = map.locate(&look(&other)).unwrap();
    assert!(!found.good, "{found:?}");
}

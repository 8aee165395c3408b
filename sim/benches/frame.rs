//! Pictures on one thread, 500x500: of the cell, all of it and without the noise, and of fifty solids that all move.

use ctos::diagnostic::Source;
use divan::Bencher;
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use sim::{
    camera::Renderer,
    cell::Cell,
    scene::SceneState,
    shapes::{Paint, Shape, Solid},
};

fn main() {
    divan::main();
}

fn cell() -> Option<Cell> {
    let text = include_str!("../../configs/cell.toml");
    Cell::parse(&Source::new("cell.toml", text)).ok()
}

#[divan::bench]
fn render(bencher: Bencher) {
    let Some(cell) = cell() else { return };
    let scene = cell.start();
    let mut renderer = Renderer::new(&cell, &cell.cameras[0], 1);
    let mut number = 0;
    bencher.bench_local(|| {
        number += 1;
        renderer.render(&scene, number)
    });
}

#[divan::bench]
fn light(bencher: Bencher) {
    let Some(cell) = cell() else { return };
    let scene = cell.start();
    let mut renderer = Renderer::new(&cell, &cell.cameras[0], 1);
    bencher.bench_local(|| renderer.light(&scene)[0]);
}

/// The cell with fifty balls where its arm was, and its scene with ten each of balls, boxes, cylinders, capsules and discs of
/// 30 to 60 cm, over the whole picture.
fn fifty() -> Option<(Cell, SceneState)> {
    let text = include_str!("../../configs/cell.toml");
    let cameras = text.find("[room]")?;
    let mut text = text.get(cameras..)?.to_owned();
    for index in 0..50 {
        text += &format!(
            "[[object]]\nname = 'o{index}'\nshape = 'sphere'\nradius = 0.05\nmass = 1.0\ngrey = 120\nposition = [{}, {}, 3.5]\n",
            0.2 * f64::from(index % 10) - 4.0,
            0.2 * f64::from(index / 10)
        );
    }
    let cell = Cell::parse(&Source::new("cell.toml", text)).ok()?;
    let mut scene = cell.start();
    for (index, body) in scene.bodies.iter_mut().enumerate() {
        let k = index as f64;
        let place = Vector3::new(
            0.27 * (k % 10.0) - 1.2,
            0.45 * (k / 10.0).floor() - 0.9,
            0.3 + 0.05 * (k % 7.0),
        );
        let turn = UnitQuaternion::new(Vector3::new(0.3 * k, 0.2 * k, 0.5 * k));
        body.pose = Isometry3::from_parts(Translation3::from(place), turn);
        let solid = match index % 5 {
            0 => Solid::Capsule {
                a: Point3::origin(),
                b: Point3::origin(),
                radius: 0.18,
            },
            1 => Solid::Block {
                centre: Point3::origin(),
                half: Vector3::new(0.16, 0.13, 0.1),
            },
            2 => Solid::Cylinder {
                half: 0.1,
                radius: 0.16,
            },
            3 => Solid::Capsule {
                a: Point3::new(-0.2, 0.0, 0.0),
                b: Point3::new(0.2, 0.0, 0.0),
                radius: 0.09,
            },
            _ => Solid::Disc {
                centre: Point3::origin(),
                normal: Vector3::z(),
                radius: 0.18,
            },
        };
        body.shapes = vec![Shape {
            solid,
            paint: Paint::Grey(120.0),
        }];
    }
    Some((cell, scene))
}

#[divan::bench]
fn fifty_solids(bencher: Bencher) {
    let Some((cell, scene)) = fifty() else { return };
    let mut renderer = Renderer::new(&cell, &cell.cameras[0], 1);
    let mut number = 0;
    bencher.bench_local(|| {
        number += 1;
        renderer.render(&scene, number)
    });
}

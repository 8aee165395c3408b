//! The laser scanner of a simulated cell, seen by its cameras: pointing, triangulation and calibration against the cell's truth.

#![allow(
    clippy::unwrap_used,
    reason = "helpers of tests, outside test functions"
)]

use ctos::diagnostic::Source;
use nalgebra::{Isometry3, Point3, Unit, Vector2, Vector3};
use sim::{
    camera::Renderer,
    cell::Cell,
    scene::{LaserOrder, SceneState, beams},
};
use vss::{
    camera::Camera,
    frame::Frame,
    laser::{self, Plane, Scanner},
    spot::{SpotOptions, find_spot},
};

/// A camera and a scanner above a floor, a table beside, and a ball.
fn cell() -> Cell {
    let text = "
        [room]
        floor_grey = 24.0
        [[furniture]]
        centre = [0.45, 0.0, 0.15]
        size = [0.5, 1.1, 0.3]
        grey = 30.0
        [[camera]]
        name = 'left'
        width = 500
        height = 500
        fx = 420.0
        fy = 421.0
        cx = 251.0
        cy = 248.0
        k1 = -0.12
        k2 = 0.03
        p1 = 5e-4
        p2 = -4e-4
        k3 = 0.0
        position = [-0.7, 0.1, 1.7]
        look_at = [0.0, 0.0, 0.1]
        up = [0.0, 1.0, 0.0]
        blur = 1.3
        read_noise = 2.0
        shot_noise = 0.0
        [[laser]]
        name = 'scanner'
        position = [0.5, 0.0, 1.8]
        look_at = [0.0, 0.0, 0.0]
        up = [1.0, 0.0, 0.0]
        mirror_offset = 0.018
        gain = [4.0, -3.6]
        zero = [0.3, -0.4]
        radius = 0.004
        brightness = 180.0
        ";
    Cell::parse(&Source::new("cell.toml", text)).unwrap()
}

struct Bench {
    cell: Cell,
    renderer: Renderer,
    camera: Camera,
    taken: u64,
}

impl Bench {
    fn new() -> Self {
        let cell = cell();
        let renderer = Renderer::new(&cell, &cell.cameras[0], 3);
        let camera = renderer.truth().camera();
        Self {
            cell,
            renderer,
            camera,
            taken: 0,
        }
    }

    fn scene(&self, order: LaserOrder) -> SceneState {
        let mut scene = self.cell.start();
        scene.beams = beams(order, &self.cell.lasers[0]).collect();
        scene
    }

    fn picture(&mut self, order: LaserOrder) -> Frame {
        let scene = self.scene(order);
        self.taken += 1;
        Frame::grey8(500, 500, self.renderer.render(&scene, self.taken))
    }

    /// Where the camera sees the spot, if it does.
    fn spot(&mut self, command: [f64; 2]) -> Option<Vector2<f64>> {
        let frame = self.picture(LaserOrder::Spot(command));
        let spot = find_spot(&frame, &SpotOptions::default()).ok()?;
        Some(Vector2::new(spot.u, spot.v))
    }
}

/// The floor, or the table's top.
fn level(z: f64) -> Plane {
    Plane {
        normal: Vector3::z_axis(),
        distance: z,
    }
}

#[test]
fn the_spot_is_seen_where_the_beam_was_sent() {
    let mut bench = Bench::new();
    let scanner = bench.cell.lasers[0].scanner;
    for target in [
        [-0.3, 0.2, 0.0],
        [0.0, -0.3, 0.0],
        [0.5, 0.1, 0.3],
        [0.3, -0.4, 0.3],
        [-0.4, -0.2, 0.0],
    ] {
        let target = Point3::from(target);
        let command = scanner.aim(&target).unwrap();
        let pixel = bench.spot(command).unwrap();
        let met = laser::on_beam(&bench.camera, pixel, &scanner.beam(command)).unwrap();
        // A pixel is 4 mm there.
        assert!((met.place - target).norm() < 2e-3, "{target}: {met:?}");
        assert!(met.gap < 1.5e-3, "{target}: {met:?}");
        // Of another beam it is no spot.
        let other = scanner.beam([command[0] + 2.0, command[1]]);
        let wrong = laser::on_beam(&bench.camera, pixel, &other);
        assert!(wrong.is_err() || wrong.unwrap().gap > 0.02);
    }
}

#[test]
fn what_stands_in_the_way_has_the_spot() {
    let bench = Bench::new();
    let scanner = bench.cell.lasers[0].scanner;
    let aimed = Point3::new(0.4, 0.2, 0.0);
    let command = scanner.aim(&aimed).unwrap();
    let mut bench = bench;
    let pixel = bench.spot(command).unwrap();
    // Not on the floor: on the table, 0.3 m above it.
    let met = laser::on_beam(&bench.camera, pixel, &scanner.beam(command)).unwrap();
    assert!((met.place.z - 0.3).abs() < 2e-3, "{met:?}");
}

#[test]
fn a_line_is_triangulated_by_a_plane_of_light_that_was_found_on_two_planes() {
    let mut bench = Bench::new();
    // The first mirror alone draws a plane of light. It lies across the way from the camera to the scanner: along that it
    // would hold the camera.
    let [_, b] = bench.cell.lasers[0]
        .scanner
        .aim(&Point3::new(0.45, 0.0, 0.3))
        .unwrap();
    let frame = bench.picture(LaserOrder::Line([-7.0, b], [7.0, b]));
    let dark = bench.picture(LaserOrder::Off);
    // Each row's brightest place, by weight: a line has no spots.
    let mut points = Vec::new();
    for v in (10..490).step_by(4) {
        let rise =
            |u: usize| f64::from(frame.get(u, v).unwrap()) - f64::from(dark.get(u, v).unwrap());
        let peak = (6..494)
            .max_by(|a, b| rise(*a).total_cmp(&rise(*b)))
            .unwrap();
        // Noise alone rises by a dozen grey levels somewhere in a row.
        if rise(peak) > 20.0 {
            let near = || (peak - 5..=peak + 5).map(|u| (rise(u), u as f64));
            let weight: f64 = near().map(|(rise, _)| rise).sum();
            let u = near().map(|(rise, u)| rise * u).sum::<f64>() / weight;
            points.push(Vector2::new(u, v as f64));
        }
    }
    assert!(points.len() > 30, "{}", points.len());
    // The known planes: what is not on the table is on the floor.
    let on = |pixel: &Vector2<f64>, z: f64| {
        laser::on_plane(&bench.camera, *pixel, &level(z))
            .unwrap()
            .place
    };
    let above = |p: &Point3<f64>| (0.21..0.69).contains(&p.x) && p.y.abs() < 0.52;
    let below = |p: &Point3<f64>| p.y.abs() > 0.69;
    let mut seen = Vec::new();
    for pixel in &points {
        let (high, low) = (on(pixel, 0.3), on(pixel, 0.0));
        if above(&high) && !below(&low) {
            seen.push((pixel, high));
        } else if below(&low) && !above(&high) {
            seen.push((pixel, low));
        }
    }
    let places: Vec<Point3<f64>> = seen.iter().map(|(_, place)| *place).collect();
    let laser::FittedPlane {
        plane: light,
        rms_m: rms,
        ..
    } = laser::plane_through(&places).unwrap();
    assert!(rms < 3e-3, "{rms}");
    for (pixel, place) in seen {
        let met = laser::on_plane(&bench.camera, *pixel, &light).unwrap();
        assert!((met.place - place).norm() < 8e-3, "{place}: {met:?}");
    }
}

#[test]
fn mirrors_are_calibrated_from_spots_on_known_planes() {
    let mut bench = Bench::new();
    let truth = bench.cell.lasers[0].scanner;
    let mut met = Vec::new();
    for (z, xs) in [
        (0.0, [-0.6, -0.35, -0.1, 0.05]),
        (0.3, [0.25, 0.4, 0.55, 0.65]),
    ] {
        for x in xs {
            for y in [-0.5, -0.25, 0.0, 0.25, 0.5] {
                let command = truth.aim(&Point3::new(x, y, z)).unwrap();
                let pixel = bench.spot(command).unwrap();
                met.push((
                    command,
                    laser::on_plane(&bench.camera, pixel, &level(z))
                        .unwrap()
                        .place,
                ));
            }
        }
    }
    let near = Isometry3::new(
        Vector3::new(0.02, -0.02, 0.03),
        Vector3::new(0.03, -0.02, 0.02),
    );
    let start = Scanner {
        world_t_scanner: truth.world_t_scanner * near,
        offset: 0.01,
        gain: [0.07, -0.06],
        zero: [0.0, 0.0],
    };
    let found = laser::calibrate(&met, &start).unwrap();
    assert!(found.rms_m < 2e-3, "{found:?}");
    for place in [[-0.4, 0.3, 0.0], [0.0, 0.0, 0.15], [0.4, -0.3, 0.3]] {
        let place = Point3::from(place);
        let command = found.scanner.aim(&place).unwrap();
        let beam = truth.beam(command);
        let along = Unit::new_normalize(beam.direction.into_inner());
        let beside = (place - beam.origin).cross(&along).norm();
        assert!(beside < 3e-3, "{place}: {beside}");
    }
}

//! The gripper is corrected by the camera on its hand: four moves of the simulated arm teach the visual Jacobian, and pictures of a
//! disc from other places are answered with the move that was missing.

#![allow(
    clippy::unwrap_used,
    reason = "helpers of tests, outside test functions"
)]

use ctos::diagnostic::Source;
use nalgebra::{Isometry3, Matrix6, Point3, Translation3, Vector3, Vector6};
use sim::{camera::Renderer, cell::Cell};
use vss::{
    image::{Format, Picture, board::disc_near},
    visual_jacobian::{Correction, EXAMPLES, Example, Seen, VisualJacobian},
};

/// The gripper points straight down, degrees.
const DOWN: [f64; 6] = [0.0, 75.0, -180.0, 0.0, -75.0, 0.0];
/// How far below the flange the disc lies, m.
const BELOW: f64 = 0.25;
/// About how large the disc is in a picture, px.
const RADIUS_PX: f64 = 46.0;

/// A PUMA with a tilted camera beside its flange, and a disc of 18 mm radius on a table there.
fn cell(disc: &Point3<f64>) -> Cell {
    let table = disc.z - 0.01;
    let text = format!(
        "
        [[arm]]
        name = 'puma'
        model = 'puma560'
        start = {DOWN:?}
        [[furniture]]
        centre = [{}, {}, {}]
        size = [0.4, 0.4, 0.02]
        grey = 42.0
        [[object]]
        name = 'disc'
        shape = 'cylinder'
        radius = 0.018
        height = 0.01
        mass = 0.02
        grey = 150.0
        position = [{}, {}, {}]
        [room]
        floor_grey = 24.0
        [[camera]]
        name = 'hand'
        arm = 'puma'
        link = 'link6'
        width = 500
        height = 500
        fx = 560.0
        fy = 561.0
        cx = 247.8
        cy = 250.2
        k1 = -0.142
        k2 = 0.036
        p1 = 0.0004
        p2 = -0.0003
        k3 = 0.0
        position = [0.05, 0.01, 0.02]
        look_at = [0.0, 0.0, 0.25]
        up = [1.0, 0.1, 0.0]
        blur = 0.8
        read_noise = 2.0
        shot_noise = 0.02
        exposure_ms = 8.0
        ",
        disc.x,
        disc.y,
        table - 0.01,
        disc.x,
        disc.y,
        disc.z - 0.005,
    );
    Cell::parse(&Source::new("cell.toml", text)).unwrap()
}

struct Bench {
    cell: Cell,
    camera: Renderer,
    /// The flange where it would grip the disc.
    grip: Isometry3<f64>,
    taken: u64,
}

impl Bench {
    fn new() -> Self {
        let elsewhere = Point3::new(1.5, 1.5, 0.5);
        let grip = flange(&cell(&elsewhere), &DOWN.map(f64::to_radians));
        let disc = grip * Point3::new(0.0, 0.0, BELOW);
        let cell = cell(&disc);
        Self {
            camera: Renderer::new(&cell, cell.camera("hand").unwrap(), 1),
            cell,
            grip,
            taken: 0,
        }
    }

    /// What is seen of the disc with the flange off the grip by so much along the world's x and y, and higher by so much.
    fn seen(&mut self, [x, y]: [f64; 2], higher: f64) -> Seen {
        let goal = Translation3::new(x, y, higher) * self.grip;
        let joints = reached(&self.cell, &goal);
        let scene = self.cell.scene(&[&joints]);
        self.taken += 1;
        let picture = Picture {
            width: 500,
            height: 500,
            format: Format::Grey8,
            pixels: self.camera.render(&scene, self.taken),
            notes: Vec::new(),
        };
        let places = (0..9).map(|k| {
            let along = |nth: i32| 250.0 + 1.5 * RADIUS_PX * f64::from(nth - 1);
            [along(k % 3), along(k / 3)]
        });
        let found = places.filter_map(|place| disc_near(&picture, place, RADIUS_PX).ok());
        let worth = |sd: [f64; 2]| sd[0].hypot(sd[1]);
        let best = found.min_by(|a, b| worth(a.sd_px).total_cmp(&worth(b.sd_px)));
        let disc = best.unwrap();
        Seen {
            u: disc.u,
            v: disc.v,
            radius: disc.radius,
        }
    }

    fn taught(&mut self) -> VisualJacobian {
        let half = 0.015;
        let corners = [[-half, -half], [half, -half], [-half, half], [half, half]];
        let examples: [Example; EXAMPLES] = corners.map(|offset| Example {
            offset,
            seen: self.seen(offset, 0.0),
        });
        VisualJacobian::train(&examples, 0.1, 0.15).unwrap()
    }
}

fn flange(cell: &Cell, joints: &[f64]) -> Isometry3<f64> {
    cell.scene(&[joints]).body("puma.link6").unwrap().pose
}

/// Joints that take the flange to a pose nearby, by Newton's method.
fn reached(cell: &Cell, goal: &Isometry3<f64>) -> [f64; 6] {
    let mut joints = DOWN.map(f64::to_radians);
    let off = |joints: &[f64; 6]| {
        let by = flange(cell, joints);
        let turn = (goal.rotation * by.rotation.inverse()).scaled_axis();
        let shift = goal.translation.vector - by.translation.vector;
        Vector6::new(turn.x, turn.y, turn.z, shift.x, shift.y, shift.z)
    };
    for _ in 0..8 {
        let here = off(&joints);
        let mut slopes = Matrix6::zeros();
        for k in 0..6 {
            let mut beside = joints;
            beside[k] += 1e-6;
            slopes.set_column(k, &((here - off(&beside)) / 1e-6));
        }
        let step = slopes.lu().solve(&here).unwrap();
        for (joint, by) in joints.iter_mut().zip(step.iter()) {
            *joint += by;
        }
    }
    assert!(off(&joints).norm() < 1e-9, "{}", off(&joints));
    joints
}

/// What is left after the correction, m.
fn left(offset: [f64; 2], found: &Correction) -> f64 {
    Vector3::new(offset[0] + found.by[0], offset[1] + found.by[1], 0.0).norm()
}

/// The published case: one correcting move from anywhere in the square of the examples.
#[test]
fn four_moves_teach_corrections_to_three_tenths_of_a_millimetre() {
    let mut bench = Bench::new();
    let mut map = bench.taught();
    for step in 0..6 {
        let k = f64::from(step);
        let offset = [0.015 * (1.3 * k).sin(), 0.015 * (2.1 * k).cos()];
        let found = map.correction(&bench.seen(offset, 0.0)).unwrap();
        let left = left(offset, &found);
        assert!(found.good && left < 3e-4, "{offset:?}: {left} {found:?}");
        assert!(found.sd.iter().all(|sd| *sd < 2e-4), "{found:?}");
    }
}

#[test]
fn a_hand_that_is_higher_than_it_was_taught_is_told() {
    let mut bench = Bench::new();
    let mut map = bench.taught();
    let found = map.correction(&bench.seen([0.004, -0.003], 0.015)).unwrap();
    assert!(!found.good, "{found:?}");
}

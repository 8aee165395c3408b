//! Makes the positions file of the camera calibration: lamp positions spread over the arm's work
//! volume, in an order of short moves. The arm can take each, and both cameras see it. Tells on
//! standard error how well they determine each camera (Cramér-Rao bound).
//!
//! ```text
//! cargo run --release -p cli --example layout > configs/positions.csv
//! ```

#![allow(
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "a small program whose output is a file"
)]

use std::{error::Error, f64::consts::TAU, path::Path};

use mcs::model::{Placement, built_in, file::Inertias, inverse::ClosedForm};
use nalgebra::{Isometry3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use sim::{camera::Renderer, cell::Cell};
use vss::calibrate::{LensModel, design};

/// Standard deviation of a spot that the cell's noise gives, px per coordinate.
const SPOT_SD_PX: f64 = 0.15;

/// Lamp heights, m, and radii about joint 1's axis, m.
const SHELLS: [(f64, &[f64]); 5] = [
    (0.40, &[0.62, 0.80]),
    (0.70, &[0.55, 0.88]),
    (1.00, &[0.50, 0.90]),
    (1.25, &[0.45, 0.80]),
    (1.48, &[0.25, 0.55]),
];

/// Directions about joint 1's axis in which the lamp is placed, degrees.
const DIRECTIONS: [f64; 8] = [-150.0, -107.0, -64.0, -21.0, 21.0, 64.0, 107.0, 150.0];

/// How far the tool may lean outwards from straight up, degrees, in order of preference.
const LEANS: [f64; 5] = [0.0, 25.0, 50.0, 75.0, 100.0];

/// Part of the lamp that must be seen, and how far from the picture's border, px.
const SEEN_MIN: f64 = 0.999;
const BORDER_PX: f64 = 12.0;

type Joints = [f64; 6];

struct Layout {
    /// The arm with the lamp as its tool.
    arm: ClosedForm,
    cell: Cell,
    renderers: Vec<Renderer>,
}

struct Placed {
    pose: Isometry3<f64>,
    degrees: [f64; 3],
    joints: Joints,
}

impl Layout {
    /// A way to hold the lamp at a point that is reachable and seen by all cameras.
    fn place(&mut self, point: &Point3<f64>, near: &Joints) -> Option<Placed> {
        let azimuth = point.y.atan2(point.x).to_degrees();
        let mut best: Option<(f64, Placed)> = None;
        for lean in LEANS {
            for turn in [0.0, 90.0, 180.0, 270.0] {
                let degrees = [turn, lean, azimuth];
                // The tool axis leans outwards; `turn` is about the tool axis itself.
                let rotation = Rotation3::from_axis_angle(&Vector3::z_axis(), azimuth.to_radians())
                    * Rotation3::from_axis_angle(&Vector3::y_axis(), lean.to_radians())
                    * Rotation3::from_axis_angle(&Vector3::z_axis(), f64::to_radians(turn));
                let pose = Isometry3::from_parts(
                    Translation3::from(point.coords),
                    UnitQuaternion::from_rotation_matrix(&rotation),
                );
                let Some(joints) = self.joints(&pose, near) else {
                    continue;
                };
                if !self.seen(&joints) {
                    continue;
                }
                let cost = self.cost(&joints, near) + lean / 100.0;
                if best.as_ref().is_none_or(|(least, _)| cost < *least) {
                    best = Some((
                        cost,
                        Placed {
                            pose,
                            degrees,
                            joints,
                        },
                    ));
                }
            }
        }
        best.map(|(_, placed)| placed)
    }

    fn joints(&self, pose: &Isometry3<f64>, near: &Joints) -> Option<Joints> {
        let solutions = self.arm.inverse(&Placement::from(pose), near).ok()?;
        let nearest = solutions.nearest_within(self.arm.limits(), near, None);
        Some(nearest.ok()?.joints)
    }

    fn seen(&mut self, joints: &Joints) -> bool {
        let scene = self.cell.scene(&[joints]);
        self.renderers.iter_mut().all(|renderer| {
            let (width, height) = (
                renderer.truth().width as f64,
                renderer.truth().height as f64,
            );
            renderer.lamp_view(&scene, 0).is_some_and(|view| {
                let inside = |value: f64, size: f64| value > BORDER_PX && value < size - BORDER_PX;
                view.visible > SEEN_MIN
                    && inside(view.centre.0, width)
                    && inside(view.centre.1, height)
            })
        })
    }

    /// Seconds at full joint speeds.
    fn cost(&self, joints: &Joints, near: &Joints) -> f64 {
        let per_joint = joints.iter().zip(near).zip(self.arm.limits());
        per_joint.fold(0.0, |longest, ((to, from), limit)| {
            f64::max(longest, (to - from).abs() / limit.velocity)
        })
    }
}

/// Where the cell's first arm starts.
fn start(cell: &Cell) -> Result<Joints, Box<dyn Error>> {
    let arm = cell.arms.first().ok_or("the cell has no arm")?;
    Ok(arm.start.as_slice().try_into()?)
}

fn main() -> Result<(), Box<dyn Error>> {
    let cell = Cell::read(Path::new("configs/cell.toml"))?;
    let renderers = cell
        .cameras
        .iter()
        .map(|camera| Renderer::new(&cell, camera, 0))
        .collect();
    let lamp = cell.lamps.first().ok_or("the cell has no lamp")?.offset;
    let arm = built_in::model("puma560", Inertias::Identified).ok_or("no such arm")??;
    let arm = arm.with_tool(&Placement::shifted(lamp.x, lamp.y, lamp.z));
    let mut layout = Layout {
        arm: ClosedForm::of(&arm, arm.tip()).ok_or("the arm has no closed form")?,
        renderers,
        cell,
    };
    let mut near = start(&layout.cell)?;
    let mut placed = Vec::new();
    for (column, direction) in DIRECTIONS.into_iter().enumerate() {
        // Up one column, down the next one.
        let mut points: Vec<Point3<f64>> = Vec::new();
        for (height, radii) in SHELLS {
            for radius in radii {
                let angle = direction / 360.0 * TAU;
                points.push(Point3::new(
                    radius * angle.cos(),
                    radius * angle.sin(),
                    height,
                ));
            }
        }
        if column % 2 == 1 {
            points.reverse();
        }
        for point in points {
            match layout.place(&point, &near) {
                Some(found) => {
                    near = found.joints;
                    placed.push(found);
                }
                None => eprintln!("left out: {:.2} {:.2} {:.2}", point.x, point.y, point.z),
            }
        }
    }
    println!(
        "# Lamp positions (m) and tool orientation (degrees) in the base frame, over the work volume."
    );
    println!("x,y,z,roll,pitch,yaw");
    for found in &placed {
        let p = found.pose.translation;
        let (roll, pitch, yaw) = found.pose.rotation.euler_angles();
        println!(
            "{:.4},{:.4},{:.4},{:.3},{:.3},{:.3}",
            p.x,
            p.y,
            p.z,
            roll.to_degrees(),
            pitch.to_degrees(),
            yaw.to_degrees()
        );
    }
    judge(&layout, &placed)
}

fn judge(layout: &Layout, placed: &[Placed]) -> Result<(), Box<dyn Error>> {
    let mut from = start(&layout.cell)?;
    let mut seconds = 0.0;
    for found in placed {
        seconds += layout.cost(&found.joints, &from);
        from = found.joints;
    }
    eprintln!(
        "{} positions, {seconds:.0} s of motion at full speed",
        placed.len()
    );
    let turned = placed.iter().filter(|found| found.degrees[1] > 0.0).count();
    eprintln!("{turned} of them with the tool leaning");
    let points: Vec<Point3<f64>> = placed
        .iter()
        .map(|found| Point3::from(found.pose.translation.vector))
        .collect();
    for camera in &layout.cell.cameras {
        let truth = &camera.truth;
        for model in [LensModel::K1K2, LensModel::K1K2P1P2, LensModel::Brown5] {
            let bound = design(&truth.camera(), &points, SPOT_SD_PX, model)?;
            eprintln!(
                "{} {model:?}: position {:.2} mm, rotation {:.2} mrad, focal length {:.3} %",
                truth.name,
                bound.position_sd_m * 1e3,
                bound.rotation_sd_rad * 1e3,
                bound.focal_sd_rel * 1e2
            );
        }
    }
    Ok(())
}

//! What data objects are to viewers. Of a calibration: how far the job is, where the lamp was seen, and the cameras once they
//! are computed. Of Coordinators that choose: what is believed of each way, and which one is tried. The DOM shows it. Only data objects are read here, and only when somebody follows.

use std::{cell::RefCell, collections::BTreeMap, rc::Rc};

use ctos::{
    message::Message,
    task::{Context, Handled},
};
use scene::{Job, Number, Part, Pose, Said, Seen, Solid, Source, Stage, View};
use vss::camera::Camera;

use crate::{
    objects::{CALIBRATIONS, Calibrations, OBSERVATIONS, Observations},
    strategy::shown::{CHOICES, Choices},
};

/// The data objects that are shown.
const SHOWN: [&str; 4] = [OBSERVATIONS, CALIBRATIONS, CHOICES, LAID];
/// A data object of things that are where somebody saw them: [`Laid`].
pub(crate) const LAID: &str = "laid";

/// [`LAID`]: in the base frame of the arm.
pub(crate) type Laid = Vec<(Part, Pose)>;
/// How far the pyramid of a camera reaches, m.
const DEPTH: f64 = 0.6;
/// The radius of a ball where the lamp was, m.
const BEAD: f64 = 0.009;
const BEADS: [u8; 3] = [217, 119, 6];
const CAMERAS: [u8; 3] = [59, 91, 219];

/// The shown ones of a DOM's objects, and who follows.
#[derive(Default)]
pub(crate) struct Drawn {
    stage: Option<Stage>,
    objects: Rc<RefCell<Objects>>,
}

#[derive(Default)]
struct Objects {
    /// Values, postcard.
    bytes: BTreeMap<String, Vec<u8>>,
    changed: bool,
}

impl Drawn {
    /// Takes note of an object that is stored.
    pub(crate) fn put(&self, name: &str, bytes: &[u8]) {
        if self.stage.is_some() && SHOWN.contains(&name) {
            let mut objects = self.objects.borrow_mut();
            objects.bytes.insert(name.to_owned(), bytes.to_vec());
            objects.changed = true;
        }
    }

    /// One more follows; `value_of` tells the present value of an object.
    ///
    /// # Errors
    /// The message asks for something else.
    pub(crate) fn follow<'b>(
        &mut self,
        cx: &Context,
        message: Message,
        value_of: impl Fn(&str) -> Option<&'b [u8]>,
    ) -> Handled {
        if self.stage.is_none() {
            let objects = Rc::clone(&self.objects);
            self.stage = Some(Stage::new(Table {
                objects,
                ..Table::default()
            }));
            for name in SHOWN {
                if let Some(bytes) = value_of(name) {
                    self.put(name, bytes);
                }
            }
        }
        match &self.stage {
            Some(stage) => stage.follow(cx, message),
            None => cx.default_processing(message),
        }
    }
}

/// The objects as they were looked at last.
#[derive(Default)]
struct Table {
    objects: Rc<RefCell<Objects>>,
    seen: Seen,
}

impl Source for Table {
    fn view(&mut self) -> Option<View> {
        let mut objects = self.objects.borrow_mut();
        if !std::mem::take(&mut objects.changed) {
            return None;
        }
        let bytes = |name: &str| objects.bytes.get(name);
        // An object of another type is another app's, and nothing to draw.
        let observations: Option<Observations> =
            bytes(OBSERVATIONS).and_then(|bytes| postcard::from_bytes(bytes).ok());
        let calibrations: Option<Calibrations> =
            bytes(CALIBRATIONS).and_then(|bytes| postcard::from_bytes(bytes).ok());
        let choices: Option<Choices> =
            bytes(CHOICES).and_then(|bytes| postcard::from_bytes(bytes).ok());
        let (mut view, mut seen) = drawn(
            &observations.unwrap_or_default(),
            &calibrations.unwrap_or_default(),
        );
        let laid: Option<Laid> = bytes(LAID).and_then(|bytes| postcard::from_bytes(bytes).ok());
        for (part, pose) in laid.into_iter().flatten() {
            view.parts.push(part);
            seen.states.push((pose, Vec::new()));
        }
        for (part, numbers) in choices.iter().flat_map(ways) {
            view.parts.push(part);
            seen.states.push((Pose::default(), numbers));
        }
        self.seen = seen;
        Some(view)
    }

    fn look(&mut self) -> Seen {
        self.seen.clone()
    }
}

fn drawn(observations: &Observations, calibrations: &Calibrations) -> (View, Seen) {
    let mut view = View::default();
    let mut seen = Seen::default();
    let mut add = |part: Part, pose: Pose, numbers: Vec<f64>| {
        view.parts.push(part);
        seen.states.push((pose, numbers));
    };
    let beads = beads(observations);
    if !beads.is_empty() {
        let part = Part {
            name: "lamp positions".to_owned(),
            kind: format!("{} points", beads.len()),
            solids: beads,
            colour: BEADS,
            ..Part::default()
        };
        add(part, Pose::default(), Vec::new());
    }
    for (name, calibration) in &calibrations.cameras {
        let size = [calibration.width as f64, calibration.height as f64];
        let number = |name: &str, resolution| Number {
            name: name.to_owned(),
            unit: "px".to_owned(),
            resolution,
        };
        let part = Part {
            name: name.clone(),
            kind: "camera, as computed".to_owned(),
            solids: vec![Solid::Frustum {
                corners: corners(&calibration.camera, size),
                camera: name.clone(),
            }],
            colour: CAMERAS,
            numbers: vec![number("residual rms", 1e-3), number("noise", 1e-3)],
            ..Part::default()
        };
        let numbers = vec![calibration.rms_px, calibration.noise_px];
        add(part, pose(&calibration.camera), numbers);
    }
    seen.said = said(observations, calibrations);
    (view, seen)
}

/// The ways of all steps, which have no form: what is believed of each.
fn ways(choices: &Choices) -> Vec<(Part, Vec<f64>)> {
    let number = |name: &str, unit: &str, resolution| Number {
        name: name.to_owned(),
        unit: unit.to_owned(),
        resolution,
    };
    let ways = choices.iter().flat_map(|(step, shown)| {
        shown.figures.iter().map(move |figures| {
            let is_chosen = shown.chosen.as_ref() == Some(&figures.name);
            let kind = if is_chosen { "way, chosen" } else { "way" };
            let part = Part {
                name: format!("{step}: {}", figures.name),
                kind: kind.to_owned(),
                numbers: vec![
                    number("success", "", 1e-3),
                    number("cost", "s", 1e-2),
                    number("tried", "", 1.0),
                ],
                ..Part::default()
            };
            (
                part,
                vec![figures.chance, figures.cost, figures.trials as f64],
            )
        })
    });
    ways.collect()
}

/// A ball for each place at which the lamp was seen.
fn beads(observations: &Observations) -> Vec<Solid> {
    let points = observations.cameras.iter().flat_map(|table| &table.points);
    let mut places: Vec<[f64; 3]> = points.map(|point| [point.x, point.y, point.z]).collect();
    places.sort_by(|one, other| one.partial_cmp(other).unwrap_or(std::cmp::Ordering::Equal));
    places.dedup();
    let bead = |at: [f64; 3]| Solid::Capsule {
        a: at,
        b: at,
        radius: BEAD,
    };
    places.into_iter().map(bead).collect()
}

fn said(observations: &Observations, calibrations: &Calibrations) -> Said {
    let done = u64::from(observations.reached) + u64::from(observations.out_of_reach);
    let tables = observations.cameras.iter();
    let seen: Vec<String> = tables
        .map(|table| format!("{} saw the lamp {} times", table.camera, table.points.len()))
        .collect();
    let cameras = calibrations.cameras.iter();
    let computed: Vec<String> = cameras
        .map(|(camera, calibration)| {
            format!("{camera} is computed, to {:.2} px rms", calibration.rms_px)
        })
        .collect();
    let words = if computed.is_empty() {
        &seen
    } else {
        &computed
    };
    Said {
        words: words.join("; "),
        fault: false,
        job: (done > 0).then(|| Job {
            done,
            total: observations.wanted.into(),
            step: "position".to_owned(),
            words: seen.join("; "),
        }),
    }
}

/// Where the camera is: its frame has x right, y down, z forward.
fn pose(camera: &Camera) -> Pose {
    let turn = camera.rotation.inverse();
    Pose {
        at: camera.centre.coords.into(),
        turn: turn.coords.into(),
    }
}

/// The corners of what a camera sees, without its distortion.
fn corners(camera: &Camera, [width, height]: [f64; 2]) -> [[f64; 3]; 4] {
    let lens = &camera.intrinsics;
    let corner = |u: f64, v: f64| {
        let (x, y) = ((u - lens.cx) / lens.fx, (v - lens.cy) / lens.fy);
        [DEPTH * x, DEPTH * y, DEPTH]
    };
    let (left, top, right, bottom) = (-0.5, -0.5, width - 0.5, height - 0.5);
    [
        corner(left, top),
        corner(right, top),
        corner(right, bottom),
        corner(left, bottom),
    ]
}

#[cfg(test)]
mod tests {
    use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3, Vector4};
    use vss::calibrate::LightPoint;

    use super::*;
    use crate::{
        objects::CameraTable,
        rig,
        strategy::{Figures, shown::Shown},
    };

    fn observations() -> Observations {
        let point = |x: f64| LightPoint {
            x,
            y: 0.5,
            z: 1.0,
            u: 10.0,
            v: 20.0,
        };
        let table = |camera: &str, xs: &[f64]| CameraTable {
            camera: camera.to_owned(),
            points: xs.iter().map(|x| point(*x)).collect(),
            ..CameraTable::default()
        };
        Observations {
            wanted: 74,
            reached: 3,
            out_of_reach: 1,
            cameras: vec![table("west", &[0.1, 0.2]), table("east", &[0.2, 0.3])],
            ..Observations::default()
        }
    }

    #[test]
    fn the_table_of_a_calibration_says_how_far_it_is_and_where_the_lamp_was_seen() {
        let (view, seen) = drawn(&observations(), &Calibrations::default());
        let job = seen.said.job.unwrap();
        assert_eq!(
            (job.done, job.total, job.step.as_str()),
            (4, 74, "position")
        );
        assert_eq!(
            job.words,
            "west saw the lamp 2 times; east saw the lamp 2 times"
        );
        // A place that both saw is one.
        assert_eq!(view.parts[0].solids.len(), 3);
        let (view, seen) = drawn(&Observations::default(), &Calibrations::default());
        assert_eq!((view.parts.len(), seen.said), (0, Said::default()));
    }

    #[test]
    fn the_ways_of_a_step_are_told_with_what_is_believed_of_them_and_which_one_is_tried() {
        let figures = |name: &str, trials, chance| Figures {
            name: name.to_owned(),
            trials,
            chance,
            cost: 2.0,
        };
        let shown = Shown {
            chosen: Some("arch".to_owned()),
            figures: vec![figures("arch", 3, 0.8), figures("line", 0, 0.5)],
        };
        let choices = Choices::from([("transfer".to_owned(), shown)]);
        let told: Vec<(String, String, Vec<f64>)> = ways(&choices)
            .into_iter()
            .map(|(part, numbers)| (part.name, part.kind, numbers))
            .collect();
        let way = |name: &str, kind: &str, numbers: [f64; 3]| {
            (name.to_owned(), kind.to_owned(), numbers.to_vec())
        };
        assert_eq!(
            told,
            [
                way("transfer: arch", "way, chosen", [0.8, 2.0, 3.0]),
                way("transfer: line", "way", [0.5, 2.0, 0.0]),
            ]
        );
    }

    #[test]
    fn what_stands_at_the_edges_of_a_cameras_pyramid_is_at_the_edges_of_its_picture() {
        let camera = rig::camera(Point3::new(0.5, -0.1, 2.9));
        let Pose { at, turn } = pose(&camera);
        let world_t_camera = Isometry3::from_parts(
            Vector3::from(at).into(),
            UnitQuaternion::from_quaternion(Vector4::from(turn).into()),
        );
        let pixels = [[-0.5, -0.5], [499.5, -0.5], [499.5, 399.5], [-0.5, 399.5]];
        for (corner, [u, v]) in corners(&camera, [500.0, 400.0]).into_iter().zip(pixels) {
            let seen = camera
                .project(&(world_t_camera * Point3::from(corner)))
                .unwrap();
            assert!(
                (seen.x - u).abs() < 1e-9 && (seen.y - v).abs() < 1e-9,
                "{seen}"
            );
        }
    }
}

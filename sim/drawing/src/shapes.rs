//! The outer form of arms, objects and the room: one list, used both by the physics (as colliders) and by the cameras
//! (as pictures).

use mcs_model::{FrameId, Model, built_in};
use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

/// A solid in the frame it is attached to, m.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Solid {
    /// All points within `radius` of the segment from `a` to `b`; a ball when they are equal.
    Capsule {
        /// One end of the axis.
        a: Point3<f64>,
        /// The other end.
        b: Point3<f64>,
        /// Radius, m.
        radius: f64,
    },
    /// A box along the frame's axes.
    Block {
        /// Its centre.
        centre: Point3<f64>,
        /// Half its edge lengths.
        half: Vector3<f64>,
    },
    /// A cylinder about the frame's z axis with its centre at the origin.
    Cylinder {
        /// Half its height, m.
        half: f64,
        /// Radius, m.
        radius: f64,
    },
    /// A flat disc without thickness, the same from both sides.
    Disc {
        /// Its centre.
        centre: Point3<f64>,
        /// A unit vector at right angles to it.
        normal: Vector3<f64>,
        /// Radius, m.
        radius: f64,
    },
}

/// What a surface reflects when it is lit from straight above, each 0 to 255.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Paint {
    /// Grey level.
    Grey(f64),
    /// Levels of red, green and blue.
    Colour([f64; 3]),
}

impl Paint {
    /// As a grey camera sees it: a colour by ITU-R BT.709.
    #[must_use]
    pub fn grey(self) -> f64 {
        match self {
            Self::Grey(grey) => grey,
            Self::Colour([red, green, blue]) => 0.2126 * red + 0.7152 * green + 0.0722 * blue,
        }
    }

    /// Red, green and blue.
    #[must_use]
    pub fn rgb(self) -> [f64; 3] {
        match self {
            Self::Grey(grey) => [grey; 3],
            Self::Colour(rgb) => rgb,
        }
    }
}

/// A solid with what it reflects.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Shape {
    /// Its form.
    pub solid: Solid,
    /// Its colour.
    pub paint: Paint,
}

/// A capsule of a PUMA or a finger: the last word of the frame that carries it, the ends of its axis, radius, grey.
type Part = (&'static str, [f64; 3], [f64; 3], f64, f64);

/// The parts of a PUMA.
///
/// The dimensions are ours, after the link lengths and offsets of the arm: the upper arm passes
/// beside the shoulder axis, the forearm comes back by part of that offset.
/// The parts near the wrist are painted like the floor: an edge behind a lamp's spot pulls at its
/// measured centre (by up to 0.1 px even so).
const PUMA: [Part; 9] = [
    ("base", [0.0, 0.0, 0.05], [0.0, 0.0, 0.56], 0.09, 38.0),
    ("link1", [0.0, 0.0, -0.06], [0.0, 0.0, 0.13], 0.085, 44.0),
    (
        "link2",
        [-0.56, 0.0, 0.235],
        [-0.4318, 0.0, 0.235],
        0.075,
        38.0,
    ),
    (
        "link2",
        [-0.4318, 0.0, 0.235],
        [0.0, 0.0, 0.235],
        0.062,
        42.0,
    ),
    ("link2", [0.0, 0.0, 0.20], [0.0, 0.0, 0.15], 0.058, 38.0),
    (
        "link3",
        [-0.0203, 0.0, -0.04],
        [-0.0203, 0.0, 0.20],
        0.055,
        28.0,
    ),
    (
        "link3",
        [-0.0203, 0.0, 0.20],
        [-0.0203, 0.0, 0.37],
        0.045,
        24.0,
    ),
    ("link4", [0.0, -0.03, 0.0], [0.0, 0.03, 0.0], 0.042, 24.0),
    ("link6", [0.0, 0.0, 0.0], [0.0, 0.0, 0.04], 0.028, 24.0),
];

/// A box of the gripper: the last word of the frame that carries it, its centre, half its edge lengths, grey.
type Block = (&'static str, [f64; 3], [f64; 3], f64);

/// The parts of the built-in gripper. The dimensions are ours; the pads stand as its model's file says.
const GRIPPER: [Block; 3] = [
    ("housing", [0.0, 0.0, 0.035], [0.03, 0.05, 0.035], 40.0),
    ("jaw_left", [0.0, 0.006, 0.03], [0.012, 0.006, 0.03], 60.0),
    ("jaw_right", [0.0, -0.006, 0.03], [0.012, 0.006, 0.03], 60.0),
];

/// The prism of the built-in hand.
const PRISM: Block = ("prism", [0.0, 0.0, 0.03], [0.045, 0.045, 0.03], 40.0);

/// The parts of each of its fingers, by their names without the finger's number.
const FINGER: [Part; 3] = [
    ("phalanx", [0.0, 0.0, 0.005], [0.0, 0.0, 0.06], 0.008, 50.0),
    ("distal", [0.0, 0.0, 0.0], [0.0, 0.0, 0.04], 0.0075, 55.0),
    ("tip", [0.0; 3], [0.0; 3], 0.009, 70.0),
];

/// The flange of a PUMA in frame 6, m.
const FLANGE: Point3<f64> = Point3::new(0.0, 0.0, 0.05625);

/// Radius and grey of the rod that carries a lamp.
const ROD_RADIUS: f64 = 0.004;
const ROD_GREY: f64 = 24.0;

/// The outer form of a model that is built in: its PUMAs, grippers and hands. Nothing is known of other models, nor of the
/// carts.
#[must_use]
pub fn outline(model: &Model) -> Vec<(FrameId, Shape)> {
    if !built_in::NAMES.contains(&model.name()) {
        return Vec::new();
    }
    let mut all = Vec::new();
    for frame in model.frames() {
        let word = last_word(&frame.name);
        let finger = word.trim_end_matches(|letter: char| letter.is_ascii_digit());
        let capsules = PUMA.iter().filter(|(part, ..)| *part == word);
        let capsules = capsules.chain(FINGER.iter().filter(|(part, ..)| *part == finger));
        let blocks = GRIPPER.iter().chain([&PRISM]);
        let blocks = blocks.filter(|(part, ..)| *part == word);
        let shapes = capsules.map(capsule).chain(blocks.map(block));
        all.extend(shapes.filter_map(|shape| Some((model.frame(&frame.name)?, shape))));
    }
    all
}

fn capsule((_, a, b, radius, grey): &Part) -> Shape {
    let solid = Solid::Capsule {
        a: (*a).into(),
        b: (*b).into(),
        radius: *radius,
    };
    Shape {
        solid,
        paint: Paint::Grey(*grey),
    }
}

fn block((_, centre, half, grey): &Block) -> Shape {
    let solid = Solid::Block {
        centre: (*centre).into(),
        half: (*half).into(),
    };
    Shape {
        solid,
        paint: Paint::Grey(*grey),
    }
}

/// The rod from the flange of a PUMA to a lamp at `lamp` (m, frame 6); `None` on another frame, or when there is no room.
#[must_use]
pub fn rod(frame: &str, lamp: &Point3<f64>, lamp_radius: f64) -> Option<Shape> {
    // The rod ends where the lamp begins; from the side it hides nothing of it.
    let rod = lamp - FLANGE;
    let length = rod.norm() - lamp_radius - ROD_RADIUS;
    (last_word(frame) == "link6" && length > 0.0).then(|| Shape {
        solid: Solid::Capsule {
            a: FLANGE,
            b: FLANGE + rod.normalize() * length,
            radius: ROD_RADIUS,
        },
        paint: Paint::Grey(ROD_GREY),
    })
}

/// `link1` of `left_arm.link1`.
fn last_word(name: &str) -> &str {
    name.rsplit('.').next().unwrap_or(name)
}

#[cfg(test)]
mod tests {
    use mcs_model::{self as model, file::Inertias};

    use super::*;

    #[test]
    fn a_puma_that_is_seen_and_touched_has_the_form_that_collisions_are_looked_for_with() {
        let model = built_in::model("puma560", Inertias::Engine)
            .unwrap()
            .unwrap();
        let seen = outline(&model);
        assert_eq!(seen.len(), model.shapes().len());
        let (mut data, q) = (model.data(), [0.3, -0.4, 0.5, 0.6, -0.7, 0.8]);
        for ((frame, seen), shape) in seen.iter().zip(model.shapes()) {
            let Solid::Capsule { a, b, radius } = seen.solid else {
                panic!("{seen:?}");
            };
            let (a, b) = (a.coords, b.coords);
            let there = model.placement(&mut data, &q, *frame);
            let seen = model::Solid::Capsule { a, b, radius }.seen_from(&there);
            let touched = shape.solid.seen_from(&data.carrier(shape.carrier));
            let [seen, touched] = [seen, touched].map(|solid| match solid {
                model::Solid::Capsule { a, b, radius } => (a, b, radius),
                _ => panic!("{solid:?}"),
            });
            assert_eq!((*frame, seen.2), (shape.frame, touched.2));
            assert!((seen.0 - touched.0).norm() + (seen.1 - touched.1).norm() < 1e-12);
        }
    }

    #[test]
    fn every_puma_and_every_hand_of_a_built_in_model_has_its_outline_and_a_cart_has_none() {
        for (name, parts) in [
            ("puma560", 9),
            ("transporter", 0),
            ("testbed9", 9),
            ("testbed18", 18),
            ("testbed9_gripper", 12),
            ("gripper", 3),
            ("puma560_gripper", 12),
            ("puma560_hand", 19),
        ] {
            let model = built_in::model(name, Inertias::Engine).unwrap().unwrap();
            assert_eq!(outline(&model).len(), parts, "{name}");
        }
    }
}

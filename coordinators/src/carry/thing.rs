//! What is carried: one file with all that is to be said of a new object.

use std::ops::RangeInclusive;

use ctos::{
    config::Node,
    diagnostic::{Finding, Findings, Source},
};
use serde::{Deserialize, Serialize};

/// A thing to be carried, from its file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Thing {
    /// Its name.
    pub name: String,
    /// How wide it is between the pads that hold it, m.
    pub width_m: f64,
    /// What is wider or narrower by more than this is another thing, m.
    pub tolerance_m: f64,
    /// How high it is, m.
    pub height_m: f64,
    /// How heavy it is, kg. What weighs more by half when it is lifted is more than one; nobody weighs it when it is left out.
    pub mass_kg: Option<f64>,
    /// How it is grasped.
    pub grasp: Grasping,
    /// In which colours cameras look for it; in none, when it cannot be seen.
    #[serde(default)]
    pub colour: Vec<Colour>,
}

/// A colour that a thing may have.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Colour {
    /// What it is called.
    pub name: String,
    /// Red, green and blue, 0 to 255. Greys are not told from what else there is.
    pub rgb: [f64; 3],
}

/// A colour's largest part is larger than its smallest by so much, levels.
const HUED: f64 = 40.0;

/// How a thing is grasped.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Grasping {
    /// How hard each jaw presses, N.
    pub force_n: f64,
    /// How far the pads are apart on the way down, m, where there is room; nearer where other things lie beside it.
    pub open_m: f64,
    /// How much room a finger takes outside of the opening, m.
    #[serde(default)]
    pub finger_m: f64,
    /// The middle between the pads above the bottom of the thing, m.
    pub above_m: f64,
    /// How the gripper may be turned about the vertical of the board, degrees: the first turn with which the arm reaches
    /// all there is to do is taken.
    pub turns_deg: Vec<f64>,
}

/// Between a finger and what it goes past, m.
const PAST_M: f64 = 1e-3;

/// Between a finger and the thing that it goes round, m: no opening is narrower.
const ROUND_M: f64 = 2e-3;

impl Thing {
    /// How far fingers open to go round it, m: between things whose middles are so far from its own, m.
    #[must_use]
    pub fn opening(&self, neighbours_m: impl Iterator<Item = f64>) -> f64 {
        let Grasping {
            open_m, finger_m, ..
        } = self.grasp;
        let nearest = neighbours_m.fold(f64::INFINITY, f64::min);
        let room = 2.0 * (nearest - 0.5 * self.width_m - finger_m - PAST_M);
        let least = self.width_m + 2.0 * ROUND_M;
        room.max(least).min(open_m)
    }

    /// How far the middles of two things are apart, m, when a finger goes down between them.
    #[must_use]
    pub fn apart(&self) -> f64 {
        self.width_m + self.grasp.finger_m + PAST_M + ROUND_M
    }

    /// Reads the text of a thing's file.
    ///
    /// # Errors
    /// Everything that is wrong in it, each with its place.
    pub fn parse(source: &Source) -> Result<Self, Findings> {
        let mut findings = Findings::new();
        let file = Node::from_toml(source, &mut findings);
        if !findings.is_empty() {
            return Err(findings);
        }
        let thing: Self = file.parse()?;
        let mut wrong = |key: &str, text: String| {
            let place = file.locate(key).or_else(|| file.place().cloned());
            let finding = Finding::error("coordinators::carry::thing", text);
            findings.push(match place {
                Some(place) => finding.at(place),
                None => finding,
            });
        };
        let grasp = &thing.grasp;
        let ranges: [(&str, f64, RangeInclusive<f64>); 8] = [
            ("width_m", thing.width_m, 1e-3..=0.5),
            ("tolerance_m", thing.tolerance_m, 1e-4..=0.1),
            ("height_m", thing.height_m, 1e-3..=0.5),
            ("mass_kg", thing.mass_kg.unwrap_or(1.0), 1e-3..=50.0),
            ("grasp.force_n", grasp.force_n, 0.1..=500.0),
            ("grasp.open_m", grasp.open_m, 1e-3..=0.5),
            ("grasp.finger_m", grasp.finger_m, 0.0..=0.2),
            ("grasp.above_m", grasp.above_m, 0.0..=0.5),
        ];
        for (key, value, range) in ranges {
            if !range.contains(&value) {
                let (least, most) = (range.start(), range.end());
                wrong(
                    key,
                    format!("`{key}` is {value}; give from {least} to {most}"),
                );
            }
        }
        if grasp.open_m <= thing.width_m {
            let text = format!(
                "pads {} m apart do not go round a thing {} m wide: give a larger `grasp.open_m`",
                grasp.open_m, thing.width_m
            );
            wrong("grasp.open_m", text);
        }
        let turns = &grasp.turns_deg;
        if turns.is_empty() || !turns.iter().all(|turn| (-360.0..=360.0).contains(turn)) {
            let text = "`grasp.turns_deg` needs at least one turn from -360 to 360 degrees";
            wrong("grasp.turns_deg", text.to_owned());
        }
        for (number, colour) in thing.colour.iter().enumerate() {
            let least = colour.rgb.iter().copied().fold(f64::INFINITY, f64::min);
            let most = colour.rgb.iter().copied().fold(0.0, f64::max);
            if !(least >= 0.0 && most <= 255.0 && most - least >= HUED) {
                let name = &colour.name;
                let text = format!(
                    "colour `{name}` is {:?}; give red, green and blue from 0 to 255, of which one is larger than another by {HUED}",
                    colour.rgb
                );
                wrong(&format!("colour.{number}.rgb"), text);
            }
        }
        if findings.is_empty() {
            Ok(thing)
        } else {
            Err(findings)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DISC: &str = include_str!("../../../configs/carry/disc.toml");

    fn parse(text: &str) -> Result<Thing, Findings> {
        Thing::parse(&Source::new("disc.toml", text))
    }

    #[test]
    fn the_thing_that_is_delivered_reads() {
        let disc = parse(DISC).unwrap();
        assert_eq!(disc.name, "disc");
        assert!(disc.grasp.open_m > disc.width_m);
    }

    #[test]
    fn fingers_open_as_far_as_there_is_room_between_the_thing_and_its_neighbours_and_no_further() {
        let mut disc = parse(DISC).unwrap();
        (disc.width_m, disc.grasp.open_m, disc.grasp.finger_m) = (0.036, 0.05, 0.018);
        let opening = |neighbours: &[f64]| disc.opening(neighbours.iter().copied());
        assert_eq!(opening(&[]), 0.05);
        assert_eq!(opening(&[0.2, 0.1]), 0.05);
        // A finger of 18 mm beside a rim that is 60 - 18 mm away.
        assert!((opening(&[0.1, 0.06]) - 0.046).abs() < 1e-12);
        // It goes round the thing in any case.
        assert!((opening(&[0.045]) - 0.040).abs() < 1e-12);
    }

    #[test]
    fn what_makes_no_sense_is_found_at_its_place() {
        let broken = [
            ("width_m = 0.036", "width_m = -1.0", "`width_m` is -1"),
            ("open_m = 0.05", "open_m = 0.03", "do not go round"),
            ("mass_kg = 0.02", "mass_kg = 0.0", "`mass_kg` is 0"),
            ("height_m = 0.01", "heigth_m = 0.01", "heigth_m"),
            ("turns_deg = [", "turns_deg = [] # [", "at least one turn"),
            ("force_n = 15.0", "force_n = \"much\"", "force_n"),
            ("name = \"disc\"", "name = ", "disc.toml"),
            (
                "rgb = [190.0, 45.0, 40.0]",
                "rgb = [90.0, 90.0, 90.0]",
                "colour `red`",
            ),
        ];
        for (whole, wrong, text) in broken {
            assert!(DISC.contains(whole), "{whole}");
            let found = parse(&DISC.replace(whole, wrong)).unwrap_err().to_string();
            assert!(found.contains(text), "{wrong}: {found}");
            assert!(found.contains("disc.toml:"), "{found}");
        }
    }
}

//! What is asked of a gripper or a hand by message, and of those who feel what presses on fingers.

use ctos::command;
use mcs::{Joints, client::MotionError};
use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};

/// Whether a gripper holds something.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Held {
    /// It closed on something, still presses on it, and the jaws stand still; of a hand, every fingertip feels it.
    pub holds: bool,
    /// How far the pads are apart, m: as wide as what it holds. Of a hand, the width of the round thing that all fingertips touch.
    pub width_m: f64,
    /// How hard each jaw may press; of a hand, what is felt by the fingertip that feels the least, N.
    pub force_n: f64,
}

command! {
    /// Closes until the jaws stand still, and tells whether they hold something.
    #[derive(Debug, Clone, PartialEq)]
    pub struct Grasp {
        /// How hard each jaw presses, N; as the configuration says when it is left out.
        pub force_n: Option<f64>,
        /// Fraction of full speed, above 0 up to 1.
        pub speed: f64,
    } => Result<Held, MotionError>, 0x0381, "grasp"
}
command! {
    /// Opens, and so lets go of what it holds.
    #[derive(Debug, Clone, PartialEq)]
    pub struct Open {
        /// How far, m between the pads; all the way when it is left out.
        pub width_m: Option<f64>,
        /// Fraction of full speed, above 0 up to 1.
        pub speed: f64,
    } => Result<Held, MotionError>, 0x0382, "open"
}
command! {
    /// Tells whether it holds something now. What has slipped away since it was grasped is held no more.
    #[derive(Debug, Clone, PartialEq)]
    pub struct ReadHeld => Result<Held, MotionError>, 0x0383, "read_held"
}
command! {
    /// Switches power off, and so lets the brakes of the jaws hold what there is between them.
    #[derive(Debug, Clone, PartialEq)]
    pub struct SwitchOff => Result<(), MotionError>, 0x0384, "switch_off"
}

/// What presses on a link.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Touch {
    /// The link, by the name of its frame in the model.
    pub link: String,
    /// The force on it, N, in the axes of that frame.
    pub force_n: [f64; 3],
}

command! {
    /// Asks what presses on the links of an arm with their hands. Those that nothing presses on are not told.
    #[derive(Debug, Clone, PartialEq)]
    pub struct ReadTouch {
        /// The arm, by its name where the sensors are; the only one when it is left out.
        pub arm: Option<String>,
    } => Vec<Touch>, 0x0388, "read_touch"
}

/// Where fingers are, and what they feel.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct HandState {
    /// Joint positions, rad.
    pub joints: Joints,
    /// How hard something presses on each fingertip, N.
    pub touch_n: [f64; 3],
    /// Whether the last grasp holds.
    pub holds: bool,
}

command! {
    /// Moves the joints of all fingers, and lets go of what they hold.
    #[derive(Debug, Clone, PartialEq)]
    pub struct MoveFingers {
        /// Where to, rad, in the order of the model.
        pub joints: Joints,
        /// Fraction of full speed, above 0 up to 1.
        pub speed: f64,
        /// In just so many seconds instead.
        pub time_s: Option<f64>,
    } => Result<HandState, MotionError>, 0x0389, "move_fingers"
}
command! {
    /// Grasps with three fingertips, and tells whether each of them feels that something presses back.
    #[derive(Debug, Clone, PartialEq)]
    pub struct Tripod {
        /// Where the fingertips would meet, m, in the base frame of the hand's model.
        pub centre_m: [f64; 3],
        /// How hard each fingertip presses, N.
        pub force_n: f64,
        /// Fraction of full speed, above 0 up to 1.
        pub speed: f64,
    } => Result<HandState, MotionError>, 0x038a, "tripod"
}
command! {
    /// Lets go: the fingers go back to where they were before the grasp.
    #[derive(Debug, Clone, PartialEq)]
    pub struct LetGo {
        /// Fraction of full speed, above 0 up to 1.
        pub speed: f64,
    } => Result<HandState, MotionError>, 0x038b, "let_go"
}
command! {
    /// Tells where the fingers are, what they feel, and whether the last grasp still holds.
    #[derive(Debug, Clone, PartialEq)]
    pub struct ReadHand => Result<HandState, MotionError>, 0x038c, "read_hand"
}
command! {
    /// Makes every joint a spring of its own from now on.
    #[derive(Debug, Clone, PartialEq)]
    pub struct SetStiffness {
        /// N m/rad; 0 is as stiff as the servo makes it.
        pub stiffness: f64,
    } => Result<(), MotionError>, 0x038d, "set_stiffness"
}

/// How hard two tips press on what they carry between them, along the line between them.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Squeeze {
    /// How hard they shall press, N; below 0 they pull. None while they carry nothing.
    pub wanted_n: Option<f64>,
    /// How hard the wrists felt them press in the last tick, N.
    pub felt_n: f64,
}

command! {
    /// Says how hard two tips shall press on what they carry between them, from now on, or that they carry nothing.
    #[derive(Debug, Clone, PartialEq)]
    pub struct SetSqueeze {
        /// N; below 0 they pull. None when they carry nothing.
        pub force_n: Option<f64>,
    } => Result<(), String>, 0x0390, "set_squeeze"
}
command! {
    /// Tells how hard they shall press, and how hard they do.
    #[derive(Debug, Clone, PartialEq)]
    pub struct ReadSqueeze => Squeeze, 0x0391, "read_squeeze"
}

/// A body of the world.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Body {
    /// Its name: that of an object, or `ARM.LINK`.
    pub name: String,
    /// `world_t_body`, 4 by 4, row by row, m.
    pub world_t_body: [f64; 16],
}

command! {
    /// Asks a stand-in for the world where its bodies truly are. For those who judge, and for nobody who plans.
    #[derive(Debug, Clone, PartialEq)]
    pub struct ReadBodies => Vec<Body>, 0x0392, "read_bodies"
}
command! {
    /// A person makes it lighter or darker in the room, from the next picture on.
    #[derive(Debug, Clone, PartialEq)]
    pub struct LightRoom {
        /// How light: 1 is as the cell has it, 0 without light, 10 the most.
        pub share: f64,
    } => (), 0x0397, "light_room"
}
command! {
    /// A person puts an object elsewhere: where it is and how it lies, at once and at rest.
    #[derive(Debug, Clone, PartialEq)]
    pub struct PlaceBody {
        /// Its name in the cell.
        pub body: String,
        /// `world_T_body`, m. Nobody sees to it that nothing else is there.
        pub pose: Isometry3<f64>,
    } => (), 0x0394, "place_body"
}

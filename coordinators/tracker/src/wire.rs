//! What the tasks of the tracker exchange: snapshot buffers of the app for what is new again and again, and messages.
//!
//! | buffer | writer, readers | a record |
//! |---|---|---|
//! | [`BLOB`] | argus; client, display | [`BlobRecord`] |
//! | [`STATES`] | the servo; druide | joints and sensors, as `record_states` says |
//! | [`SETPOINT`] | druide; the servo | a position of each joint, rad or m |
//! | [`MOUSE`] | the mouse's daemon; druide | six numbers from -1 to 1 |
//! | [`COURSE`] | druide; application, display | [`CourseRecord`] |

use ctos::time::Instant;
use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};
use vss::target_map::Seen;

use crate::{
    blob::{Look, Sighting},
    control::{Counts, Phase},
    grasp::Grasped,
    learning::Learning,
    map::Example,
};

/// What argus sees.
pub const BLOB: &str = "tracker.blob";
/// What each tick of the servo leaves.
pub const STATES: &str = "tracker.states";
/// Where the hand shall be.
pub const SETPOINT: &str = "tracker.setpoint";
/// How the mouse is deflected.
pub const MOUSE: &str = "tracker.mouse";
/// What druide did.
pub const COURSE: &str = "tracker.course";

ctos::command! {
    /// Tells argus what the ball looks like from now on.
    #[derive(Debug, Clone, PartialEq)]
    pub struct TuneLook {
        /// What it looks like.
        pub look: Look,
    } => (), 0x0620, "tune_look"
}
ctos::command! {
    /// Asks a task for its clock: one side of an exchange.
    #[derive(Debug, Clone, PartialEq)]
    pub struct CompareClocks => ClockTimes, 0x0621, "compare_clocks"
}
ctos::command! {
    /// Asks how wrong the clock of a task's chassis is; only virtual time knows. For a judge only.
    #[derive(Debug, Clone, PartialEq)]
    pub struct TrueClock => ClockTruth, 0x0622, "true_clock"
}
ctos::command! {
    /// Tells druide where the hand should have been at a moment.
    #[derive(Debug, Clone, PartialEq)]
    pub struct TargetSeen {
        /// When the picture was exposed, ns by the clock of argus.
        pub stamp_ns: u64,
        /// When the camera had given it, by the same clock, ns.
        pub received_ns: u64,
        /// The place where the hand should have been, seen from where it was: m along the axes of the tool.
        pub relative: [f64; 3],
    } => (), 0x0623, "target_seen"
}
ctos::command! {
    /// Has the client learn a map of these examples, keep it, and use it from now on.
    #[derive(Debug, Clone, PartialEq)]
    pub struct LearnMap {
        /// The examples, in the order of a map.
        pub examples: Vec<Example>,
    } => (), 0x0624, "learn_map"
}
ctos::command! {
    /// Has the client tell the place of a blob: m along the axes of the tool, and E; nothing where it is no ball.
    #[derive(Debug, Clone, PartialEq)]
    pub struct LocateBlob {
        /// u, v, radius and spread, px.
        pub seen: [f64; 4],
    } => Option<([f64; 3], f64)>, 0x0625, "locate_blob"
}
ctos::command! {
    /// Asks the client what became of the pictures.
    #[derive(Debug, Clone, PartialEq)]
    pub struct ReadSights => Sights, 0x062c, "read_sights"
}
ctos::command! {
    /// Has druide take the arm and follow.
    #[derive(Debug, Clone, PartialEq)]
    pub struct StartTracking => (), 0x0626, "start_tracking"
}
ctos::command! {
    /// Has druide come to rest and give the arm back.
    #[derive(Debug, Clone, PartialEq)]
    pub struct StopTracking => (), 0x0627, "stop_tracking"
}
ctos::command! {
    /// Has druide follow again with an arm that was stopped.
    #[derive(Debug, Clone, PartialEq)]
    pub struct ResumeTracking => (), 0x062a, "resume_tracking"
}
ctos::command! {
    /// Has druide take the arm and learn the map. It answers when that has begun.
    #[derive(Debug, Clone, PartialEq)]
    pub struct StartLearning => (), 0x062b, "start_learning"
}
ctos::command! {
    /// Has druide take the arm and grasp the ball where it rested when the arm was given back. It answers when that has begun.
    #[derive(Debug, Clone, PartialEq)]
    pub struct StartGrasp => (), 0x0632, "start_grasp"
}
ctos::command! {
    /// Has the hand let go of what it holds, and druide give the arm back.
    #[derive(Debug, Clone, PartialEq)]
    pub struct LetGo => (), 0x0633, "let_go"
}
ctos::command! {
    /// Asks druide how it is.
    #[derive(Debug, Clone, PartialEq)]
    pub struct ReadTracker => TrackerReport, 0x0628, "read_tracker"
}
ctos::command! {
    /// Deflects the mouse: six numbers from -1 to 1, until they are said anew or called back.
    #[derive(Debug, Clone, PartialEq)]
    pub struct DeflectMouse {
        /// Along x, y and z of the base frame, and about them.
        pub numbers: [f64; 6],
    } => (), 0x0629, "deflect_mouse"
}

ctos::command! {
    /// Deflects the mouse for a while, each number from -1 to 1; then it is let go.
    #[derive(Debug, Clone, PartialEq)]
    pub struct SteerMouse {
        /// Along x of the base frame,
        pub x: f64,
        /// along y,
        pub y: f64,
        /// along z,
        pub z: f64,
        /// about x,
        pub about_x: f64,
        /// about y,
        pub about_y: f64,
        /// about z.
        pub about_z: f64,
        /// For how long, s.
        pub seconds: f64,
    } => (), 0x062d, "steer_mouse"
}

/// When a question arrived, and when it was answered, ns by the clock of who was asked.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ClockTimes {
    /// When it arrived.
    pub arrived_ns: u64,
    /// When it was answered.
    pub replied_ns: u64,
}

/// How wrong a simulated clock is.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct ClockTruth {
    /// What it showed at the start of the app, s.
    pub ahead_s: f64,
    /// How much faster than the true time it runs, s per s.
    pub rate: f64,
}

impl ClockTruth {
    /// Of the clock here.
    #[must_use]
    pub fn here(cx: &ctos::task::Context) -> Self {
        let drift = cx.chassis().clock().drift();
        Self {
            ahead_s: drift.offset_ns as f64 * 1e-9,
            rate: f64::from(drift.rate_ppb) * 1e-9,
        }
    }

    /// By how much another clock is ahead when this one shows `now`, s.
    #[must_use]
    pub fn ahead_of_this(&self, other: &Self, now: f64) -> f64 {
        let truly = (now - self.ahead_s) / (1.0 + self.rate);
        truly * (1.0 + other.rate) + other.ahead_s - now
    }
}

/// What became of pictures in which something shone.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Sights {
    /// Those whose ball has a place.
    pub placed: u64,
    /// The ball was cut by the border,
    pub clipped: u64,
    /// too small or too large,
    pub size: u64,
    /// not round: a reflection, or partly covered,
    pub shape: u64,
    /// or beside another one that is as good.
    pub ambiguous: u64,
    /// The map does not know the place: E is high.
    pub unknown: u64,
}

/// How druide is.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct TrackerReport {
    /// What it does.
    pub phase: Phase,
    /// Why it was stopped last, if it was.
    pub stopped: Option<String>,
    /// How often it was stopped.
    pub stops: u64,
    /// What held the hand back last where the arm reaches no further, if something did.
    pub held_by: Option<String>,
    /// What has happened.
    pub counts: Counts,
    /// Places that nobody knows the hand's pose for: before the clocks were compared, or too old.
    pub unplaced: u64,
    /// The clock of argus minus the clock here, s.
    pub clock_s: f64,
    /// The most by which that is wrong, s.
    pub clock_bound_s: f64,
    /// How often a clock was set.
    pub clock_restarts: u64,
    /// How learning the map is.
    pub learning: Learning,
    /// How grasping the ball ended last, if it has.
    pub grasped: Option<Grasped>,
}

/// Seconds of a moment.
#[must_use]
pub fn seconds(moment: Instant) -> f64 {
    moment.since_start().as_secs_f64()
}

/// A record of [`BLOB`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BlobRecord {
    /// When the picture was exposed, ns by the clock of argus.
    pub stamp_ns: u64,
    /// When the camera had given it, by the same clock, ns.
    pub received_ns: u64,
    /// Which picture.
    pub number: u64,
    /// What it shows.
    pub sighting: Sighting,
}

impl BlobRecord {
    /// Its floats.
    pub const FLOATS: usize = 11;

    /// What they are.
    pub const DESCRIPTION: &str = "exposed ns\nreceived ns\npicture\nu px\nv px\nradius px\nspread px\narea px\neccentricity\nblobs\ndoubts";

    /// As floats. A stamp of a float is right to a nanosecond for 50 days.
    #[must_use]
    pub fn floats(&self) -> [f64; Self::FLOATS] {
        let Sighting {
            seen,
            area,
            eccentricity,
            blobs,
            doubts,
        } = &self.sighting;
        [
            self.stamp_ns as f64,
            self.received_ns as f64,
            self.number as f64,
            seen.u,
            seen.v,
            seen.radius,
            seen.spread,
            *area as f64,
            *eccentricity,
            *blobs as f64,
            *doubts as f64,
        ]
    }

    /// From floats; `None` when they are others.
    #[must_use]
    pub fn from_floats(floats: &[f64]) -> Option<Self> {
        let [
            stamp,
            received,
            number,
            u,
            v,
            radius,
            spread,
            area,
            eccentricity,
            blobs,
            doubts,
        ] = *floats
        else {
            return None;
        };
        Some(Self {
            stamp_ns: stamp as u64,
            received_ns: received as u64,
            number: number as u64,
            sighting: Sighting {
                seen: Seen {
                    u,
                    v,
                    radius,
                    spread,
                },
                area: area as u64,
                eccentricity,
                blobs: blobs as usize,
                doubts: doubts as i64,
            },
        })
    }
}

/// A record of [`COURSE`]: what a period of druide did. Places are those of the hand, m in the base frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CourseRecord {
    /// The moment, s by the clock of druide.
    pub now: f64,
    /// Where the hand is sent.
    pub place: Point3<f64>,
    /// How fast, m/s.
    pub velocity: Vector3<f64>,
    /// Where it should be now, as estimated; nothing without a ball.
    pub target: Option<Point3<f64>>,
    /// How old what that was predicted from was when the setpoint was left, s.
    pub age: f64,
    /// How long the camera had given the newest picture in it then, s: what of its age is our own work.
    pub own: f64,
    /// What druide did.
    pub phase: Phase,
    /// Where the hand was measured.
    pub tool: Point3<f64>,
    /// When, s.
    pub tool_at: f64,
    /// Force at the wrist, N.
    pub force: f64,
    /// Change of the velocity, as a part of what the limit allows.
    pub ratio: f64,
    /// The clock of argus minus the clock here, s.
    pub clock: f64,
    /// The most by which that is wrong, s.
    pub clock_bound: f64,
}

impl CourseRecord {
    /// Its floats.
    pub const FLOATS: usize = 21;

    /// What they are.
    pub const DESCRIPTION: &str = "now s\nx m\ny m\nz m\nvx m/s\nvy m/s\nvz m/s\ntarget x m\ntarget y m\ntarget z m\nage s\nown s\nphase\ntool x m\ntool y m\ntool z m\ntool at s\nforce N\nacceleration ratio\nclock s\nclock bound s";

    /// As floats; a target that is not there has none that are numbers.
    #[must_use]
    pub fn floats(&self) -> [f64; Self::FLOATS] {
        let target = self
            .target
            .map_or([f64::NAN; 3], |target| target.coords.into());
        let [x, y, z] = target;
        let phase = Phase::ALL.iter().position(|phase| *phase == self.phase);
        [
            self.now,
            self.place.x,
            self.place.y,
            self.place.z,
            self.velocity.x,
            self.velocity.y,
            self.velocity.z,
            x,
            y,
            z,
            self.age,
            self.own,
            phase.unwrap_or_default() as f64,
            self.tool.x,
            self.tool.y,
            self.tool.z,
            self.tool_at,
            self.force,
            self.ratio,
            self.clock,
            self.clock_bound,
        ]
    }

    /// From floats; `None` when they are others.
    #[must_use]
    pub fn from_floats(floats: &[f64]) -> Option<Self> {
        let all: &[f64; Self::FLOATS] = floats.try_into().ok()?;
        let [
            now,
            x,
            y,
            z,
            vx,
            vy,
            vz,
            tx,
            ty,
            tz,
            age,
            own,
            phase,
            hx,
            hy,
            hz,
            at,
            rest @ ..,
        ] = *all;
        let [force, ratio, clock, clock_bound] = rest;
        let target = Point3::new(tx, ty, tz);
        Some(Self {
            now,
            place: Point3::new(x, y, z),
            velocity: Vector3::new(vx, vy, vz),
            target: (!tx.is_nan()).then_some(target),
            age,
            own,
            phase: *Phase::ALL.get(phase as usize)?,
            tool: Point3::new(hx, hy, hz),
            tool_at: at,
            force,
            ratio,
            clock,
            clock_bound,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn records_read_as_what_was_written() {
        let blob = BlobRecord {
            stamp_ns: 3_600_000_000_123,
            received_ns: 3_600_019_000_456,
            number: 7,
            sighting: Sighting {
                seen: Seen {
                    u: 1.0,
                    v: 2.0,
                    radius: 3.0,
                    spread: 4.0,
                },
                area: 28,
                eccentricity: 0.1,
                blobs: 2,
                doubts: 65,
            },
        };
        assert_eq!(BlobRecord::from_floats(&blob.floats()), Some(blob));
        let lines = |text: &str| text.lines().count();
        assert_eq!(lines(BlobRecord::DESCRIPTION), BlobRecord::FLOATS);
        assert_eq!(lines(CourseRecord::DESCRIPTION), CourseRecord::FLOATS);
        for phase in Phase::ALL {
            let course = CourseRecord {
                now: 1.0,
                place: Point3::new(1.0, 2.0, 3.0),
                velocity: Vector3::new(4.0, 5.0, 6.0),
                target: (phase == Phase::Track).then(|| Point3::new(7.0, 8.0, 9.0)),
                age: 10.0,
                own: 10.5,
                phase,
                tool: Point3::new(11.0, 12.0, 13.0),
                tool_at: 14.0,
                force: 15.0,
                ratio: 0.5,
                clock: 16.0,
                clock_bound: 17.0,
            };
            assert_eq!(CourseRecord::from_floats(&course.floats()), Some(course));
        }
        assert_eq!(CourseRecord::from_floats(&[1.0]), None);
    }

    #[test]
    fn how_far_a_clock_is_ahead_follows_from_how_wrong_both_are() {
        let (right, fast) = (
            ClockTruth::default(),
            ClockTruth {
                ahead_s: 2.0,
                rate: 1e-4,
            },
        );
        assert!((right.ahead_of_this(&fast, 10.0) - 2.001).abs() < 1e-12);
        assert!((fast.ahead_of_this(&right, 12.001) + 2.001).abs() < 1e-9);
    }
}

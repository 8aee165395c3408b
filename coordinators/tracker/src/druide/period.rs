//! A period of druide: what the servo left and the mouse says in, a setpoint out, by snapshot buffers.

use ctos::task::{Context, HandlerError};
use mcs::{Joints, trajectory::Solver};
use nalgebra::{Isometry3, Point3, Vector3};
use sorma::{
    clock::Difference,
    snapshot::{Layout, Place, Reader, Snapshot, Writer},
};

use super::DruideArgs;
use crate::{
    arm::Arm,
    control::{Control, Phase},
    history::History,
    target::Taken,
    wire::{COURSE, CourseRecord, MOUSE, SETPOINT, STATES, TrackerReport, seconds},
};

/// Where the hand was is remembered for so long, s: pictures come later than that only when something is wrong.
const REMEMBERED: f64 = 2.0;

/// Records that the buffers keep.
const SETPOINTS: usize = 16;
const COURSES: usize = 2000;

/// The vectors of a state record before the setpoints, and before what slots read that are no joints.
const SETPOINT_AT: usize = 2;
const SLOTS_AT: usize = 4;

/// A mouse's buffer that is not there is looked for every so many periods.
const LOOK: u64 = 100;

/// What a period works with.
pub(super) struct Period {
    control: Control,
    states: Reader,
    mouse: Option<Reader>,
    /// What the mouse said last: which record, since when it is known here, and how the mouse is deflected.
    said: (u64, f64, Vector3<f64>),
    place: Place,
    record: Snapshot,
    arm: Arm,
    joints: usize,
    history: History,
    setpoints: Writer,
    courses: Writer,
    /// About where the ball is seen from a hand that is where it should be, m.
    ball: Point3<f64>,
    /// Which number of the slots is the first of the force.
    wrist: Option<usize>,
    mouse_age: f64,
    period: f64,
    /// The force at the wrist, N, in the base frame.
    force: Vector3<f64>,
    /// When the camera had given the newest picture that is used, s.
    received: f64,
    /// The arm does not follow.
    halted: bool,
    /// Where the ball stays, and since when, s; within how far, m, and how long until it rests, s.
    stays: Option<(Point3<f64>, f64)>,
    rests: [f64; 2],
    count: u64,
}

impl Period {
    /// With an arm that rests and is held.
    pub(super) fn new(
        cx: &Context,
        solver: Solver,
        args: &DruideArgs,
    ) -> Result<Self, HandlerError> {
        let place = Place::of_app(&cx.app().name)?;
        let clock = cx.chassis().clock();
        let mut states = Reader::open(&place, STATES)?;
        let mut record = Snapshot::default();
        if !states.latest(&mut record)? {
            return Err("the servo has left no state yet".into());
        }
        let joints = solver.model().dof();
        let held = vector(&record.floats, SETPOINT_AT, joints);
        let held = held.and_then(|held| Joints::try_from(held).ok());
        let held = held.ok_or("a state of the servo has other numbers")?;
        let mut arm = Arm::at_rest(solver, held);
        let pose = arm.pose(&held);
        let layout = Layout::new(SETPOINTS, joints).described("joint positions, rad or m");
        let setpoints = Writer::create(&place, SETPOINT, layout, clock)?;
        let layout =
            Layout::new(COURSES, CourseRecord::FLOATS).described(CourseRecord::DESCRIPTION);
        let mut period = Self {
            control: Control::new(args.control, pose.translation.vector.into())
                .with_walls(args.walls.clone()),
            states,
            mouse: None,
            said: (0, 0.0, Vector3::zeros()),
            record,
            arm,
            joints,
            history: History::new(REMEMBERED),
            setpoints,
            courses: Writer::create(&place, COURSE, layout, clock)?,
            place,
            ball: Point3::from(args.ball_m),
            wrist: args.wrist,
            mouse_age: args.mouse_age_s,
            period: args.period_ms * 1e-3,
            force: Vector3::zeros(),
            received: f64::NAN,
            halted: false,
            stays: None,
            rests: args.rests,
            count: 0,
        };
        period.send()?;
        Ok(period)
    }

    /// The arm follows no more. Whether it did until now.
    pub(super) fn halt(&mut self) -> bool {
        !std::mem::replace(&mut self.halted, true)
    }

    /// The arm follows.
    pub(super) fn resume(&mut self) {
        self.halted = false;
    }

    /// Whether the hand is to come to rest, and to stand whatever is seen.
    pub(super) fn stand(&mut self, stands: bool) {
        self.control.stand(stands);
    }

    /// How large the force at the wrist is, N; what no sensor can read is no number.
    pub(super) fn felt(&self) -> f64 {
        self.force.norm()
    }

    /// Where a tool that is turned as the hand would have its place in the middle of the ball, if that is followed.
    pub(super) fn grasp(&self, now: f64) -> Option<Isometry3<f64>> {
        let target = self.control.target(now)?;
        let turn = self.arm.turn();
        let ball = target.place + turn * self.ball.coords;
        Some(Isometry3::from_parts(ball.into(), turn))
    }

    /// How the ball is.
    pub(super) fn phase(&self) -> Phase {
        self.control.phase()
    }

    /// Whether the ball has rested for a while.
    pub(super) fn ball_rests(&self, now: f64) -> bool {
        let [_, long] = self.rests;
        self.stays.is_some_and(|(_, since)| now - since >= long)
    }

    /// Takes in that the hand should have been at `relative`, m along its own axes, at the moment `at`; it is known `now`, and the
    /// camera had given the picture at `received`. False where nobody knows where the hand was then.
    pub(super) fn take(&mut self, now: f64, [at, received]: [f64; 2], relative: &[f64; 3]) -> bool {
        let Some(pose) = self.history.at(at) else {
            return false;
        };
        // The ball is seen from a hand that may be turned a little, as a hand that is late is; the map was learned without that.
        let ball = pose * (self.ball + Vector3::from(*relative));
        let place = ball - self.arm.turn() * self.ball.coords;
        let taken = self.control.measure(now, at, &place);
        tracing::trace!(at, late = now - at, ?relative, place = ?place.coords, ?taken);
        if matches!(taken, Taken::Begun | Taken::Used) {
            self.received = received;
        }
        if matches!(taken, Taken::Begun) {
            tracing::info!(x = place.x, y = place.y, z = place.z, "the ball is seen");
        }
        true
    }

    /// One period, until `now`, s.
    pub(super) fn go(
        &mut self,
        cx: &Context,
        now: f64,
        difference: Option<Difference>,
        report: &mut TrackerReport,
    ) {
        self.count += 1;
        self.read_states(cx);
        let mouse = self.deflection(now);
        let mut ratio = 0.0;
        if self.halted {
            // What is sent is where the arm is held, so that it begins there.
            if let Some(held) = self.held() {
                self.control.rest_at(held);
            }
        } else {
            ratio = self.go_on(now, &mouse, report);
        }
        if let Err(error) = self.send() {
            tracing::warn!("a setpoint is lost: {error}");
        }
        let left = seconds(cx.now());
        let phase = match self.halted {
            true => Phase::Stopped,
            false => self.control.phase(),
        };
        (report.phase, report.counts) = (phase, self.control.counts());
        let (tool_at, tool) = self.history.newest().map_or_else(
            || (now, Point3::origin()),
            |(at, pose)| (*at, pose.translation.vector.into()),
        );
        let target = self.control.target(now);
        let ball = target.filter(|_| phase == Phase::Track);
        let ball = ball.map(|target| target.place);
        self.stays = ball.map(|ball| match self.stays {
            Some((there, since)) if (ball - there).norm() < self.rests[0] => (there, since),
            _ => (ball, now),
        });
        let difference = difference.map_or((f64::NAN, f64::NAN), |difference| {
            let seconds = |ns: f64| ns * 1e-9;
            let offset = seconds(difference.offset_ns as f64);
            (offset, seconds(difference.error_ns as f64))
        });
        let record = CourseRecord {
            now,
            place: self.control.course().place,
            velocity: self.control.course().velocity,
            target: target.map(|target| target.place),
            age: target.map_or(0.0, |target| target.age + left - now),
            own: left - self.received,
            phase,
            tool,
            tool_at,
            force: self.force.norm(),
            ratio,
            clock: difference.0,
            clock_bound: difference.1,
        };
        let _ = self.courses.write(&record.floats(), &[]);
    }

    /// Goes on by a period as far as the arm reaches.
    fn go_on(&mut self, now: f64, mouse: &Vector3<f64>, report: &mut TrackerReport) -> f64 {
        let held = self.control.counts().held;
        let both = [&self.force, mouse];
        let arm = &mut self.arm;
        let joints = arm.limits();
        let limits_at = |place: &Point3<f64>| arm.limits_at(place).ok();
        let control = &mut self.control;
        let ratio = control.go_within(now, both, self.period, &joints, limits_at);
        if let Some(beyond) = self.control.beyond()
            && self.control.counts().held > held
        {
            report.held_by = self.arm.limits_at(&beyond).err();
            let why = report.held_by.as_deref().unwrap_or_default();
            tracing::warn!("the hand stays where the arm reaches no further: {why}");
        }
        ratio
    }

    /// Takes in what ticks of the servo left.
    fn read_states(&mut self, cx: &Context) {
        let clock = cx.chassis().clock();
        let joints = self.joints;
        while let Ok(Some(_)) = self.states.next(&mut self.record) {
            let floats = &self.record.floats;
            let Some(position) = vector(floats, 0, joints) else {
                continue;
            };
            let pose = self.arm.pose(position);
            let at = seconds(self.record.at(clock));
            self.history.note(at, pose);
            let force = self.wrist.and_then(|first| {
                let first = SLOTS_AT * joints + first;
                floats.get(first..first + 3)
            });
            // The sensor's frame is the tool's.
            self.force = match force {
                Some([x, y, z]) => pose.rotation * Vector3::new(*x, *y, *z),
                _ => Vector3::zeros(),
            };
        }
    }

    /// The arm rests where the servo holds it; where the hand is then.
    fn held(&mut self) -> Option<Point3<f64>> {
        let held = vector(&self.record.floats, SETPOINT_AT, self.joints)?;
        let held = Joints::try_from(held).ok()?;
        self.arm.rest_at(held);
        Some(self.arm.pose(&held).translation.vector.into())
    }

    /// How the mouse is deflected; not at all where its daemon has said nothing new for a while.
    fn deflection(&mut self, now: f64) -> Vector3<f64> {
        if self.mouse.as_ref().is_none_or(Reader::is_over) && self.count % LOOK == 1 {
            self.mouse = Reader::open(&self.place, MOUSE).ok();
        }
        let mut record = Snapshot::default();
        let mouse = self.mouse.as_mut();
        let read = mouse.is_some_and(|mouse| mouse.latest(&mut record).unwrap_or(false));
        if let [x, y, z, ..] = record.floats[..]
            && read
            && record.count != self.said.0
        {
            self.said = (record.count, now, Vector3::new(x, y, z));
        }
        let (_, since, deflection) = self.said;
        match now - since <= self.mouse_age {
            true => deflection,
            false => Vector3::zeros(),
        }
    }

    /// Leaves the setpoint: nothing where the arm has no joints for it, which ends the stream.
    fn send(&mut self) -> Result<(), HandlerError> {
        let place = self.control.course().place;
        self.arm.go(&place, self.period)?;
        self.setpoints.write(self.arm.joints(), &[])?;
        Ok(())
    }
}

/// A vector of a state record, by its number.
fn vector(floats: &[f64], number: usize, joints: usize) -> Option<&[f64]> {
    floats.get(number * joints..(number + 1) * joints)
}

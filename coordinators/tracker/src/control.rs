//! One period of the tracker: from what was seen, felt and steered to the next setpoint of the hand (SORMA technical report, figure
//! 2.7). Knows no tasks and no clocks: times are seconds of one clock, places m in the arm's base frame.
//!
//! The ball's place, as it is told here, is where the hand should be: the map was trained to give the way from the hand to there. A
//! force or a mouse moves that place, as a spring would that pulls the hand to it. Without a ball they move the hand itself.

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

use crate::{
    contact::{Contact, ContactArgs},
    course::{Course, CourseArgs},
    joint_limits::JointLimits,
    target::{Predicted, Taken, Target, TargetArgs},
    vector::{VectorArgs, VectorFilter},
    walls::{Wall, Walls},
};

/// A target that has expired and is slower than this, m/s, is given up.
const AT_REST: f64 = 0.002;

/// A hand counts with this part of its acceleration at least, however little the joints allow along its way.
const BRAKES: f64 = 0.3;

/// How fast force and mouse move a hand that has no target: parts of their displacement for each second.
const FREELY: f64 = 2.0;

/// The hand stays so far before the end of what the arm reaches, m. It looks for that end in steps as long, in so many at most, and finds
/// it by so many halvings of one.
const SHORT: f64 = 0.02;
const MOST_STEPS: f64 = 16.0;
const HALVINGS: u32 = 7;

/// A hand that is held is let go so many times farther from the end.
const HELD: f64 = 1.25;

/// How the hand follows.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ControlArgs {
    /// The ball.
    pub target: TargetArgs,
    /// Limits of the hand.
    pub course: CourseArgs,
    /// From the force at the wrist, N, to a displacement, m.
    pub wrist: VectorArgs,
    /// What the hand does at something that pushes back.
    pub contact: ContactArgs,
    /// From the mouse, whose axes go from -1 to 1, to a displacement, m.
    pub mouse: VectorArgs,
    /// Whether the ball's motion is predicted.
    pub prediction: bool,
    /// How long a setpoint takes to become a place of the hand, s.
    pub lead_s: f64,
    /// How long the hand takes to come up with a ball that turns, s: as far ahead motions are held against what came of them.
    pub catch_up_s: f64,
    /// Force and mouse move the goal no faster than this, m/s: what they lead the hand into is met gently.
    pub steer_m_s: f64,
    /// The hand stays within this distance from where it began, m.
    pub reach_m: f64,
    /// Without a measurement for this time the ball counts as lost, s; it is followed until it expires.
    pub overdue_s: f64,
    /// So long after the hand has come to rest without its ball it goes back to where it began, to look from there, s.
    pub home_after_s: f64,
}

impl Default for ControlArgs {
    fn default() -> Self {
        Self {
            target: TargetArgs::default(),
            course: CourseArgs::default(),
            wrist: VectorArgs {
                low_pass_hz: 4.0,
                null_radius: 3.0,
                scale: 0.004,
                clip: 0.1,
            },
            contact: ContactArgs::default(),
            mouse: VectorArgs {
                low_pass_hz: 4.0,
                null_radius: 0.05,
                scale: 0.1,
                clip: 0.1,
            },
            prediction: true,
            lead_s: 0.0135,
            catch_up_s: 0.2,
            steer_m_s: 0.2,
            reach_m: 0.3,
            overdue_s: 0.2,
            home_after_s: 2.0,
        }
    }
}

impl ControlArgs {
    /// The first number that cannot be, by its key.
    #[must_use]
    pub fn wrong(&self) -> Option<(String, f64)> {
        let parts = [
            ("target", self.target.wrong()),
            ("course", self.course.wrong()),
            ("wrist", self.wrist.wrong()),
            ("contact", self.contact.wrong()),
            ("mouse", self.mouse.wrong()),
        ];
        let part = parts
            .into_iter()
            .find_map(|(name, wrong)| wrong.map(|(key, value)| (format!("{name}.{key}"), value)));
        let own = [
            ("lead_s", self.lead_s, 0.0),
            ("catch_up_s", self.catch_up_s, 0.0),
            ("steer_m_s", self.steer_m_s, 0.001),
            ("reach_m", self.reach_m, 0.01),
            ("overdue_s", self.overdue_s, 0.001),
        ];
        let wrong = |(_, value, least): &(_, f64, f64)| !(*value >= *least && *value <= 10.0);
        let home = Some(self.home_after_s).filter(|after| !(0.0..=1e6).contains(after));
        let home = home.map(|after| ("home_after_s".to_owned(), after));
        let own = own.into_iter().find(wrong);
        let own = own.map(|(key, value, _)| (key.to_owned(), value));
        part.or(own).or(home)
    }
}

/// How the tracker is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum Phase {
    /// It does not move the arm.
    #[default]
    Idle,
    /// It looks for the ball.
    Acquire,
    /// It follows the ball.
    Track,
    /// Nothing was seen of the ball for a while; it is followed all the same.
    Lost,
    /// The ball has expired, and the hand comes to rest.
    Expired,
    /// The arm was stopped by somebody else: a guard, a stop, a fault.
    Stopped,
}

impl Phase {
    /// All, in the order of their numbers.
    pub const ALL: [Self; 6] = [
        Self::Idle,
        Self::Acquire,
        Self::Track,
        Self::Lost,
        Self::Expired,
        Self::Stopped,
    ];
}

/// What has happened so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Counts {
    /// Measurements that were used.
    pub used: u64,
    /// Those that came too late, or twice.
    pub late: u64,
    /// Those that were too far from the ball.
    pub far: u64,
    /// How often a ball that was followed was lost: no measurement of it has come for so long. Each that expires was lost before.
    pub lost: u64,
    /// How often it has expired: the picture of its last measurement was exposed so long ago.
    pub expired: u64,
    /// How often the hand was held back at the end of what the arm reaches.
    pub held: u64,
}

/// The tracker of one hand.
#[derive(Debug, Clone)]
pub struct Control {
    args: ControlArgs,
    home: Point3<f64>,
    target: Target,
    course: Course,
    wrist: VectorFilter,
    contact: Contact,
    walls: Walls,
    mouse: VectorFilter,
    /// Where the hand should be without a target.
    hold: Point3<f64>,
    phase: Phase,
    counts: Counts,
    /// When a measurement was used last.
    seen: f64,
    offset: Vector3<f64>,
    /// The hand is to stand, whatever is seen, felt or steered.
    stands: bool,
    /// Where the hand would have gone, had the arm reached that.
    beyond: Option<Point3<f64>>,
    /// When the hand came to rest without its ball; unless somebody has moved it since.
    rests_since: Option<f64>,
}

impl Control {
    /// Of a hand that is at rest at `home`.
    #[must_use]
    pub fn new(args: ControlArgs, home: Point3<f64>) -> Self {
        Self {
            target: Target::new(args.target),
            course: Course::at_rest(args.course, home),
            wrist: VectorFilter::new(args.wrist),
            contact: Contact::new(args.contact),
            walls: Walls::default(),
            mouse: VectorFilter::new(args.mouse),
            hold: home,
            home,
            phase: Phase::Acquire,
            counts: Counts::default(),
            seen: f64::NEG_INFINITY,
            offset: Vector3::zeros(),
            stands: false,
            beyond: None,
            rests_since: None,
            args,
        }
    }

    /// With walls, before which the hand slows down.
    #[must_use]
    pub fn with_walls(mut self, walls: Vec<Wall>) -> Self {
        self.walls = Walls::new(walls, self.args.course.acceleration);
        self
    }

    /// Whether the hand is to come to rest, and to stand, whatever is seen, felt or steered.
    pub fn stand(&mut self, stands: bool) {
        self.stands = stands;
    }

    /// The hand rests elsewhere now: it was stopped. What was counted stays.
    pub fn rest_at(&mut self, place: Point3<f64>) {
        let kept = (self.counts, self.home, self.stands);
        let walls = std::mem::take(&mut self.walls);
        *self = Self::new(self.args, place);
        (self.counts, self.home, self.stands) = kept;
        self.walls = walls;
    }

    /// Takes in that the hand should have been at `place` at the moment `at`; it is known `now`.
    pub fn measure(&mut self, now: f64, at: f64, place: &Point3<f64>) -> Taken {
        let ahead = (now - at).max(0.0) + self.args.lead_s;
        let further = ahead + self.args.catch_up_s;
        let taken = self.target.measure(at, place, [ahead, further]);
        match taken {
            Taken::Begun | Taken::Used => {
                self.counts.used += 1;
                self.seen = now;
                self.rests_since = None;
                self.phase = Phase::Track;
            }
            Taken::Late => self.counts.late += 1,
            Taken::Far | Taken::Wrong => self.counts.far += 1,
        }
        taken
    }

    /// Goes on by a period, s, until `now`. `force` is what the hand is pushed with, N in the base frame, `mouse` how the mouse is
    /// deflected. Answers how large the change of the velocity was, as a part of what the limit allows.
    pub fn go(&mut self, now: f64, force: &Vector3<f64>, mouse: &Vector3<f64>, period: f64) -> f64 {
        let none = JointLimits::NONE;
        self.go_within(now, [force, mouse], period, &none, |_| Some(none))
    }

    /// The same with an arm that does not reach every place of the hand. `joints` is what its joints allow here, and `limits_at` tells
    /// that of a place that it reaches.
    pub fn go_within(
        &mut self,
        now: f64,
        [force, mouse]: [&Vector3<f64>; 2],
        period: f64,
        joints: &JointLimits,
        mut limits_at: impl FnMut(&Point3<f64>) -> Option<JointLimits>,
    ) -> f64 {
        let offset = self.wrist.take(force, period) + self.mouse.take(mouse, period);
        self.offset += (offset - self.offset).cap_magnitude(self.args.steer_m_s * period);
        let ahead = now + self.args.lead_s;
        let expected = match self.args.prediction {
            true => self.target.at(ahead),
            false => self.target.last(ahead),
        };
        if let Some(target) = &expected {
            self.watch(now, target);
        }
        let (goal, moving) = match expected {
            _ if self.stands => {
                // Wherever it is when it has braked.
                self.hold = self.course.place;
                (self.hold, Vector3::zeros())
            }
            Some(target) => {
                self.hold = target.place + self.offset;
                // Of a motion that seldom goes on as predicted the hand takes little along.
                (self.hold, target.velocity * target.worth)
            }
            None => {
                let moving = self.offset * FREELY + self.homeward(now, period);
                self.hold += moving * period;
                (self.hold, moving)
            }
        };
        let (goal, moving) = self.within_reach(goal, moving);
        let (goal, moving) = self.short_of_the_end(goal, moving, joints, &mut limits_at);
        if expected.is_none() {
            self.hold = goal;
        }
        let before = self.course.velocity;
        let predicted = self.args.prediction && expected.is_some() && !self.stands;
        let way = (goal - self.course.place).try_normalize(0.0);
        let way = way.unwrap_or_else(Vector3::zeros);
        // As the joints can brake here and there, whichever is less.
        let there = limits_at(&goal).unwrap_or(*joints);
        let brakes = self.braking(joints, &way).min(self.braking(&there, &way));
        // Before the end of what the arm reaches the hand brakes as hard as before a wall.
        let held = self.beyond.is_some();
        let joints = if held { &JointLimits::NONE } else { joints };
        let course = &mut self.course;
        let wanted = course.wanted(&goal, &moving, predicted, brakes, period);
        let both = [course.velocity, wanted];
        let both = both.map(|fast| self.contact.allow(force, &course.place, fast));
        course.follow_within(&self.walls, joints, both, period);
        self.course.ratio(&before, period)
    }

    /// How fast a hand goes back to where it began that has waited for its ball, m/s. Who pushes or steers it knows better.
    fn homeward(&mut self, now: f64, period: f64) -> Vector3<f64> {
        if self.offset != Vector3::zeros() {
            self.rests_since = None;
        }
        let waits = |since: f64| now - since < self.args.home_after_s;
        match self.rests_since {
            Some(since) if !waits(since) => {
                ((self.home - self.hold) / period).cap_magnitude(self.args.steer_m_s)
            }
            _ => Vector3::zeros(),
        }
    }

    /// How the ball is that is followed.
    fn watch(&mut self, now: f64, target: &Predicted) {
        let phase = match target.expired {
            true => Phase::Expired,
            false if now - self.seen > self.args.overdue_s => Phase::Lost,
            false => Phase::Track,
        };
        // One that expires between two periods was lost before.
        if phase != Phase::Track && self.phase == Phase::Track {
            self.counts.lost += 1;
        }
        if phase == Phase::Expired && self.phase != Phase::Expired {
            self.counts.expired += 1;
        }
        self.phase = phase;
        if target.expired && target.velocity.norm() < AT_REST {
            self.target.forget();
            self.rests_since = Some(now);
            self.phase = Phase::Acquire;
        }
    }

    /// What the hand brakes with that goes along a direction, m/s^2.
    fn braking(&self, joints: &JointLimits, along: &Vector3<f64>) -> f64 {
        let most = self.args.course.acceleration;
        joints.braking(along).clamp(BRAKES * most, most)
    }

    /// The goal, within reach; one that goes outwards there goes along the border.
    fn within_reach(&self, goal: Point3<f64>, moving: Vector3<f64>) -> (Point3<f64>, Vector3<f64>) {
        let way = goal - self.home;
        let length = way.norm();
        if length <= self.args.reach_m {
            return (goal, moving);
        }
        let outward = way / length;
        let along = moving - outward * moving.dot(&outward).max(0.0);
        (self.home + outward * self.args.reach_m, along)
    }

    /// The goal, or the last place on the way there from which the arm still reaches a little further.
    fn short_of_the_end(
        &mut self,
        goal: Point3<f64>,
        moving: Vector3<f64>,
        joints: &JointLimits,
        mut limits_at: impl FnMut(&Point3<f64>) -> Option<JointLimits>,
    ) -> (Point3<f64>, Vector3<f64>) {
        // Where a hand comes to rest that moves on with the goal and then brakes.
        let along = moving.try_normalize(0.0).unwrap_or_else(Vector3::zeros);
        let brakes = moving * (0.5 * moving.norm() / self.braking(joints, &along));
        let from = self.course.place;
        let way = goal + brakes - from;
        let ahead = way.try_normalize(0.0).unwrap_or_else(Vector3::zeros);
        // A hand that is held stays so until it is a little farther from the end: noise does not let it go.
        let short = SHORT * if self.beyond.is_some() { HELD } else { 1.0 };
        let mut ends = |way: &Vector3<f64>, on: &Vector3<f64>| {
            let end = from + way + on * short;
            limits_at(&end).is_none().then_some(end)
        };
        // Behind a singularity there may be reach again, in a posture without a way back. So all of the way counts, and all of that on
        // which the hand comes to rest if it brakes now, as hard as it does when it is held.
        let velocity = self.course.velocity;
        let stop = velocity * (0.5 * velocity.norm() / self.args.course.acceleration);
        let on = velocity.try_normalize(AT_REST).unwrap_or(ahead);
        let of_stop = parts(&stop).find_map(|part| ends(&(stop * part), &on));
        let first = parts(&way).find_map(|part| Some((part, ends(&(way * part), &ahead)?)));
        let Some(end) = of_stop.or(first.map(|(_, end)| end)) else {
            self.beyond = None;
            return (goal, moving);
        };
        if self.beyond.replace(end).is_none() {
            self.counts.held += 1;
        }
        let (Some((part, _)), None) = (first, of_stop) else {
            return (from, Vector3::zeros());
        };
        // The end is in the last of these steps.
        let (mut good, mut bad) = ((part - 1.0 / steps(&way)).max(0.0), part);
        for _ in 0..HALVINGS {
            let middle = 0.5 * (good + bad);
            match ends(&(way * middle), &ahead) {
                Some(_) => bad = middle,
                None => good = middle,
            }
        }
        (from + way * good, Vector3::zeros())
    }

    /// A place that the hand would go to, and that the arm does not reach, if it is held back.
    #[must_use]
    pub fn beyond(&self) -> Option<Point3<f64>> {
        self.beyond
    }

    /// Where the hand is sent, and how fast it goes.
    #[must_use]
    pub fn course(&self) -> &Course {
        &self.course
    }

    /// Where the ball is believed to be at a moment, s.
    #[must_use]
    pub fn target(&self, now: f64) -> Option<Predicted> {
        match self.args.prediction {
            true => self.target.at(now),
            false => self.target.last(now),
        }
    }

    /// How it is.
    #[must_use]
    pub fn phase(&self) -> Phase {
        self.phase
    }

    /// What has happened.
    #[must_use]
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// By how much force and mouse move the hand from the ball, m.
    #[must_use]
    pub fn offset(&self) -> Vector3<f64> {
        self.offset
    }
}

/// In how many steps it is looked for an end on a way.
fn steps(way: &Vector3<f64>) -> f64 {
    (way.norm() / SHORT).ceil().clamp(1.0, MOST_STEPS)
}

/// The ends of these steps, as parts of the way.
fn parts(way: &Vector3<f64>) -> impl Iterator<Item = f64> + use<> {
    let steps = steps(way);
    (1..=steps as u32).map(move |step| f64::from(step) / steps)
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: f64 = 0.0045;
    const NONE: Vector3<f64> = Vector3::new(0.0, 0.0, 0.0);

    /// A rig for a ball that is measured every 40 ms, 40 ms late, where it can be seen.
    struct Rig {
        control: Control,
        tick: u32,
        worst: f64,
    }

    impl Rig {
        fn new(args: ControlArgs) -> Self {
            Self {
                control: Control::new(args, Point3::origin()),
                tick: 0,
                worst: 0.0,
            }
        }

        fn now(&self) -> f64 {
            f64::from(self.tick) * PERIOD
        }

        fn run(
            &mut self,
            seconds: f64,
            ball: impl Fn(f64) -> Option<Point3<f64>>,
            force: Vector3<f64>,
        ) {
            for _ in 0..(seconds / PERIOD) as u32 {
                self.tick += 1;
                let now = self.now();
                let seen = now - 0.04;
                if self.tick.is_multiple_of(9)
                    && let Some(place) = ball(seen)
                {
                    self.control.measure(now, seen, &place);
                }
                let ratio = self.control.go(now, &force, &NONE, PERIOD);
                self.worst = self.worst.max(ratio);
            }
        }
    }

    fn sweep(t: f64) -> Point3<f64> {
        Point3::new(0.2 * (2.5 * t).sin(), 0.0, 0.0)
    }

    #[test]
    fn a_ball_is_followed_through_loss_expiry_and_its_return_without_a_step() {
        let mut rig = Rig::new(ControlArgs::default());
        rig.run(5.0, |t| Some(sweep(t)), NONE);
        assert_eq!(rig.control.phase(), Phase::Track);
        let off = rig.control.course().place - sweep(rig.now() + 0.0135);
        assert!(off.norm() < 0.01, "{off}");
        rig.run(0.3, |_| None, NONE);
        assert_eq!(rig.control.phase(), Phase::Lost);
        rig.run(0.4, |_| None, NONE);
        assert_eq!(rig.control.phase(), Phase::Expired);
        rig.run(2.0, |_| None, NONE);
        assert_eq!(rig.control.phase(), Phase::Acquire);
        assert!(rig.control.course().velocity.norm() < 1e-3);
        rig.run(3.0, |t| Some(sweep(t)), NONE);
        assert_eq!(rig.control.phase(), Phase::Track);
        assert!((rig.control.course().place - sweep(rig.now() + 0.0135)).norm() < 0.01);
        let counts = rig.control.counts();
        assert_eq!((counts.lost, counts.expired), (1, 1));
        assert!(rig.worst <= 1.0 + 1e-9, "{}", rig.worst);
    }

    #[test]
    fn a_ball_that_expires_within_one_period_was_lost_before() {
        let mut rig = Rig::new(ControlArgs::default());
        rig.run(3.0, |t| Some(sweep(t)), NONE);
        rig.tick += 200;
        rig.run(0.1, |_| None, NONE);
        assert_eq!(rig.control.phase(), Phase::Expired);
        let counts = rig.control.counts();
        assert_eq!((counts.lost, counts.expired), (1, 1));
    }

    #[test]
    fn a_push_moves_the_hand_from_the_ball_and_a_spring_brings_it_back() {
        let mut rig = Rig::new(ControlArgs::default());
        let still = |_| Some(Point3::new(0.1, 0.0, 0.0));
        rig.run(3.0, still, NONE);
        rig.run(3.0, still, Vector3::new(0.0, 8.0, 0.0));
        let pushed = rig.control.course().place;
        assert!(
            (pushed - Point3::new(0.1, 0.02, 0.0)).norm() < 1e-3,
            "{pushed}"
        );
        rig.run(3.0, still, NONE);
        assert!((rig.control.course().place - Point3::new(0.1, 0.0, 0.0)).norm() < 1e-3);
    }

    #[test]
    fn force_and_mouse_move_the_hand_no_faster_than_is_said() {
        let mut rig = Rig::new(ControlArgs::default());
        let still = |_| Some(Point3::new(0.1, 0.0, 0.0));
        rig.run(3.0, still, NONE);
        for _ in 0..150 {
            rig.run(0.0046, still, Vector3::new(0.0, 40.0, 0.0));
            let fast = rig.control.course().velocity.norm();
            assert!(fast < 0.25, "{fast} m/s");
        }
        assert!(rig.control.course().place.y > 0.08);
    }

    #[test]
    fn without_a_ball_a_push_guides_the_hand_and_it_stays_there() {
        let mut rig = Rig::new(ControlArgs::default());
        rig.run(2.0, |_| None, Vector3::new(0.0, 8.0, 0.0));
        rig.run(2.0, |_| None, NONE);
        let there = rig.control.course().place;
        assert!(there.y > 0.05, "{there}");
        rig.run(2.0, |_| None, NONE);
        assert!((rig.control.course().place - there).norm() < 1e-4);
    }

    #[test]
    fn a_ball_out_of_reach_is_followed_as_far_as_that_goes() {
        let args = ControlArgs {
            reach_m: 0.3,
            ..ControlArgs::default()
        };
        let mut rig = Rig::new(args);
        rig.run(8.0, |t| Some(Point3::new(0.1 * t, 0.02 * t, 0.0)), NONE);
        let place = rig.control.course().place;
        assert!((place.coords.norm() - 0.3).abs() < 0.005, "{place}");
        assert!(rig.worst <= 1.0 + 1e-9);
    }

    #[test]
    fn a_ball_beyond_what_the_arm_reaches_holds_the_hand_before_that_without_a_step_and_leads_it_back()
     {
        let mut control = Control::new(ControlArgs::default(), Point3::origin());
        let ball = |t: f64| Point3::new(0.25 * (1.5 * t).sin(), 0.0, 0.0);
        let (mut worst, mut furthest, mut last): (f64, f64, f64) = (0.0, 0.0, 0.0);
        for tick in 1..3000_u32 {
            let now = f64::from(tick) * PERIOD;
            let seen = now - 0.04;
            if tick.is_multiple_of(9) {
                control.measure(now, seen, &ball(seen));
            }
            let end = |place: &Point3<f64>| (place.x < 0.15).then_some(JointLimits::NONE);
            worst =
                worst.max(control.go_within(now, [&NONE, &NONE], PERIOD, &JointLimits::NONE, end));
            furthest = furthest.max(control.course().place.x);
            assert_eq!(
                control.beyond().is_some(),
                control.beyond().is_some_and(|place| place.x >= 0.15)
            );
            if ball(now).x < 0.1 {
                last = (control.course().place - ball(now + 0.0135)).norm();
            }
        }
        assert!((0.12..0.15).contains(&furthest), "{furthest}");
        assert!(worst <= 1.0 + 1e-9 && last < 0.01, "{worst} {last}");
        assert!(control.counts().held >= 3, "{:?}", control.counts());
    }

    #[test]
    fn whatever_the_ball_does_the_hand_does_not_pass_a_singularity_behind_which_the_arm_reaches_again()
     {
        // A wall of places without reach, 50 mm thick, and a ball that goes through it and back, or aside and then across.
        let ways: [fn(f64) -> [f64; 2]; 3] = [
            |t| [0.45 * (1.2 * t).sin(), 0.0],
            |t| {
                [
                    0.12 + 0.4 * (0.5 * t).sin().max(0.0),
                    0.25 * (3.0 * t).sin(),
                ]
            },
            |t| {
                [
                    if t % 4.0 < 2.0 { 0.05 } else { 0.5 },
                    0.2 * (t % 4.0) - 0.4,
                ]
            },
        ];
        for (nth, way) in ways.into_iter().enumerate() {
            let mut control = Control::new(ControlArgs::default(), Point3::origin());
            let ball = |t: f64| {
                let [x, y] = way(t);
                Point3::new(x, y, 0.0)
            };
            let (mut worst, mut furthest): (f64, f64) = (0.0, 0.0);
            for tick in 1..4000_u32 {
                let now = f64::from(tick) * PERIOD;
                let seen = now - 0.04;
                if tick.is_multiple_of(9) {
                    control.measure(now, seen, &ball(seen));
                }
                let reached = |place: &Point3<f64>| !(0.15..0.2).contains(&place.x);
                let limits = |place: &Point3<f64>| reached(place).then_some(JointLimits::NONE);
                let none = JointLimits::NONE;
                worst = worst.max(control.go_within(now, [&NONE, &NONE], PERIOD, &none, limits));
                furthest = furthest.max(control.course().place.x);
            }
            assert!((0.11..0.15).contains(&furthest), "{nth}: {furthest}");
            assert!(worst <= 1.0 + 1e-9, "{nth}: {worst}");
            // It is held for each time that the ball goes there, and not again and again.
            let held = control.counts().held;
            assert!((2..=12).contains(&held), "{nth}: {held}");
        }
    }

    #[test]
    fn a_hand_whose_ball_is_gone_looks_from_where_it_began_unless_somebody_moves_it() {
        let ball = |t: f64| (t < 2.0).then(|| Point3::new(0.2, 0.05 * t, 0.0));
        for pushed in [false, true] {
            let mut rig = Rig::new(ControlArgs::default());
            rig.run(4.0, ball, NONE);
            let there = rig.control.course().place;
            assert!(
                there.x > 0.15 && rig.control.phase() == Phase::Acquire,
                "{there}"
            );
            let push = if pushed {
                Vector3::new(0.0, 0.0, 5.0)
            } else {
                NONE
            };
            rig.run(0.5, |_| None, push);
            let there = rig.control.course().place;
            rig.run(8.0, |_| None, NONE);
            let now = rig.control.course().place;
            match pushed {
                true => assert!(
                    (now - there).norm() < 0.05,
                    "{now}, and it was led to {there}"
                ),
                false => assert!(now.coords.norm() < 1e-6, "{now}"),
            }
            assert!(rig.worst <= 1.0 + 1e-9);
            // From there it is found again.
            rig.run(2.0, |_| Some(Point3::new(0.05, 0.0, 0.0)), NONE);
            assert_eq!(rig.control.phase(), Phase::Track);
        }
    }

    #[test]
    fn an_hour_of_a_still_ball_has_no_drift() {
        let mut rig = Rig::new(ControlArgs::default());
        rig.run(3600.0, |_| Some(Point3::new(0.1, 0.05, 0.0)), NONE);
        assert!((rig.control.course().place - Point3::new(0.1, 0.05, 0.0)).norm() < 1e-6);
        assert_eq!(rig.control.counts().lost, 0);
    }

    #[test]
    fn a_hand_that_is_to_stand_comes_to_rest_without_a_step_whatever_is_seen() {
        let mut rig = Rig::new(ControlArgs::default());
        rig.run(3.0, |t| Some(sweep(t)), NONE);
        rig.control.stand(true);
        rig.run(1.0, |t| Some(sweep(t)), NONE);
        let there = rig.control.course().place;
        assert!(rig.control.course().velocity.norm() < 1e-6);
        rig.run(1.0, |t| Some(sweep(t)), Vector3::new(0.0, 8.0, 0.0));
        assert!((rig.control.course().place - there).norm() < 1e-6);
        rig.control.stand(false);
        rig.run(3.0, |t| Some(sweep(t)), NONE);
        assert!((rig.control.course().place - sweep(rig.now() + 0.0135)).norm() < 0.02);
        assert!(rig.worst <= 1.0 + 1e-9, "{}", rig.worst);
    }

    #[test]
    fn numbers_that_cannot_be_are_named() {
        let mut args = ControlArgs::default();
        assert_eq!(args.wrong(), None);
        args.course.speed = f64::NAN;
        assert_eq!(args.wrong().unwrap().0, "course.speed");
        let args = ControlArgs {
            reach_m: 0.0,
            ..ControlArgs::default()
        };
        assert_eq!(args.wrong(), Some(("reach_m".to_owned(), 0.0)));
    }
}

//! Two arms on their carts, side by side, moved by their servos on ideal drives: whatever they are asked to do, they come
//! to rest before they touch; and what passes near is let pass. `tests/run --long faults` makes 1,000 motions: `CTOS_MOTIONS=1000`.

#![allow(clippy::unwrap_used, reason = "a test that cannot be set up fails")]

use std::ops::Range;
use std::sync::Arc;
use std::time::Duration;

use ctos::config::Node;
use ctos::diagnostic::{Findings, Source};
use ctos::registry::Registry;
use ctos::task::HandlerError;
use mcs::Joints;
use mcs::control::ControlLaw;
use mcs::driver::{ChannelDriver, DriverError, Power, SlotReading};
use mcs::guard::{Around, GuardRegistry, GuardSettings, Mounted, Neighbour, Reaction};
use mcs::model::{JointKind, Model, Placement, Solid, built_in, file::Inertias};
use mcs::servo::{MotionPhase, Servo, ServoCommand, ServoConfig, ServoPort};
use mcs::trajectory::{CartesianLimits, Path, Planner, Segment, Setpoint};
use nalgebra::{Translation3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rapier3d_f64::parry::math::{Pose, Rotation};
use rapier3d_f64::parry::{query, shape};

/// Where the bases are: side by side, m.
const APART: f64 = 1.2;
/// The distance that the guards keep, m.
const MARGIN: f64 = 0.02;
const PERIOD: Duration = Duration::from_micros(4500);

fn motions() -> u64 {
    let asked = std::env::var("CTOS_MOTIONS").ok();
    asked.and_then(|count| count.parse().ok()).unwrap_or(20)
}

fn model() -> Arc<Model> {
    let model = built_in::model("testbed9", Inertias::Engine)
        .unwrap()
        .unwrap();
    Arc::new(model)
}

/// Drives that are always where they are told to be: what the law writes is a position.
struct Ideal {
    q: Joints,
    qd: Joints,
}

impl ChannelDriver for Ideal {
    fn slots(&self) -> usize {
        self.q.len()
    }

    fn read(&mut self, readings: &mut [SlotReading]) -> Result<(), DriverError> {
        for (index, reading) in readings.iter_mut().enumerate() {
            reading.position = self.q[index];
            reading.velocity = self.qd[index];
        }
        Ok(())
    }

    fn write(&mut self, told: &[f64], power: Power, period: Duration) -> Result<(), DriverError> {
        let before = self.q;
        if power == Power::Released {
            self.q = Joints::try_from(told).unwrap();
        }
        for (index, speed) in self.qd.iter_mut().enumerate() {
            *speed = (self.q[index] - before[index]) / period.as_secs_f64();
        }
        Ok(())
    }
}

struct Follow;

impl ControlLaw for Follow {
    fn reset(&mut self, _: &[SlotReading]) {}

    fn torques(&mut self, setpoint: &Setpoint, _: &[SlotReading], _: Duration, out: &mut [f64]) {
        out.copy_from_slice(&setpoint.position);
    }
}

struct Boards([Neighbour; 2]);

impl Around for Boards {
    fn neighbour(&self, servo: &str) -> Result<Neighbour, HandlerError> {
        Ok(self.0[usize::from(servo == "right")].clone())
    }
}

struct Arm {
    servo: Servo,
    port: ServoPort,
    planner: Planner,
}

/// Two arms at these positions, each with its guard.
fn arms(starts: &[Joints; 2]) -> [Arm; 2] {
    let boards = Boards([(); 2].map(|()| Neighbour::new(model())));
    let mut guards = GuardRegistry::new();
    mcs_collision::register(&mut Registry::new(), &mut guards);
    let sides = [("left", "right", APART), ("right", "left", -APART)];
    let mut arms = [0, 1].map(|side| {
        let model = model();
        let driver = Ideal {
            q: starts[side],
            qd: Joints::zeros(9),
        };
        let config = ServoConfig::default();
        let built = Servo::new(
            Arc::clone(&model),
            Box::new(driver),
            Box::new(Follow),
            config,
        );
        let (mut servo, port) = built.unwrap();
        servo.show_on(boards.0[side].clone());
        let planner = Planner::new(model, CartesianLimits::default(), 0.018).unwrap();
        Arm {
            servo,
            port,
            planner,
        }
    });
    for (arm, (own, other, apart)) in arms.iter_mut().zip(sides) {
        let text = format!(
            "margin = {MARGIN}\nothers = [{{ servo = \"{other}\", at = {{ xyz = [0, {apart}, 0] }} }}]\n\
             room = [{{ name = \"floor\", shapes = [{{ box = [20, 20, 1], at = {{ xyz = [0, 0, -0.5] }} }}] }}]"
        );
        let mut findings = Findings::new();
        let args = Node::from_toml(&Source::new("guard", text), &mut findings);
        let settings = GuardSettings {
            model: &model(),
            period: PERIOD,
            servo: own,
            around: &boards,
            cx: None,
            args: &args,
        };
        let guard = guards.build("collision", &settings).unwrap().unwrap();
        let guard = Mounted::new("collision", Reaction::Stop, true, guard);
        arm.port.mount(0, Some(guard)).unwrap();
        for command in [ServoCommand::PowerOn, ServoCommand::ReleaseBrakes] {
            arm.port.order(command).unwrap();
            arm.servo.tick(0);
        }
    }
    arms
}

/// The solids of both arms and of the floor, by another program: what is a pair, and how far from one another it is.
struct Judge {
    model: Arc<Model>,
    data: mcs::model::Data,
    pairs: Vec<(usize, usize)>,
    /// The pair that was nearest the last time: it probably is again, and then few others are looked at.
    nearest: usize,
}

impl Judge {
    fn new() -> Self {
        let model = model();
        let count = model.shapes().len();
        let carrier = |index: usize| model.shapes()[index % count].carrier;
        let parent = |index: usize| carrier(index).and_then(|joint| model.joints()[joint].parent);
        let mut pairs = Vec::new();
        for one in 0..2 * count {
            for other in one + 1..2 * count {
                let same_arm = one / count == other / count;
                let near = carrier(one) == carrier(other)
                    || parent(one) == carrier(other)
                    || parent(other) == carrier(one);
                if !(same_arm && near) {
                    pairs.push((one, other));
                }
            }
            pairs.push((one, 2 * count));
        }
        Self {
            data: model.data(),
            model,
            pairs,
            nearest: 0,
        }
    }

    fn solids(&mut self, positions: [&Joints; 2]) -> Vec<Solid> {
        let mut all = Vec::new();
        for (q, y) in positions.into_iter().zip([0.0, APART]) {
            self.model.forward(&mut self.data, q);
            let base = Placement::shifted(0.0, y, 0.0);
            for shape in self.model.shapes() {
                let at = base.then(&self.data.carrier(shape.carrier));
                all.push(shape.solid.seen_from(&at));
            }
        }
        all.push(Solid::Block {
            at: Placement::shifted(0.0, 0.0, -0.5),
            half: [10.0, 10.0, 0.5].into(),
        });
        all
    }

    /// The distance of each pair, m; no more than it where it is above a tenth.
    fn distances(&mut self, positions: [&Joints; 2]) -> Vec<f64> {
        let solids = self.solids(positions);
        let pairs = self.pairs.iter();
        pairs
            .map(|(one, other)| elsewhere(&solids[*one], &solids[*other]))
            .collect()
    }

    /// The least distance of the pairs that are apart in both of these positions, and else of any use: the carriage
    /// and the floor are always near one another, and so are the links at the wrist.
    fn least(&mut self, positions: [&Joints; 2], counts: &[bool]) -> f64 {
        let solids = self.solids(positions);
        let balls: Vec<_> = solids.iter().map(Solid::ball).collect();
        let (mut least, mut nearest) = (f64::INFINITY, self.nearest);
        for index in [self.nearest].into_iter().chain(0..self.pairs.len()) {
            let (one, other) = self.pairs[index];
            // What is around a pair is nearer than the pair is.
            if counts[index] && apart(&balls[one], &balls[other]) < least {
                let distance = elsewhere(&solids[one], &solids[other]);
                if distance < least {
                    (least, nearest) = (distance, index);
                }
            }
        }
        self.nearest = nearest;
        least
    }

    /// How far any solid of an arm moves at most when its joints go from one position to another, m: no farther from any
    /// axis is anything than all links put end to end reach.
    fn moves(&self, from: &Joints, to: &Joints) -> f64 {
        let links = self.model.joints().iter();
        let links: f64 = links.map(|joint| joint.placement.origin.norm()).sum();
        let solids = self.model.shapes().iter().map(|shape| shape.solid.reach());
        let reach = links + solids.fold(0.0, f64::max);
        let joints = self.model.joints().iter().zip(from.iter().zip(to));
        let each = joints.map(|(joint, (from, to))| match joint.kind {
            JointKind::Revolute => reach * (to - from).abs(),
            JointKind::Prismatic => (to - from).abs(),
        });
        each.sum()
    }

    /// The pairs that are not always nearer than so many m.
    fn counts(&mut self, near: f64) -> Vec<bool> {
        let mut rng = ChaCha8Rng::seed_from_u64(99);
        let mut counts = vec![false; self.pairs.len()];
        for _ in 0..300 {
            let (one, other) = (position(&mut rng), position(&mut rng));
            let all = self.distances([&one, &other]);
            for (counts, distance) in counts.iter_mut().zip(all) {
                *counts |= distance > near;
            }
        }
        counts
    }
}

/// How far two balls are from one another, m.
fn apart(one: &(Vector3<f64>, f64), other: &(Vector3<f64>, f64)) -> f64 {
    (one.0 - other.0).norm() - one.1 - other.1
}

fn elsewhere(one: &Solid, other: &Solid) -> f64 {
    let at_least = apart(&one.ball(), &other.ball());
    if at_least > 0.1 {
        return at_least;
    }
    let made = |solid: &Solid| -> (Pose, Box<dyn shape::Shape>) {
        match solid {
            Solid::Capsule { a, b, radius } => {
                let end = |v: &Vector3<f64>| [v.x, v.y, v.z].into();
                let capsule = shape::Capsule::new(end(a), end(b), *radius);
                (Pose::identity(), Box::new(capsule))
            }
            Solid::Block { at, half } => {
                let (t, r) = (at.origin, at.isometry().rotation);
                let turn = Rotation::from_xyzw(r.i, r.j, r.k, r.w);
                let pose = Pose::from_parts([t.x, t.y, t.z].into(), turn);
                (
                    pose,
                    Box::new(shape::Cuboid::new([half.x, half.y, half.z].into())),
                )
            }
            Solid::Hull { .. } => (Pose::identity(), Box::new(shape::Ball::new(f64::MAX))),
        }
    };
    let ((pose1, shape1), (pose2, shape2)) = (made(one), made(other));
    query::distance(&pose1, &*shape1, &pose2, &*shape2)
        .unwrap()
        .distance
}

/// Joint positions anywhere within their limits, the cart near the middle of its track.
fn position(rng: &mut ChaCha8Rng) -> Joints {
    let model = model();
    Joints::from_fn(9, |index| {
        let limits = &model.joints()[index].limits;
        let share = rng.random_range(0.02..0.98);
        let whole = limits.lower + (limits.upper - limits.lower) * share;
        match index {
            0 => whole * 0.3,
            2 => whole * 0.5,
            _ => whole,
        }
    })
}

/// Two starting positions in which nothing is near anything else.
fn starts(rng: &mut ChaCha8Rng, judge: &mut Judge, counts: &[bool]) -> [Joints; 2] {
    loop {
        let starts = [position(rng), position(rng)];
        if judge.least([&starts[0], &starts[1]], counts) > MARGIN + 0.01 {
            return starts;
        }
    }
}

/// To anywhere within the limits, or straight or on an arc to anywhere near, where the arm can do that.
fn segment(rng: &mut ChaCha8Rng, planner: &mut Planner, start: &Joints) -> Segment {
    let speed = rng.random_range(0.3..1.0);
    let goal = position(rng);
    let near = [(); 3].map(|()| rng.random_range(-0.6..0.6));
    let via = [(); 3].map(|()| rng.random_range(-0.2..0.2));
    let shape = rng.random_range(0..4);
    let tool = planner.tool_pose(start);
    let pose = Translation3::from(near) * tool;
    let line = match shape {
        0 => planner.line(start, &pose, speed),
        1 => {
            let half = 0.5 * (tool.translation.vector + pose.translation.vector);
            planner.arc_through(start, (half + Vector3::from(via), &pose), speed)
        }
        _ => planner.joint(start, &goal, speed),
    };
    // Many lines lead out of reach.
    line.or_else(|_| planner.joint(start, &goal, speed))
        .unwrap()
}

#[test]
fn two_arms_that_move_at_random_come_to_rest_before_anything_touches() {
    let (mut judge, mut stopped, mut arrived) = (Judge::new(), 0, 0);
    let mut lines = 0;
    let counts = judge.counts(MARGIN);
    for seed in 0..motions() {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let starts = starts(&mut rng, &mut judge, &counts);
        let mut arms = arms(&starts);
        let mut begins = [0, rng.random_range(0..80)];
        if rng.random() {
            begins.reverse();
        }
        let segments = [0, 1].map(|side| segment(&mut rng, &mut arms[side].planner, &starts[side]));
        lines += segments
            .iter()
            .filter(|segment| is_of_tool(segment))
            .count();
        // What both can move in all before they are nearer than they may be.
        let (mut room, mut before) = (0.0, starts);
        for tick in 0..20_000 {
            for (side, arm) in arms.iter_mut().enumerate() {
                if tick == begins[side] {
                    let segment = segments[side];
                    arm.port
                        .order(ServoCommand::Move { id: 1, segment })
                        .unwrap();
                }
                arm.servo.tick(0);
            }
            let at = [0, 1].map(|side| arms[side].port.status().setpoint);
            room -= judge.moves(&before[0], &at[0]) + judge.moves(&before[1], &at[1]);
            before = at;
            if room <= 0.0 {
                let least = judge.least([&at[0], &at[1]], &counts);
                // What the margin is for are tracking errors, which ideal drives have not.
                room = least - 0.5 * MARGIN;
                assert!(
                    room > 0.0,
                    "seed {seed}, tick {tick}: {least} m apart at {at:?}"
                );
            }
            let over = |arm: &Arm| {
                let motion = arm.port.status().motion;
                motion.id == 1 && motion.phase.is_over()
            };
            if arms.iter().all(over) {
                break;
            }
        }
        for arm in &arms {
            let status = arm.port.status();
            match status.motion.phase {
                MotionPhase::Done => arrived += 1,
                MotionPhase::Stopped => {
                    assert!(status.ended_by_guard(1).is_some(), "seed {seed}");
                    stopped += 1;
                }
                phase => panic!("seed {seed}: {phase:?}, {:?}", status.fault),
            }
        }
    }
    let share = f64::from(stopped) / f64::from(stopped + arrived);
    // Both happen. Of a thousand motions of both arms a guard ends some 6 %.
    assert!((0.02..0.95).contains(&share), "{stopped} of {arrived}");
    // Of the motions a quarter is to be straight and a quarter an arc. What the arm can do of them is a share of all.
    let share = lines as f64 / f64::from(stopped + arrived);
    assert!(share > 0.15, "{lines} lines and arcs");
}

/// Whether the tool goes straight or on an arc.
fn is_of_tool(segment: &Segment) -> bool {
    matches!(segment.path(), Path::Tool(_))
}

/// Motions of both arms, or of the left one alone, that pass near something, and no wide way off, all by themselves.
struct Pass {
    starts: [Joints; 2],
    segments: [Option<Segment>; 2],
    least: f64,
}

/// The next seed whose motions come as near as this and no nearer, m.
fn pass(seed: &mut u64, both: bool, near: Range<f64>, judge: &mut Judge, counts: &[bool]) -> Pass {
    loop {
        *seed += 1;
        let mut rng = ChaCha8Rng::seed_from_u64(*seed);
        let starts = starts(&mut rng, judge, counts);
        let mut planner = Planner::new(model(), CartesianLimits::default(), 0.018).unwrap();
        let segments = [(0, true), (1, both)]
            .map(|(side, moves)| moves.then(|| segment(&mut rng, &mut planner, &starts[side])));
        let (mut least, mut solver) = (f64::INFINITY, planner.solver().clone());
        let longest = segments
            .iter()
            .flatten()
            .map(Segment::duration)
            .fold(0.0, f64::max);
        for step in 0..=400 {
            let time = longest * f64::from(step) / 400.0;
            let at = [0, 1].map(|side| match &segments[side] {
                Some(segment) => {
                    let (time, near) = (time.min(segment.duration()), &starts[side]);
                    segment.at(&mut solver, time, near).unwrap().position
                }
                None => starts[side],
            });
            least = least.min(judge.least([&at[0], &at[1]], counts));
            if least < near.start {
                break;
            }
        }
        if near.contains(&least) {
            return Pass {
                starts,
                segments,
                least,
            };
        }
    }
}

#[test]
fn an_arm_that_passes_what_stands_still_and_itself_at_35_mm_or_more_is_never_stopped() {
    let mut judge = Judge::new();
    // Of what is always about as far away, none passes.
    let counts = judge.counts(0.1);
    let mut seed = 10_000;
    for _ in 0..motions() / 3 {
        let pass = pass(&mut seed, false, 0.035..0.08, &mut judge, &counts);
        let ended = made(pass.segments, arms(&pass.starts));
        let Pass { least, .. } = pass;
        assert_eq!(ended, None, "seed {seed}, {least} m");
    }
}

#[test]
fn two_arms_that_pass_one_another_and_all_else_at_80_mm_or_more_are_never_stopped() {
    let mut judge = Judge::new();
    // Of what is always about as far away, none passes.
    let counts = judge.counts(0.1);
    let (mut seed, mut lines) = (30_000, 0);
    for _ in 0..motions() / 3 {
        let pass = pass(&mut seed, true, 0.08..0.12, &mut judge, &counts);
        lines += pass
            .segments
            .iter()
            .flatten()
            .filter(|segment| is_of_tool(segment))
            .count();
        let ended = made(pass.segments, arms(&pass.starts));
        let Pass { least, .. } = pass;
        assert_eq!(ended, None, "seed {seed}, {least} m");
    }
    assert!(lines > 0, "no line and no arc among them");
}

/// Makes these motions at once, to their ends; what a guard said that ended one.
fn made(segments: [Option<Segment>; 2], mut arms: [Arm; 2]) -> Option<String> {
    for (arm, segment) in arms.iter().zip(segments) {
        if let Some(segment) = segment {
            let order = ServoCommand::Move { id: 1, segment };
            arm.port.order(order).unwrap();
        }
    }
    // A line near a singularity takes minutes.
    for _ in 0..200_000 {
        for arm in &mut arms {
            arm.servo.tick(0);
        }
        let phases = || arms.iter().map(|arm| arm.port.status().motion.phase);
        if phases().all(|phase| phase == MotionPhase::None || phase.is_over()) {
            break;
        }
    }
    arms.iter().zip(segments).find_map(|(arm, segment)| {
        let status = arm.port.status();
        let arrived = segment.is_none() || status.motion.phase == MotionPhase::Done;
        (!arrived).then(|| format!("{:?}: {:?}", status.motion.phase, status.guard))
    })
}
#[test]
fn an_arm_whose_neighbours_servo_falls_silent_stops_and_names_it_and_since_when() {
    let start = Joints::try_from(&[0.0, 0.0, 0.0, 0.0, 0.8, -2.6, 0.0, 0.7, 0.0][..]).unwrap();
    let mut arms = arms(&[start, start]);
    let mut id = 0;
    // One motion of the left arm while the right one's servo ticks now and then.
    let mut go = |arms: &mut [Arm; 2], track: f64, other_ticks: &dyn Fn(u32) -> bool| {
        id += 1;
        let (from, mut goal) = (arms[0].port.status().setpoint, start);
        goal[0] = track;
        let segment = arms[0].planner.joint(&from, &goal, 0.2).unwrap();
        arms[0]
            .port
            .order(ServoCommand::Move { id, segment })
            .unwrap();
        let mut ticks = 0;
        while !arms[0].port.status().motion.phase.is_over() || ticks < 10 {
            arms[0].servo.tick(0);
            if other_ticks(ticks) {
                arms[1].servo.tick(0);
            }
            ticks += 1;
        }
        let status = arms[0].port.status();
        (
            status.motion.phase,
            status.ended_by_guard(id).map(|found| found.measured),
        )
    };
    // One that comes late each time, but comes, is no reason to stop. Neither is what was before the motion.
    (0..50).for_each(|_| arms[0].servo.tick(0));
    let (phase, found) = go(&mut arms, 0.5, &|tick| tick % 20 == 10);
    assert_eq!((phase, found), (MotionPhase::Done, None));
    let (phase, found) = go(&mut arms, 0.0, &|tick| tick < 100);
    assert_eq!(phase, MotionPhase::Stopped);
    let found = found.unwrap();
    let told = "where the arm of `right` is is not known: it has shown nothing for 0.103 s";
    assert_eq!(found.as_str(), told);
    // It is back, and so is the arm's right to move.
    let (phase, found) = go(&mut arms, 0.3, &|_| true);
    assert_eq!((phase, found), (MotionPhase::Done, None));
}

#[test]
fn no_tick_with_the_guard_allocates_while_two_arms_run_into_one_another() {
    let (cart, arm) = ([0.0; 3], [0.0, 0.8, -2.6, 0.2, 0.7, 0.1]);
    let start = Joints::try_from(&[&cart[..], &arm].concat()[..]).unwrap();
    let mut arms = arms(&[start, start]);
    for (side, turn) in [(0, 1.5), (1, -1.1)] {
        let mut goal = start;
        goal[3] = turn;
        goal[4] = 0.0;
        goal[5] = -1.57;
        let arm = &mut arms[side];
        let segment = arm.planner.joint(&start, &goal, 1.0).unwrap();
        arm.port
            .order(ServoCommand::Move { id: 1, segment })
            .unwrap();
    }
    let mut count = 0;
    for _ in 0..2000 {
        for arm in &mut arms {
            count += allocation_counter::measure(|| arm.servo.tick(0)).count_total;
        }
    }
    let found = arms[0].port.status().ended_by_guard(1).unwrap();
    let text = found.measured.as_str();
    assert!(text.contains(" of the other testbed9 are "), "{text}");
    assert_eq!(count, 0);
}

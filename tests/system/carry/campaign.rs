//! Carries with physics among everything that may go wrong together, drawn from a seed: board, discs, stacks, light, noise, pushes,
//! covered cameras, stops, and processes that die. `CTOS_CARRY_SEEDS` says how many seeds there are.

use std::{fmt::Write as _, io::Write as _, panic::AssertUnwindSafe, time::Duration};

use ctos::{
    boot::{self, End, Fault, FaultKind},
    time::Instant,
};
use nalgebra::{Isometry3, Point2, Translation3};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sim::scene::CameraFault;

use super::{
    layout::{board, disc_on, error, laid, nothing_was_hit, other, reached},
    person::{Deed, Moment, Seen, Step, prepared},
};
use crate::harness::Scratch;

/// Processes that come back, with what they know.
const DURABLE: [&str; 4] = ["robot", "hand", "vision", "laser"];

/// What a seed draws.
struct Drawn {
    steps: Vec<Step>,
    kills: Vec<Fault>,
    from: [f64; 3],
    to: [f64; 2],
    /// In words.
    wrong: Vec<String>,
    is_pushed: bool,
}

/// The cell with another light and other noise.
fn lit(cell: &str, rng: &mut impl Rng) -> String {
    let light = rng.random_range(0.75..1.15);
    let (noise, blur) = (rng.random_range(1.0..4.0), rng.random_range(0.6..1.1));
    let shine = |line: &str, key: &str| -> Option<String> {
        let at = line.find(key)? + key.len();
        let (before, rest) = line.split_at(at);
        let rest = rest.trim_matches(|one: char| one == '[' || one == ' ');
        let end = rest.find([']', '}']).unwrap_or(rest.len());
        let (numbers, after) = rest.split_at(end);
        let numbers = numbers.split(',');
        let numbers: Option<Vec<String>> = numbers
            .map(|number| {
                let level = number.trim().parse::<f64>().ok()? * light;
                Some(format!("{:.1}", level.min(254.0)))
            })
            .collect();
        let numbers = numbers?.join(", ");
        let open = if after.starts_with(']') { "[" } else { "" };
        Some(format!("{before}{open}{numbers}{after}"))
    };
    let mut text = String::new();
    for line in cell.lines() {
        let mut line = line.to_owned();
        for key in ["grey = ", "colour = "] {
            line = shine(&line, key).unwrap_or(line);
        }
        if line.starts_with("read_noise") {
            line = format!("read_noise = {noise}");
        } else if line.starts_with("blur") {
            line = format!("blur = {blur}");
        }
        writeln!(text, "{line}").unwrap();
    }
    text
}

fn drawn(rng: &mut ChaCha8Rng, is_rough: bool) -> Drawn {
    let surface = board(
        rng.random_range(0.52..0.62),
        rng.random_range(-0.12..0.12),
        rng.random_range(-180.0..180.0),
    );
    let fields = reached(&surface);
    let apart = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
    let mut draw = || fields[rng.random_range(0..fields.len())];
    let from = draw();
    let to = std::iter::repeat_with(&mut draw).find(|to| apart(*to, from) > 0.9);
    let to = to.unwrap();
    let clear = |one: &[f64; 2]| apart(*one, from) > 1.5 && apart(*one, to) > 1.5;
    let blue = std::iter::repeat_with(&mut draw).find(clear).unwrap();
    let elsewhere =
        std::iter::repeat_with(&mut draw).find(|one| clear(one) && apart(*one, blue) > 1.5);
    let is_stacked = rng.random_bool(0.25);
    let (angle, far) = (
        rng.random_range(0.0..std::f64::consts::TAU),
        if is_stacked {
            0.0
        } else {
            rng.random_range(0.0..0.010)
        },
    );
    let mut steps = laid(&surface, from, [far * angle.cos(), far * angle.sin()]);
    if is_stacked {
        steps.push(other(&surface, from));
        let upper = disc_on(&surface, from, [0.0; 2]);
        steps.push(Step::Put(
            "disc",
            Translation3::new(0.0, 0.0, 0.0102) * upper,
        ));
    } else {
        steps.push(other(&surface, blue));
    }
    steps.push(Step::Trace);
    let (mut wrong, mut kills, mut is_pushed) = (Vec::new(), Vec::new(), false);
    let moment = |rng: &mut ChaCha8Rng| Duration::from_millis(rng.random_range(500..14_000));
    if is_rough && rng.random_bool(0.4) {
        let at = moment(rng);
        let table = Isometry3::translation(0.9, -0.4, 0.4052);
        let there = match (rng.random_bool(0.5), elsewhere) {
            (true, Some(field)) => disc_on(&surface, field, [0.0; 2]),
            _ => table,
        };
        steps.push(Step::Later(at, "disc", there));
        wrong.push(format!("the disc is moved at {at:?}"));
        is_pushed = true;
    }
    if is_rough && rng.random_bool(0.25) {
        let at = moment(rng);
        let by = Translation3::new(
            rng.random_range(-0.03..0.03),
            rng.random_range(-0.03..0.03),
            -0.01,
        );
        steps.push(Step::Later(at, "board", surface * by));
        wrong.push(format!("the board is pushed at {at:?}"));
        is_pushed = true;
    }
    if is_rough && rng.random_bool(0.3) {
        let (at, camera) = (moment(rng), ["left", "right"][rng.random_range(0..2)]);
        let fault =
            [CameraFault::Cover, CameraFault::Black, CameraFault::Freeze][rng.random_range(0..3)];
        steps.push(Step::After(at, Deed::Camera(camera, Some(fault))));
        steps.push(Step::After(at + moment(rng), Deed::Camera(camera, None)));
        wrong.push(format!("{camera}: {fault:?} at {at:?}"));
    }
    if is_rough && rng.random_bool(0.3) {
        let at = moment(rng);
        if rng.random_bool(0.3) {
            steps.push(Step::After(at, Deed::EmergencyStop));
            wrong.push(format!("emergency stop at {at:?}"));
        } else {
            let until = at + Duration::from_millis(rng.random_range(700..6000));
            steps.push(Step::After(at, Deed::Stop));
            steps.push(Step::After(until, Deed::Resume));
            wrong.push(format!("stop from {at:?} to {until:?}"));
        }
    }
    for _ in 0..if is_rough { rng.random_range(0..3) } else { 0 } {
        let (at, chassis) = (moment(rng), DURABLE[rng.random_range(0..DURABLE.len())]);
        kills.push(Fault::on(
            chassis.to_owned(),
            FaultKind::Kill,
            Instant::START + at,
        ));
        wrong.push(format!("{chassis} is killed at {at:?}"));
    }
    let height = f64::from(u8::from(is_stacked));
    let line = format!("{},{},{height} {},{}", from[0], from[1], to[0], to[1]);
    steps.extend([Step::Carry(line), Step::Rest(Duration::from_secs(2))]);
    Drawn {
        steps,
        kills,
        from: [from[0], from[1], height],
        to,
        wrong,
        is_pushed,
    }
}

/// What is durable, as `--profile durable` has it.
fn durable() -> String {
    let mut text = String::new();
    for chassis in DURABLE {
        write!(
            text,
            "[chassis.{chassis}]\nrestart = \"on-failure\"\nmax_restarts = 10\n"
        )
        .unwrap();
    }
    for task in [
        "dom",
        "dispatcher",
        "robot",
        "pusher",
        "hand",
        "vision",
        "laser",
        "people",
    ] {
        write!(text, "[task.{task}.args]\ndurable = true\n").unwrap();
    }
    text
}

/// How far the disc is beside a field's middle at a moment, m, if it lies there so high.
fn beside(moment: &Moment, [column, row, height]: [f64; 3]) -> f64 {
    let at = (moment.board.inverse() * moment.disc).translation.vector;
    let field = Point2::new((column - 4.5) * 0.06, (row - 4.5) * 0.06);
    let level = 0.01 + 0.005 + height * 0.01;
    match (at.z - level).abs() < 3e-3 {
        true => (Point2::from(at.xy()) - field).norm(),
        false => f64::INFINITY,
    }
}

/// The arm stands while a stop holds, m.
fn stands_when_stopped(seen: &Seen) {
    let (moments, deeds) = (seen.moments.lock().unwrap(), seen.deeds.lock().unwrap());
    let mut deeds = deeds.clone();
    deeds.sort_by_key(|(at, _)| *at);
    for (at, deed) in &deeds {
        if !matches!(deed, Deed::Stop | Deed::EmergencyStop) {
            continue;
        }
        let ends = |(end, deed): &&(Duration, Deed)| end > at && matches!(deed, Deed::Resume);
        let until = match deed {
            Deed::Stop => deeds
                .iter()
                .find(ends)
                .map_or(Duration::MAX, |(end, _)| *end),
            _ => Duration::MAX,
        };
        let from = *at + Duration::from_millis(600);
        let still = moments.iter().filter(|one| one.at > from && one.at < until);
        let hands: Vec<_> = still.map(|one| one.hand.translation.vector).collect();
        let far = hands
            .iter()
            .map(|hand| (hand - hands[0]).norm())
            .fold(0.0, f64::max);
        assert!(
            far < 3e-3,
            "{deed:?} at {at:?}: the hand went {far} m from {from:?} to {until:?}"
        );
    }
}

/// One seed; the answer, and how far the disc is from the middle of its field, m.
fn run(seed: u64) -> (String, bool, f64) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let is_rough = !seed.is_multiple_of(4);
    let scratch = Scratch::new();
    let cell = scratch.read("configs/carry-cell.toml");
    scratch.write("configs/carry-cell.toml", lit(&cell, &mut rng));
    let Drawn {
        steps,
        kills,
        from,
        to,
        wrong,
        is_pushed,
    } = drawn(&mut rng, is_rough);
    let (mut app, registry, seen) = prepared("carry.toml", &scratch, &durable(), steps);
    app.seed = seed;
    let observer: boot::Observer = std::sync::Arc::new(|_| {});
    let end = boot::simulate(app, registry, &kills, &observer)
        .unwrap()
        .end;
    assert!(
        matches!(&end, End::Finished(result) if result.ok),
        "{wrong:?}: {end:?}"
    );
    let all = seen.answers.lock().unwrap();
    let answer = &all[0];
    let case = format!(
        "{from:?} to {to:?}, {wrong:?}: {}: {}",
        answer.symbol, answer.text
    );
    let moments = seen.moments.lock().unwrap().clone();
    let by = seen.answered.lock().unwrap()[0];
    let before: Vec<&Moment> = moments.iter().filter(|one| one.at <= by).collect();
    let is_on = |one: &&&Moment, field: [f64; 3], within: f64| beside(one, field) < within;
    let target = [to[0], to[1], 0.0];
    match answer.symbol.as_str() {
        "carried" => {
            // Who is pushed meanwhile is told by how much it is beside the middle; it is on its field.
            let within = if is_pushed { 0.027 } else { 3e-3 };
            let arrived = before.iter().any(|one| is_on(&one, target, within));
            assert!(arrived, "it was never there: {case}");
            let is_there = is_pushed || error(answer, to) < 3e-3;
            assert!(is_there, "it is not there: {case}");
        }
        "nothing_at_from" => {
            let gone = before.iter().any(|one| !is_on(&one, from, 0.027));
            assert!(gone, "it was there all the time: {case}");
        }
        "occupied" => {
            let taken = before.iter().any(|one| is_on(&one, target, 0.036));
            assert!(taken, "nothing was there: {case}");
        }
        _ => assert!(!answer.text.is_empty(), "{case}"),
    }
    let lies = answer.disc.translation.vector.z - answer.board.translation.vector.z;
    let full = *seen.hand_full.lock().unwrap();
    assert!(
        lies < 0.05 || full == 1,
        "it is in the hand, and nobody says so: {case}"
    );
    // The arm is at rest once it is answered.
    let after: Vec<_> = moments
        .iter()
        .filter(|one| one.at > by + Duration::from_millis(200))
        .collect();
    let still = after.windows(2).all(|two| {
        let by = two[1].hand.translation.vector - two[0].hand.translation.vector;
        by.norm() < 1e-3
    });
    assert!(still, "the arm moves after the answer: {case}");
    stands_when_stopped(&seen);
    nothing_was_hit(&seen);
    (case, answer.symbol == "carried", error(answer, to))
}

fn seeds() -> u64 {
    let given = std::env::var("CTOS_CARRY_SEEDS").ok();
    given.map_or(6, |text| text.parse().unwrap())
}

#[test]
fn among_everything_that_goes_wrong_together_every_answer_is_true_and_without_it_every_disc_is_carried()
 {
    let (mut failed, mut calm, mut carried, mut rough, mut squares) = (Vec::new(), 0, 0, 0, 0.0);
    for seed in 0..seeds() {
        let ran = std::panic::catch_unwind(AssertUnwindSafe(|| run(seed)));
        let is_calm = seed.is_multiple_of(4);
        let said = match &ran {
            Ok((case, ..)) => case.lines().next().unwrap_or_default().to_owned(),
            Err(_) => "FAILED".to_owned(),
        };
        writeln!(std::io::stdout(), "seed {seed}: {said}").unwrap();
        match ran {
            Ok((case, was_carried, error)) => {
                calm += u32::from(is_calm);
                if is_calm && was_carried {
                    carried += 1;
                    squares += error * error;
                } else if is_calm {
                    failed.push(format!("{seed} without faults: {case}"));
                }
                rough += u32::from(!is_calm && was_carried);
            }
            Err(why) => {
                let why = why.downcast_ref::<String>().cloned().unwrap_or_default();
                failed.push(format!("{seed}: {why}"));
            }
        }
    }
    let rms_mm = 1e3 * (squares / f64::from(carried.max(1))).sqrt();
    let told = format!(
        "{carried} of {calm} were carried without faults, {rms_mm:.2} mm rms; {rough} with them; failed: {failed:#?}\n"
    );
    std::io::stdout().write_all(told.as_bytes()).unwrap();
    assert!(failed.is_empty(), "{told}");
    assert!(rms_mm < 1.5, "{told}");
}

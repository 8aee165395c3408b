//! The visual and force tracker in virtual time: the arm follows the ball through real pictures, whatever goes wrong.

#[allow(
    clippy::print_stdout,
    reason = "what came out is a table for the documentation"
)]
mod campaign;
#[allow(
    clippy::print_stdout,
    reason = "what became of a run is shown when one fails"
)]
mod rig;

use serde_json::Value;
use sim::scene::CameraFault;

use crate::harness::Scratch;
use rig::{Act, Ended, Rig};

/// Runs `configs/tracker.toml` under a name that no other test has, for its snapshot buffers are of the whole host; what it tells.
fn run(scratch: &Scratch, name: &str, seconds: f64, more: &[&str]) -> Value {
    let name = format!("app.name=\"tracker_{name}_{}\"", std::process::id());
    let seconds = format!("task.tracker.args.seconds={seconds:?}");
    let own = [
        "sim",
        "configs/tracker.toml",
        "--json",
        "--set",
        &name,
        "--set",
        &seconds,
    ];
    let ended = scratch.ctos(&[&own, more].concat());
    ended.must_exit(0);
    ended.json()["result"].clone()
}

fn number(result: &Value, key: &str) -> f64 {
    result[key]
        .as_f64()
        .unwrap_or_else(|| panic!("`{key}` in {result}"))
}

/// What holds in every run, whatever goes wrong: no step of the commanded speed, no record lost, clocks known within their bound.
fn must_be_smooth(result: &Value) {
    assert!(
        number(result, "max_acceleration_ratio") <= 1.0 + 1e-6,
        "{result}"
    );
    // 6 m/s^2 in 4.5 ms.
    assert!(
        number(result, "max_step_m_s") <= 6.0 * 0.0045 + 1e-6,
        "{result}"
    );
    assert_eq!(result["unread"], 0, "{result}");
    assert_eq!(result["clock_within"], true, "{result}");
}

#[test]
fn two_clocks_that_differ_and_drift_cost_no_accuracy() {
    let scratch = Scratch::new();
    let fault = |chassis: &str, ahead: f64, rate: f64| {
        format!(
            "[[fault]]\nkind = \"drift\"\nchassis = \"{chassis}\"\nahead_s = {ahead:?}\nrate_ppm = {rate:?}\n"
        )
    };
    let faults = [
        fault("argus", 3.7, 120.0),
        fault("client", 1.1, -80.0),
        fault("druide", 0.4, -50.0),
    ];
    scratch.write("clocks.toml", faults.concat());
    let result = run(&scratch, "clocks", 8.0, &["--faults", "clocks.toml"]);
    must_be_smooth(&result);
    assert!(number(&result, "clock_error_s") < 1e-3, "{result}");
    assert!(
        number(&result, "rms_m") < 0.006 && number(&result, "tracked") > 0.99,
        "{result}"
    );
}

#[test]
fn a_clock_that_is_set_while_the_ball_is_followed_is_noticed_and_costs_no_step() {
    let ended = Rig::new("set", 12.0)
        .clock_that_is_set()
        // Just after the clocks were compared.
        .act(4.05, Act::SetClock(300_000_000))
        .act(8.05, Act::SetClock(0))
        .run();
    ended.must_move_smoothly();
    // Until the clocks are compared again no moment of argus can be believed.
    let wrong = ended.number("unplaced") + ended.number("late");
    assert!(wrong >= 2.0, "{}", ended.result);
    assert_eq!(ended.result["clock_restarts"], 2, "{}", ended.result);
    assert_eq!(ended.result["stops"], 0, "{}", ended.result);
    for at in [3.9, 5.0, 7.9, 9.0, 11.9] {
        assert_eq!(ended.state(at), "track", "{:?}", ended.states);
    }
    assert!(ended.number("tracked") > 0.95, "{}", ended.result);
    assert!(ended.number("rms_m") < 0.01, "{}", ended.result);
    assert!(ended.number("last_error_m") < 0.005, "{}", ended.result);
}

#[test]
fn a_vision_chassis_that_is_killed_comes_back_and_so_does_the_hand() {
    let ended = Rig::new("killed", 7.0)
        .set("task.ball.args.reach=[0.02, 0.05, 0.02]")
        .set("task.ball.args.speed=0.2")
        .kill("argus", 3.0)
        .run();
    ended.must_be_smooth();
    assert_eq!(ended.state(6.9), "track", "{:?}", ended.states);
    assert!(ended.number("lost") >= 1.0, "{}", ended.result);
}

#[test]
fn after_too_much_force_the_hand_stays_where_it_is_until_a_person_says_so() {
    let scratch = Scratch::new();
    let app = scratch.read("configs/tracker.toml");
    let force = "args.force = 40.0";
    assert!(app.contains(force));
    // What the sensor's noise is too much for.
    scratch.write(
        "configs/tracker.toml",
        app.replace(force, "args.force = 0.01"),
    );
    let name = format!("app.name=\"tracker_overload_{}\"", std::process::id());
    let own = ["sim", "configs/tracker.toml", "--json", "--set", &name];
    let ended = scratch.ctos(&[&own[..], &["--set", "task.tracker.args.seconds=6.0"]].concat());
    let result = ended.json()["result"].clone();
    ended.must_exit(1);
    assert_eq!(
        (&result["phase"], &result["stops"]),
        (&"Stopped".into(), &1.into()),
        "{result}"
    );
    let why = result["stopped"].as_str().unwrap();
    assert!(why.contains("overload"), "{why}");
    assert!(number(&result, "tracked") < 0.1, "{result}");
}

#[test]
fn the_arm_learns_its_map_by_one_command() {
    let ended = Rig::new("learn", 1.0)
        .set("task.tracker.args.mode=\"learn\"")
        .set("task.ball.args.motion=\"rest\"")
        .set("task.druide.args.learn={ pictures = 3, speed = 1.0 }")
        // Most of a run is pictures that nobody needs.
        .set("task.argus.args.period_ms=200.0")
        .run();
    assert_eq!(ended.result["examples"], 27, "{}", ended.result);
    assert!(ended.number("checked_rms_m") < 0.002, "{}", ended.result);
    assert_eq!(ended.state(5.0), "learn", "{:?}", ended.states);
    assert_eq!(ended.map.lines().count(), 28);
    assert_ne!(
        ended.map,
        Scratch::new().read("configs/tracker-map.csv"),
        "nothing was learned"
    );
}

#[test]
fn a_ball_that_is_covered_for_a_tenth_or_for_five_seconds_is_followed_again_when_it_is_seen() {
    let covered = "task.ball.args.hidden_s=[[2.5, 2.6], [3.5, 3.8], [5.0, 6.5], [7.5, 12.5]]";
    let ended = Rig::new("covered", 14.0).set(covered).run();
    ended.must_be_smooth();
    let states: Vec<&str> = ended.states.iter().map(|(_, state)| &**state).collect();
    let expected = [
        "idle", "acquire", "track", "lost", "track", "lost", "expired", "acquire", "track", "lost",
        "expired", "acquire", "track",
    ];
    assert!(states.starts_with(&expected), "{:?}", ended.states);
    assert_eq!(
        (
            &ended.result["lost"],
            &ended.result["expired"],
            &ended.result["stops"]
        ),
        (&3.into(), &2.into(), &0.into()),
        "{}",
        ended.result
    );
}

#[test]
fn a_camera_that_lies_costs_the_ball_and_when_it_is_well_the_ball_is_followed_again() {
    let faults = [
        CameraFault::Freeze,
        CameraFault::Repeat,
        CameraFault::Jump,
        CameraFault::Black,
    ];
    let mut rig = Rig::new("lies", 14.5)
        .set("task.ball.args.reach=[0.02, 0.05, 0.02]")
        .set("task.ball.args.speed=0.2");
    let mut at = 2.0;
    for fault in faults {
        rig = rig
            .act(at, Act::Camera(Some(fault)))
            .act(at + 1.5, Act::Camera(None));
        at += 3.0;
    }
    let ended = rig.run();
    ended.must_be_smooth();
    let mut at = 2.0;
    for fault in faults {
        assert_eq!(
            ended.state(at - 0.05),
            "track",
            "{fault:?} {:?}",
            ended.states
        );
        assert_ne!(
            ended.state(at + 1.4),
            "track",
            "{fault:?} {:?}",
            ended.states
        );
        at += 3.0;
    }
    assert_eq!(ended.state(14.4), "track", "{:?}", ended.states);
    assert!(ended.number("last_error_m") < 0.005, "{}", ended.result);
}

#[test]
fn pictures_out_of_order_and_twice_are_left_out_and_the_ball_is_followed() {
    let late = "task.argus.args.latency_ms=[80.0, 60.0]";
    let ended = Rig::new("order", 7.0).set(late).run();
    ended.must_be_smooth();
    assert!(ended.number("late") > 5.0, "{}", ended.result);
    assert!(ended.number("tracked") > 0.99, "{}", ended.result);
    assert!(ended.number("rms_m") < 0.015, "{}", ended.result);
}

/// A second ball as bright as the first, which comes and goes.
const SECOND: &str = r#"
[[object]]
name = "second"
shape = "sphere"
radius = 0.019
mass = 0.003
grey = 250.0
position = [0.56, -0.06, 0.270]
"#;

/// Bright spots on the floor, a small and a long one.
const REFLECTIONS: &str = r#"
[[furniture]]
centre = [0.80, -0.25, 0.005]
size = [0.02, 0.02, 0.01]
grey = 250.0

[[furniture]]
centre = [0.50, -0.30, 0.005]
size = [0.01, 0.25, 0.01]
grey = 250.0
"#;

#[test]
fn a_second_ball_is_told_and_not_followed_and_reflections_do_no_harm() {
    let hand = r#"
        [task.second]
        handler = "sim.hand"
        on = "druide/servo"
        args = { body = "second", home = [0.56, -0.06, 0.27], motion = "rest", hidden_s = [[0.0, 5.0], [7.0, 99.0]] }
    "#;
    let ended = Rig::new("second", 10.0)
        .cell(SECOND)
        .cell(REFLECTIONS)
        .app(hand)
        .set("task.ball.args.reach=[0.02, 0.03, 0.01]")
        .set("task.ball.args.speed=0.05")
        .run();
    ended.must_be_smooth();
    let sights = &ended.result["sights"];
    assert!(sights["ambiguous"].as_u64() > Some(20), "{sights}");
    // Nobody knows which is the ball: neither is followed, and when there is one again it is.
    assert_eq!(ended.state(4.9), "track", "{:?}", ended.states);
    assert_ne!(ended.state(6.9), "track", "{:?}", ended.states);
    assert_eq!(ended.state(9.9), "track", "{:?}", ended.states);
    assert!(ended.number("rms_m") < 0.01, "{}", ended.result);
}

#[test]
fn a_ball_at_the_border_or_outside_of_what_the_map_knows_is_told_and_followed_when_it_is_back() {
    let ended = Rig::new("border", 11.0)
        .set("task.druide.args.control.reach_m=0.03")
        .set("task.ball.args.motion=\"sweep\"")
        .set("task.ball.args.reach=[0.0, 0.35, 0.0]")
        .set("task.ball.args.speed=0.6")
        .run();
    ended.must_be_smooth();
    let sights = &ended.result["sights"];
    assert!(sights["clipped"].as_u64() > Some(0), "{sights}");
    assert!(sights["unknown"].as_u64() > Some(0), "{sights}");
    let tracked = ended.states.iter().filter(|(_, state)| state == "track");
    assert!(tracked.count() >= 3, "{:?}", ended.states);
}

#[test]
fn what_the_ball_is_expected_to_look_like_is_tuned_while_it_is_followed() {
    let ended = Rig::new("tuned", 7.0)
        .act(2.5, Act::Tune(15_000))
        .act(5.0, Act::Tune(150))
        .run();
    ended.must_be_smooth();
    // Too small for what is expected then.
    assert!(
        ended.result["sights"]["size"].as_u64() > Some(50),
        "{}",
        ended.result
    );
    assert_eq!(ended.state(2.4), "track", "{:?}", ended.states);
    assert_eq!(ended.state(4.9), "acquire", "{:?}", ended.states);
    assert_eq!(ended.state(6.9), "track", "{:?}", ended.states);
}

#[test]
fn a_mouse_moves_the_hand_and_a_daemon_that_is_killed_with_a_deflection_leaves_none() {
    let push = Act::Deflect([0.0, 1.0, 0.0, 0.0, 0.0, 0.0]);
    let mut rig = Rig::new("mouse", 8.0).set("task.ball.args.motion=\"rest\"");
    for step in 0..4 {
        rig = rig.act(2.0 + 0.2 * f64::from(step), push);
    }
    let ended = rig.kill("spacemouse", 2.7).run();
    ended.must_be_smooth();
    // 0.095 m for less than a second, and then nothing more.
    assert!(ended.number("p95_m") < 0.1, "{}", ended.result);
    assert!(ended.number("max_error_m") > 0.05, "{}", ended.result);
    assert!(ended.number("last_error_m") < 0.003, "{}", ended.result);
    assert_eq!(ended.result["stops"], 0, "{}", ended.result);
}

#[test]
fn a_force_sensor_that_is_broken_or_saturated_stops_the_arm_until_it_is_well_and_a_person_says_so()
{
    let ended = Rig::new("sensor", 10.0)
        .act(2.0, Act::Feel([f64::NAN, 0.0, 0.0]))
        .act(2.5, Act::Feel([0.0; 3]))
        .act(3.0, Act::Reset)
        .act(4.0, Act::Order("resume"))
        .act(6.0, Act::Feel([300.0, 300.0, 300.0]))
        .act(7.0, Act::Order("resume"))
        .act(7.5, Act::Feel([0.0; 3]))
        .act(8.5, Act::Order("resume"))
        .run();
    ended.must_be_smooth();
    // What is no number is a fault of the arm, which takes its power; too much is felt by the guard.
    let broken = [(2.0, 4.0, "estopped"), (6.0, 8.5, "overload")];
    for (broken, again, state) in broken {
        assert_eq!(ended.state(broken - 0.1), "track", "{:?}", ended.states);
        assert_eq!(ended.state(broken + 0.3), state, "{:?}", ended.states);
        // Well again, and nobody has said so.
        assert_eq!(ended.state(again - 0.1), state, "{:?}", ended.states);
        assert_eq!(ended.answer(again).0, "resumed");
        assert_eq!(ended.state(again + 1.4), "track", "{:?}", ended.states);
    }
    let (answer, why) = ended.answer(7.0);
    assert_eq!(answer, "not_resumed");
    assert!(why.contains("the wrist feels"), "{why}");
    assert_eq!(ended.result["stops"], 2, "{}", ended.result);
}

#[test]
fn an_emergency_stop_waits_for_a_reset_and_a_person_and_a_stop_for_whoever_resumes_the_arm() {
    let ended = Rig::new("estop", 9.5)
        .act(2.0, Act::EmergencyStop)
        .act(2.5, Act::Order("resume"))
        .act(3.0, Act::Reset)
        .act(4.0, Act::Order("resume"))
        .act(6.0, Act::Stop)
        .act(6.8, Act::Order("track"))
        .act(7.0, Act::Resume)
        .run();
    ended.must_be_smooth();
    assert_eq!(ended.state(2.2), "estopped", "{:?}", ended.states);
    assert_eq!(ended.answer(2.5).0, "not_resumed");
    // A reset alone moves nothing.
    assert_eq!(ended.state(3.9), "estopped", "{:?}", ended.states);
    assert_eq!(ended.answer(4.0).0, "resumed");
    assert_eq!(ended.state(5.9), "track", "{:?}", ended.states);
    assert_eq!(ended.state(6.9), "halted", "{:?}", ended.states);
    assert_eq!(ended.answer(6.8).0, "busy");
    assert_eq!(ended.state(9.0), "track", "{:?}", ended.states);
}

/// A fence that the hand leaves on its way after the ball.
const FENCE: &str = r#"
[mcs.manipulator.servo.guards.fence]
kind = "workspace"
args.inside = [{ low = [0.0, -0.23, 0.0], high = [1.0, 1.0, 2.0] }]
"#;

#[test]
fn a_guard_that_speaks_waits_for_a_person_unless_it_is_one_after_which_the_arm_may_begin_again() {
    let sweep = "task.ball.args.motion=\"sweep\"";
    let ended = Rig::new("fence", 7.0).app(FENCE).set(sweep).run();
    ended.must_be_smooth();
    assert_eq!(ended.state(6.9), "guarded", "{:?}", ended.states);
    assert_eq!(ended.result["stops"], 1, "{}", ended.result);
    let why = ended.result["stopped"].as_str().unwrap();
    assert!(why.contains("fence"), "{why}");
    let ended = Rig::new("again", 11.0)
        .app(FENCE)
        .set(sweep)
        .set("task.druide.args.again_after=[\"fence\"]")
        .run();
    ended.must_be_smooth();
    assert!(ended.number("stops") > 1.0, "{}", ended.result);
}

#[test]
fn the_net_hands_over_when_the_ball_rests_and_answers_every_order() {
    let ended = Rig::new("orders", 8.0)
        .set("task.ball.args.motion=\"rest\"")
        .act(1.0, Act::Order("resume"))
        .act(1.1, Act::Order("learn"))
        .act(1.2, Act::Order("track"))
        .act(2.0, Act::Order("hand_over"))
        .act(4.0, Act::Order("track"))
        .act(5.0, Act::Order("stop"))
        .act(5.5, Act::Order("learn"))
        .act(6.4, Act::Order("track"))
        .act(6.7, Act::Order("stop"))
        .act(7.3, Act::Order("track"))
        .run();
    ended.must_be_smooth();
    let answers = [
        (1.0, "nothing_stands"),
        (1.1, "busy"),
        (1.2, "tracking"),
        (2.0, "when_it_rests"),
        (4.0, "tracking"),
        (5.0, "stopped"),
        (5.5, "learns"),
        (6.4, "busy"),
        (6.7, "stopped"),
        (7.3, "tracking"),
    ];
    for (at, answer) in answers {
        assert_eq!(ended.answer(at).0, answer, "{at}: {:?}", ended.answers);
    }
    assert_eq!(ended.state(3.9), "handed_over", "{:?}", ended.states);
    assert_eq!(ended.state(6.3), "learn", "{:?}", ended.states);
    assert_eq!(ended.state(7.2), "idle", "{:?}", ended.states);
}

/// A run in which the hand is told to take the ball.
fn taken(name: &str, seconds: f64) -> Rig {
    Rig::new(name, seconds)
        .with_hand()
        .set("task.ball.args.motion=\"rest\"")
        .act(2.0, Act::Order("grasp"))
}

#[test]
fn a_ball_that_slips_away_or_is_gone_is_told_and_the_arm_may_follow_again() {
    // Whoever holds it does not let go; or has taken it away meanwhile.
    let slipped = taken("slipped", 12.2)
        .set("task.ball.args.gives_n=1000.0")
        .act(11.5, Act::Order("track"))
        .run();
    let missed = taken("missed", 12.2)
        .act(4.5, Act::Person("drag", &[0.0, 0.12, 0.0]))
        .act(11.5, Act::Order("track"))
        .run();
    for (ended, how) in [(slipped, "Slipped"), (missed, "Missed")] {
        ended.must_be_smooth();
        let grasped = &ended.result["grasped"];
        assert!(grasped[how].is_string(), "{how}: {grasped}");
        assert_eq!(ended.state(11.4), "handed_over", "{:?}", ended.states);
        assert_eq!(ended.answer(11.5).0, "tracking");
    }
}

/// Moments of a run of [`taken`], s, and what the hand does then.
const AMID: [(f64, &str); 3] = [
    (4.2, "while the hand went to the ball"),
    (5.5, "while the hand closed"),
    (9.1, "while the ball was lifted"),
];

/// What must hold after something has stopped a grasp, from `at` until `again`: nothing moves, and the run tells during what that was.
fn must_stand(ended: &Ended, (at, step): (f64, &str), again: f64) {
    ended.must_be_smooth();
    let told = &ended.result["grasped"];
    let why = told["BrokenOff"].as_str().unwrap_or_default();
    assert!(why.starts_with(step), "{step}: {told}");
    let before = ended.states.iter().rev().find(|(since, _)| *since < at);
    assert_eq!(before.unwrap().1, "grasps", "{:?}", ended.states);
    assert_eq!(
        ended.state(again - 0.1),
        "handed_over",
        "{:?}",
        ended.states
    );
    // Fingers that are closing close.
    let arm = ended.turned(false, at + 0.6, again);
    let fingers = ended.turned(true, at + 2.5, again);
    assert!(arm < 2e-3 && fingers < 2e-2, "{step}: {arm} {fingers}");
}

#[test]
fn an_emergency_stop_amid_a_grasp_stops_arm_and_hand_and_after_a_reset_both_work_again() {
    for (number, step) in AMID.into_iter().enumerate() {
        let (at, _) = step;
        let name = ["estop_near", "estop_close", "estop_lift"][number];
        let ended = taken(name, at + 6.2)
            .act(at, Act::EmergencyStop)
            .act(at + 3.0, Act::Order("track"))
            .act(at + 3.5, Act::Reset)
            .act(at + 4.0, Act::Order("let_go"))
            .act(at + 5.6, Act::Order("track"))
            .run();
        must_stand(&ended, step, at + 3.0);
        let (answer, why) = ended.answer(at + 3.0);
        assert_eq!(answer, "not_tracking", "{why}");
        assert!(why.contains("emergency stop"), "{why}");
        assert_eq!(ended.answer(at + 4.0).0, "has_let_go");
        assert_eq!(ended.answer(at + 5.6).0, "tracking");
    }
}

#[test]
fn a_stop_amid_a_grasp_gives_the_arm_back_with_the_hand_as_it_is_and_it_lets_go_when_it_is_told_to()
{
    for (number, step) in AMID.into_iter().enumerate() {
        let (at, _) = step;
        let name = ["stop_near", "stop_close", "stop_lift"][number];
        let ended = taken(name, at + 5.2)
            .act(at, Act::Order("stop"))
            .act(at + 3.0, Act::Order("let_go"))
            .act(at + 4.6, Act::Order("track"))
            .run();
        must_stand(&ended, step, at + 3.0);
        let answers = [(0.0, "stopped"), (3.0, "has_let_go"), (4.6, "tracking")];
        for (after, answer) in answers {
            assert_eq!(ended.answer(at + after).0, answer, "{:?}", ended.answers);
        }
    }
}

#[test]
fn an_arm_that_others_stop_amid_a_lift_follows_again_when_they_resume_it() {
    let [.., step] = AMID;
    let (at, _) = step;
    let ended = taken("halted_lift", at + 5.2)
        .act(at, Act::Stop)
        .act(at + 3.0, Act::Order("track"))
        .act(at + 3.5, Act::Resume)
        .act(at + 4.5, Act::Order("track"))
        .run();
    must_stand(&ended, step, at + 3.0);
    assert_eq!(ended.answer(at + 3.0).0, "not_tracking");
    assert_eq!(ended.answer(at + 4.5).0, "tracking");
}

#[test]
fn the_hand_takes_a_ball_that_rests_with_three_fingers_lifts_it_and_lets_go_when_it_is_told_to() {
    let ended = taken("taken", 12.7)
        .act(2.5, Act::Order("let_go"))
        .act(10.5, Act::Order("let_go"))
        .act(12.0, Act::Order("track"))
        .run();
    ended.must_be_smooth();
    let answers = [
        (2.0, "when_it_rests"),
        (2.5, "busy"),
        (10.5, "has_let_go"),
        (12.0, "tracking"),
    ];
    for (at, answer) in answers {
        assert_eq!(ended.answer(at).0, answer, "{:?}", ended.answers);
    }
    let states: Vec<&str> = ended.states.iter().map(|(_, state)| &**state).collect();
    let expected = ["track", "grasps", "holds", "handed_over"];
    assert!(
        states.windows(4).any(|states| states == expected),
        "{states:?}"
    );
    assert_eq!(ended.state(10.4), "holds", "{:?}", ended.states);
    let force = ended.result["grasped"]["Holds"]["force_n"].as_f64();
    assert!(force.is_some_and(|force| force > 1.0), "{}", ended.result);
    // Nobody but the fingers holds it, 0.1 m above where it rested.
    let [x, y, z] = ended.ball(10.4);
    assert!(
        (x - 0.6603).abs() < 0.01 && (y + 0.15).abs() < 0.01 && (z - 0.3504).abs() < 0.01,
        "{x} {y} {z}"
    );
    // And then nobody.
    assert_eq!(ended.state(11.9), "handed_over", "{:?}", ended.states);
    let [.., z] = ended.ball(12.7);
    assert!(z < 0.25, "{z}");
}

#[test]
fn an_arm_without_a_hand_is_handed_over_when_it_is_told_to_grasp() {
    let ended = Rig::new("handless", 5.0)
        .set("task.ball.args.motion=\"rest\"")
        .act(2.0, Act::Order("grasp"))
        .run();
    ended.must_be_smooth();
    assert_eq!(ended.answer(2.0).0, "when_it_rests");
    assert_eq!(ended.state(4.9), "handed_over", "{:?}", ended.states);
}

#[test]
fn a_ball_that_leads_to_where_the_arm_does_not_reach_is_followed_as_far_as_that_goes_and_back() {
    // The arm is nearly folded or stretched in one run, also quicker and farther; in the last its wrist comes to the limit of joint 5.
    let ends = [
        (
            "reach",
            -60,
            "[0.649, -0.145, 0.27]",
            "[0.4, 0.0, 0.2]",
            "singular",
            13.0,
        ),
        (
            "far",
            -60,
            "[0.649, -0.145, 0.27]",
            "[0.6, 0.0, 0.2]",
            "joint",
            13.0,
        ),
        (
            "limit",
            -90,
            "[0.436, -0.145, 0.354]",
            "[0.12, 0.0, 0.0]",
            "joint",
            7.0,
        ),
    ];
    for (name, joint5, home, reach, why, seconds) in ends {
        let start = format!("start = [0.0, 39.0, -159.0, 0.0, {joint5}.0, 0.0]");
        let ended = Rig::new(name, seconds)
            .swap("start = [0.0, 39.0, -159.0, 0.0, -60.0, 0.0]", &start)
            .set("task.druide.args.control.reach_m=2.0")
            // It waits there for the ball.
            .set("task.druide.args.control.home_after_s=1000.0")
            .set("task.ball.args.motion=\"sweep\"")
            .set(&format!("task.ball.args.home={home}"))
            .set(&format!("task.ball.args.reach={reach}"))
            .set("task.ball.args.speed=0.3")
            .run();
        ended.must_be_smooth();
        assert_eq!(ended.result["stops"], 0, "{}", ended.result);
        assert!(ended.number("held") >= 1.0, "{}", ended.result);
        let held_by = ended.result["held_by"].as_str().unwrap();
        assert!(held_by.contains(why), "{held_by}");
        assert!(ended.number("tracked") > 0.5, "{:?}", ended.states);
    }
}

#[test]
fn a_ball_that_leads_through_a_straight_wrist_is_followed_through_it_and_back() {
    // Inwards until the wrist is straight, and on: also aside, where joint 4 would have to turn by half a turn.
    for (name, aside) in [("straight", 0.0), ("aside", 0.03)] {
        let ended = Rig::new(name, 8.0)
            .swap(
                "start = [0.0, 39.0, -159.0, 0.0, -60.0, 0.0]",
                "start = [0.0, 49.6, -179.1, 0.0, -10.5, 0.0]",
            )
            .set("task.ball.args.home=[0.844, -0.145, 0.341]")
            .set("task.ball.args.motion=\"sweep\"")
            .set(&format!("task.ball.args.reach=[0.12, {aside:?}, 0.0]"))
            .set("task.ball.args.speed=0.2")
            .run();
        ended.must_be_smooth();
        assert_eq!(ended.result["stops"], 0, "{}", ended.result);
        assert_eq!(ended.result["lost"], 0, "{}", ended.result);
        assert_eq!(ended.result["held"], 0, "{}", ended.result);
        assert_eq!(ended.state(7.9), "track", "{:?}", ended.states);
        assert!(ended.number("rms_m") < 0.01, "{}", ended.result);
    }
}

#[test]
fn a_ball_that_leads_to_a_singular_elbow_or_shoulder_holds_the_hand_which_comes_back_by_itself() {
    // Outwards until the arm is stretched, and towards the axis of joint 1, above the shoulder.
    const WAYS: [[f64; 3]; 4] = [
        [0.2, 0.0, 0.0],
        [-0.2, 0.0, 0.0],
        [-0.32, 0.0, 0.0],
        [0.32, 0.0, 0.0],
    ];
    let [outwards, back, inwards, away] = &WAYS;
    let ends = [
        (
            "stretched",
            [39.0, -159.0, -60.0],
            [0.649, -0.145, 0.27],
            [outwards, back],
        ),
        (
            "above",
            [105.8, -178.0, -67.8],
            [0.545, -0.145, 0.831],
            [inwards, away],
        ),
    ];
    for (name, [two, three, five], home, [there, back]) in ends {
        let start = format!("start = [0.0, {two:?}, {three:?}, 0.0, {five:?}, 0.0]");
        let ended = Rig::new(name, 11.0)
            .swap("start = [0.0, 39.0, -159.0, 0.0, -60.0, 0.0]", &start)
            .set("task.druide.args.control.reach_m=2.0")
            .set("task.ball.args.motion=\"rest\"")
            .set(&format!("task.ball.args.home={home:?}"))
            .act(2.0, Act::Person("drag", there))
            .act(6.5, Act::Person("drag", back))
            .run();
        ended.must_be_smooth();
        assert_eq!(ended.result["stops"], 0, "{}", ended.result);
        assert!(ended.number("held") >= 1.0, "{}", ended.result);
        assert!(ended.number("max_error_m") > 0.02, "{}", ended.result);
        assert!(ended.result["held_by"].is_string(), "{}", ended.result);
        assert_eq!(ended.state(10.9), "track", "{:?}", ended.states);
        assert!(ended.number("last_error_m") < 0.003, "{}", ended.result);
    }
}

#[test]
fn a_ball_that_leads_the_hand_through_a_singularity_costs_no_step_and_is_followed_on() {
    // Joint 5 is nearly straight: sideways the hand goes only as joints 4 and 6 turn against each other.
    let ended = Rig::new("singular", 9.0)
        .swap(
            "start = [0.0, 39.0, -159.0, 0.0, -60.0, 0.0]",
            "start = [0.0, 39.0, -159.0, 0.0, -2.0, 0.0]",
        )
        .set("task.ball.args.home=[1.046, -0.145, 0.435]")
        .set("task.ball.args.reach=[0.02, 0.06, 0.03]")
        .set("task.ball.args.speed=0.1")
        .run();
    ended.must_be_smooth();
    let tracked = ended.states.iter().filter(|(_, state)| state == "track");
    assert!(tracked.count() >= 1, "{:?}", ended.states);
    // Where the joints cannot turn as fast, the stream ends with its reason, and the arm begins again by itself.
    let stopped = ended.result["stopped"].as_str();
    assert_eq!(stopped.is_some(), ended.result["stops"] != 0);
    assert!(
        ["track", "acquire"].contains(&ended.state(8.9)),
        "{:?}",
        ended.states
    );
}

#[test]
fn a_person_drags_the_ball_pushes_the_hand_and_steers_the_mouse_by_one_net() {
    let ended = Rig::new("person", 8.5)
        .set("task.ball.args.motion=\"rest\"")
        .act(2.0, Act::Person("drag", &[0.0, 0.1, 0.0]))
        .act(
            3.5,
            Act::Person("steer", &[0.0, 0.5, 0.0, 0.0, 0.0, 0.0, 1.0]),
        )
        .act(5.5, Act::Person("push", &[0.0, 8.0, 0.0, 1.0]))
        .act(
            7.0,
            Act::Person("steer", &[0.0, 2.0, 0.0, 0.0, 0.0, 0.0, 1.0]),
        )
        .act(7.1, Act::Person("push", &[900.0, 0.0, 0.0, 1.0]))
        .act(7.2, Act::Person("drag", &[5.0, 0.0, 0.0]))
        .run();
    ended.must_be_smooth();
    for (at, answer) in [(2.0, "dragged"), (3.5, "steered"), (5.5, "pushed")] {
        assert_eq!(ended.answer(at).0, answer, "{:?}", ended.answers);
    }
    let refused = [
        (7.0, "not_steered", "-1 to 1"),
        (7.1, "not_pushed", "200 N"),
        (7.2, "not_dragged", "1 m"),
    ];
    for (at, answer, why) in refused {
        let (symbol, text) = ended.answer(at);
        assert!(symbol == answer && text.contains(why), "{symbol}: {text}");
    }
    // The sensor reads the push: 8 N, and 5 N beyond the null radius are 20 mm of give.
    assert!(
        (ended.number("max_force_n") - 8.0).abs() < 2.0,
        "{}",
        ended.result
    );
    // The mouse leads 45 mm away, and the hand comes back to the ball that was dragged.
    assert!(
        (0.04..0.05).contains(&ended.number("max_error_m")),
        "{}",
        ended.result
    );
    assert!(ended.number("last_error_m") < 0.003, "{}", ended.result);
    assert!(ended.number("tracked") > 0.99, "{}", ended.result);
}

/// A wall beside the hand, 30 mm from its foam, which feels what presses on it.
const WALL: &str = r#"
[[furniture]]
centre = [0.70, 0.055, 0.75]
size = [0.3, 0.1, 0.3]
grey = 30.0
feels = { name = "wall", cuts_n = 25.0 }
"#;

/// Somebody pushes the mouse to the side from one moment to another, s.
fn push(mut rig: Rig, from: f64, until: f64) -> Rig {
    let mut at = from;
    while at < until {
        rig = rig.act(at, Act::Deflect([0.0, 1.0, 0.0, 0.0, 0.0, 0.0]));
        at += 0.2;
    }
    rig
}

#[test]
fn a_ball_that_leads_the_hand_into_a_wall_makes_it_press_with_less_than_15_n() {
    let ended = Rig::new("wall", 9.0)
        .cell(WALL)
        .set("task.ball.args.motion=\"sweep\"")
        .set("task.ball.args.reach=[0.0, 0.12, 0.0]")
        .run();
    ended.must_be_smooth();
    let most = ended.pressed(0.0, 9.0)[1];
    assert!(most > 3.0, "the wall was not touched: {most} N");
    assert!(most < 15.0, "{most} N, {}", ended.result);
    assert_eq!(ended.result["stops"], 0, "{}", ended.result);
    assert_eq!(ended.state(8.9), "track", "{:?}", ended.states);
}

#[test]
fn half_a_metre_a_second_into_a_wall_that_nobody_states_presses_with_less_than_15_n_each_time() {
    // The middle of the sweep, where the ball is the fastest, is 30 mm before the foam touches.
    let ended = Rig::new("fast", 9.5)
        .cell(WALL)
        .set("task.ball.args.motion=\"sweep\"")
        .set("task.ball.args.reach=[0.0, 0.2, 0.0]")
        .set("task.ball.args.speed=0.52")
        .run();
    ended.must_be_smooth();
    let most = ended.pressed(0.0, 9.5)[1];
    assert!(most > 6.0, "the wall was not touched: {most} N");
    assert!(most < 15.0, "{most} N, {}", ended.result);
    assert_eq!(ended.result["stops"], 0, "{}", ended.result);
    assert_eq!(ended.result["expired"], 0, "{}", ended.result);
}

/// The same wall, as druide is told of it. The foam touches it 0.12 m from the tool.
const STATED: &str = r#"
[[task.druide.args.walls]]
name = "wall"
box = { low = [0.55, 0.005, 0.6], high = [0.85, 0.105, 0.9] }
stand_off_m = 0.13
"#;

#[test]
fn half_a_metre_a_second_into_a_wall_that_is_stated_presses_with_less_than_15_n_and_evenly() {
    // Somebody leads the ball so far behind the wall, along it, and back.
    let ended = Rig::new("stated", 9.0)
        .cell(WALL)
        .app(STATED)
        .set("task.ball.args.motion=\"rest\"")
        .set("task.ball.args.speed=0.5")
        .act(2.0, Act::Person("drag", &[0.0, 0.15, 0.0]))
        .act(5.5, Act::Person("drag", &[0.05, 0.0, 0.0]))
        .act(7.0, Act::Person("drag", &[0.0, -0.15, 0.0]))
        .run();
    ended.must_be_smooth();
    let most = ended.pressed(0.0, 9.0)[1];
    assert!(most > 3.0, "the wall was not touched: {most} N");
    assert!(most < 15.0, "{most} N, {}", ended.result);
    let [low, high] = ended.pressed(4.0, 5.5);
    assert!(low > 1.0 && high - low < 1.0, "{low} to {high} N");
    assert_eq!(ended.result["stops"], 0, "{}", ended.result);
    assert!(ended.number("last_error_m") < 0.003, "{}", ended.result);
}

#[test]
fn a_ball_that_sweeps_into_a_stated_wall_at_half_a_metre_a_second_costs_less_than_15_n_each_time() {
    let ended = Rig::new("swept", 8.0)
        .cell(WALL)
        .app(STATED)
        .set("task.ball.args.motion=\"sweep\"")
        .set("task.ball.args.reach=[0.0, 0.12, 0.0]")
        .set("task.ball.args.speed=0.5")
        .run();
    ended.must_be_smooth();
    let most = ended.pressed(0.0, 8.0)[1];
    assert!((2.0..15.0).contains(&most), "{most} N");
    assert_eq!(ended.result["stops"], 0, "{}", ended.result);
}

#[test]
fn along_a_stated_wall_the_hand_is_no_slower() {
    let errors = ["", STATED].map(|walls| {
        let ended = Rig::new("along", 7.0)
            .app(walls)
            .set("task.ball.args.motion=\"sweep\"")
            .set("task.ball.args.reach=[0.12, 0.0, 0.0]")
            .set("task.ball.args.speed=0.5")
            .run();
        ended.must_be_smooth();
        ended.number("rms_m")
    });
    assert!((errors[1] / errors[0] - 1.0).abs() < 0.02, "{errors:?} m");
}

#[test]
fn a_hand_that_is_pushed_against_a_wall_presses_evenly() {
    let rig = Rig::new("pushed", 7.0)
        .cell(WALL)
        .set("task.ball.args.motion=\"rest\"");
    let ended = push(rig, 2.0, 6.5).run();
    ended.must_be_smooth();
    let [_, most] = ended.pressed(0.0, 7.0);
    let [low, high] = ended.pressed(4.5, 6.5);
    assert!(most < 15.0, "{most} N, {}", ended.result);
    assert!(low > 1.0 && high - low < 1.0, "{low} to {high} N");
}

#[test]
fn a_table_that_is_pressed_too_hard_cuts_the_power_whatever_tracker_and_guards_want() {
    let mouse = "low_pass_hz = 4.0, null_radius = 0.05, scale = 0.3, clip = 0.3";
    let contact = "touch_n = 900.0, held_n = 900.0, most_n = 900.0";
    // Of harder foam, which is not pressed flat.
    let rig = Rig::new("cut", 8.5)
        .cell(WALL)
        .swap("stiffness = 240.0", "stiffness = 800.0")
        .set("task.ball.args.motion=\"rest\"")
        .set(&format!("task.druide.args.control.contact={{ {contact} }}"))
        .set(&format!("task.druide.args.control.mouse={{ {mouse} }}"));
    let ended = push(rig, 2.0, 3.5)
        .act(4.0, Act::Order("resume"))
        .act(4.5, Act::Reset)
        .act(5.5, Act::Order("resume"))
        .run();
    ended.must_be_smooth();
    assert_eq!(ended.state(1.9), "track", "{:?}", ended.states);
    assert_eq!(ended.state(3.9), "estopped", "{:?}", ended.states);
    let why = ended.result["stopped"].as_str().unwrap();
    assert!(
        why.contains("`wall`") && why.contains("cut the power"),
        "{why}"
    );
    // What it felt, and a little for the time until brakes hold.
    let [_, most] = ended.pressed(0.0, 8.5);
    assert!((25.0..45.0).contains(&most), "{most} N");
    assert_eq!(ended.answer(4.0).0, "not_resumed");
    assert_eq!(ended.answer(5.5).0, "resumed");
    assert_eq!(ended.state(8.4), "track", "{:?}", ended.states);
}

#[test]
fn a_hand_without_foam_ends_in_an_overload_at_a_wall_that_is_smooth_and_waits_for_a_person() {
    let ended = Rig::new("rigid", 5.5)
        .cell(&WALL.replace("cuts_n = 25.0", "cuts_n = 900.0"))
        .swap("stiffness = 240.0", "stiffness = 20000.0")
        .set("task.ball.args.motion=\"sweep\"")
        .set("task.ball.args.reach=[0.0, 0.12, 0.0]")
        .set("task.ball.args.speed=0.3")
        .run();
    ended.must_be_smooth();
    // 3 s later it would have lost its power: an arm that is pressed does not settle.
    assert_eq!(ended.state(5.4), "overload", "{:?}", ended.states);
    assert_eq!(ended.result["stops"], 1, "{}", ended.result);
}

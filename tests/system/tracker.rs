//! The visual and force tracker in virtual time: the arm follows the ball through real pictures, whatever goes wrong.

use serde_json::Value;

use crate::harness::Scratch;

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
    // 4 m/s^2 in 4.5 ms.
    assert!(
        number(result, "max_step_m_s") <= 4.0 * 0.0045 + 1e-6,
        "{result}"
    );
    assert_eq!(result["unread"], 0, "{result}");
    assert_eq!(result["clock_within"], true, "{result}");
}

#[test]
fn a_ball_on_a_circle_is_followed_smoothly_whether_pictures_are_late_or_not() {
    let scratch = Scratch::new();
    for (latency, most) in [("[0.0, 0.0]", 0.005), ("[110.0, 20.0]", 0.012)] {
        let late = format!("task.argus.args.latency_ms={latency}");
        let result = run(&scratch, "circle", 9.0, &["--set", &late]);
        must_be_smooth(&result);
        assert!(number(&result, "tracked") > 0.99, "{result}");
        assert!(number(&result, "rms_m") < most, "{result}");
        assert!(number(&result, "estimate_rms_m") < most, "{result}");
        assert_eq!(result["stops"], 0, "{result}");
    }
}

#[test]
fn without_prediction_the_hand_is_at_least_twice_as_far_from_the_ball() {
    let scratch = Scratch::new();
    let errors = ["true", "false"].map(|prediction| {
        let prediction = format!("task.druide.args.prediction={prediction}");
        let late = "task.argus.args.latency_ms=[110.0, 20.0]";
        let result = run(&scratch, "off", 8.0, &["--set", &prediction, "--set", late]);
        must_be_smooth(&result);
        number(&result, "rms_m")
    });
    assert!(errors[1] > 2.0 * errors[0], "{errors:?} m");
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
fn a_ball_that_is_covered_is_followed_again_when_it_is_seen() {
    let scratch = Scratch::new();
    let covered = "task.ball.args.hidden_s=[[5.0, 5.3], [6.5, 8.0]]";
    let result = run(&scratch, "covered", 11.0, &["--set", covered]);
    must_be_smooth(&result);
    assert_eq!(
        (&result["lost"], &result["expired"]),
        (&2.into(), &1.into()),
        "{result}"
    );
    assert_eq!(
        (&result["phase"], &result["stops"]),
        (&"Track".into(), &0.into()),
        "{result}"
    );
}

#[test]
fn a_vision_chassis_that_is_killed_comes_back_and_so_does_the_hand() {
    let scratch = Scratch::new();
    let fault = "[[fault]]\nkind = \"kill\"\nchassis = \"argus\"\nat_s = 5.0\n";
    scratch.write("kill.toml", fault);
    let result = run(&scratch, "killed", 11.0, &["--faults", "kill.toml"]);
    must_be_smooth(&result);
    assert_eq!(result["phase"], "Track", "{result}");
    assert!(number(&result, "lost") >= 1.0, "{result}");
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
    let scratch = Scratch::new();
    let map = scratch.read("configs/tracker-map.csv");
    let learn = "task.tracker.args.mode=\"learn\"";
    let rest = "task.ball.args.motion=\"rest\"";
    let few = "task.tracker.args.pictures=3";
    // Most of a run is pictures that nobody needs.
    let slow = "task.argus.args.period_ms=200.0";
    let all = ["--set", learn, "--set", rest, "--set", few, "--set", slow];
    let result = run(&scratch, "learn", 1.0, &all);
    assert_eq!(result["examples"], 27, "{result}");
    assert!(number(&result, "checked_rms_m") < 0.002, "{result}");
    let learned = scratch.read("configs/tracker-map.csv");
    assert_eq!(learned.lines().count(), 28);
    assert_ne!(learned, map);
}

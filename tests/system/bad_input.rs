//! Bad input: everything that is wrong in an app is found before anything starts. Each finding has
//! its file, line and column and says what to do.

use serde_json::Value;

use crate::harness::{CTOS, Scratch};

const APP: &str = "configs/calibrate.toml";
const CELL: &str = "configs/cell.toml";
const POSITIONS: &str = "configs/positions.csv";
const DISPATCHER: &str = "configs/nets/dispatcher.net";
const MOTION: &str = "configs/nets/motion.net";
const VISION: &str = "configs/nets/vision.net";

/// One thing that must be found.
struct Expected<'a> {
    /// The file it is in.
    file: &'a str,
    /// Where it is: the only place of this text in the file, after the change.
    at: &'a str,
    /// What the message must contain.
    message: &'a str,
    /// What the help must contain.
    help: &'a str,
}

fn found<'a>(file: &'a str, at: &'a str, message: &'a str, help: &'a str) -> Expected<'a> {
    Expected {
        file,
        at,
        message,
        help,
    }
}

/// What `check --json` finds.
fn check(scratch: &Scratch, sets: &[&str]) -> Vec<Value> {
    let ended = scratch.ctos(&[&["check", APP, "--json"], sets].concat());
    ended.must_exit(3);
    assert_eq!(ended.stderr, "", "{}", ended.told);
    ended.json_lines()
}

fn text<'a>(finding: &'a Value, key: &str) -> &'a str {
    finding[key].as_str().unwrap_or_default()
}

/// The app must be refused for exactly the `expected` errors (warnings may come along). `check` refuses
/// it, and so does `boot`, which must start nothing and show each place.
#[track_caller]
fn refused(scratch: &Scratch, expected: &[Expected<'_>]) {
    let mut findings = check(scratch, &[]);
    findings.retain(|finding| text(finding, "severity") == "error");
    assert_eq!(findings.len(), expected.len(), "{findings:#?}");
    let boot = scratch
        .start(CTOS, &["boot", APP], &[("NO_COLOR", "1")])
        .end();
    boot.must_exit(3).must_say("nothing was started");
    assert_eq!(boot.stdout, "", "{}", boot.told);
    assert!(boot.chassis.is_empty(), "{}", boot.told);
    boot.must_not_say("phase 1");
    for expected in expected {
        let (line, column) = scratch.place(expected.file, expected.at);
        let place = serde_json::json!({ "file": expected.file, "line": line, "column": column });
        let here = findings.iter().find(|finding| {
            finding["place"] == place && text(finding, "message").contains(expected.message)
        });
        let Some(here) = here else {
            panic!("no `{}` at {place}: {findings:#?}", expected.message);
        };
        assert!(text(here, "help").contains(expected.help), "{here:#?}");
        assert!(
            !text(here, "help").is_empty(),
            "does not say what to do: {here:#?}"
        );
        boot.must_say(&format!("[{}:{line}:{column}]", expected.file));
    }
}

/// The app with one change must be refused for one error.
#[track_caller]
fn refused_edit(edit: (&str, &str, &str), expected: Expected<'_>) {
    let scratch = Scratch::new();
    let (file, from, to) = edit;
    scratch.edit(file, from, to);
    refused(&scratch, &[expected]);
}

#[test]
fn an_unknown_handler_is_refused() {
    refused_edit(
        (
            APP,
            "handler = \"coordinators.dom\"",
            "handler = \"coordinators.dmo\"",
        ),
        found(
            APP,
            "\"coordinators.dmo\"",
            "`coordinators.dmo`",
            "did you mean `coordinators.dom`?",
        ),
    );
}

#[test]
fn a_task_that_nobody_is_called_is_refused_where_another_task_needs_it() {
    refused_edit(
        (APP, "judge = \"referee\"", "judge = \"refree\""),
        found(APP, "judge =", "`refree`", "did you mean `referee`?"),
    );
    refused_edit(
        (APP, "state = \"state\"", "state = \"stat\""),
        found(APP, "state = \"stat\"", "`stat`", "did you mean `state`?"),
    );
    refused_edit(
        (APP, "until = \"operator\"", "until = \"operater\""),
        found(
            APP,
            "\"operater\"",
            "`operater`",
            "did you mean `operator`?",
        ),
    );
    refused_edit(
        (
            APP,
            "handler = \"coordinators.dom\"",
            "handler = \"coordinators.dom\"\non = \"ws1\"\n\n[task.second]\nhandler = \"coordinators.operator\"\nargs = { dispatcher = \"dispatchr\", command = \"c\", success = \"s\" }",
        ),
        found(
            APP,
            "dispatcher = \"dispatchr\"",
            "`dispatchr`",
            "did you mean `dispatcher`?",
        ),
    );
}

#[test]
fn an_unknown_chassis_and_an_unknown_processor_are_refused() {
    refused_edit(
        (
            APP,
            "\"mcs.servo\"\non = \"cage_motion/servo\"",
            "\"mcs.servo\"\non = \"cage_moton/servo\"",
        ),
        found(
            APP,
            "\"cage_moton/servo\"",
            "`cage_moton`",
            "did you mean `cage_motion`?",
        ),
    );
    refused_edit(
        (
            APP,
            "\"mcs.servo\"\non = \"cage_motion/servo\"",
            "\"mcs.servo\"\non = \"cage_motion/srvo\"",
        ),
        found(
            APP,
            "\"cage_motion/srvo\"",
            "`srvo`",
            "did you mean `servo`?",
        ),
    );
    refused_edit(
        (APP, "on = \"cage_vision\"", "on = \"cage_vison\""),
        found(
            APP,
            "\"cage_vison\"",
            "`cage_vison`",
            "did you mean `cage_vision`?",
        ),
    );
}

#[test]
fn an_unknown_command_or_task_in_a_send_of_a_net_is_refused() {
    let send = |what| (MOTION, "  do find_pos", what);
    refused_edit(
        send("  send mcs.read_positon(-> position)"),
        found(
            MOTION,
            "mcs.read_positon",
            "no command `read_positon`",
            "did you mean `read_position`?",
        ),
    );
    refused_edit(
        send("  send msc.read_position(-> position)"),
        found(MOTION, "msc.read_position", "`msc`", "did you mean `mcs`?"),
    );
}

#[test]
fn an_unknown_driver_frame_source_or_vision_service_is_refused() {
    refused_edit(
        (APP, "\"sim.arm\"", "\"sim.amr\""),
        found(APP, "driver = ", "`sim.amr`", "did you mean `sim.arm`?"),
    );
    refused_edit(
        (
            APP,
            "[vss.cameras.ceiling_east]\nsource = \"sim.camera\"",
            "[vss.cameras.ceiling_east]\nsource = \"sim.camrea\"",
        ),
        found(
            APP,
            "\"sim.camrea\"",
            "`sim.camrea`",
            "did you mean `sim.camera`?",
        ),
    );
    let scratch = Scratch::new();
    scratch.edit(APP, "\"Calibrate\"", "\"Calibarte\"");
    let unknown = found(
        APP,
        "\"Calibarte\"",
        "`Calibarte`",
        "did you mean `Calibrate`?",
    );
    refused(&scratch, &[unknown]);
}

#[test]
fn an_unknown_camera_is_refused() {
    refused_edit(
        (APP, "\"ceiling_east\"]", "\"ceiling_est\"]"),
        found(
            APP,
            "\"ceiling_est\"",
            "`ceiling_est`",
            "did you mean `ceiling_east`?",
        ),
    );
    refused_edit(
        (CELL, "name = \"ceiling_west\"", "name = \"ceiling_wst\""),
        found(
            APP,
            "cell = \"cell.toml\"\n\n[vss.cameras.ceiling_east]",
            "`ceiling_west`",
            "did you mean `ceiling_wst`?",
        ),
    );
}

#[test]
fn files_that_include_each_other_are_refused_with_the_circle() {
    let scratch = Scratch::new();
    scratch.edit(APP, "[app]\n", "include = [\"common.toml\"]\n\n[app]\n");
    scratch.write("configs/common.toml", "include = [\"more.toml\"]\n");
    scratch.write("configs/more.toml", "include = [\"calibrate.toml\"]\n");
    let circle = "configs/calibrate.toml -> configs/common.toml -> configs/more.toml -> configs/calibrate.toml";
    refused(
        &scratch,
        &[found(
            "configs/more.toml",
            "\"calibrate.toml\"",
            circle,
            "third file",
        )],
    );
}

#[test]
fn a_missing_include_is_refused() {
    refused_edit(
        (APP, "[app]\n", "include = [\"absent.toml\"]\n\n[app]\n"),
        found(
            APP,
            "\"absent.toml\"",
            "cannot read `configs/absent.toml`",
            "check the path",
        ),
    );
}

#[test]
fn a_task_that_stands_twice_is_refused() {
    let scratch = Scratch::new();
    scratch.edit(
        APP,
        "[task.world]\nhandler = \"sim.world\"\non = \"cage_motion/servo\"",
        "[task.world]\nhandler = \"sim.world\"\non = \"cage_motion/servo\"\n\n[task.world]\n",
    );
    let text = scratch.read(APP);
    let second = text.rfind("[task.world]").unwrap();
    let line = text[..second].matches('\n').count() + 1;
    let findings = check(&scratch, &[]);
    let [finding] = &findings[..] else {
        panic!("{findings:#?}");
    };
    assert_eq!(finding["place"]["line"], line, "{finding:#?}");
    assert_eq!(finding["place"]["column"], 7, "{finding:#?}");
    assert!(
        finding["message"].as_str().unwrap().contains("duplicate"),
        "{finding:#?}"
    );
    assert!(
        finding["help"].as_str().unwrap().contains("rename"),
        "{finding:#?}"
    );
}

#[test]
fn an_unknown_key_is_refused() {
    refused_edit(
        (APP, "seed = 1\n", "sed = 1\n"),
        found(APP, "sed = 1", "`sed`", "did you mean `seed`?"),
    );
    refused_edit(
        (APP, "stop_first = true", "stop_frist = true"),
        found(
            APP,
            "stop_frist",
            "`stop_frist`",
            "did you mean `stop_first`?",
        ),
    );
    refused_edit(
        (APP, "period_ms = 4.5\n", "perod_ms = 4.5\n"),
        found(APP, "perod_ms", "`perod_ms`", "did you mean `period_ms`?"),
    );
    refused_edit(
        (APP, "retries = 2", "retires = 2"),
        found(APP, "retires", "`retires`", "did you mean `retries`?"),
    );
    refused_edit(
        (APP, "max_sigma_px = 4.0", "max_sigma = 4.0"),
        found(
            APP,
            "max_sigma =",
            "`max_sigma`",
            "did you mean `max_sigma_px`?",
        ),
    );
}

#[test]
fn a_value_of_the_wrong_type_is_refused_at_the_value() {
    for (from, to, at, message) in [
        (
            "period_ms = 4.5\n",
            "period_ms = \"fast\"\n",
            "\"fast\"",
            "expected a number",
        ),
        ("seed = 1\n", "seed = \"one\"\n", "\"one\"", "whole number"),
        (
            "stop_first = true",
            "stop_first = \"yes\"",
            "\"yes\"",
            "true or false",
        ),
        (
            "retries = 2",
            "retries = -2",
            "-2",
            "expected a whole number",
        ),
    ] {
        let scratch = Scratch::new();
        scratch.edit(APP, from, to);
        let findings = check(&scratch, &[]);
        let [finding] = &findings[..] else {
            panic!("{findings:#?}");
        };
        let (line, column) = scratch.place(APP, at);
        let place = serde_json::json!({ "file": APP, "line": line, "column": column });
        assert_eq!(finding["place"], place, "{finding:#?}");
        assert!(
            finding["message"].as_str().unwrap().contains(message),
            "{finding:#?}"
        );
    }
}

#[test]
fn a_place_that_no_net_has_is_refused() {
    refused_edit(
        (
            VISION,
            "  do find_spot\n  out VC_done",
            "  do find_spot\n  out VC_dnoe",
        ),
        found(
            VISION,
            "VC_dnoe",
            "no place `VC_dnoe`",
            "did you mean `VC_done`?",
        ),
    );
    refused_edit(
        (
            VISION,
            "  do find_spot\n  out VC_done",
            "  do find_spot\n  out VC_done, spot_don@dispatcher",
        ),
        found(
            VISION,
            "spot_don@",
            "no place `spot_don`",
            "did you mean `spot_done`?",
        ),
    );
    refused_edit(
        (
            VISION,
            "  do find_spot\n  out VC_done",
            "  do find_spot\n  out VC_done, spot_done@dispatchr",
        ),
        found(
            VISION,
            "spot_done@dispatchr",
            "`dispatchr`",
            "did you mean `dispatcher`?",
        ),
    );
}

#[test]
fn a_function_that_the_library_does_not_have_is_refused() {
    refused_edit(
        (DISPATCHER, "do compute_calib", "do compute_calbi"),
        found(
            DISPATCHER,
            "compute_calbi",
            "`compute_calbi`",
            "did you mean `compute_calib`?",
        ),
    );
    let scratch = Scratch::new();
    for when in ["when more_positions", "when not more_positions"] {
        scratch.edit(DISPATCHER, when, &when.replace("positions", "postions"));
    }
    let unknown = |at| {
        found(
            DISPATCHER,
            at,
            "`more_postions`",
            "did you mean `more_positions`?",
        )
    };
    refused(
        &scratch,
        &[
            unknown("more_postions\n  do store_point\n  idempotent\n  out loop_ready"),
            unknown("more_postions\n  do store_point\n  idempotent\n  out points_complete"),
        ],
    );
}

#[test]
fn nets_that_can_deadlock_are_refused_with_the_way_there() {
    refused_edit(
        (
            VISION,
            "transition skip_spot\n  in spot_missed\n  when not tries_left\n  out VC_failed\n",
            "",
        ),
        found(
            DISPATCHER,
            "pos_done data position",
            "vision.spot_missed",
            "pair it with its negation",
        ),
    );
}

#[test]
fn nets_that_can_grow_without_bound_are_refused_with_the_round_that_adds() {
    refused_edit(
        (
            DISPATCHER,
            "  out robot_available, camera_available\n  write calibration_done",
            "  out robot_available, camera_available*2\n  write calibration_done",
        ),
        found(
            DISPATCHER,
            "camera_available = 1",
            "without bound",
            "semaphore",
        ),
    );
}

#[test]
fn a_missing_file_is_refused_where_it_is_named() {
    refused_edit(
        (APP, "net = \"nets/motion.net\"", "net = \"nets/moton.net\""),
        found(
            APP,
            "\"nets/moton.net\"",
            "cannot read `configs/nets/moton.net`",
            "check the path",
        ),
    );
    refused_edit(
        (APP, "\"positions.csv\"", "\"postions.csv\""),
        found(
            APP,
            "positions = ",
            "cannot read `configs/postions.csv`",
            "check the path",
        ),
    );
    refused_edit(
        (APP, "{ cell = \"cell.toml\"", "{ cell = \"cel.toml\""),
        found(
            APP,
            "cell = \"cel.toml\"",
            "cannot read `configs/cel.toml`",
            "check the path",
        ),
    );
    let scratch = Scratch::empty();
    let ended = scratch.ctos(&["boot", "absent.toml"]);
    ended.must_exit(3).must_say("cannot read `absent.toml`");
}

/// The app with another file of positions; `at` is where the error must be.
#[track_caller]
fn refused_positions(content: &str, at: &str, message: &str) {
    let scratch = Scratch::new();
    scratch.write(POSITIONS, content);
    refused(&scratch, &[found(POSITIONS, at, message, "")]);
}

/// A sound file of few positions with its `row`th data line replaced.
fn with_row(row: usize, text: &str) -> String {
    let scratch = Scratch::short();
    let content = scratch.read(POSITIONS);
    let mut lines: Vec<&str> = content.lines().collect();
    lines[row] = text;
    lines.join("\n") + "\n"
}

#[test]
fn a_position_that_is_no_number_is_refused_at_the_number() {
    for word in ["NaN", "inf", "-inf", "much"] {
        let row = format!("0.3507,-0.7190,{word},50.000,0.000,26.000");
        refused_positions(&with_row(3, &row), word, &format!("`{word}`"));
    }
}

#[test]
fn a_position_out_of_reach_is_refused_at_its_line() {
    let row = "2.3507,-0.7190,0.4,50.000,0.000,26.000";
    refused_positions(&with_row(5, row), row, "out of reach");
    let scratch = Scratch::new();
    scratch.write(POSITIONS, with_row(5, row));
    let far = check(&scratch, &[]);
    let message = text(&far[0], "message");
    assert!(message.contains(" m"), "says no distance: {message}");
}

#[test]
fn a_file_of_two_lines_or_of_too_few_positions_is_refused() {
    let header = "x,y,z,roll,pitch,yaw";
    let row = "0.3507,-0.7190,0.4,50.000,0.000,26.000";
    refused_positions(
        &format!("{header}\n{row}\n"),
        header,
        "1 positions are too few",
    );
    let sound = with_row(0, header);
    let eleven: Vec<&str> = sound.lines().take(12).collect();
    refused_positions(&eleven.join("\n"), header, "11 positions are too few");
    refused_positions(&format!("{header}\n"), header, "0 positions are too few");
}

#[test]
fn positions_all_in_one_plane_are_refused() {
    let scratch = Scratch::new();
    let all = scratch.read(POSITIONS);
    let flat: Vec<&str> = all
        .lines()
        .filter(|line| line.starts_with("x,") || line.contains(",1.0000,"))
        .collect();
    assert!(flat.len() > 12);
    refused_positions(&flat.join("\n"), "x,y,z", "in one plane");
}

#[test]
fn a_file_of_garbage_is_refused() {
    let rubbish: Vec<u8> = (0..4096_u32)
        .map(|n| (n * 167 + n * n * 31) as u8)
        .collect();
    let scratch = Scratch::new();
    scratch.write(POSITIONS, &rubbish);
    let findings = check(&scratch, &[]);
    assert!(
        text(&findings[0], "message").contains("not UTF-8"),
        "{findings:#?}"
    );
    for content in ["", "hello\n", "0.3,0.3,0.3,0,0,0\n", "\n\n\n"] {
        scratch.write(POSITIONS, content);
        let findings = check(&scratch, &[]);
        let [finding] = &findings[..] else {
            panic!("{findings:#?}");
        };
        assert_eq!(finding["place"]["file"], POSITIONS, "{content:?}");
        assert!(
            text(finding, "message").contains("x,y,z,roll,pitch,yaw"),
            "{finding:#?}"
        );
    }
    for (file, content) in [
        (APP, &rubbish[..]),
        (CELL, &rubbish),
        (MOTION, &rubbish),
        (MOTION, b"net"),
        (VISION, b""),
    ] {
        let scratch = Scratch::new();
        scratch.write(file, content);
        let findings = check(&scratch, &[]);
        let name = findings
            .iter()
            .any(|finding| finding.to_string().contains(file));
        assert!(name, "{file}: {findings:#?}");
    }
}

#[test]
fn rows_with_too_few_or_too_many_numbers_are_refused_at_their_lines() {
    let short = "0.3507,-0.7190,0.4,50.000,0.000";
    let long = "0.3507,-0.7190,0.4,50.000,0.000,26.000,7.5";
    let scratch = Scratch::new();
    let text = with_row(2, short);
    let lines: Vec<&str> = text.lines().collect();
    let both = [&lines[..6], &[long], &lines[7..]].concat().join("\n");
    scratch.write(POSITIONS, both);
    let findings = check(&scratch, &[]);
    let places: Vec<&Value> = findings
        .iter()
        .map(|finding| &finding["place"]["line"])
        .collect();
    assert_eq!(places, [3, 7], "{findings:#?}");
}

#[test]
fn a_wrong_cell_file_is_refused_once_at_its_place() {
    refused_edit(
        (CELL, "brightness = 80.0", "brightnes = 80.0"),
        found(
            CELL,
            "brightnes = ",
            "`brightnes`",
            "did you mean `brightness`?",
        ),
    );
    refused_edit(
        (CELL, "fx = 418.6", "fx = -1.0"),
        found(CELL, "-1.0", "fx is -1 px", "50000 px"),
    );
    refused_edit(
        (CELL, "radius = 0.012", "radius = nan"),
        found(CELL, "nan", "NaN", "give a number"),
    );
}

#[test]
fn a_wrong_set_is_refused_at_its_column() {
    for (set, column, message, help) in [
        ("app.sed=1", 5, "`sed`", "did you mean `seed`?"),
        (
            "task.motoin.args.speed=1",
            6,
            "`motoin`",
            "did you mean `motion`?",
        ),
        (
            "task.motion.args.sped=1",
            18,
            "`sped`",
            "did you mean `speed`?",
        ),
        ("task.motion.on=\"cage\"", 16, "`cage`", "cage_motion"),
        (
            "time.mode=\"virtaul\"",
            11,
            "`virtaul`",
            "did you mean `virtual`?",
        ),
        ("seed", 1, "no `=`", "write --set"),
    ] {
        let scratch = Scratch::new();
        let findings = check(&scratch, &["--set", set]);
        let [finding] = &findings[..] else {
            panic!("{set}: {findings:#?}");
        };
        let place = serde_json::json!({ "file": "--set", "line": 1, "column": column });
        assert_eq!(finding["place"], place, "{set}");
        assert!(text(finding, "message").contains(message), "{finding:#?}");
        assert!(text(finding, "help").contains(help), "{finding:#?}");
        let boot = scratch.boot(&["--set", set]);
        boot.must_exit(3).must_say("nothing was started");
        assert!(boot.chassis.is_empty());
    }
}

#[test]
fn several_mistakes_in_several_files_are_all_shown_at_once() {
    let scratch = Scratch::new();
    scratch.edit(APP, "retries = 2", "retires = 2");
    scratch.edit(APP, "judge = \"referee\"", "judge = \"refree\"");
    scratch.edit(CELL, "fx = 418.6", "fx = -1.0");
    scratch.edit(CELL, "fx = 414.9", "fx = 0.0");
    scratch.edit(MOTION, "do plan_path", "do plan_pth");
    scratch.write(
        POSITIONS,
        with_row(3, "0.3507,much,0.4,50.000,0.000,26.000"),
    );
    refused(
        &scratch,
        &[
            found(APP, "retires", "`retires`", "retries"),
            found(APP, "judge =", "`refree`", "referee"),
            found(CELL, "-1.0", "fx is -1 px", "px"),
            found(CELL, "0.0\nfy = 416.3", "fx is 0 px", "px"),
            found(MOTION, "plan_pth", "`plan_pth`", "plan_path"),
            found(POSITIONS, "much", "`much`", "number"),
        ],
    );
    let boot = scratch.boot(&[]);
    boot.must_say("6 errors; nothing was started");
}

#[test]
fn a_task_on_an_unknown_chassis_is_looked_at_with_the_others() {
    let scratch = Scratch::new();
    scratch.edit(APP, "retries = 2", "retires = 2");
    scratch.edit(APP, "judge = \"referee\"", "judge = \"refree\"");
    let findings = check(
        &scratch,
        &[
            "--set",
            "task.referee.on=\"wss1\"",
            "--set",
            "task.motion.on=\"cage_moton\"",
            "--set",
            "task.motion.handler=\"coordinators.moton\"",
        ],
    );
    let codes = findings.iter().map(|finding| text(finding, "code"));
    let mut codes: Vec<_> = codes.collect();
    codes.sort_unstable();
    let expected = [
        "unknown_chassis",
        "unknown_chassis",
        "unknown_handler",
        "unknown_key",
        "unknown_task",
    ];
    assert_eq!(codes, expected.map(|code| format!("ctos::config::{code}")));
}

#[test]
fn one_pass_finds_what_is_wrong_in_configuration_nets_and_data_files_of_one_app() {
    // Every task is there, so what is wrong between them is found, too.
    let scratch = Scratch::new();
    scratch.edit(APP, "retries = 2", "retires = 2");
    scratch.edit(APP, "judge = \"referee\"", "judge = \"refree\"");
    scratch.edit(MOTION, "do plan_path", "do plan_pth");
    scratch.edit(VISION, "  in I_find_spot", "  in I_find_spt");
    scratch.edit(VISION, "do retry_find_spot", "do retry_find_spt");
    let on = "task.motion.on=\"cage_moton\"";
    let findings = check(&scratch, &["--set", on]);
    let codes = |findings: &[Value]| {
        let codes = findings
            .iter()
            .map(|finding| text(finding, "code").to_owned());
        let mut codes: Vec<String> = codes.collect();
        codes.sort_unstable();
        codes
    };
    let named = [
        "ctos::config::unknown_chassis",
        "ctos::config::unknown_key",
        "ctos::config::unknown_task",
        "pnt::net::unknown_function",
        "pnt::net::unknown_function",
        "pnt::net::unknown_place",
    ];
    assert_eq!(codes(&findings), named, "{findings:#?}");
    // What an include that is not there might have held is no mistake; the rest is found beside it.
    let text = scratch.read(APP);
    scratch.write(
        APP,
        format!(
            "include = [\"none.toml\"]\n{}",
            text.replacen("include = ", "# ", 1)
        ),
    );
    let findings = check(&scratch, &["--set", on]);
    let codes = codes(&findings);
    for code in [
        "ctos::file::unreadable",
        "ctos::config::unknown_key",
        "pnt::net::unknown_function",
        "pnt::net::unknown_place",
    ] {
        assert!(codes.iter().any(|one| one == code), "{code}: {findings:#?}");
    }
    assert!(
        !codes
            .iter()
            .any(|code| code == "ctos::config::unknown_task"),
        "{findings:#?}"
    );
}

#[test]
fn what_a_daemon_of_service_objects_is_given_is_found_by_the_check() {
    let daemon = "[profile.objects.task.objects]\nhandler = \"sorma.daemon\"\non = \"ws1\"\n";
    let scratch = Scratch::new();
    for (args, said) in [
        (
            "args.dictonary = [\"objects.dict\"]",
            "unknown key `dictonary`",
        ),
        ("args.dictionary = [\"none.dict\"]", "none.dict"),
    ] {
        let text = scratch.read(APP);
        scratch.edit(APP, daemon, &format!("{daemon}{args}\n"));
        let findings = check(&scratch, &["--profile", "objects"]);
        assert_eq!(findings.len(), 1, "{findings:#?}");
        assert!(text_of(&findings).contains(said), "{findings:#?}");
        let (line, _) = scratch.place(APP, args);
        assert_eq!(findings[0]["place"]["line"], line, "{findings:#?}");
        scratch.write(APP, text);
    }
}

fn text_of(findings: &[Value]) -> String {
    findings
        .iter()
        .map(|found| text(found, "message"))
        .collect()
}

#[test]
fn an_app_of_another_folder_that_includes_one_has_the_files_that_this_one_names() {
    let scratch = Scratch::new();
    std::fs::create_dir(scratch.path("mine")).unwrap();
    scratch.write(
        "mine/app.toml",
        "include = [\"../configs/calibrate.toml\"]\n",
    );
    let checked = scratch.ctos(&["check", "mine/app.toml"]);
    checked.must_exit(0).must_say("nothing found");
    scratch.edit(
        APP,
        "positions = \"positions.csv\"",
        "positions = \"other.csv\"",
    );
    let checked = scratch.ctos(&["check", "mine/app.toml"]);
    checked
        .must_exit(3)
        .must_say("it is looked for in the folder of the app's file, then in those of the files that it includes");
    // A file of the app's own comes before one of that name elsewhere.
    scratch.write("mine/other.csv", scratch.read(POSITIONS));
    scratch.ctos(&["check", "mine/app.toml"]).must_exit(0);
    let ended = scratch.ctos(&["boot", "mine/app.toml", "--set", "time.mode=virtual"]);
    ended.must_exit(0);
}

#[test]
fn a_port_in_use_is_found_by_the_check_and_named_by_the_option_that_was_typed() {
    let scratch = Scratch::new();
    let other = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let at = other.local_addr().unwrap().to_string();
    let metrics = format!("metrics.listen={at:?}");
    let checked = scratch.ctos(&["check", APP, "--set", &metrics]);
    checked
        .must_exit(0)
        .must_say(&format!("[metrics] cannot listen on {at} here"))
        .must_say("if this app is running, it has the port itself")
        .must_say("1 warning");
    let display = format!("--display={at}");
    let booted = scratch.boot(&[&display]);
    booted
        .must_exit(3)
        .must_say(&format!("`{display}`: no page can be served there"))
        .must_say("`--display=127.0.0.1:0`")
        .must_not_say("phase 1");
    let foxglove = format!("--foxglove={at}");
    let booted = scratch.boot(&[&foxglove]);
    booted
        .must_exit(3)
        .must_say(&format!("`{foxglove}`: no viewer can be served there"))
        .must_say("`--foxglove=127.0.0.1:0`")
        .must_not_say("phase 1");
    let booted = scratch.boot(&["--foxglove=0.0.0.0:0"]);
    booted
        .must_exit(3)
        .must_say("where others can reach it, needs keys")
        .must_say("ctos keys new");
    let panel = format!("task.panel.args.listen={at:?}");
    let booted = scratch.boot(&["--profile", "panel", "--set", &panel]);
    booted
        .must_exit(3)
        .must_say(&format!("the page of task `panel` cannot listen on {at}"))
        .must_not_say("phase 1");
    for (set, who) in [
        ("metrics.listen", "[metrics]"),
        ("control.listen", "[control]"),
        ("app.listen", "the boot"),
        ("chassis.cage_motion.listen", "chassis `cage_motion`"),
    ] {
        let set = format!("{set}={at:?}");
        let says = format!("{who} cannot listen on {at} here");
        let checked = scratch.ctos(&["check", APP, "--set", &set]);
        checked.must_exit(0).must_say(&says);
        let booted = scratch.boot(&["--set", &set]);
        booted
            .must_exit(3)
            .must_say(&says)
            .must_say("--set")
            .must_not_say("chassis  cage_motion  pid")
            .must_not_say("phase 1");
    }
}

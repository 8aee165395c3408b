//! Every error of the app's own tables, with its exact place.

use super::*;
use crate::diagnostic::Severity;

#[test]
fn toml_errors_come_all_at_once_with_their_places() {
    let lines = refused(load_one("[app]\nseed = \nname = \"x\n[task.a]\n[task.a]\n"));
    let places: Vec<_> = lines
        .iter()
        .filter_map(|line| line.split(": error").next())
        .collect();
    assert_eq!(
        places,
        ["app.toml:2:8", "app.toml:3:10", "app.toml:5:7"],
        "{lines:#?}"
    );
    let lines = refused(load_one("[app]\nseed = 1\nseed = 2\n"));
    assert_eq!(
        lines,
        [
            "app.toml:3:1: error: this is not valid TOML: duplicate key (a key, or a table, stands once in a file: rename it or take it out)"
        ]
    );
}

#[test]
fn unknown_keys_anywhere_are_errors_with_the_nearest_name() {
    refused_line(
        "",
        "[tsak.b]",
        "app.toml:6:2: error: unknown key `tsak` at the top level (did you mean `task`?)",
    );
    refused_line(
        "[app]",
        "sed = 3",
        "app.toml:6:1: error: unknown key `sed` in [app] (did you mean `seed`?)",
    );
    refused_line(
        "[time]",
        "mod = \"real\"",
        "app.toml:6:1: error: unknown key `mod` in [time] (did you mean `mode`?)",
    );
    refused_line(
        "[chassis.b]",
        "listne = \"\"",
        "app.toml:6:1: error: unknown key `listne` in chassis `b` (did you mean `listen`?)",
    );
    refused_line(
        "[chassis.b]",
        "processors.x = { rt = true }",
        "app.toml:6:18: error: unknown key `rt` in processor `b/x` (known here: cpu, overrun, period_s, priority, realtime, spin_us)",
    );
    refused_line(
        "queue = 3",
        "restrat = \"never\"",
        "app.toml:6:1: error: unknown key `restrat` in task `a` (did you mean `restart`?)",
    );
}

#[test]
fn wrong_types_and_absurd_values_are_errors_at_the_value() {
    let cases = [
        (
            "[app]",
            "seed = -1",
            "app.toml:6:8: error: [app]: `seed` must be a whole number from 0 to 18446744073709551615, found -1",
        ),
        (
            "[app]",
            "seed = 18446744073709551616",
            "app.toml:6:8: error: [app]: `seed` must be a whole number from 0 to 18446744073709551615, found 18446744073709551616",
        ),
        (
            "[app]",
            "seed = \"1\"",
            "app.toml:6:8: error: [app]: `seed` must be a whole number from 0 to 18446744073709551615, found \"1\"",
        ),
        (
            "[app]",
            "name = \"\"",
            "app.toml:6:8: error: [app]: `name` must be a text that is not empty, found \"\"",
        ),
        (
            "[app]",
            "name = 5",
            "app.toml:6:8: error: [app]: `name` must be a string, found 5",
        ),
        (
            "[app]",
            "phase_timeout_s = -1",
            "app.toml:6:19: error: [app]: `phase_timeout_s` must be a number of seconds above 0 and at most 3600, found -1",
        ),
        (
            "[app]",
            "stop_timeout_s = nan",
            "app.toml:6:18: error: [app]: `stop_timeout_s` must be a number of seconds above 0 and at most 3600, found NaN",
        ),
        (
            "[app]",
            "stop_timeout_s = inf",
            "app.toml:6:18: error: [app]: `stop_timeout_s` must be a number of seconds above 0 and at most 3600, found inf",
        ),
        (
            "[app]",
            "until = \"aa\"",
            "app.toml:6:9: error: `until` waits for the task `aa`, which does not exist (did you mean `a`?)",
        ),
        (
            "[time]",
            "mode = \"virtaul\"",
            "app.toml:6:8: error: [time]: unknown choice `virtaul` for `mode` (did you mean `virtual`?)",
        ),
        (
            "[chassis.b]",
            "listen = \"localhost\"",
            "app.toml:6:10: error: chassis `b`: `listen` must be an address such as \"127.0.0.1:0\", found \"localhost\"",
        ),
        (
            "[chassis.b]",
            "stop_first = 1",
            "app.toml:6:14: error: chassis `b`: `stop_first` must be true or false, found 1",
        ),
        (
            "[chassis.b]",
            "processors = 3",
            "app.toml:6:14: error: chassis `b`: `processors` must be a table, found 3",
        ),
        (
            "[chassis.b]",
            "processors.x.priority = 100",
            "app.toml:6:25: error: processor `b/x`: `priority` must be a whole number from 1 to 99, found 100",
        ),
        (
            "[chassis.b]",
            "processors.\"x/y\" = {}",
            "app.toml:6:12: error: `x/y` cannot be the name of a processor (names are 1 to 64 letters, digits, `_`, `-` or `.`)",
        ),
        (
            "",
            "queue = 0",
            "app.toml:6:9: error: task `a`: `queue` must be a whole number from 1 to 65536, found 0",
        ),
        (
            "",
            "queue = 1.5",
            "app.toml:6:9: error: task `a`: `queue` must be a whole number from 1 to 65536, found 1.5",
        ),
        (
            "",
            "restart = \"allways\"",
            "app.toml:6:11: error: task `a`: unknown choice `allways` for `restart` (did you mean `always`?)",
        ),
        (
            "",
            "call_deadline_s = 0",
            "app.toml:6:19: error: task `a`: `call_deadline_s` must be a number of seconds above 0 and at most 86400, found 0",
        ),
        (
            "",
            "args = 3",
            "app.toml:6:8: error: task `a`: `args` must be a table, found 3",
        ),
        (
            "",
            "queue = 1_000_000_000_000_000_000_000_000_000_000_000_000_000",
            "app.toml:6:9: error: this integer is too large to be represented",
        ),
    ];
    for (table, line, expected) in cases {
        refused_line(table, line, expected);
    }
}

#[test]
fn names_that_nobody_has_are_errors_at_the_name_with_the_nearest_one() {
    let text = CELL.replace("on = \"cage_motion/main\"", "on = \"cage_moton/main\"");
    assert_eq!(
        refused(load_one(&text)),
        ["app.toml:17:6: error: there is no chassis `cage_moton` (did you mean `cage_motion`?)"]
    );
    let text = CELL.replace("on = \"cage_motion/main\"", "on = \"cage_motion/servos\"");
    assert_eq!(
        refused(load_one(&text)),
        [
            "app.toml:17:6: error: chassis `cage_motion` has no processor `servos` (did you mean `servo`?)"
        ]
    );
    let text = CELL.replace("until = \"operator\"", "until = \"oprator\"");
    assert_eq!(
        refused(load_one(&text)),
        [
            "app.toml:2:9: error: `until` waits for the task `oprator`, which does not exist (did you mean `operator`?)"
        ]
    );
    assert_eq!(
        refused(load_one("[task.a]\nhandler = \"h\"\non = \"ws1\"\n")),
        ["app.toml:3:6: error: there is no chassis `ws1` (declare it: [chassis.ws1])"]
    );
}

#[test]
fn what_a_task_needs_is_asked_for_at_its_name() {
    assert_eq!(
        refused(load_one("[chassis.w]\n\n[task.a]\nqueue = 2\n")),
        [
            "app.toml:3:7: error: task `a` has no `handler` (add handler = \"NAME\", the handler that this task runs)",
            "app.toml:3:7: error: task `a` has no `on` (add on = \"CHASSIS\" or on = \"CHASSIS/PROCESSOR\")",
        ]
    );
    assert_eq!(
        refused(load_one("[task]\na = 3\n")),
        ["app.toml:2:5: error: task `a`: expected a table of keys, found 3"]
    );
    assert_eq!(
        refused(load_one("task = 3\n")),
        ["app.toml:1:1: error: `task` holds named tables, found an integer (write [task.NAME])"]
    );
    assert!(
        refused(load_one(""))[0].starts_with("app.toml:1:1: error: this app has no task to run")
    );
}

#[test]
fn all_that_is_wrong_is_found_in_one_go_in_order_of_place() {
    let text = CELL
        .replace("until", "untli")
        .replace("priority = 80", "priority = 800")
        .replace("on = \"ws1\"", "on = \"ws2\"")
        .replace("queue = 16", "queue = 0");
    let lines = refused(load_one(&text));
    let places: Vec<_> = lines
        .iter()
        .filter_map(|line| line.split(": error").next())
        .collect();
    assert_eq!(
        places,
        [
            "app.toml:2:1",
            "app.toml:8:50",
            "app.toml:13:6",
            "app.toml:18:9"
        ],
        "{lines:#?}"
    );
}

#[test]
fn what_has_no_effect_is_a_warning_and_the_app_is_made() {
    let text = "[chassis.w]\nprocessors.m = { priority = 3 }\n[chassis.idle]\n[task.a]\nhandler = \"h\"\non = \"w\"\nmax_restarts = 2\n";
    let app = load_one(text).unwrap();
    assert!(
        app.warnings
            .iter()
            .all(|finding| finding.severity == Severity::Warning)
    );
    let lines: Vec<_> = app
        .warnings
        .into_sorted()
        .iter()
        .map(ToString::to_string)
        .collect();
    assert_eq!(
        lines,
        [
            "app.toml:2:29: warning: a priority without `realtime = true` has no effect",
            "app.toml:3:10: warning: no task is on chassis `idle`",
            "app.toml:7:16: warning: `max_restarts` has no effect where nothing is restarted (add restart = \"on-failure\" or restart = \"always\")",
        ]
    );
}

#[test]
fn two_chassis_cannot_listen_at_one_address() {
    let text = format!(
        "{CELL}[chassis.b]\nlisten = \"127.0.0.1:7000\"\n[chassis.c]\nlisten = \"127.0.0.1:7000\"\n"
    );
    assert!(
        refused(load_one(&text))[0]
            .starts_with("app.toml:27:1: error: chassis `b` and `c` listen at the same address")
    );
}

#[test]
fn a_thousand_chassis_are_taken_and_more_processors_than_a_task_id_can_tell_apart_are_refused() {
    let rest = "[task.a]\nhandler = \"h\"\non = \"c0\"\n";
    let chassis = |count: usize| {
        let all: String = (0..count).map(|n| format!("[chassis.c{n}]\n")).collect();
        load_one(&format!("{all}{rest}"))
    };
    // To read as many as are refused, 65,535, takes a minute; those of processors are counted in the same way.
    assert!(chassis(1000).is_ok());
    let processors = |count: usize| {
        let all: String = (0..count).map(|n| format!("p{n} = {{}}\n")).collect();
        load_one(&format!("[chassis.c0.processors]\n{all}{rest}"))
    };
    assert!(processors(255).is_ok());
    assert_eq!(
        refused(processors(256)),
        [
            "app.toml:257:1: error: a chassis has room for 255 processors, and this is one of 256 (put more tasks on one processor)"
        ]
    );
}

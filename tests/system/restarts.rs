//! Chassis whose processes are killed and come back, with real processes on the real clock.

use crate::harness::{Ended, MISBEHAVING, Run, Scratch};

const APP: &str = r#"
[app]
until = "caller"
stop_timeout_s = 2

[chassis.desk]

[chassis.side]

[chassis.cage]
restart = "on-failure"
max_restarts = 2
restart_backoff_s = 0.1

[task.arm]
handler = "test.steady"
on = "cage"
args = { slow_s = 0.2 }

[task.hand]
handler = "test.steady"
on = "cage"
args = { slow_s = 0.2 }

[task.other]
handler = "test.steady"
on = "side"
args = { slow_s = 0.0 }

[task.caller]
handler = "test.caller"
on = "desk"
args = { calls = "arm", enough = 40 }
"#;

fn scratch() -> Scratch {
    let scratch = Scratch::empty();
    scratch.write("app.toml", APP);
    scratch
}

fn start<'a>(scratch: &'a Scratch, arguments: &[&str]) -> Run<'a> {
    let all = [&["boot", "app.toml"], arguments].concat();
    scratch.start(MISBEHAVING, &all, &[])
}

fn must_have_survived(ended: &Ended) {
    ended
        .must_exit(0)
        .must_say("failed   cage was killed by signal 9 (SIGKILL)")
        .must_say_before("restart  cage as process 2", "restart  cage is up again")
        .must_not_say("error")
        .must_not_say("does not end");
    assert_eq!(ended.stdout.trim(), "counted", "{}", ended.told);
    for process in ended.chassis.values() {
        assert!(process.ends(), "{}", ended.told);
    }
}

#[test]
fn a_chassis_that_is_killed_while_the_app_runs_comes_back_and_its_names_with_it() {
    let scratch = scratch();
    let mut run = start(&scratch, &[]);
    run.wait_for("phase 3");
    let old = run.chassis["cage"].pid;
    run.kill("cage");
    run.wait_for("cage is up again");
    assert_ne!(run.chassis["cage"].pid, old);
    let ended = run.end();
    must_have_survived(&ended);
    ended.must_say_before("misses cage", "greets cage");
}

#[test]
fn a_chassis_that_is_killed_in_any_phase_comes_back() {
    for phase in ["create", "connect", "run"] {
        let scratch = scratch();
        let mut run = start(&scratch, &[]);
        run.wait_for(&format!("is in phase {phase}"));
        run.kill("cage");
        let ended = run.end();
        must_have_survived(&ended);
        for number in ["phase 1", "phase 2", "phase 3"] {
            assert_eq!(ended.stderr.matches(number).count(), 1, "{}", ended.told);
        }
    }
}

#[test]
fn a_task_whose_chassis_dies_as_soon_as_it_is_back_is_waited_for_and_never_unknown() {
    let scratch = Scratch::empty();
    let app = r#"
        [app]
        [chassis.desk]
        [chassis.side]
        [chassis.cage]
        restart = "on-failure"
        max_restarts = 1000
        restart_backoff_s = 0.001
        restart_window_s = 0.01
        [task.dying]
        handler = "test.dying"
        on = "cage"
        [task.finder]
        handler = "test.finder"
        on = "desk"
        args.deaths = 20
        [task.looker]
        handler = "test.finder"
        on = "side"
    "#;
    scratch.write("app.toml", app);
    let ended = start(&scratch, &[]).end();
    ended.must_exit(0);
    assert_eq!(ended.stdout.trim(), "found", "{}", ended.told);
}

#[test]
fn a_chassis_that_is_killed_before_it_connects_is_restarted_as_its_policy_says() {
    let killed = |times: usize, arguments: &[&str]| {
        let scratch = scratch();
        let all = [&["boot", "app.toml"], arguments].concat();
        let holds = format!("cage:{times}");
        let mut run = scratch.start(MISBEHAVING, &all, &[("TEST_HOLDS", &holds)]);
        for _ in 0..times {
            run.wait_for("holds before it connects");
            run.kill("cage");
        }
        run.end()
    };
    let ended = killed(1, &[]);
    must_have_survived(&ended);
    ended.must_say("is in phase create");
    // It counts as every other restart does.
    let ended = killed(3, &[]);
    ended.must_exit(1);
    let reason = "was restarted 2 times within 60 s and failed again: it was killed by signal 9";
    assert!(ended.error().contains(reason), "{}", ended.told);
    let ended = killed(1, &["--set", "chassis.cage.restart=never"]);
    ended.must_exit(5).must_not_say("restart  ");
    let error = "chassis `cage` did not start: it was killed by signal 9 (SIGKILL)";
    assert!(ended.error().contains(error), "{}", ended.told);
}

#[test]
fn a_chassis_that_dies_again_and_again_ends_the_app_with_its_reason() {
    let scratch = scratch();
    let dies = ["--set", "task.hand.args.dies=\"run\"", "--json"];
    let ended = start(&scratch, &dies).end();
    ended.must_exit(1);
    let reason = "chassis `cage` was restarted 2 times within 60 s and failed again: it aborted with signal 6 (SIGABRT)";
    assert!(ended.error().contains(reason), "{}", ended.told);
    assert!(ended.json()["reason"].as_str().unwrap().contains(reason));
    ended.must_say("stops because chassis `cage` was restarted");
}

#[test]
fn a_second_kill_while_the_chassis_comes_back_is_survived_too() {
    let scratch = scratch();
    let mut run = start(&scratch, &[]);
    run.wait_for("phase 3");
    run.kill("cage");
    run.wait_for("is in phase connect");
    run.kill("cage");
    run.wait_for("restart  cage as process 3");
    run.end().must_exit(0).must_say("cage is up again");
}

#[test]
fn without_a_policy_the_app_ends_with_the_chassis() {
    let scratch = scratch();
    let mut run = start(&scratch, &["--set", "chassis.cage.restart=never"]);
    run.wait_for("phase 3");
    run.kill("cage");
    let ended = run.end();
    ended.must_exit(1).must_not_say("restart  ");
    let error = "chassis `cage` was killed by signal 9 (SIGKILL)";
    assert!(ended.error().contains(error), "{}", ended.told);
}

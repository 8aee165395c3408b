//! How the program behaves on the command line.

use std::collections::BTreeSet;

use crate::harness::{CTOS, Scratch, VIRTUAL};

#[test]
fn every_command_has_a_short_and_a_long_help() {
    let scratch = Scratch::empty();
    for command in [&[][..], &["check"], &["boot"], &["completions"]] {
        for flag in ["-h", "--help"] {
            let ended = scratch.ctos(&[command, &[flag]].concat());
            ended.must_exit(0);
            assert!(ended.stdout.contains("Usage: ctos"), "{}", ended.told);
            assert_eq!(ended.stderr, "");
            let too_wide = ended.stdout.lines().find(|line| line.chars().count() > 100);
            assert_eq!(too_wide, None);
        }
    }
    for command in ["check", "boot"] {
        let ended = scratch.ctos(&[command, "--help"]);
        assert!(ended.stdout.contains("Example"), "{}", ended.told);
    }
    let ended = scratch.ctos(&["--version"]);
    ended.must_exit(0);
    assert!(ended.stdout.starts_with("ctos "), "{}", ended.told);
}

#[test]
fn completions_are_printed_for_every_common_shell() {
    let scratch = Scratch::empty();
    for shell in ["bash", "zsh", "fish"] {
        let ended = scratch.ctos(&["completions", shell]);
        ended.must_exit(0);
        for word in ["ctos", "check", "boot"] {
            assert!(ended.stdout.contains(word), "{shell}: no `{word}`");
        }
        assert_eq!(ended.stderr, "");
    }
}

#[test]
fn a_wrong_command_line_exits_2_and_shows_the_usage() {
    let scratch = Scratch::new();
    let file = "configs/calibrate.toml";
    for arguments in [
        &[][..],
        &["boot"],
        &["check"],
        &["bott", file],
        &["boot", file, "--josn"],
        &["boot", file, file],
        &["boot", file, "--set"],
        &["completions", "tcl"],
        &["boot", file, "--log", "===="],
    ] {
        let ended = scratch.ctos(arguments);
        ended.must_exit(2).must_not_say("pid ");
        assert_eq!(ended.stdout, "", "{}", ended.told);
        assert!(!ended.stderr.is_empty());
    }
    scratch.ctos(&["bott"]).must_say("boot");
}

#[test]
fn a_sound_app_passes_the_check_without_being_started() {
    let scratch = Scratch::new();
    let ended = scratch.ctos(&["check", "configs/calibrate.toml"]);
    ended.must_exit(0).must_say("nothing found");
    assert_eq!(ended.stdout, "");
    assert!(ended.chassis.is_empty());
    let ended = scratch.ctos(&["check", "configs/calibrate.toml", "--json"]);
    ended.must_exit(0);
    assert_eq!((ended.stdout.as_str(), ended.stderr.as_str()), ("", ""));
}

#[test]
fn standard_output_carries_data_only() {
    let scratch = Scratch::short();
    let ended = scratch.boot(&[&VIRTUAL[..], &["--json", "-v"]].concat());
    assert_eq!(ended.must_exit(0).json_lines().len(), 1, "{}", ended.told);
    let missing = scratch.ctos(&["boot", "configs/absent.toml"]);
    missing.must_exit(3).must_say("absent.toml");
    assert_eq!(missing.stdout, "");
    scratch.edit("configs/cell.toml", "brightness = 80.0", "brightness = 0.0");
    let ended = scratch.boot(&VIRTUAL);
    ended.must_exit(1);
    assert_eq!(ended.stdout, "");
}

#[test]
fn no_color_wins_over_forced_colours() {
    let scratch = Scratch::short();
    scratch.write("configs/wrong.toml", "[app]\nsed = 1\n");
    let escapes = |text: &str| text.contains('\u{1b}');
    let run = |arguments: &[&str], environment: &[(&str, &str)]| {
        let ended = scratch.start(CTOS, arguments, environment).end();
        (escapes(&ended.stdout), escapes(&ended.stderr))
    };
    let wrong = ["boot", "configs/wrong.toml"];
    let right = [&["boot", "configs/calibrate.toml", "-v"], &VIRTUAL[..]].concat();
    let (force, no) = (("CLICOLOR_FORCE", "1"), ("NO_COLOR", "1"));
    assert_eq!(run(&wrong, &[]), (false, false), "into a pipe");
    assert_eq!(run(&wrong, &[force]), (false, true), "forced");
    assert_eq!(run(&wrong, &[force, no]), (false, false), "forbidden");
    assert_eq!(run(&right, &[force]), (false, true), "forced");
    assert_eq!(run(&right, &[force, no]), (false, false), "forbidden");
}

#[test]
fn v_shows_the_net_transitions_as_they_start_and_complete() {
    let scratch = Scratch::short();
    let firing = |net: &str, transition: &str, phase: &str| {
        format!("net=\"{net}\" transition=\"{transition}\" phase=\"{phase}\"")
    };
    let ended = scratch.boot(&[&VIRTUAL[..], &["-v"]].concat());
    ended.must_exit(0);
    for (net, transition) in [
        ("dispatcher", "init_calib"),
        ("dispatcher", "read_next_pos"),
        ("dispatcher", "loop_again"),
        ("dispatcher", "loop_done"),
        ("dispatcher", "compute_calib"),
        ("motion", "plan_path"),
        ("motion", "move_manip"),
        ("motion", "do_find_pos"),
        ("motion", "do_release_robot"),
        ("vision", "do_find_spot"),
    ] {
        ended.must_say_before(
            &firing(net, transition, "started"),
            &firing(net, transition, "completed"),
        );
    }
    // The two branches run side by side: both have started before either is over. The first position is an
    // exception: the arm stands there already, and one branch may be over at once.
    let (mut busy, mut positions, mut beside) = (BTreeSet::new(), 0, 0);
    for line in ended.stderr.lines() {
        for (net, transition) in [("motion", "do_find_pos"), ("vision", "do_find_spot")] {
            if line.contains(&firing(net, transition, "started")) {
                busy.insert(net);
                positions += u32::from(net == "motion");
                beside += u32::from(busy.len() == 2);
            }
            if line.contains(&firing(net, transition, "completed")) {
                busy.remove(net);
            }
        }
    }
    assert!(
        positions > 10 && beside + 1 >= positions,
        "{beside} of {positions}"
    );
    ended.must_say(&firing("dispatcher", "move_robot", "started"));
    let quiet = scratch.boot(&VIRTUAL);
    quiet.must_exit(0).must_not_say("transition=");
}

#[test]
fn v_shows_the_transitions_of_another_process_with_its_name() {
    let scratch = Scratch::short();
    let mut run = scratch.start_boot(&["-v"]);
    run.wait_for("transition=\"init_calib\" phase=\"started\"");
    run.signal(rustix::process::Signal::INT);
    let ended = run.end();
    ended.must_exit(130);
    let line = ended
        .stderr
        .lines()
        .find(|line| line.contains("init_calib"));
    assert!(
        line.is_some_and(|line| line.starts_with("ws1 ")),
        "{line:?}"
    );
}

//! What people in the room hear.

use std::{fs::Permissions, os::unix::fs::PermissionsExt as _};

use rustix::process::Signal;

use super::carry;
use crate::harness::{CTOS, Scratch};

/// What a daemon in a process of its own has said or played, in an app that is booted so, when these lines were asked.
fn heard(boots: &[&str], asks: &[&str]) -> String {
    let scratch = Scratch::new();
    let heard = scratch.path("heard");
    for (program, line) in [("voice", "echo \"$1\""), ("player", "echo played")] {
        let line = format!("#!/bin/sh\n{line} >> '{}'\n", heard.display());
        scratch.write(program, line);
        let rights = Permissions::from_mode(0o700);
        std::fs::set_permissions(scratch.path(program), rights).unwrap();
    }
    let boot = [&["boot", "configs/objects.toml"], boots].concat();
    let run = scratch.start(CTOS, &boot, &[]);
    let (voice, player) = (scratch.path("voice"), scratch.path("player"));
    let (voice, player) = (voice.display(), player.display());
    for name in ["sound", "sound.beep"] {
        let set = format!("{name}@d2 CTRL -voice {voice} -player {player}");
        // An app that says nothing does not say when it is up; the watchdog of a run ends what never comes.
        while scratch.scott(&["objects", "-c", &set]).code != Some(0) {}
    }
    for line in asks {
        let said = scratch.scott(&["objects", "-c", line]);
        said.must_exit_leaving(0);
        let is_said = !line.contains("EXEC") || said.stdout.contains("TMSG disc lost");
        assert!(is_said, "{}", said.stdout);
    }
    run.signal(Signal::INT);
    run.end();
    std::fs::read_to_string(heard).unwrap_or_default()
}

#[test]
fn the_speaker_is_muted_by_the_flag_quiet_of_the_boot_also_in_another_process() {
    let asks = ["sound@d2 EXEC disc lost"];
    assert_eq!(heard(&[], &asks), "disc lost\n");
    assert_eq!(heard(&["--quiet"], &asks), "");
}

#[test]
fn the_daemon_that_signals_is_traded_by_name_and_the_louder_one_is_taken() {
    let trade = "dict CTRL -add signal 'trade -most loudness'";
    let asks = [
        trade,
        "sound@signal EXEC disc lost",
        "sound.beep@signal EXEC disc lost",
    ];
    let offered = |one: u32, other: u32| {
        let offer = |task: &str, loudness| {
            format!("task.{task}.args.offers.sound={{ loudness = {loudness} }}")
        };
        let (one, other) = (offer("d1", one), offer("d2", other));
        heard(&["--set", &one, "--set", &other], &asks)
    };
    assert_eq!(offered(1, 2), "disc lost\nplayed\n");
    // The other one has no voice that is heard here.
    assert_eq!(offered(2, 1), "");
}

#[test]
fn people_are_signalled_by_beep_or_by_text_alone_where_a_name_says_so_by_dispatcher_and_hand() {
    for (by, object) in [
        ("signal", "sound"),
        ("beep", "sound.beep"),
        ("note", "sound.text"),
    ] {
        let speaks = |task: &str| format!("task.{task}.args.speaker=\"fork.{by}@objects\"");
        let ended = carry(&[
            "task.operator.args.arguments=[\"2,2\", \"4,5\"]",
            "task.vision.args.board=\"known\"",
            "task.dispatcher.args.tries=1",
            &speaks("hand"),
            &speaks("dispatcher"),
        ]);
        assert_ne!(ended.code, Some(0));
        for said in ["no disc is in the grasp", "disc not carried"] {
            ended.must_say(&format!("sorma::sound: {said} object={object}\n"));
        }
        ended.must_not_say("nobody speaks");
    }
}

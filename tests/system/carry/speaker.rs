//! What people in the room hear.

use std::{fs::Permissions, os::unix::fs::PermissionsExt as _};

use rustix::process::Signal;

use crate::harness::{CTOS, Scratch};

/// Whether a sound is heard that a daemon in a process of its own is asked for, in an app that is booted so.
fn is_heard(flag: Option<&str>) -> bool {
    let scratch = Scratch::new();
    let heard = scratch.path("heard");
    let voice = scratch.path("voice");
    let line = format!("#!/bin/sh\necho \"$1\" >> '{}'\n", heard.display());
    scratch.write("voice", line);
    std::fs::set_permissions(&voice, Permissions::from_mode(0o700)).unwrap();
    let boot: Vec<&str> = ["boot", "configs/objects.toml"]
        .into_iter()
        .chain(flag)
        .collect();
    let run = scratch.start(CTOS, &boot, &[]);
    let set = format!("sound@d2 CTRL -voice {}", voice.display());
    // An app that says nothing does not say when it is up; the watchdog of a run ends what never comes.
    while scratch.scott(&["objects", "-c", &set]).code != Some(0) {}
    let said = scratch.scott(&["objects", "-c", "sound@d2 EXEC disc lost"]);
    said.must_exit_leaving(0);
    assert!(said.stdout.contains("TMSG disc lost"), "{}", said.stdout);
    run.signal(Signal::INT);
    run.end();
    let written = std::fs::read_to_string(heard).unwrap_or_default();
    assert!(["", "disc lost\n"].contains(&written.as_str()), "{written}");
    !written.is_empty()
}

#[test]
fn the_speaker_is_muted_by_the_flag_quiet_of_the_boot_also_in_another_process() {
    assert!(is_heard(None));
    assert!(!is_heard(Some("--quiet")));
}

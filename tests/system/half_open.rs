//! Peers whose packets vanish while nobody closes anything. The loopback of a network of the test's own is
//! taken down under an app whose links are TCP.

use std::process::Command;

use crate::{
    harness::{MISBEHAVING, Scratch},
    moving::APP,
};

/// Brings the loopback up, and takes it down when the file `cut` is there.
const SCRIPT: &str = "ip link set lo up; \
    (until [ -e cut ]; do sleep 0.02; done; ip link set lo down) & \
    exec \"$0\" \"$@\"";

/// Whether this system gives a test a network of its own.
fn is_possible() -> bool {
    let tried = Command::new("unshare")
        .args(["-Urn", "ip", "link", "set", "lo", "up"])
        .output();
    tried.is_ok_and(|tried| tried.status.success())
}

#[test]
fn a_peer_whose_packets_vanish_is_given_up_after_the_peer_timeout_and_nobody_is_left() {
    if !is_possible() {
        // The system tests of the simulated links say the same of virtual time.
        return;
    }
    let scratch = Scratch::empty();
    scratch.write("app.toml", APP);
    let boot = [
        "-Urn",
        "sh",
        "-c",
        SCRIPT,
        MISBEHAVING,
        "boot",
        "app.toml",
        "--set",
        "same_host=\"tcp\"",
        "--set",
        "peer_timeout_s=1.0",
    ];
    let mut run = scratch.start("unshare", &boot, &[]);
    run.wait_for("phase 3");
    scratch.write("cut", "");
    run.wait_for("nothing was heard of it for 1.000 s");
    let ended = run.end();
    ended.must_exit(1);
    // Each of the three has noticed by itself, and after the same time.
    for peer in ["\"boot\"", "\"desk\"", "\"cage\""] {
        let line = format!("link down peer={peer} reason=nothing was heard of it for 1.000 s");
        ended.must_say(&line);
    }
    // Whose line it is stands before it, the boot's too.
    let named = |line: &&str| line.contains("link down peer=") && line.contains("WARN");
    for line in ended.stderr.lines().filter(named) {
        let (process, _) = line.split_once('│').unwrap_or_else(|| panic!("{line}"));
        assert!(["boot", "desk", "cage"].contains(&process.trim()), "{line}");
    }
    ended.must_say("the boot is gone: stopping");
    let error = ended.error();
    let named = ["`desk`", "`cage`"].iter().any(|name| error.contains(name));
    assert!(named, "{}", ended.told);
    for process in ended.chassis.values() {
        assert!(process.ends(), "{}", ended.told);
    }
}

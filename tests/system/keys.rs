//! Keys and their roles: who may boot on another host, and what tools may do to an app there. And the
//! walk-through of `docs/security.md`, as it stands there.

use std::{fs, net::TcpStream, os::unix::fs::PermissionsExt, path::Path};

use rustix::process::Signal;

use crate::{
    harness::{CTOS, Ended, MISBEHAVING, Run, SCOTT, Scratch},
    hosts::{Agent, ask, boot, free_port, pair},
};

/// Makes keys in `keys` of a folder: name and role.
fn keys(scratch: &Scratch, wanted: &[(&str, &str)]) {
    for (name, role) in wanted {
        let made = ask(
            scratch,
            &["keys", "new", &format!("keys/{name}"), "--role", role],
        );
        made.must_exit(0);
    }
}

/// Takes a key of one folder to another one, with the authority's certificate.
fn carry(from: &Scratch, to: &Scratch, name: &str) {
    fs::create_dir_all(to.path("keys")).unwrap();
    for file in [
        "ca.pem".to_owned(),
        format!("{name}.pem"),
        format!("{name}.key"),
    ] {
        fs::copy(
            from.path(&format!("keys/{file}")),
            to.path(&format!("keys/{file}")),
        )
        .unwrap();
    }
}

fn secured(agent: &str, key: &str, more: &str) -> String {
    let security =
        format!("[security]\nkey = \"keys/{key}\"\nauthority = \"keys/ca.pem\"\n{more}\n");
    format!("{}{security}", pair(agent, ""))
}

/// A host with an agent that has the key `cage`, and a folder with all keys.
fn with_keys() -> [Scratch; 2] {
    let [here, x] = [Scratch::empty(), Scratch::empty()];
    let wanted = [
        ("cell", "boot"),
        ("cage", "boot"),
        ("low", "control"),
        ("panel", "watch"),
    ];
    keys(&here, &wanted);
    carry(&here, &x, "cage");
    carry(&here, &x, "panel");
    [here, x]
}

const KEY: [&str; 2] = ["--key", "keys/cage"];

/// Ends a boot and its agent in order.
fn finish(run: Run<'_>, mut agent: Agent<'_>) {
    run.signal(Signal::INT);
    run.end().must_exit(130);
    agent.run.wait_for("over     pair: the boot has ended it");
    agent.end();
}

#[test]
fn an_app_with_keys_boots_on_an_agent_with_keys_and_its_chassis_talk_over_tls() {
    let [here, x] = with_keys();
    let mut on_x = Agent::start(&x, &KEY);
    let mut run = boot(
        &here,
        &secured(&on_x.address, "cell", "[injure]\ndrop = 0.0"),
        &["--set", "same_host=tcp"],
    );
    run.wait_for("phase 3");
    on_x.run.wait_for("with the key `cell`");
    finish(run, on_x);
}

#[test]
fn whoever_may_not_boot_is_refused_and_told_why() {
    let [here, x] = with_keys();
    let mut on_x = Agent::start(&x, &KEY);
    let refused = |text: &str, says: &str| {
        let ended = boot(&here, text, &[]).end();
        ended
            .must_exit(5)
            .must_say("host `x`")
            .must_say(says)
            .must_not_say("pid");
        ended
    };
    // A key of a lesser role.
    let role = "it may not boot: the key `low` has the role `control`, and that takes `boot`";
    refused(&secured(&on_x.address, "low", ""), role);
    on_x.run.wait_for(role);
    // No key.
    refused(
        &pair(&on_x.address, ""),
        "does it want keys? name them in [security]",
    );
    on_x.run.wait_for("refused  127.0.0.1:");
    // A key of another authority.
    let strange = Scratch::empty();
    keys(&strange, &[("cell", "boot")]);
    let ended = boot(&strange, &secured(&on_x.address, "cell", ""), &[]).end();
    ended
        .must_exit(5)
        .must_say("its agent does not prove who it is");
    on_x.run.wait_for("refused  127.0.0.1:");
    // Nothing of that keeps the agent from its work.
    let mut run = boot(&here, &secured(&on_x.address, "cell", ""), &[]);
    run.wait_for("phase 3");
    finish(run, on_x);
}

#[test]
fn an_agent_whose_key_is_not_enough_does_not_begin() {
    let [_, x] = with_keys();
    let ended = ask(
        &x,
        &["agent", "--listen", "127.0.0.1:0", "--key", "keys/panel"],
    );
    ended
        .must_exit(1)
        .must_say("the key `panel` has the role `watch`");
}

#[test]
fn a_boot_with_keys_does_not_trust_an_agent_without() {
    let [here, x] = with_keys();
    let mut on_x = Agent::start(&x, &[]);
    let ended = boot(&here, &secured(&on_x.address, "cell", ""), &[]).end();
    ended.must_exit(5).must_say("it needs `--key`");
    on_x.run.wait_for("refused  127.0.0.1:");
    on_x.end();
}

/// An app of this host alone that tools reach at a port.
fn watched(port: u16, key: &str) -> String {
    let security = if key.is_empty() {
        String::new()
    } else {
        format!("[security]\nkey = \"keys/{key}\"\nauthority = \"keys/ca.pem\"\n")
    };
    format!(
        "[app]\nname = \"cell\"\n[control]\nlisten = \"127.0.0.1:{port}\"\n{security}[chassis.cage]\nrestart = \"on-failure\"\n[task.arm]\nhandler = \"test.steady\"\non = \"cage\"\nargs = {{ slow_s = 0.0 }}\n"
    )
}

/// Asks as a tool on another host does, where nothing of the app is known but its address.
fn tool(panel: &Scratch, port: u16, arguments: &[&str], key: &str) -> Ended {
    let at = format!("127.0.0.1:{port}");
    let key_path = format!("keys/{key}");
    let key = ["--key", &key_path];
    let key = if key_path == "keys/" { &[][..] } else { &key };
    let all = [arguments, &["--at", &at], key].concat();
    ask(panel, &all)
}

#[test]
fn tools_may_do_what_the_role_of_their_key_permits_and_no_more() {
    let [here, panel] = [Scratch::empty(), Scratch::empty()];
    keys(
        &here,
        &[
            ("cell", "boot"),
            ("screen", "watch"),
            ("caller", "call"),
            ("desk", "control"),
        ],
    );
    for name in ["screen", "caller", "desk"] {
        carry(&here, &panel, name);
    }
    let port = free_port();
    let mut run = boot(
        &here,
        &watched(port, "cell"),
        &["--set", "metrics.listen=127.0.0.1:0"],
    );
    run.wait_for("phase 3");

    let view = tool(&panel, port, &["ps", "--json"], "screen");
    let view = view.must_exit(0).json();
    assert_eq!(
        (&view["app"], &view["refused"]),
        (&"cell".into(), &0.into())
    );
    let shown = tool(&panel, port, &["status", "arm"], "screen");
    shown.must_exit(0);
    let option =
        format!("restart it       ctos restart arm --at 127.0.0.1:{port} --key keys/screen");
    assert!(shown.stdout.contains(&option), "{}", shown.told);
    let logs = tool(&panel, port, &["logs", "arm", "--json"], "screen");
    assert_eq!(logs.must_exit(0).json_lines().len(), 3);
    tool(
        &panel,
        port,
        &["top", "--once", "--interval", "0.1"],
        "screen",
    )
    .must_exit(0);

    for key in ["screen", "caller"] {
        for command in [
            &["stop"][..],
            &["restart", "arm"],
            &["record", "--to", "/rec"],
        ] {
            let refused = tool(&panel, port, command, key);
            refused
                .must_exit(8)
                .must_say("takes the role `control`")
                .must_say(&format!("the key `{key}`"));
        }
    }
    run.wait_for("refused=6");
    let view = tool(&panel, port, &["ps", "--json"], "screen").json();
    assert_eq!(view["refused"], 6, "{view}");
    let shown = tool(&panel, port, &["ps"], "screen");
    assert!(
        shown.stdout.contains("6 callers were refused"),
        "{}",
        shown.told
    );

    let here_alone = tool(&panel, port, &["record", "--to", "rec"], "desk");
    here_alone.must_exit(1).must_say("name its whole path");
    let folder = here.path("rec");
    let record = [
        "record",
        "--for",
        "100ms",
        "--json",
        "--to",
        folder.to_str().unwrap(),
    ];
    let view = tool(&panel, port, &record, "desk").must_exit(0).json();
    for file in view["files"].as_array().unwrap() {
        let file = file["file"].as_str().unwrap();
        assert!(std::fs::exists(folder.join(file)).unwrap(), "{view}");
    }

    tool(&panel, port, &["restart", "arm"], "desk").must_exit(0);
    let stopped = tool(&panel, port, &["stop"], "desk");
    stopped.must_exit(0).must_say("stopped");
    run.end().must_exit(130);
}

#[test]
fn who_may_call_asks_objects_and_stops_nothing() {
    let here = Scratch::empty();
    keys(
        &here,
        &[("cell", "boot"), ("screen", "watch"), ("caller", "call")],
    );
    let port = free_port();
    here.write(
        "app.toml",
        format!(
            "[security]\nkey = \"keys/cell\"\nauthority = \"keys/ca.pem\"\n[control]\nlisten = \"127.0.0.1:{port}\"\n[chassis.cage]\n[task.objects]\nhandler = \"sorma.daemon\"\non = \"cage\"\n"
        ),
    );
    let mut run = here.start(CTOS, &["boot", "app.toml"], &[]);
    run.wait_for("phase 3");
    let at = format!("127.0.0.1:{port}");
    let say = |key: &str| {
        let line = ["--at", &at, "--key", key, "-c", "foo.a EXEC"];
        here.start(SCOTT, &line, &[]).end()
    };
    say("keys/screen").must_say("`say` takes the role `call`");
    let said = say("keys/caller");
    said.must_exit_leaving(0);
    assert!(said.stdout.contains("foo.a RET 0"), "{}", said.told);
    for command in [&["stop"][..], &["restart", "objects"]] {
        let refused = tool(&here, port, command, "caller");
        refused.must_exit_leaving(8);
        refused.must_say("takes the role `control`");
    }
    run.signal(Signal::INT);
    run.end().must_exit(130);
}

#[test]
fn tools_without_a_key_or_with_one_of_another_authority_are_refused() {
    let [here, panel, strange] = [Scratch::empty(), Scratch::empty(), Scratch::empty()];
    keys(&here, &[("cell", "boot")]);
    keys(&strange, &[("screen", "boot")]);
    carry(&strange, &panel, "screen");
    let port = free_port();
    let mut run = boot(&here, &watched(port, "cell"), &[]);
    run.wait_for("phase 3");
    let refused = tool(&panel, port, &["ps"], "");
    refused.must_exit(5).must_say("does it want a key (--key)");
    let refused = tool(&panel, port, &["ps"], "screen");
    refused.must_exit(8).must_say("127.0.0.1");
    // One that says nothing, and one that says rubbish, cost nobody else anything.
    let silent = TcpStream::connect(("127.0.0.1", port)).unwrap();
    let view = ask(&here, &["ps", "--json"]);
    let view = view.must_exit_leaving(0).json();
    assert!(view["refused"].as_u64().unwrap() >= 2, "{view}");
    drop(silent);
    run.signal(Signal::INT);
    run.end().must_exit(130);
}

#[test]
fn at_the_loopback_without_keys_whoever_knows_the_secret_of_the_port_may_do_everything() {
    let [here, panel] = [Scratch::empty(), Scratch::empty()];
    let port = free_port();
    let mut run = boot(&here, &watched(port, ""), &[]);
    run.wait_for("phase 3");
    // Tools of the same user find it.
    let view = tool(&here, port, &["ps", "--json"], "");
    assert_eq!(view.must_exit_leaving(0).json()["app"], "cell");
    // Others are told what is missing.
    let refused = tool(&panel, port, &["ps"], "");
    refused.must_exit(5).must_say("--token-file");
    fs::write(panel.path("guessed"), "0123456789abcdef").unwrap();
    let guessed = ["ps", "--token-file", "guessed"];
    let refused = tool(&panel, port, &guessed, "");
    refused
        .must_exit(8)
        .must_say("does not know the secret of this port");
    let token = here.path(&format!("ctos/127.0.0.1:{port}.token"));
    let mode = token.metadata().unwrap().permissions().mode();
    assert_eq!(mode & 0o777, 0o600);
    let file = token.to_str().unwrap();
    tool(&panel, port, &["stop", "--token-file", file], "").must_exit(0);
    run.end().must_exit(130);
    assert!(!token.exists());
    let gone = tool(&panel, port, &["ps"], "");
    gone.must_exit(5)
        .must_say(&format!("cannot reach app `127.0.0.1:{port}`"));
}

#[test]
fn a_port_of_control_that_is_taken_is_an_error_of_the_boot() {
    let here = Scratch::empty();
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port();
    let ended = boot(&here, &watched(port, ""), &[]).end();
    ended
        .must_exit(3)
        .must_say(&format!("[control] cannot listen on 127.0.0.1:{port} here"));
}

/// Why a chassis cannot start reaches the boot over TLS too.
#[test]
fn a_chassis_with_keys_that_cannot_listen_says_so() {
    let here = Scratch::empty();
    keys(&here, &[("cell", "boot")]);
    // Nobody has the port before the boot itself does, on one of the addresses that the chassis wants.
    let port = free_port();
    let at = format!("0.0.0.0:{port}");
    let text = format!(
        "[app]\nsame_host = \"tcp\"\n[control]\nlisten = \"127.0.0.1:{port}\"\n[security]\nkey = \"keys/cell\"\nauthority = \"keys/ca.pem\"\n[chassis.cage]\nlisten = \"{at}\"\n[task.arm]\nhandler = \"test.steady\"\non = \"cage\"\nargs = {{ slow_s = 0.0 }}\n"
    );
    let ended = boot(&here, &text, &[]).end();
    // Not how the process ended, and not the last lines of its log: its own reason.
    ended.must_exit(5).must_say(&format!(
        "chassis `cage` did not start: cannot listen on {at}"
    ));
}

/// The fenced blocks of a section of a page: language and text.
fn blocks(page: &str, section: &str) -> Vec<(String, String)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs");
    let page = fs::read_to_string(folder.join(page)).unwrap();
    let section = page.split(&format!("\n## {section}\n")).nth(1).unwrap();
    let section = section.split("\n## ").next().unwrap();
    let mut parts = section.split("\n```");
    parts.next();
    let mut blocks = Vec::new();
    while let Some(block) = parts.next() {
        let (language, text) = block.split_once('\n').unwrap();
        blocks.push((language.to_owned(), text.to_owned()));
        parts.next();
    }
    blocks
}

/// The walk-through, with other ports, and two folders in the place of two hosts.
#[test]
fn the_walk_through_of_the_page_about_security_does_what_it_says() {
    let [here, cage] = [Scratch::empty(), Scratch::empty()];
    let (agent_port, control_port) = (free_port(), free_port());
    let at_hand = |text: &str| {
        text.replace("127.0.0.1:7410", &format!("127.0.0.1:{agent_port}"))
            .replace("127.0.0.1:7411", &format!("127.0.0.1:{control_port}"))
    };
    let blocks = blocks("security.md", "A walk-through");
    let toml = blocks
        .iter()
        .find(|(language, _)| language == "toml")
        .unwrap();
    here.write("yard.toml", at_hand(&toml.1));
    let lines = blocks.iter().filter(|(language, _)| language == "sh");
    let lines: Vec<String> = lines
        .flat_map(|(_, text)| text.lines().map(&at_hand))
        .collect();
    let mut running = Vec::new();
    for line in lines {
        let line = line.split(" #").next().unwrap().trim();
        let words: Vec<&str> = line.split_whitespace().collect();
        match words[..] {
            // Keys go to the other host by whatever way is safe.
            ["scp", ..] => carry(&here, &cage, "cage"),
            ["ctos", "agent", ..] => {
                let mut run = cage.start(CTOS, &words[1..], &[]);
                run.wait_for("listens at");
                running.push(run);
            }
            ["ctos", "boot", ..] => {
                let mut run = here.start(CTOS, &words[1..], &[]);
                run.wait_for("phase 3");
                running.push(run);
            }
            ["ctos", "stop", ..] if line.contains("keys/panel") => {
                here.start(CTOS, &words[1..], &[])
                    .end()
                    .must_exit_leaving(8);
            }
            ["ctos", ..] => {
                here.start(CTOS, &words[1..], &[])
                    .end()
                    .must_exit_leaving(0);
            }
            _ => panic!("`{line}` is no command of the walk-through"),
        }
    }
    let [agent, app] = <[Run<'_>; 2]>::try_from(running).ok().unwrap();
    app.end().must_exit(130).must_say("on cage");
    agent.signal(Signal::TERM);
    agent.end().must_exit(0);
}

/// The handlers of the tests are not in the program of the walk-through.
#[test]
fn both_programs_can_be_agents() {
    for program in [CTOS, MISBEHAVING] {
        let folder = Scratch::empty();
        let help = folder.start(program, &["agent", "--help"], &[]).end();
        assert!(
            help.must_exit(0).stdout.contains("--listen"),
            "{}",
            help.told
        );
    }
}

#[test]
fn objects_of_an_app_on_another_host_are_asked_with_a_key_that_may_control() {
    let [here, away] = [Scratch::empty(), Scratch::empty()];
    keys(
        &here,
        &[("cell", "boot"), ("screen", "watch"), ("desk", "control")],
    );
    for name in ["screen", "desk"] {
        carry(&here, &away, name);
    }
    let port = free_port();
    here.write(
        "app.toml",
        format!(
            "{}[task.objects]\nhandler = \"sorma.daemon\"\non = \"cage\"\n",
            watched(port, "cell").replace(
                "[task.arm]\nhandler = \"test.steady\"\non = \"cage\"\nargs = { slow_s = 0.0 }\n",
                ""
            )
        ),
    );
    let mut run = here.start(CTOS, &["boot", "app.toml"], &[]);
    run.wait_for("phase 3");
    let at = format!("127.0.0.1:{port}");
    let asked = |key: &str, line: &str| {
        let key = format!("keys/{key}");
        let arguments = ["--at", &at, "--key", &key, "-c", line];
        away.start(SCOTT, &arguments, &[]).end()
    };
    let ended = asked("desk", "foo.a EXEC");
    assert!(ended.must_exit(0).stdout.starts_with("foo.a RET 0"));
    // What went wrong over there has its report here.
    let ended = asked("desk", "nothing.a EXEC");
    assert_ne!(ended.code, Some(0));
    ended.must_say("nothing");
    let ended = asked("screen", "foo.a EXEC");
    assert_ne!(ended.code, Some(0));
    ended.must_say("watch");
    run.signal(Signal::INT);
    run.end().must_exit(130);
}

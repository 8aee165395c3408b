//! `[zenoh]`: what is read, and what does not fit together.

use super::*;

const APP: &str = "[task.t]\nhandler = \"h\"\non = \"a\"\n[chassis.a]\n";
const SECURITY: &str = "[security]\nkey = \"keys/a\"\nauthority = \"keys/ca.pem\"\n";

/// What is found in an app with these lines, apart from what any app hears of a program without zenoh.
fn found(more: &str) -> Vec<String> {
    let text = format!("{APP}{more}");
    let mut lines = match load_one(&text) {
        Ok(app) => Err(app.warnings),
        Err(findings) => Err(findings),
    };
    let lines = refused(std::mem::replace(&mut lines, Err(Findings::new())));
    let built = |line: &String| !line.contains("was built without them");
    lines.into_iter().filter(built).collect()
}

#[test]
fn a_program_without_zenoh_says_how_to_build_one_that_has_it() {
    let text = format!("{APP}{SECURITY}[zenoh]\nmulticast = \"lo\"\n");
    match load_one(&text) {
        Ok(app) => {
            assert!(has_zenoh());
            assert!(app.warnings.is_empty(), "{}", app.warnings);
        }
        Err(findings) => {
            assert!(!has_zenoh());
            let lines = refused(Err(findings));
            assert_eq!(lines.len(), 1);
            assert!(
                lines[0].starts_with("app.toml:8:") && lines[0].contains("--features zenoh"),
                "{lines:?}"
            );
        }
    }
}

#[test]
fn networks_are_read_and_listen_at_the_loopback_unless_told() {
    if !has_zenoh() {
        return;
    }
    let read = |more: &str| {
        let app = load_one(&format!("{APP}{more}"));
        app.map_err(|findings| findings.to_string())
            .unwrap()
            .links
            .zenoh
    };
    assert_eq!(read(""), None);
    assert_eq!(read("[zenoh]\n"), None);
    let shown = |endpoints: &[ZenohEndpoint]| {
        let shown = endpoints.iter().map(ToString::to_string);
        shown.collect::<Vec<_>>()
    };
    let plain = read("[zenoh]\nmulticast = \"lo\"\n").unwrap();
    assert_eq!(plain.mode, ZenohMode::Peer);
    assert_eq!(shown(&plain.listen), ["tcp/127.0.0.1:0"]);
    assert_eq!(plain.multicast.as_deref(), Some("lo"));
    let text = format!(
        "{SECURITY}[zenoh]\nmode = \"client\"\nconnect = [\"tls/router.lab:7447\", \"tcp/[::1]:1\"]\n"
    );
    let keys = read(&text).unwrap();
    assert_eq!(keys.mode, ZenohMode::Client);
    assert_eq!(shown(&keys.connect), ["tls/router.lab:7447", "tcp/[::1]:1"]);
    assert_eq!(shown(&keys.listen), ["tcp/127.0.0.1:0"]);
}

#[test]
fn whatever_others_can_reach_needs_keys() {
    for open in [
        "connect = [\"tcp/10.0.0.5:7447\"]",
        "connect = [\"tcp/router.lab:7447\"]",
        "connect = [\"tls/127.0.0.1:7447\"]",
        "multicast = \"lo\"\nlisten = [\"tcp/0.0.0.0:0\"]",
        "multicast = \"eth0\"",
        "multicast = \"10.0.0.1\"",
        "mode = \"router\"\nlisten = [\"tcp/10.0.0.5:7447\"]",
    ] {
        let lines = found(&format!("[zenoh]\n{open}\n"));
        assert!(
            lines.len() == 1 && lines[0].contains("needs keys"),
            "{open}: {lines:?}"
        );
    }
    for near in ["multicast = \"lo\"", "connect = [\"tcp/localhost:7447\"]"] {
        let lines = found(&format!("[zenoh]\n{near}\n"));
        assert!(
            lines.len() == 1 && lines[0].contains("warning: [zenoh] without keys"),
            "{near}: {lines:?}"
        );
        let none = found(&format!("{SECURITY}[zenoh]\n{near}\n"));
        assert_eq!(none, Vec::<String>::new());
    }
}

#[test]
fn zenohs_own_tls_is_warned_of_and_open_doors_too() {
    for (text, says) in [
        ("connect = [\"tls/10.0.0.5:7447\"]", "can end the process"),
        (
            "mode = \"router\"\nlisten = [\"tcp/10.0.0.5:7447\"]",
            "lets in everybody",
        ),
    ] {
        let lines = found(&format!("{SECURITY}[zenoh]\n{text}\n"));
        assert!(
            lines.len() == 1 && lines[0].contains("warning") && lines[0].contains(says),
            "{text}: {lines:?}"
        );
    }
}

#[test]
fn what_does_not_fit_together_is_found_with_its_place() {
    for (text, says) in [
        ("mode = \"peer\"", "nobody would be found"),
        ("mode = \"client\"", "nobody would be found"),
        (
            "mode = \"router\"",
            "does not say where the chassis find it",
        ),
        ("mode = \"broker\"", "unknown choice `broker`"),
        (
            "mode = \"router\"\nlisten = [\"tls/127.0.0.1:0\"]",
            "connect to the router",
        ),
        (
            "mode = \"router\"\nlisten = [\"tls/0.0.0.0:7447\"]",
            "connect to the router",
        ),
        (
            "mode = \"router\"\nlisten = [\"tls/host:7447\"]",
            "takes addresses, not names",
        ),
        (
            "multicast = \"lo\"\nlisten = [\"tls/0.0.0.0:7447\"]",
            "only one process",
        ),
        (
            "multicast = \"lo\"\nlisten = [\"tcp/0.0.0.0:0\"]",
            "lets in everybody",
        ),
        ("multicast = \"lo,eth0\"", "not the name of an interface"),
        (
            "connect = \"tls/10.0.0.5:7447\"",
            "`connect` must be a list",
        ),
        ("connect = [7447]", "is a list of texts"),
        ("connect = [\"10.0.0.5:7447\"]", "is not an endpoint"),
        ("connect = [\"udp/10.0.0.5:7447\"]", "is not an endpoint"),
        ("connect = [\"tls/10.0.0.5\"]", "is not an endpoint"),
        (
            "connect = [\"tls/10.0.0.5:7447#iface=eth0\"]",
            "is not an endpoint",
        ),
        (
            "connect = [\"tls/h:1\"]\nmode = \"client\"\nlisten = [\"tls/127.0.0.1:0\"]",
            "has no effect",
        ),
    ] {
        let lines = found(&format!("{SECURITY}[zenoh]\n{text}\n"));
        let found = lines.iter().any(|line| line.contains(says));
        assert!(found, "{text}: {lines:?}");
        assert!(
            lines.iter().all(|line| line.starts_with("app.toml:")),
            "{lines:?}"
        );
    }
    let lines = refused(load_set(&format!("{APP}{SECURITY}"), &["same_host=zenoh"]));
    assert!(
        lines[0].contains("a network that is not described"),
        "{lines:?}"
    );
}

proptest! {
    #[test]
    fn endpoints_survive_their_text_and_rubbish_is_refused(
        tls: bool, ip: std::net::IpAddr, port: u16, rubbish in ".{0,40}"
    ) {
        let endpoint = ZenohEndpoint { tls, host: ip.to_string(), port };
        prop_assert_eq!(endpoint.to_string().parse::<ZenohEndpoint>().unwrap(), endpoint);
        if let Ok(read) = rubbish.parse::<ZenohEndpoint>() {
            prop_assert_eq!(read.to_string().parse::<ZenohEndpoint>().unwrap(), read);
        }
    }
}

#[test]
fn the_example_of_the_page_on_links_is_an_app_in_a_program_with_zenoh() {
    let page = include_str!("../../../../docs/links.md");
    let example = page
        .split("```toml")
        .nth(1)
        .and_then(|rest| rest.split("```").next())
        .unwrap();
    match load_one(example) {
        Ok(app) => {
            assert!(app.warnings.is_empty(), "{}", app.warnings);
            assert_eq!(app.links.zenoh.unwrap().mode, ZenohMode::Client);
        }
        Err(findings) => assert!(!has_zenoh(), "{findings}"),
    }
}

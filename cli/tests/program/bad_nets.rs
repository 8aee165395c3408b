//! Net files with every kind of mistake that files have. Each is refused with exit code 3 and the place of the
//! mistake, and nothing is reported of a half-read net.

use std::{fs, path::Path, process::Command};

const NODES: &str = "<place id=\"p\"/><place id=\"q\"/><transition id=\"t\"/>";

/// A PNML document whose fourth line is this.
fn pnml(line: &str) -> String {
    let kind = "http://www.pnml.org/version-2009/grammar";
    format!(
        "<?xml version=\"1.0\"?>\n<pnml xmlns=\"{kind}/pnml\"><net id=\"n\" type=\"{kind}/ptnet\"><page id=\"g\">\n{NODES}\n{line}\n</page></net></pnml>\n"
    )
}

fn arc(target: &str, weight: &str) -> String {
    format!(
        "<arc id=\"a\" source=\"p\" target=\"{target}\"><inscription><text>{weight}</text></inscription></arc>"
    )
}

fn utf16(text: &str) -> Vec<u8> {
    let marked = format!("\u{feff}{text}");
    marked.encode_utf16().flat_map(u16::to_le_bytes).collect()
}

/// Checks what `arguments` say; it must end with exit code 3, say `said` and where, and nothing of a net.
#[track_caller]
fn refused(folder: &Path, arguments: &[&str], place: &str, said: &str) {
    let output = Command::new(env!("CARGO_BIN_EXE_ctos"))
        .args(["net", "check", "--json"])
        .args(arguments)
        .current_dir(folder)
        .env("NO_COLOR", "1")
        .output()
        .unwrap();
    let stdout = String::from_utf8_lossy(&output.stdout);
    let stderr = String::from_utf8_lossy(&output.stderr);
    let told = format!("{arguments:?}:\n{stdout}\n{stderr}");
    assert_eq!(output.status.code(), Some(3), "{told}");
    assert!(told.contains(place), "no `{place}` in {told}");
    assert!(told.contains(said), "no `{said}` in {told}");
    assert!(!stdout.contains("\"markings\""), "{told}");
    assert!(told.len() < 10_000, "a message is for people");
}

/// A file of these bytes is refused.
#[track_caller]
fn file(name: &str, bytes: impl AsRef<[u8]>, place: &str, said: &str) {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join(name), bytes).unwrap();
    refused(folder.path(), &[name], &format!("{name}:{place}"), said);
}

#[test]
fn truncated_and_foreign_xml_is_refused_at_its_place() {
    let whole = pnml(&arc("t", "2"));
    let cut = whole.find("target").unwrap();
    file("a.pnml", &whole[..cut], "4:", "not well-formed XML");
    file(
        "a.xml",
        "<?xml version=\"1.0\"?>\n<svg width=\"3\"/>\n",
        "2:1",
        "is a `svg` and no PNML",
    );
    let hlpng = whole.replace("ptnet", "pt-hlpng");
    file("a.pnml", hlpng, "2:", "pt-hlpng");
}

#[test]
fn dangling_arcs_arcs_between_places_and_double_ids_are_refused_at_their_places() {
    file(
        "a.pnml",
        pnml(&arc("u", "1")),
        "4:32",
        "no node has that id",
    );
    file("a.pnml", pnml(&arc("q", "1")), "4:10", "joins two places");
    file(
        "a.pnml",
        pnml("<place id=\"q\"/>"),
        "4:12",
        "the id `q` of this place is there already",
    );
    file(
        "a.net",
        "net n\nplace a = 1\ntransition t\n  in a, b\n",
        "4:9",
        "no place `b`",
    );
    file(
        "a.net",
        "net n\nplace a, b\nplace a\ntransition t\n  in a\n",
        "3:7",
        "is there twice",
    );
}

#[test]
fn negative_and_absurd_weights_and_markings_are_refused_at_their_places() {
    let many = "99999999999999999999";
    for weight in ["-2", "0", many, "1.5", "NaN"] {
        file("a.pnml", pnml(&arc("t", weight)), "4:", weight);
    }
    let marked = |tokens: &str| {
        pnml(&format!(
            "<place id=\"r\"><initialMarking><text>{tokens}</text></initialMarking></place>"
        ))
    };
    file("a.pnml", marked(many), "4:37", "more than can be counted");
    file("a.pnml", marked("-1"), "4:37", "-1");
    let net = |tokens: &str, weight: &str| {
        format!("net n\nplace a = {tokens}\ntransition t\n  in a*{weight}\n")
    };
    file("a.net", net(many, "1"), "2:11", many);
    file("a.net", net("-1", "1"), "2:11", "from 0 up");
    file("a.net", net("1", "4294967296"), "4:8", "4294967296");
    file("a.net", net("1", "-2"), "4:8", "-2");
}

#[test]
fn entity_bombs_and_files_from_outside_are_not_read() {
    let bomb = "<?xml version=\"1.0\"?>\n<!DOCTYPE l [<!ENTITY a \"aaaa\"><!ENTITY b \"&a;&a;&a;\">]>\n<pnml>&b;</pnml>\n";
    file("a.pnml", bomb, "2:1", "document type");
    let outside = "<!DOCTYPE x [<!ENTITY p SYSTEM \"file:///etc/passwd\">]>\n<pnml>&p;</pnml>\n";
    file("a.pnml", outside, "1:1", "document type");
}

#[test]
fn mistakes_in_utf_16_are_told_at_the_same_place_as_in_utf_8() {
    let wrong = pnml(&arc("q", "1"));
    file("a.pnml", utf16(&wrong), "4:10", "joins two places");
    let text = "net n\nplace a = 1\nplase b\ntransition t\n  in a\n";
    file("a.net", utf16(text), "3:1", "did you mean `place`?");
    let mut odd = utf16(&wrong);
    odd.pop();
    file("a.pnml", odd, "", "is not UTF-16LE text here");
}

#[test]
fn fifty_megabytes_of_one_line_are_refused_shortly() {
    let long = "a".repeat(50 << 20);
    file("a.net", format!("net n\nplace {long}\n"), "2:", "");
    file(
        "a.pnml",
        format!("<pnml x=\"{long}\"/>"),
        "1:1",
        "has 51 MiB of PNML, and at most 16 MiB are read",
    );
}

#[test]
fn a_net_without_transitions_is_refused() {
    file("a.net", "net n\nplace a = 1\n", "1:5", "no transition");
    let none = pnml("").replace("<transition id=\"t\"/>", "");
    file("a.pnml", none, "2:", "no transition");
}

#[test]
fn a_place_with_two_names_is_refused_at_the_second() {
    let named = "<place id=\"r\"><name><text>a</text></name><name><text>b</text></name></place>";
    file(
        "a.pnml",
        pnml(named),
        "4:42",
        "this place has a second `name`",
    );
}

#[test]
fn subnets_that_use_each_other_are_refused_with_the_circle() {
    let text = "net n\nsubnet x(a)\nplace b\nuse y(b) as one\nend\nsubnet y(a)\nplace c\nuse x(c) as two\nend\nplace p = 1\nuse x(p) as three\ntransition t\n  in p\n";
    file("a.net", text, "8:5", "x uses y uses x");
}

#[test]
fn a_place_of_a_net_that_is_nowhere_and_an_action_that_no_task_offers_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let app = "[app]\nname = \"t\"\n[chassis.a]\n[task.dom]\nhandler = \"coordinators.dom\"\non = \"a\"\n[task.n]\nhandler = \"coordinators.motion\"\non = \"a\"\nargs.net = \"n.net\"\n";
    fs::write(folder.path().join("app.toml"), app).unwrap();
    let refused = |lines: &str, place: &str, said: &str| {
        let net = format!("net n\nplace a = 1\ntransition t\n  in a\n{lines}\n");
        fs::write(folder.path().join("n.net"), net).unwrap();
        refused(
            folder.path(),
            &["--app", "app.toml"],
            &format!("n.net:{place}"),
            said,
        );
    };
    refused("  out b@m", "5:7", "the app has no net `m`");
    refused(
        "  send dom.lisst\n  out a",
        "5:8",
        "takes no command `lisst`",
    );
    refused("  send nobody.list\n  out a", "5:8", "`nobody`");
}

//! `ctos net`, as authors of nets use it.

use std::{fs, path::Path, process::Command};

use crate::common::root;

struct Ended {
    code: i32,
    stdout: String,
    stderr: String,
}

fn ctos(folder: &Path, arguments: &[&str]) -> Ended {
    let output = Command::new(env!("CARGO_BIN_EXE_ctos"))
        .args(arguments)
        .current_dir(folder)
        .env("NO_COLOR", "1")
        .output()
        .unwrap();
    Ended {
        code: output.status.code().unwrap_or(-1),
        stdout: String::from_utf8(output.stdout).unwrap(),
        stderr: String::from_utf8(output.stderr).unwrap(),
    }
}

#[test]
fn the_nets_beside_the_configurations_are_laid_out() {
    let nets = root().join("configs/nets");
    let files: Vec<String> = fs::read_dir(&nets)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .filter(|name| name.ends_with(".net"))
        .collect();
    assert!(files.len() >= 4, "{files:?}");
    let mut arguments = vec!["net", "fmt", "--check"];
    arguments.extend(files.iter().map(String::as_str));
    let ended = ctos(&nets, &arguments);
    assert_eq!(
        (ended.code, ended.stdout.as_str()),
        (0, ""),
        "{}",
        ended.stderr
    );
}

#[test]
fn fmt_changes_what_it_names_keeps_comments_and_leaves_what_it_cannot_read() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.net");
    fs::write(&file, "net a #x\nplace p=1\ntransition t\nin p\nout p\n").unwrap();
    let checked = ctos(folder.path(), &["net", "fmt", "--check", "a.net"]);
    assert_eq!((checked.code, checked.stdout.as_str()), (1, "a.net\n"));
    assert_eq!(ctos(folder.path(), &["net", "fmt", "a.net"]).code, 0);
    let text = fs::read_to_string(&file).unwrap();
    assert_eq!(
        text,
        "net a  #x\nplace p = 1\ntransition t\n  in p\n  out p\n"
    );
    assert_eq!(
        ctos(folder.path(), &["net", "fmt", "--check", "a.net"]).code,
        0
    );

    let broken = "net a\nplace \"p\n   place q\n";
    fs::write(&file, broken).unwrap();
    let ended = ctos(folder.path(), &["net", "fmt", "a.net"]);
    assert!(
        ended.code == 3 && ended.stderr.contains("a.net:2:7"),
        "{}",
        ended.stderr
    );
    assert_eq!(fs::read_to_string(&file).unwrap(), broken);
}

#[test]
fn a_net_goes_to_pnml_and_back_and_is_checked_in_either_form() {
    let folder = tempfile::tempdir().unwrap();
    let hello = root().join("configs/nets/hello.net");
    let hello = hello.to_str().unwrap();
    let made = ctos(
        folder.path(),
        &["net", "convert", hello, "hello.pnml", "--json"],
    );
    assert_eq!(made.code, 0, "{}", made.stderr);
    let object: serde_json::Value = serde_json::from_str(made.stdout.trim()).unwrap();
    assert_eq!(
        (object["places"].as_u64(), object["transitions"].as_u64()),
        (Some(3), Some(3))
    );
    let back = ctos(
        folder.path(),
        &["net", "convert", "hello.pnml", "-", "--to", "text"],
    );
    assert_eq!(back.code, 0);
    assert!(
        back.stdout.contains("  send counter.count(-> times)\n"),
        "{}",
        back.stdout
    );
    assert_eq!(ctos(folder.path(), &["net", "check", "hello.pnml"]).code, 0);
    let refused = ctos(
        folder.path(),
        &["net", "convert", "hello.pnml", "-", "--to", "tina"],
    );
    assert!(
        refused.code == 3 && refused.stdout.is_empty(),
        "{}",
        refused.stderr
    );
    assert_eq!(
        ctos(folder.path(), &["net", "convert", "hello.pnml", "out"]).code,
        2
    );
}

#[test]
fn drawing_and_converting_call_every_form_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let text = "net n\nplace a = 1, b\ntransition t\n  in a\n  out b\n";
    fs::write(folder.path().join("n.net"), text).unwrap();
    let net = |arguments: &[&str]| {
        let ended = ctos(folder.path(), &[&["net"], arguments].concat());
        assert_eq!(ended.code, 0, "{arguments:?}: {}", ended.stderr);
        ended.stdout
    };
    for (form, begins) in [
        ("text", "net n\nplace "),
        ("pnml", "<?xml "),
        ("tina", "net n\npl "),
        ("svg", "<svg "),
        ("dot", "digraph "),
        ("mermaid", "flowchart "),
    ] {
        let converted = net(&["convert", "n.net", "-", "--to", form]);
        assert!(converted.starts_with(begins), "{form}: {converted}");
        assert_eq!(net(&["draw", "n.net", "--to", form]), converted);
    }
    // As it was called before, and as the name of a file says.
    let dot = net(&["draw", "n.net", "--as", "dot"]);
    net(&["convert", "n.net", "n.dot"]);
    assert_eq!(
        fs::read_to_string(folder.path().join("n.dot")).unwrap(),
        dot
    );
}

#[test]
fn a_file_that_is_wrong_leaves_what_was_there_and_says_where_it_is_wrong() {
    let folder = tempfile::tempdir().unwrap();
    let wrong = "<pnml><net id=\"n\" type=\"x/ptnet\">\n<transition id=\"t\"/>\n<arc id=\"a\" source=\"p\" target=\"t\"/></net></pnml>";
    fs::write(folder.path().join("a.pnml"), wrong).unwrap();
    fs::write(folder.path().join("out.net"), "kept").unwrap();
    for arguments in [
        &["net", "convert", "a.pnml", "out.net"][..],
        &["net", "check", "a.pnml"],
    ] {
        let ended = ctos(folder.path(), arguments);
        assert!(
            ended.code == 3 && ended.stdout.is_empty(),
            "{}",
            ended.stderr
        );
        assert!(ended.stderr.contains("a.pnml:3:21"), "{}", ended.stderr);
    }
    assert_eq!(
        fs::read_to_string(folder.path().join("out.net")).unwrap(),
        "kept"
    );
}

#[test]
fn a_line_of_many_megabytes_is_refused_without_being_shown() {
    let folder = tempfile::tempdir().unwrap();
    let text = format!("net n\nplace {}\n", "a".repeat(50 << 20));
    fs::write(folder.path().join("a.net"), text).unwrap();
    let ended = ctos(folder.path(), &["net", "check", "a.net"]);
    assert_eq!(ended.code, 3);
    assert!(ended.stderr.contains("a.net:2:1") && ended.stderr.len() < 1000);
}

#[test]
fn an_action_that_no_task_takes_or_with_other_data_objects_is_found_with_the_app() {
    let folder = tempfile::tempdir().unwrap();
    let app = "[app]\nname = \"t\"\n[chassis.a]\n[task.dom]\nhandler = \"coordinators.dom\"\non = \"a\"\n[task.n]\nhandler = \"coordinators.motion\"\non = \"a\"\nargs.net = \"n.net\"\n";
    fs::write(folder.path().join("app.toml"), app).unwrap();
    let checked = |action: &str| {
        let net = format!(
            "net n\nplace a = 1\ncommand go -> gone\ntransition t\n  in a\n  tape go\n  {action}\n  out a\n  write gone\n"
        );
        fs::write(folder.path().join("n.net"), net).unwrap();
        ctos(folder.path(), &["net", "check", "--app", "app.toml"])
    };
    let sound = checked("send dom.list(-> all)");
    assert_eq!(sound.code, 0, "{}", sound.stderr);
    // All of the fields in one object.
    let whole = checked("send dom.put(entry)");
    assert_eq!(whole.code, 0, "{}", whole.stderr);
    for (action, said) in [
        (
            "send dom.list(-> one, two)",
            "command `list` of task `dom` gives 1 result, and 2 data objects are there to take them",
        ),
        (
            "send dom.put(name, value, more)",
            "command `put` of task `dom` takes 2 arguments, and 3 data objects go with it",
        ),
        ("send dom.lisst", "task `dom` takes no command `lisst`"),
    ] {
        let wrong = checked(action);
        assert_eq!(wrong.code, 3, "{action}: {}", wrong.stderr);
        for said in [said, "n.net:7:8"] {
            assert!(wrong.stderr.contains(said), "{action}: {}", wrong.stderr);
        }
    }
}

//! Panels as a browser meets them, of `scott --panel` and of an app with a task `sorma.panel`. That is the page, its
//! token, and lines that reach the objects.

use std::{
    io::{BufRead, BufReader, Read, Write},
    net::TcpStream,
    os::unix::fs::PermissionsExt,
    process::{Child, Command, Stdio},
};

use crate::common::root;
use serde_json::Value;

/// A panel that is served; it ends with this.
struct Served {
    child: Child,
    address: String,
    token: String,
}

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn serve(what: &str) -> Served {
    let mut child = Command::new(env!("CARGO_BIN_EXE_scott"))
        .current_dir(root())
        .args(["--local", "--panel", what])
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .expect("scott runs");
    let mut line = String::new();
    let stderr = child.stderr.take().expect("a pipe");
    BufReader::new(stderr).read_line(&mut line).expect("a line");
    let (_, place) = line.split_once("http://").expect("an address");
    let place = place.split_whitespace().next().expect("an address");
    let (address, token) = place.split_once("/#").expect("a token");
    Served {
        child,
        address: address.to_owned(),
        token: token.to_owned(),
    }
}

/// An app with one daemon, which serves a panel itself.
fn serve_in_app(control: bool) -> (Served, tempfile::TempDir) {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, text: &str| {
        std::fs::write(folder.path().join(name), text).expect("a file");
    };
    write(
        "foo.toml",
        "title = \"Foo\"\n[[widget]]\nkind = \"readout\"\nlabel = \"Says\"\nask = \"foo.a EXEC\"\n\
         [[widget]]\nkind = \"button\"\nlabel = \"New\"\nask = \"sorm CTRL -create foo.b\"\n",
    );
    write(
        "app.toml",
        &format!(
            "[app]\nname = \"panelled\"\n[chassis.one]\n[chassis.two]\n\
             [task.desk]\nhandler = \"sorma.daemon\"\non = \"two\"\n\
             [task.panel]\nhandler = \"sorma.panel\"\non = \"one\"\n\
             [task.panel.args]\nlisten = \"127.0.0.1:0\"\npanels = [\"foo.toml\"]\nobjects = [\"spot\"]\n\
             allow_control = {control}\n"
        ),
    );
    let mut child = Command::new(env!("CARGO_BIN_EXE_ctos"))
        .current_dir(folder.path())
        .args([
            "boot",
            "app.toml",
            "--log",
            "trace",
            "--log-file",
            "app.log",
        ])
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .expect("ctos runs");
    let mut lines = BufReader::new(child.stderr.take().expect("a pipe")).lines();
    let line = lines
        .by_ref()
        .map_while(Result::ok)
        .find(|line| line.contains("a panel is served"))
        .expect("an address");
    assert!(!line.contains('#'), "a log holds no token: {line}");
    // With control it names a file that has the token.
    let place = match line.split_once("open=") {
        Some((_, file)) => {
            let file = file.split([' ', '\u{1b}']).next().expect("a file");
            std::fs::read_to_string(file).expect("a file that opens the page")
        }
        None => line,
    };
    let (_, place) = place.split_once("http://").expect("an address");
    let place = place.to_owned();
    // It must not stand still because nobody reads what else it says.
    std::thread::spawn(move || lines.for_each(drop));
    let place = place
        .split(['"', ' ', '\u{1b}'])
        .next()
        .expect("an address");
    let (address, token) = place.split_once('/').expect("a path");
    let served = Served {
        child,
        address: address.to_owned(),
        token: token.trim_start_matches('#').to_owned(),
    };
    (served, folder)
}

impl Served {
    /// Status and body of an answer.
    fn http(&self, request: &str, headers: &[(&str, &str)], body: &str) -> (u16, String) {
        let mut text = format!(
            "{request} HTTP/1.1\r\nConnection: close\r\nContent-Length: {}\r\n",
            body.len()
        );
        if !headers.iter().any(|(name, _)| *name == "Host") {
            text.push_str(&format!("Host: {}\r\n", self.address));
        }
        for (name, value) in headers {
            text.push_str(&format!("{name}: {value}\r\n"));
        }
        let mut stream = TcpStream::connect(&self.address).expect("it listens");
        stream
            .write_all(format!("{text}\r\n{body}").as_bytes())
            .expect("it reads");
        let mut answer = String::new();
        stream.read_to_string(&mut answer).expect("it answers");
        let (head, body) = answer.split_once("\r\n\r\n").expect("a head");
        let status = head.split(' ').nth(1).expect("a status");
        (status.parse().expect("a number"), body.to_owned())
    }

    fn ask(&self, line: &str) -> Value {
        let (status, body) = self.http("POST /ask", &[("x-scott-token", &self.token)], line);
        assert_eq!(status, 200, "{body}");
        serde_json::from_str(&body).expect("JSON")
    }
}

#[test]
fn a_panel_shows_what_its_file_says_and_its_lines_reach_the_objects() {
    let served = serve("configs/panels/puma560.toml");
    for (file, part) in [
        ("/", "<!doctype html>"),
        ("/panel.js", "panel.json"),
        ("/panel.css", "prefers-color-scheme"),
    ] {
        let (status, body) = served.http(&format!("GET {file}"), &[], "");
        assert_eq!(status, 200);
        assert!(body.contains(part), "{file}");
    }
    let (status, body) = served.http("GET /panel.json", &[("x-scott-token", &served.token)], "");
    assert_eq!(status, 200);
    let panel: Value = serde_json::from_str(&body).expect("JSON");
    assert_eq!(
        (&panel["title"], &panel["control"]),
        (&"PUMA 560".into(), &true.into())
    );
    let buttons = panel["widgets"].as_array().expect("widgets").iter();
    let buttons: Vec<&Value> = buttons
        .filter(|widget| widget["kind"] == "button")
        .collect();
    let before = served.ask("pino EXEC state")["floats"].clone();
    // The first button does what stands on it.
    served.ask("mvpos EXEC by FMSG 6 0.2 0 0 0 0 0");
    assert_ne!(served.ask("pino EXEC state")["floats"], before);
    let moved = served.ask(buttons[0]["ask"].as_str().expect("a line"));
    assert_eq!(moved["ret"], 0, "{moved}");
    // What is wrong comes back as a reply.
    let wrong = served.ask("mvpos EXEC joints FMSG 6 0 0 0 0 2 0");
    assert!(
        wrong["reports"][0]["text"]
            .as_str()
            .expect("a report")
            .contains("joint 5"),
        "{wrong}"
    );
}

#[test]
fn a_panel_is_made_of_the_option_table_of_an_object() {
    let served = serve("spot");
    let (_, body) = served.http("GET /panel.json", &[("x-scott-token", &served.token)], "");
    let panel: Value = serde_json::from_str(&body).expect("JSON");
    let widget = &panel["widgets"][0];
    assert_eq!(
        (&widget["kind"], &widget["object"]),
        (&"options".into(), &"spot".into())
    );
    let options = widget["class"]["options"].as_array().expect("options");
    assert!(
        options.iter().any(|option| option["name"] == "threshold"),
        "{widget}"
    );
    assert!(
        widget["dump"]
            .as_str()
            .expect("a dump")
            .contains("-threshold")
    );
}

#[test]
fn only_the_page_that_was_opened_by_its_address_may_ask() {
    let served = serve("spot");
    let refused = |request: &str, headers: &[(&str, &str)]| {
        let (status, body) = served.http(request, headers, "foo.a EXEC");
        assert_eq!(status, 403, "{request} {headers:?}: {body}");
    };
    refused("POST /ask", &[]);
    refused("GET /panel.json", &[]);
    refused("POST /ask", &[("x-scott-token", "")]);
    refused(
        "POST /ask",
        &[("x-scott-token", &format!("{}0", served.token))],
    );
    refused(
        "POST /ask",
        &[
            ("x-scott-token", &served.token),
            ("Origin", "http://evil.example"),
        ],
    );
    refused(
        "POST /ask",
        &[("x-scott-token", &served.token), ("Host", "evil.example")],
    );
    let long = "x".repeat(100_000);
    let (status, _) = served.http("POST /ask", &[("x-scott-token", &served.token)], &long);
    assert_eq!(status, 413);
    assert_eq!(served.ask("foo.a EXEC")["ret"], 0);
}

#[test]
fn an_app_serves_its_panels_itself_and_a_page_without_the_token_only_looks_on() {
    let (served, _folder) = serve_in_app(true);
    assert_eq!(served.token.len(), 32);
    // With the token a page may ask anything, of objects in another process.
    assert_eq!(served.ask("sorm CTRL -create foo.a")["ret"], 0);
    let wrong = served.ask("nothing EXEC");
    assert!(
        wrong["reports"][0]["text"].to_string().contains("nothing"),
        "{wrong}"
    );
    for (number, title) in ["Foo", "spot"].iter().enumerate() {
        for (token, control) in [(served.token.as_str(), true), ("", false)] {
            let request = format!("GET /panel.json?n={number}");
            let (status, body) = served.http(&request, &[("x-scott-token", token)], "");
            assert_eq!(status, 200, "{body}");
            let panel: Value = serde_json::from_str(&body).expect("JSON");
            assert_eq!(panel["title"], *title);
            assert_eq!(panel["control"], control);
            assert_eq!(panel["panels"].as_array().map(Vec::len), Some(2));
            if number == 1 {
                assert!(
                    panel["widgets"][0]["dump"]
                        .to_string()
                        .contains("-threshold")
                );
            }
        }
    }
    assert_eq!(served.http("GET /panel.json?n=2", &[], "").0, 404);
    assert_eq!(served.http("GET /panel.json?n=x", &[], "").0, 400);
    // Others see how it stands, and change nothing.
    assert_eq!(served.http("POST /ask", &[], "foo.a EXEC").0, 200);
    for line in ["sorm CTRL -create foo.b", "foo.a CTRL -help", "foo.a EXEC "] {
        let (status, body) = served.http("POST /ask", &[], line);
        assert_eq!(status, 403, "{line}");
        assert!(body.contains("token"), "{body}");
    }
    let listed = served.ask("sorm CTRL -list");
    assert!(!listed["text"].to_string().contains("foo.b"), "{listed}");
    let origin = ("Origin", "http://evil.example");
    assert_eq!(served.http("POST /ask", &[origin], "foo.a EXEC").0, 403);
    assert_eq!(served.http("GET /", &[("Host", "evil.example")], "").0, 403);
}

#[test]
fn no_log_holds_the_token_of_a_page_at_any_level_and_a_log_file_is_its_users_alone() {
    let (served, folder) = serve_in_app(true);
    assert_eq!(served.token.len(), 32);
    assert_eq!(served.ask("sorm CTRL -create foo.a")["ret"], 0);
    let path = folder.path().join("app.log");
    let mode = path.metadata().expect("a log").permissions().mode();
    assert_eq!(mode & 0o777, 0o600);
    let log = std::fs::read_to_string(path).expect("a log");
    assert!(log.contains("a panel is served") && log.contains("TRACE"));
    assert!(!log.contains(&served.token));
}

#[test]
fn a_panel_whose_configuration_allows_no_control_has_no_token() {
    let (served, _folder) = serve_in_app(false);
    assert_eq!(served.token, "");
    assert_eq!(served.http("POST /ask", &[], "foo.a EXEC").0, 200);
    let (status, body) = served.http("POST /ask", &[], "sorm CTRL -create foo.b");
    assert_eq!(status, 403);
    assert!(body.contains("allow_control"), "{body}");
}

#[test]
fn what_is_wrong_with_a_panel_is_found_before_the_app_runs() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("app.toml");
    let check = |args: &str| {
        let text = format!(
            "[chassis.one]\n[task.desk]\nhandler = \"sorma.daemon\"\non = \"one\"\n\
             [task.panel]\nhandler = \"sorma.panel\"\non = \"one\"\n[task.panel.args]\n{args}\n"
        );
        std::fs::write(&path, text).expect("a file");
        let run = Command::new(env!("CARGO_BIN_EXE_ctos"))
            .arg("check")
            .arg(&path)
            .output()
            .expect("ctos runs");
        let text = String::from_utf8_lossy(&run.stderr).into_owned()
            + &String::from_utf8_lossy(&run.stdout);
        (run.status.code(), text)
    };
    assert_eq!(check("objects = [\"spot\"]").0, Some(0));
    for (args, part) in [
        ("", "shows nothing"),
        ("panels = [\"no.toml\"]", "no.toml"),
        ("objects = [\"sp ot\"]", "no name of an object"),
        ("objects = [\"spot\"]\ndaemon = \"dsk\"", "`desk`"),
        ("objects = [\"spot\"]\nalow_control = true", "allow_control"),
    ] {
        let (code, text) = check(args);
        assert_eq!(code, Some(3), "{args}: {text}");
        assert!(text.contains(part), "{args}: {text}");
    }
    let (code, text) =
        check("objects = [\"spot\"]\nlisten = \"0.0.0.0:8109\"\nallow_control = true");
    assert_eq!(code, Some(3), "{text}");
    assert!(
        text.contains("needs keys") && text.contains("ctos keys new"),
        "{text}"
    );
}

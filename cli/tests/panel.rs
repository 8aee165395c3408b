//! `scott --panel` as a browser meets it: the page, its token, and lines that move the arm of the process.

#![allow(
    clippy::expect_used,
    clippy::panic,
    reason = "a test ends when it cannot start"
)]

mod common;

use std::{
    io::{BufRead, BufReader, Read, Write},
    net::TcpStream,
    process::{Child, Command, Stdio},
};

use common::root;
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
    assert_eq!(panel["title"], "PUMA 560");
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

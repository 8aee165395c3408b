//! `ctos net lsp`, driven as an editor does: the real program over its standard input and output.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test may end when the server does not answer as it should"
)]

mod common;

use std::{
    io::{BufReader, Write as _},
    process::{Child, ChildStdin, ChildStdout, Command, Stdio},
};

use common::root;
use lsp_server::{Message, Notification, Request};
use serde_json::{Value, json};

const URI: &str = "file:///tmp/a%20net.net";

const TEXT: &str = "net n\nplace idle = 1, büsy\ncommand go -> gone\ntransition t\n  in idle\n  tape go\n  send operator.\n  out büsy\n  do work\n";

struct Editor {
    server: Child,
    input: Option<ChildStdin>,
    output: BufReader<ChildStdout>,
    asked: i32,
}

impl Editor {
    fn start(arguments: &[&str]) -> Self {
        let mut server = Command::new(env!("CARGO_BIN_EXE_ctos"))
            .args(["net", "lsp"])
            .args(arguments)
            .current_dir(root())
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let input = server.stdin.take();
        let output = BufReader::new(server.stdout.take().unwrap());
        let mut editor = Self {
            server,
            input,
            output,
            asked: 0,
        };
        let answer = editor.ask("initialize", json!({ "capabilities": {} }));
        assert_eq!(answer["capabilities"]["hoverProvider"], json!(true));
        editor.tell("initialized", json!({}));
        editor
    }

    fn send(&mut self, message: &Message) {
        let input = self.input.as_mut().unwrap();
        message.write(input).unwrap();
        input.flush().unwrap();
    }

    fn tell(&mut self, method: &str, params: Value) {
        self.send(&Notification::new(method.to_owned(), params).into());
    }

    fn try_ask(&mut self, method: &str, params: Value) -> Result<Value, String> {
        self.asked += 1;
        let id = self.asked;
        self.send(&Request::new(id.into(), method.to_owned(), params).into());
        match Message::read(&mut self.output).unwrap().unwrap() {
            Message::Response(response) if response.id == id.into() => {
                match serde_json::to_value(&response).unwrap() {
                    Value::Object(mut object) => match object.remove("error") {
                        Some(error) => Err(error["message"].to_string()),
                        None => Ok(object.remove("result").unwrap_or_default()),
                    },
                    other => panic!("{other}"),
                }
            }
            other => panic!("{other:?}"),
        }
    }

    fn ask(&mut self, method: &str, params: Value) -> Value {
        self.try_ask(method, params)
            .unwrap_or_else(|error| panic!("{method}: {error}"))
    }

    /// Opens or changes the text; what is found in it.
    fn open(&mut self, text: &str) -> Vec<Value> {
        self.tell(
            "textDocument/didOpen",
            json!({ "textDocument": { "uri": URI, "languageId": "net", "version": 1, "text": text } }),
        );
        self.published()
    }

    fn published(&mut self) -> Vec<Value> {
        match Message::read(&mut self.output).unwrap().unwrap() {
            Message::Notification(told) => {
                assert_eq!(told.method, "textDocument/publishDiagnostics");
                told.params["diagnostics"].as_array().unwrap().clone()
            }
            other => panic!("{other:?}"),
        }
    }

    fn at(&mut self, method: &str, line: u32, character: u32) -> Value {
        self.ask(method, position(line, character))
    }

    fn offered(&mut self, line: u32, character: u32) -> Vec<String> {
        let items = self.at("textDocument/completion", line, character);
        let items = items.as_array().unwrap().iter();
        items
            .map(|item| item["label"].as_str().unwrap().to_owned())
            .collect()
    }

    fn end(mut self) {
        self.ask("shutdown", Value::Null);
        self.tell("exit", Value::Null);
        self.input = None;
        assert_eq!(self.server.wait().unwrap().code(), Some(0));
    }
}

fn position(line: u32, character: u32) -> Value {
    json!({ "textDocument": { "uri": URI }, "position": { "line": line, "character": character } })
}

#[test]
fn findings_are_told_with_every_change() {
    let mut editor = Editor::start(&[]);
    let found = editor.open("net n\nplace idle = 1\ntransition t\n  in idel\n");
    assert_eq!(found.len(), 1, "{found:#?}");
    assert_eq!(found[0]["code"], "pnt::net::unknown_place");
    assert_eq!(
        found[0]["range"],
        json!({ "start": { "line": 3, "character": 5 }, "end": { "line": 3, "character": 9 } })
    );
    assert!(
        found[0]["message"]
            .as_str()
            .unwrap()
            .contains("did you mean `idle`?")
    );
    let mut change = |text: &str| {
        editor.tell(
            "textDocument/didChange",
            json!({ "textDocument": { "uri": URI, "version": 2 }, "contentChanges": [{ "text": text }] }),
        );
        let found = editor.published();
        found
            .iter()
            .map(|found| found["code"].clone())
            .collect::<Vec<Value>>()
    };
    let text = "net n\nplace idle = 1\ntransition t\n  in idle\n  out idle\n";
    assert_eq!(change(text), Vec::<Value>::new());
    // What the text means is looked at as well, unless it works with nets that are not at hand.
    let stops = text.replace("  out idle\n", "");
    assert_eq!(change(&stops), ["pnt::check::deadlock"]);
    assert_eq!(
        change(&text.replace("out idle", "out idle@m")),
        Vec::<Value>::new()
    );
    editor.end();
}

#[test]
fn places_symbols_tasks_and_commands_are_offered_where_they_fit() {
    let mut editor = Editor::start(&["--app", "configs/calibrate.toml"]);
    editor.open(
        &TEXT
            .replace("operator", "dispatcher")
            .replace("büsy", "busy"),
    );
    assert_eq!(editor.offered(4, 5), ["busy", "idle"]);
    assert_eq!(editor.offered(5, 7), ["go"]);
    let commands = editor.offered(6, 18);
    assert!(commands.contains(&"put_tape".to_owned()), "{commands:?}");
    assert!(editor.offered(6, 7).contains(&"dispatcher".to_owned()));
    assert!(editor.offered(5, 2).contains(&"inhibit".to_owned()));
    assert!(!editor.offered(1, 0).contains(&"inhibit".to_owned()));
    editor.end();
}

#[test]
fn a_name_is_explained_found_and_renamed_everywhere() {
    let mut editor = Editor::start(&[]);
    let text = TEXT
        .replace("büsy", "\"büsy\"")
        .replace("  send operator.\n", "");
    editor.open(&text);
    // The `ü` is one unit of the protocol's columns and two bytes of the text.
    let hover = editor.at("textDocument/hover", 6, 8);
    let told = hover["contents"]["value"].as_str().unwrap();
    assert!(
        told.contains("place `büsy`") && told.contains("used by t"),
        "{told}"
    );
    let keyword = editor.at("textDocument/hover", 5, 3);
    assert!(
        keyword["contents"]["value"]
            .as_str()
            .unwrap()
            .contains("input tape")
    );
    let declared = editor.at("textDocument/definition", 6, 8);
    assert_eq!(
        declared["range"]["start"],
        json!({ "line": 1, "character": 16 })
    );
    assert_eq!(
        editor
            .at("textDocument/references", 6, 8)
            .as_array()
            .unwrap()
            .len(),
        2
    );
    let rename = |to: &str| {
        let mut params = position(6, 8);
        params["newName"] = json!(to);
        params
    };
    let edits = editor.ask("textDocument/rename", rename("in hand"));
    let edits = edits["changes"][URI].as_array().unwrap();
    assert_eq!(edits.len(), 2);
    assert!(
        edits.iter().all(|edit| edit["newText"] == "\"in hand\""),
        "{edits:#?}"
    );
    let taken = editor.try_ask("textDocument/rename", rename("idle"));
    assert!(
        taken
            .unwrap_err()
            .contains("there is a place `idle` already")
    );
    editor.end();
}

#[test]
fn a_text_is_laid_out_and_what_is_not_served_is_refused() {
    let mut editor = Editor::start(&[]);
    editor.open("net   n\nplace p=1\ntransition t\nin p\n");
    let edits = editor.ask("textDocument/formatting", position(0, 0));
    assert_eq!(
        edits[0]["newText"],
        "net n\nplace p = 1\ntransition t\n  in p\n"
    );
    let symbols = editor.ask("textDocument/documentSymbol", position(0, 0));
    assert_eq!(symbols.as_array().unwrap().len(), 2);
    assert!(
        editor
            .try_ask("textDocument/foldingRange", position(0, 0))
            .is_err()
    );
    let mut elsewhere = position(0, 0);
    elsewhere["textDocument"]["uri"] = json!("file:///nowhere");
    assert!(editor.try_ask("textDocument/hover", elsewhere).is_err());
    // Positions far behind the text are the end of it.
    editor.at("textDocument/hover", 4_000_000_000, 4_000_000_000);
    editor.end();
}

//! `ctos net lsp`, driven as an editor does: the real program over its standard input and output.

use std::{
    io::{BufReader, Write as _},
    process::{Child, ChildStdin, ChildStdout, Command, Stdio},
};

use crate::common::root;
use ctos::diagnostic::Source;
use lsp_server::{Message, Notification, Request};
use pnt::net::PlaceId;
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
        Self::start_in(arguments, json!({ "capabilities": {} }))
    }

    fn start_in(arguments: &[&str], client: Value) -> Self {
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
        let answer = editor.ask("initialize", client);
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
    // The functions of all nets of the app, as this one is none of them.
    assert!(editor.offered(8, 5).contains(&"init_calib".to_owned()));
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

const LEFT: &str = "net left
include \"lib/parts.net\"
command go -> gone
place idle = 1
use hand(idle) as one
transition ask
  in one.closed
  tape go
  out one.open
  write gone
";

const RIGHT: &str = "net right
include \"lib/parts.net\"
place idle = 1
use hand(idle) as two
transition again
  in two.closed
  out two.open
";

const PARTS: &str = "subnet hand(free)
place open, closed = 1
transition close
  in open, free
  out closed, free
end
";

/// Applies the edits of one file, last one first.
fn edited(text: &str, edits: &[Value]) -> String {
    let offset = |position: &Value| {
        let line = position["line"].as_u64().unwrap();
        let before: usize = text
            .split_inclusive('\n')
            .take(usize::try_from(line).unwrap())
            .map(str::len)
            .sum();
        before + usize::try_from(position["character"].as_u64().unwrap()).unwrap()
    };
    let mut changed = text.to_owned();
    let mut edits: Vec<(usize, usize, &str)> = edits
        .iter()
        .map(|edit| {
            let (start, end) = (&edit["range"]["start"], &edit["range"]["end"]);
            (
                offset(start),
                offset(end),
                edit["newText"].as_str().unwrap(),
            )
        })
        .collect();
    edits.sort_unstable();
    for (start, end, new) in edits.into_iter().rev() {
        changed.replace_range(start..end, new);
    }
    changed
}

#[test]
fn a_name_of_a_subnet_is_renamed_in_its_file_and_in_every_net_that_includes_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    std::fs::create_dir(path("lib")).unwrap();
    std::fs::write(
        path("left.net"),
        "net left\n# What is on disk is older than what is open.\n",
    )
    .unwrap();
    std::fs::write(path("right.net"), RIGHT).unwrap();
    std::fs::write(path("lib/parts.net"), PARTS).unwrap();
    let uri = |name: &str| format!("file://{}", path(name).display());
    let client = json!({
        "capabilities": {},
        "workspaceFolders": [{ "uri": uri(""), "name": "nets" }],
    });
    let mut editor = Editor::start_in(&[], client);
    for (name, text) in [("lib/parts.net", PARTS), ("left.net", LEFT)] {
        editor.tell(
            "textDocument/didOpen",
            json!({ "textDocument": { "uri": uri(name), "languageId": "net", "version": 1, "text": text } }),
        );
        assert_eq!(editor.published(), Vec::<Value>::new(), "{name}");
    }
    let at = |name: &str, line: u32, character: u32| json!({ "textDocument": { "uri": uri(name) }, "position": { "line": line, "character": character } });
    // From the instance's place in a net to its declaration in the file of the subnet.
    let declared = editor.ask("textDocument/definition", at("left.net", 8, 11));
    assert_eq!(declared["uri"], json!(uri("lib/parts.net")));
    assert_eq!(
        declared["range"]["start"],
        json!({ "line": 1, "character": 6 })
    );
    let told = editor.ask("textDocument/hover", at("left.net", 8, 11));
    let told = told["contents"]["value"].as_str().unwrap().to_owned();
    assert!(
        told.contains("in parts.net:\n\n```\nplace open, closed = 1\n```"),
        "{told}"
    );
    // From the name of an included file into it.
    let included = editor.ask("textDocument/definition", at("left.net", 1, 12));
    assert_eq!(included["uri"], json!(uri("lib/parts.net")));
    assert_eq!(
        editor.ask("textDocument/definition", at("left.net", 1, 3)),
        Value::Null
    );
    let places = editor.ask("textDocument/references", at("lib/parts.net", 1, 7));
    assert_eq!(places.as_array().unwrap().len(), 4);
    for (name, line, character, old, new) in [
        ("lib/parts.net", 1, 7, "open", "spread"),
        ("left.net", 8, 11, "open", "wide_open"),
        ("left.net", 4, 5, "hand", "a gripper"),
        ("lib/parts.net", 3, 12, "free", "f"),
    ] {
        let mut params = at(name, line, character);
        params["newName"] = json!(new);
        let edits = editor.ask("textDocument/rename", params);
        let after = |name: &str, text: &str| {
            let edits = edits["changes"][uri(name)].as_array();
            edited(text, edits.map_or(&[], Vec::as_slice))
        };
        let parts = after("lib/parts.net", PARTS);
        for (name, text) in [("left.net", LEFT), ("right.net", RIGHT)] {
            let before = flat(text, PARTS);
            let renamed = flat(&after(name, text), &parts);
            let wanted = match old {
                "open" => before.replace(&format!(".{old}\""), &format!(".{new}\"")),
                // The name of a subnet and those of its parameters are not in the net that it makes.
                _ => before.clone(),
            };
            assert_eq!(renamed, wanted, "{old} to {new} in {name}");
            assert_eq!(renamed == before, old != "open", "{old} to {new} in {name}");
            // The text itself has changed wherever the name stands.
            assert_eq!(
                after(name, text) == text,
                old == "free",
                "{old} to {new} in {name}"
            );
        }
        assert_ne!(parts, PARTS);
    }
    let mut params = at("left.net", 8, 11);
    params["newName"] = json!("closed");
    let refused = editor.try_ask("textDocument/rename", params).unwrap_err();
    assert!(
        refused.contains("there is a place `closed` already, in parts.net"),
        "{refused}"
    );
    // What is changed in the file of subnets is looked at in the open net that includes it.
    editor.tell(
        "textDocument/didChange",
        json!({
            "textDocument": { "uri": uri("lib/parts.net"), "version": 2 },
            "contentChanges": [{ "text": PARTS.replace("open", "ajar") }],
        }),
    );
    assert_eq!(editor.published(), Vec::<Value>::new());
    let found = editor.published();
    assert_eq!(found.len(), 1, "{found:#?}");
    assert_eq!(found[0]["code"], "pnt::net::unknown_place");
    editor.end();
}

/// Places, transitions and arcs of a net with what it includes, names in quotes.
fn flat(net: &str, parts: &str) -> String {
    let net = pnt::compile::net_with(&Source::new("n.net", net), &mut |file| {
        assert_eq!(file, "lib/parts.net");
        Ok(Source::new(file, parts))
    })
    .unwrap_or_else(|found| panic!("{found}"));
    let name = |place: &PlaceId| net.places()[place.index()].name.clone();
    let mut shown = String::new();
    for place in net.places() {
        shown += &format!("{:?} = {}\n", place.name, place.tokens);
    }
    for transition in net.transitions() {
        let arcs = |arcs: &[pnt::net::Arc]| -> Vec<(String, u32)> {
            arcs.iter()
                .map(|arc| (name(&arc.place), arc.weight))
                .collect()
        };
        shown += &format!(
            "{:?} {:?} {:?} {:?}\n",
            transition.name,
            arcs(&transition.inputs),
            arcs(&transition.outputs.local),
            transition.write,
        );
    }
    shown
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

//! `ctos net lsp`: net text in editors, over the Language Server Protocol on standard input and output.

mod document;
mod workspace;

use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
};

use clap::Args;
use cli_common::{exit, show};
use ctos::{
    config::Selection,
    diagnostic::Source,
    registry::{Registry, Vocabulary},
};
use lsp_server::{Connection, ErrorCode, Message, Notification, Request, Response};
use serde_json::{Value, json};

use crate::ReadApp;
use document::{Document, line_at, path_of, uri_of};
use workspace::{Spot, Workspace};

/// Serve an editor: findings as you type, completion, hover, rename, go to definition, layout
///
/// Speaks the Language Server Protocol on standard input and output; an editor starts it. With `--app` the tasks of an
/// app and their commands are offered, too.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  ctos net lsp
  ctos net lsp --app configs/calibrate.toml")]
pub struct LspArgs {
    /// Configuration of the app whose tasks and commands are offered
    #[arg(long, value_name = "FILE")]
    pub app: Option<PathBuf>,
}

/// What can be offered beside the words of the text itself.
#[derive(Debug, Default)]
pub struct Offered {
    /// Commands of each task, with their help.
    pub tasks: BTreeMap<String, Vec<(String, String)>>,
    /// The functions of each net, which is called as its task is.
    pub functions: BTreeMap<String, Vocabulary>,
}

impl Offered {
    fn of(
        app: Option<&PathBuf>,
        registry: &Registry,
        read: ReadApp,
    ) -> Result<Self, ctos::diagnostic::Findings> {
        let Some(file) = app else {
            return Ok(Self::default());
        };
        let app = read(&Selection {
            file: file.clone(),
            profiles: Vec::new(),
            sets: Vec::new(),
        })?;
        let commands = |handler: &str| {
            let kind = registry.kind(handler)?;
            let shown = |command: &ctos::message::CommandInfo| {
                (command.name.to_owned(), command.doc.to_owned())
            };
            Some(kind.commands().iter().map(shown).collect())
        };
        let tasks = app.tasks.iter().map(|task| {
            let commands = commands(&task.handler).unwrap_or_default();
            (task.name.clone(), commands)
        });
        let functions = app.tasks.iter().filter_map(|task| {
            let words = registry.kind(&task.handler)?.vocabulary(task);
            Some((task.name.clone(), words))
        });
        Ok(Self {
            tasks: tasks.collect(),
            functions: functions.collect(),
        })
    }

    /// The functions of one kind that a net may use; all that are known if it is none of the app's.
    pub fn functions(&self, net: Option<&str>, what: &str) -> BTreeSet<&str> {
        let own = net.and_then(|net| self.functions.get(net));
        let all = self.functions.values().filter(|_| own.is_none());
        let words = own
            .into_iter()
            .chain(all)
            .filter_map(|words| words.get(what));
        words.flatten().map(String::as_str).collect()
    }
}

/// Runs the command.
#[must_use]
pub fn run(args: &LspArgs, registry: &Registry, read: ReadApp) -> u8 {
    let offered = match Offered::of(args.app.as_ref(), registry, read) {
        Ok(offered) => offered,
        Err(findings) => {
            show::findings(findings);
            return exit::CONFIG;
        }
    };
    let (connection, threads) = Connection::stdio();
    let served = serve(&connection, &offered);
    // The writing thread ends when nobody can send any more.
    drop(connection);
    let ended = threads.join();
    match (served, ended) {
        (Ok(()), Ok(())) => exit::OK,
        (Err(error), _) => {
            show::say(&format!("error: {error}"));
            exit::FAILED
        }
        (_, Err(error)) => {
            show::say(&format!("error: {error}"));
            exit::FAILED
        }
    }
}

fn capabilities() -> Value {
    json!({
        // The whole text with every change: nets are small.
        "textDocumentSync": 1,
        "completionProvider": { "triggerCharacters": [" ", ".", "@"] },
        "hoverProvider": true,
        "definitionProvider": true,
        "referencesProvider": true,
        "documentSymbolProvider": true,
        "documentFormattingProvider": true,
        "renameProvider": { "prepareProvider": true },
    })
}

/// Answers until the editor says that it is enough.
fn serve(connection: &Connection, offered: &Offered) -> Result<(), lsp_server::ProtocolError> {
    let client = connection.initialize(capabilities())?;
    let mut editor = Editor {
        documents: BTreeMap::new(),
        folders: folders(&client),
    };
    for message in &connection.receiver {
        match message {
            Message::Request(request) => {
                if connection.handle_shutdown(&request)? {
                    return Ok(());
                }
                let response = editor.answer(request, offered);
                // An editor that is gone needs no answer; the loop ends with its messages.
                let _ = connection.sender.send(response.into());
            }
            Message::Notification(notification) => {
                for told in editor.take(&notification) {
                    let _ = connection.sender.send(told.into());
                }
            }
            Message::Response(_) => {}
        }
    }
    Ok(())
}

/// The folders that an editor works in, by what it says of itself.
fn folders(client: &Value) -> Vec<PathBuf> {
    let listed = client["workspaceFolders"].as_array();
    let listed = listed.into_iter().flatten().map(|folder| &folder["uri"]);
    let mut folders: Vec<PathBuf> = listed.filter_map(|uri| path_of(uri.as_str()?)).collect();
    if folders.is_empty() {
        folders.extend(client["rootUri"].as_str().and_then(path_of));
    }
    folders
}

fn published(uri: &str, findings: &[Value]) -> Notification {
    let params = json!({ "uri": uri, "diagnostics": findings });
    Notification::new("textDocument/publishDiagnostics".to_owned(), params)
}

/// What an editor has open.
struct Editor {
    /// By their addresses.
    documents: BTreeMap<String, Document>,
    /// Where it works.
    folders: Vec<PathBuf>,
}

impl Editor {
    /// Takes what the editor tells about a document; the findings about it, and about those that include it.
    fn take(&mut self, told: &Notification) -> Vec<Notification> {
        let params = &told.params;
        let Some(uri) = params["textDocument"]["uri"].as_str() else {
            return Vec::new();
        };
        let text = match told.method.as_str() {
            "textDocument/didOpen" => &params["textDocument"]["text"],
            "textDocument/didChange" => {
                let changes = params["contentChanges"].as_array();
                changes
                    .and_then(|changes| changes.last())
                    .map_or(&Value::Null, |last| &last["text"])
            }
            "textDocument/didClose" => {
                let closed = self.documents.remove(uri);
                let mut told = vec![published(uri, &[])];
                // From now on what is on disk counts.
                told.extend(closed.into_iter().flat_map(|closed| self.users(&closed)));
                return told;
            }
            _ => return Vec::new(),
        };
        let Some(text) = text.as_str() else {
            return Vec::new();
        };
        let document = Document::new(uri, text);
        self.documents.insert(uri.to_owned(), document);
        let Some(document) = self.documents.get(uri) else {
            return Vec::new();
        };
        let mut told = vec![published(uri, &document.findings(&self.open()))];
        told.extend(self.users(document));
        told
    }

    /// The findings about the open documents that include one.
    fn users(&self, document: &Document) -> Vec<Notification> {
        let open = self.open();
        let mut texts = open.clone();
        // Also of one that was closed a moment ago.
        texts.insert(document.path().to_owned(), document.source().clone());
        let all = Workspace::of(texts);
        let users: BTreeSet<_> = all.users(document.path()).collect();
        let documents = self.documents.iter();
        documents
            .filter(|(_, user)| users.contains(user.path()))
            .map(|(uri, user)| published(uri, &user.findings(&open)))
            .collect()
    }

    /// The texts that are open, by their files.
    fn open(&self) -> BTreeMap<PathBuf, Source> {
        let documents = self.documents.values();
        documents
            .map(|document| (document.path().to_owned(), document.source().clone()))
            .collect()
    }

    fn answer(&self, request: Request, offered: &Offered) -> Response {
        let Request { id, method, params } = request;
        let uri = params["textDocument"]["uri"].as_str().unwrap_or_default();
        let Some(document) = self.documents.get(uri) else {
            let text = format!("`{uri}` is not open");
            return Response::new_err(id, ErrorCode::InvalidParams as i32, text);
        };
        let at = document.offset(&params["position"]);
        let result = match method.as_str() {
            "textDocument/completion" => Ok(self.completions(document, at, offered)),
            "textDocument/hover" => Ok(self.hover(document, at)),
            "textDocument/definition" => Ok(self.definition(document, at)),
            "textDocument/references" => Ok(self.references(document, at)),
            "textDocument/documentSymbol" => Ok(document.symbols()),
            "textDocument/formatting" => Ok(document.formatted()),
            "textDocument/prepareRename" => Ok(document.renamed_range(at)),
            "textDocument/rename" => {
                let name = params["newName"].as_str().unwrap_or_default();
                self.rename(document, at, name)
            }
            other => {
                let text = format!("`{other}` is not served");
                return Response::new_err(id, ErrorCode::MethodNotFound as i32, text);
            }
        };
        match result {
            Ok(value) => Response::new_ok(id, value),
            Err(text) => Response::new_err(id, ErrorCode::RequestFailed as i32, text),
        }
    }

    // -- what is looked for in more files than one ------------------------------------------

    /// All nets around a document.
    fn around(&self, document: &Document) -> Workspace {
        Workspace::around(document.path(), &self.folders, self.open())
    }

    fn hover(&self, document: &Document, at: usize) -> Value {
        let around = self.around(document);
        let spot = document.spot(at);
        let declared = spot.map_or_else(BTreeSet::new, |spot| around.declarations(&spot));
        let elsewhere = declared.iter().find(|spot| spot.file != document.path());
        let elsewhere = elsewhere.and_then(|spot| {
            let text = around.text(&spot.file)?.text();
            Some((spot.file.as_path(), line_at(text, spot.bytes.0)))
        });
        document.hover(at, elsewhere)
    }

    fn completions(&self, document: &Document, at: usize, offered: &Offered) -> Value {
        let around = self.around(document);
        match around.whole(document.path()) {
            Some((net, whole)) => document.completions(at, offered, (net, whole)),
            None => json!([]),
        }
    }

    /// Where the word at a byte is declared: in one place, or in each net that includes its file.
    fn definition(&self, document: &Document, at: usize) -> Value {
        let around = self.around(document);
        if let Some(file) = document.included(at) {
            let there = around.text(&file).is_some();
            let start = json!({ "line": 0, "character": 0 });
            let range = json!({ "start": start, "end": start });
            return if there {
                json!({ "uri": self.uri(&file), "range": range })
            } else {
                Value::Null
            };
        }
        let spot = document.spot(at);
        let declared = spot.map(|spot| around.declarations(&spot));
        let mut places = self.locations(&around, declared.unwrap_or_default());
        match places.len() {
            0 => Value::Null,
            1 => places.remove(0),
            _ => Value::Array(places),
        }
    }

    /// Everywhere where the word at a byte stands for the same thing.
    fn references(&self, document: &Document, at: usize) -> Value {
        let around = self.around(document);
        let Some(spot) = document.spot(at) else {
            return Value::Null;
        };
        Value::Array(self.locations(&around, around.same(&spot)))
    }

    /// The edits by which the word at a byte gets another name wherever it stands for the same thing.
    fn rename(&self, document: &Document, at: usize, name: &str) -> Result<Value, String> {
        let around = self.around(document);
        let spot = document.spot(at).ok_or("there is no name here")?;
        if name.trim().is_empty() {
            return Err("a name is not empty".to_owned());
        }
        let new = pnt::text::name_in_text(name);
        let mut changes: BTreeMap<String, Vec<Value>> = BTreeMap::new();
        for place in self.locations(&around, around.renamed(&spot, name)?) {
            let uri = place["uri"].as_str().unwrap_or_default().to_owned();
            let edit = json!({ "range": place["range"], "newText": new });
            changes.entry(uri).or_default().push(edit);
        }
        Ok(json!({ "changes": changes }))
    }

    /// A file's address: as the editor has it, where it is open.
    fn uri(&self, file: &Path) -> String {
        let mut open = self.documents.iter();
        let open = open.find(|(_, document)| document.path() == file);
        open.map_or_else(|| uri_of(file), |(uri, _)| uri.clone())
    }

    /// Places as the protocol has them.
    fn locations(&self, around: &Workspace, spots: BTreeSet<Spot>) -> Vec<Value> {
        let mut read: BTreeMap<PathBuf, (String, Document)> = BTreeMap::new();
        let mut places = Vec::new();
        for spot in spots {
            if !read.contains_key(&spot.file) {
                let uri = self.uri(&spot.file);
                let text = around.text(&spot.file).map_or("", Source::text);
                let document = Document::new(&uri, text);
                read.insert(spot.file.clone(), (uri, document));
            }
            if let Some((uri, document)) = read.get(&spot.file) {
                places.push(json!({ "uri": uri, "range": document.range(&spot.range()) }));
            }
        }
        places
    }
}

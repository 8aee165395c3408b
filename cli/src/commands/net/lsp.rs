//! `ctos net lsp`: net text in editors, over the Language Server Protocol on standard input and output.

mod document;

use std::{collections::BTreeMap, path::PathBuf};

use clap::Args;
use ctos::{config::Selection, registry::Registry};
use lsp_server::{Connection, ErrorCode, Message, Notification, Request, Response};
use serde_json::{Value, json};

use crate::{exit, program, show};
use document::Document;

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
}

impl Offered {
    fn of(app: Option<&PathBuf>, registry: &Registry) -> Result<Self, ctos::diagnostic::Findings> {
        let Some(file) = app else {
            return Ok(Self::default());
        };
        let app = program::app(&Selection {
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
        Ok(Self {
            tasks: tasks.collect(),
        })
    }
}

/// Runs the command.
#[must_use]
pub fn run(args: &LspArgs, registry: &Registry) -> u8 {
    let offered = match Offered::of(args.app.as_ref(), registry) {
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
    connection.initialize(capabilities())?;
    let mut documents: BTreeMap<String, Document> = BTreeMap::new();
    for message in &connection.receiver {
        match message {
            Message::Request(request) => {
                if connection.handle_shutdown(&request)? {
                    return Ok(());
                }
                let response = answer(request, &documents, offered);
                // An editor that is gone needs no answer; the loop ends with its messages.
                let _ = connection.sender.send(response.into());
            }
            Message::Notification(notification) => {
                if let Some(told) = take(&notification, &mut documents) {
                    let _ = connection.sender.send(told.into());
                }
            }
            Message::Response(_) => {}
        }
    }
    Ok(())
}

/// Takes what the editor tells about a document; the findings about it.
fn take(told: &Notification, documents: &mut BTreeMap<String, Document>) -> Option<Notification> {
    let params = &told.params;
    let uri = params["textDocument"]["uri"].as_str()?;
    let text = match told.method.as_str() {
        "textDocument/didOpen" => params["textDocument"]["text"].as_str()?,
        "textDocument/didChange" => {
            params["contentChanges"].as_array()?.last()?["text"].as_str()?
        }
        "textDocument/didClose" => {
            documents.remove(uri);
            return Some(published(uri, &[]));
        }
        _ => return None,
    };
    let document = Document::new(uri, text);
    let findings = document.findings();
    documents.insert(uri.to_owned(), document);
    Some(published(uri, &findings))
}

fn published(uri: &str, findings: &[Value]) -> Notification {
    let params = json!({ "uri": uri, "diagnostics": findings });
    Notification::new("textDocument/publishDiagnostics".to_owned(), params)
}

fn answer(request: Request, documents: &BTreeMap<String, Document>, offered: &Offered) -> Response {
    let Request { id, method, params } = request;
    let uri = params["textDocument"]["uri"].as_str().unwrap_or_default();
    let Some(document) = documents.get(uri) else {
        let text = format!("`{uri}` is not open");
        return Response::new_err(id, ErrorCode::InvalidParams as i32, text);
    };
    let at = document.offset(&params["position"]);
    let result = match method.as_str() {
        "textDocument/completion" => Ok(document.completions(at, offered)),
        "textDocument/hover" => Ok(document.hover(at)),
        "textDocument/definition" => Ok(document.definition(uri, at)),
        "textDocument/references" => Ok(document.references(uri, at)),
        "textDocument/documentSymbol" => Ok(document.symbols()),
        "textDocument/formatting" => Ok(document.formatted()),
        "textDocument/prepareRename" => Ok(document.renamed_range(at)),
        "textDocument/rename" => {
            let name = params["newName"].as_str().unwrap_or_default();
            document.rename(uri, at, name)
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

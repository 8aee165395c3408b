//! `ctos net lsp`: net text in editors, over the Language Server Protocol on standard input and output.

mod document;
mod offered;
mod workspace;

use std::{
    collections::{BTreeMap, BTreeSet, HashMap},
    fmt,
    path::{Path, PathBuf},
};

use clap::Args;
use cli_common::{exit, show};
use ctos::{diagnostic::Source, registry::Registry};
use lsp_server::{Connection, ErrorCode, Message, Notification, Request, Response};
use lsp_types::{
    CompletionItem, CompletionOptions, Diagnostic, DidChangeTextDocumentParams,
    DidCloseTextDocumentParams, DidOpenTextDocumentParams, DocumentSymbolParams,
    GotoDefinitionResponse, Hover, HoverProviderCapability, Location, OneOf, PrepareRenameResponse,
    PublishDiagnosticsParams, Range, RenameOptions, ServerCapabilities, TextDocumentPositionParams,
    TextDocumentSyncKind, TextEdit, Uri, WorkDoneProgressOptions, WorkspaceEdit, WorkspaceFolder,
    notification::{
        DidChangeTextDocument, DidCloseTextDocument, DidOpenTextDocument, Notification as _,
        PublishDiagnostics,
    },
    request::{
        self, Completion, DocumentSymbolRequest, Formatting, GotoDefinition, HoverRequest,
        PrepareRenameRequest, References, Rename, Request as _,
    },
};
use serde_json::Value;

use crate::ReadApp;
use document::{Document, line_at, path_of, uri_of};
use offered::Offered;
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

fn capabilities() -> ServerCapabilities {
    ServerCapabilities {
        // The whole text with every change: nets are small.
        text_document_sync: Some(TextDocumentSyncKind::FULL.into()),
        completion_provider: Some(CompletionOptions {
            trigger_characters: Some([" ", ".", "@"].map(str::to_owned).to_vec()),
            ..CompletionOptions::default()
        }),
        hover_provider: Some(HoverProviderCapability::Simple(true)),
        definition_provider: Some(OneOf::Left(true)),
        references_provider: Some(OneOf::Left(true)),
        document_symbol_provider: Some(OneOf::Left(true)),
        document_formatting_provider: Some(OneOf::Left(true)),
        rename_provider: Some(OneOf::Right(RenameOptions {
            prepare_provider: Some(true),
            work_done_progress_options: WorkDoneProgressOptions::default(),
        })),
        ..ServerCapabilities::default()
    }
}

/// Answers until the editor says that it is enough.
fn serve(connection: &Connection, offered: &Offered) -> Result<(), ServeError> {
    let client = connection.initialize(serde_json::to_value(capabilities())?)?;
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
                for told in editor.take(notification) {
                    let told = Notification::new(PublishDiagnostics::METHOD.to_owned(), told);
                    let _ = connection.sender.send(told.into());
                }
            }
            Message::Response(_) => {}
        }
    }
    Ok(())
}

/// Why an editor is served no more.
#[derive(Debug, thiserror::Error)]
enum ServeError {
    #[error(transparent)]
    Protocol(#[from] lsp_server::ProtocolError),
    #[error(transparent)]
    Json(#[from] serde_json::Error),
}

/// The folders that an editor works in, by what it says of itself; what else it says is not looked at.
fn folders(client: &Value) -> Vec<PathBuf> {
    let listed = serde_json::from_value(client["workspaceFolders"].clone());
    let listed: Vec<WorkspaceFolder> = listed.unwrap_or_default();
    let mut folders: Vec<PathBuf> = listed
        .iter()
        .filter_map(|folder| path_of(folder.uri.as_str()))
        .collect();
    if folders.is_empty() {
        folders.extend(client["rootUri"].as_str().and_then(path_of));
    }
    folders
}

fn published(uri: &Uri, diagnostics: Vec<Diagnostic>) -> PublishDiagnosticsParams {
    PublishDiagnosticsParams::new(uri.clone(), diagnostics, None)
}

/// Why a request is not answered.
struct Refused(ErrorCode, String);

impl Refused {
    fn invalid(reason: impl fmt::Display) -> Self {
        Self(ErrorCode::InvalidParams, reason.to_string())
    }
}

/// Checks that what is answered is what the protocol wants there.
fn answered<R: request::Request>(answer: R::Result) -> Result<Value, Refused> {
    serde_json::to_value(answer)
        .map_err(|error| Refused(ErrorCode::InternalError, error.to_string()))
}

/// What an editor has open.
struct Editor {
    /// By their addresses.
    documents: BTreeMap<Uri, Document>,
    /// Where it works.
    folders: Vec<PathBuf>,
}

impl Editor {
    /// Takes what the editor tells about a document; the findings about it, and about those that include it.
    fn take(&mut self, told: Notification) -> Vec<PublishDiagnosticsParams> {
        let Notification { method, params } = told;
        // A notification that cannot be read is dropped, because it has no answer.
        match method.as_str() {
            DidOpenTextDocument::METHOD => {
                let read = serde_json::from_value(params);
                let Ok(DidOpenTextDocumentParams { text_document }) = read else {
                    return Vec::new();
                };
                self.changed(text_document.uri, &text_document.text)
            }
            DidChangeTextDocument::METHOD => {
                let read = serde_json::from_value(params);
                let Ok(DidChangeTextDocumentParams {
                    text_document,
                    content_changes,
                }) = read
                else {
                    return Vec::new();
                };
                let last = content_changes.last();
                last.map_or_else(Vec::new, |last| self.changed(text_document.uri, &last.text))
            }
            DidCloseTextDocument::METHOD => {
                let read = serde_json::from_value(params);
                let Ok(DidCloseTextDocumentParams { text_document }) = read else {
                    return Vec::new();
                };
                let closed = self.documents.remove(&text_document.uri);
                let mut told = vec![published(&text_document.uri, Vec::new())];
                // From now on what is on disk counts.
                told.extend(closed.into_iter().flat_map(|closed| self.users(&closed)));
                told
            }
            _ => Vec::new(),
        }
    }

    /// A document as it is from now on.
    fn changed(&mut self, uri: Uri, text: &str) -> Vec<PublishDiagnosticsParams> {
        self.documents
            .insert(uri.clone(), Document::new(&uri, text));
        let Some(document) = self.documents.get(&uri) else {
            return Vec::new();
        };
        let mut told = vec![published(&uri, document.findings(&self.open()))];
        told.extend(self.users(document));
        told
    }

    /// The findings about the open documents that include one.
    fn users(&self, document: &Document) -> Vec<PublishDiagnosticsParams> {
        let open = self.open();
        let mut texts = open.clone();
        // Also of one that was closed a moment ago.
        texts.insert(document.path().to_owned(), document.source().clone());
        let all = Workspace::of(texts);
        let users: BTreeSet<_> = all.users(document.path()).collect();
        let documents = self.documents.iter();
        documents
            .filter(|(_, user)| users.contains(user.path()))
            .map(|(uri, user)| published(uri, user.findings(&open)))
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
        match self.result(&method, params, offered) {
            Ok(value) => Response::new_ok(id, value),
            Err(Refused(code, reason)) => Response::new_err(id, code as i32, reason),
        }
    }

    fn result(&self, method: &str, params: Value, offered: &Offered) -> Result<Value, Refused> {
        match method {
            Completion::METHOD => {
                let (document, at) = self.place(params)?;
                answered::<Completion>(Some(self.completions(document, at, offered).into()))
            }
            HoverRequest::METHOD => {
                let (document, at) = self.place(params)?;
                answered::<HoverRequest>(self.hover(document, at))
            }
            GotoDefinition::METHOD => {
                let (document, at) = self.place(params)?;
                answered::<GotoDefinition>(self.definition(document, at))
            }
            References::METHOD => {
                let (document, at) = self.place(params)?;
                answered::<References>(self.references(document, at))
            }
            DocumentSymbolRequest::METHOD => {
                let symbols = self.document(params)?.symbols();
                answered::<DocumentSymbolRequest>(Some(symbols.into()))
            }
            Formatting::METHOD => answered::<Formatting>(self.document(params)?.formatted()),
            PrepareRenameRequest::METHOD => {
                let (document, at) = self.place(params)?;
                let range = document.renamed_range(at).map(PrepareRenameResponse::Range);
                answered::<PrepareRenameRequest>(range)
            }
            Rename::METHOD => {
                let name = params["newName"].as_str().unwrap_or_default().to_owned();
                let (document, at) = self.place(params)?;
                let edit = self.rename(document, at, &name);
                let edit = edit.map_err(|reason| Refused(ErrorCode::RequestFailed, reason))?;
                answered::<Rename>(Some(edit))
            }
            other => {
                let reason = format!("`{other}` is not served");
                Err(Refused(ErrorCode::MethodNotFound, reason))
            }
        }
    }

    /// The document that a request is about. What else the request says is not looked at.
    fn document(&self, params: Value) -> Result<&Document, Refused> {
        let params: DocumentSymbolParams =
            serde_json::from_value(params).map_err(Refused::invalid)?;
        self.opened(&params.text_document.uri)
    }

    /// The document that a request is about, and the byte. What else the request says is not looked at.
    fn place(&self, params: Value) -> Result<(&Document, usize), Refused> {
        let params: TextDocumentPositionParams =
            serde_json::from_value(params).map_err(Refused::invalid)?;
        let document = self.opened(&params.text_document.uri)?;
        Ok((document, document.offset(params.position)))
    }

    fn opened(&self, uri: &Uri) -> Result<&Document, Refused> {
        let document = self.documents.get(uri);
        document.ok_or_else(|| Refused::invalid(format!("`{}` is not open", uri.as_str())))
    }

    // -- what the server looks for in more files than one ------------------------------------------

    /// All nets around a document.
    fn around(&self, document: &Document) -> Workspace {
        Workspace::around(document.path(), &self.folders, self.open())
    }

    fn hover(&self, document: &Document, at: usize) -> Option<Hover> {
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

    fn completions(
        &self,
        document: &Document,
        at: usize,
        offered: &Offered,
    ) -> Vec<CompletionItem> {
        let around = self.around(document);
        match around.whole(document.path()) {
            Some((net, whole)) => document.completions(at, offered, (net, whole)),
            None => Vec::new(),
        }
    }

    /// Where the word at a byte is declared: in one place, or in each net that includes its file.
    fn definition(&self, document: &Document, at: usize) -> Option<GotoDefinitionResponse> {
        let around = self.around(document);
        if let Some(file) = document.included(at) {
            around.text(&file)?;
            let there = Location::new(self.uri(&file)?, Range::default());
            return Some(there.into());
        }
        let spot = document.spot(at);
        let declared = spot.map(|spot| around.declarations(&spot));
        let mut places = self.locations(&around, declared.unwrap_or_default());
        match places.len() {
            0 => None,
            1 => Some(places.remove(0).into()),
            _ => Some(places.into()),
        }
    }

    /// Everywhere where the word at a byte stands for the same thing.
    fn references(&self, document: &Document, at: usize) -> Option<Vec<Location>> {
        let around = self.around(document);
        let spot = document.spot(at)?;
        Some(self.locations(&around, around.same(&spot)))
    }

    /// The edits by which the word at a byte gets another name wherever it stands for the same thing.
    #[allow(
        clippy::mutable_key_type,
        reason = "the protocol's type; an address does not change"
    )]
    fn rename(&self, document: &Document, at: usize, name: &str) -> Result<WorkspaceEdit, String> {
        let around = self.around(document);
        let spot = document.spot(at).ok_or("there is no name here")?;
        if name.trim().is_empty() {
            return Err("a name is not empty".to_owned());
        }
        let new = pnt::text::name_in_text(name);
        let mut changes: HashMap<Uri, Vec<TextEdit>> = HashMap::new();
        for place in self.locations(&around, around.renamed(&spot, name)?) {
            let edit = TextEdit::new(place.range, new.clone());
            changes.entry(place.uri).or_default().push(edit);
        }
        Ok(WorkspaceEdit::new(changes))
    }

    /// A file's address: as the editor has it, where it is open.
    fn uri(&self, file: &Path) -> Option<Uri> {
        let mut open = self.documents.iter();
        let open = open.find(|(_, document)| document.path() == file);
        open.map_or_else(|| uri_of(file), |(uri, _)| Some(uri.clone()))
    }

    /// Places as the protocol has them.
    fn locations(&self, around: &Workspace, spots: BTreeSet<Spot>) -> Vec<Location> {
        let mut read: BTreeMap<PathBuf, (Uri, Document)> = BTreeMap::new();
        let mut places = Vec::new();
        for spot in spots {
            if !read.contains_key(&spot.file)
                && let Some(uri) = self.uri(&spot.file)
            {
                let text = around.text(&spot.file).map_or("", Source::text);
                let document = Document::new(&uri, text);
                read.insert(spot.file.clone(), (uri, document));
            }
            if let Some((uri, document)) = read.get(&spot.file) {
                places.push(Location::new(uri.clone(), document.range(&spot.range())));
            }
        }
        places
    }
}

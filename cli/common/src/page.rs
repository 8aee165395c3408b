//! What the tasks that serve people have in common: who may do what there, and how files are sent. Also a server
//! on a thread of its own. The address is bound before anything else is done. Knows no page.

use std::{
    io,
    net::{SocketAddr, TcpListener},
    path::PathBuf,
    sync::Arc,
};

use axum::{
    Router,
    body::Body,
    http::{
        StatusCode,
        header::{CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE},
    },
    response::{IntoResponse, Response},
};
use ctos::{
    config::{App, TaskConfig},
    control,
    diagnostic::{Finding, Findings},
    doors::{self, OpenError, Pages, Refusals},
    security::Keys,
    task::{Context, HandlerError, Phase},
    time::Clock,
};
use hyper_util::service::TowerToHyperService;
use tokio::sync::oneshot;

/// What a browser must not do with a page: load or send anything elsewhere, or show it inside another one.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; \
     connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// The log target under which a page's address is told: it is shown where nothing else of its level is.
pub const LOG_TARGET: &str = "ctos::page";

/// How a page is to be served.
pub struct Setting<'a> {
    /// Where; port 0 takes any that is free.
    pub listen: SocketAddr,
    /// What else than its own name and its addresses this host is called.
    pub names: &'a [String],
    /// Whether a page may intervene.
    pub allow_control: bool,
    /// What a page must show for it; drawn when it is left out.
    pub token: Option<&'a str>,
    /// How it is reached.
    pub kind: Kind,
}

/// How what is served is reached.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A browser opens a page, with the token behind this mark. Pages of other sites may ask nothing.
    Page(&'static str),
    /// Programs connect by WebSocket, and so do pages of other sites that show the token.
    Stream,
}

/// A finding about an argument of a page's task.
pub fn at(task: &TaskConfig, key: &str, finding: Finding) -> Finding {
    let place = task.args.locate(key).unwrap_or_else(|| task.place.clone());
    finding.at(place)
}

/// Finds what is wrong with where a page is to be served: others could reach it, and there are no keys.
pub fn check(
    task: &TaskConfig,
    listen: SocketAddr,
    app: &App,
    code: &'static str,
    findings: &mut Findings,
) {
    if listen.ip().to_canonical().is_loopback() || app.security.is_some() {
        return;
    }
    let text =
        format!("what {listen} serves, where others can reach it, needs keys, and there are none");
    let finding = Finding::error(code, text).help(
        "make keys with `ctos keys new keys/NAME --role boot` and name them in [security]; or listen at 127.0.0.1",
    );
    findings.push(at(task, "listen", finding));
}

/// Whether nobody can look at a page: in virtual time. It is logged once.
pub fn is_needless(cx: &Context, phase: Phase) -> bool {
    let needless = cx.chassis().clock().origin_ns().is_none();
    if needless && phase == Phase::Create {
        tracing::info!(task = cx.name(), "no page is served in virtual time");
    }
    needless
}

/// A file of a page, or what else it asks for.
pub fn file(kind: &'static str, text: impl Into<Body>) -> Response {
    let headers = [
        (CONTENT_TYPE, kind),
        (CONTENT_SECURITY_POLICY, POLICY),
        // Another version of the program has other files under the same names.
        (CACHE_CONTROL, "no-store"),
    ];
    (headers, text.into()).into_response()
}

/// Serves what `router` leads to until `stop` is over.
///
/// # Errors
/// The address is of no use any more.
pub async fn serve(pages: Pages, router: Router, stop: impl Future) -> io::Result<()> {
    tokio::select! {
        served = pages.serve(TowerToHyperService::new(router)) => served.map(|never| match never {}),
        _ = stop => Ok(()),
    }
}

/// An address that is bound, and not yet served.
pub struct Front {
    pages: Pages,
    door: Door,
    kind: Kind,
}

impl Front {
    /// Binds the address: for this host alone, or with the keys of the app.
    ///
    /// # Errors
    /// The address is taken or not this host's, or there are no keys where others can reach it.
    pub fn bind(app: &App, setting: &Setting<'_>) -> Result<Self, HandlerError> {
        let listen = setting.listen;
        let failed = |error: &dyn std::fmt::Display| failed(listen, error);
        let listener = TcpListener::bind(listen).map_err(|error| failed(&error))?;
        let is_loopback = listen.ip().to_canonical().is_loopback();
        let security = app.security.as_ref().filter(|_| !is_loopback);
        let keys = security.map(|security| {
            let place = |path: &PathBuf| app.folder.join(path);
            Keys::load(&place(&security.key), &place(&security.authority)).map(Arc::new)
        });
        let keys = keys.transpose().map_err(|error| failed(&error))?;
        let mut pages =
            Pages::new(listener, keys, setting.names).map_err(|error| failed(&error))?;
        let is_stream = setting.kind == Kind::Stream;
        if is_stream {
            pages = pages.with_any_origin();
        }
        let token = match setting.token {
            Some(token) => Some(token.to_owned()),
            None => Some(drawn_token()?),
        };
        Ok(Self {
            door: Door {
                token: token.filter(|_| setting.allow_control || is_stream || !is_loopback),
                anybody_looks: is_loopback,
                allow_control: setting.allow_control,
                refusals: Refusals::default(),
            },
            pages,
            kind: setting.kind,
        })
    }

    /// The address, without a token.
    fn url(&self) -> String {
        let url = self.pages.url();
        match self.kind {
            Kind::Page(_) => url,
            Kind::Stream => url.replacen("http", "ws", 1),
        }
    }

    /// Writes the file that has the address with the token: a page that leads there, or the text.
    fn opener(&self, app: &str, task: &str) -> io::Result<Option<Opener>> {
        let Some(token) = &self.door.token else {
            return Ok(None);
        };
        let plain = |letter: char| {
            let is_plain = letter.is_ascii_alphanumeric() || "_.".contains(letter);
            if is_plain { letter } else { '_' }
        };
        let plain = |name: &str| name.chars().take(64).map(plain).collect::<String>();
        let url = self.url();
        let (ending, text) = match self.kind {
            Kind::Page(mark) => ("html", opening(&format!("{url}{mark}{token}"))),
            Kind::Stream => ("txt", format!("{url}?token={token}\n")),
        };
        let name = format!(
            "{}-{}-{}.{ending}",
            plain(app),
            plain(task),
            std::process::id()
        );
        let path = control::prepared_folder()?.join(name);
        doors::private_file(&path, &text)?;
        Ok(Some(Opener { path }))
    }

    /// Serves what a task shows, and writes the file that opens it. `server` is given who may do what.
    ///
    /// # Errors
    /// The system has no thread to give, or no place for the file.
    pub fn serve_task<S, F>(
        mut self,
        cx: &Context,
        name: &'static str,
        server: S,
    ) -> Result<Served, HandlerError>
    where
        S: FnOnce(Pages, Door, oneshot::Receiver<()>) -> F + Send + 'static,
        F: Future<Output = io::Result<()>>,
    {
        cx.reads_unrecorded("what the browsers of its page ask");
        let opener = self.opener(&cx.app().name, cx.name())?;
        let (url, door) = (self.url(), std::mem::take(&mut self.door));
        let _stop = self.serve(name, move |pages, stopped| server(pages, door, stopped))?;
        Ok(Served { url, opener, _stop })
    }

    /// Serves it on a thread called `name`, until what is returned is sent or dropped.
    fn serve<S, F>(self, name: &'static str, server: S) -> Result<oneshot::Sender<()>, HandlerError>
    where
        S: FnOnce(Pages, oneshot::Receiver<()>) -> F + Send + 'static,
        F: Future<Output = io::Result<()>>,
    {
        let Self { pages, .. } = self;
        let address = pages.address();
        let (stop, stopped) = oneshot::channel();
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .map_err(|error| failed(address, &error))?;
        let serve = move || {
            if let Err(error) = runtime.block_on(server(pages, stopped)) {
                tracing::error!(page = name, error = %error, "a page is not served any more");
            }
        };
        let thread = std::thread::Builder::new().name(name.to_owned());
        let spawned = thread.spawn(serve);
        spawned.map_err(|error| failed(address, &error))?;
        Ok(stop)
    }
}

fn failed(listen: SocketAddr, error: &dyn std::fmt::Display) -> HandlerError {
    HandlerError::new(format!(
        "{listen} cannot be served: {error}; choose another `listen`, or another address for `--display` or `--foxglove` if that gave it"
    ))
}

/// A task's page that is served, until this is dropped.
pub struct Served {
    /// Its address, without a token: for logs.
    pub url: String,
    /// The file that opens it.
    pub opener: Option<Opener>,
    _stop: oneshot::Sender<()>,
}

/// A page that leads to `url`, for a browser that opens it as a file.
fn opening(url: &str) -> String {
    let url: String = url
        .chars()
        .map(|letter| match letter {
            '&' => "&amp;".to_owned(),
            '"' => "&quot;".to_owned(),
            '<' => "&lt;".to_owned(),
            letter => letter.to_string(),
        })
        .collect();
    format!(
        "<!doctype html>\n<meta charset=\"utf-8\">\n<meta http-equiv=\"refresh\" content=\"0; url={url}\">\n\
         <a href=\"{url}\">{url}</a>\n"
    )
}

/// A file of this user alone that opens a page with its token, which no log holds. It goes with this.
pub struct Opener {
    path: PathBuf,
}

impl std::fmt::Display for Opener {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.path.display().fmt(f)
    }
}

impl Drop for Opener {
    fn drop(&mut self) {
        // Somebody else has removed it: that is what was wanted.
        let _ = std::fs::remove_file(&self.path);
    }
}

/// Who may do what; nobody anything unless it says so.
#[derive(Default)]
pub struct Door {
    /// What a page must show to do more than anybody may.
    pub token: Option<String>,
    /// Whether those may look on who do not show it.
    pub anybody_looks: bool,
    /// Whether those may intervene who show it.
    pub allow_control: bool,
    /// Those that did not show it.
    pub refusals: Refusals,
}

/// What a page may do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Right {
    /// See what is shown.
    Look,
    /// Intervene too.
    Control,
}

impl Door {
    /// Whether these bytes are the token.
    pub fn knows(&self, shown: &[u8]) -> bool {
        self.token.as_ref().is_some_and(|token| {
            // Looked at to its end, wherever it differs.
            let pairs = shown.iter().zip(token.as_bytes());
            let differs = shown.len() ^ token.len();
            pairs.fold(differs, |differs, (a, b)| differs | usize::from(a ^ b)) == 0
        })
    }

    /// The right that these bytes give.
    pub fn right(&self, shown: &[u8]) -> Option<Right> {
        match (self.knows(shown), self.allow_control) {
            (true, true) => Some(Right::Control),
            (true, false) => Some(Right::Look),
            (false, _) => self.anybody_looks.then_some(Right::Look),
        }
    }

    /// Refuses somebody, which is counted and logged.
    pub fn refuse(&self, reason: &str) -> Response {
        self.refusals.note(&Clock::real_from(0), "a page", reason);
        (StatusCode::FORBIDDEN, format!("{reason}\n")).into_response()
    }

    /// Why somebody who may look on may do no more.
    pub fn why_only_look(&self) -> &'static str {
        match self.allow_control {
            true => "this page may only look on: open it by the address with the token",
            false => "this page may only look on: set `allow_control = true` for its task",
        }
    }
}

/// Pages of a program that has no app, and so no keys: for this host alone.
///
/// # Errors
/// [`OpenError`].
pub fn loopback_pages(listen: SocketAddr) -> Result<Pages, OpenError> {
    Pages::new(TcpListener::bind(listen)?, None, &[])
}

/// 128 bits that nobody guesses.
///
/// # Errors
/// The system has no randomness to give.
pub fn drawn_token() -> io::Result<String> {
    let mut bytes = [0_u8; 16];
    getrandom::fill(&mut bytes).map_err(io::Error::other)?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    fn app(more: &str) -> App {
        let text = format!("[chassis.a]\n[task.one]\nhandler = \"none\"\non = \"a\"\n{more}");
        let loaded = ctos::config::load_texts(&[("app.toml", &text)], &[], &[]);
        loaded.map_err(|findings| findings.to_string()).unwrap()
    }

    fn setting(listen: &str, allow_control: bool, token: Option<&'static str>) -> Setting<'static> {
        Setting {
            listen: listen.parse().unwrap(),
            names: &[],
            allow_control,
            token,
            kind: Kind::Page("?token="),
        }
    }

    #[test]
    fn a_token_is_there_only_where_control_is_allowed_and_none_is_drawn_twice() {
        let token = |control, token| {
            let front = Front::bind(&app(""), &setting("127.0.0.1:0", control, token));
            front.unwrap().door.token
        };
        assert_eq!(token(false, Some("given")), None);
        assert_eq!(token(true, Some("given")).as_deref(), Some("given"));
        let drawn = token(true, None).unwrap();
        assert_eq!(drawn.len(), 32);
        assert_ne!(token(true, None), Some(drawn));
    }

    #[test]
    fn beyond_the_loopback_a_page_needs_keys_speaks_tls_and_shows_nothing_without_its_token() {
        let beyond = setting("0.0.0.0:0", false, None);
        let told = Front::bind(&app(""), &beyond).err().unwrap().to_string();
        assert!(told.contains("[security]"), "{told}");
        let found = |app: &App| {
            let mut findings = Findings::new();
            check(
                &app.tasks[0],
                beyond.listen,
                app,
                "test::open",
                &mut findings,
            );
            findings.to_string()
        };
        assert!(found(&app("")).contains("needs keys"));
        let folder = tempfile::tempdir().unwrap();
        let key = folder.path().join("a");
        ctos::security::make_key(&key, ctos::security::Role::Boot).unwrap();
        let authority = folder.path().join("ca.pem");
        let keys = app(&format!(
            "[security]\nkey = {key:?}\nauthority = {authority:?}\n"
        ));
        assert_eq!(found(&keys), "");
        let front = Front::bind(&keys, &beyond).unwrap();
        assert!(front.url().starts_with("https://"), "{}", front.url());
        let token = front.door.token.clone().unwrap();
        assert_eq!(front.door.right(b""), None);
        assert_eq!(front.door.right(token.as_bytes()), Some(Right::Look));
    }

    #[test]
    fn the_file_that_opens_a_page_is_this_users_alone_and_the_log_has_no_token() {
        let setting = setting("127.0.0.1:0", true, Some("a\"b"));
        let front = Front::bind(&app(""), &setting).unwrap();
        assert!(!front.url().contains("a\"b"));
        let opener = front.opener("app", "../x").unwrap().unwrap();
        let path = opener.path.clone();
        let mode = path.metadata().unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o600);
        assert_eq!(path.parent().unwrap(), control::folder());
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(
            text.contains(&format!("{}?token=a&quot;b", front.url())),
            "{text}"
        );
        drop(opener);
        assert!(!path.exists());
    }

    #[test]
    fn whoever_shows_the_token_may_do_what_is_allowed_and_others_look_on_at_most() {
        for (anybody_looks, allow_control) in
            [(true, true), (true, false), (false, true), (false, false)]
        {
            let others = anybody_looks.then_some(Right::Look);
            let door = |token: Option<&str>| Door {
                token: token.map(str::to_owned),
                anybody_looks,
                allow_control,
                ..Door::default()
            };
            let closed = door(None);
            assert_eq!(closed.right(b""), others);
            assert_eq!(closed.right(b"secret"), others);
            let open = door(Some("secret"));
            for wrong in [&b""[..], b"secre", b"secrets", b"secreT", b"\xff"] {
                assert_eq!(open.right(wrong), others);
            }
            let right = if allow_control {
                Right::Control
            } else {
                Right::Look
            };
            assert_eq!(open.right(b"secret"), Some(right));
        }
    }

    #[test]
    fn a_stream_has_a_token_also_where_anybody_looks_and_its_file_is_the_address_with_it() {
        let stream = Setting {
            kind: Kind::Stream,
            ..setting("127.0.0.1:0", false, Some("secret"))
        };
        let front = Front::bind(&app(""), &stream).unwrap();
        let opener = front.opener("app", "viewers").unwrap().unwrap();
        let text = std::fs::read_to_string(&opener.path).unwrap();
        let port = front.pages.address().port();
        assert_eq!(text, format!("ws://127.0.0.1:{port}/?token=secret\n"));
        assert_eq!(front.door.right(b""), Some(Right::Look));
        assert!(front.door.knows(b"secret") && !front.door.knows(b""));
    }

    #[test]
    fn an_address_that_is_taken_is_refused_with_what_to_do() {
        let first = Front::bind(&app(""), &setting("127.0.0.1:0", false, None)).unwrap();
        let taken = first.pages.address().to_string();
        let told = Front::bind(&app(""), &setting(&taken, false, None));
        let told = told.err().unwrap().to_string();
        assert!(told.contains(&taken) && told.contains("`listen`"), "{told}");
    }

    #[test]
    fn a_server_ends_when_nobody_wants_it_any_more() {
        let front = Front::bind(&app(""), &setting("127.0.0.1:0", false, None)).unwrap();
        let (ended, heard) = std::sync::mpsc::channel();
        let stop = front
            .serve("test", move |_, stopped| async move {
                let _ = stopped.await;
                ended.send(()).map_err(io::Error::other)
            })
            .unwrap();
        drop(stop);
        heard.recv().unwrap();
    }
}

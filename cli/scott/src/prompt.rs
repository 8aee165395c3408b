//! The prompt: a line editor around a session. Everything that it offers comes from
//! [`complete`].

use std::{
    borrow::Cow,
    env, fs,
    io::{self, Write},
    path::PathBuf,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
        mpsc::SyncSender,
    },
};

use reedline::{
    ColumnarMenu, Completer, CompletionResult, DefaultPrompt, DefaultPromptSegment, EditMode,
    Emacs, ExternalPrinter, FileBackedHistory, Hinter, History, KeyCode, KeyModifiers, Keybindings,
    MenuBuilder, Prompt, PromptEditMode, PromptHistorySearch, Reedline, ReedlineEvent,
    ReedlineMenu, Signal, Span, Suggestion, ValidationResult, Validator, Vi,
    default_emacs_keybindings, default_vi_insert_keybindings, default_vi_normal_keybindings,
    default_vi_visual_keybindings,
};
use sorma::{
    ClassInfo,
    words::{self, WordError},
};

use super::{
    backend::Backend,
    complete::{self, Known},
    follow,
    session::{Place, Session},
};
use cli_common::{exit, show, table};

/// Lines that are kept between sessions.
const HISTORY: usize = 10_000;
/// Messages that may wait until the line is drawn again.
const MESSAGES: usize = 256;
const MENU: &str = "completion";

/// Names that the line editor offers, as of the last prompt.
#[derive(Debug, Default)]
struct Names {
    objects: Vec<String>,
    variables: Vec<String>,
    classes: Vec<ClassInfo>,
    daemons: Vec<String>,
}

type Shared = Arc<Mutex<Names>>;

/// Runs a session at a terminal until Ctrl-D, `exit` or `quit`; the exit code.
pub fn run(session: &mut Session, vi: bool) -> u8 {
    let names = Shared::default();
    let printer = ExternalPrinter::new(MESSAGES);
    log_above(printer.sender());
    session.show_above(printer.sender());
    let gone = Arc::new(AtomicBool::new(false));
    if let Backend::App(app) = session.backend() {
        let gone = Arc::clone(&gone);
        follow::start(app.name().to_owned(), app.place(), printer.sender(), gone);
    }
    let mut editor = editor(&names, vi).with_external_printer(printer);
    session.show_to_people();
    show::say(&table::for_messages(
        "`list` tells what there is, `help` how it is asked; Tab completes, Ctrl-D or `exit` leaves.",
    ));
    loop {
        refresh(&names, session);
        let prompt = Speaks::to(session.backend(), &gone);
        match editor.read_line(&prompt) {
            Ok(Signal::Success(text)) if ["exit", "quit"].contains(&text.trim()) => {
                return exit::OK;
            }
            Ok(Signal::Success(text)) => {
                let place = Place {
                    name: "scott",
                    line: 0,
                    wrong: exit::FAILED,
                };
                session.line(&place, &text.replace("\\\n", " "));
                session.forget_failure();
            }
            Ok(Signal::CtrlD) => return exit::OK,
            // Ctrl-C cancels the line and nothing else.
            Ok(_) => {}
            Err(error) => {
                show::say(&format!("error: the terminal cannot be read: {error}"));
                return exit::FAILED;
            }
        }
    }
}

/// The prompt: whom it speaks to, and whether that is there at the moment. It is asked whenever the line is drawn, also
/// while nobody types.
struct Speaks {
    there: DefaultPrompt,
    away: DefaultPrompt,
    gone: Arc<AtomicBool>,
}

impl Speaks {
    fn to(backend: &Backend, gone: &Arc<AtomicBool>) -> Self {
        let name = match backend {
            Backend::Local(_) => "scott".to_owned(),
            Backend::App(app) => format!("scott {}", app.name()),
        };
        let prompt = |text: String| {
            let text = DefaultPromptSegment::Basic(text);
            DefaultPrompt::new(text, DefaultPromptSegment::Empty)
        };
        Self {
            away: prompt(format!("{name} (gone)")),
            there: prompt(name),
            gone: Arc::clone(gone),
        }
    }

    fn now(&self) -> &DefaultPrompt {
        match self.gone.load(Ordering::Relaxed) {
            true => &self.away,
            false => &self.there,
        }
    }
}

impl Prompt for Speaks {
    fn render_prompt_left(&self) -> Cow<'_, str> {
        self.now().render_prompt_left()
    }

    fn render_prompt_right(&self) -> Cow<'_, str> {
        self.now().render_prompt_right()
    }

    fn render_prompt_indicator(&self, mode: PromptEditMode) -> Cow<'_, str> {
        self.now().render_prompt_indicator(mode)
    }

    fn render_prompt_multiline_indicator(&self) -> Cow<'_, str> {
        self.now().render_prompt_multiline_indicator()
    }

    fn render_prompt_history_search_indicator(&self, search: PromptHistorySearch) -> Cow<'_, str> {
        self.now().render_prompt_history_search_indicator(search)
    }
}

/// What there is now.
fn refresh(names: &Shared, session: &mut Session) {
    let (objects, classes) = session.backend().known();
    let daemons = session.backend().daemons().to_vec();
    let mut names = names.lock().unwrap_or_else(PoisonError::into_inner);
    names.objects = objects;
    names.classes = classes;
    names.daemons = daemons;
    names.variables = session.variables().map(str::to_owned).collect();
}

fn editor(names: &Shared, vi: bool) -> Reedline {
    let menu = ColumnarMenu::default().with_name(MENU);
    let mode: Box<dyn EditMode> = if vi {
        let mut insert = default_vi_insert_keybindings();
        bind(&mut insert);
        Box::new(Vi::new(
            insert,
            default_vi_normal_keybindings(),
            default_vi_visual_keybindings(),
        ))
    } else {
        let mut keys = default_emacs_keybindings();
        bind(&mut keys);
        Box::new(Emacs::new(keys))
    };
    let editor = Reedline::create()
        .with_completer(Box::new(Offers(Arc::clone(names))))
        .with_hinter(Box::new(Hints(Arc::clone(names))))
        .with_validator(Box::new(Whole))
        .with_menu(ReedlineMenu::EngineCompleter(Box::new(menu)))
        .with_partial_completions(true)
        .with_ansi_colors(show::colours())
        .with_edit_mode(mode);
    match history() {
        Some(history) => editor.with_history(history),
        None => editor,
    }
}

fn bind(keys: &mut Keybindings) {
    let complete = ReedlineEvent::UntilFound(vec![
        ReedlineEvent::Menu(MENU.to_owned()),
        ReedlineEvent::MenuNext,
    ]);
    keys.add_binding(KeyModifiers::NONE, KeyCode::Tab, complete);
    keys.add_binding(
        KeyModifiers::SHIFT,
        KeyCode::BackTab,
        ReedlineEvent::MenuPrevious,
    );
}

/// The history in the user's state folder; without one, that of this session only.
fn history() -> Option<Box<dyn History>> {
    let state = env::var_os("XDG_STATE_HOME").map(PathBuf::from);
    let home = env::var_os("HOME").map(|home| PathBuf::from(home).join(".local/state"));
    let folder = state.or(home)?.join("ctos");
    fs::create_dir_all(&folder).ok()?;
    let history = FileBackedHistory::with_file(HISTORY, folder.join("scott_history")).ok()?;
    Some(Box::new(history))
}

struct Offers(Shared);

impl Completer for Offers {
    fn complete(&mut self, line: &str, at: usize) -> CompletionResult {
        let names = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let text = line.get(..at).unwrap_or(line);
        let (start, found) = complete::candidates(text, known(&names));
        let suggestions: Vec<Suggestion> = found
            .into_iter()
            .map(|candidate| Suggestion {
                value: candidate.word,
                description: Some(candidate.about).filter(|about| !about.is_empty()),
                span: Span::new(start, at.max(start)),
                append_whitespace: candidate.ends,
                ..Suggestion::default()
            })
            .collect();
        CompletionResult::fresh(suggestions)
    }
}

struct Hints(Shared);

impl Hinter for Hints {
    fn handle(
        &mut self,
        line: &str,
        at: usize,
        _history: &dyn History,
        ansi: bool,
        _cwd: &str,
    ) -> String {
        if at < line.len() {
            return String::new();
        }
        let names = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let hint = complete::hint(line, known(&names));
        if ansi && !hint.is_empty() {
            format!("\u{1b}[90m{hint}\u{1b}[0m")
        } else {
            hint
        }
    }

    // A hint tells what kind of thing comes next; it is nothing to be taken over into the line.
    fn complete_hint(&self) -> String {
        String::new()
    }

    fn next_hint_token(&self) -> String {
        String::new()
    }
}

fn known(names: &Names) -> Known<'_> {
    Known {
        classes: &names.classes,
        names: &names.objects,
        daemons: &names.daemons,
        variables: &names.variables,
    }
}

/// A line is whole when its quotes are closed and it does not end with a backslash.
struct Whole;

impl Validator for Whole {
    fn validate(&self, line: &str) -> ValidationResult {
        let open = matches!(words::split(line), Err(WordError::Open(_)));
        if open || line.ends_with('\\') {
            ValidationResult::Incomplete
        } else {
            ValidationResult::Complete
        }
    }
}

/// Shows warnings of the log above the line that is being edited.
fn log_above(printer: SyncSender<String>) {
    let started = tracing_subscriber::fmt()
        .with_max_level(tracing::Level::WARN)
        .without_time()
        .with_ansi(false)
        .with_writer(move || Above(printer.clone()))
        .try_init();
    // Somebody else's log is as good.
    drop(started);
}

struct Above(SyncSender<String>);

impl Write for Above {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let text = String::from_utf8_lossy(bytes);
        let text = text.trim_end().to_owned();
        // While no line is edited nobody takes messages; then they are said as they are.
        if let Err(error) = self.0.try_send(text) {
            let (std::sync::mpsc::TrySendError::Full(text)
            | std::sync::mpsc::TrySendError::Disconnected(text)) = error;
            show::say(&text);
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

//! An app with a program in it, and a person who asks it.

use std::{fs, future::Future, path::Path, pin::Pin, sync::Arc, time::Duration};

use ctos::{
    boot::{BootEvent, End, Outcome},
    config::{self, App},
    message::Message,
    registry::Registry,
    simulation::{self, Setup},
    system::AppResult,
    task::{Context, EventHandler, Handled, Phase},
};
use serde_json::Value;

pub type Does = Pin<Box<dyn Future<Output = Result<String, String>>>>;

/// What the person does when the app runs; its text is the result.
pub type Person = Arc<dyn Fn(Context) -> Does + Send + Sync>;

struct Desk(Person);

impl EventHandler for Desk {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let (here, does) = (cx.clone(), (self.0)(cx.clone()));
            cx.spawn(async move {
                let (ok, text) = match does.await {
                    Ok(text) => (true, text),
                    Err(text) => (false, text),
                };
                here.finish(AppResult {
                    ok,
                    text,
                    json: String::new(),
                });
            });
        }
        Ok(())
    }
}

ctos::command! {
    /// Adds to the sum so far.
    pub struct Add { pub number: i64 } => i64, 1, "add"
}

#[derive(Default)]
struct Sum(i64);

#[ctos::handler]
impl Sum {
    #[command]
    fn add(&mut self, Add { number }: Add) -> i64 {
        self.0 += number;
        self.0
    }
}

/// The event handlers of the tests.
pub fn registry(person: Person) -> Registry {
    let mut registry = Registry::new();
    bridge_program::register(&mut registry);
    registry.handler("sum", &Sum::COMMANDS, |_| Ok(Sum::default()));
    registry.handler("person", &[], move |_| Ok(Desk(person.clone())));
    sorma::daemon::register(&mut registry, sorma::Dictionary::new(), |_, sorm| {
        bridge_program::register_class(sorm);
    });
    registry
}

pub fn person<F: Future<Output = Result<String, String>> + 'static>(
    does: impl Fn(Context) -> F + Send + Sync + 'static,
) -> Person {
    Arc::new(move |cx| Box::pin(does(cx)))
}

/// A command of a task, by JSON.
pub async fn ask(cx: &Context, task: &str, command: &str, data: Value) -> Result<Value, String> {
    let info = cx.registry().command_of(cx.app(), task, command);
    let info = info.map_err(|finding| finding.to_string())?;
    let bytes = bridge_program::encoded(&info.request.shape().unwrap(), &data)?;
    let found = cx.task(task).await.map_err(|error| error.to_string())?;
    let reply = cx
        .call_raw(&found, info, bytes, Duration::from_secs(60))
        .await;
    let reply = reply.map_err(|error| error.to_string())?;
    let json = bridge_program::told(&info.reply.shape().unwrap(), &reply, 1 << 30).unwrap();
    Ok(serde_json::from_slice(&json).unwrap())
}

/// The Python of the tests.
pub fn python() -> String {
    std::env::var("CTOS_PYTHON").unwrap_or_else(|_| "python3".to_owned())
}

pub fn has_python() -> bool {
    let there = std::process::Command::new(python())
        .arg("--version")
        .output();
    there.is_ok_and(|output| output.status.success())
}

/// The folder of the client for Python.
pub fn client() -> String {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"))
        .ancestors()
        .nth(2)
        .unwrap();
    root.join("clients/python/src").display().to_string()
}

/// The text of an app: a person, and a program whose arguments are given.
pub fn app_text(args: &str, more: &str) -> String {
    format!(
        "app.until = \"person\"\napp.seed = 3\n[chassis.a]\n[chassis.b]\n\
         [task.person]\nhandler = \"person\"\non = \"b\"\n\
         [task.sum]\nhandler = \"sum\"\non = \"b\"\n\
         [task.detector]\nhandler = \"ctos.program\"\non = \"a\"\n{more}\n[task.detector.args]\n{args}\n"
    )
}

pub fn load(folder: &Path, files: &[(&str, &str)], app: &str) -> App {
    for (name, text) in files {
        fs::write(folder.join(name), text).unwrap();
    }
    fs::write(folder.join("app.toml"), app).unwrap();
    config::load(&folder.join("app.toml"), &[], &[]).unwrap_or_else(|found| panic!("{found}"))
}

/// Runs it in virtual time.
pub fn run_app(app: App, registry: Registry) -> Outcome {
    let setup = Setup {
        stop_after: Some(Duration::from_secs(600)),
        ..Setup::default()
    };
    let events = Arc::new(|_: &BootEvent| ());
    simulation::run(app, registry, setup, &(events as _))
        .unwrap()
        .outcome
}

/// How an app ended: `Ok` by the person, else by what went wrong.
pub fn run(files: &[(&str, &str)], app: &str, person: Person) -> Result<String, String> {
    let folder = tempfile::tempdir().unwrap();
    let app = load(folder.path(), files, app);
    match run_app(app, registry(person)).end {
        End::Finished(AppResult { ok: true, text, .. }) => Ok(text),
        End::Finished(result) => Err(result.text),
        other => Err(format!("{other:?}")),
    }
}

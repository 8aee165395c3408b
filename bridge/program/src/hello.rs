//! What a program says of itself before its app starts: it is started, says hello, and is ended. Only where the
//! configuration asks for that, and once in a process for each way to start it.

use std::{
    collections::BTreeMap,
    path::{Path, absolute},
    sync::{Mutex, PoisonError},
    time::Duration,
};

use ctos::config::{App, TaskConfig, TimeMode};

use crate::{
    args::Args,
    lines::{Hello, Said, Told, VERSION},
    process::{Event, Events, Plan, Program},
};

/// The value of `declares` that asks for it.
pub(crate) const BY_HELLO: &str = "hello";

type Heard = Result<Hello, String>;

/// What was heard, by how the programs were started.
static HEARD: Mutex<BTreeMap<String, Heard>> = Mutex::new(BTreeMap::new());

/// What the program of a task says of itself.
///
/// # Errors
/// Why it does not.
pub(crate) fn heard(args: &Args, task: &TaskConfig, app: &App) -> Heard {
    let known = || HEARD.lock().unwrap_or_else(PoisonError::into_inner);
    let way = format!(
        "{} {:?} {:?} {:?} {}",
        app.folder.display(),
        args.command,
        args.environment,
        args.args,
        task.name
    );
    if let Some(heard) = known().get(&way) {
        return heard.clone();
    }
    let heard = hear(args, task, app);
    known().insert(way, heard.clone());
    heard
}

fn hear(args: &Args, task: &TaskConfig, app: &App) -> Heard {
    let plan = Plan {
        task: &task.name,
        command: &command(args, app)?,
        folder: folder(app),
        environment: environment(args, &task.name),
        line: usize::try_from(args.line_mib).unwrap_or(1) << 20,
        logs: false,
        frames: None,
    };
    let (program, events) = Program::start(&plan, None)?;
    let Events::Thread(events) = events else {
        return Err("it cannot be heard".to_owned());
    };
    let hello = Told::Hello {
        protocol: VERSION,
        task: &task.name,
        app: app.name.as_str(),
        args: &args.args,
        seed: app.seed,
        virtual_time: app.time == TimeMode::Virtual,
        state: None,
        frames: None,
        declare: true,
    };
    program.write(hello.line())?;
    let limit = args.start_s;
    let first = events.recv_timeout(Duration::from_secs_f64(limit.clamp(0.0, 86_400.0)));
    match first {
        Ok(Event::Line(line)) => match serde_json::from_str(&line) {
            Ok(Said::Hello(hello)) => Ok(hello),
            Ok(_) => Err("it did not say hello at first".to_owned()),
            Err(error) => Err(format!("it said no hello at first: {error}")),
        },
        Ok(Event::Ended(why) | Event::Wrong(why)) => Err(why),
        Err(_) => Err(format!("it did not say hello within {limit} s")),
    }
}

/// The program and its arguments.
///
/// # Errors
/// There is no working folder that its path could start from.
pub(crate) fn command(args: &Args, app: &App) -> Result<Vec<String>, String> {
    let mut command = args.command.clone();
    if let Some(program) = command.first_mut()
        && program.contains('/')
    {
        // A relative one would be looked for where the program is to run.
        let path = absolute(app.folder.join(&*program)).map_err(|error| error.to_string())?;
        *program = path.to_string_lossy().into_owned();
    }
    Ok(command)
}

/// Where it runs.
pub(crate) fn folder(app: &App) -> &Path {
    match app.folder.as_os_str().is_empty() {
        true => Path::new("."),
        false => &app.folder,
    }
}

/// Variables of its environment.
pub(crate) fn environment(args: &Args, task: &str) -> Vec<(String, String)> {
    let own = [
        ("CTOS_TASK".to_owned(), task.to_owned()),
        // Sets of texts have the same order in every run.
        ("PYTHONHASHSEED".to_owned(), "0".to_owned()),
    ];
    let given = args.environment.iter();
    let given = given.map(|(name, value)| (name.clone(), value.clone()));
    own.into_iter().chain(given).collect()
}

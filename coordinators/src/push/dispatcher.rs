//! The Dispatcher of `push`: the functions of `nets/push/dispatcher.net`, which turns a command into a job, and tells what
//! became of it.

use std::rc::Rc;

use ctos::{
    diagnostic::Finding,
    registry::{Registry, Vocabulary},
    task::{Context, HandlerError},
};
use nalgebra::Point2;
use pnt::{
    check::FunctionNames,
    library::{Acted, Action, Library},
    task::{COMMANDS, KEYS, NetTask, args as net_args, args_of, check_args},
};
use serde::Deserialize;

use super::job::{ACCOUNT, Account, JOB, Job};
use crate::dom::DomStore;

/// The handler's name.
pub const HANDLER: &str = "coordinators.push";

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct PushArgs {
    /// The longest way, m.
    #[serde(default = "longest_m")]
    longest_m: f64,
    /// The data object manager.
    #[serde(default = "crate::dom_task")]
    dom: String,
}

fn longest_m() -> f64 {
    1.0
}

/// What the functions share.
struct Dispatcher {
    args: Rc<PushArgs>,
    store: DomStore,
    /// Number of the command in work, from 1.
    command: u32,
}

/// Registers the handler.
pub(super) fn register(registry: &mut Registry) {
    registry
        .handler(HANDLER, &COMMANDS, |cx| {
            let args: PushArgs = args_of(cx)?;
            let store = DomStore::new(&args.dom);
            NetTask::from_args(cx, library(args, store.clone()), Some(Rc::new(store)))
        })
        .speaks(|task| match net_args::<PushArgs>(task) {
            Ok(args) => names(&args).vocabulary(),
            Err(_) => Vocabulary::new(),
        })
        .keys(&KEYS)
        .checked_args::<PushArgs>(|args, task, app, findings| {
            crate::need_task(task, app, "dom", &args.dom, findings);
            if !(0.01..=10.0).contains(&args.longest_m) {
                let place = task.args.locate("longest_m");
                let text = format!("`longest_m` is {}", args.longest_m);
                findings.push(
                    Finding::error("coordinators::push::range", text)
                        .at(place.unwrap_or_else(|| task.place.clone()))
                        .help("give from 0.01 to 10 m"),
                );
            }
            check_args(task, app, &names(args), findings);
        });
}

fn names(args: &PushArgs) -> FunctionNames {
    library(args.clone(), DomStore::new(&args.dom)).names()
}

fn library(args: PushArgs, store: DomStore) -> Library<Dispatcher> {
    let state = Dispatcher {
        args: Rc::new(args),
        store,
        command: 0,
    };
    Library::new(state)
        .kept(
            |state| state.command,
            |state, command| state.command = command,
        )
        .action("begin", begin)
        .action("report", report)
}

type Act = Action<Dispatcher>;

fn parts(action: &Act) -> (Context, Rc<PushArgs>, DomStore) {
    let (args, store) = action.with_state(|state| (state.args.clone(), state.store.clone()));
    (action.cx().clone(), args, store)
}

/// Reads `FROM TO`, two points, and makes the job of them. Why it makes none goes into the answer.
async fn begin(action: Act) -> Acted {
    let (cx, args, store) = parts(&action);
    let command = action.with_state(|state| state.command.wrapping_add(1));
    let began = match job(command, action.arguments(), args.longest_m) {
        Ok(job) => store.store(&cx, JOB, &job).await,
        Err(error) => {
            action.note(error.to_string());
            Err(error)
        }
    };
    action.with_state(|state| state.command = command);
    began
}

fn job(command: u32, arguments: &[String], longest_m: f64) -> Result<Job, HandlerError> {
    let [from, to] = arguments else {
        return Err(HandlerError::new(format!(
            "`push` takes FROM and TO, two points X,Y in m such as 0.5,-0.2 0.5,0.1, and was given {}",
            arguments.len()
        )));
    };
    let point = |text: &str| -> Result<Point2<f64>, HandlerError> {
        let numbers: Option<Vec<f64>> = text
            .split(',')
            .map(|number| {
                number
                    .trim()
                    .parse()
                    .ok()
                    .filter(|number: &f64| number.is_finite())
            })
            .collect();
        match numbers.as_deref() {
            Some(&[x, y]) => Ok(Point2::new(x, y)),
            _ => Err(HandlerError::new(format!(
                "`{text}` is no point: write X,Y in m of the arm's base frame"
            ))),
        }
    };
    let job = Job {
        command,
        from: point(from)?,
        to: point(to)?,
    };
    let length = job.length();
    if !(0.005..=longest_m).contains(&length) {
        return Err(HandlerError::new(format!(
            "a push is 0.005 to {longest_m} m long, not {length:.3} m"
        )));
    }
    Ok(job)
}

/// Tells, in the answer, how far the thing was pushed, and what was not done and why.
async fn report(action: Act) -> Acted {
    let (cx, _, store) = parts(&action);
    let command = action.with_state(|state| state.command);
    if let Ok(account) = store.fetch::<Account>(&cx, ACCOUNT).await
        && account.command == command
    {
        for line in account.lines() {
            action.note(line);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {

    #[test]
    fn a_command_names_two_points_or_is_refused_in_words() {
        let job = |words: &[&str]| {
            let words: Vec<String> = words.iter().map(ToString::to_string).collect();
            super::job(1, &words, 0.5).map_err(|error| error.to_string())
        };
        let found = job(&["0.5,-0.2", "0.5,0.1"]).unwrap();
        assert!((found.length() - 0.3).abs() < 1e-12);
        for (words, text) in [
            (&["0.5,0"][..], "FROM and TO"),
            (&["0.5", "0.5,0.1"], "is no point"),
            (&["nan,0", "0.5,0.1"], "is no point"),
            (&["0.5,0", "0.5,0"], "not 0.000 m"),
            (&["0.5,0", "0.5,0.7"], "not 0.700 m"),
        ] {
            let error = job(words).unwrap_err();
            assert!(error.contains(text), "{words:?}: {error}");
        }
    }
}

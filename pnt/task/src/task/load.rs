//! Reading and checking the nets of a configuration before anything starts.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use ctos::{
    config::{App, TaskConfig},
    diagnostic::{Finding, Findings, Severity, Source},
    registry::Registry,
};

use super::{
    breaks, fields,
    messages::COMMANDS,
    settings::{self, settings},
};
use crate::{
    layout::{LayoutFile, beside},
    stream::NetView,
};
use pnt_analysis::check::{self, FunctionNames, Limits, Report, objects};
use pnt_language::{
    compile, format,
    net::{Action, Net},
};

/// Reads one net.
///
/// # Errors
/// All findings about the file and its text.
pub fn load(path: &Path) -> Result<Net, Findings> {
    let folder = path.parent().unwrap_or(Path::new(""));
    compile::net_with(&Source::read(path)?, &mut |file| {
        Source::read(&folder.join(file))
    })
}

/// Nets that were compiled, by the paths of their files.
static COMPILED: Mutex<Compiled> = Mutex::new(BTreeMap::new());

/// So many nets are kept; then all are forgotten.
const MOST_KEPT: usize = 10_000;

/// A net, and the texts that it was made of: its file's, then those that it includes.
#[derive(Clone)]
struct Known {
    texts: Vec<(PathBuf, Source)>,
    net: Arc<Net>,
    /// How often it was compiled.
    times: u64,
}

type Compiled = BTreeMap<PathBuf, Known>;

fn compiled() -> MutexGuard<'static, Compiled> {
    COMPILED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// How often this process has compiled the net of a file for the tasks of apps.
#[doc(hidden)]
#[must_use]
pub fn compilations(file: &Path) -> u64 {
    compiled().get(file).map_or(0, |known| known.times)
}

/// The net of a task. A file is compiled once in a process, as long as it and what it includes are the same.
///
/// # Errors
/// What [`check_args`] finds about its arguments and its net.
pub fn net_of(task: &TaskConfig, app: &App) -> Result<Arc<Net>, Findings> {
    let file = settings(task)?.net;
    let source = app.read(&file).map_err(|finding| {
        let place = task.args.get("net").and_then(|net| net.place().cloned());
        finding.at(place.unwrap_or_else(|| task.place.clone()))
    })?;
    let path = app.file_at(&file);
    let known = compiled().get(&path).cloned();
    let times = known.as_ref().map_or(1, |known| known.times + 1);
    if let Some(Known { texts, net, .. }) = known {
        let same = |(path, before): &(PathBuf, Source)| {
            let now = app.read(path);
            now.is_ok_and(|now| now.text() == before.text())
        };
        let mut texts = texts.iter();
        let own = texts.next();
        if own.is_some_and(|(_, own)| own.text() == source.text()) && texts.all(same) {
            return Ok(of_copy(net, &task.name));
        }
    }
    let folder = Path::new(&file).parent().unwrap_or(Path::new(""));
    let mut texts = vec![(PathBuf::from(&file), source.clone())];
    let net = compile::net_with(&source, &mut |included| {
        let path = folder.join(included);
        let source = app.read(&path)?;
        texts.push((path, source.clone()));
        Ok(source)
    });
    let net = Arc::new(net?);
    let known = Known {
        texts,
        net: Arc::clone(&net),
        times,
    };
    let mut compiled = compiled();
    if compiled.len() >= MOST_KEPT {
        compiled.clear();
    }
    compiled.insert(path, known);
    Ok(of_copy(net, &task.name))
}

/// The net of a task; a copy `cell7.dispatcher` runs the net `dispatcher` under its own name.
pub(super) fn of_copy(net: Arc<Net>, task: &str) -> Arc<Net> {
    match task.rsplit_once('.') {
        Some((_, name)) if name == net.name() => Arc::new(net.named(task)),
        _ => net,
    }
}

/// Checks one net task: its arguments, its net by itself, and that its library has every function
/// the net names. For [`ctos::registry::HandlerKind::check_in_app`].
pub fn check_args(
    task: &TaskConfig,
    app: &App,
    functions: &FunctionNames,
    findings: &mut Findings,
) {
    match net_of(task, app) {
        Ok(net) => {
            if settings(task).is_ok_and(|read| read.stand_in.is_none()) {
                check::functions(&net, functions, findings);
            }
            check_layout(&net, task, app, findings);
            if let Ok(settings) = settings(task) {
                breaks::check(&net, &app.file_at(settings.net), findings);
            }
            if net.name() != task.name {
                let finding = wrong_name(&task.name, net.name());
                findings.push(finding.at(task.place.clone()));
            }
            if let Ok(read) = settings(task) {
                let other = |name: &str| net_of(app.task(name)?, app).ok();
                settings::check(task, (&net, &read), other, app, findings);
            }
        }
        Err(found) => {
            findings.extend(found);
            if let Some(net) = as_far_as_known(task, app) {
                check::functions(&net, functions, findings);
            }
        }
    }
}

/// The net of a task that has mistakes, to look at how what is known of it fits to others.
fn as_far_as_known(task: &TaskConfig, app: &App) -> Option<Net> {
    let file = settings(task).ok()?.net;
    format::load_all(&app.file_at(file)).0
}

/// A net whose task is called otherwise.
pub(super) fn wrong_name(task: &str, net: &str) -> Finding {
    let text = format!("task `{task}` runs net `{net}`; the names must be the same");
    Finding::error("pnt::task::name", text)
        .help("rename one of them: other nets find this one's places by the task's name")
}

/// What is wrong with a layout file stops nothing: a net runs without it.
fn check_layout(net: &Net, task: &TaskConfig, app: &App, findings: &mut Findings) {
    let Ok(settings) = settings(task) else { return };
    let path = app.file_at(settings.net);
    let mut found = Findings::new();
    let file = LayoutFile::of_net(&path, &mut found);
    if file == LayoutFile::default() && found.is_empty() {
        return;
    }
    for mut finding in found.into_sorted() {
        finding.severity = Severity::Warning;
        findings.push(finding);
    }
    let mut view = NetView::new(net);
    let known: Vec<String> = view.names().map(str::to_owned).collect();
    for name in file.pin(&mut view) {
        let message = format!("net `{}` has no node `{name}` to draw there", net.name());
        let finding = Finding::warning("pnt::layout::unknown_node", message)
            .suggest(&name, known.iter().map(String::as_str))
            .label(format!("its drawing is {}", beside(&path).display()));
        findings.push(finding.at(task.place.clone()));
    }
}

/// Has all nets of every app checked together before it starts ([`check_app`]).
pub fn check_nets(registry: &mut Registry) {
    registry.app_check("pnt::nets", |app, registry, findings| {
        check_app(app, registry, &Limits::default(), findings);
    });
}

/// Whether the handler of `task` runs a net: it takes what nets take.
pub(super) fn runs_net(task: &TaskConfig, registry: &Registry) -> bool {
    registry.kind(&task.handler).is_some_and(|kind| {
        COMMANDS
            .iter()
            .all(|command| kind.commands().contains(command))
    })
}

/// The tasks of an app that run nets, in declared order.
#[must_use]
pub fn net_tasks(app: &App, registry: &Registry) -> Vec<String> {
    let tasks = app.tasks.iter().filter(|task| runs_net(task, registry));
    tasks.map(|task| task.name.clone()).collect()
}

/// The nets of an app, whichever handlers run them.
///
/// # Errors
/// All findings about the first net that is wrong by itself.
pub fn nets(app: &App, registry: &Registry) -> Result<Vec<Arc<Net>>, Findings> {
    let tasks = app.tasks.iter().filter(|task| runs_net(task, registry));
    tasks.map(|task| net_of(task, app)).collect()
}

/// Checks all nets of an app together, whichever handlers run them. When one of the nets is wrong by itself
/// ([`check_args`] tells), nothing is proved, and only what they send is looked at.
pub fn check_app(
    app: &App,
    registry: &Registry,
    limits: &Limits,
    findings: &mut Findings,
) -> Option<Report> {
    check_app_with(app, registry, limits, None, findings)
}

/// [`check_app`] with another net in the place of the one that the app has under its name.
pub(super) fn check_app_with(
    app: &App,
    registry: &Registry,
    limits: &Limits,
    instead: Option<&Net>,
    findings: &mut Findings,
) -> Option<Report> {
    let Ok(mut nets) = nets(app, registry) else {
        let tasks = net_tasks(app, registry);
        let known = tasks.iter().filter_map(|name| {
            let task = app.task(name)?;
            let whole = net_of(task, app).ok();
            whole.or_else(|| as_far_as_known(task, app).map(Arc::new))
        });
        let known: Vec<Arc<Net>> = known.collect();
        check_messages(&known, app, registry, findings);
        if known.len() == tasks.len() {
            let fit = check::fit(&known).into_sorted().into_iter();
            let sure = fit.filter(|finding| finding.code == "pnt::app::unknown_net");
            sure.for_each(|finding| findings.push(finding));
        }
        return None;
    };
    if nets.is_empty() {
        return None;
    }
    if let Some(instead) = instead {
        for net in nets.iter_mut().filter(|net| net.name() == instead.name()) {
            *net = Arc::new(instead.clone());
        }
    }
    check_messages(&nets, app, registry, findings);
    let (report, found) = check::check(&nets, limits);
    findings.extend(found);
    Some(report)
}

/// Checks the message actions of all nets of an app: that somebody takes them, with such data objects.
pub fn check_messages(nets: &[Arc<Net>], app: &App, registry: &Registry, findings: &mut Findings) {
    let stood_in = |net: &&Arc<Net>| {
        let settings = app.task(net.name()).and_then(|task| settings(task).ok());
        settings.is_some_and(|settings| settings.stand_in.is_some())
    };
    for net in nets.iter().filter(|net| !stood_in(net)) {
        check_messages_of(net, nets, (app, registry), findings);
    }
}

/// Every message action must go to a task that takes the command with such data objects, or to a net that
/// reads the symbol.
fn check_messages_of(
    net: &Net,
    nets: &[Arc<Net>],
    (app, registry): (&App, &Registry),
    findings: &mut Findings,
) {
    for transition in net.transitions() {
        let Some(Action::Message {
            task,
            command,
            inputs,
            outputs,
            at,
            ..
        }) = &transition.action
        else {
            continue;
        };
        let objects = (inputs.as_slice(), outputs.as_slice());
        let other = nets.iter().find(|other| other.name() == task);
        let found = if other.is_some_and(|other| other.command(command).is_some()) {
            let why = "it goes with the arguments of the command in progress";
            objects::none(
                &format!("command `{command}` of net `{task}`"),
                why,
                objects,
            )
        } else {
            match registry.command_of(app, task, command) {
                Ok(info) => {
                    let types = (info.request, info.reply);
                    let what = format!("command `{command}` of task `{task}`");
                    let mut found = objects::check(&what, objects, types);
                    if found.is_empty() {
                        found = fields::check(&what, net, inputs, types.0);
                        found.extend(fields::check(&what, net, outputs, types.1));
                    }
                    found
                }
                Err(finding) => vec![finding],
            }
        };
        for finding in found {
            findings.push(finding.at(at.clone()));
        }
    }
}

#[cfg(test)]
mod tests {
    use ctos::config;

    use super::*;
    use crate::{library::Library, task};

    ctos::command! {
        /// Doubles.
        struct Double => (), 0x0001, "double"
    }

    fn library() -> Library<()> {
        Library::new(()).action("find_spot", |_| async { Ok(()) })
    }

    fn write_app(folder: &Path, files: &[(&str, &str)]) -> App {
        for (name, text) in files {
            std::fs::write(folder.join(name), text).unwrap();
        }
        config::load(&folder.join("app.toml"), &[], &[]).unwrap_or_else(|f| panic!("{f}"))
    }

    fn checked(app: &App) -> Findings {
        let mut registry = Registry::new();
        task::register(&mut registry, "test.net", library);
        registry.function::<Double, _, _>("test.doubler", |_, Double {}| async move { Ok(()) });
        registry.check(app)
    }

    ctos::command! {
        /// Looks.
        struct Look { from: String, far_m: f64 } => (String, f64, u8), 0x0001, "look"
    }

    #[test]
    fn data_objects_that_do_not_fit_what_an_action_calls_are_found_where_it_stands() {
        let folder = tempfile::tempdir().unwrap();
        let config = "[app]\nname = \"t\"\n[chassis.a]\n[task.n]\nhandler = \"test.net\"\non = \"a\"\nargs = { net = \"n.net\" }\n[task.camera]\nhandler = \"test.camera\"\non = \"a\"\n";
        let checked = |actions: [&str; 3]| {
            let mut text = "net n\nplace a = 1\ncommand go -> gone\ntransition answer\n  in a\n  tape go\n  out a\n  write gone\n".to_owned();
            for (number, action) in actions.iter().enumerate() {
                text += &format!("transition t{number}\n  in a\n  {action}\n  out a\n");
            }
            let app = write_app(folder.path(), &[("app.toml", config), ("n.net", &text)]);
            let mut registry = Registry::new();
            task::register(&mut registry, "test.net", || {
                library().function("turn", |_, (a, b): (u8, u8)| async move { Ok((b, a)) })
            });
            registry.function::<Look, _, _>("test.camera", |_, look| async move {
                Ok((look.from, look.far_m, 0))
            });
            registry.check(&app)
        };
        for fits in [
            [
                "do turn(p, q -> q, p)",
                "send camera.look(p, q -> x, y, z)",
                "do find_spot",
            ],
            [
                "do turn(p -> q)",
                "send camera.look(p -> x)",
                "do turn(p, q)",
            ],
        ] {
            let found = checked(fits);
            assert!(found.is_empty(), "{found}");
        }
        let found = checked([
            "do turn(p, q -> x, y, z)",
            "send camera.look(p, q, r -> x, y)",
            "do find_spot(p -> q)",
        ])
        .to_string();
        for (line, said) in [
            (
                "11:6",
                "local function `turn` gives 2 results, and 3 data objects are there to take them",
            ),
            (
                "15:8",
                "command `look` of task `camera` takes 2 arguments, and 3 data objects go with it",
            ),
            (
                "15:8",
                "command `look` of task `camera` gives 3 results, and 2 data objects are there to take them",
            ),
            (
                "19:6",
                "local function `find_spot` takes no data objects from a net and gives none",
            ),
        ] {
            let said = format!("n.net:{line}: error: {said}");
            assert!(found.contains(&said), "{said}\n{found}");
        }
        let to_net = checked(["send n.go(p)", "do find_spot", "do find_spot"]).to_string();
        let said = "n.net:11:8: error: command `go` of net `n` takes no data objects";
        assert!(to_net.contains(said), "{to_net}");
    }

    #[test]
    fn what_a_net_sends_and_calls_is_looked_at_beside_what_is_wrong_in_its_text() {
        let folder = tempfile::tempdir().unwrap();
        let config = "[app]\nname = \"t\"\n[chassis.a]\n[task.n]\nhandler = \"test.net\"\non = \"a\"\nargs = { net = \"n.net\" }\n[task.doubler]\nhandler = \"test.doubler\"\non = \"a\"\n";
        let wrong = "net n\nplace a = 1\ntransition t\n  in b\n  do find_spt\n  out a\ntransition u\n  in a\n  send doubler.dubble\n  out a\n";
        let app = write_app(folder.path(), &[("app.toml", config), ("n.net", wrong)]);
        let found = checked(&app);
        let codes: Vec<&str> = found.iter().map(|finding| finding.code).collect();
        assert_eq!(
            codes,
            [
                "pnt::net::unknown_place",
                "pnt::net::unknown_function",
                "ctos::config::unknown_command",
            ],
            "{found}"
        );
    }

    #[test]
    fn data_that_is_called_as_an_enabling_function_of_the_library_is_found() {
        let folder = tempfile::tempdir().unwrap();
        let config = "[app]\nname = \"t\"\n[chassis.a]\n[task.n]\nhandler = \"test.net\"\non = \"a\"\nargs = { net = \"n.net\" }\n";
        let net = "net n\nplace a = 1\ndata more : bool\ncommand go -> gone\ntransition t\n  in a\n  tape go\n  when more\n  out a\n  write gone\ntransition u\n  in a\n  tape go\n  when not more\n  out a\n  write gone\n";
        let found = |net: &str| {
            let app = write_app(folder.path(), &[("app.toml", config), ("n.net", net)]);
            let mut registry = Registry::new();
            task::register(&mut registry, "test.net", || {
                Library::new(()).enabling("more", |()| true)
            });
            registry.check(&app).to_string()
        };
        let said = found(net);
        assert!(
            said.contains(
                "n.net:3:6: error: data `more` hides the enabling function `more` of the library of net `n`"
            ),
            "{said}"
        );
        assert_eq!(found(&net.replace("data more : bool\n", "")), "");
        assert_eq!(found(&net.replace("more", "other")), "");
    }

    #[test]
    fn an_app_with_a_sound_net_has_no_findings_and_one_with_mistakes_has_them_where_they_are() {
        let folder = tempfile::tempdir().unwrap();
        let config = "[app]\nname = \"t\"\n[chassis.a]\n[task.n]\nhandler = \"test.net\"\non = \"a\"\nargs = { net = \"n.net\" }\n[task.doubler]\nhandler = \"test.doubler\"\non = \"a\"\n";
        let sound = "net n\nplace a = 1\ntransition t\n  in a\n  do find_spot\n  out a\ntransition u\n  in a\n  send doubler.double\n  out a\n";
        let found = checked(&write_app(
            folder.path(),
            &[("app.toml", config), ("n.net", sound)],
        ));
        assert!(found.is_empty(), "{found}");

        let wrong = sound
            .replace("find_spot", "find_spott")
            .replace("doubler.double", "doubler.dubble");
        let shown = checked(&write_app(
            folder.path(),
            &[("app.toml", config), ("n.net", &wrong)],
        ))
        .to_string();
        assert!(shown.contains("n.net:5:6: error: the library of net `n` has no local function `find_spott` (did you mean `find_spot`?)"), "{shown}");
        assert!(
            shown.contains(
                "n.net:9:8: error: task `doubler` takes no command `dubble` (did you mean `double`?)"
            ),
            "{shown}"
        );

        let bad_text = checked(&write_app(
            folder.path(),
            &[("app.toml", config), ("n.net", "net n\nplase a\n")],
        ))
        .to_string();
        assert_eq!(bad_text.lines().count(), 1, "{bad_text}");
        assert!(
            bad_text.contains("n.net:2:1: error: no line of net text begins with `plase`"),
            "{bad_text}"
        );

        let other_name = checked(&write_app(
            folder.path(),
            &[
                ("app.toml", config),
                ("n.net", &sound.replace("net n", "net m")),
            ],
        ))
        .to_string();
        assert!(
            other_name.contains("task `n` runs net `m`; the names must be the same"),
            "{other_name}"
        );

        let no_file = checked(&write_app(
            folder.path(),
            &[("app.toml", &config.replace("n.net", "x.net"))],
        ))
        .to_string();
        assert!(no_file.contains("x.net"), "{no_file}");
        let no_net = checked(&write_app(
            folder.path(),
            &[("app.toml", &config.replace("net = ", "nett = "))],
        ))
        .to_string();
        assert!(
            no_net.contains("runs a net and does not say which"),
            "{no_net}"
        );
    }
}

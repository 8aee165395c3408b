//! The operator: stands in for the Organization Level. Puts one command on a Dispatcher's input tape, or one after the other
//! from a list, waits for each answer on its output tape, and ends the app with the last. After a list it tells how long each step of the
//! net took.

mod phases;

use std::time::Duration;

use ctos::{
    config::TaskConfig,
    diagnostic::{Finding, Findings},
    message::Message,
    registry::Registry,
    system::AppResult,
    task::{Context, EventHandler, Handled, HandlerError, Phase},
};
use pnt::net::Net;
use pnt::task::{Marking, PutOnce, RequestId, TapeAnswer, put_once};
use serde::Deserialize;

use self::phases::Phases;
use crate::referee::Judge;

/// The handler's name.
pub const HANDLER: &str = "coordinators.operator";

/// The longest that a command may take.
const LONGEST: Duration = Duration::from_secs(1_000_000_000);

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct OperatorArgs {
    /// The net task that takes the command.
    #[serde(default = "dispatcher_task")]
    dispatcher: String,
    /// The input tape symbol.
    command: String,
    /// What goes along with it.
    #[serde(default)]
    arguments: Vec<String>,
    /// A file, relative to the configuration's folder, of commands with other arguments: those of one on each line, with
    /// spaces between them. What is empty or begins with `#` is none. The first that does not succeed is the last.
    list: Option<String>,
    /// It commands nothing: others do, until somebody stops the app.
    #[serde(default)]
    waits: bool,
    /// The output tape symbol that means success.
    success: String,
    /// How long the command may take.
    #[serde(default = "within_s")]
    within_s: Duration,
    /// The task that judges the result against the truth, if there is one.
    judge: Option<String>,
}

fn dispatcher_task() -> String {
    "dispatcher".to_owned()
}

fn within_s() -> Duration {
    Duration::from_secs(1800)
}

/// The event handler.
struct Operator {
    args: OperatorArgs,
}

/// Registers the handler.
pub(crate) fn register(registry: &mut Registry) {
    registry
        .handler(HANDLER, &[], |cx| Ok(Operator { args: cx.args()? }))
        .checked_args::<OperatorArgs>(|args, task, app, findings| {
            crate::need_task(task, app, "dispatcher", &args.dispatcher, findings);
            if let Some(judge) = &args.judge {
                crate::need_task(task, app, "judge", judge, findings);
            }
            if args.within_s.is_zero() || args.within_s > LONGEST {
                let place = task.args.locate("within_s");
                findings.push(
                    Finding::error(
                        "coordinators::operator::within",
                        format!("`within_s` is {}", args.within_s.as_secs_f64()),
                    )
                    .at(place.unwrap_or_else(|| task.place.clone()))
                    .help("give a positive number of seconds"),
                );
            }
            if let Some(list) = &args.list
                && let Err(finding) = app.read(list)
            {
                let place = task.args.locate("list");
                findings.push(finding.at(place.unwrap_or_else(|| task.place.clone())));
            }
            // What is wrong with a net by itself is told of its own task.
            let dispatcher = app.task(&args.dispatcher);
            if let Some(Ok(net)) = dispatcher.map(|task| pnt::task::net_of(task, app)) {
                check_symbols(args, &net, task, findings);
            }
        });
}

/// The command must be one that the net takes, and what counts as success one of its answers.
fn check_symbols(args: &OperatorArgs, net: &Net, task: &TaskConfig, findings: &mut Findings) {
    let mut unknown = |key: &str, text: String, given: &str, known: Vec<&str>| {
        let place = task.args.locate(key).unwrap_or_else(|| task.place.clone());
        let finding = Finding::error("coordinators::operator::symbol", text).at(place);
        findings.push(finding.suggest(given, known));
    };
    let mut commands = net.commands().iter();
    let name = &args.dispatcher;
    match commands.find(|command| command.symbol == args.command) {
        None => {
            let text = format!("net `{name}` takes no command `{}`", args.command);
            let known = net.commands().iter().map(|command| &*command.symbol);
            unknown("command", text, &args.command, known.collect());
        }
        Some(command) if !command.answers.contains(&args.success) => {
            let (symbol, success) = (&args.command, &args.success);
            let text = format!("net `{name}` never answers `{symbol}` with `{success}`");
            let known = command.answers.iter().map(String::as_str);
            unknown("success", text, success, known.collect());
        }
        Some(_) => {}
    }
}

impl EventHandler for Operator {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        match phase {
            Phase::Create => {}
            Phase::Connect => {
                cx.task(&self.args.dispatcher).await?;
            }
            Phase::Run if self.args.waits => {}
            Phase::Run => {
                let (child, args) = (cx.clone(), self.args.clone());
                cx.spawn(async move {
                    let result = command(&child, &args).await;
                    child.finish(result.unwrap_or_else(|error| failure(&error.to_string())));
                });
            }
        }
        Ok(())
    }
}

fn failure(reason: &str) -> AppResult {
    AppResult {
        ok: false,
        text: reason.to_owned(),
        json: serde_json::json!({ "ok": false, "reason": reason }).to_string(),
    }
}

/// The arguments of each command, in their order.
fn orders(cx: &Context, args: &OperatorArgs) -> Result<Vec<Vec<String>>, HandlerError> {
    let Some(list) = &args.list else {
        return Ok(vec![args.arguments.clone()]);
    };
    let source = cx.app().read(list);
    let source = source.map_err(|finding| HandlerError::new(finding.to_string()))?;
    let lines = source.text().lines().map(str::trim);
    let orders: Vec<Vec<String>> = lines
        .filter(|line| !line.is_empty() && !line.starts_with('#'))
        .map(|line| line.split_whitespace().map(ToOwned::to_owned).collect())
        .collect();
    if orders.is_empty() {
        return Err(HandlerError::new(format!("`{list}` names no command")));
    }
    Ok(orders)
}

async fn command(cx: &Context, args: &OperatorArgs) -> Result<AppResult, HandlerError> {
    let began = cx.now();
    // It asks once in the life of an app, also when it is started again in it. What a durable Dispatcher
    // remembers of an earlier boot is another request.
    let boot = cx.started_ns();
    let orders = orders(cx, args)?;
    let (mut symbol, mut text) = (String::new(), String::new());
    let mut phases = Phases::default();
    for (number, arguments) in (1..).zip(&orders) {
        let asked = cx.now();
        let put = PutOnce {
            request: RequestId {
                from: format!("{} {boot:016x}", cx.name()),
                number,
            },
            symbol: args.command.clone(),
            arguments: arguments.clone(),
        };
        let answered = put_once(cx, &args.dispatcher, &put, args.within_s).await?;
        TapeAnswer { symbol, text, .. } = answered;
        if symbol != args.success {
            let which = match orders.len() {
                1 => String::new(),
                count => format!("command {number} of {count}, `{}`: ", arguments.join(" ")),
            };
            return Ok(failure(&format!("{which}{symbol}: {text}")));
        }
        if orders.len() > 1 {
            cx.progress(
                number,
                orders.len() as u64,
                &args.command,
                &arguments.join(" "),
            );
            let dispatcher = cx.task(&args.dispatcher).await?;
            let net = cx.call(&dispatcher, Marking {}).await?;
            phases.add(&net.events, asked);
        }
    }
    if orders.len() > 1 {
        text = format!("{text}\n{}", phases.table());
    }
    let Some(judge) = &args.judge else {
        let json = serde_json::json!({ "ok": true, "answer": symbol }).to_string();
        return Ok(AppResult {
            ok: true,
            text: format!("{symbol}\n{text}"),
            json,
        });
    };
    let judge = cx.task(judge).await?;
    let seconds = cx.now().since(began).as_secs_f64();
    let judged = cx
        .call(
            &judge,
            Judge {
                seconds,
                notes: text,
            },
        )
        .await;
    judged.map_err(|error| HandlerError::new(error.reason()))
}

#[cfg(test)]
mod tests {
    use std::{path::Path, sync::Arc};

    use ctos::{
        boot::End,
        diagnostic::Source,
        simulation::{self, Fault, FaultKind, Faults, Setup},
        time::Instant,
    };
    use pnt::{
        library::{Action, Library},
        task::{COMMANDS, NetTask, settings},
    };

    use super::*;
    use crate::rig::{self, Answer, Rig, Shared};

    /// The text of the rig's app with the real operator, and with the referee that it asks.
    fn with_operator(rig: &Rig, folder: &Path, more: &str) -> String {
        rig::app_text(rig, folder).replace(
            "handler = \"test.operator\"\non = \"ws1\"\n",
            &format!(
                "handler = \"coordinators.operator\"\non = \"ws1\"\n[task.operator.args]\ncommand = \"calibrate_camera\"\nsuccess = \"calibration_done\"\n{more}\n[task.referee]\nhandler = \"coordinators.referee\"\non = \"ws1\"\n"
            ),
        )
    }

    #[test]
    fn what_the_net_does_not_take_or_never_answers_is_found_before_anything_starts() {
        let rig = Rig::default();
        let folder = tempfile::tempdir().unwrap();
        let text = with_operator(&rig, folder.path(), "");
        let registry = rig::registry(&rig, &Shared::default());
        for (right, wrong, said) in [
            (
                "command = \"calibrate_camera\"",
                "command = \"calibrate_camra\"",
                "net `dispatcher` takes no command `calibrate_camra` (did you mean `calibrate_camera`?)",
            ),
            (
                "success = \"calibration_done\"",
                "success = \"finished\"",
                "net `dispatcher` never answers `calibrate_camera` with `finished` (known here: calibration_done",
            ),
            (
                "success = \"calibration_done\"",
                "success = \"calibration_done\"\nwithin_s = -1",
                "`within_s`: -1 s is no time (give a number of seconds, 0 or more)",
            ),
        ] {
            let text = text.replace(right, wrong);
            let findings = registry.check(&rig::load(&text, folder.path()));
            assert!(findings.has_errors(), "{wrong}");
            assert!(findings.to_string().contains(said), "{findings}");
        }
    }

    /// How it ends.
    fn operated(rig: &Rig, more: &str) -> AppResult {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("twice.txt"), "enough=50%\nenough=50%\n").unwrap();
        let text = with_operator(rig, folder.path(), more);
        let world = Shared::default();
        let registry = rig::registry(rig, &world);
        let app = rig::load(&text, folder.path());
        let findings = registry.check(&app);
        assert!(findings.is_empty(), "{findings}");
        match rig::boot(app, registry, &world) {
            End::Finished(result) => result,
            other => panic!("{other:?}"),
        }
    }

    fn refusing(what: &'static str, occurrence: usize) -> Rig {
        Rig {
            script: Arc::new(
                move |command, detail, n| match command == what && n == occurrence {
                    true => Answer::Refuse,
                    // Where one way is refused, so are the others.
                    false if detail.starts_with("Some") => Answer::Refuse,
                    false => Answer::Work,
                },
            ),
            ..Rig::default()
        }
    }

    #[test]
    fn a_command_that_succeeds_ends_the_app_with_the_judges_verdict() {
        let result = operated(&refusing("plan", 2), "judge = \"referee\"");
        assert!(result.ok, "{}", result.text);
        let json: serde_json::Value = serde_json::from_str(&result.json).unwrap();
        assert_eq!(json["positions"], 15);
        assert_eq!(json["rejected"], 0);
        assert!(json["seconds"].as_f64().unwrap() > 15.0);
        for camera in json["cameras"].as_array().unwrap() {
            assert!(
                camera["position_error_m"].as_f64().unwrap() < 1e-6,
                "{camera}"
            );
            assert!(camera["rms_true_px"].as_f64().unwrap() < 1e-6, "{camera}");
        }
        let skipped = "  line 5: position 3 cannot be reached: plan None: refused on purpose\n";
        assert!(result.text.contains(skipped), "{}", result.text);
    }

    #[test]
    fn rejected_spots_are_counted_over_all_cameras() {
        let rig = Rig {
            script: Arc::new(|command, camera, n| match (command, camera) {
                ("spot_find", "west") if n < 3 => Answer::Refuse,
                ("spot_find", "east") if n < 6 => Answer::Refuse,
                _ => Answer::Work,
            }),
            ..Rig::default()
        };
        let result = operated(&rig, "judge = \"referee\"");
        let json: serde_json::Value = serde_json::from_str(&result.json).unwrap();
        // Three looks are one miss.
        assert_eq!(json["rejected"], 3, "{}", result.text);
        assert_eq!(json["cameras"][0]["rejected"], 1);
        assert_eq!(json["cameras"][1]["missed"], 2);
    }

    #[test]
    fn without_a_judge_the_answer_itself_ends_the_app() {
        let result = operated(&Rig::default(), "");
        assert!(
            result.ok && result.text.starts_with("calibration_done"),
            "{}",
            result.text
        );
    }

    #[test]
    fn after_a_list_stands_how_often_each_step_was_done_and_how_long_it_took() {
        let result = operated(&Rig::default(), "list = \"twice.txt\"");
        assert!(result.ok, "{}", result.text);
        let rows = result
            .text
            .lines()
            .skip_while(|line| !line.starts_with("step "));
        let rows: Vec<Vec<&str>> = rows.map(|row| row.split_whitespace().collect()).collect();
        assert!(rows.len() > 2, "{}", result.text);
        for row in &rows[1..] {
            let [_, times, mean, most] = row.as_slice() else {
                panic!("{row:?}");
            };
            let (mean, most): (f64, f64) = (mean.parse().unwrap(), most.parse().unwrap());
            assert!(
                times.parse::<u32>().unwrap() >= 2 && 0.0 < mean && mean <= most,
                "{row:?}"
            );
        }
    }

    #[test]
    fn a_command_that_fails_ends_the_app_with_its_reason() {
        let result = operated(&refusing("calibrate", 0), "judge = \"referee\"");
        assert!(!result.ok);
        let json: serde_json::Value = serde_json::from_str(&result.json).unwrap();
        assert_eq!(json["ok"], false);
        let reason = json["reason"].as_str().unwrap();
        assert!(reason.starts_with("calibration_failed: "), "{reason}");
        assert!(reason.contains("refused on purpose"), "{reason}");
    }

    #[test]
    fn a_command_that_takes_too_long_ends_the_app_with_the_limit() {
        let result = operated(&Rig::default(), "within_s = 5.0");
        assert!(!result.ok);
        assert!(result.text.contains("within 5.000 s"), "{}", result.text);
    }

    #[test]
    fn a_judge_that_cannot_judge_ends_the_app_with_its_reason() {
        let result = operated(&refusing("true_cameras", 0), "judge = \"referee\"");
        assert!(!result.ok);
        assert!(
            result.text.contains("true_cameras : refused on purpose"),
            "{}",
            result.text
        );
    }

    /// Counts how often its command was done.
    const COUNTING: &str = "net dispatcher
place free = 1, done, times
command go -> gone
transition work
  in free
  tape go
  do work
  idempotent
  out done, times
transition answer
  in done
  out free
  write gone
";

    /// How often the one command of an app was done, when chassis die at these times, ms.
    fn done_times(kills: &[(&str, u64)]) -> End {
        let chassis = |name: &str| {
            format!(
                "[chassis.{name}]\nrestart = \"always\"\nmax_restarts = 100\nrestart_backoff_s = 0.05\n"
            )
        };
        let text = format!(
            "[app]\nname = \"t\"\nuntil = \"operator\"\n[time]\nmode = \"virtual\"\n{}{}[chassis.court]\n[task.operator]\nhandler = \"coordinators.operator\"\non = \"desk\"\nargs = {{ command = \"go\", success = \"gone\", judge = \"judge\" }}\n[task.dispatcher]\nhandler = \"test.net\"\non = \"home\"\nargs = {{ net = \"dispatcher.net\", durable = true }}\n[task.judge]\nhandler = \"test.judge\"\non = \"court\"\n",
            chassis("desk"),
            chassis("home"),
        );
        let app = ctos::config::load_texts(&[("app.toml", &text)], &[], &[]).unwrap();
        let mut registry = Registry::new();
        register(&mut registry);
        let net = pnt::compile::net(&Source::new("dispatcher.net", COUNTING)).unwrap();
        registry.handler("test.net", &COMMANDS, move |cx| {
            let library = Library::new(()).action("work", |action: Action<()>| async move {
                action.cx().sleep(Duration::from_millis(200)).await;
                Ok(())
            });
            let settings = settings(cx.config().unwrap())?;
            NetTask::with_settings(cx, net.clone(), library, None, settings)
        });
        registry.function::<Judge, _, _>("test.judge", |cx, _| async move {
            let snapshot = loop {
                let to = cx
                    .wait_for_task("dispatcher", Duration::from_secs(60))
                    .await?;
                match cx.call(&to, Marking {}).await {
                    Ok(snapshot) => break snapshot,
                    Err(_) => cx.sleep(Duration::from_millis(50)).await,
                }
            };
            let times = snapshot.places.iter().find(|(place, _)| place == "times");
            Ok(AppResult {
                ok: true,
                text: format!("{times:?}"),
                json: String::new(),
            })
        });
        let kills = kills.iter().map(|(chassis, ms)| {
            Fault::on(
                (*chassis).to_owned(),
                FaultKind::Kill,
                Instant::from_nanos(ms * 1_000_000),
            )
        });
        let setup = Setup {
            faults: Faults::of_script("deaths", kills.collect()),
            ..Setup::default()
        };
        let observer: ctos::boot::Observer = Arc::new(|_| {});
        let run = simulation::run(app, registry, setup, &observer).unwrap();
        run.outcome.end
    }

    #[test]
    fn a_command_whose_answer_was_lost_is_asked_for_again_and_done_once() {
        for step in 0..30 {
            let at = 1 + step * 11;
            for kills in [
                vec![("home", at)],
                vec![("desk", at)],
                vec![("home", at), ("desk", at + 90), ("home", at + 250)],
            ] {
                match done_times(&kills) {
                    End::Finished(result) => {
                        let text = result.text;
                        assert_eq!(text, "Some((\"times\", 1))", "{kills:?}");
                    }
                    other => panic!("{kills:?}: {other:?}"),
                }
            }
        }
    }
}

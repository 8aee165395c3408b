//! Programs in real time: what a call of one costs beside a bare pipe, and bad ones beside good tasks.
//!
//! Its own `main`, because the chassis of the apps are processes of this program.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test may end where it finds something wrong"
)]

use std::{
    ffi::OsString,
    fs,
    io::{BufRead as _, BufReader, Write as _},
    path::Path,
    process::{Command, ExitCode, Stdio},
    sync::Arc,
    time::Duration,
};

use ctos::{
    boot::{BootEvent, End, Launcher, boot, run_chassis},
    config::{self, App},
    message::Message,
    registry::Registry,
    system::AppResult,
    task::{Context, EventHandler, Handled, Phase},
};
use libtest_mimic::{Arguments, Failed, Trial};
use serde_json::{Value, json};

/// The first argument of a process that is a chassis and not the tests.
const CHASSIS: &str = "program-chassis";

ctos::command! {
    /// Adds to the sum so far.
    struct Add { number: i64 } => i64, 1, "add"
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

#[derive(serde::Deserialize)]
struct Case {
    case: String,
}

/// Carries out a case, and ends the app with what came of it.
struct Person;

impl EventHandler for Person {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let here = cx.clone();
            cx.spawn(async move {
                let done = match here.args::<Case>().unwrap().case.as_str() {
                    "ratio" => ratio(&here).await,
                    "beside" => beside(&here).await,
                    "moved" => moved(&here).await,
                    _ => ask(&here, "find", json!({"number": 1}))
                        .await
                        .map(|found| found.to_string()),
                };
                let (ok, text) = match done {
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

fn registry() -> Registry {
    let mut registry = Registry::new();
    bridge_program::register(&mut registry);
    registry.handler("sum", &Sum::COMMANDS, |_| Ok(Sum::default()));
    registry
        .handler("person", &[], |_| Ok(Person))
        .args::<Case>();
    registry
}

async fn ask(cx: &Context, command: &str, data: Value) -> Result<Value, String> {
    let info = cx.registry().command_of(cx.app(), "detector", command);
    let info = info.map_err(|finding| finding.to_string())?;
    let bytes = bridge_program::encoded(&info.request.shape().unwrap(), &data)?;
    let found = cx
        .task("detector")
        .await
        .map_err(|error| error.to_string())?;
    let reply = cx
        .call_raw(&found, info, bytes, Duration::from_secs(30))
        .await;
    let reply = reply.map_err(|error| error.to_string())?;
    let json = bridge_program::told(&info.reply.shape().unwrap(), &reply, 1 << 30).unwrap();
    Ok(serde_json::from_slice(&json).unwrap())
}

fn median(mut all: Vec<Duration>) -> f64 {
    all.sort_unstable();
    all[all.len() / 2].as_secs_f64() * 1e6
}

const BARE: &str = "import json, sys
out = open(1, 'wb', buffering=0)
for line in sys.stdin.buffer:
    line = json.loads(line)
    out.write(json.dumps({'reply': {'id': line['message']['id'], 'data': 2 * line['message']['data']['number']}}).encode() + b'\\n')
";

/// Calls of a Python handler, and the same lines through a bare pipe, in turns.
async fn ratio(cx: &Context) -> Result<String, String> {
    let mut child = Command::new(python())
        .args(["-c", BARE])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .map_err(|error| error.to_string())?;
    let (mut to, mut from) = (
        child.stdin.take().unwrap(),
        BufReader::new(child.stdout.take().unwrap()),
    );
    let found = cx
        .task("detector")
        .await
        .map_err(|error| error.to_string())?;
    let info = cx
        .registry()
        .command_of(cx.app(), "detector", "double")
        .map_err(|error| error.to_string())?;
    let (mut bare, mut asked) = (Vec::new(), Vec::new());
    for number in 0..2000_i64 {
        let began = cx.now();
        let data = postcard(number);
        let reply = cx
            .call_raw(&found, info, data, Duration::from_secs(10))
            .await;
        let took = cx.now().since(began);
        assert_eq!(
            reply.map_err(|error| error.to_string())?,
            postcard(2 * number)
        );
        asked.push(took);
        let began = cx.now();
        let line = format!(
            "{{\"message\":{{\"id\":{number},\"command\":\"double\",\"left_s\":10.0,\"data\":{{\"number\":{number}}}}}}}\n"
        );
        to.write_all(line.as_bytes())
            .map_err(|error| error.to_string())?;
        let mut answer = String::new();
        from.read_line(&mut answer)
            .map_err(|error| error.to_string())?;
        let answer: Value = serde_json::from_str(&answer).map_err(|error| error.to_string())?;
        assert_eq!(answer["reply"]["data"], 2 * number);
        bare.push(cx.now().since(began));
    }
    drop(to);
    let _ = child.wait();
    let (asked, bare) = (median(asked), median(bare));
    let ratio = asked / bare;
    Ok(format!(
        "{asked:.0} us a call, {bare:.0} us the bare pipe, ratio {ratio:.2}"
    ))
}

/// An `int` as one field.
fn postcard(number: i64) -> Vec<u8> {
    let shape = ctos::message::Shape::of::<i64>().unwrap();
    bridge_program::encoded(&shape, &json!(number)).unwrap()
}

/// While the program does whatever it does, a task of the same processor answers.
async fn beside(cx: &Context) -> Result<String, String> {
    let sum = cx.task("sum").await.map_err(|error| error.to_string())?;
    let child = cx.clone();
    let big = "x".repeat(4 << 20);
    cx.spawn(async move {
        let _ = ask(&child, "load", json!({"text": big})).await;
    });
    let mut waits = Vec::new();
    for _ in 0..50 {
        let began = cx.now();
        cx.call(&sum, Add { number: 1 })
            .await
            .map_err(|error| error.to_string())?;
        waits.push(cx.now().since(began));
        cx.sleep(Duration::from_millis(2)).await;
    }
    Ok(format!("{:.0} us", median(waits)))
}

async fn moved(cx: &Context) -> Result<String, String> {
    let first = ask(cx, "double", json!({"number": 4})).await?;
    let place = cx
        .move_task("detector", "b:main")
        .await
        .map_err(|error| error.to_string())?;
    let count = ask(cx, "count", json!({})).await?;
    Ok(format!("{first} {place} {count}"))
}

fn python() -> String {
    std::env::var("CTOS_PYTHON").unwrap_or_else(|_| "python3".to_owned())
}

const DETECTOR: &str = r#"
import ctos

@ctos.handler
def double(number: int) -> int:
    return 2 * number

@ctos.handler
def count() -> int:
    return ctos.state() or 0

@ctos.on_run
def begins():
    ctos.keep((ctos.state() or 0) + 1)

ctos.run()
"#;

const TOML: &str = r#"
[command.double]
request = { number = "int" }
reply = "int"
[command.count]
reply = "int"
[command.find]
request = { number = "int" }
reply = "int"
[command.load]
request = { text = "text" }
reply = "int"
"#;

fn app(folder: &Path) -> App {
    config::load(&folder.join("app.toml"), &[], &[]).unwrap_or_else(|found| panic!("{found}"))
}

/// Boots the app of a case with this program.
fn run(case: &str, command: &str) -> Result<String, Failed> {
    let folder = tempfile::tempdir()?;
    let client = Path::new(env!("CARGO_MANIFEST_DIR"))
        .ancestors()
        .nth(2)
        .unwrap();
    let client = client.join("clients/python/src").display().to_string();
    let text = format!(
        "app.until = \"person\"\n[chassis.a]\n[chassis.b]\n\
         [task.person]\nhandler = \"person\"\non = \"a\"\nargs.case = \"{case}\"\n\
         [task.sum]\nhandler = \"sum\"\non = \"a\"\n\
         [task.other]\nhandler = \"sum\"\non = \"b\"\n\
         [task.detector]\nhandler = \"ctos.program\"\non = \"a\"\n\
         [task.detector.args]\n{command}\ndeclares = \"detector.toml\"\ngrace_s = 0.3\nenvironment.PYTHONPATH = {client:?}\n"
    );
    for (name, text) in [
        ("app.toml", &*text),
        ("detector.toml", TOML),
        ("detector.py", DETECTOR),
    ] {
        fs::write(folder.path().join(name), text)?;
    }
    let launcher = Launcher {
        program: std::env::current_exe()?,
        arguments: vec![OsString::from(CHASSIS), folder.path().into()],
    };
    let observer = Arc::new(|_: &BootEvent| ());
    let outcome = boot(app(folder.path()), registry(), &launcher, &(observer as _))?;
    match outcome.end {
        End::Finished(AppResult { ok: true, text, .. }) => Ok(text),
        End::Finished(result) => Err(result.text.into()),
        end => Err(format!("{end:?}").into()),
    }
}

fn in_python(case: &str) -> Result<String, Failed> {
    run(
        case,
        &format!("command = [{:?}, \"detector.py\"]", python()),
    )
}

/// Says hello, and then does what is given.
fn script(after: &str) -> String {
    format!(
        "command = [\"sh\", \"-c\", '''read l; echo '{{\"hello\":{{\"protocol\":1}}}}'; {after}''']"
    )
}

fn costs_no_more_than_some_bare_pipes() -> Result<(), Failed> {
    let text = in_python("ratio")?;
    let _ = writeln!(std::io::stderr(), "{text}");
    let ratio = text
        .rsplit_once(' ')
        .and_then(|(_, ratio)| ratio.parse::<f64>().ok());
    match ratio {
        // Measured: docs/benchmarks.md. A host that does other things gives other numbers.
        Some(ratio) if ratio < 6.0 => Ok(()),
        _ => Err(text.into()),
    }
}

fn moves_to_another_process() -> Result<(), Failed> {
    let text = in_python("moved")?;
    match &*text {
        "8 b:main 2" => Ok(()),
        _ => Err(text.into()),
    }
}

fn others_answer_beside(program: &str) -> Result<(), Failed> {
    let text = run("beside", &script(program))?;
    let micros = text.trim_end_matches(" us").parse::<f64>();
    match micros {
        Ok(micros) if micros < 50_000.0 => Ok(()),
        _ => Err(text.into()),
    }
}

fn one_that_ignores_stop_is_killed() -> Result<(), Failed> {
    let folder = tempfile::tempdir()?;
    let pid = folder.path().join("pid");
    let text = run(
        "find",
        &script(&format!(
            "echo $$ > {}; trap '''' TERM INT; read l; read l; echo '{{\"reply\":{{\"id\":1,\"data\":5}}}}'; while :; do sleep 1; done",
            pid.display()
        ).replace("''''", "\"\"")),
    )?;
    assert_eq!(text, "5");
    let stat = fs::read_to_string(format!("/proc/{}/stat", fs::read_to_string(pid)?.trim()));
    match stat {
        Ok(stat) if !stat.contains(") Z ") => Err(stat.into()),
        _ => Ok(()),
    }
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if arguments.first().is_some_and(|first| first == CHASSIS) {
        return chassis(&arguments);
    }
    let has_python = Command::new(python()).arg("--version").output().is_ok();
    let mut trials = vec![
        Trial::test(
            "one_that_ignores_stop_is_killed",
            one_that_ignores_stop_is_killed,
        ),
        Trial::test("others_answer_beside_one_that_does_not_read", || {
            others_answer_beside("exec sleep 1000")
        }),
        Trial::test("others_answer_beside_one_that_writes_without_end", || {
            others_answer_beside("exec yes '{\"log\":{\"level\":\"debug\",\"text\":\"more\"}}'")
        }),
    ];
    if has_python {
        trials.push(Trial::test(
            "a_program_moves_to_another_process",
            moves_to_another_process,
        ));
        trials.push(Trial::test(
            "a_call_costs_no_more_than_some_bare_pipes",
            costs_no_more_than_some_bare_pipes,
        ));
    }
    libtest_mimic::run(&Arguments::from_args(), trials).exit_code()
}

/// The process of one chassis: `program-chassis FOLDER --chassis NAME --boot ADDRESS --origin NS`.
fn chassis(arguments: &[String]) -> ExitCode {
    let [_, folder, _, name, _, address, _, origin] = arguments else {
        return ExitCode::from(2);
    };
    let (Ok(address), Ok(origin)) = (address.parse(), origin.parse()) else {
        return ExitCode::from(2);
    };
    match run_chassis(app(Path::new(folder)), registry(), name, &address, origin) {
        Ok(code) => ExitCode::from(u8::try_from(code).unwrap_or(255)),
        Err(error) => {
            // The boot shows what a chassis writes there.
            let _ = writeln!(std::io::stderr(), "{error}");
            ExitCode::from(4)
        }
    }
}

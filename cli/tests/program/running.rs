//! Command lines of the documents and the help that need a running app are run against one. Each other line stands
//! in one list, with what runs it or why nothing can.

use std::{
    collections::BTreeSet,
    ffi::OsStr,
    fs,
    io::{BufRead, BufReader, Read},
    path::Path,
    process::{Child, Command, Stdio},
    sync::mpsc::{Receiver, channel},
    thread,
    time::Duration,
};

use rustix::process::{Pid, Signal, kill_process};

use crate::{
    common::{configurations, example, root},
    lines::{Line, is_run, lines},
};

/// No line takes longer, and no app takes longer to come up, on the slowest machine.
const LIMIT: Duration = Duration::from_secs(60);
/// So long a line that goes on may take to fail.
const PATIENCE: Duration = Duration::from_secs(1);
const CTOS: &str = env!("CARGO_BIN_EXE_ctos");

/// What becomes of a line.
enum Then {
    /// It ends with 0.
    Ends,
    /// It goes on: it says something, and then it is interrupted.
    GoesOn,
    /// It boots an app: that comes up, and then it is interrupted.
    ComesUp,
    /// It cannot do what it is asked for as the app stands: its exit code, and a word of what it says.
    Refused(i32, &'static str),
}
use Then::{ComesUp, Ends, GoesOn, Refused};

/// Lines for the calibration, which waits at its first move, in this order.
const CALIBRATION: &[(&str, Then)] = &[
    ("ctos ps", Ends),
    ("ctos ps --json", Ends),
    ("ctos status motion", Ends),
    ("ctos status cage_motion --json", Ends),
    ("ctos logs", Ends),
    ("ctos logs cage_motion -f", GoesOn),
    ("ctos logs motion --level warn --last 20", Ends),
    ("ctos top", GoesOn),
    ("ctos top --sort queue", GoesOn),
    ("ctos top --once", Ends),
    ("ctos top --json", GoesOn),
    ("ctos display", Ends),
    ("ctos display --app calibrate --once", Ends),
    ("ctos display --json --net dispatcher", Ends),
    ("ctos net marking dispatcher", Ends),
    ("ctos net tape dispatcher", Ends),
    ("ctos net break dispatcher loop_again", Ends),
    ("ctos net break dispatcher move_robot", Ends),
    ("ctos net break dispatcher spot_done>=1", Ends),
    ("ctos net break dispatcher --clear", Ends),
    ("ctos net pause dispatcher", Ends),
    ("ctos net put dispatcher loop_ready", Ends),
    ("ctos net take dispatcher loop_ready", Ends),
    ("ctos net fire dispatcher fork", Refused(1, "fork")),
    (
        "ctos net cancel dispatcher compute_calib",
        Refused(1, "compute_calib"),
    ),
    (
        "ctos net complete dispatcher compute_calib",
        Refused(1, "compute_calib"),
    ),
    ("ctos net step dispatcher 2", Ends),
    ("ctos net resume dispatcher", Ends),
    ("ctos record", GoesOn),
    ("ctos record calibrate --to records --for 10s", GoesOn),
    (
        "ctos record --channels /message/* --channels /firing/*",
        GoesOn,
    ),
    ("scott calibrate", Ends),
    (
        "scott calibrate -c watch mvpos.* --kind EXEC --slower 50ms",
        GoesOn,
    ),
    ("ctos restart motion", Ends),
    ("ctos restart cage_motion", Ends),
    ("ctos stop calibrate --now", Ends),
];

/// Lines for the app of service objects, in this order.
const OBJECTS: &[(&str, Then)] = &[
    ("scott objects", Ends),
    (
        "scott objects -c foo.a EXEC -c QUEUE.jobs EXEC put hello -c queue.jobs@d2 EXEC take",
        Ends,
    ),
    (
        "scott objects -c queue.jobs@d2 EXEC put 'pick up' FMSG 2 0.5 0.1",
        Ends,
    ),
    ("scott objects -c queue.jobs@d2 EXEC take", Ends),
    ("scott --local", Ends),
    ("ctos stop", Ends),
];

/// Lines that boot the calibration, or run it in virtual time, in this order.
const BOOTS: &[(&str, Then)] = &[
    ("ctos boot configs/calibrate.toml", ComesUp),
    ("ctos boot configs/calibrate.toml -v", ComesUp),
    ("ctos boot configs/calibrate.toml --display", ComesUp),
    (
        "ctos boot configs/calibrate.toml --record run.mcap",
        ComesUp,
    ),
    (
        "ctos boot configs/calibrate.toml --break dispatcher.move_robot",
        ComesUp,
    ),
    ("ctos boot configs/calibrate.toml --profile panel", ComesUp),
    ("ctos boot configs/remote.toml --profile inside", ComesUp),
    (
        "ctos boot configs/calibrate.toml --detach --log-file calibrate.log",
        Ends,
    ),
    ("ctos stop", Ends),
    (
        "ctos boot configs/calibrate.toml --set time.mode=virtual --set seed=7 --json",
        Ends,
    ),
    ("ctos boot --detach configs/objects.toml", Ends),
    ("ctos stop", Ends),
    ("ctos boot --detach configs/testbed-2x9.toml", Ends),
    (
        "scott testbed -c mvpos.left EXEC by FMSG 9 0.3 0 0 0.5 0 0 0 0 0",
        Ends,
    ),
    (
        "scott testbed -c mvpos.right EXEC by FMSG 9 0 0.4 0 0 0 0 0 0.3 0",
        Ends,
    ),
    ("ctos stop", Ends),
];

/// Lines for an app of the reader's with the nets of the calibration, in this order.
const OWN: &[(&str, Then)] = &[
    ("ctos boot app.toml", ComesUp),
    ("ctos boot app.toml --break dispatcher.loop_again", ComesUp),
    ("ctos boot app.toml --break dispatcher.move_robot", ComesUp),
    (
        "ctos sim app.toml --seed 7 --break dispatcher.spot_done>=1",
        Refused(7, "spot_done"),
    ),
    ("ctos boot app.toml --detach", Ends),
    ("ctos stop", Ends),
];

/// Lines for an app of the reader's with two chassis.
const LINKS: &[(&str, Then)] = &[(
    "ctos boot app.toml --drop 0.01 --delay 5ms..20ms --cut motion:vision@2s+0.5s",
    ComesUp,
)];

/// Lines for the example `hello`, which need no running app.
const HELLO: &[(&str, Then)] = &[
    ("ctos boot configs/hello.toml -v", Ends),
    ("ctos sim configs/hello.toml --seed 7", Ends),
    (
        "ctos sim configs/hello.toml --seeds 0..50 --faults rough",
        Ends,
    ),
    (
        "ctos sim configs/hello.toml --seeds 0..100 --faults rough",
        Ends,
    ),
    (
        "ctos sim configs/hello.toml --seed 7 --record records",
        Ends,
    ),
    (
        "ctos sim configs/hello.toml --break hello.count",
        Refused(7, "count"),
    ),
];

/// Lines for files of the reader's: nets, apps, scripts of requests, spots that were seen.
const FILES: &[(&str, Then)] = &[
    ("ctos net check cell.pnml --json", Ends),
    ("ctos net check cell.pnml --seconds 30 --deadlocks 10", Ends),
    ("ctos net convert model.pnml - --to tina", Ends),
    ("ctos net convert model.pnml model.net", Ends),
    ("ctos net draw model.pnml --to dot", Ends),
    ("ctos net draw model.pnml --to mermaid", Ends),
    ("ctos net fmt -", Ends),
    ("ctos net check grab.net --json", Refused(1, "grab.a")),
    ("ctos net play grab.net --sequence steps.txt --json", Ends),
    ("ctos check app.toml", Ends),
    ("ctos check apps/*.toml", Ends),
    ("ctos net perf queue.net", Ends),
    ("ctos new my-app", Ends),
    (
        "scott --local -c resect CTRL -size 640 480 -model k1k2 -c resect EXEC lights.csv",
        Ends,
    ),
    ("scott --local -f check.sor", Ends),
    ("scott --local -f checks.sor --json", Ends),
    ("scott --local --panel configs/panels/puma560.toml", GoesOn),
];

/// Lines for the record of a calibration.
const RECORD: &[(&str, Then)] = &[
    ("ctos log info run.*.mcap", Ends),
    (
        "ctos log cat run.mcap --topic /message/* --from 1.5 --to 2",
        Ends,
    ),
    (
        "ctos log cat run.mcap --topic /message/* --from 1.5 --to 2 --json",
        Ends,
    ),
    ("ctos log filter run.mcap arm.mcap --topic */arm", Ends),
    ("ctos log merge run.*.mcap all.mcap", Ends),
    ("ctos log recover torn.mcap whole.mcap", Ends),
    ("ctos display run.*.mcap", GoesOn),
    ("ctos display run.ws1.mcap --export run.html", Ends),
    ("ctos display run.ws1.mcap --once --moment 12.5", Ends),
    (
        "ctos net draw run.ws1.mcap --net dispatcher --at 12.5",
        Ends,
    ),
    ("ctos replay configs/calibrate.toml run.mcap", Ends),
    (
        "ctos replay configs/calibrate.toml run.mcap --task dispatcher",
        Ends,
    ),
    (
        "ctos replay configs/calibrate.toml run.*.mcap --task dispatcher --json",
        Ends,
    ),
];

/// Pages whose lines are run by a test of the page, in its order and with its files.
const PAGES: [(&str, &str); 4] = [
    ("docs/authoring-nets.md", "cli/tests/program/authoring.rs"),
    ("docs/proving.md", "cli/tests/program/proving.rs"),
    ("docs/tutorial.md", "tests/system/documents.rs"),
    ("docs/security.md", "tests/system/keys.rs"),
];

/// Beginnings of lines that cannot be run here, and why; what does the same elsewhere.
const ELSEWHERE: &[(&str, &str)] = &[
    (
        "ctos boot configs/calibrate.toml --set time.mode=virtual --record run.mcap",
        "makes the record for the lines about records: cli/tests/program/running.rs",
    ),
    (
        "ctos boot configs/hello.toml --set same_host=zenoh",
        "needs a program with zenoh, which tests of the whole are built without: ctos/tests/conformance/main.rs",
    ),
    (
        "ctos boot --detach configs/grasp.toml",
        "moves an arm for half a minute: tests/system/grasp.rs",
    ),
    (
        "scott grasp",
        "moves an arm for half a minute: tests/system/grasp.rs",
    ),
    (
        "ctos boot configs/remote.toml",
        "needs an arm in another process: tests/system/remote.rs",
    ),
    (
        "scott remote",
        "needs an arm in another process: tests/system/remote.rs",
    ),
    (
        "ctos sim app.toml --seed 7",
        "in the tutorial the app with the kettle: tests/system/documents.rs",
    ),
    (
        "ctos sim configs/hello.toml --seed 3 --faults faults.toml",
        "a file of the page: cli/tests/program/sim.rs",
    ),
    (
        "ctos sim configs/hello.toml --seed 7 --faults hostile --shrink",
        "shrinks a run that fails, and this one does well: cli/tests/program/sim.rs",
    ),
    (
        "ctos agent",
        "serves one port that is the same for all tests: tests/system/hosts.rs",
    ),
    (
        "ctos record --at",
        "needs a second machine: tests/system/keys.rs",
    ),
    ("scott --at", "needs a second machine: tests/system/keys.rs"),
    (
        "ctos net replace",
        "needs an app that comes to rest: tests/system/nets.rs",
    ),
    (
        "ctos net play grab.net --sequence -",
        "reads what another command has written: cli/tests/program/proving.rs",
    ),
    (
        "ctos net lsp",
        "speaks to an editor: cli/tests/program/lsp.rs",
    ),
    (
        "ctos move sink",
        "needs a handler that hands its state over, and no shipped app has one: tests/system/moving.rs",
    ),
];

/// Whether a line only names a command, or stands for many.
fn is_form(line: &Line) -> bool {
    let names = |word: &String| word.contains(char::is_uppercase);
    let file = |word: &String| word.contains(['.', '/']);
    let words = || line.words.iter();
    line.in_text && (words().any(names) || !words().any(file))
}

/// A line as the lists have it.
fn listed(words: &[String]) -> String {
    let quoted = words
        .iter()
        .map(|word| match word.split_once(" put pick up ") {
            Some((start, end)) => format!("{start} put 'pick up' {end}"),
            None => word.clone(),
        });
    quoted.collect::<Vec<String>>().join(" ")
}

#[test]
fn every_command_line_is_run_by_a_test_or_stands_in_a_list_with_the_reason() {
    let all = [
        CALIBRATION,
        OBJECTS,
        BOOTS,
        OWN,
        LINKS,
        HELLO,
        FILES,
        RECORD,
    ];
    let running = || all.into_iter().flatten().map(|(line, _)| *line);
    let mut seen = BTreeSet::new();
    let mut unknown = Vec::new();
    for line in lines() {
        let text = listed(&line.words);
        seen.insert(text.clone());
        let page = line.place.split(':').next().unwrap_or_default();
        let known = is_form(&line)
            || is_run(&line.words)
            || PAGES.iter().any(|(known, _)| *known == page)
            || running().any(|known| known == text)
            || ELSEWHERE.iter().any(|(start, _)| text.starts_with(start));
        if !known {
            unknown.push(line.text());
        }
    }
    assert!(unknown.is_empty(), "nothing runs\n{}", unknown.join("\n"));
    let stale: Vec<&str> = running().filter(|line| !seen.contains(*line)).collect();
    assert!(stale.is_empty(), "no page has\n{}", stale.join("\n"));
    for (start, _) in ELSEWHERE {
        let of_it = seen.iter().any(|line| line.starts_with(start));
        assert!(of_it, "no page has {start}");
    }
    let files = PAGES.iter().chain(ELSEWHERE).map(|(_, why)| why);
    for file in files.flat_map(|why| why.split([' ', ':', ','])) {
        assert!(
            !file.ends_with(".rs") || root().join(file).exists(),
            "{file}"
        );
    }
}

/// A command that knows no app but those of its folder.
fn command(program: impl AsRef<OsStr>, folder: &Path) -> Command {
    let mut command = Command::new(program);
    command
        .current_dir(folder)
        .env("XDG_RUNTIME_DIR", folder)
        .env("NO_COLOR", "1")
        .stdin(Stdio::null());
    command
}

/// A running app, in a folder of its own.
struct App {
    folder: tempfile::TempDir,
    child: Child,
}

impl App {
    fn boot(file: &str, sets: &[&str]) -> Self {
        let folder = configurations();
        let mut child = command(CTOS, folder.path())
            .args(["boot", file])
            .args(sets)
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let said = told(child.stderr.take().unwrap());
        let app = Self { folder, child };
        let mut all = String::new();
        while !all.contains("phase 3") {
            match said.recv_timeout(LIMIT) {
                Ok(line) => all.push_str(&line),
                Err(_) => panic!("{file} does not come up:\n{all}"),
            }
        }
        // What else it says is read, so that it never waits for that.
        thread::spawn(move || said.iter().for_each(drop));
        app
    }
}

/// The arguments of a line, its patterns replaced by the files that they stand for, as a shell does.
fn arguments(words: &[String], folder: &Path) -> Vec<String> {
    let mut arguments = Vec::new();
    for word in &words[1..] {
        match word.split_once('*') {
            Some((start, ending @ (".mcap" | ".toml"))) => {
                let within = start.rsplit_once('/').map_or("", |(within, _)| within);
                let entries = fs::read_dir(folder.join(within)).unwrap();
                let names = entries.map(|entry| entry.unwrap().file_name());
                let names = names.map(|name| Path::new(within).join(name));
                let names = names.map(|name| name.into_os_string().into_string().unwrap());
                let fits = |name: &String| {
                    let rest = name.strip_prefix(start);
                    rest.is_some_and(|rest| rest.ends_with(ending))
                };
                let mut names: Vec<String> = names.filter(fits).collect();
                names.sort();
                arguments.append(&mut names);
            }
            _ => arguments.push(word.clone()),
        }
    }
    arguments
}

/// Runs a line; why it did not go as it must.
fn run(mut command: Command, then: &Then) -> Option<String> {
    let mut child = command
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let out = told(child.stdout.take().unwrap());
    let err = told(child.stderr.take().unwrap());
    let rest = |said: &Receiver<String>| {
        let mut all = String::new();
        while let Ok(line) = said.recv_timeout(LIMIT) {
            all.push_str(&line);
        }
        all
    };
    if matches!(then, GoesOn) {
        // Some say nothing while nothing happens.
        let first = err.recv_timeout(PATIENCE);
        let ended = child.try_wait().unwrap();
        interrupt(&child);
        child.wait().unwrap();
        let wrong = ended.filter(|status| !status.success());
        return wrong.map(|status| format!("{status}: {first:?} {}{}", rest(&out), rest(&err)));
    }
    let mut begun = String::new();
    if matches!(then, ComesUp) {
        while let Ok(line) = err.recv_timeout(LIMIT) {
            begun.push_str(&line);
            if line.contains("phase 3") {
                interrupt(&child);
                break;
            }
        }
    }
    let (out, err) = (rest(&out), begun + &rest(&err));
    let status = child.wait().unwrap();
    let well = match then {
        // As Ctrl-C ends it.
        ComesUp => status.code() == Some(130),
        Refused(code, what) => {
            status.code() == Some(*code) && (out.contains(what) || err.contains(what))
        }
        _ => status.success(),
    };
    (!well).then(|| format!("{status}: {out}{err}"))
}

/// Runs lines in their order, those of `ctos` by this program.
fn run_all(all: &[(&str, Then)], ctos: &OsStr, folder: &Path) {
    let known = lines();
    for (text, then) in all {
        let line = known.iter().find(|line| listed(&line.words) == *text);
        let words = &line.unwrap_or_else(|| panic!("no page has {text}")).words;
        let program = match words[0].as_str() {
            "scott" => OsStr::new(env!("CARGO_BIN_EXE_scott")),
            _ => ctos,
        };
        let mut command = command(program, folder);
        command.args(arguments(words, folder));
        if words.starts_with(&["ctos", "net", "fmt", "-"].map(str::to_owned)) {
            command.stdin(fs::File::open(folder.join("draft.net")).unwrap());
        }
        if let Some(why) = run(command, then) {
            panic!("{text}\n{why}");
        }
    }
}

impl Drop for App {
    fn drop(&mut self) {
        interrupt(&self.child);
        let _ = self.child.wait();
    }
}

fn interrupt(child: &Child) {
    let pid = i32::try_from(child.id()).ok().and_then(Pid::from_raw);
    // It may have ended by itself.
    let _ = kill_process(pid.unwrap(), Signal::INT);
}

/// What is written into a pipe, line by line.
fn told(pipe: impl Read + Send + 'static) -> Receiver<String> {
    let (sender, receiver) = channel();
    thread::spawn(move || {
        let mut reader = BufReader::new(pipe);
        let mut line = Vec::new();
        while reader
            .read_until(b'\n', &mut line)
            .is_ok_and(|read| read > 0)
        {
            let text = String::from_utf8_lossy(&line).into_owned();
            if sender.send(text).is_err() {
                break;
            }
            line.clear();
        }
    });
    receiver
}

#[test]
fn the_lines_about_a_running_calibration_are_run_and_go_well() {
    let app = App::boot(
        "configs/calibrate.toml",
        &[
            "--profile",
            "objects",
            "--set",
            "task.dispatcher.args.allow_control=true",
            "--break",
            "dispatcher.move_robot",
        ],
    );
    run_all(CALIBRATION, CTOS.as_ref(), app.folder.path());
}

#[test]
fn the_lines_about_service_objects_are_run_against_their_app_and_go_well() {
    let app = App::boot("configs/objects.toml", &[]);
    run_all(OBJECTS, CTOS.as_ref(), app.folder.path());
    // Nobody is left after the last line.
    let sockets = fs::read_dir(app.folder.path().join("ctos"));
    assert!(sockets.is_err() || sockets.unwrap().count() == 0);
}

#[test]
fn the_lines_that_boot_an_app_are_run_and_go_well() {
    let folder = configurations();
    few_positions(folder.path());
    run_all(BOOTS, CTOS.as_ref(), folder.path());
}

#[test]
fn the_lines_that_boot_an_app_of_the_reader_are_run_and_go_well() {
    let folder = configurations();
    few_positions(folder.path());
    let configs = folder.path().join("configs");
    fs::copy(configs.join("calibrate.toml"), configs.join("app.toml")).unwrap();
    run_all(OWN, CTOS.as_ref(), &configs);
    let task = |name: &str, on: &str| {
        format!("[chassis.{on}]\n[task.{name}]\nhandler = \"sorma.daemon\"\non = \"{on}\"\n")
    };
    let app = task("d1", "motion") + &task("d2", "vision");
    fs::write(folder.path().join("app.toml"), app).unwrap();
    run_all(LINKS, CTOS.as_ref(), folder.path());
}

/// Leaves the calibration some positions, so that it ends soon.
fn few_positions(folder: &Path) {
    let file = folder.join("configs/positions.csv");
    let positions = fs::read_to_string(&file).unwrap();
    let few: Vec<&str> = positions.lines().take(14).collect();
    fs::write(file, few.join("\n")).unwrap();
}

#[test]
fn the_lines_about_the_example_are_run_and_go_well() {
    let folder = configurations();
    let hello = example("hello");
    run_all(HELLO, hello.get_program(), folder.path());
}

#[test]
fn the_lines_about_a_record_are_run_and_go_well() {
    let folder = configurations();
    few_positions(folder.path());
    let mut boot = command(CTOS, folder.path());
    let recorded = ["--set", "time.mode=virtual", "--record", "run.mcap"];
    boot.args(["boot", "configs/calibrate.toml"]).args(recorded);
    let output = boot.output().unwrap();
    let record = fs::read(folder.path().join("run.mcap")).unwrap();
    assert!(record.len() > 1000, "{output:?}");
    fs::write(folder.path().join("run.ws1.mcap"), &record).unwrap();
    let torn = &record[..record.len() / 2];
    fs::write(folder.path().join("torn.mcap"), torn).unwrap();
    run_all(RECORD, CTOS.as_ref(), folder.path());
}

#[test]
fn the_lines_about_files_of_the_reader_are_run_and_go_well() {
    let folder = configurations();
    let net =
        "net ring\nplace a = 1, b\ntransition t\n  in a\n  out b\ntransition u\n  in b\n  out a\n";
    fs::write(folder.path().join("ring.net"), net).unwrap();
    for file in ["cell.pnml", "model.pnml"] {
        let mut convert = command(CTOS, folder.path());
        convert.args(["net", "convert", "ring.net", file]);
        assert!(convert.output().unwrap().status.success());
    }
    // The text of a block of a page.
    let block = |page: &str, opens: &str| {
        let page = fs::read_to_string(root().join(page)).unwrap();
        let block = page.split(&format!("```{opens}\n")).nth(1).unwrap();
        block.split("```").next().unwrap().to_owned()
    };
    let write = |file: &str, text: &str| fs::write(folder.path().join(file), text).unwrap();
    write("queue.net", &block("docs/net-performance.md", "net"));
    write("grab.net", &block("docs/proving.md", "net grab.net"));
    write("steps.txt", "grab.first_left\ngrab.first_right\n");
    write("draft.net", net);
    let app = "[chassis.w]\n[task.d]\nhandler = \"sorma.daemon\"\non = \"w\"\n";
    write("app.toml", app);
    fs::create_dir(folder.path().join("apps")).unwrap();
    write("apps/one.toml", app);
    write("apps/other.toml", app);
    let page = fs::read_to_string(root().join("docs/service-objects.md")).unwrap();
    let script = page.split("$ cat check.sor\n").nth(1).unwrap();
    let script = script.split("$ ").next().unwrap();
    write("check.sor", script);
    write("checks.sor", script);
    // What a camera without distortion sees of lights before it.
    let lights = (0..40).map(|at| {
        let at = f64::from(at);
        let (x, y) = ((at * 1.3).sin(), 0.7 * (at * 2.1).cos());
        let z = 3.0 + (at * 0.9).sin();
        let (u, v) = (500.0 * x / z + 320.0, 510.0 * y / z + 240.0);
        format!("{x:?},{y:?},{z:?},{u:?},{v:?}\n")
    });
    write(
        "lights.csv",
        &format!("X,Y,Z,u,v\n{}", lights.collect::<String>()),
    );
    run_all(FILES, CTOS.as_ref(), folder.path());
}

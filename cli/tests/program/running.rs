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
    /// It cannot do what it is asked for as the app stands: its exit code, and a word of what it says.
    Refused(i32, &'static str),
}
use Then::{Ends, GoesOn, Refused};

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

/// Lines for the example `hello`, which need no running app.
const HELLO: &[(&str, Then)] = &[
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

/// Lines for files of the reader's: a net as PNML, and an app.
const FILES: &[(&str, Then)] = &[
    ("ctos net check cell.pnml --json", Ends),
    ("ctos net check cell.pnml --seconds 30 --deadlocks 10", Ends),
    ("ctos net convert model.pnml - --to tina", Ends),
    ("ctos net convert model.pnml model.net", Ends),
    ("ctos net draw model.pnml --to dot", Ends),
    ("ctos net draw model.pnml --to mermaid", Ends),
    ("ctos check app.toml", Ends),
    ("ctos net perf queue.net", Ends),
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
];

/// Pages whose lines are run by a test of the page, in its order and with its files.
const PAGES: [(&str, &str); 4] = [
    ("docs/authoring-nets.md", "cli/tests/program/authoring.rs"),
    ("docs/proving.md", "cli/tests/program/proving.rs"),
    ("docs/tutorial.md", "tests/system/documents.rs"),
    ("docs/security.md", "tests/system/keys.rs"),
];

/// Beginnings of lines that are run elsewhere, or by nothing, and why.
const ELSEWHERE: &[(&str, &str)] = &[
    (
        "ctos boot",
        "boots: every test of tests/system does so, with these options",
    ),
    (
        "ctos sim app.toml",
        "the app of docs/tutorial.md: tests/system/documents.rs",
    ),
    (
        "ctos sim configs/hello.toml --seed 3 --faults faults.toml",
        "a file of the page: cli/tests/program/sim.rs",
    ),
    (
        "ctos sim configs/hello.toml --seed 7 --faults hostile --shrink",
        "needs a run that fails: cli/tests/program/sim.rs",
    ),
    ("ctos agent", "waits for other hosts: tests/system/hosts.rs"),
    (
        "ctos replay configs/calibrate.toml run.*.mcap",
        "needs the records of several processes: tests/system/recording.rs",
    ),
    (
        "ctos display run.desk.mcap",
        "the record of docs/tutorial.md: tests/system/displays.rs",
    ),
    (
        "ctos record calibrate --to records --for 10s",
        "takes ten seconds: tests/system/keys.rs",
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
        "ctos net check grab.net",
        "a file of docs/proving.md: cli/tests/program/proving.rs",
    ),
    (
        "ctos net play",
        "a file of docs/proving.md: cli/tests/program/proving.rs",
    ),
    (
        "ctos net fmt -",
        "reads a net on standard input: cli/tests/program/nets.rs",
    ),
    (
        "ctos net lsp",
        "speaks to an editor: cli/tests/program/lsp.rs",
    ),
    ("ctos new", "cli/tests/program/offline.rs"),
    (
        "scott testbed",
        "two manipulators that move: tests/system/testbed.rs",
    ),
    (
        "ctos check apps/*.toml",
        "files of the reader's: cli/tests/program/offline.rs",
    ),
    (
        "ctos move sink",
        "the app of docs/names.md: tests/system/moving.rs",
    ),
    (
        "scott --local --panel",
        "serves a page until Ctrl-C: cli/tests/program/panel.rs",
    ),
    (
        "scott --local -f",
        "files of the reader's: cli/tests/program/scott.rs",
    ),
    (
        "scott --local -c resect",
        "a file of the reader's: cli/tests/program/scott.rs",
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
    let all = [CALIBRATION, OBJECTS, HELLO, FILES, RECORD];
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
            Some((start, ".mcap")) => {
                let entries = fs::read_dir(folder).unwrap();
                let names = entries.map(|entry| entry.unwrap().file_name());
                let names = names.map(|name| name.into_string().unwrap());
                let mut names: Vec<String> = names
                    .filter(|name| name.starts_with(start) && name.ends_with(".mcap"))
                    .collect();
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
    let (out, err) = (rest(&out), rest(&err));
    let status = child.wait().unwrap();
    let well = match then {
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
fn the_lines_about_the_example_are_run_and_go_well() {
    let folder = configurations();
    let hello = example("hello");
    run_all(HELLO, hello.get_program(), folder.path());
}

#[test]
fn the_lines_about_a_record_are_run_and_go_well() {
    let folder = configurations();
    let file = folder.path().join("configs/positions.csv");
    let positions = fs::read_to_string(&file).unwrap();
    let few: Vec<&str> = positions.lines().take(14).collect();
    fs::write(file, few.join("\n")).unwrap();
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
    let page = fs::read_to_string(root().join("docs/net-performance.md")).unwrap();
    let queue = page.split("```net\n").nth(1).unwrap();
    let queue = queue.split("```").next().unwrap();
    fs::write(folder.path().join("queue.net"), queue).unwrap();
    let app = "[chassis.w]\n[task.d]\nhandler = \"sorma.daemon\"\non = \"w\"\n";
    fs::write(folder.path().join("app.toml"), app).unwrap();
    run_all(FILES, CTOS.as_ref(), folder.path());
}

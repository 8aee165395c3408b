//! Command lines of the documents and the help that need a running app are run against one. Another host is this one,
//! and files are those that the pages describe. No line is left that nothing runs.

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
    /// It boots an app: that comes up, and then it is interrupted, unless it has come to its breakpoint before.
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
    ("ctos motion", GoesOn),
    ("ctos motion mcs", GoesOn),
    ("ctos motion --once", Ends),
    ("ctos motion --json", GoesOn),
    ("ctos ways", Ends),
    ("ctos ways --json", Ends),
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
    ("scott calibrate -c slots EXEC", Ends),
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
    ("ctos boot configs/calibrate.toml --foxglove", ComesUp),
    (
        "ctos boot configs/calibrate.toml --record run.mcap",
        ComesUp,
    ),
    (
        "ctos boot configs/calibrate.toml --break dispatcher.move_robot",
        ComesUp,
    ),
    (
        "ctos boot configs/calibrate.toml --profile objects --record run.mcap",
        ComesUp,
    ),
    ("ctos boot configs/calibrate.toml --profile panel", ComesUp),
    ("ctos boot configs/testbed.toml --profile panel", ComesUp),
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

/// Lines for the arm with a gripper, in this order.
const GRASP: &[(&str, Then)] = &[
    ("ctos boot --detach configs/grasp.toml", Ends),
    ("scott grasp -f configs/pick_and_place.sor", Ends),
    // The box has been placed by then, and nothing is between the jaws.
    (
        "scott grasp -c gripper EXEC grasp FMSG 1 20",
        Refused(1, "the jaws stand 0.0 mm apart"),
    ),
    ("ctos stop", Ends),
];

/// Lines about the task `carry`, in this order.
const CARRY: &[(&str, Then)] = &[
    ("ctos boot configs/carry.toml", ComesUp),
    (
        "ctos boot configs/carry.toml --set task.operator.args.list=\"carry/short_tour.txt\"",
        ComesUp,
    ),
    ("ctos boot configs/carry.toml --profile durable", ComesUp),
    ("ctos boot configs/carry.toml --profile planned", ComesUp),
    ("ctos boot configs/carry-hand.toml", ComesUp),
    (
        "ctos boot --detach --profile waiting configs/carry.toml",
        Ends,
    ),
    ("scott carry -c carry EXEC FMSG 6 3 4 0 4 5 0", Ends),
    ("scott carry -c pointer@laser EXEC FMSG 3 4 5 0", Ends),
    ("scott carry -c sound@speaker EXEC disc lost at D 4", Ends),
    (
        "scott carry -c pino@robot DBX -version -c gripper@hand DBX -version -c getDisk@vision DBX -version -c psom@transform DBX -version -c pointer@laser DBX -version",
        Ends,
    ),
    (
        "scott carry -c carry.answer EXEC fetch",
        Refused(1, "nobody asks whether a thing is fetched"),
    ),
    (
        "scott carry -c dict CTRL -add carry.slow '-SUBST carry -transferSpeed 0.2' -c carry.slow EXEC FMSG 6 4 5 0 3 4 0",
        Ends,
    ),
    (
        "ctos net ask dispatcher --success carried carry 3,4,0 4,5,0",
        Ends,
    ),
    // It is there no more.
    (
        "ctos net ask dispatcher --success carried carry 3,4 4,5",
        Refused(1, "nothing_at_from"),
    ),
    ("ctos stop", Ends),
];

/// Lines about the task `push`, and about ways around obstacles.
const WAYS: &[(&str, Then)] = &[
    ("ctos boot configs/around.toml", ComesUp),
    ("ctos boot configs/push.toml", ComesUp),
    ("ctos boot configs/push-finger.toml", ComesUp),
    ("ctos boot configs/tracker.toml", ComesUp),
    ("ctos boot --detach configs/tracker.toml", Ends),
    ("ctos net ask tracking hand_over", Ends),
    ("ctos net ask tracking resume", Ends),
    ("ctos net marking tracking", Ends),
    ("ctos net ask tracking learn", Ends),
    ("ctos net ask tracking stop", Ends),
    ("ctos net ask tracking track", Ends),
    ("ctos stop", Ends),
    ("ctos boot --detach configs/tracker-grasp.toml", Ends),
    ("ctos net ask tracking grasp", Ends),
    ("ctos stop", Ends),
    ("ctos boot configs/checkers.toml", ComesUp),
    ("ctos sim configs/checkers.toml --seed 7", Ends),
    (
        "ctos boot configs/checkers.toml --display --allow-control --set task.player.args.opponent=person --set task.player.args.colour=black",
        ComesUp,
    ),
    ("ctos boot configs/checkers-seen.toml", ComesUp),
    ("ctos sim configs/checkers-seen.toml --seed 7", Ends),
    ("ctos boot configs/checkers-hands.toml", ComesUp),
    ("ctos boot configs/checkers-fingers.toml", ComesUp),
    (
        "ctos sim configs/checkers.toml --set task.player.args.opponent=program --seeds 0..3 --json",
        Ends,
    ),
    (
        "ctos sim configs/tracker.toml --set task.tracker.args.seconds=5",
        Ends,
    ),
    ("ctos sim configs/guide.toml", Ends),
    (
        "ctos sim configs/fleet.toml --set fleet.cells=4 --set fleet.sites=2",
        Ends,
    ),
    (
        "ctos sim configs/fleet.toml --seeds 0..5 --faults configs/fleet/rough.toml",
        Ends,
    ),
    (
        "ctos boot configs/fleet.toml --display --allow-control",
        GoesOn,
    ),
];

/// Lines for an arm in another process: one that boots its app, and one for that when it is up.
const REMOTE: [&[(&str, Then)]; 2] = [
    &[("ctos boot configs/remote.toml", ComesUp)],
    &[(
        "scott remote -c mvpos EXEC by FMSG 6 0.3 -0.2 0.2 0.3 -0.2 0.5",
        Ends,
    )],
];

/// Lines for an app with a task that hands its state over, in this order.
const MOVING: &[(&str, Then)] = &[
    ("ctos move sink cage", Ends),
    ("ctos move sink cage:servo --json", Ends),
];

/// Lines for an app whose nets are at rest.
const AT_REST: &[(&str, Then)] = &[
    (
        "ctos net replace dispatcher configs/nets/dispatcher.net --within 30",
        Ends,
    ),
    ("ctos net replace dispatcher new.net --within 30", Ends),
];

/// Lines for an app on another host.
const ELSEWHERE: &[(&str, Then)] = &[
    (
        "scott --at lab7:7411 --key keys/anna -c sorm CTRL -list",
        Ends,
    ),
    (
        "ctos record --at cell.example:7400 --key keys/me --to /var/tmp/records",
        GoesOn,
    ),
];

/// Lines that wait for boots of other hosts.
const AGENTS: &[(&str, Then)] = &[
    ("ctos agent", GoesOn),
    (
        "ctos agent --listen 192.168.1.20:7410 --key keys/cage",
        GoesOn,
    ),
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
    (
        "ctos sim configs/hello.toml --seed 3 --faults faults.toml",
        Refused(1, "fault    kill   shelf at 0.001000 s"),
    ),
    // Nothing fails with this seed, so nothing is left to be found fewer of.
    (
        "ctos sim configs/hello.toml --seed 7 --faults hostile --shrink fewer.toml",
        Ends,
    ),
    // This program is built without: it says what to build.
    (
        "ctos boot configs/hello.toml --set same_host=zenoh --set zenoh.multicast=lo",
        Refused(3, "--features zenoh"),
    ),
    (
        "ctos boot configs/calibrate-ros2.toml",
        Refused(3, "--features ros2"),
    ),
    (
        "ctos boot configs/sites/north.toml",
        Refused(3, "--features zenoh"),
    ),
    (
        "ctos boot configs/sites/south.toml --profile display",
        Refused(3, "--features zenoh"),
    ),
    (
        "ctos boot configs/sites/west.toml",
        Refused(3, "--features zenoh"),
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
    ("ctos net play grab.net --sequence -", Ends),
    ("ctos net lsp", Ends),
    ("ctos net lsp --app configs/calibrate.toml", Ends),
    ("ctos check app.toml", Ends),
    ("ctos check apps/*.toml", Ends),
    ("ctos net perf queue.net", Ends),
    ("ctos new my-app", Ends),
    ("ctos new --task my-task", Ends),
    ("ctos new --python my-script", Ends),
    ("ctos new --net my-net", Ends),
    ("ctos net watch queue.net", GoesOn),
    (
        "ctos net watch queue.net --app app.toml --replace queue",
        GoesOn,
    ),
    (
        "ctos net run configs/nets/greet.net --tape greet world 3 -v",
        Ends,
    ),
    (
        "ctos net run configs/nets/greet.net --tape greet world 3 --stand-in --seed 7",
        Ends,
    ),
    (
        "ctos net run configs/nets/greet.net --tape greet world 3",
        Ends,
    ),
    (
        "ctos net run configs/nets/greet.net --tape greet world 3 --stand-in --fail 0.3 --seed 7 -v",
        Refused(1, "the stand-in fails by chance"),
    ),
    ("ctos net run configs/nets/greet.net --display", ComesUp),
    (
        "scott --local -c resect CTRL -size 640 480 -model k1k2 -c resect EXEC lights.csv",
        Ends,
    ),
    ("scott --local -f check.sor", Ends),
    ("scott --local -f checks.sor --json", Ends),
    ("scott --local --panel configs/panels/puma560.toml", GoesOn),
];

/// Lines about the record of a calibration: first the one that makes it.
const MAKES_RECORD: &[(&str, Then)] = &[(
    "ctos boot configs/calibrate.toml --set time.mode=virtual --record run.mcap",
    Ends,
)];
const RECORD: &[(&str, Then)] = &[
    ("ctos log info run.mcap", Ends),
    (
        "ctos log cat run.mcap --topic /message/* --from 1.5 --to 2",
        Ends,
    ),
    (
        "ctos log cat run.mcap --topic /message/* --from 1.5 --to 2 --json",
        Ends,
    ),
    ("ctos log filter run.mcap arm.mcap --topic */arm", Ends),
    ("ctos log merge run.mcap all.mcap", Ends),
    ("ctos log recover torn.mcap whole.mcap", Ends),
    ("ctos display run.mcap", GoesOn),
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
        "ctos replay configs/calibrate.toml run.mcap --task dispatcher --json",
        Ends,
    ),
];

/// Pages whose lines are run by a test of the page, in its order and with its files.
const PAGES: [(&str, &str); 6] = [
    ("docs/authoring-nets.md", "cli/tests/program/authoring.rs"),
    ("docs/own-task.md", "cli/tests/program/authoring.rs"),
    ("docs/proving.md", "cli/tests/program/proving.rs"),
    ("docs/tutorial.md", "tests/system/documents.rs"),
    ("docs/security.md", "tests/system/keys.rs"),
    ("docs/sites.md", "tests/system/sites.rs"),
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
fn every_command_line_is_run_by_a_test() {
    let all = [
        CALIBRATION,
        OBJECTS,
        BOOTS,
        OWN,
        LINKS,
        HELLO,
        FILES,
        MAKES_RECORD,
        RECORD,
        GRASP,
        CARRY,
        WAYS,
        REMOTE[0],
        REMOTE[1],
        MOVING,
        AT_REST,
        ELSEWHERE,
        AGENTS,
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
            || running().any(|known| known == text);
        if !known {
            unknown.push(line.text());
        }
    }
    assert!(unknown.is_empty(), "nothing runs\n{}", unknown.join("\n"));
    let stale: Vec<&str> = running().filter(|line| !seen.contains(*line)).collect();
    assert!(stale.is_empty(), "no page has\n{}", stale.join("\n"));
    for (_, file) in PAGES {
        assert!(root().join(file).exists(), "{file}");
    }
}

/// A command that knows no app but those of its folder.
pub fn command(program: impl AsRef<OsStr>, folder: &Path) -> Command {
    let mut command = Command::new(program);
    command
        .current_dir(folder)
        .env("XDG_RUNTIME_DIR", folder)
        .env("NO_COLOR", "1")
        .stdin(Stdio::null());
    command
}

/// A running app, in a folder of its own.
pub struct App {
    pub folder: tempfile::TempDir,
    child: Child,
}

impl App {
    pub fn boot(file: &str, sets: &[&str]) -> Self {
        Self::boot_in(configurations(), CTOS, file, sets)
    }

    fn boot_in(
        folder: tempfile::TempDir,
        program: impl AsRef<OsStr>,
        file: &str,
        sets: &[&str],
    ) -> Self {
        let mut child = command(program, folder.path())
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
        // As Ctrl-C ends it, or a breakpoint.
        ComesUp => {
            let said = out.contains("is at breakpoint") || err.contains("is at breakpoint");
            let at_breakpoint = status.code() == Some(7) && said;
            status.code() == Some(130) || at_breakpoint
        }
        Refused(code, what) => {
            status.code() == Some(*code) && (out.contains(what) || err.contains(what))
        }
        _ => status.success(),
    };
    (!well).then(|| format!("{status}: {out}{err}"))
}

/// What a line reads, where the file stands for what is typed or comes from another command.
fn input(words: &[String]) -> Option<&'static str> {
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    match words.as_slice() {
        ["ctos", "net", "fmt", "-"] => Some("draft.net"),
        ["ctos", "net", "play", .., "-"] => Some("found.json"),
        ["ctos", "net", "lsp", ..] => Some("editor"),
        _ => None,
    }
}

/// Runs lines in their order, those of `ctos` by this program.
fn run_all(all: &[(&str, Then)], ctos: &OsStr, folder: &Path) {
    run_here(all, ctos, folder, &[]);
}

/// As [`run_all`]; of each pair the first, as a word, stands for the second, which is here.
fn run_here(all: &[(&str, Then)], ctos: &OsStr, folder: &Path, here: &[(&str, String)]) {
    let known = lines();
    for (text, then) in all {
        let line = known.iter().find(|line| listed(&line.words) == *text);
        let words = &line.unwrap_or_else(|| panic!("no page has {text}")).words;
        let program = match words[0].as_str() {
            "scott" => OsStr::new(env!("CARGO_BIN_EXE_scott")),
            _ => ctos,
        };
        let mut asked = command(program, folder);
        let arguments = arguments(words, folder).into_iter().map(|word| {
            let stands = here.iter().find(|(there, _)| *there == word);
            stands.map_or(word, |(_, here)| here.clone())
        });
        asked.args(arguments);
        if let Some(file) = input(words) {
            asked.stdin(fs::File::open(folder.join(file)).unwrap());
        }
        if let Some(why) = run(asked, then) {
            // An app that a line before left running would take time from other tests.
            let _ = command(ctos, folder).args(["stop", "--now"]).output();
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
    let mut app = App::boot("configs/objects.toml", &[]);
    run_all(OBJECTS, CTOS.as_ref(), app.folder.path());
    // Nobody is left after the last line, by which the app is told to end.
    app.child.wait().unwrap();
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
    let faults = "[[fault]]\nkind = \"kill\"\nchassis = \"shelf\"\nat_s = 0.001\n";
    fs::write(folder.path().join("faults.toml"), faults).unwrap();
    let hello = example("hello");
    run_all(HELLO, hello.get_program(), folder.path());
}

#[test]
fn the_lines_about_a_record_are_run_and_go_well() {
    let folder = configurations();
    few_positions(folder.path());
    run_all(MAKES_RECORD, CTOS.as_ref(), folder.path());
    let record = fs::read(folder.path().join("run.mcap")).unwrap();
    assert!(record.len() > 1000);
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
    let mut check = command(CTOS, folder.path());
    let found = check.args(["net", "check", "grab.net", "--json"]).output();
    write(
        "found.json",
        &String::from_utf8(found.unwrap().stdout).unwrap(),
    );
    write("editor", &editor());
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

/// What an editor says that opens nothing and leaves.
fn editor() -> String {
    let said = [
        r#"{"jsonrpc":"2.0","id":1,"method":"initialize","params":{"capabilities":{}}}"#,
        r#"{"jsonrpc":"2.0","method":"initialized","params":{}}"#,
        r#"{"jsonrpc":"2.0","id":2,"method":"shutdown"}"#,
        r#"{"jsonrpc":"2.0","method":"exit"}"#,
    ];
    let framed = said.map(|text| format!("Content-Length: {}\r\n\r\n{text}", text.len()));
    framed.concat()
}

#[test]
fn the_lines_about_an_arm_with_a_gripper_are_run_and_go_well() {
    let folder = configurations();
    run_all(GRASP, CTOS.as_ref(), folder.path());
}

#[test]
fn the_lines_about_carrying_are_run_and_go_well() {
    let folder = configurations();
    run_all(CARRY, CTOS.as_ref(), folder.path());
}

#[test]
fn the_lines_about_ways_and_pushing_are_run_and_go_well() {
    let folder = configurations();
    run_all(WAYS, CTOS.as_ref(), folder.path());
}

/// Another process of the test, which ends with this.
struct Beside(Child);

impl Drop for Beside {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn the_lines_about_an_arm_in_another_process_are_run_and_go_well() {
    let folder = configurations();
    let file = folder.path().join("configs/remote.toml");
    let text = fs::read_to_string(&file).unwrap();
    // Others may use the port, and a machine under tests is slow.
    let address = "driver_args.address = \"udp:127.0.0.1:4560\"";
    let here = "driver_args.address = \"unix:arm.socket\"\ndriver_args.watchdog_ms = 1000";
    assert!(text.contains(address));
    fs::write(&file, text.replace(address, here)).unwrap();
    let mut peer = example("peer");
    peer.current_dir(folder.path().join("configs"))
        .args(["cell.toml", "unix:arm.socket"]);
    let _peer = Beside(peer.spawn().unwrap());
    run_all(REMOTE[0], CTOS.as_ref(), folder.path());
    let app = App::boot_in(folder, CTOS, "configs/remote.toml", &[]);
    run_all(REMOTE[1], CTOS.as_ref(), app.folder.path());
}

#[test]
fn the_lines_about_a_task_that_moves_are_run_and_go_well() {
    let folder = tempfile::tempdir().unwrap();
    let app = "[chassis.desk]\n[chassis.cage]\nprocessors.main = {}\nprocessors.servo = {}\n\
               [task.sink]\nhandler = \"sink\"\non = \"desk\"\n";
    fs::write(folder.path().join("app.toml"), app).unwrap();
    let program = example("moving").get_program().to_owned();
    let app = App::boot_in(folder, &program, "app.toml", &[]);
    run_all(MOVING, &program, app.folder.path());
}

#[test]
fn the_lines_that_replace_a_net_are_run_and_go_well() {
    let folder = configurations();
    // Without its operator nobody commands anything, so the nets are at rest.
    let file = folder.path().join("configs/calibrate.toml");
    let text = fs::read_to_string(&file).unwrap();
    let (before, after) = text.split_once("[task.operator]").unwrap();
    let (_, after) = after.split_once("[task.referee]").unwrap();
    let text = format!("{before}[task.referee]{after}").replace("until = \"operator\"", "");
    fs::write(&file, text).unwrap();
    let net = folder.path().join("configs/nets/dispatcher.net");
    fs::copy(net, folder.path().join("new.net")).unwrap();
    let control = ["--set", "task.dispatcher.args.allow_control=true"];
    let app = App::boot_in(folder, CTOS, "configs/calibrate.toml", &control);
    run_all(AT_REST, CTOS.as_ref(), app.folder.path());
}

/// A folder with keys that were made as the documents say: names and roles.
fn keys(folder: &Path, wanted: &[(&str, &str)]) {
    for (name, role) in wanted {
        let mut made = command(CTOS, folder);
        made.args(["keys", "new", &format!("keys/{name}"), "--role", role]);
        assert!(made.status().unwrap().success());
    }
}

#[test]
fn the_lines_about_an_app_on_another_host_are_run_and_go_well() {
    let folder = tempfile::tempdir().unwrap();
    let wanted = [("cell", "boot"), ("anna", "call"), ("me", "control")];
    keys(folder.path(), &wanted);
    let free = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = free.local_addr().unwrap().to_string();
    drop(free);
    let app = format!(
        "[security]\nkey = \"keys/cell\"\nauthority = \"keys/ca.pem\"\n[control]\nlisten = \"{address}\"\n\
         [chassis.desk]\n[task.objects]\nhandler = \"sorma.daemon\"\non = \"desk\"\n"
    );
    fs::write(folder.path().join("app.toml"), app).unwrap();
    let app = App::boot_in(folder, CTOS, "app.toml", &[]);
    let folder = app.folder.path();
    let records = folder.join("records").display().to_string();
    let here = [
        ("lab7:7411", address.clone()),
        ("cell.example:7400", address),
        ("/var/tmp/records", records),
    ];
    run_here(ELSEWHERE, CTOS.as_ref(), folder, &here);
}

#[test]
fn the_lines_that_wait_for_boots_of_other_hosts_are_run_and_go_well() {
    let folder = tempfile::tempdir().unwrap();
    keys(folder.path(), &[("cage", "boot")]);
    let here = [("192.168.1.20:7410", "127.0.0.1:0".to_owned())];
    run_here(AGENTS, CTOS.as_ref(), folder.path(), &here);
}

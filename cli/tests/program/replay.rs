//! Every task of every app in `configs/` does the same again, out of a record of any kind of run. Or it is refused at
//! once with the reason.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Path, PathBuf},
    sync::Arc,
    time::Duration,
};

use crate::{common::root, hello_example};
use cli::program;
use ctos::{
    config::{App, Selection},
    record::{Filter, Record, ReplayError, replay, replayable},
    registry::Registry,
    simulation::{self, Faults, Setup},
};

/// Whether there is a Python for the app that needs one.
fn has_python() -> bool {
    let python = std::env::var("CTOS_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let told = std::process::Command::new(python).arg("--version").output();
    told.is_ok_and(|told| told.status.success())
}

fn registry() -> Registry {
    let mut registry = program::registry();
    hello_example::register(&mut registry);
    registry
}

/// The folder of configurations, with as few positions as a calibration takes.
fn configs() -> tempfile::TempDir {
    fn copy(from: &Path, to: &Path) {
        fs::create_dir_all(to).unwrap();
        for entry in fs::read_dir(from).unwrap() {
            let (path, to) = {
                let entry = entry.unwrap();
                (entry.path(), to.join(entry.file_name()))
            };
            match path.is_dir() {
                true => copy(&path, &to),
                false => drop(fs::copy(&path, &to).unwrap()),
            }
        }
    }
    let folder = tempfile::tempdir().unwrap();
    copy(&root().join("configs"), folder.path());
    let positions = fs::read_to_string(folder.path().join("positions.csv")).unwrap();
    let few: Vec<&str> = positions.lines().take(14).collect();
    fs::write(folder.path().join("positions.csv"), few.join("\n")).unwrap();
    // Results belong here, too.
    let file = folder.path().join("calibrate.toml");
    let app = fs::read_to_string(&file).unwrap();
    let results = folder.path().join("results").display().to_string();
    assert!(app.contains("out/calibrate"));
    fs::write(file, app.replace("out/calibrate", &results)).unwrap();
    folder
}

/// The files in a folder of configurations that are apps, cells of robots left out.
fn apps(folder: &Path) -> Vec<PathBuf> {
    let files = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path());
    let is_app = |path: &PathBuf| {
        let is_text = path.extension().is_some_and(|end| end == "toml");
        // Only a program with the feature `ros2` boots it.
        let is_ros = path.ends_with("calibrate-ros2.toml");
        let in_python = path.ends_with("program.toml") || path.ends_with("measure.toml");
        let left_out = is_ros || (in_python && !has_python());
        is_text && !left_out && {
            let text = fs::read_to_string(path).unwrap();
            text.contains("[chassis.") || text.contains("\ninclude = [")
        }
    };
    let mut apps: Vec<PathBuf> = files.filter(is_app).collect();
    apps.sort();
    assert!(apps.len() >= 3, "{apps:?}");
    apps
}

fn app(file: &Path, seed: u64) -> App {
    let mut selection = Selection::new(file);
    selection.sets = vec![
        format!("seed={seed}"),
        // Apps of one name share their snapshot buffers, and other tests boot these files, too.
        format!("app.name=\"replayed_{}\"", std::process::id()),
        "time.mode=\"virtual\"".to_owned(),
        "record.file=\"run.mcap\"".to_owned(),
    ];
    if file.ends_with("fleet.toml") {
        // All cells are alike.
        let one = ["fleet.sites=1", "fleet.cells=1"];
        selection.sets.extend(one.map(str::to_owned));
    }
    // The client for Python lies beside the folder of configurations.
    let client = root().join("clients/python/src").display().to_string();
    let programs = match file.file_name().and_then(|name| name.to_str()) {
        Some("program.toml") => &["meter", "desk"][..],
        Some("measure.toml") => &["meter"],
        _ => &[],
    };
    let sets = programs.iter();
    let sets = sets.map(|task| format!("task.{task}.args.environment.PYTHONPATH={client:?}"));
    selection.sets.extend(sets);
    program::app(&selection).unwrap_or_else(|findings| panic!("{findings}"))
}

/// What became of the replays of all tasks: those that did the same, and why the others were refused.
#[derive(Default)]
struct Replayed {
    same: BTreeSet<String>,
    refused: BTreeMap<String, String>,
}

fn replay_all(file: &Path, seed: u64, record: &Record) -> Replayed {
    let mut replayed = Replayed::default();
    let app = app(file, seed);
    let listed = replayable(&app, record);
    let listed: BTreeMap<String, Result<(), ReplayError>> = listed.into_iter().collect();
    for task in app.tasks.clone() {
        let listed = &listed[&task.name];
        match replay(app.clone(), registry(), &task.name, record) {
            Ok(report) => {
                assert!(
                    report.is_same(),
                    "{}, seed {seed}: {report}",
                    file.display()
                );
                assert_eq!(*listed, Ok(()), "{}", task.name);
                replayed.same.insert(task.name);
            }
            Err(error @ (ReplayError::Outside { .. } | ReplayError::Incomplete { .. })) => {
                // Known before any is chosen.
                assert_eq!(*listed, Err(error.clone()));
                replayed.refused.insert(task.name, error.to_string());
            }
            Err(error) => panic!("{}, seed {seed}: {error}", file.display()),
        }
    }
    replayed
}

/// Records a run in virtual time, and replays all its tasks.
fn run_and_replay(file: &Path, seed: u64, faults: &str) -> Replayed {
    let app = app(file, seed);
    // An app of daemons has no end of its own, and nothing comes after its start. A longer record has more of the same:
    // `tests/run --long` reads those.
    let seconds = match app.until {
        // It records 25 pictures a second.
        Some(_) if file.ends_with("tracker.toml") || file.ends_with("tracker-grasp.toml") => 2,
        Some(_) if std::env::var_os("CTOS_REPLAY_SEEDS").is_some() => 60,
        Some(_) => 12,
        None => 3,
    };
    let setup = Setup {
        faults: Faults::built_in(faults).unwrap(),
        stop_after: Some(Duration::from_secs(seconds)),
        ..Setup::default()
    };
    simulation::run(app, registry(), setup, &(Arc::new(|_: &_| ()) as _)).unwrap();
    let path = file.with_file_name("run.mcap");
    let record = Record::read(std::slice::from_ref(&path), &Filter::default()).unwrap();
    fs::remove_file(path).unwrap();
    replay_all(file, seed, &record)
}

/// As many seeds as `CTOS_REPLAY_SEEDS` says, or one.
fn seeds() -> std::ops::Range<u64> {
    let many = std::env::var("CTOS_REPLAY_SEEDS").map_or(1, |many| many.parse().unwrap());
    5..5 + many
}

/// The tasks of the shipped apps that share memory with others, or are called in time: what they read is in no record.
const REFUSED: [&str; 16] = [
    "argus",
    "ball",
    "client",
    "collisions",
    "druide",
    "gripper",
    "hand",
    "mouse",
    "planner",
    "servo",
    "state",
    "tracker",
    "truth",
    "vmImageDisp",
    "vmSpotDisp",
    "world",
];

/// Whether it is one of them, perhaps that of one of several manipulators: `servo_left`.
fn is_refused(task: &str) -> bool {
    REFUSED.contains(&task.split('_').next().unwrap_or(task))
}

#[test]
fn every_task_of_every_shipped_app_does_the_same_again_or_says_what_it_reads_elsewhere() {
    let folder = configs();
    for file in apps(folder.path()) {
        for seed in seeds() {
            let Replayed { same, refused } = run_and_replay(&file, seed, "none");
            for (task, why) in &refused {
                assert!(is_refused(task), "{why}");
                let reason = [
                    "shared memory `",
                    "a synchronous function",
                    "the grip `",
                    "what argus sees",
                    "what the servo leaves",
                    "what the tracker leaves",
                ];
                assert!(reason.iter().any(|reason| why.contains(reason)), "{why}");
            }
            assert!(!same.is_empty(), "{}", file.display());
        }
    }
}

#[test]
fn a_record_made_under_faults_is_replayed_but_for_tasks_whose_chassis_was_restarted() {
    let folder = configs();
    let (mut same, mut runs) = (0, 0);
    for (file, number) in apps(folder.path()).iter().zip(0..) {
        for seed in seeds() {
            // The one for half of the apps, the other for the rest, and the other way round with the next seed.
            let faults = if (seed + number) % 2 == 0 {
                "light"
            } else {
                "rough"
            };
            let replayed = run_and_replay(file, seed, faults);
            same += replayed.same.len();
            runs += 1;
            for (task, why) in replayed.refused {
                let known =
                    is_refused(&task) || why.contains("was moved, or its chassis restarted");
                assert!(known, "{faults} {seed}: {why}");
            }
        }
    }
    assert!(same > 2 * runs, "only {same} tasks were replayed");
}

#[test]
fn records_of_real_processes_with_a_display_are_replayed() {
    let folder = configs();
    let path = |name: &str| folder.path().join(name);
    // The program of the example has the event handlers of both.
    for (app, chassis) in [
        ("hello.toml", ["desk", "shelf", "desk"]),
        ("calibrate.toml", ["ws1", "cage_motion", "cage_vision"]),
    ] {
        let run = crate::common::example("hello")
            .args(["boot", &path(app).display().to_string()])
            .args(["--record", &path("real.mcap").display().to_string()])
            .args(["--display=127.0.0.1:0"])
            .env("NO_COLOR", "1")
            .output()
            .unwrap();
        // From so few positions no camera can be computed; that is a result, too.
        assert!(matches!(run.status.code(), Some(0 | 1)), "{run:?}");
        let files: BTreeSet<PathBuf> = chassis
            .map(|name| path(&format!("real.{name}.mcap")))
            .into();
        let files: Vec<PathBuf> = files.into_iter().collect();
        let record = Record::read(&files, &Filter::default()).unwrap();
        let Replayed { same, refused } = replay_all(&path(app), 1, &record);
        must_list(&path(app), &files, &same, &refused);
        assert!(same.len() >= 4, "{same:?}");
        for (task, why) in &refused {
            assert!(is_refused(task), "{why}");
        }
    }
}

/// `ctos replay` without a task says of each whether it does the same again, for people and for programs.
fn must_list(
    app: &Path,
    files: &[PathBuf],
    same: &BTreeSet<String>,
    refused: &BTreeMap<String, String>,
) {
    let list = |more: &[&str]| {
        let mut command = crate::common::example("hello");
        let listed = command.arg("replay").arg(app).args(files).args(more);
        let listed = listed.env("NO_COLOR", "1").output().unwrap();
        assert_eq!(listed.status.code(), Some(0), "{listed:?}");
        String::from_utf8(listed.stdout).unwrap()
    };
    let text = list(&[]);
    let json: serde_json::Value = serde_json::from_str(&list(&["--json"])).unwrap();
    let told = json["tasks"].as_array().unwrap();
    assert_eq!(
        (text.lines().count(), told.len()),
        (same.len() + refused.len(), text.lines().count())
    );
    for (line, told) in text.lines().zip(told) {
        let task = told["task"].as_str().unwrap();
        assert!(line.starts_with(&format!("{task} ")), "{line}");
        assert_eq!(told["replays"], same.contains(task), "{told}");
        match refused.get(task) {
            Some(why) => {
                assert_eq!(told["why"], why.as_str());
                // The list has the task before it, and once is enough for what can be done.
                let short = why
                    .split_once(" cannot be replayed: ")
                    .map_or(why.as_str(), |(_, why)| why);
                let short = short
                    .split_once("; what a task reads")
                    .map_or(short, |(why, _)| why);
                assert!(line.ends_with(&format!("  does not: {short}")), "{line}");
            }
            None => assert!(
                told["why"].is_null() && line.ends_with("  replays"),
                "{line}"
            ),
        }
    }
}

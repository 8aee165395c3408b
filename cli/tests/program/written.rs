//! Nets without a compiler, as a person tries them: `ctos net run`, `ctos net watch`, `ctos new --net`.

use std::{
    fs,
    io::{BufRead as _, BufReader},
    process::{Command, Output, Stdio},
};

use crate::common::{good, root};

fn ctos(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_ctos"));
    command
        .current_dir(root())
        .args(arguments)
        .env("NO_COLOR", "1");
    command
}

/// Exit code, and all that was said.
fn said(output: &Output) -> (Option<i32>, String) {
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (
        output.status.code(),
        text(&output.stdout) + &text(&output.stderr),
    )
}

#[test]
fn a_net_runs_without_a_configuration_and_its_first_answer_is_success() {
    let run = |more: &[&str]| {
        let line = ["net", "run", "configs/nets/greet.net", "--tape"];
        said(&ctos(&[&line, more].concat()).output().unwrap())
    };
    let (code, text) = run(&["greet world 2", "-v"]);
    assert_eq!(code, Some(0), "{text}");
    assert_eq!(text.matches("Hello, world!").count(), 2, "{text}");
    assert!(text.contains("world has 0.2 l of tea"), "{text}");
    // The same seed is the same run.
    let by_chance = |seed: &str| {
        run(&[
            "greet world 2",
            "--stand-in",
            "--fail",
            "0.4",
            "--seed",
            seed,
            "-v",
        ])
    };
    let shown = |seed: &str| {
        let (code, text) = by_chance(seed);
        // Lines about the run itself have the name of a folder that is made for each.
        let lines = text.lines().filter(|line| line.contains(" INFO "));
        (code, lines.map(str::to_owned).collect::<Vec<String>>())
    };
    assert_eq!(shown("3"), shown("3"));
    let ran: Vec<_> = (1..12).map(|seed| by_chance(&seed.to_string())).collect();
    assert!(ran.iter().any(|(code, _)| *code == Some(0)), "{ran:?}");
    let failed = ran.iter().find(|(code, _)| *code == Some(1)).unwrap();
    // The command that repeats it is the one that was given, and no folder that is gone stands in it.
    let again = failed
        .1
        .lines()
        .find_map(|line| line.strip_prefix("repeat   "));
    assert!(
        again.is_some_and(|again| again.contains(" net run ")),
        "{failed:?}"
    );
    // What is wrong with a command is told where it is put.
    let (code, text) = run(&["greet world many"]);
    assert!(
        code != Some(0) && text.contains("`many` is no int for `times`"),
        "{text}"
    );
    let (code, text) = run(&["great world 2"]);
    assert!(
        code == Some(3) && text.contains("takes no command `great`"),
        "{text}"
    );
}

#[test]
fn what_new_writes_for_a_net_is_checked_tried_and_run_without_a_compiler() {
    let folder = tempfile::tempdir().unwrap();
    let app = folder.path().join("tea-room");
    good(
        &ctos(&["new", "-q", "--net", &app.display().to_string()])
            .output()
            .unwrap(),
    );
    let test = Command::new("sh")
        .arg("test.sh")
        .current_dir(&app)
        .env("CTOS", env!("CARGO_BIN_EXE_ctos"))
        .output();
    let (code, text) = said(&test.unwrap());
    assert!(code == Some(0) && text.contains("all is well"), "{text}");
    let file = app.join("app.toml").display().to_string();
    let (code, text) = said(&ctos(&["sim", &file]).output().unwrap());
    assert!(code == Some(0) && text.contains("fetched"), "{text}");
    let again = said(
        &ctos(&["new", "--net", &app.display().to_string()])
            .output()
            .unwrap(),
    );
    assert!(
        again.0 == Some(1) && again.1.contains("is there already"),
        "{again:?}"
    );
}

#[test]
fn a_watched_net_is_checked_at_every_save() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.net");
    let sound = "net a\nplace p = 1\ndata n : int\ntransition t\n  in p\n  wait 1 s\n  set n = n + 1\n  out p\n";
    fs::write(&file, sound).unwrap();
    let mut watch = ctos(&["net", "watch", &file.display().to_string()])
        .stderr(Stdio::piped())
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(watch.stderr.take().unwrap()).lines();
    let mut until = |wanted: &str| {
        let mut seen = String::new();
        while !seen.ends_with(wanted) {
            seen = lines.next().expect("more to come").unwrap();
        }
    };
    until("a.net: sound");
    fs::write(&file, sound.replace("n + 1", "m + 1")).unwrap();
    until("a.net: not sound");
    // As editors do it: another file in the place of the old one.
    let other = folder.path().join("b.net");
    fs::write(&other, sound).unwrap();
    fs::rename(&other, &file).unwrap();
    until("a.net: sound");
    watch.kill().unwrap();
    watch.wait().unwrap();
}

#[test]
fn a_net_asks_a_program_in_python_and_decides_by_its_answer_with_units_checked() {
    let python = std::env::var("CTOS_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    if !Command::new(python)
        .arg("--version")
        .output()
        .is_ok_and(|ran| ran.status.success())
    {
        return;
    }
    let boot = |more: &[&str]| {
        let line = [
            "boot",
            "configs/measure.toml",
            "-v",
            "--set",
            "time.mode=\"virtual\"",
        ];
        said(&ctos(&[&line, more].concat()).output().unwrap())
    };
    let (code, text) = boot(&[]);
    assert_eq!(code, Some(0), "{text}");
    assert!(text.contains("mm thick, from 64 values"), "{text}");
    // The net's text names the unit, and the file of the program, too.
    let folder = tempfile::tempdir().unwrap();
    let net = fs::read_to_string(root().join("configs/nets/measure.net")).unwrap();
    let file = folder.path().join("measure.net");
    fs::write(&file, net.replace("sd : mm", "sd : px")).unwrap();
    let (code, text) = boot(&[
        "--set",
        &format!("task.measure.args.net={:?}", file.display().to_string()),
    ]);
    assert_eq!(code, Some(3), "{text}");
    assert!(
        text.contains("`result` is (mm, px, int), and command `measure` of task `meter` has (mm, mm, i64) there"),
        "{text}"
    );
}

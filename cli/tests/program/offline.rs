//! The commands that start nothing, as a person or a script meets them: what they print, where, in
//! which colours, and with which exit code.

use std::{
    fs,
    io::Read,
    path::Path,
    process::{Command, Output, Stdio},
};

use crate::common::{example, good, root};
use serde_json::Value;

/// An app with nothing wrong that needs no handler to be read.
const APP: &str = "[app]\nseed = 3\n[chassis.w]\n[task.a]\nhandler = \"h\"\non = \"w\"\n[profile.sim.app]\nseed = 4\n";

fn ctos(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_ctos"));
    command.current_dir(root()).args(arguments);
    for name in ["NO_COLOR", "CLICOLOR", "CLICOLOR_FORCE"] {
        command.env_remove(name);
    }
    command
}

fn run(arguments: &[&str]) -> Output {
    ctos(arguments).output().expect("ctos runs")
}

/// Exit code, standard output, standard error.
fn ended(output: &Output) -> (Option<i32>, String, String) {
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (
        output.status.code(),
        text(&output.stdout),
        text(&output.stderr),
    )
}

/// A folder with a file in it.
fn folder_with(name: &str, text: &str) -> (tempfile::TempDir, String) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join(name);
    fs::write(&path, text).expect("a file");
    let path = path.display().to_string();
    (folder, path)
}

#[test]
fn the_shipped_apps_are_checked_without_a_finding() {
    let (code, out, err) = ended(&run(&["check", "configs/calibrate.toml"]));
    assert_eq!((code, out.as_str()), (Some(0), ""), "{err}");
    assert_eq!(err, "configs/calibrate.toml: nothing found\n");
    let (code, out, err) = ended(&run(&["check", "-q", "configs/calibrate.toml"]));
    assert_eq!((code, out.as_str(), err.as_str()), (Some(0), "", ""));
}

#[test]
fn a_file_of_the_command_line_is_looked_for_where_the_person_is() {
    for command in ["check", "boot"] {
        let (code, _, err) = ended(&run(&[command, "no-such.toml"]));
        assert_eq!(code, Some(3), "{err}");
        assert!(err.contains("from the folder where you are"), "{err}");
    }
}

#[test]
fn exit_codes_are_those_of_the_list() {
    let (_folder, app) = folder_with("app.toml", APP);
    let (_other, wrong) = folder_with("wrong.toml", "[tsak]\n");
    let cases: [(&[&str], i32); 13] = [
        (&["--help"], 0),
        (&["--version"], 0),
        (&["config", "show", &app], 0),
        (&["config", "defaults"], 0),
        (&["explain"], 0),
        (&["new", "no/such/folder/app"], 1),
        (&["bot"], 2),
        (&["new", "1 2"], 2),
        (&["check", &app, "--color", "purple"], 2),
        (&["check", &wrong], 3),
        (&["boot", &wrong], 3),
        (&["config", "show", &app, "--profile", "sin"], 3),
        (&["explain", "ctos::config::unknown_kye"], 4),
    ];
    for (arguments, code) in cases {
        let (found, _, err) = ended(&run(arguments));
        assert_eq!(found, Some(code), "{arguments:?}: {err}");
    }
    let (_, out, _) = ended(&run(&["--help"]));
    for (code, meaning) in cli::exit::CODES {
        assert!(out.contains(&format!("{code:>3}  {meaning}")), "{code}");
    }
}

#[test]
fn several_apps_are_checked_in_one_go_and_the_worst_decides() {
    let (_folder, wrong) = folder_with("wrong.toml", "[tsak]\n");
    let (code, _, err) = ended(&run(&[
        "check",
        "configs/calibrate.toml",
        &wrong,
        "configs/calibrate.toml",
    ]));
    assert_eq!(code, Some(3));
    assert_eq!(
        err.matches("configs/calibrate.toml: nothing found").count(),
        2,
        "{err}"
    );
    assert!(err.contains("wrong.toml: 1 error"), "{err}");
}

#[test]
fn a_reader_that_goes_away_is_no_failure() {
    let (_folder, app) = folder_with("app.toml", APP);
    let cases: [&[&str]; 7] = [
        &["--help"],
        &["config", "defaults"],
        &["config", "schema"],
        &["config", "show", &app],
        &["config", "show", &app, "--json"],
        &["explain"],
        &["completions", "bash"],
    ];
    for arguments in cases {
        let mut child = ctos(arguments)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("ctos runs");
        drop(child.stdout.take());
        let mut err = String::new();
        let stderr = child.stderr.as_mut().expect("it is piped");
        stderr.read_to_string(&mut err).expect("text");
        let status = child.wait().expect("it ends");
        assert_eq!(
            (status.code(), err.as_str()),
            (Some(0), ""),
            "{arguments:?}"
        );
    }
}

#[test]
fn colours_follow_the_flag_then_no_color_then_clicolor_force_then_the_terminal() {
    let (_folder, wrong) = folder_with("wrong.toml", "[tsak]\n");
    let coloured = |flag: &[&str], variables: &[(&str, &str)]| {
        let arguments = [flag, &["check", &wrong]].concat();
        let mut command = ctos(&arguments);
        command.envs(variables.iter().copied());
        let (code, _, err) = ended(&command.output().expect("ctos runs"));
        assert_eq!(code, Some(3));
        err.contains('\u{1b}')
    };
    let (no, force) = (("NO_COLOR", "1"), ("CLICOLOR_FORCE", "1"));
    assert!(!coloured(&[], &[]), "a pipe is no terminal");
    assert!(coloured(&[], &[force]));
    assert!(!coloured(&[], &[force, no]));
    assert!(coloured(&["--color=always"], &[no]));
    assert!(!coloured(&["--color", "never"], &[force]));
    assert!(!coloured(&["--color", "auto"], &[]));
    let help = |flag: &str| {
        let (_, out, _) = ended(&run(&["--help", flag]));
        out.contains('\u{1b}')
    };
    assert!(help("--color=always") && !help("--color=never"));
}

#[test]
fn twenty_findings_are_shown_and_counted_unless_all_are_asked_for() {
    let lines: Vec<String> = (0..25).map(|n| format!("zz{n} = 1")).collect();
    let app = APP.replace("\"h\"", "\"sorma.daemon\"");
    let (_folder, wrong) = folder_with("wrong.toml", &format!("{}\n{app}", lines.join("\n")));
    let shown = |arguments: &[&str]| {
        let (code, _, err) = ended(&run(&[&["check", wrong.as_str()], arguments].concat()));
        assert_eq!(code, Some(3), "{err}");
        (err.matches("unknown key `zz").count(), err)
    };
    let (count, err) = shown(&[]);
    assert_eq!(count, 20, "{err}");
    assert!(err.contains("… and 5 more"), "{err}");
    assert!(err.ends_with("25 errors\n"), "{err}");
    let told = "`ctos explain ctos::config::unknown_key` tells more";
    assert_eq!(err.matches(told).count(), 1, "{err}");
    let (count, err) = shown(&["--all"]);
    assert_eq!(count, 25);
    assert!(!err.contains("more;"), "{err}");
    let (code, out, err) = ended(&run(&["check", &wrong, "--json"]));
    assert_eq!((code, out.lines().count()), (Some(3), 25), "{err}");
    assert_eq!(err, "");
}

#[test]
fn config_show_prints_an_app_that_is_the_same_app_with_the_origin_of_each_value() {
    let (folder, app) = folder_with("app.toml", APP);
    let show = ["config", "show", &app, "--profile", "sim"];
    let (out, err) = good(&run(&show));
    assert_eq!(err, "");
    let seed = out.lines().find(|line| line.starts_with("seed = "));
    let seed = seed.expect("a seed");
    assert!(seed.starts_with("seed = 4 "), "{seed}");
    assert!(seed.ends_with(&format!("# profile sim, {app}:8")), "{seed}");
    let written = folder.path().join("shown.toml");
    fs::write(&written, &out).expect("a file");
    let written = written.display().to_string();
    let (again, _) = good(&run(&["config", "show", &written]));
    let bare = |text: &str| {
        let lines = text.lines().skip(1);
        let lines = lines.map(|line| line.split(" # ").next().unwrap_or_default().trim_end());
        lines.map(str::to_owned).collect::<Vec<_>>()
    };
    assert_eq!(bare(&again), bare(&out));
    let (out, _) = good(&run(&[&show[..], &["--json", "--set", "seed=5"]].concat()));
    let lines: Vec<Value> = out
        .lines()
        .map(|line| serde_json::from_str(line).expect("an object"))
        .collect();
    let of = |key: &str| {
        let found = lines.iter().find(|line| line["key"] == key);
        found.unwrap_or_else(|| panic!("no {key}")).clone()
    };
    assert_eq!(
        (&of("app.seed")["value"], &of("app.seed")["origin"]),
        (&5.into(), &"set".into())
    );
    assert_eq!(of("task.a.queue")["origin"], "default");
    assert_eq!(of("task.a.on")["place"]["line"], 6);
}

#[test]
fn the_whole_of_a_shipped_app_survives_config_show() {
    let (out, _) = good(&run(&["config", "show", "configs/calibrate.toml"]));
    let name = root().join("configs/shown.toml").display().to_string();
    let texts = [(name.as_str(), out.as_str())];
    let shown = ctos::config::Selection::new(&name);
    let shown = shown.load_texts(
        &texts,
        &std::collections::BTreeMap::new(),
        &cli::program::EXPANDERS,
    );
    let shown = shown.unwrap_or_else(|findings| panic!("{findings}"));
    let findings = cli::program::registry().check(&shown);
    assert!(findings.is_empty(), "{findings}");
}

#[test]
fn a_shipped_app_goes_to_another_folder_with_all_that_its_checks_read() {
    let registry = cli::program::registry();
    let here = ctos::config::Selection::new(root().join("configs/calibrate.toml"));
    let (app, _) = cli::program::checked(&here, &registry).unwrap_or_else(|f| panic!("{f}"));
    let bundle = app.bundle().expect("no path is absolute");
    let names: Vec<&str> = bundle.files.keys().map(String::as_str).collect();
    assert_eq!(
        names,
        [
            "calibrate.toml",
            "cell.toml",
            "nets/dispatcher.net",
            "nets/motion.net",
            "nets/vision.net",
            "positions.csv",
        ]
    );
    let folder = tempfile::tempdir().expect("a folder");
    let there = bundle.unpack(folder.path()).expect("it can be written");
    let (moved, findings) =
        cli::program::checked(&there, &registry).unwrap_or_else(|f| panic!("{f}"));
    assert!(findings.is_empty(), "{findings}");
    assert_eq!(moved.folder, folder.path());
    assert_eq!(moved.bundle().expect("no path is absolute"), bundle);
}

#[test]
fn explain_prints_the_section_or_what_was_meant() {
    let (out, _) = good(&run(&["explain", "ctos::config::unknown_key"]));
    assert!(out.starts_with("ctos::config::unknown_key\n\n"), "{out}");
    assert!(out.contains("\nDo: ") && !out.contains("## "), "{out}");
    let (_, out, err) = ended(&run(&["explain", "ctos::config::unknown_kye"]));
    assert_eq!(out, "");
    assert!(
        err.contains("did you mean `ctos::config::unknown_key`?"),
        "{err}"
    );
    let (out, _) = good(&run(&["explain", "--json"]));
    for line in out.lines() {
        let object: Value = serde_json::from_str(line).expect("an object");
        assert!(object["text"].as_str().is_some_and(|text| !text.is_empty()));
    }
}

#[test]
fn doctor_looks_at_the_host_and_at_what_an_app_asks_of_it() {
    let (out, err) = good(&run(&["doctor"]));
    assert_eq!(err, "");
    for what in ["cpus", "real-time", "memory", "files", "loopback", "zenoh"] {
        let lines = out.lines().filter(|line| line.contains(what));
        assert_eq!(lines.count(), 1, "{what} in {out}");
    }
    let taken = std::net::TcpListener::bind(("127.0.0.1", 0)).expect("a port");
    let address = taken.local_addr().expect("it has one");
    let text = APP.replace(
        "[chassis.w]",
        &format!("[chassis.w]\nlisten = \"{address}\""),
    );
    let (_folder, app) = folder_with("app.toml", &text);
    let (code, out, err) = ended(&run(&["doctor", &app, "--json"]));
    assert_eq!((code, err.as_str()), (Some(1), ""), "{out}");
    let last: Value = serde_json::from_str(out.lines().last().expect("a line")).expect("an object");
    assert_eq!(last["code"], "ctos::doctor::address");
}

/// The files of a folder with their texts, by relative path.
fn files(folder: &Path, under: &Path, found: &mut Vec<(String, String)>) {
    for entry in fs::read_dir(under).expect("a folder") {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            files(folder, &path, found);
        } else {
            let name = path.strip_prefix(folder).expect("it is below");
            let text = fs::read_to_string(&path).expect("a text");
            found.push((name.display().to_string(), text));
        }
    }
    found.sort();
}

/// Has the app `app` written with these arguments, out of this template.
fn must_write(app: &Path, arguments: &[&str], template: &str) {
    let app_name = app.display().to_string();
    let (code, out, err) = ended(&run(&[&["new", &app_name], arguments].concat()));
    assert_eq!((code, out.as_str()), (Some(0), ""), "{err}");
    assert!(err.contains("cargo run -- boot app.toml"), "{err}");
    let mut written = Vec::new();
    files(app, app, &mut written);
    let settings = written
        .iter()
        .position(|(path, _)| path == ".cargo/config.toml");
    let (_, settings) = written.remove(settings.expect("settings of cargo"));
    assert!(settings.contains("target-dir = "), "{settings}");
    let template = root().join("cli/examples").join(template);
    let mut expected = Vec::new();
    files(&template, &template, &mut expected);
    let workspace = root().canonicalize().expect("the workspace");
    let name = app.file_name().and_then(|name| name.to_str());
    let name = name.expect("a name");
    for (path, text) in &mut expected {
        *path = path.replace("Cargo.toml.in", "Cargo.toml");
        *text = text
            .replace("my-app", name)
            .replace("my_app", &name.replace('-', "_"))
            .replace("CTOS/", &format!("{}/", workspace.display()))
            .replace("../../../", &format!("{}/", workspace.display()))
            .replace("/examples/template/", "/")
            .replace("/examples/template_task/", "/");
        if path == "Cargo.toml" {
            let manifest = fs::read_to_string(root().join("Cargo.toml")).expect("the manifest");
            let profiles = manifest.find("[profile.dev]").expect("a profile");
            text.push_str(&manifest[profiles..]);
        }
    }
    let lock = fs::read_to_string(root().join("Cargo.lock"));
    expected.push(("Cargo.lock".to_owned(), lock.expect("the lock file")));
    expected.push((".gitignore".to_owned(), "/target\n".to_owned()));
    let schema = fs::read_to_string(root().join("configs/ctos.schema.json"));
    expected.push(("ctos.schema.json".to_owned(), schema.expect("the schema")));
    expected.sort();
    assert_eq!(written, expected);
}

#[test]
fn new_writes_the_template_with_its_name_and_overwrites_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let app = folder.path().join("tea-robot");
    must_write(&app, &[], "template");
    must_write(&folder.path().join("picker"), &["--task"], "template_task");
    let mine = app.join("src/handlers.rs");
    fs::write(&mine, "mine").expect("a file");
    let (code, _, err) = ended(&run(&["new", &app.display().to_string()]));
    assert_eq!(code, Some(1));
    assert!(
        err.contains("is there already; nothing was written"),
        "{err}"
    );
    assert_eq!(fs::read_to_string(&mine).expect("a text"), "mine");
    let nowhere = folder.path().join("other");
    let arguments = ["new", &nowhere.display().to_string(), "--path", "configs"];
    let (code, _, err) = ended(&run(&arguments));
    assert_eq!(code, Some(1));
    assert!(err.contains("is not the CTOS workspace"), "{err}");
    assert!(!nowhere.exists());
}

#[test]
fn what_new_writes_boots_in_processes_and_on_the_virtual_clock_and_its_readme_is_short() {
    let folder = tempfile::tempdir().expect("a folder");
    let app = folder.path().join("my-app");
    good(&run(&["new", "-q", &app.display().to_string()]));
    let file = app.join("app.toml").display().to_string();
    let template = |arguments: &[&str]| {
        example("template")
            .args(arguments)
            .output()
            .expect("the example runs")
    };
    good(&template(&["check", &file]));
    let (out, err) = good(&template(&["boot", "-q", &file, "--profile", "virtual"]));
    // In one process, what the reporter prints stands before the result.
    let result = "added\nthe sum is 6\n";
    let printed = format!("the sum is 6\n{result}");
    assert_eq!((out.as_str(), err.as_str()), (printed.as_str(), ""));
    let quick = ["--set", "task.adder.args.takes_s=0.01"];
    let (out, err) = good(&template(&[&["boot", &file], &quick[..]].concat()));
    assert_eq!(out, result, "{err}");
    assert!(err.contains("pid"), "{err}");
    assert!(err.contains("shelf │ the sum is 6\n"), "{err}");
    let page = [&["boot", &file, "--profile", "page"], &quick[..]].concat();
    let (out, err) = good(&template(&page));
    assert_eq!(out, result, "{err}");
    assert!(err.contains("nets are shown"), "{err}");
    let readme = fs::read_to_string(app.join("README.md")).expect("a text");
    assert!(readme.lines().count() <= 16);
}

/// The packages of a lock file: name and version.
fn locked(text: &str) -> Vec<(String, String)> {
    let value = |line: &str| line.split('"').nth(1).unwrap_or_default().to_owned();
    let packages = text.split("[[package]]").skip(1);
    let read = packages.map(|package| {
        let mut lines = package.lines();
        let mut of = |key: &str| lines.find(|line| line.starts_with(key)).map(value);
        (
            of("name = ").expect("a name"),
            of("version = ").expect("a version"),
        )
    });
    read.collect()
}

#[test]
fn what_new_writes_is_a_package_of_the_versions_that_the_workspace_is_built_with() {
    let folder = tempfile::tempdir().expect("a folder");
    let app = folder.path().join("my-app");
    good(&run(&["new", "-q", &app.display().to_string()]));
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    // It reads the manifest with its profiles, and fits the lock file to it; packages of other systems need not be here.
    let output = Command::new(cargo)
        .args(["tree", "--offline", "--quiet"])
        .current_dir(&app)
        .output()
        .expect("cargo runs");
    good(&output);
    // It builds to where the workspace does, so that nothing of others is built twice.
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let output = Command::new(cargo)
        .args([
            "metadata",
            "--offline",
            "--quiet",
            "--no-deps",
            "--format-version",
            "1",
        ])
        .env_remove("CARGO_TARGET_DIR")
        .current_dir(&app)
        .output()
        .expect("cargo runs");
    let (told, _) = good(&output);
    let target = root().canonicalize().expect("a folder").join("target");
    let target = format!("\"target_directory\":\"{}\"", target.display());
    assert!(told.contains(&target), "{told}");
    let ours = locked(&fs::read_to_string(root().join("Cargo.lock")).expect("a lock file"));
    let its = locked(&fs::read_to_string(app.join("Cargo.lock")).expect("a lock file"));
    assert!(its.len() > 100, "{its:?}");
    for package in its.iter().filter(|(name, _)| name != "my-app") {
        assert!(ours.contains(package), "{package:?}");
    }
}

#[test]
fn a_profile_and_the_environment_reach_the_processes_of_the_chassis() {
    let folder = tempfile::tempdir().expect("a folder");
    let app = folder.path().join("my-app");
    good(&run(&["new", "-q", &app.display().to_string()]));
    let file = app.join("app.toml");
    let mut text = fs::read_to_string(&file).expect("a text");
    text.push_str("[profile.quick.task.operator.args]\narguments = [\"20\", \"${NUMBER}\"]\n[profile.quick.task.adder.args]\ntakes_s = 0.01\n");
    fs::write(&file, text).expect("a file");
    let output = example("template")
        .arg("boot")
        .args([file.as_os_str(), "--profile".as_ref(), "quick".as_ref()])
        .env("NUMBER", "1")
        .output()
        .expect("the example runs");
    let (out, err) = good(&output);
    assert_eq!(out, "added\nthe sum is 21\n", "{err}");
}

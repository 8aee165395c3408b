//! What `ctos new` makes is compiled, tested and run. The compiler and the libraries are those of these
//! tests: for a package of its own cargo would build all of them once more.

use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Output},
};

use serde_json::Value;

use crate::common::{build, good};

/// The libraries that the app names, and those that cargo made for them. A name has more than one where
/// something else has been built with other features.
fn libraries() -> Vec<(&'static str, Vec<PathBuf>)> {
    let mut cargo = build("template");
    let made = cargo.arg("--message-format=json").output().unwrap();
    let (messages, _) = good(&made);
    let messages: Vec<Value> = messages
        .lines()
        .filter_map(|line| serde_json::from_str(line).ok())
        .collect();
    let of = |name: &'static str| {
        let named = messages.iter().filter(|message| {
            message["reason"] == "compiler-artifact" && message["target"]["name"] == name
        });
        let files = named.flat_map(|message| message["filenames"].as_array().cloned());
        let files = files
            .flatten()
            .filter_map(|file| Some(PathBuf::from(file.as_str()?)));
        let libraries = files.filter(|file| file.extension().is_some_and(|end| end == "rlib"));
        (name, libraries.collect::<Vec<PathBuf>>())
    };
    ["cli", "ctos", "pnt", "serde"].map(of).into()
}

/// Compiles the app in `folder` as cargo would, into the program `to`.
fn compile(folder: &Path, libraries: &[(&str, &Path)], arguments: &[&str], to: &Path) -> Output {
    let mut rustc = Command::new(std::env::var("RUSTC").unwrap_or_else(|_| "rustc".to_owned()));
    rustc.args(["--edition", "2024", "--crate-name", "tea_robot"]);
    rustc.args(arguments).arg("-o").arg(to);
    for (name, file) in libraries {
        rustc
            .arg("--extern")
            .arg(format!("{name}={}", file.display()));
        let mut dependencies = std::ffi::OsString::from("dependency=");
        dependencies.push(file.parent().unwrap());
        rustc.arg("-L").arg(dependencies);
    }
    rustc
        .arg("src/main.rs")
        .current_dir(folder)
        .env("CARGO_MANIFEST_DIR", folder)
        .output()
        .unwrap()
}

#[test]
fn what_new_writes_is_compiled_passes_its_own_test_and_runs() {
    let folder = tempfile::tempdir().unwrap();
    let app = folder.path().join("tea-robot");
    let new = Command::new(env!("CARGO_BIN_EXE_ctos"))
        .args(["new", "-q"])
        .arg(&app)
        .output();
    good(&new.unwrap());
    let manifest = fs::read_to_string(app.join("Cargo.toml")).unwrap();
    let found = libraries();
    for (name, files) in &found {
        assert!(!files.is_empty(), "{name} is not built");
        assert!(
            manifest.contains(&format!("\n{name} = ")),
            "{name} is no dependency of the app:\n{manifest}"
        );
    }
    // Only serde is also built for what runs while others are compiled.
    let serdes = &found[3].1;
    let program = folder.path().join("program");
    let mut said = String::new();
    let libraries = serdes.iter().find_map(|serde| {
        let libraries: Vec<(&str, &Path)> = found
            .iter()
            .map(|(name, files)| match *name {
                "serde" => ("serde", serde.as_path()),
                name => (name, files[0].as_path()),
            })
            .collect();
        let output = compile(&app, &libraries, &["-D", "warnings"], &program);
        said = String::from_utf8_lossy(&output.stderr).into_owned();
        output.status.success().then_some(libraries)
    });
    let libraries = libraries.unwrap_or_else(|| panic!("{said}"));
    let tests = folder.path().join("tests");
    good(&compile(&app, &libraries, &["--test"], &tests));
    let run = |program: &Path, arguments: &[&str]| {
        let output = Command::new(program)
            .args(arguments)
            .current_dir(&app)
            .env("NO_COLOR", "1")
            .output();
        good(&output.unwrap())
    };
    let (passed, _) = run(&tests, &[]);
    assert!(passed.contains("test result: ok. 2 passed"), "{passed}");
    let (_, found) = run(&program, &["check", "app.toml"]);
    assert!(found.contains("nothing found"), "{found}");
    let quick = "task.adder.args.takes_s=0.01";
    let (out, err) = run(
        &program,
        &["boot", "app.toml", "--profile", "page", "--set", quick],
    );
    assert_eq!(out, "added\nthe sum is 6\n", "{err}");
    assert!(err.contains("nets are shown"), "{err}");
}

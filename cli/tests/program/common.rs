//! What the tests of commands, examples and documents share.

use std::{
    path::{Path, PathBuf},
    process::{Command, Output},
};

/// The workspace's folder.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// A command that builds an example.
///
/// Built as all tests are, for the whole workspace. By itself cargo would choose other features of its
/// dependencies, and build all of them again.
pub fn build(name: &str) -> Command {
    let mut build = Command::new(env!("CARGO"));
    // What cargo tells a test of its own package makes build scripts that look at it (ring's) run again.
    // Then half of the workspace is compiled anew. What a person tells cargo stays.
    for (key, _) in std::env::vars_os() {
        let of_package = [
            "CARGO_MANIFEST_",
            "CARGO_PKG_",
            "CARGO_BIN_EXE_",
            "CARGO_CRATE_NAME",
            "OUT_DIR",
        ];
        let is_of_package = |key: &str| of_package.iter().any(|start| key.starts_with(start));
        if key.to_str().is_some_and(is_of_package) {
            build.env_remove(&key);
        }
    }
    build
        .current_dir(root())
        .args(["build", "--quiet", "--workspace", "--example", name]);
    build
}

/// A command that runs an example, built now if it is not.
pub fn example(name: &str) -> Command {
    let built = build(name)
        .status()
        .expect("cargo runs, for it runs this test");
    assert!(built.success(), "{name} is not built");
    let here = std::env::current_exe().expect("a test is a program");
    let folder = here
        .ancestors()
        .nth(2)
        .expect("tests are built in a folder");
    let mut command = Command::new(folder.join("examples").join(name));
    command.current_dir(root());
    command
}

/// Runs the example `hello` as a newcomer does, from the workspace's folder.
pub fn hello(arguments: &[&str]) -> Output {
    example("hello")
        .args(["boot", "configs/hello.toml"])
        .args(arguments)
        .env("NO_COLOR", "1")
        .output()
        .expect("the example runs")
}

/// Standard output and standard error of a run that went well.
pub fn good(output: &Output) -> (String, String) {
    let out = String::from_utf8_lossy(&output.stdout).into_owned();
    let err = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{}:\n{out}\n{err}", output.status);
    (out, err)
}

/// A folder with the configurations.
pub fn configurations() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let copied = Command::new("cp")
        .arg("-r")
        .arg(root().join("configs"))
        .arg(folder.path())
        .status();
    assert!(copied.unwrap().success());
    folder
}

//! What the tests of commands, examples and documents share.

#![allow(dead_code, reason = "each file of tests uses its own part")]

use std::{
    path::{Path, PathBuf},
    process::{Command, Output},
};

/// The workspace's folder.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Runs the example `hello` as a newcomer does, from the workspace's folder.
pub fn hello(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO"))
        .current_dir(root())
        .args(["run", "--quiet", "--package", "cli", "--example", "hello"])
        .args(["--", "boot", "configs/hello.toml"])
        .args(arguments)
        .env("NO_COLOR", "1")
        .output()
        .expect("cargo runs, for it runs this test")
}

/// Standard output and standard error of a run that went well.
pub fn good(output: &Output) -> (String, String) {
    let out = String::from_utf8_lossy(&output.stdout).into_owned();
    let err = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{}:\n{out}\n{err}", output.status);
    (out, err)
}

//! What a program says about how it was compiled, and the script that finds it out.

use std::{fs, path::Path, process::Command};

use crate::common::root;

/// The build script, compiled, and what it says in a folder.
struct Script {
    folder: tempfile::TempDir,
}

impl Script {
    fn new() -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let source = root().join("cli/build.rs");
        let compiled = Command::new(std::env::var("RUSTC").unwrap_or_else(|_| "rustc".to_owned()))
            .args(["--edition", "2024", "-o"])
            .arg(folder.path().join("script"))
            .arg(source)
            .status()
            .expect("rustc runs");
        assert!(compiled.success());
        fs::create_dir(folder.path().join("cli")).expect("a folder");
        fs::write(folder.path().join("cli/build.rs"), "").expect("a file");
        Self { folder }
    }

    fn cli(&self) -> std::path::PathBuf {
        self.folder.path().join("cli")
    }

    fn says(&self, variables: &[(&str, &str)]) -> String {
        let mut script = Command::new(self.folder.path().join("script"));
        script.current_dir(self.cli());
        script.env_remove("CTOS_REVISION");
        script.env_remove("SOURCE_DATE_EPOCH");
        script.env("GIT_CEILING_DIRECTORIES", Path::new("/"));
        script.envs(variables.iter().copied());
        let output = script.output().expect("the script runs");
        assert!(output.status.success());
        String::from_utf8(output.stdout).expect("text")
    }

    fn git(&self, arguments: &[&str]) -> bool {
        let mut git = Command::new("git");
        git.current_dir(self.cli()).args([
            "-c",
            "user.name=n",
            "-c",
            "user.email=e@e",
            "-c",
            "commit.gpgsign=false",
        ]);
        git.args(arguments)
            .output()
            .is_ok_and(|output| output.status.success())
    }
}

#[test]
fn dbx_tells_revision_and_time_of_compilation() {
    let output = Command::new(env!("CARGO_BIN_EXE_scott"))
        .args(["--local", "-c", "bar DBX -build"])
        .output()
        .expect("scott runs");
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(
        said.contains(", revision ") && said.contains(", compiled 20"),
        "{said}"
    );
    let said = said.split("compiled ").nth(1).expect("a time");
    let time: String = said
        .chars()
        .map(|letter| if letter.is_ascii_digit() { '0' } else { letter })
        .collect();
    assert!(
        time.trim_end()
            .trim_end_matches('"')
            .starts_with("0000-00-00T00:00:00Z"),
        "{time}"
    );
}

#[test]
fn the_revision_comes_from_the_environment_or_git_and_without_both_it_is_said_that_it_is_not_known()
{
    let script = Script::new();
    let none = script.says(&[]);
    assert!(none.contains("CTOS_BUILD_REVISION=not known"), "{none}");
    let none = script.says(&[("PATH", "")]);
    assert!(none.contains("CTOS_BUILD_REVISION=not known"), "{none}");
    let said = script.says(&[("CTOS_REVISION", "v7"), ("SOURCE_DATE_EPOCH", "1709210096")]);
    assert!(said.contains("CTOS_BUILD_REVISION=v7\n"), "{said}");
    // The 29th of February is a day too.
    assert!(
        said.contains("CTOS_BUILD_TIME=2024-02-29T12:34:56Z\n"),
        "{said}"
    );
    // The same twice, bit by bit.
    assert_eq!(
        said,
        script.says(&[("CTOS_REVISION", "v7"), ("SOURCE_DATE_EPOCH", "1709210096")])
    );
    let begun = script.git(&["init", "-q"]);
    if !begun || !script.git(&["add", "build.rs"]) || !script.git(&["commit", "-qm", "x"]) {
        // Not every machine has git.
        return;
    }
    let clean = script.says(&[]);
    let revision = |said: &str| {
        let line = said
            .lines()
            .find_map(|line| line.strip_prefix("cargo::rustc-env=CTOS_BUILD_REVISION="));
        line.expect("a revision").to_owned()
    };
    assert_eq!(revision(&clean).len(), 12, "{clean}");
    assert!(
        clean.contains("logs/HEAD"),
        "a commit has it run again: {clean}"
    );
    fs::write(script.cli().join("build.rs"), "// changed").expect("a file");
    assert_eq!(
        revision(&script.says(&[])),
        format!("{} with changes", revision(&clean))
    );
}

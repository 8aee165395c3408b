//! What the compiler says of a handler that does not fit its commands, and where.

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

const HANDLER: &str = "
ctos::command! {
    /// Counts.
    pub struct Count => u64, 1, \"count\"
}
pub struct Counter;
#[ctos::handler]
impl Counter {
    #[command]
    fn count(&mut self, _: Count) -> TYPE {
        TEXT
    }
}
";

/// The libraries beside this program, those called `name`, newest first: more than one may be there.
fn libraries(folder: &Path, name: &str) -> Vec<PathBuf> {
    let start = format!("lib{name}-");
    let mut found: Vec<_> = fs::read_dir(folder)
        .unwrap()
        .filter_map(|entry| {
            let entry = entry.ok()?;
            let file = entry.file_name().into_string().ok()?;
            let fits = file.starts_with(&start) && file.ends_with(".rlib");
            fits.then_some((entry.metadata().ok()?.modified().ok()?, entry.path()))
        })
        .collect();
    found.sort();
    found.into_iter().rev().map(|(_, path)| path).collect()
}

/// What the compiler says of a text.
fn compiled(text: &str) -> String {
    let program = std::env::current_exe().unwrap();
    let folder = program.parent().unwrap();
    let scratch = tempfile::tempdir().unwrap();
    let file = scratch.path().join("handler.rs");
    fs::write(&file, text).unwrap();
    let rustc = std::env::var_os("RUSTC").unwrap_or_else(|| "rustc".into());
    for library in libraries(folder, "ctos") {
        let output = Command::new(&rustc)
            .args([
                "--edition",
                "2024",
                "--crate-type",
                "lib",
                "--emit",
                "metadata",
            ])
            .arg("--extern")
            .arg(format!("ctos={}", library.display()))
            .arg("-L")
            .arg(format!("dependency={}", folder.display()))
            .arg("--out-dir")
            .arg(scratch.path())
            .arg(&file)
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        // One that another build has left behind.
        if !said.contains("can't find crate") && !said.contains("E0460") && !said.contains("E0514")
        {
            return said;
        }
    }
    panic!("no library to compile with in {}", folder.display());
}

#[test]
fn a_reply_of_the_wrong_type_is_shown_at_the_method_that_returns_it() {
    for (wrong, text) in [
        ("String", "String::new()"),
        (
            "Result<String, ctos::task::HandlerError>",
            "Ok(String::new())",
        ),
    ] {
        let handler = HANDLER.replace("TYPE", wrong).replace("TEXT", text);
        let said = compiled(&handler);
        assert!(said.contains("expected `u64`"), "{said}");
        let line = 1 + handler[..handler.find("fn count").unwrap()]
            .matches('\n')
            .count();
        let place = said.lines().find(|line| line.trim().starts_with("-->"));
        let shown = place.is_some_and(|place| place.contains(&format!("handler.rs:{line}:")));
        assert!(shown, "{said}");
    }
    let right = HANDLER.replace("TYPE", "u64").replace("TEXT", "1");
    assert_eq!(compiled(&right), "");
}

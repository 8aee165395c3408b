//! `ctos new`: a small app that runs, as files to start from.
//!
//! The files are those of `cli/examples/template`, `template_task` and `template_net`. The first two are compiled and
//! tested with the workspace, the third is run.

use std::{
    io,
    path::{Path, PathBuf},
};

use clap::Args;

use cli_common::{exit, show};

use crate::program;

/// Write a small app of your own: handlers, configuration, net, test, page
#[derive(Debug, Args)]
#[command(after_help = "Example:
  ctos new my-app
  cd my-app && cargo run -- boot app.toml
  ctos new --task my-task
  ctos new --python my-script
  ctos new --net my-net
  cd my-net && sh test.sh")]
pub struct NewArgs {
    /// Folder to make
    pub folder: PathBuf,
    /// A task for a robot instead: a net that has an arm pick up a box with the service objects of `configs/grasp.toml`
    #[arg(long)]
    pub task: bool,
    /// An app whose event handlers are programs in Python: nothing is compiled
    #[arg(long, conflicts_with_all = ["task", "path"])]
    pub python: bool,
    /// A net without a program instead: configuration, net, layout, and a test that tries the net with a stand-in
    #[arg(long, conflicts_with_all = ["task", "python", "path"])]
    pub net: bool,
    /// Folder of the CTOS workspace that the app is built with [default: the one this program was built in]
    #[arg(long, value_name = "FOLDER")]
    pub path: Option<PathBuf>,
    /// Say nothing when all is well
    #[arg(short, long)]
    pub quiet: bool,
}

/// Path and text of a file.
type File = (&'static str, &'static str);

/// The files of an app, with `my-app`, `my_app`, `CTOS/` and the folder of the template for what is filled in.
const APP: &[File] = &[
    (
        "Cargo.toml",
        include_str!("../../examples/template/Cargo.toml.in"),
    ),
    (".gitignore", IGNORED),
    (".cargo/config.toml", SHARED),
    (
        "README.md",
        include_str!("../../examples/template/README.md"),
    ),
    ("app.toml", include_str!("../../examples/template/app.toml")),
    ("sum.net", include_str!("../../examples/template/sum.net")),
    (
        "src/main.rs",
        include_str!("../../examples/template/src/main.rs"),
    ),
    (
        "src/handlers.rs",
        include_str!("../../examples/template/src/handlers.rs"),
    ),
    (
        "src/tests.rs",
        include_str!("../../examples/template/src/tests.rs"),
    ),
];

/// The files of a task, as above; `../../../` is the workspace, too.
const TASK: &[File] = &[
    (
        "Cargo.toml",
        include_str!("../../examples/template_task/Cargo.toml.in"),
    ),
    (".gitignore", IGNORED),
    (".cargo/config.toml", SHARED),
    (
        "README.md",
        include_str!("../../examples/template_task/README.md"),
    ),
    (
        "app.toml",
        include_str!("../../examples/template_task/app.toml"),
    ),
    (
        "object.toml",
        include_str!("../../examples/template_task/object.toml"),
    ),
    (
        "pick.net",
        include_str!("../../examples/template_task/pick.net"),
    ),
    (
        "src/main.rs",
        include_str!("../../examples/template_task/src/main.rs"),
    ),
    (
        "src/handlers.rs",
        include_str!("../../examples/template_task/src/handlers.rs"),
    ),
    (
        "src/tests.rs",
        include_str!("../../examples/template_task/src/tests.rs"),
    ),
];

/// The files of an app in Python, which are those of `configs/program.toml`, and a copy of the client.
const PYTHON: &[File] = &[
    (
        "README.md",
        include_str!("../../examples/template_python/README.md"),
    ),
    (".gitignore", "__pycache__/\n*.mcap\n"),
    ("app.toml", include_str!("../../../configs/program.toml")),
    (
        "programs/meter.py",
        include_str!("../../../configs/programs/meter.py"),
    ),
    (
        "programs/meter.toml",
        include_str!("../../../configs/programs/meter.toml"),
    ),
    (
        "programs/desk.py",
        include_str!("../../../configs/programs/desk.py"),
    ),
    (
        "ctos/__init__.py",
        include_str!("../../../clients/python/src/ctos/__init__.py"),
    ),
    (
        "ctos/py.typed",
        include_str!("../../../clients/python/src/ctos/py.typed"),
    ),
];

/// The files of a net, as above. They need no workspace.
const NET: &[File] = &[
    (
        "README.md",
        include_str!("../../examples/template_net/README.md"),
    ),
    (
        "app.toml",
        include_str!("../../examples/template_net/app.toml"),
    ),
    (
        "work.net",
        include_str!("../../examples/template_net/work.net"),
    ),
    (
        "work.layout.toml",
        include_str!("../../examples/template_net/work.layout.toml"),
    ),
    (
        "test.sh",
        include_str!("../../examples/template_net/test.sh"),
    ),
];

const IGNORED: &str = "/target\n";

/// Cargo's settings for an app.
const SHARED: &str =
    "# What the app and CTOS are both made of is built once, and lies in the target folder of CTOS.
[build]
target-dir = \"CTOS/target\"
";

/// Words that cannot name a package: of the language, of its libraries, or of what the app is built with.
const TAKEN: [&str; 10] = [
    "cli", "core", "crate", "ctos", "pnt", "self", "serde", "sorma", "std", "test",
];

/// Runs the command.
#[must_use]
pub fn run(args: &NewArgs) -> u8 {
    let name = match name(&args.folder) {
        Ok(name) => name,
        Err(reason) => {
            show::say(&format!("error: {reason}"));
            return exit::USAGE;
        }
    };
    if args.python {
        let files = PYTHON.iter();
        let files = files.map(|(path, text)| (*path, in_python(text, name)));
        let schema = ("ctos.schema.json", format!("{:#}\n", program::schema()));
        let written = write_all(&args.folder, files.chain([schema]));
        return told(args, written, "", "ctos boot app.toml");
    }
    if args.net {
        let written = write_net(&args.folder, name);
        let next = "sh test.sh\n  ctos boot app.toml -v";
        return told(args, written, "", next);
    }
    let built_in = Path::new(env!("CARGO_MANIFEST_DIR")).parent();
    let workspace = args.path.as_deref().or(built_in).unwrap_or(Path::new("."));
    let Some(workspace) = workspace
        .canonicalize()
        .ok()
        .filter(|folder| folder.join("ctos/Cargo.toml").is_file())
    else {
        show::say(&format!(
            "error: `{}` is not the CTOS workspace; say with --path where it is",
            workspace.display()
        ));
        return exit::FAILED;
    };
    let files = if args.task { TASK } else { APP };
    let written = write(&args.folder, name, &workspace, files);
    let next = "cargo test\n  cargo run -- boot app.toml";
    told(args, written, " (the first build takes some minutes)", next)
}

/// Says what was written and what comes next, or why nothing was.
fn told(args: &NewArgs, written: Result<(), (PathBuf, io::Error)>, note: &str, next: &str) -> u8 {
    match written {
        Ok(()) => {}
        Err((path, error)) if error.kind() == io::ErrorKind::AlreadyExists => {
            show::say(&format!(
                "error: `{}` is there already; nothing was written",
                path.display()
            ));
            return exit::FAILED;
        }
        Err((path, error)) => {
            show::say(&format!(
                "error: cannot write `{}`: {error}",
                path.display()
            ));
            return exit::FAILED;
        }
    }
    if !args.quiet {
        let folder = args.folder.display();
        show::say(&format!(
            "wrote {folder}; next{note}:\n  cd {folder}\n  {next}"
        ));
    }
    exit::OK
}

/// The app's name, from the folder's.
fn name(folder: &Path) -> Result<&str, String> {
    let name = folder.file_name().and_then(|name| name.to_str());
    let name = name.ok_or_else(|| format!("`{}` names no folder to make", folder.display()))?;
    let letter = |letter: char| letter.is_ascii_alphanumeric() || letter == '-' || letter == '_';
    let first = name.starts_with(|letter: char| letter.is_ascii_alphabetic());
    if !first || !name.chars().all(letter) || name.len() > 64 {
        return Err(format!(
            "`{name}` cannot be the name of an app: use letters, digits, `-` and `_`, beginning with a letter"
        ));
    }
    if TAKEN.contains(&name) {
        return Err(format!(
            "`{name}` cannot be the name of an app: it is taken"
        ));
    }
    Ok(name)
}

/// The text of a file for the app called `name`.
fn filled(text: &str, name: &str, workspace: &Path) -> String {
    // A path is a TOML string here: quotes and backslashes in it would end or change it.
    let workspace = workspace.display().to_string();
    let workspace = workspace.replace('\\', "\\\\").replace('"', "\\\"");
    text.replace("my-app", name)
        .replace("my_app", &name.replace('-', "_"))
        .replace("CTOS/", &format!("{workspace}/"))
        .replace("../../../", &format!("{workspace}/"))
        .replace("/examples/template/", "/")
        .replace("/examples/template_task/", "/")
}

/// The text of a file for the app in Python called `name`.
fn in_python(text: &str, name: &str) -> String {
    text.replace("my-app", name)
        .replace("name = \"program\"", &format!("name = \"{name}\""))
        .replace("scott program", &format!("scott {name}"))
        .replace(
            "cargo run --release -- boot configs/program.toml",
            "ctos boot app.toml",
        )
        .replace("../clients/python/src", ".")
}

/// How the workspace builds: its profiles, which stand last in its manifest.
fn profiles(manifest: &str) -> &str {
    let start = manifest.find("\n[profile.").map(|at| at + 1);
    start.and_then(|at| manifest.get(at..)).unwrap_or_default()
}

/// Writes all files into `folder`, which must not be there.
fn write(
    folder: &Path,
    name: &str,
    workspace: &Path,
    files: &[File],
) -> Result<(), (PathBuf, io::Error)> {
    let at = |path: &Path| {
        let path = path.to_owned();
        move |error| (path, error)
    };
    let schema = format!("{:#}\n", program::schema());
    let files = files.iter();
    let files = files.map(|(path, text)| (*path, filled(text, name, workspace)));
    // The versions that the workspace is tested with, and built with already.
    let read = |name: &str| {
        let path = workspace.join(name);
        std::fs::read_to_string(&path).map_err(at(&path))
    };
    let (lock, manifest) = (read("Cargo.lock")?, read("Cargo.toml")?);
    let more = [("ctos.schema.json", schema), ("Cargo.lock", lock)];
    let all = files.chain(more).map(|(path, mut text)| {
        if path == "Cargo.toml" {
            text.push_str(profiles(&manifest));
        }
        (path, text)
    });
    write_all(folder, all)
}

/// Writes these files into `folder`, which must not be there.
fn write_all(
    folder: &Path,
    files: impl Iterator<Item = (&'static str, String)>,
) -> Result<(), (PathBuf, io::Error)> {
    std::fs::create_dir(folder).map_err(|error| (folder.to_owned(), error))?;
    for (path, text) in files {
        let path = folder.join(path);
        let inner = path.parent().unwrap_or(folder);
        let written = std::fs::create_dir_all(inner).and_then(|()| std::fs::write(&path, text));
        written.map_err(|error| (path, error))?;
    }
    Ok(())
}

/// Writes the files of a net into `folder`, which must not be there.
fn write_net(folder: &Path, name: &str) -> Result<(), (PathBuf, io::Error)> {
    std::fs::create_dir(folder).map_err(|error| (folder.to_owned(), error))?;
    let schema = format!("{:#}\n", program::schema());
    let files = NET.iter();
    let files = files.map(|(path, text)| (*path, text.replace("my-app", name)));
    for (path, text) in files.chain([("ctos.schema.json", schema)]) {
        let path = folder.join(path);
        std::fs::write(&path, text).map_err(|error| (path, error))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_that_of_a_package_or_refused() {
        assert_eq!(name(Path::new("a/b/my-app_2")), Ok("my-app_2"));
        for bad in ["", "..", "a b", "1a", "é", "-a", "cli", "ctos", "a.b", "/"] {
            assert!(name(Path::new(bad)).is_err(), "{bad}");
        }
    }

    #[test]
    fn nothing_of_the_workspace_is_left_in_an_app_in_python() {
        for (path, text) in PYTHON {
            let text = in_python(text, "thing");
            for word in ["my-app", "../", "configs/", "cargo"] {
                assert!(!text.contains(word), "{path} holds {word}");
            }
        }
    }

    #[test]
    fn nothing_of_the_template_is_left_unfilled() {
        for (path, text) in APP.iter().chain(TASK).chain(NET) {
            let text = filled(text, "thing", Path::new("/w \"s\""));
            for word in ["my-app", "my_app", "CTOS/", "../", "{{", "template"] {
                assert!(!text.contains(word), "{path} holds {word}");
            }
        }
        let manifest = filled(APP[0].1, "thing", Path::new("/w \"s\\"));
        assert!(
            manifest.contains("path = \"/w \\\"s\\\\/cli\""),
            "{manifest}"
        );
    }
}

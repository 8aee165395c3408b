//! A configuration that goes to another host.

use super::*;

/// A folder with an app, an include beside it and one above it, and a data file.
fn app_on_disk(folder: &Path) -> PathBuf {
    let write = |name: &str, text: &str| {
        let path = folder.join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, text).unwrap();
    };
    write(
        "cell/app.toml",
        "include = [\"../common.toml\", \"./tasks.toml\"]\n[chassis.w]\n\
         [profile.sim.time]\nmode = \"virtual\"\n[profile.sim.task.a]\nargs.where = \"${NONE:-here}\"\n",
    );
    write("common.toml", "[app]\nseed = 8\n");
    write(
        "cell/tasks.toml",
        "[task.a]\nhandler = \"h\"\non = \"w\"\nargs.net = \"nets/a.net\"\n",
    );
    write("cell/nets/a.net", "net a\n");
    folder.join("cell/app.toml")
}

fn selected(file: PathBuf) -> Selection {
    Selection {
        file,
        profiles: vec!["sim".to_owned()],
        sets: vec!["task.a.queue=9".to_owned()],
    }
}

#[test]
fn a_bundle_holds_every_file_and_makes_the_same_app_elsewhere() {
    let here = tempfile::tempdir().unwrap();
    let app = selected(app_on_disk(here.path())).load(&[]).unwrap();
    let net = app.args_net();
    assert_eq!(app.read(&net).unwrap().text(), "net a\n");
    let bundle = app.clone().bundle().unwrap();
    let files: Vec<_> = bundle.files.keys().map(String::as_str).collect();
    assert_eq!(
        files,
        [
            "cell/app.toml",
            "cell/nets/a.net",
            "cell/tasks.toml",
            "common.toml"
        ]
    );
    assert_eq!(
        bundle.variables,
        BTreeMap::from([("NONE".to_owned(), None)])
    );

    let sent = postcard::to_stdvec(&bundle).unwrap();
    let bundle: Bundle = postcard::from_bytes(&sent).unwrap();
    let looked_at = bundle.load(&[]).unwrap();
    assert_eq!(summary(&looked_at), summary(&app));

    let there = tempfile::tempdir().unwrap();
    let selection = bundle.unpack(&there.path().join("run")).unwrap();
    let moved = selection.load(&[]).unwrap();
    assert_eq!(summary(&moved), summary(&app));
    assert_eq!(moved.folder, there.path().join("run/cell"));
    assert_eq!(moved.read(&net).unwrap().text(), "net a\n");
}

impl App {
    fn args_net(&self) -> String {
        let net = self.tasks[0].args.get("net").and_then(Node::as_str);
        net.unwrap().to_owned()
    }
}

#[test]
fn a_file_that_would_be_elsewhere_on_another_host_is_refused() {
    let here = tempfile::tempdir().unwrap();
    let file = app_on_disk(here.path());
    let absolute = here.path().join("common.toml");
    let app = selected(file.clone()).load(&[]).unwrap();
    app.read(&absolute).unwrap();
    let refused = app.bundle().unwrap_err().to_string();
    assert!(refused.contains("is an absolute path"), "{refused}");
    let text = std::fs::read_to_string(&file).unwrap();
    let text = text.replace("../common.toml", &absolute.display().to_string());
    std::fs::write(&file, text).unwrap();
    let app = selected(file).load(&[]).unwrap();
    let refused = app.bundle().unwrap_err().to_string();
    assert!(
        refused.contains("common.toml` is an absolute path"),
        "{refused}"
    );
}

#[test]
fn a_bundle_never_writes_outside_its_folder() {
    let good = Bundle {
        selection: Selection::new("a.toml"),
        files: BTreeMap::from([("a.toml".to_owned(), String::new())]),
        variables: BTreeMap::new(),
    };
    let folder = tempfile::tempdir().unwrap();
    let inside = folder.path().join("in");
    for path in ["../x", "/x", "", "a/../../x", ".."] {
        let mut bad = good.clone();
        bad.files.insert(path.to_owned(), "evil".to_owned());
        let refused = bad.unpack(&inside);
        assert!(matches!(refused, Err(BundleError::Path(_))), "{path}");
        assert!(!inside.exists(), "{path}: nothing was written");
    }
    let mut lost = good.clone();
    lost.selection.file = "b.toml".into();
    assert!(matches!(lost.unpack(&inside), Err(BundleError::Missing(_))));
    assert!(good.unpack(&inside).is_ok());
    std::fs::remove_file(inside.join("a.toml")).unwrap();
    std::fs::create_dir(inside.join("a.toml")).unwrap();
    assert!(matches!(good.unpack(&inside), Err(BundleError::Io { .. })));
}

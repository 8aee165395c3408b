//! Precedence, includes and `--set`.

use super::*;

#[test]
fn default_then_include_then_file_then_set() {
    let texts = [
        (
            "cell/app.toml",
            "include = [\"../common.toml\"]\n[chassis.ws1]\n[task.a]\nqueue = 7\n",
        ),
        (
            "common.toml",
            "[task.a]\nhandler = \"h\"\non = \"ws1\"\nqueue = 5\n[app]\nseed = 4\n[task.a.args]\nx = 1\ny = 2\n",
        ),
    ];
    let load = |sets: &[&str]| {
        let sets: Vec<String> = sets.iter().map(|set| (*set).to_owned()).collect();
        load_texts(&texts, &sets, &[]).unwrap()
    };
    let app = load(&[]);
    assert_eq!(app.tasks[0].queue, 7, "the file overrides what it includes");
    assert_eq!(app.seed, 4, "an include overrides the default");
    assert_eq!(
        app.stop_timeout,
        Duration::from_secs(5),
        "the default is left"
    );
    assert_eq!(app.folder, Path::new("cell"));
    let app = load(&[
        "task.a.queue=9",
        "seed=11",
        "task.a.args.y=3",
        "task.a.queue=10",
    ]);
    assert_eq!(app.tasks[0].queue, 10, "the last --set wins");
    assert_eq!(app.seed, 11);
    let args = &app.tasks[0].args;
    assert_eq!(
        args.get("x").and_then(Node::as_integer),
        Some(1),
        "the rest of the table is kept"
    );
    assert_eq!(args.get("y").and_then(Node::as_integer), Some(3));
    assert_eq!(
        app.locate("task.a.args.y").unwrap().to_string(),
        "--set:1:13"
    );
    assert_eq!(
        app.locate("task.a.args.x").unwrap().to_string(),
        "common.toml:8:1"
    );
    assert_eq!(app.tasks[0].place.to_string(), "common.toml:1:7");
}

#[test]
fn a_processor_stands_behind_a_slash_or_a_colon() {
    for on in ["w/fast", "w:fast"] {
        let text = format!(
            "[chassis.w]\nprocessors = {{ main = {{}}, fast = {{}} }}\n[task.a]\nhandler=\"h\"\non={on:?}\n"
        );
        let app = load_texts(&[("a.toml", &text)], &[], &[]).unwrap();
        assert_eq!(app.tasks[0].processor, "fast");
    }
}

#[test]
fn an_array_is_replaced_as_a_whole() {
    let texts = [
        (
            "a.toml",
            "include = [\"b.toml\"]\n[chassis.w]\n[task.a]\nhandler=\"h\"\non=\"w\"\nargs.list=[1]\n",
        ),
        ("b.toml", "[task.a.args]\nlist = [1, 2, 3]\n"),
    ];
    let app = load_texts(&texts, &[], &[]).unwrap();
    assert_eq!(app.tasks[0].args.get("list").unwrap().elements().len(), 1);
}

#[test]
fn a_file_included_twice_does_not_undo_what_another_include_says_on_top_of_it() {
    let texts = [
        (
            "a.toml",
            "include = [\"b.toml\", \"c.toml\"]\n[chassis.w]\n",
        ),
        ("b.toml", "include = [\"base.toml\"]\n[task.a]\nqueue = 2\n"),
        ("c.toml", "include = [\"base.toml\"]\n"),
        (
            "base.toml",
            "[task.a]\nhandler = \"h\"\non = \"w\"\nqueue = 1\n",
        ),
    ];
    assert_eq!(load_texts(&texts, &[], &[]).unwrap().tasks[0].queue, 2);
}

#[test]
fn files_on_disk_include_each_other_relative_to_themselves() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("cell")).unwrap();
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
    write("app.toml", "include = [\"cell/tasks.toml\"]\n[chassis.w]\n");
    write(
        "cell/tasks.toml",
        "include = [\"queue.toml\"]\n[task.a]\nhandler = \"h\"\non = \"w\"\n",
    );
    write("cell/queue.toml", "[task.a]\nqueue = 3\n");
    let file = folder.path().join("app.toml");
    let sets = ["time.mode=virtual".to_owned()];
    let app = load(&file, &sets, &[]).unwrap();
    assert_eq!((app.tasks[0].queue, app.time), (3, TimeMode::Virtual));
    assert_eq!(app.folder, folder.path());
    let again = load(&app.selection.file, &app.selection.sets, &[]).unwrap();
    assert_eq!(again, app, "file and sets make the same app again");

    write("cell/queue.toml", "include = [\"../cell/./tasks.toml\"]\n");
    let lines = refused(load(&file, &[], &[]));
    assert_eq!(lines.len(), 1);
    assert!(lines[0].contains("queue.toml:1:12: error: files include each other in a circle"));
}

#[test]
fn a_cyclic_include_is_refused_and_shows_the_chain() {
    let texts = [
        ("a.toml", "include = [\"b.toml\"]\n"),
        ("b.toml", "\ninclude = [\"c.toml\"]\n"),
        ("c.toml", "include = [\n  \"b.toml\"]\n"),
    ];
    let lines = refused(load_texts(&texts, &[], &[]));
    assert_eq!(
        lines,
        [
            "c.toml:2:3: error: files include each other in a circle: b.toml -> c.toml -> b.toml \
          (move what both need into a third file that includes neither)"
        ]
    );
    let own = refused(load_one("include = [\"app.toml\"]\n"));
    assert!(own[0].starts_with(
        "app.toml:1:12: error: files include each other in a circle: app.toml -> app.toml"
    ));
}

#[test]
fn an_include_that_is_not_there_or_not_a_list_of_paths_is_named_where_it_is_written() {
    let lines = refused(load_one("include = [\"gone.toml\"]\n"));
    assert!(
        lines[0].starts_with("app.toml:1:12: error: cannot read `gone.toml`"),
        "{lines:?}"
    );
    let lines = refused(load_one("include = \"x.toml\"\n"));
    assert_eq!(
        lines,
        [
            "app.toml:1:11: error: `include` is a list of paths, found a string (write include = [\"common.toml\"])"
        ]
    );
    let lines = refused(load_one("include = [\n3]\n"));
    assert!(lines[0].starts_with("app.toml:2:1: error: `include` is a list"));
}

#[test]
fn a_missing_main_file_is_a_finding() {
    let lines = refused(load(Path::new("no/such/app.toml"), &[], &[]));
    assert!(lines[0].starts_with("error: cannot read `no/such/app.toml`"));
}

#[test]
fn a_set_takes_toml_values_and_bare_words() {
    let args = |set: &str| {
        let app = load_set(CELL, &[set]).unwrap();
        app.task("mcs")
            .unwrap()
            .args
            .get("x")
            .unwrap()
            .value()
            .clone()
    };
    assert_eq!(args("task.mcs.args.x=3"), Value::Integer(3));
    assert_eq!(
        args("task.mcs.args.x = -0x10 ").clone(),
        args("task.mcs.args.x=-0x10")
    );
    assert_eq!(args("task.mcs.args.x=1e-3"), Value::Float(1e-3));
    assert_eq!(args("task.mcs.args.x=true"), Value::Bool(true));
    assert_eq!(
        args("task.mcs.args.x=word"),
        Value::String("word".to_owned())
    );
    assert_eq!(
        args("task.mcs.args.x=dir/file.csv"),
        Value::String("dir/file.csv".to_owned())
    );
    assert_eq!(
        args("task.mcs.args.x=127.0.0.1:80"),
        Value::String("127.0.0.1:80".to_owned())
    );
    assert_eq!(args("task.mcs.args.x=a=b"), Value::String("a=b".to_owned()));
    assert_eq!(args("task.mcs.args.x=\"\""), Value::String(String::new()));
    assert!(matches!(args("task.mcs.args.x=[1, 2]"), Value::Array(list) if list.len() == 2));
    assert!(matches!(args("task.mcs.args.x={ a = 1 }"), Value::Table(list) if list.len() == 1));
}

#[test]
fn a_set_may_add_a_whole_task_and_is_shorthand_for_app_keys() {
    let app = load_set(
        CELL,
        &[
            "task.extra={ handler = \"h\", on = \"ws1\" }",
            "until=extra",
        ],
    )
    .unwrap();
    assert_eq!(app.until.as_deref(), Some("extra"));
    assert_eq!(app.task("extra").unwrap().chassis, "ws1");
}

#[test]
fn a_wrong_set_is_an_error_that_points_into_the_set_text() {
    let cases = [
        (
            "app.sed=3",
            "--set:1:5: error: unknown key `sed` in [app] (did you mean `seed`?)",
        ),
        (
            "seeed=3",
            "--set:1:1: error: unknown key `seeed` at the top level (known here: app, barrier, chassis, control, host, include, injure, metrics, profile, record, security, semaphore, task, time, zenoh)",
        ),
        (
            "task.msc.queue=3",
            "--set:1:6: error: there is no task called `msc` (did you mean `mcs`?)",
        ),
        (
            "chassis.ws2.stop_first=true",
            "--set:1:9: error: there is no chassis called `ws2` (did you mean `ws1`?)",
        ),
        (
            "task.mcs.queue=0",
            "--set:1:16: error: task `mcs`: `queue` must be a whole number from 1 to 65536, found 0",
        ),
        (
            "task.mcs.on=cage_motion/x",
            "--set:1:13: error: chassis `cage_motion` has no processor `x` (known here: main, servo)",
        ),
        (
            "time.mode=fast",
            "--set:1:11: error: [time]: unknown choice `fast` for `mode` (known here: real, virtual)",
        ),
        (
            "seed",
            "--set:1:1: error: `--set seed`: there is no `=` (write --set path.to.key=value, for example --set time.mode=virtual)",
        ),
        (
            "seed=",
            "--set:1:1: error: `--set seed=`: the value is missing (an empty text is \"\") (write --set path.to.key=value, for example --set time.mode=virtual)",
        ),
        (
            "a b=1",
            "--set:1:1: error: `--set a b=1`: the part before `=` is not a key (write --set path.to.key=value, for example --set time.mode=virtual)",
        ),
        (
            "include=[]",
            "--set:1:1: error: `--set include=[]`: `include` cannot be set from outside the files (write --set path.to.key=value, for example --set time.mode=virtual)",
        ),
    ];
    for (set, expected) in cases {
        assert_eq!(
            refused(load_set(CELL, &[set])),
            [expected],
            "for --set {set}"
        );
    }
    let broken = refused(load_set(CELL, &["task.mcs.args.x=[1, 2"]));
    assert!(
        broken[0].starts_with("--set:1:22: error: this is not valid TOML"),
        "{broken:?}"
    );
}

proptest! {
    #[test]
    fn a_later_source_always_wins(default_or in prop::option::of(0_u64..100), file in prop::option::of(0_u64..100), set in prop::option::of(0_u64..100)) {
        let line = |seed: Option<u64>| seed.map_or(String::new(), |seed| format!("[app]\nseed = {seed}\n"));
        let main = format!("include = [\"i.toml\"]\n[chassis.w]\n[task.a]\nhandler = \"h\"\non = \"w\"\n{}", line(file));
        let sets: Vec<String> = set.iter().map(|seed| format!("app.seed={seed}")).collect();
        let app = load_texts(&[("m.toml", &main), ("i.toml", &line(default_or))], &sets, &[]).unwrap();
        prop_assert_eq!(app.seed, set.or(file).or(default_or).unwrap_or(1));
    }
}

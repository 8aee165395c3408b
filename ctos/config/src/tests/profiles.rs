//! Profiles: what they change, who chooses them, and what is refused.

use super::*;

const APP: &str = r#"include = ["base.toml"]
[app]
seed = 2
[chassis.w]
[task.a]
handler = "h"
on = "w"
queue = 2
[profile.sim.time]
mode = "virtual"
[profile.sim.task.a]
queue = 3
[profile.sim.task.lamp]
handler = "sim.lamp"
on = "w"
[profile.fast.app]
seed = 4
[profile.fast.task.a]
queue = 4
"#;
const BASE: &str = "[profile.sim.task.a]\nqueue = 99\nargs.x = 1\n";

fn chosen(app: &str, profiles: &[&str], sets: &[&str]) -> Result<App, Findings> {
    let owned = |list: &[&str]| list.iter().map(|one| (*one).to_owned()).collect();
    let selection = Selection {
        file: "app.toml".into(),
        profiles: owned(profiles),
        sets: owned(sets),
    };
    let texts = [("app.toml", app), ("base.toml", BASE)];
    selection.load_texts(&texts, &BTreeMap::new(), &[])
}

fn numbers(app: &App) -> (usize, u64, TimeMode, usize) {
    (app.tasks[0].queue, app.seed, app.time, app.tasks.len())
}

#[test]
fn a_profile_lies_between_the_file_and_set_and_later_ones_lie_on_top() {
    let app = |profiles: &[&str], sets: &[&str]| chosen(APP, profiles, sets).unwrap();
    assert_eq!(numbers(&app(&[], &[])), (2, 2, TimeMode::Real, 1));
    let sim = app(&["sim"], &[]);
    assert_eq!(
        numbers(&sim),
        (3, 2, TimeMode::Virtual, 2),
        "a profile may add tasks; what the file says of it overrides what the include says"
    );
    assert_eq!(
        sim.tasks[0].args.get("x").and_then(Node::as_integer),
        Some(1),
        "a profile of an included file is merged with its namesake"
    );
    assert_eq!(
        numbers(&app(&["sim", "fast"], &[])),
        (4, 4, TimeMode::Virtual, 2)
    );
    assert_eq!(numbers(&app(&["fast", "sim"], &[])).0, 3);
    assert_eq!(numbers(&app(&["sim"], &["task.a.queue=7"])).0, 7);
    assert_eq!(sim.selection.profiles, ["sim"]);
}

#[test]
fn the_file_chooses_a_profile_unless_the_command_line_does() {
    let text = APP.replace("seed = 2", "profile = \"fast\"");
    assert_eq!(
        chosen(&text, &[], &[]).unwrap().selection.profiles,
        ["fast"]
    );
    assert_eq!(
        chosen(&text, &["sim"], &[]).unwrap().selection.profiles,
        ["sim"]
    );
}

#[test]
fn what_an_app_says_of_itself_makes_the_same_app_again() {
    let text = APP.replace("seed = 2", "profile = \"fast\"");
    for profiles in [&[][..], &["sim"], &["sim", "fast"]] {
        let app = chosen(&text, profiles, &["seed=9"]).unwrap();
        let texts = [("app.toml", text.as_str()), ("base.toml", BASE)];
        let again = app.selection.load_texts(&texts, &BTreeMap::new(), &[]);
        assert_eq!(again.unwrap(), app);
    }
}

#[test]
fn an_unknown_profile_is_an_error_where_it_is_chosen_with_the_nearest_name() {
    assert_eq!(
        refused(chosen(APP, &["sin"], &[])),
        ["--profile:1:1: error: there is no profile `sin` (did you mean `sim`?)"]
    );
    let text = APP.replace("seed = 2", "profile = \"fats\"");
    assert_eq!(
        refused(chosen(&text, &[], &[])),
        ["app.toml:3:11: error: there is no profile `fats` (did you mean `fast`?)"]
    );
    assert_eq!(
        refused(load_one("[app]\nprofile = \"x\"\n")),
        ["app.toml:2:11: error: there is no profile `x` (declare it: [profile.x.app])"]
    );
}

#[test]
fn what_no_profile_can_hold_is_refused_at_its_key() {
    let refuse = |line: &str| {
        let text = format!("[chassis.w]\n[task.a]\nhandler = \"h\"\non = \"w\"\n{line}\n");
        refused(load_one(&text)).join("\n")
    };
    let cases = [
        (
            "[profile]\nsim = 3",
            "app.toml:6:7: error: profile `sim` holds tables of the app, found an integer (write for example [profile.sim.time])",
        ),
        (
            "[profile.sim]\ninclude = [\"a.toml\"]",
            "app.toml:6:1: error: a profile cannot include files (write `include` at the top of the file; files may hold profiles too)",
        ),
        (
            "[profile.sim.app]\nprofile = \"x\"",
            "app.toml:6:1: error: a profile cannot choose a profile (choose several with --profile A --profile B; the later ones lie on top)",
        ),
        (
            "[profile.sim.profile.x.app]\nseed = 1",
            "app.toml:5:14: error: a profile cannot hold profiles (choose several with --profile A --profile B; the later ones lie on top)",
        ),
        (
            "[profile.\"a b\".app]\nseed = 1",
            "app.toml:5:10: error: `a b` cannot be the name of a profile (names are 1 to 64 letters, digits, `_`, `-` or `.`)",
        ),
    ];
    for (line, expected) in cases {
        assert_eq!(refuse(line), expected, "for {line}");
    }
    assert_eq!(
        refused(load_one("profile = 3\n")),
        [
            "app.toml:1:11: error: `profile` holds named tables, found an integer (write [profile.NAME]; app.profile chooses one)"
        ]
    );
}

#[test]
fn a_typing_error_in_a_profile_is_found_whether_it_is_chosen_or_not() {
    let text = APP
        .replace("mode = \"virtual\"", "mod = \"virtual\"")
        .replace("queue = 4", "queue = 0")
        .replace("[profile.fast.app]", "[profile.fast.ap]");
    let lines = refused(chosen(&text, &[], &[]));
    let expected = [
        "app.toml:10:1: error: unknown key `mod` in [time] (did you mean `mode`?)",
        "app.toml:16:15: error: unknown key `ap` at the top level (did you mean `app`?)",
        "app.toml:19:9: error: task `a`: `queue` must be a whole number from 1 to 65536, found 0",
    ];
    assert_eq!(lines, expected);
    assert_eq!(refused(chosen(&text, &["sim", "fast"], &[])), expected);
}

#[test]
fn a_profile_may_need_another_one_but_not_change_a_task_that_is_nowhere() {
    let text = format!("{APP}[profile.dim.task.lamp]\nargs.grey = 3\n");
    assert!(chosen(&text, &["sim", "dim"], &[]).is_ok());
    assert!(chosen(&text, &[], &[]).is_ok(), "it is not chosen");
    assert_eq!(
        refused(chosen(&text, &["dim"], &[]))[0],
        "app.toml:20:19: error: profile `dim` changes a task `lamp`, which does not exist (known here: a)"
    );
}

#[test]
fn a_profile_is_not_chosen_or_changed_by_set() {
    for set in ["app.profile=sim", "profile=sim", "profile.sim.app.seed=3"] {
        let lines = refused(chosen(APP, &[], &[set]));
        assert!(
            lines[0].contains("profiles are chosen before `--set` is read (write --profile NAME"),
            "{lines:?}"
        );
    }
}

#[test]
fn every_value_knows_which_layer_it_comes_from() {
    let app = chosen(APP, &["sim"], &["seed=5"]).unwrap();
    let origin = |path: &str| app.origin(app.root().get(path).unwrap());
    let shown = |path: &str| match origin(path) {
        Origin::Default => "default".to_owned(),
        Origin::File(place) => place.to_string(),
        Origin::Profile { name, place } => format!("{name} {place}"),
        Origin::Set(place) => place.to_string(),
    };
    assert_eq!(shown("app.seed"), "--set:1:6");
    assert_eq!(shown("task.a.on"), "app.toml:7:6");
    assert_eq!(shown("task.a.queue"), "sim app.toml:12:9");
    assert_eq!(shown("task.a.args.x"), "sim base.toml:3:10");
}

proptest! {
    #[test]
    fn the_last_layer_that_says_something_wins(
        layers in prop::collection::vec(prop::option::of(0_u64..100), 5),
    ) {
        let [include, file, first, second, set] = layers.as_slice() else { unreachable!() };
        let line = |table: &str, seed: &Option<u64>| {
            seed.map_or(String::new(), |seed| format!("[{table}]\nseed = {seed}\n"))
        };
        let main = format!(
            "include = [\"i.toml\"]\n[chassis.w]\n[task.a]\nhandler = \"h\"\non = \"w\"\n\
             [profile.one]\n[profile.two]\n{}{}{}",
            line("app", file), line("profile.one.app", first), line("profile.two.app", second),
        );
        let selection = Selection {
            file: "m.toml".into(),
            profiles: vec!["one".to_owned(), "two".to_owned()],
            sets: set.iter().map(|seed| format!("app.seed={seed}")).collect(),
        };
        let texts = [("m.toml", main.as_str()), ("i.toml", &line("app", include))];
        let app = selection.load_texts(&texts, &BTreeMap::new(), &[]).unwrap();
        let last = layers.iter().rev().find_map(|seed| *seed);
        prop_assert_eq!(app.seed, last.unwrap_or(1));
    }
}

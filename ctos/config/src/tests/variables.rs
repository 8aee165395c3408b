//! `${NAME}` in strings.

use super::*;
use crate::load::Files;
use crate::variables::Variables;

const APP: &str = "[chassis.w]\n[task.a]\nhandler = \"h\"\non = \"w\"\n";

fn with(text: &str, variables: &[(&str, &str)]) -> Result<App, Findings> {
    let variables = variables
        .iter()
        .map(|(name, value)| ((*name).to_owned(), (*value).to_owned()))
        .collect();
    Selection::new("app.toml").load_texts(&[("app.toml", text)], &variables, &[])
}

fn port(value: &str, variables: &[(&str, &str)]) -> Result<String, Vec<String>> {
    let text = format!("{APP}args.port = {value}\n");
    match with(&text, variables) {
        Ok(app) => {
            let port = app.tasks[0].args.get("port").and_then(Node::as_str);
            Ok(port.unwrap().to_owned())
        }
        Err(findings) => Err(refused(Err(findings))),
    }
}

#[test]
fn a_reference_becomes_the_value_its_default_or_a_literal_text() {
    let set = [("PORT", "/dev/ttyS0"), ("EMPTY", ""), ("N_1", "é")];
    let cases = [
        ("\"${PORT}\"", "/dev/ttyS0"),
        ("'${PORT}:${N_1}x'", "/dev/ttyS0:éx"),
        ("\"${PORT:-/dev/null}\"", "/dev/ttyS0"),
        ("\"${NONE:-/dev/null}\"", "/dev/null"),
        ("\"${NONE:-}\"", ""),
        ("\"${NONE:-a:-b}\"", "a:-b"),
        ("\"${EMPTY:-x}\"", "x"),
        ("\"<${EMPTY}>\"", "<>"),
        ("\"$${PORT}\"", "${PORT}"),
        ("\"$$${PORT}\"", "$${PORT}"),
        ("\"$PORT $ 5$\"", "$PORT $ 5$"),
        ("\"{PORT}\"", "{PORT}"),
    ];
    for (value, expected) in cases {
        assert_eq!(port(value, &set), Ok(expected.to_owned()), "for {value}");
    }
    assert_eq!(
        port("\"${PORT}\"", &[("PORT", "${X} $${Y}")]),
        Ok("${X} $${Y}".to_owned()),
        "what a variable holds is not looked at again"
    );
}

#[test]
fn a_variable_that_is_not_set_is_an_error_at_its_reference() {
    assert_eq!(
        port("\"tcp/${HOST}:${PORT}\"", &[("PORT", "1")]),
        Err(vec![
            "app.toml:5:18: error: the environment variable `HOST` is not set (set it, or write what holds without it: ${HOST:-...})"
                .to_owned()
        ])
    );
    assert_eq!(
        port("\"${A}${B}\"", &[]).unwrap_err().len(),
        2,
        "all of them at once"
    );
}

#[test]
fn a_reference_that_is_none_is_an_error_at_its_place() {
    for value in [
        "\"x${PORT\"",
        "\"x${}\"",
        "\"x${1A}\"",
        "\"x${A-B}\"",
        "\"x${A B}\"",
        "\"x${:-d}\"",
    ] {
        let lines = port(value, &[("A", "a")]).unwrap_err();
        assert!(
            lines.len() == 1
                && lines[0].starts_with("app.toml:5:15: error: `${")
                && lines[0].contains("is no reference to an environment variable (write ${NAME}"),
            "{value}: {lines:?}"
        );
    }
}

#[test]
fn only_what_counts_in_the_end_needs_its_variable() {
    let text = format!(
        "{APP}args.port = \"${{PORT}}\"\n[profile.real.task.a]\nargs.port = \"${{REAL}}\"\n"
    );
    let load = |profiles: &[&str], sets: &[&str]| {
        let owned = |list: &[&str]| list.iter().map(|one| (*one).to_owned()).collect();
        let selection = Selection {
            file: "app.toml".into(),
            profiles: owned(profiles),
            sets: owned(sets),
        };
        selection.load_texts(&[("app.toml", &text)], &BTreeMap::new(), &[])
    };
    assert!(load(&[], &["task.a.args.port=x"]).is_ok());
    assert!(refused(load(&[], &[]))[0].contains("`PORT` is not set"));
    assert!(refused(load(&["real"], &[]))[0].contains("`REAL` is not set"));
    let set = load(&[], &["task.a.args.port='${X}'"]).unwrap();
    assert_eq!(
        set.tasks[0].args.get("port").and_then(Node::as_str),
        Some("${X}"),
        "the shell has expanded what stands in --set"
    );
}

#[test]
fn an_include_and_the_choice_of_a_profile_may_name_variables() {
    let text = format!(
        "include = [\"${{CELL}}.toml\"]\n[app]\nprofile = \"${{HOW:-sim}}\"\n{APP}\
         [profile.sim.app]\nseed = 5\n[profile.real.app]\nseed = 6\n"
    );
    let load = |variables: &[(&str, &str)]| {
        let variables = variables
            .iter()
            .map(|(name, value)| ((*name).to_owned(), (*value).to_owned()))
            .collect();
        let texts = [
            ("app.toml", text.as_str()),
            ("north.toml", "[task.a]\nqueue = 9\n"),
        ];
        Selection::new("app.toml").load_texts(&texts, &variables, &[])
    };
    let app = load(&[("CELL", "north")]).unwrap();
    assert_eq!((app.seed, app.tasks[0].queue), (5, 9));
    assert_eq!(load(&[("CELL", "north"), ("HOW", "real")]).unwrap().seed, 6);
    assert!(
        refused(load(&[]))[0].starts_with("app.toml:1:13: error: the environment variable `CELL`")
    );
}

#[test]
fn the_environment_of_the_process_is_asked_for_what_a_file_names() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("app.toml");
    std::fs::write(&file, format!("{APP}args.path = \"${{PATH}}\"\n")).unwrap();
    let app = Selection::new(&file).load(&[]).unwrap();
    let path = app.tasks[0].args.get("path").and_then(Node::as_str);
    assert_eq!(path.map(str::to_owned), std::env::var("PATH").ok());
}

proptest! {
    #[test]
    fn any_text_can_be_escaped(text in "[$}{A:-]{0,12}|.{0,20}") {
        let mut findings = Findings::new();
        let none = BTreeMap::new();
        let files = Files::Texts(&[], &none);
        let escaped = text.replace("${", "$${");
        let back = Variables::of(files).expanded(&escaped, None, &mut findings);
        prop_assert_eq!(back, Some(text));
        prop_assert!(findings.is_empty());
    }
}

//! The merged configuration as a file.

use std::collections::BTreeMap;

use ctos::{
    config::{App, Entry, Expander, GeneratedTask, Node, Origin, Selection, Value, load_texts},
    diagnostic::Findings,
};
use proptest::prelude::*;

use super::shown::{toml, toml_of, values};

const CELL: &str = r#"[app]
until = "operator"

[chassis.ws1]

[chassis.cage_motion]
stop_first = true
processors.servo = { realtime = true, priority = 80, cpu = 1 }
processors.main = {}

[task.operator]
handler = "cell.operator"
on = "ws1"

[task.mcs]
handler = "mcs.client"
on = "cage_motion/main"
queue = 16
restart = "always"
call_deadline_s = 2.5

[task.mcs.args]
speed = 0.5
"#;

fn load_one(text: &str) -> Result<App, Findings> {
    load_texts(&[("app.toml", text)], &[], &[])
}

fn sim() -> App {
    let text = format!(
        "{CELL}[profile.sim.task.mcs]\nqueue = 3\n[task.operator.args]\nlist = [{{ a.b = 1 }}, {{}}]\n\"odd key\" = \"$${{X}} \\\" \\\\ \\n\"\n"
    );
    let selection = Selection {
        file: "app.toml".into(),
        profiles: vec!["sim".to_owned()],
        sets: vec!["seed=7".to_owned()],
    };
    let texts = [("app.toml", text.as_str())];
    selection.load_texts(&texts, &BTreeMap::new(), &[]).unwrap()
}

/// The comment of the line that begins with `start`, in the table of that header.
fn comment(text: &str, header: &str, start: &str) -> String {
    let table = text.split(&format!("\n{header}")).nth(1);
    let line = table.and_then(|table| table.lines().find(|line| line.starts_with(start)));
    let line = line.unwrap_or_else(|| panic!("no {header} {start} in\n{text}"));
    line.split_once("# ").unwrap().1.to_owned()
}

#[test]
fn each_value_is_shown_with_where_it_comes_from() {
    let text = toml(&sim());
    assert_eq!(
        text.lines().next(),
        Some("# app.toml --profile sim --set seed=7")
    );
    let cases = [
        ("[app]", "seed = 7", "--set"),
        ("[app]", "until = \"operator\"", "app.toml:2"),
        ("[app]", "name = \"app\"", "default"),
        ("[app]", "stop_timeout_s = 5.0", "default"),
        ("[time]", "mode = \"real\"", "default"),
        ("[chassis.ws1]", "stop_first = false", "default"),
        (
            "[chassis.ws1.processors.main]",
            "realtime = false",
            "default",
        ),
        (
            "[chassis.cage_motion.processors.servo]",
            "cpu = 1",
            "app.toml:8",
        ),
        ("[task.mcs]", "queue = 3", "profile sim, app.toml:25"),
        ("[task.mcs]", "handler = \"mcs.client\"", "app.toml:16"),
        ("[task.mcs.args]", "speed = 0.5", "app.toml:23"),
    ];
    for (header, start, origin) in cases {
        assert_eq!(comment(&text, header, start), origin, "{header} {start}");
    }
}

struct Services;

impl Expander for Services {
    fn expand(&self, table: &Node, _: &mut Findings) -> Vec<GeneratedTask> {
        let named = table.get("services").map_or(&[][..], Node::elements).iter();
        let task = |element: &Node| {
            let name = element.as_str()?;
            Some(GeneratedTask {
                name: name.to_owned(),
                handler: format!("vss.{name}"),
                on: "ws1".to_owned(),
                args: Node::table(),
                place: element.place()?.clone(),
            })
        };
        named.filter_map(task).collect()
    }
}

#[test]
fn tasks_that_a_table_makes_are_told_as_comments() {
    let text = format!("{CELL}[vss]\nservices = [\"spot\"]\n");
    let app = load_texts(&[("app.toml", &text)], &[], &[("vss", &Services)]).unwrap();
    let shown = toml(&app);
    assert!(
        shown.ends_with("\n# Made from these tables:\n# task spot: vss.spot on ws1/main\n"),
        "{shown}"
    );
    assert!(!toml(&sim()).contains("# Made from"));
}

#[test]
fn what_is_shown_makes_the_same_app_by_itself() {
    let app = sim();
    let text = toml(&app);
    let again = load_texts(&[("shown.toml", &text)], &[], &[]).unwrap();
    assert!(again.warnings.is_empty(), "{}", again.warnings);
    let tasks = |app: &App| {
        let each = app.tasks.iter().map(|task| {
            let args = serde_json::Value::from(&task.args);
            let place = (task.chassis.clone(), task.processor.clone());
            (
                task.name.clone(),
                task.handler.clone(),
                place,
                task.queue,
                args,
            )
        });
        each.collect::<Vec<_>>()
    };
    assert_eq!(tasks(&again), tasks(&app));
    let all = |app: &App| {
        let each = values(app).into_iter();
        let each = each.map(|shown| (shown.path, serde_json::Value::from(shown.value)));
        each.collect::<Vec<_>>()
    };
    let (mut one, mut other) = (all(&again), all(&app));
    one.sort_by(|one, other| one.0.cmp(&other.0));
    other.sort_by(|one, other| one.0.cmp(&other.0));
    assert_eq!(one, other);
}

#[test]
fn the_list_of_values_has_every_value_once_with_its_path() {
    let app = sim();
    let values = values(&app);
    let of = |path: &str| {
        let mut found = values.iter().filter(|shown| shown.path == path);
        let value = found.next().unwrap_or_else(|| panic!("no {path}"));
        assert!(found.next().is_none(), "{path} twice");
        (serde_json::Value::from(value.value), value.origin.clone())
    };
    assert_eq!(of("task.mcs.queue").0, 3);
    assert_eq!(of("task.operator.queue"), (64.into(), Origin::Default));
    assert_eq!(of("task.operator.args.\"odd key\"").0, "${X} \" \\ \n");
    assert!(matches!(of("app.seed"), (seed, Origin::Set(_)) if seed == 7));
}

fn value() -> impl Strategy<Value = Node> {
    let scalar = prop_oneof![
        ".{0,12}".prop_map(Node::from),
        "[${}\"'\\\\#\n\r\t\u{1}\u{7f}]{0,8}".prop_map(Node::from),
        any::<i64>().prop_map(Node::from),
        any::<u64>().prop_map(Node::from),
        any::<f64>().prop_map(Node::from),
        any::<bool>().prop_map(Node::from),
    ];
    scalar.prop_recursive(3, 24, 4, |inner| {
        let entry = (".{0,6}", inner.clone());
        prop_oneof![
            prop::collection::vec(inner, 0..4)
                .prop_map(|elements| Node::from(Value::Array(elements))),
            prop::collection::vec(entry, 0..4).prop_map(|entries| {
                let each = entries.into_iter();
                each.fold(Node::table(), |table, (key, value)| table.with(key, value))
            }),
        ]
    })
}

/// The same without places, and with every NaN alike.
fn bare(node: &Node) -> Node {
    Node::from(match node.value() {
        Value::Float(number) if number.is_nan() => Value::String("nan".to_owned()),
        Value::Array(elements) => Value::Array(elements.iter().map(bare).collect()),
        Value::Table(entries) => {
            let each = entries.iter().map(|entry| Entry {
                key: entry.key.clone(),
                key_place: None,
                value: bare(&entry.value),
            });
            let mut entries: Vec<_> = each.collect();
            entries.sort_by(|one, other| one.key.cmp(&other.key));
            Value::Table(entries)
        }
        other => other.clone(),
    })
}

proptest! {
    #[test]
    fn any_arguments_are_shown_so_that_they_read_back_the_same(args in prop::collection::vec((".{0,6}", value()), 0..4)) {
        let args = args.into_iter().fold(Node::table(), |table, (key, value)| table.with(key, value));
        let app = load_one("[chassis.w]\n[task.a]\nhandler = \"h\"\non = \"w\"\n").unwrap();
        let task = Node::table().with("handler", "h").with("on", "w").with("args", args.clone());
        let root = app.root().clone().with("task", Node::table().with("a", task));
        let text = toml_of(&app, &root);
        let again = load_one(&text).map_err(|findings| TestCaseError::fail(format!("{findings}\n{text}")))?;
        prop_assert_eq!(bare(&again.tasks[0].args), bare(&args), "{}", text);
    }
}

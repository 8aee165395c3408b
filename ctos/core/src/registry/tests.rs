//! What the check of an app says of handlers by themselves, and of tasks that wait for each other.

use super::*;
use ctos_config::load_texts;

fn info(code: u16, name: &'static str) -> CommandInfo {
    CommandInfo {
        code,
        name,
        doc: "",
        ..crate::system::Ping::INFO
    }
}

struct Idle;

impl EventHandler for Idle {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }
}

fn found(registry: &Registry, tasks: &str) -> Vec<String> {
    let text = format!("[chassis.w]\n{tasks}");
    let app = load_texts(&[("app.toml", text.as_str())], &[], &[]).unwrap();
    let findings = registry.check(&app).into_sorted();
    findings.iter().map(ToString::to_string).collect()
}

#[test]
fn a_handler_whose_commands_cannot_be_told_apart_is_refused_once_where_a_task_names_it() {
    let mut registry = Registry::new();
    let commands = [
        info(1, "greet"),
        info(2, "count"),
        info(1, "part"),
        info(0xff00, "ping"),
        info(0xfeff, "last"),
    ];
    registry.handler("h", &commands, |_| Ok(Idle));
    registry.handler("unused", &[info(3, "a"), info(3, "b")], |_| Ok(Idle));
    let tasks = "[task.a]\nhandler = \"h\"\non = \"w\"\n[task.b]\nhandler = \"h\"\non = \"w\"\n";
    assert_eq!(
        found(&registry, tasks),
        [
            "app.toml:3:11: error: the event handler `h` takes two commands with the code 0x0001, `greet` and `part` (give each command of a handler a code of its own)",
            "app.toml:3:11: error: the command `ping` of the event handler `h` has the code 0xff00, which belongs to the runtime (choose a code below 0xff00)",
        ]
    );
}

#[test]
fn tasks_that_wait_for_each_other_in_their_startup_are_refused_with_the_circle() {
    let mut registry = Registry::new();
    let kind = registry.handler("h", &[], |_| Ok(Idle));
    kind.keys(&["waits_for"]).waits_for(|task| {
        let on = task.args.get("waits_for").and_then(|on| on.as_str());
        on.map(str::to_owned).into_iter().collect()
    });
    let task = |name: &str, waits_for: &str| {
        format!("[task.{name}]\nhandler = \"h\"\non = \"w\"\nargs.waits_for = \"{waits_for}\"\n")
    };
    let circle = [
        task("a", "b"),
        task("b", "c"),
        task("c", "b"),
        task("d", "d"),
    ]
    .concat();
    assert_eq!(
        found(&registry, &circle),
        [
            "app.toml:6:7: error: task `b` waits in its startup for `c`, which waits for `b` (let one of them ask in the phase `run` without waiting there, or when it is called)",
            "app.toml:14:7: error: task `d` waits in its startup for `d` (let one of them ask in the phase `run` without waiting there, or when it is called)",
        ]
    );
    let line = [task("a", "b"), task("b", "c"), task("c", "nobody")].concat();
    assert_eq!(found(&registry, &line), Vec::<String>::new());
}

#[derive(serde::Deserialize)]
struct Pace {
    #[serde(rename = "speed")]
    _speed: f64,
    #[serde(rename = "every_s", default)]
    _every: std::time::Duration,
}

#[test]
fn arguments_that_no_handler_reads_are_found_with_the_name_that_was_meant() {
    let mut registry = Registry::new();
    registry.handler("paced", &[], |_| Ok(Idle)).args::<Pace>();
    registry.handler("plain", &[], |_| Ok(Idle));
    let task = |handler: &str, args: &str| {
        let table = format!("[task.a]\nhandler = \"{handler}\"\non = \"w\"\n");
        found(&registry, &format!("{table}args = {{ {args} }}\n"))
    };
    assert_eq!(task("paced", "speed = 1, every_s = 0.5"), [""; 0]);
    assert_eq!(task("plain", ""), [""; 0]);
    assert_eq!(
        task("paced", "speeed = 3, speed = 1"),
        ["app.toml:5:10: error: unknown key `speeed` (did you mean `speed`?)"]
    );
    // All of them in one pass.
    assert_eq!(
        task("paced", "sped = 1, every_s = -1, often = 2"),
        [
            "app.toml:5:1: error: the key `speed` is missing (add `speed = ...`)",
            "app.toml:5:10: error: unknown key `sped` (did you mean `speed`?)",
            "app.toml:5:30: error: `every_s`: -1 s is no time (give a number of seconds, 0 or more)",
            "app.toml:5:34: error: unknown key `often` (known here: every_s, speed)",
        ]
    );
    assert_eq!(
        task("paced", "speed = 1, every_s = -1"),
        ["app.toml:5:31: error: `every_s`: -1 s is no time (give a number of seconds, 0 or more)"]
    );
    assert_eq!(
        task("plain", "speed = 3"),
        [
            "app.toml:5:10: error: task `a` gives `args.speed`, and its event handler `plain` declares no arguments (leave it out; or declare what the handler reads where it is registered: `registry.handler(..).args::<ItsArgs>()`)"
        ]
    );
}

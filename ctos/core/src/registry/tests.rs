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
    registry.handler("h", &[], |_| Ok(Idle)).waits_for(|task| {
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

//! Arguments that no event handler reads, in every kind of handler that the programs register.

use ctos::{config::load_texts, diagnostic::Findings, registry::Registry};

use crate::hello_example;

/// A key that no handler has.
const KEY: &str = "never_heard_of";

fn registry() -> Registry {
    let mut registry = cli::program::registry();
    hello_example::register(&mut registry);
    registry
}

/// What is found of an app of one task with these arguments.
fn found(registry: &Registry, handler: &str, args: &str) -> Findings {
    let text = format!(
        "[chassis.w]\n[task.t]\nhandler = \"{handler}\"\non = \"w\"\n[task.t.args]\n{args}\n"
    );
    let app = load_texts(&[("app.toml", text.as_str())], &[], &[]).unwrap();
    registry.check(&app)
}

/// Whether a line of `args` is found wrong, at its beginning, and the key is named.
fn is_found(findings: &Findings, line: usize) -> bool {
    let start = format!("app.toml:{}:1: error: ", 5 + line);
    let mut shown = findings.iter().map(ToString::to_string);
    shown.any(|shown| shown.starts_with(&start) && shown.contains(KEY))
}

#[test]
fn a_key_that_no_handler_reads_is_found_for_every_handler_there_is() {
    let registry = registry();
    let names: Vec<&str> = registry.kinds().map(|kind| kind.name()).collect();
    assert!(names.len() > 20, "{names:?}");
    for name in names {
        let findings = found(&registry, name, &format!("{KEY} = 1"));
        assert!(is_found(&findings, 1), "{name}: {findings}");
    }
}

/// A driver and a frame source take arguments in those of their task.
#[test]
fn a_key_that_no_driver_and_no_frame_source_reads_is_found() {
    let registry = registry();
    let cell = "cell = \"cell.toml\"";
    let servo = format!("driver = \"sim.arm\"\n[task.t.args.driver_args]\n{KEY} = 1");
    let findings = found(&registry, "mcs.servo", &servo);
    assert!(is_found(&findings, 3), "{findings}");
    let camera =
        format!("camera = \"c\"\nsource = \"sim.camera\"\n[task.t.args.args]\n{cell}\n{KEY} = 1");
    let findings = found(&registry, "vss.vm_snap", &camera);
    assert!(is_found(&findings, 5), "{findings}");
}

#[test]
fn a_key_of_a_net_that_is_written_wrong_is_found_with_the_one_that_was_meant() {
    let mut registry = registry();
    pnt::task::register(
        &mut registry,
        "plain.net",
        || pnt::library::Library::new(()),
    );
    let findings = found(&registry, "plain.net", "net = \"a.net\"\nbreakpoint = []");
    let shown: Vec<String> = findings.iter().map(ToString::to_string).collect();
    let meant = shown.iter().any(|one| {
        one.starts_with("app.toml:7:1: ") && one.contains("did you mean `breakpoints`?")
    });
    assert!(meant, "{shown:?}");
}

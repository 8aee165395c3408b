//! The whole app on the virtual clock, physics and all: the same every time.

use std::sync::Arc;

use ctos::{
    boot::{End, Observer, simulate},
    config::Selection,
    system::AppResult,
};

use crate::handlers::registry;

const APP: &str = concat!(
    env!("CARGO_MANIFEST_DIR"),
    "/examples/template_task/app.toml"
);

/// Runs the app as `app.toml` has it, with these overrides.
fn run(sets: &[&str]) -> AppResult {
    let mut selection = Selection::new(APP);
    selection.profiles = vec!["virtual".to_owned()];
    selection.sets = sets.iter().map(|set| (*set).to_owned()).collect();
    let app = cli::program::app(&selection).unwrap();
    // It proves the net, too.
    let findings = registry().check(&app);
    assert!(!findings.has_errors(), "{findings}");
    let nobody: Observer = Arc::new(|_| ());
    match simulate(app, registry(), &[], &nobody).unwrap().end {
        End::Finished(result) => result,
        other => panic!("{other:?}"),
    }
}

#[test]
fn the_box_is_picked_up_and_put_elsewhere() {
    let result = run(&[]);
    assert!(result.ok, "{}", result.text);
}

#[test]
fn where_there_is_nothing_the_answer_says_so() {
    let result = run(&["task.pick.args.object.from_m=[0.5, 0.1, 0.43]"]);
    assert!(
        !result.ok && result.text.contains("grasp: "),
        "{}",
        result.text
    );
}

#[test]
fn what_cannot_be_reached_is_refused_and_nothing_is_picked_up() {
    let result = run(&["task.pick.args.object.from_m=[1.5, 0.0, 0.43]"]);
    assert!(
        !result.ok && result.text.contains("go_above: "),
        "{}",
        result.text
    );
}

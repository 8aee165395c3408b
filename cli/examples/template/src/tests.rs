//! The whole app on the virtual clock: no process, no waiting, and the same every time.

use std::{sync::Arc, time::Duration};

use ctos::{
    boot::{End, Observer, Outcome, simulate},
    config::Selection,
};

use crate::handlers::registry;

const APP: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/examples/template/app.toml");

/// Runs the app as `app.toml` has it, with these overrides.
fn run(sets: &[&str]) -> Outcome {
    let mut selection = Selection::new(APP);
    selection.profiles = vec!["virtual".to_owned()];
    selection.sets = sets.iter().map(|set| (*set).to_owned()).collect();
    let app = cli::program::app(&selection).unwrap();
    // It proves the net, too.
    let findings = registry().check(&app);
    assert!(!findings.has_errors(), "{findings}");
    let nobody: Observer = Arc::new(|_| ());
    simulate(app, registry(), &[], &nobody).unwrap()
}

fn told(outcome: &Outcome) -> &str {
    match &outcome.end {
        End::Finished(result) if result.ok => &result.text,
        other => panic!("{other:?}"),
    }
}

#[test]
fn the_net_has_one_number_a_second_added_and_answers_with_the_sum() {
    let outcome = run(&[]);
    assert!(
        told(&outcome).contains("the sum is 6"),
        "{}",
        told(&outcome)
    );
    assert!(outcome.took >= Duration::from_secs(3));
}

#[test]
fn it_is_the_same_wherever_the_adder_runs() {
    let outcome = run(&[
        "task.adder.on=desk",
        "task.operator.args.arguments=[\"40\", \"2\"]",
    ]);
    assert!(
        told(&outcome).contains("the sum is 42"),
        "{}",
        told(&outcome)
    );
}

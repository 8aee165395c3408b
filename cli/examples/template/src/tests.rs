//! The whole app on the virtual clock: no process, no waiting, and the same every time.

use std::{sync::Arc, time::Duration};

use ctos::{
    boot::{End, Observer, Outcome, simulate},
    config::load_texts,
};

use crate::handlers::registry;

/// Runs the app as `app.toml` has it, with these overrides.
fn run(sets: &[&str]) -> Outcome {
    let sets: Vec<String> = sets.iter().map(|set| (*set).to_owned()).collect();
    let app = load_texts(&[("app.toml", include_str!("../app.toml"))], &sets, &[]).unwrap();
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
fn the_client_adds_one_number_a_second_and_tells_the_sum() {
    let outcome = run(&[]);
    assert_eq!(told(&outcome), "the sum is 6");
    assert!(outcome.took >= Duration::from_secs(3));
}

#[test]
fn it_is_the_same_wherever_the_adder_runs() {
    let outcome = run(&["task.adder.on=desk", "task.client.args.numbers=[40, 2]"]);
    assert_eq!(told(&outcome), "the sum is 42");
}

//! The app of `configs/guide.toml` in virtual time: a person guides the arm by hand.

use std::collections::BTreeMap;

use ctos::{
    config::{Expander, Selection},
    system::AppResult,
};
use mcs::{control::LawRegistry, partition::McsExpander};

use super::*;

/// Runs the app with these settings; how the person ended it.
fn guided(sets: &[&str]) -> (AppResult, BTreeMap<String, f64>) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs/guide.toml");
    let mut app = Selection::new(path);
    app.sets = ["time.mode=virtual"]
        .iter()
        .chain(sets)
        .map(|set| (*set).to_owned())
        .collect();
    let expanders: [(&str, &dyn Expander); 1] = [("mcs", &McsExpander)];
    let app = app
        .load(&expanders)
        .unwrap_or_else(|found| panic!("{found}"));
    let (mut registry, mut laws) = (Registry::new(), LawRegistry::new());
    let (mut drivers, mut sources) = (DriverRegistry::new(), FrameSources::new());
    register(&mut registry, &mut drivers, &mut sources);
    mcs_hand::register(&mut registry, &mut laws);
    let guards = mcs::guard::GuardRegistry::new();
    mcs::register(&mut registry, drivers, laws, guards);
    // Nobody asks service objects here.
    registry.handler("sorma.daemon", &[], |_| Ok(Nobody));
    let observer: boot::Observer = Arc::new(|_: &boot::BootEvent| {});
    let outcome = boot::boot(app, registry, &launcher(), &observer).unwrap();
    let End::Finished(result) = outcome.end else {
        panic!("{:?}", outcome.end)
    };
    let numbers = result.json.trim_matches(['{', '}']).split(',');
    let named = numbers.filter_map(|number| {
        let (name, value) = number.split_once(':')?;
        Some((name.trim_matches('"').to_owned(), value.parse().ok()?))
    });
    let told = named.collect();
    (result, told)
}

struct Nobody;

impl EventHandler for Nobody {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }
}

#[test]
fn an_arm_that_a_person_guides_comes_along_by_200_mm_and_stays_where_it_was_left() {
    // What the wrist feels of the hand helps it; without that the arm comes along as well, and is harder to pull.
    let pulled = ["1.0", "0.0"].map(|gain| {
        let set = format!("task.servo_arm.args.law_args.force_gain={gain}");
        let (result, told) = guided(&[&set]);
        assert!(result.ok, "{gain}: {}", result.text);
        assert!((told["along_m"] - 0.2).abs() < 1e-3, "{told:?}");
        assert!(told["off_m"] < 3e-3, "{told:?}");
        assert!(
            told["coasted_m"] < 2e-4 && told["drifted_m"] < 3e-4,
            "{told:?}"
        );
        told["pulled_n"]
    });
    assert!(
        pulled[0] < 0.7 * pulled[1] && pulled[1] < 30.0,
        "{pulled:?}"
    );
}

#[test]
fn an_arm_on_a_spring_goes_back_when_a_person_lets_go_and_that_is_told() {
    let spring = "task.servo_arm.args.law_args.stiffness=[200.0,200.0,200.0,100.0,100.0,100.0]";
    let (result, told) = guided(&[spring]);
    assert!(!result.ok, "{}", result.text);
    assert!(told["coasted_m"] > 0.1, "{told:?}");
}

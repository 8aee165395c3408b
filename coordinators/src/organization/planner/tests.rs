//! Plans around the nets of `carry`, between stand-ins, in virtual time.

use ctos::{config, registry::Registry, system::AppResult};

use crate::{
    bench::{self, configs, kinds},
    carry::tests::world::{STAND_INS, World, on, tasks},
};

/// The app of the stand-ins' world with a planner that has a disc carried, and perhaps a plan.
fn app(plans: &str) -> String {
    let app = bench::app(&tasks("seen"), &STAND_INS);
    let app = bench::planned(&app, "carry 3,4,0 4,5,0", plans);
    app.replace("show = true\n", "show = true\nallow_control = true\n")
}

/// A plan after what is missing or in the way, with the lines of a file.
fn plan(file: &str) -> String {
    format!("{{ after = [\"absent\", \"occupied\"], adds = \"{file}\" }}")
}

fn patience() -> String {
    let file = configs().join("nets/carry/patience.net");
    plan(&file.display().to_string())
}

/// A disc stands on TO, until a person takes it away after so many looks.
fn occupied(until: usize) -> World {
    let mut world = World::default();
    world.others.push(on("4,5"));
    world.is_cleared_after = until;
    world
}

fn planned(world: World, plans: &str) -> (World, AppResult) {
    bench::run_planned(world, &app(plans))
}

#[test]
fn after_occupied_a_net_that_waits_takes_over_and_the_same_command_is_done() {
    let (world, result) = planned(occupied(2), &patience());
    assert!(result.ok, "{}", result.text);
    assert!(
        result.text.contains("patience.net\ncarried\n"),
        "{}",
        result.text
    );
    assert!((world.stands_at() - on("4,5")).norm() < 1e-9);
    assert!(!world.bench.reserved);
}

#[test]
fn what_was_in_the_way_is_told_by_types_when_no_plan_is_left() {
    let (_, none) = planned(occupied(usize::MAX), "");
    assert!(!none.ok);
    assert_eq!(
        kinds(&none),
        ("occupied".to_owned(), vec!["occupied".to_owned()])
    );
    // Its patience comes to an end, too.
    let (world, waited) = planned(occupied(usize::MAX), &patience());
    assert_eq!(kinds(&waited).0, "occupied");
    assert_eq!(world.looks, 5);
    assert!(!world.moved());
    let mut blocked = World::default();
    blocked.blocked = vec!["arch", "line", "joint"];
    let (_, blocked) = planned(blocked, &patience());
    let (answer, all) = kinds(&blocked);
    assert_eq!(answer, "not_carried");
    assert!(
        !all.is_empty() && all.iter().all(|kind| kind == "guard"),
        "{all:?}"
    );
}

#[test]
fn a_net_that_is_not_sound_with_the_coordinators_nets_is_refused_and_the_running_one_goes_on() {
    // The command is never answered once something stands on TO.
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("stuck.net");
    std::fs::write(
        &file,
        "place stuck\ntransition wait\n  in target_taken\n  priority 1\n  out stuck\n",
    )
    .unwrap();
    let (_, result) = planned(occupied(usize::MAX), &plan(&file.display().to_string()));
    assert!(!result.ok);
    for said in ["occupied\n", "no other net was sent: refused", "stuck"] {
        assert!(result.text.contains(said), "{said}: {}", result.text);
    }
}

#[test]
fn a_plan_that_cannot_be_is_found_before_anything_starts() {
    let mut registry = Registry::new();
    crate::register(&mut registry);
    let findings = |text: &str| {
        let app = config::load_texts(&[("app.toml", text)], &[], &[]).unwrap();
        registry.check(&app).to_string()
    };
    let good = app(&patience());
    for (right, wrong, said) in [
        ("\"absent\"", "\"abscent\"", "did you mean `absent`?"),
        ("patience.net", "patient.net", "patient.net"),
        ("allow_control = true\n", "", "takes no other net"),
        (
            "send_within_s = 5",
            "send_within_s = 0",
            "`send_within_s` is 0 s",
        ),
    ] {
        let found = findings(&good.replace(right, wrong));
        assert!(found.contains(said), "{found}");
    }
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("wrong.net");
    std::fs::write(&file, "transition wait\n  in nowhere\n").unwrap();
    let found = findings(&app(&plan(&file.display().to_string())));
    assert!(found.contains("no place `nowhere`"), "{found}");
}

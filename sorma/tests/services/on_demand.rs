//! Daemons that start with the first request and not with the app (the `inetd` of the SORMA technical report,
//! section 3.4), in virtual time.

use crate::app::{App, Scenario, ask, kill, seconds};
use ctos::boot::BootEvent;
use ctos::registry::Registry;
use ctos::task::{Context, Handled, Phase};

/// How often a chassis came up after the app's boot.
fn starts(seen: &[BootEvent], name: &str) -> usize {
    let of = |event: &&BootEvent| {
        matches!(
            event,
            BootEvent::Awake { chassis, .. } | BootEvent::Restarted { chassis, .. } if chassis == name
        )
    };
    seen.iter().filter(of).count()
}

/// Two daemons, of which the second starts on demand.
fn app(scenario: Scenario) -> App {
    App {
        daemons: vec![("d1", "cage", ""), ("d2", "shelf", "")],
        on_demand: &["shelf"],
        ..App::new(scenario)
    }
}

#[test]
fn nobody_asks_and_it_never_starts_and_the_app_is_up_without_it() {
    let (result, seen) = app(|cx, sorm| {
        Box::pin(async move {
            assert!(ask(&sorm, &cx, "count@d1 EXEC").await.body.is_ok());
            cx.sleep(seconds(60.0)).await;
            Ok(String::new())
        })
    })
    .run_seen();
    assert_eq!(result, Ok(String::new()));
    assert_eq!(starts(&seen, "shelf"), 0, "{seen:?}");
}

#[test]
fn the_first_request_starts_it_and_those_after_it_find_it() {
    let (result, seen) = app(|cx, sorm| {
        Box::pin(async move {
            cx.sleep(seconds(5.0)).await;
            let begun = cx.now();
            for number in 1..=3 {
                let body = ask(&sorm, &cx, "count@d2 EXEC").await.body;
                assert_eq!(body.ints, [number], "{:?}", body.reports);
            }
            assert!(cx.now().since(begun) < seconds(1.0));
            Ok(String::new())
        })
    })
    .run_seen();
    assert_eq!(result, Ok(String::new()));
    assert_eq!(starts(&seen, "shelf"), 1, "{seen:?}");
    // It is not a restart, and who asked first is told.
    let asked = seen.iter().find_map(|event| match event {
        BootEvent::Wanted { chassis, task, by } => Some((chassis, task.as_deref(), by)),
        _ => None,
    });
    let (chassis, task, by) = asked.unwrap();
    assert_eq!((chassis.as_str(), task), ("shelf", Some("d2")));
    assert!(by.is_some(), "{seen:?}");
    let restarts = |event: &BootEvent| {
        matches!(
            event,
            BootEvent::Restarting { .. } | BootEvent::Restarted { .. }
        )
    };
    assert!(!seen.iter().any(restarts), "{seen:?}");
}

#[test]
fn many_who_ask_at_the_same_time_start_it_once() {
    let (result, seen) = app(|cx, sorm| {
        Box::pin(async move {
            let requests = (0..20).map(|_| crate::app::request("count@d2 EXEC"));
            let comm = sorma::daemon::Tasks::of(&cx);
            let replies = sorm.fork(&comm, requests.collect(), 20).await;
            assert!(replies.iter().all(|reply| reply.body.is_ok()));
            assert_eq!(ask(&sorm, &cx, "count@d2 EXEC").await.body.ints, [21]);
            Ok(String::new())
        })
    })
    .run_seen();
    assert_eq!(result, Ok(String::new()));
    assert_eq!(starts(&seen, "shelf"), 1, "{seen:?}");
}

#[test]
fn one_that_died_is_there_again_as_any_other() {
    let (result, seen) = App {
        faults: vec![kill("shelf", 10.0)],
        ..app(|cx, sorm| {
            Box::pin(async move {
                assert!(ask(&sorm, &cx, "count@d2 EXEC").await.body.is_ok());
                cx.sleep(seconds(20.0)).await;
                assert_eq!(ask(&sorm, &cx, "count@d2 EXEC").await.body.ints, [1]);
                Ok(String::new())
            })
        })
    }
    .run_seen();
    assert_eq!(result, Ok(String::new()));
    assert_eq!(starts(&seen, "shelf"), 2, "{seen:?}");
}

/// Looks for the daemon while the app comes up.
struct Early;

#[ctos::handler]
impl Early {
    #[phase]
    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Connect {
            cx.task("d2").await?;
        }
        Ok(())
    }
}

#[test]
fn a_task_may_look_for_it_while_the_app_comes_up() {
    let early = |registry: &mut Registry| {
        registry.handler("early", &Early::COMMANDS, |_| Ok(Early));
    };
    let mut app = app(|cx, sorm| {
        Box::pin(async move {
            assert!(ask(&sorm, &cx, "count@d2 EXEC").await.body.is_ok());
            Ok(String::new())
        })
    });
    app.daemons.push(("early", "one", "handler = \"early\""));
    app.handlers = early;
    let (result, seen) = app.run_seen();
    assert_eq!(result, Ok(String::new()), "{seen:?}");
}

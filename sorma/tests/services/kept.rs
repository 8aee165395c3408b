//! What CTRL has changed of the objects of a durable daemon survives its process; in virtual time.

use crate::app::{App, Scenario, ask, kill, seconds};
use ctos::registry::Registry;
use ctos::task::{Context as TaskContext, Handled, HandlerError, StateStore};
use futures_util::future::LocalBoxFuture;
use std::collections::BTreeMap;
use std::sync::Mutex;
use std::time::Duration;

/// A store in memory that takes 3 ms. A process that dies meanwhile has stored nothing.
#[derive(Default)]
struct Memory(Mutex<BTreeMap<String, Vec<u8>>>);

impl StateStore for Memory {
    fn load(&self, cx: &TaskContext) -> Result<Option<Vec<u8>>, HandlerError> {
        Ok(self.0.lock().unwrap().get(cx.name()).cloned())
    }

    fn store<'a>(&'a self, cx: &'a TaskContext, state: &'a [u8]) -> LocalBoxFuture<'a, Handled> {
        Box::pin(async move {
            cx.sleep(Duration::from_millis(3)).await;
            let name = cx.name().to_owned();
            self.0.lock().unwrap().insert(name, state.to_vec());
            Ok(())
        })
    }
}

fn stored(registry: &mut Registry) {
    registry.states(Memory::default());
}

/// An app of the durable daemon `d1`.
fn durable(scenario: Scenario) -> App {
    App {
        daemons: vec![("d1", "cage", "state = \"durable\"")],
        handlers: stored,
        ..App::new(scenario)
    }
}

#[test]
fn a_change_that_was_answered_or_seen_is_there_whenever_its_daemon_is_killed() {
    let scenario: Scenario = |cx, sorm| {
        Box::pin(async move {
            for factor in 1..=8 {
                let change = format!("scale.two@d1 CTRL -factor {factor}");
                while !ask(&sorm, &cx, &change).await.body.is_ok() {
                    cx.sleep(Duration::from_millis(5)).await;
                }
                for _ in 0..3 {
                    cx.sleep(Duration::from_millis(1)).await;
                    let seen = ask(&sorm, &cx, "scale.two@d1 EXEC FMSG 1 1").await.body;
                    if seen.is_ok() && seen.floats != [f64::from(factor)] {
                        return Err(format!("{:?} after factor {factor}", seen.floats));
                    }
                }
            }
            Ok("kept".to_owned())
        })
    };
    for step in 0..60 {
        let at = 0.001 * f64::from(step);
        let faults = vec![kill("cage", at), kill("cage", at + 0.56)];
        let app = App {
            faults,
            ..durable(scenario)
        };
        assert_eq!(app.run(), Ok("kept".to_owned()), "killed at {at} s");
    }
}

#[test]
fn an_object_that_is_built_anew_takes_its_recipe_then_what_was_kept_and_free_begins_afresh() {
    let app = App {
        faults: vec![kill("cage", 1.0), kill("cage", 3.0)],
        ..durable(|cx, sorm| {
            Box::pin(async move {
                let mut said = Vec::new();
                // A request that changes nothing keeps nothing: a later recipe is taken.
                ask(&sorm, &cx, "scale.minus@d1 CTRL -dump").await;
                for request in [
                    "scale.two@d1 CTRL -factor 7",
                    "scale.two@d1 CTRL -factor nonsense",
                ] {
                    ask(&sorm, &cx, request).await;
                }
                for wait in [2.0, 2.0] {
                    cx.sleep(seconds(wait)).await;
                    for name in ["scale.two", "scale.minus"] {
                        let dumped = ask(&sorm, &cx, &format!("{name}@d1 CTRL -dump")).await;
                        said.push(dumped.body.text);
                    }
                    ask(&sorm, &cx, "sorm@d1 CTRL -free scale.two").await;
                }
                Ok(said.join("; "))
            })
        })
    };
    let said = "-factor 7.0; -factor -1.0; -factor 2.0; -factor -1.0";
    assert_eq!(app.run(), Ok(said.to_owned()));
}

//! Apps in virtual time, where every other site is cut off.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "all of this is test code, helpers too, which fails by panicking"
)]

use std::{sync::Arc, time::Duration};

use ctos::{
    boot::{BootEvent, End, simulate},
    config::{Expander, Selection},
    registry::Registry,
    system::AppResult,
    task::{Context, Handled, Phase},
};
use pnt::task::{Marking, PutTape};

use bridge_sites::{SiteExpander, register};

const APP: &str = r#"
app.until = "person"
time.mode = "virtual"
[chassis.desk]
[chassis.gate]
[task.person]
handler = "person"
on = "desk"
[site]
name = "south"
on = "gate"
connect = ["tcp/127.0.0.1:7447"]
cut_after_s = 5.0
[site.reach.north]
depot = "net"
"#;

struct Person;

/// What a call ended with, and after which time in ms.
async fn asked(cx: &Context, name: &str) -> String {
    let begun = cx.now();
    let said = match cx.task(name).await {
        Ok(task) => match cx
            .call(&task, Marking {})
            .deadline(Duration::from_secs(60))
            .await
        {
            Ok(_) => "answered".to_owned(),
            Err(error) => error.to_string(),
        },
        Err(error) => error.to_string(),
    };
    format!("{said} ({} s)", cx.now().since(begun).as_secs())
}

#[ctos::handler]
impl Person {
    #[phase]
    async fn enters(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let cx = cx.clone();
            cx.clone().spawn(async move {
                let mut said = Vec::new();
                for name in ["depot@north", "depot@north", "depot@west"] {
                    said.push(asked(&cx, name).await);
                }
                let depot = cx.task("depot@north").await;
                let put = PutTape {
                    symbol: "parcel".to_owned(),
                    arguments: Vec::new(),
                };
                // Nobody waits for what becomes of it.
                let sent = match depot {
                    Ok(depot) => cx.send(&depot, put).await.is_ok(),
                    Err(_) => false,
                };
                said.push(format!("sent {sent}"));
                let text = said.join("\n");
                cx.finish(AppResult {
                    ok: true,
                    text,
                    json: String::new(),
                });
            });
        }
        Ok(())
    }
}

#[test]
fn a_call_to_a_site_that_is_never_heard_ends_with_its_name_the_task_and_the_time_and_an_unknown_site_has_no_tasks()
 {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("app.toml");
    std::fs::write(&file, APP).unwrap();
    let selection = Selection {
        file,
        ..Selection::default()
    };
    let extra: [(&'static str, &dyn Expander); 1] = [("site", &SiteExpander)];
    let app = selection.load(&extra).unwrap();
    let mut registry = Registry::new();
    registry.handler("person", &Person::COMMANDS, |_| Ok(Person));
    pnt::task::register(&mut registry, "net", || pnt::library::Library::new(()));
    register(&mut registry);
    let found = registry.check(&app);
    assert!(!found.has_errors(), "{found}");
    let stand_in = app.task("depot@north").unwrap();
    let known: Vec<_> = registry
        .commands_of(stand_in, &app)
        .iter()
        .map(|one| one.name)
        .collect();
    assert!(
        known.contains(&"tokens"),
        "it takes what its handler there takes: {known:?}"
    );
    let outcome = simulate(app, registry, &[], &(Arc::new(|_: &BootEvent| ()) as _)).unwrap();
    let End::Finished(result) = outcome.end else {
        panic!("{:?}", outcome.end)
    };
    let said: Vec<_> = result.text.lines().collect();
    assert!(
        said[0].starts_with("site `north` has been cut off for 5."),
        "{said:?}"
    );
    assert!(
        said[0].contains("`depot@north` was not asked for `marking` by `person`"),
        "{said:?}"
    );
    // The second one need not wait.
    assert!(
        said[1].starts_with("site `north`") && said[1].ends_with("(0 s)"),
        "{said:?}"
    );
    assert!(
        said[2].starts_with("no task is called `depot@west`"),
        "{said:?}"
    );
    assert_eq!(said[3], "sent true");
}

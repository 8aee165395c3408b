//! Links that are made on their first use, in virtual time: who has one, who is told of what, and what happened to
//! the way before.

use std::{
    fmt::Write as _,
    sync::{Arc, Mutex},
    time::Duration,
};

use ctos::{
    boot::{End, Fault, FaultKind, simulate},
    call::Fault as Failure,
    config::load_texts,
    registry::Registry,
    system::AppResult,
    task::{Context, Handled, HandlerError, Phase},
    time::Instant,
};
use futures_util::future::LocalBoxFuture;

ctos::command! {
    /// Asks for the chassis to which that of the task has links.
    struct Linked {} => Vec<String>, 1, "linked"
}

type Play = fn(Context) -> LocalBoxFuture<'static, Result<(), HandlerError>>;
type Told = Arc<Mutex<Vec<String>>>;

fn linked(cx: &Context) -> Vec<String> {
    let all = cx.chassis().link_counts().into_iter();
    all.map(|(peer, _)| peer).collect()
}

/// Says to whom it is linked, and notes who is gone.
struct Neighbour(Told);

#[ctos::handler]
impl Neighbour {
    #[command]
    fn linked(&self, cx: &Context, _: Linked) -> Vec<String> {
        linked(cx)
    }

    #[chassis_down]
    fn lost(&mut self, cx: &Context, chassis: &str) -> Handled {
        let told = format!("{} misses {chassis}", cx.name());
        self.0.lock().unwrap().push(told);
        Ok(())
    }
}

/// Plays once all run, and ends the app.
struct Person(Play);

#[ctos::handler]
impl Person {
    #[phase]
    async fn enters(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let (own, play) = (cx.clone(), self.0);
            cx.spawn(async move {
                let said = play(own.clone()).await;
                own.finish(AppResult {
                    ok: said.is_ok(),
                    text: said
                        .err()
                        .map_or_else(String::new, |error| error.to_string()),
                    json: String::new(),
                });
            });
        }
        Ok(())
    }
}

/// Runs an app of chassis with a neighbour each, of which the first has the person too; what its tasks were told.
fn run(count: usize, faults: &[Fault], play: Play) -> Vec<String> {
    let mut text =
        "[app]\nuntil = \"person\"\n[task.person]\nhandler = \"person\"\non = \"c0\"\n".to_owned();
    for at in 0..count {
        let restart = "restart = \"on-failure\"\nrestart_backoff_s = 0.5\n";
        write!(
            text,
            "[chassis.c{at}]\n{restart}[task.t{at}]\nhandler = \"neighbour\"\non = \"c{at}\"\n"
        )
        .unwrap();
    }
    let app = load_texts(&[("app.toml", &text)], &[], &[]).unwrap();
    let told = Told::default();
    let mut registry = Registry::new();
    let noted = told.clone();
    registry.handler("neighbour", &Neighbour::COMMANDS, move |_| {
        Ok(Neighbour(noted.clone()))
    });
    registry.handler("person", &Person::COMMANDS, move |_| Ok(Person(play)));
    let run = simulate(app, registry, faults, &(Arc::new(|_: &_| ()) as _)).unwrap();
    match run.end {
        End::Finished(result) => assert!(result.ok, "{}", result.text),
        end => panic!("{end:?}"),
    }
    let told = told.lock().unwrap();
    told.clone()
}

fn at(millis: u64) -> Instant {
    Instant::START + Duration::from_millis(millis)
}

/// What neighbour `name` is linked to.
async fn ask(cx: &Context, name: &str) -> Result<Vec<String>, HandlerError> {
    let task = cx.task(name).await?;
    Ok(cx.call(&task, Linked {}).await?)
}

#[test]
fn a_thousand_chassis_boot_and_each_is_linked_to_the_boot_and_to_whom_it_has_spoken() {
    run(1000, &[], |cx| {
        Box::pin(async move {
            assert_eq!(linked(&cx), ["boot"]);
            assert_eq!(ask(&cx, "t700").await?, ["boot", "c0"]);
            assert_eq!(ask(&cx, "t999").await?, ["boot", "c0"]);
            assert_eq!(linked(&cx), ["boot", "c700", "c999"]);
            Ok(())
        })
    });
}

#[test]
fn a_dead_chassis_is_told_to_those_who_hold_a_name_of_it_and_its_return_ends_that() {
    let told = run(4, &[Fault::on("c1", FaultKind::Kill, at(300))], |cx| {
        Box::pin(async move {
            // To hold a name is enough.
            cx.task("t1").await?;
            cx.task("t2").await?;
            cx.sleep(Duration::from_secs(2)).await;
            assert_eq!(linked(&cx), ["boot", "c2"]);
            assert_eq!(ask(&cx, "t1").await?, ["boot", "c0"]);
            Ok(())
        })
    });
    assert_eq!(told, ["t0 misses c1"]);
}

#[test]
fn a_call_to_a_chassis_that_died_before_it_had_a_link_fails_and_its_name_is_waited_for() {
    let told = run(2, &[Fault::on("c1", FaultKind::Kill, at(300))], |cx| {
        Box::pin(async move {
            cx.sleep(Duration::from_millis(600)).await;
            let begun = cx.now();
            ask(&cx, "t1").await?;
            assert!(cx.now() > begun, "it waits for the restart");
            Ok(())
        })
    });
    assert_eq!(told, [""; 0]);
}

#[test]
fn a_cut_from_before_the_first_use_holds() {
    run(
        2,
        &[Fault::between("c0", "c1", FaultKind::Cut, at(1))],
        |cx| {
            Box::pin(async move {
                cx.sleep(Duration::from_millis(300)).await;
                let found = cx.task("t1").deadline(Duration::from_secs(1)).await;
                assert!(found.is_err(), "{found:?}");
                assert_eq!(linked(&cx), ["boot"]);
                Ok(())
            })
        },
    );
}

/// The links of two chassis break before they are used, so that nothing comes for `lasts` ms.
fn broken(lasts: u64, play: Play) {
    let breaks = Fault::between("c0", "c1", FaultKind::Break, at(200));
    run(2, &[breaks.until(at(200 + lasts))], play);
}

#[test]
fn a_break_that_began_before_the_first_use_delays_it_or_ends_it_after_the_time_out() {
    broken(1500, |cx| {
        Box::pin(async move {
            cx.sleep(Duration::from_millis(600)).await;
            ask(&cx, "t1").await?;
            assert!(cx.now() >= at(1700), "{}", cx.now());
            Ok(())
        })
    });
    broken(9000, |cx| {
        Box::pin(async move {
            cx.sleep(Duration::from_millis(600)).await;
            let task = cx.task("t1").await?;
            let begun = cx.now();
            let error = cx.call(&task, Linked {}).await.unwrap_err();
            let chassis = "c1".to_owned();
            assert_eq!(error.fault, Failure::PeerDown { chassis });
            // From when somebody listens a peer may be silent for two seconds.
            let took = cx.now().since(begun).as_secs_f64();
            assert!(took > 1.9, "{took}");
            Ok(())
        })
    });
}

#[test]
fn one_that_stands_still_at_the_first_use_is_given_up_after_the_time_out() {
    let freeze = Fault::on("c1", FaultKind::Freeze, at(200)).until(at(1500));
    run(2, &[freeze], |cx| {
        Box::pin(async move {
            cx.sleep(Duration::from_millis(600)).await;
            ask(&cx, "t1").await?;
            assert!(cx.now() >= at(1500), "{}", cx.now());
            Ok(())
        })
    });
}

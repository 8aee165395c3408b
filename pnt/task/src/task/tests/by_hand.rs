//! Interventions, breakpoints, replacing and dispatching to other nets.

use ctos::{
    message::Command as _,
    record::{Filter, Record},
    simulation::{Fault, FaultKind, Faults},
    time::Instant,
};

use super::{
    survival::{
        durable_app, durable_app_with, insist, register_script, register_with_settings, simulate,
        tokens,
    },
    *,
};

const PUMP: &str = "net n
place tank = 6, out
command go -> gone
transition pump
  in tank
  do work
  out out
  fail out
transition drain
  in out*100
  tape go
  write gone
";

fn run_with(
    more: &str,
    text: &str,
    script: Faults,
    operator: fn(Context) -> Later<Result<String, HandlerError>>,
) -> Result<String, String> {
    let app = durable_app(&[("n", more)], 1);
    let mut registry = Registry::new();
    register_with_settings(&mut registry, text, || {
        Library::new(()).action("work", slow(Duration::from_millis(500)))
    });
    register_script(&mut registry, operator);
    simulate(app, registry, script).0
}

async fn order(cx: &Context, order: Order) -> String {
    let to = cx.task("n").await.unwrap();
    let by = "ada".to_owned();
    match cx.call(&to, Control { order, by }).await {
        Ok(said) => said,
        Err(error) => format!("no: {}", error.reason()),
    }
}

async fn marking(cx: &Context) -> Snapshot {
    insist(cx, "n", Marking {}).await.unwrap()
}

#[test]
fn a_net_is_not_controlled_unless_its_task_allows_it() {
    let found = run_with("durable = false", PUMP, Faults::none(), |cx| {
        Box::pin(async move { Ok(order(&cx, Order::Pause).await) })
    });
    let found = found.unwrap();
    assert!(
        found.contains("not to be controlled by hand: its task says no `allow_control = true`"),
        "{found}"
    );
}

#[test]
fn whoever_looks_at_the_task_of_a_net_is_told_that_it_is_paused() {
    async fn at(cx: &Context) -> Option<String> {
        let to = cx.task("n").await.unwrap();
        let look = cx.look_at(&to, &[]).await.unwrap();
        look.task.at
    }
    let found = run_with("allow_control = true", PUMP, Faults::none(), |cx| {
        Box::pin(async move {
            let before = at(&cx).await;
            order(&cx, Order::Pause).await;
            let paused = at(&cx).await;
            order(&cx, Order::Resume).await;
            Ok(format!("{before:?}, {paused:?}, {:?}", at(&cx).await))
        })
    });
    assert_eq!(found.unwrap(), "None, Some(\"paused: by hand\"), None");
}

#[test]
fn an_action_is_ended_by_hand_as_completed_or_as_failed() {
    const TWO: &str = "net n\nplace tank = 2, good, bad\ncommand go -> gone\n\
        transition pump\n  in tank\n  do work\n  out good\n  fail bad\n\
        transition drain\n  in good, bad\n  tape go\n  write gone\n";
    let more = "allow_control = true, breakpoints = [\"pump\"]";
    let found = run_with(more, TWO, Faults::none(), |cx| {
        Box::pin(async move {
            let transition = || "pump".to_owned();
            let mut said = Vec::new();
            let (complete, cancel) = (
                Order::Complete {
                    transition: transition(),
                },
                Order::Cancel {
                    transition: transition(),
                },
            );
            order(&cx, Order::Clear { at: None }).await;
            for end in [complete, cancel] {
                order(&cx, Order::Step { firings: 1 }).await;
                assert_eq!(marking(&cx).await.in_action.len(), 1);
                order(&cx, end).await;
                cx.sleep(Duration::from_millis(10)).await;
                let now = marking(&cx).await;
                said.push(format!(
                    "{} good, {} bad, {} running",
                    tokens(&now, "good"),
                    tokens(&now, "bad"),
                    now.in_action.len()
                ));
            }
            let transition = transition();
            said.push(order(&cx, Order::Complete { transition }).await);
            Ok(said.join("\n"))
        })
    });
    let found = found.unwrap();
    let lines: Vec<&str> = found.lines().collect();
    assert_eq!(
        lines[..2],
        ["1 good, 0 bad, 0 running", "1 good, 1 bad, 0 running"]
    );
    assert!(
        lines[2].contains("transition `pump` is not in action"),
        "{found}"
    );
}

#[test]
fn a_net_is_paused_stepped_fired_filled_emptied_and_its_actions_are_cancelled_by_hand() {
    let more = "allow_control = true, breakpoints = [\"pump\"]";
    let found = run_with(more, PUMP, Faults::none(), |cx| {
        Box::pin(async move {
            let mut said = Vec::new();
            let mut say = |what: &str, snapshot: &Snapshot| {
                said.push(format!(
                    "{what}: tank {} out {} {} running, {}",
                    tokens(snapshot, "tank"),
                    tokens(snapshot, "out"),
                    snapshot.in_action.len(),
                    snapshot.paused.as_deref().unwrap_or("goes on"),
                ));
            };
            // Armed before the first firing.
            say("begin", &marking(&cx).await);
            order(&cx, Order::Clear { at: None }).await;
            order(&cx, Order::Step { firings: 2 }).await;
            say("step", &marking(&cx).await);
            let transition = "pump".to_owned();
            order(&cx, Order::Fire { transition }).await;
            say("fire", &marking(&cx).await);
            let transition = "pump".to_owned();
            order(&cx, Order::Cancel { transition }).await;
            cx.sleep(Duration::from_secs(2)).await;
            say("cancel", &marking(&cx).await);
            let place = || "tank".to_owned();
            let (place_there, place_taken) = (place(), place());
            order(
                &cx,
                Order::Put {
                    place: place_there,
                    tokens: 4,
                },
            )
            .await;
            order(
                &cx,
                Order::Take {
                    place: place_taken,
                    tokens: 6,
                },
            )
            .await;
            say("put and take", &marking(&cx).await);
            let at = "out >= 4".to_owned();
            order(&cx, Order::Break { at }).await;
            order(&cx, Order::Resume).await;
            cx.sleep(Duration::from_secs(2)).await;
            say("place", &marking(&cx).await);
            let place = place();
            let too_many = order(&cx, Order::Take { place, tokens: 60 }).await;
            said.push(too_many);
            let transition = "drain".to_owned();
            said.push(order(&cx, Order::Fire { transition }).await);
            let at = "tnak>=1".to_owned();
            said.push(order(&cx, Order::Break { at }).await);
            let events = marking(&cx).await.events;
            let by_hand = events.iter().filter(|event| event.transition.is_empty());
            said.push(format!("{} of the net", by_hand.count()));
            Ok(said.join("\n"))
        })
    });
    let found = found.unwrap();
    let lines: Vec<&str> = found.lines().collect();
    let expected = [
        "begin: tank 6 out 0 0 running, breakpoint `pump`",
        "step: tank 4 out 0 2 running, breakpoint `pump`",
        "fire: tank 3 out 0 3 running, breakpoint `pump`",
        "cancel: tank 3 out 3 0 running, breakpoint `pump`",
        "put and take: tank 1 out 3 0 running, breakpoint `pump`",
        "place: tank 0 out 4 0 running, breakpoint `out >= 4`",
    ];
    assert_eq!(lines[..6], expected, "{found}");
    assert!(lines[6].contains("place `tank` holds 0 tokens"), "{found}");
    assert!(lines[7].contains("`drain` is not enabled"), "{found}");
    assert!(
        lines[8].contains("net `n` has no place `tnak`; there are: tank, out"),
        "{found}"
    );
}

/// Does everything that can be done to [`LAMP`] by hand, once.
async fn every_intervention(cx: Context) -> Result<String, HandlerError> {
    let replaced = replace(&cx, LAMP.to_owned(), 1000).await;
    assert_eq!(replaced, "replaced by new.net");
    let (place, on) = (|| "off".to_owned(), || "switch_on".to_owned());
    let at = || "on>=90".to_owned();
    let orders = [
        Order::Clear { at: None },
        Order::Break { at: at() },
        Order::Clear { at: Some(at()) },
        Order::Pause,
        Order::Put {
            place: place(),
            tokens: 2,
        },
        Order::Take {
            place: place(),
            tokens: 2,
        },
        Order::Fire { transition: on() },
        Order::Cancel { transition: on() },
        Order::Step { firings: 1 },
        Order::Complete { transition: on() },
        Order::Resume,
    ];
    for one in orders {
        if matches!(one, Order::Fire { .. }) {
            let child = cx.clone();
            cx.spawn(async move {
                let _ = switch(&child).await;
            });
            cx.sleep(Duration::from_millis(10)).await;
        }
        let said = order(&cx, one.clone()).await;
        assert!(!said.starts_with("no: "), "{one:?}: {said}");
        // An action that was ended ends concurrently with the order.
        cx.sleep(Duration::from_millis(10)).await;
    }
    Ok(String::new())
}

#[test]
fn each_intervention_is_in_the_record_with_who_did_it() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("run.mcap");
    let set = format!("record.file={:?}", file.display().to_string());
    let app = durable_app_with(&[("n", "allow_control = true")], 1, &[set]);
    let mut registry = Registry::new();
    register_with_settings(&mut registry, LAMP, || {
        Library::new(()).action("work", slow(Duration::from_millis(500)))
    });
    register_script(&mut registry, every_intervention);
    simulate(app, registry, Faults::none()).0.unwrap();
    let filter = Filter {
        topics: vec!["/firing/n".to_owned()],
        ..Filter::default()
    };
    let record = Record::read(&[file], &filter).unwrap();
    let events = record.entries.iter().map(|entry| {
        let event: serde_json::Value = serde_json::from_slice(&entry.json).unwrap();
        let word = |key: &str| event[key].as_str().unwrap_or_default().to_owned();
        (word("phase"), word("text"))
    });
    let by_ada: Vec<(String, String)> =
        events.filter(|(_, text)| text.ends_with("(ada)")).collect();
    let by_ada: Vec<(&str, &str)> = by_ada
        .iter()
        .map(|(phase, text)| (phase.as_str(), text.trim_end_matches(" (ada)")))
        .collect();
    let expected = [
        ("ordered", "replaced by new.net"),
        ("ordered", "no breakpoints"),
        ("ordered", "break at on>=90"),
        ("ordered", "no break at on>=90"),
        ("paused", "by hand"),
        ("put", "by hand"),
        ("taken", "by hand"),
        ("ordered", "fire switch_on"),
        ("ordered", "cancel switch_on"),
        ("ordered", "step 1"),
        ("ordered", "complete switch_on"),
        ("resumed", "by hand"),
    ];
    assert_eq!(by_ada, expected);
}

#[test]
fn an_app_ends_at_a_breakpoint_that_was_set_for_that() {
    let more = "breakpoints = [\"out>=2\"], break_ends = true";
    let ended = run_with(more, PUMP, Faults::none(), |cx| {
        Box::pin(async move {
            cx.sleep(Duration::from_secs(60)).await;
            Ok("it went on".to_owned())
        })
    });
    let ended = ended.unwrap_err();
    assert!(
        ended.contains("Breakpoint { task: \"n\", reason: \"net `n` is at breakpoint `out>=2`\" }"),
        "{ended}"
    );
}

const LAMP: &str = "net n
place off = 1, on
command switch -> switched
transition switch_on
  in off
  tape switch
  do work
  out on
transition switch_off
  in on
  do work
  out off
  write switched
";

async fn replace(cx: &Context, text: String, within_ms: u64) -> String {
    let file = "new.net".to_owned();
    order(
        cx,
        Order::Replace {
            file,
            text,
            within_ms,
        },
    )
    .await
}

async fn switch(cx: &Context) -> Result<TapeAnswer, HandlerError> {
    let to = cx.task("n").await?;
    let put = PutTape {
        symbol: "switch".to_owned(),
        arguments: Vec::new(),
    };
    Ok(cx.call(&to, put).await?)
}

#[test]
fn a_net_is_replaced_between_commands_when_it_is_sound_and_stays_replaced_when_its_process_dies() {
    let more = "durable = true, allow_control = true";
    let death = Fault::on("on_n", FaultKind::Kill, Instant::from_nanos(20_000_000_000));
    let script = Faults::of_script("a death", vec![death]);
    let found = run_with(more, LAMP, script, |cx| {
        Box::pin(async move {
            let mut said = Vec::new();
            said.push(replace(&cx, LAMP.replace("out on", "out onn"), 100).await);
            said.push(replace(&cx, LAMP.replace("do work", "do wrok"), 100).await);
            said.push(replace(&cx, LAMP.replace("net n", "net m"), 100).await);
            // While a command is in progress: too late, then in time.
            let child = cx.clone();
            cx.spawn(async move {
                let _ = switch(&child).await;
            });
            cx.sleep(Duration::from_millis(200)).await;
            said.push(replace(&cx, LAMP.to_owned(), 100).await);
            let other = LAMP
                .replace("place off = 1, on", "place off = 1, shining")
                .replace(" on\n", " shining\n");
            said.push(replace(&cx, other, 5000).await);
            let places = |snapshot: Snapshot| {
                let places = snapshot.places.into_iter();
                places
                    .map(|(name, held)| format!("{name} {held}"))
                    .collect::<Vec<_>>()
                    .join(" ")
            };
            switch(&cx).await?;
            said.push(places(marking(&cx).await));
            cx.sleep(Duration::from_secs(25)).await;
            insist(&cx, "n", Marking {}).await?;
            switch(&cx).await?;
            said.push(places(marking(&cx).await));
            Ok(said.join("\n----\n"))
        })
    });
    let found = found.unwrap();
    let said: Vec<&str> = found.split("\n----\n").collect();
    assert!(
        said[0].contains("new.net:8:7: error: net `n` has no place `onn`"),
        "{found}"
    );
    assert!(said[1].contains("no local function `wrok`"), "{found}");
    assert!(said[2].contains("task `n` runs net `m`"), "{found}");
    assert!(
        said[3].contains("within 0.100 s there was no safe marking; at last it waited for: the action of `switch_on`; the answer to `switch`"),
        "{found}"
    );
    assert_eq!(said[4], "replaced by new.net", "{found}");
    assert_eq!(said[5], "off 1 shining 0", "{found}");
    assert_eq!(said[6], "off 1 shining 0", "{found}");
}

#[test]
fn firings_are_counted_from_the_start_of_the_process_also_of_a_durable_net() {
    let death = Fault::on("on_n", FaultKind::Kill, Instant::from_nanos(20_000_000_000));
    let script = Faults::of_script("a death", vec![death]);
    let found = run_with("durable = true", LAMP, script, |cx| {
        Box::pin(async move {
            switch(&cx).await?;
            switch(&cx).await?;
            let before = marking(&cx).await.firings;
            cx.sleep(Duration::from_secs(25)).await;
            let after = marking(&cx).await.firings;
            switch(&cx).await?;
            Ok(format!("{before} {after} {}", marking(&cx).await.firings))
        })
    });
    assert_eq!(found.unwrap(), "4 0 2");
}

#[test]
fn a_full_tape_is_told_and_so_is_a_symbol_that_nobody_ever_reads() {
    let text = LAMP.replace(
        "command switch -> switched",
        "command switch -> switched\ncommand idle -> idled",
    );
    let found = run_with("tape = 2", &text, Faults::none(), |cx| {
        Box::pin(async move {
            let to = cx.task("n").await?;
            let put = |symbol: &str| PutTape {
                symbol: symbol.to_owned(),
                arguments: Vec::new(),
            };
            let refused = |answer: Result<TapeAnswer, ctos::call::CallError>| {
                answer.map_or_else(|error| error.reason(), |answer| answer.symbol)
            };
            let mut said = vec![refused(cx.call(&to, put("idle")).await)];
            said.push(refused(cx.call(&to, put("swich")).await));
            for _ in 0..3 {
                let (child, to, put) = (cx.clone(), to.clone(), put("switch"));
                cx.spawn(async move {
                    let _ = child.call(&to, put).await;
                });
            }
            cx.sleep(Duration::from_millis(100)).await;
            said.push(refused(cx.call(&to, put("switch")).await));
            Ok(said.join("\n"))
        })
    });
    let found = found.unwrap();
    let said: Vec<&str> = found.lines().collect();
    assert!(
        said[0].contains("no transition of net `n` ever reads `idle`; it reads: switch"),
        "{found}"
    );
    assert!(
        said[1].contains("takes no command `swich`; it takes: switch, idle"),
        "{found}"
    );
    assert!(
        said[2].contains("the input tape of net `n` is full: 2 commands wait on it"),
        "{found}"
    );
}

#[test]
fn an_output_symbol_of_one_net_is_an_input_of_another_also_when_that_one_dies() {
    let first = "net first\nplace free = 1\ncommand plan -> planned\ntransition t\n  in free\n  tape plan\n  do work\n  out free\n  write planned\n";
    let second = "net second\nplace free = 1, count\ncommand planned -> moved\ntransition t\n  in free\n  tape planned\n  do work\n  idempotent\n  out free, count\n  write moved\n";
    async fn ask(cx: Context) -> Result<String, HandlerError> {
        let to = cx.task("first").await?;
        for number in 0..5 {
            let put = PutTape {
                symbol: "plan".to_owned(),
                arguments: vec![format!("x{number}")],
            };
            cx.call(&to, put).await?;
        }
        let read = loop {
            let read = insist(&cx, "second", ReadTape { taken: 0 }).await?;
            if read.len() >= 5 {
                break read;
            }
            cx.sleep(Duration::from_millis(100)).await;
        };
        let arguments: Vec<&str> = read
            .iter()
            .map(|output| output.arguments[0].as_str())
            .collect();
        let count = tokens(&insist(&cx, "second", Marking {}).await?, "count");
        Ok(format!("{} {count}", arguments.join(" ")))
    }
    for at in (0..30).map(|step| step * 100_000_000) {
        let app = durable_app(
            &[
                (
                    "first",
                    "durable = true, forward = { planned = \"second\" }",
                ),
                ("second", "durable = true, tape = 2048"),
            ],
            at,
        );
        let mut registry = Registry::new();
        for text in [first, second] {
            register_with_settings(&mut registry, text, || {
                Library::new(()).action("work", slow(Duration::from_millis(200)))
            });
        }
        register_script(&mut registry, ask);
        let kill = Fault::on("on_second", FaultKind::Kill, Instant::from_nanos(at));
        let found = simulate(app, registry, Faults::of_script("a death", vec![kill])).0;
        assert_eq!(found.as_deref(), Ok("x0 x1 x2 x3 x4 5"), "at {at}");
    }
}

#[test]
fn a_net_asks_another_for_one_of_its_commands_and_takes_its_failure_branch_for_another_answer() {
    let outer = "net outer\nplace free = 1, good, bad\ncommand go -> gone, failed\ntransition ask\n  in free\n  tape go\n  send inner.turn\n  out good\n  fail bad\ntransition t\n  in good\n  out free\n  write gone\ntransition u\n  in bad\n  out free\n  write failed\n";
    let inner = "net inner\nplace free = 1, good, bad\ncommand turn -> turned, stuck\ntransition t\n  in free\n  tape turn\n  do work\n  out good\n  fail bad\ntransition u\n  in good\n  out free\n  write turned\ntransition v\n  in bad\n  out free\n  write stuck\n";
    async fn ask(cx: Context) -> Result<String, HandlerError> {
        let to = cx.task("outer").await?;
        let mut said = Vec::new();
        for argument in ["left", "wall"] {
            let put = PutTape {
                symbol: "go".to_owned(),
                arguments: vec![argument.to_owned()],
            };
            let answer = cx.call(&to, put).await?;
            said.push(format!("{} [{}]", answer.symbol, answer.text));
        }
        Ok(said.join(", "))
    }
    let app = durable_app(
        &[("outer", "durable = false"), ("inner", "durable = false")],
        1,
    );
    let mut registry = Registry::new();
    register_with_settings(&mut registry, outer, || Library::new(()));
    register_with_settings(&mut registry, inner, || {
        Library::new(()).action("work", |a: Action<()>| async move {
            match a.arguments().first().map(String::as_str) {
                Some("wall") => Err("there is a wall".into()),
                _ => Ok(()),
            }
        })
    });
    register_script(&mut registry, ask);
    let found = simulate(app, registry, Faults::none()).0.unwrap();
    assert!(found.starts_with("gone [], failed ["), "{found}");
    assert!(found.contains("there is a wall"), "{found}");
    assert!(
        found.contains("net `inner` answered `turn` with `stuck`"),
        "{found}"
    );
    assert_eq!(PutTape::NAME, "put_tape");
}

#[test]
fn a_breakpoint_that_was_set_by_hand_is_armed_again_before_the_first_firing() {
    let more = "durable = false, allow_control = true";
    let deaths = [5_u64, 15].map(|at_s| {
        Fault::on(
            "on_n",
            FaultKind::Kill,
            Instant::from_nanos(at_s * 1_000_000_000),
        )
    });
    let script = Faults::of_script("two deaths", deaths.to_vec());
    let found = run_with(more, PUMP, script, |cx| {
        Box::pin(async move {
            let mut said = Vec::new();
            said.push(
                order(
                    &cx,
                    Order::Break {
                        at: "pump".to_owned(),
                    },
                )
                .await,
            );
            cx.sleep(Duration::from_secs(10)).await;
            let again = marking(&cx).await;
            said.push(format!(
                "{:?} after {} firings",
                again.paused, again.firings
            ));
            said.push(order(&cx, Order::Clear { at: None }).await);
            cx.sleep(Duration::from_secs(10)).await;
            let free = marking(&cx).await;
            said.push(format!("{:?} {:?}", free.paused, free.breakpoints));
            Ok(said.join("\n"))
        })
    });
    assert_eq!(
        found.unwrap().lines().collect::<Vec<_>>(),
        [
            "break at pump",
            "Some(\"breakpoint `pump`\") after 0 firings",
            "no breakpoints",
            "None []",
        ]
    );
}

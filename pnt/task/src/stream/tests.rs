//! The stream between a net's task and those who follow it, in virtual time, and by itself.

use std::{cell::RefCell, collections::BTreeMap, rc::Rc, sync::Arc, time::Duration};

use ctos::{
    boot::{self, End, Launcher},
    config,
    diagnostic::Source as Text,
    message::Message,
    registry::Registry,
    system::AppResult,
    task::{Context, EventHandler, Handled, HandlerError, Phase},
    time::Instant,
};
use proptest::prelude::*;

use super::*;
use crate::{
    library::{Action, Library},
    task::{COMMANDS, Marking, NetTask, PutTape},
};
use pnt_language::{
    compile,
    data::Value,
    exec::{Conflicts, Execution},
    net::Net,
};

fn net(text: &str) -> Net {
    compile::net(&Text::new("n.net", text)).unwrap_or_else(|f| panic!("{f}"))
}

/// Works for a while on each command, and then fires a burst without any action.
fn busy(burst: u32) -> Net {
    net(&format!(
        "net n
place free = 1, work, left, done
command go -> gone
transition take
  in free
  tape go
  do load
  out work, left*{burst}
transition spend
  in left
  out done
transition give
  in work, done*{burst}
  out free
  write gone
"
    ))
}

/// What a display does between two questions.
#[derive(Clone, Copy)]
enum Manner {
    /// Asks again at once.
    Keen,
    /// Takes its time.
    Slow(Duration),
    /// Asks once, and drops the answer.
    Stuck,
}

/// What displays saw.
#[derive(Debug, Default)]
struct Seen {
    batches: u64,
    events: u64,
    skipped: u64,
    states: u64,
    last: Option<State>,
}

async fn watch(cx: &Context, manner: Manner, seen: &RefCell<Seen>) -> Result<(), HandlerError> {
    let to = cx.task("n").await?;
    let view = cx.call(&to, Describe {}).await?;
    let mut after = None;
    let mut replica: Option<Replica> = None;
    loop {
        let follow = Follow {
            after,
            patience_ms: 1000,
        };
        let batch = cx.call(&to, follow).await?;
        if let Manner::Stuck = manner {
            return Ok(());
        }
        after = Some(batch.mark);
        {
            let mut seen = seen.borrow_mut();
            seen.batches += 1;
            seen.events += batch.events.len() as u64;
            seen.skipped += batch.skipped;
            seen.states += u64::from(batch.state.is_some());
        }
        if let Some(state) = batch.state {
            replica = Some(Replica::new(&view, state)?);
        }
        let replica = replica.as_mut().ok_or("events before any state")?;
        for event in batch.events.iter() {
            replica.apply(event)?;
        }
        assert_eq!(replica.state().seq, batch.mark.seq);
        seen.borrow_mut().last = Some(replica.state().clone());
        if let Manner::Slow(pause) = manner {
            cx.sleep(pause).await;
        }
    }
}

struct Display(Manner, Rc<RefCell<Seen>>);

impl EventHandler for Display {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let (child, manner, seen) = (cx.clone(), self.0, self.1.clone());
            cx.spawn(async move {
                if let Err(error) = watch(&child, manner, &seen).await {
                    child.fail(&error.to_string());
                }
            });
        }
        Ok(())
    }
}

struct Operator;

impl EventHandler for Operator {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let child = cx.clone();
            cx.spawn(async move {
                let text = operate(&child).await;
                let (ok, text) = text.map_or_else(|e| (false, e.to_string()), |text| (true, text));
                child.finish(AppResult {
                    ok,
                    text,
                    json: String::new(),
                });
            });
        }
        Ok(())
    }
}

/// Ten commands; every firing and its time, and the marking.
async fn operate(cx: &Context) -> Result<String, HandlerError> {
    let to = cx.task("n").await?;
    for _ in 0..10 {
        let put = PutTape {
            symbol: "go".to_owned(),
            arguments: Vec::new(),
        };
        cx.call(&to, put).await?;
    }
    // The displays are behind by as much as they may be.
    cx.sleep(Duration::from_secs(3)).await;
    let snapshot = cx.call(&to, Marking {}).await?;
    // How long the boot took is no matter of the net's.
    let start = snapshot.events.first().map_or(0, |event| event.at_ns);
    let events = snapshot.events.iter();
    let events = events.map(|event| format!("{} {}", event.at_ns - start, event.transition));
    let events: Vec<String> = events.collect();
    Ok(format!("{:?}\n{}", snapshot.places, events.join("\n")))
}

/// Runs the net on one chassis and the displays on another; what was fired when, and what was seen.
fn run(burst: u32, manners: &[Manner]) -> (String, Vec<Seen>) {
    use std::fmt::Write as _;
    let mut text = "[app]\nname = \"t\"\nuntil = \"operator\"\n[time]\nmode = \"virtual\"\n[chassis.a]\n[chassis.b]\n[task.operator]\nhandler = \"operator\"\non = \"a\"\n[task.n]\nhandler = \"n\"\non = \"a\"\n".to_owned();
    let all: Arc<std::sync::Mutex<BTreeMap<usize, Seen>>> = Arc::default();
    let mut registry = Registry::new();
    registry.handler("operator", &[], |_| Ok(Operator));
    let busy = busy(burst);
    registry.handler("n", &COMMANDS, move |cx| {
        let library = Library::new(()).action("load", |a: Action<()>| async move {
            a.cx().sleep(Duration::from_millis(7)).await;
            Ok(())
        });
        Ok(NetTask::new(
            cx,
            busy.clone(),
            library,
            Conflicts::Declared,
            None,
        ))
    });
    for (index, manner) in manners.iter().copied().enumerate() {
        let _ = writeln!(text, "[task.d{index}]\nhandler = \"d{index}\"\non = \"b\"");
        let all = all.clone();
        registry.handler(&format!("d{index}"), &[], move |_| {
            let seen = Rc::new(RefCell::new(Seen::default()));
            let kept = Kept(index, seen.clone(), all.clone());
            Ok(Keeping(Display(manner, seen), kept))
        });
    }
    let app =
        config::load_texts(&[("app.toml", &text)], &[], &[]).unwrap_or_else(|f| panic!("{f}"));
    let launcher = Launcher {
        program: "none".into(),
        arguments: Vec::new(),
    };
    let observer: boot::Observer = Arc::new(|_| {});
    let text = match boot::boot(app, registry, &launcher, &observer).unwrap().end {
        End::Finished(AppResult { ok: true, text, .. }) => text,
        other => panic!("{other:?}"),
    };
    let seen = std::mem::take(&mut *all.lock().unwrap());
    (text, seen.into_values().collect())
}

type All = Arc<std::sync::Mutex<BTreeMap<usize, Seen>>>;

/// Hands out what a display saw when its task ends.
struct Kept(usize, Rc<RefCell<Seen>>, All);

impl Drop for Kept {
    fn drop(&mut self) {
        self.2.lock().unwrap().insert(self.0, self.1.take());
    }
}

struct Keeping(
    Display,
    #[allow(dead_code, reason = "it is dropped with the task")] Kept,
);

impl EventHandler for Keeping {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        self.0.handle(cx, message).await
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        self.0.phase(cx, phase).await
    }
}

#[test]
fn a_display_that_follows_knows_the_marking_and_every_event_of_a_net_that_fires_slowly() {
    let (text, seen) = run(3, &[Manner::Keen]);
    let seen = &seen[0];
    let last = seen.last.as_ref().unwrap();
    assert_eq!((seen.states, seen.skipped), (1, 0));
    // A symbol, two phases of `take`, three times `spend`, and `give`, ten times, some before it came; and
    // the end of the app.
    assert_eq!(last.seq, 71);
    assert!(last.stopped.is_some());
    assert!(seen.events <= 71 && seen.events >= 60, "{seen:?}");
    assert_eq!(last.ended, [10, 30, 10]);
    assert_eq!(last.busy_ns[0], 70_000_000);
    assert!(last.running.is_empty() && last.tape.is_empty() && last.in_progress.is_none());
    let names = ["free", "work", "left", "done"];
    let places: Vec<(&str, u32)> = names.into_iter().zip(last.places.iter().copied()).collect();
    assert!(
        text.starts_with(&format!("{places:?}")),
        "{text} {places:?}"
    );
}

#[test]
fn displays_that_are_slow_or_stuck_or_a_hundred_delay_no_firing() {
    let (alone, _) = run(3, &[]);
    for manners in [
        vec![Manner::Keen],
        vec![Manner::Stuck; 10],
        vec![Manner::Slow(Duration::from_millis(50)); 10],
        vec![Manner::Keen; 100],
    ] {
        let (watched, _) = run(3, &manners);
        assert_eq!(alone, watched, "{} displays", manners.len());
    }
}

#[test]
fn who_falls_too_far_behind_gets_the_state_and_the_number_of_what_was_missed() {
    let burst = 2 * MOST_EVENTS as u32;
    let (_, seen) = run(
        burst,
        &[Manner::Keen, Manner::Slow(Duration::from_millis(400))],
    );
    for seen in &seen {
        let last = seen.last.as_ref().unwrap();
        assert!(
            seen.states > 1 && seen.skipped > u64::from(burst),
            "{seen:?}"
        );
        assert_eq!(last.ended, [10, 10 * u64::from(burst), 10]);
        assert_eq!(last.places, [1, 0, 0, 0]);
    }
}

#[test]
fn a_net_answers_so_often_and_no_oftener() {
    // Events every 7 ms for 70 ms, each with a burst: at most one batch each 4 ms, and one a second.
    let (_, seen) = run(50, &[Manner::Keen]);
    assert!(seen[0].batches <= 70 / 4 + 5, "{seen:?}");
    let (_, seen) = run(50, &vec![Manner::Keen; 50]);
    for seen in seen {
        assert!(seen.batches <= 70 / 50 + 5, "{seen:?}");
    }
}

#[test]
fn the_latest_events_are_kept_in_order_however_many_came_before() {
    let net = Arc::new(busy(1));
    let execution = Execution::new(net.clone());
    let mut source = Source::new(net, Instant::from_nanos(5));
    for seq in 1..=10 * MOST_EVENTS as u64 {
        let what = Happened::Net(EventPhase::Ordered, seq.to_string());
        source.note(Instant::from_nanos(10 * seq), 0, what, &execution);
        assert_eq!(source.last().unwrap().at_ns, 10 * seq);
        let latest: Vec<(u64, String)> = source.latest(3).map(|e| (e.seq, e.text)).collect();
        let expected = (1..=seq).skip(seq.saturating_sub(3) as usize);
        let expected: Vec<(u64, String)> = expected.map(|seq| (seq, seq.to_string())).collect();
        assert_eq!(latest, expected);
    }
    assert_eq!(source.latest(usize::MAX).count(), 4 * MOST_EVENTS);
}

#[test]
fn an_event_twice_or_left_out_or_of_another_net_is_refused_and_changes_nothing() {
    let net = Arc::new(busy(1));
    let view = NetView::new(&net);
    let mut execution = Execution::new(net.clone());
    let mut source = Source::new(net.clone(), Instant::from_nanos(5));
    let now = Instant::from_nanos(9);
    let mut replica = Replica::new(&view, source.state(now, &execution)).unwrap();
    execution.put_symbol("go", Vec::new()).unwrap();
    let asked = Happened::Asked("go".to_owned(), String::new());
    source.note(now, 0, asked, &execution);
    let event = source.last().unwrap();
    replica.apply(&event).unwrap();
    let good = replica.state().clone();
    assert!(matches!(
        replica.apply(&event),
        Err(ReplicaError::Gap {
            expected: 2,
            found: 1,
            ..
        })
    ));
    let other = Event {
        seq: 2,
        transition: "nobody".to_owned(),
        ..event.clone()
    };
    let error = replica.apply(&other).unwrap_err().to_string();
    assert_eq!(
        error,
        "net `n` has no transition `nobody`, which event 2 names"
    );
    let greedy = Event {
        seq: 2,
        consumed: vec![("free".to_owned(), 2)],
        ..event
    };
    let error = replica.apply(&greedy).unwrap_err().to_string();
    assert_eq!(
        error,
        "net `n`: event 2 takes 2 tokens from `free`, which has 1"
    );
    assert_eq!(replica.state(), &good);
    let mut foreign = good.clone();
    foreign.places.pop();
    assert!(matches!(
        replica.set(foreign),
        Err(ReplicaError::Other { .. })
    ));
}

/// What happens to a net from outside.
#[derive(Debug, Clone)]
enum Push {
    Go,
    Fire(usize),
    End(usize, bool),
    Receive(usize),
}

fn pushes() -> impl Strategy<Value = Vec<Push>> {
    let one = prop_oneof![
        Just(Push::Go),
        (0_usize..8).prop_map(Push::Fire),
        (0_usize..4, any::<bool>()).prop_map(|(index, ok)| Push::End(index, ok)),
        (0_usize..4).prop_map(Push::Receive),
    ];
    prop::collection::vec(one, 0..60)
}

#[test]
fn a_request_is_told_by_its_authors_name_with_what_happened_to_it() {
    let text = "net n\nplace a = 1, b, gone\ncoordinator m : go\ntransition move\n  in a\n  ask m go\n  out b\n  fail gone\ntransition turn\n  in b\n  out a\n";
    let net = Arc::new(compile::net(&Text::new("n.net", text)).unwrap());
    let view = NetView::new(&net);
    let mut execution = Execution::new(Arc::clone(&net));
    let mut source = Source::new(Arc::clone(&net), Instant::from_nanos(0));
    let mut told = Vec::new();
    for name in ["start_move", "end_move", "turn", "start_move", "fail_move"] {
        if let Some(answer) = name.strip_suffix("_move").filter(|part| *part != "start") {
            let place = if answer == "end" { "O_m" } else { "OF_m" };
            execution.put_tokens(place, 1).unwrap();
            execution.put_tokens("SI_m", 1).unwrap();
        }
        let id = net.transition(name).unwrap();
        execution.fire(id).unwrap();
        let what = Happened::Transition(id, EventPhase::Fired, None, String::new(), Vec::new());
        source.note(Instant::from_nanos(0), 0, what, &execution);
        let event = source.last().unwrap();
        let (transition, phase) = view.told(&event);
        told.push(format!("{transition} {phase}"));
    }
    assert_eq!(
        told,
        [
            "move started",
            "move completed",
            "turn fired",
            "move started",
            "move failed"
        ]
    );
}

proptest! {
    #[test]
    fn whatever_happens_a_replica_is_as_the_net(pushes in pushes()) {
        let net = Arc::new(net("net n
place a = 2, b, c = 1, d
command go -> gone, lost
transition read
  in a
  tape go
  do work
  out b*2
transition branch
  in b
  do work
  out c, there@m*2
  fail d
transition both
  in b, c
  tape go
  out a
  write gone
transition answer
  in d
  read c
  out a
  write lost
transition loop
  in c
  inhibit d
  out c, a
"));
        let view = NetView::new(&net);
        let mut execution = Execution::new(net.clone());
        let mut source = Source::new(net.clone(), Instant::from_nanos(0));
        let mut replica = Replica::new(&view, source.state(Instant::from_nanos(0), &execution)).unwrap();
        for (at, push) in pushes.into_iter().enumerate() {
            let now = Instant::from_nanos(at as u64);
            let what = match push {
                Push::Go => {
                    execution.put_symbol("go", Vec::new()).unwrap();
                    Happened::Asked("go".to_owned(), String::new())
                }
                Push::Fire(index) => {
                    let Some(id) = execution.enabled().nth(index) else { continue };
                    if net[id].action.is_some() {
                        let firing = execution.start(id).unwrap();
                        Happened::Transition(id, EventPhase::Started, Some(firing), String::new(), Vec::new())
                    } else {
                        execution.fire(id).unwrap();
                        Happened::Transition(id, EventPhase::Fired, None, String::new(), Vec::new())
                    }
                }
                Push::End(index, ok) => {
                    let Some((firing, id)) = execution.running().nth(index) else { continue };
                    let (result, phase) = if ok {
                        (execution.complete(firing).map(|_| ()), EventPhase::Completed)
                    } else {
                        (execution.fail(firing).map(|_| ()), EventPhase::Failed)
                    };
                    result.unwrap();
                    Happened::Transition(id, phase, Some(firing), String::new(), Vec::new())
                }
                Push::Receive(index) => {
                    let name = &net.places()[index].name;
                    execution.put_tokens(name, 1).unwrap();
                    Happened::Tokens(EventPhase::Received, [(net.place(name).unwrap(), 1)].into_iter().collect(), "m".into())
                }
            };
            source.note(now, 0, what, &execution);
            let event = source.last().unwrap();
            // As it comes from another process, and from a record.
            let json = serde_json::to_string(&event).unwrap();
            prop_assert_eq!(&serde_json::from_str::<Event>(&json).unwrap(), &event);
            replica.apply(&event).unwrap();
            prop_assert_eq!(replica.state(), &source.state(now, &execution));
        }
    }
}

#[test]
fn a_replica_has_the_values_of_declared_data_after_each_event_and_the_view_says_beside_which_place()
{
    let text = "net n\nplace p = 1, found data spot\ndata count : int = 4\ndata spot { u : px, far : bool }\ntransition t\n  in p\n  set count = 5\n  out p\n";
    let net = Arc::new(net(text));
    let view = NetView::new(&net);
    let shown = |one: &DataView| {
        let place = one
            .place
            .map(|place| view.places[place as usize].name.clone());
        (
            one.name.clone(),
            one.kind.clone(),
            one.initial.clone(),
            place,
        )
    };
    let name = str::to_owned;
    assert_eq!(
        view.data.iter().map(shown).collect::<Vec<_>>(),
        [
            (name("count"), name("int"), name("4"), None),
            (name("spot.u"), name("px"), name("0.0"), Some(name("found"))),
            (
                name("spot.far"),
                name("bool"),
                name("false"),
                Some(name("found"))
            ),
        ]
    );
    let mut execution = Execution::new(Arc::clone(&net));
    let now = Instant::from_nanos(0);
    let mut source = Source::new(Arc::clone(&net), now);
    let mut replica = Replica::new(&view, source.state(now, &execution)).unwrap();
    let id = net.transition("t").unwrap();
    let changes: [&[(usize, Value)]; 2] = [
        &[(0, Value::Int(5))],
        &[(1, Value::Float(1.5)), (2, Value::Bool(true))],
    ];
    for changed in changes {
        let firing = execution.start(id).unwrap();
        let begun = Happened::Transition(
            id,
            EventPhase::Started,
            Some(firing),
            String::new(),
            Vec::new(),
        );
        source.note(now, 0, begun, &execution);
        replica.apply(&source.last().unwrap()).unwrap();
        execution.complete(firing).unwrap();
        let done = Happened::Transition(
            id,
            EventPhase::Completed,
            Some(firing),
            String::new(),
            changed.to_vec(),
        );
        source.note(now, 0, done, &execution);
        replica.apply(&source.last().unwrap()).unwrap();
        assert_eq!(replica.state(), &source.state(now, &execution));
    }
    assert_eq!(replica.state().data, ["5", "1.5", "true"]);
    let strange = Event {
        data: vec![(name("cuont"), name("1"))],
        seq: 5,
        ..source.last().unwrap()
    };
    let error = replica.apply(&strange).unwrap_err().to_string();
    assert_eq!(error, "net `n` has no data `cuont`, which event 5 names");
}

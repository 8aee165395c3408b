//! Nets whose app is stopped while they work.

use std::sync::Mutex;

use ctos::{
    boot::BootEvent,
    simulation::{self, Setup},
};

use super::{
    survival::{register_with_settings, tokens},
    *,
};

type Trace = Arc<Mutex<Vec<String>>>;

ctos::command! {
    /// Switches the lamp.
    #[derive(Clone)]
    struct Switch { on: bool } => (), 0x0401, "switch"
}
ctos::command! {
    /// Moves until somebody stops it.
    struct Move => (), 0x0402, "move"
}

/// A lamp and an arm, on a chassis that is stopped first.
struct Device {
    trace: Trace,
    moving: Option<ctos::message::Replier<Move>>,
}

impl EventHandler for Device {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            Switch::CODE => {
                let (Switch { on }, reply) = message.open::<Switch>()?;
                self.trace.lock().unwrap().push(format!("lamp {on}"));
                reply.ok(())
            }
            Move::CODE => {
                let (Move {}, reply) = message.open::<Move>()?;
                self.moving = Some(reply);
                Ok(())
            }
            _ => cx.default_processing(message),
        }
    }

    async fn quiesce(&mut self, _: &Context, _: &StopReason) -> Handled {
        match self.moving.take() {
            Some(reply) => reply.fail("stopped"),
            None => Ok(()),
        }
    }

    async fn stop(&mut self, _: &Context, _: &StopReason) -> Handled {
        self.trace.lock().unwrap().push("device stops".to_owned());
        Ok(())
    }
}

/// Takes the lamp, moves, and gives it back in either branch.
const WORK: &str = "net work
place idle = 1, lit, moved, failed, dark
command go -> done, broken
transition light
  in idle
  tape go
  do light
  out lit
transition move
  in lit
  do move
  out moved
  fail failed
transition darken
  in moved
  do darken
  out dark
transition darken_after
  in failed
  do darken
  out idle
  write broken
transition end
  in dark
  out idle
  write done
";

fn work(trace: &Trace) -> Library<()> {
    let switch = |on: bool| {
        move |action: Action<()>| async move {
            let device = action.cx().task("device").await?;
            Ok(action.cx().call(&device, Switch { on }).await?)
        }
    };
    let trace = trace.clone();
    Library::new(())
        .action("light", switch(true))
        .action("darken", switch(false))
        .action("move", move |action: Action<()>| {
            let trace = trace.clone();
            async move {
                let device = action.cx().task("device").await?;
                let limit = Duration::from_secs(1000);
                let moved = action.cx().call(&device, Move {}).deadline(limit).await;
                let said = format!("moved {}, {}", moved.is_ok(), action.is_stopping());
                trace.lock().unwrap().push(said);
                Ok(moved?)
            }
        })
}

fn register_device(registry: &mut Registry, trace: &Trace) {
    let trace = trace.clone();
    registry.handler("device", &[Switch::INFO, Move::INFO], move |_| {
        Ok(Device {
            trace: trace.clone(),
            moving: None,
        })
    });
}

/// Puts each command on the tape of its net concurrently with the others, and notes what it is told.
struct Asks {
    commands: &'static [(&'static str, &'static str)],
    trace: Trace,
    ends: bool,
}

impl EventHandler for Asks {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            for (net, command) in self.commands {
                cx.spawn(ask(cx.clone(), net, command, self.trace.clone()));
            }
            let (own, ends) = (cx.clone(), self.ends);
            cx.spawn(async move {
                own.sleep(Duration::from_secs(2)).await;
                if ends {
                    own.finish(AppResult {
                        ok: true,
                        text: String::new(),
                        json: String::new(),
                    });
                }
            });
        }
        Ok(())
    }

    async fn quiesce(&mut self, cx: &Context, _: &StopReason) -> Handled {
        // A command that comes too late.
        for (net, command) in self.commands {
            cx.spawn(ask(cx.clone(), net, command, self.trace.clone()));
        }
        Ok(())
    }
}

async fn ask(cx: Context, net: &str, command: &str, trace: Trace) {
    let late = if cx.is_stopping() { "late " } else { "" };
    let to = cx.task(net).await.unwrap();
    let put = PutTape {
        symbol: command.to_owned(),
        arguments: Vec::new(),
    };
    let limit = Duration::from_secs(3600);
    let answer = match cx.call(&to, put).deadline(limit).await {
        Ok(answer) => answer.symbol,
        Err(error) => error.reason(),
    };
    let said = format!("{late}{net} {command}: {answer}");
    trace.lock().unwrap().push(said);
}

struct Ran {
    trace: Vec<String>,
    events: Vec<String>,
    /// How long the step took in which the tasks come to rest.
    quiet: Duration,
}

/// Runs nets on chassis of their own, with the device on one that is stopped first. The person (or the result) ends
/// it after two seconds.
fn run(
    nets: &[&str],
    commands: &'static [(&'static str, &'static str)],
    ends: bool,
    mut registry: Registry,
    trace: &Trace,
) -> Ran {
    use std::fmt::Write as _;
    let mut text = String::from(
        "[app]\nuntil = \"asks\"\nstop_timeout_s = 10\n[chassis.cage]\nstop_first = true\n[task.device]\nhandler = \"device\"\non = \"cage\"\n[chassis.desk]\n[task.asks]\nhandler = \"asks\"\non = \"desk\"\n",
    );
    for net in nets {
        let _ = writeln!(
            text,
            "[chassis.on_{net}]\n[task.{net}]\nhandler = \"{net}\"\non = \"on_{net}\""
        );
    }
    let app =
        config::load_texts(&[("app.toml", &text)], &[], &[]).unwrap_or_else(|f| panic!("{f}"));
    register_device(&mut registry, trace);
    let of = trace.clone();
    registry.handler("asks", &[], move |_| {
        Ok(Asks {
            commands,
            trace: of.clone(),
            ends,
        })
    });
    let events = Arc::<Mutex<Vec<String>>>::default();
    let quiet = Arc::<Mutex<Duration>>::default();
    let (seen, long) = (events.clone(), quiet.clone());
    let observer: boot::Observer = Arc::new(move |event: &BootEvent| {
        let said = match event {
            BootEvent::NotQuiet { task, reason } => format!("{task}: {reason}"),
            BootEvent::Quiet { took, tasks, of } => {
                *long.lock().unwrap() = *took;
                format!("quiet {tasks}/{of}")
            }
            BootEvent::Stopped {
                error: Some(error), ..
            } => format!("error {error}"),
            _ => return,
        };
        seen.lock().unwrap().push(said);
    });
    let setup = Setup {
        stop_after: (!ends).then_some(Duration::from_secs(2)),
        ..Setup::default()
    };
    simulation::run(app, registry, setup, &observer).unwrap();
    let (trace, events) = (
        trace.lock().unwrap().clone(),
        events.lock().unwrap().clone(),
    );
    let quiet = *quiet.lock().unwrap();
    Ran {
        trace,
        events,
        quiet,
    }
}

#[test]
fn a_command_in_work_gives_back_what_it_took_before_the_device_is_stopped_and_the_tape_refuses() {
    for ends in [false, true] {
        let (mut registry, trace) = (Registry::new(), Trace::default());
        let of = trace.clone();
        register_net(&mut registry, WORK, move || work(&of));
        let ran = run(
            &["work"],
            &[("work", "go"), ("work", "go")],
            ends,
            registry,
            &trace,
        );
        let waiting = "work go: net `work` did not begin it: the app is being stopped";
        let late = "late work go: net `work` takes no commands: the app is being stopped";
        let mut told = ran.trace.clone();
        told.sort();
        let mut expected = [
            "lamp true",
            "moved false, true",
            "lamp false",
            "work go: broken",
            waiting,
            late,
            late,
            "device stops",
        ];
        expected.sort_unstable();
        assert_eq!(told, expected, "{ends}");
        let at = |what: &str| ran.trace.iter().position(|one| one == what).unwrap();
        assert!(at("lamp false") < at("work go: broken"));
        assert!(at("work go: broken") < at("device stops"));
        assert_eq!(ran.events, ["quiet 3/3"]);
        assert!(ran.quiet < Duration::from_secs(1), "{:?}", ran.quiet);
    }
}

#[test]
fn an_action_that_never_ends_is_cancelled_takes_its_failure_branch_and_the_device_is_given_back() {
    let (mut registry, trace) = (Registry::new(), Trace::default());
    let of = trace.clone();
    register_net(&mut registry, WORK, move || {
        work(&of).action("move", |_| std::future::pending())
    });
    let ran = run(&["work"], &[("work", "go")], false, registry, &trace);
    let after: Vec<&str> = ran
        .trace
        .iter()
        .map(String::as_str)
        .filter(|one| !one.contains("late"))
        .collect();
    assert_eq!(
        after,
        ["lamp true", "lamp false", "work go: broken", "device stops"]
    );
    assert_eq!(ran.events, ["quiet 3/3"]);
    let (least, most) = (Duration::from_secs(9), Duration::from_millis(9500));
    assert!(ran.quiet >= least && ran.quiet < most, "{:?}", ran.quiet);
}

#[test]
fn an_action_that_does_not_end_even_then_is_named_and_the_stop_goes_on() {
    let (mut registry, trace) = (Registry::new(), Trace::default());
    let of = trace.clone();
    register_net(&mut registry, WORK, move || {
        work(&of)
            .action("move", |_| std::future::pending())
            .action("darken", |_| std::future::pending())
    });
    let ran = run(&["work"], &[("work", "go")], false, registry, &trace);
    let late = "work: not within 10.000 s: command `go` is in work, transition `darken_after` is in action";
    assert_eq!(ran.events, [late, "quiet 2/3"]);
    assert!(ran.trace.contains(&"device stops".to_owned()));
    let told = ran
        .trace
        .iter()
        .any(|one| one.starts_with("work go: net `work` has stopped"));
    assert!(told, "{:#?}", ran.trace);
}

#[test]
fn an_action_without_failure_branch_is_not_tried_again() {
    const TRIES: &str = "net tries
place idle = 1, moved
command go -> done
transition move
  in idle
  tape go
  do move
  out moved
transition end
  in moved
  out idle
  write done
";
    let (mut registry, trace) = (Registry::new(), Trace::default());
    let of = trace.clone();
    register_net(&mut registry, TRIES, move || work(&of));
    let ran = run(&["tries"], &[("tries", "go")], false, registry, &trace);
    let moves = ran.trace.iter().filter(|one| one.starts_with("moved"));
    assert_eq!(moves.count(), 1, "{:#?}", ran.trace);
    let why = "tries go: net `tries` has stopped: transition `move` failed and is not tried again, because the app is being stopped: ";
    assert!(
        ran.trace.iter().any(|one| one.starts_with(why)),
        "{:#?}",
        ran.trace
    );
    assert!(ran.quiet < Duration::from_secs(1), "{:?}", ran.quiet);
}

#[test]
fn nets_that_work_for_nobody_do_not_hold_the_stop_up() {
    const CLOCK: &str = "net clock\nplace a = 1, b\ntransition tick\n  in a\n  time 10 ms\n  out b\ntransition tock\n  in b\n  do walk\n  out a\n";
    let (mut registry, trace) = (Registry::new(), Trace::default());
    register_net(&mut registry, CLOCK, || {
        Library::new(()).action("walk", slow(Duration::from_millis(100)))
    });
    let ran = run(&["clock"], &[], false, registry, &trace);
    assert_eq!(ran.events, ["quiet 3/3"]);
    assert!(ran.quiet < Duration::from_millis(200), "{:?}", ran.quiet);
}

/// Asks a coordinator three times, each after what came of the time before.
const BOSS: &str = "net boss
place ready = 1, one, two, three, failed
coordinator helper : help
command go -> done, broken
transition first
  in ready
  tape go
  ask helper help
  out one
  fail failed
transition second
  in one
  ask helper help
  out two
  fail failed
transition last
  in two
  out ready
  write done
transition broken
  in failed
  out ready
  write broken
";

const HELPER: &str = "net helper
place helped, not_helped
serves boss : help ; done helped ; failed not_helped
transition begin
  in I_help
  do help
  out helped
  fail not_helped
";

#[test]
fn a_coordinator_that_is_idle_still_serves_a_net_with_a_command_in_work() {
    let (mut registry, trace) = (Registry::new(), Trace::default());
    register_net(&mut registry, BOSS, || Library::new(()));
    register_net(&mut registry, HELPER, || {
        Library::new(()).action("help", slow(Duration::from_millis(1500)))
    });
    let ran = run(
        &["boss", "helper"],
        &[("boss", "go")],
        false,
        registry,
        &trace,
    );
    // The first request is in work when the stop begins, and the second one comes while it goes on.
    assert!(
        ran.trace.contains(&"boss go: done".to_owned()),
        "{:#?}",
        ran.trace
    );
    assert_eq!(ran.events, ["quiet 4/4"]);
    assert!(ran.quiet < Duration::from_secs(2), "{:?}", ran.quiet);
}

#[test]
fn a_library_is_told_that_a_stop_is_on_and_leads_its_net_to_an_end() {
    const LOOP: &str = "net rounds
place idle = 1, round
command go -> done
transition begin
  in idle
  tape go
  out round
transition again
  in round
  when more
  do walk
  out round
transition end
  in round
  when not more
  out idle
  write done
";
    let (mut registry, trace) = (Registry::new(), Trace::default());
    register_net(&mut registry, LOOP, || {
        Library::new(true)
            .enabling("more", |more| *more)
            .action("walk", |action: Action<bool>| async move {
                action.cx().sleep(Duration::from_millis(300)).await;
                Ok(())
            })
            .when_stopping(|more| *more = false)
    });
    let ran = run(&["rounds"], &[("rounds", "go")], false, registry, &trace);
    assert!(
        ran.trace.contains(&"rounds go: done".to_owned()),
        "{:#?}",
        ran.trace
    );
    assert!(ran.quiet < Duration::from_millis(400), "{:?}", ran.quiet);
}

#[test]
fn a_durable_net_ends_its_action_and_keeps_the_command_in_work_for_the_next_boot() {
    const KEEPS: &str = "net keeps
place idle = 1, one, two
command go -> done
transition first
  in idle
  tape go
  do walk
  idempotent
  out one
transition second
  in one
  do walk
  idempotent
  out two
transition end
  in two
  out idle
  write done
";
    /// Looks at the net while it is to come to rest.
    struct Looks(Trace);

    impl EventHandler for Looks {
        async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
            cx.default_processing(message)
        }

        async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
            if phase == Phase::Run {
                for _ in 0..2 {
                    cx.spawn(ask(cx.clone(), "keeps", "go", self.0.clone()));
                }
            }
            Ok(())
        }

        async fn quiesce(&mut self, cx: &Context, _: &StopReason) -> Handled {
            let (own, trace) = (cx.clone(), self.0.clone());
            let look = async move {
                own.sleep(Duration::from_secs(8)).await;
                let net = own.task("keeps").await?;
                let now = own.call(&net, Marking {}).await?;
                let said = format!(
                    "one {}, acts {:?}, in work {:?}, waiting {:?}",
                    tokens(&now, "one"),
                    now.in_action,
                    now.in_progress,
                    now.tape
                );
                trace.lock().unwrap().push(said);
                Ok(())
            };
            cx.quiet_after(|| "a look".to_owned(), look);
            Ok(())
        }
    }
    let app = "[app]\nstop_timeout_s = 10\n[chassis.desk]\n[task.looks]\nhandler = \"looks\"\non = \"desk\"\n[chassis.cell]\n[task.keeps]\nhandler = \"keeps\"\non = \"cell\"\nargs = { net = \"keeps.net\", durable = true }\n";
    let app = config::load_texts(&[("app.toml", app)], &[], &[]).unwrap_or_else(|f| panic!("{f}"));
    let (mut registry, trace) = (Registry::new(), Trace::default());
    register_with_settings(&mut registry, KEEPS, || {
        Library::new(()).action("walk", slow(Duration::from_secs(3)))
    });
    let of = trace.clone();
    registry.handler("looks", &[], move |_| Ok(Looks(of.clone())));
    let observer: boot::Observer = Arc::new(|_| {});
    let setup = Setup {
        stop_after: Some(Duration::from_secs(2)),
        ..Setup::default()
    };
    simulation::run(app, registry, setup, &observer).unwrap();
    let kept = r#"one 1, acts [], in work Some("go"), waiting ["go"]"#;
    let trace = trace.lock().unwrap();
    assert_eq!(trace.first().unwrap(), kept);
    // As after every stop: waiting callers learn that the net has stopped, and the next boot goes
    // on.
    let told = trace
        .iter()
        .filter(|one| one.contains("net `keeps` has stopped"));
    assert_eq!(told.count(), 2, "{trace:#?}");
}

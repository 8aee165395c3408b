//! What displays cost the net that they follow: an app in virtual time, whose net fires 50 times a
//! millisecond, alone and with 1, 10 and 100 displays. Everything runs on one thread, so the figures hold
//! the work of the displays too: the net's own share is smaller.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a benchmark may end when its input is wrong"
)]

use std::{fmt::Write as _, sync::Arc, time::Duration};

use ctos::{
    boot::{self, End, Launcher},
    config,
    diagnostic::Source,
    message::Message,
    registry::Registry,
    system::AppResult,
    task::{Context, EventHandler, Handled, HandlerError, Phase},
};
use divan::{Bencher, counter::ItemsCount};
use pnt::{
    compile,
    exec::Conflicts,
    library::{Action, Library},
    stream::{Follow, Mark},
    task::{COMMANDS, NetTask, PutTape},
};

const CYCLES: usize = 200;
const BURST: usize = 50;

fn main() {
    divan::main();
}

/// Asks for what is new, again and again.
struct Display;

impl EventHandler for Display {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let child = cx.clone();
            cx.spawn(async move {
                // It ends with the app.
                let _ = follow(&child).await;
            });
        }
        Ok(())
    }
}

async fn follow(cx: &Context) -> Handled {
    let to = cx.task("n").await?;
    let mut after: Option<Mark> = None;
    loop {
        let follow = Follow {
            after,
            patience_ms: 1000,
        };
        after = Some(cx.call(&to, follow).await?.mark);
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
                let done = operate(&child).await;
                child.finish(AppResult {
                    ok: done.is_ok(),
                    text: String::new(),
                    json: String::new(),
                });
            });
        }
        Ok(())
    }
}

async fn operate(cx: &Context) -> Result<(), HandlerError> {
    let to = cx.task("n").await?;
    for _ in 0..CYCLES {
        let put = PutTape {
            symbol: "go".to_owned(),
            arguments: Vec::new(),
        };
        cx.call(&to, put).await?;
    }
    Ok(())
}

fn run(displays: usize) {
    let text = format!(
        "net n\nplace free = 1, work, left, done\ncommand go -> gone\ntransition take\n  in free\n  tape go\n  do nap\n  out work, left*{BURST}\ntransition spend\n  in left\n  out done\ntransition give\n  in work, done*{BURST}\n  out free\n  write gone\n"
    );
    let net = compile::net(&Source::new("n.net", text)).unwrap();
    let mut registry = Registry::new();
    registry.handler("operator", &[], |_| Ok(Operator));
    registry.handler("display", &[], |_| Ok(Display));
    registry.handler("n", &COMMANDS, move |cx| {
        let library = Library::new(()).action("nap", |a: Action<()>| async move {
            a.cx().sleep(Duration::from_millis(1)).await;
            Ok(())
        });
        Ok(NetTask::new(
            cx,
            net.clone(),
            library,
            Conflicts::Declared,
            None,
        ))
    });
    let mut config = "[app]\nname = \"t\"\nuntil = \"operator\"\n[time]\nmode = \"virtual\"\n[chassis.a]\n[task.operator]\nhandler = \"operator\"\non = \"a\"\n[task.n]\nhandler = \"n\"\non = \"a\"\n".to_owned();
    for index in 0..displays {
        let _ = writeln!(config, "[task.d{index}]\nhandler = \"display\"\non = \"a\"");
    }
    let app =
        config::load_texts(&[("app.toml", &config)], &[], &[]).unwrap_or_else(|f| panic!("{f}"));
    let launcher = Launcher {
        program: "none".into(),
        arguments: Vec::new(),
    };
    let observer: boot::Observer = Arc::new(|_| {});
    let outcome = boot::boot(app, registry, &launcher, &observer).unwrap();
    assert!(matches!(
        outcome.end,
        End::Finished(AppResult { ok: true, .. })
    ));
}

#[divan::bench(args = [0, 1, 10, 100], sample_count = 20)]
fn firings_with_displays(bencher: Bencher, displays: usize) {
    bencher
        .counter(ItemsCount::new(CYCLES * (BURST + 3)))
        .bench(|| run(displays));
}

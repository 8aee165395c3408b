//! Nets that pass tokens round for ever, and who counts them when told to.

use std::{io::Write, path::Path, time::Duration};

use ctos::{
    message::{Command, Message},
    registry::Registry,
    system::AppResult,
    task::{Context, EventHandler, Handled, HandlerError, Phase},
};
use pnt::{
    library::{Action, Library},
    task::{Control, Marking, Order, PutOnce, RequestId, Snapshot, put_once},
};
use serde::Deserialize;

/// How long a command may take.
const LIMIT: Duration = Duration::from_secs(600);

/// Arguments of [`Counter`].
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct CounterArgs {
    nets: Vec<String>,
    /// The file whose appearance, in the folder of the configuration, begins the count.
    when: String,
}

/// Pauses the nets when told to, waits until nothing is on its way, and counts the tokens of all.
struct Counter(CounterArgs);

impl EventHandler for Counter {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let (args, cx) = (self.0.clone(), cx.clone());
            cx.clone().spawn(async move {
                while !Path::new(&cx.path(&args.when)).exists() {
                    cx.sleep(Duration::from_millis(20)).await;
                }
                let (ok, text) = match count(&cx, &args.nets).await {
                    Ok(text) => (true, text),
                    Err(error) => (false, error.to_string()),
                };
                let json = format!("{{\"ok\":{ok}}}");
                cx.finish(AppResult { ok, text, json });
            });
        }
        Ok(())
    }
}

/// Puts one command after the other on the tape of the net `net`, each once. It ends when there is a file `enough` in the
/// folder of the configuration. What it is told goes to the file `told`, in which a process after it finds what was
/// answered.
struct Putter;

/// Adds a line to `told`.
fn tell(cx: &Context, line: &str) -> Result<(), HandlerError> {
    let mut options = std::fs::OpenOptions::new();
    let mut file = options.create(true).append(true).open(cx.path("told"))?;
    // In one piece: others write there too.
    file.write_all(format!("{line}\n").as_bytes())?;
    Ok(())
}

async fn put_all(cx: &Context) -> Result<(), HandlerError> {
    let told = std::fs::read_to_string(cx.path("told")).unwrap_or_default();
    let answered = told.lines().filter(|line| line.starts_with("answered "));
    let mut number = answered.count() as u64;
    while !cx.path("enough").exists() {
        number += 1;
        let put = PutOnce {
            request: RequestId {
                from: "putter".to_owned(),
                number,
            },
            symbol: "go".to_owned(),
            arguments: vec![number.to_string()],
        };
        let answer = put_once(cx, "net", &put, LIMIT).await;
        match answer {
            Ok(answer) => tell(cx, &format!("answered {number} {}", answer.symbol))?,
            Err(error) => tell(cx, &format!("failed {number} {error}"))?,
        }
    }
    Ok(())
}

impl EventHandler for Putter {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let cx = cx.clone();
            cx.clone().spawn(async move {
                let put = put_all(&cx).await;
                cx.finish(AppResult {
                    ok: put.is_ok(),
                    text: put.err().map(|error| error.to_string()).unwrap_or_default(),
                    json: "{}".to_owned(),
                });
            });
        }
        Ok(())
    }
}

async fn ask<C: Command>(cx: &Context, net: &str, request: C) -> Result<C::Reply, HandlerError> {
    let to = cx.task(net).await?;
    Ok(cx.call(&to, request).await?)
}

async fn count(cx: &Context, nets: &[String]) -> Result<String, HandlerError> {
    for net in nets {
        let (order, by) = (Order::Pause, cx.name().to_owned());
        ask(cx, net, Control { order, by }).await?;
    }
    let mut before = None;
    loop {
        let mut snapshots: Vec<Snapshot> = Vec::new();
        for net in nets {
            snapshots.push(ask(cx, net, Marking {}).await?);
        }
        let rests = |one: &Snapshot| one.in_action.is_empty() && one.sending.is_empty();
        if snapshots.iter().all(rests) {
            let places = |one: &Snapshot| one.places.clone();
            let now: Vec<_> = snapshots.iter().map(places).collect();
            // The nets are looked at one after the other: tokens may go from one that comes to one that was counted.
            if before.as_ref() == Some(&now) {
                let tokens: u32 = now.iter().flatten().map(|(_, tokens)| tokens).sum();
                return Ok(format!("{tokens} tokens"));
            }
            before = Some(now);
        }
        cx.sleep(Duration::from_millis(20)).await;
    }
}

/// Registers the handlers.
pub fn register(registry: &mut Registry) {
    pnt::task::register(registry, "test.net", || {
        Library::new(()).action("work", |action: Action<()>| async move {
            action.cx().sleep(Duration::from_millis(15)).await;
            Ok(())
        })
    });
    pnt::task::register(registry, "test.told", || {
        Library::new(()).action("work", |action: Action<()>| async move {
            action.cx().sleep(Duration::from_millis(5)).await;
            let number = action.arguments().concat();
            tell(action.cx(), &format!("did {number}"))
        })
    });
    registry.handler("test.putter", &[], |_| Ok(Putter));
    let counter = registry.handler("test.counter", &[], |cx| Ok(Counter(cx.args()?)));
    counter.args::<CounterArgs>();
}

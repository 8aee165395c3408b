//! Nets that pass tokens round for ever, and who counts them when told to.

use std::{path::Path, time::Duration};

use ctos::{
    message::{Command, Message},
    registry::Registry,
    system::AppResult,
    task::{Context, EventHandler, Handled, HandlerError, Phase},
};
use pnt::{
    library::{Action, Library},
    task::{Control, Marking, Order, Snapshot},
};
use serde::Deserialize;

/// Arguments of [`Counter`].
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct CounterArgs {
    /// The nets.
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

async fn ask<C: Command>(cx: &Context, net: &str, request: C) -> Result<C::Reply, HandlerError> {
    let to = cx.task(net).await?;
    Ok(cx.call(&to, request).await?)
}

async fn count(cx: &Context, nets: &[String]) -> Result<String, HandlerError> {
    for net in nets {
        let (order, by) = (Order::Pause, cx.name().to_owned());
        ask(cx, net, Control { order, by }).await?;
    }
    loop {
        let mut snapshots: Vec<Snapshot> = Vec::new();
        for net in nets {
            snapshots.push(ask(cx, net, Marking {}).await?);
        }
        let rests = |one: &Snapshot| one.in_action.is_empty() && one.sending.is_empty();
        if snapshots.iter().all(rests) {
            let places = snapshots.iter().flat_map(|one| &one.places);
            let tokens: u32 = places.map(|(_, tokens)| tokens).sum();
            return Ok(format!("{tokens} tokens"));
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
    let counter = registry.handler("test.counter", &[], |cx| Ok(Counter(cx.args()?)));
    counter.args::<CounterArgs>();
}

//! A tally whose state can survive its process, and who counts with it until told to stop.

use std::{path::Path, time::Duration};

use ctos::{
    message::{Command, Message},
    registry::Registry,
    system::AppResult,
    task::{Context, Durable, EventHandler, Handled, HandlerError, Handover, Phase},
};

ctos::command! {
    /// Counts to a number, unless that was done before: the count.
    pub struct CountTo { pub number: u64 } => u64, 1, "count_to"
}

/// Counts.
struct Tally(u64);

impl EventHandler for Tally {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        if message.command() != CountTo::CODE {
            return cx.default_processing(message);
        }
        let (CountTo { number }, reply) = message.open::<CountTo>()?;
        if number == self.0 + 1 {
            self.0 = number;
        }
        reply.ok(self.0)
    }
}

impl Handover for Tally {
    type State = u64;

    fn hand_over(&mut self) -> Result<u64, HandlerError> {
        Ok(self.0)
    }

    fn take_over(&mut self, _: &Context, count: u64) -> Handled {
        self.0 = count;
        Ok(())
    }
}

impl Durable for Tally {
    fn state(&self) -> u64 {
        self.0
    }
}

/// Has the task `tally` count on, each number until it is answered, until the file `enough` is there.
struct Counting;

impl EventHandler for Counting {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let cx = cx.clone();
            cx.clone().spawn(async move {
                let said = count(&cx).await;
                let ok = said.is_ok();
                let text = said.unwrap_or_else(|error| error.to_string());
                let json = format!("{{\"ok\":{ok}}}");
                cx.finish(AppResult { ok, text, json });
            });
        }
        Ok(())
    }
}

async fn count(cx: &Context) -> Result<String, HandlerError> {
    let began = ask(cx, 0).await?;
    let mut last = began;
    while !Path::new(&cx.path("enough")).exists() || last < began + 20 {
        let counted = ask(cx, last + 1).await?;
        if counted != last + 1 {
            return Err(format!("{counted} after {last}").into());
        }
        last = counted;
    }
    Ok(format!("from {began} to {last}"))
}

async fn ask(cx: &Context, number: u64) -> Result<u64, HandlerError> {
    loop {
        let tally = cx.wait_for_task("tally", Duration::from_secs(20)).await?;
        match cx.call(&tally, CountTo { number }).await {
            Ok(count) => return Ok(count),
            Err(_) => cx.sleep(Duration::from_millis(2)).await,
        }
    }
}

/// Registers the handlers.
pub fn register(registry: &mut Registry) {
    registry.durable("test.tally", &[CountTo::INFO], |_| Ok(Tally(0)));
    registry.handler("test.counting", &[], |_| Ok(Counting));
}

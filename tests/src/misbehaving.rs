//! A program like `ctos` with event handlers of its own, which break the rules of startup and of
//! stopping: what the boot must then say and undo is tested with it.

use std::process::ExitCode;

use ctos::{
    message::Message,
    registry::Registry,
    task::{Context, EventHandler, Handled, Phase, StopReason},
};
use serde::Deserialize;

/// What the handler does wrong.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Fault {
    /// It does nothing wrong.
    Nothing,
    /// It refuses the phase.
    Refuse,
    /// It panics in the phase.
    Panic,
    /// It never acknowledges the phase.
    Silence,
    /// It never gives its processor back.
    Block,
}

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Args {
    fault: Fault,
    /// `create`, `connect`, `run` or `stop`.
    phase: String,
}

struct Misbehaving(Args);

impl Misbehaving {
    async fn misbehave(&self, phase: &str) -> Handled {
        if phase != self.0.phase {
            return Ok(());
        }
        match self.0.fault {
            Fault::Nothing => Ok(()),
            Fault::Refuse => Err("the hardware does not answer".into()),
            #[allow(clippy::panic, reason = "a handler that panics is what is tested")]
            Fault::Panic => panic!("an index out of range"),
            Fault::Silence => std::future::pending().await,
            Fault::Block => loop {
                std::thread::park();
            },
        }
    }
}

impl EventHandler for Misbehaving {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, _cx: &Context, phase: Phase) -> Handled {
        self.misbehave(&phase.to_string()).await
    }

    async fn stop(&mut self, _cx: &Context, _reason: &StopReason) -> Handled {
        self.misbehave("stop").await
    }
}

fn main() -> ExitCode {
    let mut registry = Registry::new();
    registry.handler("test.misbehaving", &[], |cx| Ok(Misbehaving(cx.args()?)));
    cli::commands::main(registry)
}

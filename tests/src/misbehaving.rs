//! A program like `ctos` with event handlers of its own, which break the rules of startup and of
//! stopping. With it, tests check what the boot then says and undoes.

mod durable;
mod load;
mod nets;
mod runaways;

use std::{io::Write, process::ExitCode, time::Duration};

use ctos::{
    message::{Command, Message},
    registry::Registry,
    system::AppResult,
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
    /// It prints a line, which is no fault.
    Print,
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
            #[allow(clippy::print_stdout, reason = "what becomes of it is tested")]
            Fault::Print => {
                println!("printed, not logged");
                Ok(())
            }
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

ctos::command! {
    /// Counts.
    pub struct Count => u32, 1, "count"
}
ctos::command! {
    /// Waits for ever.
    pub struct Wait => (), 2, "wait"
}

/// Arguments of [`Steady`].
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct SteadyArgs {
    /// How long each phase takes, s.
    slow_s: f64,
    /// The phase in which its process dies.
    dies: Option<String>,
    /// A task that is asked to wait for ever, in phase run.
    waits_for: Option<String>,
}

/// Counts, takes its time in every phase and says so.
struct Steady {
    args: SteadyArgs,
    count: u32,
}

impl EventHandler for Steady {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            Count::CODE => {
                let (Count {}, reply) = message.open::<Count>()?;
                self.count += 1;
                reply.ok(self.count)
            }
            Wait::CODE => std::future::pending().await,
            _ => cx.default_processing(message),
        }
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        tracing::warn!(task = %cx.name(), "is in phase {phase}");
        if self.args.dies == Some(phase.to_string()) {
            std::process::abort();
        }
        cx.sleep(Duration::from_secs_f64(self.args.slow_s)).await;
        if let (Phase::Run, Some(task)) = (phase, self.args.waits_for.clone()) {
            let cx = cx.clone();
            cx.clone().spawn(async move {
                if let Ok(task) = cx.task(&task).await {
                    // Ends with the app.
                    let _ = cx
                        .call(&task, Wait {})
                        .deadline(Duration::from_secs(3600))
                        .await;
                }
            });
        }
        Ok(())
    }

    async fn stop(&mut self, cx: &Context, reason: &StopReason) -> Handled {
        tracing::warn!(task = %cx.name(), "stops because {reason}");
        Ok(())
    }
}

/// Arguments of [`Caller`].
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct CallerArgs {
    /// Whom it lets count.
    calls: String,
    /// How far one life of that task must count.
    enough: u32,
}

/// Lets another task count, finds it anew by its name each time, and ends the app when it has counted
/// far enough.
struct Caller(CallerArgs);

impl EventHandler for Caller {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let (args, cx) = (self.0.clone(), cx.clone());
            cx.clone().spawn(async move {
                loop {
                    cx.sleep(Duration::from_millis(10)).await;
                    let Ok(task) = cx.task(&args.calls).await else {
                        continue;
                    };
                    if let Ok(count) = cx.call(&task, Count {}).await
                        && count >= args.enough
                    {
                        break;
                    }
                }
                cx.finish(AppResult {
                    ok: true,
                    text: "counted".to_owned(),
                    json: r#"{"ok":true}"#.to_owned(),
                });
            });
        }
        Ok(())
    }

    async fn chassis_down(&mut self, cx: &Context, chassis: &str) -> Handled {
        tracing::warn!(task = %cx.name(), "misses {chassis}");
        Ok(())
    }

    async fn chassis_up(&mut self, cx: &Context, chassis: &str) -> Handled {
        tracing::warn!(task = %cx.name(), "greets {chassis}");
        Ok(())
    }
}

/// The first processes of a chassis, as `TEST_HOLDS=CHASSIS:TIMES` says, say so and never come to anything.
fn hold() {
    let variable = |name| std::env::var(name).unwrap_or_default();
    let holds = variable("TEST_HOLDS");
    let (held, times) = holds.split_once(':').unwrap_or_default();
    let is_held = std::env::args().any(|argument| argument == held);
    let number = variable("CTOS_INCARNATION").parse::<u32>();
    if is_held && number.is_ok_and(|number| times.parse().is_ok_and(|times| number <= times)) {
        // The waiting test reads it.
        let _ = std::io::stderr().write_all(b"holds before it connects\n");
        loop {
            std::thread::park();
        }
    }
}

fn main() -> ExitCode {
    hold();
    let mut registry = Registry::new();
    let steady = registry.handler("test.steady", &[Count::INFO, Wait::INFO], |cx| {
        let args = cx.args()?;
        Ok(Steady { args, count: 0 })
    });
    steady.args::<SteadyArgs>();
    let caller = registry.handler("test.caller", &[], |cx| Ok(Caller(cx.args()?)));
    caller.args::<CallerArgs>();
    let misbehaving = registry.handler("test.misbehaving", &[], |cx| Ok(Misbehaving(cx.args()?)));
    misbehaving.args::<Args>();
    durable::register(&mut registry);
    load::register(&mut registry);
    runaways::register(&mut registry);
    nets::register(&mut registry);
    cli::commands::main(registry)
}

//! What never comes to an end: an object of a daemon, and a handler. What ends at once, whenever it is asked.

use std::{io::Write, time::Duration};

use ctos::{
    message::{Command, Message},
    registry::Registry,
    system::AppResult,
    task::{Context, EventHandler, Handled, NameError, Phase},
};
use sorma::{Class, Dictionary, Outcome, ServiceObject, Transport, daemon, demo};

/// An object whose EXEC never ends.
struct Mill;

/// An object whose building never ends.
fn unfinished() -> Class {
    Class::new("ruin", "1.0", |_, _| {
        loop {
            std::thread::park();
        }
    })
    .any_flavor()
}

impl ServiceObject for Mill {
    fn exec(&mut self, _cx: &sorma::Context<'_>, _io: &mut Transport) -> Outcome {
        loop {
            std::thread::park();
        }
    }

    fn ctrl(&mut self, _cx: &sorma::Context<'_>, _io: &mut Transport) -> Outcome {
        Ok(())
    }

    fn dump(&self) -> String {
        String::new()
    }
}

ctos::command! {
    /// Is handled for ever.
    pub struct Spin => (), 1, "spin"
}

/// Begins to spin as soon as it runs.
struct Spinning;

impl EventHandler for Spinning {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        if message.command() == Spin::CODE {
            loop {
                std::thread::park();
            }
        }
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let own = cx.task(cx.name()).await?;
            cx.try_send(&own, Spin {})?;
        }
        Ok(())
    }
}

ctos::command! {
    /// Ends the process.
    pub struct Die => (), 2, "die"
}

/// Dies whenever it is told to.
struct Dying;

impl EventHandler for Dying {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        if message.command() == Die::CODE {
            std::process::abort();
        }
        cx.default_processing(message)
    }
}

/// Looks the task `dying` up all the time. With `deaths` it tells that task to die as soon as it is found, so often;
/// then the app ends. It also ends when a lookup fails.
struct Finder {
    deaths: Option<usize>,
}

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct FinderArgs {
    deaths: Option<usize>,
}

impl Finder {
    async fn look(cx: &Context, deaths: Option<usize>) -> Result<(), NameError> {
        let mut died = 0;
        while deaths.is_none_or(|deaths| died < deaths) {
            let dying = cx.task("dying").await?;
            if deaths.is_some() {
                // Its death is what is wanted.
                let _ = cx.call(&dying, Die {}).await;
                died += 1;
            } else {
                cx.sleep(Duration::from_micros(20)).await;
            }
        }
        Ok(())
    }
}

impl EventHandler for Finder {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let (cx, deaths) = (cx.clone(), self.deaths);
            cx.clone().spawn(async move {
                let said = Self::look(&cx, deaths).await;
                let text = said.as_ref().err().map(ToString::to_string);
                let result = AppResult {
                    ok: said.is_ok(),
                    text: text.unwrap_or_else(|| "found".to_owned()),
                    json: "{}".to_owned(),
                };
                cx.finish(result);
            });
        }
        Ok(())
    }
}

/// Starts so many tasks, and ends the app.
struct Parent(usize);

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct ParentArgs {
    children: usize,
}

impl EventHandler for Parent {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            for number in 0..self.0 {
                let name = format!("child{number}");
                let args = ctos::config::Node::table();
                cx.start(&name, "test.dying", args).await?;
            }
            cx.finish(AppResult {
                ok: true,
                text: "started".to_owned(),
                json: "{}".to_owned(),
            });
        }
        Ok(())
    }
}

/// Arguments of [`Owner`].
#[derive(Clone, serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct OwnerArgs {
    /// Where it writes while it has the permit, until there is a file `enough` in the folder of the configuration.
    file: String,
    /// Whether it looks at the app's clock before it writes.
    looks: bool,
    /// The file of the owner before it, if it is not the first one: it waits for that, and ends the app.
    after: Option<String>,
}

/// Takes the only permit of the app. Then, in a handler that never waits, it writes the number of the permit as long
/// as it believes to have it.
struct Owner(OwnerArgs);

impl Owner {
    async fn own(&self, cx: &Context) -> Handled {
        while let Some(file) = &self.0.after
            && !cx.path(file).exists()
        {
            cx.sleep(Duration::from_millis(10)).await;
        }
        let permit = cx.semaphore("app/board", 1)?.acquire().await?;
        tracing::warn!(task = cx.name(), "has permit {}", permit.number());
        let mut file = std::fs::OpenOptions::new()
            .create(true)
            .append(true)
            .open(cx.path(&self.0.file))?;
        while !cx.path("enough").exists() {
            std::thread::sleep(Duration::from_millis(1));
            if self.0.looks {
                let _now = cx.now();
            }
            writeln!(file, "{}", permit.number())?;
        }
        if self.0.after.is_some() {
            cx.finish(AppResult {
                ok: true,
                text: "enough".to_owned(),
                json: "{}".to_owned(),
            });
        }
        Ok(())
    }
}

impl EventHandler for Owner {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        if message.command() == Spin::CODE {
            return self.own(cx).await;
        }
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let own = cx.task(cx.name()).await?;
            cx.try_send(&own, Spin {})?;
        }
        Ok(())
    }
}

pub fn register(registry: &mut Registry) {
    let owner = registry.handler("test.owner", &[Spin::INFO], |cx| Ok(Owner(cx.args()?)));
    owner.args::<OwnerArgs>();
    daemon::register(registry, Dictionary::new(), |_, sorm| {
        demo::register(sorm);
        sorm.register(Class::new("mill", "1.0", |_, _| Ok(Box::new(Mill))).any_flavor());
        sorm.register(unfinished());
    });
    registry.handler("test.spinning", &[Spin::INFO], |_| Ok(Spinning));
    registry.handler("test.dying", &[Die::INFO], |_| Ok(Dying));
    let parent = registry.handler("test.parent", &[], |cx| {
        Ok(Parent(cx.args::<ParentArgs>()?.children))
    });
    parent.args::<ParentArgs>();
    let finder = registry.handler("test.finder", &[], |cx| {
        let deaths = cx.args::<FinderArgs>()?.deaths;
        Ok(Finder { deaths })
    });
    finder.args::<FinderArgs>();
}

//! The event handler that runs one net. Commands come to its input tape, tokens from other nets to
//! its places. Actions run as its children. Tokens for other nets go out as messages that are
//! acknowledged. What cannot be delivered stops the net, and waiting callers get that as an error.
//!
//! A net's task bears the net's name: that is how other nets find its places.

mod acting;
mod action;
mod ask;
mod breaks;
mod by_net;
mod carry;
mod carrying;
mod control;
mod durable;
mod engine;
mod fields;
mod firing;
mod held;
mod journal;
mod load;
mod manual;
mod messages;
mod once;
mod other;
mod publish;
mod quiet;
mod replace;
mod replacing;
mod requests;
mod routes;
mod settings;
mod transfers;
mod written;

#[cfg(test)]
mod tests;

use std::{rc::Rc, sync::Arc};

use serde::de::DeserializeOwned;

use ctos::{
    diagnostic::Findings,
    message::{Command as _, Message},
    registry::{Registry, Vocabulary},
    task::{Context, EventHandler, Handled, HandlerError, Phase, StopReason},
};

use crate::{
    layout::LayoutFile,
    library::{DataStore, Functions, Library},
    store::{Contents, Owner, Store},
    stream::{Describe, Follow},
};
pub use ask::put_once;
use engine::{Asker, Engine};
pub use load::{
    check_app, check_args, check_messages, check_nets, compilations, load, net_of, net_tasks, nets,
};
pub use manual::check_breakpoint;
pub use messages::{
    COMMANDS, Control, FiringEvent, Marking, Order, Output, PutOnce, PutTape, ReadTape, RequestId,
    Snapshot, TapeAnswer, Tokens, Transfer, from_site,
};
use pnt_language::{exec::Conflicts, net::Net};
pub use settings::{KEYS, Settings, StandIn, args, args_of, settings};

/// Registers a handler that runs a net with the functions of `library`. It has all checks: of the
/// task, and of all nets of the app together. Its only arguments are those of [`settings`].
pub fn register<S: 'static>(
    registry: &mut Registry,
    name: &str,
    library: impl Fn() -> Library<S> + Clone + Send + Sync + 'static,
) {
    let (build, spoken) = (library.clone(), library.clone());
    registry
        .handler(name, &COMMANDS, move |cx| {
            NetTask::from_args(cx, build(), None)
        })
        .keys(&KEYS)
        .check_in_app(move |task, app, findings| {
            check_args(task, app, &library().names(), findings);
        })
        .speaks(move |_| spoken().names().vocabulary());
    check_nets(registry);
}

/// [`register`] for a library with arguments of its own, which stand among those of [`settings`]. They are read when the
/// app is checked, too.
pub fn register_with<A: DeserializeOwned + Clone + 'static, S: 'static>(
    registry: &mut Registry,
    name: &str,
    library: impl Fn(A) -> Library<S> + Clone + Send + Sync + 'static,
) {
    let (build, spoken) = (library.clone(), library.clone());
    registry
        .handler(name, &COMMANDS, move |cx| {
            NetTask::from_args(cx, build(args_of(cx)?), None)
        })
        .keys(&KEYS)
        .checked_args::<A>(move |args, task, app, findings| {
            check_args(task, app, &library(args.clone()).names(), findings);
        })
        .speaks(move |task| match args::<A>(task) {
            Ok(args) => spoken(args).names().vocabulary(),
            Err(_) => Vocabulary::new(),
        });
    check_nets(registry);
}

/// Runs one net.
pub struct NetTask {
    engine: Rc<Engine>,
}

impl NetTask {
    /// A task for a net, with the functions it names and, if it has any data objects, their store.
    #[must_use]
    pub fn new<S: 'static>(
        cx: &Context,
        net: impl Into<Arc<Net>>,
        library: Library<S>,
        conflicts: Conflicts,
        data: Option<Rc<dyn DataStore>>,
    ) -> Self {
        let plain = (Settings::default(), None);
        Self::of(Engine::new(
            cx.clone(),
            net.into(),
            library.functions,
            conflicts,
            data,
            plain,
        ))
    }

    fn of(engine: Engine) -> Self {
        Self {
            engine: Rc::new(engine),
        }
    }

    /// The same, with the net and the rule for conflicts from the task's arguments (`net`,
    /// `conflicts`; see [`settings`]).
    ///
    /// # Errors
    /// What is wrong with the arguments or with the net.
    pub fn from_args<S: 'static>(
        cx: &Context,
        library: Library<S>,
        data: Option<Rc<dyn DataStore>>,
    ) -> Result<Self, HandlerError> {
        Self::configured(cx, library.functions, data)
    }

    fn configured(
        cx: &Context,
        library: Functions,
        data: Option<Rc<dyn DataStore>>,
    ) -> Result<Self, HandlerError> {
        let config = cx
            .config()
            .ok_or_else(|| HandlerError::new("a net task needs arguments"))?;
        let settings = settings(config)?;
        let net = net_of(config, cx.app())?;
        // What is wrong with it was said when the app was checked; a net runs without it.
        let layout = LayoutFile::of_net(&cx.app().file_at(&settings.net), &mut Findings::new());
        let task = Self::resumed(cx, net, library, data, settings)?;
        layout.pin(&mut task.engine.view.borrow_mut());
        Ok(task)
    }

    /// A task for a net with settings as its arguments could give them. A durable net goes on where it
    /// was when its last process ended.
    ///
    /// # Errors
    /// What is wrong with the settings or with what was stored.
    pub fn with_settings<S: 'static>(
        cx: &Context,
        net: impl Into<Arc<Net>>,
        library: Library<S>,
        data: Option<Rc<dyn DataStore>>,
        settings: Settings,
    ) -> Result<Self, HandlerError> {
        Self::resumed(cx, net.into(), library.functions, data, settings)
    }

    fn resumed(
        cx: &Context,
        net: Arc<Net>,
        library: Functions,
        data: Option<Rc<dyn DataStore>>,
        settings: Settings,
    ) -> Result<Self, HandlerError> {
        let conflicts = if settings.random {
            Conflicts::Random(Box::new(cx.rng("conflicts")))
        } else {
            Conflicts::Declared
        };
        if settings.durable && !library.survives() {
            return Err(HandlerError::new(format!(
                "net `{}` cannot be durable: its functions share a state that is not kept (`Library::kept`)",
                net.name()
            )));
        }
        let store = if settings.durable {
            let owner = Owner {
                kind: "net".to_owned(),
                name: net.name().to_owned(),
            };
            let file = format!("{}.redb", net.name());
            let path = cx.path(&settings.store).join(file);
            Some(Store::open(cx, &path, &owner)?)
        } else {
            None
        };
        let contents = match &store {
            Some(store) => store.load(cx)?,
            None => Contents::new(),
        };
        let net = match durable::replaced_net(&contents)? {
            Some(new) => load::of_copy(Arc::new(new), cx.name()),
            None => net,
        };
        let with = (settings, store);
        let mut engine = Engine::new(cx.clone(), net, library, conflicts, data, with);
        engine.resume(&contents)?;
        engine.arm()?;
        Ok(Self::of(engine))
    }
}

impl EventHandler for NetTask {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            PutTape::CODE => {
                let (request, reply) = message.open::<PutTape>()?;
                let PutTape { symbol, arguments } = request;
                self.engine
                    .put_tape(cx, (symbol, arguments), Asker::Plain(reply))
            }
            PutOnce::CODE => {
                let (request, reply) = message.open::<PutOnce>()?;
                self.engine.put_once(cx, request, reply)
            }
            Tokens::CODE => {
                let (tokens, reply) = message.open::<Tokens>()?;
                self.engine.put_tokens(cx, tokens, reply)
            }
            Marking::CODE => {
                let (Marking {}, reply) = message.open::<Marking>()?;
                self.engine.show(reply);
                Ok(())
            }
            Control::CODE => {
                let (Control { order, by }, reply) = message.open::<Control>()?;
                self.engine.control(cx, (order, by), reply)
            }
            ReadTape::CODE => {
                let (ReadTape { taken }, reply) = message.open::<ReadTape>()?;
                let output = self.engine.read_tape(taken);
                self.engine.when_stored(move |_| {
                    // Answering never fails; a reader that is gone reads again.
                    let _ = reply.ok(output);
                });
                Ok(())
            }
            Describe::CODE => {
                let (Describe {}, reply) = message.open::<Describe>()?;
                reply.ok(self.engine.view.borrow().clone())
            }
            Follow::CODE => {
                let (request, reply) = message.open::<Follow>()?;
                self.engine.follow(&request, reply)
            }
            _ => cx.default_processing(message),
        }
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            self.engine.begin(cx);
        }
        Ok(())
    }

    async fn quiesce(&mut self, cx: &Context, _reason: &StopReason) -> Handled {
        self.engine.quiesce(cx);
        Ok(())
    }

    async fn stop(&mut self, _cx: &Context, reason: &StopReason) -> Handled {
        self.engine.stopping.set(true);
        self.engine.tell_unfinished();
        self.engine.stop(&reason.to_string());
        Ok(())
    }

    async fn chassis_down(&mut self, cx: &Context, chassis: &str) -> Handled {
        let lost = |net: &str| {
            let task = cx.app().task(net);
            task.is_some_and(|task| task.chassis == chassis) && !other::is_durable(cx, net)
        };
        if let Some(net) = self.engine.partners().into_iter().find(|net| lost(net)) {
            self.engine
                .halt(&format!("net `{net}` is gone with chassis `{chassis}`"));
        }
        Ok(())
    }
}

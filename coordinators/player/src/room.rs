//! The room of a dry game: the task that has [`Table`] and [`Person`], and answers in modelled time. It has the place of arm and hand, and
//! of cameras unless it shows its table to some; who plays there is said by the arguments of the player.

use std::{cell::RefCell, rc::Rc, time::Duration};

use ctos::{
    diagnostic::Finding,
    message::{Command, Message},
    registry::Registry,
    task::{Context, EventHandler, Handled, HandlerError, Phase},
};
use mcs_hand::command::{PlaceBody, ReadBodies};
use rand::RngExt;
use serde::Deserialize;

use crate::{
    person::Person,
    player::PlayerArgs,
    shown::{Shown, ShownArgs},
    table::{Chances, Table},
    wire::{self, Close, Go, Hear, Looked, Open, See, Truth},
};

/// The handler's name.
pub const HANDLER: &str = "checkers.room";

/// How long a picture takes, and the hand.
const PICTURE: Duration = Duration::from_millis(300);
const FINGERS: Duration = Duration::from_millis(500);
/// How often the person's doings are looked after.
const TICK: Duration = Duration::from_millis(500);

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct RoomArgs {
    /// The task whose arguments say who plays.
    #[serde(default = "player")]
    player: String,
    #[serde(default)]
    errors: f64,
    #[serde(default)]
    slips: f64,
    #[serde(default)]
    bumps: f64,
    #[serde(default)]
    glare: f64,
    /// The world whose cameras see the table.
    shown: Option<ShownArgs>,
}

fn player() -> String {
    "player".to_owned()
}

struct Inner {
    table: Table,
    person: Option<Person>,
    heard: u32,
    starts: checkers::Colour,
    shown: Option<Shown>,
}

/// The event handler.
struct Room {
    inner: Rc<RefCell<Inner>>,
}

/// Registers the handler.
pub(crate) fn register(registry: &mut Registry) {
    let commands = [
        See::INFO,
        Go::INFO,
        Close::INFO,
        Open::INFO,
        Hear::INFO,
        Truth::INFO,
        Looked::INFO,
    ];
    registry
        .handler(HANDLER, &commands, Room::new)
        .checked_args::<RoomArgs>(|args, task, app, findings| {
            coordinators::need_task(task, app, "player", &args.player, findings);
            if let Some(shown) = &args.shown {
                coordinators::need_task(task, app, "shown.world", &shown.world, findings);
            }
            let chances = [
                ("errors", args.errors),
                ("slips", args.slips),
                ("bumps", args.bumps),
                ("glare", args.glare),
            ];
            for (key, chance) in chances {
                if !(0.0..=1.0).contains(&chance) {
                    let place = task.args.locate(key).unwrap_or_else(|| task.place.clone());
                    let text = format!("`{key}` is {chance}");
                    let finding = Finding::error("checkers::player::args", text).at(place);
                    findings.push(finding.help("give from 0 to 1"));
                }
            }
        });
}

impl Room {
    fn new(cx: &Context) -> Result<Self, HandlerError> {
        let args: RoomArgs = cx.args()?;
        let player = cx.app().task(&args.player).ok_or("there is no player")?;
        let player = pnt::task::args::<PlayerArgs>(player)?;
        let chances = Chances {
            errors: args.errors,
            slips: args.slips,
            bumps: args.bumps,
            glare: args.glare,
        };
        let rules = player.rules();
        let record = player.record(cx.app()).map_err(HandlerError::new)?;
        let side = player.ours().map(checkers::Colour::other);
        let inner = Inner {
            table: Table::new(chances, rules.starts(), cx.rng("room")),
            person: side.map(|side| Person::new(side, rules, record)),
            heard: 0,
            starts: rules.starts(),
            shown: args.shown.map(Shown::new),
        };
        Ok(Self {
            inner: Rc::new(RefCell::new(inner)),
        })
    }

    /// Whether arm and hand are those of a world that moves by itself.
    fn is_real(&self) -> bool {
        let inner = self.inner.borrow();
        inner.shown.as_ref().is_some_and(|shown| shown.args.real)
    }

    /// Answers a request after some time.
    fn after<C: Command>(
        &self,
        cx: &Context,
        message: Message,
        takes: Duration,
        act: impl FnOnce(&mut Table, C) -> C::Reply + 'static,
    ) -> Handled {
        let (request, reply) = message.open::<C>()?;
        let (child, inner) = (cx.clone(), self.inner.clone());
        cx.spawn(async move {
            child.sleep(takes).await;
            let answer = act(&mut inner.borrow_mut().table, request);
            show(&child, &inner).await;
            // Who asked may be gone.
            let _ = reply.ok(answer);
        });
        Ok(())
    }
}

impl EventHandler for Room {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            See::CODE => {
                self.after::<See>(cx, message, PICTURE, |table, See { pose }| table.see(pose))
            }
            Go::CODE if self.is_real() => {
                let (Go { to }, reply) = message.open::<Go>()?;
                let table = &mut self.inner.borrow_mut().table;
                if to.is_some() {
                    if !table.hand {
                        table.arm = to;
                    }
                    return reply.ok(!table.hand);
                }
                let (child, inner) = (cx.clone(), self.inner.clone());
                cx.spawn(async move {
                    let read = read(&child, &inner).await;
                    let _ = match read {
                        Ok(()) => reply.ok(true),
                        Err(error) => reply.fail(error),
                    };
                });
                Ok(())
            }
            Go::CODE => {
                let (Go { to }, reply) = message.open::<Go>()?;
                let began = {
                    let table = &mut self.inner.borrow_mut().table;
                    table.go(to).map(|seconds| (seconds, table.motion))
                };
                let Some((seconds, motion)) = began else {
                    return reply.ok(false);
                };
                let (child, inner) = (cx.clone(), self.inner.clone());
                cx.spawn(async move {
                    child.sleep(Duration::from_secs_f64(seconds)).await;
                    inner.borrow_mut().table.arrived(motion, to);
                    show(&child, &inner).await;
                    let _ = reply.ok(true);
                });
                Ok(())
            }
            Close::CODE => self.after::<Close>(cx, message, FINGERS, |table, close| {
                table.close(close.errand, close.discs)
            }),
            Open::CODE => {
                self.after::<Open>(cx, message, FINGERS, |table, open| table.open(open.errand))
            }
            Hear::CODE => {
                let (Hear { number, words }, reply) = message.open::<Hear>()?;
                let now = seconds(cx);
                let inner = &mut *self.inner.borrow_mut();
                if number > inner.heard {
                    inner.heard = number;
                    inner.table.truth.heard.push(words.clone());
                    // Somebody in the room does that.
                    if words.contains("set up the board") {
                        inner.table.begin_anew(inner.starts);
                    }
                    if let Some(person) = &mut inner.person {
                        person.hear(&mut inner.table, &words, now);
                    }
                }
                reply.ok(())
            }
            Truth::CODE => {
                let (Truth {}, reply) = message.open::<Truth>()?;
                let inner = self.inner.borrow();
                let mut truth = inner.table.truth();
                if let Some(shown) = &inner.shown {
                    truth.looks = shown.looks;
                }
                reply.ok(truth)
            }
            Looked::CODE => {
                let (looked, reply) = message.open::<Looked>()?;
                let Inner { table, shown, .. } = &mut *self.inner.borrow_mut();
                if let Some(shown) = shown {
                    shown.judge(table, &looked);
                }
                reply.ok(())
            }
            _ => cx.default_processing(message),
        }
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let (child, inner) = (cx.clone(), self.inner.clone());
            cx.spawn(async move {
                while !child.is_stopping() {
                    show(&child, &inner).await;
                    child.sleep(TICK).await;
                    inner.borrow_mut().tick(seconds(&child));
                }
            });
        }
        Ok(())
    }
}

impl Inner {
    /// Time passes.
    fn tick(&mut self, now: f64) {
        let Self {
            table,
            person,
            shown,
            ..
        } = self;
        if let Some(person) = person {
            person.tick(table, now);
        }
        if table.hand && (table.moving || table.arm.is_some()) {
            table.truth.met += 1;
        }
        // Cameras do not say when they look.
        if let Some(shown) = shown {
            if person.as_ref().is_some_and(Person::thinks) {
                table.may_bump();
            }
            if table.rng.random_bool(table.chances.glare) {
                shown.hide(table.rng.random_range(0..32), now);
            }
        }
    }
}

/// Nobody is at the table any more: it is as arm and hand have left it.
async fn read(cx: &Context, inner: &Rc<RefCell<Inner>>) -> Handled {
    let world = inner
        .borrow()
        .shown
        .as_ref()
        .map(|shown| shown.args.world.clone());
    let world = world.ok_or("there is no world")?;
    let bodies = wire::ask(cx, &world, ReadBodies {}).await?;
    let now = seconds(cx);
    let Inner { table, shown, .. } = &mut *inner.borrow_mut();
    if let Some(shown) = shown {
        shown.read(table, &bodies, now);
    }
    table.arm = None;
    table.note();
    Ok(())
}

/// Puts the bodies of the world where the table has them.
async fn show(cx: &Context, inner: &Rc<RefCell<Inner>>) {
    let now = seconds(cx);
    let (world, moved) = {
        let Inner { table, shown, .. } = &mut *inner.borrow_mut();
        let Some(shown) = shown else { return };
        (shown.args.world.clone(), shown.take(table, now))
    };
    if moved.is_empty() {
        return;
    }
    for nth in moved {
        // As it is by now: it may have been moved again meanwhile.
        let body = inner
            .borrow()
            .shown
            .as_ref()
            .and_then(|shown| shown.body(nth));
        let Some((body, pose)) = body else { continue };
        if let Err(error) = wire::ask(cx, &world, PlaceBody { body, pose }).await {
            tracing::error!(%error, "a disc is not shown");
        }
    }
    if let Some(shown) = &mut inner.borrow_mut().shown {
        shown.is_shown(seconds(cx));
    }
}

fn seconds(cx: &Context) -> f64 {
    cx.now().as_nanos() as f64 / 1e9
}

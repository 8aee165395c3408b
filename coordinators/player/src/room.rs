//! The room of a dry game: the task that has [`Table`] and [`Person`], and answers in modelled time. It has the place of arm and hand, and
//! of cameras unless it shows its table to some; who plays there is said by the arguments of the player.

use std::{cell::RefCell, rc::Rc, time::Duration};

use checkers::Numbering;
use ctos::{
    config::{App, TaskConfig},
    diagnostic::{Finding, Findings},
    message::{Command, Message},
    registry::Registry,
    task::{Context, EventHandler, Handled, HandlerError, Phase},
};
use mcs_hand::command::{LightRoom, PlaceBody, Touch};
use rand::RngExt;
use scene::{FollowScene, Stage};
use serde::Deserialize;

use crate::{
    drawn::Drawn,
    guest::{self, Drag},
    meddling::{self, Mishap},
    person::{self, Person},
    play::{CROWN, MIDDLE, MOVE_FOR_ME, POWER},
    player::{PERSON, PlayerArgs},
    shown::{Shown, ShownArgs, is_disc},
    table::{Chances, Table},
    wire::{
        self, Close, DragDisc, FIELD_M, Go, Hear, Hue, Looked, Open, See, Shine, Shove, Truth, Why,
    },
};

/// The handler's name.
pub const HANDLER: &str = "checkers.room";

/// How long a picture takes, and the hand.
const PICTURE: Duration = Duration::from_millis(300);
const FINGERS: Duration = Duration::from_millis(500);
/// How often the person's doings are looked after.
const TICK: Duration = Duration::from_millis(500);
/// So high discs are lifted, m, before they are put elsewhere together.
const LIFT_M: f64 = 0.12;

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
    #[serde(default)]
    far: f64,
    #[serde(default)]
    power: f64,
    #[serde(default)]
    reaches: f64,
    #[serde(default)]
    lamps: f64,
    /// Discs that stand beside the middles of their squares at the beginning.
    #[serde(default)]
    aside: Vec<Aside>,
    /// The world whose cameras see the table.
    shown: Option<ShownArgs>,
}

/// A disc beside the middle of its square.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct Aside {
    /// The square's number.
    square: u32,
    /// How far, in the board's frame, m.
    by: [f64; 2],
}

pub fn player() -> String {
    "player".to_owned()
}

pub struct Inner {
    pub table: Table,
    /// The bodies that a display shows.
    pub drawn: Shown,
    /// Whether a person drags discs on a display.
    guest: bool,
    person: Option<Person>,
    heard: u32,
    /// The squares that the laser shows.
    pub laser: Vec<u8>,
    first: checkers::Position,
    shown: Option<Shown>,
}

/// The event handler.
struct Room {
    inner: Rc<RefCell<Inner>>,
    stage: Stage,
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
        DragDisc::INFO,
        Shove::INFO,
        Shine::INFO,
        FollowScene::INFO,
    ];
    registry
        .handler(HANDLER, &commands, Room::new)
        .checked_args::<RoomArgs>(|args, task, app, findings| {
            coordinators::need_task(task, app, "player", &args.player, findings);
            if let Some(shown) = &args.shown {
                coordinators::need_task(task, app, "shown.world", &shown.world, findings);
                wire::check_disc_m(task, "shown.disc_m", shown.disc_m, findings);
                if shown.real {
                    coordinators::need_task(task, app, "shown.mcs", &shown.mcs, findings);
                }
            }
            let chances = [
                ("errors", args.errors),
                ("slips", args.slips),
                ("bumps", args.bumps),
                ("glare", args.glare),
                ("far", args.far),
                ("power", args.power),
                ("reaches", args.reaches),
                ("lamps", args.lamps),
            ];
            for (key, chance) in chances {
                if !(0.0..=1.0).contains(&chance) {
                    let place = task.args.locate(key).unwrap_or_else(|| task.place.clone());
                    let text = format!("`{key}` is {chance}");
                    let finding = Finding::error("checkers::player::args", text).at(place);
                    findings.push(finding.help("give from 0 to 1"));
                }
            }
            check_aside(args, task, app, findings);
        });
}

/// Each disc that stands aside is one of the first position, and on the board.
fn check_aside(args: &RoomArgs, task: &TaskConfig, app: &App, findings: &mut Findings) {
    let player = app.task(&args.player);
    let Some(player) = player.and_then(|task| pnt::task::args::<PlayerArgs>(task).ok()) else {
        // That is found where the player is checked.
        return;
    };
    let numbering = Numbering::of(player.rules());
    let Ok(first) = player.first(app) else { return };
    for (nth, Aside { square, by }) in args.aside.iter().enumerate() {
        let mut wrong = |key: &str, text: String, help: &str| {
            let key = format!("aside.{nth}.{key}");
            let place = task.args.locate(&key).unwrap_or_else(|| task.place.clone());
            let finding = Finding::error("checkers::player::args", text);
            findings.push(finding.at(place).help(help));
        };
        let place = numbering.square(*square);
        if place.and_then(|place| first.piece(place)).is_none() {
            let text = format!("`aside` names square {square}, on which nothing stands");
            wrong(
                "square",
                text,
                "name a square of the first position with a disc",
            );
        }
        if !by.iter().all(|along| along.abs() <= FIELD_M) {
            let text = format!("`aside` puts the disc of square {square} {by:?} m aside");
            wrong(
                "by",
                text,
                "give at most 0.06 m, the side of a square, along each axis",
            );
        }
    }
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
            far: args.far,
            power: args.power,
            reaches: args.reaches,
            lamps: args.lamps,
        };
        let rules = player.rules();
        let first = player.first(cx.app()).map_err(HandlerError::new)?;
        let record = player.record(cx.app()).map_err(HandlerError::new)?;
        let guest = player.opponent == PERSON;
        let side = player.ours().map(checkers::Colour::other);
        // Where the robot plays both sides somebody does what people are asked for, and has no turn.
        let side = side.unwrap_or(checkers::Colour::White);
        let person = (!guest).then(|| Person::new(side, rules, record));
        let mut table = Table::new(chances, first, cx.rng("room"));
        table.board.mirrored = rules.mirrored();
        for Aside { square, by } in args.aside {
            let place = Numbering::of(rules).square(square);
            let at = place.and_then(|place| table.on(place));
            let stack = at.and_then(|at| table.stacks.get_mut(at));
            let nothing = || format!("`aside` names square {square}, on which nothing stands");
            let stack = stack.ok_or_else(nothing)?;
            stack.at = [stack.at[0] + by[0], stack.at[1] + by[1]];
        }
        let inner = Inner {
            table,
            drawn: Shown::for_people(
                args.shown
                    .as_ref()
                    .map_or_else(wire::disc_m, |shown| shown.disc_m),
            ),
            guest,
            person,
            heard: 0,
            laser: Vec::new(),
            first,
            shown: args.shown.map(Shown::new),
        };
        let inner = Rc::new(RefCell::new(inner));
        let stage = Stage::new(Drawn::new(inner.clone()));
        Ok(Self { inner, stage })
    }

    /// A person at a display has put a disc elsewhere: a hand does that.
    fn drag(&self, cx: &Context, message: Message) -> Handled {
        let (request, reply) = message.open::<DragDisc>()?;
        let taken = self.inner.borrow_mut().take(&request);
        let drag = match taken {
            Ok(drag) => drag,
            Err(reason) => return reply.fail(reason),
        };
        let (child, inner) = (cx.clone(), self.inner.clone());
        cx.spawn(async move {
            show(&child, &inner).await;
            child.sleep(Duration::from_secs_f64(guest::TAKES_S)).await;
            let dragged = {
                let table = &mut inner.borrow_mut().table;
                let dragged = guest::drag(table, drag);
                table.hand = false;
                table.note();
                dragged
            };
            show(&child, &inner).await;
            let _ = match dragged {
                Ok(()) => reply.ok(()),
                Err(reason) => reply.fail(reason),
            };
        });
        Ok(())
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
            DragDisc::CODE => self.drag(cx, message),
            Shove::CODE => self.after::<Shove>(cx, message, FINGERS, |table, shove| {
                if table.hand {
                    return Some(Why::HandInTheWay);
                }
                table.shove(shove.from, shove.to);
                None
            }),
            FollowScene::CODE => self.stage.follow(cx, message),
            Go::CODE if self.inner.borrow().is_real() => {
                let (Go { to, then }, reply) = message.open::<Go>()?;
                let (child, inner) = (cx.clone(), self.inner.clone());
                let table = &mut self.inner.borrow_mut().table;
                if let Some(there) = to {
                    if table.hand {
                        return reply.ok(Some(Why::HandInTheWay));
                    }
                    table.arm = to;
                    table.motion += 1;
                    // Without a next place it is the errand's second end.
                    table.sets_out(Some(u8::from(then.is_none())), seconds(cx));
                    if let Some(mishap) = Mishap::of(table, then.is_none()) {
                        cx.spawn(meddling::befall(child, inner, mishap, there));
                    }
                    return reply.ok(None);
                }
                table.sets_out(None, seconds(cx));
                cx.spawn(async move {
                    let read = read(&child, &inner).await;
                    let _ = match read {
                        Ok(()) => reply.ok(None),
                        Err(error) => reply.fail(error),
                    };
                });
                Ok(())
            }
            Go::CODE => {
                let (Go { to, then }, reply) = message.open::<Go>()?;
                let began = {
                    let table = &mut self.inner.borrow_mut().table;
                    let began = table.go(to, then);
                    began.map(|seconds| (seconds, table.motion))
                };
                let (seconds, motion) = match began {
                    Ok(began) => began,
                    Err(why) => return reply.ok(Some(why)),
                };
                let (child, inner) = (cx.clone(), self.inner.clone());
                cx.spawn(async move {
                    child.sleep(Duration::from_secs_f64(seconds)).await;
                    let why = inner.borrow_mut().table.arrived(motion, to);
                    show(&child, &inner).await;
                    let _ = reply.ok(why);
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
                let (hear, reply) = message.open::<Hear>()?;
                let Hear {
                    number,
                    words,
                    shown,
                    board,
                } = hear;
                let now = seconds(cx);
                let inner = &mut *self.inner.borrow_mut();
                if number > inner.heard {
                    inner.heard = number;
                    inner.table.truth.heard.push(words.clone());
                    inner.laser = shown;
                    // Somebody in the room does that.
                    if words.contains("set up the board") {
                        inner.table.begin_anew(&inner.first);
                    }
                    if words.contains(MIDDLE) {
                        inner.table.push_to_middle();
                    }
                    let is_asked = [MOVE_FOR_ME, CROWN]
                        .iter()
                        .any(|asked| words.contains(asked));
                    if let Some(board) = board.filter(|_| is_asked) {
                        inner.carry_for_the_robot(board);
                    }
                    let is_real = inner.is_real();
                    if words.contains(POWER) && is_real {
                        let (child, inner) = (cx.clone(), self.inner.clone());
                        cx.spawn(async move {
                            if let Err(error) = meddling::switch_on(&child, &inner).await {
                                tracing::error!(%error, "the arm is not switched on");
                            }
                        });
                    } else {
                        inner.table.powered |= words.contains(POWER);
                    }
                    if let Some(person) = &mut inner.person {
                        person.hear(&mut inner.table, &words, now);
                    }
                }
                reply.ok(())
            }
            Shine::CODE => {
                let (Shine { share }, reply) = message.open::<Shine>()?;
                // The world before cameras is told with the next tick.
                self.inner.borrow_mut().table.light = share;
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
            if self.inner.borrow().is_real() {
                cx.spawn(meddling::watch_touches(cx.clone(), self.inner.clone()));
            }
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
    /// Whether arm and hand are those of a world that moves by itself.
    pub fn is_real(&self) -> bool {
        self.shown.as_ref().is_some_and(|shown| shown.args.real)
    }

    /// How high a disc is, m.
    pub fn disc_m(&self) -> f64 {
        self.drawn.args.disc_m
    }

    /// Counts what presses on the arm besides the links that hold discs.
    pub fn note(&mut self, touches: impl Iterator<Item = Touch>) {
        let holds = |link: &str| {
            let link = link.rsplit('.').next().unwrap_or(link);
            let mut holding = self.shown.iter().flat_map(|shown| &shown.args.holding);
            holding.any(|own| !own.is_empty() && link.starts_with(own.as_str()))
        };
        for Touch { link, force_n } in touches.filter(|touch| !holds(&touch.link)) {
            let pressed = &mut self.table.truth.pressed;
            if !pressed.contains_key(&link) {
                tracing::warn!(link, ?force_n, "something presses on the arm");
            }
            *pressed.entry(link).or_default() += 1;
        }
    }

    /// Somebody in the room makes the robot's move. A person at a display drags discs instead.
    fn carry_for_the_robot(&mut self, [white, black, kings]: [u32; 3]) {
        if self.guest || self.is_real() {
            return;
        }
        self.table.set_up(&checkers::Position {
            white,
            black,
            kings,
            turn: checkers::Colour::White,
        });
        person::count(&mut self.table);
        self.table.note();
    }

    /// The world whose cameras see the table.
    pub fn world(&self) -> Result<String, HandlerError> {
        let shown = self.shown.as_ref();
        let world = shown.map(|shown| shown.args.world.clone());
        world.ok_or_else(|| "there is no world".into())
    }

    /// The client interface of the arm there.
    pub fn mcs(&self) -> Result<String, HandlerError> {
        let shown = self.shown.as_ref();
        let mcs = shown.map(|shown| shown.args.mcs.clone());
        mcs.ok_or_else(|| "there is no arm".into())
    }

    /// A person's hand comes over the board for a disc.
    fn take(&mut self, request: &DragDisc) -> Result<Drag, String> {
        let Self {
            table,
            drawn,
            guest,
            ..
        } = self;
        if !*guest {
            return Err(format!(
                "no person plays here: give the player `opponent = \"{PERSON}\"`"
            ));
        }
        if table.hand || table.moving || table.arm.is_some() {
            return Err("arm and hand are not over the board together: wait".to_owned());
        }
        drawn.take(table, 0.0);
        let DragDisc { disc, x, y } = request;
        let found = drawn.all().find(|(name, _)| name == disc);
        let hue = match disc.starts_with("light") {
            true => Hue::Light,
            false => Hue::Dark,
        };
        let (_, pose) = found.ok_or_else(|| format!("there is no disc `{disc}`"))?;
        let from = [pose.translation.x, pose.translation.y];
        let to = [from[0] + x, from[1] + y];
        if !to.iter().all(|along| along.abs() < 2.0) {
            return Err(format!("{to:?} is not on the table"));
        }
        table.hand = true;
        Ok(Drag { hue, from, to })
    }

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
        if table.hand && !table.curtain && (table.moving || table.arm.is_some()) {
            table.truth.met += 1;
        }
        table.may_light(now);
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
    let bodies = meddling::bodies(cx, inner).await?;
    let now = seconds(cx);
    let Inner { table, shown, .. } = &mut *inner.borrow_mut();
    if let Some(shown) = shown {
        shown.read(table, &bodies, now);
    }
    table.arm = None;
    table.note();
    Ok(())
}

/// Makes it as light in the world as it is in the room.
async fn light(cx: &Context, inner: &Rc<RefCell<Inner>>) {
    let (world, share) = {
        let Inner { table, shown, .. } = &mut *inner.borrow_mut();
        let Some(shown) = shown else { return };
        let share = table.lit();
        if shown.lit == share {
            return;
        }
        (shown.args.world.clone(), share)
    };
    match wire::ask(cx, &world, LightRoom { share }).await {
        Ok(()) => {
            if let Some(shown) = &mut inner.borrow_mut().shown {
                shown.lit = share;
            }
        }
        // The next look tries again.
        Err(error) => tracing::warn!(%error, "the light is as it was"),
    }
}

/// Puts the bodies of the world where the table has them.
pub async fn show(cx: &Context, inner: &Rc<RefCell<Inner>>) {
    let now = seconds(cx);
    light(cx, inner).await;
    let (world, moved, lifts) = {
        let Inner { table, shown, .. } = &mut *inner.borrow_mut();
        let Some(shown) = shown else { return };
        let moved = shown.take(table, now);
        // Where things move by themselves a disc must not be put into one that is still to go.
        let lifts = shown.args.real && moved.len() > 1;
        (shown.args.world.clone(), moved, lifts)
    };
    if moved.is_empty() {
        return;
    }
    let lifted = moved.iter().filter(|_| lifts).map(|nth| (*nth, LIFT_M));
    for (nth, by) in lifted.chain(moved.iter().map(|nth| (*nth, 0.0))) {
        // As it is by now: it may have been moved again meanwhile.
        let body = inner
            .borrow()
            .shown
            .as_ref()
            .and_then(|shown| shown.body(nth));
        let Some((body, mut pose)) = body else {
            continue;
        };
        if by > 0.0 && !is_disc(&body) {
            continue;
        }
        pose.translation.z += by;
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

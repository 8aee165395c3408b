//! What befalls a real arm on its way: what it carries is knocked out of its fingers, somebody reaches over the board, its power goes. A light
//! curtain stops the arm before a hand is there, and lets it go on afterwards. A dry game has all that in its table instead.

use std::{cell::RefCell, rc::Rc, time::Duration};

use ctos::{
    message::Command,
    task::{Context, Handled, HandlerError},
};
use mcs::client::{EmergencyStop, Reset, Resume, Stop};
use mcs_hand::command::{Body, PlaceBody, ReadBodies, ReadTouch};
use nalgebra::{Isometry3, Translation3};
use rand::RngExt;

use crate::{
    room::{Inner, show},
    shown::{hand_at, is_disc},
    table::Table,
    wire::{self, BOARD_M, TABLE_M, apart},
};

/// What is higher than this is in the arm's fingers, m: no stack is so high.
const HELD_M: f64 = TABLE_M + 0.1;
/// Nothing is knocked to where the fingers come down, m, nor onto other discs.
const FINGERS_M: f64 = 0.1;
const FREE_M: f64 = 0.05;
/// The middle of a disc that falls to the floor, m.
const ON_FLOOR_M: f64 = 0.05;
/// A hand stays outside the curtain while the fingers are nearer than this to where it would be, m.
const ROOM_M: f64 = 0.2;
/// How long the arm brakes, and how often it is looked for what it holds.
const BRAKES: Duration = Duration::from_millis(600);
const LOOK: Duration = Duration::from_millis(200);
const LOOKS: u32 = 20;
/// How often it is looked what presses on the arm.
const TOUCHES: Duration = Duration::from_millis(45);

/// What befalls the arm.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mishap {
    /// Something knocks what it carries out of its fingers.
    Knocked,
    /// A person reaches over the board.
    ReachedIn,
    /// Somebody presses the emergency stop.
    NoPower,
}

impl Mishap {
    /// One that befalls a way, if any; only what is carried can be knocked out.
    pub fn of(table: &mut Table, carries: bool) -> Option<Self> {
        let chances = table.chances;
        let slips = if carries { chances.slips } else { 0.0 };
        let all = [
            (slips, Self::Knocked),
            (chances.reaches, Self::ReachedIn),
            (chances.power, Self::NoPower),
        ];
        let mut drawn = all.into_iter();
        drawn.find_map(|(chance, mishap)| table.rng.random_bool(chance).then_some(mishap))
    }
}

/// Lets it happen some time after the arm has set out to there.
pub async fn befall(cx: Context, inner: Rc<RefCell<Inner>>, mishap: Mishap, to: [f64; 2]) {
    let (motion, after) = {
        let table = &mut inner.borrow_mut().table;
        (table.motion, table.rng.random_range(0.3..3.0))
    };
    cx.sleep(Duration::from_secs_f64(after)).await;
    // What was to befall one way does not befall the next.
    if inner.borrow().table.motion != motion || inner.borrow().table.arm.is_none() {
        return;
    }
    let done = match mishap {
        Mishap::Knocked => knock(&cx, &inner, to).await,
        Mishap::ReachedIn => reach_in(&cx, &inner).await,
        Mishap::NoPower => stop(&cx, &inner).await,
    };
    if let Err(error) = done {
        tracing::error!(%error, ?mishap, "what should befall the arm does not");
    }
}

/// Asks the arm's client interface.
async fn ask<C: Command + Clone>(cx: &Context, inner: &RefCell<Inner>, request: C) -> Handled
where
    C::Reply: std::fmt::Debug,
{
    let mcs = inner.borrow().mcs()?;
    let answer = wire::ask(cx, &mcs, request).await?;
    tracing::debug!(?answer, "the arm's answer");
    Ok(())
}

/// The bodies of the world, as they truly are.
pub async fn bodies(cx: &Context, inner: &RefCell<Inner>) -> Result<Vec<Body>, HandlerError> {
    let world = inner.borrow().world()?;
    wire::ask(cx, &world, ReadBodies {}).await
}

/// Counts what presses on the arm besides the links that hold discs, for the referee.
pub async fn watch_touches(cx: Context, inner: Rc<RefCell<Inner>>) {
    while !cx.is_stopping() {
        cx.sleep(TOUCHES).await;
        let world = inner.borrow().world();
        let Ok(world) = world else { return };
        // A world that does not answer says nothing of touches.
        let touches = wire::ask(&cx, &world, ReadTouch { arm: None }).await;
        inner.borrow_mut().note(touches.into_iter().flatten());
    }
}

/// What the arm holds lies elsewhere: on the board, or on the floor.
async fn knock(cx: &Context, inner: &Rc<RefCell<Inner>>, to: [f64; 2]) -> Handled {
    for _ in 0..LOOKS {
        let held = bodies(cx, inner).await?;
        let held = held
            .into_iter()
            .filter(|body| is_disc(&body.name) && body.world_t_body[11] > HELD_M);
        let held: Vec<String> = held.map(|body| body.name).collect();
        if inner.borrow().table.arm.is_none() {
            return Ok(());
        }
        let (lies, world) = {
            let inner = &mut *inner.borrow_mut();
            inner.table.truth.slipped += u32::try_from(held.len()).unwrap_or(u32::MAX);
            let disc_m = inner.disc_m();
            let mut with = Vec::new();
            let lies = held.iter();
            let lies = lies.map(|_| fallen(&mut inner.table, to, &mut with, disc_m));
            let lies: Vec<_> = lies.collect();
            (lies, inner.world()?)
        };
        let any = !held.is_empty();
        for (body, pose) in held.into_iter().zip(lies) {
            wire::ask(cx, &world, PlaceBody { body, pose }).await?;
        }
        if any {
            return Ok(());
        }
        cx.sleep(LOOK).await;
    }
    Ok(())
}

/// Where what falls comes to lie, free of all that stands and of what has fallen with it.
fn fallen(
    table: &mut Table,
    to: [f64; 2],
    with: &mut Vec<[f64; 2]>,
    disc_m: f64,
) -> Isometry3<f64> {
    let board = table.board;
    for _ in 0..40 {
        let at = [
            table.rng.random_range(-0.23..0.23),
            table.rng.random_range(-0.23..0.23),
        ];
        let [x, y] = board.on_table(at);
        let others = table.stacks.iter().filter(|stack| stack.on_board);
        let mut others = others.map(|stack| stack.at).chain(with.iter().copied());
        let free = others.all(|other| apart(other, at) > FREE_M);
        if free && apart([x, y], to) > FINGERS_M && table.rng.random_bool(0.85) {
            with.push(at);
            return Translation3::new(x, y, TABLE_M + BOARD_M + 0.6 * disc_m).into();
        }
    }
    let y = table.rng.random_range(-4.0..-1.0);
    Translation3::new(-2.0, y, ON_FLOOR_M).into()
}

/// A hand comes over the board for a while; the arm rests before.
async fn reach_in(cx: &Context, inner: &Rc<RefCell<Inner>>) -> Handled {
    if inner.borrow().table.hand {
        return Ok(());
    }
    inner.borrow_mut().table.curtain = true;
    let came = hand_comes(cx, inner).await;
    inner.borrow_mut().table.hand = false;
    show(cx, inner).await;
    let resumed = ask(cx, inner, Resume {}).await;
    inner.borrow_mut().table.curtain = false;
    came.and(resumed)
}

/// The arm rests, and the hand is over the board for a while.
async fn hand_comes(cx: &Context, inner: &Rc<RefCell<Inner>>) -> Handled {
    ask(cx, inner, Stop {}).await?;
    cx.sleep(BRAKES).await;
    let fingers = bodies(cx, inner).await?;
    let fingers = fingers.iter().find(|body| body.name.ends_with("jaw_left"));
    let fingers = fingers.map(|body| [body.world_t_body[3], body.world_t_body[7]]);
    let stays = {
        let inner = &mut *inner.borrow_mut();
        let hand = hand_at(&inner.table);
        if fingers.is_none_or(|fingers| apart(fingers, hand) > ROOM_M) {
            inner.table.hand = true;
        }
        inner.table.truth.errors.push("reached in".to_owned());
        Duration::from_secs_f64(inner.table.rng.random_range(2.0..6.0))
    };
    show(cx, inner).await;
    cx.sleep(stays).await;
    Ok(())
}

/// The arm has no power until somebody has heard that it needs some.
async fn stop(cx: &Context, inner: &RefCell<Inner>) -> Handled {
    inner.borrow_mut().table.powered = false;
    ask(cx, inner, EmergencyStop {}).await
}

/// Somebody switches the arm on.
pub async fn switch_on(cx: &Context, inner: &RefCell<Inner>) -> Handled {
    ask(cx, inner, Reset {}).await?;
    inner.borrow_mut().table.powered = true;
    Ok(())
}

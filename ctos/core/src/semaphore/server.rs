//! The task of the runtime that keeps the semaphores and barriers of app scope, on the chassis that boots.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
    time::Duration,
};

use futures_util::future::{Either, select};
use serde::{Deserialize, Serialize};

use super::{
    Late, Passage, Scope, SemaphoreView,
    gathering::Gathering,
    ledger::{Claim, Hold, Ledger},
    store,
};
use crate::{
    chassis::Chassis,
    context::Context,
    envelope::{Message, Replier},
    handled::Handled,
    handler::EventHandler,
    sync::Signal,
};
use ctos_message::{Command, CommandInfo, Tid, command};
use ctos_time::{Instant, lock::lock};

/// What the service takes.
pub const COMMANDS: [CommandInfo; 4] = [
    AcquireSemaphore::INFO,
    ReleaseTicket::INFO,
    ArriveBarrier::INFO,
    ListSemaphores::INFO,
];

/// What became of [`AcquireSemaphore`].
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Acquired {
    Granted,
    Late(Late),
    Disagree { has: u32 },
}

/// What became of [`ArriveBarrier`].
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Arrived {
    Passed(Passage),
    Late(Vec<String>),
    Disagree { has: u32 },
}

command! {
    /// Waits for a permit of a semaphore.
    #[derive(Debug)]
    pub struct AcquireSemaphore {
        pub name: String,
        pub permits: u32,
        pub hold: u64,
        pub task: String,
        pub wait: Duration,
        pub high: bool,
    } => Acquired, 0xff70, "acquire_semaphore"
}
command! {
    /// Gives a permit back, or waits no longer.
    pub struct ReleaseTicket { pub hold: u64 } => (), 0xff71, "release_ticket"
}
command! {
    /// Arrives at a barrier and waits for the others.
    #[derive(Debug)]
    pub struct ArriveBarrier {
        pub name: String,
        pub parties: u32,
        pub hold: u64,
        pub task: String,
        pub wait: Duration,
    } => Arrived, 0xff72, "arrive_barrier"
}
command! {
    /// Asks for the semaphores of the app, who holds them and who waits.
    pub struct ListSemaphores => Vec<SemaphoreView>, 0xff73, "list_semaphores"
}

/// Where somebody waits or holds.
#[derive(Debug, Clone, PartialEq, Eq)]
enum At {
    Semaphore(String),
    Barrier(String),
}

/// Somebody who waits, and until when.
#[derive(Debug)]
struct Waiter<C: Command> {
    reply: Replier<C>,
    until: Instant,
}

/// What the service keeps. It lies in its chassis, where displays can see it.
#[derive(Debug, Default)]
pub(super) struct Shared {
    semaphores: BTreeMap<String, Ledger<Waiter<AcquireSemaphore>>>,
    barriers: BTreeMap<String, Gathering<Waiter<ArriveBarrier>>>,
    /// Everybody who waits or holds.
    holds: BTreeMap<Hold, At>,
    /// Those who wait, by the end of their patience.
    deadlines: BTreeSet<(Instant, Hold)>,
}

/// Answers that are given when nothing is locked any more.
#[derive(Default)]
struct Answers {
    acquired: Vec<(Waiter<AcquireSemaphore>, Acquired)>,
    arrived: Vec<(Waiter<ArriveBarrier>, Arrived)>,
    /// Those who wait no longer: nobody reads what they are told by being dropped.
    withdrawn: Vec<Waiter<AcquireSemaphore>>,
    left: Vec<Waiter<ArriveBarrier>>,
}

impl Answers {
    fn give(self) {
        for (waiter, answer) in self.acquired {
            // An answer cannot fail.
            let _ = waiter.reply.ok(answer);
        }
        for (waiter, answer) in self.arrived {
            let _ = waiter.reply.ok(answer);
        }
    }
}

impl Shared {
    pub(super) fn views(&self) -> Vec<SemaphoreView> {
        let semaphores = self.semaphores.iter();
        semaphores
            .map(|(name, ledger)| store::view(name, Scope::App, ledger))
            .collect()
    }

    fn acquire(
        &mut self,
        request: &AcquireSemaphore,
        claim: Claim,
        waiter: Waiter<AcquireSemaphore>,
        now: Instant,
        answers: &mut Answers,
    ) {
        let ledger = self
            .semaphores
            .entry(request.name.clone())
            .or_insert_with(|| Ledger::new(request.permits));
        if ledger.permits() != request.permits {
            let has = ledger.permits();
            return answers.acquired.push((waiter, Acquired::Disagree { has }));
        }
        let (hold, until) = (claim.hold, waiter.until);
        if request.wait.is_zero() && !ledger.try_acquire(&claim, now) {
            let late = ledger.late(hold, now);
            return answers.acquired.push((waiter, Acquired::Late(late)));
        }
        self.holds.insert(hold, At::Semaphore(request.name.clone()));
        if request.wait.is_zero() {
            return answers.acquired.push((waiter, Acquired::Granted));
        }
        match ledger.acquire(claim, request.high, waiter, now) {
            Some(waiter) => answers.acquired.push((waiter, Acquired::Granted)),
            None => {
                self.deadlines.insert((until, hold));
            }
        }
    }

    fn arrive(
        &mut self,
        request: &ArriveBarrier,
        claim: Claim,
        waiter: Waiter<ArriveBarrier>,
        answers: &mut Answers,
    ) {
        let gathering = self
            .barriers
            .entry(request.name.clone())
            .or_insert_with(|| Gathering::new(request.parties));
        if gathering.parties() != request.parties {
            let has = gathering.parties();
            return answers.arrived.push((waiter, Arrived::Disagree { has }));
        }
        self.holds
            .insert(claim.hold, At::Barrier(request.name.clone()));
        self.deadlines.insert((waiter.until, claim.hold));
        for (claim, waiter, passage) in gathering.arrive(claim, waiter) {
            self.holds.remove(&claim.hold);
            self.deadlines.remove(&(waiter.until, claim.hold));
            answers.arrived.push((waiter, Arrived::Passed(passage)));
        }
    }

    /// Ends a wait or a hold, whichever it is; `late` says how those who still waited are answered.
    fn end(&mut self, hold: Hold, late: bool, now: Instant, answers: &mut Answers) {
        let Some(at) = self.holds.remove(&hold) else {
            return;
        };
        match at {
            At::Semaphore(name) => {
                let Some(ledger) = self.semaphores.get_mut(&name) else {
                    return;
                };
                let reason = ledger.late(hold, now);
                let (granted, withdrawn) = ledger.end(|claim| claim.hold == hold, now);
                for waiter in withdrawn {
                    self.deadlines.remove(&(waiter.until, hold));
                    if late {
                        let answer = Acquired::Late(reason.clone());
                        answers.acquired.push((waiter, answer));
                    } else {
                        answers.withdrawn.push(waiter);
                    }
                }
                for (served, waiter) in granted {
                    self.deadlines.remove(&(waiter.until, served));
                    answers.acquired.push((waiter, Acquired::Granted));
                }
            }
            At::Barrier(name) => {
                let Some(gathering) = self.barriers.get_mut(&name) else {
                    return;
                };
                let arrived = gathering.arrived();
                for waiter in gathering.leave(|claim| claim.hold == hold) {
                    self.deadlines.remove(&(waiter.until, hold));
                    if late {
                        let answer = Arrived::Late(arrived.clone());
                        answers.arrived.push((waiter, answer));
                    } else {
                        answers.left.push(waiter);
                    }
                }
            }
        }
    }

    fn end_all(&mut self, gone: impl Fn(&Hold) -> bool, now: Instant, answers: &mut Answers) {
        let holds: Vec<Hold> = self
            .holds
            .keys()
            .copied()
            .filter(|hold| gone(hold))
            .collect();
        // First those who wait, or what one gives back would be handed to the next who is gone as well.
        let waits: BTreeSet<Hold> = self.deadlines.iter().map(|(_, hold)| *hold).collect();
        let (waiting, holding): (Vec<_>, Vec<_>) =
            holds.into_iter().partition(|hold| waits.contains(hold));
        for hold in waiting.into_iter().chain(holding) {
            self.end(hold, false, now, answers);
        }
    }

    /// Tells those whose time is over. Returns the next end of somebody's patience.
    fn expire(&mut self, now: Instant, answers: &mut Answers) -> Option<Instant> {
        while let Some((until, hold)) = self.deadlines.first().copied() {
            if until > now {
                return Some(until);
            }
            self.deadlines.remove(&(until, hold));
            self.end(hold, true, now, answers);
        }
        None
    }
}

/// The service.
#[derive(Default)]
pub struct SemaphoreServer {
    /// Raised when somebody begins to wait; `None` before the first does.
    watched: Option<Signal>,
}

impl SemaphoreServer {
    /// Changes what is kept, then answers those whom it concerns.
    fn change(cx: &Context, change: impl FnOnce(&mut Shared, &mut Answers)) {
        let mut answers = Answers::default();
        change(&mut lock(&cx.chassis().blocking().shared), &mut answers);
        answers.give();
    }

    /// Sees to it that waits end in time.
    fn watch(&mut self, cx: &Context) {
        let signal = self.watched.get_or_insert_with(|| {
            let signal = Signal::new();
            cx.spawn(expire(cx.clone(), signal.clone()));
            signal
        });
        signal.raise();
    }
}

async fn expire(cx: Context, signal: Signal) {
    loop {
        let mut next = None;
        SemaphoreServer::change(&cx, |shared, answers| {
            next = shared.expire(cx.now(), answers);
        });
        match next {
            Some(next) => {
                let sleep = std::pin::pin!(cx.sleep(next.since(cx.now())));
                let raised = std::pin::pin!(signal.wait());
                match select(sleep, raised).await {
                    Either::Left(_) | Either::Right(_) => {}
                }
            }
            None => signal.wait().await,
        }
    }
}

/// A claim of the task that sent a message. Its chassis is known from the link, so nobody can name the
/// holds of others.
fn claim(from: Tid, number: u64, task: &str) -> Claim {
    let chassis = from.chassis();
    Claim {
        hold: Hold { chassis, number },
        task: task.into(),
        tid: from,
    }
}

impl EventHandler for SemaphoreServer {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        let from = message.from();
        let now = cx.now();
        match message.command() {
            AcquireSemaphore::CODE => {
                let (request, reply) = message.open::<AcquireSemaphore>()?;
                let claim = claim(from, request.hold, &request.task);
                let until = now + request.wait;
                let waiter = Waiter { reply, until };
                Self::change(cx, |shared, answers| {
                    shared.acquire(&request, claim, waiter, now, answers);
                });
                self.watch(cx);
                Ok(())
            }
            ReleaseTicket::CODE => {
                let (ReleaseTicket { hold }, reply) = message.open::<ReleaseTicket>()?;
                let hold = claim(from, hold, "").hold;
                Self::change(cx, |shared, answers| shared.end(hold, false, now, answers));
                reply.ok(())
            }
            ArriveBarrier::CODE => {
                let (request, reply) = message.open::<ArriveBarrier>()?;
                let claim = claim(from, request.hold, &request.task);
                let until = now + request.wait;
                let waiter = Waiter { reply, until };
                Self::change(cx, |shared, answers| {
                    shared.arrive(&request, claim, waiter, answers);
                });
                self.watch(cx);
                Ok(())
            }
            ListSemaphores::CODE => {
                let (ListSemaphores {}, reply) = message.open::<ListSemaphores>()?;
                let views = lock(&cx.chassis().blocking().shared).views();
                reply.ok(views)
            }
            _ => cx.default_processing(message),
        }
    }

    async fn chassis_down(&mut self, cx: &Context, chassis: &str) -> Handled {
        let now = cx.now();
        let home: Arc<Chassis> = cx.chassis().clone();
        let gone = |hold: &Hold| home.name_of(hold.chassis) == chassis;
        Self::change(cx, |shared, answers| shared.end_all(gone, now, answers));
        Ok(())
    }
}

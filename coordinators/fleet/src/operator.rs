//! The operator of a site: takes jobs from the company, lends them to the cells that the trader names, and tells the
//! company how they ended. What it must not forget stands in its [book](crate::book).

use std::{
    cell::RefCell,
    collections::{BTreeMap, BTreeSet},
    rc::Rc,
    time::Duration,
};

use ctos::{
    config::Node,
    message::Replier,
    registry::Registry,
    task::{Context, Durable, Handled, HandlerError, Handover, Phase, TaskRef},
};
use scene_summary::Mark;
use serde::Deserialize;

use crate::{
    agent::{CARRY, ask},
    book::{Book, Stand},
    wire::{
        Begin, CellState, Counts, Ended, Install, JobNumber, Judge, Lend, Look, Offer, Overdue,
        Overview, Report, Seek, Take, Turn,
    },
    world,
};

/// The handler's name.
pub const HANDLER: &str = "fleet.operator";

/// How often it looks what is to be done when nothing has happened.
const TURN: Duration = Duration::from_millis(500);

/// How often it asks the trader for all cells.
const SURVEY: Duration = Duration::from_secs(5);

/// How long an answer is waited for.
const ANSWER: Duration = Duration::from_secs(5);

/// How long a cell may take to install something.
const INSTALLED_WITHIN: Duration = Duration::from_secs(300);

/// What a cell must offer to get a job, and which of several gets it.
const FREE: &str = "load<1 -most reliability";

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Args {
    /// The trader of the site.
    trader: String,
    /// The task above, which gives jobs.
    company: String,
    /// The trader above, who hears how many jobs the site can take.
    above: String,
    /// How long a cell may work on a job, s.
    #[serde(default = "lease_s")]
    lease_s: Duration,
    /// By how much the clocks of two chassis, and the way of a message, may make a lease look longer to its cell, s.
    #[serde(default = "clock_bound_s")]
    clock_bound_s: Duration,
}

/// How long a cell may work on a job, by these arguments of an operator.
pub(crate) fn lease_of(args: &Node) -> Option<Duration> {
    args.parse::<Args>().ok().map(|args| args.lease_s)
}

fn lease_s() -> Duration {
    Duration::from_secs(90)
}

fn clock_bound_s() -> Duration {
    Duration::from_secs(5)
}

/// Registers the handler.
pub(crate) fn register(registry: &mut Registry) {
    registry
        .durable(HANDLER, &Operator::COMMANDS, |cx| {
            Ok(Operator {
                site: Site {
                    args: Rc::new(cx.args()?),
                    book: Rc::default(),
                    seen: Rc::default(),
                    run: cx.now().as_nanos(),
                },
            })
        })
        .checked_args::<Args>(|args, task, app, findings| {
            let needed = [
                ("trader", &args.trader),
                ("company", &args.company),
                ("above", &args.above),
            ];
            for (key, name) in needed {
                crate::need_task(task, app, key, name, findings);
            }
        });
}

/// What is known of the cells; found again after a kill.
#[derive(Debug, Default)]
struct Seen {
    /// All cells that were heard of, and whether they are there now.
    cells: BTreeMap<String, bool>,
    /// Jobs that the company is just being told of.
    telling: BTreeSet<JobNumber>,
    /// The trader is just being asked.
    seeking: bool,
    /// How each cell stood when it was last asked, and the change that it came with.
    told: BTreeMap<String, (u64, CellState)>,
    /// How many changes there were.
    changes: u64,
}

/// The event handler.
struct Operator {
    site: Site,
}

/// What the handler and its children share.
#[derive(Clone)]
struct Site {
    args: Rc<Args>,
    book: Rc<RefCell<Book>>,
    seen: Rc<RefCell<Seen>>,
    /// When it began, ns: what it saw before is forgotten.
    run: u64,
}

#[ctos::handler]
impl Operator {
    #[phase]
    async fn enters(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let (now, lease) = (cx.now(), self.site.lease());
            self.site.book.borrow_mut().begin_again(now, lease);
            let here = cx.clone();
            cx.spawn(async move {
                loop {
                    turn(&here);
                    here.sleep(TURN).await;
                }
            });
            let (site, here) = (self.site.clone(), cx.clone());
            cx.spawn(async move { site.survey_for_ever(&here).await });
        }
        Ok(())
    }

    #[command]
    fn take(&mut self, Take { number, job }: Take) -> u64 {
        self.site.book.borrow_mut().take(number, job)
    }

    #[command]
    fn begin(&mut self, Begin { job, epoch }: Begin) -> bool {
        self.site.book.borrow_mut().begin(job, epoch)
    }

    /// The cell is free, and says so to the trader, who is asked with the next turn.
    #[command]
    fn report(&mut self, report: Report) {
        self.site.book.borrow_mut().report(report);
    }

    #[command]
    fn turn(&mut self, cx: &Context, _: Turn) {
        self.site.book.borrow_mut().expire(cx.now());
        self.site.tell_ends(cx);
        self.site.seek(cx);
    }

    #[command]
    fn look(&mut self, cx: &Context, Look { after }: Look) -> Overview {
        self.site.overview(cx, after)
    }

    #[command]
    fn judge(&mut self, cx: &Context, judge: Judge) -> Result<Result<(), String>, HandlerError> {
        turn(cx);
        Ok(self.site.book.borrow_mut().judge(&judge, cx.now()))
    }

    #[command]
    fn install(&mut self, cx: &Context, install: Install, reply: Replier<Install>) -> Handled {
        let here = cx.clone();
        cx.spawn(async move {
            let cell = install.cell.clone();
            // Answering never fails; who is gone asks again.
            let _ = match ask(&here, &cell, install, INSTALLED_WITHIN).await {
                Ok(installed) => reply.ok(installed),
                Err(error) => reply.fail(error.to_string()),
            };
        });
        Ok(())
    }

    #[task_down]
    async fn gone(&mut self, cx: &Context, task: &str, _: &str) -> Handled {
        self.site
            .seen
            .borrow_mut()
            .cells
            .insert(task.to_owned(), false);
        let jobs = self.site.book.borrow_mut().gone(task);
        let now = cx.now();
        world::note(cx, |world| world.died(task, &jobs, now));
        turn(cx);
        Ok(())
    }

    #[task_up]
    async fn back(&mut self, _: &Context, task: &TaskRef) -> Handled {
        let mut seen = self.site.seen.borrow_mut();
        seen.cells.insert(task.name().to_owned(), true);
        Ok(())
    }
}

/// Has the task look soon what is to be done.
pub(crate) fn turn(cx: &Context) {
    let here = cx.clone();
    cx.spawn(async move {
        if let Ok(me) = here.task(here.name()).await {
            // A full queue has something to look at already.
            let _ = here.try_send(&me, Turn {});
        }
    });
}

impl Site {
    /// How long it takes until a cell has given up for sure what was lent to it.
    fn lease(&self) -> Duration {
        self.args.lease_s + self.args.clock_bound_s
    }

    /// Asks the trader for cells, if jobs wait, and lends them.
    fn seek(&self, cx: &Context) {
        let waiting = self.book.borrow().waiting().count();
        if waiting == 0 || self.seen.borrow().seeking {
            return;
        }
        self.seen.borrow_mut().seeking = true;
        let (site, here) = (self.clone(), cx.clone());
        cx.spawn(async move {
            let holders = site.book.borrow().entries().len();
            let seek = Seek {
                service: CARRY.to_owned(),
                wanted: FREE.to_owned(),
                most: u32::try_from(waiting + holders).unwrap_or(u32::MAX),
            };
            let found = ask(&here, &site.args.trader, seek, ANSWER).await;
            site.seen.borrow_mut().seeking = false;
            let cells = found.unwrap_or_default().into_iter().map(|one| one.from);
            if let Err(error) = site.lend(&here, cells.collect()).await {
                here.fail(&error.to_string());
            }
        });
    }

    /// Lends waiting jobs to cells that have none, and stores that before the cells hear of it.
    async fn lend(&self, cx: &Context, cells: Vec<String>) -> Handled {
        let mut lent = Vec::new();
        {
            let mut book = self.book.borrow_mut();
            let seen = self.seen.borrow();
            let busy: BTreeSet<String> = book
                .entries()
                .values()
                .filter_map(Book::holder)
                .map(str::to_owned)
                .collect();
            let is_there = |cell: &String| seen.cells.get(cell) != Some(&false);
            let free = cells
                .into_iter()
                .filter(|cell| !busy.contains(cell) && is_there(cell));
            let waiting: Vec<_> = book.waiting().cloned().collect();
            for (job, cell) in waiting.into_iter().zip(free) {
                if let Some(epoch) = book.lend(job.number, &cell, cx.now(), self.lease()) {
                    lent.push((job, cell, epoch));
                }
            }
        }
        if lent.is_empty() {
            return Ok(());
        }
        let book = self.book.borrow().clone();
        cx.keep(&book).await?;
        for (job, cell, epoch) in lent {
            let (site, here) = (self.clone(), cx.clone());
            cx.spawn(async move {
                let number = job.number;
                let now = here.now();
                world::note(&here, |world| world.lend(number, &cell, now));
                let lend = Lend {
                    job,
                    epoch,
                    lease_ms: u64::try_from(site.args.lease_s.as_millis()).unwrap_or(u64::MAX),
                };
                let taken = ask(&here, &cell, lend, ANSWER).await;
                if !taken.unwrap_or(false) {
                    // Should it work on it after all: it will not be told that it may begin.
                    site.book.borrow_mut().take_back(number, epoch);
                    turn(&here);
                }
            });
        }
        Ok(())
    }

    /// Tells the company how jobs ended, each until it has heard.
    fn tell_ends(&self, cx: &Context) {
        let book = self.book.borrow();
        for (number, entry) in book.entries() {
            let Stand::Over(outcome) = entry.stand else {
                continue;
            };
            if !self.seen.borrow_mut().telling.insert(*number) {
                continue;
            }
            let ended = Ended {
                job: *number,
                site: cx.name().to_owned(),
                outcome,
                attempts: entry.attempts.clone(),
            };
            let (site, here) = (self.clone(), cx.clone());
            cx.spawn(async move {
                let number = ended.job;
                while ask(&here, &site.args.company, ended.clone(), ANSWER)
                    .await
                    .is_err()
                {
                    here.sleep(TURN).await;
                }
                site.book.borrow_mut().forget(number);
                site.seen.borrow_mut().telling.remove(&number);
                // Stored with the next change; told twice, the company knows it already.
            });
        }
    }

    /// Learns again and again which cells there are, and offers their work above.
    async fn survey_for_ever(&self, cx: &Context) {
        loop {
            let seek = Seek {
                service: CARRY.to_owned(),
                wanted: String::new(),
                most: u32::MAX,
            };
            if let Ok(found) = ask(cx, &self.args.trader, seek, ANSWER).await {
                self.meet(cx, found.into_iter().map(|one| one.from)).await;
            }
            let cells = self.seen.borrow().cells.len();
            let offer = Offer {
                service: CARRY.to_owned(),
                from: cx.name().to_owned(),
                attributes: format!("cells={cells}"),
                stands_ms: u64::try_from((SURVEY * 3).as_millis()).unwrap_or(u64::MAX),
            };
            if let Err(error) = ask(cx, &self.args.above, offer, ANSWER).await {
                tracing::debug!(%error, "the company's trader did not hear the offer");
            }
            cx.sleep(SURVEY).await;
        }
    }

    /// Watches cells that it has not known.
    async fn meet(&self, cx: &Context, cells: impl Iterator<Item = String>) {
        for cell in cells {
            if self.seen.borrow().cells.contains_key(&cell) {
                continue;
            }
            let Ok(agent) = cx.task(&cell).await else {
                continue;
            };
            self.seen.borrow_mut().cells.insert(cell, true);
            // Unwatched, a cell's jobs come back when its leases end.
            let _ = cx.monitor(&agent).await;
        }
    }

    fn overview(&self, cx: &Context, after: Option<Mark>) -> Overview {
        let (book, mut seen) = (self.book.borrow(), self.seen.borrow_mut());
        let overdue: Vec<Overdue> = book.overdue(cx.now()).collect();
        let late: BTreeSet<&str> = overdue.iter().map(|one| one.cell.as_str()).collect();
        let entries = book.entries().values();
        let busy: BTreeSet<&str> = entries.filter_map(Book::holder).collect();
        let mut counts = Counts {
            waiting: u32::try_from(book.waiting().count()).unwrap_or(u32::MAX),
            deaths: book.deaths(),
            ..Counts::default()
        };
        (counts.carried, counts.failed) = book.ended();
        let Seen {
            cells,
            told,
            changes,
            ..
        } = &mut *seen;
        for (cell, is_there) in cells.iter() {
            let state = match (is_there, busy.contains(cell.as_str())) {
                _ if late.contains(cell.as_str()) => CellState::Overdue,
                (false, _) => CellState::Silent,
                (true, true) => CellState::Working,
                (true, false) => CellState::Idle,
            };
            counts.cells += 1;
            counts.silent += u32::from(!*is_there);
            counts.working += u32::from(state == CellState::Working);
            if told.get(cell).is_none_or(|(_, known)| *known != state) {
                *changes += 1;
                told.insert(cell.clone(), (*changes, state));
            }
        }
        let since = after.filter(|mark| mark.run == self.run);
        let since = since.map_or(0, |mark| mark.seq);
        let new = told.iter().filter(|(_, (change, _))| *change > since);
        Overview {
            mark: Mark {
                run: self.run,
                seq: *changes,
            },
            counts,
            cells: new
                .map(|(cell, (_, state))| (cell.clone(), *state))
                .collect(),
            overdue,
        }
    }
}

impl Handover for Operator {
    type State = Book;

    fn hand_over(&mut self) -> Result<Book, HandlerError> {
        Ok(self.state())
    }

    fn take_over(&mut self, _: &Context, state: Book) -> Handled {
        *self.site.book.borrow_mut() = state;
        Ok(())
    }
}

impl Durable for Operator {
    fn state(&self) -> Book {
        self.site.book.borrow().clone()
    }
}

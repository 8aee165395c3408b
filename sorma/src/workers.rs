//! Threads on which a daemon has its objects built and called. So an object that takes its time, or never comes to an
//! end, keeps nobody else waiting. A thread that an object does not give back ends with its process.

use crate::raise;
use crate::report::{Report, code};
use ctos::time::Instant;
use parking_lot::Mutex;
use std::any::Any;
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::LazyLock;
use std::time::Duration;
use tokio::runtime::{Builder, Runtime};

/// So many objects of a process may be at work at once; the next one waits for one of them.
const MOST: usize = 256;

/// How long a thread without work is kept.
const KEPT: Duration = Duration::from_secs(60);

/// When all threads have been at work for so long, a request does not wait for one.
const LONG: Duration = Duration::from_secs(1);

/// So many of them are named.
const NAMED: usize = 3;

/// What is at work, or waits for a thread.
#[derive(Debug)]
pub(crate) struct Work {
    /// The object.
    pub(crate) name: String,
    /// Which call of it, of whom.
    pub(crate) call: String,
    pub(crate) since: Instant,
}

/// The threads of this process, made when they are needed.
#[derive(Debug)]
pub struct Workers {
    threads: Runtime,
    most: usize,
    /// In the order in which it came.
    at_work: Mutex<BTreeMap<u64, Work>>,
}

static WORKERS: LazyLock<Option<Workers>> = LazyLock::new(|| {
    let built = Workers::new(MOST);
    if let Err(error) = &built {
        tracing::warn!(error = %error, "objects are called on the threads of their daemons");
    }
    built.ok()
});

impl Workers {
    fn new(most: usize) -> std::io::Result<Self> {
        let threads = Builder::new_current_thread()
            .thread_name("objects")
            .max_blocking_threads(most)
            .thread_keep_alive(KEPT)
            .build()?;
        Ok(Self {
            threads,
            most,
            at_work: Mutex::default(),
        })
    }

    /// Those of this process; `None` when the system refuses them.
    #[must_use]
    pub(crate) fn of_process() -> Option<&'static Self> {
        WORKERS.as_ref()
    }

    /// Does some work to a value there; with the value comes back what a panic said.
    ///
    /// # Errors
    /// All threads have been at work for long; which objects keep them, in the chassis `process`.
    pub(crate) async fn call<T: Send + 'static>(
        &'static self,
        work: Work,
        process: &str,
        mut value: T,
        act: impl FnOnce(&mut T) + Send + 'static,
    ) -> Result<(T, Result<(), Box<dyn Any + Send>>), (T, Report)> {
        let number = match self.begin(work, process) {
            Ok(number) => number,
            Err(report) => return Err((value, report)),
        };
        let called = self.threads.spawn_blocking(move || {
            let ended = catch_unwind(AssertUnwindSafe(|| act(&mut value)));
            self.at_work.lock().remove(&number);
            (value, ended)
        });
        match called.await {
            Ok(done) => Ok(done),
            // What it does is contained, and this runtime is never shut down.
            Err(error) => resume_unwind(Box::new(error.to_string())),
        }
    }

    /// Notes what will be at work.
    fn begin(&self, work: Work, process: &str) -> Result<u64, Report> {
        let mut at_work = self.at_work.lock();
        let now = work.since;
        let is_long = |work: &&Work| now.since(work.since) >= LONG;
        let long = at_work.values().filter(is_long).count();
        if long >= self.most {
            return Err(crowded(at_work.values(), process, now));
        }
        let number = at_work
            .last_key_value()
            .map_or(0, |(last, _)| last.wrapping_add(1));
        at_work.insert(number, work);
        Ok(number)
    }
}

/// Nobody else gets a thread; why.
fn crowded<'a>(
    at_work: impl ExactSizeIterator<Item = &'a Work>,
    process: &str,
    now: Instant,
) -> Report {
    let count = at_work.len();
    let named = at_work.take(NAMED);
    let named: Vec<String> = named
        .map(|Work { name, call, since }| {
            let time = now.since(*since).as_secs_f64();
            format!("`{name}` is in {call} for {time:.1} s")
        })
        .collect();
    let more = match count.saturating_sub(NAMED) {
        0 => String::new(),
        more => format!(", and {more} more"),
    };
    raise!(
        code::BUSY,
        "all {count} calls that the objects of chassis `{process}` may be in at once take long: {}{more}; \
         `ctos restart {process}` ends them",
        named.join(", ")
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::class::Class;
    use crate::comm::{Alone, Answer, Comm, Job};
    use crate::name::Location;
    use crate::object::{Context, Later, Outcome, ServiceObject, Waiting};
    use crate::report::{Report, code};
    use crate::request::{Reply, Request};
    use crate::transport::Transport;
    use crate::{Dictionary, Sorm, demo};
    use ctos::time::Clock;
    use futures_util::future::{LocalBoxFuture, join};
    use std::sync::mpsc::{Receiver, Sender, channel};

    /// How long it is waited.
    #[derive(Clone, Copy, PartialEq)]
    enum Patience {
        Endless,
        None,
    }

    /// Reaches nobody, and has objects called on threads.
    struct Threads(Patience, &'static Workers);

    impl Comm for Threads {
        fn ask<'a>(&'a self, at: &'a Location, request: Request) -> Answer<'a, Transport> {
            Alone.ask(at, request)
        }

        fn sleep(&self, _: Duration) -> LocalBoxFuture<'_, ()> {
            match self.0 {
                Patience::Endless => Box::pin(std::future::pending()),
                Patience::None => Box::pin(std::future::ready(())),
            }
        }

        fn spawn(&self, job: Job) -> Result<(), Report> {
            Alone.spawn(job)
        }

        fn workers(&self) -> Option<&'static Workers> {
            Some(self.1)
        }
    }

    /// Says that it has begun, and ends when it may; panics when it is told to.
    struct Mill {
        begun: Sender<()>,
        may_end: Receiver<()>,
    }

    impl ServiceObject for Mill {
        fn exec(&mut self, _: &Context<'_>, io: &mut Transport) -> Outcome {
            assert_ne!(io.text, "break");
            self.begun.send(()).unwrap();
            self.may_end.recv_timeout(Duration::from_secs(60)).unwrap();
            io.text = "ground".to_owned();
            Ok(())
        }

        fn ctrl(&mut self, _: &Context<'_>, _: &mut Transport) -> Outcome {
            Ok(())
        }

        fn dump(&self) -> String {
            String::new()
        }
    }

    /// A [`Mill`] whose EXEC may wait for others; it does not give back its thread while it grinds.
    struct Waits(Mill);

    impl ServiceObject for Waits {
        fn exec_waiting<'a>(&'a mut self, cx: &'a Waiting<'a>, io: &'a mut Transport) -> Later<'a> {
            Some(Box::pin(async move {
                // Asked where its daemon is.
                cx.comm().back(&Location::Alias("far".to_owned())).await?;
                self.0.exec(cx.here(), io)?;
                let line = "bar CTRL -dump".parse().unwrap();
                io.text = cx.ask(line).await.body.text;
                Ok(())
            }))
        }

        fn ctrl(&mut self, _: &Context<'_>, _: &mut Transport) -> Outcome {
            Ok(())
        }

        fn dump(&self) -> String {
            String::new()
        }
    }

    /// A manager with a mill; who is told that it turns, and what lets it end.
    fn mill() -> (Sorm, Receiver<()>, Sender<()>) {
        let (begun, turns) = channel();
        let (end, may_end) = channel();
        let once = parking_lot::Mutex::new(Some(Mill { begun, may_end }));
        let sorm = Sorm::new(Dictionary::new());
        demo::register(&sorm);
        let class = Class::new("mill", "1.0", move |_, _| {
            let mill = once.lock().take();
            let gone = || Report::error(code::VALUE, "there is only one");
            mill.map(|mill| Box::new(mill) as Box<dyn ServiceObject>)
                .ok_or_else(gone)
        });
        sorm.register(class.any_flavor());
        (sorm, turns, end)
    }

    /// A manager with a mill that waits for others, and panics when it is told to.
    fn waiting_mill() -> (Sorm, Receiver<()>, Sender<()>) {
        let (begun, turns) = channel();
        let (end, may_end) = channel();
        let once = parking_lot::Mutex::new(Some(Waits(Mill { begun, may_end })));
        let sorm = Sorm::new(Dictionary::new());
        demo::register(&sorm);
        let class = Class::new("mill", "1.0", move |_, _| {
            let mill = once.lock().take();
            let gone = || Report::error(code::VALUE, "there is only one");
            mill.map(|mill| Box::new(mill) as Box<dyn ServiceObject>)
                .ok_or_else(gone)
        });
        sorm.register(class.any_flavor().waits());
        (sorm, turns, end)
    }

    fn run<T>(work: impl Future<Output = T>) -> T {
        let runtime = Builder::new_current_thread().build();
        runtime.unwrap().block_on(work)
    }

    async fn asked(sorm: &Sorm, wait: Patience, line: &str) -> Reply {
        asked_on(Workers::of_process().unwrap(), sorm, wait, line).await
    }

    async fn asked_on(workers: &'static Workers, sorm: &Sorm, wait: Patience, line: &str) -> Reply {
        let told = sorm.tell(&Threads(wait, workers), line, "anna").await;
        told.parse().unwrap()
    }

    #[test]
    fn an_object_that_does_not_end_keeps_nobody_from_others_and_is_named_to_who_wants_it() {
        let (sorm, turns, end) = mill();
        assert!(
            run(asked(&sorm, Patience::Endless, "mill.a CTRL"))
                .body
                .is_ok()
        );
        let grinds = asked(&sorm, Patience::Endless, "mill.a EXEC");
        let meanwhile = async {
            // It begins on its own thread, so this one may wait for it here.
            turns.recv().unwrap();
            let other = asked(&sorm, Patience::Endless, "bar CTRL -tea 1 -dump").await;
            let busy = asked(&sorm, Patience::Endless, "sorm CTRL -busy").await;
            let second = asked(&sorm, Patience::None, "mill.a EXEC").await;
            let dump = asked(&sorm, Patience::None, "mill.a CTRL -dump").await;
            end.send(()).unwrap();
            (other, busy, second, dump)
        };
        let (ground, (other, busy, second, dump)) = run(join(grinds, meanwhile));
        assert_eq!(ground.body.text, "ground");
        assert!(other.body.is_ok());
        assert!(busy.body.text.starts_with("mill.a: EXEC of `anna` for "));
        for late in [second, dump] {
            assert_eq!(late.body.code, code::BUSY);
            let text = &late.body.reports[0].text;
            assert!(
                text.starts_with("`mill.a` is in EXEC of `anna` for "),
                "{text}"
            );
            assert!(text.contains("`ctos restart "), "{text}");
        }
        assert_eq!(
            run(asked(&sorm, Patience::Endless, "sorm CTRL -busy"))
                .body
                .text,
            ""
        );
    }

    /// A class whose objects are built when they may be.
    fn slow_to_build(sorm: &Sorm) -> (Receiver<()>, Sender<()>) {
        let (begun, turns) = channel();
        let (end, may_end) = channel();
        let both = parking_lot::Mutex::new((begun, may_end));
        let class = Class::new("kiln", "1.0", move |_, _| {
            let both = both.lock();
            both.0.send(()).unwrap();
            both.1.recv().unwrap();
            Err(Report::error(code::VALUE, "it is cold"))
        });
        sorm.register(class.any_flavor());
        (turns, end)
    }

    #[test]
    fn an_object_whose_building_does_not_end_keeps_nobody_from_others_built_or_not_and_is_named() {
        let sorm = Sorm::new(Dictionary::new());
        demo::register(&sorm);
        let (begun, end) = slow_to_build(&sorm);
        let builds = asked(&sorm, Patience::Endless, "kiln.a EXEC");
        let meanwhile = async {
            // It begins on its own thread, so this one may wait for it here.
            begun.recv().unwrap();
            let new = asked(&sorm, Patience::Endless, "bar CTRL -tea 1 -dump").await;
            let old = asked(&sorm, Patience::Endless, "bar CTRL -dump").await;
            let busy = asked(&sorm, Patience::Endless, "sorm CTRL -busy").await;
            let second = asked(&sorm, Patience::None, "kiln.a EXEC").await;
            end.send(()).unwrap();
            end.send(()).unwrap();
            (new, old, busy, second)
        };
        let (built, (new, old, busy, second)) = run(join(builds, meanwhile));
        assert!(new.body.is_ok() && old.body.is_ok());
        let text = &busy.body.text;
        assert!(text.starts_with("kiln.a: is being built for "), "{text}");
        assert_eq!(second.body.code, code::BUSY);
        let text = &second.body.reports[0].text;
        assert!(
            text.starts_with("`kiln.a` has been in the making for "),
            "{text}"
        );
        assert!(text.contains("`ctos restart "), "{text}");
        // The report of the building reaches the first caller.
        assert_eq!(built.body.code, code::VALUE);
    }

    #[test]
    fn when_all_threads_have_long_been_at_work_a_request_hears_at_once_of_whom_and_what_ends_them()
    {
        let workers: &'static Workers = Box::leak(Box::new(Workers::new(2).unwrap()));
        let clock = Clock::virtual_clock();
        let sorm = Sorm::of("cage", clock.clone(), Dictionary::new());
        demo::register(&sorm);
        let (begun, end) = slow_to_build(&sorm);
        let first = asked_on(workers, &sorm, Patience::Endless, "kiln.a EXEC");
        let waits = |line| asked_on(workers, &sorm, Patience::Endless, line);
        let meanwhile = async {
            begun.recv().unwrap();
            let work = Work {
                name: "mill".to_owned(),
                call: "EXEC of `bert`".to_owned(),
                since: sorm.now(),
            };
            let held = workers.begin(work, "cage").unwrap();
            // Nothing takes long yet, and there is a thread.
            let early = waits("bar CTRL -dump").await;
            clock.advance_to(Instant::START + LONG);
            let late = waits("bar CTRL -dump").await;
            workers.at_work.lock().remove(&held);
            let again = waits("bar CTRL -dump").await;
            end.send(()).unwrap();
            (early, late, again)
        };
        let (_, (early, late, again)) = run(join(first, meanwhile));
        assert!(early.body.is_ok() && again.body.is_ok());
        assert_eq!(late.body.code, code::BUSY);
        assert_eq!(
            late.body.reports[0].text,
            "all 2 calls that the objects of chassis `cage` may be in at once take long: `kiln.a` is in EXEC of `anna` \
             for 1.0 s, `mill` is in EXEC of `bert` for 1.0 s; `ctos restart cage` ends them"
        );
    }

    #[test]
    fn an_object_that_asks_others_and_loops_between_its_waits_keeps_nobody_from_others() {
        let (sorm, turns, end) = waiting_mill();
        let grinds = asked(&sorm, Patience::Endless, "mill.a EXEC");
        let meanwhile = async {
            // It gets this far on its own thread, and on this one only when it is done.
            while turns.try_recv().is_err() {
                tokio::task::yield_now().await;
            }
            let other = asked(&sorm, Patience::Endless, "bar CTRL -tea 1").await;
            let busy = asked(&sorm, Patience::Endless, "sorm CTRL -busy").await;
            let second = asked(&sorm, Patience::None, "mill.a EXEC").await;
            end.send(()).unwrap();
            (other, busy, second)
        };
        let (ground, (other, busy, second)) = run(join(grinds, meanwhile));
        assert!(other.body.is_ok());
        let text = &busy.body.text;
        assert!(text.starts_with("mill.a: EXEC of `anna` for "), "{text}");
        assert_eq!(second.body.code, code::BUSY);
        assert!(ground.body.text.contains("-tea"), "{}", ground.body.text);
    }

    #[test]
    fn a_panic_of_an_object_that_asks_others_is_a_report_and_the_object_is_gone() {
        let (sorm, ..) = waiting_mill();
        let reply = run(asked(&sorm, Patience::Endless, "mill.a EXEC break"));
        assert_eq!(reply.body.code, code::PANIC);
        assert!(sorm.find("mill.a").is_none());
    }

    #[test]
    fn requests_to_an_object_that_is_built_meanwhile_are_met_in_their_order() {
        for number in 0..200 {
            let (sorm, ..) = mill();
            let set = asked(&sorm, Patience::Endless, "foo CTRL -where garden");
            let read = asked(&sorm, Patience::Endless, "foo EXEC");
            let (set, read) = run(join(set, read));
            assert!(set.body.is_ok());
            assert_eq!(read.body.text, "dinner in the garden, piano", "{number}");
            assert!(sorm.inner.arrivals.lock().is_empty());
        }
    }

    #[test]
    fn requests_to_one_object_are_met_in_their_order() {
        let (sorm, ..) = mill();
        for place in ["garden", "kitchen", "garden"] {
            let line = format!("foo CTRL -where {place}");
            let set = asked(&sorm, Patience::Endless, &line);
            let served = asked(&sorm, Patience::Endless, "foo EXEC");
            let (set, served) = run(join(set, served));
            assert!(set.body.is_ok());
            assert_eq!(served.body.text, format!("dinner in the {place}, piano"));
        }
    }

    #[test]
    fn a_panic_on_a_thread_is_a_report_and_the_object_is_gone() {
        let (sorm, ..) = mill();
        let reply = run(asked(
            &sorm,
            Patience::Endless,
            "mill.a EXEC break FMSG 1 2",
        ));
        assert_eq!(
            (reply.body.code, &*reply.body.floats),
            (code::PANIC, &[2.0][..])
        );
        assert!(sorm.find("mill.a").is_none());
    }
}

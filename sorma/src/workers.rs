//! Threads on which a daemon has its objects called: one that takes its time, or never comes to an end, keeps nobody else
//! waiting. A thread that an object does not give back ends with its process.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::LazyLock;
use std::time::Duration;
use tokio::runtime::{Builder, Runtime};

/// So many objects of a process may be in long calls at once; the next call waits for one of them.
const MOST: usize = 64;

/// How long a thread without work is kept.
const KEPT: Duration = Duration::from_secs(60);

/// The threads of this process, made when they are needed.
#[derive(Debug)]
pub struct Workers(Runtime);

static WORKERS: LazyLock<Option<Workers>> = LazyLock::new(|| {
    let built = Builder::new_current_thread()
        .thread_name("objects")
        .max_blocking_threads(MOST)
        .thread_keep_alive(KEPT)
        .build();
    if let Err(error) = &built {
        tracing::warn!(error = %error, "objects are called on the threads of their daemons");
    }
    built.ok().map(Workers)
});

impl Workers {
    /// Those of this process; `None` when the system refuses them.
    #[must_use]
    pub(crate) fn of_process() -> Option<&'static Self> {
        WORKERS.as_ref()
    }

    /// Does something to a value there; with it comes back what a panic said.
    pub(crate) async fn call<T: Send + 'static>(
        &self,
        mut value: T,
        act: impl FnOnce(&mut T) + Send + 'static,
    ) -> (T, Result<(), Box<dyn Any + Send>>) {
        let called = self.0.spawn_blocking(move || {
            let ended = catch_unwind(AssertUnwindSafe(|| act(&mut value)));
            (value, ended)
        });
        match called.await {
            Ok(done) => done,
            // What it does is contained, and this runtime is never shut down.
            Err(error) => resume_unwind(Box::new(error.to_string())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::class::Class;
    use crate::comm::{Alone, Answer, Comm, Job};
    use crate::name::Location;
    use crate::object::{Context, Outcome, ServiceObject};
    use crate::report::{Report, code};
    use crate::request::{Reply, Request};
    use crate::transport::Transport;
    use crate::{Dictionary, Sorm, demo};
    use futures_util::future::{LocalBoxFuture, join};
    use std::sync::mpsc::{Receiver, Sender, channel};

    /// How long it is waited.
    #[derive(Clone, Copy, PartialEq)]
    enum Patience {
        Endless,
        None,
    }

    /// Reaches nobody, and has objects called on threads.
    struct Threads(Patience);

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
            Workers::of_process()
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
            self.may_end.recv().unwrap();
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

    fn run<T>(work: impl Future<Output = T>) -> T {
        let runtime = Builder::new_current_thread().build();
        runtime.unwrap().block_on(work)
    }

    async fn asked(sorm: &Sorm, wait: Patience, line: &str) -> Reply {
        let told = sorm.tell(&Threads(wait), line, "anna").await;
        told.parse().unwrap()
    }

    #[test]
    fn an_object_that_does_not_end_keeps_nobody_from_others_and_is_named_to_who_wants_it() {
        let (sorm, turns, end) = mill();
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

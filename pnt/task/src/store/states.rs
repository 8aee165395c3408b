//! The states of ordinary tasks that survive their processes (`state = "durable"`), in stores like those of nets.

use std::sync::Arc;

use ctos::{
    registry::Registry,
    task::{Context, Handled, HandlerError, StateStore},
};
use futures_util::future::LocalBoxFuture;

use super::{Owner, Store, StoreError};

/// The folder of the stores, relative to the configuration's folder.
const FOLDER: &str = "state";

/// The name that a state has in its store.
const STATE: &str = "state";

/// Stores the states of durable tasks, each in the file `state/TASK.task.redb` beside the configuration.
pub fn keep_states(registry: &mut Registry) {
    registry.states(States);
}

struct States;

impl States {
    /// The store of a task. It stays open as long as its chassis lives.
    fn open(cx: &Context) -> Result<Arc<Store>, StoreError> {
        let owner = Owner {
            kind: "task".to_owned(),
            name: cx.name().to_owned(),
        };
        let file = format!("{}.task.redb", cx.name());
        Store::open(cx, &cx.path(FOLDER).join(file), &owner)
    }
}

impl StateStore for States {
    fn load(&self, cx: &Context) -> Result<Option<Vec<u8>>, HandlerError> {
        Ok(Self::open(cx)?.load(cx)?.remove(STATE))
    }

    fn store<'a>(&'a self, cx: &'a Context, state: &'a [u8]) -> LocalBoxFuture<'a, Handled> {
        Box::pin(async move {
            let changes = vec![(STATE.to_owned(), Some(state.to_vec()))];
            Ok(Self::open(cx)?.commit(cx, changes).await?)
        })
    }
}

#[cfg(test)]
mod tests {
    use std::{collections::BTreeMap, time::Duration};

    use ctos::{
        boot::{End, Observer},
        config::load_texts,
        message::Command,
        simulation::{self, Fault, FaultKind, Faults, Setup},
        system::AppResult,
        task::{Durable, Handover, Phase},
        time::Instant,
    };
    use serde::{Deserialize, Serialize};

    use super::*;

    /// Counts once for each number of each asker, and answers how often it has counted.
    #[derive(Debug, Clone, Serialize, Deserialize, Command)]
    #[command(reply = u64, code = 0x0001)]
    struct CountOnce {
        from: String,
        number: u64,
    }

    /// Answers how often it has counted.
    #[derive(Serialize, Deserialize, Command)]
    #[command(reply = u64, code = 0x0002)]
    struct Read {}

    #[derive(Default, Clone, Serialize, Deserialize)]
    struct Counted {
        count: u64,
        /// The last number of each asker.
        last: BTreeMap<String, u64>,
    }

    struct Counter(Counted);

    #[ctos::handler]
    impl Counter {
        #[command]
        fn count_once(&mut self, request: CountOnce) -> u64 {
            let last = self.0.last.entry(request.from).or_default();
            if *last < request.number {
                *last = request.number;
                self.0.count += 1;
            }
            self.0.count
        }

        #[command]
        fn read(&mut self, _: Read) -> u64 {
            self.0.count
        }
    }

    impl Handover for Counter {
        type State = Counted;

        fn hand_over(&mut self) -> Result<Counted, HandlerError> {
            Ok(self.state())
        }

        fn take_over(&mut self, _: &Context, state: Counted) -> Handled {
            self.0 = state;
            Ok(())
        }
    }

    impl Durable for Counter {
        fn state(&self) -> Counted {
            self.0.clone()
        }
    }

    /// Asks for so many counts, each until it is answered, while a child looks; ends the app with what it saw.
    struct Asker;

    #[ctos::handler]
    impl Asker {
        #[phase]
        async fn enters(&mut self, cx: &Context, phase: Phase) -> Handled {
            if phase == Phase::Run {
                let here = cx.clone();
                cx.spawn(async move {
                    let said = count(&here).await;
                    let ok = said.is_ok();
                    let text = said.unwrap_or_else(|error| error.to_string());
                    let json = String::new();
                    here.finish(AppResult { ok, text, json });
                });
                let here = cx.clone();
                cx.spawn(async move {
                    let mut most = 0;
                    loop {
                        if let Ok(counter) = here.task("counter").await
                            && let Ok(count) = here.call(&counter, Read {}).await
                        {
                            if count < most {
                                return here.fail(&format!("{count} was seen after {most}"));
                            }
                            most = count;
                        }
                        here.sleep(Duration::from_micros(700)).await;
                    }
                });
            }
            Ok(())
        }
    }

    async fn count(cx: &Context) -> Result<String, HandlerError> {
        for number in 1..=20 {
            let from = cx.name().to_owned();
            let request = CountOnce { from, number };
            let counted = loop {
                let counter = cx.wait_for_task("counter", Duration::from_secs(60)).await?;
                match cx.call(&counter, request.clone()).await {
                    Ok(counted) => break counted,
                    Err(_) => cx.sleep(Duration::from_millis(5)).await,
                }
            };
            if counted != number {
                return Err(format!("count {number} was answered with {counted}").into());
            }
        }
        Ok("counted".to_owned())
    }

    fn app(state: &str) -> ctos::config::App {
        let text = format!(
            "[app]\nuntil = \"asker\"\n[time]\nmode = \"virtual\"\n[chassis.desk]\n[chassis.home]\nrestart = \"always\"\nmax_restarts = 100\nrestart_backoff_s = 0.01\n[task.asker]\nhandler = \"asker\"\non = \"desk\"\n[task.counter]\nhandler = \"counter\"\non = \"home\"\nstate = \"{state}\"\n"
        );
        load_texts(&[("app.toml", &text)], &[], &[]).unwrap()
    }

    /// How the app ends whose counter is killed at these times, in tenths of a millisecond.
    fn ends(state: &str, kills: &[u64]) -> (End, usize) {
        let mut registry = Registry::new();
        registry.durable("counter", &Counter::COMMANDS, |_| {
            Ok(Counter(Counted::default()))
        });
        registry.handler("asker", &[], |_| Ok(Asker));
        keep_states(&mut registry);
        let app = app(state);
        assert!(registry.check(&app).is_empty());
        let kills = kills.iter().map(|at| {
            let at = Instant::from_nanos(at * 100_000);
            Fault::on("home".to_owned(), FaultKind::Kill, at)
        });
        let faults = Faults::of_script("kills", kills.collect());
        let setup = Setup {
            faults,
            ..Setup::default()
        };
        let observer: Observer = Arc::new(|_| ());
        let run = simulation::run(app, registry, setup, &observer).unwrap();
        (run.outcome.end, run.faults.len())
    }

    #[test]
    fn no_count_that_was_answered_or_seen_is_lost_or_doubled_whenever_its_task_is_killed() {
        let mut killed = 0;
        for step in 0..150 {
            // The counts take 50 ms, and to be started again 40 ms.
            let at = 1 + step * 3;
            let kills = [at, at + 420 + step, at + 840 + 2 * step];
            let (end, times) = ends("durable", &kills);
            match end {
                End::Finished(result) => assert_eq!(result.text, "counted", "{kills:?}"),
                other => panic!("{kills:?}: {other:?}"),
            }
            killed += times;
        }
        assert!(killed > 250, "{killed}");
    }

    #[test]
    fn a_state_in_memory_is_lost_with_its_process() {
        let lost = |at| !matches!(ends("memory", &[at]).0, End::Finished(result) if result.ok);
        assert!((5..60).any(lost));
    }
}

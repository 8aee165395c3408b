//! Lines of the log about a durable net say what is stored, as its stream does.

use std::sync::{
    Arc,
    atomic::{AtomicU32, Ordering},
};

use ctos::{
    simulation::{Fault, FaultKind, Faults},
    time::Instant,
};
use tracing::{Event, Metadata, Subscriber, span};

use super::{
    survival::{durable_app, insist, register_script, register_with_settings, simulate, tokens},
    *,
};

/// Counts the lines about firings.
struct Lines(Arc<AtomicU32>);

impl Subscriber for Lines {
    fn enabled(&self, metadata: &Metadata<'_>) -> bool {
        metadata.target() == "pnt::firing"
    }

    fn new_span(&self, _: &span::Attributes<'_>) -> span::Id {
        span::Id::from_u64(1)
    }

    fn record(&self, _: &span::Id, _: &span::Record<'_>) {}

    fn record_follows_from(&self, _: &span::Id, _: &span::Id) {}

    fn event(&self, event: &Event<'_>) {
        assert_eq!(event.metadata().target(), "pnt::firing");
        self.0.fetch_add(1, Ordering::Relaxed);
    }

    fn enter(&self, _: &span::Id) {}

    fn exit(&self, _: &span::Id) {}
}

/// Its tally only ever grows.
const COUNTER: &str = "net n
place src = 200, tally
transition count
  in src
  out tally
  time 7 ms
transition never
  in tally*1000
  out tally*1000
";

async fn wait(cx: Context) -> Result<String, HandlerError> {
    loop {
        let tally = tokens(&insist(&cx, "n", Marking {}).await?, "tally");
        if tally == 200 {
            return Ok(tally.to_string());
        }
        cx.sleep(Duration::from_millis(100)).await;
    }
}

fn run_counted(more: &str, faults: Faults) -> (Result<String, String>, u32) {
    let app = durable_app(&[("n", more)], 1);
    let mut registry = Registry::new();
    register_with_settings(&mut registry, COUNTER, || Library::new(()));
    register_script(&mut registry, wait);
    // Where there is one listener alone, a callsite asks the listener of the thread that comes there first: none, if
    // another test comes first. Where there are two, all are asked.
    let _other = tracing::Dispatch::new(Lines(Arc::default()));
    let lines = Arc::new(AtomicU32::new(0));
    let counting = Lines(Arc::clone(&lines));
    let (found, _) =
        tracing::subscriber::with_default(counting, || simulate(app, registry, faults));
    (found, lines.load(Ordering::Relaxed))
}

#[test]
fn every_firing_has_its_line() {
    for more in ["durable = true", "durable = false"] {
        let (found, lines) = run_counted(more, Faults::none());
        assert_eq!((found.as_deref(), lines), (Ok("200"), 200), "{more}");
    }
}

#[test]
fn no_line_tells_of_a_firing_that_was_not_stored_whenever_the_net_dies() {
    for step in 0..20_u64 {
        let kills = (1..12_u64).map(|number| {
            Fault::on(
                "on_n",
                FaultKind::Kill,
                Instant::from_nanos(number * 150_000_000 + step * 370_000),
            )
        });
        let script = Faults::of_script("deaths", kills.collect());
        let (found, lines) = run_counted("durable = true", script);
        assert_eq!(found.as_deref(), Ok("200"), "step {step}");
        // A line may be lost with the process that was to write it. None is about a firing that never was.
        assert!((150..=200).contains(&lines), "step {step}: {lines} lines");
    }
}

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use crate::watch::LintCode;
use ctos_config::load_texts;
use ctos_core::{
    chassis::Chassis,
    context::Context,
    envelope::Message,
    handled::Handled,
    handler::EventHandler,
    registry::Registry,
    runner::{TaskSpec, start_task},
};
use ctos_message::{Command, Tid};
use ctos_time::Clock;

ctos_message::command! {
    /// Keeps its processor until it is released.
    struct Block => (), 1, "block"
}

struct Stuck(Arc<AtomicBool>);

impl EventHandler for Stuck {
    async fn handle(&mut self, _: &Context, message: Message) -> Handled {
        let (Block {}, reply) = message.open::<Block>()?;
        while !self.0.load(Ordering::Acquire) {
            std::thread::yield_now();
        }
        reply.ok(())
    }
}

#[test]
fn a_handler_that_never_returns_is_named_with_the_processor_that_it_keeps() {
    let text = "[chassis.cell]\n[task.arm]\nhandler = \"stuck\"\non = \"cell\"\n";
    let app = load_texts(&[("app.toml", text)], &[], &[]).unwrap();
    let config = app.tasks[0].clone();
    let released = Arc::new(AtomicBool::new(false));
    let mut registry = Registry::new();
    let release = released.clone();
    registry.handler("stuck", &[Block::INFO], move |_| Ok(Stuck(release.clone())));
    let recipe = registry.kind("stuck").unwrap().recipe();
    let chassis = Chassis::new(1, Arc::new(app), Arc::new(registry), Clock::real());
    let _threads = ctos_core::threads::start_processors(&chassis).unwrap();
    let tid = Tid::new(1, 1, 0);
    let spec = TaskSpec::new("arm", tid, Some(config), recipe, &chassis.processors[1].1);
    let task = spec.record.clone();
    let home = chassis.clone();
    chassis.processors[1].1.inject(move |processor| {
        start_task(&home, processor, spec).unwrap();
    });
    let block = Message::request(task.tid, Tid::default(), Block::CODE, Block {});
    task.mailbox.put(block);
    while task.statistics.poll().is_none() {
        std::thread::yield_now();
    }
    let seen = chassis.clock.now();
    let look = |later_ms| {
        crate::watch::Watch::of(&chassis).look(&chassis, seen + Duration::from_millis(later_ms));
        crate::watch::lints(&chassis)
    };
    assert_eq!(look(0), []);
    assert_eq!(look(999), [], "not yet over its time-out");
    let lints = look(1000);
    assert_eq!(lints.len(), 1, "{lints:?}");
    assert_eq!(lints[0].code, LintCode::HandlerBlocks);
    let text = &lints[0].text;
    assert!(text.contains("`arm` has been at `block`"), "{text}");
    assert!(text.contains("processor `cell/main`"), "{text}");
    let counted = crate::watch::gather_here(&chassis);
    let page = crate::watch::page(0.0, &[("cell".to_owned(), Some(counted))]);
    for line in [
        "ctos_lint{code=\"handler-blocks\",task=\"arm\"} 1",
        "ctos_queue_length{task=\"arm\"} 0",
        "ctos_restarts_total{task=\"arm\"} 0",
    ] {
        assert!(page.contains(line), "{line:?} is not in\n{page}");
    }
    released.store(true, Ordering::Release);
    while task.statistics.read().began.is_some() {
        std::thread::yield_now();
    }
    assert_eq!(look(2000), [], "it is over");
    chassis.stop_processors();
}

use super::{
    lint::{Lint, LintCode},
    metrics::{ChassisMetrics, CyclicMetrics, LinkMetrics, Quantiles, TaskMetrics},
    text::page,
};
use ctos_core::meter::CommandCount;
use ctos_time::Instant;

fn metrics() -> ChassisMetrics {
    ChassisMetrics {
        chassis: "cell".to_owned(),
        tasks: vec![TaskMetrics {
            task: "a\"rm".to_owned(),
            commands: vec![CommandCount {
                command: "go".to_owned(),
                ok: 3,
                failed: 1,
            }],
            durations: vec![1, 2, 0, 1],
            busy_s: 0.25,
            queue: 4,
            capacity: 64,
            restarts: 2,
        }],
        cyclics: vec![CyclicMetrics {
            function: "servo.cyclic".to_owned(),
            lateness: Quantiles {
                p50_s: 0.125,
                p99_s: 0.25,
                max_s: 0.5,
                sum_s: 3.0,
                count: 9,
            },
            duration: Quantiles {
                p50_s: 0.5,
                p99_s: 0.5,
                max_s: 0.5,
                sum_s: 4.5,
                count: 9,
            },
            missed: 6,
            overruns: 7,
        }],
        links: vec![LinkMetrics {
            peer: "boot".to_owned(),
            bytes_out: 10,
            bytes_in: 20,
        }],
        lints: vec![Lint {
            code: LintCode::QueueGrows,
            task: "arm".to_owned(),
            chassis: "cell".to_owned(),
            since: Instant::START,
            text: "words".to_owned(),
        }],
        unrecorded: Some(5),
        refused: 11,
    }
}

#[test]
fn the_page_has_what_prometheus_reads() {
    let answers = vec![
        ("cell".to_owned(), Some(metrics())),
        ("gone".to_owned(), None),
    ];
    let page = page(1.5, &answers);
    for line in [
        "ctos_up{chassis=\"cell\"} 1",
        "ctos_up{chassis=\"gone\"} 0",
        "ctos_messages_total{task=\"a\\\"rm\",command=\"go\",result=\"failed\"} 1",
        "ctos_handler_duration_seconds_bucket{task=\"a\\\"rm\",le=\"0.000001\"} 1",
        "ctos_handler_duration_seconds_bucket{task=\"a\\\"rm\",le=\"+Inf\"} 4",
        "ctos_handler_duration_seconds_sum{task=\"a\\\"rm\"} 0.25",
        "ctos_handler_duration_seconds_count{task=\"a\\\"rm\"} 4",
        "ctos_queue_length{task=\"a\\\"rm\"} 4",
        "ctos_restarts_total{task=\"a\\\"rm\"} 2",
        "ctos_lint{code=\"queue-grows\",task=\"arm\"} 1",
        "ctos_record_dropped_total{chassis=\"cell\"} 5",
        "ctos_uptime_seconds 1.5",
        "ctos_cyclic_lateness_seconds{function=\"servo.cyclic\",quantile=\"0.99\"} 0.25",
        "ctos_cyclic_duration_seconds_count{function=\"servo.cyclic\"} 9",
        "ctos_cyclic_missed_total{function=\"servo.cyclic\"} 6",
        "ctos_link_bytes_total{chassis=\"cell\",peer=\"boot\",direction=\"in\"} 20",
    ] {
        assert!(
            page.lines().any(|there| there == line),
            "{line:?} is not in\n{page}"
        );
    }
    // Every sample belongs to a metric that was announced.
    for line in page.lines().filter(|line| !line.starts_with('#')) {
        let name = line.split(['{', ' ']).next().unwrap();
        let base = ["_bucket", "_sum", "_count"]
            .iter()
            .find_map(|suffix| name.strip_suffix(suffix))
            .unwrap_or(name);
        assert!(
            page.contains(&format!("# TYPE {base} ")),
            "{name} has no type"
        );
    }
}

mod real {
    use std::{
        sync::{
            Arc,
            atomic::{AtomicBool, Ordering},
        },
        time::Duration,
    };

    use crate::{boot, watch::LintCode};
    use ctos_config::load_texts;
    use ctos_core::{
        chassis::Chassis,
        context::Context,
        delivery::Acceptance,
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
        task.mailbox.put(
            Message::request(task.tid, Tid::default(), Block::CODE, Block {}),
            Acceptance::Silent,
        );
        while task.statistics.poll().is_none() {
            std::thread::yield_now();
        }
        let seen = chassis.clock.now();
        let look = |later_ms| {
            crate::watch::Watch::of(&chassis)
                .look(&chassis, seen + Duration::from_millis(later_ms));
            crate::watch::lints(&chassis)
        };
        assert_eq!(look(0), []);
        assert_eq!(look(999), [], "not yet over its limit");
        let lints = look(1000);
        assert_eq!(lints.len(), 1, "{lints:?}");
        assert_eq!(lints[0].code, LintCode::HandlerBlocks);
        let text = &lints[0].text;
        assert!(text.contains("`arm` has been at `block`"), "{text}");
        assert!(text.contains("processor `cell/main`"), "{text}");
        released.store(true, Ordering::Release);
        while task.statistics.read().began.is_some() {
            std::thread::yield_now();
        }
        assert_eq!(look(2000), [], "it is over");
        chassis.stop_processors();
    }
}

use std::{sync::Arc, time::Duration};

use super::*;
use ctos_config::load_texts;
use ctos_core::registry::Registry;
use ctos_time::Clock;

fn metrics() -> Metrics {
    let folder = tempfile::tempdir().unwrap();
    let text = format!(
        "[record]\nfile = {:?}\n[chassis.cell]\n[task.arm]\nhandler = \"none\"\non = \"cell\"\n",
        folder.path().join("app.mcap")
    );
    let app = load_texts(&[("app.toml", &text)], &[], &[]).unwrap();
    let registry = Arc::new(Registry::new());
    let chassis = Chassis::new(1, Arc::new(app), registry, Clock::virtual_clock());
    Refusals::of(&chassis).note(&chassis.clock, "somebody", "no key");
    let record =
        ctos_record::start(std::slice::from_ref(&chassis), crate::watch::COMMANDS).unwrap();
    let mut metrics = gather_here(&chassis);
    record.unwrap().finish();
    let counts = Counts {
        bytes_out: 10,
        bytes_in: 20,
        ..Counts::default()
    };
    metrics.link(&[("chassis", "cell"), ("peer", "boot")], counts);
    let count = CommandCount {
        command: "go".to_owned(),
        ok: 3,
        failed: 1,
    };
    metrics.commands("a\"rm", &[count]);
    metrics.durations("a\"rm", &[1, 2, 0, 1], 0.25);
    let counted = CyclicStatistics::default();
    for _ in 0..9 {
        counted.lateness.record(Duration::from_millis(250));
        counted.duration.record(Duration::from_millis(500));
    }
    metrics.cyclic("servo.cyclic", &counted);
    metrics
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
        "ctos_uptime_seconds 1.5",
        "ctos_refused_total{chassis=\"cell\"} 1",
        "ctos_cyclic_lateness_seconds{function=\"servo.cyclic\",quantile=\"0.99\"} 0.25",
        "ctos_cyclic_lateness_seconds_sum{function=\"servo.cyclic\"} 2.25",
        "ctos_cyclic_duration_seconds_count{function=\"servo.cyclic\"} 9",
        "ctos_link_bytes_total{chassis=\"cell\",peer=\"boot\",direction=\"in\"} 20",
        "ctos_record_dropped_total{chassis=\"cell\"} 0",
        "ctos_cyclic_missed_total{function=\"servo.cyclic\"} 0",
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
    // And none was lost because its metric is not on the page.
    let samples = answers.into_iter().filter_map(|(_, answer)| answer);
    for line in samples.flat_map(|one| one.0.into_values()) {
        assert!(page.contains(&line), "{line}");
    }
}

use super::text::page;
use ctos_bootstrap::watch::{
    Lint, LintCode,
    metrics::{ChassisMetrics, CyclicMetrics, LinkMetrics, Quantiles, TaskMetrics},
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

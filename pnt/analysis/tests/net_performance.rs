//! `docs/net-performance.md` as it stands: its net, and the figures that it prints.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test may end when its page is wrong"
)]

use std::{fs, path::Path, sync::Arc};

use ctos::diagnostic::Source;
use pnt_analysis::stochastic::{Options, Report, analyse};
use pnt_language::{compile, net::Net};

fn root() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."))
}

fn net(source: &Source) -> Arc<Net> {
    Arc::new(compile::net(source).unwrap_or_else(|findings| panic!("{findings}")))
}

fn report(net: Arc<Net>) -> Report {
    let options = Options {
        time_s: Some(100_000.0),
        ..Options::default()
    };
    analyse(&[net], &options).unwrap()
}

/// Whether `printed` is `value` to as many digits as it has.
fn is_printed(value: f64, printed: &str) -> bool {
    let decimals = printed.split_once('.').map_or(0, |(_, after)| after.len());
    format!("{value:.decimals$}") == printed
}

#[test]
fn the_page_prints_what_its_net_does() {
    let page = fs::read_to_string(root().join("docs/net-performance.md")).unwrap();
    let text = page
        .split_once("```net\n")
        .unwrap()
        .1
        .split_once("```")
        .unwrap()
        .0;
    let report = report(net(&Source::new("queue.net", text)));
    let row = |name: &str| -> Vec<&str> {
        let line = page
            .lines()
            .find(|line| line.starts_with(&format!("| {name} |")));
        line.expect(name).split('|').map(str::trim).collect()
    };
    for place in &report.places {
        let row = row(&place.place);
        assert!(is_printed(place.tokens.exact.unwrap(), row[2]), "{row:?}");
        assert!(is_printed(place.marked.exact.unwrap(), row[3]), "{row:?}");
    }
    for transition in &report.transitions {
        let row = row(&transition.transition);
        assert!(
            is_printed(transition.throughput_per_s.exact.unwrap(), row[2]),
            "{row:?}"
        );
        assert!(
            is_printed(transition.utilisation.unwrap().exact.unwrap(), row[3]),
            "{row:?}"
        );
    }
}

#[test]
fn the_work_cell_makes_as_many_good_parts_as_come_in() {
    let source = Source::read(&root().join("configs/nets/cell.net")).unwrap();
    let report = report(net(&source));
    let per_s = |name: &str| {
        let found = report.transitions.iter().find(|t| t.transition == name);
        found.unwrap().throughput_per_s.exact.unwrap()
    };
    assert!((per_s("good") - per_s("arrive")).abs() < 1e-12);
    assert!((per_s("bad") / per_s("look") - 0.05).abs() < 1e-12);
}

//! The tables `[record]` and `[metrics]`: what is written down of an app, and who may look.

use super::app::RecordConfig;
use super::check::defaults;
use super::node::Node;
use crate::diagnostic::{Finding, Findings};
use std::net::SocketAddr;
use std::path::PathBuf;

impl RecordConfig {
    /// What is recorded to `file` where the configuration says nothing of it.
    #[must_use]
    pub fn new(file: PathBuf) -> Self {
        Self::read(file, &defaults())
    }

    fn read(file: PathBuf, root: &Node) -> Self {
        let max_mb = root.read::<u64>("record.max_mb").unwrap_or_default();
        let buffer_mb = root.read::<usize>("record.buffer_mb").unwrap_or_default();
        Self {
            file,
            max_bytes: max_mb * 1_000_000,
            keep: root.read("record.keep").unwrap_or_default(),
            flush: root.seconds("record.flush_s").unwrap_or_default(),
            buffer_bytes: buffer_mb * 1_000_000,
            channels: root.read("record.channels").unwrap_or_default(),
        }
    }
}

/// `[record]`; `None` without a `file`.
pub(super) fn record(root: &Node, findings: &mut Findings) -> Option<RecordConfig> {
    let channels = root.get("record.channels");
    for channel in channels.map_or(&[][..], Node::elements) {
        // Only whether it is a text counts.
        let _ = findings.keep(channel.parse::<String>());
    }
    Some(RecordConfig::read(root.read("record.file")?, root))
}

/// `[metrics]`; `None` without `listen`.
pub(super) fn metrics(root: &Node, findings: &mut Findings) -> Option<SocketAddr> {
    let listen = root.read::<SocketAddr>("metrics.listen")?;
    if !listen.ip().is_loopback() {
        let text =
            format!("metrics are served to this host only, and {listen} is not on its loopback");
        let finding = Finding::error("ctos::config::not_loopback", text)
            .help("listen on 127.0.0.1 and let a proxy that knows its clients pass them on");
        findings.push(finding.at(root.place_of("metrics.listen")));
    }
    Some(listen)
}

#[cfg(test)]
mod tests {
    use crate::load_texts;

    const APP: &str = "[chassis.a]\n[task.t]\nhandler = \"h\"\non = \"a\"\n";

    fn load(more: &str) -> Result<crate::App, String> {
        let text = format!("{APP}{more}");
        load_texts(&[("app.toml", &text)], &[], &[]).map_err(|findings| {
            let findings = findings.into_sorted();
            findings
                .iter()
                .map(|finding| format!("{finding}\n"))
                .collect()
        })
    }

    #[test]
    fn nothing_is_recorded_or_served_unless_it_is_asked_for() {
        let app = load("[record]\nkeep = 2\n").unwrap();
        assert_eq!((app.record, app.metrics), (None, None));
    }

    #[test]
    fn what_is_left_out_of_record_has_the_documented_default() {
        let record = load("[record]\nfile = \"run.mcap\"\n")
            .unwrap()
            .record
            .unwrap();
        assert_eq!(record.max_bytes, 256_000_000);
        assert_eq!((record.keep, record.buffer_bytes), (8, 16_000_000));
        assert_eq!(record.flush, std::time::Duration::from_secs(1));
        assert_eq!(record.channels, Vec::<String>::new());
    }

    #[test]
    fn metrics_for_other_hosts_and_absurd_sizes_are_findings_with_places() {
        let said =
            load("[record]\nfile = \"r.mcap\"\nmax_mb = 0\n[metrics]\nlisten = \"0.0.0.0:9464\"\n");
        let said = said.unwrap_err();
        assert!(said.contains("app.toml:7"), "{said}");
        assert!(said.contains("app.toml:9"), "{said}");
        assert!(
            said.contains("`max_mb` must be a whole number from 1"),
            "{said}"
        );
    }
}

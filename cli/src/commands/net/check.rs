//! `ctos net check`.

use std::{path::PathBuf, sync::Arc};

use clap::Args;
use ctos::{diagnostic::Findings, registry::Registry};
use pnt::{check, format, net::Net, space::Limits};

use crate::{exit, show};

/// Prove nets sound, or show a firing sequence by which they are not
///
/// Nets that name each other are given together. The last line on standard output with `--json` is one object about
/// all of them.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  ctos net check configs/nets/hello.net
  ctos net check configs/nets/dispatcher.net configs/nets/motion.net configs/nets/vision.net --json")]
pub struct CheckArgs {
    /// The nets
    #[arg(value_name = "FILE", required = true)]
    pub files: Vec<PathBuf>,
    /// Print a JSON object
    #[arg(long)]
    pub json: bool,
}

/// Runs the command.
#[must_use]
pub fn run(args: &CheckArgs, _registry: &Registry) -> u8 {
    let mut findings = Findings::new();
    let mut nets: Vec<Arc<Net>> = Vec::new();
    for file in &args.files {
        match format::load(file) {
            Ok((net, warnings)) => {
                findings.extend(warnings);
                nets.push(Arc::new(net));
            }
            Err(found) => findings.extend(found),
        }
    }
    if findings.has_errors() {
        show::findings(findings);
        return exit::CONFIG;
    }
    let (report, found) = check::check(&nets, &Limits::default());
    findings.extend(found);
    let sound = report.proved && !findings.has_errors();
    show::findings(findings);
    if args.json {
        let object = serde_json::json!({
            "markings": report.markings,
            "edges": report.edges,
            "complete": report.proved,
        });
        // A reader that went away has what it wanted.
        let _ = show::data(&object.to_string());
    }
    if sound { exit::OK } else { exit::FAILED }
}

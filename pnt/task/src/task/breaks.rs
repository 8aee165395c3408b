//! Breakpoints that people set while a net runs: kept beside the net, in `NAME.breaks.toml`, and armed before
//! the first firing when it runs again. Those of the configuration are not in it: they are armed anyway.
//! In virtual time the file is one of the simulated host.

use std::{
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
};

use ctos::{
    config::Node,
    diagnostic::{Findings, Severity, Source},
    task::{Context, HandlerError},
};
use serde::Deserialize;

use super::{
    engine::Engine,
    manual::{check_breakpoint, name_of},
    settings::Settings,
};
use pnt_language::net::Net;

/// A file of the simulated host.
type Simulated = Mutex<Option<String>>;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    breakpoints: Vec<String>,
}

/// Where the breakpoints of a net are kept: `motion.net` has `motion.breaks.toml` beside it.
fn beside(net: &Path) -> PathBuf {
    net.with_extension("breaks.toml")
}

/// Reads what is kept; what is wrong in it is told and left out.
fn read(source: &Source, net: &Net, findings: &mut Findings) -> Vec<String> {
    let root = Node::from_toml(source, findings);
    let file = findings.keep(root.parse::<File>());
    let mut texts = file.map_or_else(Vec::new, |file| file.breakpoints);
    texts.retain(|text| match check_breakpoint(text, net) {
        Ok(()) => true,
        Err(finding) => {
            let place = root
                .get("breakpoints")
                .and_then(|node| node.place().cloned());
            let finding = finding
                .help("the net is another one now: take it out of the file, or remove the file");
            findings.push(finding.at(place.unwrap_or_else(|| source.at(0..0))));
            false
        }
    });
    texts
}

/// What is wrong with the breakpoints that are kept beside a net stops nothing.
pub(super) fn check(net: &Net, path: &Path, findings: &mut Findings) {
    let path = beside(path);
    if !path.is_file() {
        return;
    }
    let mut found = Findings::new();
    if let Some(source) = found.keep(Source::read(&path)) {
        read(&source, net, &mut found);
    }
    for mut finding in found.into_sorted() {
        finding.severity = Severity::Warning;
        findings.push(finding);
    }
}

/// The text of a file of breakpoints.
fn text(breakpoints: &[&str]) -> String {
    let list: Vec<String> = breakpoints.iter().map(|one| format!("{one:?}")).collect();
    format!(
        "# Set by hand while the net ran; armed before its first firing.\nbreakpoints = [{}]\n",
        list.join(", ")
    )
}

/// The file of a net's task: on disk, or of the simulated host.
struct Kept {
    path: PathBuf,
    simulated: Option<Arc<Simulated>>,
}

impl Kept {
    /// None for a net that is not from a file.
    fn of(cx: &Context, settings: &Settings) -> Option<Self> {
        if settings.net.is_empty() {
            return None;
        }
        let path = beside(&cx.app().file_at(&settings.net));
        let simulated = match cx.disk() {
            Some(disk) => Some(disk.open::<Simulated>(&path)?),
            None => None,
        };
        Some(Self { path, simulated })
    }

    fn source(&self, findings: &mut Findings) -> Option<Source> {
        match &self.simulated {
            Some(file) => {
                let text = file
                    .lock()
                    .unwrap_or_else(PoisonError::into_inner)
                    .clone()?;
                Some(Source::new(self.path.display().to_string(), text))
            }
            None if self.path.is_file() => findings.keep(Source::read(&self.path)),
            None => None,
        }
    }

    /// Replaces the file as a whole, or not at all; without breakpoints there is none.
    fn write(&self, breakpoints: &[&str]) -> std::io::Result<()> {
        let text = (!breakpoints.is_empty()).then(|| text(breakpoints));
        if let Some(file) = &self.simulated {
            *file.lock().unwrap_or_else(PoisonError::into_inner) = text;
            return Ok(());
        }
        match text {
            Some(text) => {
                let new = self.path.with_extension("toml.new");
                std::fs::write(&new, text)?;
                std::fs::rename(new, &self.path)
            }
            None if self.path.exists() => std::fs::remove_file(&self.path),
            None => Ok(()),
        }
    }
}

impl Engine {
    /// The breakpoints that were kept, where people may control the net: elsewhere nobody could release it.
    pub(super) fn kept_breakpoints(&self) -> Vec<String> {
        if !self.settings.allow_control {
            return Vec::new();
        }
        let Some(kept) = Kept::of(&self.cx, &self.settings) else {
            return Vec::new();
        };
        let mut findings = Findings::new();
        let kept_text = || {
            let source = kept.source(&mut findings);
            source.map(|source| source.text().to_owned())
        };
        let source = self.cx.outside("the breakpoints beside the net", kept_text);
        let source = source.map(|text| Source::new(kept.path.display().to_string(), text));
        let net = self.net();
        let texts = source.map_or_else(Vec::new, |source| read(&source, &net, &mut findings));
        for finding in findings.iter() {
            tracing::warn!(target: "pnt::net", net = net.name(), finding = %finding.message, "a breakpoint is not armed");
        }
        texts
    }

    /// Keeps the breakpoints as they are now.
    ///
    /// # Errors
    /// The file cannot be written; the breakpoints are set all the same.
    pub(super) fn keep_breakpoints(&self) -> Result<(), HandlerError> {
        let Some(kept) = Kept::of(&self.cx, &self.settings) else {
            return Ok(());
        };
        let set = self.core.borrow().manual.breakpoints();
        let net = self.net();
        let given = self.settings.breakpoints.iter();
        let given: Vec<String> = given.map(|text| name_of(text, &net)).collect();
        let by_hand = set.iter().filter(|one| !given.contains(one));
        let by_hand: Vec<&str> = by_hand.map(String::as_str).collect();
        // A replay writes nothing.
        let written = self.cx.outside("that its breakpoints are kept", || {
            kept.write(&by_hand).map_err(|error| error.to_string())
        });
        written.map_err(|error| {
            let path = kept.path.display();
            HandlerError::new(format!("not kept for the next run: {path}: {error}"))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pnt_language::compile;

    #[test]
    fn a_breakpoint_at_a_question_to_a_coordinator_is_one_before_it_is_asked() {
        let text = "net n\nplace a = 1, b\ncoordinator m : go\ntransition move\n  in a\n  ask m go\n  out b\n";
        let net = compile::net(&Source::new("n.net", text)).unwrap();
        assert_eq!(name_of("move", &net), "move");
        assert_eq!(name_of("start_move", &net), "move");
        assert_eq!(name_of("end_move", &net), "end_move");
        assert_eq!(name_of("a>=1", &net), "a>=1");
        assert!(check_breakpoint("move", &net).is_ok());
        assert!(check_breakpoint("mov", &net).is_err());
    }

    #[test]
    fn what_is_kept_is_read_again_and_what_the_net_has_no_more_is_told() {
        let text_of_net = "net n\nplace a = 1\ntransition t\n  in a\n  out a\n";
        let net = compile::net(&Source::new("n.net", text_of_net)).unwrap();
        let read_from = |text: &str| {
            let mut findings = Findings::new();
            let source = Source::new("n.breaks.toml", text);
            (read(&source, &net, &mut findings), findings.to_string())
        };
        let kept = ["t", "a>=1"];
        let (texts, told) = read_from(&text(&kept));
        assert_eq!(
            (texts, told.as_str()),
            (kept.map(str::to_owned).to_vec(), "")
        );
        let (texts, told) = read_from(&text(&["u", "t", "b<=2"]));
        assert_eq!(texts, ["t"]);
        assert!(told.contains("n.breaks.toml:2:"), "{told}");
        assert!(
            told.contains("no transition `u`") && told.contains("no place `b`"),
            "{told}"
        );
        let (texts, told) = read_from("breakpoints = 3\n");
        assert!(
            texts.is_empty() && told.contains("n.breaks.toml:1:"),
            "{told}"
        );
    }
}

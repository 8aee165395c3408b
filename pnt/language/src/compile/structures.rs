//! Coordination structures (architecture report, section 7 and figure 11). `coordinator`, `ask` and
//! `serves` lines become the places SI, I, O, SO and the transitions around them.
//!
//! A request takes the token of the input semaphore SI and marks the coordinator's input place I.
//! When the coordinator has finished, its transition `tf` (or `tf_failed`) takes the output semaphore
//! SO. It marks the requester's output place O (or OF) and restores SI. The requester takes O and
//! gives SO back. The report's figure lets a second request start as soon as SI is back, while O
//! still holds the answer to the first. The second could then take that answer. So a start also waits
//! until O and OF are empty.

use std::mem;

use ctos::diagnostic::{Finding, Findings};

use super::coordinator;
use crate::{
    draft::{Draft, DraftAction, DraftArc, DraftPlace, DraftServes, DraftTransition, Word},
    net::{Part, Role},
};

/// A transition after expansion.
pub(super) struct PartOf {
    pub(super) draft: DraftTransition,
    pub(super) part: Part,
    /// Remote outputs that belong to the coordination structure.
    pub(super) handshake: Vec<DraftArc>,
}

/// A draft whose coordination structures have become places and transitions.
pub(super) struct Expanded {
    pub(super) places: Vec<(DraftPlace, Role)>,
    pub(super) transitions: Vec<PartOf>,
}

/// Expands all coordination structures of a net.
pub(super) fn expand(draft: &Draft, findings: &mut Findings) -> Expanded {
    let mut expanded = Expanded {
        places: draft
            .places
            .iter()
            .map(|place| (place.clone(), Role::Declared))
            .collect(),
        transitions: Vec::new(),
    };
    for side in &draft.coordinators {
        expanded.place(side.net.derived(format!("SI_{}", side.net)), 1);
        expanded.place(side.net.derived(format!("O_{}", side.net)), 0);
        expanded.place(side.net.derived(format!("OF_{}", side.net)), 0);
    }
    for transition in &draft.transitions {
        match &transition.action {
            Some(DraftAction::Ask {
                coordinator,
                request,
            }) => expanded.ask(draft, transition, coordinator, request, findings),
            _ => expanded.transitions.push(PartOf {
                draft: transition.clone(),
                part: Part::Whole,
                handshake: Vec::new(),
            }),
        }
    }
    for side in &draft.serves {
        expanded.serve(draft, side);
    }
    expanded
}

impl Expanded {
    fn place(&mut self, name: Word, tokens: u32) {
        let mut place = DraftPlace::new(name);
        place.tokens = tokens;
        self.places.push((place, Role::Coordination));
    }

    /// `move_robot` becomes `start_move_robot`, `move_robot_active`, `end_move_robot` and
    /// `fail_move_robot`.
    fn ask(
        &mut self,
        draft: &Draft,
        transition: &DraftTransition,
        net: &Word,
        request: &Word,
        findings: &mut Findings,
    ) {
        check_ask(draft, transition, net, request, findings);
        let name = |part: Part| {
            let prefix = part.prefix();
            transition
                .name
                .derived(format!("{prefix}{}", transition.name))
        };
        let here = |prefix: &str| DraftArc::local(net.derived(format!("{prefix}_{net}")));
        let there = |place: String| DraftArc::remote(request.derived(place), net.clone());
        let active = transition
            .name
            .derived(format!("{}_active", transition.name));
        self.place(active.clone(), 0);
        let active = DraftArc::local(active);

        let mut start = transition.clone();
        start.name = name(Part::Start);
        start.action = None;
        start.within = None;
        start.idempotent = false;
        start.sets.clear();
        start.inputs.push(here("SI"));
        start.inhibitors.extend([here("O"), here("OF")]);
        let outputs = mem::replace(&mut start.outputs, vec![active.clone()]);
        let branch = mem::take(&mut start.fail);
        let write = start.write.take();

        let mut end = DraftTransition::new(name(Part::End));
        end.inputs = vec![here("O"), active.clone()];
        end.outputs = outputs;
        end.write = write;

        let written = !branch.is_empty();
        let failed = Part::Fail { branch: written };
        let mut fail = DraftTransition::new(name(failed));
        fail.inputs = vec![here("OF"), active];
        fail.outputs = if written {
            branch
        } else {
            transition.inputs.clone()
        };

        let give_back = there(format!("SO_{}", draft.name));
        let parts = [
            (start, Part::Start, there(format!("I_{request}"))),
            (end, Part::End, give_back.clone()),
            (fail, failed, give_back),
        ];
        for (draft, part, arc) in parts {
            self.transitions.push(PartOf {
                draft,
                part,
                handshake: vec![arc],
            });
        }
    }

    /// The input places, the output semaphore and the returning transitions of a coordinator.
    fn serve(&mut self, draft: &Draft, side: &DraftServes) {
        for request in &side.requests {
            self.place(request.derived(format!("I_{request}")), 0);
        }
        let semaphore = side.net.derived(format!("SO_{}", side.net));
        self.place(semaphore.clone(), 1);
        let there = |prefix: &str| {
            DraftArc::remote(
                side.net.derived(format!("{prefix}_{}", draft.name)),
                side.net.clone(),
            )
        };
        let returns = [
            ("tf", Some(&side.done), "O"),
            ("tf_failed", side.failed.as_ref(), "OF"),
        ];
        for (name, finished, output) in returns {
            let Some(finished) = finished else { continue };
            let mut give = DraftTransition::new(finished.derived(name));
            give.inputs = vec![
                DraftArc::local(finished.clone()),
                DraftArc::local(semaphore.clone()),
            ];
            self.transitions.push(PartOf {
                draft: give,
                part: Part::Return,
                handshake: vec![there(output), there("SI")],
            });
        }
    }
}

fn check_ask(
    draft: &Draft,
    transition: &DraftTransition,
    net: &Word,
    request: &Word,
    findings: &mut Findings,
) {
    match coordinator(draft, net) {
        None => findings.push(
            Finding::error(
                "pnt::net::unknown_coordinator",
                format!(
                    "no `coordinator` line of net `{}` names `{net}`",
                    draft.name
                ),
            )
            .at(net.at.clone())
            .help("declare it: `coordinator NET : REQUEST, ...`")
            .suggest(
                &net.text,
                draft.coordinators.iter().map(|c| c.net.text.as_str()),
            ),
        ),
        Some(side) if !side.requests.contains(request) => findings.push(
            Finding::error(
                "pnt::net::unknown_request",
                format!("`{request}` is not among the requests to coordinator `{net}`"),
            )
            .at(request.at.clone())
            .suggest(&request.text, side.requests.iter().map(|r| r.text.as_str())),
        ),
        Some(_) => {}
    }
    if transition.idempotent {
        findings.push(
            Finding::error(
                "pnt::net::cannot_fail",
                format!(
                    "transition `{}` has an `idempotent` line and only asks a coordinator",
                    transition.name
                ),
            )
            .at(transition.name.at.clone())
            .help("put the `idempotent` line on the action in the coordinator's net"),
        );
    }
    if let Some(set) = transition.sets.first() {
        let text = format!(
            "transition `{}` sets data and asks a coordinator",
            transition.name
        );
        findings.push(
            Finding::error("pnt::net::data", text)
                .at(set.target.at.clone())
                .help("put the `set` line into a transition of its own"),
        );
    }
    if transition.within.is_some() {
        findings.push(
            Finding::error(
                "pnt::net::limit_of_request",
                format!(
                    "transition `{}` cannot limit what a coordinator does",
                    transition.name
                ),
            )
            .at(transition.name.at.clone())
            .help("put the `within` line on the action in the coordinator's net"),
        );
    }
    if transition.tape.is_some() && transition.fail.is_empty() {
        findings.push(
            Finding::error(
                "pnt::net::lost_command",
                format!(
                    "transition `{}` reads the tape and asks a coordinator: when that fails, the symbol cannot go back",
                    transition.name
                ),
            )
            .at(transition.name.at.clone())
            .help("add a `fail` line, or read the tape in a transition of its own"),
        );
    }
}

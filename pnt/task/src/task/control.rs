//! Interventions: firing by hand, putting and taking tokens, pausing, stepping, breakpoints, cancelling.
//! Each is authorised, checked, done, written into the journal and stored before it is answered.

use std::rc::Rc;

use ctos::{
    diagnostic::Finding,
    message::Replier,
    task::{Context, Handled, HandlerError},
};
use thiserror::Error;

use super::{
    action::Ended,
    engine::{Core, Engine},
    messages::{Control, Order},
};
use crate::stream::{EventPhase, Happened};
use pnt_language::{
    exec::Execution,
    net::{Net, PlaceId, TransitionId},
};

/// What a person has done to a net, and where it shall stop.
#[derive(Debug, Default)]
pub(super) struct Manual {
    /// Why nothing is fired.
    paused: Option<String>,
    /// Firings that may begin nevertheless.
    steps: u32,
    breakpoints: Vec<Breakpoint>,
    /// The transition at which it stands: it does not stop there again when it goes on.
    stands_at: Option<TransitionId>,
    /// A breakpoint that was met and not told yet.
    met: Option<String>,
}

#[derive(Debug, Clone)]
struct Breakpoint {
    /// As it was written.
    text: String,
    at: At,
    /// Whether the condition held when it was looked at last.
    held: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum At {
    Transition(TransitionId),
    Place(PlaceId, Comparison, u32),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Comparison {
    AtLeast,
    AtMost,
    Equal,
}

/// A breakpoint that cannot be.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub(super) enum BreakError {
    #[error(
        "`{0}` is no breakpoint: write the name of a transition, or PLACE>=N, PLACE<=N or PLACE=N"
    )]
    Form(String),
    #[error("net `{net}` has no {what} `{name}`; there are: {}", .known.join(", "))]
    Unknown {
        net: String,
        what: &'static str,
        name: String,
        known: Vec<String>,
    },
    #[error("there is no breakpoint `{0}`; there are: {1}")]
    NotSet(String, String),
}

impl Breakpoint {
    fn parse(text: &str, net: &Net) -> Result<Self, BreakError> {
        let comparisons = [
            (">=", Comparison::AtLeast),
            ("<=", Comparison::AtMost),
            ("==", Comparison::Equal),
            ("=", Comparison::Equal),
        ];
        let unknown = |what, name: &str, known: Vec<String>| BreakError::Unknown {
            net: net.name().to_owned(),
            what,
            name: name.to_owned(),
            known,
        };
        let split = comparisons.iter().find_map(|(sign, comparison)| {
            let (place, number) = text.split_once(sign)?;
            Some((place.trim(), *comparison, number.trim()))
        });
        let at = if let Some((name, comparison, number)) = split {
            let number = number
                .parse()
                .map_err(|_| BreakError::Form(text.to_owned()))?;
            let names = || net.places().iter().map(|place| place.name.clone());
            let place = net.place(name);
            let place = place.ok_or_else(|| unknown("place", name, names().collect()))?;
            At::Place(place, comparison, number)
        } else {
            let name = text.trim();
            let names = || net.transitions().iter().map(|t| t.name.clone());
            let transition = net.transition(name);
            let transition =
                transition.ok_or_else(|| unknown("transition", name, names().collect()))?;
            At::Transition(transition)
        };
        Ok(Self {
            text: text.to_owned(),
            at,
            held: false,
        })
    }

    fn holds(&self, execution: &Execution) -> bool {
        let At::Place(place, comparison, number) = self.at else {
            return false;
        };
        let held = execution.marking().get(place.index()).copied();
        let held = held.unwrap_or(0);
        match comparison {
            Comparison::AtLeast => held >= number,
            Comparison::AtMost => held <= number,
            Comparison::Equal => held == number,
        }
    }
}

/// Whether a net has what a breakpoint names: `TRANSITION`, `PLACE>=N`, `PLACE<=N` or `PLACE=N`.
///
/// # Errors
/// What is wrong with it, without a place.
pub fn check_breakpoint(text: &str, net: &Net) -> Result<(), Finding> {
    const CODE: &str = "pnt::task::breakpoint";
    match Breakpoint::parse(text, net) {
        Ok(_) => Ok(()),
        Err(BreakError::Unknown {
            net,
            what,
            name,
            known,
        }) => {
            let finding = Finding::error(CODE, format!("net `{net}` has no {what} `{name}`"));
            Err(finding.suggest(&name, known.iter().map(String::as_str)))
        }
        Err(error) => Err(Finding::error(CODE, error.to_string())),
    }
}

impl Manual {
    /// Why it is paused.
    pub(super) fn paused(&self) -> Option<&str> {
        self.paused.as_deref()
    }

    /// Whether no firing may begin.
    #[inline]
    pub(super) fn is_stopped(&self) -> bool {
        self.paused.is_some() && self.steps == 0
    }

    pub(super) fn pause(&mut self, why: String) {
        self.paused = Some(why);
        self.steps = 0;
    }

    /// The breakpoints as they were written.
    pub(super) fn breakpoints(&self) -> Vec<String> {
        self.breakpoints.iter().map(|b| b.text.clone()).collect()
    }

    pub(super) fn set(&mut self, text: &str, execution: &Execution) -> Result<(), BreakError> {
        let mut breakpoint = Breakpoint::parse(text, execution.net())?;
        // What holds already has not become true.
        breakpoint.held = breakpoint.holds(execution);
        self.breakpoints.retain(|other| other.text != text);
        self.breakpoints.push(breakpoint);
        Ok(())
    }

    fn clear(&mut self, at: Option<&str>) -> Result<(), BreakError> {
        let Some(at) = at else {
            self.breakpoints.clear();
            return Ok(());
        };
        let before = self.breakpoints.len();
        self.breakpoints.retain(|breakpoint| breakpoint.text != at);
        if self.breakpoints.len() == before {
            let there = self.breakpoints().join(", ");
            return Err(BreakError::NotSet(at.to_owned(), there));
        }
        Ok(())
    }

    #[inline]
    pub(super) fn has_breakpoints(&self) -> bool {
        !self.breakpoints.is_empty()
    }

    /// Holds the places against the breakpoints after a change.
    pub(super) fn watch_places(&mut self, execution: &Execution) {
        for breakpoint in &mut self.breakpoints {
            let holds = breakpoint.holds(execution);
            if holds && !breakpoint.held {
                let why = format!("breakpoint `{}`", breakpoint.text);
                self.paused = Some(why.clone());
                self.steps = 0;
                self.met = Some(why);
            }
            breakpoint.held = holds;
        }
    }

    /// Keeps the breakpoints that another net has too.
    pub(super) fn replaced(&mut self, execution: &Execution) {
        let texts = self.breakpoints();
        self.breakpoints.clear();
        self.stands_at = None;
        for text in texts {
            if self.set(&text, execution).is_err() {
                tracing::warn!(target: "pnt::net", breakpoint = %text, "the new net has no such place or transition");
            }
        }
    }

    /// Whether a transition that was chosen may fire now.
    #[inline]
    fn passes(&mut self, id: TransitionId) -> bool {
        let stood = self.stands_at.take() == Some(id);
        let mut breakpoints = self.breakpoints.iter();
        let breakpoint = breakpoints.find(|b| b.at == At::Transition(id));
        if let Some(breakpoint) = breakpoint
            && !stood
        {
            let why = format!("breakpoint `{}`", breakpoint.text);
            self.paused = Some(why.clone());
            self.steps = 0;
            self.stands_at = Some(id);
            self.met = Some(why);
            return false;
        }
        self.steps = self.steps.saturating_sub(1);
        true
    }
}

impl<S: 'static> Engine<S> {
    /// Sets the breakpoints of the configuration, and those that people left, before anything is fired.
    pub(super) fn arm(&self) -> Result<(), HandlerError> {
        let kept = self.kept_breakpoints();
        let mut core = self.core.borrow_mut();
        let Core {
            manual, execution, ..
        } = &mut *core;
        for text in self.settings.breakpoints.iter().chain(&kept) {
            manual.set(text, execution)?;
        }
        Ok(())
    }

    /// Whether the transition that was chosen may fire, or the net stands at a breakpoint.
    pub(super) fn passes(self: &Rc<Self>, core: &mut Core, id: TransitionId) -> bool {
        let passes = core.manual.passes(id);
        self.tell_met(core);
        passes
    }

    /// Tells of a breakpoint that was met, by a place with the last change or by what was chosen.
    #[inline]
    pub(super) fn tell_met(self: &Rc<Self>, core: &mut Core) {
        if core.manual.met.is_some() {
            self.tell_of_it(core);
        }
    }

    fn tell_of_it(self: &Rc<Self>, core: &mut Core) {
        if let Some(why) = core.manual.met.take() {
            let net = std::sync::Arc::clone(core.execution.net());
            let paused = Happened::Net(EventPhase::Paused, why.clone());
            self.note(core, &self.cx, paused);
            let (of, at) = (std::sync::Arc::clone(&net), why.clone());
            self.when_change_stored(core.changes, move |_| {
                tracing::warn!(target: "pnt::net", net = of.name(), why = at, "net paused");
            });
            if self.settings.break_ends {
                let reason = format!("net `{}` is at {why}", net.name());
                self.cx.end_at_breakpoint(&reason);
            }
        }
    }

    /// Carries an order out.
    pub(super) fn control(
        self: &Rc<Self>,
        cx: &Context,
        (order, by): (Order, String),
        reply: Replier<Control>,
    ) -> Handled {
        if !self.settings.allow_control {
            return reply.fail(format!(
                "net `{}` is not to be controlled by hand: its task says no `allow_control = true`",
                self.net().name()
            ));
        }
        if let Order::Replace {
            file,
            text,
            within_ms,
        } = order
        {
            return self.replace(cx, (file, text, by), within_ms, reply);
        }
        let sets = matches!(order, Order::Break { .. } | Order::Clear { .. });
        let (mut said, happened) = self.carry_out_order(cx, order, &by)?;
        if sets && let Err(error) = self.keep_breakpoints() {
            said = format!("{said}, {error}");
        }
        let net = self.net();
        {
            let mut core = self.core.borrow_mut();
            core.changed();
            self.note(&mut core, cx, happened);
        }
        self.when_stored(move |_| {
            tracing::warn!(target: "pnt::net", net = net.name(), order = %said, by = %by, "by hand");
            // Answering never fails; a caller that is gone needs no answer.
            let _ = reply.ok(said);
        });
        self.advance(cx);
        Ok(())
    }

    /// Does what is ordered; what was done, in words and for displays.
    fn carry_out_order(
        self: &Rc<Self>,
        cx: &Context,
        order: Order,
        by: &str,
    ) -> Result<(String, Happened), HandlerError> {
        let mut core = self.core.borrow_mut();
        let ordered = |said: String| {
            let what = Happened::Net(EventPhase::Ordered, with_name(&said, by));
            Ok((said, what))
        };
        let by_hand = || with_name(BY_HAND, by);
        match order {
            Order::Fire { transition } => {
                drop(core);
                self.fire_by_hand(cx, &transition)?;
                ordered(format!("fire {transition}"))
            }
            Order::Put { place, tokens } => {
                core.execution.put_tokens(&place, tokens)?;
                let of = core.execution.net().place(&place);
                let put = of.into_iter().map(|place| (place, tokens)).collect();
                let what = Happened::Tokens(EventPhase::Put, put, by_hand().into());
                Ok((format!("put {tokens} into {place}"), what))
            }
            Order::Take { place, tokens } => {
                core.execution.take_tokens(&place, tokens)?;
                let of = core.execution.net().place(&place);
                let taken = of.into_iter().map(|place| (place, tokens)).collect();
                let what = Happened::Tokens(EventPhase::Taken, taken, by_hand().into());
                Ok((format!("take {tokens} out of {place}"), what))
            }
            Order::Pause => {
                core.manual.pause(BY_HAND.to_owned());
                let what = Happened::Net(EventPhase::Paused, by_hand());
                Ok(("pause".to_owned(), what))
            }
            Order::Resume => {
                core.manual.paused = None;
                core.manual.steps = 0;
                let what = Happened::Net(EventPhase::Resumed, by_hand());
                Ok(("resume".to_owned(), what))
            }
            Order::Step { firings } => {
                if core.manual.paused.is_none() {
                    core.manual.pause(BY_HAND.to_owned());
                }
                core.manual.steps = firings;
                ordered(format!("step {firings}"))
            }
            Order::Break { at } => {
                let Core {
                    manual, execution, ..
                } = &mut *core;
                manual.set(&at, execution)?;
                ordered(format!("break at {at}"))
            }
            Order::Clear { at } => {
                core.manual.clear(at.as_deref())?;
                ordered(match at {
                    Some(at) => format!("no break at {at}"),
                    None => "no breakpoints".to_owned(),
                })
            }
            Order::Cancel { transition } => {
                core.end_action(&transition, false)?;
                ordered(format!("cancel {transition}"))
            }
            Order::Complete { transition } => {
                core.end_action(&transition, true)?;
                ordered(format!("complete {transition}"))
            }
            // It waits, and was taken out before.
            Order::Replace { file, .. } => ordered(format!("replace by {file}")),
        }
    }

    fn fire_by_hand(self: &Rc<Self>, cx: &Context, name: &str) -> Handled {
        let id = {
            let core = self.core.borrow();
            if let Some(why) = &core.halted {
                return Err(HandlerError::new(format!("it has stopped: {why}")));
            }
            let net = core.execution.net();
            let Some(id) = net.transition(name) else {
                let known = net.transitions().iter().map(|t| t.name.clone());
                let unknown = BreakError::Unknown {
                    net: net.name().to_owned(),
                    what: "transition",
                    name: name.to_owned(),
                    known: known.collect(),
                };
                return Err(unknown.into());
            };
            if let Some(when) = &net[id].when {
                let said = self.library.ask(&when.function).unwrap_or(false);
                if said == when.negated {
                    let function = &when.function;
                    return Err(HandlerError::new(format!(
                        "transition `{name}` is not enabled: its enabling function `{function}` says {}",
                        if said { "yes, and is negated" } else { "no" }
                    )));
                }
            }
            id
        };
        self.begin_firing(id, &mut cx.clone())?;
        Ok(())
    }
}

/// Why a net is paused that somebody has paused.
const BY_HAND: &str = "by hand";

/// What was done, with who did it, if that was said.
pub(super) fn with_name(what: &str, by: &str) -> String {
    match by {
        "" => what.to_owned(),
        by => format!("{what} ({by})"),
    }
}

impl Core {
    /// Ends the action of a transition, as completed or as failed.
    fn end_action(&mut self, name: &str, completed: bool) -> Handled {
        let net = std::sync::Arc::clone(self.execution.net());
        let found = self
            .execution
            .running()
            .find(|(_, id)| net[*id].name == name);
        let Some((firing, id)) = found else {
            let text = format!("transition `{name}` is not in action");
            return Err(HandlerError::new(text));
        };
        if !completed && net[id].fail.is_none() {
            // Or it would begin again at once.
            self.manual.pause(format!("`{name}` was cancelled by hand"));
        }
        if let Some(acting) = self.acting.get_mut(&firing) {
            acting.end(if completed {
                Ended::Completed
            } else {
                Ended::Cancelled
            });
        }
        Ok(())
    }
}

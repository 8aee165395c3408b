//! Interventions: firing by hand, putting and taking tokens, pausing, stepping, breakpoints, cancelling.
//! Each is authorised, checked, done, written into the journal and stored before it is answered.

use std::rc::Rc;

use ctos::{
    message::Replier,
    task::{Context, Handled, HandlerError},
};

use super::{
    acting::Ended,
    engine::{Core, Engine},
    manual::BreakError,
    messages::{Control, Order},
};
use crate::stream::{EventPhase, Happened};
use pnt_language::net::TransitionId;

impl Engine {
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
                let name = of.name();
                tracing::warn!(
                    target: "pnt::net",
                    net = name,
                    why = at,
                    "net paused: `ctos net step {name}` and `ctos net resume {name}` go on"
                );
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
                let Core {
                    manual, execution, ..
                } = &mut *core;
                manual.clear(at.as_deref(), execution.net())?;
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
            let Some(id) = net.written(name) else {
                let known = net.transitions().iter().map(|t| t.called().to_owned());
                let unknown = BreakError::Unknown {
                    net: net.name().to_owned(),
                    what: "transition",
                    name: name.to_owned(),
                    known: known.collect(),
                };
                return Err(unknown.into());
            };
            if let Some(when) = &net[id].when {
                let said = self.says(when, &core.declared, core.journal.ended());
                let said = said.map_err(HandlerError::new)?;
                if said == when.negated {
                    let function = &when.function;
                    return Err(HandlerError::new(format!(
                        "transition `{name}` is not enabled: its condition `{function}` says {}",
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

/// What was done, with who did it, if the order names somebody.
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

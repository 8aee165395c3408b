//! Putting another net in the place of a running one. It is checked with all other nets of the app
//! first. Then it takes over at a marking at which nothing is under way, without losing a token or a
//! command.

use std::{rc::Rc, sync::Arc, time::Duration};

use ctos::{
    diagnostic::{Findings, Source},
    message::Replier,
    task::{Context, Handled},
};

use super::{
    control::with_name,
    engine::{Core, Engine, objects_of},
    load,
    messages::Control,
    replacing::Replacing,
    routes::Routes,
};
use crate::stream::{EventPhase, Happened, NetView};
use pnt_analysis::check::{self, Limits};
use pnt_language::{
    compile,
    exec::{Execution, State},
    net::{CommandId, Net},
};

impl Engine {
    /// Checks a net, and puts it in place at the next safe marking.
    pub(super) fn replace(
        self: &Rc<Self>,
        cx: &Context,
        (file, text, by): (String, String, String),
        within_ms: u64,
        reply: Replier<Control>,
    ) -> Handled {
        let net = match self.checked(cx, &file, &text) {
            Ok(net) => net,
            Err(findings) => {
                return reply.fail(format!("the net is refused:\n{findings}"));
            }
        };
        let number = {
            let mut core = self.core.borrow_mut();
            if core.replacing.is_some() {
                return reply.fail("another net waits to be put in place already");
            }
            let number = core.changes;
            core.replacing = Some(Replacing {
                number,
                file,
                text,
                by,
                net,
                reply,
            });
            number
        };
        let (engine, limit) = (Rc::clone(self), Duration::from_millis(within_ms));
        self.cx.spawn(async move {
            engine.cx.sleep(limit).await;
            engine.give_up_replacing(number, limit);
        });
        self.advance(cx);
        Ok(())
    }

    /// Reads a net and checks it as the boot does: by itself, against the library, and together with the
    /// nets that the app runs now.
    fn checked(&self, cx: &Context, file: &str, text: &str) -> Result<Arc<Net>, Findings> {
        let net = Arc::new(compile::net(&Source::new(file, text))?);
        let net = load::of_copy(net, cx.name());
        let mut findings = Findings::new();
        check::functions(&net, &self.library.names(), &mut findings);
        if net.name() != cx.name() {
            findings.push(load::wrong_name(cx.name(), net.name()).at(net.at().clone()));
        }
        if !findings.has_errors() {
            load::check_app_with(
                cx.app(),
                &cx.registry(),
                &Limits::default(),
                Some(&net),
                &mut findings,
            );
        }
        if findings.has_errors() {
            return Err(findings);
        }
        Ok(net)
    }

    /// Puts the net that waits in place, if the marking is safe.
    pub(super) fn replace_if_safe(self: &Rc<Self>, cx: &Context) {
        let Some((said, replacing)) = self.replaced(cx) else {
            return;
        };
        self.when_stored(move |_| {
            // Answering never fails; a caller that is gone needs no answer.
            let _ = match said {
                Ok(said) => replacing.reply.ok(said),
                Err(why) => replacing.reply.fail(why),
            };
        });
    }

    fn replaced(self: &Rc<Self>, cx: &Context) -> Option<(Result<String, String>, Replacing)> {
        let mut core = self.core.borrow_mut();
        if core.replacing.is_none() || !core.keeps_from_replacing().is_empty() {
            return None;
        }
        let replacing = core.replacing.take()?;
        let put = core.put_in_place(&replacing.net);
        let put = put.and_then(|()| {
            let stored = self.store_net(&replacing.file, &replacing.text);
            stored.map_err(|error| error.to_string())
        });
        if let Err(why) = put {
            return Some((Err(why), replacing));
        }
        let said = format!("replaced by {}", replacing.file);
        let name = core.execution.net().name().to_owned();
        self.view.replace(NetView::new(core.execution.net()));
        {
            let Core {
                journal,
                execution,
                declared,
                ..
            } = &mut *core;
            let stream = &mut journal.stream;
            stream.begin_again(cx.now(), execution, declared.values());
        }
        let what = Happened::Net(EventPhase::Ordered, with_name(&said, &replacing.by));
        core.changed();
        self.note(&mut core, cx, what);
        let (file, by) = (replacing.file.clone(), replacing.by.clone());
        self.when_change_stored(core.changes, move |_| {
            tracing::warn!(target: "pnt::net", net = %name, file = %file, by = %by, "net replaced");
        });
        Some((Ok(said), replacing))
    }

    fn give_up_replacing(&self, number: u64, limit: Duration) {
        let mut core = self.core.borrow_mut();
        let Some(replacing) = core
            .replacing
            .take_if(|replacing| replacing.number == number)
        else {
            return;
        };
        let keeps = core.keeps_from_replacing().join("; ");
        drop(core);
        // Answering never fails.
        let _ = replacing.reply.fail(format!(
            "the net was not replaced: within {:.3} s there was no safe marking; at last it waited for: {keeps}",
            limit.as_secs_f64()
        ));
    }
}

impl Core {
    /// Why the net cannot be replaced now; nothing at a safe marking.
    fn keeps_from_replacing(&self) -> Vec<String> {
        let execution = &self.execution;
        let net = execution.net();
        let running = execution.running();
        let mut keeps: Vec<String> = running
            .map(|(_, id)| format!("the action of `{}`", net[id].name))
            .collect();
        if let Some(on_tape) = execution.tape().current() {
            let symbol = &net[on_tape.command].symbol;
            keeps.push(format!("the answer to `{symbol}`"));
        }
        if net.is_safe(execution.marking()) {
            return keeps;
        }
        if net.safe().is_empty() {
            for (place, held) in net.places().iter().zip(execution.marking()) {
                if *held != place.tokens {
                    let (name, rest) = (&place.name, place.tokens);
                    keeps.push(format!(
                        "place `{name}`, which holds {held} and at rest {rest}"
                    ));
                }
            }
            return keeps;
        }
        let safe = net.safe().iter().map(|arcs| {
            let arcs = arcs.iter().map(|arc| {
                let held = execution.marking().get(arc.place.index()).copied();
                let (name, held) = (&net[arc.place].name, held.unwrap_or(0));
                format!("{} in `{name}`, which holds {held}", arc.weight)
            });
            arcs.collect::<Vec<_>>().join(" and ")
        });
        keeps.push(format!(
            "a safe marking: {}",
            safe.collect::<Vec<_>>().join(", or ")
        ));
        keeps
    }

    fn put_in_place(&mut self, net: &Arc<Net>) -> Result<(), String> {
        let old = Arc::clone(self.execution.net());
        let state = carried(self.execution.state(), &old, net);
        let state = state.map_err(|why| format!("the net was not replaced: {why}"))?;
        self.declared = self.declared.carried(net);
        let execution = Execution::restore(Arc::clone(net), state);
        self.execution = execution.map_err(|error| error.to_string())?;
        self.race = self.race.begin_again(&self.execution);
        self.failures = vec![0; net.transitions().len()];
        self.routes = Routes::new(net);
        self.requests.replaced(net);
        self.objects = objects_of(net, None);
        self.manual.replaced(&self.execution);
        Ok(())
    }
}

/// A state carried over from one net to another: tokens by the names of places, commands by their symbols.
/// Places that are new begin as the new net says.
///
/// # Errors
/// What would be lost: tokens of a place, or a command on the tape, that the new net does not have.
fn carried(mut state: State, from: &Net, to: &Net) -> Result<State, String> {
    let mut marking: Vec<u32> = to.places().iter().map(|place| place.tokens).collect();
    for (place, tokens) in from.places().iter().zip(&state.marking) {
        let there = to.place(&place.name);
        match there.and_then(|id| marking.get_mut(id.index())) {
            Some(there) => *there = *tokens,
            None if *tokens == 0 => {}
            None => {
                let name = &place.name;
                return Err(format!(
                    "the new one has no place `{name}`, which holds {tokens}"
                ));
            }
        }
    }
    state.marking = marking;
    let renumbered = |command: CommandId| {
        let symbol = &from[command].symbol;
        let lost = || format!("the new one takes no command `{symbol}`, which is on the tape");
        to.command(symbol).ok_or_else(lost)
    };
    state.tape.renumber(renumbered)?;
    Ok(state)
}

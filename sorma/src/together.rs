//! Locks and two-step commitment: an object is kept for one caller, and several objects do their jobs all, or
//! none of them does.

use crate::object::{Body, Context, Outcome, Slot};
use crate::raise;
use crate::report::{Report, code};
use crate::request::{Method, Reply, Request};
use crate::reserve::Reservation;
use crate::sorm::Sorm;
use crate::transport::Transport;
use std::sync::Arc;
use std::time::Duration;

/// What is prepared waits so long for its commitment unless somebody says otherwise.
pub const COMMIT_WITHIN: Duration = Duration::from_secs(30);

impl Sorm {
    /// Prepares an EXEC under the name `commitment`; until it is committed or aborted the object is
    /// locked for everybody. After `within` it is aborted by itself.
    ///
    /// # Errors
    /// The object has no two-step commitment, is locked or prepared, or cannot do the job.
    pub fn prepare(
        &self,
        commitment: &str,
        request: Request,
        within: Duration,
    ) -> Result<Reply, Report> {
        self.prepare_in(None, commitment, request, within)
    }

    pub(crate) fn prepare_in(
        &self,
        call: Option<&Context<'_>>,
        commitment: &str,
        request: Request,
        within: Duration,
    ) -> Result<Reply, Report> {
        if request.method != Method::Exec {
            return Err(raise!(
                code::UNSUPPORTED,
                "only EXEC is prepared; `{}` asks for {}",
                request.name,
                request.method
            ));
        }
        let handle = self.resolve(&request.name)?;
        let slot = &handle.slot;
        let mut io = request.body;
        let mut body = slot.lock(call)?;
        slot.with_reports(&mut body, self, call, &mut io, |body, cx, io| {
            slot.free_for(body, self, &io.from)?;
            let Some(steps) = body.object.two_step() else {
                let name = slot.name();
                return Err(raise!(
                    code::UNSUPPORTED,
                    "`{name}` has no two-step commitment; ask it with EXEC alone"
                ));
            };
            steps.prepare(cx, io)
        });
        if io.is_ok() {
            let until = self.now() + within;
            body.reserved = Some(Reservation::prepared(&io.from, until, commitment));
        }
        Ok(Reply {
            name: request.name,
            body: io,
        })
    }

    /// Commits what `from` prepared under that name, in all objects of this process.
    ///
    /// # Errors
    /// Nothing is prepared under it, or not any more.
    pub fn commit(&self, commitment: &str, from: &str) -> Result<Vec<(String, Transport)>, Report> {
        self.commit_in(None, commitment, from)
    }

    pub(crate) fn commit_in(
        &self,
        call: Option<&Context<'_>>,
        commitment: &str,
        from: &str,
    ) -> Result<Vec<(String, Transport)>, Report> {
        let prepared = self.prepared(call, commitment, from);
        if prepared.is_empty() {
            return Err(nothing(commitment));
        }
        let mut replies = Vec::new();
        for slot in prepared {
            let mut io = Transport::default().from(from);
            let mut body = slot.lock(call)?;
            slot.with_reports(&mut body, self, call, &mut io, |body, cx, io| {
                // Between the look and the lock it may have expired.
                if !holds(body, from, commitment) {
                    return Err(nothing(commitment));
                }
                let steps = body.object.two_step();
                steps.map_or(Ok(()), |steps| steps.commit(cx, io))
            });
            if holds(&body, from, commitment) {
                body.reserved = None;
            }
            slot.publish(self, &io);
            replies.push((slot.name().to_owned(), io));
        }
        Ok(replies)
    }

    /// Aborts what `from` prepared under that name.
    ///
    /// # Errors
    /// Nothing is prepared under it, or not any more.
    pub fn abort(&self, commitment: &str, from: &str) -> Outcome {
        self.abort_in(None, commitment, from)
    }

    pub(crate) fn abort_in(
        &self,
        call: Option<&Context<'_>>,
        commitment: &str,
        from: &str,
    ) -> Outcome {
        let prepared = self.prepared(call, commitment, from);
        if prepared.is_empty() {
            return Err(nothing(commitment));
        }
        for slot in prepared {
            let mut body = slot.lock(call)?;
            if holds(&body, from, commitment) {
                slot.let_go(&mut body, self);
            }
        }
        Ok(())
    }

    /// Has several objects of this process do their jobs all or not at all: prepares each in turn and
    /// commits when all have agreed. The replies stand in the order of the requests.
    ///
    /// # Errors
    /// The first refusal, with the object's reason; what was prepared before it is aborted.
    pub fn together(&self, commitment: &str, requests: Vec<Request>) -> Result<Vec<Reply>, Report> {
        let from = requests.first().map(|request| request.body.from.clone());
        let from = from.unwrap_or_default();
        let mut names = Vec::new();
        for mut request in requests {
            let name = request.name.clone();
            request.body.from.clone_from(&from);
            let refused = match self.prepare(commitment, request, COMMIT_WITHIN) {
                Ok(reply) if reply.body.is_ok() => {
                    names.push(name);
                    continue;
                }
                Ok(reply) => refusal(&reply),
                Err(report) => report,
            };
            if !names.is_empty() {
                self.abort(commitment, &from)?;
            }
            return Err(refused);
        }
        let mut done = self.commit(commitment, &from)?;
        let replies = names.into_iter().map(|name| {
            let local = name.local();
            let at = done.iter().position(|(object, _)| *object == local);
            let body = at.map(|at| done.swap_remove(at).1).unwrap_or_default();
            Reply { name, body }
        });
        Ok(replies.collect())
    }

    fn prepared(&self, call: Option<&Context<'_>>, commitment: &str, from: &str) -> Vec<Arc<Slot>> {
        let mut slots = self.slots();
        slots.retain(|slot| {
            let body = slot.lock(call);
            body.is_ok_and(|mut body| {
                let reserved = body.reserved.as_ref();
                if reserved.is_some_and(|reserved| reserved.is_over(self.now())) {
                    slot.let_go(&mut body, self);
                }
                holds(&body, from, commitment)
            })
        });
        slots
    }

    /// Locks an object for a caller.
    ///
    /// # Errors
    /// There is no such object, or it is locked for somebody else.
    pub fn lock(&self, name: &str, from: &str, time: Duration) -> Outcome {
        self.lock_in(None, name, from, time)
    }

    pub(crate) fn lock_in(
        &self,
        call: Option<&Context<'_>>,
        name: &str,
        from: &str,
        time: Duration,
    ) -> Outcome {
        let handle = self.get(name)?;
        let mut body = handle.slot.lock(call)?;
        handle.slot.free_for(&mut body, self, from)?;
        body.reserved = Some(Reservation::lock(from, self.now() + time));
        Ok(())
    }

    /// Ends a caller's lock. Says whether there was one.
    ///
    /// # Errors
    /// The object is in a call that does not end.
    pub fn unlock(&self, name: &str, from: &str) -> Result<bool, Report> {
        self.unlock_in(None, name, from)
    }

    pub(crate) fn unlock_in(
        &self,
        call: Option<&Context<'_>>,
        name: &str,
        from: &str,
    ) -> Result<bool, Report> {
        let Some(slot) = self.find(name) else {
            return Ok(false);
        };
        let mut body = slot.lock(call)?;
        let reserved = body.reserved.as_ref();
        let own = reserved.is_some_and(|reserved| reserved.is_of(from));
        if own {
            slot.let_go(&mut body, self);
        }
        Ok(own)
    }

    /// Ends all locks of callers that are gone, aborts what is prepared for them, and has the objects give back
    /// what they keep for them. Answers whether that was all: an object that is in a call now is to be asked
    /// again.
    pub fn release(&self, gone: impl Fn(&str) -> bool) -> bool {
        let mut is_all = true;
        for slot in self.slots() {
            let Some(mut body) = slot.body.try_lock() else {
                is_all = false;
                continue;
            };
            let reserved = body.reserved.as_ref();
            if reserved.is_some_and(|reserved| gone(reserved.by())) {
                slot.let_go(&mut body, self);
            }
            if body.object.forget(&gone) {
                drop(body);
                self.remove(slot.name());
            }
        }
        is_all
    }
}

fn holds(body: &Body, from: &str, commitment: &str) -> bool {
    let reserved = body.reserved.as_ref();
    reserved.is_some_and(|reserved| reserved.is_commitment(from, commitment))
}

fn nothing(commitment: &str) -> Report {
    raise!(
        code::PREPARED,
        "nothing is prepared under `{commitment}`, or not any more"
    )
}

/// The error of a reply, as a report raised by the caller.
fn refusal(reply: &Reply) -> Report {
    raise!(
        reply.body.code,
        "`{}` refuses: {}",
        reply.name,
        reply.body.texts()
    )
}

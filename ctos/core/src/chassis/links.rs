//! What goes over the links of a chassis and comes from them: requests, answers, and that nobody waits for
//! one any more.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use super::{
    Chassis,
    delivery::Outcome,
    pending::{Inbound, Outbound, Pending},
};
use crate::{
    envelope::{Envelope, Message},
    reply::{Answer, Caller, ReplySlot},
    system,
    tap::{Asked, WaitFor},
};
use ctos_message::{
    ChassisNumber, Data, Flags, Header,
    blob::Body,
    fault::Fault,
    frame::{BODY_LIMIT, Counts, Frame, Full, Link, NO_DEADLINE},
};
use ctos_time::{Instant, lock::lock};

impl Caller for Inbound {
    fn answer(&self, answer: Answer) {
        self.chassis.post_reply(self, answer);
    }

    fn is_abandoned(&self) -> bool {
        self.abandoned.load(Ordering::Acquire)
    }
}

impl Chassis {
    /// The sender of a request waits no longer: the receiver need not begin, if it has not.
    pub(crate) fn abandon(&self, Outbound(call): Outbound) {
        let (pending, link) = {
            let mut links = lock(&self.links);
            let Some(pending) = links.pending.remove(&call) else {
                return;
            };
            let link = links.up.get(&pending.peer()).cloned();
            (pending, link)
        };
        if let Some(link) = link {
            // What is not a request is never refused.
            let _ = link.post(Frame {
                header: Header {
                    flags: Flags::ABANDONED,
                    size: 0,
                    ..pending.header
                },
                call,
                trace: pending.trace,
                left_ns: NO_DEADLINE,
                body: Body::default(),
            });
        }
    }

    /// Sends a message to another chassis; the reply slot that `slot` makes gets what `wait` names.
    pub(super) fn post(
        &self,
        message: Message,
        wait: WaitFor,
        slot: impl FnOnce() -> ReplySlot,
    ) -> Outcome {
        let Envelope {
            mut header,
            trace,
            deadline,
            data,
            ..
        } = *message.envelope;
        let peer = header.to.chassis();
        if wait == WaitFor::Nothing {
            let chassis = self.name_of(peer).to_owned();
            return Outcome::Failed(Fault::Elsewhere { chassis });
        }
        let body = match body_of(data) {
            Ok(body) => body,
            Err(fault) => return Outcome::Failed(fault),
        };
        header.flags |= wait.flags() | Flags::OWNED;
        header.size = u32::try_from(body.len()).unwrap_or(u32::MAX);
        let mut links = lock(&self.links);
        if !links.up.contains_key(&peer) {
            drop(links);
            self.reach(peer);
            links = lock(&self.links);
        }
        let Some(link) = links.up.get(&peer).cloned() else {
            drop(links);
            return Outcome::Failed(self.peer_down_fault(peer));
        };
        links.next_call += 1;
        let call = links.next_call;
        let pending = Pending {
            reply: slot(),
            header,
            trace,
        };
        links.pending.insert(call, pending);
        drop(links);
        let posted = link.post(Frame {
            header,
            call,
            trace,
            left_ns: self.left_ns(deadline),
            body,
        });
        if let Err(Full { bytes }) = posted {
            let pending = lock(&self.links).pending.remove(&call);
            let fault = Fault::LinkFull { bytes };
            if let Some(pending) = pending {
                pending.answer(Err(fault));
            }
            return Outcome::Waits(None);
        }
        Outcome::Waits(Some(Outbound(call)))
    }

    /// How long it is until `deadline`, for the wire.
    fn left_ns(&self, deadline: Option<Instant>) -> u64 {
        deadline.map_or(NO_DEADLINE, |deadline| {
            let left = deadline.since(self.clock.now()).as_nanos();
            u64::try_from(left).map_or(NO_DEADLINE - 1, |left| left.min(NO_DEADLINE - 1))
        })
    }

    /// Sends an answer back over the link that the request came by, if anybody waits for it.
    fn post_reply(&self, inbound: &Inbound, answer: Answer) {
        let Inbound {
            header: request,
            call,
            trace,
            ..
        } = inbound;
        let peer = request.from.chassis();
        let link = {
            let mut links = lock(&self.links);
            if !links.close_inbound(peer, inbound) {
                return;
            }
            links.up.get(&peer).cloned()
        };
        let Some(link) = link else {
            return;
        };
        if let Some(recorder) = self.tap.recorder() {
            let asked = Asked::by_header(request, *trace);
            recorder.replied(inbound.recorded, &asked, answer.as_ref());
        }
        let (flags, body) = match answer.and_then(body_of) {
            Ok(body) => (Flags::REPLY, body),
            Err(fault) => (
                Flags::REPLY | Flags::FAULT,
                // A fault is plain data; should it fail to encode, the empty body is read as one.
                postcard::to_stdvec(&fault).unwrap_or_default().into(),
            ),
        };
        // What is not a request is never refused.
        let _ = link.post(Frame {
            header: Header {
                to: request.from,
                from: request.to,
                command: request.command,
                flags,
                size: u32::try_from(body.len()).unwrap_or(u32::MAX),
            },
            call: *call,
            trace: *trace,
            left_ns: NO_DEADLINE,
            body,
        });
    }

    fn receive_reply(&self, peer: ChassisNumber, call: u64, flags: Flags, body: Body) {
        let pending = {
            let mut links = lock(&self.links);
            // A reply counts only when it comes from the chassis that was asked.
            match links.pending.get(&call) {
                Some(pending) if pending.peer() == peer => links.pending.remove(&call),
                _ => None,
            }
        };
        let Some(pending) = pending else {
            return;
        };
        pending.answer(if flags.contains(Flags::FAULT) {
            Err(postcard::from_bytes(&body.into_vec()).unwrap_or(Fault::NoReply))
        } else {
            Ok(Data::from(body))
        });
    }

    /// What went over its links so far, by the name of the chassis at the other end.
    #[must_use]
    pub fn link_counts(&self) -> Vec<(String, Counts)> {
        let up: Vec<_> = {
            let links = lock(&self.links);
            let up = links.up.iter();
            up.map(|(peer, link)| (*peer, link.clone())).collect()
        };
        up.into_iter()
            .map(|(peer, link)| (self.name_of(peer).to_owned(), link.counts()))
            .collect()
    }

    /// Whether it is news to the tasks here that `peer` is gone. While the app is taken down the others go
    /// in order, and the boot once this chassis has been told to end.
    fn tells_of(&self, peer: ChassisNumber) -> bool {
        let leaving = self.leaving.load(Ordering::Acquire);
        !leaving && (peer == 0 || !self.is_stopping())
    }
}

#[doc(hidden)]
impl Chassis {
    /// Takes a frame that came from chassis `peer` at `now`.
    pub fn receive(self: &Arc<Self>, peer: ChassisNumber, frame: Frame, now: Instant) {
        let Frame {
            header,
            call,
            trace,
            left_ns,
            body,
        } = frame;
        if header.flags.contains(Flags::REPLY) {
            return self.receive_reply(peer, call, header.flags, body);
        }
        if header.from.chassis() != peer || header.to.chassis() != self.index {
            tracing::error!(
                peer = self.name_of(peer),
                from = %header.from,
                to = %header.to,
                "a frame on the wrong link"
            );
            return;
        }
        if header.flags.contains(Flags::ABANDONED) {
            let request = lock(&self.links).inbound.remove(&(peer, call));
            if let Some(request) = request {
                request.abandon();
            }
            return;
        }
        let deadline = (left_ns != NO_DEADLINE).then(|| now + Duration::from_nanos(left_ns));
        let recorder = self.tap.recorder();
        let recorded = recorder.map_or(0, |recorder| {
            recorder.arrived(&header, trace, deadline, &body)
        });
        let request = Arc::new(Inbound {
            chassis: self.clone(),
            header,
            call,
            trace,
            recorded,
            abandoned: AtomicBool::new(false),
        });
        lock(&self.links)
            .inbound
            .insert((peer, call), request.clone());
        let data = Data::from(body);
        let mut message = Message::with_data(header.to, header.from, header.command, data)
            .in_trace(trace)
            .until(deadline);
        message.envelope.header = header;
        message.envelope.recorded = recorded;
        // Every request between chassis waits for its reply or its acceptance: none is lost unseen.
        message.envelope.reply = Some(ReplySlot::other(request));
        match self.task(header.to) {
            Some(task) => task.mailbox.put(message),
            None => message.refuse(Fault::UnknownTask),
        }
    }

    /// Connects chassis `peer`.
    pub fn link_up(&self, peer: ChassisNumber, link: Arc<dyn Link>) {
        lock(&self.links).up.insert(peer, link);
    }

    /// From now on `connect` makes each link on its first use.
    pub fn connect_by(&self, connect: impl Fn(ChassisNumber) + Send + Sync + 'static) {
        lock(&self.links).connect = Some(Arc::new(connect));
    }

    /// Whether there is a way to chassis `peer`; it is made if that can be. Who is linked is told that the other is gone.
    pub fn reach(&self, peer: ChassisNumber) -> bool {
        if self.is_linked(peer) {
            return true;
        }
        let connect = lock(&self.links).connect.clone();
        connect.is_some_and(|connect| {
            connect(peer);
            self.is_linked(peer)
        })
    }

    /// Gives up all links without telling anybody, so that their writers end, and makes no others.
    pub fn drop_links(&self) {
        let mut links = lock(&self.links);
        links.connect = None;
        links.up.clear();
    }

    /// Whether chassis `peer` is connected.
    pub fn is_linked(&self, peer: ChassisNumber) -> bool {
        lock(&self.links).up.contains_key(&peer)
    }

    /// Chassis `peer` is gone: every call that waits for it ends. What it asked and nobody has begun is
    /// dropped, and every task here is told.
    pub fn link_down(self: &Arc<Self>, peer: ChassisNumber) {
        if let Some(unlinked) = self.unlink(peer) {
            self.tell_unlinked(unlinked);
        }
    }

    /// Takes away the link with `peer`, if there is one. What comes of that is told by [`Self::tell_unlinked`], under
    /// no lock.
    pub fn unlink(&self, peer: ChassisNumber) -> Option<Unlinked> {
        let mut links = lock(&self.links);
        links.up.remove(&peer)?;
        links.inbound.retain(|(from, _), request| {
            if *from == peer {
                request.abandon();
            }
            *from != peer
        });
        let of_peer = |_: &u64, pending: &mut Pending| pending.peer() == peer;
        let ended = links.pending.extract_if(.., of_peer);
        let ended = ended.map(|(_, pending)| pending).collect();
        Some(Unlinked { peer, ended })
    }

    /// Ends the calls that wait for a chassis without a link, and tells every task here.
    pub fn tell_unlinked(self: &Arc<Self>, Unlinked { peer, ended }: Unlinked) {
        for pending in ended {
            pending.answer(Err(self.peer_down_fault(peer)));
        }
        self.directory.forget_chassis(peer);
        if !self.tells_of(peer) {
            return;
        }
        let chassis = self.name_of(peer).to_owned();
        tracing::debug!(chassis = %chassis, "link down");
        for task in self.tasks() {
            // One that was moved hears of it where it is.
            if self.directory.current(task.tid) == task.tid {
                let chassis = chassis.clone();
                self.post_system(task.tid, system::ChassisDown { chassis });
            }
        }
    }
}

/// A link that was taken away, with the calls that waited for its other end.
#[doc(hidden)]
#[must_use]
pub struct Unlinked {
    peer: ChassisNumber,
    ended: Vec<Pending>,
}

/// The data of a frame.
fn body_of(data: Data) -> Result<Body, Fault> {
    let body = data.into_body()?;
    if body.len() > BODY_LIMIT {
        let text = format!(
            "{} bytes of data; a message between chassis holds at most {BODY_LIMIT}",
            body.len()
        );
        return Err(Fault::BadPayload { text });
    }
    Ok(body)
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use super::*;
    use crate::{mailbox::queue::TaskQueue, registry::Registry, task_record::TaskRecord};
    use ctos_config::load_texts;
    use ctos_message::Tid;
    use ctos_time::Clock;

    /// A link that keeps what is sent.
    #[derive(Default)]
    struct Kept(Mutex<Vec<Frame>>);

    impl Link for Kept {
        fn post(&self, frame: Frame) -> Result<(), Full> {
            lock(&self.0).push(frame);
            Ok(())
        }
    }

    fn cell() -> Arc<Chassis> {
        let text = "[chassis.cell]\n[task.arm]\nhandler = \"arm\"\non = \"cell\"\n";
        let app = load_texts(&[("app.toml", text)], &[], &[]).unwrap();
        Chassis::new(1, Arc::new(app), Arc::new(Registry::new()), Clock::real())
    }

    /// Call `call` of a task of chassis 2, which waits for an answer.
    fn asked(chassis: &Arc<Chassis>, call: u64) -> Arc<Inbound> {
        let request = Arc::new(Inbound {
            chassis: chassis.clone(),
            header: Header {
                to: Tid::new(1, 0, 5),
                from: Tid::new(2, 0, 5),
                command: 1,
                flags: Flags::REPLY_WAIT,
                size: 0,
            },
            call,
            trace: 1,
            recorded: 0,
            abandoned: AtomicBool::new(false),
        });
        lock(&chassis.links)
            .inbound
            .insert((2, call), request.clone());
        request
    }

    #[test]
    fn frames_of_a_link_come_in_their_order_whichever_threads_of_the_chassis_read_them() {
        let chassis = cell();
        let processor = chassis.processor(1).unwrap();
        let task = TaskRecord::with_capacity(8, processor.handle.clone(), 0);
        let queue = TaskQueue::open(task.clone());
        processor.add_queue(0, queue.clone());
        chassis.add_task(task.clone());
        let come = |chassis: &Arc<Chassis>, call: u64| {
            let frame = Frame {
                header: Header {
                    to: Tid::new(1, 1, 0),
                    from: Tid::new(2, 1, 0),
                    command: 1,
                    flags: Flags::ACCEPT_WAIT,
                    size: 0,
                },
                call,
                trace: call,
                left_ns: NO_DEADLINE,
                body: Body::default(),
            };
            chassis.receive(2, frame, Instant::START);
        };
        // The last two are read by the receiver's own thread.
        let elsewhere = chassis.clone();
        let read = std::thread::spawn(move || [1, 2].map(|call| come(&elsewhere, call)));
        read.join().unwrap();
        processor.enter();
        come(&chassis, 3);
        processor.run_jobs();
        come(&chassis, 4);
        let mut next = None;
        let traces = std::iter::from_fn(|| {
            _ = queue.poll_next(&mut next);
            next.take().map(|message| message.trace())
        });
        assert_eq!(traces.take(4).collect::<Vec<_>>(), [1, 2, 3, 4]);
    }

    ctos_message::command! {
        /// Tells a task something, in a command of its own.
        struct Tell { number: u64 } => (), 1, "tell"
    }

    #[test]
    fn what_the_runtime_tells_a_task_whose_queue_is_full_waits_there() {
        let chassis = cell();
        let processor = chassis.processor(1).unwrap();
        let task = TaskRecord::with_capacity(1, processor.handle.clone(), 0);
        let queue = TaskQueue::open(task.clone());
        processor.add_queue(0, queue.clone());
        chassis.add_task(task.clone());
        processor.enter();
        for number in 0..3 {
            chassis.post_system(Tid::new(1, 1, 0), Tell { number });
        }
        let mut next = None;
        let numbers = std::iter::from_fn(|| {
            processor.run_jobs();
            _ = queue.poll_next(&mut next);
            let (Tell { number }, _) = next.take()?.open::<Tell>().unwrap();
            Some(number)
        });
        assert_eq!(numbers.collect::<Vec<_>>(), [0, 1, 2]);
    }

    #[test]
    fn an_answer_to_an_earlier_life_of_a_chassis_is_none_to_its_call_of_the_same_number() {
        let chassis = cell();
        let [first, second] = [(); 2].map(|()| Arc::new(Kept::default()));
        chassis.link_up(2, first.clone());
        let early = asked(&chassis, 7);
        chassis.link_down(2);
        assert!(early.is_abandoned());
        chassis.link_up(2, second.clone());
        let late = asked(&chassis, 7);
        let answer = |byte| Ok(Data::Bytes(vec![byte]));
        chassis.post_reply(&early, answer(1));
        chassis.post_reply(&late, answer(2));
        chassis.post_reply(&late, answer(3));
        assert!(lock(&first.0).is_empty());
        let sent = std::mem::take(&mut *lock(&second.0));
        let bodies = sent.into_iter().map(|frame| frame.body.into_vec());
        assert_eq!(bodies.collect::<Vec<_>>(), [[2]]);
    }

    #[test]
    fn tasks_are_told_that_a_chassis_is_gone_until_their_own_was_told_to_end() {
        let chassis = cell();
        let told = || [0, 2].map(|peer| chassis.tells_of(peer));
        assert_eq!(told(), [true, true]);
        chassis.set_stopping();
        assert_eq!(told(), [true, false], "the others go in their turn");
        chassis.set_leaving();
        assert_eq!(
            told(),
            [false, false],
            "the boot may go after the answer to its order"
        );
    }
}

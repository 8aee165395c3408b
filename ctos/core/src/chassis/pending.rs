//! What went over the links of a chassis and has no answer yet, in both directions.

use std::{
    collections::{BTreeMap, btree_map::Entry},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
};

use super::Chassis;
use crate::reply::{Answer, ReplySlot};
use ctos_message::{ChassisNumber, Header, frame::Link};

pub(super) struct Pending {
    /// Who waits for the answer.
    pub(super) reply: ReplySlot,
    /// What was asked, to take it back.
    pub(super) header: Header,
    pub(super) trace: u64,
}

impl Pending {
    /// The chassis that was asked.
    pub(super) fn peer(&self) -> ChassisNumber {
        self.header.to.chassis()
    }

    pub(super) fn answer(self, answer: Answer) {
        self.reply.answer(answer);
    }
}

/// Makes the link to a chassis, if that is there.
pub(crate) type Connect = Arc<dyn Fn(ChassisNumber) + Send + Sync>;

#[derive(Default)]
pub(super) struct Links {
    pub(super) up: BTreeMap<ChassisNumber, Arc<dyn Link>>,
    /// Where links are made on their first use.
    pub(super) connect: Option<Connect>,
    /// What this chassis asked others and has no answer to yet.
    pub(super) pending: BTreeMap<u64, Pending>,
    pub(super) next_call: u64,
    /// What others asked this chassis, by chassis and its number for the call.
    pub(super) inbound: BTreeMap<(ChassisNumber, u64), Arc<Inbound>>,
}

/// A request that came over a link and waits for its answer.
pub(super) struct Inbound {
    pub(super) chassis: Arc<Chassis>,
    pub(super) header: Header,
    pub(super) call: u64,
    pub(super) trace: u64,
    pub(super) recorded: u64,
    /// Set when nobody waits for the answer any more.
    pub(super) abandoned: AtomicBool,
}

impl Inbound {
    pub(super) fn abandon(&self) {
        self.abandoned.store(true, Ordering::Release);
    }
}

impl Links {
    /// `request` is no longer under way: whether it still was. A chassis that comes back counts its calls from
    /// the beginning again. A request of its new life may then have the number of one of an earlier life.
    pub(super) fn close_inbound(&mut self, peer: ChassisNumber, request: &Inbound) -> bool {
        let Entry::Occupied(entry) = self.inbound.entry((peer, request.call)) else {
            return false;
        };
        let is_it = std::ptr::eq(Arc::as_ptr(entry.get()), request);
        if is_it {
            entry.remove();
        }
        is_it
    }
}

/// The number of a request that went over a link and waits for its answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Outbound(pub(super) u64);

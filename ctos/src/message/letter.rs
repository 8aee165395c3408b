//! The memory that messages are written in. A message inside a chassis is one pointer to it; when its
//! data has been taken out, the memory is kept for the next one, so that messages allocate nothing.
//!
//! What a thread keeps is its own; threads that take more than they give get it back in batches from
//! those that give more than they take, through one store of the process. As with the caches of the
//! allocator, nobody can tell from what a message does where its memory came from.

#![allow(
    clippy::vec_box,
    reason = "letters are passed on by their boxes, which is what is kept"
)]

use std::{
    cell::RefCell,
    sync::{Arc, LazyLock},
    time::Duration,
};

use serde::de::DeserializeOwned;

use super::{Data, Flags, Header, PayloadError, Tid, store::Store};
use crate::{call::ReplySlot, time::Instant};

/// How many go from thread to thread at once.
const BATCH: usize = 64;

/// Batches that the store keeps; what is more goes back to the allocator.
const MOST_BATCHES: usize = 64;

/// What a message consists of. In this order and at the beginning of a cache line it takes three of them,
/// which are what a message to another core costs. One that nobody waits for costs two: the third is
/// written to only where something in it changes, so that both cores keep it.
#[derive(Debug)]
#[repr(C, align(64))]
pub(crate) struct Letter {
    pub(crate) header: Header,
    pub(crate) trace: u64,
    /// Its number in the record; 0 when it is not in it.
    pub(crate) recorded: u64,
    pub(crate) deadline: Option<Instant>,
    pub(crate) data: Data,
    /// How long the sender waits, and the receiver as the sender knows it; until the message is sent.
    pub(crate) limit: Duration,
    pub(crate) reply: Option<ReplySlot>,
    pub(crate) to: Option<Arc<str>>,
}

thread_local! {
    /// Blank letters of this thread.
    static SPARE: RefCell<Vec<Box<Letter>>> = const { RefCell::new(Vec::new()) };
}

/// What threads have too many of.
static STORE: LazyLock<Store<Box<Letter>>> = LazyLock::new(|| Store::new(MOST_BATCHES));

impl Letter {
    const BLANK: Self = Self {
        header: Header {
            to: Tid::from_bits(0),
            from: Tid::from_bits(0),
            command: 0,
            flags: Flags::NONE,
            size: 0,
        },
        trace: 0,
        recorded: 0,
        deadline: None,
        data: Data::NOTHING,
        limit: Duration::ZERO,
        reply: None,
        to: None,
    };

    /// A letter without data and without a sender that waits. The rest is that of an older one: to be
    /// written anew.
    #[inline]
    pub(crate) fn blank() -> Box<Self> {
        let spare = SPARE.try_with(|spare| spare.borrow_mut().pop());
        match spare {
            Ok(Some(letter)) => letter,
            _ => Self::from_store(),
        }
    }

    #[cold]
    fn from_store() -> Box<Self> {
        let got = SPARE.try_with(|spare| {
            let mut spare = spare.borrow_mut();
            STORE.take(&mut spare);
            // They were another core's. Written to one after the other, their first two lines come over
            // together, and not one by one when each is needed.
            for letter in spare.iter_mut() {
                letter.trace = 0;
                letter.write(Data::of(()));
                letter.set_reply(None);
            }
            spare.pop()
        });
        // It fails where the thread ends.
        got.ok().flatten().unwrap_or_else(|| Box::new(Self::BLANK))
    }

    /// Writes the data of a blank letter. What is there, [`Data::NOTHING`] or a parcel of nothing, needs no
    /// destructor, and without one in between the data is written at once where it stays.
    #[inline(always)]
    pub(crate) fn write(&mut self, data: Data) {
        std::mem::forget(std::mem::replace(&mut self.data, data));
    }

    /// Notes what its sender needs of it before it is sent: the receiver as the sender knows it, and how long
    /// it waits.
    #[inline]
    pub(crate) fn for_sender(&mut self, to: Option<Arc<str>>, limit: Duration) {
        if to.is_some() || self.to.is_some() {
            self.to = to;
        }
        if self.limit != limit {
            self.limit = limit;
        }
    }

    /// The receiver as the sender knows it.
    #[inline]
    pub(crate) fn take_to(&mut self) -> Option<Arc<str>> {
        if self.to.is_some() {
            self.to.take()
        } else {
            None
        }
    }

    /// Who waits for the answer from now on.
    #[inline]
    pub(crate) fn set_reply(&mut self, reply: Option<ReplySlot>) {
        if reply.is_some() || self.reply.is_some() {
            self.reply = reply;
        }
    }

    /// Who waits for the answer; from now on nobody does.
    #[inline]
    pub(crate) fn take_reply(&mut self) -> Option<ReplySlot> {
        if self.reply.is_some() {
            self.reply.take()
        } else {
            None
        }
    }

    /// Looks at all of it. Where several letters came from another core they come over together, and not
    /// one by one when each is opened.
    #[inline]
    pub(crate) fn glance(&self) {
        std::hint::black_box((
            self.header.command,
            self.data.glance(),
            self.reply.is_some(),
        ));
    }

    /// The data and whoever waits for the answer; the letter is kept for another message.
    #[inline]
    pub(crate) fn open(mut self: Box<Self>) -> (Data, Option<ReplySlot>) {
        let data = std::mem::replace(&mut self.data, Data::NOTHING);
        let reply = self.take_reply();
        self.keep();
        (data, reply)
    }

    /// The value that the data is, which is all that was wanted of the letter.
    ///
    /// # Errors
    /// As [`Data::take`].
    #[inline(always)]
    pub(crate) fn take<T: DeserializeOwned + 'static>(
        mut self: Box<Self>,
    ) -> Result<T, PayloadError> {
        let value = self.data.take_out::<T>()?;
        self.set_reply(None);
        self.keep();
        Ok(value)
    }

    /// Keeps a letter that is blank for another message.
    #[inline(always)]
    pub(crate) fn keep(self: Box<Self>) {
        // It fails where the thread ends: the letter is given back to the allocator.
        let _ = SPARE.try_with(|spare| {
            let mut spare = spare.borrow_mut();
            spare.push(self);
            if spare.len() >= 2 * BATCH {
                Self::to_store(&mut spare);
            }
        });
    }

    #[cold]
    fn to_store(spare: &mut Vec<Box<Self>>) {
        STORE.give(spare, BATCH);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written(number: u32) -> Box<Letter> {
        let mut letter = Letter::blank();
        letter.data = Data::of(number);
        letter
    }

    #[test]
    fn a_letter_is_blank_whoever_wrote_in_it_before() {
        for number in 0..1000_u32 {
            let letter = written(number);
            let address = std::ptr::from_ref(letter.as_ref());
            let (data, reply) = letter.open();
            assert_eq!(data.take::<u32>().unwrap(), number);
            assert!(reply.is_none());
            let next = Letter::blank();
            assert_eq!(
                std::ptr::from_ref(next.as_ref()),
                address,
                "it was not used again"
            );
            assert!(next.data.to_bytes().unwrap().is_empty());
        }
    }

    #[test]
    fn a_thread_that_only_gives_keeps_no_more_than_two_batches() {
        let letters: Vec<_> = (0..10_000).map(written).collect();
        std::thread::spawn(move || {
            for letter in letters {
                letter.open();
            }
            SPARE.with_borrow(|spare| assert!(spare.len() < 2 * BATCH));
        })
        .join()
        .unwrap();
        assert!(STORE.len() <= MOST_BATCHES);
    }
}

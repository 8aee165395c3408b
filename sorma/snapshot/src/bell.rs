//! Waking readers that wait, without cost to a writer for whom nobody waits.
//!
//! A reader that is about to sleep sets the bell to 1 and looks once more. A writer looks at the bell after
//! each record. Only when it is 1 does the writer set it to 0 and ask the system to wake the sleeping readers.
//! Both put a full fence between their own store and the look at the other's, so that one of the two sees the
//! other. A reader that dies with the bell set costs one call of the system, once.

use rustix::thread::futex::{self, Timespec};
use std::sync::atomic::{AtomicU32, Ordering, fence};
use std::time::Duration;

const WAITED_FOR: u32 = 1;

/// The writer's side: call it after the record was announced.
#[inline]
pub(super) fn ring(bell: &AtomicU32) {
    fence(Ordering::SeqCst);
    if bell.load(Ordering::Relaxed) == WAITED_FOR {
        wake(bell);
    }
}

#[cold]
fn wake(bell: &AtomicU32) {
    bell.store(0, Ordering::Relaxed);
    // There is nothing to be done about an error, and readers look again by themselves.
    let _ = futex::wake(bell, futex::Flags::empty(), u32::MAX / 2);
}

/// The reader's side: sleeps until the bell rings, at most `limit`, unless `is_there` says that what
/// the reader waits for is there already. May end early for no reason.
pub(super) fn sleep(bell: &AtomicU32, limit: Duration, is_there: impl Fn() -> bool) {
    bell.store(WAITED_FOR, Ordering::Relaxed);
    fence(Ordering::SeqCst);
    if is_there() {
        return;
    }
    let limit = Timespec {
        tv_sec: i64::try_from(limit.as_secs()).unwrap_or(i64::MAX),
        tv_nsec: limit.subsec_nanos().into(),
    };
    // Woken, late, interrupted or rung in between: the caller looks in any case.
    let _ = futex::wait(bell, futex::Flags::empty(), WAITED_FOR, Some(&limit));
}

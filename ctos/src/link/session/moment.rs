//! The present moment, for those who mostly do not need it: a look at the clock costs as much as some of what
//! is done to send a small packet.

use crate::time::{Clock, Instant};

/// The present moment, looked up when it is wanted.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Moment<'a>(Known<'a>);

#[derive(Debug, Clone, Copy)]
enum Known<'a> {
    At(Instant),
    By(&'a Clock),
}

impl<'a> Moment<'a> {
    /// By this clock.
    pub(super) fn by(clock: &'a Clock) -> Self {
        Self(Known::By(clock))
    }

    /// Which it is.
    pub(super) fn get(self) -> Instant {
        match self.0 {
            Known::At(moment) => moment,
            Known::By(clock) => clock.now(),
        }
    }
}

impl From<Instant> for Moment<'_> {
    fn from(moment: Instant) -> Self {
        Self(Known::At(moment))
    }
}

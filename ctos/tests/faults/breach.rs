//! Rules of the links that are broken on purpose, to see that the checks notice.

use ctos::{
    message::{Flags, SYSTEM_COMMANDS, Tid},
    simulation::Tamper,
};
use ctos_message::frame::Frame;
use rand::RngExt;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

/// A rule is broken at one in so many frames of the app.
const ONE_IN: u32 = 40;

/// The rule that is broken.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Breach {
    /// Some frames arrive twice.
    Duplicate,
    /// Some frames change places with the next one between the same tasks.
    Swap,
    /// Some frames never arrive.
    Lose,
    /// Some requests arrive at another task.
    Misdeliver,
}

impl Breach {
    /// Only what tasks send each other is broken: a boot that fails would hide it.
    fn concerns(self, frame: &Frame) -> bool {
        let of_the_app = frame.header.command < SYSTEM_COMMANDS;
        let request = !frame.header.flags.contains(Flags::REPLY);
        of_the_app && (request || self == Self::Lose)
    }

    /// What breaks it, as the seed of the run says.
    pub fn tamper(self, seed: u64) -> Tamper {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut kept: Option<Frame> = None;
        Box::new(move |mut frame| {
            let ends = |frame: &Frame| (frame.header.from, frame.header.to);
            if let Some(before) = kept.take_if(|kept| ends(kept) == ends(&frame)) {
                return vec![frame, before];
            }
            if !self.concerns(&frame) || rng.random_range(0..ONE_IN) != 0 {
                return vec![frame];
            }
            match self {
                Self::Duplicate => vec![frame.clone(), frame],
                Self::Swap => kept.replace(frame).into_iter().collect(),
                Self::Lose => Vec::new(),
                Self::Misdeliver => {
                    frame.header.to = Tid::from_bits(frame.header.to.bits() ^ 1);
                    vec![frame]
                }
            }
        })
    }
}

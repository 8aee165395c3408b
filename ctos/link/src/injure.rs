//! Links that are injured on purpose: packets that are lost or late, streams that break. For any app,
//! drawn from its seed. Injuries happen below the session, which has to repair them.
//!
//! Knows what shall go wrong; what is made of it, the session decides.

use std::{io, time::Duration};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::{config::InjuryConfig, seed::mix, time::Instant};

/// What goes wrong with what one chassis sends to another.
pub struct Injury {
    config: InjuryConfig,
    /// When the link is cut, in time order.
    cuts: Vec<(Instant, Instant)>,
    rng: ChaCha8Rng,
    /// Bytes until the stream breaks.
    left: usize,
}

impl Injury {
    /// The injuries of what `from` sends to `to`; `None` when the configuration names none.
    pub fn of(config: &InjuryConfig, seed: u64, from: &str, to: &str) -> Option<Self> {
        if config.is_none() {
            return None;
        }
        let cuts = config.cuts.iter().filter(|cut| cut.is_between(from, to));
        let mut injury = Self {
            cuts: cuts
                .map(|cut| (Instant::START + cut.at, Instant::START + cut.until))
                .collect(),
            rng: ChaCha8Rng::seed_from_u64(mix(seed, &["injuries", from, to])),
            left: usize::MAX,
            config: config.clone(),
        };
        injury.restarted();
        Some(injury)
    }

    /// Whether the next packet is lost.
    pub fn loses(&mut self) -> bool {
        self.config.drop > 0.0 && self.rng.random_bool(self.config.drop)
    }

    /// When a packet that is posted now leaves.
    pub fn delayed(&mut self, now: Instant) -> Instant {
        let (least, most) = self.config.delay;
        let spread = u64::try_from((most.saturating_sub(least)).as_nanos()).unwrap_or(u64::MAX);
        let drawn = self.rng.random_range(0..=spread);
        now + least + Duration::from_nanos(drawn)
    }

    /// Whether the link is cut at this moment.
    pub fn is_cut(&self, now: Instant) -> bool {
        self.cuts
            .iter()
            .any(|(at, until)| *at <= now && now < *until)
    }

    /// A new stream: draws when it breaks.
    pub fn restarted(&mut self) {
        let mean = self.config.break_bytes;
        self.left = match mean {
            0 => usize::MAX,
            mean => self.rng.random_range(1..=mean.saturating_mul(2)),
        };
        // Each stream lives longer than the one before, or a large packet would never arrive.
        self.config.break_bytes = mean.saturating_add(mean / 2);
    }

    /// How many bytes the stream still takes.
    ///
    /// # Errors
    /// When it breaks here.
    pub fn bytes_left(&self) -> io::Result<usize> {
        if self.left == 0 {
            let text = "broken on purpose";
            return Err(io::Error::new(io::ErrorKind::ConnectionReset, text));
        }
        Ok(self.left)
    }

    /// The stream took so many.
    pub fn wrote(&mut self, count: usize) {
        if self.left != usize::MAX {
            self.left = self.left.saturating_sub(count);
        }
    }
}

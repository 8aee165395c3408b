//! How a marking is packed: a field of bits for each place, side by side in 64-bit words, none across
//! two words. As long as no field overflows, a firing adds one constant per word.

use super::model::{Model, PlaceNumber, Weighted};

/// The field of one place.
#[derive(Debug, Clone, Copy)]
pub(super) struct Field {
    pub(super) word: u32,
    pub(super) shift: u32,
    pub(super) bits: u32,
}

impl Field {
    /// The most tokens that fit.
    pub(super) fn most(self) -> u32 {
        u32::MAX >> (32 - self.bits)
    }

    pub(super) fn get(self, packed: &[u64]) -> u32 {
        let word = packed[self.word as usize];
        // A field has at most 32 bits.
        ((word >> self.shift) as u32) & self.most()
    }
}

/// The fields of all places.
#[derive(Debug, Clone)]
pub(super) struct Layout {
    pub(super) fields: Vec<Field>,
    /// Words of a packed marking, at least one.
    pub(super) words: usize,
}

/// Bits that hold every number up to this one, at least one.
pub(super) fn bits_for(tokens: u32) -> u32 {
    (32 - tokens.leading_zeros()).max(1)
}

impl Layout {
    /// A field for each place with so many bits (1 to 32).
    pub(super) fn new(bits: &[u32]) -> Self {
        let mut fields = Vec::with_capacity(bits.len());
        let (mut word, mut shift) = (0_u32, 0_u32);
        for bits in bits {
            let bits = (*bits).clamp(1, 32);
            if shift + bits > 64 {
                word += 1;
                shift = 0;
            }
            fields.push(Field { word, shift, bits });
            shift += bits;
        }
        Self {
            fields,
            words: word as usize + 1,
        }
    }

    /// The same with wider fields where there is space for them. Every place gets as many bits, up to four,
    /// as do not make a marking longer. What fits from the beginning need not be packed again later.
    pub(super) fn roomy(bits: &[u32]) -> Self {
        let tight = Self::new(bits);
        let wider = (2..=4).rev().map(|least| {
            let wider: Vec<u32> = bits.iter().map(|bits| (*bits).max(least)).collect();
            Self::new(&wider)
        });
        let fitting = wider.into_iter().find(|wider| wider.words == tight.words);
        fitting.unwrap_or(tight)
    }

    /// Bits per place.
    pub(super) fn bits(&self) -> Vec<u32> {
        self.fields.iter().map(|field| field.bits).collect()
    }

    /// Packs a marking whose tokens fit.
    pub(super) fn pack(&self, marking: &[u32], packed: &mut Vec<u64>) {
        packed.clear();
        packed.resize(self.words, 0);
        for (field, tokens) in self.fields.iter().zip(marking) {
            packed[field.word as usize] |= u64::from(*tokens & field.most()) << field.shift;
        }
    }

    pub(super) fn unpack(&self, packed: &[u64], marking: &mut Vec<u32>) {
        marking.clear();
        marking.extend(self.fields.iter().map(|field| field.get(packed)));
    }
}

/// A transition against a layout.
#[derive(Debug, Clone)]
pub(super) struct Packed {
    pub(super) needs: Vec<Weighted>,
    pub(super) forbids: Vec<Weighted>,
    /// Places that gain, and by how much.
    pub(super) gains: Vec<Weighted>,
    /// Places that lose, and by how much.
    pub(super) losses: Vec<Weighted>,
    /// Word and what is added to it, wrapping.
    adds: Vec<(u32, u64)>,
    /// What the additions add to the sum that [`linear`] makes.
    hash: u64,
    /// Places that are emptied, with what they hold afterwards.
    pub(super) resets: Vec<Weighted>,
}

impl Packed {
    pub(super) fn new(model: &Model, number: usize, layout: &Layout) -> Self {
        let transition = &model.transitions[number];
        let changes = transition.changes();
        let mut adds: Vec<(u32, u64)> = Vec::new();
        for (place, change) in &changes {
            let field = layout.fields[*place as usize];
            let amount = change.unsigned_abs() << field.shift;
            let amount = if *change < 0 {
                amount.wrapping_neg()
            } else {
                amount
            };
            match adds.iter_mut().find(|(word, _)| *word == field.word) {
                Some((_, sum)) => *sum = sum.wrapping_add(amount),
                None => adds.push((field.word, amount)),
            }
        }
        let weighted = |(place, change): (PlaceNumber, i64)| {
            // A change is a difference of two 32-bit weights.
            (
                place,
                u32::try_from(change.unsigned_abs()).unwrap_or(u32::MAX),
            )
        };
        Self {
            needs: transition.needs(),
            forbids: transition.forbids(&model.places),
            gains: changes
                .iter()
                .filter(|c| c.1 > 0)
                .copied()
                .map(weighted)
                .collect(),
            losses: changes
                .iter()
                .filter(|c| c.1 < 0)
                .copied()
                .map(weighted)
                .collect(),
            hash: adds.iter().fold(0, |sum, (word, add)| {
                sum.wrapping_add(add.wrapping_mul(factor(*word)))
            }),
            adds,
            resets: transition.after_reset(),
        }
    }

    /// What it adds to a marking of one word, and to its [`linear`] sum.
    pub(super) fn step(&self) -> (u64, u64) {
        (self.adds.first().map_or(0, |(_, add)| *add), self.hash)
    }

    /// The same as [`Packed::fire`], with the successor put at the end of a list.
    pub(super) fn fire_onto(
        &self,
        layout: &Layout,
        from: &[u64],
        sum: u64,
        list: &mut Vec<u64>,
    ) -> u64 {
        if let ([word], [], adds) = (from, self.resets.as_slice(), self.adds.as_slice()) {
            let add = adds.first().map_or(0, |(_, add)| *add);
            list.push(word.wrapping_add(add));
            return sum.wrapping_add(self.hash);
        }
        let start = list.len();
        list.extend_from_slice(from);
        self.change(layout, sum, &mut list[start..])
    }

    /// Fires on a packed marking whose [`linear`] sum is given; writes the successor and returns its
    /// sum. The transition must be enabled and its gains must fit.
    pub(super) fn fire(&self, layout: &Layout, from: &[u64], sum: u64, to: &mut [u64]) -> u64 {
        to.copy_from_slice(from);
        self.change(layout, sum, to)
    }

    fn change(&self, layout: &Layout, sum: u64, to: &mut [u64]) -> u64 {
        for (word, add) in &self.adds {
            let word = &mut to[*word as usize];
            *word = word.wrapping_add(*add);
        }
        if self.resets.is_empty() {
            return sum.wrapping_add(self.hash);
        }
        for (place, after) in &self.resets {
            let field = layout.fields[*place as usize];
            let word = &mut to[field.word as usize];
            *word &= !(u64::from(field.most()) << field.shift);
            *word |= u64::from(*after) << field.shift;
        }
        linear(to)
    }

    pub(super) fn is_enabled(&self, marking: &[u32]) -> bool {
        self.needs
            .iter()
            .all(|(place, weight)| marking[*place as usize] >= *weight)
            && self
                .forbids
                .iter()
                .all(|(place, weight)| marking[*place as usize] < *weight)
    }
}

/// An odd factor for each word.
fn factor(word: u32) -> u64 {
    mix(0x9E37_79B9_7F4A_7C15_u64.wrapping_mul(u64::from(word) + 1)) | 1
}

/// A sum over the words that a firing changes by a constant: half of the hash of a marking.
pub(super) fn linear(packed: &[u64]) -> u64 {
    linear_of(packed.iter().copied())
}

/// The same of words that come one by one.
pub(super) fn linear_of(packed: impl Iterator<Item = u64>) -> u64 {
    (0..).zip(packed).fold(0, |sum, (word, value)| {
        sum.wrapping_add(value.wrapping_mul(factor(word)))
    })
}

/// The other half: spreads every bit over all.
pub(super) fn mix(sum: u64) -> u64 {
    let mut bits = sum ^ (sum >> 32);
    bits = bits.wrapping_mul(0xD6E8_FEB8_6659_FD93);
    bits ^= bits >> 32;
    bits = bits.wrapping_mul(0xD6E8_FEB8_6659_FD93);
    bits ^ (bits >> 32)
}

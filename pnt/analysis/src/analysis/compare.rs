//! Comparisons of packed markings with numbers of tokens, several places at once and without unpacking. A
//! place is compared by a subtraction that borrows, or does not, from a bit above its field. All fields
//! of a word that leave each other such a bit are subtracted together (Lamport 1975).

use super::layout::{Field, Layout};
use super::model::{PlaceNumber, Weighted};

/// What some fields of one word must hold.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Compare {
    word: u32,
    /// Bits that the word is moved down by: the uppermost field has no bit above it.
    down: u32,
    /// The fields, the bits above them, and what is subtracted.
    fields: u64,
    above: u64,
    less: u64,
    /// Bits that are looked at then, and what they must be.
    looked_at: u64,
    expected: u64,
}

/// What some bits of a word must be: all that is looked at where places hold one token or none.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bits {
    word: u32,
    looked_at: u64,
    expected: u64,
}

impl Bits {
    #[inline]
    pub(super) fn holds(&self, packed: &[u64]) -> bool {
        packed[self.word as usize] & self.looked_at == self.expected
    }
}

/// What one place must hold.
#[derive(Debug, Clone, Copy)]
enum Wanted {
    AtLeast(u32),
    Below(u32),
}

impl Compare {
    #[inline]
    pub(super) fn holds(&self, packed: &[u64]) -> bool {
        let value = (packed[self.word as usize] >> self.down) & self.fields;
        (value | self.above).wrapping_sub(self.less) & self.looked_at == self.expected
    }

    /// The same without subtraction, where it comes to that.
    pub(super) fn bits(&self) -> Option<Bits> {
        (self.above == 0 && self.less == 0).then_some(Bits {
            word: self.word,
            looked_at: self.looked_at << self.down,
            expected: self.expected << self.down,
        })
    }

    /// Adds a place if it is of this word and no other is in its way.
    fn add(&mut self, field: Field, wanted: Wanted) -> bool {
        let Some(shift) = field.shift.checked_sub(self.down) else {
            return false;
        };
        let bits = u64::from(field.most()) << shift;
        let (number, at_least) = match wanted {
            Wanted::AtLeast(number) => (number, true),
            Wanted::Below(number) => (number, false),
        };
        // A single bit tells by itself.
        let single = field.bits == 1 && number == 1;
        let end = shift + field.bits;
        let above = match (single, end < 64) {
            (true, _) => 0,
            (false, true) => 1 << end,
            (false, false) => return false,
        };
        let used = self.fields | self.above;
        if field.word != self.word || used & (bits | above) != 0 {
            return false;
        }
        let looked_at = if single { bits } else { above };
        self.fields |= bits;
        self.above |= above;
        self.less |= if single {
            0
        } else {
            u64::from(number) << shift
        };
        self.looked_at |= looked_at;
        self.expected |= if at_least { looked_at } else { 0 };
        true
    }
}

/// Adds a condition to a list all of which must hold.
fn add(list: &mut Vec<Compare>, field: Field, wanted: Wanted) {
    let number = match wanted {
        Wanted::AtLeast(number) | Wanted::Below(number) => number,
    };
    if number > field.most() {
        // No field holds so many.
        if matches!(wanted, Wanted::AtLeast(_)) {
            list.push(Compare {
                expected: 1,
                ..Compare::default()
            });
        }
        return;
    }
    let last = list.iter_mut().rev().take(4);
    for compare in last {
        if compare.looked_at != 0 && compare.add(field, wanted) {
            return;
        }
    }
    let mut compare = Compare {
        word: field.word,
        down: u32::from(field.shift + field.bits == 64),
        ..Compare::default()
    };
    compare.add(field, wanted);
    list.push(compare);
}

/// Conditions that hold where all of some needs are there, and nothing forbids it.
pub(super) fn enabling(layout: &Layout, needs: &[Weighted], forbids: &[Weighted]) -> Vec<Compare> {
    let mut list = Vec::new();
    for (place, weight) in needs {
        let field = layout.fields[*place as usize];
        add(&mut list, field, Wanted::AtLeast(*weight));
    }
    for (place, weight) in forbids {
        let field = layout.fields[*place as usize];
        add(&mut list, field, Wanted::Below(*weight));
    }
    list
}

/// What the places that gain must hold less than, so that what a transition puts fits into the fields.
pub(super) fn room(layout: &Layout, gains: &[Weighted]) -> Vec<Weighted> {
    let below = gains.iter().map(|(place, gain)| {
        let most = layout.fields[*place as usize].most();
        // A sum of all 32 bits is too many.
        (
            *place,
            most.min(u32::MAX - 1)
                .saturating_add(1)
                .saturating_sub(*gain),
        )
    });
    below.collect()
}

/// Conditions that hold where no place has more tokens than these.
pub(super) fn at_most(layout: &Layout, tokens: &[u32]) -> Vec<Compare> {
    let mut list = Vec::new();
    for (field, most) in layout.fields.iter().zip(tokens) {
        if *most < field.most() {
            add(&mut list, *field, Wanted::Below(*most + 1));
        }
    }
    list
}

/// Finds the places that hold tokens.
#[derive(Debug, Clone, Default)]
pub(super) struct Marked {
    /// Per word, the fields of the places that are looked for.
    words: Vec<u64>,
    /// Per bit of all words, the place it belongs to, and its field.
    bits: Vec<(PlaceNumber, u64)>,
}

impl Marked {
    /// To look for these places.
    pub(super) fn new(layout: &Layout, places: impl Iterator<Item = PlaceNumber>) -> Self {
        let mut marked = Self {
            words: vec![0; layout.words],
            bits: vec![(0, 0); layout.words * 64],
        };
        for place in places {
            let field = layout.fields[place as usize];
            let bits = u64::from(field.most()) << field.shift;
            marked.words[field.word as usize] |= bits;
            let first = field.word as usize * 64 + field.shift as usize;
            marked.bits[first..first + field.bits as usize].fill((place, bits));
        }
        marked
    }

    /// Those that hold tokens, in order.
    pub(super) fn of(&self, packed: &[u64]) -> impl Iterator<Item = PlaceNumber> {
        let words = packed.iter().zip(&self.words).zip(self.bits.chunks(64));
        words.flat_map(|((word, fields), bits)| {
            let mut left = word & fields;
            std::iter::from_fn(move || {
                let (place, field) = *bits.get(left.trailing_zeros() as usize)?;
                left &= !field;
                Some(place)
            })
        })
    }
}

/// Adds up the tokens of packed markings.
#[derive(Debug, Clone)]
pub(super) struct Sum {
    /// Per word, what counts once, twice, four times and so on; `None` where fields have too many bits.
    planes: Option<Vec<[u64; PLANES]>>,
}

/// Bits of a field up to which all fields of a word are added up together.
const PLANES: usize = 4;

impl Sum {
    pub(super) fn new(layout: &Layout) -> Self {
        let narrow = layout
            .fields
            .iter()
            .all(|field| field.bits as usize <= PLANES);
        let planes = narrow.then(|| {
            let mut planes = vec![[0; PLANES]; layout.words];
            for field in &layout.fields {
                let word = &mut planes[field.word as usize];
                for (bit, plane) in (0..field.bits).zip(word) {
                    *plane |= 1 << (field.shift + bit);
                }
            }
            planes
        });
        Self { planes }
    }

    pub(super) fn of(&self, layout: &Layout, packed: &[u64]) -> u64 {
        let Some(planes) = &self.planes else {
            let fields = layout.fields.iter();
            return fields.map(|field| u64::from(field.get(packed))).sum();
        };
        let words = packed.iter().zip(planes);
        words.fold(0, |sum, (word, planes)| {
            let each = (0..).zip(planes).filter(|(_, plane)| **plane != 0);
            each.fold(sum, |sum, (bit, plane)| {
                sum + (u64::from((word & plane).count_ones()) << bit)
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Bits, tokens that fit, and numbers to compare with, of some places.
    fn places() -> impl Strategy<Value = Vec<(u32, u32, u32, bool)>> {
        let place = (
            1_u32..=32,
            any::<u32>(),
            any::<u32>(),
            any::<bool>(),
            any::<bool>(),
        );
        let place = place.prop_map(|(bits, tokens, number, near, asked)| {
            let tokens = tokens & (u32::MAX >> (32 - bits));
            let near = if number % 3 == 0 {
                tokens.saturating_add(number % 7)
            } else if near {
                tokens
            } else {
                number
            };
            (bits, tokens, near, asked)
        });
        let narrow = (1_u32..=4, any::<u32>(), 0_u32..6, any::<bool>());
        let narrow = narrow.prop_map(|(bits, tokens, number, asked)| {
            (bits, tokens & (u32::MAX >> (32 - bits)), number, asked)
        });
        prop_oneof![
            prop::collection::vec(place, 1..40),
            prop::collection::vec(narrow, 1..80)
        ]
    }

    proptest! {
        #[test]
        fn comparisons_are_those_of_the_places_one_by_one(places in places(), few in 1_usize..5) {
            let bits: Vec<u32> = places.iter().map(|place| place.0).collect();
            let tokens: Vec<u32> = places.iter().map(|place| place.1).collect();
            let numbers: Vec<u32> = places.iter().map(|place| place.2).collect();
            let layout = Layout::new(&bits);
            let mut packed = Vec::new();
            layout.pack(&tokens, &mut packed);
            let list = at_most(&layout, &numbers);
            let all = |list: &[Compare]| list.iter().all(|compare| compare.holds(&packed));
            prop_assert_eq!(all(&list), tokens.iter().zip(&numbers).all(|(held, most)| held <= most));
            // A few at a time, so that they hold now and then.
            let weighted: Vec<Weighted> = (0..).zip(numbers.iter().copied()).collect();
            for some in weighted.chunks(few) {
                let asked = |asked: bool| -> Vec<Weighted> {
                    some.iter().copied().filter(|(place, _)| places[*place as usize].3 == asked).collect()
                };
                let (needs, forbids) = (asked(true), asked(false));
                let held = |place: &u32| tokens[*place as usize];
                let holds = needs.iter().all(|(place, weight)| held(place) >= *weight)
                    && forbids.iter().all(|(place, weight)| held(place) < *weight);
                prop_assert_eq!(all(&enabling(&layout, &needs, &forbids)), holds);
                for compare in enabling(&layout, &needs, &forbids) {
                    let bits = compare.bits().map(|bits| bits.holds(&packed));
                    prop_assert!(bits.is_none_or(|holds| holds == compare.holds(&packed)));
                }
                let gains: Vec<Weighted> = some.iter().copied().filter(|(_, gain)| *gain > 0).collect();
                let fits = gains.iter().all(|(place, gain)| {
                    let sum = u64::from(held(place)) + u64::from(*gain);
                    let most = layout.fields[*place as usize].most();
                    sum <= u64::from(most) && sum < u64::from(u32::MAX)
                });
                prop_assert_eq!(all(&enabling(&layout, &[], &room(&layout, &gains))), fits);
                // Both of the same place.
                let both = enabling(&layout, some, some);
                prop_assert!(!all(&both));
            }
            let sum: u64 = tokens.iter().map(|tokens| u64::from(*tokens)).sum();
            prop_assert_eq!(Sum::new(&layout).of(&layout, &packed), sum);
            let looked_for = || (0..).zip(&places).filter(|(_, place)| place.3).map(|(number, _)| number);
            let marked: Vec<u32> = Marked::new(&layout, looked_for()).of(&packed).collect();
            let held = looked_for().filter(|place| tokens[*place as usize] > 0);
            prop_assert_eq!(marked, held.collect::<Vec<_>>());
        }
    }
}

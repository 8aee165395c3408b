//! Which of up to 64 conditions a packed marking meets, looked up. For every few bits of neighbouring fields a
//! table says which conditions they permit, whatever the others hold.

use super::{
    layout::{Field, Layout},
    model::Weighted,
};

/// Bits of a marking that are looked up at once.
const BITS: u32 = 8;

/// Tables up to which all are asked.
const MOST: usize = 16;

/// Conditions at most: each is a bit.
pub(super) const CONDITIONS: usize = 64;

/// What some places must hold at least, and what others must hold less than.
pub(super) struct Condition {
    pub(super) at_least: Vec<Weighted>,
    pub(super) below: Vec<Weighted>,
}

pub(super) struct Tables {
    tables: Vec<Table>,
}

struct Table {
    word: u32,
    shift: u32,
    /// By what the bits hold, the conditions that they permit.
    permits: Box<[u64; 1 << BITS]>,
}

impl Tables {
    /// The conditions, one a bit; nothing meets one that is `None`. Nothing when there are too many of them, or
    /// places that hold too much.
    pub(super) fn new(layout: &Layout, conditions: &[Option<Condition>]) -> Option<Self> {
        if conditions.len() > CONDITIONS || layout.fields.is_empty() {
            return None;
        }
        let bits = conditions.iter().enumerate();
        let possible = bits.filter(|(_, condition)| condition.is_some());
        let possible = possible.fold(0, |all, (bit, _)| all | 1_u64 << bit);
        let mut tables: Vec<Table> = Vec::new();
        // Per place, its table.
        let mut places = Vec::with_capacity(layout.fields.len());
        for field in &layout.fields {
            let fits = |table: &Table| {
                table.word == field.word && field.shift + field.bits <= table.shift + BITS
            };
            if !tables.last().is_some_and(fits) {
                if field.bits > BITS || tables.len() == MOST {
                    return None;
                }
                tables.push(Table {
                    word: field.word,
                    shift: field.shift,
                    permits: Box::new([possible; 1 << BITS]),
                });
            }
            places.push((tables.len() - 1, *field));
        }
        for (bit, condition) in conditions.iter().enumerate() {
            let Some(condition) = condition else { continue };
            for (place, number) in &condition.at_least {
                let (table, field) = places[*place as usize];
                tables[table].forbid(1 << bit, field, |held| held < *number);
            }
            for (place, number) in &condition.below {
                let (table, field) = places[*place as usize];
                tables[table].forbid(1 << bit, field, |held| held >= *number);
            }
        }
        Some(Self { tables })
    }

    /// The conditions that a marking meets.
    #[inline]
    pub(super) fn met(&self, packed: &[u64]) -> u64 {
        self.tables.iter().fold(u64::MAX, |met, table| {
            let bits = packed[table.word as usize] >> table.shift;
            met & table.permits[bits as usize % (1 << BITS)]
        })
    }
}

impl Table {
    /// Notes that a condition is not met where a place of this table holds what is wrong.
    fn forbid(&mut self, condition: u64, field: Field, wrong: impl Fn(u32) -> bool) {
        let shift = field.shift - self.shift;
        for (bits, permits) in (0_u32..).zip(self.permits.iter_mut()) {
            if wrong((bits >> shift) & field.most()) {
                *permits &= !condition;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn what_is_looked_up_is_what_the_places_say_one_by_one(
            places in prop::collection::vec((1_u32..=BITS, any::<u32>()), 1..20),
            wanted in prop::collection::vec(
                prop::option::of(prop::collection::vec((any::<u32>(), 0_u32..10, any::<bool>()), 0..4)),
                0..CONDITIONS,
            ),
        ) {
            let bits: Vec<u32> = places.iter().map(|place| place.0).collect();
            let layout = Layout::new(&bits);
            let fields = layout.fields.iter();
            let tokens: Vec<u32> = fields.zip(&places).map(|(field, place)| place.1 & field.most()).collect();
            let mut packed = Vec::new();
            layout.pack(&tokens, &mut packed);
            let condition = |list: &Vec<(u32, u32, bool)>| {
                let of = |below: bool| {
                    let list = list.iter().filter(|wanted| wanted.2 == below);
                    list.map(|(place, number, _)| (place % places.len() as u32, *number)).collect()
                };
                Condition { at_least: of(false), below: of(true) }
            };
            let conditions: Vec<_> = wanted.iter().map(|list| list.as_ref().map(condition)).collect();
            let held = |place: &u32| tokens[*place as usize];
            let met = |condition: &Option<Condition>| {
                condition.as_ref().is_some_and(|condition| {
                    condition.at_least.iter().all(|(place, number)| held(place) >= *number)
                        && condition.below.iter().all(|(place, number)| held(place) < *number)
                })
            };
            let each = conditions.iter().enumerate().map(|(bit, condition)| u64::from(met(condition)) << bit);
            let expected: u64 = each.sum();
            let tables = Tables::new(&layout, &conditions);
            // Places of eight bits fill a table each.
            prop_assert!(tables.is_some() || places.len() > MOST);
            prop_assert!(tables.is_none_or(|tables| tables.met(&packed) == expected));
        }
    }

    #[test]
    fn too_many_conditions_and_places_that_hold_much_are_not_looked_up() {
        let none = |conditions: usize| (0..conditions).map(|_| None).collect::<Vec<_>>();
        let tables =
            |bits: &[u32], conditions| Tables::new(&Layout::new(bits), &none(conditions)).is_some();
        assert!(tables(&[BITS], CONDITIONS));
        assert!(!tables(&[BITS], CONDITIONS + 1));
        assert!(!tables(&[BITS + 1], 1));
        assert!(!tables(&[BITS; MOST + 1], 1));
        assert!(!tables(&[], 1));
    }
}

//! Random expressions of tapes and what they mean, for tests of several crates. The module above has the types.

use std::collections::BTreeSet;

use proptest::prelude::*;

use super::{Expression, SymbolNumber};

/// All words over three symbols, up to a length.
pub(crate) fn words(longest: u32) -> Vec<Vec<SymbolNumber>> {
    (0..=longest)
        .flat_map(|length| {
            (0..3_usize.pow(length)).map(move |mut code| {
                let digit = |_| {
                    let symbol = code % 3;
                    code /= 3;
                    symbol
                };
                (0..length).map(digit).collect()
            })
        })
        .collect()
}

/// The definition: where a part of a word may end that begins at `from` and is of the expression.
pub(crate) fn ends(
    expression: &Expression<SymbolNumber>,
    word: &[SymbolNumber],
    from: usize,
) -> BTreeSet<usize> {
    match expression {
        Expression::Symbol(symbol) => {
            let there = word.get(from) == Some(symbol);
            there.then_some(from + 1).into_iter().collect()
        }
        Expression::Any => (from < word.len())
            .then_some(from + 1)
            .into_iter()
            .collect(),
        Expression::Sequence(parts) => parts.iter().fold(BTreeSet::from([from]), |starts, part| {
            starts
                .into_iter()
                .flat_map(|start| ends(part, word, start))
                .collect()
        }),
        Expression::Choice(parts) => parts
            .iter()
            .flat_map(|part| ends(part, word, from))
            .collect(),
        Expression::Repeat(inner, least, most) => {
            let mut all = BTreeSet::new();
            let mut starts = BTreeSet::from([from]);
            // Once every number of times up to this was tried, more can only repeat what is empty.
            let enough = most.unwrap_or(*least + u32::try_from(word.len()).unwrap() + 1);
            for times in 0..=enough {
                if times >= *least {
                    all.extend(&starts);
                }
                starts = starts
                    .into_iter()
                    .flat_map(|start| ends(inner, word, start))
                    .collect();
            }
            all
        }
    }
}

pub(crate) fn expression() -> impl Strategy<Value = Expression<SymbolNumber>> {
    let leaf = prop_oneof![
        6 => (0_usize..3).prop_map(Expression::Symbol),
        1 => Just(Expression::Any),
        1 => Just(Expression::Sequence(Vec::new())),
    ];
    leaf.prop_recursive(4, 12, 3, |inner| {
        let several = || prop::collection::vec(inner.clone(), 2..4);
        let times = (0_u32..3, prop::option::of(0_u32..3));
        prop_oneof![
            several().prop_map(Expression::Sequence),
            several().prop_map(Expression::Choice),
            (inner, times).prop_map(|(inner, (least, more))| {
                Expression::Repeat(Box::new(inner), least, more.map(|more| least + more))
            }),
        ]
    })
}

/// An expression as a person writes it.
pub(crate) fn written(expression: &Expression<SymbolNumber>) -> String {
    let all = |parts: &[Expression<SymbolNumber>], sign: &str| {
        let parts: Vec<String> = parts.iter().map(written).collect();
        format!("({})", parts.join(sign))
    };
    match expression {
        Expression::Symbol(symbol) => ["a", "\"b\"", "c"][*symbol].to_owned(),
        Expression::Any => ".".to_owned(),
        Expression::Sequence(parts) => all(parts, " "),
        Expression::Choice(parts) => all(parts, " | "),
        Expression::Repeat(inner, least, most) => {
            let times = match (least, most) {
                (0, None) => "*".to_owned(),
                (1, None) => "+".to_owned(),
                (0, Some(1)) => "?".to_owned(),
                (least, None) => format!("{{{least},}}"),
                (least, Some(most)) if least == most => format!("{{{least}}}"),
                (least, Some(most)) => format!("{{{least}, {most}}}"),
            };
            format!("{}{times}", written(inner))
        }
    }
}

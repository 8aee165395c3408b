//! The trader: keeps offers, and ranks them for who seeks one (SORMA technical report, section 3.5). Requests and
//! resources are matched by attributes, in the words in which dictionaries trade service objects.
//!
//! Offers are in memory only: each is made again before it ends, so a trader that was killed knows all of them soon.

use std::{cmp::Ordering, collections::BTreeMap, time::Duration};

use ctos::{
    registry::Registry,
    task::{Context, HandlerError},
    time::Instant,
};
use sorma::trade::{Attributes, Wanted, attributes};

use crate::wire::{Offer, Offered, Seek};

/// The handler's name.
pub const HANDLER: &str = "fleet.trader";

/// Registers the handler.
pub(crate) fn register(registry: &mut Registry) {
    registry.handler(HANDLER, &Trader::COMMANDS, |_| Ok(Trader::default()));
}

/// An offer that stands.
struct Standing {
    text: String,
    attributes: Attributes,
    until: Instant,
}

/// The event handler.
#[derive(Default)]
struct Trader {
    /// By the service, then by who offers it.
    offers: BTreeMap<String, BTreeMap<String, Standing>>,
}

#[ctos::handler]
impl Trader {
    #[command]
    fn offer(&mut self, cx: &Context, offer: Offer) -> Result<(), HandlerError> {
        let standing = Standing {
            attributes: attributes(&offer.attributes)?,
            text: offer.attributes,
            until: cx.now() + Duration::from_millis(offer.stands_ms),
        };
        let of_service = self.offers.entry(offer.service).or_default();
        of_service.insert(offer.from, standing);
        Ok(())
    }

    #[command]
    fn seek(&mut self, cx: &Context, seek: Seek) -> Result<Vec<Offered>, HandlerError> {
        let words: Vec<String> = seek.wanted.split_whitespace().map(str::to_owned).collect();
        let wanted = Wanted::read(&seek.service, &words);
        let wanted = wanted.map_err(|report| HandlerError::new(report.to_string()))?;
        let now = cx.now();
        let of_service = self.offers.entry(seek.service).or_default();
        of_service.retain(|_, standing| standing.until > now);
        Ok(ranked(of_service, &wanted, seek.most as usize))
    }
}

/// The offers that meet what is wanted, the best first; equal ones in the order of names.
fn ranked(offers: &BTreeMap<String, Standing>, wanted: &Wanted, most: usize) -> Vec<Offered> {
    let met = |one: &(&String, &Standing)| wanted.is_met_by(&one.1.attributes);
    let mut found: Vec<_> = offers.iter().filter(met).collect();
    found.sort_by(|(a, one), (b, other)| {
        let by_attributes = wanted.compare(&one.attributes, &other.attributes);
        match by_attributes {
            Ordering::Equal => a.cmp(b),
            decided => decided,
        }
    });
    let offered = found.into_iter().take(most);
    let offered = offered.map(|(from, standing)| Offered {
        from: from.clone(),
        attributes: standing.text.clone(),
    });
    offered.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn standing(text: &str) -> Standing {
        Standing {
            text: text.to_owned(),
            attributes: attributes(text).unwrap(),
            until: Instant::START,
        }
    }

    #[test]
    fn who_is_free_and_most_reliable_comes_first_and_who_is_not_free_does_not_come() {
        let offers = BTreeMap::from([
            ("a".to_owned(), standing("load=0 reliability=0.90")),
            ("b".to_owned(), standing("load=1 reliability=0.99")),
            ("c".to_owned(), standing("load=0 reliability=0.95")),
            ("d".to_owned(), standing("load=0 reliability=0.95")),
        ]);
        let words = ["load<1", "-most", "reliability"].map(str::to_owned);
        let wanted = Wanted::read("carry", &words).unwrap();
        let names = |most| -> Vec<String> {
            let found = ranked(&offers, &wanted, most).into_iter();
            found.map(|one| one.from).collect()
        };
        assert_eq!(names(9), ["c", "d", "a"]);
        assert_eq!(names(1), ["c"]);
    }
}

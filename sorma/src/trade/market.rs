//! What a process offers, and what it knows about the offers of others.

use super::wanted::{Attributes, Wanted, attributes};
use crate::name::ObjectName;
use crate::words;
use ctos::time::Instant;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::Notify;

/// How long one waits for the first answer of a daemon that one knows nothing about.
pub(super) const FIRST: Duration = Duration::from_secs(2);

/// A daemon is slow when it takes so many times longer than the fastest that meets the requirements...
const SLOW_TIMES: u32 = 4;
/// ...and so much longer.
const SLOW_BY: Duration = Duration::from_millis(20);

/// Classes with the attributes of what is offered.
type Offers = BTreeMap<String, Attributes>;

/// An offer that meets the requirements.
#[derive(Debug, Clone, PartialEq)]
pub struct Ranked {
    /// Whose it is.
    pub daemon: String,
    /// Its attributes.
    pub attributes: Attributes,
    /// How long the daemon's answers take; `None` while that is not known.
    pub latency: Option<Duration>,
    /// Whether it answered when it was last asked.
    pub available: bool,
    /// Whether it takes much longer than the fastest.
    pub slow: bool,
}

/// The market as one process knows it.
#[derive(Default)]
pub(crate) struct Market {
    own: Offers,
    others: BTreeMap<String, Standing>,
    /// Who met the last request for an object.
    chosen: BTreeMap<String, String>,
    /// How many traded requests were given away so far.
    turns: u64,
    /// Told whenever something becomes known about a daemon.
    known: Arc<Notify>,
}

/// What is known about a daemon.
#[derive(Default)]
struct Standing {
    offers: Option<Offers>,
    /// Smoothed, of its answers to what it offers.
    latency: Option<Duration>,
    /// When the question that it has not answered yet was asked.
    asked: Option<Instant>,
    /// When it last answered, or did not.
    known: Option<Instant>,
    down: bool,
    /// Traded requests of this process that it has not answered yet.
    under_way: u32,
    /// The number of the last one; 0 if there was none.
    turn: u64,
}

impl Standing {
    /// Whether it is just being asked for the first time. The caller may have gone without an answer.
    fn is_first_question(&self, now: Instant) -> bool {
        let asked = self.asked.filter(|_| self.known.is_none());
        asked.is_some_and(|asked| now.since(asked) < FIRST)
    }

    /// How long an answer takes, as far as one can tell: at least as long as one has been waiting now.
    fn expected(&self, now: Instant) -> Option<Duration> {
        let waiting = self.asked.map(|asked| now.since(asked));
        match (self.latency, waiting) {
            (Some(latency), Some(waiting)) => Some(latency.max(waiting)),
            (latency, _) => latency,
        }
    }
}

impl Market {
    pub(super) fn offer(&mut self, class: &str, attributes: Attributes) {
        self.own.insert(class.to_owned(), attributes);
    }

    pub(super) fn withdraw(&mut self, class: &str) -> bool {
        self.own.remove(class).is_some()
    }

    pub(super) fn own(&self) -> &Offers {
        &self.own
    }

    /// Whether a daemon is to be asked now, and then whether something is known about it already.
    pub(super) fn begin(&mut self, daemon: &str, now: Instant, every: Duration) -> Option<bool> {
        let standing = self.others.entry(daemon.to_owned()).or_default();
        let recent = standing.known.is_some_and(|known| now.since(known) < every);
        let first = standing.is_first_question(now);
        if recent || first || standing.known.is_some() && standing.asked.is_some() {
            return None;
        }
        standing.asked = Some(now);
        Some(standing.known.is_some())
    }

    /// Told whenever a daemon has said what it offers, or is given up.
    pub(super) fn known(&self) -> Arc<Notify> {
        Arc::clone(&self.known)
    }

    /// Whether one of these daemons is just being asked for the first time.
    pub(super) fn asks_first(&self, daemons: &[String], now: Instant) -> bool {
        let mut asked = daemons.iter().filter_map(|daemon| self.others.get(daemon));
        asked.any(|standing| standing.is_first_question(now))
    }

    /// Nobody waits any more for the answers of those that have not given one.
    pub(super) fn given_up(&mut self, daemons: &[String], now: Instant) {
        for daemon in daemons {
            let asked = self.others.get(daemon).and_then(|standing| standing.asked);
            if asked.is_some() {
                self.down(daemon, now);
            }
        }
    }

    /// A daemon has said what it offers.
    pub(super) fn heard(&mut self, daemon: &str, text: &str, asked: Instant, now: Instant) {
        let standing = self.others.entry(daemon.to_owned()).or_default();
        let took = now.since(asked);
        standing.latency = match standing.latency {
            // What it took to come back says nothing about how fast it is.
            _ if standing.down => None,
            Some(before) => Some((before + took) / 2),
            None => Some(took),
        };
        standing.offers = Some(read(text));
        standing.asked = None;
        standing.known = Some(now);
        standing.down = false;
        self.known.notify_waiters();
    }

    /// A daemon has not answered.
    pub(super) fn down(&mut self, daemon: &str, now: Instant) {
        let standing = self.others.entry(daemon.to_owned()).or_default();
        standing.asked = None;
        standing.known = Some(now);
        standing.down = true;
        self.known.notify_waiters();
    }

    /// A daemon is given a traded request.
    pub(super) fn gives(&mut self, daemon: &str) {
        self.turns += 1;
        let standing = self.others.entry(daemon.to_owned()).or_default();
        standing.under_way += 1;
        standing.turn = self.turns;
    }

    /// A traded request of a daemon is over.
    pub(super) fn over(&mut self, daemon: &str) {
        if let Some(standing) = self.others.get_mut(daemon) {
            standing.under_way = standing.under_way.saturating_sub(1);
        }
    }

    /// Notes who met a request; says who did so before, if that was another one.
    pub(super) fn chose(&mut self, name: &ObjectName, daemon: &str) -> Option<String> {
        let before = self.chosen.insert(name.local(), daemon.to_owned());
        before.filter(|before| before != daemon)
    }

    /// The offers that meet the requirements, the best first.
    pub(super) fn rank(
        &self,
        daemons: &[String],
        name: &ObjectName,
        wanted: &Wanted,
        now: Instant,
    ) -> Vec<Ranked> {
        let mut ranked: Vec<Ranked> = daemons
            .iter()
            .filter_map(|daemon| {
                let standing = self.others.get(daemon)?;
                let attributes = standing.offers.as_ref()?.get(name.class())?;
                wanted.is_met_by(attributes).then(|| Ranked {
                    daemon: daemon.clone(),
                    attributes: attributes.clone(),
                    latency: standing.expected(now),
                    available: !standing.down,
                    slow: false,
                })
            })
            .collect();
        let answering = ranked.iter().filter(|offer| offer.available);
        let fastest = answering.filter_map(|offer| offer.latency).min();
        if let Some(fastest) = fastest {
            let limit = (fastest * SLOW_TIMES).max(fastest + SLOW_BY);
            for offer in &mut ranked {
                offer.slow = offer.latency.is_some_and(|latency| latency > limit);
            }
        }
        let before = self.chosen.get(&name.local());
        let load = |offer: &Ranked| {
            let standing = self.others.get(&offer.daemon);
            let standing = standing.filter(|_| wanted.is_spread());
            standing.map(|standing| (standing.under_way, standing.turn))
        };
        ranked.sort_by(|one, other| {
            let ready = |offer: &Ranked| (!offer.available, offer.slow);
            let last = |offer: &Ranked| {
                (
                    before != Some(&offer.daemon),
                    offer.latency.unwrap_or_default(),
                )
            };
            ready(one)
                .cmp(&ready(other))
                .then_with(|| wanted.compare(&one.attributes, &other.attributes))
                .then_with(|| load(one).cmp(&load(other)))
                .then_with(|| last(one).cmp(&last(other)))
                .then_with(|| one.daemon.cmp(&other.daemon))
        });
        ranked
    }

    /// How daemons offer a class.
    pub(super) fn said(&self, daemons: &[String], class: &str) -> Vec<String> {
        let said = daemons.iter().filter_map(|daemon| {
            let offers = self.others.get(daemon)?.offers.as_ref()?;
            let attributes = offers.get(class)?;
            Some(format!("{daemon} {}", line(attributes)))
        });
        said.collect()
    }

    /// What is known about the others, a line each.
    pub(super) fn lines(&self, now: Instant) -> Vec<String> {
        let lines = self.others.iter().map(|(daemon, standing)| {
            let state = if standing.down { "down" } else { "up" };
            let latency = match standing.expected(now) {
                Some(latency) => format!("{:.6} s", latency.as_secs_f64()),
                None => "unknown".to_owned(),
            };
            let offers = standing.offers.as_ref().map(listed).unwrap_or_default();
            format!(
                "{daemon} {state} latency {latency} offers {}",
                offers.join("; ")
            )
        });
        lines.collect()
    }
}

fn line(attributes: &Attributes) -> String {
    let pairs = attributes
        .iter()
        .map(|(name, value)| words::word(&format!("{name}={value}")));
    pairs.collect::<Vec<_>>().join(" ")
}

/// Offers as lines: `class attribute=value ...`.
pub(crate) fn listed(offers: &Offers) -> Vec<String> {
    let lines = offers.iter().map(|(class, attributes)| {
        format!("{class} {}", line(attributes))
            .trim_end()
            .to_owned()
    });
    lines.collect()
}

/// What [`listed`] wrote. Lines of another version that say something else are left out.
fn read(text: &str) -> Offers {
    let offers = text.lines().filter_map(|line| {
        let (class, rest) = line.split_once(' ').unwrap_or((line, ""));
        Some((class.to_owned(), attributes(rest).ok()?))
    });
    offers.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ms: u64) -> Instant {
        Instant::START + Duration::from_millis(ms)
    }

    fn order(market: &Market, wanted: &str, now: Instant) -> String {
        let words = words::split(wanted).unwrap();
        let words: Vec<String> = words.into_iter().map(|word| word.text).collect();
        let wanted = Wanted::read("SCALE", &words).unwrap();
        let daemons = ["d1", "d2", "d3"].map(str::to_owned);
        let ranked = market.rank(&daemons, &"scale.two".parse().unwrap(), &wanted, now);
        let names: Vec<&str> = ranked.iter().map(|offer| offer.daemon.as_str()).collect();
        names.join(" ")
    }

    #[test]
    fn offers_are_ranked_by_whether_they_answer_then_attributes_then_habit_then_speed() {
        let mut market = Market::default();
        for (daemon, offers, ms) in [
            ("d1", "scale price=3", 5),
            ("d2", "scale price=1", 9),
            ("d3", "scale price=3\nother", 2),
        ] {
            market.heard(daemon, offers, at(0), at(ms));
        }
        assert_eq!(order(&market, "", at(10)), "d3 d1 d2");
        assert_eq!(order(&market, "-least price", at(10)), "d2 d3 d1");
        assert_eq!(order(&market, "price>1", at(10)), "d3 d1");
        assert_eq!(market.chose(&"scale.two".parse().unwrap(), "d1"), None);
        assert_eq!(order(&market, "", at(10)), "d1 d3 d2");
        market.down("d1", at(11));
        assert_eq!(order(&market, "", at(12)), "d3 d2 d1");
        assert_eq!(
            market.chose(&"scale.two".parse().unwrap(), "d3"),
            Some("d1".to_owned())
        );
    }

    #[test]
    fn equal_offers_take_turns_when_that_is_wanted_the_idle_ones_first() {
        let mut market = Market::default();
        for daemon in ["d1", "d2", "d3"] {
            market.heard(daemon, "scale price=1", at(0), at(5));
        }
        let first = |market: &Market| order(market, "-spread", at(10))[..2].to_owned();
        let mut given = Vec::new();
        for _ in 0..4 {
            let daemon = first(&market);
            market.gives(&daemon);
            market.over(&daemon);
            given.push(daemon);
        }
        assert_eq!(given, ["d1", "d2", "d3", "d1"]);
        // d2 is next, but it is still at it.
        market.gives("d2");
        assert_eq!(order(&market, "-spread", at(10)), "d3 d1 d2");
        market.heard("d3", "scale price=2", at(10), at(15));
        assert_eq!(order(&market, "-least price -spread", at(20)), "d1 d2 d3");
    }

    #[test]
    fn who_does_not_answer_for_long_is_slow_before_the_answer_is_there() {
        let mut market = Market::default();
        for daemon in ["d1", "d2"] {
            market.heard(daemon, "scale", at(0), at(2));
        }
        assert_eq!(order(&market, "", at(3)), "d1 d2");
        assert_eq!(
            market.begin("d1", at(2000), Duration::from_secs(1)),
            Some(true)
        );
        assert_eq!(market.begin("d1", at(2001), Duration::from_secs(1)), None);
        assert_eq!(order(&market, "", at(2001)), "d1 d2");
        assert_eq!(order(&market, "", at(2100)), "d2 d1");
    }

    #[test]
    fn what_is_offered_is_read_back() {
        let mut market = Market::default();
        market.offer("scale", attributes("arm=left 'note=two words'").unwrap());
        market.offer("other", Attributes::new());
        assert_eq!(&read(&listed(market.own()).join("\n")), market.own());
    }
}

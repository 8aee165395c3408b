//! Metering: how often each caller used an object, for how long, and how much data went in and out. The SORMA
//! technical report, section 3.2, leaves this open.

use crate::request::Method;
use crate::transport::Transport;
use crate::words;
use ctos::time::Instant;
use std::collections::BTreeMap;
use std::time::Duration;

/// So many callers are told apart; of more, those that were not heard of for longest are counted together.
const CALLERS: usize = 64;
/// The name under which they are.
const OTHERS: &str = "(others)";

/// What was used, by caller.
#[derive(Debug, Clone, Default)]
pub(crate) struct Meter {
    callers: BTreeMap<String, Usage>,
}

#[derive(Debug, Clone, Default)]
struct Usage {
    calls: u64,
    errors: u64,
    took: Duration,
    bytes_in: u64,
    bytes_out: u64,
    last: Instant,
}

/// A call that is metered.
pub(crate) struct Begun {
    from: String,
    at: Instant,
    bytes: u64,
}

/// Begins to meter a call, if its caller has a name. DBX, which tells about the object, is nobody's use of it.
#[inline]
pub(crate) fn begin(
    method: Method,
    io: &Transport,
    now: impl FnOnce() -> Instant,
) -> Option<Begun> {
    (!io.from.is_empty() && method != Method::Dbx).then(|| Begun {
        from: io.from.clone(),
        at: now(),
        bytes: bytes(io),
    })
}

/// Data that a caller sends or gets.
fn bytes(io: &Transport) -> u64 {
    let numbers = (io.floats.len() + io.ints.len()) * size_of::<f64>();
    u64::try_from(io.text.len() + numbers + io.opaque.len()).unwrap_or(u64::MAX)
}

impl Meter {
    /// A call has ended.
    pub(crate) fn add(&mut self, begun: Begun, io: &Transport, now: Instant) {
        if !self.callers.contains_key(&begun.from) {
            while self.callers.len() >= CALLERS {
                self.make_room();
            }
        }
        self.callers.entry(begun.from).or_default().add(&Usage {
            calls: 1,
            errors: u64::from(!io.is_ok()),
            took: now.since(begun.at),
            bytes_in: begun.bytes,
            bytes_out: bytes(io),
            last: now,
        });
    }

    fn make_room(&mut self) {
        let named = self.callers.iter().filter(|(name, _)| *name != OTHERS);
        let oldest = named.min_by_key(|(_, usage)| usage.last);
        let oldest = oldest.map(|(name, _)| name.clone());
        if let Some(usage) = oldest.and_then(|name| self.callers.remove(&name)) {
            let others = self.callers.entry(OTHERS.to_owned()).or_default();
            others.add(&usage);
        }
    }

    /// A line for each caller.
    pub(crate) fn lines(&self) -> String {
        let lines = self.callers.iter().map(|(name, usage)| {
            let Usage {
                calls,
                errors,
                took,
                bytes_in,
                bytes_out,
                ..
            } = usage;
            let took = took.as_secs_f64();
            let name = words::word(name);
            format!("{name} calls {calls} errors {errors} took {took:.6} s in {bytes_in} bytes out {bytes_out} bytes")
        });
        lines.collect::<Vec<_>>().join("\n")
    }
}

impl Usage {
    fn add(&mut self, other: &Self) {
        self.calls += other.calls;
        self.errors += other.errors;
        self.took += other.took;
        self.bytes_in = self.bytes_in.saturating_add(other.bytes_in);
        self.bytes_out = self.bytes_out.saturating_add(other.bytes_out);
        self.last = self.last.max(other.last);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn used(meter: &mut Meter, from: &str, at_s: u64) {
        let at = Instant::START + Duration::from_secs(at_s);
        let io = Transport::text("four").from(from);
        let begun = begin(Method::Exec, &io, || at).unwrap();
        let answer = Transport::floats([1.0, 2.0]);
        meter.add(begun, &answer, at + Duration::from_millis(250));
    }

    #[test]
    fn each_caller_has_its_calls_time_and_bytes() {
        let mut meter = Meter::default();
        for at in 0..3 {
            used(&mut meter, "desk", at);
        }
        used(&mut meter, "cage", 4);
        assert_eq!(
            meter.lines(),
            "cage calls 1 errors 0 took 0.250000 s in 4 bytes out 16 bytes\n\
             desk calls 3 errors 0 took 0.750000 s in 12 bytes out 48 bytes"
        );
    }

    #[test]
    fn who_has_no_name_and_who_asks_for_dbx_is_not_metered() {
        let now = || Instant::START;
        assert!(begin(Method::Exec, &Transport::default(), now).is_none());
        let named = Transport::default().from("desk");
        assert!(begin(Method::Dbx, &named, now).is_none());
    }

    #[test]
    fn a_thousand_callers_take_bounded_room_and_no_call_is_forgotten() {
        let mut meter = Meter::default();
        for at in 0..1000 {
            used(&mut meter, &format!("caller{at}"), at);
        }
        assert_eq!(meter.callers.len(), CALLERS);
        let calls: u64 = meter.callers.values().map(|usage| usage.calls).sum();
        assert_eq!(calls, 1000);
        assert!(meter.callers.contains_key("caller999"));
    }
}

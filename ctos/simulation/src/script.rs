//! Faults at given moments, as `[[fault]]` tables: read, and written so that they read back the same.

use std::{fmt::Write as _, time::Duration};

use crate::{
    fault::{Fault, FaultKind, KINDS, Kind, Site},
    reader::Reader,
};
use ctos_config::{Node, diagnostic::Finding};
use ctos_time::Instant;

/// The latest moment and the longest time, s: the nanosecond still counts in a float.
const MOST: f64 = 1e6;

/// The keys of a drift.
const DRIFT: [&str; 4] = ["kind", "chassis", "ahead_s", "rate_ppm"];

fn keys_of(kind: &Kind) -> Vec<&'static str> {
    let place = if kind.on_link { "between" } else { "chassis" };
    let lasts = kind.lasts.then_some("lasts_s");
    let keys = ["kind", place, "at_s"].into_iter();
    keys.chain(lasts).chain(kind.extent).collect()
}

/// Reads all `[[fault]]` tables.
pub(super) fn read(reader: &mut Reader<'_, '_>) -> Vec<Fault> {
    let tables = reader.tables("fault");
    tables
        .iter()
        .filter_map(|table| read_one(reader, table))
        .collect()
}

fn read_one<'n>(reader: &mut Reader<'n, '_>, table: &'n Node) -> Option<Fault> {
    let word = table.entry("kind").and_then(|kind| kind.value.as_str());
    let kind = KINDS.iter().find(|kind| Some(kind.word) == word);
    let keys = match (word, kind) {
        (Some("drift"), _) => DRIFT.to_vec(),
        (_, Some(kind)) => keys_of(kind),
        _ => KINDS.iter().flat_map(keys_of).chain(DRIFT).collect(),
    };
    let named = word.map_or_else(String::new, |word| format!(" `{word}`"));
    let mut one = Reader::new(table, format!("[[fault]]{named}"), &keys, reader.findings);
    let words = KINDS.iter().map(|kind| kind.word).chain(["drift"]);
    let words: Vec<&str> = words.collect();
    let word = one.text("kind", &format!("one of {}", words.join(", ")))?;
    if word == "drift" {
        let chassis = one.text("chassis", "the name of a chassis");
        let ahead = one.time("ahead_s", MOST);
        let rate = one.needed("rate_ppm", -100_000.0..=100_000.0);
        let (ahead, rate_ppb) = (ahead?, (rate? * 1e3).round() as i32);
        let drift = FaultKind::Drift { ahead, rate_ppb };
        return Some(Fault::on(chassis?, drift, Instant::START));
    }
    let Some(kind) = kind else {
        let message = format!("there is no fault `{word}`");
        let finding = Finding::error("ctos::faults::unknown_fault", message);
        one.push(finding.suggest(&word, words), "kind");
        return None;
    };
    let at = one.time("at_s", MOST);
    let site = if kind.on_link {
        one.pair("between")
            .map(|(one, other)| Site::Link(one, other))
    } else {
        let chassis = one.text("chassis", "the name of a chassis");
        chassis.map(Site::Chassis)
    };
    let lasts = kind.lasts.then(|| one.time("lasts_s", MOST));
    let extent = match kind.extent {
        Some("extra_s") => one.needed("extra_s", 0.0..=MOST),
        Some(key) => one.needed(key, 0.0..=1.0),
        None => Some(0.0),
    };
    let at = Instant::START + at?;
    Some(Fault {
        kind: FaultKind::of(&word, extent?)?,
        site: site?,
        at,
        until: match lasts {
            Some(lasts) => Some(at + lasts?),
            None => None,
        },
    })
}

/// The `[[fault]]` tables of `faults`; reading them gives the same faults.
#[must_use]
pub fn write_script(faults: &[Fault]) -> String {
    let mut text = String::new();
    for fault in faults {
        // Writing to a string does not fail.
        let _ = write_one(&mut text, fault);
    }
    text
}

fn write_one(text: &mut String, fault: &Fault) -> std::fmt::Result {
    writeln!(text, "[[fault]]\nkind = \"{}\"", fault.kind.word())?;
    match &fault.site {
        Site::Chassis(chassis) => writeln!(text, "chassis = \"{chassis}\"")?,
        Site::Link(one, other) => writeln!(text, "between = [\"{one}\", \"{other}\"]")?,
    }
    if let FaultKind::Drift { ahead, rate_ppb } = fault.kind {
        let ppm = f64::from(rate_ppb) / 1e3;
        return writeln!(text, "ahead_s = {}\nrate_ppm = {ppm:.3}\n", exact(ahead));
    }
    writeln!(text, "at_s = {}", exact(fault.at.since_start()))?;
    if let Some(until) = fault.until {
        writeln!(text, "lasts_s = {}", exact(until.since(fault.at)))?;
    }
    match fault.kind {
        FaultKind::Loss { share_ppm } => {
            writeln!(text, "share = {:.6}", f64::from(share_ppm) / 1e6)?
        }
        FaultKind::Delay { extra } => writeln!(text, "extra_s = {}", exact(extra))?,
        FaultKind::Slow { per_step } => writeln!(text, "step_s = {}", exact(per_step))?,
        _ => {}
    }
    writeln!(text)
}

/// Seconds with all nine digits.
fn exact(time: Duration) -> String {
    format!("{}.{:09}", time.as_secs(), time.subsec_nanos())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::Faults;
    use ctos_config::diagnostic::Source;

    fn fault() -> impl Strategy<Value = Fault> {
        let nanos = || 0_u64..1_000_000_000_000_000;
        (
            0..10_u8,
            nanos(),
            nanos(),
            0..=1_000_000_u32,
            -100_000_000..=100_000_000_i32,
        )
            .prop_map(|(kind, at, lasts, share_ppm, rate_ppb)| {
                let (chassis, one, other) = ("a".to_owned(), "boot".to_owned(), "b.c-1".to_owned());
                let at = Instant::from_nanos(at / 2);
                let until = at + Duration::from_nanos(lasts / 2);
                let short = Duration::from_nanos(lasts % 1_000_000_000);
                if kind == 9 {
                    let ahead = short;
                    return Fault::on(
                        chassis,
                        FaultKind::Drift { ahead, rate_ppb },
                        Instant::START,
                    );
                }
                let kind = &KINDS[usize::from(kind)];
                let extent = match kind.word {
                    "loss" => f64::from(share_ppm) / 1e6,
                    _ => short.as_secs_f64(),
                };
                let what = FaultKind::of(kind.word, extent).unwrap();
                let fault = if kind.on_link {
                    Fault::between(one, other, what, at)
                } else {
                    Fault::on(chassis, what, at)
                };
                if kind.lasts {
                    fault.until(until)
                } else {
                    fault
                }
            })
    }

    proptest! {
        #[test]
        fn what_is_written_reads_back_to_the_nanosecond(
            faults in proptest::collection::vec(fault(), 0..20)
        ) {
            let text = write_script(&faults);
            let read = Faults::parse(&Source::new("faults.toml", text));
            prop_assert_eq!(read.unwrap().script, faults);
        }
    }
}

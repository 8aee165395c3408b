//! What is measured: one area, at one size, in a process of its own.

use std::error::Error;

use ctos::time::Clock;

use crate::{apps, curve::Cost, parts};

/// Why something could not be measured.
pub type Failed = Box<dyn Error>;

/// Something whose cost may grow.
pub struct Area {
    /// Its name on the command line.
    pub name: &'static str,
    /// What is measured, in words.
    pub what: &'static str,
    /// As [`Curve::whole`](crate::curve::Curve::whole).
    pub whole: bool,
    /// The least and the largest size.
    pub sizes: (u64, u64),
    /// How far it goes if sizes that take an hour and a disk are wanted, too.
    pub large: Option<u64>,
    /// Measures it.
    pub measure: fn(u64) -> Result<Cost, Failed>,
}

/// Messages whose record has 4 GB.
const RECORD_4_GB: u64 = 100_000_000;

/// All areas, in the order of the table.
pub const AREAS: &[Area] = &[
    Area {
        name: "configuration",
        what: "reading a configuration of tasks",
        whole: true,
        sizes: (10, 100_000),
        large: None,
        measure: apps::configuration,
    },
    Area {
        name: "tasks",
        what: "booting tasks, virtual time",
        whole: true,
        sizes: (10, 100_000),
        large: None,
        measure: apps::tasks,
    },
    Area {
        name: "chassis",
        what: "booting chassis, virtual time",
        whole: true,
        sizes: (2, 5_000),
        large: None,
        measure: apps::chassis,
    },
    Area {
        name: "fleet",
        what: "booting cells of 3 chassis with 20 tasks each, virtual time",
        whole: true,
        sizes: (1, 1_000),
        large: None,
        measure: apps::fleet,
    },
    Area {
        name: "fleet-work",
        what: "cells of the fleet that do five jobs each, virtual time",
        whole: true,
        sizes: (10, 1_000),
        large: None,
        measure: apps::fleet_work,
    },
    Area {
        name: "processes",
        what: "booting chassis as processes",
        whole: true,
        sizes: (2, 64),
        large: None,
        measure: apps::processes,
    },
    Area {
        name: "processes-call",
        what: "a call between two of chassis as processes",
        whole: false,
        sizes: (2, 64),
        large: None,
        measure: apps::processes_call,
    },
    #[cfg(feature = "zenoh")]
    Area {
        name: "processes-zenoh",
        what: "booting chassis as processes, peers of zenoh",
        whole: true,
        sizes: (2, 50),
        large: None,
        measure: apps::processes_zenoh,
    },
    #[cfg(feature = "zenoh")]
    Area {
        name: "processes-zenoh-call",
        what: "a call between two of chassis as processes, peers of zenoh",
        whole: false,
        sizes: (2, 50),
        large: None,
        measure: apps::processes_zenoh_call,
    },
    Area {
        name: "names",
        what: "finding a name among tasks",
        whole: false,
        sizes: (10, 60_000),
        large: None,
        measure: apps::names,
    },
    Area {
        name: "calls",
        what: "calls in flight",
        whole: true,
        sizes: (10, 100_000),
        large: None,
        measure: apps::calls,
    },
    Area {
        name: "net-check",
        what: "checking a net of nodes",
        whole: true,
        sizes: (10, 10_000),
        large: None,
        measure: parts::net_check,
    },
    Area {
        name: "net-firing",
        what: "a firing in a net of nodes",
        whole: false,
        sizes: (10, 10_000),
        large: None,
        measure: parts::net_firing,
    },
    Area {
        name: "net-drawing",
        what: "drawing a net of nodes",
        whole: true,
        sizes: (10, 10_000),
        large: None,
        measure: parts::net_drawing,
    },
    Area {
        name: "net-tasks",
        what: "booting tasks that run nets",
        whole: true,
        sizes: (10, 3_000),
        large: None,
        measure: apps::net_tasks,
    },
    Area {
        name: "displays",
        what: "a firing shown to displays",
        whole: true,
        // A net is followed by no more than 256; a display task shows it to all its pages.
        sizes: (1, 200),
        large: None,
        measure: apps::displays,
    },
    Area {
        name: "record",
        what: "recording messages",
        whole: true,
        sizes: (1_000, 3_000_000),
        large: Some(RECORD_4_GB),
        measure: apps::record,
    },
    Area {
        name: "record-read",
        what: "reading a record of messages",
        whole: true,
        sizes: (1_000, 1_000_000),
        large: None,
        measure: apps::record_read,
    },
    Area {
        name: "record-info",
        what: "counting a record of messages",
        whole: true,
        sizes: (1_000, 3_000_000),
        large: Some(RECORD_4_GB),
        measure: apps::record_info,
    },
    Area {
        name: "record-replay",
        what: "reading a record of messages for a replay",
        whole: true,
        sizes: (1_000, 1_000_000),
        large: Some(5_000_000),
        measure: apps::record_replay,
    },
    Area {
        name: "record-seek",
        what: "seeking in a record of messages",
        whole: false,
        sizes: (1_000, 3_000_000),
        large: Some(RECORD_4_GB),
        measure: apps::record_seek,
    },
    Area {
        name: "objects",
        what: "building service objects",
        whole: true,
        sizes: (10, 100_000),
        large: None,
        measure: parts::objects,
    },
    Area {
        name: "objects-find",
        what: "finding one of service objects",
        whole: false,
        sizes: (10, 100_000),
        large: None,
        measure: parts::objects_find,
    },
    Area {
        name: "readers",
        what: "a snapshot read by readers",
        whole: true,
        sizes: (1, 1_000),
        large: None,
        measure: parts::readers,
    },
];

/// The area of that name.
pub fn find(name: &str) -> Option<&'static Area> {
    AREAS.iter().find(|area| area.name == name)
}

/// The sizes of an area up to `most`, three in a decade; with the large ones, if it has any.
pub fn sizes(area: &Area, most: u64, large: bool) -> impl Iterator<Item = u64> {
    let (first, last) = area.sizes;
    let last = area.large.filter(|_| large).unwrap_or(last).min(most);
    let steps = [1, 2, 5].into_iter();
    let decades = (0..12).map(|power| 10_u64.pow(power));
    let between = decades.flat_map(move |decade| steps.clone().map(move |step| step * decade));
    let inner = between.filter(move |size| first < *size && *size < last);
    [first]
        .into_iter()
        .chain(inner)
        .chain((last > first).then_some(last))
}

/// The time that `work` takes, and the memory that it leaves taken.
///
/// # Errors
/// Those of the work.
pub fn cost<T>(work: impl FnOnce() -> Result<T, Failed>) -> Result<(Cost, T), Failed> {
    let clock = Clock::real();
    let (before, begun) = (resident()?, clock.now());
    let made = work()?;
    let seconds = clock.now().since(begun).as_secs_f64();
    let bytes = Some((resident()? - before).max(0.0));
    Ok((Cost { seconds, bytes }, made))
}

/// The least time of one of `count` steps, of some rounds, s.
///
/// # Errors
/// Those of the step.
pub fn step(count: u32, mut one: impl FnMut() -> Result<(), Failed>) -> Result<Cost, Failed> {
    let clock = Clock::real();
    let mut least = f64::INFINITY;
    for _ in 0..5 {
        let begun = clock.now();
        for _ in 0..count {
            one()?;
        }
        least = least.min(clock.now().since(begun).as_secs_f64() / f64::from(count));
    }
    Ok(Cost {
        seconds: least,
        bytes: None,
    })
}

/// Bytes that this process has in memory.
fn resident() -> Result<f64, Failed> {
    let text = std::fs::read_to_string("/proc/self/status")?;
    let line = text.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let kilobytes = line.and_then(|line| line.split_whitespace().next());
    Ok(kilobytes
        .ok_or("no VmRSS in /proc/self/status")?
        .parse::<f64>()?
        * 1024.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_rise_from_the_least_to_the_largest_that_is_wanted() {
        let names = find("names").unwrap();
        let all: Vec<u64> = sizes(names, 1_000, true).collect();
        assert_eq!(all, [10, 20, 50, 100, 200, 500, 1_000]);
        assert_eq!(sizes(names, u64::MAX, true).last(), Some(60_000));
        for area in AREAS {
            let [usual, all] = [false, true].map(|large| {
                let all: Vec<u64> = sizes(area, u64::MAX, large).collect();
                assert!(all.is_sorted_by(|a, b| a < b), "{}", area.name);
                all
            });
            assert_eq!(all.len() > usual.len(), area.large.is_some());
        }
    }

    #[test]
    fn every_area_is_measured_at_its_least_sizes() {
        // Processes are started by the program alone.
        for area in AREAS
            .iter()
            .filter(|area| !area.name.starts_with("processes"))
        {
            let size = sizes(area, u64::MAX, false).nth(1).unwrap();
            let cost = (area.measure)(size);
            let cost = cost.unwrap_or_else(|error| panic!("{} of {size}: {error}", area.name));
            assert!(cost.seconds > 0.0, "{}", area.name);
        }
    }
}

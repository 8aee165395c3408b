//! How long a processor looks for messages before it sleeps, chosen by where it and the others run.
//!
//! To wake a sleeping thread on another core costs tens of microseconds on a virtual machine. To
//! hand over to a polling one costs a fraction of one. On a core that the partner shares, polling
//! keeps the partner from answering, so it is never worth it there. To yield the core to the partner
//! before going to sleep is.

use std::time::Duration;

use crate::app::{App, ProcessorConfig};

/// Looked for on a CPU of its own, unless the configuration says otherwise.
const SPIN: Duration = Duration::from_micros(20);

/// Whether `processor` of `app` has its CPU together with another one, on a machine with `cpus` CPUs that it
/// may use.
#[must_use]
pub fn shares(app: &App, processor: &ProcessorConfig, cpus: usize) -> bool {
    let all = || app.chassis.iter().flat_map(|chassis| &chassis.processors);
    let together = |other: &&ProcessorConfig| processor.cpu.is_some() && other.cpu == processor.cpu;
    all().filter(together).count() > 1 || (cpus < 2 && all().count() > 1)
}

/// How long `processor` of `app` looks for messages, on a machine with `cpus` CPUs that it may use.
#[must_use]
pub fn spin(app: &App, processor: &ProcessorConfig, cpus: usize) -> Duration {
    if cpus < 2 || shares(app, processor, cpus) {
        return Duration::ZERO;
    }
    processor.spin.unwrap_or(match processor.cpu {
        Some(_) => SPIN,
        None => Duration::ZERO,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::load_texts;

    fn spins(processors: &str, cpus: usize) -> Vec<u128> {
        let text =
            format!("[chassis.a]\n{processors}\n[task.one]\nhandler = \"none\"\non = \"a/x\"");
        let app = load_texts(&[("spin.toml", &text)], &[], &[]).unwrap();
        let processors = app.chassis.iter().flat_map(|chassis| &chassis.processors);
        let spins = processors.map(|processor| spin(&app, processor, cpus).as_micros());
        spins.collect()
    }

    #[test]
    fn a_processor_looks_for_messages_only_where_its_partner_runs_meanwhile() {
        let own = "processors.x = { cpu = 0 }\nprocessors.y = { cpu = 1 }";
        assert_eq!(spins(own, 2), [20, 20]);
        assert_eq!(spins(own, 1), [0, 0]);
        let shared = "processors.x = { cpu = 1, spin_us = 50 }\nprocessors.y = { cpu = 1 }";
        assert_eq!(spins(shared, 2), [0, 0]);
        let loose = "processors.x = {}\nprocessors.y = { spin_us = 5 }";
        assert_eq!(spins(loose, 2), [0, 5]);
        assert_eq!(spins(loose, 1), [0, 0]);
    }
}

//! Making the thread of a processor real-time: scheduler, CPU, memory, timers; and keeping, as data, what the
//! system granted of it.
//!
//! Nothing here fails by itself. A refusal is in the log with what to do about it, and in
//! [`RealtimeGrant`]. It undoes the boot where the configuration says `realtime = "require"`.

use std::{fmt, num::NonZeroU64};

use rustix::{
    mm::{MlockAllFlags, mlockall},
    process::{Resource, getrlimit},
    thread::{CapabilitySet, CpuSet, capabilities, sched_setaffinity, set_current_timer_slack},
};

use ctos_config::ProcessorConfig;

/// The priority of a real-time processor whose configuration names none: above the kernel's threaded
/// interrupts, which have 50, and below its watchdogs, which have 99.
pub const PRIORITY: u8 = 80;

/// What became of one thing that was asked of the system.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum Grant {
    /// The configuration does not ask for it, or there is nothing to ask in virtual time.
    #[default]
    NotAsked,
    /// It was granted.
    Granted,
    /// It was refused: why, and what to do.
    Refused(String),
}

impl Grant {
    fn of<E: fmt::Display>(result: Result<(), E>, what_to_do: &str) -> Self {
        match result {
            Ok(()) => Self::Granted,
            Err(error) => Self::Refused(format!("{error}; {what_to_do}")),
        }
    }

    /// Why it was refused, if it was.
    #[must_use]
    pub fn refusal(&self) -> Option<&str> {
        match self {
            Self::Refused(why) => Some(why),
            Self::NotAsked | Self::Granted => None,
        }
    }
}

/// What the system granted to one processor.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct RealtimeGrant {
    /// The processor, `chassis/processor`.
    pub processor: String,
    /// Whether the app cannot run without.
    pub required: bool,
    /// The priority that was asked for.
    pub priority: Option<u8>,
    /// `SCHED_FIFO` at that priority.
    pub scheduler: Grant,
    /// The CPU that was asked for, counted from 0.
    pub cpu: Option<usize>,
    /// Staying on that CPU.
    pub pinned: Grant,
    /// Memory that is never paged out, present and future, of the whole chassis.
    pub memory: Grant,
    /// Timers that end at their deadline and not up to 50 µs after it.
    pub timer_slack: Grant,
}

impl RealtimeGrant {
    /// What was refused: the thing, why, and what to do.
    pub fn refusals(&self) -> impl Iterator<Item = (&'static str, &str)> {
        [
            ("the real-time scheduler", &self.scheduler),
            ("its CPU", &self.pinned),
            ("locked memory", &self.memory),
            ("exact timers", &self.timer_slack),
        ]
        .into_iter()
        .filter_map(|(what, grant)| grant.refusal().map(|why| (what, why)))
    }

    pub(crate) fn log(&self) {
        let processor = self.processor.as_str();
        for (what, why) in self.refusals() {
            tracing::warn!(
                processor,
                refused = what,
                why,
                "not real-time as asked: ticks may be late under load"
            );
        }
        if self.scheduler == Grant::Granted {
            tracing::debug!(
                processor,
                priority = self.priority,
                cpu = self.cpu,
                "real-time"
            );
        }
    }
}

#[doc(hidden)]
impl RealtimeGrant {
    /// Why the app cannot run, if this processor cannot do without what was refused.
    pub fn fatal(&self) -> Option<String> {
        let refusals = self.refusals().map(|(what, why)| format!("{what}: {why}"));
        let refusals: Vec<String> = refusals.collect();
        (self.required && !refusals.is_empty()).then(|| {
            format!(
                "realtime = \"require\", but it was refused {}",
                refusals.join("; it was refused ")
            )
        })
    }
}

/// Locks the memory of this process, what it has and what it will get, if a limit cannot make a later
/// allocation fail.
pub(crate) fn lock_memory() -> Grant {
    const HELP: &str = "raise the limit (`ulimit -l unlimited`, `memlock` in /etc/security/limits.conf) or grant CAP_IPC_LOCK";
    let limit = getrlimit(Resource::Memlock).current;
    let capable =
        capabilities(None).is_ok_and(|sets| sets.effective.contains(CapabilitySet::IPC_LOCK));
    match limit {
        Some(bytes) if !capable => Grant::Refused(format!(
            "at most {} kB may be locked, and what the chassis allocates beyond that would fail; {HELP}",
            bytes / 1024
        )),
        _ => Grant::of(
            mlockall(MlockAllFlags::CURRENT | MlockAllFlags::FUTURE),
            HELP,
        ),
    }
}

/// Prepares the calling thread for the processor of `chassis` that `config` describes, as far as the system
/// permits it. `memory` is what [`lock_memory`] granted to the chassis.
pub(crate) fn prepare_thread(
    chassis: &str,
    config: Option<&ProcessorConfig>,
    memory: &Grant,
) -> RealtimeGrant {
    let timer_slack = Grant::of(
        set_current_timer_slack(NonZeroU64::new(1)),
        "nothing is known to help",
    );
    let Some(config) = config else {
        return RealtimeGrant {
            timer_slack,
            ..RealtimeGrant::default()
        };
    };
    let priority = config.realtime.then(|| config.priority.unwrap_or(PRIORITY));
    RealtimeGrant {
        processor: format!("{chassis}/{}", config.name),
        required: config.required,
        priority,
        scheduler: priority.map_or(Grant::NotAsked, schedule_fifo),
        cpu: config.cpu,
        pinned: config.cpu.map_or(Grant::NotAsked, pin),
        memory: if config.realtime {
            memory.clone()
        } else {
            Grant::NotAsked
        },
        timer_slack,
    }
}

fn pin(cpu: usize) -> Grant {
    if cpu >= CpuSet::MAX_CPU {
        return Grant::Refused(format!("there is no CPU {cpu}; choose another `cpu`"));
    }
    let mut set = CpuSet::new();
    set.set(cpu);
    let help = format!(
        "choose a `cpu` that this process may use (`taskset -p $$` shows them) instead of {cpu}"
    );
    Grant::of(sched_setaffinity(None, &set), &help)
}

fn schedule_fifo(priority: u8) -> Grant {
    use thread_priority::{
        Error, RealtimeThreadSchedulePolicy, ThreadPriority, ThreadPriorityValue,
        ThreadSchedulePolicy, set_thread_priority_and_policy, thread_native_id,
    };
    let policy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
    let result = ThreadPriorityValue::try_from(priority)
        .map_err(|error| error.to_string())
        .and_then(|value| {
            let priority = ThreadPriority::Crossplatform(value);
            set_thread_priority_and_policy(thread_native_id(), priority, policy).map_err(|error| {
                match error {
                    Error::OS(number) => std::io::Error::from_raw_os_error(number).to_string(),
                    other => other.to_string(),
                }
            })
        });
    let help = format!(
        "raise the limit (`ulimit -r {priority}`, `rtprio` in /etc/security/limits.conf) or grant CAP_SYS_NICE"
    );
    Grant::of(result, &help)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused() -> RealtimeGrant {
        RealtimeGrant {
            processor: "cage/servo".to_owned(),
            scheduler: Grant::Refused("no; ask root".to_owned()),
            memory: Grant::Refused("no; buy more".to_owned()),
            pinned: Grant::Granted,
            ..RealtimeGrant::default()
        }
    }

    #[test]
    fn a_refusal_is_fatal_only_where_it_is_required() {
        assert_eq!(refused().fatal(), None);
        let required = RealtimeGrant {
            required: true,
            ..refused()
        };
        assert_eq!(
            required.fatal().unwrap(),
            "realtime = \"require\", but it was refused the real-time scheduler: no; ask root; it was refused locked memory: no; buy more"
        );
        let granted = RealtimeGrant {
            required: true,
            scheduler: Grant::Granted,
            ..RealtimeGrant::default()
        };
        assert_eq!(granted.fatal(), None);
    }

    #[test]
    fn a_cpu_that_the_machine_has_not_is_refused_with_advice() {
        for cpu in [CpuSet::MAX_CPU - 1, usize::MAX] {
            // In a thread of its own, should the machine have as many after all.
            let pinned = std::thread::spawn(move || pin(cpu)).join().unwrap();
            assert!(pinned.refusal().unwrap().contains("choose"), "{pinned:?}");
        }
    }

    #[test]
    fn what_the_grant_says_is_what_the_thread_has() {
        let granted =
            std::thread::spawn(|| (schedule_fifo(7), thread_priority::thread_schedule_policy()))
                .join()
                .unwrap();
        let fifo = thread_priority::ThreadSchedulePolicy::Realtime(
            thread_priority::RealtimeThreadSchedulePolicy::Fifo,
        );
        match granted {
            (Grant::Granted, policy) => assert_eq!(policy, Ok(fifo)),
            (Grant::Refused(why), policy) => {
                assert!(why.contains("ulimit -r 7"), "{why}");
                assert_ne!(policy, Ok(fifo));
            }
            (Grant::NotAsked, _) => panic!("it was asked for"),
        }
    }
}

//! Processes of this host by what stays theirs alone: their number, and when they started.

use rustix::process::{Pid, getpid, test_kill_process};
use std::fmt;

/// A process of this host. The number alone may be given to another one later.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Process {
    /// Its number.
    pub pid: u32,
    /// When it started, in clock ticks since the host did; 0 when the system does not tell.
    pub start: u64,
}

impl Process {
    /// This process.
    #[must_use]
    pub fn this() -> Self {
        let pid = u32::try_from(getpid().as_raw_nonzero().get()).unwrap_or(0);
        Self::running(pid).unwrap_or(Self { pid, start: 0 })
    }

    /// The process that has this number now, if there is one.
    #[must_use]
    pub fn running(pid: u32) -> Option<Self> {
        exists(pid).then(|| Self {
            pid,
            start: start_of(pid).unwrap_or(0),
        })
    }

    /// Whether it still runs. Where the system does not say, it does.
    #[must_use]
    pub fn is_alive(&self) -> bool {
        exists(self.pid)
            && match start_of(self.pid) {
                Some(start) => self.start == 0 || start == self.start,
                None => true,
            }
    }
}

impl fmt::Display for Process {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "process {}", self.pid)
    }
}

fn exists(pid: u32) -> bool {
    let number = i32::try_from(pid).ok().filter(|pid| *pid > 0);
    let Some(pid) = number.and_then(Pid::from_raw) else {
        return false;
    };
    // Refused is an answer too: it exists and belongs to somebody else.
    !matches!(test_kill_process(pid), Err(rustix::io::Errno::SRCH)) && !is_zombie(pid)
}

/// Ended, but not yet asked after by its parent.
fn is_zombie(pid: Pid) -> bool {
    let state = stat(pid.as_raw_nonzero().get().unsigned_abs())
        .and_then(|stat| stat.split_whitespace().next().map(|state| state == "Z"));
    state.unwrap_or(false)
}

/// Field 22 of `/proc/PID/stat`; the fields are counted after the name, which may hold anything.
fn start_of(pid: u32) -> Option<u64> {
    stat(pid)?.split_whitespace().nth(19)?.parse().ok()
}

fn stat(pid: u32) -> Option<String> {
    let text = std::fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    let (_, after) = text.rsplit_once(')')?;
    Some(after.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn this_process_runs_and_one_that_started_at_another_time_is_another() {
        let this = Process::this();
        assert!(this.is_alive() && this.start > 0);
        let earlier = Process {
            start: this.start - 1,
            ..this
        };
        assert!(!earlier.is_alive());
        assert!(!Process { pid: 0, start: 0 }.is_alive());
        assert!(
            !Process {
                pid: u32::MAX,
                start: 0
            }
            .is_alive()
        );
    }

    #[test]
    fn a_child_that_was_killed_is_dead_even_before_its_parent_asks() {
        let mut child = std::process::Command::new("cat")
            .stdin(std::process::Stdio::piped())
            .spawn()
            .unwrap();
        let process = Process::running(child.id()).unwrap();
        assert!(process.is_alive());
        child.kill().unwrap();
        while process.is_alive() {
            std::thread::yield_now();
        }
        child.wait().unwrap();
    }
}

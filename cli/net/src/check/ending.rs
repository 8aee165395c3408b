//! What ends a check before it is done: Ctrl-C, or the end of its time. The check then reports what it knows.

use std::{
    io,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
        mpsc::{self, RecvTimeoutError},
    },
    thread,
    time::Duration,
};

use pnt::analysis::stop::Stop;
use signal_hook::{consts::SIGINT, flag};

/// Waits for the end of a check.
pub(super) struct Ending {
    ended: &'static Arc<AtomicBool>,
    over: Arc<AtomicBool>,
    /// Lets the thread go that waits for the time to be over.
    _done: mpsc::Sender<()>,
}

impl Ending {
    /// From now on the first Ctrl-C ends the check, and a second one the program; so does the time, s.
    ///
    /// # Errors
    /// When the system permits no handler of signals.
    pub(super) fn new(seconds: Option<f64>) -> io::Result<Self> {
        // One for each run of the command, which is one for each program.
        let ended: &'static Arc<AtomicBool> = Box::leak(Box::default());
        flag::register_conditional_shutdown(
            SIGINT,
            i32::from(cli_common::exit::INTERRUPTED),
            Arc::clone(ended),
        )?;
        flag::register(SIGINT, Arc::clone(ended))?;
        let over = Arc::new(AtomicBool::new(false));
        let (done, waits) = mpsc::channel::<()>();
        if let Some(seconds) = seconds {
            let over = Arc::clone(&over);
            thread::spawn(move || {
                let limit = Duration::from_secs_f64(seconds);
                if waits.recv_timeout(limit) == Err(RecvTimeoutError::Timeout) {
                    over.store(true, Ordering::Relaxed);
                    ended.store(true, Ordering::Relaxed);
                }
            });
        }
        Ok(Self {
            ended,
            over,
            _done: done,
        })
    }

    /// For the analyses.
    pub(super) fn stop(&self) -> Stop {
        Stop::when(self.ended)
    }

    /// Whether Ctrl-C has ended the check.
    pub(super) fn interrupted(&self) -> bool {
        self.ended.load(Ordering::Relaxed) && !self.over.load(Ordering::Relaxed)
    }
}

//! The class `shmem_far`: reads records from a snapshot buffer of another host through a daemon there (SORMA
//! technical report, sections 1.7.2 and 2.2.5). It turns their stamps into the time here, with a bound on the error.
//!
//! Every request is an exchange that teaches the estimate of the clocks' difference; nothing is sent for that alone.

use super::answer::{NOT_YET, code, int, number, split, wrong};
use super::host::buffer;
use crate::clock::{ClockDifference, Exchange, MOST_DRIFT, Observed, USUAL_DRIFT};
use crate::object::{self, Context, Outcome, ServiceObject, Waiting};
use crate::options::OptionTable;
use crate::raise;
use crate::report::{Report, code as general};
use crate::request::Method;
use crate::transport::Transport;
use ctos::time::Instant;
use std::sync::LazyLock;

/// Numbers that `shmem_r` answers for each record.
const THERE: usize = 6;

#[derive(Debug, Clone, PartialEq)]
pub(super) struct Settings {
    daemon: String,
    name: String,
    drift: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            daemon: String::new(),
            name: String::new(),
            drift: USUAL_DRIFT,
        }
    }
}

pub(super) static OPTIONS: LazyLock<OptionTable<Settings>> = LazyLock::new(|| {
    OptionTable::new(
        "reads records from a snapshot buffer of another host. EXEC latest, all, since COUNT or history N answers as \
         shmem_r does: FMSG: the floats of the records, one after the other; opaque: their bytes; IMSG, 7 for each record: \
         its number, when it was written (ns of the app's time by the clock here), its age (ns), the generation of its \
         writer, how many were lost before it, its bytes, and the most by which time and age are wrong (ns). all goes on \
         behind the last record that was read. EXEC clock: FMSG 3, the clock there minus the clock here (s), the most \
         by which that is wrong (s), and how fast it grows (s per s); IMSG 1, how often a clock was set",
    )
    .word(
        "daemon",
        "TASK",
        "the daemon on the other host",
        |set: &mut Settings| &mut set.daemon,
    )
    .word(
        "name",
        "BUFFER",
        "name of the buffer; the flavor when empty",
        |set| &mut set.name,
    )
    .float(
        "drift",
        0.0..=MOST_DRIFT,
        "s/s",
        "how fast the two clocks may drift apart at most",
        |set| &mut set.drift,
    )
});

pub(super) struct ShmemFar {
    flavor: String,
    settings: Settings,
    clock: Option<ClockDifference>,
    /// The last record that was read.
    position: u64,
}

impl ShmemFar {
    pub(super) fn new(flavor: String) -> Self {
        Self {
            flavor,
            settings: Settings::default(),
            clock: None,
            position: 0,
        }
    }

    /// What the reader there is asked.
    fn wanted(&self, text: &str) -> Result<String, Report> {
        let words = split(text)?;
        let words: Vec<&str> = words.iter().map(String::as_str).collect();
        Ok(match words.as_slice() {
            [] | ["latest"] => "latest".to_owned(),
            ["all"] => format!("since {}", self.position),
            ["since", count] => format!("since {}", number("the number of a record", count)?),
            ["history", most] => format!("history {}", number("how many records", most)?),
            _ => {
                return Err(wrong(format!(
                    "EXEC takes latest, all, since COUNT, history N or clock, not `{text}`"
                )));
            }
        })
    }

    async fn job(&mut self, cx: &Waiting<'_>, io: &mut Transport) -> Outcome {
        if self.settings.daemon.is_empty() {
            return Err(wrong("whose buffer is it? Set -daemon TASK"));
        }
        let asks_clock = io.text.trim() == "clock";
        let request = match asks_clock {
            true => String::new(),
            false => {
                let name = buffer(&self.settings.name, &self.flavor);
                format!("shmem_r.{name} EXEC {}", self.wanted(&io.text)?)
            }
        };
        let sub = Transport::text(request);
        let t1 = cx.here().sorm().now();
        let there = format!("stamp@{}", self.settings.daemon);
        let answer = cx.call(&there, Method::Exec, sub, io).await;
        let t4 = cx.here().sorm().now();
        let mut answer = answer?;
        self.learn(t1, t4, &mut answer, io)?;
        if asks_clock {
            self.tell_clock(t4, io)
        } else {
            self.hand_on(answer, t4, io)
        }
    }

    /// Learns from an exchange and takes its two times out of the answer.
    fn learn(
        &mut self,
        t1: Instant,
        t4: Instant,
        answer: &mut Transport,
        io: &mut Transport,
    ) -> Outcome {
        let daemon = &self.settings.daemon;
        let foreign = || {
            raise!(
                general::DAEMON,
                "what `stamp@{daemon}` answered has no times; is it of another version?"
            )
        };
        let times: Vec<u64> = answer
            .ints
            .iter()
            .take(2)
            .filter_map(|time| u64::try_from(*time).ok())
            .collect();
        let [t2, t3] = times[..] else {
            return Err(foreign());
        };
        answer.ints.drain(..2);
        let [t2, t3] = [t2, t3].map(Instant::from_nanos);
        let clock = match &mut self.clock {
            Some(clock) => clock,
            none => none.insert(
                ClockDifference::new(self.settings.drift)
                    .map_err(|error| wrong(error.to_string()))?,
            ),
        };
        match clock.observe(Exchange { t1, t2, t3, t4 }) {
            Ok(Observed::Used) => Ok(()),
            Ok(Observed::Restarted) => {
                let text = format!(
                    "the clock of `{daemon}` was set, or the two drift faster than -drift says: what was known of their \
                     difference is forgotten"
                );
                io.report(Report::warning(code::CLOCK, text));
                Ok(())
            }
            Err(error) => Err(Report::error(code::CLOCK, error.to_string())),
        }
    }

    fn tell_clock(&self, now: Instant, io: &mut Transport) -> Outcome {
        io.empty();
        if let Some(clock) = &self.clock
            && let Some(difference) = clock.at(now)
        {
            io.floats.extend([
                difference.offset_ns as f64 * 1e-9,
                difference.error_ns as f64 * 1e-9,
                clock.drift(),
            ]);
            io.ints.push(int(clock.restarts()));
        }
        Ok(())
    }

    /// Hands the records on, with their stamps in the time here.
    fn hand_on(&mut self, answer: Transport, now: Instant, io: &mut Transport) -> Outcome {
        io.empty();
        io.text = answer.text;
        io.floats = answer.floats;
        io.opaque = answer.opaque;
        if io.text == NOT_YET {
            return Ok(());
        }
        for record in answer.ints.chunks_exact(THERE) {
            let [count, stamp, _age, generation, lost, bytes] = *record else {
                continue;
            };
            let stamp = Instant::from_nanos(u64::try_from(stamp).unwrap_or(0));
            let Some(here) = self.clock.as_ref().and_then(|clock| clock.correct(stamp)) else {
                continue;
            };
            let nanos = |time: u128| i64::try_from(time).unwrap_or(i64::MAX);
            io.ints.extend([
                count,
                int(here.at.as_nanos()),
                nanos(now.since(here.at).as_nanos()),
                generation,
                lost,
                bytes,
                nanos(here.error.as_nanos()),
            ]);
            self.position = self.position.max(u64::try_from(count).unwrap_or(0));
        }
        Ok(())
    }
}

impl ServiceObject for ShmemFar {
    fn exec_waiting<'a>(
        &'a mut self,
        cx: &'a Waiting<'a>,
        io: &'a mut Transport,
    ) -> object::Later<'a> {
        Some(Box::pin(self.job(cx, io)))
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let before = self.settings.clone();
        OPTIONS.ctrl(&mut self.settings, io);
        if self.settings != before {
            (self.clock, self.position) = (None, 0);
        }
        Ok(())
    }

    fn dump(&self) -> String {
        OPTIONS.dump(&self.settings)
    }
}

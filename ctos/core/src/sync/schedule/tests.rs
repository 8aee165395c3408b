use std::{io::Write, rc::Rc};

use proptest::prelude::*;

use super::*;
use crate::sync::{Tick, function::Run};

const BASE: Duration = Duration::from_nanos(1_000);

type Log = Rc<RefCell<Vec<(String, Tick)>>>;

fn settings(period: Option<Duration>, overrun: Overrun) -> ScheduleSettings {
    ScheduleSettings {
        processor: "cage/servo".to_owned(),
        period,
        overrun,
        lead: Lead::default(),
    }
}

fn schedule(overrun: Overrun) -> (Schedule, Clock) {
    let clock = Clock::virtual_clock();
    (
        Schedule::new(settings(Some(BASE), overrun), clock.clone()),
        clock,
    )
}

/// A function that writes down that it ran.
fn noting(name: &str, log: &Log) -> Synchronous {
    let (seen, me) = (log.clone(), name.to_owned());
    Synchronous::new(name, move |tick: &Tick| {
        seen.borrow_mut().push((me.clone(), *tick));
    })
}

/// Runs the schedule at each of these moments, ns.
fn run_at(schedule: &Schedule, clock: &Clock, moments: impl IntoIterator<Item = u64>) {
    for moment in moments {
        clock.advance_to(Instant::from_nanos(moment));
        schedule.run();
    }
}

fn names(log: &Log) -> Vec<String> {
    log.borrow().iter().map(|(name, _)| name.clone()).collect()
}

fn counts(log: &Log, of: &str) -> Vec<(u64, u64)> {
    let log = log.borrow();
    let ticks = log.iter().filter(|(name, _)| name == of);
    ticks
        .map(|(_, tick)| (tick.due.as_nanos() / 1_000, tick.missed))
        .collect()
}

proptest! {
    #[test]
    fn late_ticks_skip_whole_periods_and_never_burst(
        steps in proptest::collection::vec(1_u64..20_000, 1..200)
    ) {
        let clock = Clock::virtual_clock();
        let log = Log::default();
        let period = Duration::from_nanos(4_500);
        let schedule = Schedule::new(settings(None, Overrun::Skip), clock.clone());
        let handle = schedule.add(noting("f", &log).period(period)).unwrap();
        let mut now = 0;
        for step in steps {
            now += step;
            clock.advance_to(Instant::from_nanos(now));
            schedule.run();
            prop_assert!(schedule.next_due().unwrap() > clock.now());
            prop_assert!(!schedule.run(), "a second tick at one moment is a burst");
        }
        let log = log.borrow();
        let skipped: u64 = log.iter().map(|(_, tick)| tick.missed).sum();
        prop_assert_eq!(handle.statistics().missed(), skipped);
        prop_assert_eq!(handle.statistics().runs(), log.len() as u64);
        if let Some((_, last)) = log.last() {
            prop_assert_eq!(last.count, log.len() as u64 + skipped);
        }
        for (_, tick) in log.iter() {
            prop_assert_eq!(tick.due.as_nanos(), tick.count * 4_500);
            prop_assert!(tick.now.since(tick.due) < period);
        }
    }

    /// However late base ticks come, every release of a function is either taken or counted as missed. A tick
    /// takes one release at most, and only `run-late-once` takes one late.
    #[test]
    fn no_turn_is_lost_without_being_counted(
        every in 1_u64..6,
        first in 1_u64..10,
        gaps in proptest::collection::vec(1_u64..12, 1..100),
        late in any::<bool>(),
    ) {
        let overrun = if late { Overrun::RunLateOnce } else { Overrun::Skip };
        let mut releases = Releases::new(first, every);
        let (mut tick, mut taken, mut missed, mut told) = (0, 0, 0, 0);
        let mut pending = 0;
        for gap in gaps {
            tick += gap;
            let (now_missed, run) = releases.at(tick, overrun);
            missed += now_missed;
            pending += now_missed;
            if let Some(Run { tick: due, count, missed: run_missed }) = run {
                taken += 1;
                told += run_missed;
                prop_assert_eq!(run_missed, pending);
                pending = 0;
                prop_assert!(due >= first && (due - first) % every == 0);
                prop_assert_eq!(count, (due - first) / every + 1);
                let lateness = tick - due;
                prop_assert!(lateness == 0 || late && lateness < every);
            }
            let turns_due = if tick < first { 0 } else { (tick - first) / every + 1 };
            prop_assert_eq!(taken + missed, turns_due);
        }
        prop_assert_eq!(told + pending, missed);
    }

    /// Functions of any rates and phases, added at any tick in any order, run exactly at their base ticks.
    /// Within a tick they run in the order of the data flow.
    #[test]
    fn rates_and_phases_are_counted_in_base_ticks(
        functions in proptest::collection::vec((1_u64..7, 0_u64..7, 0_u64..20), 1..6),
    ) {
        let (schedule, clock) = schedule(Overrun::Skip);
        let log = Log::default();
        let mut handles = Vec::new();
        for tick in 0..60_u64 {
            run_at(&schedule, &clock, [tick * 1_000]);
            for (index, (every, phase, added)) in functions.iter().enumerate() {
                if *added == tick {
                    // Each reads what all the later ones write: they run from the last to the first.
                    let function = noting(&index.to_string(), &log)
                        .every(*every)
                        .phase(phase % every)
                        .reads((index + 1..6).map(|later| format!("s{later}")))
                        .writes([format!("s{index}")]);
                    handles.push(schedule.add(function).unwrap());
                }
            }
        }
        let mut expected = Vec::new();
        for tick in 1..60_u64 {
            for (index, (every, phase, added)) in functions.iter().enumerate().rev() {
                if *added < tick && tick % every == phase % every {
                    expected.push((index.to_string(), tick));
                }
            }
        }
        let ran: Vec<(String, u64)> = log
            .borrow()
            .iter()
            .map(|(name, tick)| (name.clone(), tick.due.as_nanos() / 1_000))
            .collect();
        prop_assert_eq!(ran, expected);
    }
}

#[test]
fn functions_of_several_tasks_run_in_the_order_of_their_data() {
    let (schedule, clock) = schedule(Overrun::Skip);
    let log = Log::default();
    let _handles = [
        schedule
            .add(noting("drive.out", &log).reads(["torque"]))
            .unwrap(),
        schedule
            .add(
                noting("arm.law", &log)
                    .reads(["position"])
                    .writes(["torque"]),
            )
            .unwrap(),
        schedule
            .add(noting("drive.in", &log).writes(["position"]))
            .unwrap(),
    ];
    run_at(&schedule, &clock, [1_000]);
    assert_eq!(names(&log), ["drive.in", "arm.law", "drive.out"]);
}

#[test]
fn a_skipped_turn_waits_for_the_next_one_or_runs_late_once() {
    for (overrun, slow) in [
        (Overrun::Skip, vec![(12, 2)]),
        (Overrun::RunLateOnce, vec![(8, 1), (12, 0)]),
    ] {
        let (schedule, clock) = schedule(overrun);
        let log = Log::default();
        let fast = schedule.add(noting("fast", &log)).unwrap();
        let _slow = schedule.add(noting("slow", &log).every(4)).unwrap();
        // Nothing runs from tick 3 to tick 9, in which the releases 4 and 8 of the slow one are.
        run_at(
            &schedule,
            &clock,
            [1_000, 2_000, 9_300, 10_000, 11_000, 12_000],
        );
        let expected = [(1, 0), (2, 0), (9, 6), (10, 0), (11, 0), (12, 0)];
        assert_eq!(counts(&log, "fast"), expected, "{overrun:?}");
        assert_eq!(counts(&log, "slow"), slow, "{overrun:?}");
        assert_eq!(fast.statistics().missed(), 6);
        assert_eq!(fast.statistics().lateness.max(), Duration::from_nanos(300));
    }
}

#[test]
fn an_overrun_that_stops_is_reported_once_and_the_schedule_runs_on() {
    let (schedule, clock) = schedule(Overrun::Stop);
    let log = Log::default();
    let said = Rc::new(RefCell::new(Vec::new()));
    let heard = said.clone();
    let function =
        noting("arm.law", &log).on_failure(move |text| heard.borrow_mut().push(text.to_owned()));
    let _handle = schedule.add(function).unwrap();
    run_at(&schedule, &clock, [1_000, 1_999, 4_500, 9_000, 10_000]);
    assert_eq!(counts(&log, "arm.law"), [(1, 0), (4, 2), (9, 4), (10, 0)]);
    assert_eq!(
        *said.borrow(),
        [
            "processor `cage/servo` missed 2 of its ticks, 0.001 ms apart; of its functions `arm.law` took longest last time, 0.000 ms; its configuration says overrun = \"stop\""
        ]
    );
}

#[test]
fn what_does_not_fit_is_refused_and_changes_nothing() {
    let (schedule, clock) = schedule(Overrun::Skip);
    let log = Log::default();
    let _law = schedule
        .add(noting("law", &log).reads(["x"]).writes(["y"]))
        .unwrap();
    let refused = |function: Synchronous| schedule.add(function).unwrap_err().to_string();
    let f = || noting("f", &log);
    for (function, expected) in [
        (
            f().period(Duration::from_micros(3) + BASE / 2),
            "`f` wants a period of 0.0000035 s, which is not a whole number of base periods of processor `cage/servo` (0.000001 s); the nearest is 0.000004 s",
        ),
        (
            f().every(0),
            "`f` has a period of nothing; it needs 1 tick, or 1 µs, or more",
        ),
        (
            f().every(3).phase(3),
            "`f` runs at every 3 ticks, so its phase is 0 to 2; 3 is not",
        ),
        (
            f().reads(["y"]).writes(["x"]),
            "the data of `law`, `f` flows in a circle (`x`, `y`); let one of them take the value of the tick before with `reads_previous`",
        ),
        (
            f().writes(["y"]),
            "the signal `y` is written by `law` and by `f`; give one of them a signal of its own",
        ),
        (
            noting("law", &log),
            "`law` is on the schedule already; drop its handle before it is put there again",
        ),
    ] {
        assert_eq!(refused(function), expected);
    }
    run_at(&schedule, &clock, [1_000]);
    assert_eq!(names(&log), ["law"]);
    let free = Schedule::new(settings(None, Overrun::Skip), clock);
    assert_eq!(
        free.add(f()).unwrap_err().to_string(),
        "`f` counts in base periods, but processor `cage/servo` has none; give it `period_s` in the configuration"
    );
}

#[test]
fn a_period_in_seconds_is_a_multiple_but_for_its_rounding() {
    let third = Duration::from_secs_f64(1.0 / 3.0);
    assert_eq!(multiple(Duration::from_secs(1), third, 1), Some(3));
    assert_eq!(multiple(Duration::from_secs(1) + BASE, third, 1), None);
    assert_eq!(multiple(third / 3, third, 1), None);
}

#[test]
fn without_a_base_period_functions_that_fit_share_the_first_ones_ticks() {
    let clock = Clock::virtual_clock();
    clock.advance_to(Instant::from_nanos(500));
    let schedule = Schedule::new(settings(None, Overrun::Skip), clock.clone());
    let log = Log::default();
    let _a = schedule.add(noting("a", &log).period(BASE * 2)).unwrap();
    let _b = schedule.add(noting("b", &log).period(BASE * 4)).unwrap();
    let _c = schedule.add(noting("c", &log).period(BASE * 3)).unwrap();
    run_at(&schedule, &clock, (500..=6_500).step_by(500));
    let ran: Vec<(String, u64)> = log
        .borrow()
        .iter()
        .map(|(name, tick)| (name.clone(), tick.now.as_nanos()))
        .collect();
    let expected = [
        ("a", 2_500),
        ("c", 3_500),
        ("a", 4_500),
        ("b", 4_500),
        ("a", 6_500),
        ("c", 6_500),
    ];
    assert_eq!(ran, expected.map(|(name, at)| (name.to_owned(), at)));
}

#[test]
fn processors_with_one_base_period_tick_together() {
    let clock = Clock::virtual_clock();
    let late: Vec<_> = [0, 300, 1_700]
        .into_iter()
        .map(|start| {
            clock.advance_to(Instant::from_nanos(start));
            let schedule = Schedule::new(settings(Some(BASE), Overrun::Skip), clock.clone());
            let handle = schedule.add(Synchronous::new("f", |_: &Tick| ())).unwrap();
            (schedule, handle)
        })
        .collect();
    clock.advance_to(Instant::from_nanos(1_999));
    for (schedule, _) in &late {
        schedule.run();
        assert_eq!(schedule.next_due(), Some(Instant::from_nanos(2_000)));
    }
}

#[test]
fn a_synchronous_function_that_panics_is_reported_and_the_others_go_on() {
    let (schedule, clock) = schedule(Overrun::Skip);
    let log = Log::default();
    let said = Rc::new(RefCell::new(String::new()));
    let heard = said.clone();
    let bad = Synchronous::new("arm.law", |_: &Tick| panic!("boom"))
        .on_failure(move |text| *heard.borrow_mut() = text.to_owned());
    let _bad = schedule.add(bad).unwrap();
    let good = schedule.add(noting("good", &log)).unwrap();
    run_at(&schedule, &clock, [1_000, 2_000, 3_000]);
    assert_eq!(
        *said.borrow(),
        "the synchronous function `arm.law` panicked: boom"
    );
    assert_eq!(log.borrow().len(), 3);
    drop(good);
    run_at(&schedule, &clock, [9_000]);
    assert_eq!((log.borrow().len(), schedule.next_due()), (3, None));
}

#[test]
fn a_synchronous_function_may_add_another_one_in_its_place_in_the_order() {
    let clock = Clock::virtual_clock();
    let schedule = Rc::new(Schedule::new(
        settings(Some(BASE), Overrun::Skip),
        clock.clone(),
    ));
    let log = Log::default();
    let kept = Rc::new(RefCell::new(Vec::new()));
    let (inner, keep, seen) = (schedule.clone(), kept.clone(), log.clone());
    let adds = move |_: &Tick| {
        let mut kept = keep.borrow_mut();
        if kept.is_empty() {
            kept.push(inner.add(noting("writer", &seen).writes(["x"])).unwrap());
        }
    };
    let _adder = schedule.add(Synchronous::new("adder", adds)).unwrap();
    let _reader = schedule.add(noting("reader", &log).reads(["x"])).unwrap();
    run_at(&schedule, &clock, [1_000, 2_000]);
    assert_eq!(names(&log), ["reader", "writer", "reader"]);
    kept.borrow_mut().clear();
    schedule.clear();
}

#[test]
fn what_runs_can_be_seen_by_name_until_its_handle_is_dropped() {
    let directory = Arc::new(Directory::default());
    let clock = Clock::virtual_clock();
    let schedule = Schedule::new(settings(Some(BASE), Overrun::Skip), clock.clone());
    let schedule = schedule.shown_in(directory.clone());
    let law = Synchronous::new("arm.law", |_: &Tick| ()).reads(["position", "load"]);
    let law = schedule.add(law).unwrap();
    let sense = Synchronous::new("arm.sense", |_: &Tick| ()).writes(["position"]);
    let _sense = schedule.add(sense.every(2)).unwrap();
    run_at(&schedule, &clock, [1_000, 2_000, 3_000, 5_000]);
    let functions = directory.functions();
    let seen: Vec<_> = functions
        .iter()
        .map(|(name, of)| (name.as_str(), of.period(), of.runs(), of.missed()))
        .collect();
    assert_eq!(
        seen,
        [("arm.law", BASE, 4, 1), ("arm.sense", BASE * 2, 1, 1)]
    );
    let views = directory.schedules();
    let order: Vec<_> = views[0]
        .functions
        .iter()
        .map(|one| one.name.as_str())
        .collect();
    assert_eq!(order, ["arm.sense", "arm.law"]);
    assert_eq!(views[0].unwritten, ["load"]);
    drop(law);
    assert!(!schedule.has("arm.law"));
    run_at(&schedule, &clock, [6_000]);
    assert_eq!(directory.functions().len(), 1);
    assert_eq!(directory.schedules()[0].functions.len(), 1);
}

#[test]
fn a_function_that_outlasts_its_tick_is_named_by_its_overruns() {
    let (schedule, clock) = schedule(Overrun::Skip);
    let (other, step) = (clock.clone(), Duration::from_nanos(700));
    let slow = move |_: &Tick| other.advance_to(other.now() + step);
    let first = schedule
        .add(Synchronous::new("first", slow.clone()))
        .unwrap();
    let second = schedule.add(Synchronous::new("second", slow)).unwrap();
    run_at(&schedule, &clock, [1_000]);
    // 1.7 µs, 2.4 µs: the next tick came due during the second one.
    assert_eq!(
        (
            first.statistics().overruns(),
            second.statistics().overruns()
        ),
        (0, 1)
    );
    assert_eq!(second.statistics().lateness.max(), step);
    assert_eq!(second.statistics().duration.max(), step);
}

#[test]
fn a_processor_wakes_for_spinning_at_most_half_a_period_before_its_tick() {
    let clock = Clock::virtual_clock();
    for (spin, wakes) in [(0, 1_000), (300, 700), (900, 500)] {
        let mut settings = settings(Some(BASE), Overrun::Skip);
        settings.lead = Lead::Fixed(Duration::from_nanos(spin));
        let schedule = Schedule::new(settings, clock.clone());
        assert_eq!(schedule.wake_at(), None);
        let _handle = schedule.add(Synchronous::new("f", |_: &Tick| ())).unwrap();
        assert_eq!(schedule.wake_at(), Some(Instant::from_nanos(wakes)));
        assert!(
            !schedule.spin_to_tick(),
            "nobody would move a virtual clock"
        );
    }
}

/// A device that ticks when somebody writes into its pipe, and fails when the pipe is closed.
struct Device(std::io::PipeReader);

impl TickSource for Device {
    fn wait(&mut self) -> std::io::Result<u64> {
        let mut ticks = [0];
        std::io::Read::read_exact(&mut self.0, &mut ticks)?;
        Ok(u64::from(ticks[0]))
    }
}

/// Paces the schedule by a device, whose thread wakes this one.
fn pace(schedule: &Schedule, device: Device) -> Result<TickSourceHandle, CyclicError> {
    let thread = std::thread::current();
    schedule.pace(device, || (), move || thread.unpark())
}

#[test]
fn a_device_paces_the_schedule_until_it_fails_and_then_the_clock_does() {
    let period = Duration::from_millis(2);
    let schedule = Schedule::new(settings(Some(period), Overrun::Skip), Clock::real());
    let (reader, mut device) = std::io::pipe().unwrap();
    let _source = pace(&schedule, Device(reader)).unwrap();
    let log = Log::default();
    let said = Rc::new(RefCell::new(Vec::new()));
    let heard = said.clone();
    let function =
        noting("f", &log).on_failure(move |text| heard.borrow_mut().push(text.to_owned()));
    let handle = schedule.add(function).unwrap();
    for ticks in [1, 1, 3, 1] {
        device.write_all(&[ticks]).unwrap();
        // Woken by the device's thread, now or later; a lost wake-up would hang the test.
        while !schedule.run() {
            std::thread::park();
        }
    }
    let seen: Vec<_> = log
        .borrow()
        .iter()
        .map(|(_, tick)| (tick.count, tick.missed))
        .collect();
    assert_eq!(seen, [(1, 0), (2, 0), (5, 2), (6, 0)]);
    assert_eq!(handle.statistics().missed(), 2);
    let again = pace(&schedule, Device(std::io::pipe().unwrap().0));
    assert!(matches!(again, Err(CyclicError::SameSource { .. })));
    drop(device);
    while said.borrow().is_empty() {
        schedule.run();
        std::thread::yield_now();
    }
    let text = said.borrow()[0].clone();
    assert!(
        text.starts_with("the tick source of processor `cage/servo` failed: "),
        "{text}"
    );
    while !schedule.run() {
        std::thread::yield_now();
    }
}

#[test]
fn a_processor_without_a_base_period_takes_no_device() {
    let schedule = Schedule::new(settings(None, Overrun::Skip), Clock::real());
    let refused = pace(&schedule, Device(std::io::pipe().unwrap().0));
    assert!(matches!(refused, Err(CyclicError::NoBase { .. })));
}

#[test]
fn in_virtual_time_the_clock_ticks_where_a_device_would() {
    let (schedule, clock) = schedule(Overrun::Skip);
    let _source = pace(&schedule, Device(std::io::pipe().unwrap().0)).unwrap();
    let log = Log::default();
    let _handle = schedule.add(noting("f", &log)).unwrap();
    run_at(&schedule, &clock, [1_000, 2_000]);
    assert_eq!(counts(&log, "f"), [(1, 0), (2, 0)]);
}

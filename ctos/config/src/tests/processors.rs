//! What a processor's table says of real time and of its synchronous functions.

use super::*;
use crate::settings::{Lead, Overrun};

fn processor(line: &str) -> ProcessorConfig {
    let text = format!("[chassis.b.processors.x]\n{line}\n[task.a]\nhandler = \"h\"\non = \"b\"\n");
    load_one(&text).unwrap().chassis[0].processors[0].clone()
}

#[test]
fn real_time_may_be_asked_for_or_required_and_learns_how_early_to_wake_unless_told() {
    let asked = |line| {
        let processor = processor(line);
        (processor.realtime, processor.required, processor.lead())
    };
    let fixed = |us| Lead::Fixed(Duration::from_micros(us));
    assert_eq!(asked("realtime = false"), (false, false, fixed(0)));
    assert_eq!(asked("realtime = true"), (true, false, Lead::Learned));
    assert_eq!(asked("realtime = \"require\""), (true, true, Lead::Learned));
    assert_eq!(
        asked("realtime = true\nspin_us = 0"),
        (true, false, fixed(0))
    );
    assert_eq!(asked("spin_us = 20"), (false, false, fixed(20)));
}

#[test]
fn a_processor_may_have_a_base_period_and_an_overrun_policy() {
    let one = processor("period_s = 0.0045\noverrun = \"run-late-once\"");
    assert_eq!(one.period, Some(Duration::from_micros(4500)));
    assert_eq!(one.overrun, Overrun::RunLateOnce);
    assert_eq!(processor("overrun = \"stop\"").overrun, Overrun::Stop);
    assert_eq!(
        (processor("").period, processor("").overrun),
        (None, Overrun::Skip)
    );
}

#[test]
fn what_a_processor_cannot_be_is_refused_with_its_place() {
    for (line, expected) in [
        (
            "realtime = \"please\"",
            "app.toml:6:12: error: processor `b/x`: `realtime` must be true, false or \"require\", found \"please\"",
        ),
        (
            "period_s = 0",
            "app.toml:6:12: error: processor `b/x`: `period_s` must be a number of seconds above 0 and at most 3600, found 0",
        ),
        (
            "overrun = \"stopp\"",
            "app.toml:6:11: error: processor `b/x`: unknown choice `stopp` for `overrun` (did you mean `stop`?)",
        ),
        (
            "spin_us = -1",
            "app.toml:6:11: error: processor `b/x`: `spin_us` must be a whole number from 0 to 10000, found -1",
        ),
        (
            "period_s = 0.0001\nspin_us = 51",
            "app.toml:7:11: error: 51 us of spinning are more than half of the period of 0.0001 s; the other tasks of the processor would starve",
        ),
    ] {
        refused_line("[chassis.b.processors.x]", line, expected);
    }
}

//! The IPC classes as a caller sees them, by lines of text.

use super::*;
use crate::dictionary::Dictionary;
use crate::object::ServiceObject;
use crate::report::Severity;
use crate::request::{Method, Reply};
use crate::transport::Transport;
use crate::words;
use ctos::time::Instant;
use std::process::{Command, Stdio};
use tempfile::TempDir;

struct Desk {
    sorm: Sorm,
    clock: Clock,
    folder: TempDir,
    host: Host,
}

fn desk(clock: Clock) -> Desk {
    let folder = tempfile::tempdir().unwrap();
    let mut dictionary = Dictionary::new();
    let recipes = [
        ("shmem_w.pose", "-floats 2 -slots 4 -description 'x m\ny m'"),
        ("shmem_r.pose", "-floats 2"),
        ("flight.pose", ""),
        ("queue.jobs", "-capacity 3"),
        ("semaphore.arm", "-permits 1"),
        ("blackboard.cell", ""),
    ];
    for (index, recipe) in recipes {
        let words = words::split(recipe).unwrap();
        dictionary.add(index, words.into_iter().map(|word| word.text).collect());
    }
    let sorm = Sorm::of("", clock.clone(), dictionary);
    let host = Host {
        app: "test".to_owned(),
        clock: clock.clone(),
        root: Some(folder.path().join("shm")),
    };
    register(&sorm, &host);
    Desk {
        sorm,
        clock,
        folder,
        host,
    }
}

impl Desk {
    fn ask(&self, line: &str) -> Transport {
        let body = self.any(line);
        assert!(body.is_ok(), "{line}: {:?}", body.reports);
        body
    }

    fn any(&self, line: &str) -> Transport {
        self.sorm.dispatch(line).parse::<Reply>().unwrap().body
    }

    fn refused(&self, line: &str) -> (i32, String) {
        let body = self.any(line);
        assert!(!body.is_ok(), "{line} must be refused");
        let report = body.reports.last().unwrap();
        assert_eq!(report.severity, Severity::Error);
        (body.code, report.text.clone())
    }
}

#[test]
fn the_objects_may_move_between_threads() {
    fn is_send<T: Send>() {}
    fn all<T: ServiceObject + Send>() {
        is_send::<T>();
    }
    all::<shmem_w::ShmemW>();
    all::<shmem_r::ShmemR>();
    all::<flight::Flight>();
    all::<queue::Queue>();
    all::<semaphore::SemaphoreObject>();
    all::<blackboard::Board>();
}

#[test]
fn what_one_object_writes_another_reads_as_latest_next_all_since_and_history() {
    let desk = desk(Clock::real());
    assert_eq!(desk.refused("shmem_r.pose EXEC").0, code::BUFFER);
    for count in 1..=3 {
        let wrote = desk.ask(&format!("shmem_w.pose EXEC FMSG 2 {count} 0.5"));
        assert_eq!(wrote.ints, [count]);
    }
    let latest = desk.ask("shmem_r.pose EXEC latest");
    assert_eq!(latest.floats, [3.0, 0.5]);
    assert_eq!(
        (latest.ints[0], latest.ints[3], latest.ints.len()),
        (3, 1, 6)
    );
    assert!(latest.ints[2] > 0 && latest.ints[1] > 0);
    assert_eq!(desk.ask("shmem_r.pose EXEC next").text, NOT_YET);
    desk.ask("shmem_w.pose EXEC FMSG 2 4 0.5");
    assert_eq!(desk.ask("shmem_r.pose EXEC next").floats, [4.0, 0.5]);
    let since = desk.ask("shmem_r.pose EXEC since 2");
    assert_eq!(since.floats, [3.0, 0.5, 4.0, 0.5]);
    assert_eq!(desk.ask("shmem_r.pose EXEC history 2").floats, since.floats);
    for count in 5..=10 {
        desk.ask(&format!("shmem_w.pose EXEC FMSG 2 {count} 0.5"));
    }
    let all = desk.ask("shmem_r.pose EXEC all");
    let counts: Vec<i64> = all.ints.chunks(6).map(|record| record[0]).collect();
    assert_eq!((counts, all.ints[4]), (vec![7, 8, 9, 10], 2));
    assert_eq!(all.reports[0].code, code::LOST);
    assert_eq!(
        all.reports[0].text,
        "2 records were overwritten before they were read"
    );
    let status = desk.ask("shmem_r.pose EXEC status").text;
    assert!(
        status.contains("4 slots of 2 floats and up to 0 bytes, 10 records"),
        "{status}"
    );
}

#[test]
fn a_reader_object_is_told_of_a_new_writer_and_of_a_new_structure() {
    let desk = desk(Clock::real());
    desk.ask("shmem_w.pose CTRL -keep");
    desk.ask("shmem_w.pose EXEC FMSG 2 1 1");
    desk.ask("shmem_r.pose CTRL -floats -1");
    desk.ask("shmem_r.pose EXEC next");
    desk.sorm.remove("shmem_w.pose");
    desk.ask("shmem_w.pose EXEC FMSG 2 2 2");
    let next = desk.ask("shmem_r.pose EXEC next");
    assert_eq!(next.floats, [2.0, 2.0]);
    assert_eq!(
        next.reports[0].text,
        "writer 2 of the buffer has taken over"
    );
    desk.ask("shmem_w.pose CTRL -floats 3");
    desk.ask("shmem_w.pose EXEC FMSG 3 7 8 9");
    let next = desk.ask("shmem_r.pose EXEC next");
    assert_eq!(next.floats, [7.0, 8.0, 9.0]);
    assert!(
        next.reports[0]
            .text
            .starts_with("the buffer was made anew, with 3 floats")
    );
}

#[test]
fn what_a_buffer_cannot_take_is_refused_and_nothing_changes() {
    let desk = desk(Clock::real());
    desk.ask("shmem_w.pose EXEC FMSG 2 1 1");
    let (code, text) = desk.refused("shmem_w.pose EXEC FMSG 1 1");
    assert_eq!(
        (code, text.as_str()),
        (5, "the buffer takes floats 2, not 1")
    );
    let huge = "shmem_w.pose CTRL -slots 1048576 -floats 1048576";
    assert!(
        desk.refused(huge)
            .1
            .starts_with("bytes in all must be 0 to")
    );
    let odd = desk.refused("shmem_w.pose CTRL -name ../up");
    assert!(odd.1.contains("cannot name a snapshot buffer"), "{odd:?}");
    assert_eq!(
        desk.ask("shmem_w.pose EXEC FMSG 2 2 2").ints,
        [1],
        "made anew after the refusal"
    );
    let wrong = desk.refused("shmem_r.pose EXEC lately").1;
    assert!(wrong.starts_with("EXEC takes latest, next, all"), "{wrong}");
    desk.ask("shmem_r.pose CTRL -floats 5");
    let other = desk.refused("shmem_r.pose EXEC").1;
    assert!(
        other.ends_with("records there have floats 2, not 5"),
        "{other}"
    );
    for class in ["shmem_w.pose", "shmem_r.pose", "flight.pose"] {
        assert!(
            desk.ask(&format!("{class} CTRL -help"))
                .text
                .contains("-name BUFFER")
        );
    }
}

#[test]
fn a_call_by_reference_of_writer_and_reader_does_not_allocate() {
    let desk = desk(Clock::real());
    let writer = desk.sorm.get("shmem_w.pose").unwrap();
    let reader = desk.sorm.get("shmem_r.pose").unwrap();
    let mut io = Transport::default();
    let mut back = Transport::default();
    for _ in 0..3 {
        io.floats.extend([1.0, 2.0]);
        writer.call(&desk.sorm, Method::Exec, &mut io);
        back.text.push_str("next");
        reader.call(&desk.sorm, Method::Exec, &mut back);
        assert!(io.is_ok() && back.is_ok(), "{:?}", back.reports);
    }
    let counted = allocation_counter::measure(|| {
        io.floats.extend([1.0, 2.0]);
        writer.call(&desk.sorm, Method::Exec, &mut io);
        back.text.clear();
        back.text.push_str("next");
        reader.call(&desk.sorm, Method::Exec, &mut back);
    });
    assert_eq!(back.floats, [1.0, 2.0]);
    assert_eq!(counted.count_total, 0);
}

#[test]
fn the_flight_recorder_dumps_text_and_csv_that_read_back_to_the_bit() {
    let desk = desk(Clock::real());
    desk.ask("shmem_w.pose EXEC FMSG 2 0.1 -3e-300");
    desk.ask("shmem_w.pose EXEC FMSG 2 nan inf");
    let text = desk.ask("flight.pose EXEC dump").text;
    let lines: Vec<&str> = text.lines().collect();
    assert!(
        lines[0].starts_with("#1 ") && lines[0].ends_with(" s x=0.1 y=-3e-300"),
        "{text}"
    );
    desk.ask("flight.pose CTRL -format csv");
    let text = desk.ask("flight.pose EXEC dump 1").text;
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!(lines[0], "count,stamp_s,generation,lost,x,y");
    assert!(
        lines[1].starts_with("2,") && lines[1].ends_with(",1,0,NaN,inf"),
        "{text}"
    );
    desk.ask("flight.pose CTRL -format mcap");
    assert!(
        desk.refused("flight.pose EXEC dump")
            .1
            .starts_with("MCAP is no text")
    );
}

#[test]
fn the_flight_recorder_follows_into_a_file_and_replaces_none() {
    for format in ["csv", "mcap"] {
        let desk = desk(Clock::real());
        let file = desk.folder.path().join(format!("flight.{format}"));
        let shown = words::word(file.to_str().unwrap());
        desk.ask(&format!("flight.pose CTRL -format {format} -file {shown}"));
        desk.ask("shmem_w.pose CTRL -slots 1000");
        desk.ask("shmem_w.pose EXEC FMSG 2 1 1");
        desk.ask("flight.pose EXEC start");
        for count in 2..=500 {
            desk.ask(&format!("shmem_w.pose EXEC FMSG 2 {count} 1"));
        }
        let stopped = desk.ask("flight.pose EXEC stop");
        assert_eq!(
            (stopped.text.as_str(), &stopped.ints[..]),
            ("idle", &[500, 0][..])
        );
        let bytes = std::fs::read(&file).unwrap();
        let counts: Vec<u64> = if format == "csv" {
            let lines = std::str::from_utf8(&bytes).unwrap().lines().skip(1);
            lines
                .map(|line| line.split(',').next().unwrap().parse().unwrap())
                .collect()
        } else {
            let messages = mcap::MessageStream::new(&bytes).unwrap();
            let count = |message: mcap::McapResult<mcap::Message<'_>>| {
                let message = message.unwrap();
                assert_eq!(message.channel.topic, "/snapshot/pose");
                let value: serde_json::Value = serde_json::from_slice(&message.data).unwrap();
                assert_eq!(value["floats"]["x"].as_f64(), value["count"].as_f64());
                value["count"].as_u64().unwrap()
            };
            messages.map(count).collect()
        };
        assert!(counts.into_iter().eq(1..=500));
        let (code, text) = desk.refused("flight.pose EXEC start");
        assert_eq!(code, code::FILE, "{text}");
        assert_eq!(std::fs::read(&file).unwrap(), bytes);
    }
}

#[test]
fn in_virtual_time_a_flight_recorder_collects_when_it_is_told() {
    let desk = desk(Clock::virtual_clock());
    let file = desk.folder.path().join("flight.txt");
    desk.ask("shmem_w.pose EXEC FMSG 2 1 1");
    desk.ask(&format!(
        "flight.pose CTRL -file {}",
        file.to_str().unwrap()
    ));
    desk.ask("flight.pose EXEC start");
    assert_eq!(desk.ask("flight.pose EXEC collect").ints, [1, 0]);
    desk.ask("shmem_w.pose EXEC FMSG 2 2 1");
    assert_eq!(desk.ask("flight.pose EXEC status").ints, [1, 0]);
    assert_eq!(desk.ask("flight.pose EXEC stop").ints, [2, 0]);
    let text = std::fs::read_to_string(file).unwrap();
    assert_eq!(
        text,
        "#1 0.000000000 s x=1.0 y=1.0\n#2 0.000000000 s x=2.0 y=1.0\n"
    );
}

#[test]
fn a_queue_gives_what_was_put_in_its_order_and_refuses_more_than_it_holds() {
    let desk = desk(Clock::real());
    desk.ask("queue.jobs EXEC put 'pick up' FMSG 2 1.5 nan IMSG 1 -3");
    desk.ask("queue.jobs EXEC put place it there");
    desk.ask("queue.jobs EXEC put");
    let (code, text) = desk.refused("queue.jobs EXEC put more");
    assert_eq!(
        (code, text.starts_with("the queue is full with 3 items")),
        (code::FULL, true)
    );
    let first = desk.ask("queue.jobs EXEC take");
    assert_eq!(
        (first.text.as_str(), &first.ints[..]),
        ("pick up", &[-3][..])
    );
    assert!(first.floats[0] == 1.5 && first.floats[1].is_nan());
    assert_eq!(desk.ask("queue.jobs EXEC take").text, "place it there");
    assert_eq!(desk.ask("queue.jobs EXEC length").ints, [1, 0]);
    assert_eq!(desk.ask("queue.jobs EXEC take").text, "");
    assert_eq!(desk.ask("queue.jobs EXEC take").text, NOT_YET);
}

#[test]
fn those_who_wait_at_a_queue_are_served_in_their_order_and_before_later_ones() {
    let desk = desk(Clock::real());
    let first = desk.ask("queue.jobs EXEC take 60").ints[0];
    let second = desk.ask("queue.jobs EXEC take 60").ints[0];
    desk.ask("queue.jobs EXEC put a");
    assert_eq!(
        desk.ask(&format!("queue.jobs EXEC claim {second}")).text,
        NOT_YET
    );
    assert_eq!(desk.ask("queue.jobs EXEC take").text, NOT_YET);
    assert_eq!(
        desk.ask(&format!("queue.jobs EXEC claim {first}")).text,
        "a"
    );
    desk.ask("queue.jobs EXEC put b");
    assert_eq!(
        desk.ask(&format!("queue.jobs EXEC claim {second}")).text,
        "b"
    );
    let gone = desk.refused(&format!("queue.jobs EXEC claim {second}"));
    assert_eq!(gone.0, code::LATE);
    let third = desk.ask("queue.jobs EXEC take 60").ints[0];
    desk.ask(&format!("queue.jobs EXEC drop {third}"));
    desk.ask("queue.jobs EXEC put c");
    assert_eq!(desk.ask("queue.jobs EXEC take").text, "c");
    for wrong in [
        "take never",
        "take -1",
        "take 1e9",
        "claim x",
        "steal",
        "put 'open",
    ] {
        assert!(
            desk.refused(&format!("queue.jobs EXEC TMSG {wrong}")).0 < 100,
            "{wrong}"
        );
    }
}

#[test]
fn a_permit_is_held_by_one_and_handed_on_in_the_order_of_asking() {
    let desk = desk(Clock::real());
    let hold = desk.ask("semaphore.arm EXEC acquire anna").ints[0];
    assert_eq!(desk.ask("semaphore.arm EXEC acquire bert").text, NOT_YET);
    let bert = desk.ask("semaphore.arm EXEC acquire bert 60").ints[0];
    let carl = desk.ask("semaphore.arm EXEC acquire carl 60").ints[0];
    assert!(
        desk.ask("semaphore.arm EXEC holders")
            .text
            .contains("anna for")
    );
    desk.ask(&format!("semaphore.arm EXEC release {hold}"));
    assert_eq!(
        desk.ask(&format!("semaphore.arm EXEC claim {carl}")).text,
        NOT_YET
    );
    assert_eq!(desk.ask("semaphore.arm EXEC acquire dora").text, NOT_YET);
    assert!(
        desk.ask(&format!("semaphore.arm EXEC claim {bert}"))
            .text
            .is_empty()
    );
    assert_eq!(
        desk.refused(&format!("semaphore.arm EXEC release {hold}"))
            .0,
        code::UNKNOWN
    );
    desk.ask("semaphore.arm EXEC forget bert");
    assert!(
        desk.ask(&format!("semaphore.arm EXEC claim {carl}"))
            .text
            .is_empty()
    );
    assert_eq!(desk.ask("semaphore.arm EXEC free").ints, [0, 0]);
    desk.ask("semaphore.arm CTRL -permits 2");
    assert_eq!(desk.ask("semaphore.arm EXEC free").ints, [1, 0]);
}

#[test]
fn a_permit_comes_back_when_the_process_that_has_it_is_killed() {
    let desk = desk(Clock::real());
    let mut child = Command::new("cat").stdin(Stdio::piped()).spawn().unwrap();
    let pid = child.id();
    desk.ask(&format!("semaphore.arm EXEC acquire child 0 {pid}"));
    let waits = desk.ask("semaphore.arm EXEC acquire anna 60").ints[0];
    assert_eq!(
        desk.ask(&format!("semaphore.arm EXEC claim {waits}")).text,
        NOT_YET
    );
    child.kill().unwrap();
    child.wait().unwrap();
    let claimed = desk.ask(&format!("semaphore.arm EXEC claim {waits}"));
    assert_eq!(claimed.text, "");
    assert_eq!(
        claimed.reports[0].text,
        "child has ended without releasing; the permit is free again"
    );
    let (_, text) = desk.refused(&format!("semaphore.arm EXEC acquire late 0 {pid}"));
    assert_eq!(text, format!("`{pid}` is no process of this host"));
}

#[test]
fn a_blackboard_tells_what_changed_and_swaps_only_what_one_has_seen() {
    let desk = desk(Clock::real());
    assert_eq!(desk.ask("blackboard.cell EXEC wait lamp 0").text, NOT_YET);
    let first = desk
        .ask("blackboard.cell EXEC set lamp 'on now' FMSG 1 0.5")
        .ints[0];
    let seen = desk.ask("blackboard.cell EXEC wait lamp 0");
    assert_eq!(
        (seen.text.as_str(), &seen.floats[..], seen.ints[0]),
        ("on now", &[0.5][..], first)
    );
    assert_eq!(
        desk.ask(&format!("blackboard.cell EXEC wait lamp {first}"))
            .text,
        NOT_YET
    );
    let second = desk
        .ask(&format!("blackboard.cell EXEC swap lamp {first} off"))
        .ints[0];
    assert!(second > first);
    let (code, text) = desk.refused(&format!("blackboard.cell EXEC swap lamp {first} on"));
    assert_eq!(code, code::CONFLICT);
    assert_eq!(
        text,
        format!("`lamp` has version {second}, not {first}; read it again")
    );
    desk.ask("blackboard.cell EXEC swap ball 0 red");
    assert_eq!(
        desk.ask(&format!("blackboard.cell EXEC changes {second}"))
            .text,
        "ball"
    );
    assert_eq!(desk.ask("blackboard.cell EXEC keys").text, "ball lamp");
    assert_eq!(desk.ask("blackboard.cell EXEC keys l").text, "lamp");
    desk.ask("blackboard.cell EXEC remove lamp");
    let (code, text) = desk.refused("blackboard.cell EXEC get bal");
    assert_eq!(
        (code, text.as_str()),
        (
            code::UNKNOWN,
            "the blackboard has no `bal`; did you mean `ball`?"
        )
    );
    let again = desk.ask("blackboard.cell EXEC set lamp").ints[0];
    assert!(again > second, "a version is never used twice");
}

#[test]
fn tickets_lapse_when_their_time_is_over() {
    use tickets::{Tickets, Turn};
    let at = Instant::from_nanos;
    let mut line = Tickets::default();
    let early = line.draw("anna", at(10)).unwrap();
    let late = line.draw("bert", at(20)).unwrap();
    line.lapse(at(9), |_| false);
    assert_eq!(line.ask(late, 1), Turn::NotYet);
    line.lapse(at(10), |_| false);
    assert_eq!(line.ask(early, 1), Turn::None);
    assert_eq!(line.ask(late, 1), Turn::Now("bert"));
}

#[test]
fn the_segments_lie_where_the_host_says() {
    let desk = desk(Clock::real());
    desk.ask("shmem_w.pose EXEC FMSG 2 1 1");
    let lines = desk.ask("flight.pose EXEC segments").text;
    assert!(lines.starts_with("pose: 1 records, the latest "), "{lines}");
    assert_eq!(
        desk.ask("flight.pose EXEC sweep").text,
        "",
        "what is written stays"
    );
    desk.ask("shmem_r.pose CTRL -app other");
    assert_eq!(desk.refused("shmem_r.pose EXEC").0, code::BUFFER);
    desk.ask("shmem_r.pose CTRL -app test");
    assert_eq!(desk.ask("shmem_r.pose EXEC").floats, [1.0, 1.0]);
    let known: Vec<String> = classes().iter().map(|class| class.name.clone()).collect();
    let registered: Vec<String> = desk
        .sorm
        .classes()
        .iter()
        .map(|class| class.name().to_owned())
        .collect();
    assert!(known.iter().all(|class| registered.contains(class)) && known.len() == 8);
    let segments = desk.host.place().unwrap().segments().unwrap();
    assert_eq!((segments[0].name.as_str(), segments[0].head), ("pose", 1));
    assert!(desk.clock.now() > Instant::START);
}

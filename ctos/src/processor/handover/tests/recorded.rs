//! What a record holds of calls from hand to hand, and that a task which made them can be replayed.

use std::collections::BTreeMap;

use super::*;
use crate::record::{Filter, Record, replay};

/// Runs these calls, recorded; also what they were answered.
fn recorded(
    folder: &Path,
    hands_over: bool,
    programs: &[(usize, Vec<Step>)],
) -> (Record, Vec<Option<Result<u64, CallError>>>) {
    let file = format!("{hands_over}.mcap");
    let begin = format!("[record]\nfile = {file:?}\n");
    let bench = Bench::of(app(folder, &begin), hands_over);
    let answers = bench.call_each(programs.to_vec());
    bench.run();
    drop(bench);
    let record = Record::read(&[folder.join(file)], &Filter::default()).unwrap();
    assert_eq!(
        (record.runs[0].torn.as_deref(), record.runs[0].lost),
        (None, 0)
    );
    (record, answers.take())
}

/// For each message, what happened to it, in order.
fn fates(record: &Record) -> BTreeMap<String, Vec<&str>> {
    let mut fates: BTreeMap<String, Vec<&str>> = BTreeMap::new();
    for entry in &record.entries {
        let line: serde_json::Value = serde_json::from_slice(&entry.json).unwrap();
        let kind = entry.channel.topic.split('/').nth(1).unwrap();
        if let Some(id) = line["id"].as_str() {
            fates.entry(id.to_owned()).or_default().push(kind);
        }
    }
    fates
}

fn at_once(record: &Record) -> usize {
    let is = |json: &[u8]| json.windows(14).any(|part| part == b"\"at_once\":true");
    record
        .entries
        .iter()
        .filter(|entry| is(&entry.json))
        .count()
}

#[test]
fn a_call_from_hand_to_hand_is_in_the_record_whole_and_as_answered_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let programs = [(0, vec![Step::Call(0, Vec::new())])];
    let (record, answers) = recorded(folder.path(), true, &programs);
    assert!(matches!(answers[..], [Some(Ok(2))]));
    assert_eq!(at_once(&record), 2);
    for (id, fate) in fates(&record) {
        assert_eq!(fate, ["message", "began", "ended", "reply"], "{id}");
    }
    let (usual, _) = recorded(folder.path(), false, &programs);
    assert_eq!(at_once(&usual), 0);
    let lines = |record: &Record| {
        record.runs[0]
            .channels
            .clone()
            .into_keys()
            .collect::<Vec<_>>()
    };
    assert_eq!(lines(&record), lines(&usual));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn calls_from_hand_to_hand_leave_the_lines_that_others_leave_and_can_be_replayed(
        programs in proptest::collection::vec((0..usize::from(TASKS), steps()), 1..5),
    ) {
        let folder = tempfile::tempdir().unwrap();
        let mut counts = Vec::new();
        for hands_over in [false, true] {
            let (record, answers) = recorded(folder.path(), hands_over, &programs);
            prop_assert!(answers.iter().all(|answer| matches!(answer, Some(Ok(_)))));
            for (id, fate) in fates(&record) {
                let place = |kind| fate.iter().position(|of| *of == kind);
                prop_assert_eq!(fate.len(), 4, "{}: {:?}", id, fate);
                prop_assert_eq!(place("message"), Some(0), "{}: {:?}", id, fate);
                prop_assert!(place("began") < place("ended"), "{}: {:?}", id, fate);
            }
            let lines: BTreeMap<_, _> = record.runs[0].channels.iter()
                .map(|(topic, (lines, _))| (topic.clone(), *lines))
                .collect();
            counts.push(lines);
            let tasks = all_tasks();
            for task in tasks.iter() {
                let app = app(folder.path(), "");
                let registry = registry(&tasks, &Log::default());
                let report = replay(app, registry, task.name(), &record).unwrap();
                prop_assert!(report.is_same(), "handed over: {}: {}", hands_over, report);
            }
        }
        prop_assert_eq!(&counts[0], &counts[1]);
    }
}

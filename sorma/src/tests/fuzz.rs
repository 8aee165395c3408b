//! Everything of this crate that reads texts or bytes from outside, fed with mutations of a kept corpus.
//!
//! What is read is also printed and read again as the same. The driver, and what a target must hold, is
//! `mutate`'s.

use crate::results::Sample;
use crate::trade::{Wanted, attributes};
use crate::{
    Dictionary, Handle, Method, ObjectName, Reply, Report, Request, Sorm, Transport, asynchronous,
    daemon, demo, words,
};
use ctos::diagnostic::Source;
use ctos::message::Data;
use mutate::Mutator;
use std::path::Path;

/// What is done with an input.
type Target = fn(&[u8]);

const TARGETS: [(&str, Target); 7] = [
    ("request", request),
    ("reply", reply),
    ("options", options),
    ("dictionary", dictionary),
    ("names", names),
    ("dispatch", dispatch),
    ("payload", payload),
];

/// Pieces that mean something to one target or another.
const PIECES: [&str; 40] = [
    " EXEC",
    " CTRL",
    " DBX",
    " RET 0",
    " RET -1",
    " TMSG ",
    " FMSG 2 1 -0.0",
    " IMSG 1 7",
    " TDBX ",
    "FMSG 18446744073709551615",
    "nan:7ff8000000000001",
    "nan",
    "-inf",
    "1e-400",
    "5e-324",
    "'",
    "\"",
    "\\",
    "\\u{1f600}",
    "\\u{",
    "\n",
    "\t",
    "\u{0}",
    "é",
    "@d1",
    "@self",
    "@h:0x14",
    ".a",
    "#",
    " -SUBST foo.a",
    " -tea 1.5",
    " -where garden",
    " -dump",
    " -help",
    "error 5 a b 1 c 2 \"d\"",
    "trade",
    "<=",
    "!=",
    " -least ",
    "-9223372036854775808",
];

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// What is read is printed, and read from that as the same.
fn request(bytes: &[u8]) {
    if let Ok(read) = text(bytes).parse::<Request>() {
        let line = read.to_text().unwrap();
        let again = line.parse::<Request>().unwrap();
        assert_eq!(again.to_text().unwrap(), line);
        assert_eq!(again.body.text, read.body.text);
        assert_eq!(again.body.reports, read.body.reports);
    }
}

fn reply(bytes: &[u8]) {
    let text = text(bytes);
    if let Ok(read) = text.parse::<Reply>() {
        let line = read.to_text().unwrap();
        let again = line.parse::<Reply>().unwrap();
        assert_eq!(again.to_text().unwrap(), line);
        assert_eq!(again.body.code, read.body.code);
    }
    for line in text.lines() {
        let report = Report::from_line(line);
        assert_eq!(Report::from_line(&report.to_line()), report);
    }
}

fn kitchen() -> Sorm {
    let mut dictionary = Dictionary::new();
    dictionary
        .load(&Source::new("demo", demo::DICTIONARY))
        .unwrap();
    let sorm = Sorm::new(dictionary);
    demo::register(&sorm);
    asynchronous::register(&sorm);
    sorm
}

fn ctrl(sorm: &Sorm, object: &Handle, text: &str) -> Transport {
    let mut io = Transport::text(text);
    object.call(sorm, Method::Ctrl, &mut io);
    io
}

/// Options that are wrong leave the object as it was, and a dump is taken back.
fn options(bytes: &[u8]) {
    let sorm = kitchen();
    for name in ["foo", "bar", "later", "stream"] {
        let object = sorm.get(name).unwrap();
        let before = object.dump();
        let io = ctrl(&sorm, &object, &text(bytes));
        let after = object.dump().unwrap();
        if !io.is_ok() {
            assert_eq!(before.as_ref(), Some(&after));
        }
        let options = after.lines().next().unwrap();
        let io = ctrl(&sorm, &object, options);
        assert!(io.is_ok(), "{options}: {:?}", io.reports);
        assert_eq!(object.dump().unwrap(), after);
    }
}

/// A file is read as a whole or not at all, and every recipe ends.
fn dictionary(bytes: &[u8]) {
    let source = Source::new("fuzz.dict", text(bytes));
    let mut dictionary = Dictionary::new();
    match dictionary.load(&source) {
        Ok(()) => {
            for index in dictionary.index() {
                let _ = dictionary.recipe(index);
                let words = dictionary.entry(index).unwrap();
                let _ = Wanted::read(index, words);
            }
        }
        Err(findings) => {
            assert!(findings.iter().all(|finding| finding.place.is_some()));
            assert_eq!(dictionary, Dictionary::new());
        }
    }
    let variables = [("SORMA_foo__a".to_owned(), text(bytes))];
    let _ = dictionary.load_environment(variables);
}

fn names(bytes: &[u8]) {
    let text = text(bytes);
    if let Ok(name) = text.parse::<ObjectName>() {
        assert_eq!(name.to_string().parse::<ObjectName>().unwrap(), name);
    }
    if let Ok(split) = words::split(&text) {
        let split: Vec<String> = split.into_iter().map(|word| word.text).collect();
        let joined = words::join(split.iter().map(String::as_str));
        let again = words::split(&joined).unwrap();
        let again: Vec<String> = again.into_iter().map(|word| word.text).collect();
        assert_eq!(again, split);
        if let Ok(wanted) = Wanted::read("FOO", &split) {
            let _ = wanted.is_met_by(&attributes(&text).unwrap_or_default());
        }
    }
}

/// Any line is answered by one that can be read, and the manager goes on.
fn dispatch(bytes: &[u8]) {
    let sorm = kitchen();
    for line in text(bytes).lines() {
        let first = line.split_whitespace().next().unwrap_or_default();
        // Requests that would write files are none of this.
        if line.contains("-save") || line.contains("-reload") || first.starts_with("flight") {
            continue;
        }
        let answer = sorm.dispatch(line);
        assert!(answer.parse::<Reply>().is_ok(), "{answer}");
    }
    // Lines may rightly spoil a recipe or lock an object; what they say of the manager is still answered.
    let answer = sorm.dispatch("sorm DBX -version");
    assert!(answer.parse::<Reply>().is_ok(), "{answer}");
}

/// What a daemon and its callers send each other.
fn payload(bytes: &[u8]) {
    let data = || Data::Bytes(bytes.to_vec());
    let _ = data().take::<daemon::Ask>();
    let _ = data().take::<daemon::Tell>();
    let _ = data().take::<daemon::Say>();
    let _ = data().take::<Transport>();
    let _ = data().take::<Option<Vec<Sample>>>();
}

/// What this version itself takes or writes for a target.
fn own(target: &str) -> Vec<Vec<u8>> {
    let texts: &[&str] = match target {
        "request" => &[
            "foo.a@d1 EXEC TMSG 'a b' FMSG 2 1.5 nan IMSG 1 -3 TDBX \"watch\\nthe ice\"",
            "FOO CTRL -breakfast on -where garden",
        ],
        "reply" => {
            &["foo.a RET 5 TMSG text FMSG 1 -0.0 TDBX \"error 5 foo.a cage 12 a.rs 7 \\\"no\\\"\""]
        }
        "options" => &[
            "-tea 1.5 -ice crushed",
            "-breakfast -where kitchen -dump",
            "-from a -keep every -capacity 3",
        ],
        "dictionary" => &[
            demo::DICTIONARY,
            "FOO trade arm=left price<=3 -least price -among d1,d2\nd1 self # here\na \\\n -SUBST b\n",
        ],
        "names" => &[
            "foo.a@druide:0x14",
            "SCALE.two",
            "arm=left 'note=two words' -most speed",
        ],
        "dispatch" => &[
            "foo.a EXEC\nbar EXEC\nfoo.a CTRL -drink bar\nfoo.a EXEC",
            "dict CTRL -add foo.c '-SUBST foo.a -tempo adagio'\nfoo.c EXEC\nsorm CTRL -list -free foo.c",
            "later EXEC ask 'bar EXEC'\nlater EXEC collect 1\nfork EXEC 'bar EXEC' 'foo.a EXEC'",
            "stream CTRL -from bar -keep every\nstream EXEC begin\nbar EXEC\nstream EXEC next\nstream EXEC status",
            "sorm CTRL -lock bar 10 -prepare p 'bar EXEC' -abort p -offer bar 'a=1' -offers -market",
        ],
        _ => &[],
    };
    let mut own: Vec<Vec<u8>> = texts.iter().map(|text| text.as_bytes().to_vec()).collect();
    if target == "payload" {
        let mut body = Transport::floats([1.0, f64::NAN]).from("client@desk");
        body.text = "fkine".to_owned();
        body.report(Report::warning(101, "the glass is cold"));
        own.push(Data::of(body).into_bytes().unwrap());
    }
    own
}

fn play(name: &str) {
    let (_, target) = TARGETS.iter().find(|(found, _)| *found == name).unwrap();
    let mutator = Mutator {
        corpus: Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/corpus"),
        words: &PIECES,
        longest: 2048,
        seconds: 7.0,
        targets: TARGETS.len() as u32,
    };
    mutator.play(name, own(name), target);
}

#[test]
fn requests_take_any_text() {
    play("request");
}

#[test]
fn replies_and_reports_take_any_text() {
    play("reply");
}

#[test]
fn options_take_any_text() {
    play("options");
}

#[test]
fn dictionaries_take_any_text() {
    play("dictionary");
}

#[test]
fn names_and_requirements_take_any_text() {
    play("names");
}

#[test]
fn the_manager_answers_any_line() {
    play("dispatch");
}

#[test]
fn payloads_take_any_bytes() {
    play("payload");
}

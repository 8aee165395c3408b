//! `scott --local` as a person or a script meets it: known answers, scripts, and every kind of bad input.

use std::{
    fs,
    io::Write,
    process::{Command, Stdio},
};

use crate::common::root;
use serde_json::Value;
use sorma::Reply;

/// How a run ended: exit code, standard output, standard error.
struct Ended {
    code: Option<i32>,
    out: String,
    err: String,
}

impl Ended {
    /// The replies on standard output; each is printed again to what reads back as the same.
    fn replies(&self) -> Vec<Reply> {
        let lines = self.out.lines().filter(|line| !line.starts_with('#'));
        let replies = lines.map(|line| {
            let reply: Reply = line.parse().expect("a reply reads back");
            let again = reply.to_text().expect("no reply has opaque bytes");
            assert_eq!(again.parse().as_ref(), Ok(&reply));
            reply
        });
        replies.collect()
    }
}

fn run_with(arguments: &[&str], input: &[u8]) -> Ended {
    let mut child = Command::new(env!("CARGO_BIN_EXE_scott"))
        .current_dir(root())
        .arg("--local")
        .args(arguments)
        .env("NO_COLOR", "1")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("scott runs");
    let mut stdin = child.stdin.take().expect("a pipe");
    let bytes = input.to_vec();
    // It may end before it has read everything.
    let feeder = std::thread::spawn(move || drop(stdin.write_all(&bytes)));
    let output = child.wait_with_output().expect("scott ends");
    feeder.join().expect("the input is written");
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    Ended {
        code: output.status.code(),
        out: text(&output.stdout),
        err: text(&output.stderr),
    }
}

fn run(arguments: &[&str]) -> Ended {
    run_with(arguments, b"")
}

fn script(text: &str) -> Ended {
    run_with(&[], text.as_bytes())
}

/// The one reply to one request.
fn ask(request: &str) -> Reply {
    let ended = run(&["-c", request]);
    assert_eq!(ended.code, Some(0), "{}", ended.err);
    assert_eq!(ended.err, "");
    let mut replies = ended.replies();
    assert_eq!(replies.len(), 1);
    replies.remove(0)
}

fn near(found: &[f64], expected: &[f64], within: f64) {
    assert_eq!(found.len(), expected.len());
    for (found, expected) in found.iter().zip(expected) {
        assert!(
            (found - expected).abs() <= within,
            "{found} is not {expected}"
        );
    }
}

const POSE: &str = "FMSG 6 0.5 -0.5 0.5 -0.5 0.5 -0.5";

#[test]
fn the_arm_answers_with_the_published_numbers() {
    let zero = ask("kin.puma560 EXEC TMSG fkine FMSG 6 0 0 0 0 0 0").body;
    assert!(zero.text.is_empty() && zero.ints.is_empty() && zero.reports.is_empty());
    #[rustfmt::skip]
    let expected = [
        1.0, 0.0, 0.0, 0.4521, 0.0, 1.0, 0.0, -0.15005, 0.0, 0.0, 1.0, 1.10363, 0.0, 0.0, 0.0, 1.0,
    ];
    near(&zero.floats, &expected, 1e-12);
    let gravity = ask(&format!("dyn.puma560 EXEC TMSG gravity {POSE}")).body;
    let published = [0.0, 33.404_608_849, 0.237_041_794, 0.0, -0.013_545_114, 0.0];
    near(&gravity.floats, &published, 5e-10);
    let jacobian = ask(&format!("kin.puma560 EXEC TMSG jacobian {POSE}")).body;
    assert_eq!(jacobian.floats.len(), 36);
    let inertia = ask(&format!("dyn.puma560 EXEC TMSG inertia {POSE}")).body;
    assert_eq!(inertia.floats.len(), 36);
}

#[test]
fn a_script_has_variables_expectations_and_the_last_reply() {
    let ended = script(
        "# forward and back\n\
         set q = 0.1 0.5 -2.0 \\\n\
             0.3 0.4 0.5\n\
         kin.puma560 EXEC TMSG fkine FMSG 6 $q\n\
         expect RET 0\n\
         set pose = $FMSG\n\
         kin.puma560 CTRL -turns near -near $q\n\
         kin.puma560 EXEC TMSG ikine FMSG $pose\n\
         expect RET 0\n\
         dyn.puma560 EXEC TMSG rne FMSG 18 0.5 -0.5 0.5 -0.5 0.5 -0.5 1 1 1 1 1 1 1 1 1 1 1 1\n\
         expect RET 0 FMSG 6 2.162084304 34.157004464 1.338393456 0.005147848 -0.008551583 0.000019806 within 1e-9\n\
         kin.puma560 EXEC TMSG fkin\n\
         expect RET 9 TDBX 'did you mean `fkine`?'\n",
    );
    assert_eq!(
        (ended.code, ended.err.as_str()),
        (Some(0), ""),
        "{}",
        ended.out
    );
    let replies = ended.replies();
    assert_eq!(replies.len(), 5);
    let solutions: Vec<&[f64]> = replies[2].body.floats.chunks(6).collect();
    assert_eq!(
        replies[2].body.ints,
        [i64::try_from(solutions.len()).expect("few")]
    );
    let given = [0.1, 0.5, -2.0, 0.3, 0.4, 0.5];
    let same = |found: &&&[f64]| found.iter().zip(&given).all(|(a, b)| (a - b).abs() < 1e-9);
    assert_eq!(solutions.iter().filter(same).count(), 1);
}

#[test]
fn what_fails_is_named_with_its_line_and_stops_the_script_unless_told_otherwise() {
    let text = "bar EXEC\n\nbar CTRL -te 1\nexpect RET 0\nbar EXEC\n";
    let ended = script(text);
    assert_eq!(ended.code, Some(1));
    assert_eq!(ended.replies().len(), 2);
    assert_eq!(ended.err, "standard input:4: expected RET 0, got 4\n");
    let ended = run_with(&["-k"], text.as_bytes());
    assert_eq!((ended.code, ended.replies().len()), (Some(1), 3));
    // An error that nothing expects is a failure by itself.
    let ended = script("bar CTRL -te 1\nbar EXEC\n");
    assert_eq!((ended.code, ended.replies().len()), (Some(1), 1));
    let message = "unknown option `-te`; did you mean `tea`?";
    assert!(
        ended.err.contains("bar ended with 4") && ended.err.contains(message),
        "{}",
        ended.err
    );
    let ended = script("bar EXEC\nexpect FMSG 2 1.5 0.31 within 1e-3\n");
    assert_eq!(ended.code, Some(1));
    let message =
        "standard input:2: expected FMSG value 2 to be 0.31 within 0.001, got 0.3 (off by ";
    assert!(ended.err.starts_with(message), "{}", ended.err);
}

#[test]
fn exit_codes_are_those_of_ctos() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = |name: &str, text: &str| {
        let path = folder.path().join(name);
        fs::write(&path, text).expect("a file");
        path.display().to_string()
    };
    let good = file("good.sor", "bar EXEC\n");
    let wrong = file("wrong.sor", "bar EXEC\nexpcet\n");
    let unset = file("unset.sor", "bar EXEC FMSG $n\n");
    let dictionary = file("own.dict", "bar.strong -tea 2 -lemon 0\n");
    let broken = file("broken.dict", "a 'b\n");
    let gone = folder.path().join("gone").display().to_string();
    let cases: [(&[&str], i32); 13] = [
        (&["-f", &good], 0),
        (&["--dict", &dictionary, "-c", "bar.strong EXEC"], 0),
        (&["-c", "bar EXEC FMSG 1 2"], 1),
        (&["-c", "bar EXEC", "-c", "expect RET 1"], 1),
        (&["-c", "expect RET 0"], 2),
        (&["--no-such-flag"], 2),
        (&["-f", &wrong], 1),
        (&["-f", &unset], 3),
        (&["-f", &gone], 3),
        (&["--dict", &broken, "-c", "bar EXEC"], 3),
        (&["-c", "bra EXEC"], 4),
        (&["-c", "foo.z EXEC"], 4),
        (&["-c", "foo.a@nowhere EXEC"], 5),
    ];
    for (arguments, code) in cases {
        let ended = run(arguments);
        assert_eq!(
            ended.code,
            Some(code),
            "{arguments:?}: {}{}",
            ended.out,
            ended.err
        );
        assert!(code == 0 || !ended.err.is_empty(), "{arguments:?} says why");
    }
}

#[test]
fn the_dictionary_example_of_the_report_works_as_printed_with_foo_for_carry() {
    let ended = run(&[
        "-c",
        "dict CTRL -add foo.slow '-SUBST foo -transferSpeed 0.2'",
        "-c",
        "foo.slow EXEC FMSG 6 3 4 0 4 5 0",
        "-c",
        "expect RET 0 FMSG 1 0.2",
        "-c",
        "foo EXEC FMSG 6 4 5 0 3 4 0",
        "-c",
        "expect RET 0 FMSG 1 0.8",
    ]);
    assert_eq!((ended.code, ended.err.as_str()), (Some(0), ""));
    assert_eq!(ended.replies().len(), 3);
}

#[test]
fn json_has_one_object_a_line_with_the_same_content() {
    let ended = run(&[
        "--json",
        "-c",
        "bar EXEC",
        "-c",
        "time bar EXEC",
        "-k",
        "-c",
        "bra EXEC",
    ]);
    assert_eq!(ended.code, Some(4));
    let lines: Vec<Value> = ended
        .out
        .lines()
        .map(|line| serde_json::from_str(line).expect("JSON"))
        .collect();
    assert_eq!(lines.len(), 3);
    assert_eq!(lines[0]["name"], "bar");
    assert_eq!(lines[0]["ret"], 0);
    assert_eq!(lines[0]["floats"], serde_json::json!([1.5, 0.3]));
    assert!(lines[0].get("time_us").is_none() && lines[1]["time_us"].is_number());
    assert_eq!(lines[2]["ret"], 2);
    assert_eq!(lines[2]["reports"][0]["severity"], "error");
}

#[test]
fn requests_are_timed_and_a_failure_ends_the_repetition() {
    let ended = script("repeat 50 bar EXEC\ntime bar EXEC\n");
    assert_eq!(ended.code, Some(0));
    assert_eq!(ended.replies().len(), 2);
    let comments: Vec<&str> = ended
        .out
        .lines()
        .filter(|line| line.starts_with('#'))
        .collect();
    assert!(comments[0].starts_with("# repeat 50: min ") && comments[0].contains("median"));
    assert!(comments[1].starts_with("# time "));
    let ended = script("repeat 50 bra EXEC\n");
    assert_eq!(ended.code, Some(4));
    assert!(ended.out.contains("# repeat 1:"), "{}", ended.out);
}

#[test]
fn bad_lines_are_refused_with_their_place_and_the_next_line_runs() {
    let mut input = Vec::new();
    input.extend(b"bar EXEC TMSG ");
    input.resize(100 << 20, b'x');
    input.extend(b"\nbar EXEC\n\xff\xfebar EXEC\nbar EXEC 'open\nbar TALK\nbar EXEC FMSG 3 1\n$x\nbar EXEC\n");
    let ended = run_with(&["-k"], &input);
    assert_eq!(ended.code, Some(3), "the first failure's code");
    let said: Vec<&str> = ended.err.lines().collect();
    assert_eq!(
        said[0],
        "standard input:1: the line has 104857601 bytes; lines up to 16777216 bytes are read"
    );
    assert_eq!(said[1], "standard input:3: byte 1 of the line is not UTF-8");
    let has = |text: &str| assert!(ended.err.contains(text), "{text}: {}", ended.err);
    has("the quote at byte 9 is not closed");
    has("after the name stands EXEC, CTRL or DBX, not `TALK`");
    has("FMSG announces 3 values, but 1 follow");
    has("standard input:7: nothing was set for `$x`");
    let good = ended
        .replies()
        .iter()
        .filter(|reply| reply.body.is_ok())
        .count();
    assert_eq!(good, 2);
}

#[test]
fn a_long_text_is_refused_shortly() {
    let mut input = b"kin EXEC TMSG ".to_vec();
    input.resize(10 << 20, b'x');
    let ended = run_with(&[], &input);
    assert_eq!(ended.code, Some(1));
    assert!(ended.out.len() < 2000 && ended.err.len() < 2000);
    assert!(
        ended.err.contains("this class has fkine, jacobian, ikine"),
        "{}",
        ended.err
    );
}

#[test]
fn unknown_names_and_options_are_answered_with_the_nearest() {
    let cases = [
        (
            "kim.puma560 EXEC",
            "there is no class `kim`; did you mean `kin`?",
        ),
        ("kin.puma56 EXEC", "did you mean `kin.puma560`?"),
        (
            "dyn CTRL -rotr on",
            "unknown option `-rotr`; did you mean `rotor`?",
        ),
        ("resect CTRL -model brwn5", "did you mean `brown5`?"),
        (
            "dyn EXEC TMSG graviti FMSG 6 0 0 0 0 0 0",
            "did you mean `gravity`?",
        ),
        (
            "resect CTRL -size 640",
            "-size: write -size W H, each 1..100000 px",
        ),
        ("spot EXEC TMSG no/such.png", "cannot read `no/such.png`"),
        ("spot EXEC camera west", "there is no camera `west` here"),
    ];
    for (request, text) in cases {
        let ended = run(&["-c", request]);
        assert!(ended.code != Some(0));
        assert!(ended.err.contains(text), "{request}: {}", ended.err);
    }
}

#[test]
fn a_picture_and_a_table_are_answered_from_files() {
    let folder = tempfile::tempdir().expect("a folder");
    let picture = folder.path().join("lamp.png");
    let places = (0..60).flat_map(|v| (0..80).map(move |u| (u, v)));
    let grey = places.map(|(u, v)| {
        let square = (f64::from(u) - 33.25).powi(2) + (f64::from(v) - 21.5).powi(2);
        (30.0 + 180.0 * (-0.5 * square / 6.25).exp()).round() as u8
    });
    let file = std::fs::File::create(&picture).expect("a file");
    vss::png::write(file, 80, 60, &grey.collect::<Vec<_>>()).expect("a picture");
    let spots = ask(&format!("spot EXEC TMSG {}", picture.display())).body;
    assert_eq!(spots.ints, [1]);
    near(&spots.floats[..2], &[33.25, 21.5], 0.02);
    // A camera at the origin looking along z, without distortion: u = 500 x/z + 320, v = 510 y/z + 240.
    let mut table = String::from("X,Y,Z,u,v\n");
    for k in 0..40 {
        let at = f64::from(k);
        let (x, y, z) = (
            (at * 1.3).sin(),
            0.7 * (at * 2.1).cos(),
            3.0 + (at * 0.9).sin(),
        );
        let (u, v) = (500.0 * x / z + 320.0, 510.0 * y / z + 240.0);
        table.push_str(&format!("{x:?},{y:?},{z:?},{u:?},{v:?}\n"));
    }
    let path = folder.path().join("lights.csv");
    fs::write(&path, table).expect("a table");
    let ended = run(&[
        "-c",
        "resect CTRL -size 640 480 -model none",
        "-c",
        &format!("resect EXEC TMSG {}", path.display()),
    ]);
    assert_eq!(ended.code, Some(0), "{}", ended.err);
    let camera = &ended.replies()[1].body.floats;
    let expected = [500.0, 510.0, 320.0, 240.0];
    near(&camera[..4], &expected, 1e-6);
    near(&camera[4..], &[0.0; 12], 1e-6);
}

#[test]
fn help_is_there_and_without_an_app_it_names_local() {
    let output = Command::new(env!("CARGO_BIN_EXE_scott"))
        .arg("--help")
        .output()
        .expect("scott runs");
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(
        output.status.success() && text.contains("expect RET 0") && text.contains("Exit codes:")
    );
    // Without --local it looks for a running app, and says so where there is none.
    let nowhere = tempfile::tempdir().expect("a folder");
    let output = Command::new(env!("CARGO_BIN_EXE_scott"))
        .env("XDG_RUNTIME_DIR", nowhere.path())
        .output()
        .expect("scott runs");
    assert_eq!(output.status.code(), Some(5));
    assert!(String::from_utf8_lossy(&output.stderr).contains("--local"));
}

#[test]
fn scripts_have_help_and_list_and_their_replies_stay_as_they_were() {
    let ended = run(&[
        "-c",
        "list puma",
        "-c",
        "? kin",
        "-c",
        "kin ?",
        "-c",
        "help",
    ]);
    assert_eq!((ended.code, ended.err.as_str()), (Some(0), ""));
    assert!(ended.out.starts_with("dyn  "), "{}", ended.out);
    assert!(ended.out.contains("kin.puma560") && ended.out.contains("EXEC fkine 6 NUMBERS"));
    assert!(ended.out.contains("Statements, one a line"));
    let unknown = run(&["-c", "help kim"]);
    assert_eq!(unknown.code, Some(4));
    assert!(
        unknown.err.contains("did you mean `kin`?"),
        "{}",
        unknown.err
    );
    let json = run(&["--json", "-c", "list puma"]);
    let first: Value =
        serde_json::from_str(json.out.lines().next().expect("a line")).expect("JSON");
    assert_eq!(
        first["names"],
        serde_json::json!(["dyn.puma560", "dyn.puma600"])
    );
    // Numbers need FMSG in a script, and the answer says so; a name alone is not a request.
    let plain = run(&["-c", "kin EXEC fkine 0 0 0 0 0 0"]);
    assert_eq!(plain.code, Some(1));
    assert!(
        plain.err.contains("write FMSG 6 and the numbers"),
        "{}",
        plain.err
    );
    assert!(!plain.err.contains(".rs:"), "{}", plain.err);
    assert_eq!(run(&["-c", "kin"]).code, Some(1));
    let reply = run(&["-c", "bar EXEC"]);
    assert_eq!(reply.out, "bar RET 0 FMSG 2 1.5 0.3\n");
}

//! Programs that do not what they should: each is named with its task, and nothing else suffers.

use std::{fs, time::Duration};

use ctos::{diagnostic::Finding, task::Context};
use serde_json::json;

use crate::common::{app_text, ask, load, person, registry, run};

const TOML: (&str, &str) = (
    "detector.toml",
    "[command.find]\nrequest = { number = \"int\" }\nreply = \"int\"\n",
);

/// A program of the shell that says hello, and then what is given. Steps go back as they came.
fn script(after_hello: &str) -> String {
    let script = format!(
        "read l; echo '{{\"hello\":{{\"protocol\":1}}}}'; read l; echo \"$l\"\n{after_hello}\n"
    );
    args_of(&script)
}

fn args_of(script: &str) -> String {
    let script = script.replace("${", "$${");
    format!(
        "command = [\"sh\", \"-c\", '''{script}''']\ndeclares = \"detector.toml\"\ngrace_s = 0.3"
    )
}

/// Answers messages, `find` by what is given.
fn answering(find: &str) -> String {
    script(&format!(
        "n=0; while read l; do case \"$l\" in *'\"step\"'*) echo \"$l\";; *'\"message\"'*) n=$((n+1)); {find};; esac; done"
    ))
}

async fn find(cx: &Context) -> Result<String, String> {
    let found = ask(cx, "detector", "find", json!({"number": 1})).await;
    found.map(|value| value.to_string())
}

/// What the caller of a program is told, when another task answers after that as ever.
fn told(args: &str) -> String {
    let does = person(|cx| async move {
        let found = find(&cx).await.unwrap_or_else(|why| why);
        // Nothing else suffers.
        ask(&cx, "sum", "add", json!({"number": 1})).await?;
        Ok(found)
    });
    run(&[TOML], &app_text(args, "restart = \"on-failure\"\n"), does).unwrap()
}

/// The app with it cannot be booted, or fails: why.
fn fails(args: &str) -> String {
    run(
        &[TOML],
        &app_text(args, ""),
        person(|cx| async move { find(&cx).await }),
    )
    .unwrap_err()
}

#[test]
fn garbage_is_shown_with_the_name_of_the_task() {
    let args = answering("echo 'Loading weights ... 100%'");
    let text = told(&args);
    assert!(
        text.contains("`detector`") && text.contains("no line of the protocol"),
        "{text}"
    );
    assert!(text.contains("Loading weights"), "{text}");
    let error = fails(&args_of("echo Loading"));
    assert!(
        error.contains("detector") && error.contains("said no hello") && error.contains("Loading"),
        "{error}"
    );
    let text = told(&answering("printf '\\377\\376\\n'"));
    assert!(text.contains("no UTF-8"), "{text}");
}

#[test]
fn a_closed_pipe_is_the_end_of_the_program() {
    let text = told(&answering("exec 1>&-; sleep 100"));
    assert!(text.contains("closed its output, and was killed"), "{text}");
    let text = told(&answering("echo gone >&2; exit 7"));
    assert!(
        text.contains("ended with exit code 7; its last words: gone"),
        "{text}"
    );
    let text = told(&answering("kill -9 $$"));
    assert!(text.contains("was ended by signal 9"), "{text}");
}

#[test]
fn what_a_program_starts_ends_with_it() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("pid").display().to_string();
    // The child holds the pipes, and its parent goes without it; another one is there at the stop.
    for find in [
        "sleep 1000 & echo $! > PID; exit 1",
        "sleep 1000 & echo $! > PID; echo '{\"reply\":{\"id\":1,\"data\":1}}'",
    ] {
        told(&answering(&find.replace("PID", &file)));
        let pid: i32 = fs::read_to_string(&file).unwrap().trim().parse().unwrap();
        let lives = || {
            let stat = fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
            // A zombie waits for whoever is its parent now.
            !stat.is_empty() && !stat.contains(") Z ")
        };
        let mut waits = 0;
        while lives() && waits < 1_000_000 {
            std::thread::yield_now();
            waits += 1;
        }
        assert!(!lives(), "{find}");
    }
}

#[test]
fn a_program_that_ignores_stop_is_killed_after_its_grace() {
    let args = script(
        "trap '' TERM; while :; do if read l; then case \"$l\" in *'\"step\"'*) echo \"$l\";; *'\"message\"'*) echo '{\"reply\":{\"id\":1,\"data\":1}}';; esac; else sleep 0.05; fi; done",
    );
    assert_eq!(told(&args), "1");
}

#[test]
fn a_second_answer_goes_to_nobody_and_one_to_no_question_ends_the_program() {
    let twice = "echo '{\"reply\":{\"id\":'$n',\"data\":'$n'}}'; echo '{\"reply\":{\"id\":'$n',\"data\":5}}'";
    let does = person(|cx| async move {
        let (one, two) = (find(&cx).await?, find(&cx).await?);
        Ok(format!("{one} {two}"))
    });
    let said = run(&[TOML], &app_text(&answering(twice), ""), does).unwrap();
    assert_eq!(said, "1 2");
    let text = told(&answering("echo '{\"reply\":{\"id\":99,\"data\":1}}'"));
    assert!(
        text.contains("answered message 99, which it was never told"),
        "{text}"
    );
}

#[test]
fn a_frame_that_is_none_ends_the_program_with_what_is_wrong() {
    for (frame, why) in [
        ("../../etc/hostname", "a name is at most 64 letters"),
        ("missing", "No such file or directory"),
    ] {
        let find = format!(
            "echo '{{\"reply\":{{\"id\":'$n',\"data\":{{\"frame\":\"{frame}\",\"bytes\":5}}}}}}'"
        );
        let text = told(&answering(&find));
        assert!(text.contains("a frame") && text.contains(why), "{text}");
    }
}

#[test]
fn an_answer_that_comes_too_late_ends_the_program_where_that_is_said() {
    let args = answering(":");
    let text = told(&format!("{args}\nanswer_s = 0.5"));
    assert!(
        text.contains("did not answer `find` within 0.5 s"),
        "{text}"
    );
}

#[test]
fn an_answer_of_another_type_is_refused_and_the_program_goes_on() {
    let find = "if [ $n = 1 ]; then echo '{\"reply\":{\"id\":1,\"data\":\"x\"}}'; else echo '{\"reply\":{\"id\":2,\"data\":7}}'; fi";
    let does = person(|cx| async move {
        let first = self::find(&cx).await.unwrap_err();
        Ok(format!("{first}\n{}", self::find(&cx).await?))
    });
    let text = run(&[TOML], &app_text(&answering(find), ""), does).unwrap();
    assert!(
        text.contains("the answer of its program to `find` does not fit: \"x\" is no whole number"),
        "{text}"
    );
    assert!(text.ends_with("\n7"), "{text}");
}

#[test]
fn a_line_of_a_hundred_megabytes_is_not_read_to_its_end() {
    let args = answering("head -c 104857600 /dev/zero | tr '\\0' x");
    let text = told(&format!("{args}\nline_mib = 2"));
    assert!(text.contains("wrote a line of more than 2 MiB"), "{text}");
}

#[test]
fn a_program_asks_only_whom_its_configuration_names() {
    let call = "echo '{\"call\":{\"id\":1,\"task\":\"sum\",\"command\":\"COMMAND\",\"data\":DATA}}'; m=$l; read s; echo \"$s\"; read l; v=${l#*data\\\":}; v=${v%%\\}*}; case \"$l\" in *'\"reply\"'*) echo '{\"reply\":{\"id\":'$n',\"data\":'$v'}}';; *) t=${l#*text\\\":}; echo '{\"error\":{\"id\":'$n',\"text\":'${t%\\}\\}}'}}';; esac";
    let call = |command: &str, data: &str| {
        answering(&call.replace("COMMAND", command).replace("DATA", data))
    };
    let fits = call("add", "{\"number\":7}");
    let text = told(&fits);
    assert!(
        text.contains("`detector` may not ask `sum`: name it in `asks`"),
        "{text}"
    );
    assert_eq!(told(&format!("{fits}\nasks = [\"sum\"]")), "7");
    let text = told(&format!("{}\nasks = [\"sum\"]", call("drop", "{}")));
    assert!(text.contains("takes no command"), "{text}");
    let text = told(&format!("{}\nasks = [\"sum\"]", call("add", "\"add 7\"")));
    assert!(
        text.contains("the data of `sum.add` does not fit"),
        "{text}"
    );
}

#[test]
fn a_program_that_says_that_it_is_not_deterministic_is_refused_in_virtual_time() {
    let error = fails(&args_of(
        "read l; echo '{\"hello\":{\"protocol\":1,\"deterministic\":false}}'; read l; echo \"$l\"; read l",
    ));
    assert!(
        error.contains("detector") && error.contains("not deterministic"),
        "{error}"
    );
    let error = fails(&args_of(
        "read l; echo '{\"hello\":{\"protocol\":2}}'; read l; echo \"$l\"; read l",
    ));
    assert!(error.contains("speaks version 2"), "{error}");
    let hello =
        "{\"hello\":{\"protocol\":1,\"commands\":[{\"name\":\"find\",\"reply\":\"text\"}]}}";
    let error = fails(&args_of(&format!(
        "read l; echo '{hello}'; read l; echo \"$l\"; read l"
    )));
    assert!(
        error.contains("the reply of `find` is text; declared is int"),
        "{error}"
    );
}

/// What `check` finds.
fn found(files: &[(&str, &str)], app: &str) -> Vec<(String, String)> {
    let folder = tempfile::tempdir().unwrap();
    let app = load(folder.path(), files, app);
    let all = registry(person(|_| async { Ok(String::new()) })).check(&app);
    let told = |finding: &Finding| (finding.code.to_owned(), finding.to_string());
    all.iter().map(told).collect()
}

#[test]
fn what_is_missing_or_not_executable_is_found_before_anything_starts() {
    for (files, args, code, words) in [
        (
            &[][..],
            "command = [\"no-such-program\"]",
            "ctos::program::not_there",
            "no folder of PATH",
        ),
        (
            &[("p.sh", "#!/bin/sh\n")][..],
            "command = [\"./p.sh\"]",
            "ctos::program::not_there",
            "not executable",
        ),
        (
            &[][..],
            "command = [\"./p.sh\"]",
            "ctos::program::not_there",
            "No such file",
        ),
        (
            &[][..],
            "command = []",
            "ctos::program::no_command",
            "names no program",
        ),
        (
            &[][..],
            "command = [\"sh\"]\nasks = [\"summ\"]",
            "ctos::config::unknown_task",
            "`summ`",
        ),
        (
            &[][..],
            "command = [\"sh\"]\nstands_in_for = [\"summ\"]",
            "ctos::config::unknown_handler",
            "`summ`",
        ),
        (
            &[][..],
            "command = [\"sh\"]\ngrace_s = -1.0",
            "ctos::program::time",
            "`grace_s`",
        ),
        (
            &[][..],
            "command = [\"sh\"]\nline_mib = 0",
            "ctos::program::line",
            "`line_mib`",
        ),
        (
            &[][..],
            "command = [\"sh\"]\ndeclares = \"p.toml\"",
            "ctos::file::unreadable",
            "p.toml",
        ),
        (
            &[("p.toml", "[command.find]\nrequest = { u = \"pixel\" }\n")][..],
            "command = [\"sh\"]\ndeclares = \"p.toml\"",
            "ctos::config::value",
            "there is no type `pixel`",
        ),
        (
            &[][..],
            "command = [\"sh\", \"-c\", \"echo no more paper >&2; exit 3\"]\ndeclares = \"hello\"",
            "ctos::program::hello",
            "does not tell what it takes: its program ended with exit code 3; its last words: no more paper",
        ),
        (
            &[][..],
            "command = [\"sh\", \"-c\", \"read l; read l\"]\ndeclares = \"hello\"\nstart_s = 0.2",
            "ctos::program::hello",
            "it did not say hello within 0.2 s",
        ),
        (
            &[][..],
            "command = [\"sh\", \"-c\", \"echo Loading weights\"]\ndeclares = \"hello\"",
            "ctos::program::hello",
            "it said no hello at first",
        ),
        (
            &[("p.toml", "[command.a]\ncode = 7\n[command.b]\ncode = 7\n")][..],
            "command = [\"sh\"]\ndeclares = \"p.toml\"",
            "ctos::handler::same_code",
            "`a` and `b`",
        ),
    ] {
        let all = found(files, &app_text(args, ""));
        let one = all
            .iter()
            .find(|(at, text)| at == code && text.contains(words));
        assert!(one.is_some(), "{args}: {all:?}");
    }
    let args = "command = [\"sh\"]\ndeclares = \"p.toml\"";
    let app = format!("time.mode = \"virtual\"\n{}", app_text(args, ""));
    let all = found(&[("p.toml", "deterministic = false\n")], &app);
    assert!(
        all.iter()
            .any(|(code, _)| code == "ctos::program::not_deterministic"),
        "{all:?}"
    );
    assert_eq!(found(&[TOML], &app_text("command = [\"sh\"]", "")), []);
}

#[test]
fn a_program_that_vanished_is_named_when_its_task_starts() {
    let error = fails("command = [\"./gone\"]\ndeclares = \"detector.toml\"");
    assert!(
        error.contains("detector") && error.contains("cannot be started"),
        "{error}"
    );
}

#[test]
fn one_that_says_nothing_keeps_nobody_longer_than_its_start() {
    let does = person(|cx| async move {
        cx.sleep(Duration::from_secs(1)).await;
        Ok(String::new())
    });
    let args = args_of("exec 1>&-; sleep 100");
    let error = run(&[TOML], &app_text(&args, ""), does).unwrap_err();
    assert!(
        error.contains("detector") && error.contains("closed its output"),
        "{error}"
    );
}

#[test]
fn who_asks_a_program_that_is_busy_waits_in_line_and_is_told_when_the_line_is_full() {
    let does = person(|cx| async move {
        let asked = (0..100).map(|_| find(&cx));
        let answers = futures_util::future::join_all(asked).await;
        let full = |answer: &&Result<String, String>| {
            answer
                .as_ref()
                .is_err_and(|why| why.contains("the queue of `detector` is full"))
        };
        let (full, taken) = (
            answers.iter().filter(full).count(),
            answers.iter().flatten().count(),
        );
        Ok(format!("{full} {taken}"))
    });
    let find = "echo '{\"reply\":{\"id\":'$n',\"data\":1}}'";
    let app = app_text(&answering(find), "queue = 2\n");
    let said = run(&[TOML], &app, does).unwrap();
    let (full, taken) = said.split_once(' ').unwrap();
    assert_eq!(
        full.parse::<u32>().unwrap() + taken.parse::<u32>().unwrap(),
        100,
        "{said}"
    );
    assert_ne!(full, "0");
    assert_ne!(taken, "0");
}

#[test]
fn a_program_that_asks_without_end_is_told_that_it_is_too_much() {
    let flood = "for i in $(seq 1 600); do echo '{\"send\":{\"id\":'$i',\"task\":\"sum\",\"command\":\"add\",\"data\":{\"number\":1}}}'; done; \
        while read x; do case \"$x\" in *'\"step\"'*) echo \"$x\";; *'too many questions'*) echo '{\"reply\":{\"id\":1,\"data\":7}}'; break;; esac; done";
    let args = format!("{}\nasks = [\"sum\"]", answering(flood));
    assert_eq!(told(&args), "7");
}

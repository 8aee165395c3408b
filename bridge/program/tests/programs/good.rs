//! What a program can do as a task.

use std::{fs, time::Duration};

use ctos::record::{Filter, Record, replay};
use serde_json::json;

use crate::common::{
    app_text, ask, client, has_python, load, person, python, registry, run, run_app,
};

/// It doubles numbers, counts how often it was asked, and adds up by another task.
const PYTHON: &str = r#"
import ctos

@ctos.handler
def double(number: int) -> int:
    """Doubles a number."""
    ctos.keep((ctos.state() or 0) + 1)
    return 2 * number

@ctos.handler
def count() -> int:
    return ctos.state() or 0

@ctos.handler
def add_twice(number: int) -> int:
    ctos.call("sum", "add", number=number)
    return ctos.call("sum", "add", number=number)

@ctos.handler
def draw(sides: int) -> int:
    print("this is no line of the protocol")
    return ctos.rng().randrange(sides)

@ctos.handler
def fail(why: str) -> None:
    raise ctos.Refused(why)

@ctos.handler
def die(code: int) -> None:
    import sys
    print("no more paper", file=sys.stderr)
    sys.stderr.flush()
    import os
    os._exit(code)

@ctos.handler
def turn(pixels: bytes) -> bytes:
    import base64
    return base64.b64decode(pixels)[::-1]

@ctos.service_object
def gauge(text, floats, ints):
    if text == "read":
        return ctos.Answer(text="mm", floats=[sum(floats) / 2.0], ints=[len(ints)])
    raise ctos.Refused("EXEC read")

ctos.run()
"#;

const TOML: &str = r#"
[command.double]
help = "Doubles a number."
request = { number = "int" }
reply = "int"
[command.count]
reply = "int"
[command.add_twice]
request = { number = "int" }
reply = "int"
[command.draw]
request = { sides = "int" }
reply = "int"
[command.fail]
request = { why = "text" }
reply = "nothing"
[command.die]
request = { code = "int" }
reply = "nothing"
[command.turn]
request = { pixels = "bytes" }
reply = "bytes"
"#;

const FILES: [(&str, &str); 2] = [("detector.py", PYTHON), ("detector.toml", TOML)];

fn args() -> String {
    format!(
        "command = [\"{}\", \"detector.py\"]\nasks = [\"sum\"]\nenvironment.PYTHONPATH = \"{}\"",
        python(),
        client()
    )
}

#[test]
fn a_program_answers_by_its_declared_types_and_asks_others() {
    if !has_python() {
        return;
    }
    let does = person(|cx| async move {
        let mut said = Vec::new();
        for (command, data) in [
            ("double", json!({"number": 21})),
            ("add_twice", json!({"number": 4})),
            ("turn", json!({"pixels": "AQID"})),
            ("fail", json!({"why": "too dark"})),
            ("double", json!({"number": "x"})),
            ("draw", json!({"sides": 6})),
            ("count", json!(null)),
        ] {
            said.push(match ask(&cx, "detector", command, data).await {
                Ok(value) => value.to_string(),
                Err(why) => why,
            });
        }
        Ok(said.join("\n"))
    });
    let text = run(&FILES, &app_text(&args(), ""), does).unwrap();
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!(lines[..3], ["42", "8", "\"AwIB\""], "{text}");
    assert!(
        lines[3].contains("`detector` refused `fail`") && lines[3].ends_with("too dark"),
        "{text}"
    );
    assert!(lines[4].contains("`number`: \"x\" is no"), "{text}");
    assert_eq!(lines[6], "1", "{text}");
}

#[test]
fn a_run_is_the_same_to_the_bit_and_is_replayed_without_the_program() {
    if !has_python() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let does = person(|cx| async move {
        for number in 0..5 {
            ask(&cx, "detector", "add_twice", json!({"number": number})).await?;
            cx.sleep(Duration::from_millis(3)).await;
            ask(&cx, "detector", "draw", json!({"sides": 1000})).await?;
        }
        Ok("done".to_owned())
    });
    let records: Vec<Vec<u8>> = (0..2)
        .map(|number| {
            let text = app_text(&args(), &format!("[record]\nfile = \"run{number}.mcap\""));
            let app = load(folder.path(), &FILES, &text);
            run_app(app, registry(does.clone()));
            fs::read(folder.path().join(format!("run{number}.mcap"))).unwrap()
        })
        .collect();
    assert!(records[0] == records[1]);
    let file = folder.path().join("run0.mcap");
    let record = Record::read(std::slice::from_ref(&file), &Filter::default()).unwrap();
    fs::write(
        folder.path().join("detector.py"),
        "raise SystemExit('it is started')",
    )
    .unwrap();
    let text = app_text(&args(), "[record]\nfile = \"other.mcap\"");
    let app = load(folder.path(), &[], &text);
    let report = replay(app, registry(does), "detector", &record).unwrap();
    assert!(report.is_same(), "{report}");
    assert!(report.messages >= 10, "{report}");
}

#[test]
fn what_it_keeps_survives_its_crash_and_its_move_and_a_crash_is_named_with_its_last_words() {
    if !has_python() {
        return;
    }
    let does = person(|cx| async move {
        for number in 0..3 {
            ask(&cx, "detector", "double", json!({"number": number})).await?;
        }
        let died = ask(&cx, "detector", "die", json!({"code": 3}))
            .await
            .unwrap_err();
        let count = ask(&cx, "detector", "count", json!({})).await?;
        ask(&cx, "detector", "double", json!({"number": 1})).await?;
        let place = cx
            .move_task("detector", "b:main")
            .await
            .map_err(|error| error.to_string())?;
        let moved = ask(&cx, "detector", "count", json!({})).await?;
        Ok(format!("{died}\n{count} {place} {moved}"))
    });
    let more = "restart = \"on-failure\"\n";
    let text = run(&FILES, &app_text(&args(), more), does).unwrap();
    assert!(
        text.contains("its program ended with exit code 3; its last words: no more paper"),
        "{text}"
    );
    assert!(text.ends_with("\n3 b:main 4"), "{text}");
}

#[test]
fn a_crash_that_nothing_restarts_ends_the_app_with_its_last_words() {
    if !has_python() {
        return;
    }
    let does = person(|cx| async move {
        let _ = ask(&cx, "detector", "die", json!({"code": 3})).await;
        cx.sleep(Duration::from_secs(60)).await;
        Ok(String::new())
    });
    let error = run(&FILES, &app_text(&args(), ""), does).unwrap_err();
    assert!(
        error.contains("detector") && error.contains("no more paper"),
        "{error}"
    );
}

#[test]
fn a_program_is_a_service_object_that_lines_of_text_ask() {
    if !has_python() {
        return;
    }
    let does = person(|cx| async move {
        let mut said = Vec::new();
        for line in [
            "program.detector EXEC read FMSG 2 3 5 IMSG 1 7",
            "program.detector EXEC melt",
            "program.nobody EXEC read",
        ] {
            let data = json!({"line": line, "from": "test", "trace": 0});
            said.push(ask(&cx, "objects", "say", data).await?.to_string());
        }
        Ok(said.join("\n"))
    });
    let text = app_text(
        &args(),
        "[task.objects]\nhandler = \"sorma.daemon\"\non = \"b\"\n",
    );
    let text = run(&FILES, &text, does).unwrap();
    let lines: Vec<&str> = text.lines().collect();
    assert!(
        lines[0].contains("FMSG 1 4") && lines[0].contains("IMSG 1 1"),
        "{text}"
    );
    assert!(lines[1].contains("EXEC read"), "{text}");
    assert!(lines[2].contains("nobody"), "{text}");
}

#[test]
fn the_program_in_c_speaks_the_protocol() {
    let folder = tempfile::tempdir().unwrap();
    let source = concat!(env!("CARGO_MANIFEST_DIR"), "/../../clients/c/echo.c");
    assert!(fs::read_to_string(source).unwrap().lines().count() <= 60);
    let built = std::process::Command::new("cc")
        .args(["-Wall", "-Wextra", "-Werror", "-o"])
        .arg(folder.path().join("echo"))
        .arg(source)
        .status();
    match built {
        Ok(status) => assert!(status.success()),
        // There is no compiler here.
        Err(_) => return,
    }
    let does = person(|cx| async move {
        let first = ask(&cx, "detector", "double", json!({"number": -21})).await?;
        let place = cx
            .move_task("detector", "b:main")
            .await
            .map_err(|error| error.to_string())?;
        let second = ask(&cx, "detector", "double", json!({"number": 5})).await?;
        Ok(format!("{first} {place} {second}"))
    });
    let toml = "[command.double]\nrequest = { number = \"int\" }\nreply = \"int\"\n";
    let text = app_text("command = [\"./echo\"]\ndeclares = \"echo.toml\"", "");
    let app = load(folder.path(), &[("echo.toml", toml)], &text);
    let end = format!("{:?}", run_app(app, registry(does)).end);
    assert!(end.contains("-42 b:main 10"), "{end}");
}

ctos::command! {
    /// Says that it is there.
    pub struct Ready {} => (), 2, "ready"
}

ctos::command! {
    /// Ends the app.
    pub struct Now {} => (), 1, "now"
}

struct Ender;

#[ctos::handler]
impl Ender {
    #[command]
    fn ready(&mut self, _: Ready) {}

    #[command]
    async fn now(
        &mut self,
        cx: &ctos::task::Context,
        Now {}: Now,
    ) -> Result<(), ctos::task::HandlerError> {
        cx.finish(ctos::system::AppResult {
            ok: true,
            text: "the other task".to_owned(),
            json: String::new(),
        });
        Ok(())
    }
}

#[test]
fn other_tasks_of_the_processor_have_their_turn_while_a_program_writes_without_a_pause() {
    if !has_python() {
        return;
    }
    let writes = r#"
import json, sys
def say(**line):
    print(json.dumps(line), flush=True)
for text in sys.stdin:
    line = json.loads(text)
    if "hello" in line:
        say(hello={"protocol": 1})
    elif "run" in line:
        # From then on it knows where the other task is, and no time need pass to find it.
        say(call={"id": 1, "task": "ender", "command": "ready", "data": {}})
    elif "reply" in line:
        say(send={"id": 2, "task": "ender", "command": "now", "data": {}})
        for number in range(1000):
            say(keep={"state": number})
        say(finish={"ok": True, "text": "the program"})
    elif "step" in line:
        say(step=line["step"])
    elif "stop" in line:
        break
"#;
    let folder = tempfile::tempdir().unwrap();
    let text = format!(
        "[app]\nname = \"t\"\n[time]\nmode = \"virtual\"\n[chassis.a]\n[task.writer]\nhandler = \"ctos.program\"\non = \"a\"\nargs.command = [\"{}\", \"writer.py\"]\nargs.asks = [\"ender\"]\n[task.ender]\nhandler = \"ender\"\non = \"a\"\n",
        python()
    );
    let app = load(folder.path(), &[("writer.py", writes)], &text);
    let mut registry = registry(person(|_| async { Ok(String::new()) }));
    registry.handler("ender", &Ender::COMMANDS, |_| Ok(Ender));
    let ended = run_app(app, registry).end;
    assert!(
        matches!(&ended, ctos::boot::End::Finished(result) if result.text == "the other task"),
        "{ended:?}"
    );
}

#[test]
fn a_program_that_declares_its_commands_in_its_hello_alone_is_known_to_check_and_to_who_asks() {
    if !has_python() {
        return;
    }
    let writes = r#"
import ctos

@ctos.handler
def double(number: int) -> int:
    "Doubles a number."
    return 2 * number

@ctos.handler(request={"times": "int", "far": "mm"}, reply={"mean": "px?"})
def measure(times, far):
    return {"mean": far * times}

ctos.run()
"#;
    let args = format!(
        "command = [\"{}\", \"detector.py\"]\ndeclares = \"hello\"\nenvironment.PYTHONPATH = \"{}\"",
        python(),
        client()
    );
    let folder = tempfile::tempdir().unwrap();
    let app = load(
        folder.path(),
        &[("detector.py", writes)],
        &(app_text(&args, "") + "[time]\nmode = \"virtual\"\n"),
    );
    let does = person(|cx| async move {
        let said = ask(&cx, "detector", "measure", json!({"times": 2, "far": 1.5})).await?;
        let twice = ask(&cx, "detector", "double", json!({"number": 4})).await?;
        Ok(format!("{said} {twice}"))
    });
    let registry = registry(does);
    let found = registry.check(&app);
    assert!(found.is_empty(), "{found}");
    let measure = registry.command_of(&app, "detector", "measure").unwrap();
    assert_eq!(
        (measure.code, measure.doc),
        (2, "({times: int, far: mm} -> {mean: px?})")
    );
    let ended = run_app(app, registry).end;
    assert!(
        matches!(&ended, ctos::boot::End::Finished(result) if result.text == "{\"mean\":3.0} 8"),
        "{ended:?}"
    );
}

#[test]
fn large_bytes_go_through_shared_memory_and_nothing_of_them_is_left() {
    if !has_python() {
        return;
    }
    let writes = r#"
import ctos

@ctos.handler
def turn(pixels):
    framed = isinstance(pixels, dict)
    return {"framed": framed, "pixels": ctos.opaque(pixels)[::-1]}

ctos.run(frames=True)
"#;
    let declares = "[command.turn]\nrequest = { pixels = \"bytes\" }\nreply = { framed = \"bool\", pixels = \"bytes\" }\n";
    let args = format!(
        "command = [\"{}\", \"detector.py\"]\nenvironment.PYTHONPATH = \"{}\"",
        python(),
        client()
    );
    let does = person(|cx| async move {
        use base64::{Engine as _, engine::general_purpose::STANDARD};
        for (length, framed) in [(1000, false), (3 << 20, true)] {
            let pixels: Vec<u8> = (0..length).map(|at: usize| (at % 251) as u8).collect();
            let data = json!({"pixels": STANDARD.encode(&pixels)});
            let answer = ask(&cx, "detector", "turn", data).await?;
            assert_eq!(answer["framed"], framed, "{length}");
            let turned = STANDARD.decode(answer["pixels"].as_str().unwrap()).unwrap();
            assert!(turned.iter().eq(pixels.iter().rev()));
        }
        let own = format!("ctos-frames-{}-", std::process::id());
        let folders = fs::read_dir("/dev/shm").unwrap().flatten();
        let folders = folders.filter(|one| one.file_name().to_string_lossy().starts_with(&own));
        let left = folders
            .flat_map(|one| fs::read_dir(one.path()).unwrap())
            .count();
        Ok(format!("{left} left"))
    });
    let files = [("detector.py", writes), ("detector.toml", declares)];
    let app = app_text(&args, "") + "[time]\nmode = \"virtual\"\n";
    assert_eq!(run(&files, &app, does).unwrap(), "0 left");
}

use std::sync::Arc;

use ctos::{
    boot::{End, Observer},
    config::{App, load},
    registry::Registry,
    simulation::{self, Setup},
    system::AppResult,
    task::{Context, Handled, Phase},
};
use pnt::{
    compile,
    task::{Marking, PutTape},
};
use sorma::{Dictionary, Method, Request};

use super::*;

const HEAD: &str = "net n\nplace p = 1\ndata count : int = 7\ndata x : m = 0.5\ndata name : text = \"a\"\ndata spot { u : px, v : px }\n";

fn line(text: &str) -> Line {
    let whole = format!("{HEAD}transition t\n  in p\n  request \"{text}\"\n  out p\n");
    let net = compile::net(&ctos::diagnostic::Source::new("n.net", whole));
    let net = net.unwrap_or_else(|found| panic!("{text}: {found}"));
    requests(&net).next().unwrap().clone()
}

fn filled(text: &str, values: &[Value]) -> Request {
    let template = Template::of(&line(text), Some("objects"));
    template
        .unwrap_or_else(|found| panic!("{text}: {found}"))
        .filled(values)
}

#[test]
fn a_line_is_the_request_that_scott_reads_with_values_in_it() {
    let (u, v) = (Value::Float(1.5), Value::Float(-2.0));
    let request = filled(
        "carry.slow EXEC FMSG 3 $spot $x",
        &[u.clone(), v, Value::Float(0.25)],
    );
    assert_eq!(
        request,
        "carry.slow@objects EXEC FMSG 3 1.5 -2.0 0.25"
            .parse()
            .unwrap()
    );
    let request = filled(
        "b@c EXEC go FMSG 2 $count 4 IMSG 1 $count",
        &[Value::Int(3), Value::Int(-4)],
    );
    assert_eq!(request, "b@c EXEC go FMSG 2 3 4 IMSG 1 -4".parse().unwrap());
    let request = filled("mvpos CTRL -speed $x -keep on", &[Value::Float(0.3)]);
    assert_eq!(request.body.text, "-speed 0.3 -keep on");
    assert_eq!(request.method, Method::Ctrl);
}

#[test]
fn text_from_outside_is_one_word_and_never_read_as_more() {
    for outside in [
        "1 FMSG 2 3 4",
        "-force 100",
        "a\" -force 100 \"",
        "'",
        "x@other EXEC stop",
        "\n",
        "",
        "\u{e000}",
        "$x",
    ] {
        let value = [Value::Text(outside.to_owned())];
        let request = filled("mvpos CTRL -frame $name", &value);
        let words = sorma::words::split(&request.body.text).unwrap();
        assert_eq!(words.len(), 2, "{outside}: {}", request.body.text);
        assert_eq!(words[1].text, outside);
        assert!(words[1].quoted);
        assert_eq!(
            (request.body.floats.len(), request.name.to_string()),
            (0, "mvpos@objects".to_owned())
        );
        // A text that is all there is goes as it is, in its own field.
        let request = filled("say EXEC $name", &value);
        assert_eq!(request.body.text, outside);
        assert_eq!(request.body.floats, Vec::<f64>::new());
        // What it prints reads back as the same request.
        if !outside.contains('\u{e000}') {
            assert_eq!(
                request.to_text().unwrap().parse::<Request>().unwrap(),
                request
            );
        }
    }
}

#[test]
fn what_is_wrong_with_a_line_is_found_before_anything_starts() {
    for (text, wanted) in [
        ("mvpos", "this is no request"),
        (
            "mvpos GO",
            "after the name stands EXEC, CTRL or DBX, not `GO`",
        ),
        (
            "mvpos EXEC FMSG 3 $spot",
            "FMSG announces 3 values, but 2 follow",
        ),
        (
            "mvpos EXEC FMSG $count 1",
            "does not stand by itself among the numbers",
        ),
        (
            "mvpos EXEC IMSG 1 $x",
            "is of type `m`, and behind IMSG stands a whole number",
        ),
        (
            "mvpos EXEC FMSG 1 $name",
            "is of type `text`, and behind FMSG stands a number",
        ),
        ("mvpos EXEC FMSG 1 1$x", "does not stand by itself"),
        (
            "$name EXEC go",
            "stands where the object and what is asked of it stand",
        ),
        (
            "mvpos $name go",
            "stands where the object and what is asked of it stand",
        ),
        (
            "mvpos CTRL -a=$name",
            "is a text and does not stand by itself",
        ),
        (
            "mvpos CTRL -a \\\"$name\\\"",
            "is a text and does not stand by itself",
        ),
        ("MVPOS EXEC", "a net has no dictionary"),
        ("mvpos EXEC TDBX $name", "stands in a report"),
    ] {
        let found = Template::of(&line(text), Some("objects"))
            .expect_err(text)
            .to_string();
        assert!(found.contains(wanted), "{text}: {found}");
        assert!(found.starts_with("n.net:9:11: error"), "{text}: {found}");
    }
    assert!(Template::of(&line("mvpos EXEC"), None).is_err());
}

/// Puts commands on the tape of net `n`, and ends the app with the answers and the data.
struct Person(Vec<(String, Vec<String>)>);

#[ctos::handler]
impl Person {
    #[phase]
    async fn enters(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let (cx, orders) = (cx.clone(), self.0.clone());
            cx.clone().spawn(async move {
                let mut said = Vec::new();
                for (symbol, arguments) in orders {
                    let net = cx.wait_for_task("n", Duration::from_secs(9)).await;
                    let Ok(net) = net else { return };
                    match cx.call(&net, PutTape { symbol, arguments }).await {
                        Ok(answer) => said.push(format!("{} {}", answer.symbol, answer.text)),
                        Err(error) => said.push(error.to_string()),
                    }
                    if let Ok(marking) = cx.call(&net, Marking {}).await {
                        said.push(format!("{:?}", marking.data));
                    }
                }
                let text = said.join("\n");
                cx.finish(AppResult {
                    ok: true,
                    text,
                    json: String::new(),
                });
            });
        }
        Ok(())
    }
}

fn registry(orders: &[&str]) -> Registry {
    let mut registry = Registry::new();
    register(&mut registry);
    daemon::register(&mut registry, Dictionary::new(), |_, sorm| {
        sorma::demo::register(sorm)
    });
    let orders: Vec<(String, Vec<String>)> = orders
        .iter()
        .filter_map(|line| {
            let mut words = line.split(' ').map(str::to_owned);
            Some((words.next()?, words.collect()))
        })
        .collect();
    registry.handler("person", &[], move |_| Ok(Person(orders.clone())));
    registry
}

fn app(net: &str, args: &str) -> (tempfile::TempDir, App) {
    let folder = tempfile::tempdir().unwrap();
    let config = format!(
        "[app]\nuntil = \"person\"\n[time]\nmode = \"virtual\"\n[chassis.a]\n[task.person]\nhandler = \"person\"\non = \"a\"\n[task.objects]\nhandler = \"sorma.daemon\"\non = \"a\"\n[task.n]\nhandler = \"pnt.net\"\non = \"a\"\nargs = {{ net = \"n.net\"{args} }}\n"
    );
    std::fs::write(folder.path().join("app.toml"), config).unwrap();
    std::fs::write(folder.path().join("n.net"), net).unwrap();
    let app = load(&folder.path().join("app.toml"), &[], &[]).unwrap_or_else(|f| panic!("{f}"));
    (folder, app)
}

fn ran(net: &str, args: &str, orders: &[&str]) -> String {
    let (_folder, app) = app(net, args);
    let found = registry(orders).check(&app);
    assert!(!found.has_errors(), "{found}");
    let unseen: Observer = Arc::new(|_| ());
    let ran = simulation::run(app, registry(orders), Setup::default(), &unseen).unwrap();
    match ran.outcome.end {
        End::Finished(result) => result.text,
        other => panic!("{other:?}"),
    }
}

const DRINKS: &str = "net n
place idle = 1, told, tasted, weak, strong, failed
data drink { tea : float, lemon : float }
data count : int
command mix(tea : float) -> weak_one, strong_one, none_mixed

transition tell
  in idle
  tape mix
  request \"bar CTRL -tea $tea -lemon 0.25\"
  out told
  fail failed

transition taste
  in told
  request \"bar EXEC\"
  out tasted data drink = reply
  set count = count + 1
  fail failed

transition find_weak
  in tasted
  when drink.tea + drink.lemon < 1
  log \"number $count is weak: $drink\"
  out weak
  fail weak

transition find_strong
  in tasted
  when not drink.tea + drink.lemon < 1
  wait 2 s
  out strong
  fail strong

transition say_weak
  in weak
  out idle
  write weak_one

transition say_strong
  in strong
  out idle
  write strong_one

transition give_up
  in failed
  out idle
  write none_mixed
";

#[test]
fn a_net_without_functions_asks_objects_keeps_what_they_answer_and_decides_by_it() {
    let said = ran(
        DRINKS,
        "",
        &["mix 0.5", "mix 1.5", "mix 7", "mix", "mix a\"b"],
    );
    let lines: Vec<&str> = said.lines().collect();
    assert_eq!(lines[0], "weak_one ");
    assert_eq!(
        lines[1],
        "[(\"drink.tea\", \"0.5\"), (\"drink.lemon\", \"0.25\"), (\"count\", \"1\")]"
    );
    assert_eq!(lines[2], "strong_one ");
    assert_eq!(
        lines[3],
        "[(\"drink.tea\", \"1.5\"), (\"drink.lemon\", \"0.25\"), (\"count\", \"2\")]"
    );
    // What the object refuses is the action's failure, with the object's words.
    assert!(
        lines[4].starts_with("none_mixed tell: ") && lines[4].contains("tea"),
        "{said}"
    );
    assert!(
        said.contains("takes (tea : float), and 0 came with it"),
        "{said}"
    );
    assert!(said.contains("and `a\"b` is no float for `tea`"), "{said}");
}

#[test]
fn a_reply_with_other_numbers_than_declared_fails_the_action_and_changes_nothing() {
    let three = DRINKS.replace("lemon : float }", "lemon : float, ice : int }");
    let said = ran(&three, "", &["mix 0.5"]);
    assert!(
        said.contains("none_mixed taste: ")
            && said.contains(
                "n.net:17:19: 2 floats and 0 whole numbers were answered, and `drink` takes 2 and 1"
            ),
        "{said}"
    );
    assert!(said.ends_with("(\"count\", \"0\")]"), "{said}");
}

#[test]
fn mistakes_in_lines_and_daemons_are_found_before_anything_starts() {
    let found = |net: &str, args: &str| {
        let (_folder, app) = app(net, args);
        registry(&[]).check(&app).to_string()
    };
    assert_eq!(found(DRINKS, ""), "");
    for (old, new, wanted) in [
        (
            "\"bar EXEC\"",
            "\"bar EXEC FMSG 2 1\"",
            "n.net:16:11: error: this is no request: FMSG announces 2 values",
        ),
        (
            "\"bar EXEC\"",
            "\"bar@kitchen EXEC\"",
            "n.net:16:11: error: no task `kitchen` of this app serves objects",
        ),
        (
            "$tea",
            "$te",
            "error: nothing declares `te` (did you mean `tea`?)",
        ),
        (
            "drink.tea +",
            "drink.te +",
            "error: nothing declares `drink.te` (did you mean `drink.tea`?)",
        ),
    ] {
        let found = found(&DRINKS.replace(old, new), "");
        assert!(found.contains(wanted), "{found}");
    }
    let wrong = found(DRINKS, ", daemon = \"object\"");
    assert!(
        wrong.contains("no task `object` of this app serves objects (did you mean `objects`?)"),
        "{wrong}"
    );
    let wrong = found(DRINKS, ", demon = \"objects\"");
    assert!(wrong.contains("demon"), "{wrong}");
}

#[test]
fn stood_in_for_every_action_succeeds_after_its_stated_time_or_fails_by_chance() {
    let net = DRINKS
        .replace("\"bar EXEC\"", "\"robot@nowhere EXEC\"\n  time 5 s")
        .replace("-tea $tea", "$tea -x");
    let said = ran(&net, ", stand_in = true", &["mix 0.5"]);
    assert!(said.starts_with("weak_one"), "{said}");
    let said = ran(&net, ", stand_in = { fail = 1.0 }", &["mix 0.5"]);
    assert!(
        said.starts_with("none_mixed tell: the stand-in fails by chance"),
        "{said}"
    );
}

/// Counts to ten, a step in 20 ms.
const COUNTS: &str = "net n
place idle = 1, counting
data count : int
data half : bool
command go -> gone
transition begin
  in idle
  tape go
  set count = 0
  idempotent
  out counting
transition step
  in counting
  when count < 10
  wait 20 ms
  idempotent
  set count = count + 1
  set half = count >= 5
  out counting
transition finish
  in counting
  when not count < 10
  out idle
  write gone
";

#[test]
fn data_of_a_durable_net_survives_its_process_as_its_marking_does() {
    let folder = tempfile::tempdir().unwrap();
    let config = "[app]\nuntil = \"person\"\n[time]\nmode = \"virtual\"\n[chassis.desk]\n[chassis.a]\nrestart = \"always\"\nmax_restarts = 100\nrestart_backoff_s = 0.01\n[task.person]\nhandler = \"asker\"\non = \"desk\"\n[task.n]\nhandler = \"pnt.net\"\non = \"a\"\nargs = { net = \"n.net\", durable = true }\n";
    std::fs::write(folder.path().join("app.toml"), config).unwrap();
    std::fs::write(folder.path().join("n.net"), COUNTS).unwrap();
    for at in 0..12 {
        let kill = |ms: u64| {
            let at = ctos::time::Instant::from_nanos((ms + at * 3) * 1_000_000);
            simulation::Fault::on("a".to_owned(), simulation::FaultKind::Kill, at)
        };
        let faults = simulation::Faults::of_script("kills", vec![kill(30), kill(250), kill(420)]);
        let setup = Setup {
            faults,
            ..Setup::default()
        };
        let mut registry = registry(&[]);
        registry.handler("asker", &[], |_| Ok(Asker));
        let app = load(&folder.path().join("app.toml"), &[], &[]).unwrap();
        let unseen: Observer = Arc::new(|_| ());
        let ran = simulation::run(app, registry, setup, &unseen).unwrap();
        let End::Finished(result) = ran.outcome.end else {
            panic!("{:?}", ran.outcome.end);
        };
        assert_eq!(
            result.text,
            "gone [(\"count\", \"10\"), (\"half\", \"true\")]"
        );
    }
}

/// Asks for one count under one number until it is answered.
struct Asker;

#[ctos::handler]
impl Asker {
    #[phase]
    async fn enters(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let cx = cx.clone();
            cx.clone().spawn(async move {
                let put = pnt::task::PutOnce {
                    request: pnt::task::RequestId {
                        from: "person".to_owned(),
                        number: 1,
                    },
                    symbol: "go".to_owned(),
                    arguments: Vec::new(),
                };
                let answer = pnt::task::put_once(&cx, "n", &put, Duration::from_secs(60)).await;
                let net = cx.wait_for_task("n", Duration::from_secs(9)).await;
                let data = match net {
                    Ok(net) => cx.call(&net, Marking {}).await.map(|marking| marking.data),
                    Err(_) => Ok(Vec::new()),
                };
                let text = format!(
                    "{} {:?}",
                    answer.map_or_else(|e| e.to_string(), |a| a.symbol),
                    data.unwrap_or_default()
                );
                cx.finish(AppResult {
                    ok: true,
                    text,
                    json: String::new(),
                });
            });
        }
        Ok(())
    }
}

#[test]
fn a_guard_without_a_value_stops_the_net_and_says_where() {
    let net = COUNTS.replace("count < 10", "100 / (count - 3) < 1000");
    let said = ran(&net, "", &["go"]);
    assert!(
        said.contains("`100 / (count - 3) < 1000` has no value: it divides by zero"),
        "{said}"
    );
}

ctos::command! {
    /// Greets so many times.
    struct Greet { name: String, times: u8, loud: bool } => (String, f64, u32), 0x0001, "greet"
}

const GREETS: &str = "net n
place idle = 1, failed
data line : text
data sure : float
data count : int
data loud : bool = true
command greet(name : text, times : int) -> greeted, not_greeted
transition greet
  in idle
  tape greet
  send greeter.greet(name, times, loud -> line, sure, count)
  out idle
  write greeted
  fail failed
transition give_up
  in failed
  out idle
  write not_greeted
";

#[test]
fn messages_take_declared_data_along_and_replies_become_it() {
    let net = GREETS.to_owned();
    let registry = |orders: &[&str]| {
        let mut registry = registry(orders);
        registry.function::<Greet, _, _>("greeter", |_, greet| async move {
            let mark = if greet.loud { "!" } else { "." };
            Ok((format!("{}{mark}", greet.name), 0.5, u32::from(greet.times)))
        });
        registry
    };
    let with_greeter = |net: &str| {
        let (folder, _) = app(net, "");
        let file = folder.path().join("app.toml");
        let config = std::fs::read_to_string(&file).unwrap();
        std::fs::write(
            &file,
            config + "[task.greeter]\nhandler = \"greeter\"\non = \"a\"\n",
        )
        .unwrap();
        let app = load(&file, &[], &[]).unwrap();
        (folder, app)
    };
    let (_folder, app) = with_greeter(&net);
    let orders = ["greet a;b 7", "greet b 300"];
    let found = registry(&orders).check(&app).to_string();
    assert_eq!(found, "");
    let unseen: Observer = Arc::new(|_| ());
    let ran = simulation::run(app, registry(&orders), Setup::default(), &unseen).unwrap();
    let End::Finished(result) = ran.outcome.end else {
        panic!("{:?}", ran.outcome.end);
    };
    let lines: Vec<&str> = result.text.lines().collect();
    assert_eq!(lines[0], "greeted ");
    assert_eq!(
        lines[1],
        "[(\"line\", \"a;b!\"), (\"sure\", \"0.5\"), (\"count\", \"7\"), (\"loud\", \"true\")]"
    );
    assert!(
        lines[2].starts_with("not_greeted greet: out of range"),
        "{lines:?}"
    );
    for (old, new, wanted) in [
        (
            "(name, times, loud",
            "(name, times, count",
            "`count` is (int), and command `greet` of task `greeter` has (bool) there",
        ),
        (
            "-> line, sure",
            "-> sure, line",
            "`sure` is (float), and command `greet` of task `greeter` has (text) there",
        ),
    ] {
        let (_folder, app) = with_greeter(&net.replace(old, new));
        let found = registry(&[]).check(&app).to_string();
        assert!(found.contains(wanted), "{found}");
    }
}

#[test]
fn each_net_of_an_app_is_compiled_once_until_its_text_changes() {
    let folder = tempfile::tempdir().unwrap();
    let file = |index: usize| folder.path().join(format!("n{index}.net"));
    let mut config = "[app]\nuntil = \"person\"\n[time]\nmode = \"virtual\"\n[chassis.a]\n[task.person]\nhandler = \"person\"\non = \"a\"\n[task.objects]\nhandler = \"sorma.daemon\"\non = \"a\"\n".to_owned();
    for index in 0..30 {
        let net = DRINKS.replace(
            "net n\n",
            &format!("net n{index}\ninclude \"more.net\"\nuse rounds() as rounds\n"),
        );
        std::fs::write(file(index), net).unwrap();
        config += &format!(
            "[task.n{index}]\nhandler = \"pnt.net\"\non = \"a\"\nargs.net = \"n{index}.net\"\n"
        );
    }
    let more = |seconds: u8| {
        let subnet = format!(
            "subnet rounds()\n  place more = 1, less\n  transition lessen\n    in more\n    out less\n  transition more_again\n    in less\n    time {seconds} s\n    out more\nend\n"
        );
        std::fs::write(folder.path().join("more.net"), subnet).unwrap();
    };
    more(1);
    std::fs::write(folder.path().join("app.toml"), config).unwrap();
    let run = || {
        let app = load(&folder.path().join("app.toml"), &[], &[]);
        let app = app.unwrap_or_else(|f| panic!("{f}"));
        let found = registry(&[]).check(&app);
        assert!(!found.has_errors(), "{found}");
        let unseen: Observer = Arc::new(|_| ());
        let ran = simulation::run(app, registry(&[]), Setup::default(), &unseen).unwrap();
        assert!(matches!(ran.outcome.end, End::Finished(_)));
        (0..30)
            .map(|index| pnt::task::compilations(&file(index)))
            .collect::<Vec<u64>>()
    };
    assert_eq!(run(), [1; 30]);
    assert_eq!(run(), [1; 30]);
    // What is included counts, too.
    more(2);
    assert_eq!(run(), [2; 30]);
}

#[test]
fn a_stand_in_fails_as_often_as_said_and_the_same_from_the_same_seed() {
    let net = "net n
place idle = 1, asking, failed
data left : int
data done : int
data bad : int
command go -> gone
transition begin
  in idle
  tape go
  set left = 1000
  out asking
transition ask
  in asking
  when left > 0
  request \"bar EXEC\"
  set left = left - 1
  set done = done + 1
  out asking
  fail failed
transition fail_once
  in failed
  set left = left - 1
  set bad = bad + 1
  out asking
transition finish
  in asking
  when not left > 0
  out idle
  write gone
";
    let bad = |seed: u32| -> u32 {
        let (_folder, mut app) = app(net, ", stand_in = { fail = 0.3 }");
        app.seed = u64::from(seed);
        let unseen: Observer = Arc::new(|_| ());
        let ran = simulation::run(app, registry(&["go"]), Setup::default(), &unseen).unwrap();
        let End::Finished(result) = ran.outcome.end else {
            panic!("it did not end")
        };
        let said = result.text.split("(\"bad\", \"").nth(1).unwrap().to_owned();
        said.split('"').next().unwrap().parse().unwrap()
    };
    let counts: Vec<u32> = (0..5).map(bad).collect();
    // Four standard deviations of a binomial distribution: 58.
    assert!(
        counts.iter().all(|count| (242..=358).contains(count)),
        "{counts:?}"
    );
    assert_eq!(counts, (0..5).map(bad).collect::<Vec<u32>>());
    assert!(counts.iter().any(|count| *count != counts[0]), "{counts:?}");
}

#[test]
fn a_condition_that_is_stood_in_for_agrees_with_its_negation_and_says_both() {
    let net = "net n
place idle = 1, asked, yes, no
command go -> said_yes, said_no
transition begin
  in idle
  tape go
  out asked
transition say_yes
  in asked
  when is_dark
  out yes
transition say_no
  in asked
  when not is_dark
  out no
transition tell_yes
  in yes
  out idle
  write said_yes
transition tell_no
  in no
  out idle
  write said_no
";
    let said = ran(net, ", stand_in = true", &["go"; 40]);
    let count = |word: &str| said.matches(word).count();
    assert_eq!(count("said_yes ") + count("said_no "), 40, "{said}");
    assert!(count("said_yes ") > 5 && count("said_no ") > 5, "{said}");
}

#[test]
fn data_in_a_message_has_the_unit_that_the_command_names() {
    use ctos::message::{CommandInfo, Shape, ShapeKind};
    let shape = |unit: &str| {
        let mut shape = Shape::named(ShapeKind::Struct, "", &["far"]);
        shape.inner = vec![Shape {
            kind: ShapeKind::F64,
            unit: unit.to_owned(),
            ..Shape::default()
        }];
        shape
    };
    let found = |declared: &str, unit: &str| {
        let net = format!(
            "net n\nplace p = 1\ndata far : {declared}\ncommand go -> gone\ntransition t\n  in p\n  tape go\n  send objects2.look(far)\n  out p\n  write gone\n"
        );
        let (folder, _) = app(&net, "");
        let file = folder.path().join("app.toml");
        let config = std::fs::read_to_string(&file).unwrap()
            + "[task.objects2]\nhandler = \"camera\"\non = \"a\"\n";
        std::fs::write(&file, config).unwrap();
        let app = load(&file, &[], &[]).unwrap_or_else(|f| panic!("{f}"));
        let mut registry = registry(&[]);
        let look = CommandInfo::declared(1, "look", "", shape(unit), shape("m"));
        registry.handler("camera", &[look], |_| Ok(Person(Vec::new())));
        registry.check(&app).to_string()
    };
    for (declared, unit) in [("px", "px"), ("float", "px"), ("px", ""), ("Nm", "N m")] {
        assert_eq!(found(declared, unit), "", "{declared} {unit}");
    }
    let said = found("m", "px");
    assert!(
        said.contains(
            "n.net:8:8: error: `far` is (m), and command `look` of task `objects2` has (px) there"
        ),
        "{said}"
    );
}

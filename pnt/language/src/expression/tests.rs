use ctos::diagnostic::Source;
use proptest::prelude::*;

use super::*;
use crate::{
    compile,
    exec::Execution,
    net::{Action, Net, SetTo},
};

const HEAD: &str = "net n\nplace p = 1\ndata count : int = 3\ndata name : text = \"ab\"\ndata done : bool\ndata spot { u : px, v : px, sd : mm }\ncommand go(from : int, far : float) -> gone\n";

fn read(rest: &str) -> Result<Net, String> {
    let text = format!("{HEAD}{rest}");
    compile::net(&Source::new("n.net", text)).map_err(|findings| findings.to_string())
}

fn guard(text: &str) -> Result<Net, String> {
    read(&format!("transition t\n  in p\n  when {text}\n  out p\n"))
}

/// What a guard says with these values of count, u and sd.
fn says(text: &str, (count, u, sd): (i64, f64, f64)) -> Result<bool, String> {
    let net = guard(text)?;
    let mut values = net.declared().initial();
    values[0] = Value::Int(count);
    values[3] = Value::Float(u);
    values[5] = Value::Float(sd);
    let values = Values {
        declared: net.declared(),
        values: &values,
        arguments: &[],
    };
    let when = net.transitions()[0].when.as_ref().unwrap();
    let Some(expression) = &when.expression else {
        return Err("it is a name".to_owned());
    };
    let said = expression.evaluate(&values);
    match said.map_err(|error| error.to_string())? {
        Value::Bool(yes) => Ok(yes != when.negated),
        other => panic!("{other:?}"),
    }
}

#[test]
fn guards_over_declared_data_say_what_the_language_says() {
    let values = (2, 0.5, 0.1);
    for (text, wanted) in [
        ("count < 3 && spot.sd < 0.2", true),
        ("not count < 3 && spot.sd < 0.2", false),
        ("not (count < 3)", false),
        ("done", false),
        ("not done", true),
        ("!done || count == 1", true),
        ("spot.u < 1 && 1 > spot.u", true),
        ("spot.u * 2 == 1", true),
        ("count % 2 == 0 ? name.startsWith(\"a\") : false", true),
        ("name + \"#\" == \"ab#\"  # a comment", true),
        ("size(name) == 2 && string(count) == \"2\"", true),
        ("double(count) + spot.u > 2.4", true),
        ("-count < -1", true),
        ("int(spot.u) == 0", true),
    ] {
        assert_eq!(says(text, values), Ok(wanted), "{text}");
    }
}

#[test]
fn a_guard_without_a_value_says_why_and_where() {
    let said = says("10 / count > 1", (0, 0.0, 0.0)).unwrap_err();
    assert_eq!(
        said,
        "n.net:10:8: `10 / count > 1` has no value: it divides by zero"
    );
    let large = says("count + 1 > 0", (i64::MAX, 0.0, 0.0)).unwrap_err();
    assert!(large.ends_with("its number is too large"), "{large}");
}

#[test]
fn what_is_wrong_with_an_expression_is_found_at_its_place() {
    for (text, wanted) in [
        (
            "cout < 3",
            "10:8: error: nothing declares `cout` (did you mean `count`?)",
        ),
        (
            "count < spot.sdd",
            "10:16: error: nothing declares `spot.sdd` (did you mean `spot.sd`?)",
        ),
        ("spot == spot", "error: `spot` has fields"),
        (
            "count",
            "error: this is of type `int`, and `bool` is wanted",
        ),
        (
            "count < name",
            "error: `int` and `text` stand on the two sides",
        ),
        (
            "count < spot.u",
            "error: `int` and `px` stand on the two sides",
        ),
        ("spot.u < spot.sd", "error: `px` and `mm` are two units"),
        ("count / 0 == 1", "error: this divides by zero"),
        ("[1, 2].all(x, x > 0)", "error: a net's expressions have no"),
        ("count in [1, 2]", "error: a net's expressions have no"),
        ("has(spot.u)", "error: a net's expressions have no"),
        ("spot.u.v > 1", "error: a net's expressions have no"),
        (
            "matches(name, \"a\")",
            "error: a net's expressions have no function `matches`",
        ),
        ("count <", "is not an expression"),
        ("count < 3)", "is not an expression"),
        ("from > 1", "error: nothing declares `from`"),
        ("count < 3u", "error: data is no bytes"),
    ] {
        let found = guard(text).expect_err(text);
        assert!(found.contains(wanted), "{text}: {found}");
        assert!(found.starts_with("n.net:10:"), "{text}: {found}");
    }
    let long = format!("name == \"{}\"", "a".repeat(1000));
    assert!(guard(&long).unwrap_err().contains("is too long"));
    let many = format!("count < {}3", "1+".repeat(400));
    assert!(guard(&many).unwrap_err().contains("has too many operators"));
    let deep = format!("{}done{}", "(".repeat(40), ")".repeat(40));
    assert!(guard(&deep).unwrap_err().contains("nested too deeply"));
}

#[test]
fn the_largest_expressions_need_a_small_stack() {
    let look = || {
        for text in [
            format!("count{}>0", "+1".repeat(63)),
            format!("{}done", "done||".repeat(32)),
            format!("{}done{}", "(".repeat(32), ")".repeat(32)),
            format!("{}done", "done?done:".repeat(32)),
            format!("{}done", "!".repeat(32)),
        ] {
            says(&text, (1, 0.0, 0.0)).unwrap_or_else(|found| panic!("{text}: {found}"));
        }
        let _ = guard(&format!("spot{}", ".u".repeat(64)));
        let _ = guard(&format!("count{}", "[0]".repeat(32)));
        let _ = guard(&format!("count{}", ".f()".repeat(32)));
    };
    // Half of what the runtime's threads have.
    let thread = std::thread::Builder::new().stack_size(1 << 20).spawn(look);
    thread.unwrap().join().unwrap();
}

#[test]
fn data_its_types_and_what_sets_it_are_checked() {
    let action = |lines: &str| read(&format!("transition t\n  in p\n  {lines}\n  out p\n"));
    for fits in [
        "set count = count + from",
        "set spot.u = 2 * spot.v",
        "set spot.sd = far",
        "request \"x EXEC FMSG 4 $spot $spot.u\"\n  set spot = reply",
        "log \"$count of $$5, $spot.u, $name.\"",
        "wait 2 s\n  set done = true",
        "request \"x EXEC\"\n  set spot = reply",
    ] {
        action(fits).unwrap_or_else(|found| panic!("{fits}: {found}"));
    }
    for (wrong, wanted) in [
        (
            "set count = 0.5",
            "10:15: error: this is of type `float`, and `int` is wanted",
        ),
        (
            "set count = \"a\"",
            "error: this is of type `text`, and `int` is wanted",
        ),
        (
            "set cuont = 1",
            "10:7: error: nothing declares data `cuont` (did you mean `count`?)",
        ),
        (
            "set spot = 1",
            "error: `spot` has fields, and an expression is one value",
        ),
        ("set spot.u = spot.sd", "error: `px` and `mm` are two units"),
        (
            "set spot = reply",
            "error: `spot` shall be a reply, and this transition makes no request",
        ),
        (
            "request \"x EXEC $cunt\"",
            "10:19: error: nothing declares `cunt` (did you mean `count`?)",
        ),
        (
            "request \"x EXEC $spot.w\"",
            "error: `spot` has no field `w`",
        ),
        ("log \"5 $\"", "error: a `$` stands before a name of data"),
        ("do f(count)", "error: `count` is data of the net"),
        (
            "do f\n  set count = 1",
            "error: transition `t` sets data beside a `do` or `send` line",
        ),
        (
            "log \"a\"\n  wait 2 s",
            "error: `wait`: this transition already has an action",
        ),
        ("out p data spot = 3", "expected `reply`"),
        (
            "out p data spot = rep",
            "error: a place stores what a request was answered",
        ),
    ] {
        let found = action(wrong).expect_err(wrong);
        assert!(found.contains(wanted), "{wrong}: {found}");
    }
    for (line, wanted) in [
        ("data x : inch", "error: `inch` is no type and no unit"),
        (
            "data x : int = \"a\"",
            "error: this is of type `text`, and `int` is wanted",
        ),
        ("data x : int = 7 / (1 - 1)", "it divides by zero"),
        ("data x : int = count", "nothing declares `count`"),
        ("data count : int", "error: data `count` is there twice"),
        (
            "data x { a : int, a : int }",
            "error: field `a` is there twice",
        ),
        ("data true : bool", "error: data cannot be called `true`"),
        (
            "command walk(from : text) -> walked",
            "is of another type in another command",
        ),
        (
            "command walk(count : int) -> walked",
            "is the name of data, too",
        ),
    ] {
        let found = read(&format!("{line}\ntransition t\n  in p\n  out p\n")).expect_err(line);
        assert!(found.contains(wanted), "{line}: {found}");
    }
}

#[test]
fn an_answer_is_stored_with_a_place_or_by_a_line_of_its_own() {
    let text = "transition t\n  in p\n  request \"x EXEC\"\n  out p data spot = reply\n";
    let net = read(text).unwrap();
    let Some(Action::Written { sets, .. }) = &net.transitions()[0].action else {
        panic!("no action");
    };
    assert!(matches!(sets[0].to, SetTo::Reply) && sets[0].slots == (3..6));
    let same = text.replace("out p data spot = reply", "set spot = reply\n  out p");
    assert_eq!(read(&same).unwrap().digest(), net.digest());
}

#[test]
fn arguments_of_a_command_are_of_the_declared_types_or_refused() {
    let net = read("transition t\n  in p\n  tape go\n  out p\n  write gone\n").unwrap();
    let mut execution = Execution::new(std::sync::Arc::new(net));
    let mut put = |words: &[&str]| {
        let words = words.iter().map(|word| (*word).to_owned()).collect();
        execution
            .put_symbol("go", words)
            .map_err(|error| error.to_string())
    };
    assert!(put(&["3", "0.5"]).is_ok());
    let wanted = "command `go` of net `n` takes (from : int, far : float), and ";
    assert_eq!(put(&["3"]).unwrap_err(), format!("{wanted}1 came with it"));
    assert_eq!(
        put(&["3; 4", "1"]).unwrap_err(),
        format!("{wanted}`3; 4` is no int for `from`")
    );
    assert!(put(&["3", "inf"]).is_err());
}

#[test]
fn parameters_of_a_subnet_stand_in_expressions_and_lines() {
    let net = read(
        "subnet s(here, most, what)\n  transition t\n    in here\n    when what < most && name != \"most\"\n    log \"$what most\"\n    set what = what + most\n    out here\nend\nuse s(p, 7, count) as a\n",
    )
    .unwrap();
    let one = &net.transitions()[0];
    let when = one.when.as_ref().unwrap();
    assert_eq!(when.function, "count < 7 && name != \"most\"");
    let Some(Action::Written { sets, .. }) = &one.action else {
        panic!("{:?}", one.action);
    };
    assert!(matches!(&sets[0].to, SetTo::Value(value) if value.text() == "count + 7"));
    assert_eq!(one.action.as_ref().unwrap().called(), "log $count most");
}

proptest! {
    #[test]
    fn no_expression_makes_it_panic_and_one_that_is_accepted_has_a_value_or_says_why(
        words in prop::collection::vec(prop::sample::select(vec![
            "count", "spot.u", "name", "done", "1", "0", "-3", "2.5", "\"a\"", "+", "-", "*", "/",
            "%", "<", "==", "&&", "||", "!", "?", ":", "(", ")", "int(", "double(", "string(",
            "size(", ".startsWith(", "[", "]", "{", "}", ",", "'", "`", "\\", "r\"", "b'", "1e400", "ä",
        ]), 1..12),
        count in any::<i64>(),
        u in any::<f64>(),
    ) {
        let u = if u.is_finite() { u } else { 0.0 };
        let _ = says(&words.join(" "), (count, u, 0.0));
    }
}

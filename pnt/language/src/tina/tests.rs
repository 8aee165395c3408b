use super::*;
use crate::format::{self, Format};

fn draft(text: &str) -> Draft {
    let file = format::read_bytes("a.net", text.as_bytes()).unwrap_or_else(|f| panic!("{f}"));
    assert_eq!(file.format, Format::Tina);
    file.draft
}

fn findings(text: &str) -> Vec<String> {
    match read(&Source::new("a.net", text)) {
        Ok(draft) => panic!("read: {draft}"),
        Err(findings) => findings
            .into_sorted()
            .iter()
            .map(ToString::to_string)
            .collect(),
    }
}

#[test]
fn every_line_of_the_manual_is_read() {
    let text = "# a comment
net {my net}
tr t1 : label [0,w[ p1*2 p2?3 p3?-4 -> p4 {p 5}*6
tr t2 [3,3] p4 -> p1*2
tr {a\\}b} p4 -> p4
pl p1 (2)
pl p2 : two (1K) t2*7 -> t1
lb p1 {what it is}
nt n1 0 {a note}
";
    assert_eq!(
        draft(text).to_string(),
        "net \"my net\"
place p1 = 2
place p2 = 1000
place p3
place p4
place \"p 5\"
transition t1
  in p1*2, p2
  read p2*3
  inhibit p3*4
  out p4, \"p 5\"*6
transition t2
  in p4
  out p1*2, p2*7
  time 3 s
transition \"a}b\"
  in p4
  out p4
"
    );
}

#[test]
fn parallel_arcs_add_up() {
    let text = "tr t p p*2 -> q\npl p (1) -> t*3\n";
    assert_eq!(draft(text).transitions[0].inputs[0].weight, 6);
}

#[test]
fn what_has_no_counterpart_is_refused_by_name_all_at_once() {
    let found = findings(
        "tr t [1,2] p -> q\ntr u p!2 -> q\npr t > u\ntr v p*0 -> q\npl p (99999999999999999999)\npl q (1)\npl q (2)\nxx\ntr w p -> q?1\ntr {x\n",
    );
    let starts = [
        "a.net:1:6: error: the time interval `[1,2]`",
        "a.net:2:7: error: stopwatch arcs",
        "a.net:3:1: error: priorities",
        "a.net:4:7: error: the arc's weight cannot be 0",
        "a.net:5:7: error: the marking is more than can be counted",
        "a.net:7:4: error: the marking of place `q` is given twice",
        "a.net:8:1: error: no line of a TINA net begins with `xx`",
        "a.net:9:12: error: read and inhibitor arcs",
        "a.net:10:4: error: expected a `}`",
    ];
    assert_eq!(found.len(), starts.len(), "{found:#?}");
    for (line, start) in found.iter().zip(starts) {
        assert!(
            line.starts_with(start),
            "{line}\nshould start with\n{start}"
        );
    }
    assert!(findings("net n\npl p (1)\n")[0].contains("no transition"));
}

#[test]
fn what_is_written_is_read_as_the_same_net() {
    let net = "net \"my net\"\nplace p = 2\nplace \"{x}\\\\ y\"\ntransition t\n  in p*2\n  read \"{x}\\\\ y\"*3\n  inhibit p*4\n  out p, \"{x}\\\\ y\"*2\n  time 2 s\ntransition 7\n".replace("transition 7", "transition \"7\"\n  in p");
    let draft = crate::text::parse(&Source::new("n", net)).unwrap();
    let written = write(&draft).unwrap_or_else(|f| panic!("{f}"));
    assert_eq!(
        read(&Source::new("w", written.clone())).unwrap_or_else(|f| panic!("{f}\n{written}")),
        draft
    );
    assert_eq!(format::sniff(&written), Format::Tina);
}

#[test]
fn what_tina_cannot_say_is_refused_with_its_place() {
    let net = "net n\nplace p capacity 3\ncommand c -> d\ntransition t\n  tape c\n  do f\n  write d\ntransition u\n  in p\n  time 1.5 s\n";
    let draft = crate::text::parse(&Source::new("n.net", net)).unwrap();
    let found = write(&draft).unwrap_err();
    assert_eq!(found.iter().count(), 4, "{found}");
}

proptest::proptest! {
    #[test]
    fn no_text_makes_the_reader_panic(text in "(tr|pl|pr|net|[a-c{}\\[\\],w0-9 ()*?!:>\\-\\\\\n])*") {
        let _ = read(&Source::new("any", text));
    }
}

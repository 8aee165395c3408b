use std::collections::BTreeSet;

use proptest::prelude::*;

use super::*;
use crate::{
    draft::{Draft, DraftArc, Word},
    format::{self, Format, NetFile},
    text::tests::a_draft,
    timing::{Servers, Timing},
};

const HEAD: &str = "<pnml xmlns=\"http://www.pnml.org/version-2009/grammar/pnml\">\n<net id=\"n\" type=\"http://www.pnml.org/version-2009/grammar/ptnet\">\n<page id=\"g\">\n";
const TAIL: &str = "</page></net></pnml>\n";

fn document(inside: &str) -> String {
    format!("{HEAD}{inside}{TAIL}")
}

fn read_text(text: &str) -> NetFile {
    format::read_bytes("a.pnml", text.as_bytes()).unwrap_or_else(|f| panic!("{f}"))
}

fn bytes_findings(bytes: &[u8]) -> Vec<String> {
    match format::read_bytes("a.pnml", bytes) {
        Ok(file) => panic!("read: {}", file.draft),
        Err(findings) => findings
            .into_sorted()
            .iter()
            .map(|finding| {
                assert!(finding.help.is_some(), "{finding} says nothing to do");
                format!("{finding}")
            })
            .collect(),
    }
}

/// The findings about a net whose page holds `inside`, which begins on line 4.
fn findings(inside: &str) -> Vec<String> {
    bytes_findings(document(inside).as_bytes())
}

/// The only finding.
#[track_caller]
fn one(inside: &str, start: &str) {
    let found = findings(inside);
    assert!(
        found.len() == 1 && found[0].starts_with(start),
        "{found:#?}\nshould be\n{start}"
    );
}

const NODES: &str = "<place id=\"p\"/><place id=\"q\"/><transition id=\"t\"/>\n";

/// Two places, a transition, and `rest` from line 5.
#[track_caller]
fn one_after(rest: &str, start: &str) {
    one(&format!("{NODES}{rest}"), start);
}

#[test]
fn a_net_of_the_standard_is_read_with_its_names_weights_and_positions() {
    let file = read_text(&document(
        "<arc id=\"a\" source=\"p\" target=\"t\"><inscription><text> 2 </text></inscription><graphics><position x=\"5\" y=\"6\"/></graphics></arc>
<place id=\"p\"><name><text>in box</text></name><graphics><position x=\"1\" y=\"-2.5\"/></graphics><initialMarking><text>3</text></initialMarking></place>
<page id=\"inner\"><transition id=\"t\"><name><text>go</text></name></transition>
<referencePlace id=\"r\" ref=\"r2\"/><referencePlace id=\"r2\" ref=\"p\"/>
<arc id=\"b\" source=\"t\" target=\"r\"/></page>\n",
    ));
    assert!(file.warnings.is_empty(), "{}", file.warnings);
    assert_eq!(
        file.draft.to_string(),
        "net n\nplace \"in box\" = 3\ntransition go\n  in \"in box\"*2\n  out \"in box\"\n"
    );
    assert_eq!(file.positions.places["in box"], [1.0, -2.5]);
    let arc = (true, "in box".to_owned(), "go".to_owned());
    assert_eq!(file.positions.arcs[&arc], [[5.0, 6.0]]);
    file.compile().unwrap();
}

#[test]
fn parallel_arcs_add_up() {
    let arc = |id: &str, weight: u32| {
        format!(
            "<arc id=\"{id}\" source=\"p\" target=\"t\"><inscription><text>{weight}</text></inscription></arc>"
        )
    };
    let file = read_text(&document(&format!("{NODES}{}{}", arc("a", 2), arc("b", 3))));
    assert_eq!(file.draft.transitions[0].inputs.len(), 1);
    assert_eq!(file.draft.transitions[0].inputs[0].weight, 5);
    let many: String = (0..5)
        .map(|n| arc(&format!("a{n}"), 1_000_000_000))
        .collect();
    let found = findings(&format!("{NODES}{many}"));
    assert!(
        found.len() == 4 && found[0].contains("add up to more"),
        "{found:#?}"
    );
}

#[test]
fn nodes_that_share_a_name_are_called_by_their_ids() {
    let named = |id: &str, name: &str| {
        format!("<place id=\"{id}\"><name><text>{name}</text></name></place>")
    };
    let names = |inside: &str| -> Vec<String> {
        let text = document(&format!("{inside}<transition id=\"t\"/>"));
        let places = read_text(&text).draft.places;
        places.into_iter().map(|place| place.name.text).collect()
    };
    let same = named("a", "x") + &named("b", "x") + &named("c", "y");
    assert_eq!(names(&same), ["a", "b", "y"]);
    // A name that is another's id would be two places' name.
    let crossed = named("a", "x") + &named("b", "x") + &named("c", "a");
    assert_eq!(names(&crossed), ["a", "b", "c"]);
    assert_eq!(names(&(named("a", " ") + "<place id=\"b\"/>")), ["a", "b"]);
}

#[test]
fn broken_structure_is_told_at_its_place() {
    one_after(
        "<arc id=\"a\" source=\"p\" target=\"x\"/>",
        "a.pnml:5:32: error: the target of this arc is `x`, and no node has that id",
    );
    one_after(
        "<arc id=\"a\" target=\"t\"/>",
        "a.pnml:5:1: error: this arc has no `source`",
    );
    one_after(
        "<arc id=\"a\" source=\"p\" target=\"q\"/>",
        "a.pnml:5:10: error: this arc joins two places",
    );
    one_after(
        "<arc id=\"a\" source=\"t\" target=\"t\"/>",
        "a.pnml:5:10: error: this arc joins two transitions",
    );
    one_after(
        "<place id=\"t\"/>",
        "a.pnml:5:12: error: the id `t` of this place is there already",
    );
    one_after(
        "<page id=\"p\"/>",
        "a.pnml:5:11: error: the id `p` of this page is there already",
    );
    one_after("<place/>", "a.pnml:5:1: error: this place has no id");
    one_after(
        "<place id=\"z\"><name><text>a</text></name><name><text>b</text></name></place>",
        "a.pnml:5:42: error: this place has a second `name`",
    );
    one_after(
        "<referencePlace id=\"r\" ref=\"s\"/>",
        "a.pnml:5:29: error: the ref of this referencePlace is `s`, and no node has that id",
    );
    one_after(
        "<referencePlace id=\"r\" ref=\"t\"/>",
        "a.pnml:5:29: error: this referencePlace refers to a node of another kind",
    );
    one_after(
        "<arc id=\"a\" source=\"t\" target=\"p\" type=\"inhibitor\"/>",
        "a.pnml:5:10: error: an inhibitor, read or reset arc leads from a place",
    );
    let circle = "<referencePlace id=\"r\" ref=\"s\"/><referencePlace id=\"s\" ref=\"r\"/>";
    let found = findings(&format!("{NODES}{circle}"));
    assert!(
        found.len() == 2 && found[0].contains("in a circle"),
        "{found:#?}"
    );
    let found = findings(&format!(
        "{NODES}{circle}<arc id=\"a\" source=\"r\" target=\"t\"/>"
    ));
    assert_eq!(
        found.len(),
        2,
        "an arc to it is no finding of its own: {found:#?}"
    );
    one(
        "<place id=\"p\"/>",
        "a.pnml:2:1: error: this net has no transition",
    );
}

#[test]
fn all_mistakes_of_a_file_are_found_at_once() {
    let found = findings(&format!(
        "{NODES}<arc id=\"a\" source=\"p\" target=\"q\"/>\n<arc id=\"b\" source=\"p\" target=\"x\"/>\n<place id=\"z\"><initialMarking><text>-1</text></initialMarking></place>"
    ));
    assert_eq!(found.len(), 3, "{found:#?}");
    assert!(
        found[2].starts_with("a.pnml:7:37: error: the initial marking cannot be `-1`"),
        "{found:#?}"
    );
}

#[test]
fn a_file_with_very_many_mistakes_is_given_up_soon() {
    let arcs: String = (0..5_000)
        .map(|n| format!("<arc id=\"{n}\" source=\"no\" target=\"t\"/>"))
        .collect();
    let count = findings(&format!("{NODES}{arcs}")).len();
    assert!((100..1000).contains(&count), "{count}");
}

#[test]
fn numbers_that_cannot_be_counted_are_refused_and_never_wrap() {
    for bad in [
        "-2",
        "",
        "x",
        "1.0",
        "1e3",
        "+1",
        "0x1",
        "4294967296",
        "18446744073709551616",
        "1000000001",
        "1 2",
        "１",
    ] {
        let marking =
            format!("<place id=\"z\"><initialMarking><text>{bad}</text></initialMarking></place>");
        one_after(&marking, "a.pnml:5:");
        let weight = format!(
            "<arc id=\"a\" source=\"p\" target=\"t\"><inscription><text>{bad}</text></inscription></arc>"
        );
        one_after(&weight, "a.pnml:5:");
    }
    one_after(
        "<arc id=\"a\" source=\"p\" target=\"t\"><inscription><text>0</text></inscription></arc>",
        "a.pnml:5:54: error: the arc's weight cannot be 0",
    );
    let long = "9".repeat(1 << 20);
    let marking =
        format!("<place id=\"z\"><initialMarking><text>{long}</text></initialMarking></place>");
    let found = findings(&format!("{NODES}{marking}"));
    assert!(found[0].len() < 300, "a message is for people");
}

#[test]
fn what_is_no_place_transition_net_is_refused_by_name() {
    let with = |kind: &str| document(NODES).replace("grammar/ptnet", kind);
    for kind in [
        "grammar/symmetricnet",
        "grammar/highlevelnet",
        "grammar/pt-hlpng",
    ] {
        let found = bytes_findings(with(kind).as_bytes());
        let name = kind.rsplit('/').next().unwrap();
        assert!(
            found[0].contains(name) && found[0].starts_with("a.pnml:2:"),
            "{found:#?}"
        );
    }
    assert!(bytes_findings(with("grammar/other").as_bytes())[0].contains("is not known"));
    one_after(
        "<place id=\"z\"><hlinitialMarking/></place>",
        "a.pnml:5:15: error: a `hlinitialMarking` of a place has no counterpart",
    );
    one_after(
        "<arc id=\"a\" source=\"p\" target=\"t\" type=\"transport\" inscription=\"[0,inf):1\"/>",
        "a.pnml:5:10: error: an arc of type `transport` has no counterpart",
    );
    one_after(
        "<place id=\"z\" invariant=\"&lt;= 3\"/>",
        "a.pnml:5:26: error: a place with a time invariant",
    );
    assert!(bytes_findings(b"<html></html>")[0].contains("is a `html` and no PNML"));
    assert!(bytes_findings(b"<pnml/>")[0].contains("holds no net"));
    let two = document(NODES).replace(
        "</net>",
        "</net><net id=\"m\" type=\"http://www.pnml.org/version-2009/grammar/ptnet\"/>",
    );
    assert!(bytes_findings(two.as_bytes())[0].contains("this is a second one"));
}

#[test]
fn dialects_are_read_with_a_warning() {
    let pipe = "<pnml><net id=\"Net-One\" type=\"P/T net\">
<token id=\"Default\" enabled=\"true\"/>
<place id=\"P0\"><graphics><position x=\"15.0\" y=\"30.0\"/></graphics><name><value>P0</value><graphics/></name>
<initialMarking><value>Default,2</value></initialMarking><capacity><value>0</value></capacity></place>
<place id=\"P1\"><initialMarking><value>0</value></initialMarking><capacity><value>4</value></capacity></place>
<transition id=\"T0\"><orientation><value>0</value></orientation><rate><value>4.0</value></rate>
<timed><value>true</value></timed><infiniteServer><value>true</value></infiniteServer><priority><value>1</value></priority></transition>
<transition id=\"T1\"><rate><value>3</value></rate><timed><value>false</value></timed><infiniteServer><value>false</value></infiniteServer><priority><value>2</value></priority></transition>
<arc id=\"a\" source=\"P0\" target=\"T0\"><inscription><value>Default,2</value></inscription><tagged><value>false</value></tagged><arcpath id=\"000\" x=\"1\" y=\"2\" curvePoint=\"false\"/><type value=\"normal\"/></arc>
<arc id=\"b\" source=\"P1\" target=\"T1\"><type value=\"inhibitor\"/></arc></net></pnml>";
    let file = read_text(pipe);
    assert_eq!(
        file.warnings.iter().count(),
        2,
        "type and `token`: {}",
        file.warnings
    );
    let [p0, p1] = &file.draft.places[..] else {
        panic!()
    };
    assert_eq!((p0.tokens, p0.capacity, p1.capacity), (2, None, Some(4)));
    let [t0, t1] = &file.draft.transitions[..] else {
        panic!()
    };
    let mean = std::time::Duration::from_millis(250);
    assert_eq!(
        (t0.timing, t0.servers),
        (Timing::Exponential { mean }, Some(Servers::Many))
    );
    assert!((t1.weight - 3.0).abs() < 1e-9 && t1.priority == 2);
    assert_eq!(t0.inputs[0].weight, 2);
    assert_eq!(t1.inhibitors.len(), 1);

    let tapaal = "<pnml xmlns=\"http://www.informatik.hu-berlin.de/top/pnml/ptNetb\"><net active=\"true\" id=\"N\" type=\"P/T net\">
<place displayName=\"true\" id=\"P0\" initialMarking=\"3\" invariant=\"&lt; inf\" name=\"P0\" positionX=\"240\" positionY=\"165\"/>
<transition id=\"T0\" infiniteServer=\"false\" name=\"T0\" positionX=\"1\" positionY=\"2\" priority=\"0\" urgent=\"false\"/>
<arc id=\"I0\" inscription=\"[0,inf)\" source=\"P0\" target=\"T0\" type=\"timed\" weight=\"2\"><arcpath arcPointType=\"false\" id=\"0\" xCoord=\"1\" yCoord=\"2\"/></arc>
<arc id=\"I1\" inscription=\"[0,inf)\" source=\"P0\" target=\"T0\" type=\"tapnInhibitor\" weight=\"3\"/>
<arc id=\"O0\" inscription=\"1\" source=\"T0\" target=\"P0\" type=\"normal\" weight=\"4\"/></net></pnml>";
    let draft = read_text(tapaal).draft;
    assert_eq!(
        draft.to_string(),
        "net N\nplace P0 = 3\ntransition T0\n  in P0*2\n  inhibit P0*3\n  out P0*4\n"
    );

    let prom = document(&format!(
        "{NODES}<arc id=\"a\" source=\"p\" target=\"t\"><name><text>2</text></name><arctype><text>normal</text></arctype><inscription><text>2</text></inscription></arc>
<arc id=\"b\" source=\"q\" target=\"t\"><arctype><text>reset</text></arctype></arc>"
    ))
    .replace("grammar/ptnet", "pnmlcoremodel");
    let file = read_text(&prom);
    assert_eq!(file.warnings.iter().count(), 1);
    assert_eq!(file.draft.transitions[0].resets[0].text, "q");
}

#[test]
fn a_net_without_pages_and_with_prefixes_and_cdata_is_read() {
    let text = "<p:pnml xmlns:p=\"http://www.pnml.org/version-2009/grammar/pnml\"><p:net id=\"n\" type=\"http://www.pnml.org/version-2009/grammar/ptnet\">\r\n<p:place id=\"a\"><p:name><p:text><![CDATA[x < y]]></p:text></p:name><p:initialMarking><p:text><!-- two -->2</p:text></p:initialMarking></p:place><p:transition id=\"t\"/></p:net></p:pnml>";
    let draft = read_text(text).draft;
    assert_eq!(
        (draft.places[0].name.text.as_str(), draft.places[0].tokens),
        ("x < y", 2)
    );
}

#[test]
fn every_encoding_that_a_file_says_is_read() {
    let body =
        document("<place id=\"p\"><name><text>Brücke</text></name></place><transition id=\"t\"/>");
    let name = |bytes: &[u8]| {
        let file = format::read_bytes("a", bytes).unwrap_or_else(|f| panic!("{f}"));
        file.draft.places[0].name.text.clone()
    };
    let utf16 = |big: bool, mark: bool, text: &str| -> Vec<u8> {
        let mark = if mark { "\u{feff}" } else { "" };
        let units = mark
            .encode_utf16()
            .chain(text.encode_utf16())
            .collect::<Vec<_>>();
        let bytes = |unit: u16| {
            if big {
                unit.to_be_bytes()
            } else {
                unit.to_le_bytes()
            }
        };
        units.into_iter().flat_map(bytes).collect()
    };
    let declared =
        |encoding: &str| format!("<?xml version=\"1.0\" encoding='{encoding}'?>\n{body}");
    assert_eq!(name(body.as_bytes()), "Brücke");
    assert_eq!(
        name(format!("\u{feff}{}", declared("UTF-8")).as_bytes()),
        "Brücke"
    );
    for (big, mark) in [(false, false), (false, true), (true, false), (true, true)] {
        assert_eq!(
            name(&utf16(big, mark, &declared("UTF-16"))),
            "Brücke",
            "{big} {mark}"
        );
    }
    let latin: Vec<u8> = declared("ISO-8859-1").chars().map(|c| c as u8).collect();
    assert_eq!(name(&latin), "Brücke");
    let wrong: Vec<u8> = body.chars().map(|c| c as u8).collect();
    assert!(
        bytes_findings(&wrong)[0]
            .starts_with("a.pnml:4:29: error: `a.pnml` is not UTF-8 text here")
    );
    assert!(bytes_findings(declared("KLINGON").as_bytes())[0].contains("no known encoding"));
}

#[test]
fn xml_is_read_safely() {
    let bomb = "<?xml version=\"1.0\"?>\n<!DOCTYPE lolz [<!ENTITY a \"aaaa\"><!ENTITY b \"&a;&a;&a;\">]>\n<pnml>&b;</pnml>";
    assert!(
        bytes_findings(bomb.as_bytes())[0]
            .starts_with("a.pnml:2:1: error: this document has a document type")
    );
    let outside = "<!DOCTYPE x SYSTEM \"file:///etc/passwd\"><pnml/>";
    assert!(bytes_findings(outside.as_bytes())[0].contains("document type"));
    one_after("&nobody;", "a.pnml:5:");
    let deep = document(&("<page>".repeat(1000) + &"</page>".repeat(1000)));
    assert!(bytes_findings(deep.as_bytes())[0].contains("nested more than 128 deep"));
    let unclosed = "<pnml>".repeat(100_000);
    assert!(bytes_findings(unclosed.as_bytes())[0].contains("nested more than"));
    let attributes: String = (0..10_000).map(|n| format!(" a{n}=\"\"")).collect();
    assert!(bytes_findings(format!("<pnml{attributes}/>").as_bytes())[0].contains("attributes"));
}

#[test]
fn a_file_cut_off_anywhere_is_refused_and_never_half_read() {
    let whole = document(&format!(
        "{NODES}<arc id=\"a\" source=\"p\" target=\"t\"><inscription><text>2</text></inscription></arc>"
    ));
    let whole = whole.trim_end();
    read_text(whole);
    for end in 1..whole.len() {
        let found = bytes_findings(&whole.as_bytes()[..end]);
        assert!(
            found.len() == 1 && found[0].starts_with("a.pnml:"),
            "{end}: {found:#?}"
        );
    }
}

#[test]
fn positions_and_foreign_sections_survive_and_ours_is_read_back() {
    let nupn = "<toolspecific tool=\"nupn\" version=\"1.1\"><size  places='2'/></toolspecific>";
    let woped = "<toolspecific tool=\"WoPeD\" version=\"1.0\"><w:trigger xmlns:w=\"urn:w\" z:id=\"\" type=\"200\"/></toolspecific>";
    let offset = "<graphics><offset x=\"3\" y=\"4\"/></graphics>";
    let drawn = "<graphics><position x=\"1\" y=\"2\"/><fill color=\"red\"/></graphics>";
    let text = document(&format!(
        "{nupn}<place id=\"P-7\"><name><text>p</text>{offset}</name>{drawn}<toolspecific tool=\"pnt\" version=\"1\"><text>capacity 3 data path</text></toolspecific></place>
<transition id=\"T.1\"><name><text>t</text></name>{woped}<toolspecific tool=\"pnt\" version=\"1\"><text>do f
within 2 s
fail p</text></toolspecific></transition>
<arc id=\"A\" source=\"P-7\" target=\"T.1\">{drawn}</arc>"
    ))
    .replace("<pnml ", "<pnml xmlns:z=\"urn:z\" ");
    let file = read_text(&text);
    assert!(file.warnings.is_empty(), "{}", file.warnings);
    assert_eq!(
        file.draft.to_string(),
        "net n\nplace p capacity 3 data path\ntransition t\n  in p\n  do f\n  fail p\n  within 2 s\n"
    );
    let written = write(&file).unwrap_or_else(|f| panic!("{f}"));
    for kept in [
        nupn,
        woped,
        offset,
        drawn,
        "id=\"P-7\"",
        "id=\"T.1\"",
        "id=\"A\"",
        "xmlns:z=\"urn:z\"",
    ] {
        assert!(written.contains(kept), "{kept} is lost in\n{written}");
    }
    let again = read_text(&written);
    assert_eq!(
        (again.draft, again.positions, again.kept),
        (file.draft, file.positions, file.kept)
    );
}

#[test]
fn a_mistake_in_our_own_section_is_told_where_it_stands() {
    let section = |text: &str| {
        format!(
            "{NODES}<transition id=\"u\"><toolspecific tool=\"pnt\" version=\"1\"><text>{text}</text></toolspecific></transition>"
        )
    };
    one(
        &section("do f\n  wthin 2 s"),
        "a.pnml:6:3: error: no line of net text begins with `wthin` (did you mean `within`?)",
    );
    // Escapes do not move the line.
    one(
        &section("do &quot;f&quot;\n  wthin 2 s"),
        "a.pnml:6:3: error:",
    );
}

/// A draft as PNML keeps it. Names differ and have no blanks around them. Arcs of one kind go to
/// different places; those to places that exist come first.
fn in_pnml(mut draft: Draft) -> Draft {
    fn distinct<'a>(words: impl Iterator<Item = &'a mut Word>) -> BTreeSet<String> {
        let mut seen = BTreeSet::new();
        for (index, word) in words.enumerate() {
            let plain: String = word.text.chars().filter(|c| kept(*c)).collect();
            word.text = plain.trim().to_owned();
            if word.text.is_empty() || !seen.insert(word.text.clone()) {
                word.text = format!("{} {index}", word.text).trim().to_owned();
                seen.insert(word.text.clone());
            }
        }
        seen
    }
    fn kept(c: char) -> bool {
        !c.is_control() && !['\u{fffe}', '\u{ffff}'].contains(&c)
    }
    fn arranged(arcs: &mut Vec<DraftArc>, here: &BTreeSet<String>) {
        let mut seen = BTreeSet::new();
        let key = |arc: &DraftArc| {
            (
                arc.place.text.clone(),
                arc.net.as_ref().map(|n| n.text.clone()),
            )
        };
        arcs.retain(|arc| seen.insert(key(arc)));
        // Lines of the section come before the arcs.
        arcs.sort_by_key(|arc| arc.net.is_none() && here.contains(&arc.place.text));
    }
    let here = distinct(draft.places.iter_mut().map(|place| &mut place.name));
    distinct(draft.transitions.iter_mut().map(|t| &mut t.name));
    distinct([&mut draft.name].into_iter());
    for transition in &mut draft.transitions {
        for arcs in [
            &mut transition.inputs,
            &mut transition.reads,
            &mut transition.inhibitors,
            &mut transition.outputs,
        ] {
            arranged(arcs, &here);
        }
        let mut seen = BTreeSet::new();
        transition
            .resets
            .retain(|word| seen.insert(word.text.clone()));
        transition
            .resets
            .sort_by_key(|word| here.contains(&word.text));
    }
    draft.title = draft
        .title
        .map(|title| title.chars().filter(|c| kept(*c)).collect());
    draft
}

fn file_of(draft: Draft) -> NetFile {
    NetFile {
        format: Format::Text,
        draft,
        positions: format::Positions::default(),
        kept: Kept::default(),
        warnings: ctos::diagnostic::Findings::new(),
    }
}

#[test]
fn names_that_xml_would_change_are_refused() {
    for name in ["a\nb", " a", "a\u{1}", "\u{ffff}"] {
        let mut draft = Draft::new(Word::from("n"));
        draft
            .places
            .push(crate::draft::DraftPlace::new(Word::from(name)));
        assert!(write(&file_of(draft)).is_err(), "{name:?}");
    }
}

proptest! {
    #[test]
    fn what_is_written_is_read_as_the_same_net(draft in a_draft()) {
        if draft.transitions.is_empty() {
            return Ok(());
        }
        let draft = in_pnml(draft);
        let written = write(&file_of(draft.clone())).unwrap_or_else(|f| panic!("{f}"));
        let file = format::read_bytes("w", written.as_bytes());
        let file = file.unwrap_or_else(|f| panic!("{f}\n{written}"));
        prop_assert!(file.warnings.is_empty(), "{}", file.warnings);
        prop_assert_eq!(&file.draft, &draft, "{}", written);
        // And so is what is written of that, with what was kept.
        prop_assert_eq!(write(&file).unwrap_or_default(), written);
    }

    #[test]
    fn what_is_written_keeps_to_the_grammar_of_the_standard(draft in a_draft()) {
        if draft.transitions.is_empty() {
            return Ok(());
        }
        let written = write(&file_of(in_pnml(draft))).unwrap_or_else(|f| panic!("{f}"));
        prop_assert_eq!(against_the_grammar(&written), [""; 0], "{}", written);
    }

    #[test]
    fn every_net_that_is_read_has_a_text_form(draft in a_draft()) {
        if draft.transitions.is_empty() {
            return Ok(());
        }
        let written = write(&file_of(in_pnml(draft))).unwrap_or_else(|f| panic!("{f}"));
        let file = format::read_bytes("w", written.as_bytes()).unwrap_or_else(|f| panic!("{f}"));
        let text = file.draft.to_string();
        let again = format::read_bytes("t", text.as_bytes()).unwrap_or_else(|f| panic!("{f}\n{text}"));
        prop_assert_eq!(again.format, Format::Text);
        prop_assert_eq!(again.draft, file.draft);
    }

    #[test]
    fn no_bytes_make_the_reader_panic(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        let _ = format::read_bytes("any", &bytes);
    }

    #[test]
    fn no_mixture_of_elements_makes_the_reader_panic(
        parts in prop::collection::vec(prop::sample::select(vec![
            "<place id=\"p\">", "</place>", "<place id=\"q\"/>", "<transition id=\"t\">", "</transition>",
            "<transition id=\"u\"/>", "<arc id=\"a\" source=\"p\" target=\"t\">", "</arc>",
            "<arc source=\"t\" target=\"q\"/>", "<page>", "</page>", "<referencePlace id=\"r\" ref=\"p\"/>",
            "<referenceTransition id=\"s\" ref=\"r\"/>", "<name>", "</name>", "<text>", "</text>", "2", "-",
            "<initialMarking>", "</initialMarking>", "<inscription>", "</inscription>",
            "<toolspecific tool=\"pnt\">", "</toolspecific>", "do f", "&lt;", "<![CDATA[", "]]>", "<!--", "-->",
            "<graphics><position x=\"1\" y=\"nan\"/></graphics>", "<?x", "?>", "ä", "\n",
        ]), 0..40),
    ) {
        let _ = format::read_bytes("any", document(&parts.concat()).as_bytes());
    }
}

#[test]
fn what_other_tools_do_not_read_is_told_by_kind() {
    let text = "net n
place a = 1 capacity 3, b
transition t
  in a
  inhibit b
  do f
  out b, p@other
transition u
  in b
  read a
  reset b
  time 2 s
  out a
";
    let source = ctos::diagnostic::Source::new("n.net", text);
    let draft = crate::text::parse(&source).unwrap();
    let told = only_here(&draft);
    let told: Vec<String> = told.into_sorted().iter().map(ToString::to_string).collect();
    for kind in [
        "capacities",
        "inhibitor arcs",
        "reset arcs",
        "read arcs",
        "times,",
        "actions,",
        "tokens for other nets",
    ] {
        assert!(
            told.iter().any(|line| line.contains(kind)),
            "{kind}: {told:#?}"
        );
    }
    assert_eq!(told.len(), 7);
    let plain = crate::text::parse(&ctos::diagnostic::Source::new(
        "n.net",
        "net n\nplace a = 1\ntransition t\n  in a\n  out a*2\n",
    ));
    assert!(only_here(&plain.unwrap()).is_empty());
}

/// A place with an arc of each kind to a transition.
const EACH_KIND: &str = "net n
place a = 1, b, c
transition t
  in a*2
  inhibit b*3
  reset c
  out a
";

#[test]
fn the_kind_of_an_arc_is_written_in_the_three_ways_that_other_tools_read() {
    let source = ctos::diagnostic::Source::new("n.net", EACH_KIND);
    let draft = crate::text::parse(&source).unwrap();
    let written = write(&file_of(draft.clone())).unwrap();
    let mut count = 0;
    for kind in ["inhibitor", "reset"] {
        let ways = [
            format!(" type=\"{kind}\""),
            format!("<type value=\"{kind}\"/>"),
            format!("<arctype><text>{kind}</text></arctype>"),
        ];
        for way in &ways {
            assert!(written.contains(way), "{way}\n{written}");
            // Each by itself is enough.
            let others = ways.iter().filter(|other| other != &way);
            let only = others.fold(written.clone(), |text, other| text.replace(other, ""));
            assert_eq!(
                read_text(&only).draft.to_string(),
                read_text(&written).draft.to_string()
            );
            count += 1;
        }
        let none = ways
            .iter()
            .fold(written.clone(), |text, way| text.replace(way, ""));
        assert_ne!(
            read_text(&none).draft.to_string(),
            read_text(&written).draft.to_string()
        );
    }
    assert_eq!(count, 6);
}

/// What breaks the grammar of place/transition nets (ISO/IEC 15909-2, `ptnet.pntd` on `pnmlcoremodel.rng`) in a file that
/// we wrote, apart from the kinds of arcs. Elements may stand in other places, labels be there twice, and attributes be
/// missing or not known. Ids may not be unique, arcs join no place and transition, and numbers be of another sort.
fn against_the_grammar(text: &str) -> Vec<String> {
    const CORE: &str = "http://www.pnml.org/version-2009/grammar/pnml";
    let document = roxmltree::Document::parse(text).unwrap();
    let mut wrong = Vec::new();
    let mut ids = std::collections::BTreeMap::new();
    let label = (
        &[][..],
        &[][..],
        &["text"][..],
        &["text", "graphics", "toolspecific"][..],
    );
    for node in document.descendants().filter(roxmltree::Node::is_element) {
        let name = node.tag_name().name();
        if node
            .ancestors()
            .skip(1)
            .any(|n| n.has_tag_name((CORE, "toolspecific")))
        {
            continue;
        }
        // Attributes that must be there, and may; elements at most once, and all that may be there.
        let (must, may, once, all) = match name {
            "pnml" => (&[][..], &[][..], &[][..], &["net"][..]),
            "net" => (
                &["id", "type"][..],
                &[][..],
                &["name"][..],
                &["name", "page", "toolspecific"][..],
            ),
            "page" => (
                &["id"][..],
                &[][..],
                &["name", "graphics"][..],
                &[
                    "name",
                    "graphics",
                    "toolspecific",
                    "place",
                    "transition",
                    "arc",
                    "page",
                    "referencePlace",
                    "referenceTransition",
                ][..],
            ),
            "place" => (
                &["id"][..],
                &[][..],
                &["name", "graphics", "initialMarking"][..],
                &["name", "graphics", "initialMarking", "toolspecific"][..],
            ),
            "transition" => (
                &["id"][..],
                &[][..],
                &["name", "graphics"][..],
                &["name", "graphics", "toolspecific"][..],
            ),
            "arc" => (
                &["id", "source", "target"][..],
                &["type"][..],
                &["inscription", "graphics", "type", "arctype"][..],
                &["inscription", "graphics", "toolspecific", "type", "arctype"][..],
            ),
            "name" | "initialMarking" | "inscription" | "arctype" => label,
            "type" => (&["value"][..], &[][..], &[][..], &[][..]),
            "toolspecific" => (
                &["tool", "version"][..],
                &[][..],
                &[][..],
                &["text", "title"][..],
            ),
            "graphics" => (&[][..], &[][..], &[][..], &["position"][..]),
            "position" => (&["x", "y"][..], &[][..], &[][..], &[][..]),
            "text" => (&[][..], &[][..], &[][..], &[][..]),
            other => {
                wrong.push(format!("element `{other}`"));
                continue;
            }
        };
        if node.tag_name().namespace() != Some(CORE) {
            wrong.push(format!("the namespace of `{name}`"));
        }
        for attribute in must {
            if node.attribute(*attribute).is_none_or(str::is_empty) {
                wrong.push(format!("no `{attribute}` of `{name}`"));
            }
        }
        for attribute in node.attributes() {
            if ![must, may]
                .iter()
                .any(|list| list.contains(&attribute.name()))
            {
                wrong.push(format!("`{}` of `{name}`", attribute.name()));
            }
        }
        let children = node.children().filter(roxmltree::Node::is_element);
        let children: Vec<&str> = children.map(|child| child.tag_name().name()).collect();
        for child in &children {
            let count = children.iter().filter(|other| other == &child).count();
            if !all.contains(child) || once.contains(child) && count > 1 {
                wrong.push(format!("{count} `{child}` in `{name}`"));
            }
        }
        if let Some(id) = node.attribute("id") {
            let first = |c: char| c.is_alphabetic() || c == '_';
            let rest = |c: char| c.is_alphanumeric() || "_-.".contains(c);
            if !id.starts_with(first) || !id.chars().all(rest) {
                wrong.push(format!("id `{id}`"));
            }
            if ids.insert(id, name).is_some() {
                wrong.push(format!("id `{id}` twice"));
            }
        }
        let number = node.descendants().find(|n| n.has_tag_name((CORE, "text")));
        let number = number.and_then(|n| n.text()?.trim().parse::<u32>().ok());
        if name == "initialMarking" && number.is_none() || name == "inscription" && number < Some(1)
        {
            wrong.push(format!("the number of `{name}`"));
        }
    }
    for arc in document
        .descendants()
        .filter(|n| n.has_tag_name((CORE, "arc")))
    {
        let end = |which: &str| arc.attribute(which).and_then(|id| ids.get(id).copied());
        let ends = (end("source"), end("target"));
        let joined = [
            (Some("place"), Some("transition")),
            (Some("transition"), Some("place")),
        ];
        if !joined.contains(&ends) {
            wrong.push(format!("an arc joins {ends:?}"));
        }
    }
    wrong
}

#[test]
fn what_breaks_the_grammar_of_the_standard_is_seen() {
    let good = format!("{NODES}<arc id=\"a\" source=\"p\" target=\"t\"/>");
    assert!(against_the_grammar(&document(&good)).is_empty());
    for (from, to) in [
        ("id=\"a\"", "id=\"p\""),
        ("id=\"a\"", "id=\"7\""),
        ("id=\"a\" ", ""),
        ("target=\"t\"", "target=\"q\""),
        ("<arc ", "<arc weight=\"2\" "),
        ("<place id=\"q\"/>", "<place id=\"q\"><capacity/></place>"),
        (
            "<place id=\"q\"/>",
            "<place id=\"q\"><name/><name/></place>",
        ),
        (
            "<place id=\"q\"/>",
            "<place id=\"q\"><initialMarking><text>-1</text></initialMarking></place>",
        ),
    ] {
        let bad = document(&good).replace(from, to);
        assert!(!against_the_grammar(&bad).is_empty(), "{bad}");
    }
}

#[test]
fn the_nets_of_the_project_are_written_within_the_grammar_of_the_standard() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../configs/nets");
    let mut read = 0;
    for file in std::fs::read_dir(folder).unwrap() {
        let path = file.unwrap().path();
        if path.extension().is_some_and(|extension| extension == "net") {
            let written = write(&format::read(&path).unwrap()).unwrap();
            assert_eq!(against_the_grammar(&written), [""; 0], "{}", path.display());
            read += 1;
        }
    }
    assert!(read >= 5, "{read}");
}

#[test]
fn a_file_beyond_the_limit_is_refused_by_limit_and_size_and_one_line_below_it_is_read() {
    let places = |count: usize| {
        let each = (0..count).map(|n| format!("<place id=\"p{n}\"/>"));
        each.collect::<String>()
            + "<transition id=\"t\"/><arc id=\"a\" source=\"p0\" target=\"t\"/>"
    };
    let found = bytes_findings(document(&places(900_000)).as_bytes());
    assert_eq!(found.len(), 1);
    assert!(
        found[0].contains("MiB of PNML, and at most 16 MiB are read"),
        "{found:#?}"
    );
    assert_eq!(
        read_text(&document(&places(50_000))).draft.places.len(),
        50_000
    );
}

#[test]
fn findings_in_sections_far_down_a_line_have_the_place_in_their_names() {
    let own =
        "<toolspecific tool=\"pnt\" version=\"1\"><text>doo f(a -&gt; b)</text></toolspecific>";
    let text = document(&format!(
        "{}<transition id=\"t\">{own}</transition>",
        " ".repeat(10_000)
    ));
    let found = bytes_findings(text.as_bytes());
    assert!(
        found.iter().any(|line| line.contains("a.pnml:4:10")),
        "{found:#?}"
    );
}

//! Everything that reads nets, fed with mutations of a kept corpus: any input is a net or findings. The driver is `mutate`'s.

use std::path::Path;

use ctos::diagnostic::Source;
use mutate::Mutator;

use crate::{
    format::{self, Format},
    pnml,
    text::{self, outline::Outline},
};

/// What inputs are put together from beside each other.
const WORDS: [&str; 30] = [
    "net n\n",
    "place p = 2 capacity 3\n",
    "transition t\n",
    "  in p*2\n",
    "  out p@m\n",
    "subnet s(a)\n",
    "end\n",
    "data d : int = 0\n",
    "data s { u : px, v : px }\n",
    "command c(a : int) -> b\n",
    "  set d = d + 1\n",
    "  when not d < 3 && s.u > 0.5\n",
    "  request \"o EXEC FMSG 1 $d\"\n",
    "use s(p) as i\n",
    "\"",
    "\\u{",
    "#",
    "99999999999",
    "<place id=\"p\"/>",
    "<arc id=\"a\" source=\"p\" target=\"t\"/>",
    "<toolspecific tool=\"pnt\"><text>",
    "</text></toolspecific>",
    "<![CDATA[",
    "]]>",
    "<!--",
    "&lt;",
    "tr t p -> q\n",
    "pl p (1)\n",
    "{",
    "?-",
];

/// Any bytes are a net or findings that can be shown; a net is the same again from every form that it has.
fn file(bytes: &[u8]) {
    let file = match format::read_bytes("input", bytes) {
        Ok(file) => file,
        Err(findings) => {
            assert!(findings.has_errors() && !findings.to_string().is_empty());
            return;
        }
    };
    let printed = file.draft.to_string();
    let again = format::read_bytes("printed", printed.as_bytes());
    let again = again.unwrap_or_else(|findings| panic!("{findings}\n{printed}"));
    assert!(again.format == Format::Text && again.draft == file.draft);
    let _ = file.compile();
    if let Ok(written) = pnml::write(&file) {
        let read = format::read_bytes("written", written.as_bytes());
        // A section may name nodes twice; what is read is a net or findings.
        if let (Ok(read), true) = (&read, file.format == Format::Pnml) {
            assert_eq!(read.draft.places, file.draft.places, "{written}");
        }
    }
}

/// Any text can be laid out or says why not, and what editors ask about it has an answer.
fn editor(bytes: &[u8]) {
    let text = String::from_utf8_lossy(bytes);
    let source = Source::new("input", text.as_ref());
    let outline = Outline::of(&source);
    for word in outline.words() {
        assert!(source.text().get(word.range.clone()).is_some());
        assert!(outline.same(word).contains(&word));
    }
    let Ok(laid_out) = text::formatted(&source) else {
        return;
    };
    let once = Source::new("once", laid_out.clone());
    let twice = text::formatted(&once).unwrap_or_else(|findings| panic!("{findings}"));
    assert_eq!(twice, laid_out);
    assert_eq!(text::parse(&source).ok(), text::parse(&once).ok());
}

/// The nets that all targets begin with: those of the case study in every form.
fn own() -> Vec<Vec<u8>> {
    let texts = [
        include_str!("../../tests/nets/dispatcher.net"),
        include_str!("../../tests/nets/motion.net"),
        include_str!("../../tests/nets/vision.net"),
    ];
    let mut inputs: Vec<Vec<u8>> = texts.iter().map(|text| text.as_bytes().to_vec()).collect();
    for text in texts {
        let file = format::read_bytes("own", text.as_bytes()).unwrap();
        inputs.push(pnml::write(&file).unwrap().into_bytes());
    }
    inputs.push(b"net n\ntr t [2,2] p*2 q?3 r?-1 -> s {a b}*4\npl p (2K)\n".to_vec());
    inputs.extend(WORDS.map(|word| word.as_bytes().to_vec()));
    inputs
}

fn play(name: &str, target: fn(&[u8])) {
    let mutator = Mutator {
        corpus: Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/corpus"),
        words: &WORDS,
        longest: 4096,
        seconds: 6.0,
        targets: 2,
    };
    mutator.play(name, own(), target);
}

#[test]
fn files_of_nets_take_any_bytes() {
    play("file", file);
}

#[test]
fn editors_take_any_text() {
    play("editor", editor);
}

//! Everything that reads nets, fed with mutations of a kept corpus, as `ctos` does with what comes over links.
//!
//! A target must answer any input with a net or findings: never with a panic, never without end. The seeds
//! of a run are drawn from a fixed number, so the short run of every test is the same each time;
//! `CTOS_FUZZ_SECONDS` makes it longer (for all targets together), and then other. An input that fails is
//! written into the corpus, where the next run begins with it.

use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    path::{Path, PathBuf},
    time::Duration,
};

use ctos::{diagnostic::Source, time::Clock};
use rand::{Rng, RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use crate::{
    format::{self, Format},
    pnml,
    text::{self, outline::Outline},
};

/// Seconds for all targets together.
const SECONDS: f64 = 6.0;

/// The longest input, bytes.
const LONGEST: usize = 4096;

/// What inputs are put together from beside each other.
const WORDS: [&str; 24] = [
    "net n\n",
    "place p = 2 capacity 3\n",
    "transition t\n",
    "  in p*2\n",
    "  out p@m\n",
    "subnet s(a)\n",
    "end\n",
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

fn corpus(target: &str) -> PathBuf {
    let tests = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests");
    tests.join("corpus").join(target)
}

/// The nets that all targets begin with: those of the case study in every form.
fn own() -> Vec<Vec<u8>> {
    let texts = [
        include_str!("../tests/nets/dispatcher.net"),
        include_str!("../tests/nets/motion.net"),
        include_str!("../tests/nets/vision.net"),
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

/// The inputs that a target begins with: our own, and those that are kept, by name.
fn kept(target: &str) -> Vec<Vec<u8>> {
    let mut files: Vec<PathBuf> = match std::fs::read_dir(corpus(target)) {
        Ok(files) => files.map(|file| file.unwrap().path()).collect(),
        Err(_) => Vec::new(),
    };
    files.sort();
    let kept = files.iter().map(|file| std::fs::read(file).unwrap());
    own().into_iter().chain(kept).collect()
}

/// An input that is like those of the corpus, but for one to eight changes.
fn mutated(corpus: &[Vec<u8>], rng: &mut impl Rng) -> Vec<u8> {
    let any = |rng: &mut dyn Rng| corpus.get(rng.random_range(0..corpus.len())).unwrap();
    let mut input = any(rng).clone();
    for _ in 0..rng.random_range(1..=8) {
        let place = rng.random_range(0..=input.len());
        let other = any(rng);
        let from = rng.random_range(0..=other.len());
        let rest = input.len() - place;
        match rng.random_range(0..6) {
            0 if rest > 0 => input[place] ^= 1 << rng.random_range(0..8),
            1 if rest > 0 => input[place] = rng.random(),
            2 if rest > 0 => drop(input.drain(place..place + rng.random_range(1..=rest.min(64)))),
            3 => drop(input.splice(place.., other[from..].iter().copied())),
            4 => {
                let size = rng.random_range(0..=(other.len() - from).min(64));
                drop(input.splice(place..place, other[from..from + size].to_vec()));
            }
            _ => {
                let word = WORDS[rng.random_range(0..WORDS.len())];
                drop(input.splice(place..place, word.bytes()));
            }
        }
        input.truncate(LONGEST);
    }
    input
}

fn fail(name: &str, input: &[u8]) -> ! {
    let digest = input
        .iter()
        .fold(0xcbf2_9ce4_8422_2325_u64, |digest, byte| {
            (digest ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3)
        });
    std::fs::create_dir_all(corpus(name)).unwrap();
    let file = corpus(name).join(format!("failed-{digest:016x}"));
    std::fs::write(&file, input).unwrap();
    panic!("`{name}` failed; its input is kept in {}", file.display());
}

fn play(name: &str, target: fn(&[u8])) {
    let wanted = std::env::var("CTOS_FUZZ_SECONDS").ok();
    let wanted: Option<f64> = wanted.map(|text| text.parse().unwrap());
    let share = Duration::from_secs_f64(wanted.unwrap_or(SECONDS)) / 2;
    let seed = if wanted.is_some() { rand::random() } else { 1 };
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let passes = |input: &[u8]| catch_unwind(AssertUnwindSafe(|| target(input))).is_ok();
    let corpus = kept(name);
    if let Some(input) = corpus.iter().find(|input| !passes(input)) {
        fail(name, input);
    }
    let clock = Clock::real();
    let end = clock.now() + share;
    while clock.now() < end {
        let input = mutated(&corpus, &mut rng);
        if !passes(&input) {
            fail(name, &input);
        }
    }
}

#[test]
fn files_of_nets_take_any_bytes() {
    play("file", file);
}

#[test]
fn editors_take_any_text() {
    play("editor", editor);
}

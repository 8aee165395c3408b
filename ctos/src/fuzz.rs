//! Everything that reads bytes or texts from outside, fed with mutations of a kept corpus.
//!
//! A target must answer any input with a value or an error: never with a panic, never without end, never
//! by reserving what was only announced. The seeds of a run are drawn from a fixed number, so the short run
//! of every test is the same each time; `CTOS_FUZZ_SECONDS` makes it longer (for all targets together),
//! and then other. An input that fails is written into the corpus beside the others, where the next run
//! begins with it.

use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    path::{Path, PathBuf},
    time::Duration,
};

use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::{
    config::load_texts,
    link::{
        Frame,
        handshake::{Answer, hear, hear_greeting},
        session::packet::Decoder,
        transport::Address,
    },
    message::{Data, Header},
    time::Clock,
};

/// Seconds for all targets together.
const SECONDS: f64 = 10.0;

/// The longest input, bytes.
const LONGEST: usize = 4096;

/// What is done with an input.
type Target = fn(&[u8]);

const TARGETS: [(&str, Target); 6] = [
    ("header", header),
    ("packets", packets),
    ("handshake", handshake),
    ("config", config),
    ("payload", payload),
    ("agent", crate::remote::fuzz),
];

/// Sixteen bytes are a header whatever they are, and are the same bytes again.
fn header(bytes: &[u8]) {
    if let Some(first) = bytes.first_chunk::<16>() {
        assert_eq!(Header::decode(first).encode(), *first);
    }
    if let Ok(frame) = Frame::decode(bytes) {
        assert_eq!(frame.encode(), bytes);
    }
}

/// A stream of packets, whole and cut by its own first byte.
fn packets(bytes: &[u8]) {
    let (step, stream) = bytes.split_first().unwrap_or((&1, &[]));
    let mut decoder = Decoder::default();
    for mut part in stream.chunks(usize::from(*step).max(1)) {
        while !part.is_empty() {
            match decoder.feed(&mut part) {
                Ok(Some(_)) => {}
                Ok(None) => assert!(part.is_empty()),
                Err(_) => return,
            }
        }
    }
    assert!(decoder.reserved() <= 64 * 1024 + 2 * bytes.len());
}

/// What a stranger says first, and what somebody answers.
fn handshake(bytes: &[u8]) {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .build()
        .unwrap();
    runtime.block_on(async {
        let _ = hear_greeting(&mut &*bytes).await;
        let _ = hear::<Answer>(&mut &*bytes).await;
    });
    if let Ok(text) = std::str::from_utf8(bytes) {
        let _ = text.parse::<Address>();
    }
}

/// A configuration, and `--set` texts in its last lines.
fn config(bytes: &[u8]) {
    let text = String::from_utf8_lossy(bytes);
    let (file, sets) = text.split_once("\n--set\n").unwrap_or((&text, ""));
    let sets: Vec<String> = sets.lines().take(8).map(str::to_owned).collect();
    match load_texts(&[("app.toml", file)], &sets, &[]) {
        Ok(app) => drop(crate::registry::Registry::new().check(&app)),
        // Whoever is told must be able to read it.
        Err(findings) => assert!(!findings.to_string().is_empty()),
    }
}

/// The data of a message, as types that nest and that announce lengths.
fn payload(bytes: &[u8]) {
    let data = || Data::Bytes(bytes.to_vec());
    let _ = data().take::<Vec<String>>();
    let _ = data().take::<Vec<Vec<Option<(u64, f32)>>>>();
    let _ = data().take::<crate::call::Fault>();
    let _ = data().take::<std::collections::BTreeMap<String, Vec<u8>>>();
}

fn corpus(target: &str) -> PathBuf {
    let tests = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests");
    tests.join("corpus").join(target)
}

/// What this version itself writes for a target.
fn own(target: &str) -> Vec<Vec<u8>> {
    let frame = Frame::of_body(vec![1, 2, 3]).encode();
    let head = |kind: u8, size: usize| {
        let length = u32::try_from(17 + size).unwrap().to_le_bytes();
        [&length[..], &[kind, 1], &[0; 15]].concat()
    };
    match target {
        "header" => vec![frame],
        "packets" => {
            let packets = [
                &[7][..],
                &head(1, frame.len()),
                &frame,
                &head(4, 0),
                &head(3, 0),
            ];
            vec![packets.concat()]
        }
        "handshake" => vec![crate::link::handshake::greeting_of_corpus()],
        "agent" => crate::remote::corpus(),
        "config" => vec![crate::config::DEFAULTS.as_bytes().to_vec()],
        _ => {
            let fault = crate::call::Fault::NoReply;
            let texts = ["one".to_owned(), "two".to_owned()];
            vec![
                postcard::to_stdvec(&fault).unwrap(),
                postcard::to_stdvec(&texts[..]).unwrap(),
            ]
        }
    }
}

/// The inputs that a target begins with: its own, and those that are kept, by name.
fn kept(target: &str) -> Vec<Vec<u8>> {
    let mut files: Vec<PathBuf> = match std::fs::read_dir(corpus(target)) {
        Ok(files) => files.map(|file| file.unwrap().path()).collect(),
        Err(_) => Vec::new(),
    };
    files.sort();
    let kept = files.iter().map(|file| std::fs::read(file).unwrap());
    own(target).into_iter().chain(kept).collect()
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
        match rng.random_range(0..7) {
            0 if rest > 0 => input[place] ^= 1 << rng.random_range(0..8),
            1 if rest > 0 => input[place] = rng.random(),
            2 => input.insert(place, rng.random()),
            3 if rest > 0 => drop(input.drain(place..place + rng.random_range(1..=rest))),
            // Lengths and numbers at their limits.
            4 if rest >= 4 => {
                let limits = [0_u32, 1, 0x7f, 0x80, 0xffff, 1 << 26, 1 << 31, u32::MAX];
                let limit = limits[rng.random_range(0..limits.len())].to_le_bytes();
                input[place..place + 4].copy_from_slice(&limit);
            }
            5 => drop(input.splice(place.., other[from..].iter().copied())),
            6 => {
                let size = rng.random_range(0..=(other.len() - from).min(64));
                let part = other[from..from + size].to_vec();
                drop(input.splice(place..place, part));
            }
            _ => {}
        }
        input.truncate(LONGEST);
    }
    input
}

/// Whether the target takes the input.
fn passes(target: fn(&[u8]), input: &[u8]) -> bool {
    catch_unwind(AssertUnwindSafe(|| target(input))).is_ok()
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

fn play(name: &str) {
    let (_, target) = TARGETS.iter().find(|(found, _)| *found == name).unwrap();
    let wanted = std::env::var("CTOS_FUZZ_SECONDS")
        .ok()
        .map(|text| text.parse().unwrap());
    let share = Duration::from_secs_f64(wanted.unwrap_or(SECONDS)) / TARGETS.len() as u32;
    let seed = if wanted.is_some() {
        let mut bytes = [0; 8];
        getrandom::fill(&mut bytes).unwrap();
        u64::from_le_bytes(bytes)
    } else {
        1
    };
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let corpus = kept(name);
    for input in &corpus {
        if !passes(*target, input) {
            fail(name, input);
        }
    }
    let clock = Clock::real();
    let end = clock.now() + share;
    while clock.now() < end {
        let input = mutated(&corpus, &mut rng);
        if !passes(*target, &input) {
            fail(name, &input);
        }
    }
}

#[test]
fn headers_and_frames_take_any_bytes() {
    play("header");
}

#[test]
fn streams_of_packets_take_any_bytes() {
    play("packets");
}

#[test]
fn handshakes_take_any_bytes() {
    play("handshake");
}

#[test]
fn configurations_take_any_text() {
    play("config");
}

#[test]
fn payloads_take_any_bytes() {
    play("payload");
}

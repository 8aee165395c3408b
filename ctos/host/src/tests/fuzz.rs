//! Everything that reads bytes or texts from outside, fed with mutations of a kept corpus.
//!
//! The driver, and what a target must hold, is `mutate`'s.

use std::path::Path;

use mutate::Mutator;

use ctos_config::load_texts;
use ctos_link::{
    handshake::{
        Answer, GREETING, Greeting, Hello, Member, Process, Token, greet, hear, hear_greeting,
    },
    session::packet::Decoder,
    transport::Address,
};
use ctos_message::{
    Data, Flags, Header, Tid,
    frame::{FRAME_FIXED, Frame, NO_DEADLINE},
};

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

/// Twenty bytes are a header whatever they are, and are the same bytes again.
fn header(bytes: &[u8]) {
    if let Some(first) = bytes.first_chunk::<{ Header::BYTES }>() {
        assert_eq!(Header::decode(first).encode(), *first);
    }
    let (head, body) = bytes.split_at(FRAME_FIXED.min(bytes.len()));
    if let Ok(frame) = Frame::from_parts(head, body.to_vec().into()) {
        assert_eq!(bytes_of(&frame), bytes);
    }
}

/// A frame in one piece.
fn bytes_of(frame: &Frame) -> Vec<u8> {
    [&frame.head()[..], &frame.body.clone().into_vec()].concat()
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
        let _ = hear_greeting::<Greeting>(&mut &*bytes, GREETING).await;
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
        Ok(app) => drop(ctos_core::registry::Registry::new().check(&app)),
        // The findings must be readable.
        Err(findings) => assert!(!findings.to_string().is_empty()),
    }
}

/// The data of a message, as types that nest and that announce lengths.
fn payload(bytes: &[u8]) {
    let data = || Data::Bytes(bytes.to_vec());
    let _ = data().take::<Vec<String>>();
    let _ = data().take::<Vec<Vec<Option<(u64, f32)>>>>();
    let _ = data().take::<ctos_message::fault::Fault>();
    let _ = data().take::<std::collections::BTreeMap<String, Vec<u8>>>();
}

/// What a chassis says first.
fn greeting() -> Vec<u8> {
    let greeting = Greeting::Hello {
        token: Token("secret".to_owned()),
        hello: Hello {
            member: Member {
                chassis: 1,
                incarnation: 1,
                process: Process {
                    host: "host/1".to_owned(),
                    pid: 7,
                },
                listen: vec![Address::Unix("/run/a.sock".into())],
            },
            received: 3,
            shared: true,
        },
    };
    let runtime = tokio::runtime::Builder::new_current_thread()
        .build()
        .unwrap();
    let mut bytes = Vec::new();
    runtime
        .block_on(greet(&mut bytes, GREETING, &greeting))
        .unwrap();
    bytes
}

/// What this version itself writes for a target.
fn own(target: &str) -> Vec<Vec<u8>> {
    let frame = bytes_of(&Frame {
        header: Header {
            to: Tid::new(1, 1, 0),
            from: Tid::new(2, 1, 0),
            command: 1,
            flags: Flags::REPLY_WAIT,
            size: 3,
        },
        call: 1,
        trace: 0,
        left_ns: NO_DEADLINE,
        body: vec![1, 2, 3].into(),
    });
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
        "handshake" => vec![greeting()],
        "agent" => crate::remote::corpus(),
        "config" => vec![ctos_config::DEFAULTS.as_bytes().to_vec()],
        _ => {
            let fault = ctos_message::fault::Fault::NoReply;
            let texts = ["one".to_owned(), "two".to_owned()];
            vec![
                postcard::to_stdvec(&fault).unwrap(),
                postcard::to_stdvec(&texts[..]).unwrap(),
            ]
        }
    }
}

fn play(name: &str) {
    let (_, target) = TARGETS.iter().find(|(found, _)| *found == name).unwrap();
    let mutator = Mutator {
        corpus: Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/corpus"),
        words: &[],
        longest: 4096,
        seconds: 10.0,
        targets: TARGETS.len() as u32,
    };
    mutator.play(name, own(name), target);
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

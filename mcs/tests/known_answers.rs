//! Kinematics and dynamics of every built-in arm and of ways through URDF files, against Pinocchio: the answers in
//! `known_answers/known_answers.csv` are what `known_answers/make.py` wrote. Asked as text, as anybody asks, but for the
//! velocity-product acceleration, which no object tells.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test that cannot be set up fails"
)]

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use ctos::diagnostic::Source;
use mcs::model::{file::Inertias, origin::Origin};
use mcs::services::{DICTIONARY, register};
use sorma::{Dictionary, Reply, Request, Sorm, Transport};

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/known_answers")
}

fn manager() -> Sorm {
    let mut dictionary = Dictionary::new();
    dictionary.load(&Source::new("mcs", DICTIONARY)).unwrap();
    let sorm = Sorm::new(dictionary);
    register(&sorm);
    sorm
}

fn ask(sorm: &Sorm, request: &str, floats: Vec<f64>) -> Transport {
    let mut request: Request = request.parse().unwrap();
    request.body.floats = floats;
    let reply = sorm.dispatch(&request.to_text().unwrap());
    reply.parse::<Reply>().unwrap().body
}

fn numbers(text: &str) -> Vec<f64> {
    text.split(' ').map(|word| word.parse().unwrap()).collect()
}

/// The velocity-product acceleration of an arm's tip.
fn bias(arm: &str, options: &str, given: &[f64]) -> Vec<f64> {
    let origin = match arm.strip_suffix(".urdf") {
        Some(_) => Origin::Urdf(folder().join(arm)),
        None => Origin::BuiltIn(arm.to_owned()),
    };
    let words: Vec<&str> = options.split_whitespace().collect();
    let option = |name: &str| {
        let at = words.iter().position(|word| *word == name)?;
        words.get(at + 1).copied()
    };
    let loaded = origin.load(option("-base"), option("-tip"), Inertias::Identified);
    let model = loaded.unwrap().model;
    let (q, qd) = given.split_at(model.dof());
    let found = model.bias_acceleration(&mut model.data(), q, qd, model.tip());
    found.iter().copied().collect()
}

/// What an object of the arm answers.
fn asked(arm: &str, options: &str, what: &str, given: Vec<f64>) -> Vec<f64> {
    let sorm = manager();
    let class = if ["fkine", "jacobian"].contains(&what) {
        "kin"
    } else {
        "dyn"
    };
    let (object, mut options) = match arm.strip_suffix(".urdf") {
        Some(_) => (
            class.to_owned(),
            format!("-urdf {} {options}", folder().join(arm).display()),
        ),
        None => (format!("{class}.{arm}"), options.to_owned()),
    };
    if class == "kin" {
        options = options.replace("-rotor", "");
    }
    let set = ask(&sorm, &format!("{object} CTRL {options}"), Vec::new());
    assert!(set.is_ok(), "{arm} {options}: {:?}", set.reports);
    let reply = ask(&sorm, &format!("{object} EXEC TMSG {what}"), given);
    assert!(reply.is_ok(), "{arm} {options} {what}: {:?}", reply.reports);
    reply.floats
}

#[test]
fn kinematics_and_dynamics_of_all_arms_are_pinocchios() {
    let text = std::fs::read_to_string(folder().join("known_answers.csv")).unwrap();
    let mut worst: BTreeMap<String, f64> = BTreeMap::new();
    let mut arms = std::collections::BTreeSet::new();
    for line in text.lines().skip(1) {
        let [arm, options, what, given, expected] = line.split(',').collect::<Vec<_>>()[..] else {
            panic!("{line}");
        };
        let (given, expected) = (numbers(given), numbers(expected));
        let found = match what {
            "bias" => bias(arm, options, &given),
            _ => asked(arm, options, what, given),
        };
        assert_eq!(found.len(), expected.len(), "{arm} {options} {what}");
        let size = expected
            .iter()
            .fold(1.0_f64, |most, number| most.max(number.abs()));
        for (index, (found, expected)) in found.iter().zip(&expected).enumerate() {
            let off = (found - expected).abs() / size;
            assert!(
                off < 1e-10,
                "{arm} {options} {what}, number {index}: {found} is not {expected}"
            );
            let worst = worst.entry(what.to_owned()).or_default();
            *worst = worst.max(off);
        }
        arms.insert((arm, options));
    }
    assert_eq!(worst.len(), 7, "every request was asked: {worst:?}");
    assert!(arms.len() >= 12, "{arms:?}");
}

//! A disc is carried over a board by nets, in virtual time: where it should stand it stands, and what cannot be done is told. Cameras
//! see where board and disc are; a person moves them, and covers cameras.

mod anywhere;
mod campaign;
mod layout;
mod meddling;
mod person;
mod room;
mod seen;
mod sequence;
mod speaker;
mod ways;
mod wrong;

use crate::harness::{CTOS, Ended, Scratch};

fn carry(sets: &[&str]) -> Ended {
    carry_with(&[], sets)
}

fn carry_with(flags: &[&str], sets: &[&str]) -> Ended {
    let scratch = Scratch::new();
    let mut all = vec![
        "boot",
        "configs/carry.toml",
        "--set",
        "time.mode=\"virtual\"",
        "--json",
        "-v",
    ];
    all.extend(flags);
    for set in sets {
        all.extend(["--set", set]);
    }
    scratch.start(CTOS, &all, &[]).end()
}

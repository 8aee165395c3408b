//! CTOS's messages beside those of other libraries, measured in one run. Every round measures each
//! contender once, so that other work of the machine disturbs all of them alike. The table shows the
//! medians of the rounds and the ratios of the medians; the ratio is what counts.
//!
//! `cargo run --release -p peers --features peers [-- PART ...]`, parts: `local`, `core`, `cores`,
//! `oneway`, `idle`. With `only=ctos` the others stay away, for a profiler.

mod booted;
mod contenders;
mod ctos_side;
mod measure;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match arguments.split_first() {
        Some((first, processors)) if first == booted::BOOTED => booted::serve(processors),
        _ => measure::all(),
    }
}

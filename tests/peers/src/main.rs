//! CTOS's messages beside those of other libraries, measured in one run: every round measures each
//! contender once, so that whatever else the machine does hits all of them alike. The table shows the
//! medians of the rounds and the ratios of the medians; the ratio is what counts.
//!
//! `cargo run --release -p peers --features peers [-- PART ...]`, parts: `local`, `core`, `cores`,
//! `oneway`, `idle`. With `only=ctos` the others stay away, for a profiler.

mod contenders;
mod ctos_side;
mod measure;

fn main() {
    measure::all();
}

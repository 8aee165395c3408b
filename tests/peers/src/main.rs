//! CTOS's messages beside those of other libraries, measured in one run: every round measures each
//! contender once, so that whatever else the machine does hits all of them alike. The table shows the
//! medians of the rounds and the ratios of the medians; the ratio is what counts.
//!
//! `cargo run --release -p peers --features peers [-- PART ...]`, parts: `local`, `core`, `cores`,
//! `oneway`, `idle`.

#[cfg(feature = "peers")]
mod contenders;
#[cfg(feature = "peers")]
mod ctos_side;
#[cfg(feature = "peers")]
mod measure;

#[cfg(feature = "peers")]
fn main() {
    measure::all();
}

#[cfg(not(feature = "peers"))]
fn main() {
    eprintln!(
        "build it with `--features peers`: the libraries to compare with are built only then"
    );
    std::process::exit(2);
}

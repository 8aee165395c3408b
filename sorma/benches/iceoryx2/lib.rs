//! Holds nothing; see `benches/beside.rs`.

//! Programs of every kind, good and bad, as tasks of apps in virtual time.

#![cfg(test)]

mod bad;
mod common;
mod good;

//! A file of a circle, for the test of circles; it is compiled nowhere.

use crate::one::One;

pub struct Four(pub Option<Box<One>>);

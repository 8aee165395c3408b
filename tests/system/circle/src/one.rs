//! A file of a circle, for the test of circles; it is compiled nowhere.

use crate::two::Two;

pub struct One(pub Option<Box<Two>>);

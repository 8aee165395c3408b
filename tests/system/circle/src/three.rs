//! A file of a circle, for the test of circles; it is compiled nowhere.

use crate::four::Four;

pub struct Three(pub Option<Box<Four>>);

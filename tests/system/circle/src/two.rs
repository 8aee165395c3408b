//! A file of a circle, for the test of circles; it is compiled nowhere.

use crate::three::Three;

pub struct Two(pub Option<Box<Three>>);

//! Four files that import one another, for the test of circles.

mod four;
mod one;
mod three;
mod two;

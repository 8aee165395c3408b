//! What was declared once, for as long as the process lives: commands are known by reference everywhere. The same
//! declared again is the same reference, so that a restart keeps nothing anew.

use std::sync::{Mutex, PoisonError};

use super::Shape;

static TEXTS: Mutex<Vec<&'static str>> = Mutex::new(Vec::new());
static SHAPES: Mutex<Vec<&'static Shape>> = Mutex::new(Vec::new());

pub(crate) fn text(text: &str) -> &'static str {
    let mut all = TEXTS.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(known) = all.iter().find(|known| **known == text) {
        return known;
    }
    let new: &'static str = text.to_owned().leak();
    all.push(new);
    new
}

pub(crate) fn shape(shape: Shape) -> &'static Shape {
    let mut all = SHAPES.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(known) = all.iter().find(|known| ***known == shape) {
        return known;
    }
    let new: &'static Shape = Box::leak(Box::new(shape));
    all.push(new);
    new
}

//! Boards and discs before several calibrated cameras: where a draughts board stands ([`pose`]), and where discs lie on it and
//! beside it ([`discs`]). Numbers and pictures only: no task, no file.

pub mod discs;
pub mod pose;

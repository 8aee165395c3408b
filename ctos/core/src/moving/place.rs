//! The places of an app that a task can move to: as a person writes them, and as the runtime counts them.

use crate::{chassis::Chassis, system::Place};
use ctos_message::ChassisNumber;

/// The text names no place of the app.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{message}; there are: {}", .known.join(", "))]
pub struct NoPlace {
    /// What is wrong.
    pub message: String,
    /// The places there are instead, as they are written.
    pub known: Vec<String>,
}

/// The place `CHASSIS` or `CHASSIS:PROCESSOR` of the app. A chassis alone means its first processor.
///
/// # Errors
/// What there is instead.
pub fn find_place(chassis: &Chassis, text: &str) -> Result<Place, NoPlace> {
    let (name, processor) = match text.split_once([':', '/']) {
        Some((name, processor)) => (name, Some(processor)),
        None => (text, None),
    };
    let app = &chassis.app;
    let mut all = app.chassis.iter().enumerate();
    let Some((index, config)) = all.find(|(_, config)| config.name == name) else {
        return Err(NoPlace {
            message: format!("there is no chassis `{name}`"),
            known: app.chassis.iter().map(|one| one.name.clone()).collect(),
        });
    };
    let mut processors = config.processors.iter();
    let found = match processor {
        Some(wanted) => processors.position(|one| one.name == wanted),
        None => processors.next().map(|_| 0),
    };
    let Some(found) = found else {
        let wanted = processor.unwrap_or_default();
        let processors = config.processors.iter();
        return Err(NoPlace {
            message: format!("chassis `{name}` has no processor `{wanted}`"),
            known: processors
                .map(|one| format!("{name}:{}", one.name))
                .collect(),
        });
    };
    // Both count from 1: 0 is the chassis that boots, and the processor of the runtime.
    match (ChassisNumber::try_from(index + 1), u8::try_from(found + 1)) {
        (Ok(chassis), Ok(processor)) => Ok(Place { chassis, processor }),
        _ => Err(NoPlace {
            message: format!("`{text}` has too high a number"),
            known: Vec::new(),
        }),
    }
}

/// A place in words.
pub fn place_text(chassis: &Chassis, place: Place) -> String {
    let config = chassis.config_of(place.chassis);
    let processor = usize::from(place.processor).checked_sub(1);
    let name = config
        .and_then(|config| config.processors.get(processor?))
        .map_or("system", |one| one.name.as_str());
    format!("{}:{name}", chassis.name_of(place.chassis))
}

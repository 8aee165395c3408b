//! What people in the room are told of an errand that went wrong (the speaker daemon of the SORMA technical report, section 2.1.3):
//! short messages, with fields as players name them.

use ctos::{
    config::{App, TaskConfig},
    diagnostic::{Finding, Findings},
    task::Context,
};
use sorma::{Comm as _, Location, Method, ObjectName, Request, Transport, daemon::Tasks};

use super::board::Field;

/// The service object that speaks, at its daemon.
#[derive(Debug, Clone, PartialEq)]
pub struct Speaker(ObjectName);

impl Speaker {
    /// The object of that name, such as `fork.sound@speaker`.
    ///
    /// # Errors
    /// It is no name, or no daemon is named.
    pub fn named(name: &str) -> Result<Self, String> {
        let object: ObjectName = name.parse().map_err(|error| format!("{error}"))?;
        match object.location() {
            Location::Alias(_) | Location::Address { .. } => Ok(Self(object)),
            _ => Err(format!("`{name}` does not say at which daemon")),
        }
    }

    /// The task of its daemon, if it is named by that.
    pub fn daemon(&self) -> Option<&str> {
        match self.0.location() {
            Location::Alias(task) => Some(task),
            _ => None,
        }
    }

    /// Has it say something. Nobody waits for it; a speaker that cannot be reached is told in the log.
    pub fn say(&self, cx: &Context, words: &str) {
        let (child, object) = (cx.clone(), self.0.clone());
        let body = Transport::text(words);
        cx.spawn(async move {
            let request = Request {
                name: object.here(),
                method: Method::Exec,
                body,
            };
            let said = Tasks::of(&child).tell(object.location(), request).await;
            if let Err(report) = said {
                tracing::warn!(%object, %report, "nobody speaks");
            }
        });
    }
}

/// Findings where the argument `speaker` names nobody who speaks.
pub fn check(name: Option<&str>, task: &TaskConfig, app: &App, findings: &mut Findings) {
    match name.map(Speaker::named) {
        Some(Ok(speaker)) => {
            if let Some(daemon) = speaker.daemon() {
                crate::need_task(task, app, "speaker", daemon, findings);
            }
        }
        Some(Err(text)) => {
            let place = task.args.locate("speaker");
            findings.push(
                Finding::error("coordinators::carry::speaker", text)
                    .at(place.unwrap_or_else(|| task.place.clone()))
                    .help("name an object at its daemon, such as `fork.sound@speaker`"),
            );
        }
        None => {}
    }
}

/// Says something, and writes it in any case.
pub fn say(cx: &Context, speaker: Option<&Speaker>, words: &str) {
    tracing::info!(task = cx.name(), "said: {words}");
    if let Some(speaker) = speaker {
        speaker.say(cx, words);
    }
}

/// A field as players name it, `D 4`: the letter of its column and the number of its row.
pub fn field(field: &Field) -> String {
    let nearest = |number: f64| number.round().clamp(1.0, 1000.0) as u32;
    let (column, row) = (nearest(field.column), nearest(field.row));
    match ('A'..='Z').nth(column as usize - 1) {
        Some(letter) => format!("{letter} {row}"),
        None => format!("{column} {row}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_field_is_named_as_players_do_and_a_place_beside_its_middle_by_the_nearest() {
        for (text, name) in [
            ("1,1,0", "A 1"),
            ("4,4,2", "D 4"),
            ("3.6,8.4", "D 8"),
            ("8,0.7", "H 1"),
            ("30,2", "30 2"),
        ] {
            assert_eq!(field(&text.parse().unwrap()), name, "{text}");
        }
    }

    #[test]
    fn a_speaker_is_an_object_at_a_daemon() {
        let speaker = Speaker::named("fork.sound@speaker").unwrap();
        assert_eq!(speaker.daemon(), Some("speaker"));
        for name in ["fork.sound", "fork.sound@self", "a b@c", ""] {
            assert!(Speaker::named(name).is_err(), "{name}");
        }
    }
}

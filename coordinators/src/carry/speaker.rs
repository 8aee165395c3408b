//! What people in the room are told of an errand that went wrong (the speaker daemon of the SORMA technical report, section 2.1.3):
//! short messages, with fields as players name them.

use ctos::{
    config::{App, TaskConfig},
    diagnostic::Findings,
    task::Context,
};
use sorma::Transport;

use super::board::Field;
use crate::served::{self, Served};

/// Findings where the argument `speaker` names nobody who speaks.
pub fn check(name: Option<&str>, task: &TaskConfig, app: &App, findings: &mut Findings) {
    if let Some(name) = name {
        served::check(("speaker", name), "fork.sound@speaker", task, app, findings);
    }
}

/// Says something, and writes it in any case.
/// Nobody waits for the speaker; one that cannot be reached is told in the log.
pub fn say(cx: &Context, speaker: Option<&Served>, words: &str) {
    tracing::info!(task = cx.name(), "said: {words}");
    let Some(speaker) = speaker.cloned() else {
        return;
    };
    let (child, body) = (cx.clone(), Transport::text(words));
    cx.spawn(async move {
        if let Err(report) = speaker.tell(&child, body).await {
            tracing::warn!(object = %speaker, %report, "nobody speaks");
        }
    });
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
}

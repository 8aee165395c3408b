//! What a command may want otherwise than the configuration has it.

use serde::{Deserialize, Serialize};

use crate::served::Served;

/// More turns are not known.
pub(super) const MOST_TRIES: u32 = 100;

/// What is done with a thing that was lost on the way.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(in crate::carry) enum Lost {
    /// It is told where it lies.
    #[default]
    Tell,
    /// It is fetched, once.
    Fetch,
    /// A person is asked which of both.
    Ask,
}

/// What a command wants otherwise than the configuration has it: the words `KEY=VALUE` among its arguments.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(in crate::carry) struct Wishes {
    /// Fraction of full speed to and fro.
    pub speed: Option<f64>,
    pub lost: Option<Lost>,
    pub tries: Option<u32>,
    pub show: Option<bool>,
    pub speaker: Option<String>,
}

impl Wishes {
    /// Takes a word.
    pub fn take(&mut self, key: &str, value: &str) -> Result<(), String> {
        match key {
            "speed" => {
                let speed = value.parse().ok();
                let speed = speed.filter(|speed| *speed > 0.0 && *speed <= 1.0);
                let help = "give a fraction of full speed, above 0 and up to 1";
                self.speed = Some(speed.ok_or(help)?);
            }
            "tries" => {
                let tries = value.parse().ok();
                let tries = tries.filter(|tries| (1..=MOST_TRIES).contains(tries));
                self.tries = Some(tries.ok_or_else(|| format!("give from 1 to {MOST_TRIES}"))?);
            }
            "lost" => {
                self.lost = Some(match value {
                    "tell" => Lost::Tell,
                    "fetch" => Lost::Fetch,
                    "ask" => Lost::Ask,
                    _ => return Err("give `tell`, `fetch` or `ask`".to_owned()),
                });
            }
            "show" => {
                self.show = Some(match value {
                    "on" => true,
                    "off" => false,
                    _ => return Err("give `on` or `off`".to_owned()),
                });
            }
            "speaker" => {
                Served::named(value)?;
                self.speaker = Some(value.to_owned());
            }
            _ => {
                return Err(
                    "nobody knows this; speed, tries, lost, show and speaker may be given"
                        .to_owned(),
                );
            }
        }
        Ok(())
    }
}

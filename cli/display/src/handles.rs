//! Handles: what a person takes hold of in the scene, and the command that it puts on the tape of a net. Kept in the file of
//! displays.
//!
//! ```toml
//! [handle.ball]
//! title = "Drags the ball"
//! part = "truth/ball"
//! put = "person/drag"
//! gives = "way"
//!
//! [handle.speed]
//! put = "person/speed"
//! gives = "number"
//! range = [0.0, 1.0]
//! step = 0.1
//! shows = "person/settings/speed"
//! ```

use serde::{Deserialize, Serialize};

/// A handle. Its command has as many numbers as [`Gives`] says.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Written")]
pub(crate) struct Handle {
    pub(crate) title: String,
    /// The part of the scene that is held, `TASK/PART`; none of what stands beside the scene. `TASK/BEGINNING*` is each part
    /// whose name begins so.
    pub(crate) part: Option<String>,
    pub(crate) net: String,
    pub(crate) command: String,
    pub(crate) gives: Gives,
    /// The least and the greatest number, and what lies between two of them.
    pub(crate) range: Option<[f64; 2]>,
    pub(crate) step: Option<f64>,
    /// The number of a part of the scene that tells how it is now, `TASK/PART/NAME`.
    pub(crate) shows: Option<String>,
}

/// What a handle gives its command.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Gives {
    /// x, y, z: how much further it was dragged since the last command, m along the axes of the scene.
    Way,
    /// The part's name, and x, y: how much further it is put on the level, m along the axes of the scene. Once, when it is let go.
    Place,
    /// x, y, z: with how much it is pulled, N along the axes of the scene; and for how long that counts, s.
    Force,
    /// Six deflections from -1 to 1, of which a pad gives the first three; and for how long they count, s.
    Axes,
    /// Nothing: it is a button.
    Press,
    /// One number of `range`: a slider, or a box to tick where there are two numbers.
    Number,
}

/// As it stands in the file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Written {
    #[serde(default)]
    title: String,
    part: Option<String>,
    put: String,
    gives: Gives,
    range: Option<[f64; 2]>,
    step: Option<f64>,
    shows: Option<String>,
}

impl TryFrom<Written> for Handle {
    type Error = String;

    fn try_from(written: Written) -> Result<Self, String> {
        let Written {
            title,
            part,
            put,
            gives,
            range,
            step,
            shows,
        } = written;
        let names = |text: &str| {
            let (one, other) = text.split_once('/')?;
            let whole = !one.is_empty() && !other.is_empty();
            whole.then(|| (one.to_owned(), other.to_owned()))
        };
        let Some((net, command)) = names(&put) else {
            return Err(format!("`put` is `{put}`: write `NET/COMMAND`"));
        };
        match (&part, gives) {
            (None, Gives::Way | Gives::Place | Gives::Force) => {
                return Err("`part` is missing: write `TASK/PART`, a part of the scene".to_owned());
            }
            (Some(part), Gives::Axes | Gives::Press | Gives::Number) => {
                return Err(format!(
                    "what stands beside the scene has no part, and `part` is `{part}`: leave it out"
                ));
            }
            // The command does not say which of several it is for.
            (Some(part), Gives::Way | Gives::Force) if part.ends_with('*') => {
                return Err(format!(
                    "`part` is `{part}`, which may be several: only `gives = \"place\"` tells which"
                ));
            }
            (Some(part), _) if names(part).is_none() => {
                return Err(format!("`part` is `{part}`: write `TASK/PART`"));
            }
            _ => {}
        }
        let is_number = matches!(gives, Gives::Number);
        match (range, step) {
            (None, None) if !is_number => {}
            (Some([least, most]), step) if is_number => {
                let step = step.unwrap_or(most - least);
                if !(least < most && step > 0.0 && step <= most - least) {
                    return Err(format!(
                        "`range` is [{least}, {most}] and `step` {step}: write the least number first, and a step above 0 within them"
                    ));
                }
            }
            _ if is_number => {
                return Err(
                    "`range` is missing: write the least number and the greatest".to_owned(),
                );
            }
            _ => {
                return Err(
                    "only `gives = \"number\"` has `range` and `step`: leave them out".to_owned(),
                );
            }
        }
        if let Some(shown) = &shows
            && (!is_number || shown.split('/').filter(|name| !name.is_empty()).count() != 3)
        {
            return Err(format!(
                "`shows` is `{shown}`: with `gives = \"number\"` write `TASK/PART/NAME`, a number of a part of the scene"
            ));
        }
        Ok(Self {
            title,
            part,
            net,
            command,
            gives,
            range,
            step,
            shows,
        })
    }
}

/// A handle as a page is told of it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Named<'h> {
    pub(crate) name: &'h str,
    #[serde(flatten)]
    pub(crate) handle: &'h Handle,
}

#[cfg(test)]
mod tests {
    use ctos::{
        config::Node,
        diagnostic::{Findings, Source},
    };

    use super::*;

    #[test]
    fn what_is_wrong_in_a_handle_is_told_with_its_place() {
        let read = |text: &str| {
            let mut findings = Findings::new();
            let node = Node::from_toml(&Source::new("app.toml", text), &mut findings);
            let handle = findings.keep(node.parse::<Handle>());
            handle.ok_or_else(|| findings.to_string())
        };
        let ball = read("part = \"truth/ball\"\nput = \"n/drag\"\ngives = \"way\"\n").unwrap();
        assert_eq!((&*ball.net, &*ball.command), ("n", "drag"));
        read("put = \"n/steer\"\ngives = \"axes\"\n").unwrap();
        read("part = \"a/disc*\"\nput = \"n/move\"\ngives = \"place\"\n").unwrap();
        read("put = \"n/stop\"\ngives = \"press\"\n").unwrap();
        let speed = "put = \"n/speed\"\ngives = \"number\"\n";
        read(&format!(
            "{speed}range = [0, 1]\nstep = 0.1\nshows = \"a/b/c\"\n"
        ))
        .unwrap();
        for (wrong, says) in [
            (speed, "`range` is missing"),
            (
                &*format!("{speed}range = [1, 0]\n"),
                "the least number first",
            ),
            (
                &format!("{speed}range = [0, 1]\nstep = 2\n"),
                "a step above 0",
            ),
            (
                &format!("{speed}range = [0, 1]\nshows = \"a/b\"\n"),
                "`TASK/PART/NAME`",
            ),
            (
                "put = \"n/go\"\ngives = \"press\"\nstep = 1\n",
                "leave them out",
            ),
            ("put = \"n/drag\"\ngives = \"way\"\n", "`part` is missing"),
            (
                "part = \"ball\"\nput = \"n/drag\"\ngives = \"force\"\n",
                "`TASK/PART`",
            ),
            (
                "part = \"a/b\"\nput = \"n/drag\"\ngives = \"axes\"\n",
                "leave it out",
            ),
            ("put = \"drag\"\ngives = \"axes\"\n", "`NET/COMMAND`"),
            (
                "part = \"a/disc*\"\nput = \"n/drag\"\ngives = \"way\"\n",
                "only `gives = \"place\"` tells which",
            ),
            ("put = \"n/drag\"\ngives = \"push\"\n", "push"),
            ("puts = \"n/drag\"\ngives = \"axes\"\n", "puts"),
        ] {
            let told = read(wrong).unwrap_err();
            assert!(told.contains(says) && told.contains("app.toml:"), "{told}");
        }
    }
}

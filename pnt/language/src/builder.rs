//! Nets built in Rust, checked like those of a file. All mistakes are found at once, with the file, line and
//! column of the Rust code. Needs no runtime:
//!
//! ```
//! use std::sync::Arc;
//! use pnt::{builder::NetBuilder, exec::Execution};
//!
//! let net = NetBuilder::new("cell")
//!     .place("parts", 3)
//!     .place("machine", 1)
//!     .place("done", 0)
//!     .transition("work", |t| t.input("parts").input("machine").output("done").output("machine"))
//!     .build()
//!     .unwrap_or_else(|findings| panic!("{findings}"));
//!
//! let mut cell = Execution::new(Arc::new(net));
//! let work = cell.net().transition("work").ok_or("no such transition")?;
//! while cell.fire(work).is_ok() {}
//! assert_eq!(cell.marking(), [0, 1, 3]);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use std::{panic::Location, time::Duration};

use ctos::diagnostic::{Finding, Findings, Source};

use crate::{
    compile,
    draft::{
        Draft, DraftAction, DraftArc, DraftCommand, DraftCoordinator, DraftPlace, DraftServes,
        DraftTransition, DraftWhen, Word,
    },
    net::Net,
    text::MOST_TOKENS,
    timing::{Servers, Timing},
};

/// A name said in Rust code: findings about it stand at that line of it.
#[track_caller]
fn word(text: &str) -> Word {
    let here = Location::caller();
    let (line, column) = (here.line() as usize, here.column() as usize);
    let before = "\n".repeat(line.saturating_sub(1)) + &" ".repeat(column.saturating_sub(1));
    let range = before.len()..before.len() + text.len();
    Word::new(text, Source::new(here.file(), before + text).at(range))
}

/// An arc as it is said in Rust: `"p"`, `("p", 2)` for two tokens.
#[derive(Debug, Clone, Copy)]
pub struct To<'a> {
    place: &'a str,
    net: Option<&'a str>,
    weight: u32,
}

impl<'a> To<'a> {
    /// A place of another net.
    #[must_use]
    pub fn remote(place: &'a str, net: &'a str) -> Self {
        Self {
            place,
            net: Some(net),
            weight: 1,
        }
    }

    /// With that many tokens.
    #[must_use]
    pub fn times(self, weight: u32) -> Self {
        Self { weight, ..self }
    }

    #[track_caller]
    fn arc(self) -> DraftArc {
        DraftArc {
            place: word(self.place),
            net: self.net.map(word),
            weight: self.weight,
        }
    }
}

impl<'a> From<&'a str> for To<'a> {
    fn from(place: &'a str) -> Self {
        (place, 1).into()
    }
}

impl<'a> From<(&'a str, u32)> for To<'a> {
    fn from((place, weight): (&'a str, u32)) -> Self {
        Self {
            place,
            net: None,
            weight,
        }
    }
}

/// A net in the making.
#[derive(Debug, Clone)]
pub struct NetBuilder {
    draft: Draft,
}

impl NetBuilder {
    /// A net without places and transitions.
    #[must_use]
    #[track_caller]
    pub fn new(name: &str) -> Self {
        Self {
            draft: Draft::new(word(name)),
        }
    }

    /// One sentence about it.
    #[must_use]
    pub fn title(mut self, title: &str) -> Self {
        self.draft.title = Some(title.to_owned());
        self
    }

    /// A place and its initial tokens.
    #[must_use]
    #[track_caller]
    pub fn place(mut self, name: &str, tokens: u32) -> Self {
        let mut place = DraftPlace::new(word(name));
        place.tokens = tokens;
        self.draft.places.push(place);
        self
    }

    /// A place that holds `capacity` tokens at most.
    #[must_use]
    #[track_caller]
    pub fn bounded_place(mut self, name: &str, tokens: u32, capacity: u32) -> Self {
        let mut place = DraftPlace::new(word(name));
        place.tokens = tokens;
        place.capacity = Some(capacity);
        self.draft.places.push(place);
        self
    }

    /// A place that says whether a data object is valid.
    #[must_use]
    #[track_caller]
    pub fn data_place(mut self, name: &str, object: &str) -> Self {
        let mut place = DraftPlace::new(word(name));
        place.data = Some(word(object));
        self.draft.places.push(place);
        self
    }

    /// A symbol of the input tape and the output symbols, one of which answers it.
    #[must_use]
    #[track_caller]
    pub fn command(mut self, symbol: &str, answers: &[&str]) -> Self {
        let symbol = word(symbol);
        let answers = answers.iter().map(|answer| symbol.derived(*answer));
        let answers = answers.collect();
        self.draft.commands.push(DraftCommand {
            symbol,
            parameters: Vec::new(),
            answers,
        });
        self
    }

    /// A coordinator that this net asks.
    #[must_use]
    #[track_caller]
    pub fn coordinator(mut self, net: &str, requests: &[&str]) -> Self {
        let net = word(net);
        let requests = requests.iter().map(|request| net.derived(*request));
        let requests = requests.collect();
        self.draft
            .coordinators
            .push(DraftCoordinator { net, requests });
        self
    }

    /// The requester that this net serves: what it may ask, and the places that say that a request is done
    /// or has failed.
    #[must_use]
    #[track_caller]
    pub fn serves(
        mut self,
        net: &str,
        requests: &[&str],
        done: &str,
        failed: Option<&str>,
    ) -> Self {
        let net = word(net);
        self.draft.serves.push(DraftServes {
            requests: requests
                .iter()
                .map(|request| net.derived(*request))
                .collect(),
            done: net.derived(done),
            failed: failed.map(|failed| net.derived(failed)),
            net,
        });
        self
    }

    /// A marking at which the running net may be replaced.
    #[must_use]
    #[track_caller]
    pub fn safe(mut self, places: &[(&str, u32)]) -> Self {
        let here = word("safe");
        let arc = |(place, weight): &(&str, u32)| DraftArc {
            place: here.derived(*place),
            net: None,
            weight: *weight,
        };
        self.draft.safe.push(places.iter().map(arc).collect());
        self
    }

    /// A transition; among equals the one that is declared first goes first.
    #[must_use]
    #[track_caller]
    pub fn transition(
        mut self,
        name: &str,
        describe: impl FnOnce(TransitionBuilder) -> TransitionBuilder,
    ) -> Self {
        let transition = TransitionBuilder {
            draft: DraftTransition::new(word(name)),
        };
        self.draft.transitions.push(describe(transition).draft);
        self
    }

    /// The draft, which prints as net text.
    #[must_use]
    pub fn draft(&self) -> &Draft {
        &self.draft
    }

    /// The net, if nothing is wrong with it.
    ///
    /// # Errors
    /// Everything that is wrong, each with its place in the Rust code.
    pub fn build(&self) -> Result<Net, Findings> {
        let mut findings = Findings::new();
        for place in &self.draft.places {
            number(
                &place.name,
                "the initial tokens",
                place.tokens,
                0,
                &mut findings,
            );
            number(
                &place.name,
                "the capacity",
                place.capacity.unwrap_or(1),
                1,
                &mut findings,
            );
        }
        for transition in &self.draft.transitions {
            check(transition, &mut findings);
        }
        match compile::runnable(&self.draft) {
            Ok(net) if !findings.has_errors() => Ok(net),
            Ok(_) => Err(findings),
            Err(found) => {
                findings.extend(found);
                Err(findings)
            }
        }
    }
}

fn number(word: &Word, what: &str, number: u32, least: u32, findings: &mut Findings) {
    if !(least..=MOST_TOKENS).contains(&number) {
        let text = format!("{what} of `{word}` cannot be {number}");
        findings.push(
            Finding::error("pnt::text::number", text)
                .at(word.at.clone())
                .help(format!("give a whole number from {least} to {MOST_TOKENS}")),
        );
    }
}

/// What the parser makes sure of in net text.
fn check(transition: &DraftTransition, findings: &mut Findings) {
    let arcs = [
        &transition.inputs,
        &transition.reads,
        &transition.inhibitors,
        &transition.outputs,
        &transition.fail,
    ];
    for arc in arcs.into_iter().flatten() {
        number(
            &arc.place,
            "the weight of the arc to",
            arc.weight,
            1,
            findings,
        );
    }
    let times = match transition.timing {
        Timing::Immediate => [None, None],
        Timing::Deterministic(time) | Timing::Exponential { mean: time } => [Some(time), None],
        Timing::Normal { mean, spread } => [Some(mean), Some(spread)],
    };
    let too_short = |time: &Duration| time.as_micros() == 0;
    let weight = transition.weight;
    let wrong = if times
        .into_iter()
        .flatten()
        .chain(transition.within)
        .any(|time| too_short(&time))
    {
        Some("a time of at least a microsecond")
    } else if !(weight > 0.0 && weight.is_finite()) {
        Some("a finite weight above zero")
    } else {
        None
    };
    if let Some(needed) = wrong {
        let text = format!("transition `{}` needs {needed}", transition.name);
        findings.push(
            Finding::error("pnt::text::number", text)
                .at(transition.name.at.clone())
                .help("zero is no time and no share; leave it out instead"),
        );
    }
}

/// A transition in the making.
#[derive(Debug, Clone)]
pub struct TransitionBuilder {
    draft: DraftTransition,
}

impl TransitionBuilder {
    /// Takes tokens when it starts.
    #[must_use]
    #[track_caller]
    pub fn input<'a>(mut self, arc: impl Into<To<'a>>) -> Self {
        self.draft.inputs.push(arc.into().arc());
        self
    }

    /// Needs tokens and leaves them.
    #[must_use]
    #[track_caller]
    pub fn read<'a>(mut self, arc: impl Into<To<'a>>) -> Self {
        self.draft.reads.push(arc.into().arc());
        self
    }

    /// Only while the place holds fewer tokens.
    #[must_use]
    #[track_caller]
    pub fn inhibit<'a>(mut self, arc: impl Into<To<'a>>) -> Self {
        self.draft.inhibitors.push(arc.into().arc());
        self
    }

    /// Empties a place when it starts.
    #[must_use]
    #[track_caller]
    pub fn reset(mut self, place: &str) -> Self {
        self.draft.resets.push(word(place));
        self
    }

    /// Puts tokens when its action is complete.
    #[must_use]
    #[track_caller]
    pub fn output<'a>(mut self, arc: impl Into<To<'a>>) -> Self {
        self.draft.outputs.push(arc.into().arc());
        self
    }

    /// Puts these instead when its action has failed.
    #[must_use]
    #[track_caller]
    pub fn fail<'a>(mut self, arc: impl Into<To<'a>>) -> Self {
        self.draft.fail.push(arc.into().arc());
        self
    }

    /// Reads a symbol of the input tape.
    #[must_use]
    #[track_caller]
    pub fn tape(mut self, symbol: &str) -> Self {
        self.draft.tape = Some(word(symbol));
        self
    }

    /// Writes an output symbol when its action is complete.
    #[must_use]
    #[track_caller]
    pub fn write(mut self, symbol: &str) -> Self {
        self.draft.write = Some(word(symbol));
        self
    }

    /// Only while an enabling function says yes.
    #[must_use]
    #[track_caller]
    pub fn when(mut self, function: &str) -> Self {
        self.draft.when = Some(DraftWhen {
            function: word(function),
            negated: false,
            expression: false,
        });
        self
    }

    /// Only while an enabling function says no.
    #[must_use]
    #[track_caller]
    pub fn when_not(mut self, function: &str) -> Self {
        self.draft.when = Some(DraftWhen {
            function: word(function),
            negated: true,
            expression: false,
        });
        self
    }

    /// Its action calls a local function.
    #[must_use]
    #[track_caller]
    pub fn act(self, function: &str) -> Self {
        self.call(function, &[], &[])
    }

    /// Its action calls a local function that takes data objects and gives data objects
    /// (`Library::function` of `pnt-task`).
    #[must_use]
    #[track_caller]
    pub fn call(mut self, function: &str, inputs: &[&str], outputs: &[&str]) -> Self {
        let function = word(function);
        let words = |names: &[&str]| names.iter().map(|name| function.derived(*name)).collect();
        self.draft.action = Some(DraftAction::Do {
            inputs: words(inputs),
            outputs: words(outputs),
            function,
        });
        self
    }

    /// Its action is a request to a coordinator.
    #[must_use]
    #[track_caller]
    pub fn ask(mut self, coordinator: &str, request: &str) -> Self {
        self.draft.action = Some(DraftAction::Ask {
            coordinator: word(coordinator),
            request: word(request),
        });
        self
    }

    /// Its action is a message to a task, with data objects and for data objects.
    #[must_use]
    #[track_caller]
    pub fn send(mut self, task: &str, command: &str, inputs: &[&str], outputs: &[&str]) -> Self {
        let task = word(task);
        let words = |names: &[&str]| names.iter().map(|name| task.derived(*name)).collect();
        self.draft.action = Some(DraftAction::Send {
            command: task.derived(command),
            inputs: words(inputs),
            outputs: words(outputs),
            task,
        });
        self
    }

    /// Its action may be asked again when a crash left open how it ended.
    #[must_use]
    pub fn idempotent(mut self) -> Self {
        self.draft.idempotent = true;
        self
    }

    /// Higher goes first.
    #[must_use]
    pub fn priority(mut self, priority: u32) -> Self {
        self.draft.priority = priority;
        self
    }

    /// Its share among equals where chance decides.
    #[must_use]
    pub fn weight(mut self, weight: f64) -> Self {
        self.draft.weight = weight;
        self
    }

    /// Its time.
    #[must_use]
    pub fn time(mut self, timing: Timing) -> Self {
        self.draft.timing = timing;
        self
    }

    /// How many of its firings may go on at once.
    #[must_use]
    pub fn servers(mut self, servers: Servers) -> Self {
        self.draft.servers = Some(servers);
        self
    }

    /// Its action has failed when it takes longer.
    #[must_use]
    pub fn within(mut self, limit: Duration) -> Self {
        self.draft.within = Some(limit);
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::text;

    fn cell() -> NetBuilder {
        NetBuilder::new("cell")
            .title("A cell")
            .bounded_place("parts", 2, 4)
            .data_place("seen", "spots")
            .place("free arm", 1)
            .command("go", &["gone", "not_gone"])
            .coordinator("vision", &["find_spot"])
            .serves("planner", &["plan"], "seen", Some("parts"))
            .safe(&[("free arm", 1)])
            .transition("take", |t| {
                t.input(("parts", 2))
                    .input("free arm")
                    .read("seen")
                    .inhibit(("seen", 3))
                    .tape("go")
                    .when_not("tired")
                    .send("arm", "take", &["spots", "speed"], &["grip"])
                    .idempotent()
                    .output(To::remote("p", "other").times(2))
                    .fail("parts")
                    .write("gone")
                    .priority(2)
                    .within(Duration::from_secs(2))
            })
            .transition("look", |t| {
                t.input("free arm")
                    .ask("vision", "find_spot")
                    .output("seen")
                    .reset("parts")
            })
            .transition("wait", |t| {
                t.input("seen")
                    .when("tired")
                    .output("free arm")
                    .weight(0.5)
                    .servers(Servers::Many)
                    .time(Timing::Exponential {
                        mean: Duration::from_millis(300),
                    })
            })
    }

    #[test]
    fn a_built_net_is_the_net_of_its_text() {
        let built = cell();
        let net = built.build().unwrap_or_else(|found| panic!("{found}"));
        let text = built.draft().to_string();
        let parsed = text::parse(&Source::new("cell.net", text)).unwrap();
        assert_eq!(&parsed, built.draft());
        let of_text = compile::compile(&parsed).unwrap();
        assert_eq!(net.transitions().len(), of_text.transitions().len());
        assert_eq!(net.places().len(), of_text.places().len());
    }

    #[test]
    fn everything_wrong_is_found_at_once_at_its_line_of_the_code() {
        let first = line!() + 2;
        let found = NetBuilder::new("n")
            .place("a", 2_000_000_000)
            .transition("t", |t| t.input("b").output(("a", 0)))
            .transition("u", |t| t.input("a").weight(f64::NAN))
            .build()
            .unwrap_err();
        let shown: Vec<String> = found
            .into_sorted()
            .iter()
            .map(ToString::to_string)
            .collect();
        assert_eq!(shown.len(), 4, "{shown:#?}");
        let at = |line: u32| format!("{}:{line}:", file!());
        assert!(
            shown
                .iter()
                .any(|text| text.starts_with(&at(first))
                    && text.contains("the initial tokens of `a`")),
            "{shown:#?}"
        );
        assert!(
            shown.iter().any(|text| text.starts_with(&at(first + 1))
                && text.contains("no place `b` (did you mean `a`?)")),
            "{shown:#?}"
        );
    }

    #[test]
    fn a_name_may_be_anything_and_a_circle_that_fires_for_ever_is_refused() {
        let found = NetBuilder::new("n")
            .place("p q", 0)
            .transition("t", |t| t.output("p q"))
            .build();
        assert!(found.unwrap_err().to_string().contains("takes nothing"));
    }
}

//! The class `wspc`: recipes of guards (SORMA technical report, 2.1.3). A flavor is a recipe; EXEC gives it to the app's
//! arm under the flavor's name, in place of the one that is in force. `mvpos -guards wspc.NAME` does so before it moves.

use std::sync::LazyLock;
use std::time::Duration;

use futures_util::future::LocalBoxFuture;
use sorma::{Context, Form, OptionTable, Outcome, Report, ServiceObject, Transport, Waiting};

use super::{code, ended, known};
use crate::client::{GuardsReport, ReadGuards, RemoveGuard, SetGuard};
use crate::guard::Reaction;

/// The servo answers after a tick.
const DEADLINE: Duration = Duration::from_secs(30);

const FOR: &str = "for TASK";

const FORMS: &[Form] = &[
    Form {
        text: "",
        floats: 0,
        takes: "",
        gives: "nothing",
        results: "",
        help: "puts the guard in force under the flavor's name, or changes it, from the next servo tick on",
    },
    Form {
        text: FOR,
        floats: 0,
        takes: "",
        gives: "nothing",
        results: "",
        help: "the same for the arm behind another client interface than -client",
    },
    Form {
        text: "remove",
        floats: 0,
        takes: "",
        gives: "nothing",
        results: "",
        help: "takes the guard away again",
    },
    Form {
        text: "list",
        floats: 0,
        takes: "",
        gives: "text: a line for each guard of the arm, and one for what a guard found last",
        results: "",
        help: "tells which guards the arm has",
    },
];

#[derive(Debug, Clone)]
pub(super) struct Options {
    client: String,
    pattern: String,
    reaction: String,
    always: bool,
    inside: Vec<f64>,
    keep_out: Vec<f64>,
    above: Vec<f64>,
    radius: Vec<f64>,
    tool: Vec<f64>,
    turning: Vec<f64>,
    force: Vec<f64>,
    torque: Vec<f64>,
    direction: Vec<f64>,
    rise: Vec<f64>,
    within: Vec<f64>,
    args: String,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            client: "mcs".to_owned(),
            pattern: "workspace".to_owned(),
            reaction: "stop".to_owned(),
            always: false,
            inside: Vec::new(),
            keep_out: Vec::new(),
            above: Vec::new(),
            radius: Vec::new(),
            tool: Vec::new(),
            turning: Vec::new(),
            force: Vec::new(),
            torque: Vec::new(),
            direction: Vec::new(),
            rise: Vec::new(),
            within: Vec::new(),
            args: String::new(),
        }
    }
}

const BOX: &[&str] = &["X0", "Y0", "Z0", "X1", "Y1", "Z1"];

pub(super) static TABLE: LazyLock<OptionTable<Options>> = LazyLock::new(|| {
    OptionTable::new("recipes of guards, which watch the motions of an arm")
        .exec(FORMS)
        .word(
            "pattern",
            "KIND",
            "the kind of guard: workspace, speed, force, or another one that the program registers",
            |options: &mut Options| &mut options.pattern,
        )
        .choice(
            "reaction",
            &["stop", "retreat", "report"],
            "what happens when it finds something: the arm comes to rest, goes back as well, or goes on",
            |options| &mut options.reaction,
        )
        .flag(
            "always",
            "watches every motion, also those that do not name it",
            |options| &mut options.always,
        )
        .floats(
            "inside",
            BOX,
            -100.0..=100.0,
            "m",
            "workspace: the box, base frame, in which the tool must be",
            |options| &mut options.inside,
        )
        .floats(
            "keepout",
            BOX,
            -100.0..=100.0,
            "m",
            "workspace: the box, base frame, in which the tool must not be",
            |options| &mut options.keep_out,
        )
        .floats(
            "above",
            &["NX", "NY", "NZ", "AT"],
            -100.0..=100.0,
            "m",
            "workspace: the tool must be where N . p is at least AT",
            |options| &mut options.above,
        )
        .floats(
            "radius",
            &["R"],
            0.0..=1.0,
            "m",
            "workspace: radius of the tool about its origin",
            |options| &mut options.radius,
        )
        .floats(
            "tool",
            &["V"],
            1e-4..=100.0,
            "m/s",
            "speed: the most of the tool",
            |options| &mut options.tool,
        )
        .floats(
            "turning",
            &["W"],
            1e-4..=100.0,
            "rad/s",
            "speed: the most of the tool's turning",
            |options| &mut options.turning,
        )
        .floats(
            "force",
            &["F"],
            1e-3..=10000.0,
            "N",
            "force: the most on the tool",
            |options| &mut options.force,
        )
        .floats(
            "torque",
            &["T"],
            1e-3..=10000.0,
            "N m",
            "force: the most torque on the tool",
            |options| &mut options.torque,
        )
        .floats(
            "direction",
            &["X", "Y", "Z"],
            -100.0..=100.0,
            "",
            "force: only the force along this counts, in the sensor's frame",
            |options| &mut options.direction,
        )
        .floats(
            "rise",
            &["F"],
            1e-3..=10000.0,
            "N",
            "force: the most by which it may rise within -within",
            |options| &mut options.rise,
        )
        .floats(
            "within",
            &["T"],
            1e-3..=10.0,
            "s",
            "force: the time for -rise; 0.02 s unless it is set",
            |options| &mut options.within,
        )
        .word(
            "args",
            "TOML",
            "arguments of a kind that the program registers, as in the configuration",
            |options| &mut options.args,
        )
        .word(
            "client",
            "TASK",
            "the app's task with the client interface of MCS",
            |options| &mut options.client,
        )
});

impl Options {
    /// The arguments of the pattern, as TOML.
    fn args(&self) -> String {
        let mut lines = vec![self.args.clone()];
        let region = |values: &[f64]| match values {
            [low @ .., _, _, _] if values.len() == 6 => {
                format!("[{{ low = {low:?}, high = {:?} }}]", &values[3..])
            }
            _ => String::new(),
        };
        let mut line = |key: &str, text: String| {
            if !text.is_empty() {
                lines.push(format!("{key} = {text}"));
            }
        };
        let one = |values: &[f64]| {
            values
                .first()
                .map_or(String::new(), |value| format!("{value:?}"))
        };
        match self.pattern.as_str() {
            "workspace" => {
                line("inside", region(&self.inside));
                line("keep_out", region(&self.keep_out));
                line("radius", one(&self.radius));
                if let [x, y, z, at] = self.above[..] {
                    let text = format!("[{{ normal = [{x:?}, {y:?}, {z:?}], at = {at:?} }}]");
                    line("above", text);
                }
            }
            "speed" => {
                line("tool", one(&self.tool));
                line("turning", one(&self.turning));
            }
            "force" => {
                line("force", one(&self.force));
                line("torque", one(&self.torque));
                line("rise", one(&self.rise));
                line("within", one(&self.within));
                if !self.direction.is_empty() {
                    line("direction", format!("{:?}", self.direction));
                }
            }
            _ => {}
        }
        lines.join("\n")
    }

    fn reaction(&self) -> Reaction {
        match self.reaction.as_str() {
            "retreat" => Reaction::Retreat,
            "report" => Reaction::Report,
            _ => Reaction::Stop,
        }
    }
}

/// The name of a guard that an object of this name is the recipe of: its flavor.
pub(super) fn guard_name(object: &str) -> &str {
    let local = object.split('@').next().unwrap_or(object);
    local.split_once('.').map_or(local, |(_, flavor)| flavor)
}

/// An object of class `wspc`.
#[derive(Default)]
pub(super) struct Wspc {
    options: Options,
}

impl Wspc {
    async fn job(&self, form: &str, cx: &Waiting<'_>, io: &mut Transport) -> Outcome {
        if !cx.is_in_app() {
            let text = "there is no servo in this process; guards watch the arm of an app";
            return Err(Report::error(code::MOTION, text));
        }
        let client = match form {
            FOR => io.text.split_whitespace().nth(1).unwrap_or_default(),
            _ => self.options.client.as_str(),
        };
        let client = &client.to_owned();
        io.text.clear();
        let outcome = self.asked(form, client, cx, io).await;
        known(cx, client, outcome).await
    }

    async fn asked(
        &self,
        form: &str,
        client: &str,
        cx: &Waiting<'_>,
        io: &mut Transport,
    ) -> Outcome {
        let name = guard_name(cx.name()).to_owned();
        match form {
            "list" => {
                let report = cx.call_task(client, ReadGuards {}, DEADLINE).await?;
                io.text = listed(&report);
            }
            "remove" => cx.call_task(client, RemoveGuard { name }, DEADLINE).await?,
            _ => {
                let request = SetGuard {
                    name,
                    kind: self.options.pattern.clone(),
                    always: self.options.always,
                    reaction: self.options.reaction(),
                    args: self.options.args(),
                };
                cx.call_task(client, request, DEADLINE).await?;
            }
        }
        Ok(())
    }
}

fn word(reaction: Reaction) -> &'static str {
    match reaction {
        Reaction::Stop => "stop",
        Reaction::Retreat => "retreat",
        Reaction::Report => "report",
    }
}

fn listed(report: &GuardsReport) -> String {
    let mut lines: Vec<String> = report
        .recipes
        .iter()
        .map(|recipe| {
            let when = if recipe.always {
                "always"
            } else {
                "when named"
            };
            format!(
                "{}: {}, {when}, {}",
                recipe.name,
                recipe.kind,
                word(recipe.reaction)
            )
        })
        .collect();
    if let Some(last) = &report.last {
        let done = word(last.reaction);
        lines.push(format!(
            "last found, by {} ({done}): {}",
            last.guard, last.measured
        ));
    }
    lines.join("\n")
}

impl ServiceObject for Wspc {
    fn exec_waiting<'a>(
        &'a mut self,
        cx: &'a Waiting<'a>,
        io: &'a mut Transport,
    ) -> Option<LocalBoxFuture<'a, Outcome>> {
        Some(Box::pin(async move {
            let form = match TABLE.form(io) {
                Ok(form) => form.text,
                Err(report) => return ended(io, Err(report)),
            };
            let outcome = self.job(form, cx, io).await;
            if outcome.is_err() {
                return ended(io, outcome);
            }
            Ok(())
        }))
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        TABLE.ctrl(&mut self.options, io);
        Ok(())
    }

    fn dump(&self) -> String {
        TABLE.dump(&self.options)
    }
}

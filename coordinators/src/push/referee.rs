//! The referee of `push`: holds where the thing stands against what was told, which only a stand-in for the world can know.

use ctos::{
    diagnostic::Finding,
    message::{Command, Message},
    registry::Registry,
    system::AppResult,
    task::{Context, EventHandler, Handled, HandlerError},
};
use mcs_hand::command::ReadBodies;
use nalgebra::Point2;
use serde::{Deserialize, Serialize};

use super::job::{ACCOUNT, Account, JOB, Job};
use crate::{dom::DomStore, referee::Judge};

/// The handler's name.
pub const HANDLER: &str = "coordinators.push_referee";

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct RefereeArgs {
    /// The task that knows where bodies are.
    #[serde(default = "world_task")]
    world: String,
    /// The data object manager.
    #[serde(default = "crate::dom_task")]
    dom: String,
    /// The body that is pushed, by its name in the world.
    body: String,
    /// From its middle to where the tool presses, with the tool's own thickness, m.
    half_m: f64,
    /// How far from where it should be it may stand, m, along and across.
    #[serde(default = "within_m")]
    within_m: f64,
}

fn world_task() -> String {
    "world".to_owned()
}

fn within_m() -> f64 {
    0.015
}

/// The verdict.
#[derive(Debug, Clone, PartialEq, Serialize)]
struct Verdict {
    ok: bool,
    seconds: f64,
    /// How far along the way its middle is, m.
    along_m: f64,
    /// How far that is from where the tool left it, m.
    error_m: f64,
    /// How far it is from the line, m.
    across_m: f64,
}

struct Referee {
    args: RefereeArgs,
}

/// Registers the handler.
pub(super) fn register(registry: &mut Registry) {
    registry
        .handler(HANDLER, &[Judge::INFO], |cx| {
            Ok(Referee { args: cx.args()? })
        })
        .checked_args::<RefereeArgs>(|args, task, app, findings| {
            crate::need_task(task, app, "world", &args.world, findings);
            crate::need_task(task, app, "dom", &args.dom, findings);
            for (key, value) in [("half_m", args.half_m), ("within_m", args.within_m)] {
                if !(1e-5..=1.0).contains(&value) {
                    let place = task.args.locate(key).unwrap_or_else(|| task.place.clone());
                    let text = format!("`{key}` is {value}");
                    findings.push(
                        Finding::error("coordinators::push::range", text)
                            .at(place)
                            .help("give from 0.00001 to 1 m"),
                    );
                }
            }
        });
}

impl Referee {
    async fn judge(&self, cx: &Context, judge: &Judge) -> Result<AppResult, HandlerError> {
        let store = DomStore::new(&self.args.dom);
        let job: Job = store.fetch(cx, JOB).await?;
        let account: Account = store.fetch(cx, ACCOUNT).await?;
        let world = cx.task(&self.args.world).await?;
        let bodies = cx.call(&world, ReadBodies {}).await;
        let bodies = bodies.map_err(|error| HandlerError::new(error.reason()))?;
        let body = bodies.iter().find(|body| body.name == self.args.body);
        let body = body.ok_or_else(|| {
            HandlerError::new(format!("the world has no body `{}`", self.args.body))
        })?;
        let [_, _, _, x, _, _, _, y, ..] = body.world_t_body;
        let verdict = verdict(&job, &account, Point2::new(x, y), self.args.half_m);
        let verdict = Verdict {
            ok: verdict.error_m.abs() <= self.args.within_m
                && verdict.across_m.abs() <= self.args.within_m,
            seconds: judge.seconds,
            ..verdict
        };
        let text = format!(
            "{} stands {:.1} mm from where it was left, {:.1} mm off the line, {:.1} s\n{}",
            self.args.body,
            verdict.error_m * 1e3,
            verdict.across_m * 1e3,
            verdict.seconds,
            judge.notes
        );
        Ok(AppResult {
            ok: verdict.ok,
            text: text.trim_end().to_owned(),
            json: serde_json::to_string(&verdict)?,
        })
    }
}

fn verdict(job: &Job, account: &Account, middle: Point2<f64>, half_m: f64) -> Verdict {
    let along_m = job.along(&middle);
    let left = account.ended_m.unwrap_or_default() + half_m;
    let direction = job.direction();
    Verdict {
        ok: false,
        seconds: 0.0,
        along_m,
        error_m: along_m - left,
        across_m: direction.perp(&(middle - job.from)),
    }
}

impl EventHandler for Referee {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            Judge::CODE => {
                let (judge, reply) = message.open::<Judge>()?;
                match self.judge(cx, &judge).await {
                    Ok(result) => reply.ok(result),
                    Err(error) => reply.fail(error),
                }
            }
            _ => cx.default_processing(message),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_stands_ahead_of_the_tool_by_half_its_size_is_where_it_was_left() {
        let job = Job {
            command: 1,
            from: Point2::new(0.5, 0.0),
            to: Point2::new(0.5, 0.3),
        };
        let account = Account {
            ended_m: Some(0.295),
            ..Account::default()
        };
        let good = verdict(&job, &account, Point2::new(0.5, 0.335), 0.04);
        assert!(good.error_m.abs() < 1e-12 && good.across_m.abs() < 1e-12);
        let off = verdict(&job, &account, Point2::new(0.51, 0.3), 0.04);
        assert!((off.error_m + 0.035).abs() < 1e-12);
        assert!((off.across_m.abs() - 0.01).abs() < 1e-12);
    }
}

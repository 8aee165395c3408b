//! The referee of `push`: holds where the thing stands against what was told, which only a stand-in for the world can know.

use ctos::{
    config::TaskConfig,
    diagnostic::Findings,
    registry::Registry,
    system::AppResult,
    task::{Context, HandlerError},
};
use mcs_hand::command::Body;
use nalgebra::Point2;
use serde::{Deserialize, Serialize};

use super::job::{ACCOUNT, Account, JOB, Job};
use crate::{
    dom::DomStore,
    referee::{
        Judge,
        bodies::{self, Judges, pose_of},
    },
};

/// The handler's name.
pub const HANDLER: &str = "coordinators.push_referee";

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct RefereeArgs {
    /// The task that knows where bodies are.
    #[serde(default = "bodies::world_task")]
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

/// Registers the handler.
pub(super) fn register(registry: &mut Registry) {
    bodies::register::<RefereeArgs>(registry);
}

impl Judges for RefereeArgs {
    const HANDLER: &'static str = HANDLER;

    fn world(&self) -> &str {
        &self.world
    }

    fn dom(&self) -> &str {
        &self.dom
    }

    fn check(&self, task: &TaskConfig, findings: &mut Findings) {
        for (key, value) in [("half_m", self.half_m), ("within_m", self.within_m)] {
            let length = (key, value, 1.0);
            bodies::check_length(task, length, "coordinators::push::range", findings);
        }
    }

    async fn judge(
        &self,
        cx: &Context,
        store: &DomStore,
        bodies: &[Body],
        judge: &Judge,
    ) -> Result<AppResult, HandlerError> {
        let job: Job = store.fetch(cx, JOB).await?;
        let account: Account = store.fetch(cx, ACCOUNT).await?;
        let middle = pose_of(bodies, &self.body)?.translation.vector.xy();
        let verdict = verdict(&job, &account, middle.into(), self.half_m);
        let verdict = Verdict {
            ok: verdict.error_m.abs() <= self.within_m && verdict.across_m.abs() <= self.within_m,
            seconds: judge.seconds,
            ..verdict
        };
        let text = format!(
            "{} stands {:.1} mm from where it was left, {:.1} mm off the line, {:.1} s\n{}",
            self.body,
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

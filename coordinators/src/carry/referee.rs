//! The referee of `carry`: holds what was carried against the truth, which only a stand-in for the world can know. It runs when
//! everything is done; nothing that plans may ask it.

use ctos::{
    config::TaskConfig,
    diagnostic::Findings,
    registry::Registry,
    system::AppResult,
    task::{Context, HandlerError},
};
use mcs_hand::command::Body;
use nalgebra::{Isometry3, Point3, Translation3, Vector3};
use serde::{Deserialize, Serialize};

use super::errand::{ERRAND, Errand};
use crate::{
    dom::DomStore,
    referee::{
        Judge,
        bodies::{self, Judges, pose_of},
    },
};

/// The handler's name.
pub const HANDLER: &str = "coordinators.carry_referee";

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
    /// The body that is carried, by its name in the world. Its frame has its origin in the middle, and z up.
    body: String,
    /// The body of the board, whose frame has its origin in the middle of a box; where the errand has it, when there is none.
    board: Option<String>,
    /// How far from the middle of the field it may stand, m.
    #[serde(default = "within_m")]
    within_m: f64,
}

fn within_m() -> f64 {
    3e-3
}

/// What stands upright leans by less, rad.
const UPRIGHT: f64 = 0.035;

/// The verdict.
#[derive(Debug, Clone, PartialEq, Serialize)]
struct Verdict {
    ok: bool,
    seconds: f64,
    /// From the middle of the field, in its plane, m.
    error_m: f64,
    /// Above where it should stand, m.
    above_m: f64,
    /// Of its axis from the vertical, rad.
    lean_rad: f64,
    /// How far the middle of the board is from where it was taken to be, m.
    board_error_m: Option<f64>,
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
        let within = ("within_m", self.within_m, 0.1);
        bodies::check_length(task, within, "coordinators::carry::board", findings);
    }

    async fn judge(
        &self,
        cx: &Context,
        store: &DomStore,
        bodies: &[Body],
        judge: &Judge,
    ) -> Result<AppResult, HandlerError> {
        let errand: Errand = store.fetch(cx, ERRAND).await?;
        let board = self.board.as_ref();
        let board = board.map(|name| pose_of(bodies, name)).transpose()?;
        let body = pose_of(bodies, &self.body)?;
        let verdict = verdict(&errand, board, body, judge.seconds);
        let ok = verdict.error_m <= self.within_m
            && verdict.above_m.abs() <= self.within_m
            && verdict.lean_rad <= UPRIGHT;
        let verdict = Verdict { ok, ..verdict };
        let text = format!(
            "{} on {}: {:.2} mm from the middle of the field, {:.1} s\n{}",
            errand.thing.name,
            errand.to,
            verdict.error_m * 1e3,
            verdict.seconds,
            judge.notes
        );
        Ok(AppResult {
            ok,
            text: text.trim_end().to_owned(),
            json: serde_json::to_string(&verdict)?,
        })
    }
}

fn verdict(
    errand: &Errand,
    board: Option<Isometry3<f64>>,
    pose: Isometry3<f64>,
    seconds: f64,
) -> Verdict {
    // The middle of the surface, not of the box.
    let board =
        board.map(|middle| middle * Translation3::new(0.0, 0.0, 0.5 * errand.board.thick_m));
    let [_, to] = errand.points;
    let height_m = errand.thing.height_m;
    let to = board.map_or(to, |board| {
        board * errand.board.on_board(&errand.to, height_m)
    });
    let middle: Point3<f64> = to + Vector3::z() * (errand.thing.height_m / 2.0);
    let off = pose.translation.vector - middle.coords;
    let axis = pose * Vector3::z();
    Verdict {
        ok: false,
        seconds,
        error_m: off.xy().norm(),
        above_m: off.z,
        lean_rad: axis.xy().norm().atan2(axis.z.abs()),
        board_error_m: board.map(|board| {
            let off = board.translation.vector - Vector3::from(errand.board.at);
            off.xy().norm()
        }),
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::UnitQuaternion;

    use super::*;
    use crate::carry::tests::errand;

    #[test]
    fn what_stands_in_the_middle_of_the_field_is_without_error_and_what_does_not_is_measured() {
        let errand = errand();
        let [_, to] = errand.points;
        let at = |x: f64, z: f64, lean: f64| {
            let half = errand.thing.height_m / 2.0;
            let at = to + Vector3::new(x, 0.0, half + z);
            let lean = UnitQuaternion::from_euler_angles(lean, 0.0, 0.0);
            verdict(&errand, None, Isometry3::from_parts(at.into(), lean), 1.0)
        };
        let good = at(0.0, 0.0, 0.0);
        assert!(good.error_m < 1e-12 && good.above_m.abs() < 1e-12 && good.lean_rad < 1e-9);
        let off = at(0.004, 0.01, 0.3);
        assert!((off.error_m - 0.004).abs() < 1e-12);
        assert!((off.above_m - 0.01).abs() < 1e-12);
        assert!((off.lean_rad - 0.3).abs() < 1e-9);
        // What stands where it should by a board that is not where it was taken to be is as far off.
        let middle = errand.board.pose() * Translation3::new(0.003, 0.0, -0.01);
        let half = errand.thing.height_m / 2.0;
        let body = Isometry3::from_parts(
            (to + Vector3::z() * half).into(),
            UnitQuaternion::identity(),
        );
        let judged = verdict(&errand, Some(middle), body, 1.0);
        assert!((judged.error_m - 0.003).abs() < 1e-12, "{judged:?}");
        assert!((judged.board_error_m.unwrap() - 0.003).abs() < 1e-12);
        // A round thing has no upper side.
        assert!(at(0.0, 0.0, std::f64::consts::PI).lean_rad < 1e-9);
    }
}

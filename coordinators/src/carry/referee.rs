//! The referee of `carry`: holds what was carried against the truth, which only a stand-in for the world can know. It runs when
//! everything is done; nothing that plans may ask it.

use ctos::{
    diagnostic::Finding,
    message::{Command, Message},
    registry::Registry,
    system::AppResult,
    task::{Context, EventHandler, Handled, HandlerError},
};
use mcs_hand::command::{Body, ReadBodies};
use nalgebra::{Isometry3, Matrix4, Point3, Translation3, Vector3};
use serde::{Deserialize, Serialize};

use super::errand::{ERRAND, Errand};
use crate::{dom::DomStore, referee::Judge};

/// The handler's name.
pub const HANDLER: &str = "coordinators.carry_referee";

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
    /// The body that is carried, by its name in the world. Its frame has its origin in the middle, and z up.
    body: String,
    /// The body of the board, whose frame has its origin in the middle of a box; where the errand has it, when there is none.
    board: Option<String>,
    /// How far from the middle of the field it may stand, m.
    #[serde(default = "within_m")]
    within_m: f64,
}

fn world_task() -> String {
    "world".to_owned()
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
            if !(1e-5..=0.1).contains(&args.within_m) {
                let place = task.args.locate("within_m");
                let text = format!("`within_m` is {}", args.within_m);
                findings.push(
                    Finding::error("coordinators::carry::board", text)
                        .at(place.unwrap_or_else(|| task.place.clone()))
                        .help("give from 0.00001 to 0.1 m"),
                );
            }
        });
}

impl Referee {
    async fn judge(&self, cx: &Context, judge: &Judge) -> Result<AppResult, HandlerError> {
        let store = DomStore::new(&self.args.dom);
        let errand: Errand = store.fetch(cx, ERRAND).await?;
        let world = cx.task(&self.args.world).await?;
        let bodies = cx.call(&world, ReadBodies {}).await;
        let bodies = bodies.map_err(|error| HandlerError::new(error.reason()))?;
        let board = self.args.board.as_ref();
        let board = board.map(|name| pose_of(&bodies, name)).transpose()?;
        let body = pose_of(&bodies, &self.args.body)?;
        let verdict = verdict(&errand, board, body, judge.seconds);
        let ok = verdict.error_m <= self.args.within_m
            && verdict.above_m.abs() <= self.args.within_m
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

/// `base_t_body`.
fn pose_of(bodies: &[Body], name: &str) -> Result<Isometry3<f64>, HandlerError> {
    let body = bodies.iter().find(|body| body.name == name);
    let body = body.ok_or_else(|| {
        let names: Vec<&str> = bodies.iter().map(|body| body.name.as_str()).collect();
        HandlerError::new(format!(
            "the world has no body `{name}`; it has {}",
            names.join(", ")
        ))
    })?;
    nalgebra::try_convert(Matrix4::from_row_slice(&body.world_t_body))
        .ok_or_else(|| HandlerError::new(format!("the pose of `{name}` is none")))
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

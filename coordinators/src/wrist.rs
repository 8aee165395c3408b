//! The camera on a hand: by how much the gripper is beside what it is to grip (SORMA technical report, section 2.1.4: preshape
//! position by vision). The Service DiskFind answers that, and learns it from four examples.

use ctos::{
    config::{App, TaskConfig},
    diagnostic::{Finding, Findings},
    task::Context,
};
use serde::Deserialize;
use vss::command::{DiskOffset, DiskReport, VisionError};

use crate::outcome::{Failure, Outcome};

/// From another place it may be seen.
fn unseen(reason: &str) -> Failure {
    Failure::new(Outcome::Unseen, reason)
}

/// The camera on the hand.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WristArgs {
    /// Its name.
    camera: String,
    /// The Services Manager of VSS.
    #[serde(default = "vsm_task")]
    vsm: String,
    /// Half the side of the square whose corners are the examples, m.
    #[serde(default = "half_m")]
    pub half_m: f64,
    /// A correction that is larger is not believed, m.
    #[serde(default = "most_m")]
    most_m: f64,
}

fn vsm_task() -> String {
    "vsm".to_owned()
}

fn half_m() -> f64 {
    0.01
}

fn most_m() -> f64 {
    0.012
}

impl WristArgs {
    /// Findings where they make no sense; `key` is theirs among the arguments of the task.
    pub fn check(
        &self,
        task: &TaskConfig,
        app: &App,
        key: &str,
        code: &'static str,
        findings: &mut Findings,
    ) {
        crate::need_task(task, app, &format!("{key}.vsm"), &self.vsm, findings);
        for (part, value) in [("half_m", self.half_m), ("most_m", self.most_m)] {
            if !(1e-3..=0.1).contains(&value) {
                let key = format!("{key}.{part}");
                let place = task.args.locate(&key).unwrap_or_else(|| task.place.clone());
                let text = format!("`{key}` is {value}; give from 0.001 to 0.1 m");
                findings.push(Finding::error(code, text).at(place));
            }
        }
    }

    /// How far the thing is from where it was thought to be, m, along the axes of the tool. The gripper looks from `beside` that
    /// place, m. `None` as long as four examples are not learned.
    ///
    /// # Errors
    /// It is not seen, or not where it can be.
    pub async fn offset(
        &self,
        cx: &Context,
        beside: [f64; 2],
    ) -> Result<Option<[f64; 2]>, Failure> {
        let report = match self.look(cx, None).await {
            Ok(report) => report,
            Err(error) if error.outcome == vss::command::Outcome::Refused => return Ok(None),
            Err(error) => return Err(unseen(&error.reason)),
        };
        let none = || unseen("the camera on the hand tells no correction");
        let told = report.disk.correction.ok_or_else(none)?;
        let shift = [beside[0] + told.by[0], beside[1] + told.by[1]];
        let off_m = shift[0].hypot(shift[1]);
        if off_m > self.most_m {
            let (off_mm, most_mm) = (1e3 * off_m, 1e3 * self.most_m);
            return Err(unseen(&format!(
                "the camera on the hand sees it {off_mm:.1} mm beside, and no more than {most_mm:.1} mm is believed"
            )));
        }
        tracing::info!(
            x = shift[0],
            y = shift[1],
            "the camera on the hand corrects the arm"
        );
        Ok(Some(shift))
    }

    /// Where the gripper stands for the examples, m, along the axes of the tool from where it grips the thing.
    #[must_use]
    pub fn corners(&self) -> [[f64; 2]; 4] {
        let half = self.half_m;
        [[-half, -half], [half, -half], [-half, half], [half, half]]
    }

    /// Shows the camera the thing from the [corners](Self::corners), to which `go` brings the gripper, and goes back. What the camera
    /// does not see teaches nothing.
    ///
    /// # Errors
    /// Those of `go`.
    pub async fn learn(
        &self,
        cx: &Context,
        go: impl AsyncFn([f64; 2]) -> Result<(), Failure>,
    ) -> Result<(), Failure> {
        for corner in self.corners() {
            go(corner).await?;
            if let Err(error) = self.look(cx, Some(corner)).await {
                tracing::warn!(%error, "the camera on the hand learns nothing here");
                break;
            }
        }
        go([0.0; 2]).await
    }

    async fn look(
        &self,
        cx: &Context,
        taught: Option<[f64; 2]>,
    ) -> Result<DiskReport, VisionError> {
        let vsm = cx.task(&self.vsm).await?;
        let camera = self.camera.clone();
        cx.call(&vsm, DiskOffset { camera, taught }).await?
    }
}

//! The camera on a hand: by how much the gripper is beside what it is to grip (SORMA technical report, section 2.1.4: preshape
//! position by vision). The Service DiskFind answers that, and learns it from four examples.

use ctos::task::Context;
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
    pub vsm: String,
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
    /// Whether they make sense.
    ///
    /// # Errors
    /// A key, and what is wrong with it.
    pub fn check(&self) -> Result<(), (&'static str, String)> {
        for (key, value) in [("wrist.half_m", self.half_m), ("wrist.most_m", self.most_m)] {
            if !(1e-3..=0.1).contains(&value) {
                return Err((key, format!("`{key}` is {value}; give from 0.001 to 0.1 m")));
            }
        }
        Ok(())
    }

    /// How far it is to where the gripper grips the thing, along the axes of the tool, m, from where it was thought to be; the
    /// gripper stands so far `beside` that. `None` as long as four examples are not learned.
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
        let told = report.disk.correction.filter(|found| found.good);
        let told = told.ok_or_else(|| {
            unseen("what the camera on the hand sees does not look like what it has learned")
        })?;
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

    /// Shows the camera the thing from four places, and goes back: `go` has the gripper stand so far, m, from where it grips the
    /// thing, along the axes of the tool. What the camera does not see teaches nothing.
    ///
    /// # Errors
    /// Those of `go`.
    pub async fn learn(
        &self,
        cx: &Context,
        go: impl AsyncFn([f64; 2]) -> Result<(), Failure>,
    ) -> Result<(), Failure> {
        let half = self.half_m;
        for corner in [[-half, -half], [half, -half], [-half, half], [half, half]] {
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

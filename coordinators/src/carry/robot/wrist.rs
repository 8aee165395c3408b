//! The last correction above the thing, by one picture of the camera on the hand (SORMA technical report, section 2.1.4:
//! preshape position by vision). The Service DiskFind answers the move that is missing; it learns that from four examples.

use nalgebra::{Isometry3, Translation3};
use serde::Deserialize;
use vss::command::{DiskOffset, DiskReport, VisionError};

use super::ride::Ride;
use crate::{
    carry::{
        errand::{End, WAY, Way},
        ways::Spot,
    },
    outcome::{Failure, Outcome},
};

/// From another place it may be seen.
fn unseen(reason: &str) -> Failure {
    Failure::new(Outcome::Unseen, reason)
}

/// The camera on the hand.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct WristArgs {
    /// Its name.
    camera: String,
    /// The Services Manager of VSS.
    #[serde(default = "vsm_task")]
    pub(super) vsm: String,
    /// Half the side of the square whose corners are the examples, m.
    #[serde(default = "half_m")]
    half_m: f64,
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
    /// What is wrong with them: a key, and words.
    pub(super) fn check(&self) -> Result<(), (&'static str, String)> {
        for (key, value) in [("wrist.half_m", self.half_m), ("wrist.most_m", self.most_m)] {
            if !(1e-3..=0.1).contains(&value) {
                return Err((key, format!("`{key}` is {value}; give from 0.001 to 0.1 m")));
            }
        }
        Ok(())
    }
}

impl Ride<'_> {
    /// Looks at the thing from above it or beside that, and keeps by how much the hand is beside it; words about it. Who has not
    /// learned that yet goes to four places around it, which are the examples: then the thing is taken to be where it was seen before.
    pub(super) async fn look_from(&self, spot: Spot) -> Result<String, Failure> {
        let none = || Failure::new(Outcome::Fault, "there is no camera on the hand");
        let wrist = self.args.wrist.as_ref().ok_or_else(none)?;
        let way = self.way().await?;
        let above = self.errand.above(End::From, way.turn);
        let [x, y] = spot.offset().map(|halves| halves * wrist.half_m);
        let from = above * Translation3::new(x, y, 0.0);
        self.line(from, self.args.slow, &[]).await?;
        let shift = match self.look(wrist, None).await {
            Ok(report) => {
                let told = report.disk.correction.filter(|found| found.good);
                let told = told.ok_or_else(|| {
                    unseen(
                        "what the camera on the hand sees does not look like what it has learned",
                    )
                })?;
                let shift = [x + told.by[0], y + told.by[1]];
                let off_m = shift[0].hypot(shift[1]);
                if off_m > wrist.most_m {
                    let (off_mm, most_mm) = (1e3 * off_m, 1e3 * wrist.most_m);
                    return Err(unseen(&format!(
                        "the camera on the hand sees it {off_mm:.1} mm beside, and no more than {most_mm:.1} mm is believed"
                    )));
                }
                tracing::info!(
                    x = shift[0],
                    y = shift[1],
                    "the camera on the hand corrects the arm"
                );
                Some(shift)
            }
            Err(error) if error.outcome == vss::command::Outcome::Refused => {
                self.teach(wrist, &above).await?;
                None
            }
            Err(error) => return Err(unseen(&error.reason)),
        };
        let way = Way { shift, ..way };
        self.store.store(self.cx, WAY, &way).await?;
        Ok(String::new())
    }

    /// Shows the camera the thing from four places.
    async fn teach(&self, wrist: &WristArgs, above: &Isometry3<f64>) -> Result<(), Failure> {
        let half = wrist.half_m;
        for [x, y] in [[-half, -half], [half, -half], [-half, half], [half, half]] {
            let corner = above * Translation3::new(x, y, 0.0);
            self.line(corner, self.args.slow, &[]).await?;
            if let Err(error) = self.look(wrist, Some([x, y])).await {
                tracing::warn!(%error, "the camera on the hand learns nothing here");
                break;
            }
        }
        self.line(*above, self.args.slow, &[]).await
    }

    async fn look(
        &self,
        wrist: &WristArgs,
        taught: Option<[f64; 2]>,
    ) -> Result<DiskReport, VisionError> {
        let vsm = self.cx.task(&wrist.vsm).await?;
        let camera = wrist.camera.clone();
        self.cx.call(&vsm, DiskOffset { camera, taught }).await?
    }
}

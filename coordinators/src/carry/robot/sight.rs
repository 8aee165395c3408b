//! The last correction above the thing, by one picture of the camera on the hand.

use nalgebra::Translation3;

use super::ride::Ride;
use crate::{
    carry::{
        errand::{End, WAY, Way},
        ways::Spot,
    },
    outcome::{Failure, Outcome},
};

impl Ride<'_> {
    /// Looks at the thing from above it or beside that, and keeps by how much the hand is beside it; words about it. Who has not
    /// learned that yet goes to four places around it, which are the examples: then the thing is taken to be where it was seen before.
    pub(super) async fn look_from(&self, spot: Spot) -> Result<String, Failure> {
        let none = || Failure::new(Outcome::Fault, "there is no camera on the hand");
        let wrist = self.args.wrist.as_ref().ok_or_else(none)?;
        let way = self.way().await?;
        let above = self.errand.above(End::From, way.turn);
        let go = async |[x, y]: [f64; 2]| {
            let there = above * Translation3::new(x, y, 0.0);
            self.line(there, self.args.slow, &[]).await
        };
        let beside = spot.offset().map(|halves| halves * wrist.half_m);
        go(beside).await?;
        let shift = wrist.offset(self.cx, beside).await?;
        if shift.is_none() {
            wrist.learn(self.cx, go).await?;
        }
        let way = Way { shift, ..way };
        self.store.store(self.cx, WAY, &way).await?;
        Ok(String::new())
    }
}

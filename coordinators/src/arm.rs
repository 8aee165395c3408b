//! What Coordinators ask of MCS: again while it is gone and may be started again, and no motion is left in doubt.

use std::{future::Future, time::Duration};

use ctos::task::Context;
use mcs::client::{Manipulator, MotionError, Move, MoveReport, Outcome as Motion};

use crate::outcome::{Failure, Outcome};

/// How much longer than planned a motion may take, to settle and to be waited for.
const MOVE_MARGIN_S: f64 = 10.0;

/// How often it is looked whether the arm rests.
const REST: Duration = Duration::from_millis(20);

/// How often it is looked whether somebody has resumed.
const LOOK: Duration = Duration::from_millis(200);

/// A manipulator of MCS, as one action asks it.
pub(crate) struct Arm<'a> {
    pub cx: &'a Context,
    /// The client interface of MCS.
    pub mcs: &'a str,
    /// How long an MCS that is gone is waited for, s.
    pub within_s: f64,
}

impl Arm<'_> {
    /// Asks, again while MCS is gone and may be started again: for what may be done twice.
    pub(crate) async fn ask<T, F: Future<Output = Result<T, MotionError>>>(
        &self,
        request: impl Fn(Manipulator) -> F,
    ) -> Result<T, Failure> {
        let within = Duration::try_from_secs_f64(self.within_s).unwrap_or(Duration::MAX);
        let is_lost = |error: &MotionError| error.outcome == Motion::Lost;
        let asked = crate::patiently(self.cx, within, is_lost, || async {
            request(Manipulator::find(self.cx, self.mcs).await?).await
        });
        Ok(asked.await?)
    }

    /// Moves, and waits until the arm has settled. A motion whose end is not known is cancelled.
    pub(crate) async fn go(&self, order: Move, planned_s: f64) -> Result<MoveReport, Failure> {
        let arm = Manipulator::find(self.cx, self.mcs).await?;
        let limit = Duration::try_from_secs_f64(planned_s + MOVE_MARGIN_S);
        let limit = limit.map_err(|error| Failure::new(Outcome::Fault, error))?;
        match arm.go(order, limit).await {
            Ok(report) => Ok(report),
            Err(error) => {
                if error.outcome == Motion::Lost
                    && let Err(also) = arm.cancel().await
                {
                    tracing::warn!(%error, %also, "whether the arm still moves is not known");
                }
                Err(error.into())
            }
        }
    }

    /// Takes back what is ordered, and waits until the arm rests.
    pub(crate) async fn end(&self) -> Result<(), Failure> {
        self.ask(|arm| async move { arm.cancel().await }).await?;
        let until = self.cx.now() + Duration::from_secs_f64(MOVE_MARGIN_S);
        loop {
            self.cx.sleep(REST).await;
            let position = self.ask(|arm| async move { arm.position().await }).await?;
            if position.at_rest || self.cx.is_stopping() {
                return Ok(());
            }
            if self.cx.now() >= until {
                let text = format!("the arm did not come to rest within {MOVE_MARGIN_S} s");
                return Err(Failure::new(Outcome::Fault, text));
            }
        }
    }

    /// Waits until somebody ends the protective stop that ended a motion for `reason`, so many seconds at most.
    pub(crate) async fn resumed(&self, within_s: f64, reason: &str) -> Result<(), Failure> {
        let within = Duration::try_from_secs_f64(within_s).unwrap_or(Duration::MAX);
        let until = self.cx.now() + within;
        let mut told = false;
        loop {
            if self.cx.is_stopping() {
                return Err(Failure::new(Outcome::Stopped, "the app is being stopped"));
            }
            self.cx.sleep(LOOK).await;
            let status = self.ask(|arm| async move { arm.status().await }).await?;
            if !status.stopped {
                return Ok(());
            }
            if !std::mem::replace(&mut told, true) {
                tracing::warn!(
                    within_s,
                    "a protective stop holds; it is waited for somebody to resume"
                );
            }
            if self.cx.now() >= until {
                return Err(Failure::new(
                    Outcome::Stopped,
                    format!("{reason}; nobody resumed within {within_s} s"),
                ));
            }
        }
    }
}

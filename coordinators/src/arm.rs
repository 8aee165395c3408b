//! What Coordinators ask of MCS: again while it is gone and may be started again, and no motion is left in doubt. The arguments
//! that all of them have are checked here.

use std::{future::Future, time::Duration};

use ctos::{
    config::{App, TaskConfig},
    diagnostic::{Finding, Findings},
    task::Context,
};
use mcs::{
    Joints,
    client::{
        Manipulator, MotionError, Move, MoveReport, Outcome as Motion, PathKind, Plan, PlanReport,
        ReadSensors, SensorReport, SetOutput, Target,
    },
};
use nalgebra::{Isometry3, Matrix4};

use crate::outcome::{Failure, Outcome};

/// How much longer than planned a motion may take, to settle and to be waited for.
const MOVE_MARGIN_S: f64 = 10.0;

/// How often it is looked whether the arm rests.
const REST: Duration = Duration::from_millis(20);

/// How often it is looked whether somebody has resumed.
const LOOK: Duration = Duration::from_millis(200);

/// The arguments that every Coordinator of an arm has.
pub struct ArmKeys<'a> {
    /// The client interface of MCS.
    pub mcs: &'a str,
    /// How long a protective stop is waited out, s.
    pub resume_within_s: f64,
    /// How long an MCS that is gone is waited for, s.
    pub service_within_s: f64,
    /// Fractions of full speed, by their keys.
    pub speeds: &'a [(&'a str, f64)],
    /// Where the arm waits, degrees of its joints; for Coordinators that park it.
    pub park_deg: Option<&'a [f64]>,
}

impl ArmKeys<'_> {
    /// Findings where one of them makes no sense; `code` is that of a park position that is none.
    pub fn check(&self, task: &TaskConfig, app: &App, code: &'static str, findings: &mut Findings) {
        crate::need_task(task, app, "mcs", self.mcs, findings);
        for (key, value) in [
            ("resume_within_s", self.resume_within_s),
            ("service_within_s", self.service_within_s),
        ] {
            crate::check_seconds(task, key, value, findings);
        }
        for (key, value) in self.speeds {
            crate::check_speed(task, key, *value, findings);
        }
        if let (Some(model), Some(park)) = (mcs::manipulator(app), self.park_deg)
            && model.dof() != park.len()
        {
            let (given, count) = (park.len(), model.dof());
            let text = format!("`park_deg` has {given} numbers, and the arm {count} joints");
            let place = task.args.locate("park_deg");
            let place = place.unwrap_or_else(|| task.place.clone());
            findings.push(Finding::error(code, text).at(place));
        }
    }
}

/// A target of the tool.
#[must_use]
pub fn pose(pose: &Isometry3<f64>) -> Target {
    let matrix = pose.to_homogeneous().transpose();
    let mut rows = [0.0; 16];
    rows.copy_from_slice(matrix.as_slice());
    Target::Pose(rows)
}

/// Joint positions of an arm with only joints that turn, from degrees.
#[must_use]
pub fn radians(degrees: &[f64]) -> Joints {
    Joints::from_fn(degrees.len(), |joint| degrees[joint].to_radians())
}

/// A motion that no guard watches besides those that always do.
#[must_use]
pub fn order(target: Target, path: PathKind, speed: f64) -> Move {
    Move {
        target,
        path,
        speed,
        acceleration: None,
        elbow: None,
        guards: Vec::new(),
        blend: 0.0.into(),
    }
}

/// A manipulator of MCS, as one action asks it.
pub struct Arm<'a> {
    /// In whose name.
    pub cx: &'a Context,
    /// The client interface of MCS.
    pub mcs: &'a str,
    /// How long an MCS that is gone is waited for, s.
    pub within_s: f64,
}

impl Arm<'_> {
    /// Asks, again while MCS is gone and may be started again: for what may be done twice.
    pub async fn ask<T, F: Future<Output = Result<T, MotionError>>>(
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

    /// Reserves the arm, or sees that it is still reserved.
    pub async fn acquire(&self) -> Result<(), Failure> {
        self.ask(|arm| async move { arm.acquire().await }).await?;
        Ok(())
    }

    /// Gives the arm back.
    pub async fn release(&self) -> Result<(), Failure> {
        self.ask(|arm| async move { arm.release().await }).await?;
        Ok(())
    }

    /// `base_t_tool`.
    pub async fn tool(&self) -> Result<Isometry3<f64>, Failure> {
        let position = self.ask(|arm| async move { arm.position().await }).await?;
        let matrix = Matrix4::from_row_slice(&position.base_t_tool);
        nalgebra::try_convert(matrix)
            .ok_or_else(|| Failure::new(Outcome::Fault, "the arm's pose is none"))
    }

    /// Plans a motion from where the arm stands, without going it.
    pub async fn plan(
        &self,
        target: Target,
        path: PathKind,
        speed: f64,
    ) -> Result<PlanReport, Failure> {
        let request = Plan {
            target,
            path,
            speed,
            acceleration: None,
            elbow: None,
        };
        let planned = self.ask(|arm| {
            let request = request.clone();
            async move { arm.plan(request).await }
        });
        planned.await
    }

    /// Plans a motion and goes it.
    pub async fn travel(&self, order: Move) -> Result<MoveReport, Failure> {
        let planned = self.plan(order.target, order.path, order.speed);
        let planned = planned.await?;
        self.go(order, planned.duration_s).await
    }

    /// To where the arm waits, degrees of its joints; there it is given back.
    pub async fn park(&self, park_deg: &[f64], speed: f64) -> Result<(), Failure> {
        let target = Target::Joints(radians(park_deg));
        self.travel(order(target, PathKind::Joint, speed)).await?;
        self.release().await
    }

    /// Moves, and waits until the arm has settled. A motion whose end is not known is cancelled.
    pub async fn go(&self, order: Move, planned_s: f64) -> Result<MoveReport, Failure> {
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

    /// What the arm's sensors read.
    pub async fn sensors(&self) -> Result<SensorReport, Failure> {
        let read = self.ask(|_| async {
            let mcs = self.cx.task(self.mcs).await?;
            Ok(self.cx.call(&mcs, ReadSensors {}).await?)
        });
        read.await
    }

    /// Sets an output among the arm's slots. The arm must be reserved.
    pub async fn output(&self, name: &str, value: f64) -> Result<(), Failure> {
        let request = SetOutput {
            name: name.to_owned(),
            value,
        };
        let set = self.ask(|_| async {
            let mcs = self.cx.task(self.mcs).await?;
            self.cx.call(&mcs, request.clone()).await?
        });
        set.await
    }

    /// Whether the guard that ended the latest motion was one of these recipes.
    pub async fn was_ended_by(&self, guards: &[impl AsRef<str>]) -> Result<bool, Failure> {
        let report = self.ask(|arm| async move { arm.guards().await }).await?;
        let last = report.last.map(|last| last.guard);
        Ok(last.is_some_and(|last| guards.iter().any(|guard| guard.as_ref() == last.as_str())))
    }

    /// Takes back what is ordered, and waits until the arm rests.
    pub async fn end(&self) -> Result<(), Failure> {
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
    pub async fn resumed(&self, within_s: f64, reason: &str) -> Result<(), Failure> {
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

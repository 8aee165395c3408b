//! What may be ordered from outside: the arm follows a trajectory, a task is asked a command. All of it is plain commands,
//! as any other task sends them.

use std::{
    cell::{Cell, RefCell},
    time::Duration,
};

use ctos::task::Context;
use futures_util::{StreamExt as _, stream};
use mcs::{
    client::{Manipulator, Move, Outcome, PathKind, ReadSlots, Target},
    joints::Joints,
};
use tokio::sync::Notify;

use crate::{
    args::{Served, Taken},
    messages::{JointTrajectory, TriggerResponse},
};

/// How long the arm may take to a point.
const MOTION: Duration = Duration::from_secs(120);
/// How long a task may take to answer.
const ANSWER: Duration = Duration::from_secs(10);
/// Motions that are ordered ahead, so that the arm passes a point without a stop.
const AHEAD: usize = 3;
/// Of a stop at a point, what may be left out.
const BLEND: f64 = 0.5;
/// No trajectory has more points.
const MOST_POINTS: usize = 2_000;

/// The points of a trajectory, in the order of the arm's joints.
///
/// # Errors
/// What does not fit, in words.
pub(crate) fn points(
    trajectory: &JointTrajectory,
    joints: &[String],
) -> Result<Vec<Joints>, String> {
    let named = &trajectory.joint_names;
    let place = |joint: &String| {
        let mut at = named.iter().enumerate().filter(|(_, name)| *name == joint);
        match (at.next(), at.next()) {
            (Some((at, _)), None) => Ok(at),
            (None, _) => Err(format!("it says nothing of joint `{joint}`")),
            (Some(_), Some(_)) => Err(format!("it names joint `{joint}` twice")),
        }
    };
    let places = joints.iter().map(place).collect::<Result<Vec<_>, _>>()?;
    if let Some(strange) = named.iter().find(|name| !joints.contains(name)) {
        return Err(format!("the arm has no joint `{strange}`"));
    }
    if trajectory.points.len() > MOST_POINTS {
        let count = trajectory.points.len();
        return Err(format!("{count} points are more than {MOST_POINTS}"));
    }
    let ordered = |(index, point): (usize, &crate::messages::JointTrajectoryPoint)| {
        let (positions, count) = (&point.positions, named.len());
        if positions.len() != count {
            return Err(format!(
                "point {index} has {} positions for {count} joints",
                positions.len()
            ));
        }
        let numbers = places.iter().filter_map(|at| positions.get(*at).copied());
        let numbers: Vec<f64> = numbers.collect();
        if numbers.iter().any(|number| !number.is_finite()) {
            return Err(format!("point {index} has a position that is no number"));
        }
        Joints::try_from(&numbers[..]).map_err(|error| error.to_string())
    };
    trajectory.points.iter().enumerate().map(ordered).collect()
}

/// The trajectories of one topic: the latest counts.
#[derive(Debug, Default)]
pub(crate) struct Arm {
    next: RefCell<Option<JointTrajectory>>,
    came: Notify,
    moves: Cell<bool>,
}

impl Arm {
    /// Follows this one instead of what was to be followed. A motion under way is ended first.
    pub async fn follow(&self, cx: &Context, taken: &Taken, trajectory: JointTrajectory) {
        // While one waits, the motion before it is being ended already.
        let waits = self.next.replace(Some(trajectory)).is_some();
        self.came.notify_one();
        if self.moves.get()
            && !waits
            && let Ok(arm) = Manipulator::find(cx, &taken.task).await
            && let Err(error) = arm.cancel().await
        {
            tracing::warn!(task = cx.name(), arm = taken.task, %error, "the motion under way is not cancelled");
        }
    }

    /// Waits for the next trajectory and follows it: how that ended.
    pub async fn next(&self, cx: &Context, taken: &Taken) -> Result<String, String> {
        let trajectory = loop {
            let next = self.next.borrow_mut().take();
            match next {
                Some(next) => break next,
                None => self.came.notified().await,
            }
        };
        self.moves.set(true);
        let ended = self.carry(cx, taken, &trajectory).await;
        self.moves.set(false);
        ended
    }

    async fn carry(
        &self,
        cx: &Context,
        taken: &Taken,
        trajectory: &JointTrajectory,
    ) -> Result<String, String> {
        if trajectory.points.is_empty() {
            // What was under way has been cancelled: so ROS stops an arm.
            return Ok("the arm was stopped".to_owned());
        }
        let found = cx
            .task(&taken.task)
            .await
            .map_err(|error| error.to_string())?;
        let slots = cx.call(&found, ReadSlots {}).deadline(ANSWER).await;
        let slots = slots.map_err(|error| error.to_string())?;
        let joints: Vec<_> = slots.joints.into_iter().map(|joint| joint.name).collect();
        let points = points(trajectory, &joints)?;
        let arm = Manipulator::find(cx, &taken.task).await;
        let arm = arm.map_err(|error| error.to_string())?;
        let moved = async {
            arm.acquire().await?;
            let (count, arm) = (points.len(), &arm);
            let motions = points.into_iter().enumerate().map(|(index, point)| {
                let to = Move {
                    target: Target::Joints(point),
                    path: PathKind::Joint,
                    speed: taken.speed,
                    acceleration: None,
                    elbow: None,
                    guards: Vec::new(),
                    blend: (if index == 0 { 0.0 } else { BLEND }).into(),
                };
                async move { arm.go(to, MOTION).await.map_err(|error| (index, error)) }
            });
            let mut motions = stream::iter(motions).buffered(AHEAD);
            while let Some(ended) = motions.next().await {
                // One that another one replaces ends here, too.
                ended.map_err(|(index, mut error)| {
                    error.reason = format!("point {index} of {count}: {}", error.reason);
                    error
                })?;
            }
            Ok(format!("the arm has passed {count} points"))
        };
        let moved: Result<String, mcs::client::MotionError> = moved.await;
        let refused = moved
            .as_ref()
            .is_err_and(|error| error.outcome == Outcome::Refused);
        // Others may have it now. Who never had it has nothing to give back.
        let waits = self.next.borrow().is_some();
        if !refused
            && !waits
            && let Err(error) = arm.release().await
        {
            tracing::warn!(task = cx.name(), arm = taken.task, %error, "the arm is not released");
        }
        moved.map_err(|error| error.to_string())
    }
}

/// Asks the task what the service is for.
pub(crate) async fn serve(cx: &Context, served: &Served) -> TriggerResponse {
    let Served { task, command } = served;
    let (success, message) = match ask(cx, task, command).await {
        Ok(answer) => answer,
        Err(message) => (false, message),
    };
    TriggerResponse { success, message }
}

async fn ask(cx: &Context, task: &str, command: &str) -> Result<(bool, String), String> {
    let registry = cx.registry();
    let info = registry.command_of(cx.app(), task, command);
    let info = info.map_err(|_| format!("task `{task}` takes no command `{command}`"))?;
    let found = cx.task(task).await.map_err(|error| error.to_string())?;
    let answer = cx.call_raw(&found, info, Vec::new(), ANSWER).await;
    let answer = answer.map_err(|error| error.to_string())?;
    let mut text = Vec::new();
    let read = info
        .reply
        .shape()
        .and_then(|shape| shape.convert(&answer, &mut text));
    let text = read.and_then(|()| String::from_utf8(text).ok());
    let text = text.unwrap_or_else(|| format!("{} bytes", answer.len()));
    // A result says itself whether it is one.
    let success = !text.starts_with("{\"Err\":");
    Ok((success, text))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::JointTrajectoryPoint;

    fn trajectory(names: &[&str], points: &[&[f64]]) -> JointTrajectory {
        let point = |positions: &&[f64]| JointTrajectoryPoint {
            positions: positions.to_vec(),
            ..JointTrajectoryPoint::default()
        };
        JointTrajectory {
            joint_names: names.iter().map(|name| (*name).to_owned()).collect(),
            points: points.iter().map(point).collect(),
            ..JointTrajectory::default()
        }
    }

    #[test]
    fn points_are_put_into_the_order_of_the_arms_joints() {
        let joints = ["a".to_owned(), "b".to_owned(), "c".to_owned()];
        let all = points(&trajectory(&["c", "a", "b"], &[&[3.0, 1.0, 2.0]]), &joints).unwrap();
        assert_eq!(all.len(), 1);
        assert_eq!(all[0], [1.0, 2.0, 3.0]);
        for (wrong, why) in [
            (
                trajectory(&["a", "b"], &[&[1.0, 2.0]]),
                "nothing of joint `c`",
            ),
            (
                trajectory(&["a", "b", "c", "d"], &[&[0.0; 4]]),
                "no joint `d`",
            ),
            (
                trajectory(&["a", "b", "c", "a"], &[&[0.0; 4]]),
                "joint `a` twice",
            ),
            (
                trajectory(&["a", "b", "c"], &[&[0.0; 3], &[0.0; 2]]),
                "point 1 has 2 positions for 3",
            ),
            (
                trajectory(&["a", "b", "c"], &[&[0.0, f64::NAN, 0.0]]),
                "no number",
            ),
            (
                trajectory(&["a", "b", "c"], &[&[0.0; 3][..]; MOST_POINTS + 1]),
                "2001 points",
            ),
        ] {
            let error = points(&wrong, &joints).unwrap_err();
            assert!(error.contains(why), "{error}");
        }
    }
}

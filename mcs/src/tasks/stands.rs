//! Where an arm stands among others, as viewers see it: in the room, or carried by another arm of its chassis.

use ctos::config::{App, TaskConfig};
use ctos::diagnostic::{Finding, Findings};
use ctos::task::Context;

use super::guards::configured_arm;
use super::{Link, SERVO};
use crate::args::{ServoArgs, StandsArgs};
use crate::model::{Model, Placement};

/// An arm is carried by an arm that is carried, up to so many.
const MOST_CARRIERS: usize = 4;

/// Where the base frame of an arm is in the scene. An arm whose carrier is not there is seen as if it stood in the room.
pub(super) fn base(cx: &Context, stands: Option<&StandsArgs>) -> Placement {
    let mut base = Placement::identity();
    let mut next = stands.cloned();
    for _ in 0..MOST_CARRIERS {
        let Some(stands) = next.take() else { break };
        base = stands.at.placement().then(&base);
        let carrier = stands.on.and_then(|servo| Link::find(cx, &servo).ok());
        if let Some(link) = carrier {
            let model = link.planner.model();
            let mut data = model.data();
            model.forward(&mut data, &link.port.status().position);
            let frame = stands.frame.and_then(|name| model.frame(&name));
            let frame = frame.unwrap_or_else(|| model.tip());
            base = data.placement(model, frame).then(&base);
            next.clone_from(&link.stands);
        }
    }
    base
}

/// Finds what is wrong with where the arm of a servo stands, and with the frames of its sensors.
pub(super) fn check(
    args: &ServoArgs,
    model: &Model,
    (task, app): (&TaskConfig, &App),
    findings: &mut Findings,
) {
    let mut wrong =
        |key: &str, text: String, known: &mut dyn Iterator<Item = &str>, given: &str| {
            let place = task.args.locate(key).unwrap_or_else(|| task.place.clone());
            let text = format!("task `{}`: {text}", task.name);
            let finding = Finding::error("mcs::servo::stands", text).at(place);
            findings.push(finding.suggest(given, known));
        };
    for (sensor, frame) in &args.sensor_frames {
        if model.frame(frame).is_none() {
            let mut known = model.frames().iter().map(|frame| frame.name.as_str());
            let text = format!(
                "sensor `{sensor}` has no frame `{frame}` of `{}`",
                model.name()
            );
            wrong(&format!("sensor_frames.{sensor}"), text, &mut known, frame);
        }
    }
    let Some(stands) = &args.stands else { return };
    let Some(servo) = &stands.on else { return };
    let mut others = app.tasks.iter();
    let carrier = others.find(|other| other.name == *servo && other.handler == SERVO);
    let carrier = carrier.filter(|other| other.chassis == task.chassis && other.name != task.name);
    let Some(carrier) = carrier else {
        let servos = app.tasks.iter().filter(|other| other.handler == SERVO);
        let here = servos.filter(|other| other.chassis == task.chassis && other.name != task.name);
        let text = format!("it stands on `{servo}`, which is no other servo of its chassis");
        wrong(
            "stands.on",
            text,
            &mut here.map(|other| other.name.as_str()),
            servo,
        );
        return;
    };
    // What is wrong with that arm, its own task says.
    if let (Some(frame), Some(arm)) = (&stands.frame, configured_arm(carrier, app))
        && arm.frame(frame).is_none()
    {
        let mut known = arm.frames().iter().map(|frame| frame.name.as_str());
        let text = format!("the arm of `{servo}` has no frame `{frame}`");
        wrong("stands.frame", text, &mut known, frame);
    }
}

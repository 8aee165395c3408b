//! The class `slots`: where the joints of an arm are, should be and may be, what drives them, and why it was stopped last.
//! For those who watch: panels and displays.

use std::{sync::LazyLock, time::Duration};

use futures_util::future::LocalBoxFuture;
use sorma::{Context, Form, OptionTable, Outcome, ServiceObject, Transport, Waiting};

use super::local::SharedArm;
use super::{ended, known};
use crate::client::ReadSlots;

/// It is answered at once.
const DEADLINE: Duration = Duration::from_secs(30);

const FORMS: &[Form] = &[Form {
    text: "",
    floats: 0,
    takes: "",
    gives: "text: a line for each joint, its name and the units of its position and its drive, and a line for the last stop, if \
            there was one; 6 floats for each joint: position, setpoint minus position, torque, smallest and largest position, \
            most torque; rad and N m, or m and N of one that slides",
    results: "* number",
    help: "tells how the joints are",
}];

#[derive(Debug, Clone)]
pub(super) struct Options {
    client: String,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            client: "mcs".to_owned(),
        }
    }
}

pub(super) static TABLE: LazyLock<OptionTable<Options>> = LazyLock::new(|| {
    OptionTable::new("the joints of an arm with their limits, for those who watch")
        .exec(FORMS)
        .word(
            "client",
            "TASK",
            "the app's task with the client interface of MCS",
            |options: &mut Options| &mut options.client,
        )
});

/// An object of class `slots`.
pub(super) struct Slots {
    options: Options,
    arm: SharedArm,
}

impl Slots {
    pub(super) fn new(arm: &SharedArm) -> Self {
        Self {
            options: Options::default(),
            arm: arm.clone(),
        }
    }

    async fn job(&self, cx: &Waiting<'_>, io: &mut Transport) -> Outcome {
        TABLE.form(io)?;
        io.floats.clear();
        let mut lines = Vec::new();
        if !cx.is_in_app() {
            let arm = self.arm.lock()?;
            for (joint, position) in arm.model().joints().iter().zip(arm.joints.iter()) {
                let limits = joint.limits;
                lines.push(line(&joint.name, joint.kind));
                let numbers = [
                    *position,
                    0.0,
                    0.0,
                    limits.lower,
                    limits.upper,
                    limits.torque,
                ];
                io.floats.extend(numbers);
            }
        } else {
            let report = cx.call_task(&self.options.client, ReadSlots {}, DEADLINE);
            let report = report.await?;
            for joint in &report.joints {
                lines.push(line(&joint.name, joint.kind));
                let error = joint.setpoint - joint.position;
                io.floats.extend([joint.position, error, joint.torque]);
                io.floats.extend(joint.range);
                io.floats.push(joint.most_torque);
            }
            let stop = report.last_stop.map(|why| format!("last stop: {why}"));
            lines.extend(stop);
        }
        io.text = lines.join("\n");
        Ok(())
    }
}

fn line(name: &str, kind: crate::model::JointKind) -> String {
    format!("{name}, {}, {}", kind.unit(), kind.effort_unit())
}

impl ServiceObject for Slots {
    fn exec_waiting<'a>(
        &'a mut self,
        cx: &'a Waiting<'a>,
        io: &'a mut Transport,
    ) -> Option<LocalBoxFuture<'a, Outcome>> {
        Some(Box::pin(async move {
            let outcome = self.job(cx, io).await;
            match known(cx, &self.options.client, outcome).await {
                Ok(()) => Ok(()),
                wrong => ended(io, wrong),
            }
        }))
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        TABLE.ctrl(&mut self.options, io);
        Ok(())
    }

    fn dump(&self) -> String {
        TABLE.dump(&self.options)
    }
}

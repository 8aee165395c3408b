//! The class `pino`: how the arm is, its control parameters, and how to stop it. Never kept waiting by a motion, which is
//! another object's.

use std::{sync::LazyLock, time::Duration};

use futures_util::future::LocalBoxFuture;
use sorma::{Context, Form, OptionTable, Outcome, ServiceObject, Transport, Waiting};

use super::local::SharedArm;
use super::mvpos::answer;
use super::{ended, known};
use crate::client::{
    ControlledStop, EmergencyStop, ReadControl, ReadPosition, ReadSensors, RecordStates, Reset,
    Resume, SetControl, SetLaw, SetOutput, Status, Stop,
};

/// Everything here is answered at once, but for coming to rest.
const DEADLINE: Duration = Duration::from_secs(30);

const FORMS: &[Form] = &[
    Form {
        text: "state",
        floats: 0,
        takes: "",
        gives: "text: state, holder, motion, fault; 22 floats: joint positions, rad, and base_T_tool, row by row, m; of an arm \
                of n joints n + 16 floats; 2 ints: servo ticks, ticks missed",
        results: "q1 q2 q3 q4 q5 q6: rad; base_T_tool 4x4: m; ints ticks missed",
        help: "tells how the arm is",
    },
    Form {
        text: "",
        floats: 0,
        takes: "",
        gives: "as state",
        results: "q1 q2 q3 q4 q5 q6: rad; base_T_tool 4x4: m; ints ticks missed",
        help: "tells how the arm is",
    },
    Form {
        text: "control",
        floats: 0,
        takes: "",
        gives: "3 floats: bandwidth of the position loop, Hz; its damping ratio; following error that is an emergency, rad",
        results: "bandwidth: Hz; damping; following_error: rad",
        help: "tells the control parameters; the text is the control law",
    },
    Form {
        text: "set",
        floats: 2,
        takes: "bandwidth of the position loop, Hz, and damping ratio",
        gives: "3 floats, as control",
        results: "bandwidth: Hz; damping; following_error: rad",
        help: "sets the control parameters; the arm must not be on its way",
    },
    Form {
        text: "records",
        floats: 0,
        takes: "",
        gives: "text: the buffer, or that none is written",
        results: "",
        help: "writes what every servo tick leaves to the snapshot buffer that -records names, or ends it where none is named",
    },
    Form {
        text: "sensors",
        floats: 0,
        takes: "",
        gives: "text: names and kinds, and which are stale; the numbers of all of them, one after the other: of a force-torque \
                sensor 3 forces, N, and 3 moments, N m, in its frame; of a space mouse 6, of anything else 1",
        results: "* number",
        help: "tells what the slots read that are no joints",
    },
    Form {
        text: "output NAME",
        floats: 1,
        takes: "0 or 1; of a lamp 0 to 1",
        gives: "nothing",
        results: "",
        help: "sets an output until power goes off; only the task that holds the arm may",
    },
    Form {
        text: "law NAME",
        floats: 0,
        takes: "",
        gives: "as control",
        results: "bandwidth: Hz; damping; following_error: rad",
        help: "goes over to another control law, without a step of the torques, also under way",
    },
    Form {
        text: "stop",
        floats: 0,
        takes: "",
        gives: "nothing",
        results: "",
        help: "protective stop, of category 2: brakes along the path to rest, then holds with power on until EXEC resume",
    },
    Form {
        text: "resume",
        floats: 0,
        takes: "",
        gives: "nothing",
        results: "",
        help: "ends a protective stop; what it ended must be asked for again",
    },
    Form {
        text: "stop1",
        floats: 0,
        takes: "",
        gives: "nothing",
        results: "",
        help: "controlled stop, of category 1: brakes along the path to rest, then takes drive power away",
    },
    Form {
        text: "estop",
        floats: 0,
        takes: "",
        gives: "nothing",
        results: "",
        help: "emergency stop, of category 0: takes drive power away now",
    },
    Form {
        text: "reset",
        floats: 0,
        takes: "",
        gives: "nothing",
        results: "",
        help: "leaves the estopped state and ends a protective stop",
    },
];

#[derive(Debug, Clone)]
pub(super) struct Options {
    client: String,
    records: String,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            client: "mcs".to_owned(),
            records: String::new(),
        }
    }
}

pub(super) static TABLE: LazyLock<OptionTable<Options>> = LazyLock::new(|| {
    OptionTable::new("the state and the control parameters of an arm")
        .exec(FORMS)
        .word(
            "client",
            "TASK",
            "the app's task with the client interface of MCS",
            |options: &mut Options| &mut options.client,
        )
        .word(
            "records",
            "BUFFER",
            "the snapshot buffer for state records, which EXEC records begins",
            |options: &mut Options| &mut options.records,
        )
});

/// An object of class `pino`.
pub(super) struct Pino {
    options: Options,
    arm: SharedArm,
}

impl Pino {
    pub(super) fn new(arm: &SharedArm) -> Self {
        Self {
            options: Options::default(),
            arm: arm.clone(),
        }
    }

    /// What a form asks for; `named` is what its text names besides.
    async fn in_app(
        &self,
        (form, named): (&str, &str),
        cx: &Waiting<'_>,
        io: &mut Transport,
    ) -> Outcome {
        let client = &self.options.client;
        match form {
            "control" => {
                let control = cx.call_task(client, ReadControl {}, DEADLINE).await?;
                control_answer(io, &control.law, control.numbers());
            }
            "set" => {
                let (bandwidth_hz, damping) = numbers(io);
                let set = SetControl {
                    bandwidth_hz,
                    damping,
                };
                let control = cx.call_task(client, set, DEADLINE).await?;
                control_answer(io, &control.law, control.numbers());
            }
            "sensors" => {
                let report = cx.call_task(client, ReadSensors {}, DEADLINE).await?;
                let named = report.sensors.iter();
                let named = named.map(|sensor| {
                    let stale = report.stale.contains(&sensor.name);
                    let stale = if stale { " (stale)" } else { "" };
                    format!("{} {:?}{stale}", sensor.name, sensor.kind)
                });
                io.text = named.collect::<Vec<_>>().join(", ");
                io.floats = report.numbers;
            }
            "output NAME" => {
                let (name, (value, _)) = (named.to_owned(), numbers(io));
                io.floats.clear();
                let set = cx
                    .call_task(client, SetOutput { name, value }, DEADLINE)
                    .await?;
                set.map_err(super::in_the_way)?;
            }
            "law NAME" => {
                let law = named.to_owned();
                let control = cx.call_task(client, SetLaw { law }, DEADLINE).await?;
                control_answer(io, &control.law, control.numbers());
            }
            "stop" => cx.call_task(client, Stop {}, DEADLINE).await?,
            "records" => {
                let buffer = Some(self.options.records.clone()).filter(|name| !name.is_empty());
                io.text = match &buffer {
                    Some(name) => format!("every tick writes to buffer `{name}`"),
                    None => "no buffer is written".to_owned(),
                };
                cx.call_task(client, RecordStates { buffer }, DEADLINE)
                    .await?;
            }
            "stop1" => cx.call_task(client, ControlledStop {}, DEADLINE).await?,
            "estop" => cx.call_task(client, EmergencyStop {}, DEADLINE).await?,
            "resume" => cx.call_task(client, Resume {}, DEADLINE).await?,
            "reset" => {
                let reset = cx.call_task(client, Reset {}, DEADLINE).await?;
                reset.map_err(super::in_the_way)?;
            }
            _ => {
                let status = cx.call_task(client, Status {}, DEADLINE).await?;
                let position = cx.call_task(client, ReadPosition {}, DEADLINE).await?;
                let holder = status.holder.as_deref().unwrap_or("nobody");
                io.text = format!(
                    "{}, held by {holder}, motion {:?}",
                    status.state, status.motion
                );
                if status.stopped {
                    io.text.push_str(", stopped until EXEC resume");
                }
                if let Some(fault) = status.fault {
                    io.text.push_str(&format!(", fault: {fault}"));
                }
                io.floats.extend_from_slice(&position.joints);
                io.floats.extend(position.base_t_tool);
                let whole = |count: u64| i64::try_from(count).unwrap_or(i64::MAX);
                io.ints = vec![whole(status.ticks), whole(status.missed)];
            }
        }
        Ok(())
    }

    fn here(&self, form: &str, io: &mut Transport) -> Outcome {
        let mut arm = self.arm.lock()?;
        match form {
            "control" | "set" => {
                if form == "set" {
                    let (bandwidth_hz, damping) = numbers(io);
                    arm.control = [bandwidth_hz, damping];
                }
                let [bandwidth, damping] = arm.control;
                control_answer(io, "none: it goes as planned", [bandwidth, damping, 0.0]);
            }
            // It never is on its way, and has no power to be taken away.
            "law NAME" | "stop" | "stop1" | "resume" | "estop" | "reset" => {}
            "records" => {
                "an arm of this process has no servo, and so no records".clone_into(&mut io.text)
            }
            "output NAME" => {
                let text = "the arm of this process has no outputs";
                return Err(sorma::Report::error(super::code::MOTION, text));
            }
            "sensors" => io.text = "none: the arm of this process is kinematic only".to_owned(),
            _ => {
                io.text = format!(
                    "an arm of this process, kinematic only: {} motions, {:.3} s of them",
                    arm.motions, arm.time_s
                );
                let (joints, pose) = (arm.joints, arm.pose());
                answer(io, &joints, &pose);
            }
        }
        Ok(())
    }
}

fn numbers(io: &Transport) -> (f64, f64) {
    let at = |index: usize| io.floats.get(index).copied().unwrap_or_default();
    (at(0), at(1))
}

fn control_answer(io: &mut Transport, law: &str, numbers: [f64; 3]) {
    law.clone_into(&mut io.text);
    io.floats = numbers.to_vec();
}

impl ServiceObject for Pino {
    fn exec_waiting<'a>(
        &'a mut self,
        cx: &'a Waiting<'a>,
        io: &'a mut Transport,
    ) -> Option<LocalBoxFuture<'a, Outcome>> {
        Some(Box::pin(async move {
            let form = match TABLE.form(io) {
                Ok(form) => form.text,
                Err(report) => return ended(io, Err(report)),
            };
            let text = std::mem::take(&mut io.text);
            let named = text
                .trim()
                .split_once(' ')
                .map_or("", |(_, named)| named.trim());
            if form != "set" && form != "output NAME" {
                io.floats.clear();
            }
            let outcome = match cx.is_in_app() {
                true => {
                    let outcome = self.in_app((form, named), cx, io).await;
                    known(cx, &self.options.client, outcome).await
                }
                false => self.here(form, io),
            };
            if outcome.is_err() {
                return ended(io, outcome);
            }
            Ok(())
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

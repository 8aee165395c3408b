//! The class `gripper`: has the gripper of an app close, open and tell what it holds.

use std::{sync::LazyLock, time::Duration};

use futures_util::future::LocalBoxFuture;
use sorma::{Context, Form, OptionTable, Outcome, Report, ServiceObject, Transport, Waiting};

use super::{code, in_the_way};
use crate::command::{Grasp, Held, Open, ReadHeld, SwitchOff};

/// Closing and opening are answered at their end.
const LONGEST: Duration = Duration::from_secs(90);

const FORMS: &[Form] = &[
    Form {
        text: "grasp",
        floats: 0,
        takes: "",
        gives: "2 floats: how wide it stands, m, and how hard each jaw presses, N; or report 130",
        results: "width: m; force: N",
        help: "closes until the jaws stand still, with -force",
    },
    Form {
        text: "grasp",
        floats: 1,
        takes: "how hard each jaw presses, N",
        gives: "2 floats, as above; or report 130",
        results: "width: m; force: N",
        help: "the same with another force",
    },
    Form {
        text: "open",
        floats: 0,
        takes: "",
        gives: "2 floats, as grasp",
        results: "width: m; force: N",
        help: "opens all the way, and so lets go of what it holds",
    },
    Form {
        text: "open",
        floats: 1,
        takes: "how wide, m",
        gives: "2 floats, as grasp",
        results: "width: m; force: N",
        help: "opens, or closes, so wide",
    },
    Form {
        text: "holds",
        floats: 0,
        takes: "",
        gives: "2 floats, as grasp; or report 130",
        results: "width: m; force: N",
        help: "tells whether it holds what it grasped: what slipped away is held no more",
    },
    Form {
        text: "state",
        floats: 0,
        takes: "",
        gives: "2 floats, as grasp; 1 int: 1 when it holds something, else 0",
        results: "width: m; force: N",
        help: "tells how it is",
    },
    Form {
        text: "off",
        floats: 0,
        takes: "",
        gives: "nothing",
        results: "",
        help: "switches power off: brakes hold the jaws, and press on nothing any more",
    },
];

#[derive(Debug, Clone)]
pub(super) struct Options {
    task: String,
    force: Vec<f64>,
    speed: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            task: "gripper".to_owned(),
            force: Vec::new(),
            speed: 0.5,
        }
    }
}

pub(super) static TABLE: LazyLock<OptionTable<Options>> = LazyLock::new(|| {
    OptionTable::new("closes and opens a gripper")
        .exec(FORMS)
        .floats(
            "force",
            &["F"],
            0.0..=1000.0,
            "N",
            "how hard each jaw presses; as the app's configuration says unless it is set",
            |options: &mut Options| &mut options.force,
        )
        .float(
            "speed",
            0.001..=1.0,
            "",
            "fraction of full speed",
            |options| &mut options.speed,
        )
        .word(
            "task",
            "TASK",
            "the app's task with the handler mcs.gripper",
            |options| &mut options.task,
        )
});

/// An object of class `gripper`.
#[derive(Default)]
pub(super) struct Gripper {
    options: Options,
}

impl Gripper {
    async fn job(&self, cx: &Waiting<'_>, io: &mut Transport) -> Outcome {
        let form = TABLE.form(io)?.text;
        if !cx.is_in_app() {
            let text = format!(
                "`{}` moves the gripper of an app, and here is none",
                cx.name()
            );
            return Err(Report::error(code::NO_HAND, text));
        }
        let given = io.floats.first().copied();
        let (task, speed) = (&self.options.task, self.options.speed);
        let answer = match form {
            "grasp" => {
                let force_n = given.or(self.options.force.first().copied());
                let order = Grasp { force_n, speed };
                cx.call_task(task, order, LONGEST).await?
            }
            "open" => {
                let width_m = given;
                let order = Open { width_m, speed };
                cx.call_task(task, order, LONGEST).await?
            }
            "off" => {
                let off = cx.call_task(task, SwitchOff {}, LONGEST).await?;
                io.floats.clear();
                return off.map_err(in_the_way);
            }
            _ => cx.call_task(task, ReadHeld {}, LONGEST).await?,
        };
        let held = answer.map_err(in_the_way)?;
        if matches!(form, "grasp" | "holds") && !held.holds {
            let text = format!("the jaws stand {:.1} mm apart", held.width_m * 1e3);
            return Err(Report::error(code::NOTHING_HELD, text));
        }
        let Held {
            holds,
            width_m,
            force_n,
        } = held;
        io.floats = vec![width_m, force_n];
        if form == "state" {
            io.ints = vec![i64::from(holds)];
        }
        Ok(())
    }
}

impl ServiceObject for Gripper {
    fn exec_waiting<'a>(
        &'a mut self,
        cx: &'a Waiting<'a>,
        io: &'a mut Transport,
    ) -> Option<LocalBoxFuture<'a, Outcome>> {
        Some(Box::pin(async move {
            let outcome = self.job(cx, io).await;
            io.text.clear();
            if outcome.is_err() {
                io.floats.clear();
                io.ints.clear();
            }
            outcome
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

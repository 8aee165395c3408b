//! The class `squeeze`: says how hard two arms of an app press on what they carry between them.

use std::{sync::LazyLock, time::Duration};

use futures_util::future::LocalBoxFuture;
use sorma::{Context, Form, OptionTable, Outcome, Report, ServiceObject, Transport, Waiting};

use super::code;
use crate::command::{ReadSqueeze, SetSqueeze, Squeeze};

/// Its task answers at once.
const LONGEST: Duration = Duration::from_secs(5);

const GIVES: &str = "1 float: how hard the wrists feel it pressed, N";

const FORMS: &[Form] = &[
    Form {
        text: "press",
        floats: 1,
        takes: "how hard both press along it, N; below 0 they pull",
        gives: GIVES,
        results: "force: N",
        help: "holds that force from now on, also while the arms move",
    },
    Form {
        text: "free",
        floats: 0,
        takes: "",
        gives: GIVES,
        results: "force: N",
        help: "nothing is carried any more: the joints go where they shall be",
    },
    Form {
        text: "state",
        floats: 0,
        takes: "",
        gives: "1 float, as press; 1 int: 1 while a force is held, else 0",
        results: "force: N",
        help: "tells how hard it is pressed",
    },
];

#[derive(Debug, Clone)]
pub(super) struct Options {
    task: String,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            task: "carry".to_owned(),
        }
    }
}

pub(super) static TABLE: LazyLock<OptionTable<Options>> = LazyLock::new(|| {
    OptionTable::new("says how hard two arms press on what they carry")
        .exec(FORMS)
        .word(
            "task",
            "TASK",
            "the app's task with the handler mcs.carry",
            |options: &mut Options| &mut options.task,
        )
});

/// An object of class `squeeze`.
#[derive(Default)]
pub(super) struct Squeezing {
    options: Options,
}

impl Squeezing {
    async fn job(&self, cx: &Waiting<'_>, io: &mut Transport) -> Outcome {
        let form = TABLE.form(io)?.text;
        if !cx.is_in_app() {
            let text = format!("`{}` asks two arms of an app, and here are none", cx.name());
            return Err(Report::error(code::NO_HAND, text));
        }
        let (task, given) = (&self.options.task, io.floats.first().copied());
        if form != "state" {
            let force_n = given.filter(|_| form == "press");
            let set = cx.call_task(task, SetSqueeze { force_n }, LONGEST);
            let wrong = |text: String| Report::error(code::HAND, text);
            set.await?.map_err(wrong)?;
        }
        let Squeeze { wanted_n, felt_n } = cx.call_task(task, ReadSqueeze {}, LONGEST).await?;
        io.floats = vec![felt_n];
        if form == "state" {
            io.ints = vec![i64::from(wanted_n.is_some())];
        }
        Ok(())
    }
}

impl ServiceObject for Squeezing {
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

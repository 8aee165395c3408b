//! The classes `setpoint` and `torque`: stream joint setpoints, or torques, to the app's arm (SORMA technical report, 1.7 and
//! 2.1.3). Only the task that holds the arm may stream to it; `acquire` makes that the one which carries the object.

use std::{sync::LazyLock, time::Duration};

use futures_util::future::LocalBoxFuture;
use sorma::{Context, Form, OptionTable, Outcome, Report, ServiceObject, Transport, Waiting};

use super::{code, ended, in_the_way, known};
use crate::client::{
    Acquire, Cancel, ReadStream, Release, Status, StreamKind, StreamReport, StreamSetpoints,
    StreamValue,
};
use crate::state::State;

/// Everything here is answered at once, but for coming to rest.
const DEADLINE: Duration = Duration::from_secs(30);
/// By then a tick has seen a value.
const SEEN: Duration = Duration::from_millis(10);

const GIVES: &str = "text: what is followed, or why no more; 1 float: age of the newest value, s; 1 int: values taken";

const STATE: Form = Form {
    text: "state",
    floats: 0,
    takes: "",
    gives: GIVES,
    results: "age: s; ints values",
    help: "tells how the latest stream is",
};

/// The forms of both classes, whose values have numbers as `takes` says.
const fn forms(takes: &'static str) -> [Form; 7] {
    [
        Form { text: "", ..STATE },
        Form {
            text: "",
            floats: Form::ANY,
            takes,
            help: "the next value of the stream that EXEC begin began",
            ..STATE
        },
        Form {
            text: "begin",
            help: "follows the buffer -buffer, or without one the values that EXEC hands over, from now on",
            ..STATE
        },
        Form {
            text: "end",
            gives: "nothing",
            results: "",
            help: "ends the stream: the arm comes to rest, and holds",
            ..STATE
        },
        STATE,
        Form {
            text: "acquire",
            gives: "nothing",
            results: "",
            help: "reserves the arm for the task that carries this object, and switches its power on",
            ..STATE
        },
        Form {
            text: "release",
            gives: "nothing",
            results: "",
            help: "comes to rest, switches power off and gives the arm back",
            ..STATE
        },
    ]
}

static SETPOINT: [Form; 7] =
    forms("of n joints n positions, rad or m, or as many and then n speeds, per s");
static TORQUE: [Form; 7] = forms("of n joints n torques, N m or N");

#[derive(Debug, Clone)]
pub(super) struct Options {
    client: String,
    buffer: String,
    age: f64,
    speed: f64,
    acceleration: Vec<f64>,
    guards: String,
    gravity: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            client: "mcs".to_owned(),
            buffer: String::new(),
            age: 0.1,
            speed: 0.3,
            acceleration: Vec::new(),
            guards: String::new(),
            gravity: true,
        }
    }
}

/// The options that both classes have.
fn table(about: &'static str, forms: &'static [Form]) -> OptionTable<Options> {
    OptionTable::new(about)
        .exec(forms)
        .float(
            "age",
            0.001..=60.0,
            "s",
            "a value older than this ends the stream, and the arm comes to rest",
            |options: &mut Options| &mut options.age,
        )
        .word(
            "buffer",
            "BUFFER",
            "the snapshot buffer whose newest record is followed. Empty: what EXEC hands over is",
            |options| &mut options.buffer,
        )
        .word(
            "guards",
            "NAMES",
            "guards of the arm that watch the stream besides those that always do, with commas between",
            |options| &mut options.guards,
        )
        .word(
            "client",
            "TASK",
            "the app's task with the client interface of MCS",
            |options| &mut options.client,
        )
}

pub(super) static SETPOINTS: LazyLock<OptionTable<Options>> = LazyLock::new(|| {
    table("streams joint setpoints to an arm", &SETPOINT)
        .float(
            "speed",
            0.001..=1.0,
            "",
            "fraction of full speed",
            |options: &mut Options| &mut options.speed,
        )
        .floats(
            "acceleration",
            &["A"],
            0.001..=1.0,
            "",
            "fraction of full acceleration; as -speed unless it is set",
            |options| &mut options.acceleration,
        )
});

pub(super) static TORQUES: LazyLock<OptionTable<Options>> = LazyLock::new(|| {
    table(
        "streams joint torques to an arm, in place of its control law",
        &TORQUE,
    )
    .flag(
        "gravity",
        "adds the torques that carry the arm's weight",
        |options: &mut Options| &mut options.gravity,
    )
});

/// An object of class `setpoint` or `torque`.
pub(super) struct Streaming {
    options: Options,
    table: &'static OptionTable<Options>,
    torques: bool,
}

impl Streaming {
    pub(super) fn setpoints() -> Self {
        Self {
            options: Options::default(),
            table: &SETPOINTS,
            torques: false,
        }
    }

    pub(super) fn torques() -> Self {
        Self {
            options: Options::default(),
            table: &TORQUES,
            torques: true,
        }
    }

    fn request(&self) -> StreamSetpoints {
        let options = &self.options;
        let (kind, speed) = match self.torques {
            true => {
                let gravity = options.gravity;
                (StreamKind::Torques { gravity }, 1.0)
            }
            false => (StreamKind::Joints, options.speed),
        };
        StreamSetpoints {
            kind,
            buffer: Some(options.buffer.clone()).filter(|name| !name.is_empty()),
            max_age_s: options.age,
            speed,
            acceleration: options.acceleration.first().copied(),
            guards: guards(&options.guards),
        }
    }

    async fn job(&self, form: &str, cx: &Waiting<'_>, io: &mut Transport) -> Outcome {
        if !cx.is_in_app() {
            return Err(no_servo());
        }
        let client = &self.options.client;
        let numbers = std::mem::take(&mut io.floats);
        match form {
            "acquire" => {
                let acquired = cx.call_task(client, Acquire {}, DEADLINE).await?;
                acquired.map_err(in_the_way)?;
            }
            "release" => {
                let released = cx.call_task(client, Release {}, DEADLINE).await?;
                released.map_err(in_the_way)?;
            }
            "end" => cx.call_task(client, Cancel {}, DEADLINE).await?,
            "begin" => {
                let begun = cx.call_task(client, self.request(), DEADLINE).await?;
                told(io, begun.map_err(in_the_way)?);
            }
            form if form == "state" || numbers.is_empty() => {
                told(io, cx.call_task(client, ReadStream {}, DEADLINE).await?)
            }
            _ => {
                let taken = cx
                    .call_task(client, StreamValue { numbers }, DEADLINE)
                    .await?;
                taken.map_err(in_the_way)?;
                cx.sleep(SEEN).await;
                let report = cx.call_task(client, ReadStream {}, DEADLINE).await?;
                if let Some(end) = report.end {
                    return Err(Report::error(code::MOTION, end));
                }
                told(io, report);
            }
        }
        Ok(())
    }
}

/// Has the arm listen to poses or displacements of its tool, for `mvpos`. It is acquired where nobody holds it, and kept.
pub(super) async fn listen(
    cx: &Waiting<'_>,
    client: &str,
    request: StreamSetpoints,
    io: &mut Transport,
) -> Outcome {
    if !cx.is_in_app() {
        return Err(no_servo());
    }
    if request.buffer.is_none() {
        let text = "no buffer is named; name one: CTRL -listen BUFFER";
        return Err(Report::error(sorma::report::code::VALUE, text));
    }
    let cold = cx.call_task(client, Status {}, DEADLINE).await?.state == State::Cold;
    if cold {
        let acquired = cx.call_task(client, Acquire {}, DEADLINE).await?;
        acquired.map_err(in_the_way)?;
    }
    let begun = cx.call_task(client, request, DEADLINE).await;
    let begun = begun.and_then(|begun| begun.map_err(in_the_way));
    if cold && begun.is_err() {
        // It was had for this, and nothing came of it.
        let _ = cx.call_task(client, Release {}, DEADLINE).await;
    }
    told(io, begun?);
    Ok(())
}

fn no_servo() -> Report {
    let text = "the arm of this process has no servo that could follow a stream";
    Report::error(code::MOTION, text)
}

/// Names with commas between.
fn guards(names: &str) -> Vec<String> {
    let all = names.split(',').map(str::trim);
    all.filter(|name| !name.is_empty())
        .map(str::to_owned)
        .collect()
}

/// How a stream is, as an answer.
fn told(io: &mut Transport, report: StreamReport) {
    let what = match report.kind {
        Some(StreamKind::Joints) => "setpoints",
        Some(StreamKind::Tool) => "poses",
        Some(StreamKind::Torques { .. }) => "torques",
        None => "nothing",
    };
    io.text = match (report.end, &report.buffer) {
        (Some(end), _) => end,
        (None, Some(buffer)) => format!("the arm follows {what} of buffer `{buffer}`"),
        (None, None) if report.follows => format!("the arm follows {what} that EXEC hands over"),
        (None, None) => "no stream has been begun".to_owned(),
    };
    io.floats = vec![report.age_s];
    io.ints = vec![i64::try_from(report.values).unwrap_or(i64::MAX)];
}

impl ServiceObject for Streaming {
    fn exec_waiting<'a>(
        &'a mut self,
        cx: &'a Waiting<'a>,
        io: &'a mut Transport,
    ) -> Option<LocalBoxFuture<'a, Outcome>> {
        Some(Box::pin(async move {
            let form = match self.table.form(io) {
                Ok(form) => form.text,
                Err(report) => return ended(io, Err(report)),
            };
            io.text.clear();
            let outcome = self.job(form, cx, io).await;
            let outcome = known(cx, &self.options.client, outcome).await;
            if outcome.is_err() {
                return ended(io, outcome);
            }
            Ok(())
        }))
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        self.table.ctrl(&mut self.options, io);
        Ok(())
    }

    fn dump(&self) -> String {
        self.table.dump(&self.options)
    }
}

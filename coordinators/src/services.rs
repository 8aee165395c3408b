//! The classes of this crate: each has a command of a Dispatcher done, by text (SORMA technical report, section 2.1.3: `push` and
//! `carry` are complex movement primitives of the robot's daemon; `pointer` is the service of the laser's).

use std::{sync::LazyLock, time::Duration};

use futures_util::future::LocalBoxFuture;
use pnt::task::{PutTape, TapeAnswer};
use sorma::{
    Class, ClassInfo, Context, Form, OptionTable, Outcome, Report, ServiceObject, Sorm, Transport,
    Waiting,
};

use crate::{carry, game};

/// Version of the classes.
const VERSION: &str = env!("CARGO_PKG_VERSION");

/// No command lasts longer.
const LONGEST: Duration = Duration::from_secs(1800);

sorma::prototypes! {
    /// The codes of the reports of the classes `push`, `go` and `pointer`.
    pub mod code {
        NOT_DONE = 174, Error, "the Dispatcher's command was not done as asked", "the text says why, and what is true now";
        NOBODY = 175, Error, "nobody does this outside an app", "attach to an app that has a Dispatcher for it: `scott push`, `scott around`, `scott carry`";
    }
}

/// The recipes that are shipped with the classes, from which others are derived.
pub const DICTIONARY: &str = "\
carry -task dispatcher
push -task dispatcher
go -task dispatcher
pointer -task dispatcher
game.brazilian -variant brazilian
game.russian -variant russian
game.pool -variant pool
game.english -variant english
game.italian -variant italian
game.spanish -variant spanish
game.czech -variant czech
";

/// Makes the classes known to a manager.
pub fn register(sorm: &Sorm) {
    carry::service::register(sorm);
    game::register(sorm);
    for kind in &KINDS {
        let class = Class::new(kind.class, VERSION, move |_, _| {
            let options = Options::default();
            Ok(Box::new(Commander { kind, options }))
        });
        let class = class.waits().any_flavor().codes(code::PROTOTYPES);
        sorm.register(class.described((kind.table)().class(kind.class, VERSION)));
    }
}

/// What a program may know about the classes.
#[must_use]
pub fn classes() -> Vec<ClassInfo> {
    let mut classes = carry::service::classes();
    classes.push(game::class());
    let infos = KINDS.iter();
    classes.extend(infos.map(|kind| (kind.table)().class(kind.class, VERSION)));
    classes
}

/// Has a command done by the Dispatcher `task` of the app.
pub(crate) async fn put(
    cx: &Waiting<'_>,
    task: &str,
    symbol: &str,
    arguments: Vec<String>,
) -> Result<TapeAnswer, Report> {
    let put = PutTape {
        symbol: symbol.to_owned(),
        arguments,
    };
    cx.call_task(task, put, LONGEST).await
}

/// Ends a request: what came in must not stay there as if it were an answer.
pub(crate) fn ended(io: &mut Transport, outcome: Outcome) -> Outcome {
    io.floats.clear();
    if outcome.is_err() {
        io.text.clear();
    }
    outcome
}

/// What an object of such a class keeps.
#[derive(Debug, Clone)]
struct Options {
    task: String,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            task: "dispatcher".to_owned(),
        }
    }
}

/// A class whose EXEC is one command.
struct Kind {
    class: &'static str,
    table: fn() -> &'static OptionTable<Options>,
    /// The command, and the answer when it was done.
    symbol: &'static str,
    success: &'static str,
    /// The command's arguments of those of EXEC.
    arguments: fn(&Transport) -> Vec<String>,
}

static KINDS: [Kind; 3] = [
    Kind {
        class: "push",
        table: || &PUSH,
        symbol: "push",
        success: "pushed_it",
        arguments: |io| {
            let points = io.floats.chunks(2);
            let point = |point: &[f64]| {
                let numbers: Vec<String> = point.iter().map(ToString::to_string).collect();
                numbers.join(",")
            };
            points.map(point).collect()
        },
    },
    Kind {
        class: "go",
        table: || &GO,
        symbol: "go",
        success: "there",
        arguments: |io| io.text.split_whitespace().map(ToOwned::to_owned).collect(),
    },
    Kind {
        class: "pointer",
        table: || &POINTER,
        symbol: "point",
        success: "pointed",
        arguments: |io| {
            let field: Vec<String> = io.floats.iter().map(ToString::to_string).collect();
            vec![field.join(",")]
        },
    },
];

static PUSH: LazyLock<OptionTable<Options>> = LazyLock::new(|| {
    table(
        "pushes what stands on a line, with a compliant arm",
        "the app's task with the handler coordinators.push",
        &[Form {
            text: "",
            floats: 4,
            takes: "x and y of the begin and of the end of the line, m of the arm's base frame",
            gives: "",
            results: "",
            help: "pushes what stands between, and answers when that is done",
        }],
    )
});

static GO: LazyLock<OptionTable<Options>> = LazyLock::new(|| {
    table(
        "has an arm go to a place around what stands in the way",
        "the app's task with the handler coordinators.go",
        &[Form {
            text: "PLACE",
            floats: 0,
            takes: "",
            gives: "",
            results: "",
            help: "goes to a place of the Dispatcher's `places`, and answers when the arm is there",
        }],
    )
});

static POINTER: LazyLock<OptionTable<Options>> = LazyLock::new(|| {
    table(
        "has the laser pointer in the hand show a field of a board, and blink",
        "the app's task with the handler coordinators.carry",
        &[Form {
            text: "",
            floats: 3,
            takes: "a field of the board: column, row (from 1) and height, in things that lie beneath",
            gives: "",
            results: "",
            help: "points at the middle of the field, and answers when the arm is parked again",
        }],
    )
});

fn table(about: &'static str, task: &'static str, forms: &'static [Form]) -> OptionTable<Options> {
    let table = OptionTable::new(about).exec(forms);
    table.word("task", "TASK", task, |options: &mut Options| {
        &mut options.task
    })
}

/// An object of such a class.
struct Commander {
    kind: &'static Kind,
    options: Options,
}

impl Commander {
    async fn done(&self, cx: &Waiting<'_>, io: &mut Transport) -> Outcome {
        let Kind {
            table,
            symbol,
            success,
            arguments,
            ..
        } = self.kind;
        table().form(io)?;
        if !cx.is_in_app() {
            let text = format!("`{}` has an app do it, and here is none", cx.name());
            return Err(Report::error(code::NOBODY, text));
        }
        let answer = put(cx, &self.options.task, symbol, arguments(io)).await?;
        if answer.symbol == *success {
            io.text = answer.text;
            return Ok(());
        }
        let text = format!("{}: {}", answer.symbol, answer.text.replace('\n', "; "));
        Err(Report::error(code::NOT_DONE, text))
    }
}

impl ServiceObject for Commander {
    fn exec_waiting<'a>(
        &'a mut self,
        cx: &'a Waiting<'a>,
        io: &'a mut Transport,
    ) -> Option<LocalBoxFuture<'a, Outcome>> {
        Some(Box::pin(async move {
            let outcome = self.done(cx, io).await;
            ended(io, outcome)
        }))
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        (self.kind.table)().ctrl(&mut self.options, io);
        Ok(())
    }

    fn dump(&self) -> String {
        (self.kind.table)().dump(&self.options)
    }
}

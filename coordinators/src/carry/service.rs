//! The class `carry`: has a thing carried, by the Dispatcher of an app (SORMA technical report, section 2.1.4).

use std::sync::LazyLock;

use futures_util::future::LocalBoxFuture;
use sorma::{
    Class, ClassInfo, Context, Form, OptionTable, Outcome, Report, ServiceObject, Sorm, Transport,
    Waiting,
};

use super::board::Field;

/// Version of the class.
const VERSION: &str = env!("CARGO_PKG_VERSION");

sorma::prototypes! {
    /// The codes of the reports of this class.
    pub mod code {
        NOT_CARRIED = 170, Error, "the thing was not carried", "the text says why, and where it is";
        NOTHING_AT_FROM = 172, Error, "no thing stands where it was to be taken", "nothing has moved; the text says what is seen";
        OCCUPIED = 173, Error, "something stands where the thing was to be set down", "nothing has moved; the text says what is seen";
        NO_CARRIER = 171, Error, "nobody carries outside an app", "attach to an app that has a Dispatcher for it: `scott carry`";
        NOBODY_ASKS = 176, Error, "nobody asks whether a thing is fetched", "people are asked when a thing was lost, with `-lost ask`";
    }
}

const FORMS: &[Form] = &[
    Form {
        text: "",
        floats: 6,
        takes: "from and to on the board: column, row (from 1) and height, in things that lie beneath",
        gives: "",
        results: "",
        help: "carries what lies at the one to the other, and answers when that is done",
    },
    Form {
        text: "putBack",
        floats: 0,
        takes: "",
        gives: "",
        results: "",
        help: "has a hand that could not put something down bring it back to where it was taken",
    },
    Form {
        text: "fetch",
        floats: 0,
        takes: "",
        gives: "",
        results: "",
        help: "answers for people who are asked: what was lost is fetched",
    },
    Form {
        text: "leave",
        floats: 0,
        takes: "",
        gives: "",
        results: "",
        help: "answers for people who are asked: what was lost stays where it lies",
    },
];

/// What an object of the class keeps.
#[derive(Debug, Clone)]
struct Options {
    task: String,
    people: String,
    speed: Vec<f64>,
    tries: String,
    lost: String,
    show: String,
    speaker: String,
}

/// An option's value when the app's configuration decides.
const USUAL: &str = "asConfigured";

impl Options {
    /// What is wanted otherwise than the app's configuration has it, as words of the tape.
    fn wishes(&self) -> Vec<String> {
        let speed = self.speed.first();
        let speed = speed.map(|speed| format!("speed={speed}"));
        let words = [
            ("tries", &self.tries),
            ("lost", &self.lost),
            ("show", &self.show),
            ("speaker", &self.speaker),
        ];
        let words = words.into_iter().filter(|(_, word)| *word != USUAL);
        let words = words.map(|(key, word)| format!("{key}={word}"));
        speed.into_iter().chain(words).collect()
    }
}

impl Default for Options {
    fn default() -> Self {
        Self {
            task: "dispatcher".to_owned(),
            people: "people".to_owned(),
            speed: Vec::new(),
            tries: USUAL.to_owned(),
            lost: USUAL.to_owned(),
            show: USUAL.to_owned(),
            speaker: USUAL.to_owned(),
        }
    }
}

static TABLE: LazyLock<OptionTable<Options>> = LazyLock::new(|| {
    OptionTable::new("carries a thing from one field of a board to another")
        .exec(FORMS)
        .word(
            "task",
            "TASK",
            "the app's task with the handler coordinators.carry",
            |options: &mut Options| &mut options.task,
        )
        .word(
            "people",
            "TASK",
            "the app's task with the handler coordinators.carry_people",
            |options: &mut Options| &mut options.people,
        )
        .floats(
            "transferSpeed",
            &["SPEED"],
            0.001..=1.0,
            "",
            "fraction of full speed to and fro; as the Robot Coordinator has it unless it is set",
            |options| &mut options.speed,
        )
        .int_or(
            "tries",
            USUAL,
            1..=100,
            "",
            "how often the thing is tried to grasp",
            |options| &mut options.tries,
        )
        .choice(
            "lost",
            &[USUAL, "tell", "fetch", "ask"],
            "what is done with a thing that was lost on the way",
            |options| &mut options.lost,
        )
        .choice(
            "show",
            &[USUAL, "on", "off"],
            "whether the pointer in the hand shows where a lost thing lies",
            |options| &mut options.show,
        )
        .word(
            "speaker",
            "OBJECT",
            "the service object that tells people in the room what went wrong, at its daemon",
            |options| &mut options.speaker,
        )
});

/// Makes the class known to a manager.
pub fn register(sorm: &Sorm) {
    let class = Class::new("carry", VERSION, |_, _| Ok(Box::new(Carry::default())));
    let class = class.waits().any_flavor();
    for (class, info) in [class].into_iter().zip(classes()) {
        sorm.register(class.codes(code::PROTOTYPES).described(info));
    }
}

/// What a program may know about the class.
#[must_use]
pub fn classes() -> Vec<ClassInfo> {
    vec![TABLE.class("carry", VERSION)]
}

/// An object of class `carry`.
#[derive(Default)]
struct Carry {
    options: Options,
}

impl Carry {
    /// Answers for people who are asked.
    async fn answer(&self, cx: &Waiting<'_>, io: &mut Transport, word: &str) -> Outcome {
        let words = vec![word.to_owned()];
        let answer = crate::services::put(cx, &self.options.people, "answer", words).await?;
        io.text = answer.text;
        match answer.symbol.as_str() {
            "heard" => Ok(()),
            _ => Err(Report::error(
                code::NOBODY_ASKS,
                "nobody asks whether a thing is fetched",
            )),
        }
    }

    async fn job(&self, cx: &Waiting<'_>, io: &mut Transport) -> Outcome {
        let form = TABLE.form(io)?.text;
        if !cx.is_in_app() {
            let text = format!("`{}` has an app carry, and here is none", cx.name());
            return Err(Report::error(code::NO_CARRIER, text));
        }
        if let "fetch" | "leave" = form {
            return self.answer(cx, io, form).await;
        }
        let (put, success) = match (form, io.floats.as_slice()) {
            ("", &[column, row, height, to_column, to_row, to_height]) => {
                let field = |column, row, height| {
                    let field = Field {
                        column,
                        row,
                        height,
                    };
                    field.to_string()
                };
                let mut arguments = vec![
                    field(column, row, height),
                    field(to_column, to_row, to_height),
                ];
                arguments.extend(self.options.wishes());
                (("carry", arguments), "carried")
            }
            _ => (("put_back", Vec::new()), "put_down"),
        };
        let (symbol, arguments) = put;
        let answer = crate::services::put(cx, &self.options.task, symbol, arguments).await?;
        if answer.symbol == success {
            io.text = answer.text;
            return Ok(());
        }
        let text = format!("{}: {}", answer.symbol, answer.text.replace('\n', "; "));
        let code = match answer.symbol.as_str() {
            "nothing_at_from" => code::NOTHING_AT_FROM,
            "occupied" => code::OCCUPIED,
            _ => code::NOT_CARRIED,
        };
        Err(Report::error(code, text))
    }
}

impl ServiceObject for Carry {
    fn exec_waiting<'a>(
        &'a mut self,
        cx: &'a Waiting<'a>,
        io: &'a mut Transport,
    ) -> Option<LocalBoxFuture<'a, Outcome>> {
        Some(Box::pin(async move {
            let outcome = self.job(cx, io).await;
            crate::services::ended(io, outcome)
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

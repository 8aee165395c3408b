//! The manager as a service object, `sorm`: by it an inspector learns what there is, and sets it right.

use crate::description::ClassInfo;
use crate::object::{Context, Outcome, ServiceObject, unsupported};
use crate::options::OptionTable;
use crate::raise;
use crate::report::{Report, code};
use crate::request::{Method, Request};
use crate::sorm::Sorm;
use crate::together::COMMIT_WITHIN;
use crate::trade::{self, Attributes};
use crate::transport::Transport;
use crate::words;
use std::sync::LazyLock;
use std::time::Duration;

/// No lock is for longer.
const LONGEST_LOCK_S: f64 = 86_400.0;

/// The class `sorm`.
pub(crate) struct ManagerObject;

/// What a request asks for. All of it is read before any of it is done.
#[derive(Debug, Clone)]
enum Order {
    List,
    Classes,
    Describe,
    Codes,
    Create(String),
    Free(String),
    Alias(String, String),
    Unalias(String),
    Aliases,
    Statistics,
    Lock(String, f64),
    Unlock(String),
    Prepare(String, String),
    Commit(String),
    Abort(String),
    Offers,
    Offer(String, Attributes),
    Withdraw(String),
    Market,
}

#[derive(Debug, Clone, Default)]
struct Orders(Vec<Order>);

impl Orders {
    fn add(&mut self, order: Order) -> Result<String, String> {
        self.0.push(order);
        Ok(String::new())
    }
}

/// The words of an action; the table has seen to their number.
fn word(words: &[String], index: usize) -> String {
    words.get(index).cloned().unwrap_or_default()
}

/// What a program may know about the class.
pub(crate) fn class() -> ClassInfo {
    ORDERS.class("sorm", env!("CARGO_PKG_VERSION"))
}

static ORDERS: LazyLock<OptionTable<Orders>> = LazyLock::new(|| {
    OptionTable::new("manages the service objects of its process")
        .action(
            "list",
            &[],
            "answers the names of all objects built so far",
            |now: &mut Orders, _| now.add(Order::List),
        )
        .action(
            "classes",
            &[],
            "answers all classes with their versions",
            |now, _| now.add(Order::Classes),
        )
        .action(
            "describe",
            &[],
            "answers what programs may know about the classes, their forms and options, a JSON object a line",
            |now, _| now.add(Order::Describe),
        )
        .action(
            "codes",
            &[],
            "answers what the codes of reports mean",
            |now, _| now.add(Order::Codes),
        )
        .action(
            "create",
            &["NAME"],
            "builds an object unless it is there",
            |now, words| now.add(Order::Create(word(words, 0))),
        )
        .action(
            "free",
            &["NAME"],
            "removes an object; its next use builds it anew",
            |now, words| now.add(Order::Free(word(words, 0))),
        )
        .action(
            "alias",
            &["ALIAS", "NAME"],
            "has a further name lead to an object",
            |now, words| now.add(Order::Alias(word(words, 0), word(words, 1))),
        )
        .action(
            "unalias",
            &["ALIAS"],
            "forgets a further name",
            |now, words| now.add(Order::Unalias(word(words, 0))),
        )
        .action("aliases", &[], "answers all further names", |now, _| {
            now.add(Order::Aliases)
        })
        .action(
            "statistics",
            &[],
            "answers how often each object was called",
            |now, _| now.add(Order::Statistics),
        )
        .action(
            "lock",
            &["NAME", "SECONDS"],
            "keeps an object for the caller",
            |now, words| {
                let time = word(words, 1);
                let seconds: Option<f64> = time.parse().ok();
                let seconds = seconds.filter(|time| (0.0..=LONGEST_LOCK_S).contains(time));
                let seconds = seconds.ok_or_else(|| {
                    format!("SECONDS must be a number from 0 to {LONGEST_LOCK_S}, not `{time}`")
                })?;
                now.add(Order::Lock(word(words, 0), seconds))
            },
        )
        .action(
            "unlock",
            &["NAME"],
            "ends the caller's lock",
            |now, words| now.add(Order::Unlock(word(words, 0))),
        )
        .action(
            "prepare",
            &["COMMITMENT", "'NAME EXEC ...'"],
            "first step of a two-step commitment: the object says whether it can",
            |now, words| now.add(Order::Prepare(word(words, 0), word(words, 1))),
        )
        .action(
            "commit",
            &["COMMITMENT"],
            "second step: all do it",
            |now, words| now.add(Order::Commit(word(words, 0))),
        )
        .action(
            "abort",
            &["COMMITMENT"],
            "second step: none does it",
            |now, words| now.add(Order::Abort(word(words, 0))),
        )
        .action(
            "offer",
            &["CLASS", "'ATTRIBUTE=VALUE ...'"],
            "offers a class to whoever trades, in place of an earlier offer of it",
            |now, words| {
                let attributes = trade::attributes(&word(words, 1))?;
                now.add(Order::Offer(word(words, 0), attributes))
            },
        )
        .action(
            "withdraw",
            &["CLASS"],
            "offers a class no more",
            |now, words| now.add(Order::Withdraw(word(words, 0))),
        )
        .action("offers", &[], "answers what is offered here", |now, _| {
            now.add(Order::Offers)
        })
        .action(
            "market",
            &[],
            "answers what is known about the daemons that were asked for offers",
            |now, _| now.add(Order::Market),
        )
});

impl ServiceObject for ManagerObject {
    fn exec(&mut self, _cx: &Context<'_>, _io: &mut Transport) -> Outcome {
        Err(unsupported(Method::Exec))
    }

    fn ctrl(&mut self, cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let mut orders = Orders::default();
        ORDERS.ctrl(&mut orders, io);
        if !io.is_ok() {
            return Ok(());
        }
        let mut answers = Vec::new();
        if !io.text.is_empty() {
            answers.push(std::mem::take(&mut io.text));
        }
        for order in orders.0 {
            let answer = obey(cx, order, io)?;
            answers.extend(Some(answer).filter(|answer| !answer.is_empty()));
        }
        io.text = answers.join("\n");
        Ok(())
    }

    fn dump(&self) -> String {
        String::new()
    }
}

fn obey(cx: &Context<'_>, order: Order, io: &mut Transport) -> Result<String, Report> {
    let sorm = cx.sorm();
    let from = io.from.clone();
    match order {
        Order::List => Ok(sorm.objects().join("\n")),
        Order::Classes => {
            let classes = sorm.classes();
            let lines = classes
                .iter()
                .map(|class| format!("{} {}", class.name(), class.version()));
            Ok(lines.collect::<Vec<_>>().join("\n"))
        }
        Order::Describe => {
            let classes = sorm.classes();
            let infos = classes.iter().filter_map(|class| class.info());
            // A structure of texts and numbers always has a JSON form.
            let lines = infos.map(|info| serde_json::to_string(info).unwrap_or_default());
            Ok(lines.collect::<Vec<_>>().join("\n"))
        }
        Order::Codes => Ok(codes(sorm)),
        Order::Create(name) => sorm.get(&name).map(|_| String::new()),
        Order::Free(name) => free(cx, &name, &from),
        Order::Alias(alias, name) => sorm.alias(&alias, &name).map(|()| String::new()),
        Order::Unalias(alias) => there(sorm.unalias(&alias), "alias", &alias),
        Order::Aliases => {
            let aliases = sorm.aliases();
            let lines = aliases
                .iter()
                .map(|(alias, name)| format!("{alias} {name}"));
            Ok(lines.collect::<Vec<_>>().join("\n"))
        }
        Order::Statistics => Ok(statistics(cx)),
        Order::Lock(name, seconds) => {
            let time = Duration::from_secs_f64(seconds);
            sorm.lock_in(Some(cx), &name, &from, time)
                .map(|()| String::new())
        }
        Order::Unlock(name) => there(
            sorm.unlock_in(Some(cx), &name, &from)?,
            "lock of yours on",
            &name,
        ),
        Order::Prepare(commitment, text) => prepare(cx, &commitment, &text, io),
        Order::Commit(commitment) => commit(cx, &commitment, io),
        Order::Abort(commitment) => sorm
            .abort_in(Some(cx), &commitment, &from)
            .map(|()| String::new()),
        Order::Offers => Ok(sorm.offers().join("\n")),
        Order::Offer(class, attributes) => {
            if !sorm.classes().iter().any(|known| known.name() == class) {
                return Err(raise!(code::UNKNOWN_CLASS, "there is no class `{class}`"));
            }
            sorm.offer(&class, attributes);
            Ok(String::new())
        }
        Order::Withdraw(class) => there(sorm.withdraw(&class), "offer of", &class),
        Order::Market => Ok(sorm.market().join("\n")),
    }
}

fn there(was: bool, what: &str, name: &str) -> Result<String, Report> {
    if was {
        return Ok(String::new());
    }
    Err(raise!(code::NO_OBJECT, "there is no {what} `{name}`"))
}

fn free(cx: &Context<'_>, name: &str, from: &str) -> Result<String, Report> {
    let sorm = cx.sorm();
    if let Some(slot) = sorm.find(name) {
        let mut body = slot.lock(Some(cx))?;
        slot.free_for(&mut body, sorm, from)?;
    }
    there(sorm.remove(name), "object", name)
}

fn codes(sorm: &Sorm) -> String {
    let lines = sorm.prototypes().into_iter().map(|(class, prototype)| {
        let severity = prototype.severity.word();
        format!(
            "{} {severity} {class} {}: {}",
            prototype.code, prototype.text, prototype.help
        )
    });
    lines.collect::<Vec<_>>().join("\n")
}

fn statistics(cx: &Context<'_>) -> String {
    let slots = cx.sorm().slots().into_iter();
    let lines = slots.map(|slot| match slot.lock(Some(cx)) {
        Ok(body) => format!(
            "{} exec {} ctrl {} errors {}",
            slot.name(),
            body.meta.execs,
            body.meta.ctrls,
            body.meta.errors
        ),
        Err(_) => format!("{} is in a call", slot.name()),
    });
    lines.collect::<Vec<_>>().join("\n")
}

fn prepare(
    cx: &Context<'_>,
    commitment: &str,
    text: &str,
    io: &mut Transport,
) -> Result<String, Report> {
    let request: Request = text
        .parse()
        .map_err(|error| raise!(code::SYNTAX, "{error}"))?;
    let request = Request {
        body: request.body.from(io.from.clone()),
        ..request
    };
    let mut reply = cx
        .sorm()
        .prepare_in(Some(cx), commitment, request, COMMIT_WITHIN)?;
    io.reports.append(&mut reply.body.reports);
    if !reply.body.is_ok() {
        io.code = reply.body.code;
    }
    Ok(String::new())
}

/// The second step; answers the replies, a line each.
fn commit(cx: &Context<'_>, commitment: &str, io: &mut Transport) -> Result<String, Report> {
    let mut lines = Vec::new();
    for (name, mut body) in cx.sorm().commit_in(Some(cx), commitment, &io.from)? {
        io.reports.append(&mut body.reports);
        if !body.is_ok() && io.code == 0 {
            io.code = body.code;
        }
        lines.push(format!(
            "{name} RET {} {}",
            body.code,
            words::word(&body.text)
        ));
    }
    Ok(lines.join("\n"))
}

//! The manager as a service object, `sorm`: by it an inspector learns what there is, and sets it right.

use crate::class::Class;
use crate::description::ClassInfo;
use crate::object::{Context, Outcome, ServiceObject};
use crate::options::OptionTable;
use crate::raise;
use crate::report::{Report, code};
use crate::request::Request;
use crate::sorm::Sorm;
use crate::together::COMMIT_WITHIN;
use crate::trade::attributes;
use crate::transport::Transport;
use crate::words;
use std::rc::Rc;
use std::sync::{Arc, LazyLock};
use std::time::Duration;

/// How long the manager waits for an object that shall only tell of itself.
const GLANCE: Duration = Duration::from_millis(20);
/// No lock is for longer.
const LONGEST_LOCK_S: f64 = 86_400.0;

/// The class `sorm`.
pub(crate) struct ManagerObject;

/// Something that a request asks for.
type Order = dyn Fn(&Context<'_>, &mut Transport) -> Result<String, Report>;

/// What a request asks for. All of it is read before any of it is done.
#[derive(Clone, Default)]
struct Orders(Vec<Rc<Order>>);

impl Orders {
    fn add(
        &mut self,
        order: impl Fn(&Context<'_>, &mut Transport) -> Result<String, Report> + 'static,
    ) -> Result<String, String> {
        self.0.push(Rc::new(order));
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
            |now: &mut Orders, _| now.add(|cx, _| Ok(cx.sorm().objects().join("\n"))),
        )
        .action(
            "classes",
            &[],
            "answers all classes with their versions",
            |now, _| {
                now.add(|cx, _| {
                    let classes = cx.sorm().classes();
                    let line = |class: &Arc<Class>| format!("{} {}", class.name(), class.version());
                    Ok(lines(classes.iter().map(line)))
                })
            },
        )
        .action(
            "describe",
            &[],
            "answers what programs may know about the classes, their forms and options, a JSON object a line",
            |now, _| {
                now.add(|cx, _| {
                    let classes = cx.sorm().classes();
                    let infos = classes.iter().filter_map(|class| class.info());
                    // A structure of texts and numbers always has a JSON form.
                    Ok(lines(infos.map(|info| serde_json::to_string(info).unwrap_or_default())))
                })
            },
        )
        .action(
            "codes",
            &[],
            "answers what the codes of reports mean",
            |now, _| now.add(|cx, _| Ok(codes(cx.sorm()))),
        )
        .action(
            "create",
            &["NAME"],
            "builds an object unless it is there",
            |now, words| {
                let name = word(words, 0);
                now.add(move |cx, _| cx.sorm().get(&name).map(|_| String::new()))
            },
        )
        .action(
            "free",
            &["NAME"],
            "removes an object; its next use builds it anew",
            |now, words| {
                let name = word(words, 0);
                now.add(move |cx, io| free(cx, &name, &io.from))
            },
        )
        .action(
            "alias",
            &["ALIAS", "NAME"],
            "has a further name lead to an object",
            |now, words| {
                let (alias, name) = (word(words, 0), word(words, 1));
                now.add(move |cx, _| done(cx.sorm().alias(&alias, &name)))
            },
        )
        .action(
            "unalias",
            &["ALIAS"],
            "forgets a further name",
            |now, words| {
                let alias = word(words, 0);
                now.add(move |cx, _| there(cx.sorm().unalias(&alias), "alias", &alias))
            },
        )
        .action("aliases", &[], "answers all further names", |now, _| {
            now.add(|cx, _| {
                let aliases = cx.sorm().aliases().into_iter();
                Ok(lines(aliases.map(|(alias, name)| format!("{alias} {name}"))))
            })
        })
        .action(
            "statistics",
            &[],
            "answers how often each object was called",
            |now, _| now.add(|cx, _| Ok(statistics(cx))),
        )
        .action(
            "busy",
            &[],
            "answers which objects the daemon has in calls now, of whom, and for how long",
            |now, _| now.add(|cx, _| Ok(busy(cx))),
        )
        .action(
            "lock",
            &["NAME", "SECONDS"],
            "keeps an object for the caller",
            |now, words| {
                let (name, time) = (word(words, 0), word(words, 1));
                let seconds: Option<f64> = time.parse().ok();
                let seconds = seconds.filter(|time| (0.0..=LONGEST_LOCK_S).contains(time));
                let time = seconds.map(Duration::from_secs_f64).ok_or_else(|| {
                    format!("SECONDS must be a number from 0 to {LONGEST_LOCK_S}, not `{time}`")
                })?;
                now.add(move |cx, io| done(cx.sorm().lock_in(Some(cx), &name, &io.from, time)))
            },
        )
        .action(
            "unlock",
            &["NAME"],
            "ends the caller's lock",
            |now, words| {
                let name = word(words, 0);
                now.add(move |cx, io| {
                    let was = cx.sorm().unlock_in(Some(cx), &name, &io.from)?;
                    there(was, "lock of yours on", &name)
                })
            },
        )
        .action(
            "prepare",
            &["COMMITMENT", "'NAME EXEC ...'"],
            "first step of a two-step commitment: the object says whether it can",
            |now, words| {
                let (commitment, text) = (word(words, 0), word(words, 1));
                now.add(move |cx, io| prepare(cx, &commitment, &text, io))
            },
        )
        .action(
            "commit",
            &["COMMITMENT"],
            "second step: all do it",
            |now, words| {
                let commitment = word(words, 0);
                now.add(move |cx, io| commit(cx, &commitment, io))
            },
        )
        .action(
            "abort",
            &["COMMITMENT"],
            "second step: none does it",
            |now, words| {
                let commitment = word(words, 0);
                now.add(move |cx, io| done(cx.sorm().abort_in(Some(cx), &commitment, &io.from)))
            },
        )
        .action(
            "offer",
            &["CLASS", "'ATTRIBUTE=VALUE ...'"],
            "offers a class to whoever trades, in place of an earlier offer of it",
            |now, words| {
                let (class, attributes) = (word(words, 0), attributes(&word(words, 1))?);
                now.add(move |cx, _| {
                    if !cx.sorm().classes().iter().any(|known| known.name() == class) {
                        return Err(raise!(code::UNKNOWN_CLASS, "there is no class `{class}`"));
                    }
                    cx.sorm().offer(&class, attributes.clone());
                    Ok(String::new())
                })
            },
        )
        .action(
            "withdraw",
            &["CLASS"],
            "offers a class no more",
            |now, words| {
                let class = word(words, 0);
                now.add(move |cx, _| there(cx.sorm().withdraw(&class), "offer of", &class))
            },
        )
        .action("offers", &[], "answers what is offered here", |now, _| {
            now.add(|cx, _| Ok(cx.sorm().offers().join("\n")))
        })
        .action(
            "market",
            &[],
            "answers what is known about the daemons that were asked for offers",
            |now, _| now.add(|cx, _| Ok(cx.sorm().market().join("\n"))),
        )
});

impl ServiceObject for ManagerObject {
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
            let answer = order(cx, io)?;
            answers.extend(Some(answer).filter(|answer| !answer.is_empty()));
        }
        io.text = answers.join("\n");
        Ok(())
    }

    fn dump(&self) -> String {
        String::new()
    }
}

fn lines(lines: impl Iterator<Item = String>) -> String {
    lines.collect::<Vec<_>>().join("\n")
}

fn done(outcome: Outcome) -> Result<String, Report> {
    outcome.map(|()| String::new())
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
    sorm.keep_options(name, None);
    there(sorm.remove(name), "object", name)
}

fn codes(sorm: &Sorm) -> String {
    let prototypes = sorm.prototypes().into_iter();
    lines(prototypes.map(|(class, prototype)| {
        let severity = prototype.severity.word();
        format!(
            "{} {severity} {class} {}: {}",
            prototype.code, prototype.text, prototype.help
        )
    }))
}

fn statistics(cx: &Context<'_>) -> String {
    let slots = cx.sorm().slots().into_iter();
    lines(slots.map(|slot| match slot.body.try_lock_for(GLANCE) {
        Some(body) => format!("{} {}", slot.name(), body.meta.statistics()),
        None => format!("{} is in a call", slot.name()),
    }))
}

/// The calls that are made now, but for this one, and what is being built.
fn busy(cx: &Context<'_>) -> String {
    let now = cx.sorm().now();
    let slots = cx.sorm().slots().into_iter();
    let calls = slots.filter_map(|slot| {
        let call = slot.call.lock().clone()?;
        (slot.name() != cx.name()).then(|| format!("{}: {}", slot.name(), call.words(now)))
    });
    let building = cx.sorm().inner.building.lock();
    let building = building.iter().map(|one| {
        let time = now.since(one.since).as_secs_f64();
        format!("{}: is being built for {time:.1} s", one.name)
    });
    lines(calls.chain(building))
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

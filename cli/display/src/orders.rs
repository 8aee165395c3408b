//! What a page asks of the app: how a task is, and orders for nets.

use std::{
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

use ctos::{
    Command as _,
    recent::{Ending, LastMessage, TaskLook},
    task::{Context, HandlerError, TaskRef},
    time::Instant,
};
use pnt::{
    stream::{Describe, Follow},
    task::{Control, Marking, Order, PutOnce, RequestId, put_once},
};
use scene::FollowScene;
use tokio::sync::mpsc;

use super::{
    arrange,
    hub::Hub,
    lines,
    server::Asking,
    summing::{self, Opened},
    task,
    wire::{Asked, Breakpoint, TaskMessage, TaskNow, TaskState, TaskWait, Told},
};

/// How long an asked task may take.
const LIMIT: Duration = Duration::from_secs(2);

/// How long a net may take to answer a command: a person may have put it behind many others.
const COMMAND_LIMIT: Duration = Duration::from_secs(86_400);

/// Carries orders out, all at the same time, until the server ends.
/// `displays` is the file of overview displays and layouts; beside what is opened stand the nets that may be.
pub(super) async fn carry(
    cx: &Context,
    hub: &Arc<Hub>,
    displays: String,
    (opened, nets): (&Opened, Vec<String>),
    mut orders: mpsc::Receiver<Asking>,
) {
    // Numbers begin anew with each life of this task, and durable nets remember those of earlier boots.
    let (boot, life) = (cx.started_ns(), cx.now().as_nanos());
    let from = format!("{} {boot:016x} {life:016x}", cx.name());
    let commands = Arc::new(AtomicU64::new(0));
    let nets: Arc<[String]> = nets.into();
    while let Some((asked, answer)) = orders.recv().await {
        let (child, hub) = (cx.new_trace(), hub.clone());
        let (displays, from, commands) = (displays.clone(), from.clone(), commands.clone());
        let (opened, nets) = (opened.clone(), nets.clone());
        cx.spawn(async move {
            let told = if asked.kind == "task" {
                Told::Task {
                    task: state(&child, &asked.task).await,
                }
            } else {
                let done = match &*asked.kind {
                    "follow" => open(&child, &hub, (&opened, &nets), &asked.net),
                    "decide" => summing::decide(&child, &asked).await,
                    "move" => arrange::keep(&child, &hub, &displays, &asked),
                    "layout" => arrange::keep_layout(&child, &hub, &displays, &asked),
                    "command" => {
                        let number = 1 + commands.fetch_add(1, Ordering::Relaxed);
                        command(&child, &asked, RequestId { from, number }).await
                    }
                    _ => order(&child, &hub, &asked).await,
                };
                let (ok, text) = done.map_or_else(|e| (false, e.to_string()), |text| (true, text));
                Told::Answer {
                    id: asked.id,
                    ok,
                    text,
                }
            };
            // A browser that went away needs no answer.
            let _ = answer.send(told.text());
        });
    }
}

/// Begins to follow a net that nobody has looked at.
fn open(
    cx: &Context,
    hub: &Arc<Hub>,
    (opened, nets): (&Opened, &[String]),
    net: &str,
) -> Result<String, HandlerError> {
    if !nets.iter().any(|one| one == net) {
        return Err(HandlerError::new(format!("no net is called `{net}`")));
    }
    // Few are followed from the beginning.
    let may_open = opened.is_followed(net) || !hub.follows(net);
    if summing::are_opened(cx, nets.len()) && may_open && opened.open(net) {
        let (child, hub, opened) = (cx.clone(), hub.clone(), opened.clone());
        let net = net.to_owned();
        cx.spawn(async move { task::follow(&child, &net, &hub, Some(&opened)).await });
    }
    Ok(format!("net `{net}` is followed"))
}

/// How a task is, what it handled last, and what the log says of it.
async fn state(cx: &Context, name: &str) -> TaskState {
    let on = cx.app().task(name).map(|task| task.chassis.clone());
    let known = TaskState {
        name: name.to_owned(),
        on: on.unwrap_or_default(),
        lines: lines::about(name).await,
        ..TaskState::default()
    };
    match look(cx, name).await {
        Ok(look) => TaskState {
            now: Some(now(&look)),
            messages: look.last.into_iter().map(message).collect(),
            ..known
        },
        Err(error) => TaskState {
            error: Some(error.to_string()),
            ..known
        },
    }
}

/// Looks at a task, whose last messages are kept from then on. Those by which displays follow a net or a scene are nobody's
/// concern.
pub(super) async fn look(cx: &Context, name: &str) -> Result<TaskLook, HandlerError> {
    let is_net = pnt::task::net_tasks(cx.app(), &cx.registry())
        .iter()
        .any(|net| net == name);
    let without: &[u16] = if is_net {
        &[Describe::CODE, Follow::CODE, Marking::CODE]
    } else {
        &[FollowScene::CODE]
    };
    let to = cx.task(name).await?;
    cx.look_at(&to, without).await
}

fn now(look: &TaskLook) -> TaskNow {
    let task = &look.task;
    TaskNow {
        handled: task.handled,
        failed: task.failed,
        queued: task.urgent + task.queued,
        restarts: task.restarts,
        doing: doing(look),
        waits: task
            .waits
            .iter()
            .map(|wait| TaskWait {
                to: wait.to.clone(),
                command: wait.command.clone(),
            })
            .collect(),
        at: task.at.clone(),
        until_ns: look.until.map(Instant::as_nanos),
    }
}

/// What a task does, in words.
fn doing(look: &TaskLook) -> Option<String> {
    if let Some(wait) = look.task.waits.first() {
        let (to, command) = (&wait.to, &wait.command);
        let waited = wait.for_s;
        return Some(format!(
            "waits for `{to}` to answer `{command}`, {waited:.1} s"
        ));
    }
    let Some(time_s) = look.task.in_handler_s else {
        return look.task.at.clone();
    };
    let command = look.task.command.as_deref().unwrap_or("a message");
    Some(format!("is at `{command}`, {time_s:.1} s"))
}

fn message(last: LastMessage) -> TaskMessage {
    let failed = match &last.ended {
        None | Some((_, Ending::Done)) => None,
        Some((_, Ending::Refused(text))) => Some(text.clone()),
        Some((_, Ending::Panicked(text))) => Some(format!("panicked: {text}")),
        Some((_, Ending::Stopped)) => Some("stopped".to_owned()),
    };
    TaskMessage {
        at_ns: last.began.as_nanos(),
        from: last.from,
        command: last.command,
        took_ns: last.ended.map(|(took, _)| {
            // 584 years.
            u64::try_from(took.as_nanos()).unwrap_or(u64::MAX)
        }),
        failed,
    }
}

/// Puts a command on the tape of a net; its answer.
async fn command(cx: &Context, asked: &Asked, request: RequestId) -> Result<String, HandlerError> {
    let mut words = asked.words.iter().cloned();
    let put = PutOnce {
        request,
        symbol: words.next().ok_or("which command?")?,
        arguments: words.collect(),
    };
    let by = cx.name();
    tracing::info!(
        task = by,
        net = asked.net,
        command = asked.words.join(" "),
        "put on the tape by hand"
    );
    let answer = put_once(cx, &asked.net, &put, COMMAND_LIMIT).await?;
    let text = answer.text.trim_end();
    Ok(match text {
        "" => answer.symbol,
        text => format!("{}: {text}", answer.symbol),
    })
}

/// Has an order carried out by its net.
async fn order(cx: &Context, hub: &Hub, asked: &Asked) -> Result<String, HandlerError> {
    let to = cx.task(&asked.net).await?;
    let set = breakpoints(cx, &to).await?;
    let order = meant(asked, &set)?;
    let by = cx.name().to_owned();
    let done = cx.call(&to, Control { order, by }).deadline(LIMIT).await;
    hub.breakpoints(&asked.net, breakpoints(cx, &to).await?);
    Ok(done?)
}

/// The breakpoints of a net.
pub(super) async fn breakpoints(
    cx: &Context,
    net: &TaskRef,
) -> Result<Vec<Breakpoint>, HandlerError> {
    let snapshot = cx.call(net, Marking {}).deadline(LIMIT).await?;
    Ok(snapshot.breakpoints.into_iter().map(breakpoint).collect())
}

/// A breakpoint as it was written: `TRANSITION`, or `PLACE>=N` and the like.
fn breakpoint(at: String) -> Breakpoint {
    let end = at.find(['<', '>', '=']);
    let place = end
        .and_then(|end| at.get(..end))
        .map(|place| place.trim().to_owned());
    Breakpoint {
        transition: place.is_none().then(|| at.clone()),
        place,
        at,
    }
}

/// What a page means by what it asks; `set` are the net's breakpoints.
fn meant(asked: &Asked, set: &[Breakpoint]) -> Result<Order, HandlerError> {
    let transition = || asked.transition.clone().ok_or("which transition?");
    let place = || asked.place.clone().ok_or("which place?");
    Ok(match asked.kind.as_str() {
        "fire" => Order::Fire {
            transition: transition()?,
        },
        "put" => Order::Put {
            place: place()?,
            tokens: 1,
        },
        "take" => Order::Take {
            place: place()?,
            tokens: 1,
        },
        "cancel" => Order::Cancel {
            transition: transition()?,
        },
        "complete" => Order::Complete {
            transition: transition()?,
        },
        "pause" => Order::Pause,
        "resume" => Order::Resume,
        "step" => Order::Step { firings: 1 },
        // A place that gets a token is what a person waits for, who does not say more.
        "break" => Order::Break {
            at: match (&asked.transition, &asked.when) {
                (Some(transition), _) => transition.clone(),
                (None, Some(when)) => format!("{}{when}", place()?),
                (None, None) => format!("{}>=1", place()?),
            },
        },
        "clear" => {
            let same = |one: &&Breakpoint| match &asked.breakpoint {
                Some(at) => one.at == *at,
                None => (&one.transition, &one.place) == (&asked.transition, &asked.place),
            };
            let at = set.iter().find(same).map(|one| one.at.clone());
            Order::Clear {
                at: Some(at.ok_or("there is no such breakpoint")?),
            }
        }
        other => {
            return Err(HandlerError::new(format!(
                "nothing is called `{other}` here"
            )));
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn asked(text: &str) -> Asked {
        serde_json::from_str(text).unwrap()
    }

    #[test]
    fn what_a_page_asks_is_an_order_or_is_refused_in_words() {
        let set = [breakpoint("t".to_owned()), breakpoint("p>=1".to_owned())];
        let order = |text: &str| meant(&asked(text), &set).map_err(|error| error.to_string());
        assert_eq!(
            order(r#"{"kind":"break","net":"n","place":"p"}"#),
            Ok(Order::Break {
                at: "p>=1".to_owned()
            })
        );
        assert_eq!(
            order(r#"{"kind":"break","net":"n","place":"p","when":"<=3"}"#),
            Ok(Order::Break {
                at: "p<=3".to_owned()
            })
        );
        assert_eq!(
            order(r#"{"kind":"clear","net":"n","breakpoint":"p>=1"}"#),
            Ok(Order::Clear {
                at: Some("p>=1".to_owned())
            })
        );
        assert!(order(r#"{"kind":"clear","net":"n","breakpoint":"p>=2"}"#).is_err());
        assert_eq!(
            order(r#"{"kind":"clear","net":"n","place":"p"}"#),
            Ok(Order::Clear {
                at: Some("p>=1".to_owned())
            })
        );
        assert_eq!(
            order(r#"{"kind":"clear","net":"n","transition":"t"}"#),
            Ok(Order::Clear {
                at: Some("t".to_owned())
            })
        );
        assert_eq!(
            order(r#"{"kind":"fire","net":"n"}"#),
            Err("which transition?".to_owned())
        );
        assert!(order(r#"{"kind":"clear","net":"n","transition":"u"}"#).is_err());
        assert!(order(r#"{"kind":"explode","net":"n"}"#).is_err());
    }
}

//! The seam to other daemons: what carries requests, and waits. This crate's own carrier over tasks is
//! in [`crate::daemon`]; a program of one process needs none.

use crate::name::Location;
use crate::raise;
use crate::report::{Report, code};
use crate::request::Request;
use crate::transport::Transport;
use ctos::message::CommandInfo;
use futures_util::future::LocalBoxFuture;
use std::time::Duration;

/// What reaches other daemons (the report's COMM and its connection objects, sections 1.4.1 and 1.4.3).
pub trait Comm {
    /// Has the daemon at `at` meet a request, whose name is a local one there. What the object
    /// answers, errors of its own among it, is an `Ok`.
    ///
    /// An `Err` says why there is no answer. Whether the request was executed is then not known; it is
    /// never executed twice unless the caller has said that this does no harm.
    fn ask<'a>(
        &'a self,
        at: &'a Location,
        request: Request,
    ) -> LocalBoxFuture<'a, Result<Transport, Report>>;

    /// Waits.
    fn sleep(&self, time: Duration) -> LocalBoxFuture<'_, ()>;

    /// Whether there is an app with tasks.
    fn is_in_app(&self) -> bool {
        false
    }

    /// Asks a task of the app, in the encoding of messages between processes.
    fn call_task<'a>(
        &'a self,
        task: &'a str,
        command: CommandInfo,
        data: Vec<u8>,
        deadline: Duration,
    ) -> LocalBoxFuture<'a, Result<Vec<u8>, Report>> {
        let _ = (data, deadline);
        Box::pin(async move {
            Err(raise!(
                code::DAEMON,
                "`{}` of task `{task}`: there is no app here; ask in one that runs",
                command.name
            ))
        })
    }
}

/// Reaches nobody.
#[derive(Debug, Clone, Copy, Default)]
pub struct Alone;

impl Comm for Alone {
    fn ask<'a>(
        &'a self,
        at: &'a Location,
        request: Request,
    ) -> LocalBoxFuture<'a, Result<Transport, Report>> {
        Box::pin(async move { Err(unreachable(at, &request)) })
    }

    fn sleep(&self, _time: Duration) -> LocalBoxFuture<'_, ()> {
        Box::pin(std::future::ready(()))
    }
}

fn unreachable(at: &Location, request: &Request) -> Report {
    let name = request.name.local();
    match at {
        Location::Alias(alias) => raise!(
            code::DAEMON,
            "`{name}@{alias}`: this process reaches no other daemon, and the dictionary does not say that `{alias}` \
             is itself; add a line `{alias} self`, or ask in an app that runs"
        ),
        _ => raise!(
            code::DAEMON,
            "`{name}` is served by another daemon, and this process has no link to it"
        ),
    }
}

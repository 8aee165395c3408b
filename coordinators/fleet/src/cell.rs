//! The functions of a cell's net. The net says what follows what; a stand-in does each step and takes its time.
//!
//! - `step`: the step that is called like the transition, done by the device that the file of times names;
//! - `permit`: whether what cannot be undone may begin;
//! - `set_down`: the step of that name, while the lease holds. What it did is not known when it fails;
//! - `settle`: nothing more happens for this job; succeeds if the disc lies where it shall.

use std::{cell::OnceCell, future::Future, pin::Pin, rc::Rc, sync::Arc, time::Duration};

use ctos::{
    registry::Registry,
    task::{Context, HandlerError},
};
use pnt::library::{Acted, Action, Library};
use serde::Deserialize;

use crate::{
    agent::ask,
    stand_in::Times,
    wire::{Do, Holds, JobNumber, MayBegin, Settle},
};

/// The handler's name.
pub const HANDLER: &str = "fleet.cell";

/// The wait before a device that did not answer is asked again.
const AGAIN: Duration = Duration::from_millis(500);

/// How long the agent may take for a yes or no: as long as any lease.
const PERMITTED_WITHIN: Duration = Duration::from_secs(3600);

/// The step that changes the board.
const SET_DOWN: &str = "set_down";

/// What a function of the library returns.
type Later = Pin<Box<dyn Future<Output = Acted>>>;

/// Arguments, besides those of every net.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Args {
    /// The cell: what the names of its tasks begin with.
    cell: String,
    /// The file of times.
    times: String,
    /// The task that holds the leases.
    agent: String,
    /// What the file says, once a step has read it.
    #[serde(skip)]
    read: OnceCell<Arc<Times>>,
}

impl Args {
    fn times(&self, cx: &Context) -> Result<&Times, HandlerError> {
        let read = match self.read.get() {
            Some(read) => read,
            None => {
                let times = Times::shared(cx, &self.times)?;
                self.read.get_or_init(|| times)
            }
        };
        Ok(read)
    }
}

/// Registers the handler.
pub(crate) fn register(registry: &mut Registry) {
    pnt::task::register_with::<Args, ()>(registry, HANDLER, library);
}

fn library(args: Args) -> Library<()> {
    let args = Rc::new(args);
    let with = |function: fn(Action<()>, Rc<Args>) -> Later| {
        let args = Rc::clone(&args);
        move |action| function(action, Rc::clone(&args))
    };
    Library::new(())
        .action("step", with(|action, args| Box::pin(step(action, args))))
        .action(
            "permit",
            with(|action, args| Box::pin(permit(action, args))),
        )
        .action(
            SET_DOWN,
            with(|action, args| Box::pin(set_down(action, args))),
        )
        .action(
            "settle",
            with(|action, args| Box::pin(settle(action, args))),
        )
}

/// Number and epoch of the job in progress.
fn job(action: &Action<()>) -> Result<(JobNumber, u64), HandlerError> {
    match action.arguments() {
        [job, epoch, ..] => Ok((job.parse()?, epoch.parse()?)),
        _ => Err("a command of a cell comes with the number of a job and an epoch".into()),
    }
}

async fn step(action: Action<()>, args: Rc<Args>) -> Acted {
    let name = action.transition().to_owned();
    done(&action, &args, &name).await
}

/// Has the device do a step.
async fn done(action: &Action<()>, args: &Args, step: &str) -> Acted {
    let (cx, (job, epoch)) = (action.cx(), job(action)?);
    let known = args.times(cx)?.step.get(step);
    let known = known.ok_or_else(|| format!("no time was recorded for the step `{step}`"))?;
    let device = format!("{}.{}", args.cell, known.by);
    let request = Do {
        step: step.to_owned(),
        job,
        epoch,
    };
    let within = Duration::from_secs_f64(known.most_s) + Duration::from_secs(10);
    match ask(cx, &device, request, within).await? {
        true => Ok(()),
        false => Err(format!("{step} failed").into()),
    }
}

async fn permit(action: Action<()>, args: Rc<Args>) -> Acted {
    let (_, epoch) = job(&action)?;
    match ask(
        action.cx(),
        &args.agent,
        MayBegin { epoch },
        PERMITTED_WITHIN,
    )
    .await?
    {
        true => Ok(()),
        false => Err("the lease has ended".into()),
    }
}

async fn set_down(action: Action<()>, args: Rc<Args>) -> Acted {
    let (_, epoch) = job(&action)?;
    match ask(action.cx(), &args.agent, Holds { epoch }, PERMITTED_WITHIN).await? {
        true => done(&action, &args, SET_DOWN).await,
        false => Err("the lease has ended".into()),
    }
}

async fn settle(action: Action<()>, args: Rc<Args>) -> Acted {
    let (cx, (job, epoch)) = (action.cx(), job(&action)?);
    let known = args.times(cx)?.step.get(SET_DOWN);
    let by = known.map_or("hand", |known| known.by.as_str());
    let device = format!("{}.{by}", args.cell);
    loop {
        match ask(cx, &device, Settle { job, epoch }, AGAIN * 10).await {
            Ok(true) => return Ok(()),
            Ok(false) => return Err("the disc does not lie where it shall".into()),
            Err(_) => cx.sleep(AGAIN).await,
        }
    }
}

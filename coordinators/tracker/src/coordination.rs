//! The net in front of the tracker: what its actions do. People put orders on its tape, druide what happens; the answers say what
//! druide does next. Each action has druide do something, and ends when that is done.

use std::time::Duration;

use ctos::{
    message::Command,
    registry::Registry,
    task::{Context, HandlerError},
};
use pnt::{
    library::{Acted, Action, Library},
    task::{PutTape, TapeAnswer, register_with},
};
use serde::Deserialize;

use crate::wire::{LetGo, ResumeTracking, StartGrasp, StartLearning, StartTracking, StopTracking};

/// The handler's name.
pub const HANDLER: &str = "tracker.tracking";

/// How long taking the arm, and giving it back, may take; a command waits for the one before.
pub const CHANGE: Duration = Duration::from_secs(40);

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct TrackingArgs {
    /// The task that moves the arm.
    #[serde(default = "druide_task")]
    druide: String,
}

fn druide_task() -> String {
    "druide".to_owned()
}

/// The task of the net, unless arguments say otherwise.
pub(crate) fn net_task() -> String {
    "tracking".to_owned()
}

type Act = Action<TrackingArgs>;

/// Registers the handler.
pub(crate) fn register(registry: &mut Registry) {
    register_with(registry, HANDLER, |args: TrackingArgs| {
        Library::new(args)
            .action("begin", |action| druide(action, StartTracking {}))
            .action("give_back", |action| druide(action, StopTracking {}))
            .action("take_again", |action| druide(action, ResumeTracking {}))
            .action("learn", |action| druide(action, StartLearning {}))
            .action("grasp", |action| druide(action, StartGrasp {}))
            .action("let_go", |action| druide(action, LetGo {}))
    });
}

/// Has druide do something.
async fn druide<C: Command<Reply = ()> + 'static>(action: Act, command: C) -> Acted {
    let name = action.with_state(|args| args.druide.clone());
    let cx = action.cx();
    let druide = cx.task(&name).await?;
    cx.call(&druide, command).deadline(CHANGE).await?;
    Ok(())
}

/// Puts a symbol on the net's tape, and waits for the answer.
///
/// # Errors
/// The net is gone, or has stopped.
pub async fn ask(cx: &Context, net: &str, symbol: &str) -> Result<TapeAnswer, HandlerError> {
    let net = cx.task(net).await?;
    let put = PutTape {
        symbol: symbol.to_owned(),
        arguments: Vec::new(),
    };
    Ok(cx.call(&net, put).deadline(CHANGE).await?)
}

#[cfg(test)]
mod tests {
    use std::{path::Path, sync::Arc};

    use pnt::{
        check::{self, Limits},
        task,
    };

    const NET: &str = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../configs/nets/tracker/tracking.net"
    );

    #[test]
    fn the_net_is_bounded_has_no_deadlock_and_answers_everything() {
        let net = task::load(Path::new(NET)).unwrap_or_else(|found| panic!("{found}"));
        let (report, findings) = check::check(&[Arc::new(net)], &Limits::default());
        assert!(findings.is_empty(), "{findings}");
        assert!(report.proved, "{report:?}");
    }
}

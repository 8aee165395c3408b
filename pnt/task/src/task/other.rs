//! Another net, as the app says it is: whether it survives its process, and whether a call to it that failed may
//! succeed later.

use ctos::{
    call::{CallError, Fault},
    task::Context,
};

use super::settings::settings;

/// Why transfers were not taken.
pub(super) enum Failed {
    /// They may be taken when they are sent again.
    NotNow,
    /// They never will.
    Never(String),
}

/// Whether the net of a task goes on where it was when its process has died.
pub(super) fn is_durable(cx: &Context, net: &str) -> bool {
    // One at another site is not gone when it does not answer. Only durable ones should be asked from there.
    if net.contains('@') {
        return true;
    }
    let task = cx.app().task(net);
    task.is_some_and(|task| settings(task).is_ok_and(|settings| settings.durable))
}

/// Whether a call that failed may succeed when it is made again. A net that is not durable has lost its
/// marking with its handler: sending it more would only hide that.
pub(super) fn may_succeed(error: &CallError, durable: bool) -> Failed {
    match error.fault {
        Fault::Refused { .. } | Fault::BadPayload { .. } | Fault::UnknownCommand { .. } => {
            Failed::Never(error.to_string())
        }
        Fault::PeerDown { .. } | Fault::UnknownTask | Fault::Stopping | Fault::Panicked { .. }
            if !durable =>
        {
            Failed::Never(error.to_string())
        }
        _ => Failed::NotNow,
    }
}

//! How the app stands as a whole: its chassis, and the last warnings of its log. The process that booted the app tells both, as
//! `ctos ps` and `ctos logs --level warn` do.

use std::{sync::Arc, time::Duration};

use ctos::{
    boot::ChassisState,
    control::{
        Level, LogLine,
        protocol::{Answer, ChassisView, LogRequest, Request, TaskView},
    },
    task::Context,
};

use super::{
    hub::Hub,
    lines,
    wire::{ChassisStanding, Load, Standing},
};
use cli_common::client::{Client, ClientError};

/// How often the app is asked, as long as somebody looks.
const EVERY: Duration = Duration::from_secs(1);
/// So many warnings are told, the last ones.
pub(super) const MOST: usize = 100;

/// Tells the hub how the app stands, for good. Of an app that was booted from another host nothing is told.
pub(super) async fn follow(cx: &Context, hub: &Arc<Hub>) {
    loop {
        if hub.is_watched()
            && let Some((loads, standing)) = lines::asked(ask).await
        {
            hub.loaded(cx.now().as_nanos(), &loads);
            hub.stands(standing);
        }
        cx.sleep(EVERY).await;
    }
}

fn ask(client: &mut Client) -> Result<(Vec<Load>, Standing), ClientError> {
    let (loads, chassis) = match client.get(Request::Ps {})? {
        Answer::App(app) => (
            app.tasks.iter().map(load).collect(),
            app.chassis.iter().map(ChassisStanding::of).collect(),
        ),
        _ => (Vec::new(), Vec::new()),
    };
    let wanted = LogRequest {
        level: Some(Level::Warn),
        last: Some(MOST),
        ..LogRequest::default()
    };
    let warnings = lines::logs(client, wanted)?;
    let warning = |line: &LogLine| lines::told(line).warning(line.chassis.clone());
    let warnings = warnings.iter().filter_map(warning).collect();
    Ok((loads, Standing { chassis, warnings }))
}

fn load(task: &TaskView) -> Load {
    let waiting = task.urgent + task.queued + task.senders_waiting;
    (task.name.clone(), waiting, task.handled, task.busy_s)
}

impl ChassisStanding {
    fn of(chassis: &ChassisView) -> Self {
        let mut state = chassis.state.to_string();
        if !chassis.answers {
            state.push_str(", no answer");
        }
        Self {
            name: chassis.name.clone(),
            state,
            fine: chassis.answers && chassis.state == ChassisState::Up,
            restarts: chassis.restarts,
            last_end: chassis.last_end.clone(),
            tasks: chassis.tasks,
        }
    }
}

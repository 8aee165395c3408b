//! One app from its first phase to its last stop.

use std::{collections::BTreeMap, rc::Rc};

use futures_util::future::{Either, pending, select};

use crate::bootstrap::{
    BootEvent, ChassisState, End, ProcessOrder, StopStep,
    board::{Board, Event},
    states::{BootStep, ChassisStep},
};
use ctos_core::{phase::Phase, system::News};

/// Boots the app, waits for its end and takes it down.
pub(super) async fn run(board: Rc<Board>) {
    let end = {
        let phases = std::pin::pin!(phases(&board));
        let ended = std::pin::pin!(board.next_end());
        match select(phases, ended).await {
            Either::Left((Err(end), _)) => end,
            Either::Left((Ok(()), ended)) => ended.await,
            Either::Right((end, _)) => end,
        }
    };
    stop(&board, &end).await;
    board.step(BootStep::AtRest);
    board.leave(end);
    board.cx.chassis().exit(0);
}

async fn phases(board: &Board) -> Result<(), End> {
    for phase in Phase::ALL {
        let began = board.cx.now();
        board.aim_at(phase);
        let reached = board.all_reach(phase).await;
        reached.map_err(|failures| End::PhaseFailed { phase, failures })?;
        if board.has_failed() {
            // That ends the app, and it came before the last acknowledgement was seen.
            return pending().await;
        }
        board.step(BootStep::Acknowledged);
        if board.is_up() {
            board.tell_names(News::AppUp);
        }
        board.event(&BootEvent::PhaseDone {
            phase,
            tasks: board.tasks().len(),
            took: board.cx.now().since(began),
        });
    }
    Ok(())
}

/// Lets all tasks come to rest. Then stops them, those of chassis with `stop_first` before the others, each group
/// in the reverse order of creation. Then ends the processes.
async fn stop(board: &Board, end: &End) {
    board.step(BootStep::End);
    let reason = end.reason();
    board.tell_names(News::Stopping);
    for member in &board.members {
        let state = member.report.borrow().state;
        board.step_chassis(member, ChassisStep::Stop);
        member.tell(Event::Stop);
        // One that is just being started has no tasks yet, and nobody can ask it to end.
        if state == ChassisState::Starting && !board.cx.chassis().is_linked(member.index) {
            board.order(ProcessOrder::Kill(member.index));
        }
    }
    board.event(&BootEvent::Stopping {
        reason: reason.to_string(),
    });
    // An app that is to end at a breakpoint ends there: nothing more is fired.
    if !matches!(end, End::Breakpoint { .. }) {
        board.quiesce(&reason).await;
    }
    let tasks = board.tasks();
    if !tasks.is_empty() {
        let step = StopStep::Tasks;
        board.event(&BootEvent::StopStep { step });
    }
    let (first, rest): (Vec<_>, Vec<_>) =
        tasks.iter().rev().partition(|task| board.stops_first(task));
    let mut at_rest = BTreeMap::new();
    for task in first {
        let chassis = board.place_of(task);
        let stopped = board.stop_task_or_skip(task, &reason).await;
        *at_rest.entry(chassis).or_insert(true) &= stopped;
    }
    for (chassis, _) in at_rest.into_iter().filter(|(_, stopped)| *stopped) {
        let chassis = board.cx.chassis().name_of(chassis).to_owned();
        board.event(&BootEvent::AtRest { chassis });
    }
    for task in rest {
        board.stop_task_or_skip(task, &reason).await;
    }
    let step = StopStep::Processes;
    board.event(&BootEvent::StopStep { step });
    let code = i32::from(!matches!(end, End::Finished(result) if result.ok));
    for member in &board.members {
        board.exit_chassis(member.index, code).await;
    }
}

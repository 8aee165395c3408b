//! A Dispatcher that makes one data object of the arguments of a command, has its Coordinator do the rest, and tells what became
//! of it.

use std::rc::Rc;

use ctos::task::HandlerError;
use pnt::library::{Acted, Action, Library};
use serde::{Serialize, de::DeserializeOwned};

use crate::dom::DomStore;

/// The arguments of such a Dispatcher, and what it makes of a command.
pub(crate) trait Orders: 'static {
    /// What the Coordinator is given,
    type Order: Serialize;
    /// under this name in the DOM,
    const ORDER: &'static str;
    /// and what it tells,
    type Account: Told;
    /// under this name.
    const ACCOUNT: &'static str;

    /// The order of a command with its number, from 1.
    ///
    /// # Errors
    /// Why the arguments make none.
    fn order(&self, command: u32, arguments: &[String]) -> Result<Self::Order, HandlerError>;
}

/// How a Coordinator tells what became of a command.
pub(crate) trait Told: DeserializeOwned {
    /// The command's number.
    fn command(&self) -> u32;

    /// What there is to say of it, line by line.
    fn lines(&self) -> Vec<String>;
}

/// What the functions share.
pub(crate) struct Dispatcher<A> {
    args: Rc<A>,
    store: DomStore,
    /// Number of the command in work, from 1.
    command: u32,
}

/// The functions `begin` and `report`.
pub(crate) fn library<A: Orders>(args: A, store: DomStore) -> Library<Dispatcher<A>> {
    let state = Dispatcher {
        args: Rc::new(args),
        store,
        command: 0,
    };
    Library::new(state)
        .kept(
            |state| state.command,
            |state, command| state.command = command,
        )
        .action("begin", begin)
        .action("report", report)
}

/// Reads a command, and makes the order of it. Why it makes none goes into the answer.
async fn begin<A: Orders>(action: Action<Dispatcher<A>>) -> Acted {
    let cx = action.cx().clone();
    let (args, store, command) = action.with_state(|state| {
        let next = state.command.wrapping_add(1);
        (state.args.clone(), state.store.clone(), next)
    });
    let began = match args.order(command, action.arguments()) {
        Ok(order) => store.store(&cx, A::ORDER, &order).await,
        Err(error) => {
            action.note(error.to_string());
            Err(error)
        }
    };
    // What an action changes, it changes at its end: a process that dies before that begins it again.
    action.with_state(|state| state.command = command);
    began
}

/// Tells, in the answer, what the Coordinator has to say.
async fn report<A: Orders>(action: Action<Dispatcher<A>>) -> Acted {
    let (store, command) = action.with_state(|state| (state.store.clone(), state.command));
    if let Ok(account) = store.fetch::<A::Account>(action.cx(), A::ACCOUNT).await
        && account.command() == command
    {
        for line in account.lines() {
            action.note(line);
        }
    }
    Ok(())
}

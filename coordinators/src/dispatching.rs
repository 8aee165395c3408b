//! What Dispatchers have in common: how they tell whoever sent a command why it was not done. And a Dispatcher that makes one data
//! object of the arguments of a command, has its Coordinator do the rest, and tells what became of it.

use std::rc::Rc;

use ctos::task::{Context, HandlerError};
use pnt::library::{Acted, Action, Library};
use serde::{Serialize, de::DeserializeOwned};

use crate::{
    dom::DomStore,
    organization::{TAG, WHY, Why},
    outcome::{Failure, Outcome},
};

/// The tag of a command, and its other arguments.
pub(crate) fn tagged(arguments: &[String]) -> (String, Vec<String>) {
    let (tags, words): (Vec<_>, Vec<_>) = arguments
        .iter()
        .cloned()
        .partition(|word| word.starts_with(TAG));
    let tag = tags.first().and_then(|word| word.strip_prefix(TAG));
    (tag.unwrap_or_default().to_owned(), words)
}

/// Tells whoever sent the command with a tag, by types, what was in its way.
pub(crate) async fn tell(cx: &Context, store: &DomStore, tag: String, failures: Vec<Failure>) {
    if let Err(untold) = store.store(cx, WHY, &Why { tag, failures }).await {
        tracing::warn!(%untold, "why a command was not done could not be told by types");
    }
}

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

    /// What was in the way, in the order of time.
    fn failures(&self) -> Vec<Failure>;
}

/// What the functions share.
pub(crate) struct Dispatcher<A> {
    args: Rc<A>,
    store: DomStore,
    /// Number of the command in work, from 1, and what its sender calls it.
    command: u32,
    tag: String,
}

/// The functions `begin` and `report`.
pub(crate) fn library<A: Orders>(args: A, store: DomStore) -> Library<Dispatcher<A>> {
    let state = Dispatcher {
        args: Rc::new(args),
        store,
        command: 0,
        tag: String::new(),
    };
    Library::new(state)
        .kept(
            |state| (state.command, state.tag.clone()),
            |state, kept| (state.command, state.tag) = kept,
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
    let (tag, words) = tagged(action.arguments());
    let began = match args.order(command, &words) {
        Ok(order) => store.store(&cx, A::ORDER, &order).await,
        Err(error) => {
            action.note(error.to_string());
            let refused = Failure::new(Outcome::Refused, &error);
            tell(&cx, &store, tag.clone(), vec![refused]).await;
            Err(error)
        }
    };
    // What an action changes, it changes at its end: a process that dies before that begins it again.
    action.with_state(|state| (state.command, state.tag) = (command, tag));
    began
}

/// Tells, in the answer and by types, what the Coordinator has to say.
async fn report<A: Orders>(action: Action<Dispatcher<A>>) -> Acted {
    let (store, command, tag) =
        action.with_state(|state| (state.store.clone(), state.command, state.tag.clone()));
    if let Ok(account) = store.fetch::<A::Account>(action.cx(), A::ACCOUNT).await
        && account.command() == command
    {
        for line in account.lines() {
            action.note(line);
        }
        tell(action.cx(), &store, tag, account.failures()).await;
    }
    Ok(())
}

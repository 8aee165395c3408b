//! The functions that a net names: actions and enabling functions over one state. Knows no net and
//! no robot; a coordinator is a net and a library.

use std::{
    cell::RefCell,
    collections::{BTreeMap, BTreeSet},
    future::Future,
    pin::Pin,
    rc::Rc,
    time::Duration,
};

use ctos::{
    message::{Data, DataType},
    task::{Context, HandlerError},
};
use serde::{Serialize, de::DeserializeOwned};

use pnt_analysis::check::FunctionNames;
use pnt_language::{data::Value, net::Line};

/// Something that ends later, on the task's processor.
pub type Later<T> = Pin<Box<dyn Future<Output = T>>>;

/// How an action ends; an error takes the failure branch, and the waiting caller gets it.
pub type Acted = Result<(), HandlerError>;

type Act = Rc<dyn Fn(Action<()>) -> Later<Acted>>;
type Call = Rc<dyn Fn(Action<()>, Vec<u8>) -> Later<Result<Vec<u8>, HandlerError>>>;
type Ask = Box<dyn Fn() -> bool>;
type Change = Box<dyn Fn()>;
type Save = Box<dyn Fn() -> postcard::Result<Vec<u8>>>;
type Load = Box<dyn Fn(&[u8]) -> postcard::Result<()>>;

/// What a service object has answered.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Answer {
    /// Its text.
    pub text: String,
    /// Its floats.
    pub floats: Vec<f64>,
    /// Its whole numbers.
    pub ints: Vec<i64>,
}

/// Makes the requests of a net's `request` lines.
pub trait Requests {
    /// Asks what a line says. `values` are those that stand in it, in order; they are data, and never text to be
    /// read again.
    fn ask(
        &self,
        cx: &Context,
        line: &Line,
        values: Vec<Value>,
        limit: Duration,
    ) -> Later<Result<Answer, HandlerError>>;
}

/// Where data objects are kept. An app's data object manager task stands behind it.
pub trait DataStore {
    /// The bytes of an object.
    fn get(&self, cx: &Context, object: &str) -> Later<Result<Vec<u8>, HandlerError>>;
    /// Stores objects, by name: all of them or, where one is refused, none.
    fn put(&self, cx: &Context, objects: Vec<(String, Vec<u8>)>) -> Later<Acted>;
    /// Says that an object is valid, or no longer, because its place says so.
    fn validity(&self, cx: &Context, object: &str, valid: bool) -> Later<Acted>;
}

/// The command in progress when an action began.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CommandLine {
    /// The input tape symbol.
    pub symbol: String,
    /// What came with it.
    pub arguments: Vec<String>,
}

/// What an action can reach.
pub struct Action<S> {
    pub(crate) cx: Context,
    pub(crate) state: Rc<RefCell<S>>,
    pub(crate) transition: Rc<str>,
    pub(crate) command: Option<CommandLine>,
    pub(crate) data: Option<Rc<dyn DataStore>>,
    pub(crate) notes: Rc<RefCell<Vec<String>>>,
}

impl Action<()> {
    /// The same for a function with a state.
    fn over<S>(self, state: &Rc<RefCell<S>>) -> Action<S> {
        Action {
            cx: self.cx,
            state: Rc::clone(state),
            transition: self.transition,
            command: self.command,
            data: self.data,
            notes: self.notes,
        }
    }
}

impl<S> Action<S> {
    /// The net's task: other tasks, time, randomness, arguments.
    #[must_use]
    pub fn cx(&self) -> &Context {
        &self.cx
    }

    /// Reads or changes the library's state, which actions that run at the same time share. Panics
    /// when called inside itself.
    pub fn with_state<T>(&self, use_it: impl FnOnce(&mut S) -> T) -> T {
        use_it(&mut self.state.borrow_mut())
    }

    /// The transition whose action this is.
    #[must_use]
    pub fn transition(&self) -> &str {
        &self.transition
    }

    /// Whether the app is being stopped: what has begun may end, and nothing more is to be tried. An action that
    /// has not ended when nine tenths of `app.stop_timeout_s` are over is cancelled, as by `within`.
    #[must_use]
    pub fn is_stopping(&self) -> bool {
        self.cx.is_stopping()
    }

    /// The command in progress when the action began.
    #[must_use]
    pub fn command(&self) -> Option<&CommandLine> {
        self.command.as_ref()
    }

    /// The arguments of the command in progress.
    #[must_use]
    pub fn arguments(&self) -> &[String] {
        self.command
            .as_ref()
            .map_or(&[], |command| &command.arguments)
    }

    /// Adds a line to the text of the answer to the command in progress, if there is one.
    pub fn note(&self, line: impl Into<String>) {
        self.notes.borrow_mut().push(line.into());
    }

    /// The bytes of a data object.
    ///
    /// # Errors
    /// The store's, or that this net has none.
    pub async fn get_data(&self, object: &str) -> Result<Vec<u8>, HandlerError> {
        self.store()?.get(&self.cx, object).await
    }

    /// Stores a data object.
    ///
    /// # Errors
    /// The store's, or that this net has none.
    pub async fn put_data(&self, object: &str, bytes: Vec<u8>) -> Acted {
        self.put_all_data(vec![(object.to_owned(), bytes)]).await
    }

    /// Stores several data objects, all or none.
    ///
    /// # Errors
    /// The store's, or that this net has none; then nothing was stored.
    pub async fn put_all_data(&self, objects: Vec<(String, Vec<u8>)>) -> Acted {
        self.store()?.put(&self.cx, objects).await
    }

    fn store(&self) -> Result<&Rc<dyn DataStore>, HandlerError> {
        let none = || HandlerError::new("this net was given no store for data objects");
        self.data.as_ref().ok_or_else(none)
    }
}

impl<S> Clone for Action<S> {
    fn clone(&self) -> Self {
        Self {
            cx: self.cx.clone(),
            state: Rc::clone(&self.state),
            transition: Rc::clone(&self.transition),
            command: self.command.clone(),
            data: self.data.clone(),
            notes: Rc::clone(&self.notes),
        }
    }
}

/// A local function.
#[derive(Clone)]
pub(crate) enum Local {
    /// It reads and stores what it likes.
    Plain(Act),
    /// From the bytes of its argument to those of its result.
    Typed {
        call: Call,
        argument: DataType,
        result: DataType,
    },
}

/// Functions by the names that nets use, and the state they share.
pub struct Library<S> {
    state: Rc<RefCell<S>>,
    pub(crate) functions: Functions,
}

/// What a library's net sees of it: functions that hold their state, whatever its type is. So what runs a net is
/// compiled once, and not for each library.
pub(crate) struct Functions {
    actions: BTreeMap<String, Local>,
    enabling: BTreeMap<String, Ask>,
    kept: Option<(Save, Load)>,
    stopping: Option<Change>,
    stateless: bool,
    pub(crate) requests: Option<Rc<dyn Requests>>,
}

impl<S: 'static> Library<S> {
    /// A library without functions.
    #[must_use]
    pub fn new(state: S) -> Self {
        Self {
            state: Rc::new(RefCell::new(state)),
            functions: Functions {
                actions: BTreeMap::new(),
                enabling: BTreeMap::new(),
                kept: None,
                stopping: None,
                stateless: size_of::<S>() == 0,
                requests: None,
            },
        }
    }

    /// Adds a local function for `do` lines. It may wait; other transitions fire meanwhile.
    #[must_use]
    pub fn action<F, Fut>(mut self, name: &str, function: F) -> Self
    where
        F: Fn(Action<S>) -> Fut + 'static,
        Fut: Future<Output = Acted> + 'static,
    {
        let state = Rc::clone(&self.state);
        let act: Act = Rc::new(move |action| Box::pin(function(action.over(&state))));
        let actions = &mut self.functions.actions;
        actions.insert(name.to_owned(), Local::Plain(act));
        self
    }

    /// Adds a local function for `do` lines that name data objects. `do NAME(A, B -> C, D)` calls it with the
    /// fields `A` and `B` of its argument and stores the fields of its result as `C` and `D`. It may wait;
    /// when it fails, nothing is stored.
    #[must_use]
    pub fn function<A, R, F, Fut>(mut self, name: &str, function: F) -> Self
    where
        A: Serialize + DeserializeOwned + 'static,
        R: Serialize + DeserializeOwned + 'static,
        F: Fn(Action<S>, A) -> Fut + 'static,
        Fut: Future<Output = Result<R, HandlerError>> + 'static,
    {
        let (state, function) = (Rc::clone(&self.state), Rc::new(function));
        let call: Call = Rc::new(move |action, bytes| {
            let (action, function) = (action.over(&state), Rc::clone(&function));
            Box::pin(async move {
                let result = function(action, Data::Bytes(bytes).take::<A>()?).await?;
                Ok(postcard::to_stdvec(&result)?)
            })
        });
        let typed = Local::Typed {
            call,
            argument: DataType::of::<A>(),
            result: DataType::of::<R>(),
        };
        self.functions.actions.insert(name.to_owned(), typed);
        self
    }

    /// Adds an enabling function for `when` lines. It is asked whenever something changes, so it
    /// must be quick and depend on the state only.
    #[must_use]
    pub fn enabling(mut self, name: &str, function: impl Fn(&S) -> bool + 'static) -> Self {
        let state = Rc::clone(&self.state);
        let ask: Ask = Box::new(move || function(&state.borrow()));
        self.functions.enabling.insert(name.to_owned(), ask);
        self
    }

    /// Changes the state when the app is about to be stopped. So enabling functions may lead a command that is in
    /// work to its end: no more positions, say.
    #[must_use]
    pub fn when_stopping(mut self, change: impl Fn(&mut S) + 'static) -> Self {
        let state = Rc::clone(&self.state);
        self.functions.stopping = Some(Box::new(move || change(&mut state.borrow_mut())));
        self
    }

    /// Has the state stored with the marking of a durable net: `save` says what of it, `load` puts that
    /// back. It is stored as it is when a commit begins, also in the midst of an action.
    #[must_use]
    pub fn kept<K: Serialize + DeserializeOwned>(
        mut self,
        save: impl Fn(&S) -> K + 'static,
        load: impl Fn(&mut S, K) + 'static,
    ) -> Self {
        let state = Rc::clone(&self.state);
        let save: Save = Box::new(move || postcard::to_stdvec(&save(&state.borrow())));
        let state = Rc::clone(&self.state);
        let load: Load = Box::new(move |bytes| {
            load(&mut state.borrow_mut(), postcard::from_bytes(bytes)?);
            Ok(())
        });
        self.functions.kept = Some((save, load));
        self
    }

    /// Has `request` lines asked.
    #[must_use]
    pub fn requests(mut self, requests: impl Requests + 'static) -> Self {
        self.functions.requests = Some(Rc::new(requests));
        self
    }

    /// The names of all functions, for checking nets before anything starts.
    #[must_use]
    pub fn names(&self) -> FunctionNames {
        self.functions.names()
    }
}

impl Functions {
    /// The app is about to be stopped.
    pub(crate) fn stopping(&self) {
        if let Some(change) = &self.stopping {
            change();
        }
    }

    /// Whether a net with this library may be durable: its state is kept, or there is none.
    pub(crate) fn survives(&self) -> bool {
        self.kept.is_some() || self.stateless
    }

    /// The state in bytes, if it is kept.
    pub(crate) fn saved(&self) -> Result<Option<Vec<u8>>, HandlerError> {
        let kept = self.kept.as_ref();
        let saved = kept.map(|(save, _)| save());
        Ok(saved.transpose()?)
    }

    /// Takes up a state that was kept.
    pub(crate) fn restore(&self, bytes: &[u8]) -> Result<(), HandlerError> {
        if let Some((_, load)) = &self.kept {
            load(bytes)?;
        }
        Ok(())
    }

    pub(crate) fn names(&self) -> FunctionNames {
        let names = |keys: &mut dyn Iterator<Item = &String>| -> BTreeSet<String> {
            keys.cloned().collect()
        };
        FunctionNames {
            actions: names(&mut self.actions.keys()),
            enabling: names(&mut self.enabling.keys()),
            requests: self.requests.is_some(),
            typed: self
                .actions
                .iter()
                .filter_map(|(name, local)| match local {
                    Local::Plain(_) => None,
                    Local::Typed {
                        argument, result, ..
                    } => Some((name.clone(), (*argument, *result))),
                })
                .collect(),
        }
    }

    /// What an enabling function says; `None` when there is no such function.
    pub(crate) fn ask(&self, name: &str) -> Option<bool> {
        let function = self.enabling.get(name)?;
        Some(function())
    }

    /// A local function.
    pub(crate) fn local(&self, name: &str) -> Option<Local> {
        self.actions.get(name).cloned()
    }
}

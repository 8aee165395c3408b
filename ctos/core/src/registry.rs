//! Event handlers by the name that the configuration uses for them.

mod codes;
#[cfg(test)]
mod tests;
mod waiting;

use std::{
    collections::{BTreeMap, BTreeSet, btree_map},
    future::Future,
    rc::Rc,
    sync::Arc,
};

use crate::{
    chassis::{Chassis, Extension},
    context::Context,
    envelope::Message,
    handled::{Handled, HandlerError},
    handler::{Durable, EventHandler, Handover},
    keep::StateStore,
    runner::dynamic::{DynHandler, durable, passing, plain},
};
use ctos_config::{
    App, Entry, Node, TaskConfig,
    diagnostic::{Finding, Findings, Place},
};
use ctos_message::{ChassisNumber, Command, CommandInfo};
use ctos_time::Clock;
use serde::de::DeserializeOwned;

type Build = Arc<dyn Fn(&Context) -> Result<Box<dyn DynHandler>, HandlerError> + Send + Sync>;
type Declares = Box<dyn Fn(&TaskConfig, &App, &Registry) -> Vec<CommandInfo> + Send + Sync>;
type CheckTask = Box<dyn Fn(&TaskConfig, &App, &mut Findings) + Send + Sync>;
type CheckArgs = Box<dyn Fn(&Node, &TaskConfig, &App, &mut Findings) + Send + Sync>;
type WaitsFor = Box<dyn Fn(&TaskConfig) -> Vec<String> + Send + Sync>;
type Speaks = Box<dyn Fn(&TaskConfig) -> Vocabulary + Send + Sync>;
type CheckApp = Box<dyn Fn(&App, &Registry, &mut Findings) + Send + Sync>;

/// Names that the files of a task may use, by what they stand for.
pub type Vocabulary = BTreeMap<&'static str, BTreeSet<String>>;

/// What all tasks of a kind share: how to build their handlers, and which commands these take.
#[doc(hidden)]
pub struct Recipe {
    pub commands: Arc<[CommandInfo]>,
    pub build: Build,
}

impl Default for Recipe {
    /// For what takes no messages and is not built.
    fn default() -> Self {
        Self {
            commands: Arc::default(),
            build: Arc::new(|_| Err("it is not built".into())),
        }
    }
}

/// A kind of event handler: how to build one, which commands it takes, how to check its arguments.
pub struct HandlerKind {
    name: String,
    recipe: Arc<Recipe>,
    /// The keys that it reads by hand.
    keys: Vec<&'static str>,
    /// How the rest of its arguments is read, and what is found then; nobody reads them without it.
    args: Option<CheckArgs>,
    checks: Vec<CheckTask>,
    waits_for: Option<WaitsFor>,
    vocabulary: Option<Speaks>,
    /// What a task of this kind takes besides, as its arguments say.
    declares: Option<Declares>,
    /// Whether the state of such a handler can survive its process.
    durable: bool,
}

impl HandlerKind {
    /// Declares the words of its own that the files of a task of this kind may use, for editors.
    pub fn speaks(
        &mut self,
        words: impl Fn(&TaskConfig) -> Vocabulary + Send + Sync + 'static,
    ) -> &mut Self {
        self.vocabulary = Some(Box::new(words));
        self
    }

    /// The words of its own that the files of this task may use.
    #[must_use]
    pub fn vocabulary(&self, task: &TaskConfig) -> Vocabulary {
        let words = self.vocabulary.as_ref();
        words.map_or_else(Vocabulary::new, |words| words(task))
    }

    /// Declares which other tasks a task of this kind waits for before it has finished its startup:
    /// those whose answers its `phase` awaits. Tasks that wait for each other in a circle are found
    /// before anything starts.
    pub fn waits_for(
        &mut self,
        names: impl Fn(&TaskConfig) -> Vec<String> + Send + Sync + 'static,
    ) -> &mut Self {
        self.waits_for = Some(Box::new(names));
        self
    }

    /// The names of the tasks that `task` waits for in its startup, as far as that is declared.
    pub(crate) fn waits_for_names(&self, task: &TaskConfig) -> Vec<String> {
        let names = self.waits_for.as_ref().map(|names| names(task));
        names.unwrap_or_default()
    }

    /// The name in the configuration.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The commands it takes.
    #[must_use]
    pub fn commands(&self) -> &[CommandInfo] {
        &self.recipe.commands
    }

    /// The command called `name`.
    #[must_use]
    pub fn command(&self, name: &str) -> Option<CommandInfo> {
        let mut commands = self.commands().iter().copied();
        commands.find(|command| command.name == name)
    }

    /// Declares that each task of this kind takes commands of its own, which its arguments tell: those that `commands`
    /// returns, besides those of the kind. What is wrong with them is for a check to find; here they are left out.
    pub fn declares(
        &mut self,
        commands: impl Fn(&TaskConfig, &App, &Registry) -> Vec<CommandInfo> + Send + Sync + 'static,
    ) -> &mut Self {
        self.declares = Some(Box::new(commands));
        self
    }

    /// The commands that `task`, which is of this kind, takes.
    #[must_use]
    pub fn commands_of(
        &self,
        task: &TaskConfig,
        app: &App,
        registry: &Registry,
    ) -> Arc<[CommandInfo]> {
        let Some(declares) = &self.declares else {
            return self.recipe.commands.clone();
        };
        let own = self.commands().iter().copied();
        own.chain(declares(task, app, registry)).collect()
    }

    /// Declares what the arguments of a task of this kind are read as, by [`Context::args`]. What does not
    /// fit, and what nobody reads, is found before anything starts.
    pub fn args<T: DeserializeOwned + 'static>(&mut self) -> &mut Self {
        self.checked_args::<T>(|_, _, _, _| {})
    }

    /// The same, with a check of arguments that could be read, which sees their task and the rest of the app.
    pub fn checked_args<T: DeserializeOwned + 'static>(
        &mut self,
        check: impl Fn(&T, &TaskConfig, &App, &mut Findings) + Send + Sync + 'static,
    ) -> &mut Self {
        self.args = Some(Box::new(move |args, task, app, findings| {
            if let Some(args) = args.parse_all::<T>(findings) {
                check(&args, task, app, findings);
            }
        }));
        self
    }

    /// Declares keys of the arguments that the kind reads by hand, besides what [`Self::args`] declares.
    pub fn keys(&mut self, keys: &[&'static str]) -> &mut Self {
        self.keys.extend(keys);
        self
    }

    /// Adds a check of a task of this kind and the rest of the app that runs before anything starts. Arguments
    /// that nobody reads are found without such a check.
    pub fn check_in_app(
        &mut self,
        check: impl Fn(&TaskConfig, &App, &mut Findings) + Send + Sync + 'static,
    ) -> &mut Self {
        self.checks.push(Box::new(check));
        self
    }

    /// Checks a task of this kind. Whatever its own checks look at, a key that the kind has not declared is found.
    fn check_task(&self, task: &TaskConfig, app: &App, findings: &mut Findings) {
        match &self.args {
            Some(read) => read(&task.args.without(&self.keys), task, app, findings),
            None => unread_args(
                &task.args,
                &self.keys,
                Some(&task.place),
                |key| {
                    let (task, handler) = (&task.name, &self.name);
                    format!("task `{task}` gives `args.{key}`, and its event handler `{handler}`")
                },
                "the handler reads where it is registered: `registry.handler(..).args::<ItsArgs>()`",
                findings,
            ),
        }
        for check in &self.checks {
            check(task, app, findings);
        }
    }
}

/// Finds the keys of `args`, which stand at `at`, besides the declared `keys`: nobody reads them. `told` says who gives a
/// key to whom, and `declare` what can be declared and how.
pub fn unread_args(
    args: &Node,
    keys: &[&'static str],
    at: Option<&Place>,
    told: impl Fn(&str) -> String,
    declare: &str,
    findings: &mut Findings,
) {
    let declares = match keys {
        [] => "declares no arguments",
        _ => "does not read it",
    };
    for Entry { key, key_place, .. } in args.without(keys).entries() {
        let text = format!("{} {declares}", told(key));
        let finding = Finding::error("ctos::handler::unread_args", text)
            .label("nobody reads this key")
            .help(format!("leave it out; or declare what {declare}"))
            .suggest(key, keys.iter().copied());
        findings.push(match key_place.as_ref().or(at) {
            Some(place) => finding.at(place.clone()),
            None => finding,
        });
    }
}

/// Findings about a task that hold whatever the rest of its app is like. Those about a file that it names hold, too.
const OF_A_TASK: [&str; 9] = [
    "ctos::file::not_text",
    "ctos::file::unreadable",
    "ctos::config::not_durable",
    "ctos::config::unknown_handler",
    "ctos::config::unknown_key",
    "ctos::config::unknown_choice",
    "ctos::config::missing_key",
    "ctos::config::value",
    "ctos::handler::unread_args",
];

#[doc(hidden)]
impl HandlerKind {
    pub fn recipe(&self) -> Arc<Recipe> {
        self.recipe.clone()
    }

    /// That of one task, with the commands that it takes.
    pub fn recipe_of(&self, task: &TaskConfig, app: &App, registry: &Registry) -> Arc<Recipe> {
        if self.declares.is_none() {
            return self.recipe();
        }
        Arc::new(Recipe {
            commands: self.commands_of(task, app, registry),
            build: self.recipe.build.clone(),
        })
    }
}

impl std::fmt::Debug for HandlerKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "HandlerKind(`{}`)", self.name)
    }
}

/// Every kind of event handler that a program offers to its configurations.
#[derive(Default)]
pub struct Registry {
    kinds: BTreeMap<String, HandlerKind>,
    app_checks: BTreeMap<&'static str, CheckApp>,
    states: Option<Arc<dyn StateStore>>,
}

impl Registry {
    /// Registers a type of event handler. A later registration of the same name replaces the
    /// earlier one.
    pub fn handler<H: EventHandler>(
        &mut self,
        name: &str,
        commands: &[CommandInfo],
        build: impl Fn(&Context) -> Result<H, HandlerError> + Send + Sync + 'static,
    ) -> &mut HandlerKind {
        self.add(name, commands, Arc::new(move |cx| Ok(plain(build(cx)?))))
    }

    /// Registers a kind of event handler that passes its state on. Its tasks can be moved while they run,
    /// and a restarted one goes on where the last one ended.
    pub fn handover<H: Handover>(
        &mut self,
        name: &str,
        commands: &[CommandInfo],
        build: impl Fn(&Context) -> Result<H, HandlerError> + Send + Sync + 'static,
    ) -> &mut HandlerKind {
        self.add(name, commands, Arc::new(move |cx| Ok(passing(build(cx)?))))
    }

    /// Registers a kind of event handler whose state can survive its process: it does in tasks whose configuration
    /// says `state = "durable"`. They can be moved, too, as those of [`Self::handover`].
    pub fn durable<H: Durable>(
        &mut self,
        name: &str,
        commands: &[CommandInfo],
        build: impl Fn(&Context) -> Result<H, HandlerError> + Send + Sync + 'static,
    ) -> &mut HandlerKind {
        let build: Build = Arc::new(move |cx| Ok(durable(build(cx)?)));
        let kind = self.add(name, commands, build);
        kind.durable = true;
        kind
    }

    /// Says where states are stored that survive their processes. The first word counts.
    pub fn states(&mut self, store: impl StateStore + 'static) {
        self.states.get_or_insert_with(|| Arc::new(store));
    }

    /// Where they are stored.
    ///
    /// # Errors
    /// Nowhere; a check of the app has said so.
    pub(crate) fn state_store(&self) -> Result<&dyn StateStore, HandlerError> {
        let states = self.states.as_deref();
        states.ok_or_else(|| HandlerError::new("this program stores no states"))
    }

    fn add(&mut self, name: &str, commands: &[CommandInfo], build: Build) -> &mut HandlerKind {
        let kind = HandlerKind {
            name: name.to_owned(),
            recipe: Arc::new(Recipe {
                commands: commands.into(),
                build,
            }),
            keys: Vec::new(),
            args: None,
            checks: Vec::new(),
            waits_for: None,
            vocabulary: None,
            declares: None,
            durable: false,
        };
        match self.kinds.entry(name.to_owned()) {
            btree_map::Entry::Vacant(free) => free.insert(kind),
            btree_map::Entry::Occupied(there) => {
                let there = there.into_mut();
                *there = kind;
                there
            }
        }
    }

    /// Registers a plain function as an event handler for one command.
    pub fn function<C, F, Fut>(&mut self, name: &str, function: F) -> &mut HandlerKind
    where
        C: Command,
        F: Fn(Context, C) -> Fut + Clone + Send + Sync + 'static,
        Fut: Future<Output = Result<C::Reply, HandlerError>> + 'static,
    {
        self.handler(name, &[C::INFO], move |_| {
            Ok(FunctionHandler {
                function: Rc::new(function.clone()),
                command: std::marker::PhantomData::<fn(C)>,
            })
        })
    }

    /// Adds a check of the whole app that runs before anything starts. A later one of the same name
    /// replaces the earlier one, so that several crates may ask for the same check.
    pub fn app_check(
        &mut self,
        name: &'static str,
        check: impl Fn(&App, &Self, &mut Findings) + Send + Sync + 'static,
    ) {
        self.app_checks.insert(name, Box::new(check));
    }

    /// The kind of handler called `name`.
    #[must_use]
    pub fn kind(&self, name: &str) -> Option<&HandlerKind> {
        self.kinds.get(name)
    }

    /// All kinds, by name.
    pub fn kinds(&self) -> impl Iterator<Item = &HandlerKind> {
        self.kinds.values()
    }

    /// What the handler of `task` takes under `command`.
    ///
    /// # Errors
    /// A finding without a place when the task or its command is unknown.
    pub fn command_of(&self, app: &App, task: &str, command: &str) -> Result<CommandInfo, Finding> {
        let Some(config) = app.task(task) else {
            let names = app.tasks.iter().map(|task| task.name.as_str());
            return Err(Finding::error(
                "ctos::config::unknown_task",
                format!("no task is called `{task}`"),
            )
            .suggest(task, names));
        };
        let commands = self.commands_of(config, app);
        commands
            .iter()
            .copied()
            .find(|info| info.name == command)
            .ok_or_else(|| {
                Finding::error(
                    "ctos::config::unknown_command",
                    format!("task `{task}` takes no command `{command}`"),
                )
                .suggest(command, commands.iter().map(|info| info.name))
            })
    }

    /// The commands that `task` takes; none where nobody has its handler.
    #[must_use]
    pub fn commands_of(&self, task: &TaskConfig, app: &App) -> Arc<[CommandInfo]> {
        let kind = self.kind(&task.handler);
        kind.map_or_else(Arc::default, |kind| kind.commands_of(task, app, self))
    }

    /// No kinds.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Checks a whole app: every handler is known, every task's arguments hold, and whatever the
    /// crates of the program check across tasks.
    #[must_use]
    pub fn check(&self, app: &App) -> Findings {
        let mut findings = app.warnings.clone();
        self.check_tasks(app, &mut findings);
        waiting::check(app, self, &mut findings);
        for check in self.app_checks.values() {
            check(app, self, &mut findings);
        }
        findings
    }

    /// What is wrong with an app beside `found`, which is wrong with its configuration. Where a task could not be read, or
    /// nobody has its handler, what is wrong between tasks would be no mistake of the person.
    #[must_use]
    pub fn check_beside(&self, app: &App, mut found: Findings) -> Findings {
        let configuration = app.read_so_far();
        let knows_all = app
            .tasks
            .iter()
            .all(|task| self.kind(&task.handler).is_some());
        if knows_all && !app.is_partial() {
            found.extend(self.check(app));
            return found;
        }
        let is_named =
            |finding: &Finding| finding.code == "ctos::config::unknown_task" && !app.is_partial();
        let is_of_a_file = |finding: &Finding| {
            let place = finding.place.as_ref();
            let file = place.map(|place| place.source.name());
            file.is_some_and(|file| !configuration.contains(file))
        };
        let mut of_tasks = Findings::new();
        self.check_tasks(app, &mut of_tasks);
        for finding in of_tasks.into_sorted() {
            if OF_A_TASK.contains(&finding.code) || is_named(&finding) || is_of_a_file(&finding) {
                found.push(finding);
            }
        }
        found
    }

    fn check_tasks(&self, app: &App, findings: &mut Findings) {
        for task in &app.tasks {
            match self.kind(&task.handler) {
                Some(kind) => {
                    codes::check(kind, &kind.commands_of(task, app, self), task, findings);
                    self.check_state(kind, task, app, findings);
                    kind.check_task(task, app, findings);
                }
                None => findings.push(
                    Finding::error(
                        "ctos::config::unknown_handler",
                        format!(
                            "task `{}` names the event handler `{}`, which nobody registered",
                            task.name, task.handler
                        ),
                    )
                    .at(task.handler_place.clone())
                    .suggest(&task.handler, self.kinds.keys().map(String::as_str)),
                ),
            }
        }
    }

    /// Whether a task whose state is to survive has one that can, and a place for it.
    fn check_state(
        &self,
        kind: &HandlerKind,
        task: &TaskConfig,
        app: &App,
        findings: &mut Findings,
    ) {
        let finding = match (task.durable, kind.durable, &self.states) {
            (false, ..) | (true, true, Some(_)) => return,
            (true, false, _) => Finding::error(
                "ctos::config::not_durable",
                format!(
                    "the state of task `{}` cannot be durable: its handler `{}` has none that can be stored",
                    task.name, task.handler
                ),
            )
            .help("implement `task::Durable` for the handler and register it with `Registry::durable`, or see whether its arguments have a key for that (`args.durable` of a net)"),
            (true, true, None) => Finding::error(
                "ctos::config::no_states",
                format!("this program has no place for the state of task `{}`", task.name),
            )
            .help("add one to its registry: `pnt::store::keep_states(&mut registry)`"),
        };
        let place = app.locate(&format!("task.{}.state", task.name));
        findings.push(finding.at(place.unwrap_or_else(|| task.place.clone())));
    }
}

impl Extension for Registry {
    fn new(_: &Chassis) -> Self {
        Self::default()
    }
}

impl Chassis {
    /// The kinds of event handlers that this program knows.
    #[must_use]
    pub fn registry(&self) -> Arc<Registry> {
        self.extension()
    }
}

#[doc(hidden)]
impl Chassis {
    /// Chassis number `index` of `app`, whose event handlers are those of `registry`; its processors' threads are
    /// started elsewhere.
    pub fn new(
        index: ChassisNumber,
        app: Arc<App>,
        registry: Arc<Registry>,
        clock: Clock,
    ) -> Arc<Self> {
        let chassis = Self::bare(index, app, clock);
        chassis.extend(registry);
        chassis
    }
}

impl Context {
    /// The kinds of event handlers that this program knows.
    #[must_use]
    pub fn registry(&self) -> Arc<Registry> {
        self.chassis().registry()
    }
}

impl std::fmt::Debug for Registry {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_list().entries(self.kinds.keys()).finish()
    }
}

/// An event handler made of one function.
struct FunctionHandler<C, F> {
    function: Rc<F>,
    command: std::marker::PhantomData<fn(C)>,
}

impl<C, F, Fut> EventHandler for FunctionHandler<C, F>
where
    C: Command,
    F: Fn(Context, C) -> Fut + 'static,
    Fut: Future<Output = Result<C::Reply, HandlerError>> + 'static,
{
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        if message.command() != C::CODE {
            return cx.default_processing(message);
        }
        let (request, reply) = message.open::<C>()?;
        reply.ok((self.function)(cx.clone(), request).await?)
    }
}

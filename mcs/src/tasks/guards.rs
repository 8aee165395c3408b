//! Recipes of guards: those of the configuration and those that somebody asks for, made into guards of the servo.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use ctos::config::{App, Node, TaskConfig};
use ctos::diagnostic::{Finding, Findings, Source};
use ctos::task::{Context, HandlerError};

use super::{Link, SERVO};
use crate::args::{RecipeArgs, ServoArgs};
use crate::client::{MotionError, Outcome, Recipe, SetGuard};
use crate::guard::{
    Around, Guard, GuardRegistry, GuardSet, GuardSettings, Line, MAX_GUARDS, Mounted, Neighbour,
    Sight,
};
use crate::model::Model;

/// The recipes of one servo; each has the slot of the servo that is its index.
#[derive(Debug, Default)]
pub(super) struct Recipes(Mutex<Vec<Slot>>);

/// A place for a guard in the servo, with what is there.
type Slot = Option<Held>;

/// The recipe of a guard, and what viewers see of the guard.
#[derive(Debug)]
struct Held {
    recipe: Recipe,
    outline: Vec<Line>,
    sight: Option<Arc<dyn Sight>>,
}

impl Recipes {
    fn lock(&self) -> MutexGuard<'_, Vec<Slot>> {
        // It is changed in whole steps, so one who panicked has left it whole.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub fn all(&self) -> Vec<Recipe> {
        let recipes = self.lock();
        let recipes = recipes.iter().flatten();
        recipes.map(|held| held.recipe.clone()).collect()
    }

    /// The names of the guards that have an outline, with that, in the base frame.
    pub fn outlines(&self) -> Vec<(String, Vec<Line>)> {
        let recipes = self.lock();
        let drawn = recipes
            .iter()
            .flatten()
            .filter(|held| !held.outline.is_empty());
        drawn
            .map(|held| (held.recipe.name.clone(), held.outline.clone()))
            .collect()
    }

    /// The names of the guards that see something, with that.
    pub fn sights(&self) -> Vec<(String, Arc<dyn Sight>)> {
        let recipes = self.lock();
        let seeing = recipes.iter().flatten();
        seeing
            .filter_map(|held| Some((held.recipe.name.clone(), held.sight.clone()?)))
            .collect()
    }

    /// The guards that a motion names.
    ///
    /// # Errors
    /// The first name that no recipe has.
    pub fn named(&self, names: &[String]) -> Result<GuardSet, MotionError> {
        let recipes = self.lock();
        names.iter().try_fold(GuardSet::default(), |set, name| {
            let found = recipes.iter().position(|recipe| is(recipe, name));
            found.map(|slot| set.with(slot)).ok_or_else(|| {
                let known: Vec<&str> = recipes.iter().flatten().map(|held| held.recipe.name.as_str()).collect();
                let known = match known.is_empty() {
                    true => "it has none".to_owned(),
                    false => format!("it has {}", known.join(", ")),
                };
                let text = format!("the arm has no guard `{name}` ({known}); `wspc.{name} EXEC` makes one of a recipe of the dictionary");
                MotionError::new(Outcome::Refused, text)
            })
        })
    }
}

fn is(recipe: &Slot, name: &str) -> bool {
    recipe.as_ref().is_some_and(|held| held.recipe.name == name)
}

/// A recipe's name is a word that stands after a dot.
fn check_name(name: &str) -> Result<(), String> {
    let sound = |letter: char| letter.is_alphanumeric() || "_-".contains(letter);
    if name.is_empty() || name.len() > 64 || !name.chars().all(sound) {
        return Err(format!(
            "`{name}` is no name of a guard; it has 1 to 64 letters, digits, - and _"
        ));
    }
    Ok(())
}

/// What guards of a servo are made with.
#[derive(Clone)]
pub(super) struct Maker {
    pub kinds: Arc<GuardRegistry>,
    pub model: Arc<Model>,
    pub period: Duration,
    pub servo: String,
}

impl Maker {
    /// A guard of a kind.
    fn build(
        &self,
        (name, kind): (&str, &str),
        (around, cx): (&dyn Around, Option<&Context>),
        args: &Node,
    ) -> Result<Box<dyn Guard>, HandlerError> {
        check_name(name)?;
        let settings = GuardSettings {
            model: &self.model,
            period: self.period,
            servo: &self.servo,
            around,
            cx,
            args,
        };
        match self.kinds.build(kind, &settings) {
            Some(guard) => guard,
            None => {
                let text = format!("nobody registered the kind of guard `{kind}`");
                let finding = Finding::error("mcs::servo::guard", text);
                Err(finding.suggest(kind, self.kinds.names()).into())
            }
        }
    }

    /// Finds what is wrong with the recipes of the configuration.
    pub fn check(&self, args: &ServoArgs, task: &TaskConfig, app: &App, findings: &mut Findings) {
        if args.guards.len() > MAX_GUARDS {
            let text = format!(
                "a servo has at most {MAX_GUARDS} guards, not {}",
                args.guards.len()
            );
            let place = task.args.locate("guards");
            findings.push(Finding::error("mcs::servo::guard", text).at(place));
        }
        let around = Configured { task, app };
        for (name, recipe) in &args.guards {
            let own = own_args(task, name);
            if let Err(error) = self.build((name, &recipe.kind), (&around, None), &own) {
                let text = format!("guard `{name}`: {error}");
                let place = task.args.locate(&format!("guards.{name}"));
                let place = place.or_else(|| task.args.locate("guards"));
                findings.push(Finding::error("mcs::servo::guard", text).at(place));
            }
        }
    }

    /// Puts the guards of the configuration into the servo.
    pub fn mount_all(
        &self,
        cx: &Context,
        link: &Link,
        recipes: impl IntoIterator<Item = (String, RecipeArgs)>,
    ) -> Result<(), HandlerError> {
        let task = cx.config().ok_or("a servo task needs a configuration")?;
        for (name, recipe) in recipes {
            let own = own_args(task, &name);
            let recipe = Recipe {
                name,
                kind: recipe.kind,
                always: recipe.always,
                reaction: recipe.reaction,
                configured: true,
            };
            self.mount(cx, link, recipe, &own)?;
        }
        Ok(())
    }

    /// Puts the guard that somebody asks for into the servo.
    pub fn set(&self, cx: &Context, link: &Link, request: SetGuard) -> Result<(), HandlerError> {
        let source = Source::new(format!("guard {}", request.name), request.args);
        let mut findings = Findings::new();
        let args = Node::from_toml(&source, &mut findings);
        if findings.has_errors() {
            return Err(findings.to_string().into());
        }
        let configured = link
            .guards
            .lock()
            .iter()
            .flatten()
            .any(|Held { recipe, .. }| recipe.name == request.name && recipe.configured);
        let recipe = Recipe {
            name: request.name,
            kind: request.kind,
            always: request.always,
            reaction: request.reaction,
            configured,
        };
        self.mount(cx, link, recipe, &args)
    }

    fn mount(
        &self,
        cx: &Context,
        link: &Link,
        recipe: Recipe,
        args: &Node,
    ) -> Result<(), HandlerError> {
        let built = self.build((&recipe.name, &recipe.kind), (&Running(cx), Some(cx)), args);
        let guard = built.map_err(|error| format!("guard `{}`: {error}", recipe.name))?;
        let (outline, sight) = (guard.outline(), guard.sight());
        let mounted = Mounted::new(&recipe.name, recipe.reaction, recipe.always, guard);
        let mut recipes = link.guards.lock();
        let free = || recipes.iter().position(Option::is_none);
        let own = recipes.iter().position(|other| is(other, &recipe.name));
        let slot = own.or_else(free).unwrap_or(recipes.len());
        if slot >= MAX_GUARDS {
            return Err(format!("the servo has {MAX_GUARDS} guards already; remove one").into());
        }
        link.port.mount(slot, Some(mounted))?;
        if slot == recipes.len() {
            recipes.push(None);
        }
        recipes[slot] = Some(Held {
            recipe,
            outline,
            sight,
        });
        Ok(())
    }

    /// Takes a guard out of the servo.
    pub fn remove(&self, link: &Link, name: &str) -> Result<(), HandlerError> {
        let mut recipes = link.guards.lock();
        let Some(slot) = recipes.iter().position(|recipe| is(recipe, name)) else {
            return Err(format!("the arm has no guard `{name}`").into());
        };
        if recipes[slot]
            .as_ref()
            .is_some_and(|held| held.recipe.configured)
        {
            let text = format!(
                "guard `{name}` stands in the configuration of `{}`; take it out there",
                self.servo
            );
            return Err(text.into());
        }
        link.port.mount(slot, None)?;
        recipes[slot] = None;
        Ok(())
    }
}

/// The arguments that a recipe has of its own.
fn own_args(task: &TaskConfig, name: &str) -> Node {
    let found = task.args.get(&format!("guards.{name}.args"));
    found.cloned().unwrap_or_else(Node::table)
}

fn board_key(servo: &str) -> String {
    format!("mcs.board/{servo}")
}

/// Where a servo shows its arm. One that is built anew shows it where the one before did.
pub(super) fn board(cx: &Context, model: &Arc<Model>) -> Neighbour {
    let key = board_key(cx.name());
    if let Some(board) = cx.shared::<Neighbour>(&key)
        && board.model == *model
    {
        return (*board).clone();
    }
    let board = Neighbour::new(Arc::clone(model));
    cx.share(&key, Arc::new(board.clone()));
    board
}

/// The chassis as its configuration says.
struct Configured<'a> {
    task: &'a TaskConfig,
    app: &'a App,
}

impl Around for Configured<'_> {
    fn neighbour(&self, servo: &str) -> Result<Neighbour, HandlerError> {
        let servos = || self.app.tasks.iter().filter(|task| task.handler == SERVO);
        let Some(found) = servos().find(|task| task.name == servo) else {
            let finding = Finding::error(
                "mcs::servo::guard",
                format!("there is no servo task `{servo}`"),
            );
            let names = servos().map(|task| task.name.as_str());
            return Err(finding.suggest(servo, names).into());
        };
        if found.chassis != self.task.chassis {
            return Err(apart(servo, &self.task.name));
        }
        let model = configured_arm(found, self.app);
        let model = model.ok_or_else(|| format!("the arm of `{servo}` is not known"))?;
        Ok(Neighbour::new(Arc::new(model)))
    }
}

/// The arm of a servo's task as the configuration has it; none where something is wrong with it.
pub(super) fn configured_arm(servo: &TaskConfig, app: &App) -> Option<Model> {
    let read = ServoArgs::read(servo, app, &mut Findings::new());
    read.map(|(_, model)| model)
}

/// The chassis as it runs.
struct Running<'a>(&'a Context);

impl Around for Running<'_> {
    fn neighbour(&self, servo: &str) -> Result<Neighbour, HandlerError> {
        let found = self.0.shared::<Neighbour>(&board_key(servo));
        let found = found.ok_or_else(|| apart(servo, self.0.name()))?;
        Ok((*found).clone())
    }
}

fn apart(servo: &str, own: &str) -> HandlerError {
    format!("`{own}` finds no servo task `{servo}` on its chassis; place both on the same chassis")
        .into()
}

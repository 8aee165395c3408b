//! What stands in the net's text: declared data, guards that are expressions, and actions that are lines of text. Also
//! how the actions of a net are stood in for.

use std::{collections::BTreeMap, ops::Range, sync::Arc, time::Duration};

use ctos::{
    message::DataType,
    task::{Context, HandlerError},
};
use pnt_language::{
    data::{Kind, Value},
    expression::Values,
    net::{Action as NetAction, Does, Line, LinePart, Net, Set, SetTo, Transition, When},
    timing::Timing,
};

use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;

use super::{engine::Engine, fields, settings::StandIn};
use crate::{
    library::{Action, Answer},
    stream::Changed,
};

/// The longest account of changed data that an event has, characters.
const SHOWN: usize = 200;

/// The data of a net as it is now.
pub(super) struct Data {
    net: Arc<Net>,
    values: Vec<Value>,
}

impl Data {
    pub(super) fn new(net: &Arc<Net>) -> Self {
        Self {
            net: Arc::clone(net),
            values: net.declared().initial(),
        }
    }

    /// That of another net: what has the same name and type keeps its value.
    pub(super) fn carried(&self, net: &Arc<Net>) -> Self {
        let mut next = Self::new(net);
        next.take_up(self.named());
        next
    }

    /// Every value by its name.
    pub(super) fn named(&self) -> Vec<(String, Value)> {
        let named = self.net.declared().shown(&self.values);
        named
            .map(|(name, value)| (name.to_owned(), value.clone()))
            .collect()
    }

    /// Values that were kept; what the net does not declare so is passed over.
    pub(super) fn take_up(&mut self, named: Vec<(String, Value)>) {
        let declared = self.net.declared();
        for (name, value) in named {
            let slot = declared.slot(&name);
            let fits = |slot: &usize| {
                declared
                    .slots
                    .get(*slot)
                    .is_some_and(|slot| value.is(slot.kind))
            };
            if let Some(there) = slot.filter(fits).and_then(|slot| self.values.get_mut(slot)) {
                *there = value;
            }
        }
    }

    /// For people.
    pub(super) fn shown(&self) -> Vec<(String, String)> {
        let named = self.net.declared().shown(&self.values);
        named
            .map(|(name, value)| (name.to_owned(), value.to_string()))
            .collect()
    }

    fn with<'v>(&'v self, arguments: &'v [(String, Value)]) -> Values<'v> {
        Values {
            declared: self.net.declared(),
            values: &self.values,
            arguments,
        }
    }

    /// Gives data its new values, all of them or none; what has changed.
    fn set(
        &mut self,
        sets: &[Set],
        answer: Option<&Answer>,
        arguments: &[(String, Value)],
    ) -> Result<Changed, HandlerError> {
        let mut before = Vec::new();
        for set in sets {
            let new = match (&set.to, answer) {
                (SetTo::Value(value), _) => {
                    let value = value.evaluate(&self.with(arguments));
                    value
                        .map(|value| vec![value])
                        .map_err(|error| HandlerError::new(error.to_string()))
                }
                (SetTo::Reply, Some(answer)) => self.answered(set, answer),
                // Nobody was asked.
                (SetTo::Reply, None) => continue,
            };
            match new {
                Ok(new) => self.exchange(set.slots.clone(), new, &mut before),
                Err(error) => {
                    self.back(before);
                    return Err(error);
                }
            }
        }
        Ok(self.changed(before))
    }

    /// Gives data these values, if all are of the declared types; what has changed.
    fn put(&mut self, new: Vec<(Range<usize>, Vec<Value>)>) -> Result<Changed, HandlerError> {
        let mut before = Vec::new();
        for (slots, new) in new {
            let there = self.net.declared().slots.get(slots.clone());
            let there = there.unwrap_or_default();
            let same = there.len() == new.len()
                && there.iter().zip(&new).all(|(slot, new)| new.is(slot.kind));
            if !same {
                self.back(before);
                return Err(HandlerError::new(
                    "a reply has other values than the data that it is stored as",
                ));
            }
            self.exchange(slots, new, &mut before);
        }
        Ok(self.changed(before))
    }

    /// Puts values in the place of others, which go to those that were there before.
    fn exchange(&mut self, slots: Range<usize>, new: Vec<Value>, before: &mut Changed) {
        for (slot, new) in slots.zip(new) {
            if let Some(there) = self.values.get_mut(slot) {
                before.push((slot, std::mem::replace(there, new)));
            }
        }
    }

    /// Puts back what was there before.
    fn back(&mut self, before: Changed) {
        for (slot, old) in before.into_iter().rev() {
            if let Some(there) = self.values.get_mut(slot) {
                *there = old;
            }
        }
    }

    /// What is no longer as it was before, with its values now.
    fn changed(&self, before: Changed) -> Changed {
        let mut first = BTreeMap::new();
        for (slot, old) in before {
            first.entry(slot).or_insert(old);
        }
        let now = first.into_iter().filter_map(|(slot, old)| {
            let now = self.values.get(slot).filter(|now| **now != old)?;
            Some((slot, now.clone()))
        });
        now.collect()
    }

    /// For people: what has changed.
    pub(super) fn told(&self, changed: &Changed) -> String {
        let slots = &self.net.declared().slots;
        let mut said = String::new();
        for (slot, now) in changed {
            let name = slots.get(*slot).map_or("", |slot| slot.name.as_str());
            let apart = if said.is_empty() { "" } else { ", " };
            said.push_str(&format!("{apart}{name} = {now}"));
        }
        if let Some((cut, _)) = said.char_indices().nth(SHOWN) {
            said.truncate(cut);
            said.push('…');
        }
        said
    }

    /// All values, by number.
    pub(super) fn values(&self) -> &[Value] {
        &self.values
    }

    /// The values of an answer, which has as many of each kind as are declared.
    fn answered(&self, set: &Set, answer: &Answer) -> Result<Vec<Value>, HandlerError> {
        let slots = self
            .net
            .declared()
            .slots
            .get(set.slots.clone())
            .unwrap_or_default();
        let (mut floats, mut ints) = (answer.floats.iter(), answer.ints.iter());
        let count = |is: fn(Kind) -> bool| slots.iter().filter(|slot| is(slot.kind)).count();
        let wanted = (
            count(|kind| matches!(kind, Kind::Float(_))),
            count(|kind| kind == Kind::Int),
        );
        let came = (answer.floats.len(), answer.ints.len());
        if wanted != came {
            return Err(HandlerError::new(format!(
                "{}: {} floats and {} whole numbers were answered, and `{}` takes {} and {}",
                set.at, came.0, came.1, set.name, wanted.0, wanted.1
            )));
        }
        let value = |kind: Kind| match kind {
            Kind::Float(_) => floats
                .next()
                .filter(|number| number.is_finite())
                .copied()
                .map(Value::Float),
            Kind::Int => ints.next().copied().map(Value::Int),
            Kind::Bool => None,
            Kind::Text => kind.read(&answer.text),
        };
        let values = slots.iter().map(|slot| slot.kind).map(value);
        values.collect::<Option<Vec<Value>>>().ok_or_else(|| {
            let why = "the answer has a number that is not finite, or a text that is too long";
            HandlerError::new(format!("{}: `{}` cannot be kept: {why}", set.at, set.name))
        })
    }
}

/// What chance says where nobody is there to be asked, from the app's seed.
pub(super) struct Drawn {
    rng: ChaCha8Rng,
    /// What enabling functions say until a firing ends, and how many had ended then.
    said: (u64, BTreeMap<String, bool>),
}

impl Drawn {
    pub(super) fn new(cx: &Context) -> Self {
        Self {
            rng: cx.rng("stand-in"),
            said: (0, BTreeMap::new()),
        }
    }

    /// The same until something fires, so that a function and its negation agree.
    fn says(&mut self, function: &str, ended: u64) -> bool {
        if self.said.0 != ended {
            self.said = (ended, BTreeMap::new());
        }
        if let Some(said) = self.said.1.get(function) {
            return *said;
        }
        let said = self.rng.random();
        self.said.1.insert(function.to_owned(), said);
        said
    }
}

fn unknown_form(name: &str) -> HandlerError {
    HandlerError::new(format!("the form of the field for `{name}` is not known"))
}

impl Engine {
    /// Whether a condition holds (its negation is for who asks). `ended` counts the firings so far.
    ///
    /// # Errors
    /// A function that is not there, or an expression without a value; why.
    pub(super) fn says(&self, when: &When, data: &Data, ended: u64) -> Result<bool, String> {
        let Some(expression) = &when.expression else {
            let function = &when.function;
            let chance = || {
                let mut stand_in = self.stand_in.as_ref()?.borrow_mut();
                Some(stand_in.says(function, ended))
            };
            let said = self.library.ask(function).or_else(chance);
            return said
                .ok_or_else(|| format!("its library has no enabling function `{function}`"));
        };
        match expression.evaluate(&data.with(&[])) {
            Ok(Value::Bool(said)) => Ok(said),
            Ok(other) => Err(format!("{}: `{other}` is no yes or no", expression.at())),
            Err(error) => Err(error.to_string()),
        }
    }

    /// Does what lines of text say, then gives data its new values; what has changed.
    pub(super) async fn written(
        &self,
        action: &Action<()>,
        (does, sets): (Option<&Does>, &[Set]),
        limit: Duration,
    ) -> Result<Changed, HandlerError> {
        let arguments = self.arguments_of(action);
        let mut answer = None;
        match does {
            None => {}
            Some(Does::Wait(time)) => action.cx().sleep(*time).await,
            Some(Does::Log(line)) => {
                let text = {
                    let core = self.core.borrow();
                    let values = core.declared.with(&arguments);
                    line.filled(|name| values.get(name).map(Value::to_string).unwrap_or_default())
                };
                tracing::info!(target: "pnt::log", net = &*self.name, transition = action.transition(), text);
            }
            Some(Does::Request(line)) => {
                let values = self.values_of(line, &arguments)?;
                let asked = self.library.requests.as_ref();
                let asked =
                    asked.ok_or_else(|| HandlerError::new("its handler makes no requests"))?;
                answer = Some(asked.ask(action.cx(), line, values, limit).await?);
            }
        }
        if sets.is_empty() {
            return Ok(Changed::new());
        }
        self.core
            .borrow_mut()
            .declared
            .set(sets, answer.as_ref(), &arguments)
    }

    /// The values that stand in a line, in order.
    fn values_of(
        &self,
        line: &Line,
        arguments: &[(String, Value)],
    ) -> Result<Vec<Value>, HandlerError> {
        let core = self.core.borrow();
        let known = core.declared.with(arguments);
        let mut found = Vec::new();
        for part in &line.parts {
            let LinePart::Values { values, at, .. } = part else {
                continue;
            };
            for (name, _) in values {
                let missing =
                    || HandlerError::new(format!("{at}: no command with `{name}` is in progress"));
                found.push(known.get(name).ok_or_else(missing)?.clone());
            }
        }
        Ok(found)
    }

    /// The data of a message: data objects, declared data and arguments of the command in progress.
    pub(super) async fn sent(
        &self,
        action: &Action<()>,
        inputs: &[String],
        kind: DataType,
    ) -> Result<Vec<u8>, HandlerError> {
        let (arguments, form) = (self.arguments_of(action), kind.shape());
        let mut bytes = Vec::new();
        for (index, input) in inputs.iter().enumerate() {
            match self.own(input, &arguments)? {
                None => bytes.extend(action.get_data(input).await?),
                Some(values) => {
                    let form = form
                        .as_ref()
                        .and_then(|form| fields::part(form, index, inputs.len()));
                    let form = form.ok_or_else(|| unknown_form(input))?;
                    bytes.extend(fields::written(&values, form)?);
                }
            }
        }
        Ok(bytes)
    }

    /// The values of declared data, or of an argument of the command in progress; nothing for a data object.
    fn own(
        &self,
        name: &str,
        arguments: &[(String, Value)],
    ) -> Result<Option<Vec<Value>>, HandlerError> {
        let core = self.core.borrow();
        let net = core.execution.net();
        if fields::kinds(net, name).is_none() {
            return Ok(None);
        }
        let known = core.declared.with(arguments);
        if let Some(data) = net.declared().named(name) {
            return Ok(core
                .declared
                .values
                .get(data.slots.clone())
                .map(<[Value]>::to_vec));
        }
        let missing = || HandlerError::new(format!("no command with `{name}` is in progress"));
        Ok(Some(vec![known.get(name).ok_or_else(missing)?.clone()]))
    }

    /// Stores a reply, as one object or each of its fields as one: data objects, then declared data; all of them or,
    /// where one does not fit, none. What data has changed.
    pub(super) async fn received(
        &self,
        action: &Action<()>,
        outputs: &[String],
        reply: Vec<u8>,
        kind: DataType,
    ) -> Result<Changed, HandlerError> {
        let parts = match outputs {
            [] => return Ok(Changed::new()),
            [_] => vec![reply],
            _ => kind.split(&reply)?,
        };
        if parts.len() != outputs.len() {
            return Err(HandlerError::new(format!(
                "{} results came for {} data objects",
                parts.len(),
                outputs.len()
            )));
        }
        let (mut objects, mut own, mut form) = (Vec::new(), Vec::new(), None);
        for (index, (name, bytes)) in outputs.iter().zip(parts).enumerate() {
            let declared = self
                .core
                .borrow()
                .execution
                .net()
                .declared()
                .named(name)
                .cloned();
            let Some(data) = declared else {
                objects.push((name.clone(), bytes));
                continue;
            };
            let form = form.get_or_insert_with(|| kind.shape()).as_ref();
            let form = form.and_then(|form| fields::part(form, index, outputs.len()));
            let values = fields::read(&bytes, form.ok_or_else(|| unknown_form(name))?)?;
            own.push((data.slots, values));
        }
        if !objects.is_empty() {
            action.put_all_data(objects).await?;
        }
        self.core.borrow_mut().declared.put(own)
    }

    /// What came with the command in progress, as far as the net declares it.
    fn arguments_of(&self, action: &Action<()>) -> Vec<(String, Value)> {
        let Some(line) = action.command() else {
            return Vec::new();
        };
        let core = self.core.borrow();
        let net = core.execution.net();
        let Some(command) = net.command(&line.symbol) else {
            return Vec::new();
        };
        let pairs = net[command].parameters.iter().zip(&line.arguments);
        pairs
            .filter_map(|(one, word)| Some((one.name.clone(), one.kind.read(word)?)))
            .collect()
    }

    /// Takes the stated time of an action in its place, and fails by chance if it may.
    pub(super) async fn stand_in(
        &self,
        action: &Action<()>,
        transition: &Transition,
        stand_in: &StandIn,
    ) -> Result<Changed, HandlerError> {
        let stated = match (&transition.action, transition.timing) {
            (
                Some(NetAction::Written {
                    does: Some(Does::Wait(time)),
                    ..
                }),
                _,
            ) => *time,
            (_, Timing::Deterministic(time)) => time,
            (_, Timing::Exponential { mean } | Timing::Normal { mean, .. }) => mean,
            (_, Timing::Immediate) => Duration::ZERO,
        };
        // Drawn before anything else of this net may be.
        let fails = self.stand_in.as_ref().is_some_and(|drawn| {
            let drawn = drawn.borrow_mut().rng.random::<f64>();
            drawn < stand_in.fail
        });
        action.cx().sleep(stated).await;
        // Lines that ask nobody do not fail by chance.
        let asks = match &transition.action {
            Some(NetAction::Written { does, .. }) => matches!(does, Some(Does::Request(_))),
            _ => true,
        };
        if asks && fails {
            return Err(HandlerError::new("the stand-in fails by chance"));
        }
        match &transition.action {
            Some(NetAction::Written { does, sets, .. }) => {
                if let Some(Does::Log(_)) = does {
                    return Box::pin(self.written(action, (does.as_ref(), sets), stated)).await;
                }
                let arguments = self.arguments_of(action);
                self.core.borrow_mut().declared.set(sets, None, &arguments)
            }
            _ => Ok(Changed::new()),
        }
    }
}

//! What stands in the net's text: declared data, guards that are expressions, and actions that are lines of text. Also
//! how the actions of a net are stood in for.

use std::{sync::Arc, time::Duration};

use ctos::{mix, task::HandlerError};
use pnt_language::{
    data::{Kind, Value},
    expression::Values,
    net::{Action as NetAction, Does, Line, LinePart, Net, Set, SetTo, Transition, When},
    timing::Timing,
};

use super::{engine::Engine, settings::StandIn};
use crate::library::{Action, Answer};

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
    ) -> Result<String, HandlerError> {
        let mut next = Self {
            net: Arc::clone(&self.net),
            values: self.values.clone(),
        };
        for set in sets {
            let new = match (&set.to, answer) {
                (SetTo::Value(value), _) => {
                    let value = value.evaluate(&next.with(arguments));
                    vec![value.map_err(|error| HandlerError::new(error.to_string()))?]
                }
                (SetTo::Reply, Some(answer)) => next.answered(set, answer)?,
                // Nobody was asked.
                (SetTo::Reply, None) => continue,
            };
            let there = next.values.get_mut(set.slots.clone());
            there
                .into_iter()
                .flatten()
                .zip(new)
                .for_each(|(there, new)| *there = new);
        }
        let mut said = String::new();
        for ((name, before), now) in self.net.declared().shown(&self.values).zip(&next.values) {
            if before != now {
                let apart = if said.is_empty() { "" } else { ", " };
                said.push_str(&format!("{apart}{name} = {now}"));
            }
        }
        if let Some((cut, _)) = said.char_indices().nth(SHOWN) {
            said.truncate(cut);
            said.push('…');
        }
        self.values = next.values;
        Ok(said)
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

impl Engine {
    /// Whether a condition holds (its negation is for who asks). `ended` counts the firings so far.
    ///
    /// # Errors
    /// A function that is not there, or an expression without a value; why.
    pub(super) fn says(&self, when: &When, data: &Data, ended: u64) -> Result<bool, String> {
        let Some(expression) = &when.expression else {
            let function = &when.function;
            let chance = || {
                // The same until something fires, so that a function and its negation agree.
                let drawn = mix(self.chance, &[function, &ended.to_string()]);
                self.settings.stand_in.is_some().then_some(drawn >> 63 == 1)
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
    ) -> Result<String, HandlerError> {
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
            return Ok(String::new());
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
    ) -> Result<String, HandlerError> {
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
        let events = self.core.borrow().journal.ended();
        let drawn = mix(
            self.chance,
            &[
                &transition.name,
                &events.to_string(),
                &action.cx().now().as_nanos().to_string(),
            ],
        );
        action.cx().sleep(stated).await;
        // The upper bits, as a fraction.
        #[allow(clippy::cast_precision_loss)]
        let fraction = (drawn >> 11) as f64 / (1_u64 << 53) as f64;
        if fraction < stand_in.fail {
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
            _ => Ok(String::new()),
        }
    }
}

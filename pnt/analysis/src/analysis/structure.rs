//! What follows from the arcs alone, whatever the tokens do (Murata 1989; Desel and Esparza 1995).
//! That is invariants, siphons and traps, and the classes of nets for which these suffice.

pub mod classes;
pub mod components;
pub mod semiflows;
pub mod siphons;

use super::model::Model;

/// The arcs of a model as lists by number.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Arcs {
    /// Per place: transitions that put into it.
    pub producers: Vec<Vec<usize>>,
    /// Per place: transitions that take from it.
    pub consumers: Vec<Vec<usize>>,
    /// Per transition: places that it takes from.
    pub inputs: Vec<Vec<usize>>,
    /// Per transition: places that it puts into.
    pub outputs: Vec<Vec<usize>>,
    /// Whether every arc is of weight one, and none of another kind (read, inhibitor, reset).
    pub ordinary: bool,
    /// Effects: one row per place, one column per transition.
    pub effects: Vec<Vec<i64>>,
}

impl Arcs {
    /// The arcs of a model. A read arc counts as taking and putting back; but what the same transition takes
    /// from the place anyway it does not put back.
    #[must_use]
    pub fn of(model: &Model) -> Self {
        let (places, transitions) = (model.places.len(), model.transitions.len());
        let mut arcs = Self {
            producers: vec![Vec::new(); places],
            consumers: vec![Vec::new(); places],
            inputs: vec![Vec::new(); transitions],
            outputs: vec![Vec::new(); transitions],
            ordinary: model.places.iter().all(|place| place.capacity.is_none()),
            effects: vec![vec![0; transitions]; places],
        };
        for (number, transition) in model.transitions.iter().enumerate() {
            let needs = transition.takes.iter().chain(&transition.reads);
            let taken = |place: &u32| transition.takes.iter().find(|(of, _)| of == place);
            let back = |(place, weight): &&(u32, u32)| {
                taken(place).is_none_or(|(_, taken)| taken < weight)
            };
            let puts = transition
                .puts
                .iter()
                .chain(transition.reads.iter().filter(back));
            for (place, _) in needs {
                arcs.consumers[*place as usize].push(number);
                arcs.inputs[number].push(*place as usize);
            }
            for (place, _) in puts {
                arcs.producers[*place as usize].push(number);
                arcs.outputs[number].push(*place as usize);
            }
            for (place, change) in transition.changes() {
                arcs.effects[place as usize][number] = change;
            }
            let weights = transition.takes.iter().chain(&transition.puts);
            arcs.ordinary &= weights
                .chain(&transition.reads)
                .all(|(_, weight)| *weight == 1)
                && transition.inhibitors.is_empty()
                && transition.resets.is_empty();
        }
        let lists = [
            &mut arcs.producers,
            &mut arcs.consumers,
            &mut arcs.inputs,
            &mut arcs.outputs,
        ];
        for list in lists.into_iter().flatten() {
            list.sort_unstable();
            list.dedup();
        }
        arcs
    }

    /// The same net with every arc turned round.
    #[must_use]
    pub fn reversed(&self) -> Self {
        let negated = |row: &Vec<i64>| row.iter().map(|effect| -effect).collect();
        Self {
            producers: self.consumers.clone(),
            consumers: self.producers.clone(),
            inputs: self.outputs.clone(),
            outputs: self.inputs.clone(),
            ordinary: self.ordinary,
            effects: self.effects.iter().map(negated).collect(),
        }
    }
}

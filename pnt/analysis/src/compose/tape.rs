//! Tapes on which only the words of a language come, instead of any command at any time. The commander of
//! the net puts what may come next; a token marks its state in the language.

use super::{Phase, Stands, Step, System, SystemPlace, SystemPlaceId};
use pnt_language::{language::Language, net::CommandId};

/// What comes on the tape of one net.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Tape {
    /// Name of the net.
    pub net: String,
    /// The language as it was written.
    pub text: String,
    /// The language over the net's commands, by their numbers.
    pub language: Language,
}

/// Symbols of a word that the name of a place shows.
const SHOWN: usize = 8;

/// Where the commander of a net is.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Commander {
    /// Marked when the command before is answered.
    idle: SystemPlaceId,
    /// Where a word may end: one of these places is marked. Nothing when it may end anywhere.
    ends: Option<Vec<SystemPlaceId>>,
    /// The place that is marked when no command may follow; `None` when one always may.
    last: Option<Last>,
}

/// That no command may follow.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Last {
    /// When this place is marked.
    At(SystemPlaceId),
    /// From the beginning: the only word is the empty one.
    Always,
}

/// The markings at which every tape is at the end of a word: each command is answered, and none need
/// follow.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Ends(Vec<Commander>);

impl Ends {
    /// Whether a marking is one of them.
    #[must_use]
    pub fn holds(&self, marking: &[u32]) -> bool {
        let marked = |place: &SystemPlaceId| marking.get(*place).is_some_and(|tokens| *tokens > 0);
        self.0.iter().all(|commander| {
            let ends = commander.ends.as_ref();
            marked(&commander.idle) && ends.is_none_or(|ends| ends.iter().any(marked))
        })
    }
}

impl System {
    /// Lets only the given languages come on the tapes of the nets they name. Other tapes stay open. The
    /// end of the last word is not a deadlock: there, a step goes on that changes nothing.
    pub fn with_tapes(&mut self, tapes: &[Tape]) -> Ends {
        let commanders: Vec<Commander> = (0..self.nets.len())
            .filter_map(|net| {
                let name = self.nets.get(net)?.name();
                let tape = tapes.iter().find(|tape| tape.net == name);
                let idle = self.idle(net)?;
                Some(match tape {
                    Some(tape) => self.restrict(net, idle, &tape.language),
                    None => Commander {
                        idle,
                        ends: None,
                        last: None,
                    },
                })
            })
            .collect();
        self.end(&commanders);
        Ends(commanders)
    }

    fn idle(&self, net: usize) -> Option<SystemPlaceId> {
        self.places
            .iter()
            .position(|place| place.net == net && place.stands == Stands::Idle)
    }

    /// A place for each state of a language, and a step for each command that may come there.
    fn restrict(&mut self, net: usize, idle: SystemPlaceId, language: &Language) -> Commander {
        let states = language.states();
        let first = self.places.len();
        // With one state there is nothing to know.
        let place = |state: usize| (states.len() > 1).then_some(first + state);
        if states.len() > 1 {
            for state in 0..states.len() {
                self.word_place(net, language, state);
            }
        }
        self.steps
            .retain(|step| step.net != net || !matches!(step.phase, Phase::Put(_)));
        for (from, state) in states.iter().enumerate() {
            for (symbol, to) in &state.next {
                let command = CommandId(u32::try_from(*symbol).unwrap_or(u32::MAX));
                let Some(on_tape) = self.on_tape(net, command) else {
                    continue;
                };
                let ones = |places: [Option<SystemPlaceId>; 2]| {
                    places.into_iter().flatten().map(|p| (p, 1)).collect()
                };
                self.steps.push(Step {
                    takes: ones([Some(idle), place(from)]),
                    puts: ones([Some(on_tape), place(*to)]),
                    ..commander_step(net, Phase::Put(command))
                });
            }
        }
        let ends = || (0..states.len()).filter(|state| states[*state].ends);
        Commander {
            idle,
            ends: (states.len() > 1).then(|| ends().filter_map(place).collect()),
            last: language
                .last()
                .map(|last| place(last).map_or(Last::Always, Last::At)),
        }
    }

    fn word_place(&mut self, net: usize, language: &Language, state: usize) {
        let Some(of) = self.nets.get(net) else { return };
        let way = language.way(state);
        let names = way.iter().skip(way.len().saturating_sub(SHOWN));
        let names = names.filter_map(|symbol| Some(of.commands().get(*symbol)?.symbol.as_str()));
        let names: Vec<&str> = names.collect();
        let so_far = match (names.is_empty(), way.len() > SHOWN) {
            (true, _) => "nothing".to_owned(),
            (false, false) => names.join(" "),
            (false, true) => format!("... {}", names.join(" ")),
        };
        let (name, at) = (
            format!("tape of {} after {so_far}", of.name()),
            of.at().clone(),
        );
        self.places.push(SystemPlace {
            net,
            stands: Stands::Word(state),
            name,
            at,
            tokens: u32::from(state == 0),
            capacity: None,
        });
    }

    fn on_tape(&self, net: usize, command: CommandId) -> Option<SystemPlaceId> {
        self.places
            .iter()
            .position(|place| place.net == net && place.stands == Stands::OnTape(command))
    }

    /// A step that changes nothing, enabled where nothing more can come on any tape. Where one tape can
    /// always go on, no marking with all commands answered is dead, so there is no need of it.
    fn end(&mut self, commanders: &[Commander]) {
        let mut reads = Vec::new();
        for commander in commanders {
            reads.push((commander.idle, 1));
            match commander.last {
                Some(Last::At(place)) => reads.push((place, 1)),
                Some(Last::Always) => {}
                None => return,
            }
        }
        if !reads.is_empty() {
            self.steps.push(Step {
                reads,
                ..commander_step(0, Phase::End)
            });
        }
    }
}

/// A step that no net chooses.
fn commander_step(net: usize, phase: Phase) -> Step {
    Step {
        net,
        transition: None,
        phase,
        takes: Vec::new(),
        reads: Vec::new(),
        forbids: Vec::new(),
        resets: Vec::new(),
        puts: Vec::new(),
        when: None,
        priority: None,
        unasked: false,
        overfills: None,
    }
}

//! The Dispatcher of `carry`: the functions of `nets/carry/dispatcher.net`, which turns a command in board coordinates into
//! an errand, and tells what became of it.

use std::rc::Rc;

use ctos::{
    config::{App, TaskConfig},
    diagnostic::{Finding, Findings},
    registry::Registry,
    task::{Context, HandlerError},
};
use nalgebra::Vector3;
use pnt::library::{Acted, Action, Library};
use serde::{Deserialize, Serialize};

use super::{
    board::{Board, Field},
    errand::{
        ERRAND, Errand, HAND_PROBLEMS, LASER_PROBLEMS, Problem, Problems, ROBOT_PROBLEMS,
        VISION_PROBLEMS, WAY, WAYS, Way, Ways,
    },
    laser::{SHOWN, Shown},
    sight::{self, FOUND, Found, Hindrance, SIGHT, Sight},
    speaker::{self, Speaker},
    thing::Thing,
};
use crate::{
    dom::DomStore,
    handler::{self, NetArgs},
    organization::{TAG, WHY, Why},
    outcome::{Failure, Outcome},
};

/// The handler's name.
pub const HANDLER: &str = "coordinators.carry";

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CarryArgs {
    /// The file of the thing that is carried, relative to the configuration's folder.
    thing: String,
    /// Where the board stands.
    pub(super) board: Board,
    /// How far above the fields the gripper goes to and fro, m.
    #[serde(default = "clearance_m")]
    clearance_m: f64,
    /// What is done when the thing was lost on the way and cameras see it.
    #[serde(default)]
    lost: Lost,
    /// How often the thing is tried to grasp, each time with another turn of the gripper.
    #[serde(default = "tries")]
    tries: u32,
    /// The service object that tells people in the room what went wrong, such as `fork.sound@speaker`; nobody when it is left
    /// out.
    speaker: Option<String>,
    /// Whether the pointer in the hand shows where the thing lies that was lost.
    #[serde(default)]
    show: bool,
    /// The data object manager.
    #[serde(default = "crate::dom_task")]
    dom: String,
}

impl CarryArgs {
    fn speaker(&self) -> Option<Speaker> {
        let name = self.speaker.as_ref();
        name.and_then(|name| Speaker::named(name).ok())
    }
}

fn clearance_m() -> f64 {
    0.1
}

/// What is done with a thing that was lost on the way.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Lost {
    /// It is told where it lies.
    #[default]
    Tell,
    /// It is fetched, once.
    Fetch,
}

fn tries() -> u32 {
    2
}

/// More turns are not known.
const MOST_TRIES: u32 = 100;

/// What the functions share.
pub(super) struct Dispatcher {
    args: Rc<CarryArgs>,
    store: DomStore,
    /// Number of the command in work, from 1.
    command: u32,
    /// What was seen of its ends.
    ends: Ends,
    /// How often it was tried to grasp the thing, and whether it is tried once more.
    tried: u32,
    again: bool,
    /// The thing was lost, and is being fetched from where it was seen.
    fetches: bool,
    /// What the command's sender calls it, and what was in the way besides the problems of the Coordinators.
    tag: String,
    hindrances: Vec<Failure>,
}

/// What was seen of the ends of an errand.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
struct Ends {
    /// Nothing stands on FROM.
    from_is_empty: bool,
    /// Something stands on TO.
    to_is_taken: bool,
    /// After it was set down, the thing is not seen on TO.
    is_elsewhere: bool,
    /// People in the room were told what went wrong.
    said: bool,
    /// Where it lies is shown them by the pointer in the hand.
    is_shown: bool,
}

/// Registers the handler.
pub(super) fn register(registry: &mut Registry) {
    handler::register::<CarryArgs>(registry);
}

impl NetArgs for CarryArgs {
    const HANDLER: &'static str = HANDLER;
    type State = Dispatcher;

    fn dom(&self) -> &str {
        &self.dom
    }

    fn library(self, store: DomStore) -> Library<Dispatcher> {
        library(self, store)
    }

    fn check(&self, task: &TaskConfig, app: &App, findings: &mut Findings) {
        check(self, task, app, findings);
    }
}

fn check(args: &CarryArgs, task: &TaskConfig, app: &App, findings: &mut Findings) {
    let place = |key: &str| task.args.locate(key).unwrap_or_else(|| task.place.clone());
    if let Err((key, help)) = args.board.check() {
        let key = format!("board.{key}");
        let finding = Finding::error(
            "coordinators::carry::board",
            format!("`{key}` makes no sense"),
        );
        findings.push(finding.at(place(&key)).help(help));
    }
    if !(1..=MOST_TRIES).contains(&args.tries) {
        let text = format!("`tries` is {}", args.tries);
        let finding = Finding::error("coordinators::carry::board", text);
        let help = format!("give from 1 to {MOST_TRIES}");
        findings.push(finding.at(place("tries")).help(help));
    }
    if !(0.0..=2.0).contains(&args.clearance_m) {
        let text = format!("`clearance_m` is {}", args.clearance_m);
        let finding = Finding::error("coordinators::carry::board", text);
        findings.push(finding.at(place("clearance_m")).help("give from 0 to 2 m"));
    }
    match args.speaker.as_deref().map(Speaker::named) {
        Some(Ok(speaker)) => {
            if let Some(daemon) = speaker.daemon() {
                crate::need_task(task, app, "speaker", daemon, findings);
            }
        }
        Some(Err(text)) => findings.push(
            Finding::error("coordinators::carry::speaker", text)
                .at(place("speaker"))
                .help("name an object at its daemon, such as `fork.sound@speaker`"),
        ),
        None => {}
    }
    match app.read(&args.thing) {
        Ok(source) => {
            if let Err(found) = Thing::parse(&source) {
                findings.extend(found);
            }
        }
        Err(finding) => findings.push(finding.at(place("thing"))),
    }
}

fn library(args: CarryArgs, store: DomStore) -> Library<Dispatcher> {
    let state = Dispatcher {
        args: Rc::new(args),
        store,
        command: 0,
        ends: Ends::default(),
        tried: 0,
        again: false,
        fetches: false,
        tag: String::new(),
        hindrances: Vec::new(),
    };
    Library::new(state)
        .kept(
            |state| {
                let tries = (state.tried, state.again, state.fetches);
                let why = (state.tag.clone(), state.hindrances.clone());
                (state.command, state.ends, tries, why)
            },
            |state, (command, ends, tries, why)| {
                (state.command, state.ends) = (command, ends);
                (state.tried, state.again, state.fetches) = tries;
                (state.tag, state.hindrances) = why;
            },
        )
        .enabling("from_is_empty", |state: &Dispatcher| {
            state.ends.from_is_empty
        })
        .enabling("to_is_taken", |state: &Dispatcher| state.ends.to_is_taken)
        .enabling("stands_there", |state: &Dispatcher| {
            !state.ends.is_elsewhere
        })
        .enabling("another_try", |state: &Dispatcher| state.again)
        .enabling("is_fetched", |state: &Dispatcher| state.again)
        .enabling("is_shown", |state: &Dispatcher| state.ends.is_shown)
        .action("begin", begin)
        .action("aim", aim)
        .action("judge", judge)
        .action("weigh_trouble", weigh_trouble)
        .action("tell_unverified", tell_unverified)
        .action("tell_found", tell_found)
        .action("tell_shown", tell_shown)
        .action("begin_point", begin_point)
        .action("aim_point", aim_point)
        .action("report_point", report_point)
        .action("report", report)
        .action("report_held", report_held)
        .action("refuse", refuse)
}

type Act = Action<Dispatcher>;

fn parts(action: &Act) -> (Context, Rc<CarryArgs>, DomStore) {
    let (args, store) = action.with_state(|state| (state.args.clone(), state.store.clone()));
    (action.cx().clone(), args, store)
}

/// Reads `FROM TO`, two fields of the board, and makes the errand of them.
async fn begin(action: Act) -> Acted {
    let (cx, args, store) = parts(&action);
    let command = action.with_state(|state| state.command.wrapping_add(1));
    let (tag, words) = tagged(action.arguments());
    let began = match begun(command, &words, &cx, &args) {
        Ok(errand) => store.store(&cx, ERRAND, &errand).await,
        Err(error) => Err(error),
    };
    begin_anew(&action, command, tag, &began);
    began
}

/// The tag of a command, and its other arguments.
fn tagged(arguments: &[String]) -> (String, Vec<String>) {
    let (tags, words): (Vec<_>, Vec<_>) = arguments
        .iter()
        .cloned()
        .partition(|word| word.starts_with(TAG));
    let tag = tags.first().and_then(|word| word.strip_prefix(TAG));
    (tag.unwrap_or_default().to_owned(), words)
}

/// What is known of the command before is over. What an action changes, it changes at its end: a process that dies before that
/// begins it again.
fn begin_anew(action: &Act, command: u32, tag: String, began: &Acted) {
    let refused = |error: &HandlerError| Failure::new(Outcome::Refused, error);
    let hindrances = began.as_ref().err().map(refused).into_iter().collect();
    action.with_state(|state| {
        state.command = command;
        state.ends = Ends::default();
        (state.tried, state.again, state.fetches) = (0, false, false);
        (state.tag, state.hindrances) = (tag, hindrances);
    });
}

/// Keeps what was in the way, for whoever sent the command. An action that is begun again keeps it once.
fn hinder(action: &Act, outcome: Outcome, reason: &str) {
    let failure = Failure::new(outcome, reason);
    action.with_state(|state| {
        if !state.hindrances.contains(&failure) {
            state.hindrances.push(failure);
        }
    });
}

/// Tells whoever sent the command why it was not done, by types: what was in the way, and what the Coordinators could not do.
async fn tell_why(action: &Act) {
    let (tag, mut failures) =
        action.with_state(|state| (state.tag.clone(), state.hindrances.clone()));
    let problems = problems(action).await.into_iter();
    failures.extend(problems.map(|problem| problem.failure));
    tell(action, tag, failures).await;
}

async fn tell(action: &Act, tag: String, failures: Vec<Failure>) {
    let (cx, _, store) = parts(action);
    if let Err(untold) = store.store(&cx, WHY, &Why { tag, failures }).await {
        tracing::warn!(%untold, "why a command was not done could not be told by types");
    }
}

fn begun(
    command: u32,
    arguments: &[String],
    cx: &Context,
    args: &CarryArgs,
) -> Result<Errand, HandlerError> {
    let ([from, to], speed) = order(arguments, &args.board)?;
    let source = cx.app().read(&args.thing);
    let source = source.map_err(|finding| HandlerError::new(finding.to_string()))?;
    let thing = Thing::parse(&source).map_err(|found| HandlerError::new(found.to_string()))?;
    Ok(Errand {
        command,
        from,
        to,
        board: args.board,
        points: [from, to].map(|field| args.board.point(&field, thing.height_m)),
        yaw: args.board.yaw(),
        clearance_m: args.clearance_m,
        speed,
        thing,
    })
}

/// The two fields that a command names, and how fast.
fn order(arguments: &[String], board: &Board) -> Result<([Field; 2], Option<f64>), HandlerError> {
    let is_speed = |word: &&String| word.starts_with("speed=");
    let (speeds, ends): (Vec<&String>, Vec<&String>) = arguments.iter().partition(is_speed);
    let [from, to] = ends.as_slice() else {
        return Err(HandlerError::new(format!(
            "`carry` takes FROM and TO, such as 3,4,0 4,5,0, and was given {} fields",
            ends.len()
        )));
    };
    let field = |text: &str| -> Result<Field, HandlerError> {
        let field: Field = text.parse()?;
        if board.has(&field) {
            return Ok(field);
        }
        Err(HandlerError::new(format!(
            "`{text}` is not on the board: columns and rows are from 1 to {}, heights from 0",
            board.fields
        )))
    };
    let speed = match speeds.as_slice() {
        [] => None,
        [word, ..] => {
            let number = word
                .strip_prefix("speed=")
                .and_then(|text| text.parse().ok());
            let speed = number.filter(|speed| *speed > 0.0 && *speed <= 1.0);
            Some(speed.ok_or_else(|| {
                HandlerError::new(format!(
                    "`{word}`: give a fraction of full speed, above 0 and up to 1"
                ))
            })?)
        }
    };
    Ok(([field(from)?, field(to)?], speed))
}

/// Puts the errand's ends where they were seen, or finds what is in its way.
async fn aim(action: Act) -> Acted {
    let (cx, _, store) = parts(&action);
    action.with_state(|state| state.ends = Ends::default());
    let errand: Errand = store.fetch(&cx, ERRAND).await?;
    let sight: Sight = store.fetch(&cx, SIGHT).await?;
    if sight.command != errand.command {
        return Err(HandlerError::new("nobody looked for this errand"));
    }
    for note in &sight.notes {
        action.note(note);
    }
    let mut ends = Ends::default();
    match sight::aimed(&errand, &sight) {
        Ok(aimed) => return store.store(&cx, ERRAND, &aimed).await,
        Err(Hindrance::NothingAtFrom(text)) => {
            if action.with_state(|state| state.tried > 0) {
                // It was there before it was touched.
                hinder(&action, Outcome::Absent, &text);
                return Err(HandlerError::new(text));
            }
            ends.from_is_empty = true;
            ends.said = true;
            hinder(&action, Outcome::Absent, &text);
            action.note(text);
            tell_why(&action).await;
            let field = speaker::field(&errand.from);
            say(&action, &format!("nothing at {field}"));
        }
        Err(Hindrance::Occupied(text)) => {
            ends.to_is_taken = true;
            ends.said = true;
            hinder(&action, Outcome::Occupied, &text);
            action.note(text);
            tell_why(&action).await;
            say(
                &action,
                &format!("no room at {}", speaker::field(&errand.to)),
            );
        }
        Err(Hindrance::Stuck(text)) => {
            let field = speaker::field(&errand.from);
            say(&action, &format!("stuck together at {field}"));
            action.with_state(|state| state.ends.said = true);
            hinder(&action, Outcome::Stuck, &text);
            return Err(HandlerError::new(text));
        }
        Err(Hindrance::Other(text)) => {
            hinder(&action, Outcome::Refused, &text);
            return Err(HandlerError::new(text));
        }
    }
    action.with_state(|state| state.ends = ends);
    Ok(())
}

/// Whether another turn of the gripper may grasp the thing: something was in the way down, or the jaws found no width that fits.
async fn weigh_trouble(action: Act) -> Acted {
    let (cx, args, store) = parts(&action);
    let command = action.with_state(|state| state.command);
    let mut latest: Option<Problem> = None;
    for object in [ROBOT_PROBLEMS, HAND_PROBLEMS] {
        if let Ok(found) = store.fetch::<Problems>(&cx, object).await
            && found.command == command
        {
            let problems = found.problems.into_iter();
            latest = latest
                .into_iter()
                .chain(problems)
                .max_by_key(|problem| problem.at);
        }
    }
    let may_do = latest.is_some_and(|problem| {
        let outcome = problem.failure.outcome;
        match problem.request.as_str() {
            "descend" => outcome == Outcome::Guard,
            "grasp" => outcome == Outcome::Absent,
            _ => false,
        }
    });
    action.with_state(|state| {
        state.tried += 1;
        state.again = may_do && state.tried < args.tries;
    });
    Ok(())
}

/// What was found out about the thing after the errand.
async fn found(action: &Act) -> Result<Found, HandlerError> {
    let (cx, _, store) = parts(action);
    let command = action.with_state(|state| state.command);
    let found: Found = store.fetch(&cx, FOUND).await?;
    if found.command == command {
        return Ok(found);
    }
    Err(HandlerError::new("nobody looked after this errand"))
}

/// Notes where the thing stands that was set down.
async fn judge(action: Act) -> Acted {
    let found = found(&action).await?;
    for note in &found.notes {
        action.note(note);
    }
    let is_elsewhere = found.arrived == Some(false);
    if !is_elsewhere {
        note_ways(&action).await;
    }
    let mut is_shown = false;
    if is_elsewhere {
        say_lost(&action, &found).await;
        is_shown = prepare_to_show(&action, &found).await?;
        hinder(&action, Outcome::Unseen, &found.notes.join("; "));
    }
    action.with_state(|state| {
        state.ends.is_elsewhere = is_elsewhere;
        state.ends.is_shown = is_shown;
    });
    Ok(())
}

/// Says where the pointer in the hand shall point: at the middle of the upper side of a thing that was lost, when it may be only
/// one. Whether there is something to point at.
async fn prepare_to_show(action: &Act, found: &Found) -> Result<bool, HandlerError> {
    let (cx, args, store) = parts(action);
    let errand: Errand = store.fetch(&cx, ERRAND).await?;
    let there = sight::at_found(&errand, found);
    let Some(there) = there.filter(|_| args.show) else {
        return Ok(false);
    };
    let [at, _] = there.points;
    let shown = Shown {
        command: errand.command,
        at: at + Vector3::z() * errand.thing.height_m,
    };
    store.store(&cx, SHOWN, &shown).await?;
    Ok(true)
}

/// Notes that people were shown where it lies.
async fn tell_shown(action: Act) -> Acted {
    action.note("the pointer in the hand has shown where it lies");
    Ok(())
}

/// Reads `FIELD`, which shall be pointed at. As an errand its ends are the same.
async fn begin_point(action: Act) -> Acted {
    let (cx, args, store) = parts(&action);
    let command = action.with_state(|state| state.command.wrapping_add(1));
    let (tag, words) = tagged(action.arguments());
    let began = match words.as_slice() {
        [field] => {
            let ends = [field.clone(), field.clone()];
            match begun(command, &ends, &cx, &args) {
                Ok(errand) => store.store(&cx, ERRAND, &errand).await,
                Err(error) => Err(error),
            }
        }
        other => Err(HandlerError::new(format!(
            "`point` takes a field, such as 3,4,0, and was given {}",
            other.len()
        ))),
    };
    begin_anew(&action, command, tag, &began);
    began
}

/// Puts the field where the board was seen.
async fn aim_point(action: Act) -> Acted {
    let (cx, _, store) = parts(&action);
    let errand: Errand = store.fetch(&cx, ERRAND).await?;
    let sight: Sight = store.fetch(&cx, SIGHT).await?;
    if sight.command != errand.command {
        return Err(HandlerError::new("nobody looked for this command"));
    }
    for note in &sight.notes {
        action.note(note);
    }
    let shown = Shown {
        command: errand.command,
        at: sight.board.point(&errand.to, errand.thing.height_m),
    };
    store.store(&cx, SHOWN, &shown).await
}

/// Notes why a field was not pointed at.
async fn report_point(action: Act) -> Acted {
    note_problems(&action).await;
    tell_why(&action).await;
    Ok(())
}

/// Notes which ways the arm has gone, and what is believed of them by now.
async fn note_ways(action: &Act) {
    let (cx, _, store) = parts(action);
    let command = action.with_state(|state| state.command);
    if let Ok(way) = store.fetch::<Way>(&cx, WAY).await
        && way.command == command
        && let Some([x, y]) = way.shift
    {
        let off_mm = 1e3 * x.hypot(y);
        action.note(format!(
            "the camera on the hand saw it {off_mm:.1} mm beside"
        ));
    }
    if let Ok(ways) = store.fetch::<Ways>(&cx, WAYS).await
        && ways.command == command
    {
        for line in ways.lines {
            action.note(line);
        }
    }
}

fn say(action: &Act, words: &str) {
    let args = action.with_state(|state| state.args.clone());
    speaker::say(action.cx(), args.speaker().as_ref(), words);
}

/// Tells people in the room where the thing lies that is not where it should be.
async fn say_lost(action: &Act, found: &Found) {
    let (cx, _, store) = parts(action);
    let Ok(errand) = store.fetch::<Errand>(&cx, ERRAND).await else {
        return;
    };
    if !found.looked {
        return;
    }
    say(action, &lost(&errand, found));
    action.with_state(|state| state.ends.said = true);
}

fn lost(errand: &Errand, found: &Found) -> String {
    let (thing, board) = (&errand.thing, &found.board);
    let Some(at) = found.lies.first() else {
        return format!("{} lost", thing.name);
    };
    let lies = board.field(at, thing.height_m);
    let name = speaker::field(&lies);
    if !board.has(&Field {
        height: 0.0,
        ..lies
    }) || at.z < -1e-3
    {
        format!("{} lost beside the board", thing.name)
    } else if name == speaker::field(&errand.from) {
        format!("{} still at {name}", thing.name)
    } else {
        format!("{} lost at {name}", thing.name)
    }
}

/// Notes where the thing is that was not carried. One that was lost is fetched from there, where the configuration says so.
async fn tell_found(action: Act) -> Acted {
    action.with_state(|state| {
        state.again = false;
        state.ends.is_shown = false;
    });
    let found = found(&action).await?;
    for note in &found.notes {
        action.note(note);
    }
    say_lost(&action, &found).await;
    let (cx, args, store) = parts(&action);
    let has_fetched = action.with_state(|state| state.fetches);
    let errand: Errand = store.fetch(&cx, ERRAND).await?;
    if args.lost == Lost::Fetch
        && !has_fetched
        && let Some(there) = sight::at_found(&errand, &found)
    {
        let field = speaker::field(&there.from);
        store.store(&cx, ERRAND, &there).await?;
        let Field { column, row, .. } = there.from;
        action.note(format!("it is fetched from {column:.2},{row:.2}"));
        say(&action, &format!("fetching from {field}"));
        action.with_state(|state| (state.again, state.fetches) = (true, true));
        return Ok(());
    }
    let is_shown = prepare_to_show(&action, &found).await?;
    action.with_state(|state| state.ends.is_shown = is_shown);
    Ok(())
}

/// Notes why nobody saw where the thing stands.
async fn tell_unverified(action: Act) -> Acted {
    let (cx, _, store) = parts(&action);
    let command = action.with_state(|state| state.command);
    let problems: Problems = store.fetch(&cx, VISION_PROBLEMS).await?;
    if let Some(problem) = problems.problems.last()
        && problems.command == command
    {
        let reason = &problem.failure.reason;
        action.note(format!("it was set down, and nobody sees it: {reason}"));
    }
    note_ways(&action).await;
    Ok(())
}

/// Notes, for the answer, what was not done and why, in the order of time.
async fn report(action: Act) -> Acted {
    note_problems(&action).await;
    tell_why(&action).await;
    say_failed(&action, "not carried").await;
    Ok(())
}

/// The same of an errand that ended with the thing in the hand.
async fn report_held(action: Act) -> Acted {
    note_problems(&action).await;
    tell_why(&action).await;
    say_failed(&action, "still in the hand").await;
    Ok(())
}

/// Tells people in the room, unless they know already.
async fn say_failed(action: &Act, words: &str) {
    let (cx, _, store) = parts(action);
    let (command, said) = action.with_state(|state| (state.command, state.ends.said));
    if let Ok(errand) = store.fetch::<Errand>(&cx, ERRAND).await
        && errand.command == command
        && !said
    {
        say(action, &format!("{} {words}", errand.thing.name));
    }
}

/// What the Coordinators could not do, in the order of time.
async fn problems(action: &Act) -> Vec<Problem> {
    let (cx, _, store) = parts(action);
    let command = action.with_state(|state| state.command);
    let mut all = Vec::new();
    for object in [
        ROBOT_PROBLEMS,
        HAND_PROBLEMS,
        VISION_PROBLEMS,
        LASER_PROBLEMS,
    ] {
        if let Ok(found) = store.fetch::<Problems>(&cx, object).await
            && found.command == command
        {
            all.extend(found.problems);
        }
    }
    all.sort_by_key(|problem| problem.at);
    all
}

async fn note_problems(action: &Act) {
    for Problem {
        request, failure, ..
    } in problems(action).await
    {
        // A stop that somebody ended is no reason.
        let Failure { outcome, reason } = failure;
        match outcome {
            Outcome::Stopped => action.note(format!("{request} was stopped: {reason}")),
            _ => action.note(format!("{request}: {reason}")),
        }
    }
    note_ways(action).await;
}

/// Says why a hand that is full takes nothing.
async fn refuse(action: Act) -> Acted {
    let text =
        "the hand still holds what it could not put down: `put_back` puts it where it was taken";
    action.note(text);
    let (tag, _) = tagged(action.arguments());
    tell(&action, tag, vec![Failure::new(Outcome::Refused, text)]).await;
    Ok(())
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;

    use super::*;
    use crate::carry::tests::errand;

    #[test]
    fn people_are_told_where_a_thing_lies_by_the_nearest_field_or_that_it_is_beside_the_board() {
        let errand = errand();
        let found = |lies: &[Point3<f64>]| Found {
            command: 1,
            looked: true,
            arrived: None,
            off_m: None,
            board: errand.board,
            lies: lies.to_vec(),
            notes: Vec::new(),
        };
        let on = |field: &str| errand.board.on_board(&field.parse().unwrap(), 0.01);
        for (lies, said) in [
            (vec![], "disc lost"),
            (vec![on("4.3,4.6,0")], "disc lost at D 5"),
            (vec![on("3.1,4,0")], "disc still at C 4"),
            (vec![on("9,4,0")], "disc lost beside the board"),
            (
                vec![on("4,5,0") - Vector3::z() * 0.02],
                "disc lost beside the board",
            ),
        ] {
            assert_eq!(lost(&errand, &found(&lies)), said);
        }
    }

    const BOARD: Board = Board {
        at: [0.5, 0.0, 0.42],
        yaw_deg: 0.0,
        field_m: 0.06,
        fields: 8,
        thick_m: 0.02,
        dot: None,
    };

    #[test]
    fn a_command_names_two_fields_of_the_board_or_is_refused_in_words() {
        let ends = |words: &[&str]| {
            let words: Vec<String> = words.iter().map(ToString::to_string).collect();
            super::order(&words, &BOARD).map_err(|error| error.to_string())
        };
        let ([from, to], speed) = ends(&["3,4,0", "4,5", "speed=0.2"]).unwrap();
        assert_eq!(speed, Some(0.2));
        assert_eq!((from.column, from.row, to.row), (3.0, 4.0, 5.0));
        for (words, text) in [
            (&["3,4"][..], "FROM and TO"),
            (&["3,4", "4,5", "5,6"], "3 fields"),
            (&["3,4", "4,5", "speed=2"], "fraction of full speed"),
            (&["3,4", "x"], "is no field"),
            (&["3,4", "9,5"], "not on the board"),
        ] {
            let error = ends(words).unwrap_err();
            assert!(error.contains(text), "{words:?}: {error}");
        }
    }
}

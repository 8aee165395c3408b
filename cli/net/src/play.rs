//! `ctos net play`.

use std::{
    collections::{BTreeMap, BTreeSet},
    io::{self, Read as _},
    path::{Path, PathBuf},
    sync::Arc,
};

use clap::Args;
use ctos::{
    diagnostic::{Finding, Findings, Source},
    registry::Registry,
};
use pnt::{
    analysis::{
        model::{Model, TransitionNumber},
        play::{Lack, Player, Refused, Wanted},
    },
    compose::System,
    format,
    net::Net,
};
use serde_json::{Value, json};

use cli_common::{exit, show};

use crate::{ReadApp, check};

/// Play a firing sequence, such as a counterexample of `ctos net check`, step by step
///
/// The sequence begins at the initial marking of the nets. Each step is shown with the marking after it, and at the
/// end what may fire then. A step that is not possible ends it with exit code 1 and the reason.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  ctos net check grab.net --json | ctos net play grab.net --sequence -
  ctos net play grab.net --sequence steps.txt --json")]
pub struct PlayArgs {
    /// The nets
    #[arg(value_name = "FILE", required_unless_present = "app")]
    pub files: Vec<PathBuf>,
    /// Play the nets of this app, all together; a FILE takes the place of its net of the same name
    #[arg(long, value_name = "APP")]
    pub app: Option<PathBuf>,
    /// The sequence, or `-` for standard input: step names on lines or with commas between them, a JSON list of them,
    /// or what `ctos net check --json` has written
    #[arg(long, value_name = "FILE")]
    pub sequence: PathBuf,
    /// Of several counterexamples in the sequence file, which to play
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..), default_value = "1")]
    pub number: u16,
    /// Print a JSON object for each step
    #[arg(long)]
    pub json: bool,
}

/// Runs the command.
#[must_use]
pub fn run(args: &PlayArgs, registry: &Registry, read: ReadApp) -> u8 {
    let read = nets(args, registry, read).and_then(|nets| {
        let (system, found) = System::compose(&nets);
        if found.has_errors() {
            return Err(found);
        }
        let model = Model::of_system(&system);
        let steps = steps(args, &model)?;
        Ok((model, steps))
    });
    let (model, steps) = match read {
        Ok(read) => read,
        Err(findings) => {
            show::findings(findings);
            return exit::CONFIG;
        }
    };
    play(&model, &steps, args.json)
}

fn nets(args: &PlayArgs, registry: &Registry, read: ReadApp) -> Result<Vec<Arc<Net>>, Findings> {
    let mut nets = Vec::new();
    let mut findings = Findings::new();
    for file in &args.files {
        match format::load(file) {
            Ok((net, _)) => nets.push(Arc::new(net)),
            Err(found) => findings.extend(found),
        }
    }
    if findings.has_errors() {
        return Err(findings);
    }
    if let Some(app) = &args.app {
        nets.extend(check::others_of_app(app, &nets, registry, read)?);
    }
    Ok(nets)
}

/// A step by its name: the ways in which it can be taken, of which the marking permits one at most.
type Ways = Vec<TransitionNumber>;

/// The steps of the sequence file.
fn steps(args: &PlayArgs, model: &Model) -> Result<Vec<Ways>, Findings> {
    let source = if args.sequence == Path::new("-") {
        let mut text = String::new();
        io::stdin().read_to_string(&mut text).map_err(|error| {
            Finding::error(
                "ctos::file::unreadable",
                format!("standard input cannot be read: {error}"),
            )
        })?;
        Source::new("standard input", text)
    } else {
        Source::read(&args.sequence)?
    };
    let names = Names::of(model);
    let trimmed = source.text().trim_start();
    if trimmed.starts_with('{') || trimmed.starts_with('[') {
        let words = words_of_json(&source, args.number)?;
        let at = || source.at(0..0);
        let each = words.iter().map(|word| names.find(word, at()));
        return found(each);
    }
    let mut each = Vec::new();
    let mut start = 0;
    for line in source.text().split_inclusive('\n') {
        let text = line.split('#').next().unwrap_or_default();
        // A name may have commas itself.
        let parts = match names.knows(text.trim()) {
            true => vec![text],
            false => text.split(',').collect(),
        };
        let mut at = start;
        for part in parts {
            let word = part.trim();
            if !word.is_empty() {
                let begin = at + (part.len() - part.trim_start().len());
                each.push(names.find(word, source.at(begin..begin + word.len())));
            }
            at += part.len() + 1;
        }
        start += line.len();
    }
    found(each)
}

fn found(each: impl IntoIterator<Item = Result<Ways, Finding>>) -> Result<Vec<Ways>, Findings> {
    let mut findings = Findings::new();
    let mut steps = Vec::new();
    for step in each {
        steps.extend(findings.keep(step));
    }
    if findings.has_errors() {
        Err(findings)
    } else {
        Ok(steps)
    }
}

/// Names of steps, with and without the net where that leaves no doubt.
struct Names<'a> {
    by_name: BTreeMap<&'a str, Ways>,
    /// Names without the net, and those that they may stand for.
    short: BTreeMap<&'a str, BTreeSet<&'a str>>,
}

impl<'a> Names<'a> {
    fn of(model: &'a Model) -> Self {
        let mut by_name: BTreeMap<&str, Ways> = BTreeMap::new();
        let mut short: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
        for (number, transition) in (0..).zip(&model.transitions) {
            let name = transition.name.as_str();
            by_name.entry(name).or_default().push(number);
            if let Some((_, without_net)) = name.split_once('.') {
                short.entry(without_net).or_default().insert(name);
            }
        }
        Self { by_name, short }
    }

    fn knows(&self, word: &str) -> bool {
        self.by_name.contains_key(word) || self.short.contains_key(word)
    }

    fn find(&self, word: &str, at: ctos::diagnostic::Place) -> Result<Ways, Finding> {
        if let Some(ways) = self.by_name.get(word) {
            return Ok(ways.clone());
        }
        let meant: Vec<&Ways> = self
            .short
            .get(word)
            .into_iter()
            .flatten()
            .filter_map(|name| self.by_name.get(name))
            .collect();
        match meant.as_slice() {
            [ways] => Ok((*ways).clone()),
            [] => Err(
                Finding::error("pnt::play::step", format!("there is no step `{word}`"))
                    .at(at)
                    .suggest(word, self.by_name.keys().chain(self.short.keys()).copied()),
            ),
            _ => {
                let text = format!("several nets have a step `{word}`");
                Err(Finding::error("pnt::play::step", text)
                    .at(at)
                    .help("write the name of the net and a point before it"))
            }
        }
    }
}

/// The names in a JSON list, or in what a check has written: then one of its counterexamples, and its round twice.
fn words_of_json(source: &Source, number: u16) -> Result<Vec<String>, Finding> {
    let bad = |text: String| {
        Finding::error("pnt::play::sequence", text)
            .at(source.at(0..0))
            .help("give a list of step names, or what `ctos net check --json` has written")
    };
    let mut values = Vec::new();
    for value in serde_json::Deserializer::from_str(source.text()).into_iter::<Value>() {
        values.push(value.map_err(|error| bad(format!("this is no JSON: {error}")))?);
    }
    let list = |value: &Value| -> Option<Vec<String>> {
        let each = value.as_array()?.iter();
        each.map(|word| word.as_str().map(str::to_owned)).collect()
    };
    if let Some(words) = values.first().and_then(list) {
        return Ok(words);
    }
    let shown = |value: &Value| {
        let lists = ["counterexamples", "questions"].map(|key| value.get(key).cloned());
        lists
            .into_iter()
            .flatten()
            .flat_map(|list| list.as_array().cloned().unwrap_or_default())
            .filter(|shown| shown.get("sequence").is_some_and(Value::is_array))
            .collect::<Vec<_>>()
    };
    let all: Vec<Value> = values.iter().flat_map(shown).collect();
    let one = all
        .get(usize::from(number) - 1)
        .ok_or_else(|| match all.len() {
            0 => bad("there is no sequence here".to_owned())
                .help("a check of sound nets has nothing to show; give a list of step names"),
            count => bad(format!(
                "there is no sequence {number} here; there are {count}"
            ))
            .help("count with `--number` from 1"),
        })?;
    let part = |key: &str| one.get(key).and_then(list).unwrap_or_default();
    let round = part("round");
    Ok([part("sequence"), round.clone(), round].concat())
}

fn play(model: &Model, steps: &[Ways], json: bool) -> u8 {
    let name = |number: TransitionNumber| {
        let transition = model.transitions.get(number as usize);
        transition.map(|t| t.name.clone()).unwrap_or_default()
    };
    let names = |numbers: &[TransitionNumber]| -> Vec<String> {
        numbers.iter().map(|number| name(*number)).collect()
    };
    let mut player = Player::new(model);
    let told = |number: usize, step: Option<String>, player: &Player<'_>| {
        let marking = marking(model, player.marking());
        if json {
            return json!({ "step": number, "fires": step, "marking": marking }).to_string();
        }
        let marked: Vec<String> = marking
            .iter()
            .map(|(place, tokens)| match tokens {
                1 => place.clone(),
                _ => format!("{place}*{tokens}"),
            })
            .collect();
        let marked = match marked.is_empty() {
            true => "no tokens at all".to_owned(),
            false => marked.join(", "),
        };
        let step = step.unwrap_or_else(|| "begins".to_owned());
        format!("{number:>4}  {step}: {marked}")
    };
    if show::data(&told(0, None, &player)).is_err() {
        return exit::OK;
    }
    for (before, ways) in steps.iter().enumerate() {
        let number = before + 1;
        let step = ways.first().copied().unwrap_or_default();
        if let Err(refused) = fire(&mut player, ways) {
            let why = why(model, &refused, &names);
            let enabled = names(&player.enabled());
            if json {
                let line = json!({
                    "step": number, "refused": name(step), "why": why, "enabled": enabled,
                });
                let _ = show::data(&line.to_string());
            }
            show::say(&format!(
                "error: step {number}, `{}`, is not possible: {why}",
                name(step)
            ));
            return exit::FAILED;
        }
        // A reader that went away has what it wanted.
        if show::data(&told(number, Some(name(step)), &player)).is_err() {
            return exit::OK;
        }
    }
    let enabled = names(&player.enabled());
    let end = match (json, enabled.is_empty()) {
        (true, _) => json!({ "enabled": enabled }).to_string(),
        (false, true) => "nothing can fire then".to_owned(),
        (false, false) => format!("then can fire: {}", enabled.join(", ")),
    };
    let _ = show::data(&end);
    exit::OK
}

/// Takes a step in the way that is possible; else what keeps it from the way that lacks least.
fn fire(player: &mut Player<'_>, ways: &[TransitionNumber]) -> Result<(), Refused> {
    let mut nearest = Refused::Lacks(Vec::new());
    let mut fewest = usize::MAX;
    for way in ways {
        let refused = match player.fire(*way) {
            Ok(()) => return Ok(()),
            Err(refused) => refused,
        };
        let lacking = match &refused {
            Refused::Lacks(lacks) => lacks.len(),
            Refused::MoreUrgent(_) | Refused::Overflow => 0,
        };
        if lacking < fewest {
            (nearest, fewest) = (refused, lacking);
        }
    }
    Err(nearest)
}

fn marking(model: &Model, marking: &[u32]) -> BTreeMap<String, u32> {
    let pairs = model.places.iter().zip(marking);
    let held = pairs.filter(|(_, tokens)| **tokens > 0);
    held.map(|(place, tokens)| (place.name.clone(), *tokens))
        .collect()
}

fn why(
    model: &Model,
    refused: &Refused,
    names: &dyn Fn(&[TransitionNumber]) -> Vec<String>,
) -> String {
    let lack = |lack: &Lack| {
        let place = model.places.get(lack.place as usize);
        let place = place.map(|place| place.name.as_str()).unwrap_or_default();
        match lack.wanted {
            Wanted::AtLeast(needs) => {
                format!("`{place}` holds {}, needs {needs}", lack.holds)
            }
            Wanted::Below(below) => {
                format!("`{place}` holds {}, needs fewer than {below}", lack.holds)
            }
        }
    };
    match refused {
        Refused::Lacks(lacks) => lacks.iter().map(lack).collect::<Vec<_>>().join("; "),
        Refused::MoreUrgent(others) => {
            format!("`{}` is more urgent", names(others).join("` or `"))
        }
        Refused::Overflow => "a place would hold more than can be counted".to_owned(),
    }
}

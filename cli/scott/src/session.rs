//! Runs statements against a manager of service objects, and writes what comes of them.

use std::{
    fmt,
    io::{self, Read},
    sync::mpsc::SyncSender,
    time::Duration,
};

use ctos::time::Clock;
use serde_json::json;
use sorma::{Reply, Transport, report::code, words};

use super::{
    attach::{Interrupt, Interrupted},
    backend::Backend,
    helping,
    lines::{LONGEST_LINE, next_line},
    replies::{self, Times, told},
    script::{self, Expectation, Statement, Variables},
    watch::{self, Wanted},
};
use cli_common::{exit, show, table};

/// Runs statements.
pub struct Session {
    backend: Backend,
    /// Counts the views of `watch` and `trace`.
    views: u64,
    /// Where lines go while one is being edited.
    above: Option<SyncSender<String>>,
    clock: Clock,
    variables: Variables,
    last: Option<Transport>,
    /// A request ended with an error that no expectation has met yet.
    pending: Option<Failure>,
    /// Replies as JSON.
    json: bool,
    /// Replies as a person reads them, and not as they can be read back.
    for_people: bool,
    /// Goes on after a failure.
    keep_going: bool,
    /// The exit code of the first failure.
    failed: u8,
}

/// What went wrong, where, and the exit code that it means.
struct Failure {
    place: String,
    text: String,
    exit: u8,
}

/// Where a statement stands, for messages: `file:3`.
pub struct Place<'a> {
    /// The file's name, or another name of what is read.
    pub name: &'a str,
    /// The line, from 1; 0 for none.
    pub line: usize,
    /// The exit code of a statement that is none.
    pub wrong: u8,
}

impl<'a> Place<'a> {
    /// A line of a file.
    #[must_use]
    pub fn of_file(name: &'a str, line: usize) -> Self {
        Self {
            name,
            line,
            wrong: exit::CONFIG,
        }
    }
}

impl fmt::Display for Place<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.line {
            0 => f.write_str(self.name),
            line => write!(f, "{}:{line}", self.name),
        }
    }
}

/// Whether to go on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Flow {
    /// With the next statement.
    On,
    /// No: something failed.
    Stop,
}

impl Session {
    /// A session with the objects of `backend`.
    #[must_use]
    pub fn new(backend: Backend, json: bool, keep_going: bool) -> Self {
        Self {
            backend,
            views: 0,
            above: None,
            clock: Clock::real(),
            variables: Variables::new(),
            last: None,
            pending: None,
            json,
            for_people: false,
            keep_going,
            failed: exit::OK,
        }
    }

    /// From now on replies are shown as a person reads them, unless they are wanted as JSON.
    pub fn show_to_people(&mut self) {
        self.for_people = true;
    }

    /// Lines of what goes on in the background of the prompt are sent there from now on.
    pub fn show_above(&mut self, above: SyncSender<String>) {
        self.above = Some(above);
    }

    /// Whom it asks.
    pub fn backend(&mut self) -> &mut Backend {
        &mut self.backend
    }

    /// Names of the variables.
    pub fn variables(&self) -> impl Iterator<Item = &str> {
        self.variables.keys().map(String::as_str)
    }

    /// The exit code so far, when nothing more comes.
    pub fn end(&mut self) -> u8 {
        self.settle();
        self.failed
    }

    /// Runs a script of lines; a line that ends with `\` goes on in the next.
    pub fn script(&mut self, name: &str, input: impl Read) -> Flow {
        let mut input = io::BufReader::new(input);
        let mut line = 0;
        let mut begun = (0, String::new());
        loop {
            line += 1;
            let place = Place::of_file(name, line);
            let text = match next_line(&mut input) {
                Ok(Some(Ok(text))) => text,
                Ok(None) => break,
                Ok(Some(Err(why))) => {
                    let told = self.settle() == Flow::On;
                    if !told || self.fail(&place, &why, exit::CONFIG) == Flow::Stop {
                        return Flow::Stop;
                    }
                    continue;
                }
                // Whatever comes after cannot be read either.
                Err(error) => {
                    let _ = self.fail(&place, &format!("cannot be read: {error}"), exit::CONFIG);
                    return Flow::Stop;
                }
            };
            if begun.1.is_empty() {
                begun.0 = line;
            }
            match text.strip_suffix('\\') {
                Some(more) => {
                    begun.1.push_str(more);
                    begun.1.push(' ');
                    if begun.1.len() <= LONGEST_LINE {
                        continue;
                    }
                }
                None => begun.1.push_str(&text),
            }
            let (line, statement) = std::mem::take(&mut begun);
            if self.line(&Place::of_file(name, line), &statement) == Flow::Stop {
                return Flow::Stop;
            }
        }
        if begun.1.is_empty() {
            return Flow::On;
        }
        self.line(&Place::of_file(name, begun.0), &begun.1)
    }

    /// Runs one line.
    pub fn line(&mut self, place: &Place<'_>, line: &str) -> Flow {
        let statement = script::replace(line, &self.variables).and_then(|line| script::read(&line));
        let statement = match statement {
            Ok(Statement::Nothing) => return Flow::On,
            Ok(statement) => statement,
            Err(why) => {
                // Earlier messages come first.
                return match self.settle() {
                    Flow::On => self.fail(place, &why, place.wrong),
                    Flow::Stop => Flow::Stop,
                };
            }
        };
        if !matches!(statement, Statement::Expect(_)) && self.settle() == Flow::Stop {
            return Flow::Stop;
        }
        let statement = match self.for_people {
            true => self.meant(statement),
            false => statement,
        };
        match statement {
            Statement::Nothing => Flow::On,
            Statement::Help(name) => self.help(place, name.as_deref()),
            Statement::List(part) => self.list(&part),
            Statement::Set { name, words } => {
                self.variables.insert(name, words);
                Flow::On
            }
            Statement::Expect(expected) => self.expect(place, &expected),
            Statement::Request(request) => match self.backend.dispatch(&request, 0) {
                Ok(reply) => self.replied(place, &request, &reply, None),
                Err(Interrupted) => self.cancelled(place),
            },
            Statement::Trace(request) => self.trace(place, &request),
            Statement::Watch(wanted) => self.watch(place, &wanted),
            Statement::Time(request) => self.timed(place, &request, None),
            Statement::Repeat(count, request) => self.timed(place, &request, Some(count)),
        }
    }

    /// What a person means who types a statement.
    fn meant(&mut self, statement: Statement) -> Statement {
        let classes = self.backend.classes();
        let spoken = |request: String| helping::spoken(&request, classes).into_owned();
        match statement {
            // A name alone asks what it is.
            Statement::Request(word) if !word.contains(char::is_whitespace) => {
                Statement::Help(Some(word))
            }
            Statement::Request(request) => Statement::Request(spoken(request)),
            Statement::Time(request) => Statement::Time(spoken(request)),
            Statement::Trace(request) => Statement::Trace(spoken(request)),
            Statement::Repeat(count, request) => Statement::Repeat(count, spoken(request)),
            other => other,
        }
    }

    fn help(&mut self, place: &Place<'_>, name: Option<&str>) -> Flow {
        let text = match name {
            None => format!("{}{}", helping::FIRST, crate::STATEMENTS),
            Some(name) => match helping::about(name, self.backend.classes()) {
                Ok(text) => text,
                Err(why) => return self.fail(place, &why, exit::NO_SUCH_NAME),
            },
        };
        self.tell(&match self.json {
            true => json!({ "help": text }).to_string(),
            false => table::for_terminal(&text),
        })
    }

    fn list(&mut self, part: &str) -> Flow {
        let (names, classes) = self.backend.known();
        let listed = helping::listed(part, &names, &classes);
        let lines = listed.iter().map(|listed| match self.json {
            true => listed.json().to_string(),
            false => listed.text(),
        });
        let lines: Vec<String> = lines.collect();
        match (lines.as_slice(), self.json) {
            ([], true) => Flow::On,
            ([], false) => self.tell(&format!("nothing has `{part}` in its name")),
            (lines, true) => self.tell(&lines.join("\n")),
            (lines, false) => self.tell(&table::for_terminal(&lines.join("\n"))),
        }
    }

    fn tell(&self, text: &str) -> Flow {
        match show::data(text) {
            Ok(()) => Flow::On,
            // The reader has closed the output.
            Err(_) => Flow::Stop,
        }
    }

    /// An error that no expectation has met becomes a failure.
    fn settle(&mut self) -> Flow {
        match self.pending.take() {
            None => Flow::On,
            Some(failure) => self.fail(&failure.place, &failure.text, failure.exit),
        }
    }

    fn fail(&mut self, place: &dyn fmt::Display, why: &str, code: u8) -> Flow {
        // At the prompt the person knows where that was.
        match self.for_people {
            true => show::say(&table::for_terminal(&format!("error: {why}"))),
            false => show::say(&format!("{place}: {why}")),
        }
        if self.failed == exit::OK {
            self.failed = code;
        }
        if self.keep_going {
            Flow::On
        } else {
            Flow::Stop
        }
    }

    fn expect(&mut self, place: &Place<'_>, expected: &Expectation) -> Flow {
        let Some(last) = &self.last else {
            return self.fail(
                place,
                "there is no reply yet to expect anything of",
                place.wrong,
            );
        };
        let unmet = expected.unmet(last);
        if !unmet.is_empty() {
            self.pending = None;
            return self.fail(place, &unmet.join("; "), exit::FAILED);
        }
        if expected.code.is_some() {
            self.pending = None;
        }
        Flow::On
    }

    /// Dispatches a request once or `count` times and tells how long it took.
    fn timed(&mut self, place: &Place<'_>, request: &str, count: Option<u64>) -> Flow {
        let mut times: Vec<Duration> = Vec::new();
        let mut reply = String::new();
        for _ in 0..count.unwrap_or(1) {
            let start = self.clock.now();
            reply = match self.backend.dispatch(request, 0) {
                Ok(reply) => reply,
                Err(Interrupted) => return self.cancelled(place),
            };
            times.push(self.clock.now() - start);
            let good = reply.parse::<Reply>().is_ok_and(|reply| reply.body.is_ok());
            if !good || self.backend.is_interrupted() {
                break;
            }
        }
        times.sort_unstable();
        let at = |index: usize| times.get(index).copied().unwrap_or_default();
        let told = Times {
            repeats: count.map(|_| times.len()),
            least: at(0),
            median: at(times.len() / 2),
            longest: at(times.len().saturating_sub(1)),
        };
        self.replied(place, request, &reply, Some(&told))
    }

    /// The user has pressed Ctrl-C: nothing more is done, whatever was to be kept going.
    fn cancelled(&mut self, place: &Place<'_>) -> Flow {
        let why = "cancelled; the app may still be at it, and what was locked for this session is free again. `pino EXEC stop` stops an arm";
        let _ = self.fail(place, why, exit::INTERRUPTED);
        Flow::Stop
    }

    /// Has a request met and shows everything that it led to.
    fn trace(&mut self, place: &Place<'_>, request: &str) -> Flow {
        self.views += 1;
        let (reply, all) = match watch::trace(&mut self.backend, request, self.views) {
            Ok(traced) => traced,
            Err(Interrupted) => return self.cancelled(place),
        };
        let all = match all {
            Ok(all) => all,
            Err(why) => {
                show::say(&format!("{place}: not everything could be traced: {why}"));
                Vec::new()
            }
        };
        let begin_s = all.first().map_or(0.0, |first| first.at_s);
        for seen in &all {
            let line = match self.json {
                true => watch::as_json(seen).to_string(),
                false if self.for_people => {
                    watch::nested_line(seen, &replies::brief(&seen.reply), begin_s)
                }
                // A script reads the reply; what it led to stands behind it as a comment.
                false => {
                    let answer = watch::answer_of(seen);
                    format!("# {}", watch::nested_line(seen, answer, begin_s))
                }
            };
            if show::data(&line).is_err() {
                return Flow::Stop;
            }
        }
        self.replied(place, request, &reply, None)
    }

    /// Shows the requests that others make.
    fn watch(&mut self, place: &Place<'_>, wanted: &Wanted) -> Flow {
        self.views += 1;
        let (number, json, for_people) = (self.views, self.json, self.for_people);
        let Backend::App(app) = &self.backend else {
            let why = "watch shows what a running app is asked; here is nobody else who asks";
            return self.fail(place, why, exit::FAILED);
        };
        // What goes on in the background of the prompt is not ended by what ends a request.
        let interrupt = match wanted.background && self.above.is_some() {
            true => Interrupt::default(),
            false => app.interrupt().clone(),
        };
        let mut app = match app.again(interrupt) {
            Ok(app) => app,
            Err(error) => return self.fail(place, &error.to_string(), exit::UNREACHABLE),
        };
        let shown = move |seen: &sorma::watching::Seen| match json {
            true => watch::as_json(seen).to_string(),
            false if for_people => watch::line(seen, &replies::brief(&seen.reply)),
            false => watch::line(seen, watch::answer_of(seen)),
        };
        if let (true, Some(above)) = (wanted.background, self.above.clone()) {
            let wanted = wanted.clone();
            std::thread::spawn(move || {
                let say = |text: &str| drop(above.send(text.to_owned()));
                let show = |seen: &_| above.send(shown(seen)).is_ok();
                if let Err(why) = watch::watch(&mut app, &wanted, number, show, say) {
                    say(&why);
                }
            });
            return Flow::On;
        }
        let show = |seen: &_| show::data(&shown(seen)).is_ok();
        match watch::watch(&mut app, wanted, number, show, show::say) {
            Ok(()) => Flow::On,
            Err(why) => self.fail(place, &why, exit::FAILED),
        }
    }

    fn replied(
        &mut self,
        place: &Place<'_>,
        request: &str,
        text: &str,
        times: Option<&Times>,
    ) -> Flow {
        // The manager's own text: it reads back.
        let reply = match text.parse::<Reply>() {
            Ok(reply) => reply,
            Err(error) => return self.fail(place, &error.to_string(), exit::FAILED),
        };
        let written = if self.json {
            show::data(&replies::as_json(&reply, times).to_string())
        } else {
            let text = if self.for_people {
                let layout = helping::layout(request, self.backend.classes());
                table::for_terminal(&replies::for_people(&reply, &layout))
            } else {
                text.to_owned()
            };
            let timed = times.map(Times::text);
            let lines: Vec<String> = [Some(text), timed].into_iter().flatten().collect();
            match lines.iter().all(String::is_empty) {
                true => Ok(()),
                false => show::data(&lines.join("\n")),
            }
        };
        if written.is_err() {
            // The reader has closed the output.
            return Flow::Stop;
        }
        self.remember(&reply.body);
        if !reply.body.is_ok() {
            let told = reply.body.reports.iter().map(told);
            // At the prompt numbers need no keyword.
            let told = told.map(|told| match told.split_once(": write FMSG ") {
                Some((before, _)) if self.for_people => before.to_owned(),
                _ => told,
            });
            let told: Vec<String> = told.collect();
            let (name, code) = (&reply.name, reply.body.code);
            self.pending = Some(Failure {
                place: place.to_string(),
                text: match self.for_people && !told.is_empty() {
                    true => told.join("\n"),
                    false => format!("{name} ended with {code}\n  {}", told.join("\n  ")),
                },
                exit: exit_of(reply.body.code),
            });
        }
        self.last = Some(reply.body);
        Flow::On
    }

    /// Sets the variables of the last reply.
    fn remember(&mut self, body: &Transport) {
        let counted = |count: usize, numbers: Vec<String>| {
            let mut words = vec![count.to_string()];
            words.extend(numbers);
            words.join(" ")
        };
        let floats = body.floats.iter().map(|float| format!("{float:?}"));
        let ints = body.ints.iter().map(ToString::to_string);
        let values = [
            body.code.to_string(),
            words::quoted(&body.text),
            counted(body.floats.len(), floats.collect()),
            counted(body.ints.len(), ints.collect()),
        ];
        for (name, value) in script::REPLY.into_iter().zip(values) {
            self.variables.insert(name.to_owned(), value);
        }
    }

    /// For the prompt: shows what pends, without ending anything.
    pub fn forget_failure(&mut self) {
        if let Some(failure) = self.pending.take() {
            show::say(&table::for_messages(&failure.text));
        }
    }
}

/// The exit code that a return code means.
fn exit_of(ret: i32) -> u8 {
    match ret {
        code::UNKNOWN_CLASS | code::UNKNOWN_FLAVOR => exit::NO_SUCH_NAME,
        code::DAEMON => exit::UNREACHABLE,
        code::LATE => exit::TIMED_OUT,
        _ => exit::FAILED,
    }
}

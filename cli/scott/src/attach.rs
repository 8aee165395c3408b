//! A running app as scott asks it: over its control socket, by lines of text to its daemons. These are the tasks with
//! the handler `sorma.daemon`. A connection that is lost is made again by the next request.

use std::{
    fmt,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use ctos::{
    control::protocol::{Answer, AppView, ErrorCode, Request, SayRequest},
    time::Clock,
};
use sorma::{ClassInfo, Location, ObjectName, Reply, Report, daemon, report::code, words};

use super::patience::{self, PATIENCE};
use cli_common::{
    client::{Client, ClientError, Within},
    remote::{self, AtArgs, RemoteArgs, connect_to},
};

/// How often `scott` looks whether the user has given up waiting.
const LOOK: Duration = Duration::from_millis(100);
/// How long `scott` waits for an answer, unless the user says otherwise, s.
pub const LIMIT_S: f64 = 60.0;
/// What the app may need besides, to say that the answer did not come.
const GRACE: Duration = Duration::from_secs(5);
/// What the prompt may take to learn what there is. Whatever is not there by then is not offered.
const GLANCE: Duration = Duration::from_millis(100);

/// Which app, and how it is reached.
#[derive(Debug, Clone, Default)]
pub struct Where {
    /// Its name, process id or NAME-PID here; the only one when there is none.
    pub app: Option<String>,
    /// Its place on another host.
    pub at: AtArgs,
    /// The daemon that is asked when a name says none.
    pub daemon: Option<String>,
    /// How long `scott` waits for an answer.
    pub limit: Limit,
}

/// How long `scott` waits for an answer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limit(pub Duration);

impl Default for Limit {
    fn default() -> Self {
        Self(Duration::from_secs_f64(LIMIT_S))
    }
}

/// Why an app cannot be asked.
#[derive(Debug, thiserror::Error)]
pub enum AttachError {
    /// It cannot be reached.
    #[error(transparent)]
    Client(#[from] ClientError),
    /// It has nobody to ask.
    #[error(
        "app `{0}` has no daemon of service objects; give it a task with `handler = \"sorma.daemon\"`, or boot it with a \
         profile that has one, as `--profile objects` of the calibration does"
    )]
    NoDaemon(String),
    /// It has others.
    #[error("app `{app}` has no daemon `{name}`; it has {}", .known.join(", "))]
    NoSuchDaemon {
        /// The app.
        app: String,
        /// The name.
        name: String,
        /// Those that it has.
        known: Vec<String>,
    },
}

/// The user has pressed Ctrl-C.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Interrupted;

/// Set by Ctrl-C, and cleared by the code that obeys.
pub type Interrupt = Arc<AtomicBool>;

/// A running app.
#[derive(Debug)]
pub struct App {
    place: Where,
    name: String,
    client: Option<Client>,
    daemons: Vec<String>,
    /// What stands for tasks at other sites; daemons may be among them.
    abroad: Vec<String>,
    entry: String,
    interrupt: Interrupt,
    classes: Option<Vec<ClassInfo>>,
    /// Somebody reads what is waited for.
    watched: bool,
}

impl App {
    /// Attaches to an app.
    ///
    /// # Errors
    /// It cannot be reached, or has no such daemon.
    pub fn attach(place: Where, interrupt: Interrupt) -> Result<Self, AttachError> {
        let client = connect_to(place.app.as_deref(), &place.at)?;
        let mut app = Self {
            name: client.app().app.clone(),
            place,
            client: Some(client),
            daemons: Vec::new(),
            abroad: Vec::new(),
            entry: String::new(),
            interrupt,
            classes: None,
            watched: patience::is_there(),
        };
        app.learn()?;
        Ok(app)
    }

    /// Which daemons there are, and which of them is asked first.
    fn learn(&mut self) -> Result<(), AttachError> {
        let Some(client) = &mut self.client else {
            return Ok(());
        };
        let view = remote::view(client)?;
        self.name.clone_from(&view.app);
        self.daemons = daemons(&view);
        let tasks = view.tasks.iter().map(|task| &task.name);
        self.abroad = tasks.filter(|name| name.contains('@')).cloned().collect();
        let Some(first) = self.daemons.first().or(self.abroad.first()) else {
            return Err(AttachError::NoDaemon(self.name.clone()));
        };
        let wanted = self.place.daemon.as_ref().unwrap_or(first);
        if !self.daemons.contains(wanted) && !self.abroad.contains(wanted) {
            return Err(AttachError::NoSuchDaemon {
                app: self.name.clone(),
                name: wanted.clone(),
                known: self.daemons.clone(),
            });
        }
        self.entry.clone_from(wanted);
        self.classes = None;
        Ok(())
    }

    /// Its name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Where it is, by its name, so that it is found again when it was started anew.
    #[must_use]
    pub fn place(&self) -> Where {
        let mut place = self.place.clone();
        if place.at.at.is_none() {
            place.app = Some(self.name.clone());
        }
        place
    }

    /// What Ctrl-C sets.
    #[must_use]
    pub fn interrupt(&self) -> &Interrupt {
        &self.interrupt
    }

    /// Its daemons; that which is asked first is among them.
    #[must_use]
    pub fn daemons(&self) -> &[String] {
        &self.daemons
    }

    /// The same app over a connection of its own.
    ///
    /// # Errors
    /// As [`Self::attach`].
    pub fn again(&self, interrupt: Interrupt) -> Result<Self, AttachError> {
        Self::attach(self.place(), interrupt)
    }

    fn client(&mut self) -> Result<&mut Client, AttachError> {
        if self.client.is_none() {
            let place = self.place();
            self.client = Some(connect_to(place.app.as_deref(), &place.at)?);
            if let Err(error) = self.learn() {
                self.client = None;
                return Err(error);
            }
        }
        match &mut self.client {
            Some(client) => Ok(client),
            // Just made.
            None => Err(AttachError::Client(ClientError::NoApp)),
        }
    }

    /// Has a request line met; what comes back is a reply, whatever happens.
    ///
    /// # Errors
    /// [`Interrupted`]: nobody waits for the reply any more, and the connection was given up.
    pub fn dispatch(&mut self, line: &str, trace: u64) -> Result<String, Interrupted> {
        // A connection of an app that has ended meanwhile, with nobody to tell.
        if self.client.as_mut().is_some_and(Client::has_ended) {
            self.client = None;
        }
        if let Err(error) = self.client() {
            return Ok(refusal(line, &error.to_string()));
        }
        let (task, line, named) = self.addressed(line);
        match self.said(&task, &line, trace)? {
            Ok(reply) => Ok(match named {
                None => reply,
                Some(name) => renamed(&reply, name),
            }),
            Err(Unsaid::Lost(why)) => Ok(refusal(&line, &why)),
            Err(Unsaid::Late) => {
                let late = self.why_late(&task);
                let limit = self.place.limit.0.as_secs_f64();
                let why = format!("no answer of `{task}` within {limit} s (--limit): {late}");
                Ok(refused(&line, code::LATE, &why))
            }
        }
    }

    /// What a daemon that does not answer is at, and what can be done.
    fn why_late(&mut self, task: &str) -> Late {
        let status = Request::Status {
            name: task.to_owned(),
        };
        let status = match self.client.as_mut().map(|client| client.get(status)) {
            Some(Ok(Answer::Status(status))) => status,
            _ => {
                return Late {
                    what: "the app does not say why".to_owned(),
                    remedy: None,
                };
            }
        };
        let chassis = &status.chassis.name;
        let at = RemoteArgs {
            app: self.place.app.clone(),
            at: self.place.at.clone(),
        };
        let client = self.client.as_ref();
        let option = client.map_or_else(String::new, |client| at.option(client.app()));
        let remedy = Some(format!("`ctos restart {chassis}{option}` ends it"));
        if let Some(busy) = self
            .glance(task, "sorm CTRL -busy")
            .filter(|busy| !busy.is_empty())
        {
            let busy = busy.lines().collect::<Vec<_>>().join("; ");
            let what = format!("objects of chassis `{chassis}` are in calls: {busy}");
            return Late { what, remedy };
        }
        let does = status.tasks.first().map(remote::does).unwrap_or_default();
        let what = format!("`{task}` on chassis `{chassis}`: {does}");
        Late { what, remedy }
    }

    /// Tells a person who waits what is waited for. The connection is waiting, so another one asks.
    fn tell_wait(&self, task: &str) {
        let Ok(mut other) = self.again(Interrupt::default()) else {
            return;
        };
        let Late { what, remedy } = other.why_late(task);
        let remedy = remedy.map_or_else(String::new, |remedy| format!(", {remedy}"));
        patience::tell(&format!("{what}; Ctrl-C gives up{remedy}"));
    }

    /// Which daemon a line is for, the line as it is for that daemon, and the name that the reply is to have.
    fn addressed(&self, line: &str) -> (String, String, Option<ObjectName>) {
        let entry = || (self.entry.clone(), line.to_owned(), None);
        let Some((word, rest)) = line
            .trim_start()
            .split_once(|letter: char| letter.is_ascii_whitespace())
        else {
            return entry();
        };
        match word.parse::<ObjectName>() {
            Ok(name) => match name.location() {
                Location::Alias(daemon)
                    if self.daemons.contains(daemon) || self.abroad.contains(daemon) =>
                {
                    let local = format!("{} {rest}", name.local());
                    (daemon.clone(), local, Some(name.clone()))
                }
                _ => entry(),
            },
            Err(_) => entry(),
        }
    }

    /// Says a line to a daemon.
    ///
    /// # Errors
    /// Inside: why there is no answer. Outside: [`Interrupted`].
    pub fn say(
        &mut self,
        task: &str,
        line: &str,
        trace: u64,
    ) -> Result<Result<String, String>, Interrupted> {
        let said = self.said(task, line, trace)?;
        Ok(said.map_err(|unsaid| match unsaid {
            Unsaid::Lost(why) => why,
            Unsaid::Late => format!("no answer of `{task}`: {}", self.why_late(task)),
        }))
    }

    fn said(
        &mut self,
        task: &str,
        line: &str,
        trace: u64,
    ) -> Result<Result<String, Unsaid>, Interrupted> {
        let Limit(limit) = self.place.limit;
        let request = Request::Say(SayRequest {
            task: task.to_owned(),
            line: line.to_owned(),
            trace,
            limit_s: Some(limit.as_secs_f64()),
        });
        let clock = Clock::real();
        let begun = clock.now();
        let until = begun + limit + GRACE;
        let mut tells = self.watched;
        let lost = |app: &Self, why: &str| Ok(Err(Unsaid::Lost(lost(&app.name, why))));
        let asked = match self.client() {
            Ok(client) => client.ask(request),
            Err(error) => return Ok(Err(Unsaid::Lost(error.to_string()))),
        };
        match asked {
            Ok(()) => {}
            // Nothing was sent.
            Err(ClientError::Refused(refused)) => return Ok(Err(Unsaid::Lost(refused.message))),
            Err(error) => {
                self.client = None;
                return lost(self, &error.to_string());
            }
        }
        loop {
            let Some(client) = &mut self.client else {
                return lost(self, "the connection was closed");
            };
            let came = client.read_within(LOOK);
            match came {
                Ok(Within::Answer(answer)) => {
                    return Ok(match *answer {
                        Answer::Said { line } => Ok(line),
                        other => Err(Unsaid::Lost(format!("{other:?} is no answer to this"))),
                    });
                }
                Ok(Within::NotYet) => {
                    if self.interrupt.swap(false, Ordering::Relaxed) {
                        // Its answer must not be taken for that of a later request.
                        self.client = None;
                        return Err(Interrupted);
                    }
                    if clock.now() > until {
                        self.client = None;
                        return lost(self, "the app itself does not answer");
                    }
                    if tells && clock.now().since(begun) >= PATIENCE {
                        tells = false;
                        self.tell_wait(task);
                    }
                }
                Ok(Within::Closed) => self.client = None,
                Err(ClientError::Refused(refused)) if refused.code == ErrorCode::TimedOut => {
                    return Ok(Err(Unsaid::Late));
                }
                Err(ClientError::Refused(refused)) => {
                    let hint = match refused.code {
                        ErrorCode::BadRequest => "; is the app of an earlier version?",
                        _ => "",
                    };
                    return Ok(Err(Unsaid::Lost(format!("{}{hint}", refused.message))));
                }
                Err(error) => {
                    self.client = None;
                    return lost(self, &error.to_string());
                }
            }
        }
    }

    /// What a program may know about the classes of the daemon that is asked first, as the app itself tells it.
    /// Nothing, when the app does not tell in time.
    pub fn classes(&mut self) -> Option<&[ClassInfo]> {
        if self.classes.is_none() {
            let text = self.glance(&self.entry.clone(), "sorm CTRL -describe")?;
            let lines = text.lines();
            let classes = lines.filter_map(|line| serde_json::from_str(line).ok());
            let mut classes: Vec<ClassInfo> = classes.collect();
            classes.sort_by(|a, b| a.name.cmp(&b.name));
            self.classes = Some(classes);
        }
        self.classes.as_deref()
    }

    /// The names of its objects and flavors; none, when it does not tell in time.
    pub fn names(&mut self) -> Vec<String> {
        let mut names = Vec::new();
        for line in ["sorm CTRL -list", "dict CTRL -list"] {
            let text = self.glance(&self.entry.clone(), line).unwrap_or_default();
            let found = words::split(&text).unwrap_or_default();
            names.extend(found.into_iter().map(|word| word.text));
        }
        names
    }

    /// The text of an answer that comes at once. Says nothing when there is none.
    fn glance(&mut self, task: &str, line: &str) -> Option<String> {
        let client = self.client.as_mut()?;
        let request = Request::Say(SayRequest {
            task: task.to_owned(),
            line: line.to_owned(),
            trace: 0,
            limit_s: Some(GLANCE.as_secs_f64()),
        });
        let clock = Clock::real();
        let until = clock.now() + GLANCE * 2;
        if client.ask(request).is_err() {
            self.client = None;
            return None;
        }
        loop {
            let left = until.since(clock.now());
            if left.is_zero() {
                // Its answer must not be taken for that of a later request.
                self.client = None;
                return None;
            }
            match client.read_within(left) {
                Ok(Within::Answer(answer)) => {
                    let Answer::Said { line } = *answer else {
                        return None;
                    };
                    let reply: Reply = line.parse().ok()?;
                    return reply.body.is_ok().then_some(reply.body.text);
                }
                Ok(Within::NotYet) => {}
                Err(ClientError::Refused(_)) => return None,
                Ok(Within::Closed) | Err(_) => {
                    self.client = None;
                    return None;
                }
            }
        }
    }
}

/// Why an answer does not come, and what can be done.
struct Late {
    what: String,
    remedy: Option<String>,
}

impl fmt::Display for Late {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.what)?;
        match &self.remedy {
            None => Ok(()),
            Some(remedy) => write!(f, "; {remedy}"),
        }
    }
}

/// Why a line has no answer.
enum Unsaid {
    /// It, or its answer, was lost.
    Lost(String),
    /// It did not come in time.
    Late,
}

fn daemons(view: &AppView) -> Vec<String> {
    let tasks = view.tasks.iter();
    let daemons = tasks.filter(|task| task.handler == daemon::HANDLER);
    daemons.map(|task| task.name.clone()).collect()
}

fn lost(app: &str, why: &str) -> String {
    format!(
        "the answer of app `{app}` was lost: {why}; whether the request was met is not known, and the next one \
         looks for the app again"
    )
}

/// The reply under the name that was asked.
fn renamed(reply: &str, name: ObjectName) -> String {
    let Ok(reply) = reply.parse::<Reply>() else {
        return reply.to_owned();
    };
    let reply = Reply { name, ..reply };
    // What was read from text has a text.
    reply.to_text().unwrap_or_default()
}

/// The reply of an object that nobody could ask.
pub(crate) fn refusal(line: &str, why: &str) -> String {
    refused(line, code::DAEMON, why)
}

fn refused(line: &str, code: i32, why: &str) -> String {
    let name = line.split_whitespace().next().unwrap_or_default();
    let name = match name.parse::<ObjectName>() {
        Ok(name) => name.to_string(),
        Err(_) => "sorm".to_owned(),
    };
    let report = Report::error(code, why);
    format!(
        "{name} RET {} TDBX {}",
        report.code,
        words::quoted(&report.to_line())
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn app() -> App {
        App {
            place: Where::default(),
            name: "cell".to_owned(),
            client: None,
            daemons: vec!["desk".to_owned(), "cage".to_owned()],
            abroad: vec!["d1@north".to_owned()],
            entry: "desk".to_owned(),
            interrupt: Interrupt::default(),
            classes: None,
            watched: false,
        }
    }

    #[test]
    fn a_line_goes_to_the_daemon_in_its_name_or_to_the_first() {
        let app = app();
        let to = |line: &str| {
            let (task, line, _) = app.addressed(line);
            (task, line)
        };
        let pair = |a: &str, b: &str| (a.to_owned(), b.to_owned());
        assert_eq!(to("foo.a@cage  EXEC now"), pair("cage", "foo.a  EXEC now"));
        assert_eq!(to("foo.a@d1@north EXEC"), pair("d1@north", "foo.a EXEC"));
        // The first one's dictionary knows more names of daemons, and which one serves a class.
        assert_eq!(to("foo.a@d1 EXEC"), pair("desk", "foo.a@d1 EXEC"));
        assert_eq!(to("FOO.a EXEC"), pair("desk", "FOO.a EXEC"));
        assert_eq!(to("nonsense"), pair("desk", "nonsense"));
        assert_eq!(to("'a@cage' EXEC"), pair("desk", "'a@cage' EXEC"));
    }

    #[test]
    fn a_reply_has_the_name_that_was_asked_and_a_refusal_reads_back() {
        let name: ObjectName = "foo.a@cage".parse().unwrap();
        assert_eq!(
            renamed("foo.a RET 0 TMSG hello FMSG 1 nan", name),
            "foo.a@cage RET 0 TMSG hello FMSG 1 nan"
        );
        let reply: Reply = refusal("foo.a@cage EXEC", "it is \"gone\"")
            .parse()
            .unwrap();
        assert_eq!(reply.name.to_string(), "foo.a@cage");
        assert_eq!(reply.body.code, code::DAEMON);
        assert_eq!(reply.body.reports[0].text, "it is \"gone\"");
    }
}

//! Whole apps: booted in virtual time in this process, or as processes.

use std::{
    ffi::OsString,
    fmt::Write as _,
    future::IntoFuture as _,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
    time::Duration,
};

use ctos::{
    boot::{BootEvent, End, Launcher, Observer, boot, run_chassis, simulate},
    call::CallError,
    config::{App, Selection, load_texts},
    message::{Command as _, Message, Replier},
    record::{Filter, Record, scan_only},
    registry::Registry,
    system::AppResult,
    task::{Context, EventHandler, Handled, Phase},
    time::{Clock, Instant},
};
use fleet::table::FleetExpander;
use futures_util::future::{join, join_all};
use pnt::{
    stream::{Follow, Mark},
    task::PutTape,
};
use serde::Deserialize;

use crate::{
    areas::{Failed, cost},
    curve::Cost,
};

/// The first argument of a process that is a chassis.
pub const CHASSIS: &str = "growth-chassis";

/// So many names are looked up: fewer than are asked for between two looks of a chassis at its tasks.
const LOOKED_UP: u64 = 1_000;

/// What the last task does where only the boot is measured.
const END: &str = "{ work = \"end\", size = 0 }";

/// So many calls from a chassis to another one.
const CALLED: u64 = 2_000;

/// The tasks of one processor.
const ON_ONE: u64 = 50_000;

/// So many firings does each display see.
const SHOWN: u16 = 20;

/// Long enough for everything.
const HOUR: Duration = Duration::from_secs(3600);

/// Between two calls that shall not be at the same moment.
const PAUSE: Duration = Duration::from_millis(1);

/// The app ends so long after its last task is done.
const AFTER: Duration = Duration::from_millis(500);

ctos::command! {
    /// Is answered at once.
    pub struct Ask { pub number: u64 } => u64, 1, "ask"
}
ctos::command! {
    /// Is answered when so many have come.
    pub struct Wait { pub all: u64 } => (), 2, "wait"
}

/// Answers.
#[derive(Default)]
struct Idle {
    waiting: Vec<Replier<Wait>>,
}

impl EventHandler for Idle {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            Ask::CODE => {
                let (Ask { number }, reply) = message.open::<Ask>()?;
                reply.ok(number)
            }
            Wait::CODE => {
                let (Wait { all }, reply) = message.open::<Wait>()?;
                self.waiting.push(reply);
                if self.waiting.len() as u64 == all {
                    for reply in self.waiting.drain(..) {
                        reply.ok(())?;
                    }
                }
                Ok(())
            }
            _ => cx.default_processing(message),
        }
    }
}

/// What the last task does before the app ends.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Work {
    /// Nothing.
    End,
    /// Looks tasks up by their names.
    LookUp,
    /// Calls a task that answers when all have called.
    CallAtOnce,
    /// Calls a task, one call after the other.
    Call,
    /// The same, one call each millisecond.
    CallInTime,
    /// Follows a net with so many displays while it fires.
    Follow,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct LastArgs {
    work: Work,
    size: u64,
    /// Whom it calls.
    #[serde(default = "first")]
    to: String,
}

fn first() -> String {
    "t0".to_owned()
}

/// Works, and ends the app.
struct Last(LastArgs);

impl EventHandler for Last {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let (size, clock) = (self.0.size, Clock::real());
            if let Work::LookUp = self.0.work {
                // The others enter their phase meanwhile, which is no part of a question for a name.
                cx.sleep(AFTER).await;
            }
            let begun = clock.now();
            match self.0.work {
                Work::End => {}
                Work::LookUp => {
                    for at in 0..size.min(LOOKED_UP) {
                        cx.task(&format!("t{}", at * 7919 % size)).await?;
                    }
                }
                Work::CallAtOnce => {
                    let to = cx.task("t0").await?;
                    let calls = (0..size).map(|_| cx.call(&to, Wait { all: size }).deadline(HOUR));
                    for answer in join_all(calls).await {
                        answer?;
                    }
                }
                Work::Follow => follow(cx, size).await?,
                work @ (Work::Call | Work::CallInTime) => {
                    let to = cx.task(&self.0.to).await?;
                    for number in 0..size {
                        cx.call(&to, Ask { number }).await?;
                        if let Work::CallInTime = work {
                            cx.sleep(PAUSE).await;
                        }
                    }
                }
            }
            let took_s = clock.now().since(begun).as_secs_f64();
            let shared = shares();
            let told = AppResult {
                ok: true,
                text: String::new(),
                json: format!("[{took_s}, {shared}]"),
            };
            let child = cx.clone();
            // First all others have acknowledged the phase.
            cx.spawn(async move {
                child.sleep(AFTER).await;
                child.finish(told);
            });
        }
        Ok(())
    }
}

/// Has so many displays see each of [`SHOWN`] firings.
async fn follow(cx: &Context, displays: u64) -> Handled {
    let net = cx.task("n0").await?;
    let look = |after, patience_ms| {
        let follow = Follow { after, patience_ms };
        cx.call(&net, follow).into_future()
    };
    let mut seen = join_all((0..displays).map(|_| look(None, 0))).await;
    for _ in 0..SHOWN {
        let marks = seen.into_iter().map(|one| Ok(one?.mark));
        let marks: Vec<Mark> = marks.collect::<Result<_, CallError>>()?;
        let next = marks.into_iter().map(|mark| look(Some(mark), 10_000));
        let fire = PutTape {
            symbol: "go".to_owned(),
            arguments: Vec::new(),
        };
        let (next, fired) = join(join_all(next), cx.call(&net, fire).into_future()).await;
        fired?;
        if next.iter().flatten().any(|batch| batch.events.is_empty()) {
            return Err("a display did not see a firing".into());
        }
        seen = next;
    }
    Ok(())
}

/// The memory of all processes of this one's group of brothers and sisters, bytes; what several share counts once.
fn shares() -> f64 {
    let status =
        |pid: &str| std::fs::read_to_string(format!("/proc/{pid}/status")).unwrap_or_default();
    let parent = |pid: &str| {
        let text = status(pid);
        let line = text.lines().find_map(|line| line.strip_prefix("PPid:"));
        line.map(|line| line.trim().to_owned())
    };
    let own = parent("self");
    let all = std::fs::read_dir("/proc").into_iter().flatten().flatten();
    let pids = all.map(|entry| entry.file_name().to_string_lossy().into_owned());
    let family =
        pids.filter(|pid| pid.parse::<u32>().is_ok() && own.is_some() && parent(pid) == own);
    let share = |pid: String| {
        let text = std::fs::read_to_string(format!("/proc/{pid}/smaps_rollup")).ok()?;
        let line = text.lines().find_map(|line| line.strip_prefix("Pss:"))?;
        line.split_whitespace().next()?.parse::<f64>().ok()
    };
    family.filter_map(share).sum::<f64>() * 1024.0
}

fn registry() -> Registry {
    let mut registry = Registry::new();
    registry.handler("idle", &[Ask::INFO, Wait::INFO], |_| Ok(Idle::default()));
    registry.handler("last", &[], |cx| Ok(Last(cx.args()?)));
    pnt_net::register(&mut registry);
    registry
}

/// The tasks of an app, spread over its processors, and the one that ends it.
fn tasks_text(size: u64, work: &str) -> Result<String, Failed> {
    let mut text = format!(
        "[app]\nuntil = \"last\"\n[chassis.a]\nprocessors = {{ p0 = {{}}, p1 = {{}}, last = {{}} }}\n\
         [task.last]\nhandler = \"last\"\non = \"a/last\"\nargs = {{ work = \"{work}\", size = {size} }}\n"
    );
    for at in 0..size {
        let on = at / ON_ONE;
        writeln!(text, "[task.t{at}]\nhandler = \"idle\"\non = \"a/p{on}\"")?;
    }
    Ok(text)
}

fn loaded(text: &str, sets: &[String]) -> Result<App, Failed> {
    let app = load_texts(&[("growth.toml", text)], sets, &[]);
    Ok(app.map_err(|findings| format!("{:?}", findings.into_sorted()))?)
}

/// Runs an app in virtual time; what its last task took, s.
fn simulated(app: App) -> Result<f64, Failed> {
    let observer: Observer = Arc::new(|_| ());
    let outcome = simulate(app, registry(), &[], &observer)?;
    took(&outcome.end).map(|[seconds, _]| seconds)
}

/// What the last task told: how long it took, s, and the memory of the app, bytes.
fn took(end: &End) -> Result<[f64; 2], Failed> {
    match end {
        End::Finished(result) => Ok(serde_json::from_str(&result.json)?),
        other => Err(format!("the app ended otherwise: {other:?}").into()),
    }
}

/// Reading and checking the file.
pub fn configuration(size: u64) -> Result<Cost, Failed> {
    let text = tasks_text(size, "end")?;
    Ok(cost(|| loaded(&text, &[]))?.0)
}

/// From what was read to the end of an app that does nothing.
pub fn tasks(size: u64) -> Result<Cost, Failed> {
    let app = loaded(&tasks_text(size, "end")?, &[])?;
    Ok(cost(|| simulated(app))?.0)
}

/// An app of chassis with so many tasks each, the first of which ends it.
fn chassis_text(size: u64, tasks: u64, work: &str) -> Result<String, Failed> {
    let mut text = format!(
        "[app]\nuntil = \"last\"\nphase_timeout_s = 600\n[chassis.c0]\n[task.last]\nhandler = \"last\"\non = \"c0\"\nargs = {work}\n",
    );
    for at in 0..size * tasks {
        let on = at / tasks;
        if at % tasks == 0 && on > 0 {
            writeln!(text, "[chassis.c{on}]")?;
        }
        if at > 0 {
            writeln!(text, "[task.t{at}]\nhandler = \"idle\"\non = \"c{on}\"")?;
        }
    }
    Ok(text)
}

/// Chassis in virtual time.
pub fn chassis(size: u64) -> Result<Cost, Failed> {
    let app = loaded(&chassis_text(size, 1, END)?, &[])?;
    Ok(cost(|| simulated(app))?.0)
}

/// Cells of three chassis with twenty tasks each, in virtual time.
pub fn fleet(size: u64) -> Result<Cost, Failed> {
    let app = loaded(&chassis_text(3 * size, 20, END)?, &[])?;
    Ok(cost(|| simulated(app))?.0)
}

/// The app of `configs/fleet.toml` with so many cells, fifty on a site, from its boot to its end.
///
/// # Errors
/// When it does not do its jobs.
pub fn fleet_work(cells: u64) -> Result<Cost, Failed> {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs/fleet.toml");
    let sites = cells.div_ceil(50);
    let selection = Selection {
        sets: vec![
            format!("fleet.cells={cells}"),
            format!("fleet.sites={sites}"),
        ],
        ..Selection::new(file)
    };
    let app = selection.load(&[("fleet", &FleetExpander)]);
    let app = app.map_err(|findings| findings.to_string())?;
    let mut registry = Registry::new();
    fleet::register(&mut registry);
    pnt::store::keep_states(&mut registry);
    let observer: Observer = Arc::new(|_| ());
    let (cost, ran) = cost(|| Ok(simulate(app, registry, &[], &observer)?))?;
    match ran.end {
        End::Finished(result) if result.ok => Ok(cost),
        other => Err(format!("the fleet ended with {other:?}").into()),
    }
}

/// How the processes of an app reach each other, and what its last task does.
struct Processes {
    size: u64,
    /// Their configuration beside that of sockets.
    sets: &'static [&'static str],
    work: String,
}

/// Peers of zenoh that find each other on this host.
#[cfg(feature = "zenoh")]
const PEERS: &[&str] = &["same_host=zenoh", "zenoh.multicast=lo"];

impl Processes {
    /// Calls of a task of another chassis.
    fn calling(size: u64, sets: &'static [&'static str]) -> Self {
        let work = format!("{{ work = \"call\", size = {CALLED}, to = \"t1\" }}");
        Self { size, sets, work }
    }

    fn resting(size: u64, sets: &'static [&'static str]) -> Self {
        let work = END.to_owned();
        Self { size, sets, work }
    }

    /// Boots them; the time until all tasks run, s, and what the last one told.
    fn run(self) -> Result<(f64, [f64; 2]), Failed> {
        let text = chassis_text(self.size, 1, &self.work)?;
        let sets: Vec<String> = self.sets.iter().map(|&set| set.to_owned()).collect();
        let arguments = [CHASSIS, &text]
            .into_iter()
            .chain(self.sets.iter().copied());
        let launcher = Launcher {
            program: std::env::current_exe()?,
            arguments: arguments.map(OsString::from).collect(),
        };
        let up = Arc::new(Mutex::new(None));
        let noted = up.clone();
        let clock = Clock::real();
        let begun = clock.now();
        let observer: Observer = Arc::new(move |event| {
            // Every task of the app runs.
            if let BootEvent::PhaseDone {
                phase: Phase::Run, ..
            } = event
            {
                let seconds = clock.now().since(begun).as_secs_f64();
                *noted.lock().unwrap_or_else(PoisonError::into_inner) = Some(seconds);
            }
        });
        let outcome = boot(loaded(&text, &sets)?, registry(), &launcher, &observer)?;
        let told = took(&outcome.end)?;
        let seconds = *up.lock().unwrap_or_else(PoisonError::into_inner);
        Ok((seconds.ok_or("it never ran")?, told))
    }

    /// Until all of them run; the memory is theirs.
    fn boot(self) -> Result<Cost, Failed> {
        let (seconds, [_, bytes]) = self.run()?;
        let bytes = Some(bytes);
        Ok(Cost { seconds, bytes })
    }

    /// One call.
    fn call(self) -> Result<Cost, Failed> {
        let (_, [seconds, _]) = self.run()?;
        Ok(Cost {
            seconds: seconds / CALLED as f64,
            bytes: None,
        })
    }
}

/// Chassis as processes, which reach each other by sockets and shared memory.
pub fn processes(size: u64) -> Result<Cost, Failed> {
    Processes::resting(size, &[]).boot()
}

/// A call between two of them.
pub fn processes_call(size: u64) -> Result<Cost, Failed> {
    Processes::calling(size, &[]).call()
}

/// The same as peers of zenoh.
#[cfg(feature = "zenoh")]
pub fn processes_zenoh(size: u64) -> Result<Cost, Failed> {
    Processes::resting(size, PEERS).boot()
}

/// A call between two of them.
#[cfg(feature = "zenoh")]
pub fn processes_zenoh_call(size: u64) -> Result<Cost, Failed> {
    Processes::calling(size, PEERS).call()
}

/// This process is a chassis of [`Processes`].
///
/// # Errors
/// It cannot be one.
pub fn be_chassis(arguments: &[String]) -> Result<(), Failed> {
    let [text, sets @ .., _, name, _, address, _, origin] = arguments else {
        return Err("a chassis is started by a boot".into());
    };
    let app = loaded(text, sets)?;
    run_chassis(app, registry(), name, &address.parse()?, origin.parse()?)?;
    Ok(())
}

/// One look-up of a task by its name.
pub fn names(size: u64) -> Result<Cost, Failed> {
    let seconds = simulated(loaded(&tasks_text(size, "look-up")?, &[])?)?;
    Ok(Cost {
        seconds: seconds / size.min(LOOKED_UP) as f64,
        bytes: None,
    })
}

/// An app of two tasks, one of which calls the other.
fn pair(size: u64, work: &str, sets: &[String]) -> Result<App, Failed> {
    let queue = size.clamp(64, 65_536);
    let text = format!(
        "[app]\nuntil = \"last\"\nphase_timeout_s = 3600\n[chassis.a]\n[task.t0]\nhandler = \"idle\"\non = \"a\"\nqueue = {queue}\n\
         [task.last]\nhandler = \"last\"\non = \"a\"\nargs = {{ work = \"{work}\", size = {size} }}\n"
    );
    loaded(&text, sets)
}

/// Calls that wait for their answers all at once.
pub fn calls(size: u64) -> Result<Cost, Failed> {
    let app = pair(size, "call-at-once", &[])?;
    let (Cost { bytes, .. }, seconds) = cost(|| simulated(app))?;
    Ok(Cost { seconds, bytes })
}

/// An app of tasks that run a net each, of one file in a folder.
fn turning(folder: &Path, nets: u64, work: &str, size: u64) -> Result<App, Failed> {
    let net = "net turn\nplace rest = 1\ncommand go -> gone\ntransition turn\n  in rest\n  tape go\n  out rest\n  write gone\n";
    std::fs::write(folder.join("turn.net"), net)?;
    let mut text = format!(
        "[app]\nuntil = \"last\"\n[chassis.a]\n[task.last]\nhandler = \"last\"\non = \"a\"\nargs = {{ work = \"{work}\", size = {size} }}\n"
    );
    for at in 0..nets {
        writeln!(
            text,
            "[task.n{at}]\nhandler = \"pnt.net\"\non = \"a\"\nargs.net = \"turn.net\""
        )?;
    }
    let file = folder.join("growth.toml").display().to_string();
    let app = load_texts(&[(&file, &text)], &[], &[]);
    Ok(app.map_err(|findings| format!("{:?}", findings.into_sorted()))?)
}

/// Tasks that run a net each.
pub fn net_tasks(size: u64) -> Result<Cost, Failed> {
    let folder = tempfile::tempdir()?;
    let app = turning(folder.path(), size, "end", 0)?;
    Ok(cost(|| simulated(app))?.0)
}

/// Displays that follow one net, for each firing.
pub fn displays(size: u64) -> Result<Cost, Failed> {
    let folder = tempfile::tempdir()?;
    let app = turning(folder.path(), 1, "follow", size)?;
    let (Cost { bytes, .. }, seconds) = cost(|| simulated(app))?;
    Ok(Cost {
        seconds: seconds / f64::from(SHOWN),
        bytes,
    })
}

/// A record of an app with so many calls, in a folder that ends with it.
struct Recorded {
    folder: tempfile::TempDir,
    cost: Cost,
}

impl Recorded {
    fn new(size: u64, work: &str) -> Result<Self, Failed> {
        let folder = tempfile::tempdir()?;
        let sets = [
            format!("record.file={:?}", folder.path().join("run.mcap")),
            "record.max_mb=1000000".to_owned(),
        ];
        let app = pair(size, work, &sets)?;
        let (Cost { seconds, .. }, _) = cost(|| simulated(app))?;
        let bytes = std::fs::metadata(folder.path().join("run.mcap"))?.len();
        let cost = Cost {
            seconds,
            bytes: Some(bytes as f64),
        };
        Ok(Self { folder, cost })
    }

    fn file(&self) -> PathBuf {
        self.folder.path().join("run.mcap")
    }
}

/// Writing it; the memory is that of the disk.
pub fn record(size: u64) -> Result<Cost, Failed> {
    Ok(Recorded::new(size, "call")?.cost)
}

/// Reading all of it, as lines for people.
pub fn record_read(size: u64) -> Result<Cost, Failed> {
    let recorded = Recorded::new(size, "call")?;
    Ok(cost(|| read(&recorded.file(), &Filter::default()))?.0)
}

/// Counting its lines.
pub fn record_info(size: u64) -> Result<Cost, Failed> {
    let recorded = Recorded::new(size, "call")?;
    Ok(cost(|| read(&recorded.file(), &nothing()))?.0)
}

/// Its last ten calls, without what is before.
pub fn record_seek(size: u64) -> Result<Cost, Failed> {
    let recorded = Recorded::new(size, "call-in-time")?;
    let last = Filter {
        from: Some(Instant::START + PAUSE * u32::try_from(size.saturating_sub(10))?),
        topics: vec!["/message/t0".to_owned()],
        ..Filter::default()
    };
    let (Cost { seconds, .. }, found) = cost(|| read(&recorded.file(), &last))?;
    if found == 0 {
        return Err("nothing was found".into());
    }
    Ok(Cost {
        seconds,
        bytes: None,
    })
}

/// Reading all of it into memory, as a replay does before it begins.
pub fn record_replay(size: u64) -> Result<Cost, Failed> {
    let recorded = Recorded::new(size, "call")?;
    let files = [recorded.file()];
    let (cost, record) = cost(|| Ok(Record::read(&files, &Filter::default())?))?;
    match record.entries.is_empty() {
        true => Err("nothing was read".into()),
        false => Ok(cost),
    }
}

/// What takes no line, as where lines are only counted.
fn nothing() -> Filter {
    Filter {
        topics: vec![String::new()],
        ..Filter::default()
    }
}

fn read(path: &Path, filter: &Filter) -> Result<u64, Failed> {
    let mut lines = 0;
    scan_only(path, filter, |_| lines += 1)?;
    Ok(lines)
}
